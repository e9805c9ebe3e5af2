/* err.h - error codes and the sentence that goes with them.
 * The code says how to react; the sentence, kept per thread, says what happened to which object.
 * The function that detects an error calls err_fail; callers pass it on silently; main prints
 * err_text() once. */
#ifndef BASE_ERR_H
#define BASE_ERR_H

typedef enum {
    OK = 0,
    ERR_NOMEM = -1,       // give up cleanly
    ERR_ARG = -2,         // refuse the job: wrong request
    ERR_IO = -3,          // give up cleanly: the system refused a read or write
    ERR_FORMAT = -4,      // refuse the job: bytes from outside are malformed
    ERR_LIMIT = -5,       // refuse the job: it does not fit memory, space or a stated bound
    ERR_TIMEOUT = -6,     // retry
    ERR_LOST = -7,        // reopen the device
    ERR_UNSUPPORTED = -8, // refuse the job: this build or machine cannot do it
    ERR_BUSY = -9,        // retry later
    ERR_CANCELLED = -10,  // stop quietly
    ERR_AGAIN = -11       // nothing yet, poll again
} err_t;

#define MUST_USE __attribute__((warn_unused_result))

/* Remember the sentence for this thread and return `code`.
 * The sentence is cut at 511 bytes; arguments may point into the previous sentence. */
MUST_USE err_t err_fail(err_t code, const char *fmt, ...) __attribute__((format(printf, 2, 3)));

/* The last sentence of this thread; "" if there was none. Valid until the next err_fail. */
const char *err_text(void);

#endif
