#include "core/refine/confidence.h"

#include "core/base/gaussians.h"
#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/base/shell.h"
#include "core/photo/shade.h"
#include "core/photo/tonemap.h"
#include "core/sfm/pose.h"
#include "core/splat/raster.h"

#include <math.h>
#include <string.h>

enum { EDGE = 192, BLOCK = 4096, ADVISERS = 4, AROUND = 2 }; // px; splats; input views; px

static const float BEHIND = 1.05f; // times the depth there: hidden
static const float COVERED = 0.5f; // alpha from which a pixel hides what is behind
static const float AGREES = 0.06f; // display value
static const double ANGLE = 2 * NUM_PI / 180;
static const float LEAST = 1e-4f;   // confidence that is drawn as none
static const float KNOWN = 0.2f;    // mean confidence of a picture that can be placed
static const float USEFUL = 0.005f; // gain worth a photograph

/* Workspace. */
struct confidence {
    float *seen;   // (cap) weight of the photographs that see the splat
    float *ray[3]; // (cap) weighted sum of the unit vectors from them to it
    float *colour; // (cap) of a drawing
    float *error;  // (h, w) of the maps: difference of photograph and scene; then its mean around
    float *weight; // (h, w) exp(-(e / AGREES)^2)
    struct raster raster;
    struct render maps;
};

static err_t layout(struct confidence *c, struct arena *a, int cap)
{
    const size_t n = (size_t)(cap > 0 ? cap : 1), px = (size_t)EDGE * EDGE;
    err_t e = raster_init(&c->raster, a, (int)n, EDGE, EDGE, false);
    float **const planes[] = {&c->seen, &c->ray[0], &c->ray[1], &c->ray[2], &c->colour};
    float **const maps[] = {&c->maps.depth, &c->maps.alpha, &c->error, &c->weight};
    for (size_t k = 0; k < sizeof planes / sizeof *planes && !e; k++)
        e = arena_alloc(a, n, sizeof(float), planes[k]);
    for (size_t k = 0; k < sizeof maps / sizeof *maps && !e; k++)
        e = arena_alloc(a, px, sizeof(float), maps[k]);
    return e ? e : arena_alloc(a, 3 * px, sizeof(float), &c->maps.radiance);
}

static err_t layout_result(struct scene *s, struct arena *keep, int cap)
{
    return arena_alloc(keep, (size_t)(cap > 0 ? cap : 1), sizeof *s->confidence, &s->confidence);
}

void confidence_plan(struct plan *p, int cap)
{
    struct confidence c;
    struct scene s;
    const size_t mark = arena_mark(&p->tmp);
    if (layout(&c, &p->tmp, gaussians_cap(cap)) || layout_result(&s, &p->keep, gaussians_cap(cap)))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

/* ---- what one camera sees ---- */

struct survey {
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
static err_t draw_view(const struct run *r, struct survey *l, const struct gaussians *g,
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

/* Whether the camera of the maps sees splat i, and at which pixel. */
static bool splat_visible(const struct survey *l, int i, size_t *pixel)
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
    *pixel = at;
    const float front = maps->depth[at] / maps->alpha[at];
    return maps->alpha[at] < COVERED || p[2] <= BEHIND * front + expf(wide);
}

/* Confidence by photographs of weight n whose weighted rays have the sum `ray`. Two rays make an
 * angle of twice that between each and their mean. */
static float confidence_value(float n, const float ray[3], bool far)
{
    if (!(n > 1))
        return 0;
    const float agree = 1 - exp2f(1 - n);
    const double x[3] = {(double)ray[0], (double)ray[1], (double)ray[2]};
    const double angle = 2 * acos(fmin(sqrt(lin_dot(x, x)) / (double)n, 1));
    return far ? agree : agree * (float)(angle * angle / (angle * angle + ANGLE * ANGLE));
}

/* Unit vector from the camera of the maps to splat i. */
static void ray_to(const struct survey *l, int i, float ray[3])
{
    float length = 0;
    splat_at(l->s, i, ray);
    for (int k = 0; k < 3; k++) {
        ray[k] -= l->centre[k];
        length += ray[k] * ray[k];
    }
    length = length > 0 ? sqrtf(length) : 1;
    for (int k = 0; k < 3; k++)
        ray[k] /= length;
}

/* With a photograph of weight 1 or 0 more from the camera of the maps. */
static float value_with(const struct survey *l, int i, float more)
{
    const struct confidence *c = l->c;
    float x[3], ray[3];
    splat_at(l->s, i, x);
    ray_to(l, i, ray);
    for (int k = 0; k < 3; k++)
        ray[k] = more * ray[k] + c->ray[k][i];
    return confidence_value(c->seen[i] + more, ray, shell_has(&l->shell, x));
}

/* ---- photographs ---- */

/* Mean display value of colour c of the photograph in pixel (x, y) of the maps. */
static float photo_mean(const struct views *v, int view, const int xyc[3],
                        const struct render *maps)
{
    const struct extent *px = &v->extent[view];
    const uint8_t *rgb = views_rgb(v, view) + xyc[2];
    const int x0 = xyc[0] * px->w / maps->w, x1 = num_max(x0 + 1, (xyc[0] + 1) * px->w / maps->w);
    const int y0 = xyc[1] * px->h / maps->h, y1 = num_max(y0 + 1, (xyc[1] + 1) * px->h / maps->h);
    int sum = 0;
    for (int y = y0; y < y1; y++)
        for (int x = x0; x < x1; x++)
            sum += rgb[3 * ((size_t)y * (size_t)px->w + (size_t)x)];
    return (float)sum / (255.0f * (float)((x1 - x0) * (y1 - y0)));
}

/* Whether pixel (x, y) of the maps has a masked one of the photograph in it. */
static bool photo_hides(const struct views *v, int view, int x, int y, const struct render *maps)
{
    const struct extent *px = &v->extent[view];
    const int x0 = x * px->w / maps->w, y0 = y * px->h / maps->h;
    const int n = num_max(1, px->w / maps->w);
    return views_hides_any(v, view, x0, y0, num_min(n, px->h - y0));
}

/* The maps show view i; their radiance becomes display values. */
static void compare_photo(const struct survey *l, const struct views *v, int i)
{
    struct confidence *c = l->c;
    struct render *maps = &c->maps;
    const size_t px = (size_t)maps->w * (size_t)maps->h;
    struct tonemap_table table;
    tonemap_table_init(&table, &l->s->tone);
    if (v->shade)
        shade_apply(NULL, &v->shade[i], maps->w, maps->h, maps->radiance);
    memset(c->error, 0, px * sizeof *c->error);
    for (int k = 0; k < 3; k++) {
        float *display = maps->radiance + px * (size_t)k;
        tonemap_run(&table.c[k], display, v->log2t[i] - l->s->tone.mid_log2t, px, display);
        for (int y = 0; y < maps->h; y++)
            for (int x = 0; x < maps->w; x++) {
                const size_t at = (size_t)y * (size_t)maps->w + (size_t)x;
                const float d = display[at] - photo_mean(v, i, (const int[3]){x, y, k}, maps);
                c->error[at] += photo_hides(v, i, x, y, maps) ? 0 : fabsf(d) / 3;
            }
    }
}

static float mean_around(const float *map, int w, int h, int at)
{
    float sum = 0;
    const int x = at % w, y = at / w;
    const int x0 = num_max(0, x - AROUND), x1 = num_min(w - 1, x + AROUND);
    const int y0 = num_max(0, y - AROUND), y1 = num_min(h - 1, y + AROUND);
    for (int j = y0; j <= y1; j++)
        for (int i = x0; i <= x1; i++)
            sum += map[j * w + i];
    return sum / (float)((x1 - x0 + 1) * (y1 - y0 + 1));
}

/* A masked pixel proves nothing. */
static void weigh_agreement(struct confidence *c, const struct views *v, int view)
{
    for (int at = 0; at < c->maps.w * c->maps.h; at++) {
        const float e = mean_around(c->error, c->maps.w, c->maps.h, at) / AGREES;
        const bool hidden = photo_hides(v, view, at % c->maps.w, at / c->maps.w, &c->maps);
        c->weight[at] = hidden ? 0 : expf(-e * e);
    }
}

/* ---- splats ---- */

static int count_blocks(const struct scene *s)
{
    return (s->g.n + BLOCK - 1) / BLOCK;
}

static err_t count_chunk(void *ctx, int chunk, int worker)
{
    const struct survey *l = ctx;
    struct confidence *c = l->c;
    const int end = num_min(l->s->g.n, (chunk + 1) * BLOCK);
    (void)worker;
    for (int i = chunk * BLOCK; i < end; i++) {
        size_t at;
        float ray[3];
        if (!splat_visible(l, i, &at))
            continue;
        ray_to(l, i, ray);
        c->seen[i] += c->weight[at];
        for (int k = 0; k < 3; k++)
            c->ray[k][i] += c->weight[at] * ray[k];
    }
    return OK;
}

static float drawn_as(float confidence)
{
    return (float)((double)logf(fmaxf(confidence, LEAST)) / SH_BASIS0);
}

static err_t gain_chunk(void *ctx, int chunk, int worker)
{
    const struct survey *l = ctx;
    const int end = num_min(l->s->g.n, (chunk + 1) * BLOCK);
    (void)worker;
    for (int i = chunk * BLOCK; i < end; i++) {
        size_t at;
        l->c->colour[i] =
            drawn_as(splat_visible(l, i, &at) ? value_with(l, i, 1) - value_with(l, i, 0) : 0);
    }
    return OK;
}

static void share_splats(const struct scene *s, float *colour, struct gaussians *g)
{
    *g = s->g;
    g->degree = 0;
    for (int k = 0; k < 3; k++)
        g->plane[G_SH + k] = colour;
}

void confidence_splats(const struct scene *s, float *colour, struct gaussians *out)
{
    for (int i = 0; i < s->g.n; i++)
        colour[i] = drawn_as(s->confidence[i]);
    share_splats(s, colour, out);
}

/* Number of photographs that agree with each splat. */
static err_t count_photographs(const struct run *r, struct survey *l, const struct views *v)
{
    struct confidence *c = l->c;
    float *const planes[] = {c->seen, c->ray[0], c->ray[1], c->ray[2]};
    err_t e = OK;
    for (int k = 0; k < 4; k++)
        memset(planes[k], 0, (size_t)l->s->g.n * sizeof(float));
    for (int i = 0; i < l->s->n_views && !e; i++) {
        const struct camera cam = small_camera(&l->s->cams[i]);
        e = draw_view(r, l, &l->s->g, &cam);
        if (e)
            break;
        compare_photo(l, v, i);
        weigh_agreement(c, v, i);
        e = pool_for(r->pool, count_blocks(l->s), count_chunk, l);
    }
    return e;
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
static err_t measure_gain(const struct run *r, struct survey *l, const struct camera *cam,
                          float *gain)
{
    const struct camera small = small_camera(cam);
    struct gaussians g;
    *gain = 0;
    confidence_splats(l->s, l->c->colour, &g);
    err_t e = draw_view(r, l, &g, &small);
    if (e || map_mean(&l->c->maps) < KNOWN)
        return e;
    e = pool_for(r->pool, count_blocks(l->s), gain_chunk, l);
    if (!e)
        e = draw_view(r, l, &g, &small);
    *gain = e ? 0 : map_mean(&l->c->maps);
    return e;
}

/* Whether there is a photograph from about there: nearer than half the way from camera `from`. */
static bool is_taken(const struct scene *s, const struct camera *from, const struct camera *cam)
{
    double start[3], there[3], way[3], off[3];
    rotation_centre(from, start);
    rotation_centre(cam, there);
    for (int k = 0; k < 3; k++)
        way[k] = there[k] - start[k];
    for (int i = 0; i < s->n_views; i++) {
        rotation_centre(&s->cams[i], off);
        for (int k = 0; k < 3; k++)
            off[k] -= there[k];
        if (lin_dot(off, off) < lin_dot(way, way) / 4)
            return true;
    }
    return false;
}

static err_t advise_near(const struct run *r, struct survey *l, int view,
                         struct confidence_advice *best)
{
    const struct camera *cam = &l->s->cams[view], small = small_camera(cam);
    err_t e = draw_view(r, l, &l->s->g, &small);
    const float depth = e ? 0 : median_depth(&l->c->maps);
    for (int way = 0; way < CONFIDENCE_WAYS && depth > 0 && !e; way++) {
        struct confidence_advice a = {camera_around(cam, depth, way), view, way, 0};
        if (is_taken(l->s, cam, &a.cam))
            continue;
        e = measure_gain(r, l, &a.cam, &a.gain);
        if (!e && a.gain > fmaxf(best->gain, USEFUL))
            *best = a;
    }
    return e;
}

static err_t suggest_photograph(const struct run *r, struct survey *l,
                                struct confidence_advice *out)
{
    const int views = l->s->n_views, n = num_min(views, ADVISERS), rank = team_rank(r->team);
    struct confidence_advice best[TEAM_MAX];
    err_t e = OK;
    best[rank] = (struct confidence_advice){.near = -1};
    for (int i = team_first(r->team, n, rank); i < team_first(r->team, n, rank + 1) && !e; i++)
        e = advise_near(r, l, n > 1 ? i * (views - 1) / (n - 1) : 0, &best[rank]);
    if (!e)
        e = team_collect(r->team, best, sizeof *best);
    *out = best[0];
    for (int i = 1; i < team_size(r->team) && !e; i++)
        if (best[i].near >= 0 && best[i].gain > out->gain)
            *out = best[i];
    return e;
}

static err_t measure_splats(const struct run *r, struct survey *l, const struct views *v,
                            float *out)
{
    err_t e = layout(l->c, r->tmp, l->s->g.cap);
    if (!e)
        e = count_photographs(r, l, v);
    for (int i = 0; i < l->s->g.n && !e; i++)
        out[i] = value_with(l, i, 0);
    return e;
}

size_t confidence_need(int cap)
{
    struct arena a = arena_counter();
    struct confidence c;
    return layout(&c, &a, gaussians_cap(cap)) ? SIZE_MAX : a.peak;
}

err_t confidence_measure(const struct run *r, const struct views *v, const struct scene *s,
                         float *out)
{
    struct confidence c;
    struct survey l = {.c = &c, .s = s, .shell = shell_of(s->cams, s->n_views)};
    const size_t mark = arena_mark(r->tmp);
    err_t e = measure_splats(r, &l, v, out);
    arena_reset(r->tmp, mark);
    return e;
}

err_t confidence_run(const struct run *r, const struct views *v, struct scene *s,
                     struct confidence_advice *advice)
{
    struct confidence c;
    struct survey l = {.c = &c, .s = s, .shell = shell_of(s->cams, s->n_views)};
    const size_t mark = arena_mark(r->tmp);
    err_t e = layout_result(s, r->keep, s->g.cap);
    if (!e)
        e = measure_splats(r, &l, v, s->confidence);
    if (!e)
        e = suggest_photograph(r, &l, advice);
    arena_reset(r->tmp, mark);
    return e;
}
