/* contradict.h - whether photographs contradict the places of their cameras. Where parts of a scene
 * look alike, a camera can be placed at the wrong one of them with a small reprojection error: its
 * points fit, but what is beside and behind them does not.
 * A sample is a textured patch of a confirmed surface of one view in the picture of another that
 * sees it from about the same direction, with nothing known before it. It agrees where the other
 * view confirms the surface and looks the same there. It contradicts where that looks different and
 * the other view surely sees through the surface to something behind it, or confirms nothing at
 * all (Zach et al., "What can missing correspondences tell us about 3D structure and motion?", CVPR
 * 2008; Heinly et al., "Correcting for duplicate scene structure in sparse 3D reconstruction", ECCV
 * 2014). Two views in one place see the same whatever its depth: there every patch is a sample.
 * Exposures do not matter, and what is masked in either view is no sample.
 * Pure computation; thread: any. The result does not depend on the number of threads. */
#ifndef STEREO_CONTRADICT_H
#define STEREO_CONTRADICT_H

#include "core/base/plan.h"
#include "core/stereo/sweep.h"

#define CONTRADICT_VIEW 0.5f    // share of the samples in a view, more: its place is wrong
#define CONTRADICT_MEDIAN 0.04f // of the views, more: places are wrong, whichever they are

struct contradict {
    int n_wrong;    // views
    bool *wrong;    // (views) most of what the others have there contradicts it
    float *of_view; // (views) of the samples of others in its picture that agree or contradict, the
                    // share that contradicts; without those of views that are more wrong,
                    // and of the quarter of the others that contradicts most
    float median;   // of those that are not wrong and have samples; 0 where few contradict
};

/* v:    the views of the maps, with cameras. d: of sweep_run, and far_run or not.
 * out:  lives in r->tmp.
 * err:  ERR_NOMEM (see contradict_plan), ERR_CANCELLED. */
MUST_USE err_t contradict_run(const struct run *r, const struct views *v,
                              const struct tonemap *tone, const struct depthmaps *d,
                              struct contradict *out);

/* Count the memory, which is held until the caller resets r->tmp. maps: (n) shapes of the maps. */
void contradict_plan(struct plan *p, const struct extent *maps, int n);

#endif
