/* For each view: choose the others that have the most surfaces in common with it; draw the
 * confirmed surfaces of all into a depth buffer, which tells what is hidden; draw the light of one
 * other after another as the view would see it through that other's depth, and compare windows by
 * their correlation. Then the view with the largest share of contradictions is taken out, and
 * again, until none has too many: a wrong one makes the others suspicious, too. The median of the
 * others tells whether most are wrong: who passes by contradicts in some photographs only. */
#include "core/stereo/contradict.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/photo/response.h"
#include "core/stereo/visibility.h"

#include <math.h>
#include <string.h>

enum {
    OTHERS = 12, // views that a view is compared with
    COARSE = 8,  // px of the map between the points that choose them
    STEP = 3,    // px of the map between samples
    RADIUS = 3,  // px, of the window
    WINDOW = (2 * RADIUS + 1) * (2 * RADIUS + 1),
    KNOWN = WINDOW * 3 / 5, // pixels of a window that must be comparable
    FEW = 500,              // less than 1 contradiction of a view in so many px is chance,
    FEW_OF_ALL = 8000       // of all in so many px of theirs
};

static const float WEIGHT = 0.3f;      // least reliability of light (response.h)
static const float COS_APART = 0.906f; // 25 degrees between the rays of the two views
static const float SCALES2 = 2.56f;    // squared ratio of the distances
static const float ONE_PLACE = 0.005f; // distance of two cameras over a point's: no parallax
static const float DEPTHS = 1.28f;     // within a window, farthest over nearest: one surface
static const float NOISE_VAR = 0.02f;  // stops^2 added, so that noise does not correlate
static const float TEXTURE = 0.05f;    // stops^2, least variance of a window
static const float ALIKE = 0.6f, UNLIKE = 0.2f; // correlations
static const float ON = 0.05f;                  // relative difference of depths on one surface
static const float FRONT = 0.87f;               // depth over that of what is seen through it
static const float HIDDEN = 0.95f;              // a surface hides points beyond its depth over this

struct pair {
    int of, in; // samples of the first in the picture of the second
    int agree, contrary;
    int same; // of these, where both stand in one place
};

/* Of one worker, for the largest map. */
struct scratch {
    float *front; // (h, w) depth of the nearest confirmed surface of any view
    float *light; // (h, w of the other) light of the view where the other's surfaces are, NAN: none
};

struct comparison {
    const struct run *run;
    const struct views *v;
    const struct depthmaps *d;
    struct visibility vis;
    struct response_table table;
    float (*centre)[3];      // (n) of the cameras
    float *light;            // (maps) log2, 3 x 3 px smoothed
    bool *lit;               // (maps) reliable light, not of the background
    bool *sure;              // (maps) and a confirmed surface
    struct pair *pairs;      // (n, OTHERS) of what the first n_pairs[i] are used
    int *n_pairs;            // (n)
    float *sort;             // (n)
    struct scratch *scratch; // (workers)
};

/* ---- light ---- */

/* Log2 of the radiance of a pixel of the map. False: some of it is black, saturated or masked. */
static bool mean_light(const struct comparison *c, int view, int i, float *out)
{
    const struct extent *px = &c->v->extent[view];
    const int s = c->d->scale, w = c->d->extent[view].w;
    const uint8_t *rgb = views_rgb(c->v, view);
    float sum = 0, weight = 1;
    for (int k = 0; k < s * s; k++) {
        const int x = i % w * s + k % s, y = i / w * s + k / s;
        const uint8_t *z = rgb + 3 * ((size_t)y * (size_t)px->w + (size_t)x);
        for (int j = 0; j < 3; j++) {
            sum += c->table.x[j][z[j]];
            weight = fminf(weight, c->table.weight[j][z[j]]);
        }
    }
    *out = sum / (float)(3 * s * s);
    return weight > WEIGHT && !sweep_hides(c->d, c->v, view, i);
}

/* In place, n pixels that are `step` apart, by binomial weights. */
static void smooth_rows(float *px, int n, int step)
{
    float before = px[0];
    for (int i = 0; i < n; i++) {
        const float here = px[i * step], after = px[num_min(i + 1, n - 1) * step];
        px[i * step] = 0.25f * (before + after) + 0.5f * here;
        before = here;
    }
}

static err_t prepare_view(void *ctx, int view, int worker)
{
    struct comparison *c = ctx;
    const struct extent *map = &c->d->extent[view];
    float *light = c->light + map->at;
    (void)worker;
    for (int i = 0; i < map->w * map->h; i++) {
        const size_t at = map->at + (size_t)i;
        c->lit[at] = mean_light(c, view, i, &light[i]) && !sweep_far(c->d, at);
        c->sure[at] = c->lit[at] && visibility_confident(&c->vis, at);
    }
    for (int y = 0; y < map->h; y++)
        smooth_rows(light + y * map->w, map->w, 1);
    for (int x = 0; x < map->w; x++)
        smooth_rows(light + x, map->h, map->w);
    return OK;
}

/* ---- points ---- */

static void point_at(const struct comparison *c, int view, int i, float out[3])
{
    const struct extent *map = &c->d->extent[view];
    const float s = (float)c->d->scale;
    const float uvz[3] = {((float)(i % map->w) + 0.5f) * s, ((float)(i / map->w) + 0.5f) * s,
                          c->d->depth[map->at + (size_t)i]};
    visibility_unproject(&c->vis, view, uvz, out);
}

static float distance2(const float a[3], const float b[3])
{
    float sum = 0;
    for (int k = 0; k < 3; k++)
        sum += (a[k] - b[k]) * (a[k] - b[k]);
    return sum;
}

/* Whether another view sees the same there however far it is. */
static bool in_one_place(const struct comparison *c, int a, int b, const float point[3])
{
    return distance2(c->centre[a], c->centre[b]) <
           ONE_PLACE * ONE_PLACE * distance2(point, c->centre[a]);
}

/* The point of a pixel, if another view can be compared with it. */
static bool get_point(const struct comparison *c, int of, int in, int i, float out[3])
{
    const size_t at = c->d->extent[of].at + (size_t)i;
    if (!c->lit[at])
        return false;
    point_at(c, of, i, out);
    return c->sure[at] || in_one_place(c, of, in, out);
}

/* Whether two views see a point from about the same direction and distance. */
static bool seen_alike(const struct comparison *c, int a, int b, const float point[3])
{
    float aa = 0, bb = 0, ab = 0;
    for (int k = 0; k < 3; k++) {
        const float p = point[k] - c->centre[a][k], q = point[k] - c->centre[b][k];
        aa += p * p;
        bb += q * q;
        ab += p * q;
    }
    return ab > 0 && ab * ab > COS_APART * COS_APART * aa * bb && aa < SCALES2 * bb &&
           bb < SCALES2 * aa;
}

static int count_common(const struct comparison *c, int of, int in)
{
    const struct extent *map = &c->d->extent[of];
    int n = 0;
    for (int y = COARSE / 2; y < map->h; y += COARSE)
        for (int x = COARSE / 2; x < map->w; x += COARSE) {
            const int i = y * map->w + x;
            float point[3];
            struct projected p;
            n += get_point(c, of, in, i, point) && visibility_project(&c->vis, in, point, &p) &&
                 seen_alike(c, of, in, point);
        }
    return n;
}

/* Those with the most in common with the view, in that order. */
static void choose_others(struct comparison *c, int view)
{
    struct pair *pairs = c->pairs + view * OTHERS;
    int common[OTHERS], n = 0;
    for (int i = 0; i < c->d->n; i++) {
        const int now = i == view ? 0 : count_common(c, i, view);
        if (now == 0 || (n == OTHERS && now <= common[n - 1]))
            continue;
        int k = n < OTHERS ? n++ : n - 1;
        for (; k > 0 && common[k - 1] < now; k--) {
            common[k] = common[k - 1];
            pairs[k] = pairs[k - 1];
        }
        common[k] = now;
        pairs[k] = (struct pair){.of = i, .in = view};
    }
    c->n_pairs[view] = n;
}

static void draw_front(const struct comparison *c, int of, int view, float *front)
{
    const struct extent *map = &c->d->extent[of];
    for (int i = 0; i < map->w * map->h; i++) {
        float point[3];
        struct projected p;
        if (!c->sure[map->at + (size_t)i])
            continue;
        point_at(c, of, i, point);
        if (!visibility_project(&c->vis, view, point, &p))
            continue;
        float *z = front + (p.at - c->d->extent[view].at);
        *z = fminf(*z, p.z);
    }
}

/* Light of the view at px (u, v) of its map from its upper left, whose middle is at half a pixel;
 * NAN outside. */
static float light_at(const struct comparison *c, int view, float u, float v)
{
    const struct extent *map = &c->d->extent[view];
    const float x = u - 0.5f, y = v - 0.5f;
    if (!(x >= 0 && y >= 0 && x < (float)(map->w - 1) && y < (float)(map->h - 1)))
        return NAN;
    const int ix = (int)x, iy = (int)y;
    const float fx = x - (float)ix, fy = y - (float)iy;
    const float *p = c->light + map->at + (size_t)(iy * map->w + ix), *q = p + map->w;
    return (p[0] + fx * (p[1] - p[0])) * (1 - fy) + (q[0] + fx * (q[1] - q[0])) * fy;
}

static void draw_light(const struct comparison *c, int of, int view, float *light)
{
    const struct extent *map = &c->d->extent[of];
    const float s = (float)c->d->scale;
    for (int i = 0; i < map->w * map->h; i++) {
        float point[3];
        struct projected p;
        light[i] = NAN;
        if (get_point(c, of, view, i, point) && visibility_project(&c->vis, view, point, &p) &&
            !sweep_hides(c->d, c->v, view, (int)(p.at - c->d->extent[view].at)))
            light[i] = light_at(c, view, p.u / s, p.v / s);
    }
}

/* ---- samples ---- */

/* Correlation of the light of view `of` around pixel i with what is drawn there; NAN: faint, not
 * one surface, or too little of it. */
static float correlate(const struct comparison *c, int of, int i, const float *drawn)
{
    const struct extent *map = &c->d->extent[of];
    const float *light = c->light + map->at, *depth = c->d->depth + map->at;
    float n = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0, nearest = INFINITY, farthest = 0;
    for (int k = 0; k < WINDOW; k++) {
        const int at = i + (k / (2 * RADIUS + 1) - RADIUS) * map->w + k % (2 * RADIUS + 1) - RADIUS;
        if (isnan(drawn[at]))
            continue;
        const float p = light[at] - light[i], q = drawn[at] - drawn[i];
        n++;
        a += p;
        b += q;
        aa += p * p;
        bb += q * q;
        ab += p * q;
        nearest = fminf(nearest, depth[at]);
        farthest = fmaxf(farthest, depth[at]);
    }
    const float va = (aa - a * a / n) / n, vb = (bb - b * b / n) / n;
    if (n < (float)KNOWN || va < TEXTURE || farthest > DEPTHS * nearest)
        return NAN;
    return (ab - a * b / n) / n / sqrtf((va + NOISE_VAR) * (fmaxf(vb, 0) + NOISE_VAR));
}

/* Whether a confirmed surface is before the point, in the pixel or beside it. */
static bool is_hidden(const struct extent *map, const struct projected *p, const float *front)
{
    const int i = (int)(p->at - map->at), x = i % map->w, y = i / map->w;
    for (int v = num_max(0, y - 1); v <= num_min(map->h - 1, y + 1); v++)
        for (int u = num_max(0, x - 1); u <= num_min(map->w - 1, x + 1); u++)
            if (front[v * map->w + u] < HIDDEN * p->z)
                return true;
    return false;
}

static void take_sample(const struct comparison *c, const struct scratch *m, int i, struct pair *p)
{
    float point[3];
    struct projected to;
    if (isnan(m->light[i]))
        return;
    point_at(c, p->of, i, point);
    if (!visibility_project(&c->vis, p->in, point, &to) || !seen_alike(c, p->of, p->in, point) ||
        is_hidden(&c->d->extent[p->in], &to, m->front))
        return;
    const float alike = correlate(c, p->of, i, m->light), there = c->d->depth[to.at];
    const bool on = fabsf(there - to.z) < ON * to.z, sure = c->sure[to.at];
    const bool same = in_one_place(c, p->of, p->in, point);
    const bool agree = alike > ALIKE && (same || (sure && on));
    const bool contrary = alike < UNLIKE && (same || (sure ? to.z < FRONT * there : !on));
    p->agree += agree;
    p->contrary += contrary;
    p->same += same && (agree || contrary);
}

static err_t compare_view(void *ctx, int view, int worker)
{
    struct comparison *c = ctx;
    const struct scratch *m = &c->scratch[worker];
    const struct extent *own = &c->d->extent[view];
    choose_others(c, view);
    for (int i = 0; i < own->w * own->h; i++) {
        const size_t at = own->at + (size_t)i;
        m->front[i] = c->sure[at] ? c->d->depth[at] : INFINITY;
    }
    for (int k = 0; k < c->n_pairs[view]; k++)
        draw_front(c, c->pairs[view * OTHERS + k].of, view, m->front);
    for (int k = 0; k < c->n_pairs[view]; k++) {
        struct pair *p = &c->pairs[view * OTHERS + k];
        const struct extent *map = &c->d->extent[p->of];
        draw_light(c, p->of, view, m->light);
        for (int y = RADIUS; y < map->h - RADIUS; y += STEP)
            for (int x = RADIUS; x < map->w - RADIUS; x += STEP)
                take_sample(c, m, y * map->w + x, p);
    }
    if (c->run->cancel && atomic_load(c->run->cancel))
        return err_fail(ERR_CANCELLED, "contradict: cancelled at view %d", view);
    return OK;
}

/* ---- judgement ---- */

static float share_contrary(const struct pair *p)
{
    return p->contrary > 0 ? (float)p->contrary / (float)(p->agree + p->contrary) : 0;
}

/* What others that are not wrong have in the picture of a view, without the quarter of them that
 * contradicts most: there their depth may be wrong, unless it does not matter. */
static struct pair sum_samples(const struct comparison *c, const bool *wrong, int view)
{
    struct pair sum = {.in = view}, used[OTHERS];
    int n = 0;
    for (int i = 0; i < c->n_pairs[view]; i++) {
        const struct pair now = c->pairs[view * OTHERS + i];
        int k = n;
        if (wrong[now.of])
            continue;
        if (2 * now.same > now.agree + now.contrary) {
            sum.agree += now.agree;
            sum.contrary += now.contrary;
            continue;
        }
        for (; k > 0 && share_contrary(&used[k - 1]) < share_contrary(&now); k--)
            used[k] = used[k - 1];
        used[k] = now;
        n++;
    }
    for (int k = (n + 3) / 4; k < n; k++) {
        sum.agree += used[k].agree;
        sum.contrary += used[k].contrary;
    }
    return sum;
}

/* The view that is wrong by most, -1: none is. */
static int find_wrong(const struct comparison *c, struct contradict *out)
{
    float most = CONTRADICT_VIEW;
    int worst = -1;
    for (int i = 0; i < c->d->n; i++) {
        if (out->wrong[i])
            continue;
        const struct pair sum = sum_samples(c, out->wrong, i);
        out->of_view[i] = share_contrary(&sum);
        if (out->of_view[i] > most &&
            (size_t)sum.contrary * FEW > extent_pixels(&c->d->extent[i])) {
            most = out->of_view[i];
            worst = i;
        }
    }
    return worst;
}

static void judge_views(const struct comparison *c, struct contradict *out)
{
    struct pair all = {0};
    int i, n = 0;
    while ((i = find_wrong(c, out)) >= 0) {
        out->wrong[i] = true;
        out->n_wrong++;
    }
    for (i = 0; i < c->d->n; i++) {
        const struct pair sum = sum_samples(c, out->wrong, i);
        if (!out->wrong[i] && sum.agree + sum.contrary > 0) {
            c->sort[n++] = out->of_view[i];
            all.contrary += sum.contrary;
        }
    }
    if ((size_t)all.contrary * FEW_OF_ALL > extent_total(c->d->extent, c->d->n))
        out->median = num_median(c->sort, (size_t)n);
}

/* ---- memory and entry ---- */

static err_t layout_result(struct contradict *out, struct arena *a, int n)
{
    err_t e = arena_zalloc(a, (size_t)n, sizeof *out->wrong, &out->wrong);
    return e ? e : arena_zalloc(a, (size_t)n, sizeof *out->of_view, &out->of_view);
}

/* A counting arena has no memory for the list of the workers. */
static err_t layout(struct comparison *c, struct arena *a, const struct extent *maps, int n,
                    int workers)
{
    const size_t pixels = extent_total(maps, n), most = extent_cover(maps, n).at, views = (size_t)n;
    err_t e = visibility_layout(&c->vis, a, n);
    if (!e)
        e = arena_alloc(a, views, sizeof *c->centre, &c->centre);
    if (!e)
        e = arena_alloc(a, pixels, sizeof *c->light, &c->light);
    if (!e)
        e = arena_alloc(a, pixels, sizeof *c->lit, &c->lit);
    if (!e)
        e = arena_alloc(a, pixels, sizeof *c->sure, &c->sure);
    if (!e)
        e = arena_zalloc(a, views * OTHERS, sizeof *c->pairs, &c->pairs);
    if (!e)
        e = arena_zalloc(a, views, sizeof *c->n_pairs, &c->n_pairs);
    if (!e)
        e = arena_alloc(a, views, sizeof *c->sort, &c->sort);
    if (!e)
        e = arena_alloc(a, (size_t)workers, sizeof *c->scratch, &c->scratch);
    for (int i = 0; i < workers && !e; i++) {
        struct scratch one = {NULL, NULL};
        e = arena_alloc(a, most, sizeof *one.front, &one.front);
        if (!e)
            e = arena_alloc(a, most, sizeof *one.light, &one.light);
        if (!e && !a->counts)
            c->scratch[i] = one;
    }
    return e;
}

void contradict_plan(struct plan *p, const struct extent *maps, int n)
{
    struct contradict out;
    struct comparison c;
    const size_t mark = arena_mark(&p->tmp);
    if (layout_result(&out, &p->tmp, n) || layout(&c, &p->tmp, maps, n, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

static void set_scene(struct comparison *c, const struct tonemap *tone)
{
    response_tabulate(tone, &c->table);
    visibility_set(&c->vis, c->d, c->v->cams);
    for (int i = 0; i < c->d->n; i++) {
        double centre[3];
        rotation_centre(&c->v->cams[i], centre);
        for (int k = 0; k < 3; k++)
            c->centre[i][k] = (float)centre[k];
    }
}

err_t contradict_run(const struct run *r, const struct views *v, const struct tonemap *tone,
                     const struct depthmaps *d, struct contradict *out)
{
    struct comparison c = {.run = r, .v = v, .d = d};
    memset(out, 0, sizeof *out);
    err_t e = layout_result(out, r->tmp, d->n);
    const size_t mark = arena_mark(r->tmp);
    if (!e)
        e = layout(&c, r->tmp, d->extent, d->n, pool_size(r->pool));
    if (!e) {
        set_scene(&c, tone);
        e = pool_for(r->pool, d->n, prepare_view, &c);
    }
    if (!e)
        e = pool_for(r->pool, d->n, compare_view, &c);
    if (!e)
        judge_views(&c, out);
    arena_reset(r->tmp, mark);
    return e;
}
