/* loss_body.h - the kernels of the photometric loss, compiled once per instruction set (see kernels.h). */
#include "core/kernels/kernels.h"
#include "core/kernels/simd.h"
#include "core/net/tonemap.h"

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

static inline void tone_lanes(const struct tonemap_curve *c, vf radiance, float shift, float *x, float *value,
                              uint8_t *segment)
{
    float a[LANES], b[LANES];
    /* radiance is clamped so that log2 sees a normal number */
    vf xs = v_log2(v_clamp(radiance, 0.0f, 1e36f) + v_set(TONEMAP_FLOOR)) + v_set(shift);
    v_store(x, xs);
    for (int l = 0; l < LANES; l++) {
        int s = tonemap_segment(c, x[l]);
        segment[l] = (uint8_t)s;
        a[l] = c->a[s];
        b[l] = c->b[s];
    }
    vf logit = v_fma(v_load(a), xs, v_load(b));
    v_store(value, v_set(1.0f) / (v_set(1.0f) + v_exp(v_set(0.0f) - logit)));
}

static void tone_row(const struct tonemap_curve *c, const float *radiance, float shift, int n, float *x,
                     float *value, uint8_t *segment)
{
    int i = 0;
    for (; i + LANES <= n; i += LANES)
        tone_lanes(c, v_load(radiance + i), shift, x + i, value + i, segment + i);
    if (i >= n)
        return;
    float in[LANES] = {0}, x1[LANES], value1[LANES];
    uint8_t segment1[LANES];
    memcpy(in, radiance + i, (size_t)(n - i) * sizeof *in);
    tone_lanes(c, v_load(in), shift, x1, value1, segment1);
    memcpy(x + i, x1, (size_t)(n - i) * sizeof *x);
    memcpy(value + i, value1, (size_t)(n - i) * sizeof *value);
    memcpy(segment + i, segment1, (size_t)(n - i));
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
        total += (double)v_sum(ssim_lanes(v_load(m + i), v_load(m + stride + i), v_load(m + 2 * stride + i),
                                          v_load(m + 3 * stride + i), v_load(m + 4 * stride + i), d));
        for (int k = 0; k < 3; k++)
            v_store(out + (size_t)k * stride + i, d[k]);
    }
    for (; i < n; i++) {
        float in[5][LANES] = {{0}}, o[LANES];
        for (size_t k = 0; k < 5; k++)
            in[k][0] = m[k * stride + (size_t)i];
        v_store(o, ssim_lanes(v_load(in[0]), v_load(in[1]), v_load(in[2]), v_load(in[3]), v_load(in[4]), d));
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
    k->tone_row = tone_row;
    k->ssim_row = ssim_row;
}
