#include "core/refine/outliers.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/pose.h"

#include <math.h>
#include <string.h>

/* Display values. */
static const float SCORE_MIN = 0.06f;    // no hit below: curves and cameras are that far off
static const float SCORE_MEDIANS = 5.0f; // times the median of its photograph: no hit below
static const float SHARE_MORE = 0.004f;  // of a photograph beyond twice that of the median one
static const float SEEN = 0.9f;          // of the cells of a photograph before it is judged
static const float COVERED = 0.5f;       // alpha of a surface
static const float SAME = 0.05f;         // relative difference of depths on one surface
enum { AGREE = 6, WITNESSES = 2 };       // of 3 x 3 cells; photographs

static int photos_of(const struct outliers *o)
{
    return o->v->n + o->v->n_more;
}

static int place_of(const struct outliers *o, int k)
{
    return k < o->v->n ? k : o->v->place[k - o->v->n];
}

err_t outliers_layout(struct outliers *o, struct arena *a, const struct views *v, int px)
{
    const int edge = (v->size + px - 1) / px;
    *o = (struct outliers){.v = v, .px = px, .across = edge, .down = edge};
    const size_t cells = outliers_cells(o), n = (size_t)photos_of(o);
    err_t e = arena_zalloc(a, 3 * cells, sizeof *o->excess, &o->excess);
    if (!e)
        e = arena_alloc(a, n * cells, sizeof *o->score, &o->score);
    if (!e)
        e = arena_alloc(a, n * cells, 1, &o->hit);
    if (!e)
        e = arena_alloc(a, n * cells, 1, &o->skip);
    if (!e)
        e = arena_alloc(a, n * cells, 1, &o->former);
    if (!e)
        e = arena_alloc(a, cells, 1, &o->patch);
    if (!e)
        e = arena_alloc(a, (size_t)v->n * cells, sizeof *o->depth, &o->depth);
    if (!e)
        e = arena_alloc(a, cells, sizeof *o->alpha, &o->alpha);
    if (!e)
        e = arena_alloc(a, 3 * cells, sizeof *o->radiance, &o->radiance);
    if (!e)
        e = arena_alloc(a, cells > n ? cells : n, sizeof *o->sorted, &o->sorted);
    return e ? e : arena_alloc(a, n, sizeof *o->share, &o->share);
}

void outliers_begin(struct outliers *o)
{
    const size_t all = (size_t)photos_of(o) * outliers_cells(o);
    for (size_t i = 0; i < all; i++)
        o->score[i] = -1;
    memset(o->skip, 0, all);
}

err_t outliers_see(struct team *t, struct outliers *o, int k, const struct loss_input *compared)
{
    const int px = compared->cell_px;
    const int x1 = (compared->x + compared->pic->w + px - 1) / px;
    const int y1 = (compared->y + compared->pic->h + px - 1) / px;
    float *score = o->score + (size_t)k * outliers_cells(o);
    err_t e = loss_gather(t, compared, px, o->excess, 3 * sizeof(float) * (size_t)o->across);
    for (int row = compared->y / px; row < y1 && !e; row++)
        for (int col = compared->x / px; col < x1; col++) {
            float most = 0;
            for (int c = 0; c < 3; c++)
                most = fmaxf(most, fabsf(o->excess[(3 * row + c) * o->across + col]));
            score[row * o->across + col] = most;
        }
    return e;
}

/* ---- cells of one photograph ---- */

struct grid {
    int w, h;
};

static struct grid grid_of(const struct outliers *o, int k)
{
    const struct extent *px = &o->v->extent[k];
    return (struct grid){(px->w + o->px - 1) / o->px, (px->h + o->px - 1) / o->px};
}

static void mark_hits(struct outliers *o, int k)
{
    const struct grid g = grid_of(o, k);
    const float *score = o->score + (size_t)k * outliers_cells(o);
    uint8_t *hit = o->hit + (size_t)k * outliers_cells(o);
    size_t n = 0;
    for (int y = 0; y < g.h; y++)
        for (int x = 0; x < g.w; x++)
            if (score[y * o->across + x] >= 0)
                o->sorted[n++] = score[y * o->across + x];
    float least = fmaxf(SCORE_MIN, SCORE_MEDIANS * num_median(o->sorted, n));
    if ((float)n < SEEN * (float)(g.w * g.h))
        least = INFINITY;
    for (int y = 0; y < g.h; y++)
        for (int x = 0; x < g.w; x++)
            hit[y * o->across + x] = score[y * o->across + x] > least;
}

/* to: where at least `least` of the 3 x 3 cells of `from` are set. */
static void filter_cells(const struct outliers *o, struct grid g, const uint8_t *from, int least,
                         uint8_t *to)
{
    for (int i = 0; i < g.w * g.h; i++) {
        const int x = i % g.w, y = i / g.w;
        const int y1 = num_min(y + 2, g.h), x0 = num_max(x - 1, 0), x1 = num_min(x + 2, g.w);
        int n = 0;
        for (int row = num_max(y - 1, 0); row < y1; row++)
            for (int col = x0; col < x1; col++)
                n += from[row * o->across + col];
        to[y * o->across + x] = n >= least;
    }
}

/* ---- what other photographs say ---- */

/* One pixel for a cell. */
static struct camera cell_camera(const struct outliers *o, const struct camera *cam)
{
    return pose_scaled(cam, num_max(cam->w / o->px, 1), num_max(cam->h / o->px, 1));
}

static err_t draw_depths(const struct run *r, struct outliers *o, const struct raster *rs,
                         const struct scene *s)
{
    struct raster alone = *rs;
    alone.team = NULL;
    err_t e = OK;
    for (int i = 0; i < o->v->n && !e; i++) {
        const struct camera cam = cell_camera(o, &s->cams[i]);
        const struct raster_input in = {&s->g, &cam, {0, 0, 0}};
        float *depth = o->depth + (size_t)i * outliers_cells(o);
        struct render pic = {.radiance = o->radiance, .depth = depth, .alpha = o->alpha};
        e = raster_run(r, &alone, &in, &pic);
        for (int k = 0; k < cam.w * cam.h && !e; k++)
            depth[k] = o->alpha[k] < COVERED ? 0 : depth[k] / o->alpha[k];
    }
    return e;
}

/* Whether place j shows the point x of a surface; *cell: in its photographs. */
static bool shows(const struct outliers *o, const struct camera *cam, int j, const double x[3],
                  size_t *cell)
{
    const struct camera c = cell_camera(o, cam);
    float rotation[9];
    double p[3];
    rotation_from_unit(c.q, rotation);
    for (int k = 0; k < 3; k++)
        p[k] = (double)rotation[3 * k] * x[0] + (double)rotation[3 * k + 1] * x[1] +
               (double)rotation[3 * k + 2] * x[2] + (double)c.t[k];
    const double u = (double)c.fx * p[0] / p[2] + (double)c.cx;
    const double v = (double)c.fy * p[1] / p[2] + (double)c.cy;
    if (!(p[2] > 0 && u >= 0 && v >= 0 && u < c.w && v < c.h))
        return false;
    *cell = (size_t)v * (size_t)o->across + (size_t)u;
    const double there =
        (double)o->depth[(size_t)j * outliers_cells(o) + (size_t)v * (size_t)c.w + (size_t)u];
    return fabs(p[2] - there) <= (double)SAME * there;
}

/* The point that place i of the scene has in a cell. False: none. */
static bool point_in(const struct outliers *o, const struct camera *cam, int i, const int cell[2],
                     double out[3])
{
    const struct camera c = cell_camera(o, cam);
    const int u = num_min(cell[0], c.w - 1), v = num_min(cell[1], c.h - 1);
    const double z = (double)o->depth[(size_t)i * outliers_cells(o) + (size_t)(v * c.w + u)];
    const double p[3] = {(u + 0.5 - (double)c.cx) / (double)c.fx * z - (double)c.t[0],
                         (v + 0.5 - (double)c.cy) / (double)c.fy * z - (double)c.t[1],
                         z - (double)c.t[2]};
    float r[9];
    rotation_from_unit(c.q, r);
    for (int k = 0; k < 3; k++)
        out[k] = (double)r[k] * p[0] + (double)r[3 + k] * p[1] + (double)r[6 + k] * p[2];
    return z > 0;
}

static bool explained(const struct outliers *o, int k, size_t cell)
{
    const size_t at = (size_t)k * outliers_cells(o) + cell;
    return o->score[at] >= 0 && !o->hit[at];
}

/* Photographs that show the surface of a cell of photograph k as the scene has it. */
static int count_witnesses(const struct outliers *o, const struct scene *s, int k,
                           const int cell[2])
{
    const int i = place_of(o, k);
    double x[3];
    size_t at = (size_t)cell[1] * (size_t)o->across + (size_t)cell[0];
    int n = 0;
    for (int m = i; m >= 0; m = views_next(o->v, i, m))
        n += m != k && explained(o, m, at);
    if (!point_in(o, &s->cams[i], i, cell, x))
        return n;
    for (int j = 0; j < o->v->n; j++)
        n += j != i && shows(o, &s->cams[j], j, x, &at) && explained(o, j, at);
    return n;
}

static void find_patches(struct outliers *o, const struct scene *s, int k)
{
    const struct grid g = grid_of(o, k);
    const uint8_t *hit = o->hit + (size_t)k * outliers_cells(o);
    uint8_t *sure = o->patch, *skip = o->skip + (size_t)k * outliers_cells(o);
    size_t n = 0;
    for (int y = 0; y < g.h; y++)
        for (int x = 0; x < g.w; x++) {
            const int at = y * o->across + x;
            sure[at] = hit[at] && count_witnesses(o, s, k, (const int[2]){x, y}) >= WITNESSES;
        }
    filter_cells(o, g, sure, AGREE, skip);
    for (int y = 0; y < g.h; y++)
        for (int x = 0; x < g.w; x++)
            n += skip[y * o->across + x];
    o->share[k] = (float)n / (float)(g.w * g.h);
}

/* Patches and the cells around them; none, where most photographs have as many. */
static void leave_out_patches(struct outliers *o, int k, float usual)
{
    const size_t cells = outliers_cells(o);
    uint8_t *skip = o->skip + (size_t)k * cells;
    memcpy(o->patch, skip, cells);
    memset(skip, 0, cells);
    if (o->share[k] > 2 * usual + SHARE_MORE)
        filter_cells(o, grid_of(o, k), o->patch, 1, skip);
}

bool outliers_due(int step, int steps)
{
    static const int percent[] = {5, 10, 20, 40, 60, 80};
    for (size_t k = 0; k < sizeof percent / sizeof *percent; k++)
        if (step == (int)((int64_t)steps * percent[k] / 100))
            return true;
    return false;
}

err_t outliers_judge(const struct run *r, struct outliers *o, const struct raster *rs,
                     const struct scene *s, bool *changed)
{
    const int n = photos_of(o);
    const size_t cells = (size_t)n * outliers_cells(o);
    err_t e = draw_depths(r, o, rs, s);
    if (e)
        return e;
    memcpy(o->former, o->skip, cells);
    for (int k = 0; k < n; k++)
        mark_hits(o, k);
    for (int k = 0; k < n; k++)
        find_patches(o, s, k);
    memcpy(o->sorted, o->share, (size_t)n * sizeof *o->sorted);
    const float usual = num_median(o->sorted, (size_t)n);
    for (int k = 0; k < n; k++)
        leave_out_patches(o, k, usual);
    e = team_copy(r->team, o->skip, cells);
    *changed = memcmp(o->former, o->skip, cells) != 0;
    return e;
}

const uint8_t *outliers_skip(const struct outliers *o, int k)
{
    const size_t cells = outliers_cells(o);
    const uint8_t *skip = o->skip + (size_t)k * cells;
    return memchr(skip, 1, cells) ? skip : NULL;
}

float outliers_share(const struct outliers *o, int k)
{
    const struct grid g = grid_of(o, k);
    const uint8_t *skip = o->skip + (size_t)k * outliers_cells(o);
    int n = 0;
    for (int y = 0; y < g.h; y++)
        for (int x = 0; x < g.w; x++)
            n += skip[y * o->across + x] != 0;
    return (float)n / (float)(g.w * g.h);
}
