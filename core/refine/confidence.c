#include "core/refine/confidence.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/base/shell.h"
#include "core/sfm/pose.h"

#include <math.h>
#include <string.h>

enum { EDGE = 192, BLOCK = 4096, ADVISERS = 8 }; // px; splats; input views

static const float BEHIND = 1.05f; // times the depth there: hidden
static const float COVERED = 0.5f; // alpha from which a pixel hides what is behind
static const double ANGLE = 2 * NUM_PI / 180;
static const float LEAST = 1e-4f;   // confidence that is drawn as none
static const float KNOWN = 0.3f;    // mean confidence of a picture that can be placed
static const float USEFUL = 0.005f; // gain worth a photograph

static err_t layout(struct confidence *c, struct arena *a, int cap)
{
    const size_t n = (size_t)(cap > 0 ? cap : 1), px = (size_t)EDGE * EDGE;
    err_t e = raster_init(&c->raster, a, (int)n, EDGE, EDGE, false);
    float **const planes[] = {&c->g.plane[G_SH], &c->seen,   &c->ray[0],
                              &c->ray[1],        &c->ray[2], &c->gain};
    for (size_t k = 0; k < sizeof planes / sizeof *planes && !e; k++)
        e = arena_alloc(a, n, sizeof(float), planes[k]);
    if (!e)
        e = arena_alloc(a, 3 * px, sizeof(float), &c->maps.radiance);
    if (!e)
        e = arena_alloc(a, px, sizeof(float), &c->maps.depth);
    return e ? e : arena_alloc(a, px, sizeof(float), &c->maps.alpha);
}

size_t confidence_plan(int cap)
{
    struct arena count = arena_counter();
    struct confidence c;
    return layout(&c, &count, cap) ? SIZE_MAX : count.peak;
}

err_t confidence_init(struct confidence *c, struct arena *a, int cap)
{
    memset(c, 0, sizeof *c);
    return layout(c, a, cap);
}

/* ---- what one camera sees ---- */

struct look {
    struct confidence *c;
    const struct scene *s;
    struct shell shell;
    struct camera cam; // of c->maps
    float rotation[9], centre[3];
};

static struct camera small_camera(const struct camera *cam)
{
    const int edge = num_max(cam->w, cam->h);
    return pose_scaled(cam, num_max(1, cam->w * EDGE / edge), num_max(1, cam->h * EDGE / edge));
}

/* Draw `g` from cam into the maps. */
static err_t draw(const struct run *r, struct look *l, const struct gaussians *g,
                  const struct camera *cam)
{
    const struct raster_input in = {g, cam, {0, 0, 0}};
    double centre[3];
    l->cam = *cam;
    rotation_from_unit(cam->q, l->rotation);
    rotation_centre(cam, centre);
    for (int k = 0; k < 3; k++)
        l->centre[k] = (float)centre[k];
    return raster_run(r, &l->c->raster, &in, &l->c->maps);
}

static void splat_at(const struct scene *s, int i, float x[3])
{
    for (int k = 0; k < 3; k++)
        x[k] = s->g.plane[G_MU + k][i];
}

/* Whether the camera of the maps sees splat i. */
static bool sees(const struct look *l, int i)
{
    const struct camera *cam = &l->cam;
    const struct render *maps = &l->c->maps;
    const float *r = l->rotation;
    float x[3], p[3], wide = -INFINITY;
    splat_at(l->s, i, x);
    for (int k = 0; k < 3; k++) {
        p[k] = r[3 * k] * x[0] + r[3 * k + 1] * x[1] + r[3 * k + 2] * x[2] + cam->t[k];
        wide = fmaxf(wide, l->s->g.plane[G_LOG_SCALE + k][i]);
    }
    const float u = cam->fx * p[0] / p[2] + cam->cx, v = cam->fy * p[1] / p[2] + cam->cy;
    if (!(p[2] > RASTER_NEAR && u >= 0 && v >= 0 && u < (float)cam->w && v < (float)cam->h))
        return false;
    const size_t at = (size_t)v * (size_t)maps->w + (size_t)u;
    const float front = maps->depth[at] / maps->alpha[at];
    return maps->alpha[at] < COVERED || p[2] <= BEHIND * front + expf(wide);
}

/* Of n photographs whose unit rays have the sum `ray`. The rays of two make an angle of twice that
 * between each and their mean. */
static float confidence_value(float n, const float ray[3], bool far)
{
    if (n < 2)
        return 0;
    const float agree = 1 - exp2f(1 - n);
    const double x[3] = {(double)ray[0], (double)ray[1], (double)ray[2]};
    const double angle = 2 * acos(fmin(sqrt(lin_dot(x, x)) / (double)n, 1));
    return far ? agree : agree * (float)(angle * angle / (angle * angle + ANGLE * ANGLE));
}

/* With one more photograph from the camera of the maps, if it sees it. */
static float value_with(const struct look *l, int i, bool more)
{
    const struct confidence *c = l->c;
    float x[3], ray[3] = {c->ray[0][i], c->ray[1][i], c->ray[2][i]}, n = c->seen[i], length = 0;
    splat_at(l->s, i, x);
    for (int k = 0; k < 3; k++)
        length += (x[k] - l->centre[k]) * (x[k] - l->centre[k]);
    length = sqrtf(length);
    for (int k = 0; k < 3 && more && length > 0; k++)
        ray[k] += (x[k] - l->centre[k]) / length;
    return confidence_value(more ? n + 1 : n, ray, shell_has(&l->shell, x));
}

static int count_blocks(const struct scene *s)
{
    return (s->g.n + BLOCK - 1) / BLOCK;
}

static err_t count_chunk(void *ctx, int chunk, int worker)
{
    const struct look *l = ctx;
    const int end = num_min(l->s->g.n, (chunk + 1) * BLOCK);
    (void)worker;
    for (int i = chunk * BLOCK; i < end; i++) {
        float x[3], length = 0;
        if (!sees(l, i))
            continue;
        splat_at(l->s, i, x);
        for (int k = 0; k < 3; k++)
            length += (x[k] - l->centre[k]) * (x[k] - l->centre[k]);
        length = sqrtf(length);
        l->c->seen[i]++;
        for (int k = 0; k < 3 && length > 0; k++)
            l->c->ray[k][i] += (x[k] - l->centre[k]) / length;
    }
    return OK;
}

static float drawn_as(float confidence)
{
    return (float)((double)logf(fmaxf(confidence, LEAST)) / SH_BASIS0);
}

static err_t value_chunk(void *ctx, int chunk, int worker)
{
    const struct look *l = ctx;
    const int end = num_min(l->s->g.n, (chunk + 1) * BLOCK);
    (void)worker;
    for (int i = chunk * BLOCK; i < end; i++)
        l->c->g.plane[G_SH][i] = drawn_as(value_with(l, i, false));
    return OK;
}

static err_t gain_chunk(void *ctx, int chunk, int worker)
{
    const struct look *l = ctx;
    const int end = num_min(l->s->g.n, (chunk + 1) * BLOCK);
    (void)worker;
    for (int i = chunk * BLOCK; i < end; i++)
        l->c->gain[i] = drawn_as(sees(l, i) ? value_with(l, i, true) - value_with(l, i, false) : 0);
    return OK;
}

static struct look look_at(struct confidence *c, const struct scene *s)
{
    return (struct look){.c = c, .s = s, .shell = shell_of(s->cams, s->n_views)};
}

/* The scene's splats with other colours. */
static void share_splats(const struct scene *s, float *colour, struct gaussians *g)
{
    *g = s->g;
    g->degree = 0;
    for (int k = 0; k < 3; k++)
        g->plane[G_SH + k] = colour;
}

err_t confidence_run(const struct run *r, struct confidence *c, const struct scene *s)
{
    struct look l = look_at(c, s);
    err_t e = OK;
    float *const planes[] = {c->seen, c->ray[0], c->ray[1], c->ray[2]};
    for (int k = 0; k < 4; k++)
        memset(planes[k], 0, (size_t)s->g.n * sizeof(float));
    for (int i = 0; i < s->n_views && !e; i++) {
        const struct camera cam = small_camera(&s->cams[i]);
        e = draw(r, &l, &s->g, &cam);
        if (!e)
            e = pool_for(r->pool, count_blocks(s), count_chunk, &l);
    }
    share_splats(s, c->g.plane[G_SH], &c->g);
    return e ? e : pool_for(r->pool, count_blocks(s), value_chunk, &l);
}

float confidence_of(const struct confidence *c, int i)
{
    const float v = expf((float)SH_BASIS0 * c->g.plane[G_SH][i]);
    return v <= 1.01f * LEAST ? 0 : v;
}

/* ---- one more photograph ---- */

static float map_mean(const struct render *maps)
{
    const size_t n = (size_t)maps->w * (size_t)maps->h;
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += (double)maps->radiance[i];
    return (float)(sum / (double)n);
}

/* Median depth of what the maps show; 0 if they are empty. The radiance is spoilt. */
static float median_depth(const struct render *maps)
{
    const size_t px = (size_t)maps->w * (size_t)maps->h;
    size_t n = 0;
    for (size_t i = 0; i < px; i++)
        if (maps->alpha[i] > COVERED)
            maps->radiance[n++] = maps->depth[i] / maps->alpha[i];
    return num_median(maps->radiance, n);
}

/* cam on a circle around the point at `depth` before it. */
static struct camera camera_around(const struct camera *cam, float depth, enum confidence_way way)
{
    const double turn = CONFIDENCE_STEP * NUM_PI / 180;
    double r[9], axis[3], about[9], turned[9], point[3], q[4];
    struct camera out = *cam;
    rotation_of_camera(cam, r);
    rotation_centre(cam, point);
    /* turned about the camera's y, which points down, it goes to the left */
    const bool level = way == CONFIDENCE_LEFT || way == CONFIDENCE_RIGHT;
    const double sign = way == CONFIDENCE_LEFT || way == CONFIDENCE_BELOW ? 1 : -1;
    for (int k = 0; k < 3; k++) {
        axis[k] = sign * turn * r[(level ? 3 : 0) + k];
        point[k] += (double)depth * r[6 + k];
    }
    rotation_exp(axis, about);
    lin_product_t(r, about, turned);
    rotation_to_quat(turned, q);
    for (int i = 0; i < 3; i++) {
        double t = (double)cam->t[i];
        for (int k = 0; k < 3; k++)
            t += (r[3 * i + k] - turned[3 * i + k]) * point[k];
        out.t[i] = (float)t;
    }
    for (int k = 0; k < 4; k++)
        out.q[k] = (float)q[k];
    return out;
}

/* gain: what a photograph from cam proves; 0 if it could hardly be placed. */
static err_t measure_gain(const struct run *r, struct look *l, const struct camera *cam,
                          float *gain)
{
    const struct camera small = small_camera(cam);
    struct gaussians g;
    *gain = 0;
    err_t e = draw(r, l, &l->c->g, &small);
    if (e || map_mean(&l->c->maps) < KNOWN)
        return e;
    e = pool_for(r->pool, count_blocks(l->s), gain_chunk, l);
    share_splats(l->s, l->c->gain, &g);
    if (!e)
        e = draw(r, l, &g, &small);
    *gain = e ? 0 : map_mean(&l->c->maps);
    return e;
}

static err_t advise_near(const struct run *r, struct look *l, int view,
                         struct confidence_advice *best)
{
    const struct camera *cam = &l->s->cams[view], small = small_camera(cam);
    err_t e = draw(r, l, &l->c->g, &small);
    const float depth = e ? 0 : median_depth(&l->c->maps);
    for (int way = 0; way < CONFIDENCE_WAYS && depth > 0 && !e; way++) {
        struct confidence_advice a = {camera_around(cam, depth, way), view, way, 0};
        e = measure_gain(r, l, &a.cam, &a.gain);
        if (!e && a.gain > fmaxf(best->gain, USEFUL))
            *best = a;
    }
    return e;
}

err_t confidence_advise(const struct run *r, struct confidence *c, const struct scene *s,
                        struct confidence_advice *out)
{
    struct look l = look_at(c, s);
    const int n = num_min(s->n_views, ADVISERS);
    err_t e = OK;
    *out = (struct confidence_advice){.near = -1};
    for (int i = 0; i < n && !e; i++)
        e = advise_near(r, &l, n > 1 ? i * (s->n_views - 1) / (n - 1) : 0, out);
    return e;
}
