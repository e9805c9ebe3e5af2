/* Backward pass. Each tile writes the sums of its splats into slots of its own; a splat's slots of
 * one group of tiles are contiguous, so adding them up per splat needs no atomics and has a fixed
 * order. Then blocks of splats go through the chain rule of the projection (SIMD) and to the sink,
 * which may apply the optimiser at once. */
#include "core/splat/raster.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { CHUNK = RASTER_CHUNK };

struct grad_job {
    const struct run *r;
    struct raster *rs;
    const struct raster_input *in;
    const struct render_grad *up;
    const struct raster_sink *sink;
    struct raster_group group; // the part of a loaded one that gives gradients
    int tile;                  // its first one in the loaded group
    bool first;
    int chunk; // the first one in the chain rule
};

static int tiles_in_group(const struct splat2d *s, const struct raster_group *g)
{
    int x0 = s->tx0 > g->x0 ? s->tx0 : g->x0, x1 = s->tx1 < g->x1 ? s->tx1 : g->x1;
    int y0 = s->ty0 > g->y0 ? s->ty0 : g->y0, y1 = s->ty1 < g->y1 ? s->ty1 : g->y1;
    return s->x1 >= s->x0 && x0 < x1 && y0 < y1 ? (x1 - x0) * (y1 - y0) : 0;
}

static err_t count_chunk(void *ctx, int chunk, int worker)
{
    struct grad_job *j = ctx;
    (void)worker;
    int n = j->in->g->n, end = (chunk + 1) * CHUNK < n ? (chunk + 1) * CHUNK : n;
    uint32_t total = 0;
    for (int i = chunk * CHUNK; i < end; i++)
        total += (uint32_t)tiles_in_group(&j->rs->splats[i], &j->group);
    j->rs->key[0][chunk] = total; // reused: the sort is over
    return OK;
}

static err_t base_chunk(void *ctx, int chunk, int worker)
{
    struct grad_job *j = ctx;
    (void)worker;
    int n = j->in->g->n, end = (chunk + 1) * CHUNK < n ? (chunk + 1) * CHUNK : n;
    uint32_t at = j->rs->key[0][chunk];
    for (int i = chunk * CHUNK; i < end; i++) {
        j->rs->splats[i].base = at;
        at += (uint32_t)tiles_in_group(&j->rs->splats[i], &j->group);
    }
    return OK;
}

static err_t tile_chunk(void *ctx, int chunk, int worker)
{
    struct grad_job *j = ctx;
    (void)worker;
    struct tile t = raster_tile(j->rs, j->in, j->tile + chunk);
    t.gy0 = j->group.y0;
    t.d_radiance = j->up->radiance;
    t.d_depth = j->up->depth;
    t.d_alpha = j->up->alpha;
    j->r->k->tile_grad(&t);
    return OK;
}

static err_t gather_chunk(void *ctx, int chunk, int worker)
{
    struct grad_job *j = ctx;
    (void)worker;
    int n = j->in->g->n, end = (chunk + 1) * CHUNK < n ? (chunk + 1) * CHUNK : n;
    for (int i = chunk * CHUNK; i < end; i++) {
        float *sum = j->rs->sums + (size_t)i * SLOT;
        const float *slot = j->rs->slots + (size_t)j->rs->splats[i].base * SLOT;
        int slots = tiles_in_group(&j->rs->splats[i], &j->group);
        if (j->first)
            memset(sum, 0, SLOT * sizeof *sum);
        for (int k = 0; k < slots; k++, slot += SLOT)
            for (int c = 0; c < SLOT; c++)
                sum[c] += slot[c];
    }
    return OK;
}

/* The rows of other ranks give no gradient here. */
static void cut_group(struct grad_job *j, int i)
{
    const struct raster_group *all = &j->rs->groups[i];
    const int rank = team_rank(j->rs->team);
    j->group = *all;
    if (j->rs->team) {
        j->group.y0 = num_max(all->y0, j->rs->band[rank]);
        j->group.y1 = num_max(num_min(all->y1, j->rs->band[rank + 1]), j->group.y0);
    }
    j->tile = (j->group.y0 - all->y0) * (all->x1 - all->x0);
}

static err_t group_grad(struct grad_job *j, int i)
{
    const struct run *r = j->r;
    int chunks = (j->in->g->n + CHUNK - 1) / CHUNK;
    const struct raster_group *g = &j->group;
    cut_group(j, i);
    j->first = i == 0;
    err_t e = raster_load_group(r, j->rs, i);
    if (!e)
        e = pool_for(r->pool, chunks, count_chunk, j);
    uint32_t total = 0;
    for (int c = 0; !e && c < chunks; c++) {
        uint32_t here = j->rs->key[0][c];
        j->rs->key[0][c] = total;
        total += here;
    }
    if (!e)
        e = pool_for(r->pool, chunks, base_chunk, j);
    if (!e)
        e = pool_for(r->pool, (g->x1 - g->x0) * (g->y1 - g->y0), tile_chunk, j);
    return e ? e : pool_for(r->pool, chunks, gather_chunk, j);
}

static err_t chain_chunk(void *ctx, int chunk, int worker)
{
    struct grad_job *j = ctx;
    struct raster *rs = j->rs;
    (void)worker;
    chunk += j->chunk;
    _Alignas(64) float sums[GRAD2D * SPLAT_BLOCK], grad[G_PLANES_MAX * SPLAT_BLOCK],
        seen[SPLAT_BLOCK];
    float *pose = j->sink->pose ? rs->partial + (size_t)chunk * POSE_GRAD : NULL;
    if (pose)
        memset(pose, 0, POSE_GRAD * sizeof *pose);
    int n = j->in->g->n, end = (chunk + 1) * CHUNK < n ? (chunk + 1) * CHUNK : n;
    for (int first = chunk * CHUNK; first < end; first += SPLAT_BLOCK) {
        int count = end - first < SPLAT_BLOCK ? end - first : SPLAT_BLOCK;
        memset(sums, 0, sizeof sums);
        memset(seen, 0, sizeof seen);
        for (int i = 0; i < count; i++) {
            const struct splat2d *s = &rs->splats[first + i];
            const float *sum = rs->sums + (size_t)(first + i) * SLOT;
            const bool drawn = s->x1 >= s->x0;
            seen[i] = drawn && sum[GRAD_SHOWN] >= 0 ? 1.0f : 0.0f;
            for (int k = 0; k < GRAD2D && drawn; k++)
                sums[k * SPLAT_BLOCK + i] = sum[k];
        }
        j->r->k->project_grad(j->in->g, &rs->view, first, count, sums, grad, pose);
        j->sink->fn(j->sink->ctx, first, count, grad, seen);
    }
    return OK;
}

static err_t chain_chunks(void *ctx, int first, int end)
{
    struct grad_job *j = ctx;
    j->chunk = first;
    return pool_for(j->r->pool, end - first, chain_chunk, j);
}

/* dL/d background = sum over pixels of T dL/d radiance. */
static void background_grad(const struct raster *rs, const float *up, float out[3])
{
    size_t px = (size_t)rs->view.w * (size_t)rs->view.h;
    for (size_t c = 0; c < 3; c++) {
        double sum = 0;
        for (size_t i = 0; i < px; i++)
            sum += (double)rs->trans[i] * (double)up[c * px + i];
        out[c] = isfinite(sum) ? (float)sum : 0.0f;
    }
}

err_t raster_grad_run(const struct run *r, struct raster *rs, const struct raster_input *in,
                      const struct render_grad *up, const struct raster_sink *sink)
{
    if (!rs->slots)
        return err_fail(ERR_ARG, "raster: no memory was planned for gradients");
    if (r->cancel && atomic_load(r->cancel))
        return err_fail(ERR_CANCELLED, "raster: cancelled");
    struct grad_job j = {.r = r, .rs = rs, .in = in, .up = up, .sink = sink};
    for (int i = 0; i < rs->n_groups; i++) {
        err_t e = group_grad(&j, i);
        if (e)
            return e;
    }
    if (sink->background)
        background_grad(rs, up->radiance, sink->background);
    int chunks = (in->g->n + CHUNK - 1) / CHUNK;
    err_t e =
        rs->team ? raster_team_sum(r, rs, in->g->n, chain_chunks, &j) : chain_chunks(&j, 0, chunks);
    if (e || !sink->pose)
        return e;
    for (int k = 0; k < POSE_GRAD; k++) {
        double sum = 0;
        for (int c = 0; c < chunks; c++)
            sum += (double)rs->partial[c * POSE_GRAD + k];
        sink->pose[k] = (float)sum;
    }
    return OK;
}
