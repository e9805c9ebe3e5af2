/* The grey value is the mean over the channels of the logarithm of the display value with a toe:
 * a channel that saturates or is black no longer changes. The steps after it use only directions of
 * gradients and contrast relative to the surroundings, so that response and exposure hardly matter.
 *
 * Noise is the lower quartile of |Laplacian of Laplacians| by brightness (Immerkaer 1996). Corners
 * are maxima of the smaller eigenvalue of the structure tensor (Shi & Tomasi 1994) above
 * the noise, the strongest of each level first, spread by a count per cell of a grid. A
 * descriptor is that of SIFT (Lowe 2004) without rotation, on the corner's level and on the one
 * twice as coarse: gradients by direction in 4 x 4 cells, normalised, large parts cut,
 * normalised. It is made of the upright view and of the view turned by an eighth; the other six
 * eighths follow by a change of places, as cells and directions go over into each other in a
 * quarter turn. A surface that two views see from far apart is squeezed in one of them: where few
 * upright corners agree, descriptors are made of the view stretched in one of four directions and
 * squeezed across (after Morel & Yu, "ASIFT", 2009). */
#include "core/sfm/corner.h"

#include "core/base/num.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    TAPS = 3,       // of a Gauss kernel, to one side
    CELLS = 4,      // of a descriptor, across
    DIRECTIONS = 8, // directions
    HALF = CELLS * CELLS * DIRECTIONS,
    SPREAD = 12,          // cells of the grid that corners are spread over, across
    MARGIN = 6,           // px of a level without corners
    WARPED = 24,          // px, edge of the surroundings that are turned or stretched
    DESCRIPTOR_NORM = 256 // length of a descriptor
};

#define SMOOTH 0.9f       // px, Gauss of the finest level and before each halving of the area
#define WINDOW 1.5f       // px, Gauss of the structure tensor
#define TOE 0.03f         // display value, below which the logarithm is straight
#define NOISE_FLOOR 8e-4f // 0.2 of 255: rounding, averaged over the channels
#define CELL 4.0f         // px, a cell of a descriptor
#define SNR 6.0f          // least ratio of the eigenvalue to the part that noise adds
#define COARSE 0.7f       // length of the coarse half of a descriptor, in that of the fine one
#define CUT 0.2f          // largest part of a descriptor (Lowe 2004, 6.1)
#define TILT 2.0f         // stretch in one direction over that across

int corner_cap(int size)
{
    int n = size * 14 / 5;
    return n < CORNER_MAX ? n : CORNER_MAX;
}

/* ---- memory ---- */

static int level_size(int size, int level)
{
    return (int)lround(size / exp2(0.5 * level));
}

/* Pixels of `from` per pixel of the level after it, on both axes. */
static float level_step(const struct corner_level *from, const struct corner_level *to)
{
    return from->w >= from->h ? (float)from->w / (float)to->w : (float)from->h / (float)to->h;
}

/* The longer edge is rounded, the shorter one cut, so that one step serves both. */
static void set_shape(struct corner_view *c, int i, int w, int h)
{
    struct corner_level *l = c->level + i, *from = l - 1;
    const int size = num_max(w, h), edge = level_size(size, i);
    l->w = l->h = edge;
    l->scale = (float)size / (float)edge;
    if (i == 0) {
        l->w = w;
        l->h = h;
    } else if (from->w > from->h)
        l->h = num_max(2, (int)((float)from->h / level_step(from, l)));
    else if (from->w < from->h)
        l->w = num_max(2, (int)((float)from->w / level_step(from, l)));
}

err_t corner_alloc(struct arena *keep, int w, int h, struct corner_view *out)
{
    size_t cap = (size_t)corner_cap(num_max(w, h));
    memset(out, 0, sizeof *out);
    err_t e = arena_alloc(keep, cap, sizeof *out->at, &out->at);
    for (int i = 0; i < CORNER_WARPS && !e; i++) {
        e = arena_alloc(keep, cap, CORNER_DESCRIPTOR, &out->descriptor[i]);
        if (!e)
            e = arena_alloc(keep, cap, sizeof *out->square[i], &out->square[i]);
    }
    for (int i = 0; i < CORNER_LEVELS && !e; i++) {
        struct corner_level *l = out->level + i;
        set_shape(out, i, w, h);
        size_t px = (size_t)l->w * (size_t)l->h;
        e = arena_alloc(keep, px, sizeof *l->light, &l->light);
        if (!e)
            e = arena_alloc(keep, px, sizeof *l->weight, &l->weight);
    }
    return e;
}

size_t corner_scratch(size_t pixels)
{
    return 5 * pixels;
}

/* ---- pyramid ---- */

static void gauss_taps(float sigma, float tap[TAPS + 1])
{
    float sum = 0;
    for (int i = 0; i <= TAPS; i++) {
        tap[i] = expf(-0.5f * (float)(i * i) / (sigma * sigma));
        sum += i ? 2 * tap[i] : tap[i];
    }
    for (int i = 0; i <= TAPS; i++)
        tap[i] /= sum;
}

static void smooth_row(const float *row, int n, const float tap[TAPS + 1], float *restrict to)
{
    for (int x = 0; x < n; x++) {
        to[x] = tap[0] * row[x];
        for (int i = 1; i <= TAPS; i++)
            to[x] += tap[i] * (row[x >= i ? x - i : 0] + row[x + i < n ? x + i : n - 1]);
    }
}

/* Gauss filter of a picture of the level's shape, in place; the border repeats. scratch: (h, w). */
static void smooth_picture(float *px, const struct corner_level *l, float sigma,
                           float *restrict scratch)
{
    float tap[TAPS + 1];
    size_t w = (size_t)l->w;
    gauss_taps(sigma, tap);
    for (int y = 0; y < l->h; y++) {
        float *restrict to = scratch + (size_t)y * w;
        const float *row = px + (size_t)y * w;
        for (size_t x = 0; x < w; x++)
            to[x] = tap[0] * row[x];
        for (int i = 1; i <= TAPS; i++) {
            const float *up = px + (size_t)(y >= i ? y - i : 0) * w;
            const float *down = px + (size_t)num_min(y + i, l->h - 1) * w;
            for (size_t x = 0; x < w; x++)
                to[x] += tap[i] * (up[x] + down[x]);
        }
    }
    for (int y = 0; y < l->h; y++)
        smooth_row(scratch + (size_t)y * w, l->w, tap, px + (size_t)y * w);
}

/* A picture of the shape of level `m` becomes one of the shape of level `n`. */
static void shrink_picture(const float *from, const struct corner_level *m, float *restrict to,
                           const struct corner_level *n)
{
    const float step = level_step(m, n);
    for (int y = 0; y < n->h; y++) {
        float v = fmaxf(((float)y + 0.5f) * step - 0.5f, 0.0f);
        int j = num_min((int)v, m->h - 2);
        float fv = v - (float)j;
        const float *a = from + (size_t)j * (size_t)m->w, *b = a + m->w;
        for (int x = 0; x < n->w; x++) {
            float u = fmaxf(((float)x + 0.5f) * step - 0.5f, 0.0f);
            int i = num_min((int)u, m->w - 2);
            float fu = u - (float)i;
            float top = a[i] + fu * (a[i + 1] - a[i]), low = b[i] + fu * (b[i + 1] - b[i]);
            to[(size_t)y * (size_t)n->w + (size_t)x] = top + fv * (low - top);
        }
    }
}

/* Reliability of a display value: 0 at both ends. */
static void trust_table(float trust[256])
{
    for (int z = 0; z < 256; z++) {
        float end = (float)(num_min(z - 1, 254 - z));
        trust[z] = fminf(fmaxf(end / 6.0f, 0.0f), 1.0f);
    }
}

static void make_grey(const uint8_t *rgb, const uint8_t *masked, struct corner_level *l)
{
    float trust[256], tone[256];
    trust_table(trust);
    for (int z = 0; z < 256; z++)
        tone[z] = logf((float)z / (255 * TOE) + 1) / logf(1 / TOE + 1);
    size_t px = (size_t)l->w * (size_t)l->h;
    for (size_t i = 0; i < px; i++, rgb += 3) {
        l->light[i] = (tone[rgb[0]] + tone[rgb[1]] + tone[rgb[2]]) / 3;
        l->weight[i] = fmaxf(fmaxf(trust[rgb[0]], trust[rgb[1]]), trust[rgb[2]]);
        if (masked && masked[i])
            l->light[i] = l->weight[i] = 0;
    }
}

static void build_pyramid(struct corner_view *c, float *scratch)
{
    size_t px = (size_t)c->level[0].w * (size_t)c->level[0].h;
    for (int i = 0; i < CORNER_LEVELS; i++) {
        struct corner_level *l = c->level + i;
        if (!i) {
            smooth_picture(l->light, l, SMOOTH, scratch);
            smooth_picture(l->weight, l, SMOOTH, scratch);
            continue;
        }
        const struct corner_level *from = l - 1;
        size_t n = (size_t)from->w * (size_t)from->h;
        for (int k = 0; k < 2; k++) {
            memcpy(scratch, k ? from->weight : from->light, n * sizeof *scratch);
            smooth_picture(scratch, from, SMOOTH, scratch + px);
            shrink_picture(scratch, from, k ? l->weight : l->light, l);
        }
    }
}

/* ---- noise ---- */

static int bin_of(float light)
{
    int i = (int)(light * CORNER_BINS);
    return i < 0 ? 0 : num_min(i, CORNER_BINS - 1);
}

/* Lower quartile from a histogram of |response| with steps of 1/4 of a display step. */
static float histogram_quartile(const int *hist, int bins, int total)
{
    int sum = 0;
    for (int i = 0; i < bins; i++) {
        if (4 * (sum + hist[i]) >= total) {
            float inside = hist[i] ? (0.25f * (float)total - (float)sum) / (float)hist[i] : 0.0f;
            return ((float)i + inside) / (4 * 255.0f);
        }
        sum += hist[i];
    }
    return (float)bins / (4 * 255.0f);
}

/* Call before smoothing. Bins with few pixels get the noise of all. */
static void measure_noise(const struct corner_level *l, float noise[CORNER_BINS])
{
    enum { STEPS = 512, FEW = 200 };
    int hist[CORNER_BINS + 1][STEPS], n[CORNER_BINS + 1] = {0};
    memset(hist, 0, sizeof hist);
    size_t w = (size_t)l->w, h = (size_t)l->h;
    for (size_t y = 1; y + 1 < h; y++) {
        for (size_t x = 1; x + 1 < w; x++) {
            const float *p = l->light + y * w + x, *a = p - w, *b = p + w;
            if (l->weight[y * w + x] < 1)
                continue;
            float r = 4 * p[0] - 2 * (p[-1] + p[1] + a[0] + b[0]) + a[-1] + a[1] + b[-1] + b[1];
            int k = num_min((int)(fabsf(r) * 4 * 255.0f), STEPS - 1), bin = bin_of(*p);
            hist[bin][k]++;
            hist[CORNER_BINS][k]++;
            n[bin]++;
            n[CORNER_BINS]++;
        }
    }
    for (int i = 0; i < CORNER_BINS; i++) {
        int from = n[i] < FEW ? CORNER_BINS : i;
        float q = n[from] ? histogram_quartile(hist[from], STEPS, n[from]) : 0;
        noise[i] = fmaxf(q / (6 * 0.3186f), NOISE_FLOOR); // P(|x| < 0.3186 sigma) = 1/4
    }
}

/* Variance that noise adds to a derivative on a level, where light is `light`. */
static float noise_variance(const struct corner_view *c, int level, float light)
{
    float sigma = c->noise[bin_of(light)], scale = c->level[level].scale;
    return sigma * sigma / (25.1f * scale * scale); // 8 pi, for a Gauss of 1 px
}

/* ---- corners ---- */

struct peak {
    float strength;
    int at; // pixel
};

static int by_strength(const void *a, const void *b)
{
    const struct peak *p = a, *q = b;
    if (p->strength != q->strength)
        return p->strength > q->strength ? -1 : 1;
    return p->at < q->at ? -1 : p->at > q->at;
}

/* Smaller eigenvalue of the structure tensor at each pixel of level i. scratch: 4 (h, w), the first
 * of which is the result. */
static void eigenvalues(const struct corner_view *c, int i, float *scratch)
{
    const struct corner_level *l = c->level + i;
    size_t w = (size_t)l->w, h = (size_t)l->h, px = w * h;
    float *xx = scratch, *xy = scratch + px, *yy = scratch + 2 * px;
    memset(scratch, 0, 3 * px * sizeof *scratch);
    for (size_t y = 1; y + 1 < h; y++) {
        for (size_t k = y * w + 1; k + 1 < (y + 1) * w; k++) {
            float gx = 0.5f * (l->light[k + 1] - l->light[k - 1]);
            float gy = 0.5f * (l->light[k + w] - l->light[k - w]);
            float trust = l->weight[k] * l->weight[k];
            xx[k] = trust * gx * gx;
            xy[k] = trust * gx * gy;
            yy[k] = trust * gy * gy;
        }
    }
    for (int k = 0; k < 3; k++)
        smooth_picture(scratch + (size_t)k * px, l, WINDOW, scratch + 3 * px);
    for (size_t k = 0; k < px; k++) {
        float half = 0.5f * (xx[k] + yy[k]), d = 0.5f * (xx[k] - yy[k]);
        xx[k] = half - sqrtf(d * d + xy[k] * xy[k]);
    }
}

/* Whether pixel k is the largest of its 5 x 5 neighbourhood; the first of equal ones. */
static bool is_peak(const float *px, size_t w, size_t k)
{
    for (size_t dy = 0; dy < 5; dy++) {
        for (size_t dx = 0; dx < 5; dx++) {
            size_t j = k + dy * w + dx - 2 * w - 2;
            if (px[j] > px[k] || (px[j] == px[k] && j < k))
                return false;
        }
    }
    return true;
}

static int find_peaks(const struct corner_view *c, int i, const float *px, struct peak *out)
{
    const struct corner_level *l = c->level + i;
    size_t w = (size_t)l->w, h = (size_t)l->h;
    int n = 0;
    for (size_t y = MARGIN; y + MARGIN < h; y++) {
        for (size_t x = MARGIN; x + MARGIN < w; x++) {
            size_t k = y * w + x;
            if (px[k] > SNR * noise_variance(c, i, l->light[k]) && is_peak(px, w, k))
                out[n++] = (struct peak){px[k], (int)k};
        }
    }
    qsort(out, (size_t)n, sizeof *out, by_strength);
    return n;
}

/* Offset of the maximum of a parabola through three values. */
static float parabola_vertex(float a, float b, float c)
{
    float bend = a - 2 * b + c;
    return bend < 0 ? fminf(fmaxf(0.5f * (a - c) / bend, -0.5f), 0.5f) : 0.0f;
}

static void add_corner(struct corner_view *c, int i, const float *px, int at)
{
    const struct corner_level *l = c->level + i;
    const float *p = px + at;
    float x = (float)(at % l->w) + parabola_vertex(p[-1], p[0], p[1]);
    float y = (float)(at / l->w) + parabola_vertex(p[-l->w], p[0], p[l->w]);
    c->at[c->n++] = (struct corner){.u = (x + 0.5f) * l->scale,
                                    .v = (y + 0.5f) * l->scale,
                                    .strength = *p / noise_variance(c, i, l->light[at]),
                                    .level = i};
}

/* The strongest `want` corners of level i, at first at most `crowd` in a cell, then three times as
 * many. */
static void find_corners(struct corner_view *c, int i, int want, float *scratch)
{
    const struct corner_level *l = c->level + i;
    int count[SPREAD * SPREAD] = {0}, left = want;
    int crowd = (3 * want / 2 + SPREAD * SPREAD - 1) / (SPREAD * SPREAD);
    eigenvalues(c, i, scratch);
    struct peak *peak = (struct peak *)(scratch + (size_t)l->w * (size_t)l->h);
    int n = find_peaks(c, i, scratch, peak);
    for (int turn = 0; turn < 2; turn++, crowd *= 3) {
        for (int k = 0; k < n && left > 0; k++) {
            if (peak[k].at < 0)
                continue;
            int x = peak[k].at % l->w * SPREAD / l->w;
            int y = peak[k].at / l->w * SPREAD / l->h;
            if (count[y * SPREAD + x] >= crowd)
                continue;
            count[y * SPREAD + x]++;
            add_corner(c, i, scratch, peak[k].at);
            peak[k].at = -1;
            left--;
        }
    }
}

/* ---- descriptors ---- */

/* Direction of a gradient in parts of DIRECTIONS to a full turn, 0 <= result <= DIRECTIONS, within
 * 0.01. */
static float gradient_direction(float gx, float gy)
{
    float ax = fabsf(gx), ay = fabsf(gy), top = ax > ay ? ax : ay, low = ax > ay ? ay : ax;
    float r = low / (top + 1e-20f);
    float turn = r * (1.345f - 0.345f * r) * (DIRECTIONS / 8.0f); // atan(r) within 0.004
    turn = ay > ax ? DIRECTIONS / 4.0f - turn : turn;
    turn = gx < 0 ? DIRECTIONS / 2.0f - turn : turn;
    return gy < 0 ? DIRECTIONS - turn : turn;
}

/* Contribution of one row or column of pixels: a cell, its share in the next one, its weight. */
struct lane {
    int px, cell; // cell 0 is outside, and so is CELLS + 1
    float next, weight;
};

enum { LANES_MAX = 32 };

/* Pixels within reach of `centre` in 1 .. n - 2; returns their number. */
static int make_lanes(float centre, float cell, int n, struct lane out[LANES_MAX])
{
    float reach = 0.5f * (CELLS + 1) * cell;
    int count = 0, first = (int)ceilf(centre - reach);
    for (int i = first > 1 ? first : 1; i <= n - 2 && (float)i < centre + reach; i++) {
        float d = ((float)i - centre) / cell, at = d + 0.5f * (CELLS + 1);
        out[count++] = (struct lane){i, (int)at, at - (float)(int)at, expf(-0.125f * d * d)};
    }
    return count;
}

static void add_vote(float *cell, float part, int turn, float beyond)
{
    cell[turn] += part * (1 - beyond);
    cell[turn + 1] += part * beyond;
}

/* The descriptor's half on one level: hist (CELLS, CELLS, DIRECTIONS). */
static void build_half(const struct corner_level *l, float u, float v, float *hist)
{
    enum { DEPTH = DIRECTIONS + 2, WIDTH = (CELLS + 2) * DEPTH };
    float sum[(CELLS + 2) * WIDTH] = {0};
    struct lane column[LANES_MAX], row[LANES_MAX];
    const int n = l->w, columns = make_lanes(u / l->scale - 0.5f, CELL, n, column);
    const int rows = make_lanes(v / l->scale - 0.5f, CELL, l->h, row);
    for (int j = 0; j < rows; j++) {
        const struct lane *y = row + j;
        for (int i = 0; i < columns; i++) {
            const struct lane *x = column + i;
            size_t at = (size_t)y->px * (size_t)n + (size_t)x->px;
            const float *p = l->light + at;
            float gx = p[1] - p[-1], gy = p[n] - p[-n], turn = gradient_direction(gx, gy);
            float size = sqrtf(gx * gx + gy * gy) * l->weight[at] * x->weight * y->weight;
            int t = (int)turn;
            float *to = sum + y->cell * WIDTH + x->cell * DEPTH, beyond = turn - (float)t;
            add_vote(to, size * (1 - x->next) * (1 - y->next), t, beyond);
            add_vote(to + DEPTH, size * x->next * (1 - y->next), t, beyond);
            add_vote(to + WIDTH, size * (1 - x->next) * y->next, t, beyond);
            add_vote(to + WIDTH + DEPTH, size * x->next * y->next, t, beyond);
        }
    }
    for (int k = 0; k < CELLS * CELLS; k++) {
        const float *from = sum + (k / CELLS + 1) * WIDTH + (k % CELLS + 1) * DEPTH;
        memcpy(hist + k * DIRECTIONS, from, DIRECTIONS * sizeof *hist);
        hist[k * DIRECTIONS] += from[DIRECTIONS]; // a full turn is direction 0
        hist[k * DIRECTIONS + 1] += from[DIRECTIONS + 1];
    }
}

static void scale_to_length(float *x, int n, float length)
{
    float sum = 1e-12f;
    for (int i = 0; i < n; i++)
        sum += x[i] * x[i];
    for (int i = 0; i < n; i++)
        x[i] *= length / sqrtf(sum);
}

/* Pixels of a level per pixel of what is cut out of it, row by row. */
static void warp_matrix(int warp, float m[4])
{
    const double angle = (warp - 2) * NUM_PI / CORNER_TILTS;
    const float c = sqrtf(0.5f), x = (float)cos(angle), y = (float)sin(angle), a = sqrtf(TILT);
    const float eighth[4] = {c, c, -c, c};
    const float tilt[4] = {a * x * x + y * y / a, (a - 1 / a) * x * y, (a - 1 / a) * x * y,
                           a * y * y + x * x / a};
    memcpy(m, warp == 1 ? eighth : tilt, 4 * sizeof *m);
}

/* The surroundings of a point of a view, turned or stretched. */
struct warped {
    struct corner_level level;
    float light[WARPED * WARPED], weight[WARPED * WARPED];
};

static void cut_warped(const struct corner_level *l, const struct corner *c, const float m[4],
                       struct warped *out)
{
    const float x = c->u / l->scale - 0.5f, y = c->v / l->scale - 0.5f;
    out->level = (struct corner_level){WARPED, WARPED, 1, out->light, out->weight};
    for (int k = 0; k < WARPED * WARPED; k++) {
        float dx = (float)(k % WARPED) - 0.5f * (WARPED - 1);
        float dy = (float)(k / WARPED) - 0.5f * (WARPED - 1);
        float s = x + m[0] * dx + m[1] * dy, t = y + m[2] * dx + m[3] * dy;
        bool inside = s >= 0 && t >= 0 && s < (float)(l->w - 1) && t < (float)(l->h - 1);
        int i = num_min((int)fmaxf(s, 0), l->w - 2), j = num_min((int)fmaxf(t, 0), l->h - 2);
        float fs = fminf(fmaxf(s - (float)i, 0), 1), ft = fminf(fmaxf(t - (float)j, 0), 1);
        size_t at = (size_t)j * (size_t)l->w + (size_t)i;
        const float *p = l->light + at, *q = p + l->w;
        float top = p[0] + fs * (p[1] - p[0]), low = q[0] + fs * (q[1] - q[0]);
        out->light[k] = top + ft * (low - top);
        out->weight[k] = inside ? l->weight[at] : 0;
    }
}

static void describe_corner(struct corner_view *c, int k, int warp)
{
    float hist[2 * HALF], m[4];
    int32_t square = 0;
    struct warped cut;
    const struct corner *at = c->at + k;
    int8_t *descriptor = c->descriptor[warp] + (size_t)k * CORNER_DESCRIPTOR;
    for (int s = 0; s < 2; s++) {
        const struct corner_level *l = c->level + at->level + 2 * s;
        float *part = hist + s * HALF;
        if (warp) {
            warp_matrix(warp, m);
            cut_warped(l, at, m, &cut);
            build_half(&cut.level, 0.5f * WARPED, 0.5f * WARPED, part);
        } else
            build_half(l, at->u, at->v, part);
        scale_to_length(part, HALF, 1);
        for (int i = 0; i < HALF; i++)
            part[i] = fminf(part[i], CUT);
        scale_to_length(part, HALF, s ? COARSE : 1.0f);
    }
    scale_to_length(hist, 2 * HALF, DESCRIPTOR_NORM);
    for (int i = 0; i < 2 * HALF; i++) {
        descriptor[i] = (int8_t)lrintf(fminf(hist[i], 127));
        square += descriptor[i] * descriptor[i];
    }
    c->square[warp][k] = square;
}

const int8_t *corner_turned(const struct corner_view *c, int k, int turn, int8_t *room,
                            int32_t *square)
{
    const int8_t *from = c->descriptor[turn & 1] + (size_t)k * CORNER_DESCRIPTOR;
    *square = c->square[turn & 1][k];
    if (turn < 2)
        return from;
    for (int i = 0; i < CORNER_DESCRIPTOR; i++) {
        int x = i / DIRECTIONS % CELLS, y = i / DIRECTIONS / CELLS % CELLS;
        for (int q = 0; q < turn / 2; q++) { // where a quarter turn takes the cell from
            int old = x;
            x = y;
            y = CELLS - 1 - old;
        }
        int direction = (i - turn / 2 * (DIRECTIONS / 4)) & (DIRECTIONS - 1);
        room[i] = from[i / HALF * HALF + (y * CELLS + x) * DIRECTIONS + direction];
    }
    return room;
}

/* ---- the whole ---- */

void corner_run(const uint8_t *rgb, const uint8_t *masked, float *scratch, struct corner_view *out)
{
    const int size = num_max(out->level[0].w, out->level[0].h);
    static const float share[CORNER_FOUND] = {0.40f, 0.27f, 0.19f, 0.14f};
    out->n = 0;
    make_grey(rgb, masked, out->level);
    measure_noise(out->level, out->noise);
    build_pyramid(out, scratch);
    for (int i = 0; i < CORNER_FOUND; i++)
        find_corners(out, i, (int)(share[i] * (float)corner_cap(size)), scratch);
    for (int k = 0; k < 2 * out->n; k++)
        describe_corner(out, k / 2, k % 2);
}

void corner_tilt(struct corner_view *c)
{
    for (int k = 0; k < c->n; k++)
        for (int i = 2; i < CORNER_WARPS; i++)
            describe_corner(c, k, i);
}
