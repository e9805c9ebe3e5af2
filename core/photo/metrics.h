/* metrics.h - similarity of two images, and quantiles.
 * Images are planar floats, nominally in [0, 1] (values outside are taken as they are). Two images
 * that are compared must have the same shape and only finite values. All sums are in double and in
 * a fixed order. */
#ifndef PHOTO_METRICS_H
#define PHOTO_METRICS_H

#include "core/base/types.h"

#define METRICS_PSNR_MAX 100.0 // dB; also for smaller differences

enum { METRICS_SSIM_TAPS = 11 };

/* 10 log10(1 / mean squared difference), at most METRICS_PSNR_MAX.
 * seen: (h, w) pixels that count, not 0; NULL: all of them.
 * err:  ERR_ARG (shapes, a value that is not finite, no pixel counts). */
MUST_USE err_t metrics_psnr(const struct image *a, const struct image *b, const uint8_t *seen,
                            double *out);

/* Structural similarity as torchmetrics' StructuralSimilarityIndexMeasure(data_range=1): Gaussian
 * window of 11 x 11 px with sigma 1.5, K1 = 0.01, K2 = 0.03, mean over the (h-10) x (w-10) windows
 * inside the image and over the channels.
 * seen: (h, w) windows around these pixels count, not 0; NULL: all of them.
 * tmp:  back at its mark on return; takes metrics_ssim_plan(w) bytes.
 * err:  ERR_ARG (shapes, a side below 11 px, a value that is not finite, no window counts),
 *       ERR_NOMEM. */
MUST_USE err_t metrics_ssim(const struct image *a, const struct image *b, const uint8_t *seen,
                            struct arena *tmp, double *out);
size_t metrics_ssim_plan(int w);

/* Quantile q of n values with linear interpolation, as numpy.quantile. Needs no memory.
 * err:  ERR_ARG (n = 0, q outside [0, 1], a value that is not finite). */
MUST_USE err_t metrics_quantile(const float *values, size_t n, double q, double *out);

/* ln(1 + 5000 clip(x / scale, 0, 1)) / ln 5001 for every value (core/photo/README.md 6). NaN
 * becomes 0. A scale below 1e-6 counts as 1e-6.
 * out:  px has room for the shape of `hdr`, w, h and channels are set; px may be hdr->px.
 * err:  ERR_ARG (a scale that is not finite). */
MUST_USE err_t metrics_mu_law(const struct image *hdr, double scale, struct image *out);

/* Error of radiance a against the truth b in stops: root mean square of log2(a / b), without a
 * factor common to all values, which is the median of the ratios. Values of b below `least`, > 0,
 * do not count, those of a below it are taken as it. NAN if none counts.
 * log2: room for the values of an image.
 * err:  ERR_ARG (shapes, a value that is not finite). */
MUST_USE err_t metrics_stops(const struct image *a, const struct image *b, const uint8_t *seen,
                             double least, float *log2, double *out);

#endif
