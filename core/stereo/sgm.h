/* sgm.h - semi-global smoothing of a matching cost volume over eight paths (Hirschmueller, PAMI
 * 2008). Pure computation on the workspace; thread: one per workspace. */
#ifndef STEREO_SGM_H
#define STEREO_SGM_H

#include "core/base/types.h"

/* Workspace. For a run with fewer pixels or planes than planned, set w, h and planes. */
struct sgm {
    int w, h, planes;    // px of the picture; planes
    const float *light;  // (h, w, 2) log2 luminance and its reliability 0..1, for the edges
    uint8_t *cost;       // (y, plane, x) matching cost, the caller's input
    int16_t *total;      // (y, plane, x) smoothed cost, the result
    int16_t *path;       // (2, 3, planes + 2, w + 2) rows of the paths that run down or up
    int16_t *least;      // (2, 3, w + 2) their minima over the planes
    int16_t *transposed; // (2, w, planes) a row with the planes innermost, and one path
};

/* For pictures up to w px wide with up to `pixels` pixels.
 * err:  ERR_NOMEM. */
MUST_USE err_t sgm_init(struct sgm *m, struct arena *a, int w, size_t pixels, int planes);

/* Fill m->total from m->cost. */
void sgm_run(struct sgm *m);

#endif
