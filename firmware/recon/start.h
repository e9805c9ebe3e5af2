/* start.h - cameras and the first Gaussians of a scene, by stereo or by the network: the steps of
 * job.c between the response curve and refinement. Each is called where the recipe asks for it, in
 * this order.
 * Between the steps the network's prediction, the bundle and depth are in run.keep, the merged
 * views of stereo in run.tmp; start_gaussians frees all of it. */
#ifndef RECON_START_H
#define RECON_START_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/lenses.h"
#include "firmware/recon/recipe.h"

#include "core/sfm/bundle.h"
#include "core/stereo/sweep.h"

/* One picture for each camera position, merged from its exposures, and their tone curve. */
struct start_merged {
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
    struct lenses lenses; // of the camera positions, if cameras are not known
    bool closer;          // the bundle is of views of recipe->closer
    float scale;          // from the network's world to that of the cameras
    struct start_merged merged;
    struct depthmaps depth;
    struct shade *shade; // (places) room for what cameras do to light; NULL: not looked for
    float *drift;        // (photographs) room for that of their light
    size_t before_depth; // level of run.keep
};

/* Count the memory of all steps; only numbers and shapes of v are read, and those of `closer`, the
 * views of recipe->closer, if any.
 * The prediction of a single forward pass stays in keep. */
void start_plan(struct plan *p, const struct capture *c, const struct job_config *cfg,
                const struct recipe *recipe, const struct views *v, const struct views *closer);

/* The scene before its first splat, with room for all unless it becomes a single forward pass. */
MUST_USE err_t start_scene(struct start *s);

/* Exposures of a place against each other, and the response with what they really were. */
MUST_USE err_t start_brackets(struct start *s);

/* The network's prediction, if recipe.network. */
MUST_USE err_t start_network(struct start *s);

/* Cameras, or the scale of the network's depth, if recipe.bundle; views that share too few points
 * with the others are left out.
 * err:  ERR_ARG (recipe.must_place, and fewer than two views can be placed). */
MUST_USE err_t start_bundle(struct start *s);

/* The scene's cameras. The network's geometry is aligned to them but for its scale, which
 * start_gaussians applies. */
MUST_USE err_t start_cameras(struct start *s);

/* Whether stereo and photographs correct the network: as the recipe says, if the cameras are
 * reliable. */
bool start_corrects(const struct start *s);

/* Depth by plane sweep, and a response that is fitted again with it. */
MUST_USE err_t start_stereo(struct start *s);

/* The network's Gaussians, corrected by depth and photographs. */
MUST_USE err_t start_correct(struct start *s);

/* The network's Gaussians, one per cell, or seeds from depth. */
MUST_USE err_t start_gaussians(struct start *s);

#endif
