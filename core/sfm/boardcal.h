/* boardcal.h - cameras of a rig, and their lenses, from the corners of tags on a board that is
 * moved from take to take: Zhang, "A flexible new technique for camera calibration" (PAMI 2000),
 * for many cameras that share the poses of the board.
 * Pure computation; the result does not depend on the number of threads. */
#ifndef SFM_BOARDCAL_H
#define SFM_BOARDCAL_H

#include "core/base/plan.h"
#include "core/base/rig.h"
#include "core/base/types.h"
#include "core/sfm/boardfit.h"

enum {
    BOARDCAL_CAMERAS = RIG_CAMERAS_MAX,
    BOARDCAL_TAKES = 64,
    BOARDCAL_LEAST = 8 // corners of a take with which a camera counts: of two tags
};

/* The lens of a physical camera; it has one focal length. */
struct boardcal_lens {
    int w, h;     // px of its photographs
    double focal; // px, expected; 0: not known
    bool pinhole; // it has no terms
    bool fisheye; // it is one; else that is found out
};

struct boardcal {
    int n_cameras, n_takes, n_lenses, n;
    const int *lens_of; // (n_cameras)
    const struct boardcal_lens *lens;
    struct boardfit_corner *corner; // (n), by take, then camera
};

/* pose: X_cam = R X_world + t, the world is that of the first camera of the part; board:
 * X_world = R X_board + t. Lengths are in units of the board. */
struct boardcal_result {
    int part[BOARDCAL_CAMERAS]; // cameras with the same number are tied; -1: sees no board
    int main_part;              // the one with most cameras; only it is solved
    double pose[BOARDCAL_CAMERAS][BOARDFIT_POSE];
    double board[BOARDCAL_TAKES][BOARDFIT_POSE];
    bool seen[BOARDCAL_TAKES];                            // the board has a pose
    struct boardfit_lens fit[BOARDCAL_CAMERAS];           // (n_lenses) what of the lenses moves
    struct lens lens[BOARDCAL_CAMERAS];                   // (n_lenses)
    double lens_sd[BOARDCAL_CAMERAS][BOARDFIT_LENS];      // standard errors; 0: fixed
    double covariance[BOARDCAL_CAMERAS][COVARIANCE_POSE]; // of the poses of the main part
    double depth[BOARDCAL_CAMERAS]; // median depth of the corners it sees, units
    double rms_px;                  // of the corners that agree
    int used;                       // these
};

/* Whether all cameras are tied. */
bool boardcal_tied(const struct boardcal *in, const struct boardcal_result *b);

/* Find cameras, lenses and boards.
 * in:   corners are moved by what white spreads over black, and those that do not agree go
 * err:  ERR_ARG (no camera sees a board), ERR_NOMEM (see boardcal_plan), ERR_CANCELLED. */
MUST_USE err_t boardcal_run(const struct run *r, struct boardcal *in, struct boardcal_result *out);

/* Adjust what boardcal_run found together with points of the takes, whose kernel is set here. All
 * cameras are tied. Points should agree with their sights within some pixels.
 * err:  ERR_NOMEM (see boardcal_plan), ERR_ARG, ERR_CANCELLED. */
MUST_USE err_t boardcal_refine(const struct run *r, struct boardcal *in,
                               const struct boardfit_points *points, struct boardcal_result *io);

/* Bytes that both take from r->tmp. n_sights: of n_points; 0: no points */
size_t boardcal_plan(int n_cameras, int n_takes, int n_corners, int n_points, int n_sights);

#endif
