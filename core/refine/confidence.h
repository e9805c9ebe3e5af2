/* confidence.h - how much of a scene the photographs prove, and where one more would prove most.
 *
 * A splat that n photographs see, whose rays meet under the angle a, has the confidence
 *   (1 - 2^(1 - n)) a^2 / (a^2 + (2 degrees)^2),
 * 0 if it is seen by none or one: half for agreement of two, and half where an error of matching
 * moves it as much as it is known. Splats of the shell (core/base/shell.h) need no angle. A
 * photograph sees the splat if it is not behind what the scene shows there.
 * Invariant: results do not depend on the number of threads. */
#ifndef REFINE_CONFIDENCE_H
#define REFINE_CONFIDENCE_H

#include "core/base/types.h"
#include "core/splat/raster.h"

/* Confidence below which a splat or a pixel is a guess. */
#define CONFIDENCE_GUESS 0.25f

struct confidence {
    /* The scene's own splats with the logarithm of their confidence as radiance: drawn before black,
     * they are the confidence of pixels, 0 where there is no splat. */
    struct gaussians g;
    float *seen;   // (cap) photographs that see the splat
    float *ray[3]; // (cap) sum of the unit vectors from them to it
    struct raster raster;
    struct render maps;
    float *gain; // (cap) plane of a drawing
};

/* Bytes that confidence_init takes for `cap` splats. */
size_t confidence_plan(int cap);

/* Room for scenes up to `cap` splats.
 * err:  ERR_NOMEM. */
MUST_USE err_t confidence_init(struct confidence *c, struct arena *a, int cap);

/* Fill c->g; planes but the colours are those of s, which must outlive it.
 * err:  those of raster_run. */
MUST_USE err_t confidence_run(const struct run *r, struct confidence *c, const struct scene *s);

/* One splat's, 0..1. */
float confidence_of(const struct confidence *c, int i);

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
    float gain; // mean over its pixels of what their confidence grows by
};

/* Of places around up to 8 input views, the one that gains most while it sees enough that is known
 * to be placed itself. After confidence_run.
 * err:  those of raster_run. */
MUST_USE err_t confidence_advise(const struct run *r, struct confidence *c, const struct scene *s,
                                 struct confidence_advice *out);

#endif
