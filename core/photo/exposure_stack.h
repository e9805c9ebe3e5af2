/* exposure_stack.h - photographs of one place at several exposures: choosing those with new
 * information, and merging them to one picture.
 * Pure computation; the result does not depend on the number of threads. */
#ifndef PHOTO_EXPOSURE_STACK_H
#define PHOTO_EXPOSURE_STACK_H

#include "core/base/plan.h"
#include "core/base/types.h"

/* Leave out the photographs that show nothing better than others of their place, and put a good one
 * first: the one with the most information, or, staggered, the middle, the shortest and the longest
 * in turn (networks are trained on such sets).
 * out:  *io, with mid_log2t of the photographs left (staggered: of the first ones of the places).
 * err:  ERR_NOMEM (see exposure_stack_choose_plan), ERR_CANCELLED. */
MUST_USE err_t exposure_stack_choose(const struct run *r, const struct tonemap *tone,
                                     bool staggered, struct views *io);

/* One picture of each place from all of its photographs: 8 bits under a curve that is steep
 * wherever one of theirs is.
 * out:  *out as *v without further photographs, with pixels in r->tmp; *curve is its response.
 *       Without further photographs *v and *tone themselves.
 * err:  ERR_NOMEM, ERR_CANCELLED. */
MUST_USE err_t exposure_stack_merge(const struct run *r, const struct views *v,
                                    const struct tonemap *tone, struct views *out,
                                    struct tonemap *curve);

/* Remove photographs where keep is false; a place goes with all of its photographs.
 * keep: (n + n_more). */
void exposure_stack_drop(struct views *v, const bool *keep);

/* Count what they take: of v only its numbers are looked at. What is merged stays in tmp. */
void exposure_stack_choose_plan(struct plan *p, const struct views *v);
void exposure_stack_merge_plan(struct plan *p, const struct views *v);

#endif
