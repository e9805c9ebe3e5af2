/* refine.h - optimise a scene against its photographs (the paper's post-optimisation;
 * core/refine/README.md). Each step draws one input view, renders it, compares the tone-mapped
 * picture with its photograph, or all photographs of its bracket (0.8 L1 + 0.2 (1 - SSIM)), and
 * moves every parameter by Adam. Squares of every input view are held out: their pixels give no
 * gradient, and their error decides when to stop, how many SH bands and how many Gaussians the
 * scene needs.
 * Invariant: the result depends on the input, the configuration and the seed, never on the number
 *       of threads; with `seconds`, also on the number of steps that they allowed. */
#ifndef REFINE_REFINE_H
#define REFINE_REFINE_H

#include "core/base/types.h"
#include "core/refine/pace.h"

enum { REFINE_LEVELS = PACE_LEVELS };

/* Keeps the state of a refinement, so that one that was interrupted goes on to the same bytes. The
 * callbacks are those of the thread that runs the job; they handle their own errors. */
struct refine_saver {
    void *ctx;
    /* Asked between two steps. ends: the run was cancelled and stops here. returns: whether the
     * state shall be saved now: put for one piece after another, then end. */
    bool (*begin)(void *ctx, int step, bool ends);
    void (*put)(void *ctx, const void *p, size_t n);
    void (*end)(void *ctx);
    const void *state; // such bytes, to go on from; NULL: none. Hostile: they are checked
    size_t bytes;
};

struct refine_config {
    int steps;         // 0..100000; 0 leaves the scene as it is
    int degree_max;    // highest SH degree that may be added, 0..4
    int gaussians_max; // the scene never has more; <= scene.g.cap
    uint64_t seed;
    bool poses;      // move the cameras of the input views too
    bool tone_known; // the tone curve is right and stays
    int levels; // 1..REFINE_LEVELS: the first steps see pictures 2^(levels - 1) times smaller, then
                // ever larger ones; fewer where these would be too small, or the steps too few
    double seconds; // that refine_run may take by run.clock: as many steps as fit; 0: any
    const struct refine_saver *saver; // of rank 0; NULL: none. Without `seconds`
    uint8_t *left_out;                // (refine_cells) room for the report's, or NULL
};

/* What refinement left out of photographs (core/refine/README.md 4.1), in square cells. */
struct refine_left_out {
    int px, across; // edge of a cell, px of the photograph; cells in a row
    uint8_t *cell;  // (photographs, across, across) 1: left out; the configuration's, or NULL
};

enum { REFINE_NOTES = 8 };

struct refine_report {
    int steps;          // steps done
    int step_kept;      // after which the scene was the best: the scene is that one
    bool stopped_early; // held-out error no longer fell
    int gaussians, degree;
    float loss;           // mean of the last round through the views
    float held_out_db[2]; // PSNR of the held-out squares at the start and of the result, dB; a
                          // start that was made from these squares too is flattered
    struct refine_left_out left_out;
    int n_notes;
    char notes[REFINE_NOTES][128]; // decisions as text, for the report
};

/* Bytes that refine_run takes from r->tmp; of v only n, n_more, size, extent and deep are read. */
size_t refine_plan(const struct views *v, const struct refine_config *cfg, int threads);

/* Bytes of refine_left_out for these views; of v only n, n_more and size are read. */
size_t refine_cells(const struct views *v);

/* Number of Gaussians to start with for `places` views, from which the splits within cfg->steps can
 * still reach cfg->gaussians_max: at least half of it, all of it without steps. */
int refine_begin(const struct refine_config *cfg, int places);

/* Optimise *io. io->g must have planes for cfg->degree_max; io->cams and io->log2t are those of the
 * views. With a saver a step is not cancelled in between, nor is what
 * follows from it: a look at all views.
 * err: ERR_ARG (also: the saver's state is of another job), ERR_FORMAT (it is damaged), ERR_NOMEM,
 *      ERR_CANCELLED (then *io is valid, partly optimised). */
MUST_USE err_t refine_run(const struct run *r, const struct views *v,
                          const struct refine_config *cfg, struct scene *io,
                          struct refine_report *out);

#endif
