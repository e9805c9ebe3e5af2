/* One picture by a team: each rank draws a band of tile rows, and the gradient of a splat is the
 * sum over the bands that it touches. All ranks have projected all splats, so that each knows which
 * ones the others send, and in which order: only sums travel. They are rounded to 8 significant
 * bits (bfloat16), a fifth of a per cent: far less than what a step sees of a scene changes them,
 * and half of the bytes. */
#include "core/splat/raster.h"

#include "core/base/num.h"

#include <string.h>

enum {
    CHUNK = RASTER_CHUNK,
    ROWS_MAX = (RASTER_SIDE_MAX + TILE - 1) / TILE,
    TILE_COST = 128,  // splats on a tile that take as long as its pixels: loss and tone curve
    SENT = GRAD2D - 1 // the sum by depth is not sent: no loss of a team has depth
};

static bool is_visible(const struct splat2d *s)
{
    return s->x1 >= s->x0;
}

/* ---- bands ---- */

/* cost: (tiles_y + 1) of the rows before each row. */
static void add_costs(const struct raster *rs, int n, uint64_t *cost)
{
    int64_t step[ROWS_MAX + 1] = {0}, here = 0;
    for (int i = 0; i < n; i++) {
        const struct splat2d *s = &rs->splats[i];
        if (!is_visible(s))
            continue;
        step[s->ty0] += s->tx1 - s->tx0;
        step[s->ty1] -= s->tx1 - s->tx0;
    }
    cost[0] = 0;
    for (int y = 0; y < rs->tiles_y; y++) {
        here += step[y];
        cost[y + 1] = cost[y] + (uint64_t)(here + (int64_t)TILE_COST * rs->tiles_x);
    }
}

void raster_team_deal(struct raster *rs, int n)
{
    const struct team *t = rs->team;
    uint64_t cost[ROWS_MAX + 1], all = 0, before = 0;
    for (int k = 0; k < t->size; k++)
        all += (uint64_t)t->share[k];
    add_costs(rs, n, cost);
    int y = 0;
    for (int k = 0; k < t->size; k++) {
        const uint64_t want = cost[rs->tiles_y] * before / all;
        while (y < rs->tiles_y && (cost[y] + cost[y + 1]) / 2 < want)
            y++;
        rs->band[k] = y;
        before += (uint64_t)t->share[k];
    }
    rs->band[t->size] = rs->tiles_y;
    const int from = rs->band[t->rank], end = rs->band[t->rank + 1];
    rs->row0 = from < end ? num_max(from - 1, 0) : 0;
    rs->row1 = from < end ? num_min(end + 1, rs->tiles_y) : 0;
}

/* ---- gradients ---- */

struct exchange {
    struct raster *rs;
    int n, first, end;       // splats; chunks of this piece
    uint32_t *count;         // (chunks, ranks) splats; then those before, of this piece
    size_t at[TEAM_MAX + 1]; // bytes
    uint16_t *sums;          // of all ranks, one after another: (splats, SENT)
};

static bool is_in_band(const struct raster *rs, const struct splat2d *s, int rank)
{
    const int from = rs->band[rank], end = rs->band[rank + 1];
    return is_visible(s) && from < end && s->ty0 < end && s->ty1 > from;
}

static int chunk_end(const struct exchange *x, int chunk)
{
    return num_min((chunk + 1) * CHUNK, x->n);
}

static err_t count_chunk(void *ctx, int chunk, int worker)
{
    struct exchange *x = ctx;
    const int size = x->rs->team->size;
    uint32_t *count = x->count + (size_t)chunk * (size_t)size;
    (void)worker;
    memset(count, 0, (size_t)size * sizeof *count);
    for (int i = chunk * CHUNK; i < chunk_end(x, chunk); i++)
        for (int k = 0; k < size; k++)
            count[k] += is_in_band(x->rs, &x->rs->splats[i], k);
    return OK;
}

static uint16_t round_sum(float v)
{
    uint32_t u;
    memcpy(&u, &v, 4);
    if ((u & 0x7f800000u) == 0x7f800000u)
        return (uint16_t)(u >> 16 | ((u & 0x7fffff) != 0 ? 0x40 : 0)); // stays NaN
    return (uint16_t)((u + 0x7fff + (u >> 16 & 1)) >> 16);
}

static float sum_of(uint16_t v)
{
    const uint32_t u = (uint32_t)v << 16;
    float f;
    memcpy(&f, &u, 4);
    return f;
}

static err_t pack_chunk(void *ctx, int k, int worker)
{
    const struct exchange *x = ctx;
    const struct raster *rs = x->rs;
    const int chunk = x->first + k, rank = rs->team->rank;
    const uint32_t from = x->count[(size_t)chunk * (size_t)rs->team->size + (size_t)rank];
    uint16_t *out = x->sums + x->at[rank] / sizeof *out + (size_t)from * SENT;
    (void)worker;
    for (int i = chunk * CHUNK; i < chunk_end(x, chunk); i++)
        for (int c = 0; c < SENT && is_in_band(rs, &rs->splats[i], rank); c++)
            *out++ = round_sum(rs->sums[(size_t)i * SLOT + (size_t)c]);
    return OK;
}

static void add_band(const struct exchange *x, int chunk, int rank)
{
    const struct raster *rs = x->rs;
    const uint32_t from = x->count[(size_t)chunk * (size_t)rs->team->size + (size_t)rank];
    const uint16_t *in = x->sums + x->at[rank] / sizeof *in + (size_t)from * SENT;
    for (int i = chunk * CHUNK; i < chunk_end(x, chunk); i++)
        for (int c = 0; c < SENT && is_in_band(rs, &rs->splats[i], rank); c++)
            rs->sums[(size_t)i * SLOT + (size_t)c] += sum_of(*in++);
}

static err_t unpack_chunk(void *ctx, int k, int worker)
{
    const struct exchange *x = ctx;
    const int chunk = x->first + k, count = chunk_end(x, chunk) - chunk * CHUNK;
    (void)worker;
    memset(x->rs->sums + (size_t)chunk * CHUNK * SLOT, 0, (size_t)count * SLOT * sizeof(float));
    for (int rank = 0; rank < x->rs->team->size; rank++)
        add_band(x, chunk, rank);
    return OK;
}

/* As many chunks as have room; counts become numbers of splats before. A chunk always has. */
static void cut_piece(struct exchange *x, int chunks)
{
    const int size = x->rs->team->size;
    const size_t room = x->rs->cap_pairs * SLOT * sizeof(float) / (SENT * sizeof *x->sums);
    uint32_t before[TEAM_MAX] = {0};
    size_t all = 0;
    for (x->end = x->first; x->end < chunks; x->end++) {
        uint32_t *count = x->count + (size_t)x->end * (size_t)size;
        size_t here = 0;
        for (int k = 0; k < size; k++)
            here += count[k];
        if (all + here > room)
            break;
        all += here;
        for (int k = 0; k < size; k++) {
            const uint32_t n = count[k];
            count[k] = before[k];
            before[k] += n;
        }
    }
    x->at[0] = 0;
    for (int k = 0; k < size; k++)
        x->at[k + 1] = x->at[k] + before[k] * SENT * sizeof *x->sums;
}

err_t raster_team_sum(const struct run *r, struct raster *rs, int n)
{
    const int chunks = (n + CHUNK - 1) / CHUNK;
    /* keys are not needed any more, nor are slots; their memory has room: raster_init */
    struct exchange x = {.rs = rs, .n = n, .count = rs->key[1], .sums = (uint16_t *)rs->slots};
    err_t e = pool_for(r->pool, chunks, count_chunk, &x);
    for (x.first = 0; x.first < chunks && !e; x.first = x.end) {
        cut_piece(&x, chunks);
        e = pool_for(r->pool, x.end - x.first, pack_chunk, &x);
        if (!e)
            e = team_begin(rs->team, x.sums, x.at);
        if (!e)
            e = team_wait(rs->team);
        if (!e)
            e = pool_for(r->pool, x.end - x.first, unpack_chunk, &x);
    }
    return e;
}
