/* A world is made and prepared once, then its views are drawn: each by one worker where there are
 * enough of them, else one after the other by all. The exposure meter takes the median luminance of
 * every view and the middle one of these. */
#include "sim/train/sample.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/similarity.h"
#include "sim/world/vec.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

enum { SIZE_LEAST = 14, WORKERS_MAX = 64, STOPS_MAX = 40, SEEDS = 64 };

static const double KEY_LEVEL = 0.18;    // relative to full scale: a grey card
static const double LIGHT_LEAST = 1e-4;  // darkest radiance that the meter follows
static const double EXPOSURE_MAX = 3600; // s, of a sensor

/* Electrons at full scale: of the full well, or of the converter's last code. */
static double full_scale(const struct sensor *s)
{
    double codes = ((1 << s->bits) - 1 - s->black) / (double)s->gain;
    return codes < (double)s->full_well ? codes : (double)s->full_well;
}

bool sample_is_input(const struct sample_scene *a, int view)
{
    return a->walk || view % 2 == 0;
}

int sample_number(const struct sample_scene *a, int view)
{
    return a->walk ? view : view / 2;
}

int sample_camera_of(const struct sample_scene *a, int view)
{
    return a->n_optics > 0 ? sample_number(a, view) % a->n_optics : 0;
}

const struct optics *sample_optics(const struct sample_scene *a, int view)
{
    return a->n_optics > 0 ? &a->optics[sample_camera_of(a, view)] : NULL;
}

void sample_extents(const struct sample_scene *a, struct extent *out)
{
    size_t at = 0;
    for (int i = 0; i < a->n_views; i++) {
        const struct optics *o = sample_optics(a, i);
        out[i] = (struct extent){o ? o->w : a->size, o ? o->h : a->size, at};
        at += extent_pixels(&out[i]);
    }
}

/* ---- worlds ---- */

struct sample {
    const struct run *r;
    const struct sample_scene *a;
    const struct render_world *world;
    float *radiance, *depth;
    struct camera *cams;
    struct extent extent[SAMPLE_VIEWS];
    double median[SAMPLE_VIEWS];
    struct arena tmp[WORKERS_MAX];
    bool by_view; // one worker a view
    atomic_int drawn;
};

static err_t check_scene(const struct sample_scene *a)
{
    if (a->kind < WORLD_ANY || a->kind >= WORLD_KINDS)
        return err_fail(ERR_ARG, "sample: kind %d, allowed are %d to %d", a->kind, WORLD_ANY,
                        WORLD_KINDS - 1);
    if (a->n_views < 1 || a->n_views > SAMPLE_VIEWS)
        return err_fail(ERR_ARG, "sample: %d views, allowed are 1 to %d", a->n_views, SAMPLE_VIEWS);
    if (a->size < SIZE_LEAST || a->size > SAMPLE_SIZE)
        return err_fail(ERR_ARG, "sample: pictures of %d px, allowed are %d to %d", a->size,
                        SIZE_LEAST, SAMPLE_SIZE);
    struct extent all[SAMPLE_VIEWS];
    sample_extents(a, all);
    if (extent_total(all, a->n_views) > SAMPLE_PX)
        return err_fail(ERR_ARG, "sample: %d views of %d x %d px are more than %d px", a->n_views,
                        all[0].w, all[0].h, SAMPLE_PX);
    if (!(a->spread >= 0 && a->spread <= 1))
        return err_fail(ERR_ARG, "sample: spread %g, allowed are 0 to 1", (double)a->spread);
    if (a->orbit_deg != 0 && (a->kind != WORLD_PARK || !(a->orbit_deg > 0 && a->orbit_deg <= 180)))
        return err_fail(
            ERR_ARG, "sample: orbit with cameras %g degrees apart, allowed are 0 to 180 in a park",
            (double)a->orbit_deg);
    if (a->walk && a->kind != WORLD_PARK)
        return err_fail(ERR_ARG, "sample: a walk needs the room of a park");
    if (a->fov_deg != 0 && !(a->fov_deg >= 20 && a->fov_deg <= 120))
        return err_fail(ERR_ARG, "sample: field of view of %g degrees, allowed are 20 to 120, or 0",
                        (double)a->fov_deg);
    return OK;
}

/* The median; v is reordered. Hoare's selection. */
static float select_median(float *v, int n)
{
    int lo = 0, hi = n - 1, k = n / 2;
    while (lo < hi) {
        float pivot = v[lo + (hi - lo) / 2];
        int i = lo, j = hi;
        while (i <= j) {
            for (; v[i] < pivot; i++)
                ;
            for (; v[j] > pivot; j--)
                ;
            if (i <= j) {
                float swap = v[i];
                v[i++] = v[j];
                v[j--] = swap;
            }
        }
        if (k <= j)
            hi = j;
        else if (k >= i)
            lo = i;
        else
            break;
    }
    return v[k];
}

static double median_luminance(const float *radiance, int px, float *grey)
{
    for (int i = 0; i < px; i++) {
        float c[3] = {radiance[i], radiance[px + i], radiance[2 * px + i]};
        grey[i] = vec_grey(c);
    }
    return (double)select_median(grey, px);
}

/* Scratch memory of one view: grey levels, and its radiance if the caller does not want it. */
static err_t alloc_view(struct arena *tmp, size_t px, float **grey, float **own)
{
    err_t e = arena_alloc(tmp, px, sizeof **grey, grey);
    return e ? e : arena_alloc(tmp, px, 3 * sizeof **own, own);
}

static err_t draw_view(void *ctx, int view, int worker)
{
    struct sample *s = ctx;
    struct run r = *s->r;
    const struct extent *x = &s->extent[view];
    const size_t px = extent_pixels(x);
    const struct optics *o = sample_optics(s->a, view);
    struct render_quality quality = s->a->quality;
    float *grey, *own = NULL;
    quality.lens = o && lens_distorts(&o->lens) ? &o->lens : NULL;
    r.tmp = &s->tmp[s->by_view ? worker : 0];
    r.pool = s->by_view ? NULL : s->r->pool;
    size_t mark = arena_mark(r.tmp);
    err_t e = alloc_view(r.tmp, px, &grey, &own);
    struct render_maps maps = {.radiance = s->radiance ? s->radiance + 3 * x->at : own,
                               .depth = s->depth ? s->depth + x->at : NULL};
    if (!e)
        e = render_run(&r, s->world, s->cams + view, &quality, s->a->seed * SEEDS + (uint64_t)view,
                       &maps);
    if (!e)
        s->median[view] = median_luminance(maps.radiance, (int)px, grey);
    arena_reset(r.tmp, mark);
    return e;
}

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double metered_key(struct sample *s)
{
    qsort(s->median, (size_t)s->a->n_views, sizeof *s->median, by_value);
    double light = s->median[s->a->n_views / 2];
    light = light > LIGHT_LEAST ? light : LIGHT_LEAST;
    return KEY_LEVEL * full_scale(&sensor_default) / ((double)sensor_default.electrons * light);
}

/* What a photograph is made in. */
struct darkroom {
    struct sensor_raw raw; // of a sensor
    float *linear;         // (3, h, w) for local tone
};

static err_t alloc_darkroom(struct arena *tmp, const struct sample_camera *c, struct darkroom *d)
{
    const size_t n = 3 * (size_t)c->w * (size_t)c->h;
    *d = (struct darkroom){.raw = {.w = c->w, .h = c->h}};
    err_t e = OK;
    if (c->sensor)
        e = arena_alloc(tmp, n, sizeof *d->raw.px, &d->raw.px);
    if (!e && c->local)
        e = arena_alloc(tmp, n, sizeof *d->linear, &d->linear);
    return e;
}

/* Bytes of a photograph. */
static size_t expose_bytes(int w, int h, enum local_tone local)
{
    struct arena tmp = arena_counter();
    const struct sample_camera c = {.w = w, .h = h, .sensor = &sensor_default, .local = local};
    struct darkroom d;
    (void)alloc_darkroom(&tmp, &c, &d); // a counter is never full
    arena_step(&tmp, local_tone_plan(local, w, h));
    return tmp.peak;
}

/* Bytes of the largest view. */
static size_t view_bytes(const struct sample_scene *a)
{
    struct extent all[SAMPLE_VIEWS];
    size_t most = 0;
    sample_extents(a, all);
    for (int i = 0; i < a->n_views; i++) {
        struct plan p = plan_begin(1);
        float *grey, *own;
        (void)alloc_view(&p.tmp, extent_pixels(&all[i]), &grey, &own); // a counter is never full
        render_plan(&p, all[i].w, all[i].h);
        most = num_max_size(most, p.tmp.peak);
    }
    return most;
}

static err_t alloc_world(struct arena *room, struct world **out)
{
    return arena_alloc(room, 1, sizeof **out, out);
}

static size_t world_bytes(void)
{
    struct plan p = plan_begin(1);
    struct world *w;
    (void)alloc_world(&p.keep, &w); // a counter is never full
    world_plan(&p);
    render_open_plan(&p);
    return p.keep.peak;
}

static err_t sub_arena(struct arena *from, size_t size, const char *name, struct arena *out)
{
    *out = (struct arena){.name = name};
    err_t e = arena_alloc(from, size, 1, &out->base);
    out->size = e ? 0 : size / ARENA_ALIGN * ARENA_ALIGN;
    return e;
}

static err_t alloc_workers(struct arena *from, const struct sample_scene *a, int workers,
                           struct arena *tmp)
{
    const size_t bytes = view_bytes(a);
    err_t e = OK;
    for (int i = 0; i < workers && !e; i++)
        e = sub_arena(from, bytes, "sample", &tmp[i]);
    return e;
}

void sample_plan(struct plan *p, const struct sample_scene *a, enum local_tone local)
{
    struct extent all[SAMPLE_VIEWS];
    struct arena room, workers[WORKERS_MAX];
    struct plan opening = plan_begin(p->threads);
    const size_t mark = arena_mark(&p->tmp);
    (void)sub_arena(&p->tmp, world_bytes(), "world", &room); // a counter is never full
    render_open_plan(&opening);
    arena_step(&p->tmp, opening.tmp.peak);
    const size_t opened = arena_mark(&p->tmp);
    (void)alloc_workers(&p->tmp, a, p->threads, workers);
    arena_step(&p->tmp, similarity_plan((a->n_views + 1) / 2));
    arena_reset(&p->tmp, opened);
    sample_extents(a, all);
    for (int i = 0; i < a->n_views; i++)
        arena_step(&p->tmp, expose_bytes(all[i].w, all[i].h, local));
    arena_reset(&p->tmp, mark);
}

/* Only the thread that runs the job reports progress; it does so for all of them. */
static err_t draw_and_report(void *ctx, int view, int worker)
{
    struct sample *s = ctx;
    err_t e = draw_view(s, view, worker);
    int drawn = atomic_fetch_add(&s->drawn, 1) + 1;
    if (!e && worker == 0 && s->r->progress)
        s->r->progress(s->r->progress_ctx, "draw", drawn, s->a->n_views, NULL);
    return e;
}

static err_t draw_all(struct sample *s)
{
    int workers = pool_size(s->r->pool), n = s->a->n_views;
    s->by_view = n >= workers;
    if (s->r->progress)
        s->r->progress(s->r->progress_ctx, "draw", 0, n, NULL);
    err_t e = alloc_workers(s->r->tmp, s->a, s->by_view ? workers : 1, s->tmp);
    if (s->by_view && !e)
        e = pool_for(s->r->pool, n, draw_and_report, s);
    if (s->by_view && !e && s->r->progress)
        s->r->progress(s->r->progress_ctx, "draw", n, n, NULL);
    if (s->by_view)
        return e;
    for (int view = 0; view < n && !e; view++)
        e = draw_and_report(s, view, 0);
    return e;
}

static void set_optics(const struct sample_scene *a, struct camera *cams)
{
    for (int i = 0; i < a->n_views; i++) {
        const struct optics *o = sample_optics(a, i);
        if (!o)
            continue;
        cams[i].w = o->w;
        cams[i].h = o->h;
        cams[i].fx = (float)o->lens.fx;
        cams[i].fy = (float)o->lens.fy;
        cams[i].cx = (float)o->lens.cx;
        cams[i].cy = (float)o->lens.cy;
    }
}

/* Halfway between two cameras, intrinsics kept. */
static void set_between(const struct camera *a, const struct camera *b, struct camera *out)
{
    double ca[3], cb[3], q[4], r[9], sign = 0;
    rotation_centre(a, ca);
    rotation_centre(b, cb);
    for (int k = 0; k < 4; k++)
        sign += (double)a->q[k] * (double)b->q[k];
    for (int k = 0; k < 4; k++)
        q[k] = (double)a->q[k] + (sign < 0 ? -1 : 1) * (double)b->q[k];
    rotation_from_quat(q, r);
    rotation_to_quat(r, q);
    for (int k = 0; k < 4; k++)
        out->q[k] = (float)q[k];
    for (int i = 0; i < 3; i++) {
        double t = 0;
        for (int k = 0; k < 3; k++)
            t -= r[3 * i + k] * (ca[k] + cb[k]) / 2;
        out->t[i] = (float)t;
    }
}

static void set_pose(const struct camera *from, struct camera *to)
{
    memcpy(to->q, from->q, sizeof to->q);
    memcpy(to->t, from->t, sizeof to->t);
}

/* The similarity without its scale: the middle of the rig stays where it was. */
static void keep_metres(struct similarity *w, const struct camera *from, const struct camera *to,
                        int n)
{
    double r[9], at[3] = {0}, mean[3] = {0}, turned[3];
    rotation_from_quat(w->q, r);
    for (int i = 0; i < n; i++) {
        double a[3], b[3];
        rotation_centre(&from[i], a);
        rotation_centre(&to[i], b);
        for (int k = 0; k < 3; k++) {
            at[k] += a[k] / n;
            mean[k] += b[k] / n;
        }
    }
    lin_apply(r, at, turned);
    w->scale = 1;
    for (int k = 0; k < 3; k++)
        w->t[k] = mean[k] - turned[k];
}

/* The rig in the place of the views of even number. */
static err_t place_rig(const struct run *r, const struct sample_scene *a, struct camera *cams)
{
    struct camera even[(SAMPLE_VIEWS + 1) / 2];
    struct similarity w;
    const int n = (a->n_views + 1) / 2;
    for (int i = 0; i < n; i++)
        even[i] = cams[2 * i];
    err_t e = similarity_fit(r, a->rig, even, n, &w);
    if (!e && a->target)
        keep_metres(&w, a->rig, even, n);
    for (int i = 0; i < n && !e; i++) {
        const struct camera c = similarity_apply(&w, &a->rig[i]);
        set_pose(&c, &cams[2 * i]);
    }
    for (int i = 0; i + 1 < n && !e; i++)
        set_between(&cams[2 * i], &cams[2 * i + 2], &cams[2 * i + 1]);
    return e;
}

static err_t add_target(const struct sample_scene *a, const struct camera *cams, struct world *w)
{
    struct camera even[(SAMPLE_VIEWS + 1) / 2];
    const int n = (a->n_views + 1) / 2;
    for (int i = 0; i < n; i++)
        even[i] = cams[2 * i];
    return target_add(w, a->target, even, n);
}

/* Cameras, and what else the scene has beside its world. */
static err_t furnish(const struct run *r, const struct sample_scene *a, struct camera *cams,
                     struct world *w)
{
    const struct world_path path = {a->n_views,     a->spread,    a->fov_deg,
                                    a->jitter != 0, a->orbit_deg, a->walk != 0};
    err_t e = OK;
    world_cameras(w, &path, a->seed, a->size, cams);
    set_optics(a, cams);
    if (a->rig)
        e = place_rig(r, a, cams);
    if (!e && a->target)
        e = add_target(a, cams, w);
    if (!e && a->switched != SAMPLE_NO_SWITCH)
        world_switch_light(w, a->seed, a->switched == SAMPLE_ON);
    return e;
}

err_t sample_open(const struct run *r, const struct sample_scene *a, struct sample_place *out)
{
    struct sample s = {.r = r, .a = a, .radiance = out->radiance, .depth = out->depth};
    struct arena room = {0};
    struct run prepare = *r;
    struct world *w;
    err_t e = check_scene(a);
    if (e)
        return e;
    sample_extents(a, s.extent);
    s.cams = out->cams;
    e = sub_arena(r->tmp, world_bytes(), "world", &room);
    if (!e)
        e = alloc_world(&room, &w);
    if (!e)
        e = world_make(&room, a->seed, (enum world_kind)a->kind, w);
    prepare.keep = &room;
    if (!e)
        e = furnish(r, a, out->cams, w);
    if (!e)
        e = render_open(&prepare, w, &out->world);
    s.world = out->world;
    const size_t mark = arena_mark(r->tmp);
    if (!e)
        e = draw_all(&s);
    arena_reset(r->tmp, mark);
    if (!e)
        out->key = metered_key(&s);
    return e;
}

err_t sample_make(const struct run *r, const struct sample_scene *a, float *radiance, float *depth,
                  struct camera *cams, double *key)
{
    struct sample_place place = {.radiance = radiance, .depth = depth, .cams = cams};
    const size_t mark = arena_mark(r->tmp);
    err_t e = sample_open(r, a, &place);
    arena_reset(r->tmp, mark);
    if (!e)
        *key = place.key;
    return e;
}

/* ---- photographs ---- */

/* Relative exposure of radiance 1 without noise. */
static double clean_scale(double exposure)
{
    return exposure * (double)sensor_default.electrons / full_scale(&sensor_default);
}

static uint8_t code_of(const struct sample_camera *c, float exposure)
{
    return (uint8_t)(255 * curve_display(c->curve, exposure) + 0.5f);
}

static void develop_clean(const struct sample_camera *c, const float *radiance, double exposure,
                          uint8_t *px)
{
    size_t n = (size_t)c->w * (size_t)c->h;
    const double scale = clean_scale(exposure);
    for (size_t i = 0; i < 3 * n; i++)
        px[i] = code_of(c, (float)((double)radiance[i % 3 * n + i / 3] * scale));
}

static err_t develop_local(const struct run *r, const struct sample_camera *c,
                           const struct darkroom *d, const struct sensor_shot *shot, uint8_t *px)
{
    const size_t n = (size_t)c->w * (size_t)c->h;
    err_t e = c->sensor ? sensor_linear(r, c->sensor, shot, &d->raw, d->linear) : OK;
    if (!e)
        e = local_tone_run(r->tmp, c->local, c->w, c->h, d->linear);
    for (size_t i = 0; i < 3 * n && !e; i++)
        px[i] = code_of(c, d->linear[i % 3 * n + i / 3]);
    return e;
}

static err_t photograph(const struct run *r, const struct sample_camera *c, const float *radiance,
                        const struct sensor_shot *shot, uint8_t *px)
{
    const struct image picture = {c->w, c->h, 3, (float *)(uintptr_t)radiance};
    const size_t mark = arena_mark(r->tmp), n = 3 * (size_t)c->w * (size_t)c->h;
    const double scale = clean_scale(shot->exposure_s);
    struct darkroom d;
    err_t e = alloc_darkroom(r->tmp, c, &d);
    if (!e && c->sensor)
        e = sensor_expose(r, c->sensor, shot, &picture, &d.raw);
    for (size_t i = 0; i < n && !e && c->local && !c->sensor; i++)
        d.linear[i] = (float)((double)radiance[i] * scale);
    if (!e && c->local)
        e = develop_local(r, c, &d, shot, px);
    else if (!e && c->sensor)
        e = sensor_develop(r, c->sensor, shot, c->curve, &d.raw, px);
    else if (!e)
        develop_clean(c, radiance, shot->exposure_s, px);
    arena_reset(r->tmp, mark);
    return e;
}

static err_t check_shots(const struct sample_camera *c, int n, const float *stops)
{
    if (num_min(c->w, c->h) < SIZE_LEAST || num_max(c->w, c->h) > SAMPLE_SIZE)
        return err_fail(ERR_ARG, "photograph: %d x %d px, allowed are %d to %d", c->w, c->h,
                        SIZE_LEAST, SAMPLE_SIZE);
    if (!(c->key > 0) || !(c->key < 1e12))
        return err_fail(ERR_ARG, "photograph: key %g s, must be > 0 and < 1e12", c->key);
    if (n < 1 || n > SAMPLE_SHOTS)
        return err_fail(ERR_ARG, "photograph: %d exposures, allowed are 1 to %d", n, SAMPLE_SHOTS);
    for (int i = 0; i < n; i++)
        if (!(fabsf(stops[i]) <= STOPS_MAX))
            return err_fail(ERR_ARG, "photograph: exposure %d is 2^%g, allowed are 2^-%d to 2^%d",
                            i, (double)stops[i], STOPS_MAX, STOPS_MAX);
    return OK;
}

err_t sample_expose(const struct run *r, const struct sample_camera *c, const float *radiance,
                    int n, const float *stops, uint8_t *px)
{
    err_t e = check_shots(c, n, stops);
    for (int i = 0; i < n && !e; i++) {
        double exposure = c->key * exp2((double)stops[i]);
        struct sensor_shot shot = {
            .exposure_s = exposure, .gain = 1, .seed = c->seed, .frame = c->first + (uint64_t)i};
        uint8_t *to = px + (size_t)i * 3 * (size_t)c->w * (size_t)c->h;
        e = run_check(r, "photographs");
        if (c->sensor && exposure > EXPOSURE_MAX)
            shot.exposure_s = EXPOSURE_MAX;
        if (!e)
            e = photograph(r, c, radiance, &shot, to);
    }
    return e;
}

/* ---- for ctypes ---- */

int sample_photograph(const struct sample_request *q, float *radiance, float *depth, float *cams,
                      double *key)
{
    struct arena tmp = {0};
    struct run r = {.tmp = &tmp};
    struct camera views[SAMPLE_VIEWS];
    err_t e = check_scene(&q->scene);
    if (e)
        return e;
    struct plan p = plan_begin(1);
    sample_plan(&p, &q->scene, LOCAL_TONE_NONE);
    e = arena_init(&tmp, "sample", p.tmp.peak);
    if (!e)
        e = sample_make(&r, &q->scene, radiance, depth, views, key);
    for (int i = 0; i < q->scene.n_views && !e; i++) {
        const struct camera *c = views + i;
        const float row[11] = {c->fx,   c->fy,   c->cx,   c->cy,   c->q[0], c->q[1],
                               c->q[2], c->q[3], c->t[0], c->t[1], c->t[2]};
        memcpy(cams + 11 * i, row, sizeof row);
    }
    arena_free(&tmp);
    return e;
}

int sample_develop(const struct sample_request *q, double key, const float *radiance, int n,
                   const float *stops, uint8_t *px)
{
    struct arena tmp = {0};
    struct run r = {.tmp = &tmp};
    struct curve curve;
    const struct sample_camera c = {.w = q->scene.size,
                                    .h = q->scene.size,
                                    .key = key,
                                    .sensor = q->noise ? &sensor_default : NULL,
                                    .curve = &curve,
                                    .seed = q->noise_seed};
    err_t e = check_shots(&c, n, stops);
    if (!e && (q->curve_family < -1 || q->curve_family >= CURVE_FAMILIES))
        e = err_fail(ERR_ARG, "photograph: curve of family %d, allowed are -1 to %d",
                     q->curve_family, CURVE_FAMILIES - 1);
    if (e)
        return e;
    if (q->curve_family < 0)
        curve_draw(q->curve_seed, &curve);
    else
        curve_make((enum curve_family)q->curve_family, q->curve_param, q->curve_seed, &curve);
    e = arena_init(&tmp, "photograph", expose_bytes(c.w, c.h, c.local));
    if (!e)
        e = sample_expose(&r, &c, radiance, n, stops, px);
    arena_free(&tmp);
    return e;
}

const char *sample_error(void)
{
    return err_text();
}
