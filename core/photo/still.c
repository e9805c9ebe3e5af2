#include "core/photo/still.h"

#include "core/base/num.h"

#include <math.h>

enum { SQUARE = 32, LOW = 8, HIGH = 247, LEAST = 6, CODES = 256, CODE_LEAST = 16 };

static const double MOVED = 0.2;    // px
static const double TEXTURE = 1;    // square of codes per px, along the flatter direction
static const double UNLIKE = 0.25;  // share of the variance of a square that may be left,
static const double ROUNDING = 2;   // beside this much of noise, codes squared
static const double SAME = 0.6;     // share of the squares with texture
static const double COVERED = 0.25; // share of a square that must be usable

/* Two photographs, compared in codes of b, the darker: raised to those of a, so would its noise be.
 * like: value of b for each of a, below 0 where hardly any pixel has it. */
struct pair {
    const struct image8 *a, *b;
    float like[CODES];
};

/* Sums over the pixels of a square: gradient (x, y), difference, b. */
struct sums {
    double n, x, y, r, b, xx, xy, yy, xr, yr, rr, bb;
};

static int shrink_by(int w, int h)
{
    return (num_max(w, h) + STILL_EDGE - 1) / STILL_EDGE;
}

struct image8 still_size(int w, int h)
{
    const int k = shrink_by(w, h);
    return (struct image8){.w = w / k, .h = h / k, .channels = 1};
}

static uint8_t mean_green(const struct image8 *photo, int x0, int y0, int k)
{
    uint32_t sum = 0;
    for (int y = y0; y < y0 + k; y++)
        for (int x = x0; x < x0 + k; x++)
            sum += photo->px[3 * ((size_t)y * (size_t)photo->w + (size_t)x) + 1];
    return (uint8_t)((sum + (uint32_t)(k * k) / 2) / (uint32_t)(k * k));
}

void still_shrink(const struct image8 *photo, struct image8 *out)
{
    const int k = shrink_by(photo->w, photo->h);
    for (int y = 0; y < out->h; y++)
        for (int x = 0; x < out->w; x++)
            out->px[(size_t)y * (size_t)out->w + (size_t)x] = mean_green(photo, k * x, k * y, k);
}

static bool is_clipped(uint8_t v)
{
    return v < LOW || v > HIGH;
}

static void compare_codes(struct pair *p)
{
    uint32_t n[CODES] = {0};
    uint64_t sum[CODES] = {0};
    const size_t pixels = (size_t)p->a->w * (size_t)p->a->h;
    for (size_t i = 0; i < pixels; i++) {
        if (is_clipped(p->a->px[i]) || is_clipped(p->b->px[i]))
            continue;
        n[p->a->px[i]]++;
        sum[p->a->px[i]] += p->b->px[i];
    }
    for (int v = 0; v < CODES; v++)
        p->like[v] = n[v] < CODE_LEAST ? -1 : (float)sum[v] / (float)n[v];
}

/* Of both where they are alike; false where one is clipped. */
static bool value_at(const struct pair *p, size_t i, double *out)
{
    const uint8_t a = p->a->px[i], b = p->b->px[i];
    *out = 0.5 * ((double)p->like[a] + b);
    return !is_clipped(a) && !is_clipped(b) && p->like[a] >= 0;
}

static void add_pixel(const struct pair *p, size_t i, struct sums *s)
{
    const size_t w = (size_t)p->a->w;
    double here, left, right, up, down;
    if (!value_at(p, i, &here) || !value_at(p, i - 1, &left) || !value_at(p, i + 1, &right) ||
        !value_at(p, i - w, &up) || !value_at(p, i + w, &down))
        return;
    const double x = 0.5 * (right - left), y = 0.5 * (down - up), b = p->b->px[i];
    const double r = b - (double)p->like[p->a->px[i]];
    s->n++;
    s->x += x;
    s->y += y;
    s->r += r;
    s->b += b;
    s->xx += x * x;
    s->xy += x * y;
    s->yy += y * y;
    s->xr += x * r;
    s->yr += y * r;
    s->rr += r * r;
    s->bb += b * b;
}

/* Whether a square has texture, and whether it stayed. */
static bool judge_square(const struct sums *s, bool *stayed)
{
    if (s->n < COVERED * SQUARE * SQUARE)
        return false;
    const double xx = s->xx - s->x * s->x / s->n, yy = s->yy - s->y * s->y / s->n;
    const double xy = s->xy - s->x * s->y / s->n, det = xx * yy - xy * xy;
    const double flat = 0.5 * (xx + yy) - hypot(0.5 * (xx - yy), xy);
    if (flat < TEXTURE * s->n)
        return false;
    const double xr = s->xr - s->x * s->r / s->n, yr = s->yr - s->y * s->r / s->n;
    const double dx = (yy * xr - xy * yr) / det, dy = (xx * yr - xy * xr) / det;
    const double left = s->rr - s->r * s->r / s->n - dx * xr - dy * yr;
    const double all = s->bb - s->b * s->b / s->n;
    *stayed = hypot(dx, dy) < MOVED && left < UNLIKE * all + ROUNDING * s->n;
    return true;
}

static bool is_darker(const struct image8 *a, const struct image8 *b)
{
    int64_t sum = 0;
    for (size_t i = 0; i < (size_t)a->w * (size_t)a->h; i++)
        sum += a->px[i] - b->px[i];
    return sum < 0;
}

bool still_same(const struct image8 *a, const struct image8 *b)
{
    const bool darker = is_darker(a, b);
    struct pair p = {.a = darker ? b : a, .b = darker ? a : b};
    int textured = 0, same = 0;
    compare_codes(&p);
    for (int y0 = 1; y0 + SQUARE < a->h; y0 += SQUARE)
        for (int x0 = 1; x0 + SQUARE < a->w; x0 += SQUARE) {
            struct sums s = {0};
            bool stayed = false;
            for (int i = 0; i < SQUARE * SQUARE; i++)
                add_pixel(&p, (size_t)(y0 + i / SQUARE) * (size_t)a->w + (size_t)(x0 + i % SQUARE),
                          &s);
            textured += judge_square(&s, &stayed);
            same += stayed;
        }
    return textured >= LEAST && same >= SAME * textured;
}
