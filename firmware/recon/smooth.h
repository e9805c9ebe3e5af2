/* smooth.h - weights that are fetched with the factors of core/net/smoothing.h in them, so that
 * int8 loses less. The factors of a block or trunk are found when its first tensor is fetched.
 * thread: one. */
#ifndef RECON_SMOOTH_H
#define RECON_SMOOTH_H

#include "core/net/smoothing.h"
#include "drivers/format/modelwrite.h"

struct smooth_group;

struct smooth {
    const struct net_dims *dims;
    modelwrite_fetch *fetch; // fetches the weights as they are
    void *ctx;
    struct smooth_group *groups; // found so far; own: smooth_free
};

/* The values of t with the factors in them; ctx is a struct smooth.
 * err:  those of fetch, ERR_NOMEM. */
modelwrite_fetch smooth_fetch;

/* Accepts a zeroed struct. */
void smooth_free(struct smooth *s);

#endif
