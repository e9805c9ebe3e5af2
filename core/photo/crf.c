/* g(z) = log2 of the exposure of code z obeys g(z_j) - E = log2 t_j for the pictures j of a pixel
 * with log2 radiance E. With weights w(z), 0 at both ends, eliminating E leaves normal equations
 * A g = b in the codes alone:
 *   A = sum over pixels of diag(w) - w w^T / sum(w),   b = w (log2 t - mean of log2 t).
 * Family: g = B c, with z / 255 = d: log2 d for gamma, and for toe and shoulder a cubic spline:
 * d, d^2, d^3 and (d - k / KNOTS)^3 above k / KNOTS. B^T A B c = B^T b, first with hat weights,
 * then with those of the rounding of codes, as the slope of g is known.
 * Debevec: hat weights; A + squares of hat-weighted second differences.
 * Robertson: E and x(z) in turn, each the weighted mean that the other implies, starting with the
 * family's curve: exposures in equal ratios leave open any periodic part of g, which only the start
 * determines.
 * Pixels are taken all over the picture by a stride, a bounded number for each mean code, those in
 * flat surroundings first; every fourth is held out.
 * Where a recovered curve falls, neighbours get their mean (pool adjacent violators); code 255 is
 * 0.
 * Pictures are ordered by exposure, then content, so that the order given does not matter. */
#include "core/photo/crf.h"

#include "core/base/lin.h"

#include <math.h>
#include <string.h>

enum {
    CODES = 256,
    MOST = 9,      // pictures
    LIST = 32768,  // pixels of a channel
    STRATUM = 256, // pixels of one mean code
    ROUGH = 8,     // samples per mean code whose surroundings are not flat
    KNOTS = 7,     // intervals of the family's spline
    TERMS = KNOTS + 3,
    HELD = 4,            // every HELD-th pixel is held out
    FLAT = 16,           // codes that neighbours may differ by
    DARK = 5,            // codes below and
    BRIGHT = 250,        // above are not counted as seen
    SPAN_LO = 48,        // codes that must be reached
    SPAN_HI = 208,       //
    ROBERTSON_STEPS = 20 // more only drift where no data hold the curve
};
#define SMOOTH 1e-3    // weight of second differences, of the sum of weights
#define RIDGE 1e-9     // relative to the mean diagonal
#define RATIO_MIN 1.1  // least ratio of the longest to the shortest exposure
#define NOISE 0.01     // stops, noise of a pixel besides the rounding of its code
#define EDGE 30.0      // how much steeper than the hat the family's weights rise from the ends
#define STEP_MIN 1e-4f // stops between codes

struct work {
    const uint8_t *px[MOST]; // by exposure
    double log2t[MOST], t[MOST];
    int n, w, h, channel;
    double a[CODES * CODES], f[CODES * CODES]; // normal equations, factor
    double b[CODES], g[CODES], weight[CODES], basis[CODES][TERMS];
    int seen[CODES]; // observations of the fit
    int pixels;
    uint32_t list[]; // [pixels]
};

static double hat(int z)
{
    return (z < CODES - 1 - z ? z : CODES - 1 - z) / 127.0;
}

void crf_srgb(struct crf *out)
{
    memset(out, 0, sizeof *out);
    for (int z = 0; z < CODES; z++) {
        double d = z > 0 ? z / 255.0 : 0.25 / 255.0;
        double x = d <= 0.04045 ? d / 12.92 : pow((d + 0.055) / 1.055, 2.4);
        out->log2x[0][z] = out->log2x[1][z] = out->log2x[2][z] = z < 255 ? (float)log2(x) : 0.0f;
    }
}

static size_t list_length(const struct crf_stack *s)
{
    size_t n = (size_t)s->w * (size_t)s->h;
    return n < LIST ? n : LIST;
}

size_t crf_plan(const struct crf_stack *s)
{
    return sizeof(struct work) + list_length(s) * sizeof(uint32_t);
}

/* --- pictures and pixels -------------------------------------------------------------------- */

static err_t check_stack(const struct crf_stack *s)
{
    double lo = INFINITY, hi = 0.0;
    if (s->n < 2 || s->n > MOST)
        return err_fail(ERR_ARG, "response curve: %d pictures, must be 2..%d", s->n, MOST);
    if (s->w < 1 || s->h < 1 || s->w > 65535 || s->h > 65535)
        return err_fail(ERR_ARG, "response curve: pictures of %d x %d px, must be 1..65535", s->w,
                        s->h);
    for (int i = 0; i < s->n; i++) {
        if (!(s->exposure[i] > 0.0) || !isfinite(s->exposure[i]))
            return err_fail(ERR_ARG, "response curve: exposure %d is %g, must be > 0", i,
                            s->exposure[i]);
        lo = fmin(lo, s->exposure[i]);
        hi = fmax(hi, s->exposure[i]);
    }
    if (hi < RATIO_MIN * lo)
        return err_fail(ERR_ARG, "response curve: exposures %g..%g differ by less than %g times",
                        lo, hi, RATIO_MIN);
    return OK;
}

static bool is_before(const struct crf_stack *s, int a, int b)
{
    if (s->exposure[a] != s->exposure[b])
        return s->exposure[a] < s->exposure[b];
    return memcmp(s->px[a], s->px[b], (size_t)s->w * (size_t)s->h * 3) < 0;
}

static void sort_pictures(const struct crf_stack *s, struct work *k)
{
    int order[MOST];
    k->n = s->n;
    k->w = s->w;
    k->h = s->h;
    for (int i = 0; i < s->n; i++) {
        int at = i;
        for (; at > 0 && is_before(s, i, order[at - 1]); at--)
            order[at] = order[at - 1];
        order[at] = i;
    }
    for (int i = 0; i < s->n; i++) {
        k->px[i] = s->px[order[i]];
        k->t[i] = s->exposure[order[i]] / s->exposure[order[0]];
        k->log2t[i] = log2(k->t[i]);
    }
}

static int code_at(const struct work *k, int picture, size_t at)
{
    return k->px[picture][3 * at + (size_t)k->channel];
}

static int code_difference(int a, int b)
{
    return a < b ? b - a : a - b;
}

/* Whether the neighbours are alike in all pictures. */
static bool is_flat(const struct work *k, size_t at)
{
    size_t w = (size_t)k->w, x = at % w, y = at / w;
    size_t left = x > 0 ? at - 1 : at, right = x + 1 < w ? at + 1 : at;
    size_t up = y > 0 ? at - w : at, down = y + 1 < (size_t)k->h ? at + w : at;
    for (int j = 0; j < k->n; j++) {
        int z = code_at(k, j, at);
        if (code_difference(code_at(k, j, left), z) > FLAT ||
            code_difference(code_at(k, j, right), z) > FLAT ||
            code_difference(code_at(k, j, up), z) > FLAT ||
            code_difference(code_at(k, j, down), z) > FLAT)
            return false;
    }
    return true;
}

static size_t common_divisor(size_t a, size_t b)
{
    while (b > 0) {
        size_t r = a % b;
        a = b;
        b = r;
    }
    return a;
}

/* Pixels that are seen in two pictures at least; *links counts their further observations. */
static void choose_pixels(struct work *k, int *links)
{
    size_t n = (size_t)k->w * (size_t)k->h, stride = (size_t)((double)n * 0.618034) | 1;
    int count[CODES] = {0};
    while (common_divisor(stride, n) > 1)
        stride += 2;
    k->pixels = *links = 0;
    for (int rough = 0; rough < 2; rough++)
        for (size_t i = 0, at = 0; i < n && k->pixels < LIST; i++, at = (at + stride) % n) {
            int mean = 0, used = 0;
            for (int j = 0; j < k->n; j++) {
                int z = code_at(k, j, at);
                mean += z;
                used += z >= DARK && z <= BRIGHT;
            }
            mean /= k->n;
            if (used < 2 || count[mean] >= (rough ? ROUGH : STRATUM) ||
                is_flat(k, at) == (rough == 1))
                continue;
            count[mean]++;
            k->list[k->pixels++] = (uint32_t)at;
            *links += used - 1;
        }
}

static err_t check_pixels(struct work *k, enum crf_method method, int links)
{
    static const char *const name[] = {"red", "green", "blue"};
    int need = method == CRF_FAMILY ? 64 : 512, lo = CODES, hi = -1;
    memset(k->seen, 0, sizeof k->seen);
    for (int i = 0; i < k->pixels; i++)
        for (int j = 0; j < k->n; j++)
            k->seen[code_at(k, j, k->list[i])]++;
    if (links < need)
        return err_fail(ERR_LIMIT,
                        "response curve: %s has %d pairs of codes %d..%d of one pixel in two "
                        "pictures, %d are needed",
                        name[k->channel], links, DARK, BRIGHT, need);
    for (int z = DARK; z <= BRIGHT; z++)
        if (k->seen[z] > 0) {
            lo = lo < z ? lo : z;
            hi = z;
        }
    if (lo > SPAN_LO || hi < SPAN_HI)
        return err_fail(ERR_LIMIT,
                        "response curve: codes of %s reach from %d to %d, must from %d to %d",
                        name[k->channel], lo, hi, SPAN_LO, SPAN_HI);
    return OK;
}

static bool is_held_out(int i)
{
    return i % HELD == HELD - 1;
}

/* --- linear methods ------------------------------------------------------------------------- */

static void build_equations(struct work *k)
{
    memset(k->a, 0, sizeof k->a);
    memset(k->b, 0, sizeof k->b);
    for (int i = 0; i < k->pixels; i++) {
        double w[MOST], sum = 0.0, mean = 0.0;
        int z[MOST];
        for (int j = 0; j < k->n; j++) {
            z[j] = code_at(k, j, k->list[i]);
            w[j] = k->weight[z[j]];
            sum += w[j];
            mean += w[j] * k->log2t[j];
        }
        if (is_held_out(i) || !(sum > 0.0))
            continue;
        mean /= sum;
        for (int j = 0; j < k->n; j++) {
            k->a[z[j] * CODES + z[j]] += w[j];
            k->b[z[j]] += w[j] * (k->log2t[j] - mean);
            for (int l = 0; l < k->n; l++)
                k->a[z[j] * CODES + z[l]] -= w[j] * w[l] / sum;
        }
    }
}

/* Add RIDGE and solve the n x n system in k->f. */
static bool solve_ridge(struct work *k, int n, double *x)
{
    double trace = 0.0;
    for (int i = 0; i < n; i++)
        trace += k->f[i * n + i];
    for (int i = 0; i < n; i++)
        k->f[i * n + i] += RIDGE * trace / n;
    if (!lin_cholesky(k->f, n))
        return false;
    lin_solve(k->f, n, x);
    return true;
}

static void set_basis(struct work *k)
{
    for (int z = 0; z < CODES; z++) {
        double d = (z > 0 ? z : 0.25) / 255.0;
        double v[TERMS] = {log2(d), d - 1.0, d * d - 1.0, d * d * d - 1.0};
        for (int i = 1; i < KNOTS; i++) {
            double at = (double)i / KNOTS, above = fmax(d - at, 0.0), end = 1.0 - at;
            v[3 + i] = above * above * above - end * end * end;
        }
        memcpy(k->basis[z], v, sizeof v);
    }
}

/* B^T v. */
static void project_on_basis(const struct work *k, const double *v, double *out)
{
    memset(out, 0, TERMS * sizeof *out);
    for (int z = 0; z < CODES; z++)
        for (int i = 0; i < TERMS; i++)
            out[i] += k->basis[z][i] * v[z];
}

static bool fit_family(struct work *k)
{
    double x[TERMS];
    memset(k->f, 0, TERMS * TERMS * sizeof *k->f);
    for (int z = 0; z < CODES; z++) {
        double row[TERMS];
        project_on_basis(k, k->a + z * CODES, row);
        for (int i = 0; i < TERMS * TERMS; i++)
            k->f[i] += k->basis[z][i / TERMS] * row[i % TERMS];
    }
    project_on_basis(k, k->b, x);
    if (!solve_ridge(k, TERMS, x))
        return false;
    for (int z = 0; z < CODES; z++) {
        k->g[z] = 0.0;
        for (int i = 0; i < TERMS; i++)
            k->g[z] += k->basis[z][i] * x[i];
    }
    return true;
}

/* Weights by the error of rounded codes under the present g. */
static void set_rounding_weights(struct work *k)
{
    for (int z = 1; z < CODES - 1; z++) {
        double slope = 0.5 * (k->g[z + 1] - k->g[z - 1]);
        k->weight[z] = fmin(EDGE * hat(z), 1.0) / (slope * slope / 12.0 + NOISE * NOISE);
    }
}

static bool recover_family(struct work *k)
{
    for (int z = 0; z < CODES; z++)
        k->weight[z] = hat(z);
    build_equations(k);
    if (!fit_family(k))
        return false;
    set_rounding_weights(k);
    build_equations(k);
    return fit_family(k);
}

static bool recover_debevec(struct work *k)
{
    double trace = 0.0;
    for (int z = 0; z < CODES; z++)
        k->weight[z] = hat(z);
    build_equations(k);
    memcpy(k->f, k->a, sizeof k->a);
    for (int z = 0; z < CODES; z++)
        trace += k->a[z * CODES + z];
    for (int z = 1; z < CODES - 1; z++) {
        static const double d[3] = {1.0, -2.0, 1.0};
        double w = SMOOTH * trace * hat(z) * hat(z);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                k->f[(z + i - 1) * CODES + z + j - 1] += w * d[i] * d[j];
    }
    memcpy(k->g, k->b, sizeof k->g);
    return solve_ridge(k, CODES, k->g);
}

/* --- Robertson ------------------------------------------------------------------------------ */

static void robertson_step(struct work *k, const double *x, double *sum, double *count)
{
    memset(sum, 0, CODES * sizeof *sum);
    memset(count, 0, CODES * sizeof *count);
    for (int i = 0; i < k->pixels; i++) {
        double up = 0.0, down = 0.0;
        for (int j = 0; j < k->n; j++) {
            int z = code_at(k, j, k->list[i]);
            up += k->weight[z] * k->t[j] * x[z];
            down += k->weight[z] * k->t[j] * k->t[j];
        }
        for (int j = 0; j < k->n && !is_held_out(i) && down > 0.0; j++) {
            int z = code_at(k, j, k->list[i]);
            sum[z] += k->t[j] * up / down;
            count[z] += 1.0;
        }
    }
}

static bool recover_robertson(struct work *k)
{
    double x[CODES], sum[CODES], count[CODES];
    if (!recover_family(k))
        return false;
    for (int z = 0; z < CODES; z++) {
        x[z] = exp2(k->g[z]);
        k->weight[z] = hat(z) / (x[z] * x[z]); // weight of relative errors
    }
    for (int i = 0; i < ROBERTSON_STEPS; i++) {
        robertson_step(k, x, sum, count);
        for (int z = 1; z < CODES - 1; z++)
            if (count[z] > 0.0)
                x[z] = sum[z] / count[z];
    }
    for (int z = 1; z < CODES - 1; z++)
        k->g[z] = log2(x[z]);
    return true;
}

/* --- result --------------------------------------------------------------------------------- */

/* Replace falling stretches of g by their mean, weighted by observations (pool adjacent violators).
 */
static void make_rise(struct work *k)
{
    double mean[CODES], weight[CODES];
    int end[CODES], n = 0;
    for (int z = 1; z < CODES - 1; z++) {
        mean[n] = k->g[z];
        weight[n] = k->seen[z] + 1e-3;
        end[n++] = z;
        for (; n > 1 && mean[n - 1] <= mean[n - 2]; n--) {
            double w = weight[n - 1] + weight[n - 2];
            mean[n - 2] = (mean[n - 1] * weight[n - 1] + mean[n - 2] * weight[n - 2]) / w;
            weight[n - 2] = w;
            end[n - 2] = end[n - 1];
        }
    }
    for (int i = 0, z = 1; i < n; i++)
        for (; z <= end[i]; z++)
            k->g[z] = mean[i];
}

/* Extrapolate codes 0 and 255, set the scale and make the curve rise strictly. */
static void write_curve(struct work *k, float *out)
{
    make_rise(k);
    k->g[CODES - 1] = k->g[CODES - 2] + (k->g[CODES - 2] - k->g[CODES - 10]) / 8.0;
    k->g[0] = k->g[1] - 2.0; // as in sRGB for half a step
    for (int z = 0; z < CODES; z++)
        out[z] = (float)(k->g[z] - k->g[CODES - 1]);
    for (int z = CODES - 2; z >= 0; z--)
        out[z] = fminf(out[z], out[z + 1] - STEP_MIN);
}

/* Add the hat-weighted squared errors of the pixels held out, and the weights. */
static void measure_held_out(const struct work *k, const float *g, double *square, double *weight)
{
    for (int i = HELD - 1; i < k->pixels; i += HELD) {
        double w[MOST], r[MOST], sum = 0.0, mean = 0.0;
        for (int j = 0; j < k->n; j++) {
            int z = code_at(k, j, k->list[i]);
            w[j] = hat(z);
            r[j] = (double)g[z] - k->log2t[j];
            sum += w[j];
            mean += w[j] * r[j];
        }
        for (int j = 0; j < k->n && sum > 0.0; j++)
            *square += w[j] * (r[j] - mean / sum) * (r[j] - mean / sum);
        *weight += sum;
    }
}

err_t crf_recover(enum crf_method method, const struct crf_stack *s, void *tmp, struct crf *out)
{
    struct work *k = tmp;
    struct crf got = {.known = true};
    double square = 0.0, weight = 0.0;
    crf_srgb(out);
    err_t e = check_stack(s);
    if (e != OK)
        return e;
    sort_pictures(s, k);
    set_basis(k);
    for (k->channel = 0; k->channel < 3; k->channel++) {
        int links;
        choose_pixels(k, &links);
        e = check_pixels(k, method, links);
        if (e != OK)
            return e;
        bool solved = method == CRF_FAMILY    ? recover_family(k)
                      : method == CRF_DEBEVEC ? recover_debevec(k)
                                              : recover_robertson(k);
        if (!solved)
            return err_fail(ERR_LIMIT, "response curve: %d pixels do not determine it", k->pixels);
        write_curve(k, got.log2x[k->channel]);
        measure_held_out(k, got.log2x[k->channel], &square, &weight);
    }
    got.error = (float)sqrt(square / fmax(weight, 1e-30));
    *out = got;
    return OK;
}
