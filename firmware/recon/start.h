/* start.h - cameras and the first Gaussians of a scene, by stereo or by the network: the steps of
 * job.c between the response curve and refinement. Each is called where the recipe asks for it, in
 * this order.
 * From one step to the next the network's prediction, the bundle and depth live in run.keep, what
 * stereo sees in run.tmp; start_gaussians gives all of it back. */
#ifndef RECON_START_H
#define RECON_START_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/lenses.h"
#include "firmware/recon/recipe.h"

#include "core/sfm/bundle.h"
#include "core/stereo/sweep.h"

/* Of each place one picture with all that its exposures show. */
struct start_seen {
    struct views views;
    struct tonemap tone;
};

struct start {
    const struct run *run;
    const struct capture *capture;
    const struct job_config *cfg;
    const struct recipe *recipe;
    struct job_result *out; // views and response are set; it becomes views.cams, scene, cameras
    size_t keep, tmp;       // levels of the arenas at the beginning
    struct prediction p;
    struct bundle_result bundle;
    struct lenses lenses; // of the places, if cameras are not known
    float scale;          // from the network's world to that of the cameras
    struct start_seen seen;
    struct depthmaps depth;
    struct shade *shade; // (places) room for what cameras do to light; NULL: not looked for
    size_t before_depth; // level of run.keep
};

/* Count what all steps take: of v only its numbers and shapes are looked at; n_lenses: as
 * lenses_count says. A single forward pass
 * stays. */
void start_plan(struct plan *p, const struct job_config *cfg, const struct recipe *recipe,
                const struct views *v, int n_lenses);

/* The scene before its first splat, with room for all unless it becomes a single forward pass. */
MUST_USE err_t start_scene(struct start *s);

/* recipe.network: its prediction. */
MUST_USE err_t start_network(struct start *s);

/* recipe.bundle: cameras, or the scale of the network's depth; views that are not tied to the
 * others are left out.
 * err:  ERR_ARG (recipe.must_place, and fewer than two views can be placed). */
MUST_USE err_t start_bundle(struct start *s);

/* The scene's cameras; the network's geometry is moved there, at a scale that is left to
 * start_gaussians. */
MUST_USE err_t start_cameras(struct start *s);

/* Whether photographs correct the network: as the recipe says, if the cameras are sure. */
bool start_corrects(const struct start *s);

/* Depth, and with it a better curve. */
MUST_USE err_t start_stereo(struct start *s);

/* Depth and photographs overrule the network. */
MUST_USE err_t start_correct(struct start *s);

/* The network's Gaussians, one per cell, or seeds from depth. */
MUST_USE err_t start_gaussians(struct start *s);

#endif
