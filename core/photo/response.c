/* The curve is g(u): log2 exposure over u = clamped_logit(display), a polyline on BINS knots. It
 * minimises
 *   sum_pairs w rho(g(u_b) - g(u_a) - d) + SMOOTH |g'' - p''|^2 + WEAK |g' - p'|^2,   g(0) = 0,
 * with p the inverse of sRGB, rho made robust by reweighting, and is then forced to rise. Over u a
 * filmic curve is nearly straight and sRGB bends only near white, so few pairs determine it and it
 * extrapolates well where there are none. Of different places it is believed as far as their
 * exposures explain what sets them apart. Finally u(x) is written as 64 ReLU units
 * (core/photo/README.md 2.1): half of them face left, half right, from x = 0. */
#include "core/photo/response.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { BINS = 45, LEVELS = RESPONSE_QUANTILES, ROUNDS = 6, GROUPS_MAX = 16, SPREAD = 33 };

static const double U_END = 6.6;      // the curve lives on [-U_END, U_END]; logit of 1/512 is -6.24
static const double SMOOTH = 5.0;     // weight of a bend, with data normalised to one per knot
static const double WEAK = 2e-3;      // weight of a slope
static const double RISE_MIN = 0.06;  // stops per unit of u
static const double RISE_MAX = 8.0;   // stops per unit of u: flatter curves hold no information
static const double APART = 0.25;     // stops, root mean square: exposures that differ
static const float X_END = 24.0f;     // stops
static const float LOG2_MERGE = 0.1f; // exposures closer than this are one group

struct group {
    double log2t; // sum while collecting, then mean
    int n;
    uint32_t hist[3][256];
};

/* ---- curve over u ---- */

static double knot_u(int k)
{
    return -U_END + 2.0 * U_END * k / (BINS - 1);
}

static double clamped_logit(double z)
{
    z = fmin(fmax(z, 1.0 / 1024), 1023.0 / 1024);
    return num_logit(z);
}

/* log2 of sRGB's linear value, with a floor on the slope so that it can be inverted near white. */
static double prior_curve(int k)
{
    double u = knot_u(k), z = 1.0 / (1.0 + exp(-u));
    double lin = z <= 0.04045 ? z / 12.92 : pow((z + 0.055) / 1.055, 2.4); // IEC 61966-2-1
    return log2(lin) + 0.1 * u;
}

/* returns: k of the interpolation g(u) = (1 - f) g[k] + f g[k + 1]. */
static int locate_knot(double u, double *f)
{
    double s = (u + U_END) / (2.0 * U_END) * (BINS - 1);
    int k = (int)s;
    if (k > BINS - 2)
        k = BINS - 2;
    *f = s - k;
    return k;
}

static void add_row(double (*a)[BINS], double *b, const double *row, double rhs, double w)
{
    for (int i = 0; i < BINS; i++) {
        if (row[i] == 0.0)
            continue;
        for (int j = 0; j < BINS; j++)
            a[i][j] += w * row[i] * row[j];
        b[i] += w * row[i] * rhs;
    }
}

static double pair_residual(const double *g, const struct response_pair *p)
{
    double fa, fb;
    int ka = locate_knot(clamped_logit(p->za), &fa), kb = locate_knot(clamped_logit(p->zb), &fb);
    return g[kb] + fb * (g[kb + 1] - g[kb]) - g[ka] - fa * (g[ka + 1] - g[ka]) - p->d;
}

static void add_pairs(double (*a)[BINS], double *b, const struct response_pair *pairs, int n,
                      const double *g)
{
    const double scale = 0.15; // stops; larger residuals count less (Geman-McClure)
    double total = 1e-9;
    for (int i = 0; i < n; i++)
        total += pairs[i].weight;
    for (int i = 0; i < n; i++) {
        const struct response_pair *p = &pairs[i];
        double e = g ? pair_residual(g, p) / (scale * (1.0 + 0.3 * fabs(p->d))) : 0.0;
        double w = p->weight / total * BINS / ((1.0 + e * e) * (1.0 + e * e));
        double row[BINS] = {0}, f;
        int k = locate_knot(clamped_logit(p->zb), &f);
        row[k] += 1.0 - f;
        row[k + 1] += f;
        k = locate_knot(clamped_logit(p->za), &f);
        row[k] -= 1.0 - f;
        row[k + 1] -= f;
        add_row(a, b, row, p->d, w);
    }
}

static void add_prior(double (*a)[BINS], double *b)
{
    for (int k = 0; k + 1 < BINS; k++) {
        double row[BINS] = {0};
        row[k] = -1.0;
        row[k + 1] = 1.0;
        add_row(a, b, row, prior_curve(k + 1) - prior_curve(k), WEAK);
    }
    for (int k = 1; k + 1 < BINS; k++) {
        double row[BINS] = {0};
        row[k - 1] = row[k + 1] = 1.0;
        row[k] = -2.0;
        add_row(a, b, row, prior_curve(k - 1) - 2.0 * prior_curve(k) + prior_curve(k + 1), SMOOTH);
    }
    double row[BINS] = {0};
    row[BINS / 2] = 1.0; // BINS is odd: the knot at u = 0
    add_row(a, b, row, 0.0, 1.0);
}

/* Cholesky; `a` is positive definite by the prior. */
static void solve_bins(double (*a)[BINS], double *b)
{
    for (int j = 0; j < BINS; j++) {
        for (int k = 0; k < j; k++)
            a[j][j] -= a[j][k] * a[j][k];
        a[j][j] = sqrt(fmax(a[j][j], 1e-12));
        for (int i = j + 1; i < BINS; i++) {
            for (int k = 0; k < j; k++)
                a[i][j] -= a[i][k] * a[j][k];
            a[i][j] /= a[j][j];
        }
    }
    for (int i = 0; i < BINS; i++) {
        for (int k = 0; k < i; k++)
            b[i] -= a[i][k] * b[k];
        b[i] /= a[i][i];
    }
    for (int i = BINS - 1; i >= 0; i--) {
        for (int k = i + 1; k < BINS; k++)
            b[i] -= a[k][i] * b[k];
        b[i] /= a[i][i];
    }
}

/* middle: x of the knot at u = 0. */
static void make_rise(double *g, double middle)
{
    const double step = 2.0 * U_END / (BINS - 1);
    double rise[BINS];
    for (int k = 0; k + 1 < BINS; k++)
        rise[k] = fmin(fmax(g[k + 1] - g[k], RISE_MIN * step), RISE_MAX * step);
    g[BINS / 2] = middle;
    for (int k = BINS / 2; k + 1 < BINS; k++)
        g[k + 1] = g[k] + rise[k];
    for (int k = BINS / 2; k > 0; k--)
        g[k - 1] = g[k] - rise[k - 1];
}

/* ---- curve as ReLU units ---- */

/* u at x on the inverse polyline, continued straight. */
static double curve_at(const double *g, double x)
{
    int k = 0;
    while (k < BINS - 2 && g[k + 1] < x)
        k++;
    return knot_u(k) + (x - g[k]) / (g[k + 1] - g[k]) * (knot_u(k + 1) - knot_u(k));
}

/* Half of the units have knots at 0 .. x_end and face away from 0; the first carries the slope, the
 * others bends. */
static void write_side(const double *g, double x_end, float *p, int first)
{
    const int n = TONE_HIDDEN / 2;
    double dir = x_end > 0.0 ? 1.0 : -1.0, step = fabs(x_end) / n, before = 0.0;
    for (int k = 0; k < n; k++) {
        double x = dir * k * step;
        double slope = (curve_at(g, x + dir * step) - curve_at(g, x)) / step;
        p[first + k] = (float)dir;
        p[TONE_HIDDEN + first + k] = (float)(-k * step);
        p[2 * TONE_HIDDEN + first + k] = (float)(slope - before);
        before = slope;
    }
}

static void write_colour(const double *g, struct tonemap *out, int colour)
{
    float *p = out->p + colour * TONE_PER_COLOUR;
    write_side(g, g[0], p, 0);
    write_side(g, g[BINS - 1], p, TONE_HIDDEN / 2);
    p[3 * TONE_HIDDEN] = (float)curve_at(g, 0.0);
}

/* trust: 0 the prior .. 1 what the pairs say */
static void fit_curve(const struct response_pair *pairs, int n, double trust, float mid_log2t,
                      struct tonemap *out)
{
    double g[BINS], a[BINS][BINS];
    for (int round = 0; round < ROUNDS; round++) {
        double b[BINS] = {0};
        memset(a, 0, sizeof a);
        add_pairs(a, b, pairs, n, round ? g : NULL);
        add_prior(a, b);
        solve_bins(a, b);
        memcpy(g, b, sizeof g);
    }
    for (int k = 0; k < BINS; k++) {
        const double prior = prior_curve(k) - prior_curve(BINS / 2);
        g[k] = prior + trust * (g[k] - prior);
    }
    make_rise(g, 0.0);
    memset(out, 0, sizeof *out);
    out->mid_log2t = mid_log2t;
    for (int c = 0; c < 3; c++)
        write_colour(g, out, c);
}

void response_fit(const struct response_pair *pairs, int n, float mid_log2t, struct tonemap *out)
{
    fit_curve(pairs, n, 1.0, mid_log2t, out);
}

static double ramp(double x, double from, double to)
{
    return fmin(fmax((x - from) / (to - from), 0.0), 1.0);
}

/* How far pairs of different places tell the curve. Places differ by a stop or so without any
 * exposure; and an automatic exposure makes dark ones as bright as the others, so that longer ones
 * seem to change nothing. Of known curves log is the flattest, 0.55 of sRGB in the middle. */
static double trust_places(const struct response_pair *pairs, int n)
{
    double prior[BINS], weight = 1e-9, dd = 1e-9, dx = 0.0;
    for (int k = 0; k < BINS; k++)
        prior[k] = prior_curve(k);
    for (int i = 0; i < n; i++) {
        const double w = (double)pairs[i].weight, d = (double)pairs[i].d;
        weight += w;
        dd += w * d * d;
        dx += w * d * (pair_residual(prior, &pairs[i]) + d);
    }
    return ramp(sqrt(dd / weight), 0.7, 1.4) * ramp(dx / dd, 0.25, 0.4);
}

/* ---- known curve ---- */

/* log2 of the linear value with display value sigmoid(u), relative to that of 0.5. */
static double srgb_at(double u)
{
    const double z = 1.0 / (1.0 + exp(-u)), middle = pow((0.5 + 0.055) / 1.055, 2.4);
    const double light = z <= 0.04045 ? z / 12.92 : pow((z + 0.055) / 1.055, 2.4);
    return log2(light / middle);
}

/* As write_side, with knots that are evenly spread over u, for bends near white are narrow. */
static void write_srgb_side(double u_end, float *p, int first)
{
    const int n = TONE_HIDDEN / 2;
    const double dir = u_end > 0.0 ? 1.0 : -1.0, step = u_end / n;
    double before = 0.0;
    for (int k = 0; k < n; k++) {
        const double x = srgb_at(k * step);
        const double slope = fabs(step) / fabs(srgb_at((k + 1) * step) - x) * dir;
        p[first + k] = (float)dir;
        p[TONE_HIDDEN + first + k] = (float)-fabs(x);
        p[2 * TONE_HIDDEN + first + k] = (float)(slope - before);
        before = slope;
    }
}

void response_srgb(float mid_log2t, struct tonemap *out)
{
    const double dark = -12.0, white = 7.6; // logits; 12 bits below the 8-bit code 1
    *out = (struct tonemap){.mid_log2t = mid_log2t};
    for (int c = 0; c < 3; c++) {
        float *p = out->p + c * TONE_PER_COLOUR;
        write_srgb_side(dark, p, 0);
        write_srgb_side(white, p, TONE_HIDDEN / 2);
    }
}

/* ---- use of the curve ---- */

static float curve_logit(const struct tonemap *tone, int colour, float x)
{
    const float *w1 = tone->p + colour * TONE_PER_COLOUR, *b1 = w1 + TONE_HIDDEN,
                *w2 = b1 + TONE_HIDDEN;
    float u = w2[TONE_HIDDEN];
    for (int k = 0; k < TONE_HIDDEN; k++)
        u += w2[k] * fmaxf(w1[k] * x + b1[k], 0.0f);
    return u;
}

float response_display(const struct tonemap *tone, int colour, float x)
{
    return 1.0f / (1.0f + expf(-curve_logit(tone, colour, x)));
}

/* x of a display value by bisection: correct also for a curve that refinement has changed. */
static float invert_curve(const struct tonemap *tone, int colour, float display)
{
    float u = (float)clamped_logit(display), lo = -X_END, hi = X_END;
    for (int i = 0; i < 28; i++) {
        float mid = 0.5f * (lo + hi);
        if (curve_logit(tone, colour, mid) < u)
            lo = mid;
        else
            hi = mid;
    }
    return 0.5f * (lo + hi);
}

float response_radiance_log(const struct tonemap *tone, int colour, float display, float log2t)
{
    return (invert_curve(tone, colour, display) - log2t + tone->mid_log2t) * 0.69314718f;
}

void response_tabulate(const struct tonemap *tone, struct response_table *out)
{
    const float noise = 1.5f / 255.0f; // display units: rounding and sensor noise together
    const float good = 0.2f;           // stops of uncertainty at which the weight is one half
    for (int c = 0; c < 3; c++) {
        for (int z = 0; z < 256; z++) {
            float x = invert_curve(tone, c, (float)z / 255.0f);
            float slope =
                (response_display(tone, c, x + 0.05f) - response_display(tone, c, x - 0.05f)) /
                0.1f;
            float err = noise / fmaxf(slope, 1e-6f) / good;
            float end = fminf(fminf((float)z - 1.0f, 253.0f - (float)z) / 6.0f, 1.0f);
            out->x[c][z] = x;
            out->linear[c][z] = exp2f(x);
            out->weight[c][z] = fmaxf(end, 0.0f) / (1.0f + err * err);
        }
    }
}

void response_bounds(const struct response_table *t, int colour, float x, float weight,
                     float out[2])
{
    enum { DARK = 8, BRIGHT = 247 }; // display values that black and saturation do not reach
    const bool blind = weight < 0.05f, dark = x < t->x[colour][128];
    out[0] = !blind ? x : dark ? -INFINITY : fminf(x, t->x[colour][BRIGHT]);
    out[1] = !blind ? x : dark ? fmaxf(x, t->x[colour][DARK]) : INFINITY;
}

/* Mean display value of x over exposures end[0] .. end[1] stops away. */
static double spread_display(const struct tonemap *tone, int colour, double x, const float end[2])
{
    double sum = 0.0;
    for (int i = 0; i < SPREAD; i++) {
        double away = (double)end[0] + (double)(end[1] - end[0]) * i / (SPREAD - 1);
        sum += (double)response_display(tone, colour, (float)(x + away)) / SPREAD;
    }
    return sum;
}

void response_spread(const struct tonemap *tone, float lo, float hi, struct tonemap *out,
                     float *log2t)
{
    const float end[2] = {lo, hi};
    double g[BINS], middle = 0.0;
    struct tonemap made = {.mid_log2t = tone->mid_log2t};
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < BINS; k++) {
            double a = (double)-X_END - (double)hi, b = (double)X_END - (double)lo;
            for (int i = 0; i < 40; i++) {
                double x = 0.5 * (a + b), u = clamped_logit(spread_display(tone, c, x, end));
                *(u < knot_u(k) ? &a : &b) = x;
            }
            g[k] = 0.5 * (a + b);
        }
        middle = c == 0 ? g[BINS / 2] : middle;
        make_rise(g, g[BINS / 2] - middle);
        write_colour(g, &made, c);
    }
    *log2t = (float)((double)tone->mid_log2t - middle);
    *out = made;
}

/* ---- histograms ---- */

static err_t check_views(const struct views *v)
{
    if (v->n < 1 || v->size < 2)
        return err_fail(ERR_ARG, "response: %d views of %d px, needed are 1 view of 2 px", v->n,
                        v->size);
    for (int i = 0; i < v->n + v->n_more; i++) {
        if (!isfinite(v->log2t[i]))
            return err_fail(ERR_ARG, "response: exposure of view %d is not finite", i);
    }
    return isfinite(v->mid_log2t) ? OK
                                  : err_fail(ERR_ARG, "response: middle exposure is not finite");
}

/* Means of 2 x 2 pixels: noise widens a histogram. */
static void count_pixels(const struct views *v, int i_view, struct group *g)
{
    const size_t w = (size_t)v->extent[i_view].w, h = (size_t)v->extent[i_view].h, row = 3 * w;
    const uint8_t *px = views_rgb(v, i_view);
    for (size_t y = 0; y + 1 < h; y += 2) {
        for (size_t x = 0; x + 1 < w; x += 2) {
            const uint8_t *p = px + y * row + 3 * x;
            if (views_hides_any(v, i_view, (int)x, (int)y, 2))
                continue;
            for (size_t c = 0; c < 3; c++)
                g->hist[c][(p[c] + p[c + 3] + p[row + c] + p[row + c + 3] + 2) / 4]++;
        }
    }
}

/* Views go to the group with their exposure; beyond GROUPS_MAX exposures, to the nearest group. */
static int collect_groups(const struct views *v, struct group *g)
{
    int n = 0;
    for (int i = 0; i < v->n; i++) {
        int best = -1;
        for (int k = 0; k < n; k++) {
            double d = fabs(g[k].log2t / g[k].n - (double)v->log2t[i]);
            if (best < 0 || d < fabs(g[best].log2t / g[best].n - (double)v->log2t[i]))
                best = k;
        }
        bool near =
            best >= 0 && fabs(g[best].log2t / g[best].n - (double)v->log2t[i]) < (double)LOG2_MERGE;
        if (!near && n < GROUPS_MAX)
            best = n++;
        g[best].log2t += (double)v->log2t[i];
        g[best].n++;
        count_pixels(v, i, &g[best]);
    }
    for (int k = 0; k < n; k++)
        g[k].log2t /= g[k].n;
    return n;
}

/* Display value 0..1 below which a share `q` of the pixels lies, interpolated inside a bin. */
static float histogram_quantile(const uint32_t *hist, double q)
{
    double total = 0.0, sum = 0.0;
    for (int z = 0; z < 256; z++)
        total += hist[z];
    for (int z = 0; z < 256; z++) {
        if (hist[z] && sum + hist[z] >= q * total)
            return (float)((z - 0.5 + (q * total - sum) / hist[z]) / 255.0);
        sum += hist[z];
    }
    return 1.0f;
}

int response_quantiles(uint32_t (*a)[256], uint32_t (*b)[256], float d,
                       struct response_pair out[3 * RESPONSE_QUANTILES])
{
    int n = 0;
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < LEVELS; k++) {
            double q = (k + 0.5) / LEVELS;
            struct response_pair p = {histogram_quantile(a[c], q), histogram_quantile(b[c], q), d,
                                      0.0f};
            float lo = fminf(p.za, p.zb), hi = fmaxf(p.za, p.zb);
            if (lo < 3.0f / 255.0f || hi > 251.0f / 255.0f)
                continue;
            p.weight = sqrtf(
                lo * (1.0f - hi)); // an error of one grey value moves the logit most at the ends
            out[n++] = p;
        }
    }
    return n;
}

static int add_group_pair(struct group *a, struct group *b, struct response_pair *out)
{
    return response_quantiles(a->hist, b->hist, (float)(b->log2t - a->log2t), out);
}

/* Pairs from the exposures of one place, each with the next longer one only: they show the same
 * pixels, other places do not. */
static int add_place(const struct views *v, int place, struct group *g, struct response_pair *out)
{
    int n = 0, pairs = 0;
    for (int i = place; i >= 0; i = views_next(v, place, i)) {
        int at = n < GROUPS_MAX ? n++ : n - 1;
        for (; at > 0 && g[at - 1].log2t > (double)v->log2t[i]; at--)
            g[at] = g[at - 1];
        memset(&g[at], 0, sizeof g[at]);
        g[at].log2t = (double)v->log2t[i];
        count_pixels(v, i, &g[at]);
    }
    for (int i = 1; i < n; i++)
        pairs += add_group_pair(&g[i - 1], &g[i], out + pairs);
    return pairs;
}

static int add_groups(const struct views *v, struct group *g, struct response_pair *out)
{
    int n_groups = collect_groups(v, g), n = 0;
    for (int i = 0; i < n_groups; i++) {
        for (int j = i + 1; j < n_groups; j++)
            n += add_group_pair(&g[i], &g[j], out + n);
    }
    return n;
}

static size_t pairs_max(const struct views *v)
{
    size_t groups = GROUPS_MAX * (GROUPS_MAX - 1) / 2, more = (size_t)v->n_more;
    return (more ? more : groups) * 3 * LEVELS;
}

static err_t layout(struct group **g, struct response_pair **pairs, struct arena *tmp,
                    const struct views *v)
{
    err_t e = arena_zalloc(tmp, GROUPS_MAX, sizeof **g, g);
    return e ? e : arena_alloc(tmp, pairs_max(v), sizeof **pairs, pairs);
}

size_t response_plan(const struct views *v)
{
    struct arena tmp = arena_counter();
    struct group *g;
    struct response_pair *pairs;
    return layout(&g, &pairs, &tmp, v) ? SIZE_MAX : tmp.peak;
}

bool response_is_told(const struct views *v)
{
    const int n = v->n + v->n_more;
    double mean = 0.0, square = 0.0;
    for (int i = 0; i < n; i++)
        mean += (double)views_set_log2t(v, i) / n;
    for (int i = 0; i < n; i++) {
        const double x = (double)views_set_log2t(v, i) - mean;
        square += x * x;
    }
    return square > n * APART * APART;
}

err_t response_run(const struct run *r, const struct views *v, struct tonemap *out)
{
    struct group *g;
    struct response_pair *pairs;
    size_t mark = arena_mark(r->tmp);
    err_t e = check_views(v);
    if (e)
        return e;
    e = layout(&g, &pairs, r->tmp, v);
    if (!e) {
        int n = v->n_more ? 0 : add_groups(v, g, pairs);
        for (int i = 0; i < v->n && v->n_more; i++)
            n += add_place(v, i, g, pairs + n);
        fit_curve(pairs, n, v->n_more ? 1.0 : trust_places(pairs, n), v->mid_log2t, out);
    }
    arena_reset(r->tmp, mark);
    return e;
}

void response_mean(const struct views *v, const struct tonemap *tone, float out[3])
{
    struct response_table table;
    response_tabulate(tone, &table);
    for (int c = 0; c < 3; c++) {
        double sum = 0, weight = 0;
        for (int i = 0; i < v->n; i++) {
            float shift = v->log2t[i] - v->mid_log2t;
            const uint8_t *p = views_rgb(v, i) + c;
            for (size_t k = 0; k < extent_pixels(&v->extent[i]); k++, p += 3) {
                double w = views_hides(v, i, k) ? 0 : (double)table.weight[c][*p] + 1e-4;
                sum += w * (double)(table.x[c][*p] - shift);
                weight += w;
            }
        }
        out[c] = weight > 0 ? (float)exp2(sum / weight) : 1;
    }
}
