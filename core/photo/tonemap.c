#include "core/photo/tonemap.h"

#include <math.h>
#include <string.h>

/* Sorting key of a unit: where it bends. */
static float unit_knot(const float *p, int k)
{
    return -p[TONE_HIDDEN + k] / p[k];
}

static bool unit_bends(const float *p, int k)
{
    return p[k] != 0.0f && isfinite(unit_knot(p, k)) && isfinite(p[2 * TONE_HIDDEN + k]);
}

static void sort_units(const float *p, int *order, int n)
{
    for (int i = 1; i < n; i++) {
        int u = order[i], j = i;
        while (j > 0 && unit_knot(p, order[j - 1]) > unit_knot(p, u)) {
            order[j] = order[j - 1];
            j--;
        }
        order[j] = u;
    }
}

static void curve_init(struct tonemap_curve *c, const float *p)
{
    const float *w1 = p, *b1 = p + TONE_HIDDEN, *w2 = p + 2 * TONE_HIDDEN;
    int order[TONE_HIDDEN];
    double a = 0, b = isfinite(p[3 * TONE_HIDDEN]) ? (double)p[3 * TONE_HIDDEN] : 0;
    c->n = 0;
    for (int k = 0; k < TONE_HIDDEN; k++) {
        if (unit_bends(p, k)) {
            order[c->n++] = k;
            if (w1[k] < 0) { // active at -infinity
                a += (double)w2[k] * (double)w1[k];
                b += (double)w2[k] * (double)b1[k];
            }
        } else if (w1[k] == 0.0f && b1[k] > 0 && isfinite(b1[k]) && isfinite(w2[k])) {
            b += (double)w2[k] * (double)b1[k];
        }
    }
    sort_units(p, order, c->n);
    c->a[0] = (float)a;
    c->b[0] = (float)b;
    for (int s = 0; s < c->n; s++) {
        int k = order[s];
        double sign = w1[k] > 0 ? 1 : -1; // a unit with w1 < 0 is off from here on
        a += sign * (double)w2[k] * (double)w1[k];
        b += sign * (double)w2[k] * (double)b1[k];
        c->knot[s] = unit_knot(p, k);
        c->a[s + 1] = (float)a;
        c->b[s + 1] = (float)b;
    }
    float lo = c->n ? c->knot[0] : 0, hi = c->n ? c->knot[c->n - 1] : 0;
    c->cell_lo = fmaxf(lo, -64.0f);
    c->cell_scale = (TONEMAP_CELLS - 1) / fmaxf(fminf(hi, 64.0f) - c->cell_lo, 1e-3f);
    /* one cell less than exact, so that rounding of the cell number cannot skip a knot */
    for (int i = 0, s = 0; i < TONEMAP_CELLS; i++) {
        float x = i > 0 ? c->cell_lo + (float)(i - 1) / c->cell_scale : -INFINITY;
        while (s < c->n && x > c->knot[s])
            s++;
        c->cell[i] = (uint8_t)s;
    }
}

void tonemap_table_init(struct tonemap_table *out, const struct tonemap *t)
{
    for (int c = 0; c < 3; c++)
        curve_init(&out->c[c], t->p + c * TONE_PER_COLOUR);
}

void tonemap_run(const struct tonemap_curve *c, const float *radiance, float shift, size_t n,
                 float *out)
{
    for (size_t i = 0; i < n; i++) {
        float x = log2f(fmaxf(radiance[i], 0.0f) + TONEMAP_FLOOR) + shift;
        int s = tonemap_segment(c, x);
        out[i] = 1.0f / (1.0f + expf(-(c->a[s] * x + c->b[s])));
    }
}

void tonemap_grad(const float *params, const struct tonemap_curve *c, const double *g0,
                  const double *g1, float *out)
{
    double below0[TONE_HIDDEN + 2] = {0}, below1[TONE_HIDDEN + 2] = {0}; // sums over segments < s
    for (int s = 0; s <= c->n; s++) {
        below0[s + 1] = below0[s] + g0[s];
        below1[s + 1] = below1[s] + g1[s];
    }
    double all0 = below0[c->n + 1], all1 = below1[c->n + 1];
    for (int k = 0; k < TONE_HIDDEN; k++) {
        float w1 = params[k], b1 = params[TONE_HIDDEN + k], w2 = params[2 * TONE_HIDDEN + k];
        double on0 = 0, on1 = 0; // sums over the pixels where the unit is on
        if (unit_bends(params, k)) {
            int s = 0;
            while (s < c->n && c->knot[s] < unit_knot(params, k))
                s++;
            on0 = w1 > 0 ? all0 - below0[s + 1] : below0[s + 1];
            on1 = w1 > 0 ? all1 - below1[s + 1] : below1[s + 1];
        } else if (w1 == 0.0f && b1 > 0) {
            on0 = all0;
            on1 = all1;
        }
        out[k] += (float)((double)w2 * on1);
        out[TONE_HIDDEN + k] += (float)((double)w2 * on0);
        out[2 * TONE_HIDDEN + k] += (float)((double)w1 * on1 + (double)b1 * on0);
    }
    out[3 * TONE_HIDDEN] += (float)all0;
}

void tonemap_linear(struct tonemap *t, float gain, float lo, float hi, float mid_log2t)
{
    memset(t, 0, sizeof *t);
    t->mid_log2t = mid_log2t;
    for (int c = 0; c < 3; c++) {
        float *p = t->p + c * TONE_PER_COLOUR;
        for (int k = 0; k < TONE_HIDDEN; k++) {
            /* unit 0 is the line; the others have no slope yet */
            float at = lo + (hi - lo) * (float)k / TONE_HIDDEN;
            p[k] = 1.0f;
            p[TONE_HIDDEN + k] = -at;
            p[2 * TONE_HIDDEN + k] = k == 0 ? gain : 0.0f;
        }
        p[3 * TONE_HIDDEN] = gain * lo;
    }
}
