/* hdrig render: pictures of a scene from other places. */
#include "firmware/cmd.h"
#include "firmware/draw.h"
#include "firmware/engine.h"
#include "firmware/outdir.h"
#include "firmware/path.h"
#include "firmware/report.h"

#include "core/metrics.h"
#include "drivers/cameras.h"
#include "drivers/img.h"
#include "drivers/scenefile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { FRAMES_MAX = 9999 };

struct request {
    const char *scene, *cameras, *path, *out;
    const char *ev_text, *frames_text, *size_text;
    double ev, frames, size; // size 0: that of the cameras
    bool hdr;
    struct config cfg;
};

struct state {
    struct engine engine;
    struct scene scene;
    struct rig rig; // where to stand
    struct draw draw;
    struct outdir out;
    size_t clipped;
    double seconds[2]; // drawing, writing
};

/* ---- where to stand ---- */

static void scale(struct camera *c, int size)
{
    float sx = (float)size / (float)c->w, sy = (float)size / (float)c->h;
    c->fx *= sx;
    c->cx *= sx;
    c->fy *= sy;
    c->cy *= sy;
    c->w = c->h = size;
}

/* Median distance of the splats before camera 0: what an orbit looks at if the cameras do not agree
 * on a point. */
static err_t median_depth(struct state *st, double *out)
{
    const struct gaussians *g = &st->scene.g;
    const struct camera *cam = &st->scene.cams[0];
    double c[3], a[3];
    float *z;
    size_t n = 0, mark = arena_mark(&st->engine.tmp);
    err_t e = arena_alloc(&st->engine.tmp, (size_t)g->n, sizeof *z, &z);
    if (e)
        return e;
    path_centre(cam, c);
    path_axis(cam, a);
    for (int i = 0; i < g->n; i++) {
        double depth = 0;
        for (int k = 0; k < 3; k++)
            depth += a[k] * ((double)g->plane[G_MU + k][i] - c[k]);
        if (depth > 0)
            z[n++] = (float)depth;
    }
    *out = 1;
    if (n > 0)
        e = metrics_quantile(z, n, 0.5, out);
    arena_reset(&st->engine.tmp, mark);
    return e;
}

static err_t make_path(const struct request *rq, struct state *st)
{
    const struct scene *s = &st->scene;
    bool orbit = strcmp(rq->path, "orbit") == 0;
    double far = 1;
    if (s->n_views == 0)
        return err_fail(ERR_ARG, "%s: the scene has no input views: give --cameras FILE",
                        rq->scene);
    st->rig.n = orbit ? (int)rq->frames : s->n_views;
    st->rig.views = calloc((size_t)st->rig.n, sizeof *st->rig.views);
    if (!st->rig.views)
        return err_fail(ERR_NOMEM, "no memory for %d cameras", st->rig.n);
    err_t e = orbit ? median_depth(st, &far) : OK;
    for (int i = 0; i < st->rig.n && !e; i++) {
        if (orbit)
            path_orbit(s->cams, s->n_views, far, i, st->rig.n, &st->rig.views[i].cam);
        else
            st->rig.views[i].cam = s->cams[i];
    }
    return e;
}

static err_t place_cameras(const struct request *rq, struct state *st)
{
    err_t e = rq->cameras ? cameras_read(rq->cameras, &st->rig) : make_path(rq, st);
    for (int i = 0; i < st->rig.n && !e && rq->size > 0; i++)
        scale(&st->rig.views[i].cam, (int)rq->size);
    return e;
}

/* ---- pictures ---- */

static void largest(const struct rig *rig, int *w, int *h)
{
    *w = *h = 0;
    for (int i = 0; i < rig->n; i++) {
        *w = rig->views[i].cam.w > *w ? rig->views[i].cam.w : *w;
        *h = rig->views[i].cam.h > *h ? rig->views[i].cam.h : *h;
    }
}

static err_t write_frame(const struct request *rq, struct state *st, int i)
{
    char name[32], path[FILE_PATH_CAP];
    size_t clipped = 0;
    float log2t = st->scene.tone.mid_log2t + (float)rq->ev;
    double start = engine_seconds();
    err_t e = draw_run(&st->engine.run, &st->draw, &st->scene, &st->rig.views[i].cam);
    if (e)
        return e;
    draw_display(&st->draw, log2t);
    double drawn = engine_seconds();
    snprintf(name, sizeof name, "frame_%04d.png", i);
    e = outdir_path(&st->out, name, path);
    if (!e)
        e = img_write_ldr(path, &st->draw.display);
    snprintf(name, sizeof name, "frame_%04d.exr", i);
    if (!e && rq->hdr)
        e = outdir_path(&st->out, name, path);
    if (!e && rq->hdr)
        e = draw_write_exr(&st->draw, &st->rig.views[i].cam, log2t, path, &clipped);
    st->clipped += clipped;
    st->seconds[0] += drawn - start;
    st->seconds[1] += engine_seconds() - drawn;
    return e;
}

static err_t write_frames(const struct request *rq, struct state *st)
{
    int w, h;
    largest(&st->rig, &w, &h);
    uint64_t pixels = (uint64_t)w * (uint64_t)h, each = pixels * (rq->hdr ? 11 : 3);
    err_t e = outdir_open(rq->out, &st->out);
    if (!e)
        e = outdir_reserve(&st->out, (uint64_t)st->rig.n * (each + each / 64 + 4096));
    if (!e)
        e = draw_init(&st->draw, &st->engine.tmp, st->scene.g.cap, w, h);
    for (int i = 0; i < st->rig.n && !e; i++) {
        e = write_frame(rq, st, i);
        progress_step(&st->engine.progress, "render", i + 1, st->rig.n, NULL);
        if (!e && atomic_load(&engine_cancel))
            e = ERR_CANCELLED;
    }
    return e;
}

static err_t write_report(const struct request *rq, const struct state *st)
{
    char path[FILE_PATH_CAP];
    struct report rep;
    FILE *f;
    err_t e = outdir_path(&st->out, OUTDIR_REPORT, path);
    if (!e)
        e = file_create(path, &f);
    if (e)
        return e;
    report_init(&rep, f);
    report_open(&rep, NULL, '{');
    report_int(&rep, "frames", st->rig.n);
    report_int(&rep, "gaussians", st->scene.g.n);
    report_number(&rep, "ev", rq->ev);
    report_int(&rep, "clipped_values", (long long)st->clipped);
    report_open(&rep, "seconds", '{');
    report_number(&rep, "render", st->seconds[0]);
    report_number(&rep, "write", st->seconds[1]);
    report_close(&rep);
    report_number(&rep, "peak_rss_mb", engine_peak_rss_mb());
    report_close(&rep);
    return file_finish(f, path);
}

/* ---- command ---- */

/* The scene goes to keep; tmp is planned once the pictures' sizes are known, so the scene is read
 * in between. */
static err_t load(const struct request *rq, struct state *st)
{
    char path[FILE_PATH_CAP];
    struct scenefile_info info;
    struct rig sizes = {0};
    int w, h;
    err_t e = file_join(rq->scene, "scene.hdrig", path);
    if (!e)
        e = scenefile_peek(path, &info);
    if (!e && rq->cameras)
        e = cameras_read(rq->cameras, &sizes);
    if (e)
        return e;
    largest(&sizes, &w, &h);
    cameras_free(&sizes);
    if (rq->size > 0 || !rq->cameras)
        w = h = rq->size > 0 ? (int)rq->size : info.size;
    size_t pick = arena_need((size_t)info.n, sizeof(float)), draw = draw_plan(info.n, w, h);
    e = engine_open(&st->engine, rq->cfg.threads);
    if (!e)
        e = engine_reserve(&st->engine, 0, info.need, draw > pick ? draw : pick,
                           rq->cfg.max_memory_mb);
    return e ? e : scenefile_read(path, &st->engine.keep, &st->scene);
}

static err_t render(const struct request *rq, struct state *st)
{
    err_t e = load(rq, st);
    if (!e)
        e = place_cameras(rq, st);
    if (!e)
        e = write_frames(rq, st);
    progress_end(&st->engine.progress);
    if (!e)
        e = write_report(rq, st);
    if (e)
        return st->out.tmp[0] ? outdir_reason(&st->out, e) : e;
    e = outdir_commit(&st->out);
    if (!e)
        printf("%s: %d frames, %.1f s\n", rq->out, st->rig.n, st->seconds[0] + st->seconds[1]);
    return e;
}

static err_t read_numbers(struct request *rq)
{
    rq->frames = 60;
    err_t e = OK;
    if (rq->ev_text)
        e = cmd_number("--ev", rq->ev_text, -40, 40, &rq->ev);
    if (!e && rq->frames_text)
        e = cmd_number("--frames", rq->frames_text, 1, FRAMES_MAX, &rq->frames);
    if (!e && rq->size_text)
        e = cmd_number("--size", rq->size_text, 1, RASTER_SIDE_MAX, &rq->size);
    if (!e && !rq->cameras == !rq->path)
        e = err_fail(ERR_ARG, "give either --cameras or --path");
    if (!e && rq->path && strcmp(rq->path, "orbit") != 0 && strcmp(rq->path, "inputs") != 0)
        e = err_fail(ERR_ARG, "--path: \"%.64s\" is neither orbit nor inputs", rq->path);
    return e;
}

int cmd_render_run(int argc, char **argv)
{
    static struct state st;
    struct request rq = {0};
    const struct cmd_option options[] = {
        {"scene", "DIR", "result of hdrig reconstruct", NULL, &rq.scene, NULL},
        {"cameras", "FILE", "cameras.json: one frame for each of its cameras", NULL, &rq.cameras,
         NULL},
        {"path", "WHICH", "orbit: a circle within the input views; inputs: these", NULL, &rq.path,
         NULL},
        {"ev", "X", "exposure in stops, 0 = the middle one of the photographs", NULL, &rq.ev_text,
         NULL},
        {"frames", "N", "of an orbit, default 60", NULL, &rq.frames_text, NULL},
        {"size", "N", "px, square; else the size of the cameras", NULL, &rq.size_text, NULL},
        {"hdr", NULL, "write radiance as EXR too", NULL, NULL, &rq.hdr},
        {"out", "DIR", "where the frames go; a former result is replaced", NULL, &rq.out, NULL},
        CMD_THREADS,
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {"render",
                                    "--scene DIR --cameras FILE|--path orbit|inputs --out DIR ",
                                    "Pictures of a scene: PNG at one exposure, and EXR.", options,
                                    sizeof options / sizeof options[0]};
    int code;
    if (!cmd_parse(&usage, argc, argv, &rq.cfg, &code))
        return code;
    if (!rq.scene || !rq.out)
        return cmd_misuse(&usage, "--scene and --out are needed");
    if (read_numbers(&rq) != OK)
        return cmd_misuse(&usage, err_text());
    code = cmd_finish(usage.name, render(&rq, &st));
    outdir_close(&st.out);
    cameras_free(&st.rig);
    engine_close(&st.engine);
    return code;
}
