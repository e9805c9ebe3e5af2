/* hdrig eval: reconstruct a data set and measure it on its held-out views. */
#include "firmware/cmd.h"
#include "firmware/engine.h"
#include "firmware/evaluate.h"

#include <string.h>

struct request {
    struct imageset_request set;
    const char *views, *out, *json;
    struct config cfg;
};

struct state {
    struct engine engine;
    struct imageset train, test;
    struct outdir out;
    struct job_result job;
    struct evaluate_result figures;
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
    if (strcmp(key, "ldr") == 0)
        report_text(rep, "lpips", NULL); // needs a trained network, which the tool has not
    report_int(rep, "images", s->n);
    report_close(rep);
}

static void write_report(const struct state *st, FILE *f)
{
    struct report rep;
    const struct evaluate_result *fig = &st->figures;
    report_init(&rep, f);
    report_open(&rep, NULL, '{');
    report_int(&rep, "test_views", fig->views);
    report_score(&rep, "ldr", &fig->ldr);
    report_score(&rep, "hdr", &fig->hdr);
    report_score(&rep, "baseline_nearest", &fig->nearest);
    report_text(&rep, "pose", NULL); // cameras were given, not estimated
    report_open(&rep, "per_exposure", '[');
    for (int i = 0; i < fig->n_exposures; i++) {
        report_open(&rep, NULL, '{');
        report_number(&rep, "exposure", fig->exposures[i].exposure);
        report_number(&rep, "psnr", fig->exposures[i].score.psnr);
        report_number(&rep, "ssim", fig->exposures[i].score.ssim);
        report_close(&rep);
    }
    report_close(&rep);
    job_report(&st->job, pool_size(st->engine.pool), &rep);
    report_close(&rep);
}

static void print_score(const char *what, const struct evaluate_score *s)
{
    if (s->n > 0)
        printf("%-18s %9.3f %9.4f %7d\n", what, s->psnr, s->ssim, s->n);
}

static void print_table(const struct state *st)
{
    const struct evaluate_result *fig = &st->figures;
    printf("%d input views, %d Gaussians of SH degree %d, %d steps, %.1f s\n\n", st->job.views.n,
           st->job.scene.g.n, st->job.scene.g.degree, st->job.refine.steps,
           st->job.lap_s - st->job.start_s);
    printf("%-18s %9s %9s %7s\n", "", "PSNR dB", "SSIM", "images");
    print_score("LDR", &fig->ldr);
    for (int i = 0; i < fig->n_exposures; i++) {
        char what[32];
        snprintf(what, sizeof what, "  exposure %g", fig->exposures[i].exposure);
        print_score(what, &fig->exposures[i].score);
    }
    print_score("HDR mu-law", &fig->hdr);
    print_score("nearest input view", &fig->nearest);
}

static err_t write_file(const struct state *st, const char *path)
{
    FILE *f;
    err_t e = cmd_json_open(path, &f);
    if (e || !f)
        return e;
    write_report(st, f);
    return cmd_json_close(f, path);
}

static err_t publish(struct state *st, const struct request *rq)
{
    char path[FILE_PATH_CAP];
    err_t e = OK;
    if (rq->out) {
        e = outdir_path(&st->out, OUTDIR_REPORT, path);
        if (!e)
            e = outdir_reason(&st->out, write_file(st, path));
        if (!e)
            e = outdir_commit(&st->out);
    }
    if (!e)
        e = write_file(st, rq->json);
    if (!e && !(rq->json && strcmp(rq->json, "-") == 0))
        print_table(st);
    return e;
}

static uint64_t result_bytes(const struct capture *test, int size)
{
    uint64_t pixels = (uint64_t)size * (uint64_t)size;
    return (uint64_t)test->n * (pixels * (4 * 2 + 3) + pixels / 4 + 4096); // as if incompressible
}

/* Lists, memory and folder: everything that can be refused before the work. */
static err_t prepare(struct state *st, struct request *rq, const struct job_config *job)
{
    struct job_memory need;
    size_t keep, tmp;
    err_t e = imageset_list(&rq->set, &st->train);
    rq->set.which = IMAGESET_TEST;
    rq->set.n_views = 0;
    rq->set.every_exposure = true;
    if (!e)
        e = imageset_list(&rq->set, &st->test);
    if (!e)
        e = engine_open(&st->engine, rq->cfg.threads);
    if (!e)
        e = job_plan(&st->train.capture, job, pool_size(st->engine.pool), &need);
    if (e)
        return e;
    evaluate_plan(&st->test.capture, job->size, job->refine.gaussians_max,
                  pool_size(st->engine.pool), &keep, &tmp);
    e = engine_reserve(&st->engine, need.pictures, arena_add(need.keep, keep),
                       tmp > need.tmp ? tmp : need.tmp, rq->cfg.max_memory_mb);
    if (!e && rq->out)
        e = outdir_open(rq->out, &st->out);
    return e || !rq->out ? e : outdir_reserve(&st->out, result_bytes(&st->test.capture, job->size));
}

static err_t evaluate(struct state *st, struct request *rq)
{
    struct job_config job = cmd_job(&rq->cfg, false);
    struct outdir *out = rq->out ? &st->out : NULL;
    err_t e = prepare(st, rq, &job);
    if (!e)
        e = imageset_load(&st->train);
    if (!e)
        e = job_run(&st->engine.run, &st->train.capture, &job, &st->job);
    if (!e)
        e = evaluate_run(&st->engine.run, &st->job, &st->test, out, &st->figures);
    progress_end(&st->engine.progress);
    if (e)
        return out ? outdir_reason(out, e) : e;
    return publish(st, rq);
}

int cmd_eval_run(int argc, char **argv)
{
    static struct state st;
    struct request rq = {0};
    const struct cmd_option options[] = {
        {"data", "DIR", "data set with train and test pictures", NULL, &rq.set.images, NULL},
        {"views", "N", "input views; else all, one exposure each", NULL, &rq.views, NULL},
        {"rig", "PATH", "known cameras: COLMAP folder or cameras.json; else sparse/0", NULL,
         &rq.set.rig, NULL},
        {"json", "FILE", "figures as JSON, - for stdout", NULL, &rq.json, NULL},
        {"out", "DIR", "keep the rendered test views there", NULL, &rq.out, NULL},
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
        "Reconstruct a data set from its train pictures, measure it on its test pictures.", options,
        sizeof options / sizeof options[0]};
    int code;
    double views = 0;
    if (!cmd_parse(&usage, argc, argv, &rq.cfg, &code))
        return code;
    if (!rq.set.images)
        return cmd_misuse(&usage, "--data is needed");
    if (rq.views && cmd_number("--views", rq.views, 1, 4096, &views) != OK)
        return cmd_misuse(&usage, err_text());
    rq.set.n_views = (int)views;
    code = cmd_finish(usage.name, evaluate(&st, &rq));
    outdir_close(&st.out);
    imageset_free(&st.train);
    imageset_free(&st.test);
    engine_close(&st.engine);
    return code;
}
