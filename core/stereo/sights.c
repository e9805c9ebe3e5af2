#include "core/stereo/sights.h"

#include "core/photo/shade.h"

#include <math.h>

enum { SAMPLES = 4 }; // pixels per axis that are read

static const float LN2 = 0.69314718f;
static const float ALIKE = 0.7f; // of ln radiance, two views of one surface

void sights_set(struct sights *s, const struct views *v, const struct depthmaps *d,
                const struct tonemap *tone)
{
    s->views = v;
    s->depth = d;
    response_tabulate(tone, &s->table);
}

static const uint8_t *pixel_at(const struct sights *s, int view, int x, int y)
{
    const struct views *v = s->views;
    return views_rgb(v, view) + 3 * ((size_t)y * (size_t)v->extent[view].w + (size_t)x);
}

/* Range of picture pixels under [at - side / 2, at + side / 2] of the map: first, step and count.
 * size: px of the picture on this axis. */
static void sample_range(const struct sights *s, float at, float side, int size, int *range)
{
    const int scale = s->depth->scale;
    int n = (int)(side * (float)scale + 0.5f);
    n = n < 1 ? 1 : n;
    range[1] = (n + SAMPLES - 1) / SAMPLES;
    range[2] = n / range[1];
    int first = (int)floorf(at * (float)scale - 0.5f * (float)n + 0.5f) + range[1] / 2;
    int last = size - 1 - (range[2] - 1) * range[1];
    range[0] = first < 0 || last < 0 ? 0 : first > last ? last : first;
}

/* r^2 at a pixel of the map. */
static float shade_of(const struct sights *s, int view, const float *at)
{
    const struct extent *map = &s->depth->extent[view];
    return shade_r2(&s->views->shade[view], at[0] / (float)map->w, at[1] / (float)map->h);
}

struct sight sights_look(const struct sights *s, int view, const float *at, float side, bool alike)
{
    int rx[3], ry[3];
    sample_range(s, at[0], side, s->views->extent[view].w, rx);
    sample_range(s, at[1], side, s->views->extent[view].h, ry);
    float value[3] = {0}, weight[3] = {0};
    for (int i = 0; i < rx[2] * ry[2]; i++) {
        const int x = rx[0] + i % rx[2] * rx[1], y = ry[0] + i / rx[2] * ry[1];
        const uint8_t *p = pixel_at(s, view, x, y);
        if (views_hides_any(s->views, view, x, y, 1))
            continue;
        for (int c = 0; c < 3; c++) {
            float w = alike ? 1 : s->table.weight[c][p[c]] + 1e-4f;
            value[c] += w * s->table.linear[c][p[c]];
            weight[c] += w;
        }
    }
    const struct views *v = s->views;
    const float shift = v->log2t[view] - v->mid_log2t;
    float stops[3] = {0};
    if (v->shade)
        shade_stops(&v->shade[view].model, shade_of(s, view, at), stops);
    struct sight o;
    for (int c = 0; c < 3; c++) {
        const float mean = weight[c] > 0 ? value[c] / weight[c] : 0;
        const float x = log2f(mean + 1e-9f), dim = shift + stops[c];
        float range[2];
        o.weight[c] = weight[c] / (float)(rx[2] * ry[2]);
        response_bounds(&s->table, c, x, o.weight[c], range);
        o.ln[c] = (x - dim) * LN2;
        o.least[c] = (range[0] - dim) * LN2;
        o.most[c] = (range[1] - dim) * LN2;
    }
    return o;
}

bool sights_agree(const struct sight *a, const struct sight *b)
{
    for (int c = 0; c < 3; c++) {
        const bool blind = a->least[c] < a->most[c] || b->least[c] < b->most[c];
        if (blind && (a->least[c] > b->most[c] + ALIKE || b->least[c] > a->most[c] + ALIKE))
            return false;
    }
    return true;
}

void sights_add(const struct sight *o, float factor, float (*sum)[2])
{
    for (int c = 0; c < 3; c++) {
        sum[c][0] += factor * o->weight[c] * o->ln[c];
        sum[c][1] += factor * o->weight[c];
    }
}

float sights_contrast(const struct sights *s, int view, const float *at, float side)
{
    const int scale = s->depth->scale, n = (int)(side * (float)scale);
    const int x0 = (int)((at[0] - 0.5f * side) * (float)scale),
              y0 = (int)((at[1] - 0.5f * side) * (float)scale);
    float top = 0.0f;
    for (int c = 0; c < 3; c++) {
        float sum = 0.0f, square = 0.0f;
        int shown = 0;
        for (int i = 0; i < n * n; i++) {
            const int x = x0 + i % n, y = y0 + i / n;
            float z = (float)pixel_at(s, view, x, y)[c] / 255.0f;
            if (views_hides_any(s->views, view, x, y, 1))
                continue;
            shown++;
            sum += z;
            square += z * z;
        }
        shown = shown > 0 ? shown : 1;
        float mean = sum / (float)shown, var = square / (float)shown - mean * mean;
        float rel = sqrtf(var > 0.0f ? var : 0.0f) / (mean + 0.1f);
        top = rel > top ? rel : top;
    }
    return top;
}

float sights_reliability(const struct sights *s, int view, int x, int y)
{
    return s->table.weight[1][pixel_at(s, view, x, y)[1]];
}
