/* Memory: first what stays, then what the network needs, which is given back before stereo, or when
 * the scene is there; of a single forward pass the planes of the scene are the network's own. */
#include "firmware/recon/start.h"

#include "firmware/base/engine.h"
#include "firmware/recon/completion.h"
#include "firmware/recon/contradiction.h"
#include "firmware/recon/dump.h"
#include "firmware/recon/enlarge.h"
#include "firmware/recon/figures.h"
#include "firmware/recon/locate.h"
#include "firmware/recon/shading.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/photo/exposure_stack.h"
#include "core/photo/response.h"
#include "core/refine/correct.h"
#include "core/refine/response_refit.h"
#include "core/splat/anysplat.h"
#include "core/stereo/contradict.h"
#include "core/stereo/far.h"
#include "core/stereo/gap.h"
#include "core/stereo/seed.h"
#include "core/stereo/sweep.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    RESAMPLINGS = 2, // times that views are sampled again
    LEFT_NAMED = 32  // views left out that are named
};
#define LENS_MOVED 0.25 // px of the view, less is not worth it

static void announce_stage(const struct run *r, const char *stage)
{
    if (r->progress)
        r->progress(r->progress_ctx, stage, 0, 1, NULL);
}

/* ---- the scene before its first splat ---- */

/* Squares are the network's, or the paper's: their light is as it is. */
static bool finds_light(const struct recipe *recipe)
{
    return recipe->depth == RECIPE_STEREO && !recipe->square;
}

static err_t layout_scene(struct scene *s, struct start *st, struct arena *keep,
                          const struct views *v)
{
    const struct recipe *recipe = st->recipe;
    const size_t n = (size_t)v->n, photographs = n + (size_t)v->n_more;
    err_t e = arena_alloc(keep, n, sizeof *s->cams, &s->cams);
    if (!e && finds_light(recipe))
        e = shading_layout(&st->shade, keep, v->n);
    if (!e && recipe->depth == RECIPE_STEREO)
        e = arena_alloc(keep, photographs, sizeof *st->drift, &st->drift);
    if (!e && !recipe->forward) // room for what refinement may add
        e = gaussians_init(&s->g, keep, recipe->gaussians_max, recipe->degree_max);
    return e;
}

err_t start_scene(struct start *s)
{
    const struct views *v = &s->out->views;
    const struct recipe *recipe = s->recipe;
    struct arena *keep = s->run->keep;
    struct scene *scene = &s->out->scene;
    const size_t n = (size_t)v->n;
    *scene =
        (struct scene){.tone = s->out->response,
                       .n_views = v->n,
                       .size = v->size,
                       .names = v->names,
                       .log2t = v->log2t,
                       .metres = recipe->cameras == RECIPE_GIVEN && s->capture->shots[0].metres};
    for (int c = 0; c < 3 && recipe->forward; c++)
        scene->background[c] = 1; // core/splat/README.md 3
    err_t e = layout_scene(scene, s, keep, v);
    if (!e && v->cams)
        memcpy(scene->cams, v->cams, n * sizeof *scene->cams);
    s->keep = arena_mark(keep);
    s->tmp = arena_mark(s->run->tmp);
    if (!e && s->cfg->network && !recipe->network && !recipe->complete)
        job_result_warn(s->out,
                        "the network was not needed: cameras are known, and refinement starts from "
                        "stereo; to start from the network all the same: --set start.stereo=0");
    return e;
}

err_t start_brackets(struct start *s)
{
    if (!s->drift || s->out->views.n_more == 0)
        return OK;
    err_t e = shading_brackets(s->run, s->drift, s->out);
    s->out->scene.tone = s->out->response;
    job_result_lap(s->out, JOB_RESPONSE);
    return e;
}

/* ---- cameras ---- */

/* Why cameras are not known, and what mends it. */
static const char *why_not_located(const struct views *v, const struct bundle_result *b,
                                   char text[240])
{
    int blanks = 0, blank = 0, copies = 0, copy = 0;
    for (int i = 0; i < v->n; i++) {
        if (figures_blank(v, i))
            blank = blanks++ ? blank : i;
        if (figures_copied(v, i) >= 0)
            copy = copies++ ? copy : i;
    }
    if (2 * blanks >= v->n)
        snprintf(text, 240,
                 "%d of %d photographs are black or saturated all over (%.64s); take them at other "
                 "exposures",
                 blanks, v->n, v->names[blank]);
    else if (2 * (copies + 1) > v->n && copies)
        snprintf(text, 240,
                 "no parallax, %d of %d photographs are copies (%.64s is %.64s); take each from "
                 "another place",
                 copies, v->n, v->names[copy], v->names[figures_copied(v, copy)]);
    else if (b->agreement >= LOCATE_CONFIDENT)
        snprintf(
            text, 240,
            "no parallax, the camera turned or stood still; step aside between photographs, by "
            "a tenth of the distance or more");
    else if (b->observations > 2 * b->inliers)
        snprintf(
            text, 240,
            "of %d matches only %d fit; if photographs were zoomed or cropped, tell so with --set "
            "cameras.same=each",
            b->observations, b->inliers);
    else
        snprintf(text, 240,
                 "the views have too few points in common (%d); photograph so that neighbours "
                 "overlap by more than half",
                 b->inliers);
    return text;
}

static void report_bundle(struct start *s)
{
    const struct bundle_result *b = &s->bundle;
    char text[240];
    s->out->cameras = (struct job_cameras){.found = true,
                                           .from_tracks = b->from_tracks,
                                           .confidence = b->confidence,
                                           .rms_px = b->rms_px,
                                           .inliers = b->inliers,
                                           .observations = b->observations,
                                           .placed = b->n_placed,
                                           .edge = s->out->cameras.edge};
    if (b->confidence < LOCATE_CONFIDENT)
        job_result_warn(s->out, "cameras are a guess: %s, or give the cameras with --rig PATH",
                        why_not_located(&s->out->views, b, text));
}

/* Say which views are left out, and why; of very many only how many. */
static void warn_of_unplaced(struct start *s)
{
    const struct views *v = &s->out->views;
    const struct bundle_result *b = &s->bundle;
    struct job_result *out = s->out;
    int first = 0;
    while (b->placed[first])
        first++;
    if (v->n - b->n_placed > LEFT_NAMED)
        job_result_warn(
            out,
            "%d of %d views are left out, %.64s is the first: too little in common with "
            "the others; a scene is one place, take others apart from it",
            v->n - b->n_placed, v->n, v->names[first]);
    for (int i = 0; i < v->n && v->n - b->n_placed <= LEFT_NAMED; i++) {
        const char *blank = b->placed[i] ? NULL : figures_blank(v, i);
        if (blank)
            job_result_warn(out, "%s is left out: it is %s all over; take it at a %s exposure",
                            v->names[i], blank, *blank == 'b' ? "longer" : "shorter");
        else if (!b->placed[i])
            job_result_warn(
                out,
                "%s is left out: too little in common with the other views; take it nearer to "
                "one of them",
                v->names[i]);
    }
}

/* A view that shares too few points with the others would only spoil the scene: tracks do not tell
 * where it stood; a network does, and may be as right as those that are a guess. */
static err_t drop_unplaced_views(struct start *s)
{
    const struct run *r = s->run;
    const struct bundle_result *b = &s->bundle;
    struct job_result *out = s->out;
    struct views *v = &out->views;
    const size_t mark = arena_mark(r->tmp);
    bool *keep;
    int n = 0;
    if (b->n_placed < 2 || (b->confidence < LOCATE_CONFIDENT && !b->from_tracks))
        return OK;
    err_t e = arena_alloc(r->tmp, (size_t)(v->n + v->n_more), sizeof *keep, &keep);
    if (e)
        return e;
    for (int i = 0; i < v->n + v->n_more; i++)
        keep[i] = i >= v->n || b->placed[i];
    for (int i = 0; i < v->n; i++)
        if (keep[i])
            out->scene.cams[n++] = out->scene.cams[i];
    if (n < v->n)
        warn_of_unplaced(s);
    if (2 * n < v->n)
        job_result_warn(
            out,
            "only %d of %d photographs could be placed: cameras and scene may be wrong; light "
            "the others, or photograph so that neighbours overlap by more than half",
            n, v->n);
    if (s->recipe->depth == RECIPE_NETWORK)
        correct_drop(b->placed, b->depth_scale, &s->p);
    exposure_stack_drop(v, keep);
    out->scene.n_views = n;
    arena_reset(r->tmp, mark);
    return OK;
}

/* A network's depth and Gaussians belong to the pixels of the photographs as they were taken. */
static bool finds_distortion(const struct start *s)
{
    const struct recipe *recipe = s->recipe;
    return s->cfg->lens != RECIPE_LENS_PINHOLE && !s->out->views.cams && !recipe->square &&
           recipe->depth != RECIPE_NETWORK && recipe->gaussians != RECIPE_NETWORK;
}

static err_t refuse_cameras(const struct bundle_result *b, const struct views *v)
{
    char text[240];
    return err_fail(ERR_ARG, "the cameras cannot be found: %s, or give --rig PATH",
                    why_not_located(v, b, text));
}

/* One attempt on the views as they are. again: through lenses that are known by now. */
static err_t locate_views(struct start *s, bool again)
{
    const struct run *r = s->run;
    const struct views *v = &s->out->views;
    const struct lenses *l = &s->lenses;
    const bool known = v->cams != NULL, depth = s->recipe->depth == RECIPE_NETWORK;
    const bool alone = again || s->closer; // a network saw other views
    const struct bundle_config want = {.start = known   ? v->cams
                                                : alone ? NULL
                                                        : s->p.geom.cams,
                                       .start_depth = depth ? s->p.geom.depth : NULL,
                                       .n_lenses = l->n,
                                       .lens = l->lens,
                                       .lens_of = l->of,
                                       .turned = l->turned,
                                       .pinhole = again ? l->pinhole : NULL,
                                       .focal_known = known || s->cfg->fov_deg > 0,
                                       .find_distortion = finds_distortion(s),
                                       .find_principal = s->cfg->principal,
                                       .rig_known = known};
    struct start_merged merged;
    err_t e = exposure_stack_merge(r, v, &s->out->response, &merged.views, &merged.tone);
    if (!e)
        e = locate_run(r, &merged.views, s->p.matches.token && !alone ? &s->p.matches : NULL, &want,
                       &s->bundle);
    arena_reset(r->tmp, s->tmp);
    return e;
}

/* Where lenses distort, the views are sampled again through them: matches and cameras become
 * better, and with them the lenses. */
static err_t locate_through_lenses(struct start *s)
{
    const struct run *r = s->run;
    struct views *v = &s->out->views;
    const struct prep_source *from = s->cfg->source;
    const size_t mark = arena_mark(r->keep);
    err_t e = locate_views(s, false);
    const int most = finds_distortion(s) ? RESAMPLINGS : 0;
    for (int k = 0; k < most && !e && s->bundle.n_placed >= 2; k++) {
        if (!lenses_moved(&s->lenses, v, &s->bundle, LENS_MOVED))
            break;
        e = lenses_resample(r, s->capture, from, &s->bundle, &s->lenses, s->out);
        arena_reset(r->keep, mark);
        if (!e)
            e = locate_views(s, true);
    }
    return e;
}

static void take_cameras(struct start *s)
{
    const struct views *v = &s->out->views;
    const struct extent most = extent_cover(v->extent, v->n);
    s->out->cameras.edge = num_max(most.w, most.h);
    memcpy(s->out->scene.cams, s->bundle.cams, (size_t)v->n * sizeof *s->bundle.cams);
    lenses_note(&s->lenses, s->capture, &s->bundle, s->out);
}

/* Whether views could not be placed that show something. */
static bool lacks_views(const struct start *s)
{
    const struct views *v = &s->out->views;
    bool any = false;
    for (int i = 0; i < v->n; i++)
        any = any || (!s->bundle.placed[i] && !figures_blank(v, i));
    return any;
}

/* Views that were read again, over the former ones of their size. */
static void copy_pictures(const struct views *from, struct views *to)
{
    for (int i = 0; i < to->n + to->n_more; i++) {
        const size_t pixels = extent_pixels(&from->extent[i]);
        to->extent[i] = from->extent[i];
        memcpy(views_rgb(to, i), views_rgb(from, i), 3 * pixels);
        if (to->deep)
            memcpy(views_rgb16(to, i), views_rgb16(from, i), 3 * pixels * sizeof *to->rgb16);
        if (to->masked)
            memcpy(views_masked(to, i), views_masked(from, i), pixels);
    }
}

/* Views far apart have few things in common, and small ones: once more from larger views, in which
 * twice as many corners are found, from the beginning. That stays if it places more; then the views
 * become as small as they were. */
static err_t look_closer(struct start *s)
{
    const struct start first = *s;
    const struct scene scene = s->out->scene;
    struct views views = s->out->views;
    const size_t mark = arena_mark(s->run->keep);
    s->closer = true;
    s->out->n_found = 0; // as they were taken
    err_t e = enlarge_run(s->run, s->capture, s->cfg, s->recipe->closer, s->out);
    if (!e)
        e = lenses_layout(&s->lenses, s->run->keep, views.n);
    if (!e) {
        s->out->views.cams = NULL;
        lenses_group(&s->lenses, s->capture, &s->out->views, s->cfg);
        e = locate_through_lenses(s);
    }
    const bool better = !e && s->bundle.n_placed > first.bundle.n_placed;
    if (better) {
        take_cameras(s);
        e = enlarge_run(s->run, s->capture, s->cfg, s->recipe->work, s->out);
        if (!e)
            copy_pictures(&s->out->views, &views);
    } else {
        *s = first;
        arena_reset(s->run->keep, mark);
    }
    s->out->views = views;
    s->out->scene = scene;
    if (!better)
        take_cameras(s);
    return e;
}

err_t start_bundle(struct start *s)
{
    const struct run *r = s->run;
    const struct views *v = &s->out->views;
    const bool known = v->cams != NULL;
    err_t e = known ? OK : lenses_layout(&s->lenses, r->keep, v->n);
    if (!e && !known)
        lenses_group(&s->lenses, s->capture, v, s->cfg);
    if (!e)
        e = locate_through_lenses(s);
    if (!e && !known)
        take_cameras(s);
    if (!e && s->recipe->closer && lacks_views(s))
        e = look_closer(s);
    if (!e && !known)
        report_bundle(s);
    job_result_lap(s->out, JOB_CAMERAS);
    if (!e && s->recipe->must_place && s->bundle.n_placed < 2)
        e = refuse_cameras(&s->bundle, v);
    return e || known ? e : drop_unplaced_views(s);
}

err_t start_cameras(struct start *s)
{
    const struct recipe *recipe = s->recipe;
    struct scene *scene = &s->out->scene;
    err_t e = OK;
    s->scale = 1;
    if (recipe->cameras == RECIPE_NETWORK)
        memcpy(scene->cams, s->p.geom.cams, (size_t)scene->n_views * sizeof *scene->cams);
    else if (recipe->depth == RECIPE_NETWORK)
        e = correct_cameras(s->run, scene->cams, recipe->bundle ? s->bundle.depth_scale : NULL,
                            &s->p, &s->scale);
    s->out->views.cams = scene->cams;
    return e;
}

/* ---- the network ---- */

static struct net net_for_recipe(const struct network *n, const struct recipe *recipe)
{
    struct net out = n->net;
    out.d.gauss = recipe->gaussians == RECIPE_NETWORK;
    out.attend = recipe->bundle;
    return out;
}

err_t start_network(struct start *s)
{
    const struct network *n = s->cfg->network;
    struct job_result *out = s->out;
    const struct net net = net_for_recipe(n, s->recipe);
    static const char *const backbone[] = {"backbone", NULL}, *const heads[] = {"camera", "depth",
                                                                                NULL};
    struct network_clock clock;
    err_t e = dump_views(s->run, &out->views);
    job_result_lap(out, JOB_PREPROCESS);
    struct run timed = network_timed(s->run, &clock);
    if (!e && s->recipe->depth == RECIPE_STEREO)
        e = network_look(&timed, n, net.attend, &out->views, &s->p);
    else if (!e)
        e = net_run(&timed, &net, &out->views, &s->p);
    network_clock_stop(&clock);
    file_drop(&n->file.map); // not needed again
    out->seconds[JOB_BACKBONE] += network_seconds(&clock, backbone);
    out->seconds[JOB_HEADS] += network_seconds(&clock, heads);
    job_result_lap(out, JOB_APPEARANCE); // the whole pass, hence less the two
    out->seconds[JOB_APPEARANCE] -= out->seconds[JOB_BACKBONE] + out->seconds[JOB_HEADS];
    return e ? e : dump_prediction(s->run, &s->p);
}

/* ---- stereo ---- */

/* Unless the cameras are reliable, stereo would be worse than what the network predicts. */
bool start_corrects(const struct start *s)
{
    return s->recipe->correct &&
           (s->recipe->cameras == RECIPE_GIVEN || s->out->cameras.confidence >= LOCATE_CONFIDENT);
}

/* Brackets told the curve already, and one exposure never does. */
static bool needs_refit(const struct views *v)
{
    return v->n_more == 0 && !v->srgb && response_is_told(v);
}

static err_t find_light(struct start *s)
{
    struct job_result *out = s->out;
    struct start_merged *merged = &s->merged;
    const struct shading_input in = {.capture = s->capture,
                                     .depth = &s->depth,
                                     .room = s->shade,
                                     .drift = s->drift,
                                     .seen = &merged->views,
                                     .tone = &merged->tone,
                                     .refit = needs_refit(&out->views)};
    err_t e = shading_run(s->run, &in, out);
    if (in.refit)
        out->scene.tone = merged->tone;
    return e;
}

static err_t complete_depth(struct start *s)
{
    job_result_lap(s->out, JOB_SWEEP);
    announce_stage(s->run, "completion");
    err_t e = completion_run(s->run, &s->cfg->network->net, &s->merged.views, &s->merged.tone,
                             &s->depth, &s->out->completed);
    job_result_lap(s->out, JOB_COMPLETION);
    return e;
}

static void note_far(const struct depthmaps *d, struct job_result *out)
{
    size_t n = 0, far[FAR_BLACK + 1] = {0};
    for (int i = 0; i < d->n; i++)
        n += extent_pixels(&d->extent[i]);
    for (size_t i = 0; d->far && i < n; i++)
        far[d->far[i]]++;
    out->sky = (float)far[FAR_SKY] / (float)n;
    out->backdrop = (float)far[FAR_BLACK] / (float)n;
}

/* A guess is said to be one already. Its time counts as that of the cameras: that of the sweep
 * tells how fast the machine is. */
static err_t check_places(struct start *s)
{
    const struct job_cameras *c = &s->out->cameras;
    if (!c->found || c->confidence < LOCATE_CONFIDENT)
        return OK;
    job_result_lap(s->out, JOB_SWEEP);
    err_t e = contradiction_run(s->run, &s->merged.views, &s->merged.tone, &s->depth, s->out);
    job_result_lap(s->out, JOB_CAMERAS);
    return e;
}

err_t start_stereo(struct start *s)
{
    const struct run *r = s->run;
    struct job_result *out = s->out;
    struct start_merged *merged = &s->merged;
    if (s->recipe->depth == RECIPE_STEREO) // the network's prediction is not needed any more
        arena_reset(r->keep, s->keep);
    s->before_depth = arena_mark(r->keep);
    announce_stage(r, "sweep");
    err_t e = exposure_stack_merge(r, &out->views, &out->response, &merged->views, &merged->tone);
    if (!e)
        e = sweep_run(r, &merged->views, &merged->tone, &s->depth);
    if (!e)
        e = far_run(r, &merged->views, &merged->tone, &s->depth);
    if (!e)
        e = check_places(s);
    if (!e && s->recipe->complete)
        e = complete_depth(s);
    if (!e)
        note_far(&s->depth, out);
    if (!e && needs_refit(&out->views)) {
        e = response_refit_run(r, &out->views, &s->depth, &merged->tone);
        out->scene.tone = merged->tone;
    }
    if (!e && s->drift)
        e = find_light(s);
    job_result_lap(out, JOB_SWEEP);
    return e;
}

err_t start_correct(struct start *s)
{
    const struct run *r = s->run;
    const struct start_merged *merged = &s->merged;
    struct scene *scene = &s->out->scene;
    const struct correct_known known = {
        {&merged->views, &s->depth, &merged->tone}, &s->out->views, &scene->tone};
    err_t e = correct_run(r, &known, s->scale, &s->p);
    if (!e && !s->p.linear)
        response_mean(&merged->views, &merged->tone, scene->background);
    arena_reset(r->keep, s->before_depth);
    arena_reset(r->tmp, s->tmp);
    return e;
}

/* ---- the first Gaussians ---- */

static err_t dump_scene(const struct run *r, const struct job_config *cfg,
                        const struct prediction *p, const struct scene *s)
{
    struct dump_picture picture = {
        .g = &s->g,
        .extra = s->g.plane[G_LOGIT] + VOXEL_EXTRA * (size_t)s->g.cap, // as voxel_adapt left it
        .cam = &p->geom.cams[0],
        .tone = &s->tone};
    memcpy(picture.log2t, cfg->dump_log2t, sizeof picture.log2t);
    err_t e = dump_gaussians(r, &s->g);
    return e ? e : dump_picture(r, &picture);
}

/* Merges the predicted points in cells, which become the Gaussians of *s; its tone curve is set. */
static err_t merge_cells(const struct start *st, struct scene *s)
{
    const struct run *r = st->run;
    const struct prediction *p = &st->p;
    const struct net_dims *d = &st->cfg->network->net.d;
    const int max = st->recipe->forward ? 0 : st->recipe->gaussians_max;
    struct voxels cells;
    float cell;
    const struct voxel_input in = {p->n, p->points, p->features, p->confidence};
    announce_stage(r, "voxel");
    err_t e = voxel_merge_most(r, &in, d->voxel, max, &cells, &cell);
    if (e)
        return e;
    dump_cells(r, &cells);
    e = voxel_adapt(r, &cells, &s->g);
    if (!e && p->linear)
        anysplat_radiance(&s->g);
    return e ? e : dump_scene(r, st->cfg, p, s);
}

static err_t use_predicted_gaussians(struct start *st)
{
    struct scene *s = &st->out->scene, found = {.size = s->size};
    struct gaussians_report report;
    found.tone = st->p.tone;
    if (st->p.linear)
        anysplat_curve(st->out->views.mid_log2t, &found.tone);
    err_t e = merge_cells(st, &found);
    if (e)
        return e;
    if (st->recipe->forward)
        s->g = found.g;
    else
        gaussians_copy(&found.g, st->recipe->degree_max, &s->g);
    s->tone = found.tone;
    gaussians_sanitize(&s->g, &report);
    if (report.dropped)
        return err_fail(ERR_FORMAT,
                        "the network overflows: %d of its %d Gaussians are not finite; its weights "
                        "are damaged or of another network: convert them again, or take another "
                        "model",
                        report.dropped, report.dropped + s->g.n);
    gaussians_scale(&s->g, st->scale);
    return OK;
}

static err_t layout_confidence(struct depthmaps *d, struct arena *keep, size_t pixels)
{
    return arena_alloc(keep, pixels, sizeof *d->conf, &d->conf);
}

/* The network's depth in place of that of stereo, with full confidence at every pixel. */
static err_t use_predicted_depth(struct start *s)
{
    const struct geometry *g = &s->p.geom;
    const size_t n = (size_t)g->n_views * (size_t)g->size * (size_t)g->size;
    struct job_result *out = s->out;
    s->depth = (struct depthmaps){g->n_views, 1, out->views.extent, g->depth, NULL, NULL};
    err_t e = layout_confidence(&s->depth, s->run->keep, n);
    for (size_t i = 0; i < n && !e; i++) {
        s->depth.conf[i] = 1;
        s->depth.depth[i] *= s->scale;
    }
    return e ? e
             : exposure_stack_merge(s->run, &out->views, &out->response, &s->merged.views,
                                    &s->merged.tone);
}

static err_t place_seeds(struct start *s)
{
    struct job_result *out = s->out;
    const struct views *v = &s->merged.views;
    const struct tonemap *tone = &s->merged.tone;
    const struct seed_input in = {.views = v, .depth = &s->depth, .tone = tone};
    const struct shell shell = shell_of(v->cams, v->n);
    const int max = refine_begin(&s->recipe->refinement, v->n); // it splits what needs detail
    struct gaussians seeds;
    announce_stage(s->run, "seed");
    err_t e = seed_run(s->run, &in, max, &seeds);
    const int sure = seeds.n;
    if (!e)
        e = gap_fill(s->run, &shell, &seeds, max);
    out->sky_filled = seeds.n - sure;
    response_mean(v, tone, out->scene.background);
    if (!e)
        gaussians_copy(&seeds, 0, &out->scene.g); // refinement adds bands where they are asked for
    job_result_lap(out, JOB_SEED);
    return e;
}

err_t start_gaussians(struct start *s)
{
    const bool network = s->recipe->gaussians == RECIPE_NETWORK;
    err_t e = OK;
    if (!network && s->recipe->depth == RECIPE_NETWORK)
        e = use_predicted_depth(s);
    if (!e)
        e = network ? use_predicted_gaussians(s) : place_seeds(s);
    if (network)
        job_result_lap(s->out, JOB_VOXEL);
    arena_reset(s->run->tmp, s->tmp);
    if (!s->recipe->forward)
        arena_reset(s->run->keep, s->keep);
    return e;
}

/* ---- planning ---- */

static void plan_network(struct plan *p, const struct job_config *cfg, const struct recipe *recipe,
                         const struct views *v)
{
    if (recipe->depth == RECIPE_STEREO) {
        network_look_plan(p, cfg->network, recipe->bundle, v);
        return;
    }
    const struct net net = net_for_recipe(cfg->network, recipe);
    net_plan(p, &net, v->n, v->size);
}

static void plan_bundle(struct plan *p, const struct views *v, int n_lenses)
{
    const size_t mark = arena_mark(&p->tmp);
    struct lenses l;
    if (lenses_layout(&l, &p->keep, v->n))
        plan_refuse(p);
    exposure_stack_merge_plan(p, v);
    locate_plan(p, v, n_lenses);
    arena_reset(&p->tmp, mark);
}

/* As start_gaussians, from depth. maps: (n) shapes of those of stereo. */
static void plan_seeds(struct plan *p, const struct recipe *recipe, const struct views *v,
                       const struct extent *maps)
{
    const bool network = recipe->depth == RECIPE_NETWORK;
    struct gaussians seeds;
    struct depthmaps depth;
    if (network) {
        if (layout_confidence(&depth, &p->keep, extent_total(v->extent, v->n)))
            plan_refuse(p);
        exposure_stack_merge_plan(p, v);
    }
    seed_plan(p, network ? v->extent : maps, v->n, refine_begin(&recipe->refinement, v->n), &seeds);
    gap_plan(p);
}

static void plan_stereo(struct plan *p, const struct job_config *cfg, const struct recipe *recipe,
                        const struct views *v, const struct extent *maps)
{
    exposure_stack_merge_plan(p, v);
    sweep_plan(p, v, maps);
    far_plan(p, maps, v->n);
    if (recipe->cameras == RECIPE_BUNDLE)
        contradict_plan(p, maps, v->n);
    if (recipe->complete)
        completion_plan(p, &cfg->network->net, maps, v->n);
    if (v->n_more == 0)
        arena_step(&p->tmp, response_refit_plan(v->n));
    if (recipe->depth == RECIPE_STEREO)
        arena_step(&p->tmp, shading_plan(v->n));
}

void start_plan(struct plan *p, const struct capture *c, const struct job_config *cfg,
                const struct recipe *recipe, const struct views *v, const struct views *closer)
{
    const size_t pixels = extent_total(v->extent, v->n);
    const int points = pixels <= GAUSSIANS_MAX ? (int)pixels : -1; // -1: plans refuse it
    const int n_lenses = lenses_count(c);
    const bool gaussians = recipe->gaussians == RECIPE_NETWORK;
    struct extent *maps = calloc((size_t)v->n, sizeof *maps);
    struct scene scene;
    struct start s = {.recipe = recipe};
    if (!maps) {
        plan_refuse(p);
        return;
    }
    (void)sweep_extents(v, maps);
    if (layout_scene(&scene, &s, &p->keep, v))
        plan_refuse(p);
    shading_brackets_plan(p, v);
    const size_t keep = arena_mark(&p->keep), tmp = arena_mark(&p->tmp);
    if (recipe->tapped) // cells have room for all points
        arena_step(&p->tmp, dump_plan(cfg->size, gaussians ? points : recipe->gaussians_max));
    if (recipe->network)
        plan_network(p, cfg, recipe, v);
    if (recipe->bundle)
        plan_bundle(p, v, n_lenses);
    if (recipe->closer) {
        enlarge_plan(p, c, cfg->source, recipe->closer);
        plan_bundle(p, closer, n_lenses);
        enlarge_plan(p, c, cfg->source, recipe->work);
    }
    if (recipe->depth == RECIPE_NETWORK)
        correct_cameras_plan(p, v->n);
    else
        arena_reset(&p->keep, keep);
    const size_t before_depth = arena_mark(&p->keep);
    if (recipe->depth == RECIPE_STEREO || recipe->correct)
        plan_stereo(p, cfg, recipe, v, maps);
    if (recipe->correct) {
        correct_plan(p, v->n, v->size);
        arena_reset(&p->keep, before_depth);
        arena_reset(&p->tmp, tmp);
    }
    if (gaussians)
        voxel_plan(p, points);
    else
        plan_seeds(p, recipe, v, maps);
    free(maps);
    arena_reset(&p->tmp, tmp);
    if (!recipe->forward)
        arena_reset(&p->keep, keep);
}
