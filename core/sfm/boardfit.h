/* boardfit.h - the least squares of calibration with a board: cameras, their lenses and the poses
 * of the board that minimise the robust reprojection error of its corners. There are few unknowns,
 * so the normal equations are dense.
 * Pure functions; any thread. */
#ifndef SFM_BOARDFIT_H
#define SFM_BOARDFIT_H

#include "core/base/arena.h"
#include "core/base/lens.h"
#include "core/base/rig.h"
#include "core/sfm/covariance.h"

enum {
    BOARDFIT_POSE = 12,                // R row-major, t
    BOARDFIT_LENS = 1 + LENS_TERMS + 2 // ln focal length, terms, principal point (px)
};

/* A corner of the board as a camera sees it. */
struct boardfit_corner {
    int camera, take;
    double at[2];     // on the board, any unit, the same for all
    double px[2];     // of the photograph, pixel centres at .5
    double inward[2]; // px by which it moves where white spreads by 1 px over black
};

/* A point of the world as a camera sees it. */
struct boardfit_sight {
    int camera;
    double px[2], sigma; // of the photograph; px, expected error
};

/* Ordinary points, which are eliminated (Schur complement). */
struct boardfit_points {
    int n;
    const int *first;                   // (n + 1) sights of point i are first[i]..first[i+1]
    const struct boardfit_sight *sight; // at most BOARDFIT_SEEN of a point
    double (*at)[3];                    // (n) in the world
    double kernel;                      // expected errors, width of the loss
};

enum { BOARDFIT_SEEN = RIG_CAMERAS_MAX };

struct boardfit_lens {
    struct lens lens;                                 // fx = fy
    bool free[BOARDFIT_LENS];                         // which unknowns move
    double mean[BOARDFIT_LENS], prior[BOARDFIT_LENS]; // expected, and 1 / expected deviation
};

/* X_cam = R X_world + t of a camera, X_world = R X_board + t of a board. */
struct boardfit {
    int n_cameras, n_takes, n_lenses, n;
    const int *lens_of;             // (n_cameras)
    struct boardfit_lens *lens;     // (n_lenses)
    double (*pose)[BOARDFIT_POSE];  // (n_cameras)
    double (*board)[BOARDFIT_POSE]; // (n_takes)
    bool *camera_free,
        *board_free; // whether they move; others that corners name are where they are
    const struct boardfit_corner *corner; // (n)
    double sigma;                         // px, expected error of a corner
    struct boardfit_points points;        // n 0: none
};

/* Errors of a corner, px, and their derivatives by the twists (pose.h) of camera and board and by
 * the unknowns of the lens. False where the camera has no pixel for it. */
struct boardfit_jacobian {
    double error[2], camera[2][6], board[2][6], lens[2][BOARDFIT_LENS];
};
bool boardfit_jacobian(const struct boardfit *b, const struct boardfit_corner *c,
                       struct boardfit_jacobian *out);

/* Error alone, px; false as above. */
bool boardfit_error(const struct boardfit *b, const struct boardfit_corner *c, double error[2]);

/* Levenberg-Marquardt with the Cauchy loss of width `kernel`, px. Never raises the cost.
 * out:  *cost of the last state, in squares of sigma
 * err:  ERR_NOMEM (see boardfit_plan). */
MUST_USE err_t boardfit_run(struct arena *tmp, struct boardfit *b, double kernel, int steps,
                            double *cost);

/* How well the free cameras and all lenses are known, for errors of sigma. Every camera that
 * corners name is free: what moves all of them, and the boards, does not count (covariance.h), but
 * lengths are those of the board.
 * pose: (n_cameras); 0: fixed
 * lens: (n_lenses) standard errors; 0: fixed
 * err:  ERR_NOMEM, ERR_ARG (something is not determined). */
MUST_USE err_t boardfit_covariance(struct arena *tmp, struct boardfit *b,
                                   double (*pose)[COVARIANCE_POSE], double (*lens)[BOARDFIT_LENS]);

/* Where the unknowns of a camera, a lens, a board begin; those of a lens are its free ones. */
int boardfit_camera_at(const struct boardfit *b, int camera);
int boardfit_lens_at(const struct boardfit *b, int lens);

int boardfit_unknowns(const struct boardfit *b);

/* Pixel errors of a point; false where the camera has no pixel for it. */
bool boardfit_sight_error(const struct boardfit *b, const struct boardfit_sight *s,
                          const double at[3], double error[2]);

/* Bytes of both where everything may move. */
size_t boardfit_plan(int n_cameras, int n_takes, int n_lenses, int n_points);

#endif
