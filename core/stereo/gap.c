/* Directions are cells of a cube. Splats of the shell mark those that they cover; from a cell
 * without any, lines go out to both sides along four axes. */
#include "core/stereo/gap.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum {
    EDGE = 128, // cells of an edge of the cube
    CELLS = 6 * EDGE * EDGE,
    AXES = 4
};

static const float STEP = 0.0123f;  // rad, about a cell
static const float REACH = 0.14f;   // rad, 8 degrees
static const float COVERS = 1.2f;   // standard deviations
static const float WIDTH = 1;       // standard deviation per step
static const float LARGEST = 0.35f; // rad, a splat that covers more is cut there

struct cell {
    float sum[3], n; // ln radiance / SH_BASIS0
};

static int cell_of(const float *d)
{
    int axis = 0;
    for (int k = 1; k < 3; k++)
        axis = fabsf(d[k]) > fabsf(d[axis]) ? k : axis;
    const float most = fabsf(d[axis]) + 1e-20f;
    const float u = d[(axis + 1) % 3] / most, v = d[(axis + 2) % 3] / most;
    const int x = num_min((int)((u + 1) * 0.5f * EDGE), EDGE - 1);
    const int y = num_min((int)((v + 1) * 0.5f * EDGE), EDGE - 1);
    return ((2 * axis + (d[axis] < 0)) * EDGE + y) * EDGE + x;
}

static void direction_of(int cell, float *d)
{
    const int axis = cell / (2 * EDGE * EDGE), back = cell / (EDGE * EDGE) % 2;
    const float u = (2 * (float)(cell % EDGE) + 1) / EDGE - 1;
    const float v = (2 * (float)(cell / EDGE % EDGE) + 1) / EDGE - 1;
    const float len = sqrtf(u * u + v * v + 1);
    d[axis] = (back ? -1 : 1) / len;
    d[(axis + 1) % 3] = u / len;
    d[(axis + 2) % 3] = v / len;
}

/* Two unit vectors across d and each other. */
static void across(const float *d, float *a, float *b)
{
    const int k = fabsf(d[0]) < 0.6f ? 0 : 1;
    float len = 0;
    for (int i = 0; i < 3; i++) {
        a[i] = (i == k) - d[k] * d[i];
        len += a[i] * a[i];
    }
    for (int i = 0; i < 3; i++)
        a[i] /= sqrtf(len);
    for (int i = 0; i < 3; i++)
        b[i] = d[(i + 1) % 3] * a[(i + 2) % 3] - d[(i + 2) % 3] * a[(i + 1) % 3];
}

static void step_aside(const float *d, const float *a, const float *b, const float by[2], float *o)
{
    for (int i = 0; i < 3; i++)
        o[i] = d[i] + by[0] * a[i] + by[1] * b[i];
}

static void mark_splat(const struct shell *shell, const struct gaussians *g, int i,
                       struct cell *cells)
{
    float d[3], a[3], b[3], at[3], len = 0;
    for (int k = 0; k < 3; k++) {
        d[k] = g->plane[G_MU + k][i] - shell->middle[k];
        len += d[k] * d[k];
    }
    for (int k = 0; k < 3; k++)
        d[k] /= sqrtf(len);
    across(d, a, b);
    const float wide = COVERS * expf(g->plane[G_LOG_SCALE + 1][i]) / sqrtf(len);
    const int n = (int)(fminf(wide, LARGEST) / (0.5f * STEP));
    for (int y = -n; y <= n; y++) {
        for (int x = -n; x <= n; x++) {
            step_aside(d, a, b, (const float[2]){0.5f * STEP * (float)x, 0.5f * STEP * (float)y},
                       at);
            struct cell *c = &cells[cell_of(at)];
            for (int k = 0; k < 3; k++)
                c->sum[k] += g->plane[G_SH + k][i];
            c->n++;
        }
    }
}

/* The first cell with sky from d along (a, b) turned by `angle`; the distance in *way. */
static const struct cell *find_sky(const struct cell *cells, const float *d, const float (*ab)[3],
                                   float angle, float *way)
{
    const float right = cosf(angle), down = sinf(angle);
    float at[3];
    for (*way = STEP; *way < REACH; *way += STEP) {
        step_aside(d, ab[0], ab[1], (const float[2]){*way * right, *way * down}, at);
        const struct cell *c = &cells[cell_of(at)];
        if (c->n > 0)
            return c;
    }
    return NULL;
}

/* Mean colour of the sky on both sides of a cell; false if there is none. */
static bool is_between(const struct cell *cells, const float *d, float colour[3])
{
    float ab[2][3], weight = 0;
    across(d, ab[0], ab[1]);
    memset(colour, 0, 3 * sizeof *colour);
    for (int i = 0; i < AXES; i++) {
        const float angle = (float)NUM_PI * (float)i / AXES;
        float way[2];
        const struct cell *side[2];
        for (int k = 0; k < 2; k++)
            side[k] =
                find_sky(cells, d, (const float(*)[3])ab, angle + (float)(k * NUM_PI), &way[k]);
        for (int k = 0; k < 2 && side[0] && side[1]; k++) {
            const float w = 1 / way[k];
            for (int c = 0; c < 3; c++)
                colour[c] += w * side[k]->sum[c] / side[k]->n;
            weight += w;
        }
    }
    for (int c = 0; c < 3; c++)
        colour[c] /= weight + 1e-20f;
    return weight > 0;
}

static void add_splat(const struct shell *shell, const float *d, const float *colour,
                      struct gaussians *g)
{
    const int i = g->n++;
    for (int k = 0; k < gaussians_planes(g->degree); k++)
        g->plane[k][i] = 0;
    for (int k = 0; k < 3; k++) {
        g->plane[G_MU + k][i] = shell->middle[k] + shell->radius * d[k];
        g->plane[G_LOG_SCALE + k][i] = logf(WIDTH * STEP * shell->radius);
        g->plane[G_SH + k][i] = colour[k];
    }
    g->plane[G_QUAT][i] = 1;
    g->plane[G_LOGIT][i] = (float)num_logit((double)SHELL_OPACITY);
}

static err_t layout(struct arena *a, struct cell **cells)
{
    return arena_alloc(a, CELLS, sizeof **cells, cells);
}

void gap_plan(struct plan *p)
{
    struct cell *cells;
    const size_t mark = arena_mark(&p->tmp);
    if (layout(&p->tmp, &cells))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t gap_fill(const struct run *r, const struct shell *shell, struct gaussians *g, int max)
{
    const size_t mark = arena_mark(r->tmp);
    struct cell *cells;
    err_t e = layout(r->tmp, &cells);
    if (e)
        return e;
    memset(cells, 0, CELLS * sizeof *cells);
    bool any = false; // without sky nothing is between it
    for (int i = 0; i < g->n; i++) {
        const float x[3] = {g->plane[G_MU][i], g->plane[G_MU + 1][i], g->plane[G_MU + 2][i]};
        if (!shell_has(shell, x))
            continue;
        mark_splat(shell, g, i, cells);
        any = true;
    }
    for (int k = 0; k < CELLS && any && g->n < max; k++) {
        float d[3], colour[3];
        direction_of(k, d);
        if (!(cells[k].n > 0) && is_between(cells, d, colour))
            add_splat(shell, d, colour, g);
    }
    arena_reset(r->tmp, mark);
    return OK;
}
