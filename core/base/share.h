/* share.h - chunks of a pool dealt out to the ranks of a team, and the planes of views that they
 * computed. With run.team NULL: all chunks, and nothing to gather. */
#ifndef BASE_SHARE_H
#define BASE_SHARE_H

#include "core/base/types.h"

/* pool_for for those of n_chunks that are dealt to this rank (team_first). */
MUST_USE err_t share_for(const struct run *r, int n_chunks, pool_fn *fn, void *ctx);

/* data: n planes of `elem` bytes a pixel, as in px, each computed by the rank that view i of n is
 * dealt to: complete on all ranks.
 * err:  those of team.h. */
MUST_USE err_t share_gather(const struct run *r, void *data, size_t elem, const struct extent *px,
                           int n);

#endif
