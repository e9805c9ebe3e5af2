#include "core/stereo/guess.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum {
    BLOCK = 8,      // px of the map
    LEVELS_MAX = 9, // pyramid of the smooth depth
    BINS = 64       // histogram of inverse depth, from the farthest to the nearest usable surface
};

static const float FARTHEST =
    0.05f; // share of the usable pixels around a guess that may lie behind it
static const float AROUND = 0.3f; // least share of usable pixels in the blocks around

/* Blocks per axis of a map. */
static int blocks_across(int w)
{
    return (w + BLOCK - 1) / BLOCK;
}

/* Level of the pyramid of one view. */
struct level {
    int w, h;
    float *px; // (h, w, 2) sum of inverse depth times weight, sum of weights
};

/* Pixel of the next level that pixel i is part of. */
static int parent_of(const struct level *l, int i)
{
    return i / l->w / 2 * l[1].w + i % l->w / 2;
}

void guess_smooth(const struct guess_work *g, const struct depthmaps *d, int view, float *rho)
{
    const struct extent *map = &d->extent[view];
    struct level level[LEVELS_MAX] = {{map->w, map->h, g->levels}};
    int n = 1;
    for (int i = 0; i < map->w * map->h; i++) {
        float conf = d->conf[map->at + (size_t)i];
        float c = sweep_far(d, map->at + (size_t)i) ? 1e-8f : conf * conf + 1e-4f;
        level[0].px[2 * i] = c / d->depth[map->at + (size_t)i];
        level[0].px[2 * i + 1] = c;
    }
    for (; n < LEVELS_MAX && (level[n - 1].w > 1 || level[n - 1].h > 1); n++) {
        const struct level *fine = &level[n - 1];
        level[n] =
            (struct level){(fine->w + 1) / 2, (fine->h + 1) / 2, fine->px + 2 * fine->w * fine->h};
        memset(level[n].px, 0, 2 * (size_t)level[n].w * (size_t)level[n].h * sizeof(float));
        for (int i = 0; i < fine->w * fine->h; i++) {
            float *up = level[n].px + 2 * parent_of(fine, i);
            up[0] += fine->px[2 * i];
            up[1] += fine->px[2 * i + 1];
        }
    }
    for (n--; n > 0; n--) {
        const struct level *fine = &level[n - 1];
        for (int i = 0; i < fine->w * fine->h; i++) {
            const float *up = level[n].px + 2 * parent_of(fine, i);
            float pulled = up[0] / up[1], c = fine->px[2 * i + 1];
            float lack = c < 0.1f ? 0.1f - c : 0.0f;
            fine->px[2 * i] += lack * pulled;
            fine->px[2 * i + 1] += lack;
        }
    }
    for (int i = 0; i < map->w * map->h; i++)
        rho[i] = level[0].px[2 * i] / level[0].px[2 * i + 1];
}

void guess_shell(const struct depthmaps *d, int view, float *rho)
{
    const struct extent *map = &d->extent[view];
    for (size_t i = 0; i < extent_pixels(map); i++)
        if (sweep_far(d, map->at + i))
            rho[i] = 1.0f / d->depth[map->at + i];
}

/* Summed-area table of the usable pixels of a view over the blocks, per bin: bin k is around
 * range[0] + k range[1]. */
static void sum_sure(const struct guess_work *g, const struct depthmaps *d, int view,
                     const float *rho, const float range[2])
{
    const struct extent *map = &d->extent[view];
    const int w = map->w, n = blocks_across(w), down = blocks_across(map->h), row = (n + 1) * BINS;
    const float *conf = d->conf + map->at;
    memset(g->sum, 0, (size_t)row * (size_t)(down + 1) * sizeof *g->sum);
    for (int i = 0; i < w * map->h; i++) {
        float bin = range[1] > 0.0f ? (rho[i] - range[0]) / range[1] + 0.5f : 0.0f;
        int b = (int)fminf(fmaxf(bin, 0.0f), (float)(BINS - 1));
        if (conf[i] >= SWEEP_CONF_USABLE && !sweep_far(d, map->at + (size_t)i))
            g->sum[(i / w / BLOCK + 1) * row + (i % w / BLOCK + 1) * BINS + b]++;
    }
    for (int k = 0; k < n * down; k++) {
        uint32_t *here = g->sum + (k / n + 1) * row + (k % n + 1) * BINS, upto = 0;
        for (int b = 0; b < BINS; b++) {
            upto += here[b];
            here[b] = upto + here[b - BINS] + here[b - row] - here[b - row - BINS];
        }
    }
}

/* Bin of the farthest usable surfaces in the smallest square of blocks around block x, y that has
 * enough of them. */
static int farthest_bin(const struct guess_work *g, const struct extent *map, int x, int y)
{
    const int n = blocks_across(map->w), down = blocks_across(map->h), row = (n + 1) * BINS;
    for (int r = 1;; r *= 2) {
        int x0 = x < r ? 0 : x - r, x1 = x + r < n ? x + r + 1 : n;
        int y0 = y < r ? 0 : y - r, y1 = y + r < down ? y + r + 1 : down, b = 0;
        const uint32_t *low = g->sum + y0 * row, *high = g->sum + y1 * row;
        uint32_t count[BINS];
        for (int k = 0; k < BINS; k++)
            count[k] =
                high[x1 * BINS + k] - high[x0 * BINS + k] - low[x1 * BINS + k] + low[x0 * BINS + k];
        const float all = (float)count[BINS - 1];
        if (all < AROUND * (float)((x1 - x0) * (y1 - y0) * BLOCK * BLOCK) && (r < n || r < down))
            continue;
        while (b < BINS - 1 && (float)count[b] <= FARTHEST * all)
            b++;
        return b;
    }
}

/* g->levels is free by now. */
void guess_limit(const struct guess_work *g, const struct depthmaps *d, int view, float *rho)
{
    const struct extent *map = &d->extent[view];
    const int w = map->w, across = blocks_across(w);
    const float *conf = d->conf + map->at;
    size_t n = 0;
    for (int i = 0; i < w * map->h; i++) {
        if (conf[i] >= SWEEP_CONF_USABLE && !sweep_far(d, map->at + (size_t)i))
            g->levels[n++] = rho[i];
    }
    if (n == 0)
        return;
    const float lo = num_quantile(g->levels, n, 0.01f),
                hi = num_sorted_quantile(g->levels, n, 0.99f);
    const float step = (hi - lo) / (BINS - 1);
    sum_sure(g, d, view, rho, (const float[2]){lo, step});
    for (int k = 0; k < across * blocks_across(map->h); k++) {
        const int x0 = k % across * BLOCK, y0 = k / across * BLOCK;
        const float far = lo + step * (float)farthest_bin(g, map, x0 / BLOCK, y0 / BLOCK);
        for (int i = 0; i < BLOCK * BLOCK; i++) {
            int x = x0 + i % BLOCK, y = y0 + i / BLOCK;
            if (x < w && y < map->h)
                rho[y * w + x] = fminf(rho[y * w + x], far);
        }
    }
}

static size_t levels_floats(size_t w, size_t h)
{
    size_t sum = 0;
    for (int k = 0; k < LEVELS_MAX; k++, w = (w + 1) / 2, h = (h + 1) / 2)
        sum += 2 * w * h;
    return sum;
}

err_t guess_layout(struct guess_work *g, struct arena *a, const struct extent *maps, int n)
{
    size_t levels = 0, blocks = 0;
    for (int i = 0; i < n; i++) {
        const size_t across = (size_t)blocks_across(maps[i].w) + 1;
        levels = num_max_size(levels, levels_floats((size_t)maps[i].w, (size_t)maps[i].h));
        blocks = num_max_size(blocks, across * ((size_t)blocks_across(maps[i].h) + 1));
    }
    err_t e = arena_alloc(a, levels, sizeof *g->levels, &g->levels);
    return e ? e : arena_alloc(a, blocks * BINS, sizeof *g->sum, &g->sum);
}
