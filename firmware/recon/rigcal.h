/* rigcal.h - the calibration of a rig from takes of it: lens and pose of each camera, which all
 * takes share. */
#ifndef RECON_RIGCAL_H
#define RECON_RIGCAL_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/recipe.h"

#include "drivers/format/cameras.h"

enum { RIGCAL_TAKES = 64 };

/* One press of the whole rig. */
struct rigcal_take {
    const char *name; // its folder, for sentences
    const struct capture *capture;
    const struct prep_source *source;
};

struct rigcal_job {
    int n; // takes, 1 to RIGCAL_TAKES
    const struct rigcal_take *take;
    const struct job_config *cfg; // its network is not asked
};

struct rigcal_result {
    struct rig rig; // a view for each camera, by the name of one of its photographs; the world
                    // is that of the first camera, where a typical point lies at distance 1
    float rms_px;   // of the points in views of 448 px
    int inliers, observations;
    struct job_result *notes; // warnings, and the lenses found; malloc'd
};

/* Check that all takes are of the same cameras, 2 to BUNDLE_VIEWS_MAX, and say how much memory the
 * calibration takes. Captures need only names and sizes.
 * err:  ERR_ARG. */
MUST_USE err_t rigcal_plan(const struct rigcal_job *job, int threads, struct job_memory *out);

/* Calibrate. The arenas are as large as planned.
 * own:  rigcal_free.
 * err:  ERR_ARG (cameras that cannot be found, the sentence names one), those of decoding,
 *       ERR_NOMEM, ERR_CANCELLED. On error only *out may be freed. */
MUST_USE err_t rigcal_run(const struct run *r, const struct rigcal_job *job,
                          struct rigcal_result *out);

/* Accepts a zeroed result. */
void rigcal_free(struct rigcal_result *r);

#endif
