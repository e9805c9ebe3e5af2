#include "core/base/log.h"

#include <errno.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static atomic_int max_level = LOG_INFO;

void log_set_level(enum log_level level)
{
    atomic_store(&max_level, (int)level);
}

/* returns: bytes written. The caller keeps room for the end of the line. */
static size_t write_prefix(char *line, size_t cap, enum log_level level)
{
    int n = 0;
    if (isatty(STDERR_FILENO)) {
        struct timespec now;
        struct tm tm;
        char thread[16] = "?"; // the kernel's limit, terminating 0 included
        clock_gettime(CLOCK_REALTIME, &now);
        localtime_r(&now.tv_sec, &tm);
        pthread_getname_np(pthread_self(), thread, sizeof thread);
        n = snprintf(line, cap, "%02d:%02d:%02d.%03ld %s: ", tm.tm_hour, tm.tm_min, tm.tm_sec,
                     now.tv_nsec / 1000000, thread);
    } else if (getenv("JOURNAL_STREAM")) {
        n = snprintf(line, cap, "<%d>", (int)level);
    }
    return n < 0 ? 0 : (size_t)n;
}

static void write_all(const char *p, size_t n)
{
    while (n > 0) {
        ssize_t done = write(STDERR_FILENO, p, n);
        if (done < 0 && errno == EINTR)
            continue;
        if (done <= 0)
            return; // nowhere left to complain
        p += done;
        n -= (size_t)done;
    }
}

void log_write(enum log_level level, const char *fmt, ...)
{
    if ((int)level > atomic_load(&max_level))
        return;
    int saved_errno = errno;
    char line[1024];
    size_t n = write_prefix(line, sizeof line - 1, level);
    va_list ap;
    va_start(ap, fmt);
    int text = vsnprintf(line + n, sizeof line - n, fmt, ap);
    va_end(ap);
    size_t end = n + (text < 0 ? 0 : (size_t)text);
    if (end > sizeof line - 1)
        end = sizeof line - 1;
    for (size_t i = n; i < end; i++)
        if ((unsigned char)line[i] < 0x20 || line[i] == 0x7f)
            line[i] = '?';
    line[end] = '\n';
    write_all(line, end + 1);
    errno = saved_errno;
}
