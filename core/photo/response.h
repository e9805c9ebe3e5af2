/* response.h - the camera's response curve without a network. A first curve comes from the
 * histograms of the exposure groups (Grossberg & Nayar, "Determining the camera response from
 * images: what is knowable?", PAMI 2003): pictures of one scene at two exposures have the same
 * radiance at the same quantile, so log2 exposure g(z) of display value z obeys g(z_b) - g(z_a)
 * = log2(t_b / t_a).
 * Gauge: the three colours share one curve (the white balance stays in the radiance), and display
 * 0.5 at the middle exposure is radiance 1.
 * Pure computation; thread: any. */
#ifndef PHOTO_RESPONSE_H
#define PHOTO_RESPONSE_H

#include "core/base/types.h"

/* The inverse curve by display value. */
struct response_table {
    float x[3][256];      // log2(radiance) + log2 t - mid_log2t
    float linear[3][256]; // 2^x
    float weight[3][256]; // 0 (black, saturated) .. 1 (accurate)
};

/* Two display values of the same radiance, seen with log2 exposures d stops apart: g(zb) - g(za) =
 * d. */
struct response_pair {
    float za, zb, d, weight; // display 0..1; stops; > 0
};

enum { RESPONSE_QUANTILES = 64 };

/* Pairs from the histograms of the same surfaces at two exposures d stops apart: display values of
 * the same quantile where neither is black or saturated.
 * returns: number of pairs in out. */
int response_quantiles(uint32_t (*a)[256], uint32_t (*b)[256], float d,
                       struct response_pair out[3 * RESPONSE_QUANTILES]);

/* Curve from the histograms of `v`: of the exposures of each place if there are several, else of
 * views at different exposures. With one exposure, or pictures without grey values, it is close
 * to sRGB; also where views show different places and their exposures differ by less than a stop,
 * or were chosen by a camera for each place.
 * err:  ERR_ARG (no views, exposures not finite), ERR_NOMEM. On error *out is not changed. */
MUST_USE err_t response_run(const struct run *r, const struct views *v, struct tonemap *out);

/* Whether the exposures of the photographs differ enough to tell a curve: by more than 0.25 stops,
 * root mean square from their mean. Below that the curve and light that changes look the same. */
bool response_is_told(const struct views *v);

/* Bytes of r->tmp that response_run takes; SIZE_MAX on overflow. */
size_t response_plan(const struct views *v);

/* The curve of sRGB (IEC 61966-2-1), within 0.002 of it, in the gauge above; it ends at display
 * value 0.9995. */
void response_srgb(float mid_log2t, struct tonemap *out);

/* Curve from pairs (n may be 0: the prior). Robust against a fifth of wrong pairs.
 * out:  the shared curve with the knots of the hidden units spread over the range of 8-bit values.
 */
void response_fit(const struct response_pair *pairs, int n, float mid_log2t, struct tonemap *out);

/* Display value 0..1 of x = log2(radiance) + log2 t - mid_log2t. */
float response_display(const struct tonemap *tone, int colour, float x);

/* Natural log of the radiance that a display value 0..1 has at exposure log2t; finite, ends at 24
 * stops from x = 0. */
float response_radiance_log(const struct tonemap *tone, int colour, float display, float log2t);

/* The curve of a picture that is the mean over all exposures lo .. hi stops from the middle one:
 * nowhere steep, and not flat between them.
 * out:  *out may be *tone. *log2t: the exposure that such a picture counts as. */
void response_spread(const struct tonemap *tone, float lo, float hi, struct tonemap *out,
                     float *log2t);

/* Inverse curve and reliability for the 256 display values. */
void response_tabulate(const struct tonemap *tone, struct response_table *out);

/* What log2 radiance x (as in the table), read with reliability `weight`, says: where that is below
 * 0.05, the picture is black or saturated and only bounds it.
 * out:  least and most; -INFINITY or INFINITY where it says nothing. */
void response_bounds(const struct response_table *t, int colour, float x, float weight,
                     float out[2]);

/* Geometric mean of the radiance that the photographs tell of, per colour: holes in a scene are
 * less wrong in it than in black. */
void response_mean(const struct views *v, const struct tonemap *tone, float out[3]);

#endif
