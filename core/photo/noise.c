#include "core/photo/noise.h"

#include <math.h>
#include <stdlib.h>

enum { LEVELS = 16 * 256 }; // largest response of the mask, plus one

struct noise {
    const struct views *v;
    double *square; // (photographs) variance, display units
};

static double channel_deviation(const struct views *v, int i, int channel)
{
    const uint8_t *rgb = views_rgb(v, i);
    const struct extent *px = &v->extent[i];
    long count[LEVELS] = {0}, n = 0, below = 0;
    size_t row = (size_t)px->w * 3;
    for (int y = 1; y + 1 < px->h; y++)
        for (int x = 1; x + 1 < px->w; x++) {
            const uint8_t *p = rgb + (size_t)y * row + 3 * x + channel, *a = p - row, *b = p + row;
            if (p[0] < 3 || p[0] > 252 || views_hides_any(v, i, x - 1, y - 1, 3))
                continue;
            int sides = p[-3] + p[3] + a[0] + b[0], corners = a[-3] + a[3] + b[-3] + b[3];
            count[abs(4 * p[0] - 2 * sides + corners)]++;
            n++;
        }
    int median = 0;
    while (median < LEVELS - 1 && (below += count[median]) * 2 < n)
        median++;
    return median / (0.6745 * 6 * 255); // 0.6745: median of |x| of a unit normal
}

static err_t noise_view(void *ctx, int i, int worker)
{
    struct noise *j = ctx;
    (void)worker;
    j->square[i] = 0;
    for (int c = 0; c < 3; c++) {
        double d = channel_deviation(j->v, i, c);
        j->square[i] += d * d / 3;
    }
    return OK;
}

static err_t layout(struct noise *j, struct arena *tmp, const struct views *v)
{
    *j = (struct noise){.v = v};
    return arena_alloc(tmp, (size_t)(v->n + v->n_more), sizeof *j->square, &j->square);
}

size_t noise_plan(const struct views *v)
{
    struct arena tmp = arena_counter();
    struct noise j;
    return layout(&j, &tmp, v) ? SIZE_MAX : tmp.peak;
}

err_t noise_run(const struct run *r, const struct views *v, float *db)
{
    struct noise j;
    const int n = v->n + v->n_more;
    size_t mark = arena_mark(r->tmp);
    double sum = 0;
    err_t e = layout(&j, r->tmp, v);
    if (!e)
        e = pool_for(r->pool, n, noise_view, &j);
    for (int i = 0; i < n && !e; i++)
        sum += j.square[i] / n;
    arena_reset(r->tmp, mark);
    *db = e ? 0 : (float)(-10 * log10(fmax(sum, 1e-10)));
    return e;
}
