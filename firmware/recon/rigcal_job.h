/* rigcal_job.h - what the calibration of a rig is made from, and what comes of it. */
#ifndef RECON_RIGCAL_JOB_H
#define RECON_RIGCAL_JOB_H

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
    double tag_mm;                // edge of a tag of the board as printed; 0: not known
    bool no_board;                // boards are not looked for
};

struct rigcal_result {
    struct rig rig; // a view for each camera, by the name of one of its photographs; the world
                    // is that of the first camera, where a typical point lies at distance 1, or
                    // rig.metres
    bool board;     // from the corners of tags, with so many points beside them
    int points;
    float rms_px; // of the points in views of 448 px, or of the corners in photographs
    int inliers, observations;
    struct job_result *notes; // warnings, and the lenses found; malloc'd
};

#endif
