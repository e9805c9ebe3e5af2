/* Cameras and lenses begin with the first take that shows them on its own. Then the points of all
 * takes are adjusted together: a point belongs to one take, a camera to all of them. Where lenses
 * distort, the photographs are drawn again through them, and so on, as in start.c. */
#include "firmware/recon/rigcal.h"

#include "firmware/recon/job.h"
#include "firmware/recon/lenses.h"
#include "firmware/recon/locate.h"
#include "firmware/recon/rigboard.h"
#include "firmware/recon/rigsight.h"

#include "core/base/num.h"
#include "core/photo/exposure_stack.h"
#include "core/photo/prep.h"
#include "core/photo/response.h"
#include "core/sfm/covariance.h"
#include "core/sfm/match.h"
#include "core/sfm/rigcheck.h"
#include "drivers/format/imageset.h"
#include "drivers/format/name.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { ROUNDS = 3 };    // of all takes together
#define LENS_MOVED 0.25 // px of the view, less is not worth another round

/* Tracks of one take among those of all. */
struct part {
    int first, n, first_track, n_tracks;
};

struct rigcal {
    const struct run *r;
    const struct rigcal_job *job;
    struct rigcal_result *out;
    struct job_result *seen; // the take at work
    struct views merged;     // of it, in the arenas
    struct lenses lenses;
    struct views shape; // of the views of all takes: n, size, aspect and extent
    struct match_tracks all;
    int cap; // of all.obs
    struct part part[RIGCAL_TAKES];
    struct bundle_result found; // arrays below
    struct lens lens[RIGCHECK_MOST];
    struct selfcal_lens selfcal[RIGCHECK_MOST];
    struct camera cams[RIGCHECK_MOST];
    bool placed[RIGCHECK_MOST];
    double covariance[RIGCHECK_MOST * COVARIANCE_POSE];
    float depth[RIGCHECK_MOST];
    struct extent extent[RIGCHECK_MOST];
};

/* ---- a take ---- */

/* The views of a take, in the arenas: as taken, or through the lenses found. */
static err_t see_take(struct rigcal *c, int i, bool resampled)
{
    const struct rigcal_take *t = &c->job->take[i];
    struct job_result *s = c->seen;
    struct tonemap tone;
    memset(s, 0, sizeof *s);
    s->capture = t->capture;
    err_t e = prep_read(c->r, t->capture, t->source,
                        (struct prep_size){recipe_work(c->job->cfg), false}, &s->views);
    s->views.cams = NULL;
    if (!e)
        e = job_result_curve(c->r, s);
    if (!e && s->views.n_more)
        e = exposure_stack_choose(c->r, &s->response, false, &s->views);
    if (!e && s->views.n_more)
        e = job_result_curve(c->r, s);
    if (!e && resampled)
        e = lenses_resample(c->r, t->capture, t->source, &c->found, &c->lenses, s);
    if (!e)
        e = exposure_stack_merge(c->r, &s->views, &s->response, &c->merged, &tone);
    if (e)
        return e;
    memcpy(c->extent, s->views.extent, (size_t)s->views.n * sizeof c->extent[0]);
    c->shape = (struct views){
        .n = s->views.n, .size = s->views.size, .aspect = s->views.aspect, .extent = c->extent};
    return OK;
}

/* What bundle adjustment found, out of the arenas. */
static void keep_found(struct rigcal *c, const struct bundle_result *b)
{
    c->found = *b;
    memcpy(c->cams, b->cams, (size_t)c->shape.n * sizeof c->cams[0]);
    memcpy(c->placed, b->placed, (size_t)c->shape.n * sizeof c->placed[0]);
    memcpy(c->lens, b->lenses, (size_t)b->n_lenses * sizeof c->lens[0]);
    memcpy(c->covariance, b->pose_covariance,
           (size_t)c->shape.n * COVARIANCE_POSE * sizeof c->covariance[0]);
    memcpy(c->depth, b->depth, (size_t)c->shape.n * sizeof c->depth[0]);
    memcpy(c->selfcal, b->selfcal, (size_t)b->n_lenses * sizeof c->selfcal[0]);
    c->found.cams = c->cams;
    c->found.placed = c->placed;
    c->found.lenses = c->lens;
    c->found.selfcal = c->selfcal;
    c->found.pose_covariance = c->covariance;
    c->found.depth = c->depth;
    c->found.points = c->found.depth_scale = NULL;
}

static struct bundle_config config_of(const struct rigcal *c, bool resampled)
{
    const struct lenses *l = &c->lenses;
    return (struct bundle_config){.n_lenses = l->n,
                                  .lens = l->lens,
                                  .lens_of = l->of,
                                  .turned = l->turned,
                                  .pinhole = resampled ? l->pinhole : NULL,
                                  .focal_known = c->job->cfg->fov_deg > 0,
                                  .find_distortion = c->job->cfg->lens != RECIPE_LENS_PINHOLE,
                                  .find_principal = c->job->cfg->principal,
                                  .measure_poses = true};
}

/* Cameras and lenses from the first take that shows all of them. */
static err_t find_start(struct rigcal *c)
{
    float best = -1;
    err_t e = OK;
    for (int i = 0; i < c->job->n && !e; i++) {
        const size_t keep = arena_mark(c->r->keep), tmp = arena_mark(c->r->tmp);
        struct bundle_result b;
        e = see_take(c, i, false);
        if (!e)
            lenses_group(&c->lenses, c->job->take[i].capture, &c->seen->views, c->job->cfg);
        const struct bundle_config want = config_of(c, false);
        if (!e)
            e = locate_run(c->r, &c->merged, NULL, &want, &b);
        const float sure = e ? 0 : b.confidence * (float)b.n_placed;
        if (!e && sure > best)
            keep_found(c, &b);
        best = fmaxf(best, sure);
        arena_reset(c->r->keep, keep);
        arena_reset(c->r->tmp, tmp);
        if (!e && b.confidence >= LOCATE_CONFIDENT && b.n_placed == c->shape.n)
            break;
    }
    return e;
}

/* ---- all takes ---- */

static err_t add_tracks(struct rigcal *c, int i, const struct match_tracks *t)
{
    struct match_tracks *all = &c->all;
    if (all->n + t->n > c->cap) {
        const int cap = 2 * (all->n + t->n);
        struct match_observation *more = realloc(all->obs, (size_t)cap * sizeof *more);
        if (!more)
            return err_fail(ERR_NOMEM, "no memory for %d observations", cap);
        all->obs = more;
        c->cap = cap;
    }
    c->part[i] = (struct part){all->n, t->n, all->n_tracks, t->n_tracks};
    for (int k = 0; k < t->n; k++) {
        all->obs[all->n + k] = t->obs[k];
        all->obs[all->n + k].track += all->n_tracks;
    }
    all->n += t->n;
    all->n_tracks += t->n_tracks;
    return OK;
}

static err_t match_takes(struct rigcal *c, bool resampled)
{
    err_t e = OK;
    c->all.n = c->all.n_tracks = 0;
    for (int i = 0; i < c->job->n && !e; i++) {
        const size_t keep = arena_mark(c->r->keep), tmp = arena_mark(c->r->tmp);
        struct match_tracks t;
        e = see_take(c, i, resampled);
        if (!e)
            e = match_run(c->r, &c->merged, NULL, NULL, &t);
        if (!e)
            e = add_tracks(c, i, &t);
        arena_reset(c->r->keep, keep);
        arena_reset(c->r->tmp, tmp);
        if (c->r->progress)
            c->r->progress(c->r->progress_ctx, "takes", i + 1, c->job->n, NULL);
    }
    return e;
}

/* Rounds of all takes, until lenses stay. */
static err_t solve_all(struct rigcal *c)
{
    bool resampled = false;
    err_t e = OK;
    for (int k = 0; k < ROUNDS && !e; k++) {
        const bool moved = lenses_moved(&c->lenses, &c->shape, &c->found, LENS_MOVED);
        const size_t keep = arena_mark(c->r->keep);
        struct bundle_result b;
        if (k > 0 && !moved)
            break;
        resampled = resampled || moved;
        e = match_takes(c, resampled);
        const struct bundle_config want = config_of(c, resampled);
        if (!e)
            e = bundle_run(c->r, &c->shape, &c->all, &want, &b);
        if (!e)
            keep_found(c, &b);
        arena_reset(c->r->keep, keep);
    }
    return e;
}

/* ---- result ---- */

static const char *name_of(const struct rigcal *c, int view)
{
    const struct capture *first = c->job->take[0].capture;
    int i = 0;
    for (int place = -1; i < first->n; i++) {
        place += !first->shots[i].again;
        if (place == view)
            break;
    }
    return first->shots[i].name;
}

static err_t check_found(const struct rigcal *c)
{
    const struct bundle_result *b = &c->found;
    for (int i = 0; i < c->shape.n; i++)
        if (!b->placed[i])
            return err_fail(ERR_ARG,
                            "the camera of %s has too few points that agree with the others in "
                            "these takes: add takes of something with more texture that it shares "
                            "with its neighbours, or leave out those in which it stood elsewhere",
                            name_of(c, i));
    if (b->confidence < LOCATE_CONFIDENT)
        return err_fail(ERR_ARG,
                        "the rig cannot be calibrated from these takes: of %d matches %d fit; take "
                        "something near, with texture and depth",
                        b->observations, b->inliers);
    return OK;
}

/* What a camera sees is as far off, px of the photographs as they were taken. */
static double taken_px(const struct rigcal *c, int view, float off_px)
{
    const struct shot *s = lenses_shot(c->job->take[0].capture, name_of(c, view));
    const struct extent *px = &c->shape.extent[view];
    return (double)off_px * num_max(s->taken_w, s->taken_h) / num_max(px->w, px->h);
}

/* Takes in which a camera stood elsewhere are named, but not by less than a pixel: small
 * photographs do not tell it from errors of the calibration. */
static err_t check_take(struct rigcal *c, int i, struct rigcheck_camera *out)
{
    const struct part *p = &c->part[i];
    const struct match_tracks t = {p->n_tracks, p->n, c->all.obs + p->first};
    for (int k = 0; k < t.n; k++)
        t.obs[k].track -= p->first_track;
    err_t e = rigcheck_run(c->r, &c->shape, &t, c->found.cams, out);
    for (int k = 0; k < t.n; k++)
        t.obs[k].track += p->first_track;
    for (int k = 0; k < c->shape.n && !e; k++)
        if (out[k].moved && taken_px(c, k, out[k].off_px) > 1)
            job_result_warn(c->out->notes,
                            "%.80s: the camera of %.64s stands %.1f px off where the other takes "
                            "have it: leave this take out, or the others",
                            c->job->take[i].name, name_of(c, k), taken_px(c, k, out[k].off_px));
    return e;
}

static err_t write_view(const struct rigcal *c, int i, struct rig_view *out)
{
    const struct shot *s = lenses_shot(c->job->take[0].capture, name_of(c, i));
    struct lens lens;
    bool resampled;
    if (!lenses_find(c->out->notes, s, &lens, &resampled))
        return err_fail(ERR_ARG, "%s: no lens was found", s->name);
    memcpy(out->name, s->name, sizeof out->name);
    memcpy(out->camera, s->camera_id, sizeof out->camera);
    out->cam = c->found.cams[i];
    out->cam.w = s->taken_w;
    out->cam.h = s->taken_h;
    cameras_set_covariance(c->covariance + COVARIANCE_POSE * i, 1, (double)c->depth[i], out);
    return cameras_set_lens("rig", s->name, &lens, out);
}

static err_t write_result(struct rigcal *c)
{
    struct rigcheck_camera *check = calloc((size_t)c->shape.n, sizeof *check);
    struct rig *rig = &c->out->rig;
    rig->views = calloc((size_t)c->shape.n, sizeof *rig->views);
    err_t e = check && rig->views ? OK : err_fail(ERR_NOMEM, "no memory for the rig");
    const bool checked = c->shape.n >= RIGCHECK_LEAST;
    for (int i = 0; i < c->job->n && c->job->n > 1 && checked && !e; i++)
        e = check_take(c, i, check);
    const size_t keep = arena_mark(c->r->keep), tmp = arena_mark(c->r->tmp);
    if (!e)
        e = see_take(c, 0, false);
    if (!e) {
        lenses_note(&c->lenses, c->job->take[0].capture, &c->found, c->seen);
        c->out->notes->n_found = c->seen->n_found;
        memcpy(c->out->notes->found, c->seen->found, sizeof c->seen->found);
    }
    for (int i = 0; i < c->shape.n && !e; i++)
        e = write_view(c, i, &rig->views[rig->n++]);
    arena_reset(c->r->keep, keep);
    arena_reset(c->r->tmp, tmp);
    c->out->rms_px = c->found.rms_px;
    c->out->inliers = c->found.inliers;
    c->out->observations = c->found.observations;
    free(check);
    return e;
}

/* ---- with a board ---- */

/* Lengths of the rig in metres. */
static void scale_rig(const struct rigcal *c, const struct rigboard *b)
{
    struct rig *rig = &c->out->rig;
    const double metres = rigboard_metres(c->job, b, rig);
    if (!(metres > 0)) {
        job_result_warn(c->out->notes, "no two cameras see the board at the same press, so that it "
                                       "says nothing about the scale, which stays free");
        return;
    }
    for (int i = 0; i < rig->n; i++) {
        for (int k = 0; k < 3; k++)
            rig->views[i].cam.t[k] = (float)((double)rig->views[i].cam.t[k] * metres);
        cameras_set_covariance(c->covariance + COVARIANCE_POSE * i, metres,
                               metres * (double)c->depth[i], &rig->views[i]);
    }
    rig->metres = true;
}

/* Lenses of the board as those of views: from the middle, px of the views. False where a photograph
 * is turned against its sensor. */
static bool use_lenses(struct rigcal *c, const struct rigboard *b)
{
    struct lenses *l = &c->lenses;
    const struct capture *first = c->job->take[0].capture;
    lenses_group(l, first, &c->seen->views, c->job->cfg);
    c->found = (struct bundle_result){.n_lenses = l->n,
                                      .lenses = c->lens,
                                      .selfcal = c->selfcal,
                                      .cams = c->cams,
                                      .placed = c->placed};
    for (int i = c->shape.n - 1; i >= 0; i--) {
        const struct shot *s = lenses_shot(first, name_of(c, i));
        const double scale = (double)num_max(c->shape.extent[i].w, c->shape.extent[i].h) /
                             num_max(s->taken_w, s->taken_h);
        struct lens lens = b->found.lens[b->lens_of[i]];
        lens.cx -= 0.5 * s->taken_w;
        lens.cy -= 0.5 * s->taken_h;
        lens_scale(&lens, scale, scale);
        c->lens[l->of[i]] = lens;
        if (s->turned != 0)
            return false;
    }
    return true;
}

/* What the takes show besides the board, adjusted together with it. */
static err_t add_points(struct rigcal *c, struct rigboard *b)
{
    struct rigsight_view view[RIGCHECK_MOST];
    struct boardcal in = rigboard_problem(c->job, b);
    struct rigsight s = {0};
    const size_t keep = arena_mark(c->r->keep), tmp = arena_mark(c->r->tmp);
    err_t e = lenses_layout(&c->lenses, c->r->keep, in.n_cameras);
    const size_t lenses = arena_mark(c->r->keep);
    if (!e)
        e = see_take(c, 0, false);
    const bool straight = !e && use_lenses(c, b);
    arena_reset(c->r->keep, lenses);
    arena_reset(c->r->tmp, tmp);
    if (straight)
        e = match_takes(c, true);
    for (int i = 0; i < c->shape.n && straight; i++)
        view[i] =
            (struct rigsight_view){c->extent[i].w, c->extent[i].h, (double)c->lenses.pinhole[i]};
    if (!e && straight)
        e = rigsight_make(&in, &b->found, view, &c->all, &s);
    if (!e && s.points.n > 0)
        e = boardcal_refine(c->r, &in, &s.points, &b->found);
    c->out->points = s.points.n;
    rigsight_free(&s);
    arena_reset(c->r->keep, keep);
    return e;
}

static err_t calibrate_points(struct rigcal *c)
{
    err_t e = lenses_layout(&c->lenses, c->r->keep, prep_places(c->job->take[0].capture));
    if (!e)
        e = find_start(c);
    if (!e)
        e = solve_all(c);
    if (!e)
        e = check_found(c);
    return e ? e : write_result(c);
}

static err_t calibrate(struct rigcal *c, struct rigboard *b)
{
    const struct rigcal_job *job = c->job;
    bool tied = false;
    err_t e = job->no_board ? OK : rigboard_find(c->r, job, c->out->notes, b);
    if (e)
        return e;
    if (!rigboard_seen(b) && job->tag_mm > 0)
        return err_fail(ERR_ARG,
                        "no camera sees %d tags of a board in these takes: take it nearer, "
                        "flat, sharp and lit, or leave out --tag",
                        RIGBOARD_LEAST);
    if (rigboard_seen(b))
        e = rigboard_solve(c->r, job, b, &tied);
    if (!e && tied)
        e = add_points(c, b);
    if (e || tied)
        return e ? e : rigboard_write(job, b, c->out);
    e = calibrate_points(c);
    if (e == ERR_ARG && rigboard_seen(b))
        return rigboard_untied(job, b);
    if (!e && rigboard_seen(b) && job->tag_mm > 0)
        scale_rig(c, b);
    return e;
}

err_t rigcal_run(const struct run *r, const struct rigcal_job *job, struct rigcal_result *out)
{
    struct rigcal *c = calloc(1, sizeof *c);
    struct rigboard *board = calloc(1, sizeof *board);
    const size_t keep = arena_mark(r->keep);
    memset(out, 0, sizeof *out);
    out->notes = calloc(1, sizeof *out->notes);
    err_t e = c && board && out->notes ? OK : err_fail(ERR_NOMEM, "no memory to calibrate a rig");
    if (!e) {
        *c = (struct rigcal){.r = r, .job = job, .out = out, .seen = calloc(1, sizeof *c->seen)};
        e = c->seen ? OK : err_fail(ERR_NOMEM, "no memory to calibrate a rig");
    }
    if (!e)
        e = calibrate(c, board);
    arena_reset(r->keep, keep);
    if (c) {
        free(c->seen);
        free(c->all.obs);
    }
    free(c);
    if (board)
        rigboard_free(board);
    free(board);
    return e;
}

void rigcal_free(struct rigcal_result *r)
{
    cameras_free(&r->rig);
    free(r->notes);
    memset(r, 0, sizeof *r);
}

/* ---- planning ---- */

static err_t check_takes(const struct rigcal_job *job)
{
    const struct capture *first = job->take[0].capture;
    const int n = prep_places(first);
    if (n < 2 || n > RIGCHECK_MOST)
        return err_fail(ERR_ARG, "%s: %d cameras, a rig of 2 to %d can be calibrated",
                        job->take[0].name, n, RIGCHECK_MOST);
    for (int i = 1; i < job->n; i++) {
        const struct capture *c = job->take[i].capture;
        int a = -1, b = -1;
        if (prep_places(c) != n)
            return err_fail(ERR_ARG, "%s has %d cameras, %s has %d: all takes must be of one rig",
                            job->take[i].name, prep_places(c), job->take[0].name, n);
        for (int k = 0; k < n; k++) {
            for (a++; first->shots[a].again; a++)
                ;
            for (b++; c->shots[b].again; b++)
                ;
            if (!name_same_view(first->shots[a].name, c->shots[b].name) ||
                first->shots[a].taken_w != c->shots[b].taken_w ||
                first->shots[a].taken_h != c->shots[b].taken_h)
                return err_fail(ERR_ARG,
                                "%s of %s is not of the camera of %s: all takes must be of one rig",
                                c->shots[b].name, job->take[i].name, first->shots[a].name);
        }
    }
    return OK;
}

/* Adds to *all what the take may have. extent: room for its photographs. */
static void plan_take(struct plan *p, const struct rigcal_job *job, int i, struct extent *extent,
                      struct match_tracks *all)
{
    const struct rigcal_take *t = &job->take[i];
    const struct prep_size size = {recipe_work(job->cfg), false};
    const size_t keep = arena_mark(&p->keep), tmp = arena_mark(&p->tmp);
    const int places = prep_places(t->capture);
    prep_extents(t->capture, size, extent);
    const struct views v = {.n = places,
                            .n_more = t->capture->n - places,
                            .size = size.edge,
                            .deep = prep_is_deep(t->capture, t->source),
                            .extent = extent};
    struct match_tracks most;
    prep_plan_capture(p, t->capture, t->source, size);
    arena_step(&p->tmp, response_plan(&v));
    exposure_stack_choose_plan(p, &v);
    exposure_stack_merge_plan(p, &v);
    const size_t before = arena_mark(&p->keep);
    locate_plan(p, &v, lenses_count(t->capture));
    arena_reset(&p->keep, before);
    match_plan(p, &v, 0, &most);
    all->n += most.n;
    all->n_tracks += most.n_tracks;
    arena_reset(&p->keep, keep);
    arena_reset(&p->tmp, tmp);
}

err_t rigcal_plan(const struct rigcal_job *job, int threads, struct job_memory *out)
{
    struct plan p = plan_begin(threads);
    struct match_tracks all = {0};
    struct lenses l;
    size_t pictures = 0, most = 0;
    err_t e = check_takes(job);
    if (e)
        return e;
    for (int i = 0; i < job->n; i++)
        most = num_max_size(most, (size_t)job->take[i].capture->n);
    struct extent *extent = calloc(most, sizeof *extent);
    const int places = prep_places(job->take[0].capture);
    if (!extent)
        return err_fail(ERR_NOMEM, "no memory for the shapes of %zu photographs", most);
    if (lenses_layout(&l, &p.keep, places))
        plan_refuse(&p);
    for (int i = 0; i < job->n; i++) {
        plan_take(&p, job, i, extent, &all);
        pictures = num_max_size(pictures, imageset_bytes(job->take[i].capture, threads));
    }
    free(extent);
    bundle_plan(&p, places, lenses_count(job->take[0].capture), &all);
    rigcheck_plan(&p, places, &all);
    if (!job->no_board)
        rigboard_plan(&p, job, &all);
    *out = (struct job_memory){.pictures = pictures, .keep = p.keep.peak, .tmp = p.tmp.peak};
    return OK;
}
