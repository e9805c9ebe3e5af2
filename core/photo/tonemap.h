/* tonemap.h - the response from radiance to display value:
 * per colour sigmoid(b2 + sum_k w2_k relu(w1_k x + b1_k)), x = log2(radiance + 1e-6) + log2 t - mid
 * (core/photo/README.md 2.1). Before the sigmoid this is piecewise linear with at most 64 knots, so
 * it is evaluated exactly from a sorted table of segments. Pure functions; any thread. */
#ifndef PHOTO_TONEMAP_H
#define PHOTO_TONEMAP_H

#include "core/base/types.h"

#define TONEMAP_FLOOR 1e-6f // added to radiance before the logarithm (core/photo/README.md 2.1)

enum { TONEMAP_CELLS = 512 };

/* One colour: knots in ascending order; on segment s, between knot[s-1] and knot[s],
 * logit = a[s] x + b[s]. */
struct tonemap_curve {
    int n; // knots, 0..64
    float knot[TONE_HIDDEN];
    float a[TONE_HIDDEN + 1], b[TONE_HIDDEN + 1];
    float cell_lo, cell_scale;   // cell c = (x - lo) * scale
    uint8_t cell[TONEMAP_CELLS]; // first segment that can hold an x of this cell
};

struct tonemap_table {
    struct tonemap_curve c[3];
};

/* out: the table of t. Units with w1 = 0 or numbers that are not finite add at most a constant. */
void tonemap_table_init(struct tonemap_table *out, const struct tonemap *t);

/* Segment of x (log2 exposure of a pixel); NaN counts as -infinity. */
static inline int tonemap_segment(const struct tonemap_curve *c, float x)
{
    float f = (x - c->cell_lo) * c->cell_scale;
    int i = !(f > 0) ? 0 : f < TONEMAP_CELLS - 1 ? (int)f : TONEMAP_CELLS - 1;
    int s = c->cell[i];
    while (s < c->n && x > c->knot[s])
        s++;
    return s;
}

/* Display values in (0, 1) of n pixels of one colour.
 * radiance: >= 0, linear. shift: log2 t - mid_log2t. out: may be `radiance`. */
void tonemap_run(const struct tonemap_curve *c, const float *radiance, float shift, size_t n,
                 float *out);

/* Gradient of the units from per-segment sums: g0[s] = sum of dL/dlogit and
 * g1[s] = sum of x dL/dlogit over the pixels of segment s (64 + 1 each).
 * out: += gradient of w1, b1, w2, b2 of this colour (TONE_PER_COLOUR). */
void tonemap_grad(const float *params, const struct tonemap_curve *c, const double *g0,
                  const double *g1, float *out);

/* The common start: logit = gain * max(x, lo) in every colour, 64 units whose knots are spread
 * over [lo, hi). */
void tonemap_linear(struct tonemap *t, float gain, float lo, float hi, float mid_log2t);

#endif
