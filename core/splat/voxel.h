/* voxel.h - average the network's raw Gaussians, one per pixel, in the cells of a grid, and convert
 * the means to Gaussians (core/splat/README.md 6).
 * Pure computation; thread: any, the pool inside struct run does the work.
 * Invariant: the result depends only on the input, never on the number of threads. */
#ifndef SPLAT_VOXEL_H
#define SPLAT_VOXEL_H

#include "core/base/plan.h"
#include "core/base/types.h"

/* Raw features are the 88 channels of the network without channel 83, the confidence. */
enum {
    VOXEL_LOGIT = 0,  // 1: logit of the opacity
    VOXEL_SCALE = 1,  // 3: before softplus
    VOXEL_QUAT = 4,   // 4: x,y,z,w, any length
    VOXEL_SH = 8,     // 75: (3 colours, 25), before the mask of voxel_adapt
    VOXEL_EXTRA = 83, // 4: exposure sensitivity; merged, but it never reaches an image
    VOXEL_FEATURES = 87
};

#define VOXEL_SCALE_UNIT 0.001f // scene units of one unit of softplus(VOXEL_SCALE)

struct voxel_input {
    int n;                   // pixels of all views, 0..GAUSSIANS_MAX
    const float *points;     // (n, 3) scene units
    const float *features;   // (VOXEL_FEATURES, n)
    const float *confidence; // (n) logit
};

/* Cells that hold at least one point, sorted by key: by x, then y, then z. */
struct voxels {
    int n, cap;      // cells; room in each plane for all points, a multiple of 16, at least 16
    int32_t *key;    // (n, 3) round(point / cell edge)
    int32_t *count;  // (n) points in it, > 0
    float *points;   // (3, cap) mean, scene units
    float *features; // (VOXEL_FEATURES, cap) mean of the raw features
};

/* Count the memory of voxel_merge. */
void voxel_plan(struct plan *p, int points);

/* Average the points of each cell of edge `cell` (scene units, > 0), weighted by the softmax of
 * their confidence. Points with a coordinate or confidence that is not finite are left out; keys
 * beyond 2^31 share the outermost cell.
 * out:  memory in r->keep.
 * err:  ERR_ARG (n, cell), ERR_NOMEM (see voxel_plan), ERR_CANCELLED. On error *out is
 *       zeroed. */
MUST_USE err_t voxel_merge(const struct run *r, const struct voxel_input *in, float cell,
                           struct voxels *out);

/* The same with at most `max` cells, 0: any number; their edge grows from `cell` until they fit.
 * out:  memory in r->keep, see voxel_plan. *used: the cell.
 * err:  ERR_NOMEM (see voxel_plan), ERR_CANCELLED. */
MUST_USE err_t voxel_merge_most(const struct run *r, const struct voxel_input *in, float cell,
                                int max, struct voxels *out, float *used);

/* Turn the means into Gaussians of degree 4, in place: the planes of *out are those of io, so that
 * a large scene is in memory only once. Features that are not finite stay so (see
 * gaussians_sanitize). out:  same number and room as io, valid as long as its memory; the features
 * of io are used up. err:  ERR_CANCELLED. On error *out is zeroed. */
MUST_USE err_t voxel_adapt(const struct run *r, struct voxels *io, struct gaussians *out);

#endif
