/* A patch is a block of up to BLOCK x BLOCK px, centred in a cell of an even grid; other pixels are
 * not read. Blocks of small pictures overlap, so that each has neighbours to estimate noise from.
 * Per colour the block's codes become relative exposure (display values by a table, linear ones
 * less black) and are averaged. The mean of the colours counts: where all are noise, the strongest
 * would be biased. In a mosaic the sites of each colour are averaged, green over both of its kinds.
 * CLIPPED if any pixel of any colour is above the limit of raw_clip: once a
 * device has mixed colours, the others of a clipped pixel are not reliable.
 * Display values that are noise cut off at black are DARK whatever code they have: logarithmic
 * curves show single electrons well above code 8.
 * The error of a mean has three parts: noise, from differences of neighbours of one colour (texture
 * makes it larger, never smaller), steps of codes, which do not average out in flat surroundings,
 * and, for linear numbers, a black level that is wrong by half a code.
 * A ratio is the median of log2 x_b / x_a (core/photo/README.md 5.1). Selection must not
 * depend on the noise of the ratio, or it is biased near the dark limit: at ratio R a patch has the
 * expected exposure m = (x_a + x_b) / (1 + R) in a and R m in b, whose errors are independent of
 * x_b / x_a; it counts if both are above its floor, even if x_b itself is not. R starts as the
 * median over patches that are good in both.
 * A band of rows has its own median deviation from the ratio; patches that are dark or clipped in
 * one frame count by how far their bound is beyond the ratio.
 * A row refutes a ratio R by the sum of its patches' differences x_b - R x_a in standard errors,
 * each weighted by the difference expected if another ratio is true. The weight comes from the
 * light by both frames, which is independent of the differences if R is true; where things move,
 * the largest terms do not count. A patch that is dark
 * or clipped in one frame bounds the ratio from one side. Where things move between the frames
 * some bounds are wrong: as many as 2 % of all patches, or twice the share that is said to move. */
#include "core/photo/exposure_probe.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum {
    BLOCK_LEAST = 4,
    BLOCK = 8,
    WRONG = EXPOSURE_PROBE_PATCHES / 50,
    ROUNDS = 4,
    LEAST_PATCHES = 6,
    BAND_PATCHES = 6
};

#define LOG2E 1.44269504f
#define DARK_DISPLAY 8     // codes: core/photo/README.md 4.2
#define ABOVE_BLACK 4.0f   // times the exposure of code 1: curves recovered from noise end too high
#define DARK_LINEAR 8      // codes above black
#define STEP_DISPLAY 0.5f  // rms error of a block in codes: rounding, and DCT steps of JPEG
#define STEP_LINEAR 0.29f  // rounding
#define BLACK_ERROR 0.5f   // codes
#define LEAST 1e-9f        // relative exposure: logarithms are finite
#define SD_MAX 0.15f       // stops: noisier patches are dark
#define FAINT 0x1p-7f      // relative exposure below which display noise may be cut off at black,
#define STAND_OUT 4.0f     // and counts as light only this many times above the noise
#define BOUND_SIGMAS 3.0f  // standard errors added to a bound
#define BAND_SIGMAS 4.0f   // standard errors subtracted from the deviation of a band
#define MEDIAN_ERROR 1.25f // standard error of a median over that of a mean
#define QUARTILE 0.674f    // standard deviations, of a normal distribution
#define CONVERGED 1e-3f    // stops
#define PATCH_MAX 4.0f     // standard errors that one patch may count against a ratio
#define MOVED 0.1f         // stops beyond errors: another surface, or other light on it
#define MOVED_ROW 4.0f     // what moves is nowhere wider than so many times its share
#define ALIKE 1.5f         // codes: rows that differ by less on average are the same,
#define ALIKE_PATCH 2.0f   // if no patch differs by more: four errors of a black level
#define ALIKE_SIGMAS 2.0f  // standard errors added to that difference
#define STEP_BRIGHT 0.008f // relative to x: least step of display codes, beyond the step at black

struct scale {
    const struct raw *px;
    int clip;            // first code that counts as clipped
    float unit;          // relative exposure of a code of linear numbers
    float table[3][256]; // by display value
    float dark[3];       // relative exposure below which a patch is dark
};

/* Sums over one colour of a block. */
struct sum {
    int n, pairs, clipped;
    float x, diff2; // sum of exposures; of squared differences of neighbours
    int64_t codes;
};

struct mean {
    float x, noise;  // relative exposure; noise of a pixel, linear
    float var, step; // squared error by noise; error by steps of codes
};

static void scale_init(const struct raw *px, const struct crf *crf, struct scale *s)
{
    struct crf srgb;
    s->px = px;
    int top = (1 << px->bits) - 1 - px->black;
    s->unit = 1.0f / (float)top;
    s->clip = raw_clip(px);
    if (!px->linear && !crf) {
        crf_srgb(&srgb);
        crf = &srgb;
    }
    for (int c = 0; c < 3; c++) {
        for (int i = 0; i < 256 && !px->linear; i++)
            s->table[c][i] = exp2f(crf->log2x[c][i]);
        s->dark[c] = px->linear ? DARK_LINEAR * s->unit
                                : fmaxf(s->table[c][DARK_DISPLAY], ABOVE_BLACK * s->table[c][1]);
    }
}

static inline float exposure_of(const struct scale *s, int colour, int code)
{
    return s->px->linear ? (float)(code - s->px->black) * s->unit : s->table[colour][code & 255];
}

/* n sites of a colour in a row, `step` numbers apart. */
static void add_row(const struct scale *s, int colour, const uint16_t *p, int n, int step,
                    struct sum *to)
{
    float last = 0.0f;
    for (int i = 0; i < n; i++, p += step) {
        float x = exposure_of(s, colour, *p);
        to->clipped += *p >= s->clip;
        to->codes += *p;
        to->x += x;
        to->diff2 += i > 0 ? (x - last) * (x - last) : 0.0f;
        last = x;
    }
    to->n += n;
    to->pairs += n - 1;
}

/* Edge of the blocks along a side of n px: even, no longer than a cell if that is long enough. */
static int edge_of(int n)
{
    int cell = n / EXPOSURE_PROBE_EDGE / 2 * 2;
    return num_min(n, num_min(num_max(cell, BLOCK_LEAST), BLOCK));
}

/* Sums of a block per colour; in a mosaic it begins at an even site. */
static void add_block(const struct scale *s, int y0, int x0, struct sum to[3])
{
    const struct raw *px = s->px;
    int w = edge_of(px->w), h = edge_of(px->h);
    size_t pitch = px->cfa == RAW_RGB ? 3 : 1;
    for (int y = y0; y < y0 + h; y++) {
        const uint16_t *p = px->px + ((size_t)y * (size_t)px->w + (size_t)x0) * pitch;
        if (px->cfa == RAW_MONO)
            add_row(s, 1, p, w, 1, &to[1]);
        else if (px->cfa == RAW_RGB)
            for (int c = 0; c < 3; c++)
                add_row(s, c, p + c, w, 3, &to[c]);
        else
            for (int k = 0; k < 2; k++)
                add_row(s, raw_colour(px->cfa, y, k), p + k, w / 2, 2,
                        &to[raw_colour(px->cfa, y, k)]);
    }
}

static struct mean mean_of(const struct scale *s, int colour, const struct sum *m)
{
    float n = (float)m->n, step = STEP_LINEAR * s->unit;
    if (!s->px->linear) {
        int code = num_min((int)(m->codes / m->n), 254), below = code > 0 ? code - 1 : 0;
        step = STEP_DISPLAY * 0.5f * (s->table[colour][code + 1] - s->table[colour][below]);
    }
    float noise2 = m->pairs > 0 ? 0.5f * m->diff2 / (float)m->pairs : 0.0f;
    return (struct mean){m->x / n, sqrtf(noise2), noise2 / n, step};
}

static void measure_patch(const struct scale *s, int y0, int x0, int at, struct exposure_probe *to)
{
    struct sum sums[3] = {{0}};
    struct mean all = {0};
    float dark = 0.0f, n = 0.0f;
    bool clipped = false;
    add_block(s, y0, x0, sums);
    for (int c = 0; c < 3; c++) {
        if (sums[c].n == 0)
            continue;
        struct mean m = mean_of(s, c, &sums[c]);
        clipped |= sums[c].clipped > 0;
        all.x += m.x;
        all.noise += m.noise;
        all.var += m.var + m.step * m.step;
        dark += s->dark[c];
        n += 1.0f;
    }
    float black = s->px->linear ? BLACK_ERROR * s->unit : 0.0f;
    float x = all.x / n, sd = sqrtf(all.var / (n * n) + black * black);
    float floor = fmaxf(dark / n, LOG2E / SD_MAX * sd);
    if (!s->px->linear) // linear numbers have a black level
        floor = fmaxf(floor, fminf(FAINT, STAND_OUT * all.noise / n));
    to->x[at] = x;
    to->sd[at] = sd;
    to->floor[at] = floor;
    to->state[at] = (uint8_t)(clipped     ? EXPOSURE_PROBE_CLIPPED
                              : x < floor ? EXPOSURE_PROBE_DARK
                                          : EXPOSURE_PROBE_GOOD);
}

/* First pixel of the block of cell i, of n pixels. */
static int begin_of(const struct raw *px, int i, int n)
{
    int edge = edge_of(n),
        at = (int)((2 * i + 1) * (int64_t)n / (2 * EXPOSURE_PROBE_EDGE)) - edge / 2;
    at = num_max(num_min(at, n - edge), 0);
    return px->cfa == RAW_MONO || px->cfa == RAW_RGB ? at : at & ~1;
}

void exposure_probe_measure(const struct raw *px, const struct crf *crf, struct exposure_probe *out)
{
    struct scale s;
    int count[3] = {0};
    scale_init(px, crf, &s);
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        int y = begin_of(px, i / EXPOSURE_PROBE_EDGE, px->h),
            x = begin_of(px, i % EXPOSURE_PROBE_EDGE, px->w);
        measure_patch(&s, y, x, i, out);
        count[out->state[i]]++;
    }
    float share = (float)(edge_of(px->w) * edge_of(px->h)) / ((float)px->w * (float)px->h);
    out->linear = px->linear;
    out->step = px->linear ? s.unit : (s.table[0][1] + s.table[1][1] + s.table[2][1]) / 3.0f;
    out->overlap = fmaxf(share * EXPOSURE_PROBE_PATCHES, 1.0f);
    out->good = count[EXPOSURE_PROBE_GOOD];
    out->dark = count[EXPOSURE_PROBE_DARK];
    out->clipped = count[EXPOSURE_PROBE_CLIPPED];
}

/* ---- comparison ---- */

struct lists {
    int n_seen, n_lo, n_hi;
    struct {
        int patch;
        float log2;
    } seen[EXPOSURE_PROBE_PATCHES]; // good in at least one frame, clipped in none
    float lo[EXPOSURE_PROBE_PATCHES], hi[EXPOSURE_PROBE_PATCHES];
};

struct pair {
    const struct exposure_probe *a, *b;
    struct lists l;
    float r, ratio;                      // estimate so far: log2, linear
    float value[EXPOSURE_PROBE_PATCHES]; // scratch for medians
};

static float log_ratio(float b, float a)
{
    return log2f(fmaxf(b, LEAST) / fmaxf(a, LEAST));
}

static void add_bound(const struct exposure_probe *a, const struct exposure_probe *b, int i,
                      struct lists *to)
{
    bool lo = a->state[i] == EXPOSURE_PROBE_DARK || b->state[i] == EXPOSURE_PROBE_CLIPPED;
    float xa = a->state[i] == EXPOSURE_PROBE_DARK ? a->floor[i] : fmaxf(a->x[i], LEAST);
    float xb = b->state[i] == EXPOSURE_PROBE_DARK ? b->floor[i] : fmaxf(b->x[i], LEAST);
    float error = BOUND_SIGMAS * LOG2E * hypotf(a->sd[i] / xa, b->sd[i] / xb), r = log2f(xb / xa);
    if (lo)
        to->lo[to->n_lo++] = r - error;
    else
        to->hi[to->n_hi++] = r + error;
}

static void add_patch(const struct exposure_probe *a, const struct exposure_probe *b, int i,
                      struct lists *to)
{
    int sa = a->state[i], sb = b->state[i];
    if (sa == sb && sa != EXPOSURE_PROBE_GOOD)
        return; // most patches of a dark picture: skip their logarithm
    if (sa != EXPOSURE_PROBE_CLIPPED && sb != EXPOSURE_PROBE_CLIPPED) {
        to->seen[to->n_seen].patch = i;
        to->seen[to->n_seen++].log2 = log_ratio(b->x[i], a->x[i]);
    }
    if (sa != EXPOSURE_PROBE_GOOD || sb != EXPOSURE_PROBE_GOOD)
        add_bound(a, b, i, to);
}

/* The number of rank k of n (Hoare's FIND); reorders them. */
static float select_rank(float *v, int n, int k)
{
    for (int lo = 0, hi = n - 1; lo < hi;) {
        float pivot = v[k];
        int i = lo, j = hi;
        while (i <= j) {
            while (v[i] < pivot)
                i++;
            while (pivot < v[j])
                j--;
            if (i > j)
                break;
            float t = v[i];
            v[i++] = v[j];
            v[j--] = t;
        }
        lo = j < k ? i : lo;
        hi = k < i ? j : hi;
    }
    return v[k];
}

/* Exposure of patch i in a, expected from both frames; 0 if it is below the floor of either. */
static float expected_exposure(const struct pair *p, int i)
{
    float m = (p->a->x[i] + p->b->x[i]) / (1.0f + p->ratio);
    return m >= p->a->floor[i] && m * p->ratio >= p->b->floor[i] ? m : 0.0f;
}

static void set_ratio(struct pair *p, float r)
{
    p->r = r;
    p->ratio = exp2f(r);
}

static int collect_good(struct pair *p)
{
    int n = 0;
    for (int k = 0; k < p->l.n_seen; k++) {
        int i = p->l.seen[k].patch;
        if (p->a->state[i] == EXPOSURE_PROBE_GOOD && p->b->state[i] == EXPOSURE_PROBE_GOOD)
            p->value[n++] = p->l.seen[k].log2;
    }
    return n;
}

/* Ratios of the patches with a sufficient expected exposure; var: the sum of their squared errors.
 */
static int collect_expected(struct pair *p, float *var)
{
    int n = 0;
    *var = 0.0f;
    for (int k = 0; k < p->l.n_seen; k++) {
        int i = p->l.seen[k].patch;
        float m = expected_exposure(p, i);
        if (m <= 0.0f)
            continue;
        float sa = p->a->sd[i] / m, sb = p->b->sd[i] / (m * p->ratio);
        *var += LOG2E * LOG2E * (sa * sa + sb * sb);
        p->value[n++] = p->l.seen[k].log2;
    }
    return n;
}

/* Standard error of the median of n patches with a standard deviation of sd. */
static float median_error(const struct pair *p, float sd, int n)
{
    return MEDIAN_ERROR * sd * sqrtf(fmaxf(p->a->overlap, p->b->overlap) / (float)n);
}

/* Half of the range between the quartiles. */
static float spread_of(float *v, int n)
{
    int quarter = n / 4;
    return 0.5f * (select_rank(v, n, n - 1 - quarter) - select_rank(v, n, quarter));
}

/* Share of the patches that have a ratio or a bound of it, and surely another ratio. */
static float share_moved(const struct pair *p)
{
    const struct lists *l = &p->l;
    int n = l->n_lo + l->n_hi, moved = 0;
    for (int k = 0; k < l->n_seen; k++) {
        const int i = l->seen[k].patch;
        if (p->a->state[i] != EXPOSURE_PROBE_GOOD || p->b->state[i] != EXPOSURE_PROBE_GOOD)
            continue; // a bound
        const float sd = LOG2E * hypotf(p->a->sd[i] / p->a->x[i], p->b->sd[i] / p->b->x[i]);
        moved += fabsf(l->seen[k].log2 - p->r) > MOVED + BAND_SIGMAS * sd;
        n++;
    }
    for (int k = 0; k < l->n_lo; k++)
        moved += l->lo[k] > p->r + MOVED;
    for (int k = 0; k < l->n_hi; k++)
        moved += l->hi[k] < p->r - MOVED;
    return (float)moved / (float)n;
}

static void estimate_ratio(struct pair *p, struct exposure_probe_ratio *out)
{
    float var = 0.0f, step = INFINITY;
    int n = collect_good(p);
    if (n > 0)
        set_ratio(p, select_rank(p->value, n, n / 2));
    for (int k = 0; n > 0 && k < ROUNDS && step > CONVERGED; k++) {
        n = collect_expected(p, &var);
        float r = n > 0 ? select_rank(p->value, n, n / 2) : p->r;
        step = fabsf(r - p->r);
        set_ratio(p, r);
    }
    if (n < LEAST_PATCHES * fmaxf(p->a->overlap, p->b->overlap))
        return;
    out->patches = n;
    out->log2 = p->r;
    out->spread = spread_of(p->value, n);
    out->noise = sqrtf(var / (float)n);
    out->error = median_error(p, out->spread / QUARTILE, n);
    out->moved = share_moved(p);
}

/* Bounds of log2 x of a patch. */
static void log_bounds(const struct exposure_probe *w, int i, float *lo, float *hi)
{
    float l = log2f(fmaxf(w->x[i], w->floor[i]));
    *lo = w->state[i] == EXPOSURE_PROBE_DARK ? -INFINITY : l;
    *hi = w->state[i] == EXPOSURE_PROBE_CLIPPED ? INFINITY : l;
}

/* Least distance of the ratio of patch i from that of all, stops; false: it is not known. Dark
 * patches that are as dark as expected count, too: without them the patches that noise makes good
 * would be the majority. */
static bool ratio_deviation(const struct pair *p, int i, float *off)
{
    float lo_a, hi_a, lo_b, hi_b;
    int sa = p->a->state[i], sb = p->b->state[i];
    if (sa == sb && sa != EXPOSURE_PROBE_GOOD)
        return false;
    log_bounds(p->a, i, &lo_a, &hi_a);
    log_bounds(p->b, i, &lo_b, &hi_b);
    *off = fmaxf(lo_b - hi_a - p->r, 0.0f) + fminf(hi_b - lo_a - p->r, 0.0f);
    return *off != 0.0f || (sa != EXPOSURE_PROBE_CLIPPED && sb != EXPOSURE_PROBE_CLIPPED);
}

/* Significant deviation of a band of rows of the grid, stops. spread: of all patches. */
static float band_off(struct pair *p, int row, int rows, float spread)
{
    int n = 0;
    for (int i = row * EXPOSURE_PROBE_EDGE; i < (row + rows) * EXPOSURE_PROBE_EDGE; i++)
        n += ratio_deviation(p, i, &p->value[n]);
    if (n < BAND_PATCHES)
        return 0.0f;
    float noise = fmaxf(spread_of(p->value, n), spread) / QUARTILE;
    float off = fabsf(select_rank(p->value, n, n / 2));
    return fmaxf(off - BAND_SIGMAS * median_error(p, noise, n), 0.0f);
}

static float widest_band(struct pair *p, float spread)
{
    float most = 0.0f;
    for (int rows = 1; rows < EXPOSURE_PROBE_EDGE; rows *= 2)
        for (int row = 0; row < EXPOSURE_PROBE_EDGE; row += rows)
            most = fmaxf(most, band_off(p, row, rows, spread));
    return most;
}

/* The bounds that are left when as many are wrong as may be. */
static void bound_ratio(struct lists *l, float moving, struct exposure_probe_ratio *out)
{
    const int lo = num_max(WRONG, (int)(2 * moving * (float)l->n_lo));
    const int hi = num_max(WRONG, (int)(2 * moving * (float)l->n_hi));
    out->lo = l->n_lo > lo ? select_rank(l->lo, l->n_lo, l->n_lo - 1 - lo) : -INFINITY;
    out->hi = l->n_hi > hi ? select_rank(l->hi, l->n_hi, hi) : INFINITY;
    if (out->lo > out->hi) { // more are wrong
        out->lo = -INFINITY;
        out->hi = INFINITY;
    }
}

void exposure_probe_compare(const struct exposure_probe *a, const struct exposure_probe *b,
                            float moving, struct exposure_probe_ratio *out)
{
    struct pair p = {.a = a, .b = b};
    struct lists *l = &p.l;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
        add_patch(a, b, i, l);
    *out = (struct exposure_probe_ratio){0};
    bound_ratio(l, moving, out);
    estimate_ratio(&p, out);
    if (out->patches > 0)
        out->band = widest_band(&p, out->spread);
}

/* ---- rows that had another exposure ---- */

struct refuter {
    const struct exposure_probe *a, *b;
    float r, other; // ratios, linear
    bool same;      // the other is no other than a: what is dark or clipped is so in both
    int moved;      // patches of a row whose evidence does not count: something moves
};

/* Bounds of the true x of a patch, without its standard error. */
static void bound_patch(const struct refuter *t, const struct exposure_probe *w, int i, float *lo,
                        float *hi)
{
    bool dark = w->state[i] == EXPOSURE_PROBE_DARK && !t->same && !w->linear;
    *lo = dark ? 0.0f : w->x[i];
    *hi = dark                                                ? w->floor[i]
          : w->state[i] == EXPOSURE_PROBE_CLIPPED && !t->same ? INFINITY
                                                              : w->x[i];
}

/* Light of patch i in a by both frames, if b has the other ratio to it; var: its squared error.
 * Where both but bound it, that which makes the ratios differ most: the longer one saturates. */
static float light_if(const struct refuter *t, int i, float *var)
{
    float lo_a, hi_a, lo_b, hi_b, va = t->a->sd[i] * t->a->sd[i];
    float vb = t->b->sd[i] * t->b->sd[i] / (t->other * t->other);
    bound_patch(t, t->a, i, &lo_a, &hi_a);
    bound_patch(t, t->b, i, &lo_b, &hi_b);
    float xa = lo_a, xb = lo_b / t->other;
    bool a = lo_a == hi_a, b = lo_b == hi_b;
    *var = a && b ? va * vb / fmaxf(va + vb, 1e-30f) : a ? va : b ? vb : 0.0f;
    if (a && b)
        return (xa * vb + xb * va) / fmaxf(va + vb, 1e-30f);
    if (a || b)
        return a ? xa : xb;
    float most = fminf(1.0f / fmaxf(t->r, t->other), fminf(hi_a, hi_b / t->other));
    return fmaxf(most, fmaxf(xa, xb));
}

/* Distance of b from the other ratio towards its own, standard errors. */
static float deviation_from_other(const struct refuter *t, int i, float sd)
{
    float lo_a, hi_a, lo_b, hi_b;
    bound_patch(t, t->a, i, &lo_a, &hi_a);
    bound_patch(t, t->b, i, &lo_b, &hi_b);
    float off = t->other < t->r ? lo_b - t->other * hi_a : t->other * lo_a - hi_b;
    bool bounds = lo_a < hi_a || lo_b < hi_b;
    off = bounds ? fmaxf(off, 0.0f) : off;
    float black = BLACK_ERROR * (1.0f + t->other) * t->b->step;
    off = off > 0.0f ? fmaxf(off - black, 0.0f) : off;
    return fmaxf(fminf(off / sd, PATCH_MAX), -PATCH_MAX);
}

/* Exposure of one code at patch i of b. */
static float step_at(const struct exposure_probe *b, int i)
{
    return b->step + (b->linear ? 0.0f : STEP_BRIGHT * b->x[i]);
}

/* Difference of the two ratios at a patch of that light. */
static float expected_difference(const struct refuter *t, float light)
{
    return fabsf(fminf(t->r * light, 1.0f) - fminf(t->other * light, 1.0f));
}

/* The sum without its largest terms. */
static float sum_smallest(float *term, int n, int left_out)
{
    float sum = 0.0f;
    if (left_out > 0)
        select_rank(term, n, n - left_out);
    for (int i = 0; i < n - left_out; i++)
        sum += term[i];
    return sum;
}

static void judge_row(const struct refuter *t, int row, struct exposure_probe_rows *out)
{
    bool shown = false;
    float term[EXPOSURE_PROBE_EDGE], var = 0.0f, differ = 0.0f, differ_var = 0.0f, v;
    float apart = fabsf(t->r - t->other);
    float overlap = sqrtf(fmaxf(t->a->overlap, t->b->overlap)); // along the row
    for (int k = 0; k < EXPOSURE_PROBE_EDGE; k++) {
        const int i = row * EXPOSURE_PROBE_EDGE + k;
        float light = light_if(t, i, &v);
        float sd = fmaxf(hypotf(t->b->sd[i], t->other * t->a->sd[i]), 1e-9f);
        float off = expected_difference(t, light), weight = fmaxf(fminf(off / sd, PATCH_MAX), 0.0f);
        term[k] = weight * deviation_from_other(t, i, sd);
        var += weight * weight;
        float share = 1.0f / (step_at(t->b, i) * EXPOSURE_PROBE_EDGE);
        differ += share * off;
        differ_var += share * share * apart * apart * v;
        shown |= off > ALIKE_PATCH * step_at(t->b, i) + ALIKE_SIGMAS * apart * sqrtf(v);
    }
    if (sum_smallest(term, EXPOSURE_PROBE_EDGE, t->moved) > BAND_SIGMAS * sqrtf(overlap * var))
        out->refuted |= (uint32_t)1 << row;
    if (!shown && differ + ALIKE_SIGMAS * sqrtf(overlap * differ_var) < ALIKE)
        out->alike |= (uint32_t)1 << row;
}

void exposure_probe_refuted(const struct exposure_probe *a, const struct exposure_probe *b,
                            const struct exposure_probe_rivals *rivals,
                            struct exposure_probe_rows *out)
{
    struct refuter t = {
        a,
        b,
        (float)exp2(rivals->log2),
        (float)exp2(rivals->other),
        rivals->other == 0.0,
        num_min((int)(MOVED_ROW * rivals->moving * EXPOSURE_PROBE_EDGE), EXPOSURE_PROBE_EDGE / 2)};
    *out = (struct exposure_probe_rows){0};
    for (int i = 0; i < EXPOSURE_PROBE_EDGE; i++)
        judge_row(&t, i, out);
}
