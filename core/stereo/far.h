/* far.h - which pixels see what is infinitely far: sky. It has no texture that stereo could
 * measure, and what stereo says there is wrong.
 * Pure computation; thread: any. The result does not depend on the number of threads. */
#ifndef STEREO_FAR_H
#define STEREO_FAR_H

#include "core/base/plan.h"
#include "core/stereo/sweep.h"

#define FAR_CONF 0.5f // of a pixel that sees the shell: usable, not measured

enum { FAR_SKY = 1, FAR_BLACK = 2 }; // a black backdrop

/* Put the pixels of sky on the shell (core/base/shell.h): regions that are smooth, at least as
 * bright as the upper half of the rest of the picture, or black where much of it is, reach its
 * border or are as bright as one that does, and look the same in the same direction in all views,
 * but where a nearer surface hides them.
 * d:    from sweep_run for these views. d->far is made, in r->keep; such pixels get FAR_CONF, and
 *       all others are put well inside the shell. Cameras in one place: nothing is done.
 * err:  ERR_NOMEM (see far_plan), ERR_CANCELLED. Then *d may be partly changed. */
MUST_USE err_t far_run(const struct run *r, const struct views *v, const struct tonemap *tone,
                       struct depthmaps *d);

/* Count the memory of far_run. maps: (n) shapes of the depth maps. */
void far_plan(struct plan *p, const struct extent *maps, int n);

#endif
