#include "core/refine/pyramid.h"

void pyramid_split(const uint8_t *rgb, size_t n, uint8_t *out)
{
    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < n; i++)
            out[c * n + i] = rgb[3 * i + c];
}

void pyramid_halve(const uint8_t *in, int w, int h, uint8_t *out)
{
    const size_t across = (size_t)w, m = across / 2, down = (size_t)h / 2;
    for (size_t c = 0; c < 3; c++, in += across * (size_t)h)
        for (size_t at = 0; at < m * down; at++) {
            const uint8_t *p = in + 2 * (at / m) * across + 2 * (at % m);
            *out++ = (uint8_t)((p[0] + p[1] + p[across] + p[across + 1] + 2) / 4);
        }
}

void pyramid_halve_deep(const uint16_t *in, int w, int h, uint16_t *out)
{
    const size_t across = (size_t)w, m = across / 2, down = (size_t)h / 2;
    for (size_t c = 0; c < 3; c++, in += across * (size_t)h)
        for (size_t at = 0; at < m * down; at++) {
            const uint16_t *p = in + 2 * (at / m) * across + 2 * (at % m);
            *out++ = (uint16_t)((p[0] + p[1] + p[across] + p[across + 1] + 2) / 4);
        }
}

void pyramid_halve_mask(const uint8_t *in, int w, int h, uint8_t *out)
{
    const size_t across = (size_t)w, m = across / 2, down = (size_t)h / 2;
    for (size_t at = 0; at < m * down; at++) {
        const uint8_t *p = in + 2 * (at / m) * across + 2 * (at % m);
        *out++ = p[0] | p[1] | p[across] | p[across + 1];
    }
}

/* ---- all photographs ---- */

err_t pyramid_layout(struct pyramid *p, struct arena *a)
{
    const size_t pixels = extent_total(p->v->extent, p->v->n + p->v->n_more);
    err_t e = OK;
    for (int k = 0; k < p->levels && !e; k++)
        e = p->v->deep ? arena_alloc(a, pixels >> 2 * k, 6, &p->deep[k])
                       : arena_alloc(a, pixels >> 2 * k, 3, &p->planes[k]);
    for (int k = 1; k < p->levels && !e && (p->v->masked || a->counts);
         k++) // a plan knows no masks
        e = arena_alloc(a, pixels >> 2 * k, 1, &p->masked[k]);
    return e;
}

static size_t planes_at(const struct pyramid *p, int i, int level)
{
    return 3 * (p->v->extent[i].at >> 2 * level);
}

const uint8_t *pyramid_planes(const struct pyramid *p, int i, int level)
{
    return p->v->deep ? NULL : p->planes[level] + planes_at(p, i, level);
}

const uint16_t *pyramid_deep(const struct pyramid *p, int i, int level)
{
    return p->v->deep ? p->deep[level] + planes_at(p, i, level) : NULL;
}

const uint8_t *pyramid_masked(const struct pyramid *p, int i, int level)
{
    if (level == 0 || !p->v->masked)
        return views_masked(p->v, i);
    return p->masked[level] + (p->v->extent[i].at >> 2 * level);
}

static void split_deep(const uint16_t *in, size_t n, uint16_t *out)
{
    for (size_t k = 0; k < 3 * n; k++)
        out[k % 3 * n + k / 3] = in[k];
}

static err_t fill_photo(void *ctx, int i, int worker)
{
    const struct pyramid *p = ctx;
    const struct extent *px = &p->v->extent[i];
    const size_t n = extent_pixels(px);
    (void)worker;
    if (p->v->deep)
        split_deep(views_rgb16(p->v, i), n, p->deep[0] + planes_at(p, i, 0));
    else
        pyramid_split(views_rgb(p->v, i), n, p->planes[0] + planes_at(p, i, 0));
    for (int k = 1; k < p->levels; k++) {
        const int w = px->w >> (k - 1), h = px->h >> (k - 1);
        const size_t to = planes_at(p, i, k);
        if (p->v->deep)
            pyramid_halve_deep(pyramid_deep(p, i, k - 1), w, h, p->deep[k] + to);
        else
            pyramid_halve(pyramid_planes(p, i, k - 1), w, h, p->planes[k] + to);
        if (p->v->masked)
            pyramid_halve_mask(pyramid_masked(p, i, k - 1), w, h, p->masked[k] + to / 3);
    }
    return OK;
}

err_t pyramid_run(struct pool *pool, struct pyramid *p)
{
    return pool_for(pool, p->v->n + p->v->n_more, fill_photo, p);
}
