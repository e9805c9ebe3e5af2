/* noise.h - noise of photographs, which bounds the error that a scene can reach on them. */
#ifndef PHOTO_NOISE_H
#define PHOTO_NOISE_H

#include "core/base/types.h"

/* Bytes that noise_run takes from r->tmp; of v only n and n_more are read. */
size_t noise_plan(const struct views *v);

/* out: *db, PSNR that the noise of the photographs alone leaves, dB (100: no noise found). Median
 * of
 *       the absolute Laplacian of Laplacians, whose response to white noise is 6 times its
 * deviation (Immerkaer 1996); saturated pixels and flat texture do not count. Takes 8 bytes per
 * photograph from r->tmp.
 * err:  ERR_NOMEM. */
MUST_USE err_t noise_run(const struct run *r, const struct views *v, float *db);

#endif
