/* hdrig reconstruct: photographs to an HDR scene. */
#include "firmware/cmd/cmd.h"
#include "firmware/recon/dump.h"
#include "firmware/result/publish.h"

#include "core/base/log.h"
#include "core/base/num.h"
#include "core/photo/prep.h"
#include "drivers/format/imageset.h"
#include "drivers/format/npy.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct request {
    const char *images[CMD_TEXTS_MAX + 1]; // and a NULL
    struct imageset_request set;
    struct cmd_model model;
    const char *out, *json, *dump, *dump_exposures;
    struct outdir_rules rules;
    bool poses, strict, resume;
    struct config cfg;
};

struct state {
    struct teamwork team;
    struct engine engine;
    struct network network;
    struct imageset set;
    struct prep_source source;
    struct outdir out, dump;
    struct resume resume;
    struct cmd_json json;
    struct npy_dir tensors;
    struct job_result result;
};

static err_t print_result(const struct request *rq, struct state *st)
{
    const struct job_result *j = &st->result;
    char count[CMD_COUNT_CAP];
    if (st->json.f)
        publish_report(j, pool_size(st->engine.pool), st->json.f);
    if (st->json.f != stdout) {
        printf("%s: %d", rq->out, j->views.n);
        if (j->views.n < prep_places(&st->set.capture))
            printf(" of %d", prep_places(&st->set.capture));
        printf(" views of %d px, %d Gaussians of SH degree %d, input views %.2f dB", j->scene.size,
               j->scene.g.n, j->scene.g.degree, j->input_psnr);
        if (j->refine.steps > 0)
            printf(", held-out squares %.2f dB", (double)j->refine.held_out_db[1]);
        printf(", %.1f s%s\n", j->lap_s - j->start_s, cmd_count_warnings(j, count));
        if (j->budget[0])
            printf("%s: %s, %d steps\n", rq->out, j->budget, j->refine.steps);
    }
    return cmd_json_close(&st->json);
}

/* ---- dump ---- */

/* Three numbers above 0, as log2. */
static bool read_exposures(const char *text, float log2t[DUMP_EXPOSURES])
{
    char *end = NULL;
    for (int i = 0; i < DUMP_EXPOSURES; i++, text = end + 1) {
        log2t[i] = log2f(strtof(text, &end));
        if (end == text || *end != (i + 1 < DUMP_EXPOSURES ? ',' : 0) || !isfinite(log2t[i]))
            return false;
    }
    return true;
}

/* Exposures of the dumped picture: as asked, else those of the input views. */
static void dump_exposures(const char *text, const struct capture *c, float log2t[DUMP_EXPOSURES])
{
    float lo = INFINITY, hi = -INFINITY;
    if (text && read_exposures(text, log2t))
        return;
    for (int i = 0; i < c->n; i++) {
        lo = fminf(lo, log2f((float)c->shots[i].exposure));
        hi = fmaxf(hi, log2f((float)c->shots[i].exposure));
    }
    log2t[0] = lo;
    log2t[1] = (lo + hi) / 2;
    log2t[2] = hi;
}

static err_t begin_dump(const struct request *rq, struct state *st)
{
    if (!rq->dump)
        return OK;
    err_t e = outdir_open(rq->dump, &rq->rules, &st->dump);
    if (!e)
        e = npy_open(&st->tensors, st->dump.partial.dir);
    st->engine.run.tap = &st->tensors.tap;
    return e;
}

/* Write the report too, which marks the folder as a result. */
static err_t end_dump(const struct request *rq, struct state *st)
{
    struct report rep;
    if (!rq->dump)
        return OK;
    err_t e = npy_close(&st->tensors);
    if (!e)
        e = outdir_report_open(&st->dump, &rep);
    if (e)
        return e;
    job_report(&st->result, pool_size(st->engine.pool), &rep);
    e = outdir_report_close(&st->dump, &rep);
    return e ? e : outdir_commit(&st->dump);
}

/* ---- the job ---- */

static bool fits_memory(const struct job_memory *m, int limit_mb)
{
    const size_t files = arena_add(m->pictures, m->weights), arenas = arena_add(m->keep, m->tmp);
    return (double)arena_add(files, arenas) <= limit_mb * 1e6;
}

static err_t plan_memory(const struct request *rq, const struct state *st, const struct capture *c,
                         const struct job_config *job, struct job_memory *out)
{
    const struct engine *en = &st->engine;
    return job_plan(c, job, pool_size(en->pool), rq->dump != NULL, en->run.team, out);
}

static bool fits_job(const struct request *rq, const struct state *st, const struct job_config *job)
{
    struct job_memory m;
    return plan_memory(rq, st, &st->set.capture, job, &m) == OK &&
           fits_memory(&m, config_memory_mb(&rq->cfg));
}

/* The largest size up to the one asked for that fits into the memory allowed; 0: none above that of
 * cameras and depth. */
static int largest_size(const struct request *rq, const struct state *st,
                        const struct job_config *job)
{
    struct job_config less = *job;
    for (; less.size > recipe_work(job); less.size -= less.size / 16)
        if (fits_job(rq, st, &less))
            return less.size;
    return 0;
}

/* The least of what all ranks have memory for. */
static err_t agree_least(struct team *t, int *least)
{
    int all[TEAM_MAX] = {0};
    all[team_rank(t)] = *least;
    err_t e = team_collect(t, all, sizeof *all);
    for (int i = 0; i < team_size(t) && !e; i++)
        *least = num_min(*least, all[i]);
    return e;
}

/* Within the memory allowed a closer look for cameras first, then size. */
static err_t fit_job(const struct request *rq, struct state *st, struct job_config *job)
{
    const bool fixed = rq->cfg.size != CONFIG_SIZE_AUTO;
    struct job_config least = *job;
    least.size = fixed ? job->size : num_min(job->size, recipe_work(job));
    int closer = fits_job(rq, st, &least);
    err_t e = agree_least(st->engine.run.team, &closer);
    job->once = !closer;
    if (e || fixed)
        return e;
    job->size = num_max(largest_size(rq, st, job), least.size);
    return agree_least(st->engine.run.team, &job->size);
}

static err_t reserve_memory(const struct request *rq, struct state *st,
                            const struct job_config *job, const struct job_memory *need)
{
    const int limit = config_memory_mb(&rq->cfg);
    struct capture fewer = st->set.capture;
    struct job_memory m = *need;
    err_t e = engine_reserve(&st->engine, arena_add(m.pictures, m.weights), m.keep, m.tmp, limit);
    if (e != ERR_LIMIT)
        return e;
    const int size = largest_size(rq, st, job);
    if (size > 0)
        return err_fail(ERR_LIMIT, "%s; --size %d would fit", err_text(), size);
    for (fewer.n--; prep_places(&fewer) >= 2; fewer.n--) {
        e = plan_memory(rq, st, &fewer, job, &m);
        if (e)
            return e;
        if (fits_memory(&m, limit))
            return err_fail(ERR_LIMIT, "%s; %d of %d photographs would fit", err_text(), fewer.n,
                            st->set.capture.n);
    }
    return ERR_LIMIT;
}

/* Check everything that can be refused before the work. */
static err_t prepare_job(struct request *rq, struct state *st, struct job_config *job)
{
    const struct network *network;
    struct job_memory need;
    err_t e = cmd_network(&rq->model, &rq->cfg, &st->network, &network);
    if (e)
        return e;
    cmd_imageset(&rq->cfg, network, &rq->set);
    *job = cmd_job(&rq->cfg, network, rq->poses);
    st->source = cmd_source(&st->set);
    job->source = &st->source;
    rq->set.brackets = !rq->set.may_lack_times && !recipe_forward(job); // for refinement
    e = cmd_photographs(&rq->set, &st->set);
    if (!e)
        e = cmd_shipped(&rq->model, &st->network, &job->network);
    job->cameras_only = !network;
    if (!e)
        job->size = recipe_size(job, &st->set.capture);
    if (!e && cmd_fill_exposures(&st->set.capture))
        log_warn("exposures are not known for all pictures: none is used");
    if (!e)
        dump_exposures(rq->dump_exposures, &st->set.capture, job->dump_log2t);
    if (!e)
        e = fit_job(rq, st, job);
    if (!e)
        e = plan_memory(rq, st, &st->set.capture, job, &need);
    return e ? e : reserve_memory(rq, st, job, &need);
}

/* All places for results, before the work. */
static err_t open_results(struct request *rq, struct state *st, struct job_config *job)
{
    const char *const inputs[] = {rq->set.exposures, rq->set.rig, rq->model.path};
    enum { FILES = sizeof inputs / sizeof inputs[0] };
    _Static_assert(FILES + CMD_TEXTS_MAX <= OUTDIR_INPUTS, "every input is protected");
    memcpy(rq->rules.inputs, inputs, sizeof inputs);
    memcpy(rq->rules.inputs + FILES, rq->images, CMD_TEXTS_MAX * sizeof rq->images[0]);
    err_t e = outdir_open(rq->out, &rq->rules, &st->out);
    if (!e)
        e = publish_check(&st->set.capture, job, &st->out);
    if (!e)
        e = cmd_checkpoints(&st->out, &rq->cfg, rq->resume, &st->resume, job);
    if (!e)
        e = cmd_json_open(rq->json, &st->json);
    return e ? e : begin_dump(rq, st);
}

static err_t write_results(struct request *rq, struct state *st)
{
    err_t e = end_dump(rq, st);
    if (!e)
        e = publish_run(&st->engine.run, &st->result, &st->out);
    if (!e)
        resume_forget(st->out.path);
    progress_end(&st->engine.progress);
    return e ? e : print_result(rq, st);
}

static err_t make_scene(struct request *rq, struct state *st)
{
    struct job_config job;
    err_t e = cmd_join(&st->team, "reconstruct", &rq->cfg, &rq->set, &rq->model, &st->engine);
    const bool writes = teamwork_speaks(&st->team);
    for (int i = 0; rq->images[i] && !e; i++)
        e = teamwork_path(&st->team, &rq->images[i]);
    rq->set.images = rq->images[0];
    rq->set.more = rq->images + 1;
    if (!e)
        e = prepare_job(rq, st, &job);
    if (!e && writes)
        e = open_results(rq, st, &job);
    if (!e)
        e = job_run(&st->engine.run, &st->set.capture, &job, &st->result);
    cmd_report_unread(&st->set, &st->result);
    if (!e && writes)
        e = write_results(rq, st);
    return e;
}

/* NULL if the options fit together. */
static const char *misuse_reason(const struct request *rq)
{
    float log2t[DUMP_EXPOSURES];
    const char *reason;
    bool network = cmd_has_network(&rq->model, &reason);
    if (!rq->images[0] || !rq->out)
        return "--images and --out are needed";
    if (rq->dump && !network)
        return "--dump writes the tensors of a network, give --model FILE";
    if (rq->dump_exposures && !read_exposures(rq->dump_exposures, log2t))
        return "--dump-exposures is not like 0.125,1,8";
    return reason;
}

int cmd_reconstruct_run(int argc, char **argv)
{
    static struct state st;
    struct request rq = {0};
    const struct cmd_option options[] = {
        {"images", "DIR...", "photographs, or a data set; several: takes of one session", NULL,
         rq.images, NULL},
        {"out", "DIR", "where the result goes; a former result is replaced", NULL, &rq.out, NULL},
        {"exposures", "FILE", "JSON of file name to exposure; else exposure.json or EXIF", NULL,
         &rq.set.exposures, NULL},
        {"rig", "PATH", "COLMAP folder, cameras.json, transforms.json; none: unknown; else found",
         NULL, &rq.set.rig, NULL},
        {"model", "FILE", "weights of a network, or none", NULL, &rq.model.path, NULL},
        {"precision", "P", "that these weights must have: fp32, bf16 or int8", NULL,
         &rq.model.precision, NULL},
        {"dump", "DIR", "every tensor of the network as .npy", NULL, &rq.dump, NULL},
        {"dump-exposures", "LIST", "three, of the picture there; else those of the inputs", NULL,
         &rq.dump_exposures, NULL},
        {"json", "FILE", "the report once more, - for stdout", NULL, &rq.json, NULL},
        CMD_RESUME(rq.resume),
        CMD_FORCE(rq.rules),
        CMD_STRICT(rq.strict),
        {"refine-poses", NULL, "refine the cameras of the input views too", NULL, NULL, &rq.poses},
        CMD_BUDGET,
        CMD_REFINE,
        CMD_DEGREE,
        CMD_GAUSSIANS,
        CMD_SIZE,
        CMD_SEED,
        CMD_THREADS,
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {
        "reconstruct", "--images DIR --out DIR ",
        "Photographs with known exposures, and known cameras or a network, become an HDR scene.",
        options, sizeof options / sizeof options[0]};
    int code;
    if (!cmd_parse(&usage, argc, argv, &rq.cfg, &code))
        return code;
    if (misuse_reason(&rq))
        return cmd_misuse(&usage, misuse_reason(&rq));
    err_t e = make_scene(&rq, &st);
    const bool speaks = teamwork_speaks(&st.team);
    code = speaks ? cmd_finish_job(usage.name, e, &st.result, rq.strict) : CMD_OK;
    if (npy_close(&st.tensors) != OK)
        code = CMD_FAILURE; // after another error, which was printed
    cmd_json_discard(&st.json);
    outdir_close(&st.dump);
    resume_close(&st.resume);
    outdir_close(&st.out);
    imageset_free(&st.set);
    teamwork_close(&st.team, e, speaks ? code : CMD_FAILURE);
    engine_close(&st.engine);
    network_close(&st.network);
    return code;
}
