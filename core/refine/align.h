/* align.h - estimate the cameras of photographs from a finished scene
 * (core/refine/README.md 5). The scene is frozen; each camera moves by its 6 degrees of freedom to
 * the least Huber loss of display values. Cameras do not influence each other.
 * Invariant: the result does not depend on the number of threads. */
#ifndef REFINE_ALIGN_H
#define REFINE_ALIGN_H

#include "core/base/types.h"

/* Bytes that align_run takes from r->tmp; of v only n and extent are read. */
size_t align_plan(int splats, const struct views *v);

/* Move v->cams[i] (for v->extent[i]) of every view; v->log2t, v->rgb and v->masked are those of the
 * photographs. A camera that sees nothing of the scene, or nothing but one colour, stays.
 * err: ERR_ARG, ERR_NOMEM, ERR_CANCELLED (cameras are valid, partly aligned). */
MUST_USE err_t align_run(const struct run *r, const struct scene *s, struct views *v);

#endif
