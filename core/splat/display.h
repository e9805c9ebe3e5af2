/* display.h - conversion between radiance harmonics and the display colours of ordinary splat
 * viewers.
 * A splat has the radiance L(d) = exp(sum_k s_k Y_k(d)) per colour; such viewers show
 * 0.5 + sum_k f_k Y_k(d), clamped, as sRGB. Here
 *   0.5 + sum_k f_k Y_k(d) = S(2^ev L(d)),   S = transfer of sRGB (IEC 61966-2-1), continued
 * above 1 and never clamped: degree 0 is exact in both directions. Higher degrees are a
 * least-squares fit over the sphere up to degree 3, the highest that those viewers support.
 * Pure functions. thread: any. */
#ifndef SPLAT_DISPLAY_H
#define SPLAT_DISPLAY_H

#include "core/base/types.h"

enum { DISPLAY_DEGREE_MAX = 3 };

/* Stops that bring the radiance which the curve shows as display value 0.5 at its middle exposure
 * (mean of the colours) to where sRGB shows it; 0 for a curve that never crosses 0.5. */
float display_ev(const struct tonemap *t);

/* Transfer of sRGB without upper bound, and its inverse; linear below 0. NaN stays. */
float display_encode(float linear);
float display_decode(float value);

/* Harmonics of one splat. log_sh: ((degree+1)^2, 3) as the planes of struct gaussians; degree 0..4.
 * out:  (min(degree, 3)+1)^2 by 3, same order. Finite for finite input: radiance is clamped to
 *       exp(+-RASTER_LOG_MAX). */
void display_from_radiance(const float *log_sh, int degree, float ev, float *out);

/* The inverse, fitted in the logarithm: f of degree 0..4. Linear values below the floor, which
 * scenes of other programs have often, are raised to it. A colour that is not finite becomes NaN.
 * out:  (degree+1)^2 by 3. */
#define DISPLAY_FLOOR 1e-6f     // linear, at degree 0
#define DISPLAY_FLOOR_FIT 1e-4f // at higher degrees: invisible values must not affect the fit
void display_to_radiance(const float *f, int degree, float ev, float *out);

/* A curve that shows radiance 2^-ev x as sRGB shows x, as near as 64 units can; mid_log2t is 0. */
void display_tonemap(float ev, struct tonemap *out);

#endif
