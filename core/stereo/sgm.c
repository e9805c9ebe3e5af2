/* Along a path: L(p, d) = C(p, d) + min(L(q, d), L(q, d +- 1) + P1, min L(q) + P2) - min L(q)
 * with q the pixel before p; the sum over eight paths replaces C. Vertical and diagonal paths go
 * row by row with x innermost, horizontal ones pixel by pixel with the planes innermost, so that
 * both become vector loops. P2 is lower over edges of the picture. */
#include "core/stereo/sgm.h"

#include <math.h>
#include <string.h>

enum {
    STEP_COST = 7,     // P1: change by one plane
    JUMP_COST = 45,    // P2: larger change, away from edges
    JUMP_COST_MIN = 14 // P2 over a strong edge
};

static int16_t min16(int16_t a, int16_t b)
{
    return a < b ? a : b;
}

/* Cost of a jump between two pixels, lower over an edge of the picture that is reliable in both. */
static int16_t jump_cost(const float *p, const float *q)
{
    float edge = fabsf(p[0] - q[0]) * p[1] * q[1];
    return (int16_t)fmaxf((float)JUMP_COST / (1.0f + 3.0f * edge), (float)JUMP_COST_MIN);
}

/* One row of one plane of one path, aligned in x. */
struct path_io {
    const uint8_t *cost;
    const int16_t *before, *below,
        *above;                   // previous pixels of the path: this plane, the planes beside it
    const int16_t *least, *jump;  // minimum of the previous pixels over the planes; cost of a jump
    int16_t *now, *total, *floor; // this path; sum of all paths; minimum over the planes so far
};

static void path_row(const struct path_io *io, int n)
{
    const uint8_t *cost = io->cost;
    const int16_t *before = io->before, *below = io->below, *above = io->above, *least = io->least,
                  *jump = io->jump;
    int16_t *restrict now = io->now, *restrict total = io->total, *restrict floor = io->floor;
    for (int x = 0; x < n; x++) {
        int16_t beside = (int16_t)(min16(below[x], above[x]) + STEP_COST);
        int16_t way = min16(min16(before[x], beside), (int16_t)(least[x] + jump[x]));
        int16_t c = (int16_t)(cost[x] + way - least[x]);
        now[x] = c;
        total[x] = (int16_t)(total[x] + c);
        floor[x] = min16(floor[x], c);
    }
}

enum { FAR_COST = 16000 }; // cost of planes beyond the first and last

/* Row y of path p of 3, which comes from pixel x - 1 + p of row y - dir. The two halves of m->path
 * alternate between the row before and this one. */
static void path_down(struct sgm *m, int y, int dir, int p)
{
    const int w = m->w, row = w + 2, planes = m->planes, now = y & 1, old = 1 - now;
    const size_t path = (size_t)row * (size_t)(planes + 2);
    const float *px = m->light + 2 * (size_t)y * (size_t)w, *from = px - 2 * (ptrdiff_t)dir * w;
    const int16_t *before = m->path + (size_t)(3 * old + p) * path + p;
    int16_t *floor = m->least + (3 * now + p) * row + 1;
    for (int x = 0; x < w; x++) {
        int x0 = x - 1 + p < 0 ? 0 : x - 1 + p < w ? x - 1 + p : w - 1;
        m->transposed[x] = jump_cost(px + 2 * x, from + 2 * x0);
        floor[x] = FAR_COST;
    }
    for (int d = 0; d < planes; d++) {
        const size_t at = ((size_t)y * (size_t)planes + (size_t)d) * (size_t)w;
        const int16_t *b = before + (d + 1) * row;
        struct path_io io = {.cost = m->cost + at,
                             .before = b,
                             .below = b - row,
                             .above = b + row,
                             .least = m->least + (3 * old + p) * row + p,
                             .jump = m->transposed,
                             .now = m->path + (size_t)(3 * now + p) * path + (d + 1) * row + 1,
                             .total = m->total + at,
                             .floor = floor};
        path_row(&io, w);
    }
}

/* The three paths that run down (dir 1) or up (dir -1). Rows of m->path have one zero on both sides
 * and FAR_COST planes at both ends, so that borders need no special case. */
static void sweep_vertical(struct sgm *m, int dir)
{
    const int w = m->w, row = w + 2, planes = m->planes;
    const size_t path = (size_t)row * (size_t)(planes + 2);
    memset(m->path, 0, 6 * path * sizeof(int16_t));
    memset(m->least, 0, 6 * (size_t)row * sizeof(int16_t));
    for (int p = 0; p < 6; p++) {
        for (int x = 0; x < row; x++)
            m->path[(size_t)p * path + (size_t)x] =
                m->path[(size_t)(p + 1) * path - 1 - (size_t)x] = FAR_COST;
    }
    for (int i = 0; i < m->h; i++) {
        for (int p = 0; p < 3; p++)
            path_down(m, dir > 0 ? i : m->h - 1 - i, i > 0 ? dir : 0, p);
    }
}

/* One horizontal path of one row, dir 1 from the left or -1 from the right, planes innermost: adds
 * to sum. */
static void path_across(struct sgm *m, const float *px, const int16_t *cost, int dir, int16_t *sum)
{
    const int w = m->w, planes = m->planes;
    int16_t *buffer = sum + w * planes, least = 0;
    memset(buffer, 0, 2 * (size_t)(planes + 2) * sizeof *buffer);
    for (int i = 0; i < 4; i++)
        buffer[i / 2 * (planes + 2) + i % 2 * (planes + 1)] = FAR_COST;
    for (int i = 0; i < w; i++) {
        const int x = dir > 0 ? i : w - 1 - i, x0 = i ? x - dir : x;
        const int16_t *restrict b = buffer + (i & 1) * (planes + 2) + 1;
        int16_t *restrict now = buffer + (1 - (i & 1)) * (planes + 2) + 1;
        int16_t *restrict add = sum + x * planes;
        const int16_t *restrict own = cost + x * planes;
        int16_t jump = (int16_t)(least + jump_cost(px + 2 * x, px + 2 * x0)), floor = FAR_COST;
        for (int d = 0; d < planes; d++) {
            int16_t beside = (int16_t)(min16(b[d - 1], b[d + 1]) + STEP_COST);
            now[d] = (int16_t)(own[d] + min16(min16(b[d], beside), jump) - least);
            add[d] = (int16_t)(add[d] + now[d]);
            floor = min16(floor, now[d]);
        }
        least = floor;
    }
}

/* Both horizontal paths of row y. */
static void sweep_row(struct sgm *m, int y)
{
    const int w = m->w, planes = m->planes;
    const size_t at = (size_t)y * (size_t)planes * (size_t)w;
    const float *px = m->light + 2 * (size_t)y * (size_t)w;
    int16_t *cost = m->transposed, *sum = cost + w * planes;
    for (int x = 0; x < w; x++) {
        for (int d = 0; d < planes; d++)
            cost[x * planes + d] = m->cost[at + (size_t)(d * w + x)];
    }
    memset(sum, 0, (size_t)w * (size_t)planes * sizeof *sum);
    path_across(m, px, cost, 1, sum);
    path_across(m, px, cost, -1, sum);
    int16_t *total = m->total + at;
    for (int d = 0; d < planes; d++) {
        for (int x = 0; x < w; x++)
            total[d * w + x] = (int16_t)(total[d * w + x] + sum[x * planes + d]);
    }
}

err_t sgm_init(struct sgm *m, struct arena *a, int width, size_t pixels, int planes_max)
{
    const size_t w = (size_t)width, planes = (size_t)planes_max;
    *m = (struct sgm){.w = width, .planes = planes_max};
    err_t e = arena_alloc(a, pixels * planes, sizeof *m->cost, &m->cost);
    if (!e)
        e = arena_alloc(a, pixels * planes, sizeof *m->total, &m->total);
    if (!e)
        e = arena_alloc(a, 6 * (planes + 2) * (w + 2), sizeof *m->path, &m->path);
    if (!e)
        e = arena_alloc(a, 6 * (w + 2), sizeof *m->least, &m->least);
    return e ? e
             : arena_alloc(a, 2 * (w + 1) * (planes + 2), sizeof *m->transposed, &m->transposed);
}

void sgm_run(struct sgm *m)
{
    memset(m->total, 0, (size_t)m->w * (size_t)m->h * (size_t)m->planes * sizeof *m->total);
    sweep_vertical(m, 1);
    sweep_vertical(m, -1);
    for (int y = 0; y < m->h; y++)
        sweep_row(m, y);
}
