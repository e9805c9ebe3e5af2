/* local_tone.h - what telephones and the processors of boards do to a picture before its response
 * curve: each pixel gets a gain that depends on its surroundings. Here before the curve, one gain
 * for the three colours:
 *   BASE    the base layer (bilateral: Durand and Dorsey 2002; on a grid: Chen, Paris and Durand
 *           2007) is compressed towards middle grey to within two stops, finer detail keeps
 *           its contrast
 *   CLAHE   half of the way to equalised histograms of tiles, slopes at most 2 (Zuiderveld 1994)
 *   FUSION  the mean of gains of 0, 1.5 and 3 stops, weighted by how well each exposes the
 *           surroundings (after Mertens, Kautz and Van Reeth 2007)
 * All depend on how bright the picture is: a longer exposure is no multiple of a shorter one.
 * Pure computation, single thread; any thread. */
#ifndef SENSOR_LOCAL_TONE_H
#define SENSOR_LOCAL_TONE_H

#include "core/base/types.h"

enum local_tone {
    LOCAL_TONE_NONE,
    LOCAL_TONE_BASE,
    LOCAL_TONE_CLAHE,
    LOCAL_TONE_FUSION,
    LOCAL_TONES
};

#define LOCAL_TONE_WORDS "none|base|clahe|fusion"

/* exposure: (3, h, w) relative, 1 = full scale, cut to 0..1 and multiplied in place by gains > 0; a
 * picture that is all white stays white.
 * err: ERR_NOMEM (see local_tone_plan) */
MUST_USE err_t local_tone_run(struct arena *tmp, enum local_tone kind, int w, int h,
                              float *exposure);

/* Bytes of tmp. */
size_t local_tone_plan(enum local_tone kind, int w, int h);

#endif
