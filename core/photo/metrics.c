/* SSIM (Wang et al. 2004) of windows x, y with means m, variances s^2 and covariance s_xy, C1 =
 * K1^2, C2 = K2^2:
 *     (2 m_x m_y + C1) (2 s_xy + C2) / ((m_x^2 + m_y^2 + C1) (s_x^2 + s_y^2 + C2))
 * Only the sum of the two variances occurs, so four moments are filtered: x, y, x^2 + y^2, x y.
 * Each input row is filtered across once into a ring of 11 rows, which is then filtered down; both
 * use that the window is symmetric. */
#include "core/photo/metrics.h"

#include <math.h>
#include <string.h>

enum { TAPS = METRICS_SSIM_TAPS, MOMENTS = 4 };

static const double SSIM_SIGMA = 1.5, SSIM_C1 = 0.01 * 0.01, SSIM_C2 = 0.03 * 0.03;
static const double MU = 5000.0, SCALE_MIN = 1e-6; // core/photo/README.md 6

/* x, y, x^2 + y^2, x y as one vector: half the time of four scalars even with the SSE2 of the base
 * build. */
typedef double moments __attribute__((vector_size(MOMENTS * sizeof(double))));

static size_t values_of(const struct image *im)
{
    return (size_t)im->channels * (size_t)im->h * (size_t)im->w;
}

static err_t check_finite(const struct image *im)
{
    size_t n = values_of(im), plane = (size_t)im->w * (size_t)im->h;
    for (size_t i = 0; i < n; i++)
        if (!isfinite(im->px[i]))
            return err_fail(
                ERR_ARG, "metrics: value %g in channel %zu, row %zu, column %zu is not finite",
                (double)im->px[i], i / plane, i % plane / (size_t)im->w, i % (size_t)im->w);
    return OK;
}

static err_t check_pair(const struct image *a, const struct image *b)
{
    if (a->w != b->w || a->h != b->h || a->channels != b->channels || a->w < 1 || a->h < 1 ||
        a->channels < 1)
        return err_fail(
            ERR_ARG, "metrics: cannot compare %d x %d px, %d channels with %d x %d px, %d channels",
            a->w, a->h, a->channels, b->w, b->h, b->channels);
    err_t e = check_finite(a);
    return e ? e : check_finite(b);
}

static err_t check_count(double n)
{
    return n > 0 ? OK : err_fail(ERR_ARG, "metrics: no pixel of the picture counts");
}

err_t metrics_psnr(const struct image *a, const struct image *b, const uint8_t *seen, double *out)
{
    *out = 0.0;
    err_t e = check_pair(a, b);
    if (e)
        return e;
    size_t plane = (size_t)a->w * (size_t)a->h;
    double sum = 0.0, n = 0;
    for (size_t i = 0; i < values_of(a); i++) {
        double d = (double)a->px[i] - (double)b->px[i];
        if (seen && !seen[i % plane])
            continue;
        sum += d * d;
        n++;
    }
    e = check_count(n);
    if (!e)
        *out = fmin(METRICS_PSNR_MAX, -10.0 * log10(sum / n));
    return e;
}

static void gaussian_window(double kernel[TAPS])
{
    double sum = 0.0;
    for (int i = 0; i < TAPS; i++) {
        double d = (i - TAPS / 2) / SSIM_SIGMA;
        kernel[i] = exp(-d * d / 2.0);
        sum += kernel[i];
    }
    for (int i = 0; i < TAPS; i++)
        kernel[i] /= sum;
}

/* Moments of one row, filtered across. raw: (w), out: (w - 10). */
static void filter_across(const float *x, const float *y, int w, const double *kernel, moments *raw,
                          moments *out)
{
    for (int i = 0; i < w; i++) {
        double a = x[i], b = y[i];
        raw[i] = (moments){a, b, a * a + b * b, a * b};
    }
    for (int i = 0; i <= w - TAPS; i++) {
        const moments *p = raw + i;
        moments sum = p[TAPS / 2] * kernel[TAPS / 2];
        for (int k = 0; k < TAPS / 2; k++)
            sum += (p[k] + p[TAPS - 1 - k]) * kernel[k];
        out[i] = sum;
    }
}

static double window_similarity(const moments *m)
{
    double x = (*m)[0], y = (*m)[1], xx_yy = x * x + y * y, xy = x * y;
    double variances = fmax(0.0, (*m)[2] - xx_yy);
    return (2.0 * xy + SSIM_C1) * (2.0 * ((*m)[3] - xy) + SSIM_C2) /
           ((xx_yy + SSIM_C1) * (variances + SSIM_C2));
}

/* Sum over the windows whose top row is y0. ring: (11, n), row y at y % 11; seen: (n) of their
 * middles, or NULL. */
static double sum_down(const moments *ring, int n, int y0, const double *kernel,
                       const uint8_t *seen, double *count)
{
    const moments *row[TAPS];
    double total = 0.0;
    for (int k = 0; k < TAPS; k++)
        row[k] = ring + (size_t)((y0 + k) % TAPS) * (size_t)n;
    for (int i = 0; i < n; i++) {
        if (seen && !seen[i])
            continue;
        moments sum = row[TAPS / 2][i] * kernel[TAPS / 2];
        for (int k = 0; k < TAPS / 2; k++)
            sum += (row[k][i] + row[TAPS - 1 - k][i]) * kernel[k];
        total += window_similarity(&sum);
        ++*count;
    }
    return total;
}

/* Sum over all windows, and their number. */
static double ssim_sum(const struct image *a, const struct image *b, const uint8_t *seen,
                       moments *raw, moments *ring, double *count)
{
    double kernel[TAPS], total = 0.0;
    int n = a->w - TAPS + 1;
    gaussian_window(kernel);
    for (int c = 0; c < a->channels; c++)
        for (int y = 0; y < a->h; y++) {
            size_t row = ((size_t)c * (size_t)a->h + (size_t)y) * (size_t)a->w;
            filter_across(a->px + row, b->px + row, a->w, kernel, raw,
                          ring + (size_t)(y % TAPS) * (size_t)n);
            const size_t middle = (size_t)(y - TAPS / 2) * (size_t)a->w + TAPS / 2;
            if (y >= TAPS - 1)
                total +=
                    sum_down(ring, n, y - TAPS + 1, kernel, seen ? seen + middle : NULL, count);
        }
    return total;
}

static err_t layout(moments **raw, moments **ring, struct arena *tmp, int w)
{
    const size_t inside = w < TAPS ? 0 : (size_t)(w - TAPS + 1);
    err_t e = arena_alloc(tmp, (size_t)w, sizeof **raw, raw);
    return e ? e : arena_alloc(tmp, TAPS * inside, sizeof **ring, ring);
}

size_t metrics_ssim_plan(int w)
{
    struct arena tmp = arena_counter();
    moments *raw, *ring;
    return layout(&raw, &ring, &tmp, w) ? SIZE_MAX : tmp.peak;
}

err_t metrics_ssim(const struct image *a, const struct image *b, const uint8_t *seen,
                   struct arena *tmp, double *out)
{
    *out = 0.0;
    err_t e = check_pair(a, b);
    if (e)
        return e;
    if (a->w < TAPS || a->h < TAPS)
        return err_fail(ERR_ARG, "metrics: SSIM needs at least %d x %d px, got %d x %d", TAPS, TAPS,
                        a->w, a->h);
    size_t mark = arena_mark(tmp);
    moments *raw, *ring;
    double sum = 0, count = 0;
    e = layout(&raw, &ring, tmp, a->w);
    if (!e)
        sum = ssim_sum(a, b, seen, raw, ring, &count);
    if (!e)
        e = check_count(count);
    if (!e)
        *out = sum / count;
    arena_reset(tmp, mark);
    return e;
}

/* Order-preserving map of finite floats to integers, and back. */
static uint32_t key_of(float f)
{
    uint32_t u;
    memcpy(&u, &f, sizeof u);
    return u & 0x80000000u ? ~u : u | 0x80000000u;
}

static float value_of(uint32_t key)
{
    uint32_t u = key & 0x80000000u ? key & 0x7fffffffu : ~key;
    float f;
    memcpy(&f, &u, sizeof f);
    return f;
}

/* The key of rank k (from 0), found byte by byte from the top: each pass counts the next byte of
 * the keys that begin with the bytes found so far. above: equal keys of higher rank. */
static uint32_t key_of_rank(const float *values, size_t n, size_t k, size_t *above)
{
    uint32_t found = 0;
    for (int shift = 24; shift >= 0; shift -= 8) {
        size_t count[256] = {0};
        uint32_t byte = 0;
        for (size_t i = 0; i < n; i++) {
            uint32_t key = key_of(values[i]);
            if ((uint64_t)(key ^ found) >> shift < 256)
                count[key >> shift & 255]++;
        }
        for (; k >= count[byte]; byte++)
            k -= count[byte];
        found |= byte << shift;
        *above = count[byte] - 1 - k;
    }
    return found;
}

err_t metrics_quantile(const float *values, size_t n, double q, double *out)
{
    *out = 0.0;
    if (n == 0 || !(q >= 0.0 && q <= 1.0))
        return err_fail(ERR_ARG, "metrics: quantile %g of %zu values, must be 0..1 of at least 1",
                        q, n);
    for (size_t i = 0; i < n; i++)
        if (!isfinite(values[i]))
            return err_fail(ERR_ARG, "metrics: value %zu of %zu is %g, must be finite", i, n,
                            (double)values[i]);
    double position = q * (double)(n - 1);
    size_t k = (size_t)position, above;
    uint32_t low = key_of_rank(values, n, k, &above), high = low;
    if (above == 0 && k + 1 < n) { // the next larger value
        high = UINT32_MAX;
        for (size_t i = 0; i < n; i++) {
            uint32_t key = key_of(values[i]);
            high = key > low && key < high ? key : high;
        }
    }
    double a = value_of(low), b = value_of(high);
    *out = a + (b - a) * (position - (double)k);
    return OK;
}

err_t metrics_mu_law(const struct image *hdr, double scale, struct image *out)
{
    if (!isfinite(scale))
        return err_fail(ERR_ARG, "metrics: mu-law scale is %g, must be finite", scale);
    scale = fmax(scale, SCALE_MIN);
    size_t n = values_of(hdr);
    out->w = hdr->w;
    out->h = hdr->h;
    out->channels = hdr->channels;
    for (size_t i = 0; i < n; i++) {
        double x = fmin(fmax(hdr->px[i] / scale, 0.0), 1.0); // fmax makes 0 of a NaN
        out->px[i] = (float)(log1p(MU * x) / log1p(MU));
    }
    return OK;
}

err_t metrics_stops(const struct image *a, const struct image *b, const uint8_t *seen, double least,
                    float *log2, double *out)
{
    const size_t n = values_of(b), plane = (size_t)b->w * (size_t)b->h;
    double median = 0, sum = 0;
    size_t counted = 0;
    *out = NAN;
    err_t e = check_pair(a, b);
    if (e)
        return e;
    for (size_t i = 0; i < n; i++)
        if ((!seen || seen[i % plane]) && (double)b->px[i] >= least)
            log2[counted++] = log2f(fmaxf(a->px[i], (float)least) / b->px[i]);
    if (counted == 0)
        return OK;
    e = metrics_quantile(log2, counted, 0.5, &median);
    for (size_t i = 0; i < counted; i++)
        sum += pow((double)log2[i] - median, 2);
    *out = sqrt(sum / (double)counted);
    return e;
}
