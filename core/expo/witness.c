/* A place is a block of up to BLOCK x BLOCK px, centred in a cell of an even grid; only these are
 * touched. Per colour the block's codes become relative exposure (display values by a table, linear
 * ones less black) and are averaged; the strongest of red, green and blue counts. Of a mosaic only
 * sites of one colour are averaged, green over both of its kinds.
 * CLIPPED if any pixel of any colour is above the limit of raw_clip: a pixel that clips in one
 * colour says nothing safe by the others once a device has mixed them.
 * Display values that are noise, cut off at black, are DARK whatever code they have: curves like
 * logarithms show single electrons well above code 8.
 * The error of a mean has three parts: noise, from differences of neighbours of one colour (texture
 * makes it larger, never smaller), steps of codes, which do not average out where it is flat, and,
 * of linear numbers, a black level that is wrong by half a code.
 * A ratio is the median of log2 x_b / x_a over places good in both, 4.5 of the capture notes. A
 * place that is dark or clipped in one bounds it from one side; of the bounds sorted, the one with
 * 2 % of all places beyond it is taken. */
#include "core/expo/witness.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { BLOCK = 8, WRONG = WITNESS_PLACES / 50 };

#define LOG2E 1.44269504f
#define DARK_DISPLAY 8    // codes: capture notes 4.2
#define ABOVE_BLACK 4.0f  // of the exposure of code 1: curves recovered from noise end too high
#define DARK_LINEAR 8     // codes above black
#define STEP_DISPLAY 0.5f // rms error of a block in codes: rounding, and DCT steps of JPEG
#define STEP_LINEAR 0.29f // rounding
#define BLACK_ERROR 0.5f  // codes
#define LEAST 1e-9f       // relative exposure: logarithms are finite
#define SD_MAX 0.15f      // stops: noisier places are dark
#define FAINT 0x1p-7f     // relative exposure: below, a display's noise may be cut off at black,
#define STAND_OUT 4.0f    // and looks like light unless a pixel is so many times above it

struct scale {
    const struct raw *px;
    int clip;            // first code that counts as clipped
    float unit;          // relative exposure of a code of linear numbers
    float table[3][256]; // of display values
    float dark[3];       // relative exposure below which it is dark
};

/* Sums over one colour of a block. */
struct sum {
    int n, pairs, clipped;
    float x, diff2; // sum of exposures; of squared differences of neighbours
    int64_t codes;
};

struct mean {
    float x, sd, noise; // relative exposure; its error; noise of a pixel, linear
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

/* Edge of the blocks along a side of n px: no longer than a cell, even. */
static int edge_of(int n)
{
    int cell = n / WITNESS_EDGE / 2 * 2;
    return num_min(n, cell < 2 ? 2 : num_min(cell, BLOCK));
}

/* Sums of a block per colour, which begins at an even site of a mosaic. */
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
    float n = (float)m->n, step = STEP_LINEAR * s->unit, black = BLACK_ERROR * s->unit;
    if (!s->px->linear) {
        int code = num_min((int)(m->codes / m->n), 254), below = code > 0 ? code - 1 : 0;
        step = STEP_DISPLAY * 0.5f * (s->table[colour][code + 1] - s->table[colour][below]);
        black = 0.0f;
    }
    float noise2 = m->pairs > 0 ? 0.5f * m->diff2 / (float)m->pairs : 0.0f;
    return (struct mean){m->x / n, sqrtf(noise2 / n + step * step + black * black), sqrtf(noise2)};
}

static enum witness_state judge(const struct scale *s, int y0, int x0, float *x, float *sd)
{
    struct sum sums[3] = {{0}};
    struct mean best = {-INFINITY, 0.0f, 0.0f};
    bool clipped = false;
    int colour = 1;
    add_block(s, y0, x0, sums);
    for (int c = 0; c < 3; c++) {
        if (sums[c].n == 0)
            continue;
        struct mean m = mean_of(s, c, &sums[c]);
        clipped |= sums[c].clipped > 0;
        colour = m.x > best.x ? c : colour;
        best = m.x > best.x ? m : best;
    }
    *x = fmaxf(best.x, LEAST);
    *sd = LOG2E * best.sd / *x;
    if (clipped)
        return WITNESS_CLIPPED;
    float noise = s->px->linear ? 0.0f : best.noise; // linear numbers have a black level
    bool drowned = best.x < FAINT && best.x < STAND_OUT * noise;
    if (best.x >= s->dark[colour] && *sd <= SD_MAX && !drowned)
        return WITNESS_GOOD;
    *x = fmaxf(fmaxf(best.x + 2.0f * best.sd + noise, s->dark[colour]), LEAST);
    *sd = 0.0f;
    return WITNESS_DARK;
}

/* First pixel of the block of cell i, of n pixels. */
static int begin_of(const struct raw *px, int i, int n)
{
    int edge = edge_of(n), at = (int)((2 * i + 1) * (int64_t)n / (2 * WITNESS_EDGE)) - edge / 2;
    at = at < 0 ? 0 : at;
    return px->cfa == RAW_MONO || px->cfa == RAW_RGB ? at : at & ~1;
}

void witness_take(const struct raw *px, const struct crf *crf, struct witness *out)
{
    struct scale s;
    int count[3] = {0};
    scale_init(px, crf, &s);
    for (int i = 0; i < WITNESS_PLACES; i++) {
        int y = begin_of(px, i / WITNESS_EDGE, px->h), x = begin_of(px, i % WITNESS_EDGE, px->w);
        out->state[i] = (uint8_t)judge(&s, y, x, &out->x[i], &out->sd[i]);
        count[out->state[i]]++;
    }
    out->good = count[WITNESS_GOOD];
    out->dark = count[WITNESS_DARK];
    out->clipped = count[WITNESS_CLIPPED];
}

/* ---- comparison ---- */

struct lists {
    int n, n_lo, n_hi;
    float ratio[WITNESS_PLACES], lo[WITNESS_PLACES], hi[WITNESS_PLACES];
};

static void add_place(const struct witness *a, const struct witness *b, int i, struct lists *to)
{
    int sa = a->state[i], sb = b->state[i];
    bool lo = sa != WITNESS_CLIPPED && sb != WITNESS_DARK;
    bool hi = sa != WITNESS_DARK && sb != WITNESS_CLIPPED;
    if (!lo && !hi)
        return; // most of a dark picture, so before the logarithm
    float r = log2f(b->x[i] / a->x[i]);
    if (lo && hi) {
        to->ratio[to->n++] = r;
        return;
    }
    float error = 2.0f * sqrtf(a->sd[i] * a->sd[i] + b->sd[i] * b->sd[i]);
    if (lo)
        to->lo[to->n_lo++] = r - error;
    else
        to->hi[to->n_hi++] = r + error;
}

/* What would be at place k of n numbers in order (Hoare's FIND); reorders them. */
static float ranked(float *v, int n, int k)
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

void witness_compare(const struct witness *a, const struct witness *b, struct witness_ratio *out)
{
    struct lists l;
    l.n = l.n_lo = l.n_hi = 0;
    for (int i = 0; i < WITNESS_PLACES; i++)
        add_place(a, b, i, &l);
    *out = (struct witness_ratio){.places = l.n, .lo = -INFINITY, .hi = INFINITY};
    if (l.n > 0) {
        int quarter = l.n / 4;
        out->log2 = ranked(l.ratio, l.n, l.n / 2);
        out->spread =
            0.5f * (ranked(l.ratio, l.n, l.n - 1 - quarter) - ranked(l.ratio, l.n, quarter));
    }
    if (l.n_lo > WRONG)
        out->lo = ranked(l.lo, l.n_lo, l.n_lo - 1 - WRONG);
    if (l.n_hi > WRONG)
        out->hi = ranked(l.hi, l.n_hi, WRONG);
}
