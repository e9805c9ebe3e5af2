/* modelwrite.h - weights files (modelfile.h) from the values of a network, tensor by tensor: memory
 * is that of the largest one. The file appears under its name when it is complete.
 * Invariant: same bytes for any number of threads. */
#ifndef FORMAT_MODELWRITE_H
#define FORMAT_MODELWRITE_H

#include "core/base/types.h"
#include "core/net/model.h"

/* Write all values of tensor t, in the order of the checkpoint, to out. May use r->pool. */
typedef err_t modelwrite_fetch(void *ctx, const struct run *r, const struct tensor_spec *t,
                               float *out);

struct modelwrite {
    struct net_dims dims; // checked
    enum precision precision;
    const char *source, *licence;
    modelwrite_fetch *fetch;
    void *ctx;
};

/* Bytes that modelwrite_run takes from r->tmp with a pool of `threads`. */
size_t modelwrite_need(const struct modelwrite *w, int threads);

/* Check before the work that the file can be written at `path` and has room there.
 * err:  ERR_ARG (no folder of that name), ERR_IO, ERR_LIMIT (no space). */
MUST_USE err_t modelwrite_check(const struct modelwrite *w, const char *path);

/* err:  those of fetch, ERR_FORMAT (a value is not finite, named), ERR_IO, ERR_LIMIT (no space),
 *       ERR_NOMEM, ERR_CANCELLED. A file at `path` is then unchanged. */
MUST_USE err_t modelwrite_run(const struct run *r, const struct modelwrite *w, const char *path);

#endif
