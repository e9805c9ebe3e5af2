/* rigcheck.h - whether the cameras of a calibrated rig are still where its calibration has them:
 * each camera's pose is fitted to points that the others place, and compared.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_RIGCHECK_H
#define SFM_RIGCHECK_H

#include "core/base/rig.h"
#include "core/sfm/match.h"

enum {
    RIGCHECK_LEAST = 3, // cameras: with two one cannot tell which of them moved
    RIGCHECK_MOST = RIG_CAMERAS_MAX
};

/* A camera moved if what it sees is more than this share of its longer edge off: half a pixel of
 * 448, 0.07 degrees for a field of view of 60. */
#define RIGCHECK_MOVED (1.0f / 900)

struct rigcheck_camera {
    int seen;                      // points that two others place, too
    bool known;                    // these are enough to tell
    bool moved;                    // by more than RIGCHECK_MOVED and 2.5 standard errors
    float off_px;                  // how far what it sees is off, px of the view, median
    float turned_deg;              // rotation from where the calibration has it
    float shift;                   // distance of the centres over that to the median point
    float turned_sd_deg, shift_sd; // standard errors of these
    struct camera cam;             // as fitted if it moved, else as calibrated
};

/* v:    only n, size and extent are read
 * cams: (n) pinholes of the views, where the rig has them; finite, focal lengths > 0
 * out:  (n)
 * err:  ERR_ARG (fewer than RIGCHECK_LEAST views), ERR_NOMEM (see rigcheck_plan), ERR_CANCELLED. */
MUST_USE err_t rigcheck_run(const struct run *r, const struct views *v,
                            const struct match_tracks *tracks, const struct camera *cams,
                            struct rigcheck_camera *out);

/* Count the memory of rigcheck_run; of t only n and n_tracks are read. */
void rigcheck_plan(struct plan *p, int n_views, const struct match_tracks *t);

#endif
