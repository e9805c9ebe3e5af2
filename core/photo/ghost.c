/* A mosaic is compared as cells of 2 x 2 with three colours, so that nothing is demosaiced. Numbers
 * become light (codes above black, or the relative exposure of a display value) over exposure.
 *
 * The noise of a code is measured: a low quantile of the Laplacian of Laplacians over all frames,
 * by level (Immerkaer 1996; texture raises a median). Beside noise, which averages out, there are
 * errors that do not: of the response, of black level and rounding, and of a place that is known to
 * a fraction of a pixel, which counts by the differences to the neighbours. Flicker and what the
 * response curve is wrong by are taken off as the median ratio of the frame to the reference, by
 * level for display values, as far as the exposure may be wrong.
 *
 * A clipped pixel says "at least", a black display value "at most"; where such a bound is kept, the
 * pixel says nothing. Cells of 4 x 4 differ if the mean square of differences over their errors is
 * not one of noise. A cell alone does not count; weaker ones beside those that differ do. */
#include "core/photo/ghost.h"

#include "core/base/num.h"

#include <stdlib.h>
#include <string.h>

enum {
    CELL = 4,
    LEVELS = 32,      // of codes
    STEPS = 64,       // of a Laplacian, one each; from there on
    OCTAVE = 16,      // so many for each doubling,
    DOUBLINGS = 14,   // up to that of 16 bits
    SAMPLES = 200000, // for the noise of a frame
    POINTS = 4096,    // for its shift
    RATIOS = 256,     // bins of tolerance_of up and down
    FEW = 64,         // pixels that make no median
    DARK = 2,         // display values that may be cut off
    FULL = 6          // samples that a cell needs
};

static const float SQUARE = 32;                   // bins of a square of 1
static const float EXCESS = 4;                    // most that errors grow
static const float CAP = 25;                      // largest square that counts
static const float SURE = 3.5f;                   // mean square of a cell that differs,
static const float WEAK = 2;                      // and of one beside it
static const float RELATIVE[2] = {0.03f, 0.015f}; // error of a response: display, linear
static const float LOST = 2;      // px, of a frame that shows too little to find its shift
static const float PLACE = 0.15f; // px

/* A frame as three colours, or one. */
struct layer {
    int w, h, n; // n: colours
    const uint16_t *px;
    float scale; // light to radiance
};

struct ghost {
    const struct merge_set *s;
    const struct raw *raw;
    struct layer ref, other;
    int clip, codes;
    float *light[3], *var[3]; // (codes) of a code, light and its square
    float *factor[3];         // (codes) of the reference: to the light of the other frame,
    float *steep[3];          // and how much more errors of its own light count therefore
    float *excess[3];         // (codes) of the reference: squares of errors over what was thought
    float place;              // px, by which the shift may be wrong
    float shift[2], part[2];  // px, whole and the rest
    uint32_t *count;          // scratch of histograms
    int *point;               // (POINTS)
    float *square;            // (cells)
    uint8_t *again;           // (cells)
};

static size_t count_of(const struct ghost *g)
{
    const size_t noise = (size_t)LEVELS * (STEPS + OCTAVE * DOUBLINGS);
    (void)g;
    return num_max_size(noise, (size_t)3 * LEVELS * RATIOS);
}

/* ---- layers ---- */

static bool is_mosaic(const struct raw *f)
{
    return f->cfa != RAW_MONO && f->cfa != RAW_RGB;
}

static void layer_size(const struct raw *f, struct layer *out)
{
    const int step = is_mosaic(f) ? 2 : 1;
    *out = (struct layer){.w = f->w / step, .h = f->h / step, .n = f->cfa == RAW_MONO ? 1 : 3};
}

static void bin_row(const struct raw *f, int y, uint16_t *to)
{
    for (int x = 0; x < f->w / 2; x++) {
        int sum[3] = {0}, top = 0;
        for (int k = 0; k < 4; k++) {
            const int i = 2 * y + k / 2, j = 2 * x + k % 2, c = raw_colour(f->cfa, i, j);
            const int v = f->px[(size_t)i * (size_t)f->w + (size_t)j];
            sum[c] += v;
            top = c == 1 ? num_max(top, v) : top;
        }
        to[3 * x] = (uint16_t)sum[0];
        to[3 * x + 1] = (uint16_t)(top >= raw_clip(f) ? top : sum[1] / 2);
        to[3 * x + 2] = (uint16_t)sum[2];
    }
}

/* room: (h, w, 3) of a layer, for a mosaic. */
static void set_layer(const struct merge_set *s, int i, uint16_t *room, struct layer *out)
{
    const struct raw *f = &s->frames[i];
    layer_size(f, out);
    out->scale = 1 / (float)s->exposure_s[i];
    out->px = f->px;
    if (!is_mosaic(f))
        return;
    for (int y = 0; y < out->h; y++)
        bin_row(f, y, room + (size_t)3 * (size_t)out->w * (size_t)y);
    out->px = room;
}

static inline size_t layer_at(const struct layer *l, int x, int y)
{
    return ((size_t)y * (size_t)l->w + (size_t)x) * (size_t)l->n;
}

/* ---- noise ---- */

static int level_of(const struct ghost *g, int code)
{
    const float share = (float)(code - g->raw->black) / (float)(g->codes - g->raw->black);
    return share > 0 ? (int)(sqrtf(share) * (LEVELS - 1)) : 0;
}

static int step_of(int v)
{
    return v < STEPS ? v
                     : num_min(STEPS + (int)(OCTAVE * (log2f((float)v) - 6)),
                               STEPS + OCTAVE * DOUBLINGS - 1);
}

static float step_value(float step)
{
    return step <= STEPS ? step : exp2f((step - STEPS) / OCTAVE + 6);
}

static void count_noise(const struct ghost *g, const struct layer *l)
{
    const size_t row = (size_t)l->w * (size_t)l->n;
    const int rows = num_max(SAMPLES / (l->w * l->n), 1), skip = num_max(l->h / rows, 1);
    for (int y = 1; y + 1 < l->h; y += skip) {
        const uint16_t *p = l->px + (size_t)y * row, *a = p - row, *b = p + row;
        for (int i = l->n; i + l->n < (int)row; i++) {
            const int n = l->n, sides = p[i - n] + p[i + n] + a[i] + b[i];
            const int corners = a[i - n] + a[i + n] + b[i - n] + b[i + n];
            if (p[i] >= g->clip || (!g->raw->linear && p[i] <= DARK))
                continue;
            const int step = step_of(abs(4 * p[i] - 2 * sides + corners));
            g->count[level_of(g, p[i]) * (STEPS + OCTAVE * DOUBLINGS) + step]++;
        }
    }
}

/* Deviation of a level by the quarter of its Laplacians that is least; < 0: too few. */
static float level_deviation(const uint32_t *count)
{
    const float quarter = 0.3186f * 6; // of |x| of a unit normal, times the mask's response
    double n = 0, below = 0;
    int k = 0;
    for (int i = 0; i < STEPS + OCTAVE * DOUBLINGS; i++)
        n += count[i];
    if (n < FEW)
        return -1;
    for (; below + count[k] < n / 4; k++)
        below += count[k];
    const float inside = (float)((n / 4 - below) / count[k]);
    return step_value(fmaxf((float)k - 0.5f + inside, 0)) / quarter;
}

/* Variance of every code, in codes; of levels that no picture has, that of the next below. */
static void set_noise(struct ghost *g)
{
    float level[LEVELS], last = -1;
    for (int i = 0; i < LEVELS; i++) {
        level[i] = level_deviation(g->count + i * (STEPS + OCTAVE * DOUBLINGS));
        last = last < 0 ? level[i] : last;
    }
    for (int i = 0; i < LEVELS; i++) {
        last = level[i] >= 0 ? level[i] : last;
        level[i] = fmaxf(last, 0) * fmaxf(last, 0) + 1.0f / 12;
    }
    for (int c = 0; c < g->ref.n; c++)
        for (int code = 0; code < g->codes; code++)
            g->var[c][code] = level[level_of(g, code)];
}

/* ---- light ---- */

static void set_light(struct ghost *g)
{
    struct crf srgb;
    const struct crf *crf = g->s->crf;
    if (!crf) {
        crf_srgb(&srgb);
        crf = &srgb;
    }
    for (int c = 0; c < g->ref.n; c++)
        for (int code = 0; code < g->codes; code++)
            g->light[c][code] = g->raw->linear
                                    ? (float)(code - g->raw->black)
                                    : exp2f(crf->log2x[g->ref.n == 3 ? c : 1][code & 255]);
}

/* Noise in codes becomes that of light. */
static void spread_noise(struct ghost *g)
{
    for (int c = 0; c < g->ref.n; c++)
        for (int code = 0; code < g->codes; code++) {
            const int a = num_max(code - 1, 0), b = num_min(code + 1, g->codes - 1);
            const float slope = (g->light[c][b] - g->light[c][a]) / (float)(b - a);
            g->var[c][code] *= slope * slope;
        }
}

enum bound { EXACT, AT_LEAST, AT_MOST, NOTHING };

/* What the colour c of a pixel says of its light. */
static inline enum bound bound_of(const struct ghost *g, const uint16_t *p, int c)
{
    if (p[c] >= g->clip)
        return AT_LEAST;
    if (g->raw->linear)
        return EXACT;
    for (int k = 0; k < g->ref.n; k++)
        if (p[k] >= g->clip)
            return NOTHING; // devices mix colours
    return p[c] <= DARK ? AT_MOST : EXACT;
}

/* A difference, and its squared errors that average out, and that do not. */
struct difference {
    float d, noise;
    bool exact;
};

/* Of the frame to the reference, as far as it contradicts the bounds. False: nothing is known. */
static inline bool compare(const struct ghost *g, const uint16_t *p, const uint16_t *q, int c,
                           struct difference *out)
{
    const enum bound a = bound_of(g, p, c), b = bound_of(g, q, c);
    const float x = g->light[c][p[c]] * g->ref.scale;
    const float y = g->light[c][q[c]] * g->other.scale * g->factor[c][p[c]];
    if (a == NOTHING || b == NOTHING || (a == b && a != EXACT))
        return false;
    out->d = y - x;
    out->exact = a == EXACT && b == EXACT;
    const float own = g->ref.scale * g->steep[c][p[c]];
    out->noise = g->var[c][p[c]] * own * own + g->var[c][q[c]] * g->other.scale * g->other.scale;
    const bool less = a == AT_LEAST || b == AT_MOST; // only a frame that is darker contradicts
    return out->exact || (less ? out->d < 0 : out->d > 0);
}

/* Where both frames have pixels. */
static void common_area(const struct ghost *g, int from[2], int end[2])
{
    const int size[2] = {g->ref.w, g->ref.h};
    for (int k = 0; k < 2; k++) {
        from[k] = num_max(-(int)g->shift[k], 0);
        end[k] = size[k] - num_max((int)g->shift[k], 0);
    }
}

/* ---- the ratio of the exposures ---- */

/* As a share of the tolerance, -1..1. *n: 0 where more than half lie outside. */
static float median_ratio(const uint32_t *count, int *n)
{
    double all = 0, below = 0;
    int k = 0;
    for (int i = 0; i < RATIOS; i++)
        all += count[i];
    *n = (int)all;
    if (*n == 0)
        return 0;
    for (; below + count[k] < all / 2; k++)
        below += count[k];
    if (k == 0 || k == RATIOS - 1)
        *n = 0;
    return 2 * ((float)k - 0.5f + (float)((all / 2 - below) / count[k])) / (RATIOS - 1) - 1;
}

/* Stops by which the light of a frame may be wrong: a curve that is not known is that of sRGB only
 * in the middle. */
static float tolerance_of(const struct ghost *g)
{
    if (g->raw->linear)
        return 0.25f;
    return g->s->crf && g->s->crf->known ? 0.35f + g->s->crf->error : 3;
}

/* Pixels that the other frame clips or cuts off count as the most or the least, so that the median
 * of the rest is not that of a choice by brightness. */
static void count_pixel(const struct ghost *g, const uint16_t *p, const uint16_t *q, float most)
{
    for (int c = 0; c < g->ref.n; c++) {
        struct difference d;
        const float x = g->light[c][p[c]] * g->ref.scale;
        const enum bound other = bound_of(g, q, c);
        (void)compare(g, p, q, c, &d);
        if (bound_of(g, p, c) != EXACT || other == NOTHING || !(x > 4 * sqrtf(d.noise)))
            continue;
        float share = log2f(fmaxf((x + d.d) / x, 0.01f)) / most;
        share = other == AT_LEAST ? 1 : other == AT_MOST ? -1 : fmaxf(fminf(share, 1), -1);
        const int level = c * LEVELS + (g->raw->linear ? 0 : p[c] / 8);
        g->count[level * RATIOS + (int)((share + 1) / 2 * (RATIOS - 1) + 0.5f)]++;
    }
}

static void count_ratios(const struct ghost *g)
{
    const struct layer *l = &g->ref;
    const int skip = num_max((int)sqrtf((float)l->w * (float)l->h / SAMPLES), 1);
    const int dx = (int)g->shift[0], dy = (int)g->shift[1];
    int from[2], end[2];
    common_area(g, from, end);
    memset(g->count, 0, (size_t)3 * LEVELS * RATIOS * sizeof *g->count);
    for (int y = from[1]; y < end[1]; y += skip)
        for (int x = from[0]; x < end[0]; x += skip)
            count_pixel(g, l->px + layer_at(l, x, y), g->other.px + layer_at(l, x + dx, y + dy),
                        tolerance_of(g));
}

/* Stops of each level of a colour; one without pixels has that of the nearest. */
static void set_levels(const uint32_t *count, float most, float stops[LEVELS])
{
    int n[LEVELS];
    for (int l = 0; l < LEVELS; l++)
        stops[l] = most * median_ratio(count + l * RATIOS, &n[l]);
    for (int l = 0; l < LEVELS; l++) {
        int near = -1;
        for (int k = 0; k < LEVELS; k++)
            if (n[k] >= FEW && (near < 0 || abs(k - l) < abs(near - l)))
                near = k;
        if (n[l] < FEW)
            stops[l] = near < 0 ? 0 : stops[near];
    }
}

/* 1 - d ln factor / d ln light. */
static void set_steep(struct ghost *g, int c)
{
    for (int code = 0; code < g->codes && !g->raw->linear; code++) {
        const int a = num_max(code - 4, 0), b = num_min(code + 4, g->codes - 1);
        g->steep[c][code] = fabsf(1 - log2f(g->factor[c][b] / g->factor[c][a]) /
                                          log2f(g->light[c][b] / g->light[c][a]));
    }
}

static void set_factors(struct ghost *g)
{
    for (int c = 0; c < g->ref.n; c++)
        for (int code = 0; code < g->codes; code++)
            g->factor[c][code] = g->steep[c][code] = 1;
    count_ratios(g);
    for (int c = 0; c < g->ref.n; c++) {
        float stops[LEVELS];
        set_levels(g->count + c * LEVELS * RATIOS, tolerance_of(g), stops);
        for (int code = 0; code < g->codes; code++) {
            const float at = g->raw->linear ? 0 : fmaxf(((float)code - 3.5f) / 8, 0);
            const int l = num_min((int)at, LEVELS - 2);
            const float part = fminf(at - (float)l, 1);
            g->factor[c][code] = exp2f(-(stops[l] + part * (stops[l + 1] - stops[l])));
        }
        set_steep(g, c);
    }
}

/* ---- the shift of the frame ---- */

/* Differences of the reference's light to the neighbours: the mean to both sides, and the largest.
 */
static inline void slope_of(const struct ghost *g, int x, int y, int c, float mean[2], float *most)
{
    const struct layer *l = &g->ref;
    const uint16_t *p = l->px + layer_at(l, x, y) + c;
    const ptrdiff_t row = (ptrdiff_t)l->w * l->n;
    const float at = g->light[c][*p];
    const float a = g->light[c][p[x > 0 ? -l->n : 0]], b = g->light[c][p[x + 1 < l->w ? l->n : 0]];
    const float o = g->light[c][p[y > 0 ? -row : 0]], u = g->light[c][p[y + 1 < l->h ? row : 0]];
    mean[0] = (b - a) / 2 * l->scale;
    mean[1] = (u - o) / 2 * l->scale;
    *most = (fmaxf(fabsf(a - at), fabsf(b - at)) + fmaxf(fabsf(o - at), fabsf(u - at))) * l->scale;
}

static bool is_point(const struct ghost *g, int x, int y)
{
    const uint16_t *p = g->ref.px + layer_at(&g->ref, x, y);
    const int c = g->ref.n / 2;
    float mean[2], most;
    if (bound_of(g, p, c) != EXACT)
        return false;
    slope_of(g, x, y, c, mean, &most);
    const uint16_t *q = g->other.px + layer_at(&g->other, x, y); // about the noise it will have
    const float own = g->var[c][p[c]] * g->ref.scale * g->ref.scale,
                others = g->var[c][q[c]] * g->other.scale * g->other.scale;
    return most * most > 36 * own && most * most > 4 * others;
}

static int halve_points(const struct ghost *g)
{
    for (int i = 0; 2 * i < POINTS; i++)
        g->point[i] = g->point[2 * i];
    return POINTS / 2;
}

/* Pixels with structure; of more than there is room for, every second one is dropped. Returns their
 * number. */
static int choose_points(const struct ghost *g)
{
    const struct layer *l = &g->ref;
    const int edge = GHOST_SHIFT_MAX + 1, cols = num_max(l->w - 2 * edge, 0);
    const int skip = num_max((int)sqrtf((float)l->w * (float)l->h / (4 * POINTS)), 1);
    int n = 0, stride = 1, seen = 0;
    for (int y = edge; y < l->h - edge; y += skip)
        for (int x = edge; x < edge + cols; x += skip) {
            if (!is_point(g, x, y) || seen++ % stride != 0)
                continue;
            if (n == POINTS) {
                stride *= 2;
                n = halve_points(g);
            }
            g->point[n++] = y * l->w + x;
        }
    return n;
}

/* Mean of the differences over their errors if the frame lay there; a large number where too few
 * points say something. */
static float shift_cost(const struct ghost *g, int n, int dx, int dy)
{
    const struct layer *l = &g->ref;
    const int c = l->n / 2;
    float sum = 0;
    int valid = 0;
    for (int i = 0; i < n; i++) {
        const int x = g->point[i] % l->w, y = g->point[i] / l->w;
        const uint16_t *p = l->px + layer_at(l, x, y);
        struct difference d;
        if (!compare(g, p, g->other.px + layer_at(l, x + dx, y + dy), c, &d) || !d.exact)
            continue;
        const float slack = RELATIVE[g->raw->linear] * g->light[c][p[c]] * l->scale;
        sum += fminf(fabsf(d.d) / sqrtf(d.noise + slack * slack), 3);
        valid++;
    }
    return valid < FEW ? 1e9f : sum / (float)valid;
}

/* One step of least squares for the rest of the shift, without the points that moved. */
static void refine_part(struct ghost *g, int n)
{
    const struct layer *l = &g->ref;
    const int c = l->n / 2, dx = (int)g->shift[0], dy = (int)g->shift[1];
    double xx = 0, xy = 0, yy = 0, xd = 0, yd = 0;
    for (int i = 0; i < n; i++) {
        const int x = g->point[i] % l->w, y = g->point[i] / l->w;
        const uint16_t *p = l->px + layer_at(l, x, y);
        struct difference d;
        float s[2], most;
        if (!compare(g, p, g->other.px + layer_at(l, x + dx, y + dy), c, &d) || !d.exact)
            continue;
        slope_of(g, x, y, c, s, &most);
        const float left = d.d - g->part[0] * s[0] - g->part[1] * s[1];
        if (fabsf(left) > 0.6f * most + 3 * sqrtf(d.noise))
            continue;
        const double weight = 1 / (double)(d.noise + 0.04f * most * most);
        xx += weight * (double)(s[0] * s[0]);
        xy += weight * (double)(s[0] * s[1]);
        yy += weight * (double)(s[1] * s[1]);
        xd += weight * (double)(s[0] * d.d);
        yd += weight * (double)(s[1] * d.d);
    }
    const double det = xx * yy - xy * xy;
    if (!(det > 1e-6 * xx * yy))
        return;
    g->part[0] = (float)fmax(fmin((yy * xd - xy * yd) / det, 0.75), -0.75);
    g->part[1] = (float)fmax(fmin((xx * yd - xy * xd) / det, 0.75), -0.75);
}

/* The frame at (x + shift) shows what the reference does at x. */
static void find_shift(struct ghost *g)
{
    enum { ROUNDS = 4 };
    const int n = choose_points(g);
    const float rest = shift_cost(g, n, 0, 0);
    float best = 0.95f * rest;
    for (int dy = -GHOST_SHIFT_MAX; dy <= GHOST_SHIFT_MAX && rest < 1e9f; dy++)
        for (int dx = -GHOST_SHIFT_MAX; dx <= GHOST_SHIFT_MAX; dx++) {
            const float cost = shift_cost(g, n, dx, dy);
            if (!(cost < best))
                continue;
            best = cost;
            g->shift[0] = (float)dx;
            g->shift[1] = (float)dy;
        }
    for (int i = 0; i < ROUNDS; i++)
        refine_part(g, n);
    g->place = rest < 1e9f ? PLACE + 0.1f * (fabsf(g->part[0]) + fabsf(g->part[1])) : LOST;
}

/* ---- what remains ---- */

/* Square of a difference over its errors, of the colour c at x, y; < 0: nothing is known. */
static inline float error_square(const struct ghost *g, int x, int y, int c, bool *exact)
{
    const struct layer *l = &g->ref;
    const uint16_t *p = l->px + layer_at(l, x, y);
    const uint16_t *q = g->other.px + layer_at(l, x + (int)g->shift[0], y + (int)g->shift[1]);
    struct difference d;
    float s[2], most;
    if (!compare(g, p, q, c, &d))
        return -1;
    *exact = d.exact;
    if (d.d * d.d < d.noise) // most pixels: what else may be wrong does not matter
        return d.d * d.d / (d.noise * g->excess[c][p[c]]);
    slope_of(g, x, y, c, s, &most);
    const float slack = RELATIVE[g->raw->linear] * g->light[c][p[c]] * l->scale +
                        (d.exact ? g->place : fmaxf(g->place, 0.5f)) * most * g->steep[c][p[c]];
    d.d -= d.exact ? g->part[0] * s[0] + g->part[1] * s[1] : 0;
    return d.d * d.d / ((d.noise + slack * slack) * g->excess[c][p[c]]);
}

/* Squares by colour and level of the reference. */
static void count_squares(const struct ghost *g)
{
    const struct layer *l = &g->ref;
    const int skip = num_max((int)sqrtf((float)l->w * (float)l->h / SAMPLES), 1);
    int from[2], end[2];
    bool exact;
    common_area(g, from, end);
    memset(g->count, 0, (size_t)3 * LEVELS * RATIOS * sizeof *g->count);
    for (int y = from[1]; y < end[1]; y += skip)
        for (int i = from[0] * l->n; i < end[0] * l->n;
             i += i % l->n + 1 < l->n ? 1 : (skip - 1) * l->n + 1) {
            const int x = i / l->n, c = i % l->n;
            const float square = error_square(g, x, y, c, &exact);
            const int level = c * LEVELS + level_of(g, l->px[layer_at(l, x, y) + (size_t)c]);
            if (square >= 0 && exact)
                g->count[level * RATIOS + (int)fminf(square * SQUARE, RATIOS - 1)]++;
        }
}

/* Errors of most pixels of a level that are larger than thought make all of them larger: noise that
 * a picture hides, the shape of a response. */
static void set_excess(struct ghost *g)
{
    const float usual = 0.455f; // median square of a unit normal
    for (int c = 0; c < g->ref.n; c++)
        for (int code = 0; code < g->codes; code++)
            g->excess[c][code] = 1;
    count_squares(g);
    for (int c = 0; c < g->ref.n; c++) {
        float level[LEVELS];
        for (int l = 0; l < LEVELS; l++) {
            const uint32_t *count = g->count + (c * LEVELS + l) * RATIOS;
            double all = 0, below = 0;
            int k = 0;
            for (int i = 0; i < RATIOS; i++)
                all += count[i];
            for (; k < RATIOS - 1 && below + count[k] < all / 2; k++)
                below += count[k];
            level[l] = all < FEW ? 1 : ((float)k + 0.5f) / SQUARE / usual;
            level[l] = fmaxf(fminf(level[l], EXCESS), 1);
        }
        for (int code = 0; code < g->codes; code++)
            g->excess[c][code] = level[level_of(g, code)];
    }
}

/* ---- cells ---- */

/* Sum of the squares of a pixel. */
static float pixel_square(const struct ghost *g, int x, int y, int *n)
{
    float sum = 0;
    for (int c = 0; c < g->ref.n; c++) {
        bool exact;
        const float square = error_square(g, x, y, c, &exact);
        sum += square < 0 ? 0 : fminf(square, CAP);
        *n += square >= 0;
    }
    return sum;
}

static void square_cells(const struct ghost *g, const struct ghost_mask *m)
{
    int from[2], end[2];
    common_area(g, from, end);
    for (int i = 0; i < m->cols * m->rows; i++) {
        const int x = i % m->cols * CELL, y = i / m->cols * CELL;
        float sum = 0;
        int n = 0;
        for (int v = num_max(y, from[1]); v < num_min(y + CELL, end[1]); v++)
            for (int u = num_max(x, from[0]); u < num_min(x + CELL, end[0]); u++)
                sum += pixel_square(g, u, v, &n);
        g->square[i] = sum / (float)num_max(n, FULL);
    }
}

static int neighbours_of(const struct ghost_mask *m, const uint8_t *set, int i)
{
    const int x = i % m->cols, y = i / m->cols;
    int n = 0;
    for (int v = num_max(y - 1, 0); v <= num_min(y + 1, m->rows - 1); v++)
        for (int u = num_max(x - 1, 0); u <= num_min(x + 1, m->cols - 1); u++)
            n += set[v * m->cols + u];
    return n - set[i];
}

/* Cells that differ and do not stand alone, then weaker ones beside them, then holes. */
static void decide_cells(const struct ghost *g, struct ghost_mask *m)
{
    enum { GROW = 2, FILL = 2, HOLE = 5 };
    const int n = m->cols * m->rows;
    int moved = 0;
    for (int i = 0; i < n; i++)
        g->again[i] = g->square[i] > SURE;
    for (int i = 0; i < n; i++)
        m->moved[i] = g->again[i] && neighbours_of(m, g->again, i) > 0;
    for (int round = 0; round < GROW + FILL; round++) {
        memcpy(g->again, m->moved, (size_t)n);
        for (int i = 0; i < n; i++) {
            const int beside = neighbours_of(m, g->again, i);
            m->moved[i] |= round < GROW ? beside > 0 && g->square[i] > WEAK : beside >= HOLE;
        }
    }
    for (int i = 0; i < n; i++)
        moved += m->moved[i];
    m->share = (double)moved / n;
}

static void compare_frame(struct ghost *g, struct ghost_mask *m)
{
    const float step = is_mosaic(g->raw) ? 2 : 1;
    memset(g->shift, 0, sizeof g->shift);
    memset(g->part, 0, sizeof g->part);
    for (int round = 0; round < 2; round++) { // curve and shift need each other
        set_factors(g);
        find_shift(g);
    }
    set_factors(g);
    set_excess(g);
    square_cells(g, m);
    decide_cells(g, m);
    for (int k = 0; k < 2; k++)
        m->shift[k] = step * (g->shift[k] - g->part[k]);
}

/* ---- all ---- */

static err_t alloc_masks(struct arena *a, const struct raw *f, int n, struct ghost_mask *out)
{
    struct layer l;
    err_t e = OK;
    layer_size(f, &l);
    for (int i = 0; i < n && !e; i++) {
        out[i] = (struct ghost_mask){.cell = is_mosaic(f) ? 2 * CELL : CELL,
                                     .cols = (l.w + CELL - 1) / CELL,
                                     .rows = (l.h + CELL - 1) / CELL};
        e = arena_zalloc(a, (size_t)out[i].cols * (size_t)out[i].rows, 1, &out[i].moved);
    }
    return e;
}

static err_t alloc_scratch(struct arena *a, const struct raw *f, struct ghost *g, uint16_t *room[2])
{
    struct layer l;
    layer_size(f, &l);
    const size_t px = (size_t)l.w * (size_t)l.h, codes = (size_t)1 << (f->linear ? f->bits : 8);
    const size_t cells = (size_t)((l.w + CELL - 1) / CELL) * (size_t)((l.h + CELL - 1) / CELL);
    err_t e = OK;
    g->codes = (int)codes;
    for (int i = 0; i < 2 && !e; i++)
        e = arena_alloc(a, is_mosaic(f) ? 3 * px : 0, sizeof **room, &room[i]);
    for (int c = 0; c < 3 && !e; c++) {
        e = arena_alloc(a, codes, sizeof(float), &g->light[c]);
        if (!e)
            e = arena_alloc(a, codes, sizeof(float), &g->var[c]);
        if (!e)
            e = arena_alloc(a, codes, sizeof(float), &g->factor[c]);
        if (!e)
            e = arena_alloc(a, codes, sizeof(float), &g->steep[c]);
        if (!e)
            e = arena_alloc(a, codes, sizeof(float), &g->excess[c]);
    }
    if (!e)
        e = arena_zalloc(a, count_of(g), sizeof *g->count, &g->count);
    if (!e)
        e = arena_alloc(a, POINTS, sizeof *g->point, &g->point);
    if (!e)
        e = arena_alloc(a, cells, sizeof *g->square, &g->square);
    return e ? e : arena_alloc(a, cells, 1, &g->again);
}

size_t ghost_plan(const struct raw *frame, int n)
{
    struct arena a = arena_counter();
    struct ghost g = {0};
    struct ghost_mask masks[MERGE_FRAMES_MAX];
    uint16_t *room[2];
    err_t e = alloc_masks(&a, frame, n, masks);
    if (!e)
        e = alloc_scratch(&a, frame, &g, room);
    return e ? SIZE_MAX : a.peak;
}

/* Samples that are neither clipped nor near black, of every 7th. */
static int count_useful(const struct raw *f)
{
    const size_t n = (size_t)f->w * (size_t)f->h * (f->cfa == RAW_RGB ? 3 : 1);
    const int clip = raw_clip(f), dark = f->linear ? f->black + (clip - f->black) / 128 : 16;
    int useful = 0;
    for (size_t i = 0; i < n; i += 7)
        useful += f->px[i] > dark && f->px[i] < clip;
    return useful;
}

int ghost_reference(const struct merge_set *s)
{
    int best = 0, most = -1;
    for (int i = 0; i < s->n; i++) {
        const int useful = count_useful(&s->frames[i]);
        best = useful > most ? i : best;
        most = num_max(useful, most);
    }
    return best;
}

err_t ghost_run(struct arena *a, const struct merge_set *s, int reference, struct ghost_mask *out)
{
    struct ghost g = {.s = s, .raw = s->frames, .clip = raw_clip(s->frames)};
    uint16_t *room[2];
    err_t e = alloc_masks(a, s->frames, s->n, out);
    const size_t mark = arena_mark(a);
    if (!e)
        e = alloc_scratch(a, s->frames, &g, room);
    for (int i = 0; i < s->n && !e; i++) {
        set_layer(s, i, room[1], &g.other);
        count_noise(&g, &g.other);
    }
    if (!e) {
        set_layer(s, reference, room[0], &g.ref);
        set_noise(&g);
        set_light(&g);
        spread_noise(&g);
    }
    for (int i = 0; i < s->n && !e; i++) {
        set_layer(s, i, room[1], &g.other);
        if (i != reference)
            compare_frame(&g, &out[i]);
    }
    arena_reset(a, mark);
    return e;
}
