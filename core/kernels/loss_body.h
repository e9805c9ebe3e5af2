/* loss_body.h - the kernels of the photometric loss, compiled once per instruction set.
 * Included by loss_<isa>.c after one SIMD_ macro. */
#include "core/kernels/kernels.h"
#include "core/kernels/simd.h"
#include "core/photo/tonemap.h"

enum { TAPS = 11 };

static void blur_row(const float *taps, const float *in, int w, float *out)
{
    int n = w - (TAPS - 1), i = 0;
    for (; i + LANES <= n; i += LANES) {
        vf sum = v_set(taps[0]) * v_load(in + i);
        for (int k = 1; k < TAPS; k++)
            sum = v_fma(v_set(taps[k]), v_load(in + i + k), sum);
        v_store(out + i, sum);
    }
    for (; i < n; i++) {
        float sum = 0;
        for (int k = 0; k < TAPS; k++)
            sum += taps[k] * in[i + k];
        out[i] = sum;
    }
}

static void blur_col(const float *taps, const float *const *in, int w, float *out)
{
    int i = 0;
    for (; i + LANES <= w; i += LANES) {
        vf sum = v_set(taps[0]) * v_load(in[0] + i);
        for (int k = 1; k < TAPS; k++)
            sum = v_fma(v_set(taps[k]), v_load(in[k] + i), sum);
        v_store(out + i, sum);
    }
    for (; i < w; i++) {
        float sum = 0;
        for (int k = 0; k < TAPS; k++)
            sum += taps[k] * in[k][i];
        out[i] = sum;
    }
}

static void moments_row(const float *taps, const float *x, const float *photo, int n, size_t stride,
                        float *scratch, float *out)
{
    float *y = scratch, *product = scratch + stride;
    for (int i = 0; i < n; i++)
        y[i] = photo[i] * (1.0f / 255.0f);
    blur_row(taps, x, n, out);
    blur_row(taps, y, n, out + stride);
    for (int i = 0; i < n; i++)
        product[i] = x[i] * x[i];
    blur_row(taps, product, n, out + 2 * stride);
    for (int i = 0; i < n; i++)
        product[i] = y[i] * y[i];
    blur_row(taps, product, n, out + 3 * stride);
    for (int i = 0; i < n; i++)
        product[i] = x[i] * y[i];
    blur_row(taps, product, n, out + 4 * stride);
}

static inline void tone_lanes(const struct tone_row *t, int i, int lanes)
{
    const struct tonemap_curve *c = t->curve;
    float in[LANES] = {0}, open[LANES] = {0}, a[LANES] = {0}, b[LANES] = {0};
    float x[LANES], ldr[LANES];
    memcpy(in, t->radiance + i, (size_t)lanes * sizeof *in);
    memcpy(open, t->alpha + i, (size_t)lanes * sizeof *open);
    /* radiance is clamped so that log2 sees a normal number */
    vf xs = v_log2(v_clamp(v_load(in), 0.0f, 1e36f) + v_set(TONEMAP_FLOOR)) + v_set(t->shift);
    v_store(x, xs);
    for (int l = 0; l < lanes; l++) {
        int s = tonemap_segment(c, x[l]);
        t->segment[i + l] = (uint8_t)s;
        a[l] = c->a[s];
        b[l] = c->b[s];
    }
    vf logit = v_fma(v_load(a), xs, v_load(b));
    vf value = v_set(1.0f) / (v_set(1.0f) + v_exp(v_set(0.0f) - logit));
    v_store(ldr, v_fma(v_set(t->behind), v_set(1.0f) - v_load(open), value));
    memcpy(t->x + i, x, (size_t)lanes * sizeof *x);
    memcpy(t->slope + i, a, (size_t)lanes * sizeof *a);
    memcpy(t->ldr + i, ldr, (size_t)lanes * sizeof *ldr);
}

static void tone_row(const struct tone_row *t)
{
    int i = 0;
    for (; i + LANES <= t->n; i += LANES)
        tone_lanes(t, i, LANES);
    if (i < t->n)
        tone_lanes(t, i, t->n - i);
}

static void tone_row_grad(const struct tone_row *t, float *d, float *logit, float *d_alpha)
{
    const float log2_e = 1.44269504f;
    for (int i = 0; i < t->n; i++) {
        float v = t->ldr[i] - t->behind * (1.0f - t->alpha[i]);
        float g = d[i] * v * (1.0f - v), rad = t->radiance[i] < 1e36f ? t->radiance[i] : 1e36f;
        d_alpha[i] -= t->behind * d[i];
        logit[i] = g;
        d[i] = g * t->slope[i] * log2_e / (rad + TONEMAP_FLOOR);
    }
}

static double display_row(const struct display_row *r, float *d)
{
    const float *g0 = r->g, *g1 = r->g + r->stride, *g2 = r->g + 2 * r->stride;
    float l1 = r->l1, ssim = r->ssim;
    for (int i = 0; i < r->n; i++) {
        float y = r->photo[i] * (1.0f / 255.0f), diff = r->x[i] - y;
        float sign = (diff > 0 ? l1 : 0.0f) - (diff < 0 ? l1 : 0.0f);
        d[i] = sign + ssim * (g0[i] + 2.0f * r->x[i] * g1[i] + y * g2[i]);
    }
    float part[16] = {0};
    int i = 0;
    for (; i + 16 <= r->n; i += 16)
        for (int k = 0; k < 16; k++)
            part[k] += fabsf(r->x[i + k] - r->photo[i + k] * (1.0f / 255.0f));
    for (; i < r->n; i++)
        part[0] += fabsf(r->x[i] - r->photo[i] * (1.0f / 255.0f));
    double sum = 0;
    for (int k = 0; k < 16; k++)
        sum += (double)part[k];
    return sum;
}

/* S = (2 mx my + C1)(2 (xy - mx my) + C2) / ((mx^2 + my^2 + C1)(xx + yy - mx^2 - my^2 + C2)) */
static inline vf ssim_lanes(vf mx, vf my, vf xx, vf yy, vf xy, vf d[3])
{
    vf c1 = v_set(1e-4f), c2 = v_set(9e-4f), two = v_set(2.0f), one = v_set(1.0f);
    vf mxy = mx * my, m2 = mx * mx + my * my;
    vf a = v_fma(two, mxy, c1), b = v_fma(two, xy - mxy, c2);
    vf inv_c = one / (m2 + c1), inv_d = one / (v_max(xx + yy - m2, v_set(0.0f)) + c2);
    vf s = a * b * inv_c * inv_d;
    d[1] = v_set(0.0f) - s * inv_d;
    d[2] = two * a * inv_c * inv_d;
    d[0] = two * my * (b - a) * inv_c * inv_d - two * mx * s * (inv_c - inv_d);
    return s;
}

static double ssim_row(const float *m, size_t stride, int n, float *out)
{
    double total = 0;
    int i = 0;
    vf d[3];
    for (; i + LANES <= n; i += LANES) {
        total += (double)v_sum(ssim_lanes(v_load(m + i), v_load(m + stride + i),
                                          v_load(m + 2 * stride + i), v_load(m + 3 * stride + i),
                                          v_load(m + 4 * stride + i), d));
        for (int k = 0; k < 3; k++)
            v_store(out + (size_t)k * stride + i, d[k]);
    }
    for (; i < n; i++) {
        float in[5][LANES] = {{0}}, o[LANES];
        for (size_t k = 0; k < 5; k++)
            in[k][0] = m[k * stride + (size_t)i];
        v_store(o, ssim_lanes(v_load(in[0]), v_load(in[1]), v_load(in[2]), v_load(in[3]),
                              v_load(in[4]), d));
        total += (double)o[0];
        for (size_t k = 0; k < 3; k++) {
            v_store(o, d[k]);
            out[k * stride + (size_t)i] = o[0];
        }
    }
    return total;
}

static void loss_fill(struct kernels *k)
{
    k->blur_row = blur_row;
    k->blur_col = blur_col;
    k->moments_row = moments_row;
    k->ssim_row = ssim_row;
    k->display_row = display_row;
    k->tone_row = tone_row;
    k->tone_row_grad = tone_row_grad;
}
