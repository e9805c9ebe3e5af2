#include "core/photo/ghost_shrink.h"

#include <stddef.h>

/* Mean of k x k pixels from p on, `step` apart, in rows of `row` numbers; or the largest. */
static uint16_t mean_of(const uint16_t *p, size_t step, size_t row, int k, int clip)
{
    uint32_t sum = 0;
    int most = 0;
    for (int i = 0; i < k * k; i++) {
        const int v = p[(size_t)(i / k) * row + (size_t)(i % k) * step];
        sum += (uint32_t)v;
        most = v > most ? v : most;
    }
    return (uint16_t)(most >= clip ? most : (int)(sum / (uint32_t)(k * k)));
}

void ghost_shrink_frame(struct raw *r, int k)
{
    const bool mosaic = r->cfa != RAW_MONO && r->cfa != RAW_RGB;
    const int s = mosaic ? 2 : 1, clip = raw_clip(r), w = r->w / (s * k) * s;
    const int h = r->h / (s * k) * s;
    const size_t colours = r->cfa == RAW_RGB ? 3 : 1, row = colours * (size_t)r->w;
    uint16_t *to = r->px; // never ahead of what is read
    if (k == 1)
        return;
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++)
            for (size_t c = 0; c < colours; c++) {
                const size_t u = (size_t)(x / s * k * s + x % s);
                const size_t v = (size_t)(y / s * k * s + y % s);
                *to++ = mean_of(r->px + v * row + colours * u + c, colours * (size_t)s,
                                row * (size_t)s, k, clip);
            }
    r->w = w;
    r->h = h;
}

void ghost_shrink_undo(struct ghost_mask *m, int k)
{
    m->cell *= k;
    m->shift[0] *= (float)k;
    m->shift[1] *= (float)k;
}
