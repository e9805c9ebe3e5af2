/* align.h - estimate the cameras of photographs from a finished scene
 * (core/refine/README.md 1, C). The scene is frozen; each camera moves by its 6 degrees of freedom
 * (Adam, 1e-3 rad and 1e-3 of the scene's extent falling to 1 %), loss 0.8 (1 - SSIM) + 0.2 L1.
 * Cameras do not influence each other. */
#ifndef REFINE_ALIGN_H
#define REFINE_ALIGN_H

#include "core/base/types.h"

enum { ALIGN_ITERATIONS = 100 }; // core/refine/README.md 1, C

/* Bytes that align_run takes from r->tmp; of v only n and extent are read. */
size_t align_plan(int splats, const struct views *v, int threads);

/* Move v->cams[i] (for v->extent[i]) of every view; v->log2t and v->rgb are those of the
 * photographs.
 * err: ERR_ARG, ERR_NOMEM, ERR_CANCELLED (cameras are valid, partly aligned). */
MUST_USE err_t align_run(const struct run *r, const struct scene *s, int iterations,
                         struct views *v);

#endif
