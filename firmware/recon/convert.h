/* convert.h - weights of others, or made of numbers, become a weights file
 * (drivers/format/modelfile.h). */
#ifndef RECON_CONVERT_H
#define RECON_CONVERT_H

#include "firmware/base/engine.h"

#include "core/net/model.h"

/* Largest magnitude of a weight. Trained ones stay below some hundreds; with these, nothing inside
 * a transformer block can overflow (core/net/finite.h): norms give up to 2^27, products of them up
 * to 2^52, whose squares a norm of queries sums, and of these products up to 2^106. */
#define CONVERT_WEIGHT_MAX 0x1p20f

struct convert_request {
    const char *out;
    const char *config; // "full", "mini", a file with "model" like golden/mini/index.json; or NULL
    enum precision precision;
    int max_mb; // memory, MB (10^6 bytes)
};

/* Values of core/net/hashed.h; config is needed.
 * err:  ERR_ARG, and those of modelwrite_run. */
MUST_USE err_t convert_hashed(struct engine *en, const struct convert_request *q, uint64_t seed);

/* Weights of InstantHDR, AnySplat or VGGT from a file (drivers/format/checkpoint.h). Without config
 * the dimensions follow from it. Tensors that the network does not know are named in a warning.
 * err:  ERR_ARG, ERR_FORMAT (names up to five tensors that are missing or of another shape, or a
 *       weight beyond CONVERT_WEIGHT_MAX), and those of checkpoint_open, checkpoint_read and
 *       modelwrite_run. */
MUST_USE err_t convert_file(struct engine *en, const struct convert_request *q, const char *path);

/* Weights of LPIPS (core/net/lpips.h), fp32: torchvision's vgg16 or alexnet, told apart by their
 * shapes, without its classifier, and the linear layers that the package lpips (version 0.1) has
 * for it.
 * err:  as convert_file; ERR_FORMAT also for a linear weight below 0, with which it is no
 *       distance. */
MUST_USE err_t convert_lpips(struct engine *en, const struct convert_request *q,
                             const char *backbone, const char *linear);

#endif
