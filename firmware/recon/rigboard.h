/* rigboard.h - the calibration of a rig from a printed board (core/sfm/board.h) in its takes. */
#ifndef RECON_RIGBOARD_H
#define RECON_RIGBOARD_H

#include "firmware/recon/rigcal_job.h"

#include "core/base/plan.h"
#include "core/sfm/boardcal.h"
#include "core/sfm/match.h"

enum {
    RIGBOARD_LEAST = 4,    // tags in one photograph: then there is a board
    RIGBOARD_CORNERS = 512 // of a camera in a take, at most
};

struct rigboard {
    struct boardfit_corner *corner; // (n) by take, then camera; malloc'd
    int n, n_used, cap;             // n_used: that agree, which come first
    int tags[RIGCAL_TAKES];         // of all cameras
    int most;                       // tags in one photograph
    int n_lenses, lens_of[BOARDCAL_CAMERAS];
    struct boardcal_lens lens[BOARDCAL_CAMERAS];
    struct boardcal_result found;
};

/* Look for tags in all photographs, which are decoded as they were taken. Of several exposures the
 * mean counts where a tag has contrast. Photographs with tags of two boards are left out; they and
 * tags that are of no board become warnings of `notes`.
 * own:  rigboard_free, also on error.
 * err:  those of decoding, ERR_NOMEM, ERR_CANCELLED. */
MUST_USE err_t rigboard_find(const struct run *r, const struct rigcal_job *job,
                             struct job_result *notes, struct rigboard *out);
void rigboard_free(struct rigboard *b);

/* Whether there is a board. */
static inline bool rigboard_seen(const struct rigboard *b)
{
    return b->most >= RIGBOARD_LEAST;
}

/* Calibrate from what was found. *tied: all cameras are.
 * err:  those of boardcal_run. */
MUST_USE err_t rigboard_solve(const struct run *r, const struct rigcal_job *job, struct rigboard *b,
                              bool *tied);

/* The rig, if all cameras are tied: in metres if the job knows the size of a tag.
 * err:  ERR_NOMEM, ERR_FORMAT (a lens without numbers). */
MUST_USE err_t rigboard_write(const struct rigcal_job *job, const struct rigboard *b,
                              struct rigcal_result *out);

/* Metres of a unit of `rig`, whose views are in the order of the cameras: from the distances of
 * those that the board ties. 0 if it ties none, or the size of a tag is not known. */
double rigboard_metres(const struct rigcal_job *job, const struct rigboard *b,
                       const struct rig *rig);

/* err:  ERR_ARG: names two cameras that nothing ties. */
MUST_USE err_t rigboard_untied(const struct rigcal_job *job, const struct rigboard *b);

/* What boardcal_run was given, as it left it. */
struct boardcal rigboard_problem(const struct rigcal_job *job, const struct rigboard *b);

/* most: tracks of all takes. */
void rigboard_plan(struct plan *p, const struct rigcal_job *job, const struct match_tracks *most);

#endif
