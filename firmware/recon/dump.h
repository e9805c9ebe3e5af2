/* dump.h - the tensors of the golden sets that lie around the graph: what goes in, Gaussians per
 * pixel and per cell, cameras, and a picture; handed to run.tap under the golden names. Without a
 * tap nothing happens. */
#ifndef RECON_DUMP_H
#define RECON_DUMP_H

#include "core/net/net.h"
#include "core/splat/voxel.h"

enum { DUMP_EXPOSURES = 3 };

/* Bytes of r->tmp that these functions take, one at a time. cap: most Gaussians. */
size_t dump_plan(int size, int cap);

/* input.image. */
MUST_USE err_t dump_views(const struct run *r, const struct views *v);

/* pix.*, camera.extrinsic_c2w, camera.intrinsic_norm, scene_scale. */
MUST_USE err_t dump_prediction(const struct run *r, const struct prediction *p);

/* vox.index, vox.count, vox.feats87, vox.extra: before voxel_adapt. */
void dump_cells(const struct run *r, const struct voxels *v);

/* The rest of vox.*: g is what voxel_adapt made of v. */
MUST_USE err_t dump_gaussians(const struct run *r, const struct gaussians *g);

struct dump_picture {
    const struct gaussians *g;
    const float *extra; // (4, cap) of the voxels
    const struct camera *cam;
    const struct tonemap *tone;
    float log2t[DUMP_EXPOSURES];
};

/* render.*, before a background of 1. */
MUST_USE err_t dump_picture(const struct run *r, const struct dump_picture *p);

#endif
