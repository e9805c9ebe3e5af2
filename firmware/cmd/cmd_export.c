/* hdrig export: cameras, photographs and points of a scene, for programs that make their own. */
#include "firmware/base/engine.h"
#include "firmware/cmd/cmd.h"
#include "firmware/result/export.h"
#include "firmware/result/sceneio.h"

#include "core/base/log.h"
#include "drivers/format/imageset.h"

#include <string.h>

struct request {
    const char *scene, *colmap, *nerfstudio, *lens;
    const char *images[CMD_TEXTS_MAX + 1]; // and a NULL
    char folder[FILE_PATH_CAP];            // that is written
    struct outdir_rules rules;
    struct config cfg;
};

struct state {
    struct engine engine;
    struct imageset set;
    struct scene scene;
    struct outdir out;
};

static err_t list_photographs(const struct request *rq, struct state *st)
{
    char rig[FILE_PATH_CAP];
    const struct imageset_request set = {.images = rq->images[0],
                                         .more = rq->images + 1,
                                         .rig = rig,
                                         .every_exposure = true,
                                         .may_lack_times = true,
                                         .some_cameras = true};
    err_t e = file_join(rq->scene, "cameras.json", rig);
    if (!e)
        e = cmd_photographs(&set, &st->set);
    if (!e && st->set.n_unplaced > 0)
        log_warn("%s: %d photographs are left out, the scene has no camera for them", rq->images[0],
                 st->set.n_unplaced);
    for (int i = 0; i < st->set.n_notes && !e; i++)
        log_warn("%s: %s", rq->images[0], st->set.notes[i]);
    return e;
}

static err_t read_scene(const struct request *rq, struct state *st)
{
    struct sceneio_info info;
    struct gaussians_report report;
    err_t e = sceneio_peek(rq->scene, &info);
    if (!e)
        e = engine_open(&st->engine, rq->cfg.threads);
    if (!e)
        e = engine_reserve(&st->engine, export_plan(&st->set, pool_size(st->engine.pool)),
                           info.need, 0, config_memory_mb(&rq->cfg));
    return e ? e : sceneio_read(rq->scene, &st->engine.keep, &st->scene, &report);
}

static err_t export_scene(const struct request *rq, struct state *st)
{
    const struct export_request request = {.set = &st->set,
                                           .scene = &st->scene,
                                           .photographed = rq->lens != NULL,
                                           .transforms =
                                               rq->nerfstudio ? file_name(rq->nerfstudio) : NULL};
    struct export_result result;
    err_t e = list_photographs(rq, st);
    if (!e)
        e = read_scene(rq, st);
    if (!e)
        e = outdir_open(rq->folder, &rq->rules, &st->out);
    if (!e)
        e = outdir_reserve(&st->out, imageset_bytes(&st->set.capture, st->set.capture.n));
    if (!e)
        e = export_run(&st->engine.run, &request, &st->out, &result);
    if (!e)
        e = outdir_commit(&st->out);
    if (!e)
        printf("%s: %d images, %d points\n", rq->folder, result.n_images, result.n_points);
    return e;
}

/* NULL if the options fit together. */
static const char *misuse_reason(struct request *rq)
{
    const char *file = rq->nerfstudio;
    const size_t n = file ? strlen(file) : 0;
    if (!rq->scene || !rq->images[0] || !rq->colmap == !file)
        return "a scene, --images and one of --colmap and --nerfstudio are needed";
    if (rq->lens && strcmp(rq->lens, "photographed") != 0)
        return "--lens is photographed, or nothing";
    if (!file_is_dir(rq->scene))
        return "the scene is the folder of a result";
    if (file && (n < 6 || strcmp(file + n - 5, ".json") != 0 || !strchr(file, '/')))
        return "--nerfstudio is a file DIR/transforms.json, whose folder is written whole";
    if (rq->colmap)
        return snprintf(rq->folder, sizeof rq->folder, "%s", rq->colmap) < FILE_PATH_CAP
                   ? NULL
                   : "the path of --colmap is too long";
    return file_parent(file, rq->folder) == OK ? NULL : "the path of --nerfstudio is too long";
}

int cmd_export_run(int argc, char **argv)
{
    static struct state st;
    static struct request rq;
    int code;
    const struct cmd_option options[] = {
        {"images", "DIR...", "the photographs that the scene was made from; several as there", NULL,
         rq.images, NULL},
        {"colmap", "DIR", "folder to write: images and sparse/0", NULL, &rq.colmap, NULL},
        {"nerfstudio", "FILE", "DIR/transforms.json to write, with images and points in DIR", NULL,
         &rq.nerfstudio, NULL},
        {"lens", "L", "photographed: photographs as taken and their lenses; else undistorted", NULL,
         &rq.lens, NULL},
        CMD_FORCE(rq.rules),
        CMD_THREADS,
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {
        .name = "export",
        .synopsis = "SCENE --images DIR --colmap DIR | --nerfstudio FILE ",
        .what = "Cameras of a scene, its photographs, undistorted and upright at their full size,\n"
                "and points to start from, as other programs read them.",
        .options = options,
        .n_options = sizeof options / sizeof options[0],
    };
    if (argc > 1 && argv[1][0] != '-') { // the scene comes before the options
        rq.scene = *++argv;
        *argv = argv[-1];
        argc--;
    }
    if (!cmd_parse(&usage, argc, argv, &rq.cfg, &code))
        return code;
    const char *reason = misuse_reason(&rq);
    if (reason)
        return cmd_misuse(&usage, reason);
    rq.rules.inputs[0] = rq.scene;
    memcpy(rq.rules.inputs + 1, rq.images, CMD_TEXTS_MAX * sizeof rq.images[0]);
    code = cmd_finish(usage.name, export_scene(&rq, &st));
    outdir_close(&st.out);
    imageset_free(&st.set);
    engine_close(&st.engine);
    return code;
}
