#include "firmware/recon/job.h"

#include "firmware/base/engine.h"
#include "firmware/recon/agree.h"
#include "firmware/recon/budget.h"
#include "firmware/recon/enlarge.h"
#include "firmware/recon/figures.h"
#include "firmware/recon/shading.h"
#include "firmware/recon/start.h"
#include "firmware/recon/verify.h"
#include "firmware/result/draw.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/photo/exposure_stack.h"
#include "core/photo/prep.h"
#include "core/photo/response.h"
#include "core/photo/undistort.h"
#include "drivers/format/imageset.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char *const stage_names[JOB_STAGES] = {
    "preprocess", "response", "cameras", "sweep",      "completion", "seed",  "backbone", "heads",
    "appearance", "voxel",    "refine",  "confidence", "render",     "write", "measure"};

static void announce_stage(const struct run *r, enum job_stage stage)
{
    if (r->progress)
        r->progress(r->progress_ctx, stage_names[stage], 0, 1, NULL);
}

/* ---- steps ---- */

static err_t layout_db(float **db, struct arena *keep, int n)
{
    return arena_alloc(keep, (size_t)n, sizeof **db, db);
}

static err_t layout_left_out(uint8_t **cells, struct arena *keep, const struct views *v)
{
    return arena_alloc(keep, refine_cells(v), 1, cells);
}

static bool has_same_lens(const struct shot *a, const struct shot *b)
{
    double x[LENS_PARAMS] = {0}, y[LENS_PARAMS] = {0};
    lens_params(&a->lens, x);
    lens_params(&b->lens, y);
    return a->lens.model == b->lens.model && memcmp(x, y, sizeof x) == 0 &&
           a->taken_w == b->taken_w && a->taken_h == b->taken_h;
}

/* One line for each lens that photographs were undistorted from. */
static void note_lenses(const struct capture *c, struct job_result *out)
{
    for (int i = 0; i < c->n && out->n_lenses < JOB_LENSES; i++) {
        const struct shot *s = &c->shots[i];
        int first = 0, n = 0;
        while (!has_same_lens(&c->shots[first], s))
            first++;
        for (int k = i; k < c->n; k++)
            n += has_same_lens(&c->shots[k], s);
        if (first < i || !lens_distorts(&s->lens))
            continue;
        const struct undistort_field f = undistort_field(&s->lens, s->taken_w, s->taken_h, &s->cam);
        snprintf(out->lenses[out->n_lenses++], sizeof out->lenses[0],
                 "%d photograph%s of %d x %d px undistorted (%s): %d x %d px show %.0f x %.0f of "
                 "%.0f x %.0f degrees",
                 n, n == 1 ? "" : "s", s->taken_w, s->taken_h, lens_name(s->lens.model), s->cam.w,
                 s->cam.h, f.kept_deg[0], f.kept_deg[1], f.given_deg[0], f.given_deg[1]);
    }
}

static bool is_masked(const struct views *v, int i)
{
    const size_t n = extent_pixels(&v->extent[i]);
    return v->masked && !memchr(views_masked(v, i), 0, n);
}

/* Say which photographs are masked all over. */
static err_t check_masks(struct job_result *out)
{
    const struct views *v = &out->views;
    int n = 0, first = 0;
    for (int i = v->n + v->n_more - 1; i >= 0; i--)
        if (is_masked(v, i)) {
            first = i;
            n++;
        }
    if (n == v->n + v->n_more)
        return err_fail(ERR_ARG, "masks hide all of every photograph: what is black in a mask does "
                                 "not count, white does");
    if (n)
        job_result_warn(out,
                        "%d photograph%s masked all over (%.64s): what is black in a mask does not "
                        "count",
                        n, n == 1 ? " is" : "s are", v->names[first]);
    return OK;
}

/* Photographs become views; redundant exposures are dropped once there is a response. */
static err_t read_photographs(const struct run *r, const struct capture *c, const struct start *s,
                              struct job_result *out)
{
    const struct job_config *cfg = s->cfg;
    const struct prep_size size = {s->recipe->work, s->recipe->square};
    announce_stage(r, JOB_PREPROCESS);
    note_lenses(c, out);
    err_t e = prep_read(r, c, cfg->source, size, &out->views);
    if (!e)
        e = check_masks(out);
    if (!e)
        e = layout_db(&out->input_db, r->keep, c->n);
    for (int i = 0; i < c->n && !e; i++)
        out->input_db[i] = NAN;
    job_result_lap(out, JOB_PREPROCESS);
    return e;
}

/* The response, and the exposures of full brackets that are worth keeping. */
static err_t find_response(const struct run *r, const struct recipe *recipe, struct job_result *out)
{
    err_t e = job_result_curve(r, out);
    if (!e && out->views.n_more) {
        out->taken = out->views.n + out->views.n_more;
        e = exposure_stack_choose(r, &out->response, recipe->depth == RECIPE_NETWORK, &out->views);
        if (!e)
            e = job_result_curve(r, out);
    }
    job_result_lap(out, JOB_RESPONSE);
    return e;
}

/* The photographs are read again at the size of refinement. */
static err_t enlarge_views(const struct run *r, const struct capture *c, const struct start *s,
                           struct job_result *out)
{
    err_t e = OK;
    if (s->recipe->size > s->recipe->work)
        e = enlarge_run(r, c, s->cfg, s->recipe->size, out);
    job_result_lap(out, JOB_PREPROCESS);
    return e;
}

static err_t refine_scene(const struct run *r, const struct start *s, struct job_result *out)
{
    struct refine_config cfg = s->recipe->refinement;
    /* a network's Gaussians have its own curve unless they were corrected */
    const bool own = s->recipe->gaussians == RECIPE_NETWORK && !start_corrects(s);
    cfg.tone_known = out->views.srgb && !own;
    err_t e = layout_left_out(&cfg.left_out, r->keep, &out->views);
    if (!e)
        e = refine_run(r, &out->views, &cfg, &out->scene, &out->refine);
    job_result_lap(out, JOB_REFINE);
    return e ? e : agree_scene(r, &out->scene, "after refinement");
}

static err_t choose_within_budget(const struct run *r, const struct start *s, struct recipe *recipe,
                                  struct job_result *out)
{
    err_t e = budget_choose(r, s->capture, s->cfg, recipe, out);
    if (!e)
        e = agree_scene(r, &out->scene, "before refinement");
    recipe_tell_size(recipe, s->capture, out->cameras.edge, out->sizing, sizeof out->sizing);
    return e;
}

static err_t find_confidence(const struct run *r, struct job_result *out)
{
    announce_stage(r, JOB_CONFIDENCE);
    err_t e = confidence_run(r, &out->views, &out->scene, &out->advice);
    job_result_lap(out, JOB_CONFIDENCE);
    return e;
}

static void begin_result(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    memset(out, 0, sizeof *out);
    out->team = r->team;
    out->input_psnr = NAN;
    out->start_s = out->lap_s = engine_seconds();
    if (cfg->network)
        out->precision = modelfile_precision(cfg->network->file.model.precision);
}

static void finish_result(const struct run *r, struct job_result *out)
{
    if (out->scene.g.n == 0)
        job_result_warn(out, "the scene is empty, no splat was found or kept: take sharp "
                             "photographs of one place that overlap by more than half");
    out->keep_peak = r->keep->peak;
    out->tmp_peak = r->tmp->peak;
}

err_t job_run(const struct run *r, const struct capture *c, const struct job_config *cfg,
              struct job_result *out)
{
    struct recipe recipe = recipe_choose(c, cfg, r->tap != NULL);
    struct start start = {.run = r, .capture = c, .cfg = cfg, .recipe = &recipe, .out = out};
    begin_result(r, cfg, out);
    out->capture = c;
    err_t e = read_photographs(r, c, &start, out);
    if (!e)
        e = agree_views(r, &out->views);
    if (!e)
        e = find_response(r, &recipe, out);
    if (!e)
        e = start_scene(&start);
    if (!e)
        e = start_brackets(&start);
    if (!e && recipe.check)
        e = verify_run(r, cfg->moved, out);
    if (!e && recipe.network)
        e = start_network(&start);
    if (!e && recipe.bundle)
        e = start_bundle(&start);
    if (!e)
        e = start_cameras(&start);
    if (!e && (recipe.depth == RECIPE_STEREO || start_corrects(&start)))
        e = start_stereo(&start);
    if (!e && start_corrects(&start))
        e = start_correct(&start);
    if (!e)
        e = start_gaussians(&start);
    if (!e)
        e = choose_within_budget(r, &start, &recipe, out);
    if (!e)
        e = enlarge_views(r, c, &start, out);
    if (!e && recipe.refine)
        e = refine_scene(r, &start, out);
    if (!e)
        e = find_confidence(r, out);
    if (!e)
        finish_result(r, out);
    return e;
}

/* ---- planning ---- */

/* All cameras are known, or none. */
static err_t check_capture(const struct capture *c)
{
    if (prep_places(c) < 2)
        return err_fail(ERR_ARG,
                        "%d view, a scene needs at least 2, from different places; 8 to 20 "
                        "are good%s",
                        prep_places(c),
                        c->n > 1 ? "; all photographs are exposures of one place" : "");
    for (int i = 1; i < c->n; i++)
        if (c->shots[i].has_camera != c->shots[0].has_camera)
            return err_fail(ERR_ARG,
                            "%s: its camera is not known, that of %s is; give all of them with "
                            "--rig PATH, or none: --rig none",
                            c->shots[c->shots[i].has_camera ? 0 : i].name,
                            c->shots[c->shots[i].has_camera ? i : 0].name);
    return OK;
}

/* Shapes of the views, which are all that plans read. own: v->extent. */
static err_t shape_views(const struct capture *c, const struct job_config *cfg,
                         const struct recipe *recipe, int size, struct views *v)
{
    *v = (struct views){.n = recipe->places,
                        .n_more = c->n - recipe->places,
                        .size = size,
                        .deep = prep_is_deep(c, cfg->source),
                        .extent = malloc((size_t)c->n * sizeof *v->extent)};
    if (!v->extent)
        return err_fail(ERR_NOMEM, "no memory for the shapes of %d photographs", c->n);
    prep_extents(c, (struct prep_size){size, recipe->square}, v->extent);
    return OK;
}

/* Views of `work`, `closer` and `size`. */
struct job_views {
    struct views small, closer, large;
};

static void plan_steps(struct plan *p, const struct capture *c, const struct job_config *cfg,
                       const struct recipe *recipe, const struct job_views *v)
{
    const struct views *small = &v->small, *large = &v->large;
    const struct extent most = extent_cover(large->extent, large->n);
    float *db;
    prep_plan_capture(p, c, cfg->source, (struct prep_size){recipe->work, recipe->square});
    if (layout_db(&db, &p->keep, c->n))
        plan_refuse(p);
    arena_step(&p->tmp, response_plan(small));
    exposure_stack_choose_plan(p, small);
    if (recipe->check)
        verify_plan(p, small);
    start_plan(p, c, cfg, recipe, small, &v->closer);
    if (recipe->size > recipe->work)
        enlarge_plan(p, c, cfg->source, recipe->size);
    uint8_t *cells;
    if (recipe->refine && layout_left_out(&cells, &p->keep, large))
        plan_refuse(p);
    if (recipe->refine)
        arena_step(&p->tmp, refine_plan(large, &recipe->refinement, p->threads));
    confidence_plan(p, recipe->gaussians_max);
    /* publishing renders the views */
    size_t drawn = arena_add(draw_plan(recipe->gaussians_max, most.w, most.h),
                             draw_confidence_plan(recipe->gaussians_max, most.w, most.h));
    drawn = arena_add(drawn, arena_need((size_t)most.w * (size_t)most.h, 1));
    arena_step(&p->tmp, drawn);
}

err_t job_plan(const struct capture *c, const struct job_config *cfg, int threads, bool tapped,
               const struct team *team, struct job_memory *out)
{
    err_t e = check_capture(c);
    if (e)
        return e;
    const struct recipe recipe = recipe_choose(c, cfg, tapped);
    struct plan p = plan_begin(threads);
    p.team = team;
    struct job_views v = {0};
    e = recipe_check(&recipe, c);
    if (!e)
        e = shape_views(c, cfg, &recipe, recipe.work, &v.small);
    if (!e)
        e = shape_views(c, cfg, &recipe, num_max(recipe.work, recipe.closer), &v.closer);
    if (!e)
        e = shape_views(c, cfg, &recipe, recipe.size, &v.large);
    if (!e)
        plan_steps(&p, c, cfg, &recipe, &v);
    free(v.small.extent);
    free(v.closer.extent);
    free(v.large.extent);
    if (e)
        return e;
    const bool weights = recipe.network || recipe.complete;
    *out = (struct job_memory){.pictures = imageset_bytes(c, cfg->source ? threads : c->n),
                               .weights = weights ? cfg->network->file.model.bytes : 0,
                               .keep = p.keep.peak,
                               .tmp = p.tmp.peak};
    return OK;
}

/* ---- report ---- */

static void report_cameras(const struct job_cameras *c, struct report *rep)
{
    if (!c->found)
        return;
    report_open(rep, "cameras", '{');
    report_number(rep, "confidence", (double)c->confidence);
    report_int(rep, "edge_px", c->edge);
    report_number(rep, "rms_px", (double)c->rms_px);
    report_int(rep, "points_seen", c->observations);
    report_int(rep, "points_agree", c->inliers);
    report_int(rep, "views_placed", c->placed);
    report_bool(rep, "start_was_network", !c->from_tracks);
    report_close(rep);
}

static void report_confidence(const struct job_result *j, struct report *rep)
{
    static const char *const ways[CONFIDENCE_WAYS] = {"left", "right", "above", "below"};
    const struct confidence_advice *a = &j->advice;
    if (!j->scene.confidence)
        return;
    report_open(rep, "confidence", '{');
    report_number(rep, "mean", j->confidence_mean);
    report_number(rep, "guesses", j->guesses);
    report_close(rep);
    if (j->measured_only || a->near < 0)
        return;
    report_open(rep, "suggested_photograph", '{');
    report_text(rep, "near", j->scene.names[a->near]);
    report_text(rep, "direction", ways[a->way]);
    report_int(rep, "degrees", CONFIDENCE_STEP);
    report_number(rep, "gain", (double)a->gain);
    double q[4], t[3];
    for (int k = 0; k < 4; k++)
        q[k] = (double)a->cam.q[k];
    for (int k = 0; k < 3; k++)
        t[k] = (double)a->cam.t[k];
    report_row(rep, "q", q, 4);
    report_row(rep, "t", t, 3);
    report_close(rep);
}

static void report_words(struct report *rep, const char *key, int n, const char *first,
                         size_t stride)
{
    report_open(rep, key, '[');
    for (int i = 0; i < n; i++)
        report_text(rep, NULL, first + (size_t)i * stride);
    report_close(rep);
}

static void report_seconds(const struct job_result *j, struct report *rep)
{
    report_open(rep, "seconds", '{');
    for (int i = 0; i < JOB_STAGES; i++)
        if (j->seconds[i] > 0)
            report_number(rep, stage_names[i], j->seconds[i]);
    report_number(rep, "total", j->lap_s - j->start_s);
    report_close(rep);
}

/* Of the first rank, which writes the report. */
static void report_team(const struct job_result *j, struct report *rep)
{
    if (!j->team)
        return;
    report_int(rep, "ranks", j->team->size);
    report_number(rep, "seconds_waited", j->team->waited_s);
    report_open(rep, "bytes_sent", '{');
    for (int i = 0; i < JOB_STAGES; i++)
        if (j->sent[i] > 0)
            report_number(rep, stage_names[i], (double)j->sent[i]);
    report_close(rep);
}

static void tell_far(const struct job_result *j, struct report *rep)
{
    char text[160];
    const double far = 100 * ((double)j->sky + (double)j->backdrop);
    if (far <= 0)
        return;
    int n =
        snprintf(text, sizeof text, "%.1f %% of the pixels look like %s: put far behind all else",
                 far, j->sky > j->backdrop ? "sky" : "a black backdrop");
    if (j->sky_filled > 0)
        snprintf(text + n, sizeof text - (size_t)n,
                 "; %d Gaussians fill it where no photograph shows it", j->sky_filled);
    report_text(rep, NULL, text);
}

/* Decisions and error of refinement, on squares of the input views that it did not learn from. */
static void report_making(const struct job_result *j, struct report *rep)
{
    bool held_out = j->refine.steps > 0;
    report_int(rep, "refine_steps", j->refine.steps);
    report_int(rep, "refine_step_kept", j->refine.step_kept);
    report_bool(rep, "refine_stopped_early", j->refine.stopped_early);
    report_open(rep, "quality", '{');
    report_number(rep, "ldr_input_psnr", j->input_psnr);
    report_number(rep, "held_out_psnr_start", held_out ? (double)j->refine.held_out_db[0] : NAN);
    report_number(rep, "held_out_psnr", held_out ? (double)j->refine.held_out_db[1] : NAN);
    report_close(rep);
    lenses_report(j, rep);
    verify_report(j, rep);
    shading_report(j, rep);
    report_words(rep, "undistorted", j->n_lenses, j->lenses[0], sizeof j->lenses[0]);
    report_open(rep, "modelled", '[');
    report_text(rep, NULL, j->sizing);
    if (j->budget[0])
        report_text(rep, NULL, j->budget);
    shading_tell(j, rep);
    tell_far(j, rep);
    if (j->completed > 0) {
        char text[128];
        snprintf(text, sizeof text,
                 "depth of %.0f %% of the pixels by the network, where stereo is not sure",
                 (double)(100 * j->completed));
        report_text(rep, NULL, text);
    }
    if (j->views.n_more > 0) {
        char text[128];
        snprintf(text, sizeof text, "%d photographs from %d places: those of a bracket share one",
                 j->views.n + j->views.n_more, j->views.n);
        report_text(rep, NULL, text);
    }
    if (j->taken > j->views.n + j->views.n_more) {
        char text[128];
        snprintf(text, sizeof text, "%d of %d photographs: the others show nothing more",
                 j->views.n + j->views.n_more, j->taken);
        report_text(rep, NULL, text);
    }
    for (int i = 0; i < j->refine.n_notes; i++)
        report_text(rep, NULL, j->refine.notes[i]);
    report_close(rep);
}

/* Widest and highest view. */
static void report_size(const struct scene *s, struct report *rep)
{
    const struct extent most = draw_cover(s);
    report_open(rep, "size", '[');
    report_int(rep, NULL, most.w);
    report_int(rep, NULL, most.h);
    report_close(rep);
}

void job_report(const struct job_result *j, int threads, struct report *rep)
{
    report_int(rep, "views", j->scene.n_views);
    if (j->views.n > 0)
        report_int(rep, "photographs", j->views.n + j->views.n_more);
    report_size(&j->scene, rep);
    report_text(rep, "precision", j->precision ? j->precision : "fp32");
    report_bool(rep, "network", j->precision != NULL);
    report_int(rep, "threads", threads);
    report_int(rep, "gaussians", j->scene.g.n);
    report_int(rep, "sh_degree", j->scene.g.degree);
    report_number(rep, "mid_exposure_log2", (double)j->scene.tone.mid_log2t);
    if (!j->measured_only)
        report_making(j, rep);
    report_cameras(&j->cameras, rep);
    report_confidence(j, rep);
    figures_report(j, rep);
    report_seconds(j, rep);
    report_team(j, rep);
    report_number(rep, "peak_rss_mb", j->peak_rss_mb);
    report_number(rep, "keep_peak_mb", (double)j->keep_peak * 1e-6);
    report_number(rep, "tmp_peak_mb", (double)j->tmp_peak * 1e-6);
    report_words(rep, "warnings", j->n_warnings, j->warnings[0], sizeof j->warnings[0]);
}
