#include "firmware/job.h"

#include "firmware/draw.h"
#include "firmware/engine.h"

#include "core/opt/response.h"
#include "core/prep.h"
#include "core/splat/gaussians.h"
#include "core/splat/seed.h"
#include "core/splat/sweep.h"

#include <math.h>
#include <stdarg.h>
#include <string.h>

static const char *const stage_names[JOB_STAGES] = {"preprocess", "response", "sweep", "seed",
                                                    "refine",     "render",   "write", "measure"};

static void announce(const struct run *r, enum job_stage stage)
{
    if (r->progress)
        r->progress(r->progress_ctx, stage_names[stage], 0, 1, NULL);
}

/* ---- the map ---- */

/* The scene before its first splat: response and cameras, and room for what refinement may add. */
static err_t begin_scene(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    const struct views *v = &out->views;
    struct scene *s = &out->scene;
    size_t n = (size_t)v->n;
    *s = (struct scene){.tone = out->response,
                        .n_views = v->n,
                        .size = v->size,
                        .names = v->names,
                        .log2t = v->log2t};
    err_t e = arena_alloc(r->keep, n, sizeof *s->cams, &s->cams);
    if (!e)
        e = gaussians_init(&s->g, r->keep, cfg->refine.gaussians_max, cfg->refine.degree_max);
    if (!e)
        memcpy(s->cams, v->cams, n * sizeof *s->cams);
    return e;
}

/* Depth and seeds lie behind the scene in keep and are given back. */
static err_t place_splats(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    struct depthmaps depth;
    struct gaussians seeds;
    struct gaussians *g = &out->scene.g;
    size_t mark = arena_mark(r->keep);
    announce(r, JOB_SWEEP);
    err_t e = sweep_run(r, &out->views, &out->response, &depth);
    job_lap(out, JOB_SWEEP);
    if (!e) {
        announce(r, JOB_SEED);
        struct seed_input in = {.views = &out->views, .depth = &depth, .tone = &out->response};
        /* half of the room: the refiner splits where the photographs hold more than noise */
        e = seed_run(r, &in, (cfg->refine.gaussians_max + 1) / 2, &seeds);
    }
    g->degree = 0; // refinement adds bands where the photographs ask for them
    for (int p = 0; !e && p < gaussians_planes(0); p++)
        memcpy(g->plane[p], seeds.plane[p], (size_t)seeds.n * sizeof(float));
    if (!e)
        g->n = seeds.n;
    arena_reset(r->keep, mark);
    job_lap(out, JOB_SEED);
    return e;
}

static struct job_config within(const struct job_config *cfg, int n_views);

err_t job_run(const struct run *r, const struct capture *c, const struct job_config *asked,
              struct job_result *out)
{
    struct job_config cfg = within(asked, c->n);
    memset(out, 0, sizeof *out);
    out->input_psnr = NAN;
    out->start_s = out->lap_s = engine_seconds();
    announce(r, JOB_PREPROCESS);
    err_t e = prep_run(r, c, cfg.size, &out->views);
    job_lap(out, JOB_PREPROCESS);
    if (!e)
        e = response_run(r, &out->views, &out->response);
    job_lap(out, JOB_RESPONSE);
    if (!e)
        e = begin_scene(r, &cfg, out);
    if (!e)
        e = place_splats(r, &cfg, out);
    if (!e)
        e = refine_run(r, &out->views, &cfg.refine, &out->scene, &out->refine);
    job_lap(out, JOB_REFINE);
    if (!e && out->scene.g.n == 0)
        job_warn(out, "the scene is empty: no splat was found or kept");
    out->keep_peak = r->keep->peak;
    out->tmp_peak = r->tmp->peak;
    return e;
}

/* ---- planning ---- */

/* More splats than pixels serve nothing. */
static struct job_config within(const struct job_config *cfg, int n_views)
{
    struct job_config out = *cfg;
    long long pixels = (long long)n_views * cfg->size * cfg->size;
    if (out.refine.gaussians_max > pixels)
        out.refine.gaussians_max = (int)pixels;
    return out;
}

static size_t max_size(size_t a, size_t b)
{
    return a > b ? a : b;
}

static err_t check_capture(const struct capture *c)
{
    if (c->n < 2)
        return err_fail(ERR_ARG, "%d view, a scene needs at least 2", c->n);
    for (int i = 0; i < c->n; i++)
        if (!c->shots[i].has_camera)
            return err_fail(
                ERR_ARG,
                "%s: its camera is not known; give --rig PATH, or put a sparse/0 folder beside the "
                "pictures",
                c->shots[i].name);
    return OK;
}

err_t job_plan(const struct capture *c, const struct job_config *asked, int threads,
               struct job_memory *out)
{
    err_t e = check_capture(c);
    if (e)
        return e;
    struct job_config cfg = within(asked, c->n);
    int cap = cfg.refine.gaussians_max;
    struct views v = {.n = c->n, .size = cfg.size}; // all that plans look at
    memset(out, 0, sizeof *out);
    for (int i = 0; i < c->n; i++)
        out->pictures = arena_add(out->pictures, arena_need((size_t)c->shots[i].image.w,
                                                            (size_t)c->shots[i].image.h * 3));
    prep_plan(c, cfg.size, threads, &out->keep, &out->tmp);
    out->keep = arena_add(out->keep, arena_need((size_t)c->n, sizeof(struct camera)));
    out->keep = arena_add(out->keep, gaussians_need(cap, cfg.refine.degree_max));
    out->keep = arena_add(out->keep, arena_add(sweep_keep(&v), seed_keep(cap)));
    out->tmp = max_size(out->tmp, response_plan(&v));
    out->tmp = max_size(out->tmp, sweep_plan(&v, threads));
    out->tmp = max_size(out->tmp, seed_plan(&v));
    out->tmp = max_size(out->tmp, refine_plan(c->n, cfg.size, &cfg.refine, threads));
    out->tmp = max_size(out->tmp, draw_plan(cap, cfg.size, cfg.size));
    return OK;
}

/* ---- times and words ---- */

void job_lap(struct job_result *j, enum job_stage stage)
{
    double now = engine_seconds();
    j->seconds[stage] += now - j->lap_s;
    j->lap_s = now;
}

void job_warn(struct job_result *j, const char *fmt, ...)
{
    if (j->n_warnings == JOB_WARNINGS)
        return;
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(j->warnings[j->n_warnings++], sizeof j->warnings[0], fmt, ap);
    va_end(ap);
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

/* What refinement decided and reached, on squares of the input views that it did not learn from. */
static void report_making(const struct job_result *j, struct report *rep)
{
    bool held_out = j->refine.steps > 0;
    report_int(rep, "refine_steps", j->refine.steps);
    report_bool(rep, "refine_stopped_early", j->refine.stopped_early);
    report_open(rep, "quality", '{');
    report_number(rep, "ldr_input_psnr", j->input_psnr);
    report_number(rep, "held_out_psnr_start", held_out ? (double)j->refine.held_out_db[0] : NAN);
    report_number(rep, "held_out_psnr", held_out ? (double)j->refine.held_out_db[1] : NAN);
    report_close(rep);
    report_words(rep, "modelled", j->refine.n_notes, j->refine.notes[0], sizeof j->refine.notes[0]);
}

void job_report(const struct job_result *j, int threads, struct report *rep)
{
    report_int(rep, "views", j->scene.n_views);
    report_open(rep, "size", '[');
    report_int(rep, NULL, j->scene.size);
    report_int(rep, NULL, j->scene.size);
    report_close(rep);
    report_text(rep, "precision", "fp32");
    report_int(rep, "threads", threads);
    report_int(rep, "gaussians", j->scene.g.n);
    report_int(rep, "sh_degree", j->scene.g.degree);
    report_number(rep, "mid_exposure_log2", (double)j->scene.tone.mid_log2t);
    if (!j->measured_only)
        report_making(j, rep);
    report_seconds(j, rep);
    report_number(rep, "peak_rss_mb", engine_peak_rss_mb());
    report_number(rep, "keep_peak_mb", (double)j->keep_peak * 1e-6);
    report_number(rep, "tmp_peak_mb", (double)j->tmp_peak * 1e-6);
    report_words(rep, "warnings", j->n_warnings, j->warnings[0], sizeof j->warnings[0]);
}
