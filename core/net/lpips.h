/* lpips.h - LPIPS, the distance of two pictures by the features of a network (Zhang, Isola, Efros,
 * Shechtman, Wang: The Unreasonable Effectiveness of Deep Features as a Perceptual Metric, CVPR
 * 2018), in version 0.1 of its authors' package: features after the last ReLU of each stage are
 * divided by their length over the channels + 1e-10; squared differences are weighed per channel,
 * averaged over the pixels and added over the stages. 0 for equal pictures.
 * Invariant: same bytes for any number of threads. */
#ifndef NET_LPIPS_H
#define NET_LPIPS_H

#include "core/base/plan.h"
#include "core/net/model.h"

struct lpips {
    const struct lpips_layers *layers;
    struct weight conv[LPIPS_STAGES][LPIPS_STAGE_CONVS];
    const float *linear[LPIPS_STAGES]; // (width of the stage) >= 0
    bool centred; // pictures are mapped from [0, 1] to [-1, 1], for which LPIPS was trained
};

/* The weights of a model, which must outlive *out; not centred.
 * err:  ERR_FORMAT (not the weights of LPIPS, a tensor is missing, a linear weight below 0). */
MUST_USE err_t lpips_bind(const struct model *m, struct lpips *out);

/* err:  ERR_ARG: pictures of this size are too small for the network (16 px for VGG16, 31 px for
 *       AlexNet). */
MUST_USE err_t lpips_check(const struct lpips *l, int w, int h);

/* Distance of two planar pictures with values in [0, 1], of one size.
 * err:  those of lpips_check, ERR_ARG (shapes, a result that is not finite), ERR_NOMEM (r->tmp, see
 *       lpips_plan), ERR_CANCELLED. */
MUST_USE err_t lpips_run(const struct run *r, const struct lpips *l, const struct image *a,
                         const struct image *b, double *out);

/* Count the memory of lpips_run: 240 bytes per pixel and bands of 24 MB for VGG16, about 60 bytes
 * per pixel for AlexNet, and what convolutions take per thread. */
void lpips_plan(struct plan *p, const struct lpips *l, int w, int h);

#endif
