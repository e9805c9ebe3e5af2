/* hdrig reconstruct: photographs to an HDR scene. */
#include "firmware/cmd.h"
#include "firmware/engine.h"
#include "firmware/publish.h"

#include "drivers/imageset.h"

#include <string.h>

struct request {
    struct imageset_request set;
    const char *out, *json;
    bool poses;
    struct config cfg;
};

static err_t print_result(const struct request *rq, const struct job_result *j, int threads)
{
    FILE *json;
    err_t e = cmd_json_open(rq->json, &json);
    if (e)
        return e;
    if (json)
        publish_report(j, threads, json);
    if (json != stdout)
        printf("%s: %d views, %d Gaussians of SH degree %d, input views %.2f dB, held-out squares "
               "%.2f dB, %.1f s\n",
               rq->out, j->views.n, j->scene.g.n, j->scene.g.degree, j->input_psnr,
               (double)j->refine.held_out_db[1], j->lap_s - j->start_s);
    return cmd_json_close(json, rq->json);
}

static err_t reconstruct(const struct request *rq, struct engine *en, struct imageset *set,
                         struct outdir *o)
{
    static struct job_result result;
    struct job_config job = cmd_job(&rq->cfg, rq->poses);
    struct job_memory need;
    err_t e = imageset_list(&rq->set, set);
    if (!e)
        e = engine_open(en, rq->cfg.threads);
    if (!e)
        e = job_plan(&set->capture, &job, pool_size(en->pool), &need);
    if (!e)
        e = engine_reserve(en, need.pictures, need.keep, need.tmp, rq->cfg.max_memory_mb);
    if (!e)
        e = outdir_open(rq->out, o);
    if (!e)
        e = imageset_load(set);
    if (!e)
        e = job_run(&en->run, &set->capture, &job, &result);
    if (!e)
        e = publish_run(&en->run, &result, o);
    progress_end(&en->progress);
    return e ? e : print_result(rq, &result, pool_size(en->pool));
}

int cmd_reconstruct_run(int argc, char **argv)
{
    struct request rq = {0};
    const struct cmd_option options[] = {
        {"images", "DIR", "photographs, or a data set whose train pictures are used", NULL,
         &rq.set.images, NULL},
        {"out", "DIR", "where the result goes; a former result is replaced", NULL, &rq.out, NULL},
        {"exposures", "FILE", "JSON of file name to exposure; else exposure.json or EXIF", NULL,
         &rq.set.exposures, NULL},
        {"rig", "PATH", "known cameras: COLMAP folder or cameras.json; else sparse/0", NULL,
         &rq.set.rig, NULL},
        {"json", "FILE", "the report once more, - for stdout", NULL, &rq.json, NULL},
        {"refine-poses", NULL, "refine the cameras of the input views too", NULL, NULL, &rq.poses},
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
        "Photographs with known exposures and cameras become an HDR scene.", options,
        sizeof options / sizeof options[0]};
    int code;
    if (!cmd_parse(&usage, argc, argv, &rq.cfg, &code))
        return code;
    if (!rq.set.images || !rq.out)
        return cmd_misuse(&usage, "--images and --out are needed");
    struct engine engine = {0};
    struct imageset set = {0};
    struct outdir out = {0};
    err_t e = reconstruct(&rq, &engine, &set, &out);
    code = cmd_finish(usage.name, e);
    outdir_close(&out);
    imageset_free(&set);
    engine_close(&engine);
    return code;
}
