/* refine_inner.h - what the files of refinement share. */
#ifndef REFINE_REFINE_INNER_H
#define REFINE_REFINE_INNER_H

#include "core/base/sha256.h"
#include "core/refine/density.h"
#include "core/refine/loss.h"
#include "core/refine/outliers.h"
#include "core/refine/pyramid.h"
#include "core/refine/refine.h"
#include "core/splat/raster.h"

enum { REFINE_GROUPS = 6 }; // of parameters with a learning rate of their own

/* The scene with the lowest held-out error of the rounds at full size; step 0: none yet. */
struct best {
    float db;
    int step;
    struct gaussians g;
    struct tonemap tone;
    struct camera *cams; // (n)
};

/* Hashes of what a refinement begins with. */
struct refine_input {
    char options[SHA256_HEX_CAP], photographs[SHA256_HEX_CAP], start[SHA256_HEX_CAP];
};

struct refine {
    const struct run *r;
    const struct views *v;
    const struct refine_config *cfg;
    struct scene *s;
    struct refine_report *rep;
    struct density d;
    struct raster raster;
    struct loss loss_work;
    struct render pic;
    struct pyramid photos;
    uint8_t *held;          // (n, squares, squares)
    int held_px, squares;   // edge of a square; squares of the longest edge
    struct outliers outliers;
    struct held_sum *bands; // of one photograph, see struct loss_input
    struct held_sum *sums;  // (photographs, squares, squares) of the last comparison of each
    int *shuffled, n_drawn; // (n) order of the views in this round
    uint64_t rng;
    float extent; // scene units
    int step, steps;
    int levels, level; // pictures of level k are 2^k times smaller
    float loss;        // sum since the start of the round
    int band_from;     // step at which the highest band was added, 0 = none on trial
    bool bands_done, splits_done;
    float noise_db;               // of the photographs, as a PSNR
    float best_db;                // held-out, at full size, as drawn in the rounds
    float split_db;               // the highest before a split at this level
    int splits_vain;              // splits since
    int measured;                 // step of the last comparison with the best scene
    struct best best;
    int stalled; // rounds without progress
    struct pace pace;
    double began, ready, expected; // s: by the clock; of the steps done, as timed in advance
    float tone_m1[TONE_PARAMS], tone_m2[TONE_PARAMS];
    float *pose_m; // (n, 12) moments of the twists
    int *pose_t;   // (n) steps of each camera
    struct adam_step group[REFINE_GROUPS];
    struct refine_input input; // with a saver
};

/* In a photograph. */
static inline size_t refine_squares(const struct refine *f)
{
    return (size_t)f->squares * (size_t)f->squares;
}

/* ---- refine_step.c ---- */

/* Share of the steps that are done, 0..1. */
float refine_step_progress(const struct refine *f);

/* The gradients of one view, or of parts of some, move the scene, its curve and its cameras. */
MUST_USE err_t refine_step_learn(struct refine *f);

/* The work of such a step on view i, without effect but on the held-out error. */
MUST_USE err_t refine_step_rehearse(struct refine *f, int i);

/* Held-out error of the last comparison with each photograph, dB; 0: nothing was held out. */
float refine_step_held_db(const struct refine *f);

/* The same by a comparison of all views now. */
MUST_USE err_t refine_step_measure(struct refine *f, float *db);

/* ---- refine_state.c ---- */

/* Before anything has changed. out: *resumed: refine_state_load follows, on all ranks. */
MUST_USE err_t refine_state_begin(struct refine *f, bool *resumed);

/* The state of cfg->saver.
 * err: ERR_ARG (of another job), ERR_FORMAT (damaged). */
MUST_USE err_t refine_state_load(struct refine *f);

/* Between two steps: save the state if the saver wants it.
 * err: ERR_CANCELLED. */
MUST_USE err_t refine_state_keep(struct refine *f);

#endif
