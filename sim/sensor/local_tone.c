#include "sim/sensor/local_tone.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

#define GREY 0.18f  // of full scale
#define GAMMA 2.2f  // of the values whose histograms are equalised
#define HELD 2.0f   // stops
#define MOST 4.0f   // stops: no more noise is shown
#define CELL 0.03f  // of the longer edge: of the bilateral grid
#define DARK -12.0f // log2 of the exposure of its first layer, layers are a stop apart
enum { LAYERS = 18 };

enum { TILES = 6, BINS = 64 }; // of CLAHE: across the longer edge; of a histogram
#define SLOPE 2.0f
#define SHARE 0.5f

enum { BRACKET = 3 };
static const float stops_of[BRACKET] = {0, 1.5f, 3};
#define SURROUNDINGS 0.04f // of the longer edge: half of the window that is averaged, twice
#define WELL 0.2f          // deviation of display values that are well exposed, around 0.5

struct operation {
    enum local_tone kind;
    int w, h;
    int cell, gw, gh;      // px; nodes of the grid or tiles
    float *luma, *gain;    // (h, w)
    float *grid, *scratch; // (gh, gw, LAYERS, 2) sum and weight
    float *cdf;            // (gh, gw, BINS)
    float *weight, *line;  // (h, w); (max(w, h))
};

static void size_grid(struct operation *o)
{
    const int edge = num_max(o->w, o->h);
    o->cell = o->kind == LOCAL_TONE_BASE ? num_max(2, (int)((float)edge * CELL))
                                         : num_max(2, (edge + TILES - 1) / TILES);
    o->gw = (o->w + o->cell - 1) / o->cell + 1;
    o->gh = (o->h + o->cell - 1) / o->cell + 1;
}

static err_t layout(struct operation *o, struct arena *tmp)
{
    const size_t area = (size_t)o->w * (size_t)o->h, nodes = (size_t)o->gw * (size_t)o->gh;
    const size_t edge = (size_t)num_max(o->w, o->h);
    err_t e = arena_alloc(tmp, area, sizeof *o->luma, &o->luma);
    if (!e)
        e = arena_alloc(tmp, area, sizeof *o->gain, &o->gain);
    if (!e && o->kind == LOCAL_TONE_BASE)
        e = arena_alloc(tmp, nodes * LAYERS * 2, sizeof *o->grid, &o->grid);
    if (!e && o->kind == LOCAL_TONE_BASE)
        e = arena_alloc(tmp, nodes * LAYERS * 2, sizeof *o->scratch, &o->scratch);
    if (!e && o->kind == LOCAL_TONE_CLAHE)
        e = arena_alloc(tmp, nodes * BINS, sizeof *o->cdf, &o->cdf);
    if (!e && o->kind == LOCAL_TONE_FUSION)
        e = arena_alloc(tmp, area, sizeof *o->weight, &o->weight);
    if (!e && o->kind == LOCAL_TONE_FUSION)
        e = arena_alloc(tmp, edge, sizeof *o->line, &o->line);
    return e;
}

size_t local_tone_plan(enum local_tone kind, int w, int h)
{
    struct arena tmp = arena_counter();
    struct operation o = {.kind = kind, .w = w, .h = h};
    if (kind == LOCAL_TONE_NONE)
        return 0;
    size_grid(&o);
    return layout(&o, &tmp) ? SIZE_MAX : tmp.peak;
}

/* ---- base layer ---- */

/* The node below x, 0 .. n - 2, and the share of the one above. */
static int node_below(float x, int n, float *share)
{
    const int k = num_max(0, num_min((int)x, n - 2));
    *share = fminf(fmaxf(x - (float)k, 0), 1);
    return k;
}

static float layer_of(float luma)
{
    return fminf(fmaxf(log2f(luma + 1e-6f) - DARK, 0), LAYERS - 1);
}

/* Nodes and weights of the eight corners around a pixel. */
static void find_corners(const struct operation *o, int x, int y, size_t at[8], float share[8])
{
    float part[3];
    const int base[3] = {
        node_below((float)x / (float)o->cell, o->gw, &part[0]),
        node_below((float)y / (float)o->cell, o->gh, &part[1]),
        node_below(layer_of(o->luma[(size_t)y * (size_t)o->w + (size_t)x]), LAYERS, &part[2])};
    for (int k = 0; k < 8; k++) {
        const int up[3] = {k & 1, k >> 1 & 1, k >> 2};
        at[k] = ((size_t)(base[1] + up[1]) * (size_t)o->gw + (size_t)(base[0] + up[0])) * LAYERS +
                (size_t)(base[2] + up[2]);
        share[k] = 1;
        for (int i = 0; i < 3; i++)
            share[k] *= up[i] ? part[i] : 1 - part[i];
    }
}

/* [1 2 1] / 4 along one axis, whose nodes are `step` apart; `n` of them. */
static void blur_axis(struct operation *o, size_t step, size_t n)
{
    const size_t all = (size_t)o->gw * (size_t)o->gh * LAYERS;
    memcpy(o->scratch, o->grid, 2 * all * sizeof *o->grid);
    for (size_t i = 0; i < all; i++) {
        const size_t k = i / step % n, below = k ? i - step : i, above = k + 1 < n ? i + step : i;
        for (size_t c = 0; c < 2; c++)
            o->grid[2 * i + c] = 0.25f * (o->scratch[2 * below + c] + o->scratch[2 * above + c]) +
                                 0.5f * o->scratch[2 * i + c];
    }
}

static float hold(float base)
{
    return HELD * tanhf(base / HELD);
}

static void find_base_gain(struct operation *o)
{
    size_t at[8];
    float share[8];
    const float white = -log2f(GREY) - hold(-log2f(GREY)); // full scale stays full scale
    memset(o->grid, 0, (size_t)o->gw * (size_t)o->gh * LAYERS * 2 * sizeof *o->grid);
    for (int i = 0; i < o->w * o->h; i++) {
        find_corners(o, i % o->w, i / o->w, at, share);
        for (int k = 0; k < 8; k++) {
            o->grid[2 * at[k]] += share[k] * layer_of(o->luma[i]);
            o->grid[2 * at[k] + 1] += share[k];
        }
    }
    blur_axis(o, 1, LAYERS);
    blur_axis(o, LAYERS, (size_t)o->gw);
    blur_axis(o, (size_t)LAYERS * (size_t)o->gw, (size_t)o->gh);
    for (int i = 0; i < o->w * o->h; i++) {
        float sum[2] = {0};
        find_corners(o, i % o->w, i / o->w, at, share);
        for (int k = 0; k < 8; k++)
            for (size_t c = 0; c < 2; c++)
                sum[c] += share[k] * o->grid[2 * at[k] + c];
        const float base = sum[0] / sum[1] + DARK - log2f(GREY);
        o->gain[i] = exp2f(fminf(hold(base) - base + white, MOST));
    }
}

/* ---- histograms ---- */

/* 0..1, more of what is brighter than white. */
static float display_of(float luma)
{
    return powf(luma, 1 / GAMMA);
}

static int bin_of(float display)
{
    return num_min((int)(display * BINS), BINS - 1);
}

/* Cumulative shares of the square of a tile around its node; none above SLOPE times the mean. */
static void equalise_tile(struct operation *o, int gx, int gy)
{
    float *cdf = o->cdf + ((size_t)gy * (size_t)o->gw + (size_t)gx) * BINS;
    float n = 0, over = 0, sum = 0;
    memset(cdf, 0, BINS * sizeof *cdf);
    for (int y = num_max(0, gy * o->cell - o->cell / 2);
         y < num_min(o->h, gy * o->cell + o->cell / 2 + 1); y++)
        for (int x = num_max(0, gx * o->cell - o->cell / 2);
             x < num_min(o->w, gx * o->cell + o->cell / 2 + 1); x++) {
            cdf[bin_of(display_of(o->luma[(size_t)y * (size_t)o->w + (size_t)x]))]++;
            n++;
        }
    const float most = SLOPE * fmaxf(n, 1) / BINS;
    for (int k = 0; k < BINS; k++) {
        over += fmaxf(cdf[k] - most, 0);
        cdf[k] = fminf(cdf[k], most);
    }
    for (int k = 0; k < BINS; k++) {
        sum += (cdf[k] + over / BINS) / fmaxf(n, 1);
        cdf[k] = sum;
    }
}

/* Display value under the curve of a tile, linear within a bin. */
static float equalised(const float *cdf, float display)
{
    const int k = bin_of(display);
    const float below = k ? cdf[k - 1] : 0;
    return below + (display * BINS - (float)k) * (cdf[k] - below);
}

static void find_clahe_gain(struct operation *o)
{
    for (int k = 0; k < o->gw * o->gh; k++)
        equalise_tile(o, k % o->gw, k / o->gw);
    for (int i = 0; i < o->w * o->h; i++) {
        const float display = display_of(o->luma[i]);
        float part[2], sum = 0;
        const int gx = node_below((float)(i % o->w) / (float)o->cell, o->gw, &part[0]);
        const int gy = node_below((float)(i / o->w) / (float)o->cell, o->gh, &part[1]);
        for (int k = 0; k < 4; k++) {
            const size_t node = (size_t)(gy + k / 2) * (size_t)o->gw + (size_t)(gx + k % 2);
            const float share = (k % 2 ? part[0] : 1 - part[0]) * (k / 2 ? part[1] : 1 - part[1]);
            sum += share * equalised(o->cdf + node * BINS, display);
        }
        const float to = (1 - SHARE) * display + SHARE * sum;
        o->gain[i] = powf((to + 1e-3f) / (display + 1e-3f), GAMMA);
    }
}

/* ---- fusion ---- */

/* Mean of 2 radius + 1 values that are `step` apart; edges repeat. */
static void average_line(struct operation *o, float *at, int n, size_t step, int radius)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        o->line[i] = at[(size_t)i * step];
    for (int i = -radius; i <= radius; i++)
        sum += (double)o->line[num_max(0, num_min(i, n - 1))];
    for (int i = 0; i < n; i++) {
        at[(size_t)i * step] = (float)(sum / (2 * radius + 1));
        sum += (double)o->line[num_min(i + radius + 1, n - 1)] -
               (double)o->line[num_max(i - radius, 0)];
    }
}

static void average_weight(struct operation *o)
{
    const int radius = num_max(1, (int)((float)num_max(o->w, o->h) * SURROUNDINGS));
    for (int turn = 0; turn < 2; turn++) {
        for (int y = 0; y < o->h; y++)
            average_line(o, o->weight + (size_t)y * (size_t)o->w, o->w, 1, radius);
        for (int x = 0; x < o->w; x++)
            average_line(o, o->weight + x, o->h, (size_t)o->w, radius);
    }
}

/* The weights of one exposure at a time; the share that each has of a pixel sums to 1. */
static void find_fusion_gain(struct operation *o)
{
    const size_t area = (size_t)o->w * (size_t)o->h;
    memset(o->gain, 0, area * sizeof *o->gain);
    for (int k = 0; k < BRACKET; k++) {
        for (size_t i = 0; i < area; i++) {
            float well[BRACKET], sum = 0;
            for (int j = 0; j < BRACKET; j++) {
                const float off = (display_of(o->luma[i] * exp2f(stops_of[j])) - 0.5f) / WELL;
                sum += well[j] = expf(-0.5f * off * off);
            }
            o->weight[i] = well[k] / sum;
        }
        average_weight(o);
        for (size_t i = 0; i < area; i++)
            o->gain[i] += o->weight[i] * exp2f(stops_of[k]);
    }
}

err_t local_tone_run(struct arena *tmp, enum local_tone kind, int w, int h, float *exposure)
{
    struct operation o = {.kind = kind, .w = w, .h = h};
    const size_t area = (size_t)w * (size_t)h, mark = arena_mark(tmp);
    if (kind == LOCAL_TONE_NONE)
        return OK;
    size_grid(&o);
    err_t e = layout(&o, tmp);
    for (size_t i = 0; i < 3 * area && !e; i++)
        exposure[i] = fminf(fmaxf(exposure[i], 0), 1); // what is saturated is white
    for (size_t i = 0; i < area && !e; i++)
        o.luma[i] = 0.2126f * exposure[i] + 0.7152f * exposure[area + i] +
                    0.0722f * exposure[2 * area + i]; // ITU-R BT.709
    if (!e && kind == LOCAL_TONE_BASE)
        find_base_gain(&o);
    if (!e && kind == LOCAL_TONE_CLAHE)
        find_clahe_gain(&o);
    if (!e && kind == LOCAL_TONE_FUSION)
        find_fusion_gain(&o);
    for (size_t i = 0; i < 3 * area && !e; i++)
        exposure[i] *= o.gain[i % area];
    arena_reset(tmp, mark);
    return e;
}
