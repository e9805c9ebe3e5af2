/* gap.h - sky that no photograph shows because something stands before it, with sky on both sides.
 * Pure computation; thread: any. */
#ifndef STEREO_GAP_H
#define STEREO_GAP_H

#include "core/base/plan.h"
#include "core/base/shell.h"
#include "core/base/types.h"

/* Add splats on the shell in the directions, from its middle, that have none but have some within 8
 * degrees on both sides; they take the colours of these.
 * g:    of any degree; those on the shell are what is known. Never more than max in all.
 * err:  ERR_NOMEM (see gap_plan). Then *g is not changed. */
MUST_USE err_t gap_fill(const struct run *r, const struct shell *shell, struct gaussians *g,
                        int max);

/* Count the memory of gap_fill. */
void gap_plan(struct plan *p);

#endif
