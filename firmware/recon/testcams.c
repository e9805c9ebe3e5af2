#include "firmware/recon/testcams.h"

#include "firmware/recon/locate.h"
#include "firmware/recon/shading.h"
#include "firmware/recon/testview.h"

#include "core/photo/prep.h"
#include "core/refine/align.h"
#include "core/sfm/pose.h"
#include "core/sfm/similarity.h"
#include "drivers/format/name.h"

#include <stdlib.h>
#include <string.h>

static bool begins_view(const struct capture *c, int i)
{
    return i == 0 || !name_same_view(c->shots[i].name, c->shots[i - 1].name);
}

/* For the view that begins with picture i; its pictures are in the order of their exposures. */
static int middle_picture(const struct capture *c, int i)
{
    int n = 1;
    while (i + n < c->n && !begins_view(c, i + n))
        n++;
    return i + n / 2;
}

static int count_views(const struct capture *c)
{
    int n = 0;
    for (int i = 0; i < c->n; i++)
        n += begins_view(c, i);
    return n;
}

err_t testcams_check(const struct job_config *cfg, const struct capture *train,
                     const struct capture *test)
{
    const int inputs = prep_places(train), held_out = count_views(test);
    if (!recipe_of_cameras(cfg).bundle || inputs + held_out <= BUNDLE_VIEWS_MAX)
        return OK;
    return err_fail(ERR_ARG,
                    "%d input and %d test views, cameras can be found for at most %d together: "
                    "take fewer --views, or give the cameras with --rig PATH",
                    inputs, held_out, BUNDLE_VIEWS_MAX);
}

/* ---- pictures ---- */

static err_t layout_extents(struct views *v, struct arena *keep)
{
    return arena_alloc(keep, (size_t)v->n, sizeof *v->extent, &v->extent);
}

static err_t layout_views(struct views *v, struct bundle_lens **lens, struct arena *keep,
                          size_t pixels)
{
    err_t e = arena_alloc(keep, pixels, 3, &v->rgb);
    if (!e)
        e = arena_zalloc(keep, (size_t)v->n, sizeof **lens, lens);
    return e ? e : arena_alloc(keep, (size_t)v->n, sizeof *v->log2t, &v->log2t);
}

/* One shape for each test view; at: pixels before the first. */
static void add_extents(const struct capture *test, struct prep_size size, size_t at,
                        struct extent *out)
{
    for (int i = 0; i < test->n; i++)
        if (begins_view(test, i)) {
            const struct image8 *im = &test->shots[middle_picture(test, i)].image;
            *out = prep_extent(size, im->w, im->h);
            out->at = at;
            at += extent_pixels(out++);
        }
}

/* v: the test views in the size of the scene. */
static void plan_align(struct plan *p, const struct capture *test, const struct views *v, int most)
{
    struct shade *shade;
    const size_t mark = arena_mark(&p->keep);
    if (shading_layout(&shade, &p->keep, 1))
        plan_refuse(p);
    testview_plan(p, test, extent_cover(v->extent, v->n).at, v->size);
    arena_step(&p->tmp, align_plan(most, v));
    arena_reset(&p->keep, mark);
}

static void plan_steps(struct plan *p, const struct job_config *cfg, const struct views *v,
                       const struct capture *test)
{
    const struct recipe recipe = recipe_of_cameras(cfg);
    struct views own = *v;
    struct bundle_lens *lens;
    if (layout_extents(&own, &p->keep) ||
        layout_views(&own, &lens, &p->keep, extent_total(v->extent, v->n)))
        plan_refuse(p);
    testview_plan(p, test, extent_cover(v->extent, v->n).at, v->size);
    if (recipe.network)
        network_look_plan(p, cfg->network, recipe.bundle, v);
    if (recipe.bundle)
        locate_plan(p, v, v->n);
    arena_step(&p->tmp, pose_error_plan(v->n)); // fits a similarity, as placing does
}

err_t testcams_plan(const struct job_config *cfg, const struct testcams_scene *scene,
                    const struct capture *train, const struct capture *test, int threads,
                    struct job_memory *out)
{
    const struct prep_size size = {recipe_work(cfg), scene->square};
    const int inputs = prep_places(train);
    struct views v = {.n = inputs + count_views(test), .size = size.edge};
    struct plan p = plan_begin(threads);
    v.extent = calloc((size_t)(train->n + count_views(test)), sizeof *v.extent);
    if (!v.extent)
        return err_fail(ERR_NOMEM, "no memory for the shapes of %d views", v.n);
    prep_extents(train, size, v.extent); // places come first
    add_extents(test, size, extent_total(v.extent, inputs), v.extent + inputs);
    plan_steps(&p, cfg, &v, test);
    v.n -= inputs;
    v.size = cfg->size;
    add_extents(test, (struct prep_size){v.size, scene->square}, 0, v.extent);
    plan_align(&p, test, &v, scene->gaussians);
    free(v.extent);
    *out = (struct job_memory){.keep = p.keep.peak, .tmp = p.tmp.peak};
    return OK;
}

/* Room for the views of the scene, then one picture of each test view. */
static err_t begin_views(struct arena *keep, const struct views *train, const struct capture *test,
                         struct prep_size size, struct views *all, struct bundle_lens **lens)
{
    const int n = train->n + count_views(test);
    size_t own = 0;
    *all = (struct views){
        .n = n, .size = size.edge, .aspect = train->aspect, .mid_log2t = train->mid_log2t};
    err_t e = layout_extents(all, keep);
    if (e)
        return e;
    for (int i = 0; i < train->n; own += extent_pixels(&all->extent[i++])) {
        all->extent[i] = prep_extent(size, train->extent[i].w, train->extent[i].h);
        all->extent[i].at = own;
    }
    add_extents(test, size, own, all->extent + train->n);
    return layout_views(all, lens, keep, extent_total(all->extent, n));
}

/* A view of the scene, which may be larger. */
static err_t add_input(const struct run *r, const struct views *train, int i, struct views *all)
{
    const struct extent *px = &train->extent[i];
    const size_t mark = arena_mark(r->keep);
    struct shot s = {.image = {px->w, px->h, 3, views_rgb(train, i)}, .exposure = 1};
    struct capture one = {1, &s};
    struct views v;
    err_t e = prep_run(r, &one, (struct prep_size){all->size, px->w == px->h}, &v);
    if (!e)
        memcpy(views_rgb(all, i), v.rgb, 3 * extent_pixels(&all->extent[i]));
    all->log2t[i] = train->log2t[i];
    arena_reset(r->keep, mark);
    return e;
}

static err_t add_view(const struct run *r, const struct imageset *test, int i, int at,
                      struct views *all)
{
    const struct prep_size size = {all->size, all->extent[at].w == all->extent[at].h};
    const size_t mark = arena_mark(r->keep);
    struct views v;
    err_t e = testview_read(r, test, i, false, size, &v);
    if (!e) {
        memcpy(views_rgb(all, at), v.rgb, 3 * extent_pixels(&all->extent[at]));
        all->log2t[at] = v.log2t[0];
    }
    arena_reset(r->keep, mark);
    return e;
}

/* ---- cameras ---- */

/* Size of the views over that of the scene's views. */
static float view_scale(const struct scene *s, const struct views *v)
{
    return (float)v->size / (float)s->size;
}

/* Focal lengths of all views: those of the scene, of the test views' lenses as they were found,
 * else the scene's mean. */
static void known_focals(const struct scene *s, const struct capture *test, const struct views *all,
                         struct bundle_lens *out)
{
    const double scale = (double)view_scale(s, all);
    double mean = 0;
    for (int i = 0; i < s->n_views; i++) {
        out[i].start.fx = (double)s->cams[i].fx * scale;
        mean += out[i].start.fx / s->n_views;
    }
    for (int i = 0, at = s->n_views; i < test->n; i++) {
        const struct camera *c = &test->shots[i].cam;
        if (!begins_view(test, i))
            continue;
        out[at].start.fx = c->fx > 0 ? (double)c->fx * all->extent[at].w / c->w : mean;
        at++;
    }
}

/* Views of the scene, then the test views, as they were found. */
struct found {
    struct views all;
    struct bundle_lens *lens;
    struct camera *cams;
    bool told;                     // which ones are placed
    bool placed[BUNDLE_VIEWS_MAX]; // else the camera is a copy of another
};

/* Cameras of all views in a world of their own. */
static err_t locate_all(const struct run *r, const struct job_config *cfg, struct found *f)
{
    struct prediction p = {.geom = {.cams = NULL}};
    struct bundle_result b;
    const struct recipe recipe = recipe_of_cameras(cfg);
    const int n = f->all.n;
    err_t e = recipe.network ? network_look(r, cfg->network, recipe.bundle, &f->all, &p) : OK;
    f->cams = p.geom.cams;
    f->told = recipe.bundle;
    if (e || !recipe.bundle)
        return e;
    int of[BUNDLE_VIEWS_MAX];
    for (int i = 0; i < n; i++)
        of[i] = i;
    const struct bundle_config want = {
        .start = p.geom.cams, .n_lenses = n, .lens = f->lens, .lens_of = of, .focal_known = true};
    e = locate_run(r, &f->all, p.matches.token ? &p.matches : NULL, &want, &b);
    f->cams = b.cams;
    if (!e)
        memcpy(f->placed, b.placed, (size_t)n * sizeof f->placed[0]);
    return e;
}

/* From the found world to that of the scene, by the views of the scene that are placed if those are
 * enough. */
static err_t fit_world(const struct run *r, const struct scene *s, const struct found *f,
                       struct similarity *out)
{
    enum { ENOUGH = 3 };
    struct camera from[BUNDLE_VIEWS_MAX], to[BUNDLE_VIEWS_MAX];
    int n = 0;
    for (int i = 0; i < s->n_views && f->told; i++)
        if (f->placed[i]) {
            from[n] = f->cams[i];
            to[n++] = s->cams[i];
        }
    return n >= ENOUGH ? similarity_fit(r, from, to, n, out)
                       : similarity_fit(r, f->cams, s->cams, s->n_views, out);
}

/* The test views among them, in the world of the scene. */
static err_t place_test_views(const struct run *r, const struct scene *s, const struct found *f)
{
    struct similarity w;
    err_t e = fit_world(r, s, f, &w);
    for (int i = s->n_views; i < f->all.n && !e; i++) {
        struct camera *cam = &f->cams[i];
        *cam = similarity_apply(&w, cam);
        cam->fx = (float)f->lens[i].start.fx;
        cam->fy = cam->fx * s->cams[0].fy / s->cams[0].fx; // squeezed views
    }
    return e;
}

/* Say which were not found: they are wrong about the scene. */
static void warn_lost(const struct capture *test, const struct found *f, struct job_result *j)
{
    int lost = 0, first = 0;
    for (int i = 0, at = j->scene.n_views - 1; i < test->n && f->told; i++) {
        at += begins_view(test, i);
        if (begins_view(test, i) && !f->placed[at])
            first = lost++ ? first : i;
    }
    if (lost)
        job_result_warn(j,
                        "%d of the test views (%.64s) ha%s too little in common with the others to "
                        "be placed: figures of %s are no measure of the scene; give the cameras "
                        "with --rig PATH, or leave %s out",
                        lost, test->shots[first].name, lost == 1 ? "s" : "ve",
                        lost == 1 ? "it" : "them", lost == 1 ? "it" : "them");
}

/* Align the camera of picture i, which is that of its view, in the size of the scene. */
static err_t align_test_view(const struct run *r, const struct job_result *j,
                             const struct imageset *test, int i, struct camera *cam)
{
    const struct shot *s = &test->capture.shots[i];
    const size_t mark = arena_mark(r->keep);
    struct views v;
    struct shade *shade;
    err_t e = testview_read(r, test, i, false, job_result_size(&j->scene), &v);
    if (!e)
        e = shading_layout(&shade, r->keep, 1);
    if (!e) {
        *cam = pose_scaled(cam, v.extent[0].w, v.extent[0].h);
        v.cams = cam;
        v.shade = shading_of(j, s, cam, shade) ? shade : NULL;
        e = align_run(r, &j->scene, &v);
    }
    arena_reset(r->keep, mark);
    return e;
}

static err_t align_test_views(const struct run *r, const struct job_result *j,
                              const struct imageset *test, const struct found *f)
{
    const struct capture *c = &test->capture;
    int at = j->scene.n_views;
    err_t e = place_test_views(r, &j->scene, f);
    for (int i = 0; i < c->n && !e; i++) {
        if (!begins_view(c, i))
            continue;
        e = align_test_view(r, j, test, middle_picture(c, i), &f->cams[at++]);
        if (r->progress)
            r->progress(r->progress_ctx, "align", at - j->scene.n_views,
                        f->all.n - j->scene.n_views, NULL);
    }
    return e;
}

static void give_cameras(const struct camera *cams, struct capture *test)
{
    for (int i = 0, view = -1; i < test->n; i++) {
        struct shot *s = &test->shots[i];
        view += begins_view(test, i);
        s->cam = pose_scaled(&cams[view], s->image.w, s->image.h);
        s->has_camera = true;
    }
}

err_t testcams_run(const struct run *r, const struct job_config *cfg, struct job_result *j,
                   struct imageset *test)
{
    const int n = j->scene.n_views;
    const size_t mark = arena_mark(r->keep);
    struct found f = {.told = false};
    const struct prep_size size = {recipe_work(cfg), job_result_size(&j->scene).square};
    err_t e = begin_views(r->keep, &j->views, &test->capture, size, &f.all, &f.lens);
    for (int i = 0; i < n && !e; i++)
        e = add_input(r, &j->views, i, &f.all);
    for (int i = 0, at = n; i < test->capture.n && !e; i++)
        if (begins_view(&test->capture, i))
            e = add_view(r, test, middle_picture(&test->capture, i), at++, &f.all);
    if (!e) {
        known_focals(&j->scene, &test->capture, &f.all, f.lens);
        e = locate_all(r, cfg, &f);
    }
    if (!e)
        e = align_test_views(r, j, test, &f);
    if (!e) {
        give_cameras(f.cams + n, &test->capture);
        warn_lost(&test->capture, &f, j);
    }
    arena_reset(r->keep, mark);
    return e;
}

/* ---- figures ---- */

/* For the photograph `name`, which exists. */
static const struct shot *shot_of(const struct capture *c, const char *name)
{
    const struct shot *s = c->shots;
    while (strcmp(s->name, name) != 0)
        s++;
    return s;
}

err_t testcams_measure(const struct run *r, const struct job_result *j, const struct capture *train,
                       const struct capture *true_test, const struct capture *test,
                       struct pose_error *out)
{
    const int side = j->scene.size, views = j->scene.n_views, n = views + count_views(test);
    struct camera *found = calloc((size_t)n, sizeof *found),
                  *real = calloc((size_t)n, sizeof *real);
    err_t e = found && real ? OK : err_fail(ERR_NOMEM, "no memory for %d cameras", n);
    *out = (struct pose_error){.n = 0};
    for (int i = 0; i < views && !e; i++) {
        const struct shot *s = shot_of(train, j->scene.names[i]);
        found[i] = j->scene.cams[i];
        real[i] = pose_scaled(&s->cam, found[i].w, found[i].h);
    }
    for (int i = 0, at = views; i < test->n && !e; i++)
        if (begins_view(test, i)) {
            found[at] = pose_scaled(&test->shots[i].cam, side, side);
            real[at++] = pose_scaled(&true_test->shots[i].cam, side, side);
        }
    if (!e)
        e = pose_error_measure(r, found, real, n, out);
    free(found);
    free(real);
    return e;
}
