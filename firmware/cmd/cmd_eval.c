/* hdrig eval: reconstruct a data set, or take a result of it, and measure it on its held-out views.
 */
#include "firmware/base/engine.h"
#include "firmware/cmd/cmd.h"
#include "firmware/recon/evaluate.h"
#include "firmware/recon/lenses.h"
#include "firmware/recon/lpips_weights.h"
#include "firmware/recon/stored.h"
#include "firmware/recon/testcams.h"
#include "firmware/result/report_page.h"

#include "core/base/num.h"
#include "core/photo/metrics.h"
#include "core/photo/prep.h"
#include "core/photo/response.h"
#include "core/sfm/pose.h"
#include "drivers/format/cameras.h"
#include "drivers/format/scenefile.h"

#include <math.h>
#include <string.h>

struct request {
    struct imageset_request set;
    struct cmd_model model;
    const char *scene, *views, *exposures, *protocol, *lpips, *out, *json;
    struct outdir_rules rules;
    bool strict, resume;
    struct config cfg;
};

struct state {
    struct teamwork team;
    struct engine engine;
    struct network network;
    struct lpips_weights lpips; // zeroed: not asked for
    struct imageset train, test;
    struct prep_source source;             // of train
    struct imageset true_train, true_test; // with cameras, if the network had to find them
    struct outdir out;
    struct resume resume;
    struct cmd_json json;
    struct job_result job;
    struct evaluate_result figures;
    struct pose_error pose;
};

static void report_score(struct report *rep, const char *key, const struct evaluate_score *s)
{
    if (s->n == 0) {
        report_text(rep, key, NULL);
        return;
    }
    report_open(rep, key, '{');
    report_number(rep, "psnr", s->psnr);
    report_number(rep, "ssim", s->ssim);
    report_number(rep, "lpips", s->lpips);
    report_int(rep, "images", s->n);
    report_close(rep);
}

/* null if cameras were given, or nobody knows better ones. */
static void report_pose(struct report *rep, const struct pose_error *p)
{
    if (p->n == 0) {
        report_text(rep, "pose", NULL);
        return;
    }
    report_open(rep, "pose", '{');
    report_number(rep, "rot_deg_median", p->rot_deg);
    report_number(rep, "trans_rel_median", p->trans);
    report_number(rep, "focal_rel", p->focal);
    report_int(rep, "cameras", p->n);
    report_close(rep);
}

static double trust_share(const struct evaluate_trust *t)
{
    return t->pixels[0] / (t->pixels[0] + t->pixels[1]);
}

/* NAN without pixels. */
static double trust_psnr(const struct evaluate_trust *t, int known)
{
    return t->pixels[known] > 0
               ? fmin(-10 * log10(t->squares[known] / t->pixels[known]), METRICS_PSNR_MAX)
               : NAN;
}

static void report_trust(const struct evaluate_trust *t, struct report *rep)
{
    report_open(rep, "guesses", '{');
    report_number(rep, "share", trust_share(t));
    report_number(rep, "psnr", trust_psnr(t, 0));
    report_number(rep, "psnr_elsewhere", trust_psnr(t, 1));
    report_close(rep);
}

static void report_pictures(const struct evaluate_result *fig, struct report *rep)
{
    report_open(rep, "pictures", '[');
    for (int i = 0; i < fig->n_pictures; i++) {
        const struct evaluate_picture *p = &fig->pictures[i];
        report_open(rep, NULL, '{');
        report_text(rep, "name", p->name);
        report_number(rep, "exposure", p->exposure);
        report_bool(rep, "exposure_seen", p->seen);
        report_number(rep, "psnr", p->psnr);
        report_number(rep, "ssim", p->ssim);
        report_number(rep, "lpips", p->lpips);
        report_close(rep);
    }
    report_close(rep);
}

static const struct lpips *lpips_of(const struct state *st)
{
    return st->lpips.net.layers ? &st->lpips.net : NULL;
}

/* What the distances were measured with. */
static void report_lpips(const struct state *st, struct report *rep)
{
    const struct lpips *l = lpips_of(st);
    if (!l) {
        report_text(rep, "lpips", NULL);
        return;
    }
    report_open(rep, "lpips", '{');
    report_text(rep, "net", l->layers->name);
    report_row(rep, "range", (const double[]){l->centred ? -1 : 0, 1}, 2);
    report_text(rep, "source", st->lpips.file.model.source);
    report_close(rep);
}

static void write_report(const struct state *st, FILE *f)
{
    struct report rep;
    const struct evaluate_result *fig = &st->figures;
    report_begin(&rep, f);
    report_int(&rep, "test_views", fig->views);
    report_score(&rep, "ldr", &fig->ldr);
    report_score(&rep, "hdr", &fig->hdr);
    report_number(&rep, "hdr_stops", fig->n_stops ? fig->stops : NAN);
    report_score(&rep, "ldr_seen_exposures", &fig->ldr_seen);
    report_score(&rep, "ldr_unseen_exposures", &fig->ldr_unseen);
    report_score(&rep, "baseline_nearest", &fig->nearest);
    report_lpips(st, &rep);
    report_trust(&fig->trust, &rep);
    report_pose(&rep, &st->pose);
    report_open(&rep, "per_exposure", '[');
    for (int i = 0; i < fig->n_exposures; i++) {
        report_open(&rep, NULL, '{');
        report_number(&rep, "exposure", fig->exposures[i].exposure);
        report_number(&rep, "psnr", fig->exposures[i].score.psnr);
        report_number(&rep, "ssim", fig->exposures[i].score.ssim);
        report_number(&rep, "lpips", fig->exposures[i].score.lpips);
        report_close(&rep);
    }
    report_close(&rep);
    report_pictures(fig, &rep);
    job_report(&st->job, pool_size(st->engine.pool), &rep);
    report_close(&rep);
}

static void print_score(const char *what, const struct evaluate_score *s)
{
    if (s->n == 0)
        return;
    printf("%-18s %9.3f %9.4f", what, s->psnr, s->ssim);
    if (isfinite(s->lpips))
        printf(" %9.4f", s->lpips);
    printf(" %7d\n", s->n);
}

static void print_worst(const struct evaluate_result *fig)
{
    const struct evaluate_picture *worst = fig->pictures;
    for (int i = 1; i < fig->n_pictures; i++)
        worst = fig->pictures[i].psnr < worst->psnr ? &fig->pictures[i] : worst;
    if (fig->n_pictures > 1)
        printf("worst: %s, %.1f dB\n", worst->name, worst->psnr);
}

static void print_table(const struct state *st)
{
    const struct evaluate_result *fig = &st->figures;
    char count[CMD_COUNT_CAP];
    printf("%d input views, %d Gaussians of SH degree %d", st->job.scene.n_views, st->job.scene.g.n,
           st->job.scene.g.degree);
    if (!st->job.measured_only)
        printf(", %d steps", st->job.refine.steps);
    printf(", %.1f s%s\n\n", st->job.lap_s - st->job.start_s, cmd_count_warnings(&st->job, count));
    printf("%-18s %9s %9s %s%7s\n", "", "PSNR dB", "SSIM", lpips_of(st) ? "    LPIPS " : "",
           "images");
    print_score("LDR", &fig->ldr);
    for (int i = 0; i < fig->n_exposures; i++) {
        char what[32];
        snprintf(what, sizeof what, "  exposure %g", fig->exposures[i].exposure);
        print_score(what, &fig->exposures[i].score);
    }
    if (fig->ldr_seen.n > 0 && fig->ldr_unseen.n > 0) {
        print_score("  as in the inputs", &fig->ldr_seen);
        print_score("  not in the inputs", &fig->ldr_unseen);
    }
    print_score("HDR mu-law", &fig->hdr);
    print_score("nearest input view", &fig->nearest);
    print_worst(fig);
    if (fig->n_stops > 0)
        printf("radiance: %.2f stops off (root mean square)\n", fig->stops);
    if (fig->trust.pixels[0] > 0)
        printf("%.1f %% of the pixels are guesses: %.1f dB there, %.1f dB elsewhere\n",
               100 * trust_share(&fig->trust), trust_psnr(&fig->trust, 0),
               trust_psnr(&fig->trust, 1));
    if (st->pose.n > 0)
        printf("%d cameras found: median error %.3g degrees, %.3g of their spread, focal length "
               "%.3g\n",
               st->pose.n, st->pose.rot_deg, st->pose.trans, st->pose.focal);
}

static err_t write_file(const struct state *st, const char *path)
{
    struct cmd_json json;
    err_t e = cmd_json_open(path, &json);
    if (e || !json.f)
        return e;
    write_report(st, json.f);
    return cmd_json_close(&json);
}

/* report.json and the page of it, next to the pictures. */
static err_t write_folder(const struct state *st)
{
    char json[FILE_PATH_CAP], page[FILE_PATH_CAP];
    err_t e = outdir_path(&st->out, OUTDIR_REPORT, json);
    if (!e)
        e = outdir_path(&st->out, REPORT_PAGE_NAME, page);
    if (!e)
        e = write_file(st, json);
    return e ? e : report_page_write(page, &st->job, json);
}

static err_t publish_result(struct state *st, const struct request *rq)
{
    err_t e = OK;
    if (rq->out) {
        e = outdir_reason(&st->out, write_folder(st));
        if (!e)
            e = outdir_commit(&st->out);
        if (!e)
            resume_forget(st->out.path);
    }
    if (!e && st->json.f) {
        write_report(st, st->json.f);
        e = cmd_json_close(&st->json);
    }
    if (!e && !(rq->json && strcmp(rq->json, "-") == 0))
        print_table(st);
    return e;
}

static uint64_t result_bytes(const struct capture *test, int n_train, int size)
{
    uint64_t pixels = (uint64_t)size * (uint64_t)size;
    return (uint64_t)test->n * (pixels * (4 * 2 + 3) + pixels / 4 + 4096) + // as if incompressible
           report_page_bytes(n_train);
}

/* ---- from photographs to the scene ---- */

static err_t list_both(struct imageset_request rq, struct imageset *train, struct imageset *test)
{
    err_t e = cmd_photographs(&rq, train);
    rq.which = IMAGESET_TEST;
    rq.n_views = 0;
    rq.every_exposure = true;
    rq.exposure_set = 0;
    return e ? e : cmd_photographs(&rq, test);
}

/* Whether the cameras have to be found; cameras of the data set then serve for comparison only. */
static bool cameras_unknown(const struct state *st)
{
    return !st->train.capture.shots[0].has_camera;
}

static err_t list_pictures(struct state *st, const struct request *rq)
{
    err_t e = list_both(rq->set, &st->train, &st->test);
    if (e || !rq->set.no_cameras)
        return e;
    struct imageset_request with = rq->set;
    with.no_cameras = false;
    return list_both(with, &st->true_train, &st->true_test);
}

/* size: of the views; most: Gaussians of the scene. */
static err_t reserve_memory(struct state *st, const struct request *rq, struct job_memory need,
                            struct prep_size size, int most)
{
    struct plan p = plan_begin(pool_size(st->engine.pool));
    const struct evaluate_pictures pictures = {&st->test.capture, size, lpips_of(st)};
    err_t e = evaluate_check(&pictures);
    if (e)
        return e;
    arena_hold(&p.keep, need.keep);
    arena_step(&p.tmp, need.tmp);
    evaluate_plan(&p, &pictures, most);
    e = engine_reserve(&st->engine, arena_add(need.pictures, need.weights), p.keep.peak, p.tmp.peak,
                       config_memory_mb(&rq->cfg));
    if (!e && rq->out)
        e = outdir_open(rq->out, &rq->rules, &st->out);
    return e || !rq->out ? e
                         : outdir_reserve(&st->out, result_bytes(&st->test.capture,
                                                                 st->train.capture.n, size.edge));
}

static err_t add_testcams(const struct state *st, const struct job_config *job,
                          const struct testcams_scene *scene, struct job_memory *need)
{
    const struct capture *train = &st->train.capture;
    struct job_memory m;
    err_t e = testcams_check(job, train, &st->test.capture);
    if (!e)
        e = testcams_plan(job, scene, train, &st->test.capture, pool_size(st->engine.pool), &m);
    if (e)
        return e;
    need->keep = arena_add(need->keep, m.keep);
    need->tmp = m.tmp > need->tmp ? m.tmp : need->tmp;
    return OK;
}

static err_t find_test_cameras(struct state *st, const struct job_config *job)
{
    const struct capture *real = &st->true_train.capture;
    const struct run *r = &st->engine.run;
    err_t e = testcams_run(r, job, &st->job, &st->test);
    job_result_lap(&st->job, JOB_MEASURE);
    if (e || real->n == 0 || !real->shots[0].has_camera)
        return e;
    return testcams_measure(r, &st->job, real, &st->true_test.capture, &st->test.capture,
                            &st->pose);
}

static err_t reconstruct_inputs(struct state *st, struct request *rq)
{
    const struct network *network;
    struct job_memory need;
    err_t e = cmd_network(&rq->model, &rq->cfg, &st->network, &network);
    if (e)
        return e;
    cmd_imageset(&rq->cfg, network, &rq->set);
    struct job_config job = cmd_job(&rq->cfg, network, false);
    st->source = cmd_source(&st->train);
    job.source = &st->source;
    job.square = strcmp(rq->protocol, "paper") == 0;
    e = list_pictures(st, rq);
    if (!e)
        e = cmd_shipped(&rq->model, &st->network, &job.network);
    job.cameras_only = !network;
    if (!e)
        job.size = recipe_size(&job, &st->train.capture);
    if (!e)
        e = job_plan(&st->train.capture, &job, pool_size(st->engine.pool), false,
                     st->engine.run.team, &need);
    if (e)
        return e;
    const struct recipe recipe = recipe_choose(&st->train.capture, &job, false);
    const struct testcams_scene scene = {recipe.square, recipe.gaussians_max};
    bool unknown = cameras_unknown(st);
    if (unknown)
        e = add_testcams(st, &job, &scene, &need);
    if (!e)
        e = reserve_memory(st, rq, need, (struct prep_size){job.size, recipe.square},
                           recipe.gaussians_max);
    if (!e && rq->out)
        e = cmd_checkpoints(&st->out, &rq->cfg, rq->resume, &st->resume, &job);
    if (!e)
        e = job_run(&st->engine.run, &st->train.capture, &job, &st->job);
    if (!e && unknown)
        lenses_apply(&st->job, &st->test.capture);
    return e || !unknown ? e : find_test_cameras(st, &job);
}

/* ---- from a result to its scene ---- */

/* Views that are squares where photographs are not have no lens. */
static bool is_squeezed(const struct rig *rig, const struct capture *c)
{
    const struct camera *cam = &rig->views[0].cam;
    return cam->w == cam->h && c->n > 0 && c->shots[0].taken_w != c->shots[0].taken_h;
}

/* Keeps the train pictures that the scene was made from. */
static void keep_inputs(const struct rig *rig, struct capture *c)
{
    int n = 0;
    for (int i = 0; i < c->n; i++)
        for (int k = 0; k < rig->n; k++)
            if (strcmp(c->shots[i].name, rig->views[k].name) == 0)
                c->shots[n++] = c->shots[i];
    c->n = n;
}

/* Read the cameras and light of the result's photographs. Lenses that were
 * found are those of the pictures, unless these come with cameras. */
static err_t read_cameras(struct state *st, const struct request *rq)
{
    char path[FILE_PATH_CAP];
    struct rig rig;
    err_t e = file_join(rq->scene, "cameras.json", path);
    if (!e)
        e = cameras_read(path, &rig);
    if (e)
        return e;
    keep_inputs(&rig, &st->train.capture);
    keep_inputs(&rig, &st->true_train.capture);
    if (rq->set.no_cameras && st->train.capture.n == 0) {
        e = err_fail(ERR_ARG,
                     "%s: none of the scene's %d input views are in this folder, and cameras of "
                     "held-out pictures are found beside them",
                     rq->set.images, rig.n);
        cameras_free(&rig);
        return e;
    }
    stored_light(&rig, &st->job);
    if (rq->set.no_cameras && !is_squeezed(&rig, &st->test.capture)) {
        stored_lenses(&rig, &st->train.capture, &st->job);
        lenses_apply(&st->job, &st->train.capture);
        lenses_apply(&st->job, &st->test.capture);
    }
    cameras_free(&rig);
    return OK;
}

static void plan_scene(const struct state *st, const struct scenefile_info *info,
                       struct job_memory *need)
{
    const struct capture *c = &st->train.capture;
    const struct views v = {.n = c->n, .size = info->size};
    struct plan p = plan_begin(pool_size(st->engine.pool));
    *need = (struct job_memory){.keep = info->need};
    if (c->n == 0)
        return;
    arena_hold(&p.keep, info->need);
    prep_plan_capture(&p, c, &st->source,
                      (struct prep_size){info->size, true}); // no view has more pixels
    arena_step(&p.tmp, response_plan(&v));
    need->keep = p.keep.peak;
    need->tmp = p.tmp.peak;
    need->pictures = imageset_bytes(c, pool_size(st->engine.pool));
}

/* Without known cameras the scene tells where its photographs were taken. */
static err_t take_cameras(struct state *st)
{
    struct views *v = &st->job.views;
    const struct scene *s = &st->job.scene;
    if (v->cams)
        return OK;
    if (v->n != s->n_views)
        return err_fail(ERR_ARG, "%s: only %d of the scene's %d input views are in this folder",
                        st->train.dir, v->n, s->n_views);
    for (int i = 0; i < v->n; i++)
        if (strcmp(v->names[i], s->names[i]) != 0)
            return err_fail(ERR_ARG, "%s: %s is no input view of the scene", st->train.dir,
                            v->names[i]);
    v->cams = s->cams;
    return OK;
}

/* The photographs that the scene was made from, if the data set has them. */
static err_t read_inputs(struct state *st)
{
    const struct run *r = &st->engine.run;
    if (st->train.capture.n == 0)
        return OK;
    err_t e = prep_read(r, &st->train.capture, &st->source, job_result_size(&st->job.scene),
                        &st->job.views);
    job_result_lap(&st->job, JOB_PREPROCESS);
    if (!e)
        e = take_cameras(st);
    if (!e)
        e = response_run(r, &st->job.views, &st->job.response);
    job_result_lap(&st->job, JOB_RESPONSE);
    return e;
}

/* Its views become as large as asked. */
static void scale_scene(struct scene *s, int size)
{
    const double scale = (double)size / s->size;
    for (int i = 0; i < s->n_views; i++) {
        struct camera *c = &s->cams[i];
        *c = pose_scaled(c, num_max(1, (int)lround(c->w * scale)),
                         num_max(1, (int)lround(c->h * scale)));
    }
    s->size = size;
}

static err_t read_scene(struct state *st, struct request *rq)
{
    char path[FILE_PATH_CAP];
    struct scenefile_info info;
    struct job_memory need;
    struct job_config job = cmd_job(&rq->cfg, NULL, false);
    st->source = cmd_source(&st->train);
    st->job.measured_only = true;
    st->job.start_s = st->job.lap_s = engine_seconds();
    cmd_imageset(&rq->cfg, NULL, &rq->set);
    rq->set.every_exposure = true;
    err_t e = file_join(rq->scene, "scene.hdrig", path);
    if (!e)
        e = scenefile_peek(path, &info);
    if (!e)
        e = list_pictures(st, rq);
    if (!e)
        e = read_cameras(st, rq);
    if (e)
        return e;
    if (job.size != RECIPE_SIZE_AUTO)
        info.size = recipe_size(&job, &st->test.capture);
    job.size = info.size;
    plan_scene(st, &info, &need);
    const struct testcams_scene scene = {true, info.n}; // squares have the most pixels
    if (rq->set.no_cameras)
        e = add_testcams(st, &job, &scene, &need);
    if (!e)
        e = reserve_memory(st, rq, need, (struct prep_size){info.size, true}, info.n);
    if (!e)
        e = scenefile_read(path, &st->engine.keep, &st->job.scene);
    if (!e)
        scale_scene(&st->job.scene, info.size);
    if (!e)
        e = read_inputs(st);
    return e || !rq->set.no_cameras ? e : find_test_cameras(st, &job);
}

/* ---- command ---- */

/* Exposures in the unit of the scene; those of the test pictures should be in it, too. */
static err_t list_stored(struct state *st, const char *scene, struct evaluate_seen *out)
{
    char path[FILE_PATH_CAP];
    err_t e = file_join(scene, "report.json", path); // of every place its first view
    if (!e)
        e = stored_exposures(path, out);
    if (!e)
        evaluate_compare_units(out, &st->test.capture, &st->job);
    return e;
}

static err_t list_exposures(struct state *st, const struct request *rq, struct evaluate_seen *out)
{
    const struct views *v = &st->job.views;
    err_t e = rq->scene ? list_stored(st, rq->scene, out) : OK;
    for (int i = 0; i < v->n + v->n_more; i++)
        evaluate_see(out, views_set_log2t(v, i));
    return e;
}

/* The release gives LPIPS values in [0, 1]; it was trained with [-1, 1]. */
static err_t open_lpips(struct state *st, const struct request *rq)
{
    err_t e = lpips_weights_open(rq->lpips, &st->lpips);
    st->lpips.net.centred = strcmp(rq->protocol, "native") == 0;
    return e;
}

static err_t evaluate_scene(struct state *st, struct request *rq)
{
    struct evaluate_seen inputs = {0};
    err_t e = cmd_join(&st->team, "eval", &rq->cfg, &rq->set, &rq->model, &st->engine);
    const bool measures = teamwork_speaks(&st->team);
    if (!measures)
        rq->out = rq->json = NULL;
    struct outdir *out = rq->out ? &st->out : NULL;
    if (!e)
        e = cmd_json_open(rq->json, &st->json);
    if (!e)
        e = teamwork_path(&st->team, &rq->set.images);
    if (!e && rq->lpips && measures)
        e = open_lpips(st, rq);
    if (!e)
        e = rq->scene ? read_scene(st, rq) : reconstruct_inputs(st, rq);
    st->engine.run.team = NULL; // the first rank measures alone
    if (!e && !measures)
        return OK;
    if (!e)
        e = list_exposures(st, rq, &inputs);
    if (!e)
        e = evaluate_run(&st->engine.run, &st->job,
                         &(struct evaluate_job){&st->test, &inputs, lpips_of(st), out},
                         &st->figures);
    cmd_report_unread(&st->train, &st->job);
    st->job.keep_peak = st->engine.keep.peak;
    st->job.tmp_peak = st->engine.tmp.peak;
    progress_end(&st->engine.progress);
    if (e)
        return out ? outdir_reason(out, e) : e;
    return publish_result(st, rq);
}

/* NULL if the options fit together. */
static const char *misuse_reason(const struct request *rq)
{
    const char *reason;
    bool network = cmd_has_network(&rq->model, &reason);
    if (!rq->set.images)
        return "--data is needed";
    if (rq->scene && (network || rq->resume))
        return "--scene is finished, --model and --resume make one";
    if (rq->resume && !rq->out)
        return "--resume needs --out: its checkpoint lies beside it";
    return reason;
}

static err_t read_numbers(struct request *rq)
{
    struct cmd_list list = {0};
    err_t e = OK;
    if (strcmp(rq->protocol, "paper") != 0 && strcmp(rq->protocol, "native") != 0)
        e = err_fail(ERR_ARG, "--protocol: \"%.32s\" is none of paper, native", rq->protocol);
    if (rq->scene && (rq->views || rq->exposures))
        e = err_fail(ERR_ARG, "--scene has its input views; --views and --exposure-set choose some "
                              "for a reconstruction");
    if (!e && rq->views)
        e = cmd_whole("--views", rq->views, 1, 4096, &rq->set.n_views);
    if (!e && rq->exposures)
        e = cmd_list("--exposure-set", rq->exposures, 1, 32, &list);
    for (int i = 0; i < list.n; i++)
        rq->set.exposure_set |= UINT32_C(1) << (list.v[i] - 1);
    return e;
}

static void close_files(struct state *st)
{
    cmd_json_discard(&st->json);
    resume_close(&st->resume);
    outdir_close(&st->out);
    imageset_free(&st->train);
    imageset_free(&st->test);
    imageset_free(&st->true_train);
    imageset_free(&st->true_test);
}

int cmd_eval_run(int argc, char **argv)
{
    static struct state st;
    struct request rq = {.protocol = "paper"};
    const struct cmd_option options[] = {
        {"data", "DIR", "data set with train and test pictures", NULL, &rq.set.images, NULL},
        {"scene", "DIR", "measure this result of hdrig reconstruct, at its own size or --size",
         NULL, &rq.scene, NULL},
        {"views", "N", "input views; else all, one exposure each", NULL, &rq.views, NULL},
        {"exposure-set", "LIST", "inputs only at these of the set's sorted exposures: 1,3,5", NULL,
         &rq.exposures, NULL},
        {"protocol", "P",
         "paper (default): views squeezed to squares, LPIPS of values in [0, 1]; native: as they "
         "are, in [-1, 1]",
         NULL, &rq.protocol, NULL},
        {"lpips", "FILE", "measure LPIPS, too, with these weights of hdrig convert --lpips", NULL,
         &rq.lpips, NULL},
        {"rig", "PATH", "known cameras: COLMAP folder or cameras.json; else sparse/0; none", NULL,
         &rq.set.rig, NULL},
        {"model", "FILE", "weights of a network, or none", NULL, &rq.model.path, NULL},
        {"precision", "P", "that these weights must have: fp32, bf16 or int8", NULL,
         &rq.model.precision, NULL},
        {"json", "FILE", "figures as JSON, - for stdout", NULL, &rq.json, NULL},
        {"out", "DIR", "keep the rendered test views there", NULL, &rq.out, NULL},
        CMD_RESUME(rq.resume),
        CMD_FORCE(rq.rules),
        CMD_STRICT(rq.strict),
        CMD_REFINE,
        CMD_DEGREE,
        CMD_GAUSSIANS,
        CMD_SIZE,
        CMD_SEED,
        CMD_THREADS,
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {
        "eval", "--data DIR ",
        "Reconstruct a data set from its train pictures, or take --scene; measure it on its test\n"
        "pictures. Inputs have one exposure per view: as protocol.json says, or interleaved.",
        options, sizeof options / sizeof options[0]};
    int code;
    if (!cmd_parse(&usage, argc, argv, &rq.cfg, &code))
        return code;
    if (misuse_reason(&rq))
        return cmd_misuse(&usage, misuse_reason(&rq));
    if (read_numbers(&rq) != OK)
        return cmd_misuse(&usage, err_text());
    const char *const inputs[] = {rq.set.images, rq.scene, rq.set.rig, rq.model.path, rq.lpips};
    memcpy(rq.rules.inputs, inputs, sizeof inputs);
    err_t e = evaluate_scene(&st, &rq);
    const bool speaks = teamwork_speaks(&st.team);
    code = speaks ? cmd_finish_job(usage.name, e, &st.job, rq.strict) : CMD_OK;
    close_files(&st);
    teamwork_close(&st.team, e, speaks ? code : CMD_FAILURE);
    engine_close(&st.engine);
    network_close(&st.network);
    lpips_weights_close(&st.lpips);
    return code;
}
