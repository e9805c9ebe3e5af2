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
    HALO = RASTER_HALO / TILE,
    PIECES = 8,       // that travel one after another
    TILE_COST = 128,  // splats on a tile that take as long as its pixels: loss and tone curve
    SPLATS_COST = 2,  // splats that all ranks project and move while one is drawn on a tile
    SENT = GRAD2D - 1 // the sum by depth is not sent: no loss of a team has depth
};

/* ---- bands ---- */

/* cost: (tiles_y + 1) of the rows before each row. returns: splats that are seen. */
static int add_costs(const struct raster *rs, int n, uint64_t *cost)
{
    int64_t step[ROWS_MAX + 1] = {0}, here = 0;
    int seen = 0;
    for (int i = 0; i < n; i++) {
        const struct raster_span *s = &rs->spans[i];
        seen += s->wide > 0;
        step[s->y0] += s->wide;
        step[s->y1] -= s->wide;
    }
    cost[0] = 0;
    for (int y = 0; y < rs->tiles_y; y++) {
        here += step[y];
        cost[y + 1] = cost[y] + (uint64_t)(here + (int64_t)TILE_COST * rs->tiles_x);
    }
    return seen;
}

/* Parts of `all` with which the ranks end at the same time. own: what each does beside its part; a
 * rank that is too slow even for that gets none. */
static void part_costs(const struct team *t, double all, double own, double part[TEAM_MAX])
{
    bool idle[TEAM_MAX] = {false};
    for (bool again = true; again;) {
        double sum = all, speed = 0;
        again = false;
        for (int k = 0; k < t->size; k++) {
            sum += idle[k] ? 0 : own;
            speed += idle[k] ? 0 : t->share[k];
        }
        for (int k = 0; k < t->size; k++) {
            part[k] = idle[k] ? 0 : sum * t->share[k] / speed - own;
            again = again || part[k] < 0;
            idle[k] = idle[k] || part[k] < 0;
        }
    }
}

void raster_team_deal(struct raster *rs, int n)
{
    const struct team *t = rs->team;
    uint64_t cost[ROWS_MAX + 1];
    double part[TEAM_MAX], before = 0;
    const int seen = add_costs(rs, n, cost);
    const double all = (double)cost[rs->tiles_y];
    part_costs(t, all, seen / SPLATS_COST + HALO * all / rs->tiles_y, part);
    int y = 0;
    for (int k = 0; k < t->size; k++) {
        while (y < rs->tiles_y && (double)(cost[y] + cost[y + 1]) / 2 < before)
            y++;
        rs->band[k] = y;
        before += part[k];
    }
    rs->band[t->size] = rs->tiles_y;
    const int from = rs->band[t->rank], end = rs->band[t->rank + 1];
    rs->row0 = from < end ? num_max(from - HALO, 0) : 0;
    rs->row1 = from < end ? num_min(end + HALO, rs->tiles_y) : 0;
}

/* ---- gradients ---- */

/* Some chunks of splats. */
struct piece {
    int first, end;
    size_t at[TEAM_MAX + 1]; // bytes in `sums`
};

struct exchange {
    const struct run *r;
    struct raster *rs;
    int n, chunks;
    uint32_t *count; // (chunks, ranks) splats; in a piece: those before
    uint16_t *sums;  // of the pieces: of all ranks, one after another, (splats, SENT)
    size_t room;     // bytes
    struct piece pieces[PIECES];
    int n_pieces;
    const struct piece *now;
};

static bool is_in_band(const struct raster *rs, int i, int rank)
{
    const int from = rs->band[rank], end = rs->band[rank + 1];
    return from < end && rs->spans[i].y0 < end && rs->spans[i].y1 > from;
}

static int chunk_end(const struct exchange *x, int chunk)
{
    return num_min((chunk + 1) * CHUNK, x->n);
}

static uint32_t *count_of(const struct exchange *x, int chunk, int rank)
{
    return x->count + (size_t)chunk * (size_t)x->rs->team->size + (size_t)rank;
}

static err_t count_chunk(void *ctx, int chunk, int worker)
{
    struct exchange *x = ctx;
    (void)worker;
    for (int k = 0; k < x->rs->team->size; k++) {
        uint32_t n = 0;
        for (int i = chunk * CHUNK; i < chunk_end(x, chunk); i++)
            n += is_in_band(x->rs, i, k);
        *count_of(x, chunk, k) = n;
    }
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

/* Where the sums of a rank and chunk begin. */
static uint16_t *sums_of(const struct exchange *x, int chunk, int rank)
{
    return x->sums + x->now->at[rank] / sizeof *x->sums + (size_t)*count_of(x, chunk, rank) * SENT;
}

static err_t pack_chunk(void *ctx, int k, int worker)
{
    const struct exchange *x = ctx;
    const struct raster *rs = x->rs;
    const int chunk = x->now->first + k, rank = rs->team->rank;
    uint16_t *out = sums_of(x, chunk, rank);
    (void)worker;
    for (int i = chunk * CHUNK; i < chunk_end(x, chunk); i++) {
        if (!is_in_band(rs, i, rank))
            continue;
        for (int c = 0; c < SENT; c++)
            *out++ = round_sum(rs->sums[(size_t)i * SLOT + (size_t)c]);
    }
    return OK;
}

static void add_band(const struct exchange *x, int chunk, int rank)
{
    const struct raster *rs = x->rs;
    const uint16_t *in = sums_of(x, chunk, rank);
    for (int i = chunk * CHUNK; i < chunk_end(x, chunk); i++) {
        if (!is_in_band(rs, i, rank))
            continue;
        for (int c = 0; c < SENT; c++)
            rs->sums[(size_t)i * SLOT + (size_t)c] += sum_of(*in++);
    }
}

static err_t unpack_chunk(void *ctx, int k, int worker)
{
    const struct exchange *x = ctx;
    const int chunk = x->now->first + k, count = chunk_end(x, chunk) - chunk * CHUNK;
    (void)worker;
    memset(x->rs->sums + (size_t)chunk * CHUNK * SLOT, 0, (size_t)count * SLOT * sizeof(float));
    for (int rank = 0; rank < x->rs->team->size; rank++)
        add_band(x, chunk, rank);
    return OK;
}

/* A piece from chunk `first` on, not longer than its part of all, as far as there is room from
 * `used` on; counts become numbers of splats before. */
static void cut_piece(struct exchange *x, int first, size_t used, struct piece *p)
{
    const int size = x->rs->team->size, most = (x->chunks + PIECES - 1) / PIECES;
    const size_t item = SENT * sizeof *x->sums;
    uint32_t before[TEAM_MAX] = {0};
    p->first = first;
    for (p->end = first; p->end < num_min(first + most, x->chunks); p->end++) {
        size_t here = 0;
        for (int k = 0; k < size; k++)
            here += *count_of(x, p->end, k) * item;
        if (used + here > x->room)
            break;
        used += here;
        for (int k = 0; k < size; k++) {
            const uint32_t n = *count_of(x, p->end, k);
            *count_of(x, p->end, k) = before[k];
            before[k] += n;
        }
    }
    for (int k = 0; k < size; k++)
        p->at[k + 1] = p->at[k] + before[k] * item;
}

/* Send pieces from chunk `first` on, until all are sent or there is no more room. */
static err_t send_pieces(struct exchange *x, int first)
{
    size_t used = 0;
    err_t e = OK;
    for (x->n_pieces = 0; x->n_pieces < PIECES && first < x->chunks && !e; x->n_pieces++) {
        struct piece *p = &x->pieces[x->n_pieces];
        p->at[0] = used;
        cut_piece(x, first, used, p);
        if (p->end == first)
            break;
        used = p->at[x->rs->team->size];
        first = p->end;
        x->now = p;
        e = pool_for(x->r->pool, p->end - p->first, pack_chunk, x);
        if (!e)
            e = team_begin(x->rs->team, x->sums, p->at);
    }
    return e;
}

err_t raster_team_sum(const struct run *r, struct raster *rs, int n, raster_team_fn *done,
                      void *ctx)
{
    /* keys are not needed any more, nor are slots, whose memory has room for any chunk:
     * raster_init */
    struct exchange x = {.r = r,
                         .rs = rs,
                         .n = n,
                         .chunks = (n + CHUNK - 1) / CHUNK,
                         .count = rs->key[1],
                         .sums = (void *)rs->slots,
                         .room = rs->cap_pairs * SLOT * sizeof *rs->slots};
    err_t e = pool_for(r->pool, x.chunks, count_chunk, &x);
    for (int first = 0; first < x.chunks && !e;) {
        e = send_pieces(&x, first);
        for (int i = 0; i < x.n_pieces && !e; i++) {
            x.now = &x.pieces[i];
            e = team_wait(rs->team);
            if (!e)
                e = pool_for(r->pool, x.now->end - x.now->first, unpack_chunk, &x);
            if (!e)
                e = done(ctx, x.now->first, x.now->end);
            first = x.now->end;
        }
    }
    return e;
}
