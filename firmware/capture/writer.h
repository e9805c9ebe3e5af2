/* writer.h - a thread that puts takes into the store, so that cameras are served meanwhile: takes
 * go in by pointer, the outcome of each comes out. One is written while one more may wait.
 * thread: all functions from one thread; the store belongs to the writer until writer_close, but
 * store_list and store_room may be called. */
#ifndef CAPTURE_WRITER_H
#define CAPTURE_WRITER_H

#include "firmware/store/store.h"

#include <stdbool.h>

enum { WRITER_TEXT = 512 };

struct writer;

struct writer_outcome {
    struct take *take; // the caller's again
    err_t err;
    char id[STORE_ID_CAP], text[WRITER_TEXT]; // the stored take's id; the error's sentence
};

/* own:  writer_close. err: ERR_NOMEM, ERR_IO */
MUST_USE err_t writer_open(struct store *s, struct writer **out);

/* Waits for what is being written; what waits is written too. Accepts NULL. */
void writer_close(struct writer *w);

bool writer_free(struct writer *w); // writer_put would succeed

/* own:  the take is the writer's until its outcome. err: ERR_BUSY (one waits already) */
MUST_USE err_t writer_put(struct writer *w, struct take *t);

int writer_fd(struct writer *w); // readable when an outcome waits

/* err: ERR_AGAIN */
MUST_USE err_t writer_outcome(struct writer *w, struct writer_outcome *out);

/* Since when it has been busy with the present take, CLOCK_MONOTONIC ns; 0: idle. */
int64_t writer_since_ns(struct writer *w);

#endif
