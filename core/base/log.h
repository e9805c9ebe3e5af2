/* log.h - one line per event on stderr. Used by drivers and firmware only: core returns errors.
 * Under systemd each line starts with its priority; on a terminal it starts with the time and the
 * thread's name.
 * thread: any; a line is one write, so lines of different threads do not mix. */
#ifndef BASE_LOG_H
#define BASE_LOG_H

/* syslog(3) priorities, which systemd reads. */
enum log_level { LOG_ERROR = 3, LOG_WARN = 4, LOG_INFO = 6, LOG_DEBUG = 7 };

/* Print events up to this level; LOG_INFO at the start. */
void log_set_level(enum log_level level);

/* Lines are cut at 1023 bytes; control characters become '?': a file name cannot forge a line. */
void log_write(enum log_level level, const char *fmt, ...) __attribute__((format(printf, 2, 3)));

#define log_error(...) log_write(LOG_ERROR, __VA_ARGS__)
#define log_warn(...) log_write(LOG_WARN, __VA_ARGS__)
#define log_info(...) log_write(LOG_INFO, __VA_ARGS__)
#define log_debug(...) log_write(LOG_DEBUG, __VA_ARGS__)

#endif
