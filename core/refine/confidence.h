/* confidence.h - how much of a scene the photographs prove, and where one more would prove most.
 *
 * A photograph sees a splat that is not behind what the scene shows there. It speaks for it with
 * the weight w = exp(-(e / 0.06)^2), e the mean difference of photograph and scene around it,
 * display values. Of a splat for which photographs of the total weight n speak, whose rays meet
 * under the angle a, the confidence is
 *   (1 - 2^(1 - n)) a^2 / (a^2 + (2 degrees)^2),  0 for n <= 1:
 * half for agreement of two, and half where an error of matching moves it as much as it is known.
 * Splats of the shell (core/base/shell.h) need no angle.
 * Invariant: results do not depend on the number of threads. */
#ifndef REFINE_CONFIDENCE_H
#define REFINE_CONFIDENCE_H

#include "core/base/plan.h"
#include "core/base/types.h"

/* Confidence below which a splat or a pixel is a guess. */
#define CONFIDENCE_GUESS 0.25f

enum confidence_way {
    CONFIDENCE_LEFT,
    CONFIDENCE_RIGHT,
    CONFIDENCE_ABOVE,
    CONFIDENCE_BELOW,
    CONFIDENCE_WAYS
};

enum { CONFIDENCE_STEP = 20 }; // degrees

/* One more photograph: CONFIDENCE_STEP around what input view `near` looks at. */
struct confidence_advice {
    struct camera cam;
    int near; // -1: no place is any use
    enum confidence_way way;
    float gain; // mean over its pixels of what their confidence would grow by
};

/* Count what confidence_run takes for scenes of up to `cap` splats. */
void confidence_plan(struct plan *p, int cap);

/* The confidence of every splat of s, seen by the photographs of v, one of each view of s.
 * out:  (s->g.n).
 * err:  those of raster_run, ERR_NOMEM. */
MUST_USE err_t confidence_measure(const struct run *r, const struct views *v,
                                  const struct scene *s, float *out);

/* Bytes of r->tmp that it takes for scenes of up to `cap` splats. */
size_t confidence_need(int cap);

/* The same into s->confidence, in r->keep, and where one more photograph would prove most.
 * out:  *advice: of places around up to 4 input views, the one that gains most while it sees enough
 *       that is known to be placed itself, and none was taken near it. */
MUST_USE err_t confidence_run(const struct run *r, const struct views *v, struct scene *s,
                              struct confidence_advice *advice);

/* The same splats with the logarithm of their confidence as radiance: drawn before black, they are
 * the confidence of pixels, 0 where there is no splat. s has confidence.
 * colour: (cap) is filled; *out points to it and into s. */
void confidence_splats(const struct scene *s, float *colour, struct gaussians *out);

#endif
