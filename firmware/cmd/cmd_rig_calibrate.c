/* hdrig rig calibrate: lens and place of every camera of a rig, from takes of it. */
#include "firmware/cmd/cmd_rig.h"

#include "firmware/base/engine.h"
#include "firmware/recon/rigcal.h"

#include "core/base/num.h"
#include "drivers/format/origin.h"
#include "drivers/format/partial.h"

#include <string.h>

struct request {
    const char *takes[RIGCAL_TAKES];
    int n;
    const char *out, *tag;
    double tag_mm;
    bool no_board;
    struct config cfg;
};

struct state {
    struct engine engine;
    struct imageset set[RIGCAL_TAKES];
    struct prep_source source[RIGCAL_TAKES];
    struct rigcal_take take[RIGCAL_TAKES];
    struct rigcal_result result;
    struct partial partial;
};

static err_t list_take(const struct request *rq, int i, struct state *st)
{
    struct imageset_request set = {.images = rq->takes[i],
                                   .no_cameras = true,
                                   .brackets = true,
                                   .lenses = (enum physcam_rule)rq->cfg.cameras_same};
    err_t e = cmd_photographs(&set, &st->set[i]);
    st->source[i] = cmd_source(&st->set[i]);
    st->take[i] = (struct rigcal_take){rq->takes[i], &st->set[i].capture, &st->source[i]};
    return e;
}

/* How well each camera is known: one that is tied badly stands out. */
static void print_cameras(const struct rig *rig)
{
    int wide = 0;
    for (int i = 0; i < rig->n; i++)
        wide = num_max(wide, (int)strlen(rig->views[i].name));
    for (int i = 0; i < rig->n; i++) {
        const struct rig_view *v = &rig->views[i];
        if (v->has_deviation)
            printf("  %-*s  +- %.3f degrees, %.2f %% of its distance to the scene\n", wide, v->name,
                   (double)v->deviation[0], 100 * (double)v->deviation[1]);
    }
}

static void print_result(const struct request *rq, const struct rigcal_result *r)
{
    printf("%s: %d cameras from %d take%s, %d %s fit to %.2f px", rq->out, r->rig.n, rq->n,
           rq->n == 1 ? "" : "s", r->inliers, r->board ? "corners of tags" : "points in views",
           (double)r->rms_px);
    if (r->points > 0)
        printf(", %d points beside them", r->points);
    puts(r->rig.metres ? ", in metres"
         : r->board    ? ", the scale is free: --tag MM gives the printed size of a tag"
                       : "");
    print_cameras(&r->rig);
    for (int i = 0; i < r->notes->n_found; i++) {
        const struct job_lens *l = &r->notes->found[i];
        int n = (int)strlen(l->camera_id); // parts that EXIF lacks leave spaces
        while (n > 0 && l->camera_id[n - 1] == ' ')
            n--;
        printf("%.*s, %d camera%s: %s, focal length %.1f +- %.1f of %d px\n", n, l->camera_id,
               l->photographs, l->photographs == 1 ? "" : "s", lens_name(l->lens.model), l->lens.fx,
               l->lens.fx * l->selfcal.deviation[0], l->edge);
    }
}

/* A former calibration is replaced in one step. */
static err_t write_rig(const struct request *rq, const struct state *st)
{
    char at[FILE_PATH_CAP];
    err_t e = partial_path(&st->partial, rq->out, at);
    if (!e)
        e = cameras_write(at, &st->result.rig);
    return e ? e : partial_show(&st->partial, rq->out);
}

static err_t calibrate_rig(const struct request *rq, struct state *st)
{
    struct job_config cfg = cmd_job(&rq->cfg, NULL, false);
    const struct rigcal_job job = {rq->n, st->take, &cfg, rq->tag_mm, rq->no_board};
    struct job_memory need;
    err_t e = origin_check_place(rq->out);
    if (!e)
        e = partial_open(rq->out, &st->partial);
    for (int i = 0; i < rq->n && !e; i++)
        e = list_take(rq, i, st);
    if (!e)
        cfg.size = recipe_size(&cfg, &st->set[0].capture);
    if (!e)
        e = engine_open(&st->engine, rq->cfg.threads);
    if (!e)
        e = rigcal_plan(&job, pool_size(st->engine.pool), &need);
    if (!e)
        e = engine_reserve(&st->engine, need.pictures, need.keep, need.tmp,
                           config_memory_mb(&rq->cfg));
    if (!e)
        e = rigcal_run(&st->engine.run, &job, &st->result);
    progress_end(&st->engine.progress);
    if (!e)
        e = write_rig(rq, st);
    if (!e)
        print_result(rq, &st->result);
    return e;
}

int cmd_rig_calibrate(int argc, char **argv)
{
    static struct state st;
    static struct request rq;
    int code, words = 0;
    const struct cmd_option options[] = {
        {"out", "FILE", "the calibration, for rig.file and --rig", NULL, &rq.out, NULL},
        {"tag", "MM", "edge of a tag as printed, of the board in the takes: gives metres", NULL,
         &rq.tag, NULL},
        {"no-board", NULL, "do not look for a board", NULL, NULL, &rq.no_board},
        CMD_THREADS,
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {
        "rig calibrate", "TAKE... --out FILE ",
        "Lens and place of every camera of a rig that is bolted together, from takes of it: of\n"
        "anything with texture and depth; several takes of different things give more. With the\n"
        "board of hdrig rig board in them, moved from take to take, also cameras that see nothing\n"
        "in common are tied. The setting rig.file then names the file.",
        options, sizeof options / sizeof options[0]};
    while (words + 1 < argc && argv[words + 1][0] != '-')
        words++;
    for (int i = 1; i <= words && rq.n < RIGCAL_TAKES; i++)
        rq.takes[rq.n++] = argv[i];
    argv[words] = argv[0];
    if (!cmd_parse(&usage, argc - words, argv + words, &rq.cfg, &code))
        return code;
    if (rq.n == 0 || !rq.out)
        return cmd_misuse(&usage, "takes and --out are needed");
    if (words > RIGCAL_TAKES)
        return cmd_misuse(&usage, "too many takes, at most 64");
    if (rq.tag && cmd_number("--tag", rq.tag, 1, 1000, &rq.tag_mm) != OK)
        return cmd_misuse(&usage, err_text());
    if (rq.tag && rq.no_board)
        return cmd_misuse(&usage,
                          "--tag is the size of the board that --no-board does not look for");
    err_t e = calibrate_rig(&rq, &st);
    code = st.result.notes ? cmd_finish_job(usage.name, e, st.result.notes, false)
                           : cmd_finish(usage.name, e);
    partial_close(&st.partial);
    rigcal_free(&st.result);
    for (int i = 0; i < rq.n; i++)
        imageset_free(&st.set[i]);
    engine_close(&st.engine);
    return code;
}
