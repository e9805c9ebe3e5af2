/* Forward pass:
 * 1. project blocks of splats (SIMD) into one cache line each, count the visible ones per block;
 * 2. compact the visible ones, radix sort by the bits of z (positive floats order like integers;
 *    ties by number);
 * 3. count splats per tile by a two-dimensional difference array, split the picture into groups of
 *    tiles whose lists fit the planned memory (nearly always one group);
 * 4. per band of tiles, append the sorted splats to the lists of their tiles;
 * 5. blend each tile (SIMD).
 * No step depends on the distribution of chunks over threads. */
#include "core/splat/raster.h"

#include "core/base/num.h"
#include "core/base/rotation.h"

#include <math.h>
#include <string.h>

enum {
    CHUNK = RASTER_CHUNK,
    CHUNK_BLOCKS = CHUNK / SPLAT_BLOCK,
    BAND = 2, // tile rows filled by one chunk
    RADIX_BITS = 11,
    PAIRS_PER_SPLAT = 5, // planned tiles per splat; measured 1.5 to 4 on refined scenes
    PAIRS_MIN = 1 << 16
};

static int div_up(int a, int b)
{
    return (a + b - 1) / b;
}

static size_t pairs_for(int cap)
{
    return (size_t)cap * PAIRS_PER_SPLAT + PAIRS_MIN;
}

static size_t tiles_for(int w, int h)
{
    return (size_t)div_up(w, TILE) * (size_t)div_up(h, TILE);
}

static err_t alloc_forward(struct raster *rs, struct arena *a)
{
    size_t n = (size_t)rs->cap + SPLAT_BLOCK, tiles = tiles_for(rs->w, rs->h),
           px = (size_t)rs->w * (size_t)rs->h;
    err_t e = arena_alloc(a, n, sizeof *rs->splats, &rs->splats);
    if (!e)
        e = arena_alloc(a, n / SPLAT_BLOCK + 2, 4, &rs->block_seen);
    for (int i = 0; i < 2; i++) {
        if (!e)
            e = arena_alloc(a, n, 4, &rs->key[i]);
        if (!e)
            e = arena_alloc(a, n, 4, &rs->order[i]);
    }
    if (!e)
        e = arena_alloc(a, n, 8, &rs->boxes);
    if (!e)
        e = arena_alloc(a, tiles, 4, &rs->tile_count);
    if (!e)
        e = arena_alloc(a, tiles + 1, 4, &rs->start);
    if (!e)
        e = arena_alloc(a, rs->cap_pairs, 4, &rs->list);
    if (!e)
        e = arena_alloc(a, tiles, sizeof *rs->groups, &rs->groups);
    if (!e)
        e = arena_alloc(a, px, 4, &rs->trans);
    return e ? e : arena_alloc(a, px, 4, &rs->stop);
}

err_t raster_init(struct raster *rs, struct arena *a, int cap, int w, int h, bool gradients)
{
    memset(rs, 0, sizeof *rs);
    if (cap < 1 || w < 1 || h < 1 || w > RASTER_SIDE_MAX || h > RASTER_SIDE_MAX)
        return err_fail(
            ERR_ARG,
            "raster: %d splats on %d x %d px, must be at least 1 splat and 1..%d px a side", cap, w,
            h, RASTER_SIDE_MAX);
    rs->cap = cap;
    rs->w = w;
    rs->h = h;
    rs->cap_pairs = pairs_for(cap);
    size_t n = (size_t)cap + SPLAT_BLOCK;
    err_t e = alloc_forward(rs, a);
    if (e || !gradients)
        return e;
    e = arena_alloc(a, (size_t)w * (size_t)h, 4, &rs->front);
    if (!e)
        e = arena_alloc(a, rs->cap_pairs * SLOT, 4, &rs->slots);
    if (!e)
        e = arena_alloc(a, n, sizeof *rs->spans, &rs->spans);
    if (!e)
        e = arena_alloc(a, n * SLOT, 4, &rs->sums);
    return e ? e : arena_alloc(a, (n / CHUNK + 1) * POSE_GRAD, 4, &rs->partial);
}

size_t raster_plan(int cap, int w, int h, bool gradients)
{
    struct arena a = arena_counter();
    struct raster rs;
    return raster_init(&rs, &a, cap, w, h, gradients) ? SIZE_MAX : a.peak;
}

static void view_from_camera(const struct camera *c, struct view_geom *v)
{
    rotation_from_unit(c->q, v->r);
    for (int k = 0; k < 3; k++) {
        v->t[k] = c->t[k];
        v->centre[k] = -(v->r[k] * c->t[0] + v->r[3 + k] * c->t[1] + v->r[6 + k] * c->t[2]);
    }
    v->fx = c->fx;
    v->fy = c->fy;
    v->cx = c->cx;
    v->cy = c->cy;
    v->w = c->w;
    v->h = c->h;
    /* core/splat/README.md 2 */
    float mx = 0.15f * (float)c->w / c->fx, my = 0.15f * (float)c->h / c->fy;
    v->lim_x0 = c->cx / c->fx + mx;
    v->lim_x1 = ((float)c->w - c->cx) / c->fx + mx;
    v->lim_y0 = c->cy / c->fy + my;
    v->lim_y1 = ((float)c->h - c->cy) / c->fy + my;
}

struct job {
    const struct run *r;
    struct raster *rs;
    const struct raster_input *in;
    struct render *out;
    const struct raster_group *group;
};

/* On a tile that is drawn here. */
static bool is_drawn(const struct raster *rs, int i)
{
    const struct splat2d *s = &rs->splats[i];
    return rs->team ? rs->spans[i].y0 < rs->row1 && rs->spans[i].y1 > rs->row0 : s->x1 >= s->x0;
}

static void span_block(struct raster *rs, int first, int n)
{
    for (int i = first; i < first + n; i++) {
        const struct splat2d *s = &rs->splats[i];
        rs->spans[i] = (struct raster_span){0, 0, 0};
        if (s->x1 >= s->x0)
            rs->spans[i] = (struct raster_span){s->ty0, s->ty1, (uint8_t)(s->tx1 - s->tx0)};
    }
}

static void count_block(struct job *j, int b)
{
    struct raster *rs = j->rs;
    const int first = b * SPLAT_BLOCK, end = num_min(first + SPLAT_BLOCK, j->in->g->n);
    uint32_t seen = 0;
    for (int i = first; i < end; i++)
        seen += is_drawn(rs, i);
    rs->block_seen[b] = seen;
}

static err_t count_chunk(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    (void)worker;
    for (int b = chunk * CHUNK_BLOCKS;
         b < (chunk + 1) * CHUNK_BLOCKS && b * SPLAT_BLOCK < j->in->g->n; b++)
        count_block(j, b);
    return OK;
}

static err_t project_chunk(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    struct raster *rs = j->rs;
    (void)worker;
    for (int b = chunk * CHUNK_BLOCKS;
         b < (chunk + 1) * CHUNK_BLOCKS && b * SPLAT_BLOCK < j->in->g->n; b++) {
        int first = b * SPLAT_BLOCK, n = j->in->g->n - first;
        n = n < SPLAT_BLOCK ? n : SPLAT_BLOCK;
        j->r->k->project(j->in->g, &rs->view, first, n, rs->splats);
        if (rs->team)
            span_block(rs, first, n);
        else
            count_block(j, b);
    }
    return OK;
}

static err_t compact_chunk(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    struct raster *rs = j->rs;
    (void)worker;
    int first = chunk * CHUNK, end = first + CHUNK < j->in->g->n ? first + CHUNK : j->in->g->n;
    uint32_t at = rs->block_seen[chunk * CHUNK_BLOCKS];
    for (int i = first; i < end; i++) {
        const struct splat2d *s = &rs->splats[i];
        if (!is_drawn(rs, i))
            continue;
        memcpy(&rs->key[0][at], &s->z, 4);
        rs->order[0][at++] = (uint32_t)i;
    }
    return OK;
}

/* Least significant digit first, stable; the sorted order ends in order[1] (three passes). */
static void sort_by_depth(struct raster *rs)
{
    uint32_t count[3][1 << RADIX_BITS];
    const uint32_t mask = (1u << RADIX_BITS) - 1;
    memset(count, 0, sizeof count);
    for (int i = 0; i < rs->n_seen; i++)
        for (int p = 0; p < 3; p++)
            count[p][rs->key[0][i] >> (RADIX_BITS * p) & mask]++;
    for (int p = 0; p < 3; p++) {
        uint32_t total = 0;
        for (uint32_t d = 0; d <= mask; d++) {
            uint32_t c = count[p][d];
            count[p][d] = total;
            total += c;
        }
        const uint32_t *key = rs->key[p & 1], *order = rs->order[p & 1];
        uint32_t *key2 = rs->key[~p & 1], *order2 = rs->order[~p & 1];
        for (int i = 0; i < rs->n_seen; i++) {
            uint32_t to = count[p][key[i] >> (RADIX_BITS * p) & mask]++;
            key2[to] = key[i];
            order2[to] = order[i];
        }
    }
}

/* A box packs the splat number and tile rectangle, so that fill_band reads 8 bytes per splat in
 * order. */
static err_t box_chunk(void *ctx, int chunk, int worker)
{
    struct raster *rs = ((struct job *)ctx)->rs;
    (void)worker;
    int end = (chunk + 1) * CHUNK < rs->n_seen ? (chunk + 1) * CHUNK : rs->n_seen;
    for (int i = chunk * CHUNK; i < end; i++) {
        uint32_t id = rs->order[1][i];
        const struct splat2d *s = &rs->splats[id];
        const int ty0 = num_max(s->ty0, rs->row0), ty1 = num_min(s->ty1, rs->row1);
        rs->boxes[i] = (uint64_t)id << 32 | (uint32_t)s->tx0 << 24 | (uint32_t)s->tx1 << 16 |
                       (uint32_t)ty0 << 8 | (uint32_t)ty1;
    }
    return OK;
}

struct box {
    uint32_t id;
    int x0, x1, y0, y1;
};

static struct box box_unpack(uint64_t b)
{
    return (struct box){(uint32_t)(b >> 32), (int)(b >> 24 & 255), (int)(b >> 16 & 255),
                        (int)(b >> 8 & 255), (int)(b & 255)};
}

/* tile_count[t] = splats on tile t: corners of a difference array, then running sums along both
 * axes. */
static void count_tiles(struct raster *rs)
{
    int tx = rs->tiles_x, ty = rs->tiles_y;
    int32_t *d = (int32_t *)rs->tile_count;
    memset(d, 0, (size_t)tx * (size_t)ty * 4);
    for (int i = 0; i < rs->n_seen; i++) {
        struct box b = box_unpack(rs->boxes[i]);
        d[b.y0 * tx + b.x0]++;
        if (b.x1 < tx)
            d[b.y0 * tx + b.x1]--;
        if (b.y1 < ty)
            d[b.y1 * tx + b.x0]--;
        if (b.x1 < tx && b.y1 < ty)
            d[b.y1 * tx + b.x1]++;
    }
    for (int y = 0; y < ty; y++)
        for (int x = 1; x < tx; x++)
            d[y * tx + x] += d[y * tx + x - 1];
    for (int y = 1; y < ty; y++)
        for (int x = 0; x < tx; x++)
            d[y * tx + x] += d[(y - 1) * tx + x];
}

/* Whole rows of tiles where they fit, else pieces of one row; one tile always fits because pairs
 * >= splats. */
static void split_groups(struct raster *rs)
{
    size_t used = 0;
    rs->n_groups = 0;
    for (int y = rs->row0; y < rs->row1; y++) {
        size_t row = 0;
        for (int x = 0; x < rs->tiles_x; x++)
            row += rs->tile_count[y * rs->tiles_x + x];
        if (rs->n_groups && used + row <= rs->cap_pairs) {
            rs->groups[rs->n_groups - 1].y1 = y + 1;
            used += row;
            continue;
        }
        rs->groups[rs->n_groups++] = (struct raster_group){0, rs->tiles_x, y, y + 1};
        used = row;
        if (row <= rs->cap_pairs)
            continue;
        size_t piece = 0;
        for (int x = 0; x < rs->tiles_x; x++) {
            size_t c = rs->tile_count[y * rs->tiles_x + x];
            if (piece + c > rs->cap_pairs) {
                rs->groups[rs->n_groups - 1].x1 = x;
                rs->groups[rs->n_groups++] = (struct raster_group){x, rs->tiles_x, y, y + 1};
                piece = 0;
            }
            piece += c;
        }
        used = rs->cap_pairs; // the next row starts a new group
    }
}

static err_t fill_band(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    struct raster *rs = j->rs;
    const struct raster_group *g = j->group;
    (void)worker;
    int nx = g->x1 - g->x0, y0 = g->y0 + chunk * BAND, y1 = y0 + BAND < g->y1 ? y0 + BAND : g->y1;
    uint32_t at[BAND * 256];
    memcpy(at, rs->start + (size_t)(y0 - g->y0) * (size_t)nx, (size_t)(y1 - y0) * (size_t)nx * 4);
    for (int i = 0; i < rs->n_seen; i++) {
        struct box b = box_unpack(rs->boxes[i]);
        int by0 = b.y0 > y0 ? b.y0 : y0, by1 = b.y1 < y1 ? b.y1 : y1;
        int bx0 = b.x0 > g->x0 ? b.x0 : g->x0, bx1 = b.x1 < g->x1 ? b.x1 : g->x1;
        for (int y = by0; y < by1; y++)
            for (int x = bx0; x < bx1; x++)
                rs->list[at[(y - y0) * nx + x - g->x0]++] = b.id;
    }
    return OK;
}

err_t raster_load_group(const struct run *r, struct raster *rs, int i)
{
    if (rs->loaded == i)
        return OK;
    const struct raster_group *g = &rs->groups[i];
    uint32_t total = 0;
    int k = 0;
    for (int y = g->y0; y < g->y1; y++)
        for (int x = g->x0; x < g->x1; x++) {
            rs->start[k++] = total;
            total += rs->tile_count[y * rs->tiles_x + x];
        }
    rs->start[k] = total;
    struct job j = {r, rs, NULL, NULL, g};
    err_t e = pool_for(r->pool, div_up(g->y1 - g->y0, BAND), fill_band, &j);
    rs->loaded = e ? -1 : i;
    return e;
}

struct tile raster_tile(const struct raster *rs, const struct raster_input *in, int k)
{
    const struct raster_group *g = &rs->groups[rs->loaded];
    int nx = g->x1 - g->x0;
    struct tile t = {.splats = rs->splats,
                     .list = rs->list + rs->start[k],
                     .n = (int)(rs->start[k + 1] - rs->start[k]),
                     .x0 = (g->x0 + k % nx) * TILE,
                     .y0 = (g->y0 + k / nx) * TILE,
                     .w = rs->view.w,
                     .h = rs->view.h,
                     .trans = rs->trans,
                     .front = rs->front,
                     .stop = rs->stop,
                     .slots = rs->slots,
                     .gx0 = g->x0,
                     .gx1 = g->x1,
                     .gy0 = g->y0};
    memcpy(t.background, in->background, sizeof t.background);
    return t;
}

static err_t tile_chunk(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    (void)worker;
    struct tile t = raster_tile(j->rs, j->in, chunk);
    t.radiance = j->out->radiance;
    t.depth = j->out->depth;
    t.alpha = j->out->alpha;
    j->r->k->tile(&t);
    return OK;
}

void raster_rows(const struct raster *rs, int *first, int *end)
{
    const int rank = team_rank(rs->team);
    *first = rs->team ? num_min(rs->band[rank] * TILE, rs->view.h) : 0;
    *end = rs->team ? num_min(rs->band[rank + 1] * TILE, rs->view.h) : rs->view.h;
}

static err_t check_input(const struct raster *rs, const struct raster_input *in)
{
    const struct camera *c = in->cam;
    if (in->g->n > rs->cap || in->g->n < 0)
        return err_fail(ERR_ARG, "raster: %d splats, planned for %d", in->g->n, rs->cap);
    if (c->w < 1 || c->h < 1 || tiles_for(c->w, c->h) > tiles_for(rs->w, rs->h) ||
        c->w > RASTER_SIDE_MAX || c->h > RASTER_SIDE_MAX ||
        (size_t)c->w * (size_t)c->h > (size_t)rs->w * (size_t)rs->h)
        return err_fail(ERR_ARG, "raster: picture of %d x %d px, planned for %d x %d", c->w, c->h,
                        rs->w, rs->h);
    float sum = c->fx + c->fy + c->cx + c->cy;
    for (int i = 0; i < 4; i++)
        sum += c->q[i] + c->t[i % 3];
    if (!isfinite(sum) || !(c->fx > 0) || !(c->fy > 0))
        return err_fail(
            ERR_ARG,
            "raster: camera with focal lengths %g, %g px must have finite numbers and lengths > 0",
            (double)c->fx, (double)c->fy);
    return OK;
}

static err_t sort_splats(struct job *j)
{
    struct raster *rs = j->rs;
    const struct run *r = j->r;
    int n = j->in->g->n, chunks = div_up(n, CHUNK), blocks = div_up(n, SPLAT_BLOCK);
    rs->row0 = 0;
    rs->row1 = rs->tiles_y;
    err_t e = pool_for(r->pool, chunks, project_chunk, j);
    if (!e && rs->team) {
        raster_team_deal(rs, n);
        e = pool_for(r->pool, chunks, count_chunk, j);
    }
    if (e)
        return e;
    uint32_t total = 0;
    for (int b = 0; b < blocks; b++) {
        uint32_t c = rs->block_seen[b];
        rs->block_seen[b] = total;
        total += c;
    }
    rs->n_seen = (int)total;
    e = pool_for(r->pool, chunks, compact_chunk, j);
    if (e)
        return e;
    sort_by_depth(rs);
    e = pool_for(r->pool, div_up(rs->n_seen, CHUNK), box_chunk, j);
    if (e)
        return e;
    count_tiles(rs);
    split_groups(rs);
    rs->loaded = -1;
    return OK;
}

err_t raster_run(const struct run *r, struct raster *rs, const struct raster_input *in,
                 struct render *out)
{
    err_t e = check_input(rs, in);
    if (e)
        return e;
    if (r->cancel && atomic_load(r->cancel))
        return err_fail(ERR_CANCELLED, "raster: cancelled");
    out->w = in->cam->w;
    out->h = in->cam->h;
    rs->tiles_x = div_up(out->w, TILE);
    rs->tiles_y = div_up(out->h, TILE);
    view_from_camera(in->cam, &rs->view);
    struct job j = {r, rs, in, out, NULL};
    e = sort_splats(&j);
    for (int i = 0; !e && i < rs->n_groups; i++) {
        const struct raster_group *g = &rs->groups[i];
        e = raster_load_group(r, rs, i);
        if (!e)
            e = pool_for(r->pool, (g->x1 - g->x0) * (g->y1 - g->y0), tile_chunk, &j);
    }
    return e;
}
