/* hdrig convert-scene: writes a scene as another kind of file and measures the loss. */
#include "core/base/num.h"
#include "core/refine/confidence.h"
#include "core/splat/path.h"
#include "firmware/base/engine.h"
#include "firmware/cmd/cmd.h"
#include "firmware/result/draw.h"
#include "firmware/result/report.h"
#include "firmware/result/sceneio.h"

#include "core/base/log.h"
#include "core/photo/metrics.h"
#include "core/splat/display.h"
#include "drivers/format/cameras.h"
#include "drivers/format/file.h"
#include "drivers/format/scenefile.h"
#include "drivers/format/spzwrite.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

enum { VIEWS_MAX = 4, SIDE_MAX = 448 }; // for the comparison

struct request {
    const char *in, *out, *spz_text, *json, *crop;
    struct sceneio_format format;
    double box[6]; // of crop: x, y, z of its least corner, then of its opposite one
    bool without_guesses;
    bool readable; // out can be read back
    struct config cfg;
};

struct loss {
    int views;
    double display, display_least, radiance, radiance_least; // dB: mean, of the worst view
};

struct state {
    struct engine engine;
    struct sceneio_info info;
    struct scene scene, back; // back: as the file has it
    struct draw draw;
    struct image before[2], after[2]; // display values, radiance
    struct gaussians_report report;
    int left_out;
    double bytes;
    struct loss loss;
    struct cmd_json json;
};

/* ---- what is left out ---- */

static err_t read_box(const char *text, double box[6])
{
    char *end = NULL;
    int n = 0;
    for (const char *at = text; n < 6; at = end + 1) {
        box[n++] = strtod(at, &end);
        if (end == at || *end != (n < 6 ? ',' : '\0') || !isfinite(box[n - 1]))
            return err_fail(ERR_ARG, "--crop: \"%.128s\" is not six numbers like -1,-1,0,1,1,2.5",
                            text);
    }
    for (int k = 0; k < 3; k++)
        if (box[k] >= box[k + 3])
            return err_fail(ERR_ARG, "--crop: from %g to %g in %c there is nothing", box[k],
                            box[k + 3], "xyz"[k]);
    return OK;
}

static bool is_wanted(const struct request *rq, const struct scene *s, int i)
{
    for (int k = 0; k < 3 && rq->crop; k++) {
        double v = (double)s->g.plane[G_MU + k][i];
        if (v < rq->box[k] || v > rq->box[k + 3])
            return false;
    }
    return !rq->without_guesses || s->confidence[i] >= CONFIDENCE_GUESS;
}

/* What remains keeps its order. */
static err_t leave_out(const struct request *rq, struct scene *s, int *left_out)
{
    int all = s->g.n, n = 0;
    if (rq->without_guesses && !s->confidence)
        return err_fail(ERR_ARG,
                        "%s: does not say which splats are guesses; a result folder and its "
                        "scene.hdrig do",
                        rq->in);
    for (int i = 0; i < all; i++) {
        if (!is_wanted(rq, s, i))
            continue;
        gaussians_move(&s->g, i, n);
        if (s->confidence)
            s->confidence[n] = s->confidence[i];
        n++;
    }
    if (n == 0 && all > 0)
        return err_fail(ERR_ARG, "%s: none of %d splats would be left", rq->in, all);
    s->g.n = n;
    *left_out = all - n;
    return OK;
}

/* ---- cameras ---- */

static int side_of(const struct scene *s)
{
    return s->n_views == 0 || s->size > SIDE_MAX ? SIDE_MAX : s->size;
}

/* Camera i of n around a scene that has none: on a circle through the side of its middle splats. */
static err_t camera_around(const struct gaussians *g, int i, int n, struct camera *out)
{
    double middle[3], spread = 0, q;
    for (int k = 0; k < 3; k++) {
        err_t e = metrics_quantile(g->plane[G_MU + k], (size_t)g->n, 0.5, &middle[k]);
        for (int end = 0; end < 2 && !e; end++) {
            e = metrics_quantile(g->plane[G_MU + k], (size_t)g->n, end ? 0.9 : 0.1, &q);
            spread = fmax(spread, fabs(q - middle[k]));
        }
        if (e)
            return e;
    }
    double turn = 2 * NUM_PI * i / n, c = cos(turn), s = sin(turn), t[3];
    for (int k = 0; k < 3; k++) // R = rotation about y; t puts the middle before the camera
        t[k] = -(k == 0   ? c * middle[0] + s * middle[2]
                 : k == 1 ? middle[1]
                          : c * middle[2] - s * middle[0]);
    t[2] += 3 * spread;
    *out = (struct camera){.w = SIDE_MAX,
                           .h = SIDE_MAX,
                           .fx = SIDE_MAX,
                           .fy = SIDE_MAX,
                           .cx = SIDE_MAX / 2,
                           .cy = SIDE_MAX / 2,
                           .q = {(float)cos(turn / 2), 0, (float)sin(turn / 2), 0},
                           .t = {(float)t[0], (float)t[1], (float)t[2]}};
    return OK;
}

static err_t choose_camera(const struct scene *s, int i, int n, struct camera *out)
{
    if (s->n_views == 0)
        return camera_around(&s->g, i, n, out);
    float scale = (float)side_of(s) / (float)s->size;
    *out = s->cams[(size_t)i * (size_t)s->n_views / (size_t)n];
    out->fx *= scale;
    out->fy *= scale;
    out->cx *= scale;
    out->cy *= scale;
    out->w = (int)lrintf((float)out->w * scale);
    out->h = (int)lrintf((float)out->h * scale);
    return OK;
}

/* ---- losses ---- */

static err_t draw_view(struct state *st, const struct scene *s, const struct camera *cam,
                       struct image out[2])
{
    err_t e = draw_run(&st->engine.run, &st->draw, s, cam);
    if (e)
        return e;
    size_t bytes = 3 * (size_t)cam->w * (size_t)cam->h * sizeof(float);
    draw_display(&st->draw, NULL, s->tone.mid_log2t);
    out[0].w = out[1].w = cam->w;
    out[0].h = out[1].h = cam->h;
    memcpy(out[0].px, st->draw.display.px, bytes);
    memcpy(out[1].px, st->draw.maps.radiance, bytes);
    return OK;
}

/* PSNR of one view: of display values, and of radiance through the mu-law at its 0.99 quantile. */
static err_t compare_view(struct state *st, const struct camera *cam, double db[2])
{
    double scale;
    err_t e = draw_view(st, &st->scene, cam, st->before);
    if (!e)
        e = draw_view(st, &st->back, cam, st->after);
    if (!e)
        e = metrics_psnr(&st->before[0], &st->after[0], NULL, &db[0]);
    if (!e)
        e = metrics_quantile(st->before[1].px, 3 * (size_t)cam->w * (size_t)cam->h, 0.99, &scale);
    if (!e)
        e = metrics_mu_law(&st->before[1], scale, &st->before[1]);
    if (!e)
        e = metrics_mu_law(&st->after[1], scale, &st->after[1]);
    return e ? e : metrics_psnr(&st->before[1], &st->after[1], NULL, &db[1]);
}

static err_t alloc_pictures(struct arena *tmp, struct state *st)
{
    err_t e = OK;
    for (int k = 0; k < 4 && !e; k++) {
        struct image *im = k < 2 ? &st->before[k] : &st->after[k - 2];
        im->channels = 3;
        e = arena_alloc(tmp, 3 * SIDE_MAX * SIDE_MAX, sizeof *im->px, &im->px);
    }
    return e;
}

static err_t compare_scenes(struct state *st)
{
    struct loss *l = &st->loss;
    struct arena *tmp = &st->engine.tmp;
    int n = st->scene.n_views > 0 && st->scene.n_views < VIEWS_MAX ? st->scene.n_views : VIEWS_MAX;
    int cap = st->scene.g.cap > st->back.g.cap ? st->scene.g.cap : st->back.g.cap;
    err_t e = draw_init(&st->draw, tmp, cap, side_of(&st->scene), side_of(&st->scene));
    if (!e)
        e = alloc_pictures(tmp, st);
    *l = (struct loss){.views = n, .display_least = INFINITY, .radiance_least = INFINITY};
    for (int i = 0; i < n && !e; i++) {
        struct camera cam;
        double db[2] = {0};
        e = choose_camera(&st->scene, i, n, &cam);
        if (!e)
            e = compare_view(st, &cam, db);
        l->display += db[0] / n;
        l->radiance += db[1] / n;
        l->display_least = fmin(l->display_least, db[0]);
        l->radiance_least = fmin(l->radiance_least, db[1]);
        progress_step(&st->engine.progress, "compare", i + 1, n, NULL);
    }
    return e;
}

/* ---- report ---- */

static err_t report_losses(const struct request *rq, struct state *st)
{
    const struct loss *l = &st->loss;
    int n = st->scene.g.n;
    double each = n > 0 ? st->bytes / n : 0;
    struct report rep;
    err_t e = OK;
    if (st->json.f) {
        report_begin(&rep, st->json.f);
        report_int(&rep, "gaussians", n);
        report_int(&rep, "left_out", st->left_out);
        report_int(&rep, "sh_degree", st->scene.g.degree);
        report_number(&rep, "bytes", st->bytes);
        report_number(&rep, "bytes_per_gaussian", each);
        report_int(&rep, "views", l->views);
        if (l->views > 0) {
            report_number(&rep, "display_psnr", l->display);
            report_number(&rep, "display_psnr_least", l->display_least);
            report_number(&rep, "radiance_psnr", l->radiance);
            report_number(&rep, "radiance_psnr_least", l->radiance_least);
        }
        report_close(&rep);
        e = cmd_json_close(&st->json);
    }
    bool lines = !rq->json || strcmp(rq->json, "-") != 0; // stdout holds no JSON
    if (!e && lines)
        printf("%s: %d splats of degree %d, %.3f MB, %.2f bytes a splat\n", rq->out, n,
               st->scene.g.degree, st->bytes / 1e6, each);
    if (!e && lines && st->left_out > 0)
        printf("%d of %d splats are left out\n", st->left_out, n + st->left_out);
    if (!e && lines && l->views > 0)
        printf("read back, against the original at the middle exposure: display %.1f dB (worst of "
               "%d views %.1f), radiance %.1f dB (%.1f)\n",
               l->display, l->views, l->display_least, l->radiance, l->radiance_least);
    return e;
}

/* ---- command ---- */

static err_t reserve_memory(const struct request *rq, struct state *st)
{
    const struct sceneio_info *info = &st->info;
    struct arena keep = arena_counter(), tmp = arena_counter();
    arena_hold(&keep, info->need);
    if (rq->readable) {
        arena_hold(&keep, gaussians_need(info->n, info->degree)); // read back
        arena_hold(&keep, scenefile_views_need(info->n_views));
        arena_hold(&keep, arena_need((size_t)info->n, sizeof(float))); // confidence
        arena_hold(&tmp, draw_plan(info->n, SIDE_MAX, SIDE_MAX));
        (void)alloc_pictures(&tmp, st); // a counter is never full; compare_scenes allocates again
    }
    return engine_reserve(&st->engine, sceneio_write_plan(info->n, info->degree), keep.peak,
                          tmp.peak, config_memory_mb(&rq->cfg));
}

static err_t show_step(struct state *st, const char *stage, int done)
{
    progress_step(&st->engine.progress, stage, done, 1, NULL);
    return run_check(&st->engine.run, stage);
}

static err_t convert_scene(const struct request *rq, struct state *st)
{
    struct gaussians_report report;
    struct stat file;
    err_t e = sceneio_peek(rq->in, &st->info);
    if (!e)
        e = reserve_memory(rq, st);
    if (!e)
        e = cmd_json_open(rq->json, &st->json);
    if (!e)
        e = show_step(st, "read", 0);
    if (!e)
        e = sceneio_read(rq->in, &st->engine.keep, &st->scene, &st->report);
    if (!e)
        e = leave_out(rq, &st->scene, &st->left_out);
    if (!e)
        e = show_step(st, "write", 0);
    if (!e)
        e = sceneio_write(rq->out, &st->scene, &rq->format);
    if (!e)
        e = show_step(st, "write", 1);
    if (!e && rq->readable)
        e = sceneio_read(rq->out, &st->engine.keep, &st->back, &report);
    if (!e && rq->readable && st->scene.g.n > 0)
        e = compare_scenes(st);
    progress_end(&st->engine.progress);
    if (e)
        return e;
    if (stat(rq->out, &file) == 0)
        st->bytes = (double)file.st_size;
    sceneio_warn(rq->in, &st->info, &st->scene, &st->report);
    return report_losses(rq, st);
}

static err_t check_request(struct request *rq)
{
    rq->format.spz = SPZWRITE_VERSION;
    err_t e = rq->in && rq->out ? OK : err_fail(ERR_ARG, "a scene and --out are needed");
    if (!e && file_is_same(rq->in, rq->out))
        e = err_fail(ERR_ARG, "%s is both input and output: give another --out", rq->in);
    if (!e && rq->spz_text)
        e = cmd_whole("--spz", rq->spz_text, 3, 4, &rq->format.spz);
    if (!e && rq->crop)
        e = read_box(rq->crop, rq->box);
    if (!e)
        e = sceneio_check_place(rq->out, &rq->readable);
    if (!e && rq->format.lossless && rq->readable)
        e = err_fail(ERR_ARG, "--lossless is for .html; .hdrig has all bits always");
    return e;
}

int cmd_convert_scene_run(int argc, char **argv)
{
    static struct state st;
    struct request rq = {0};
    int code;
    const struct cmd_option options[] = {
        {"out", "FILE", "file to write, by its end .hdrig, .ply, .spz, .glb or .html", NULL,
         &rq.out, NULL},
        {"spz", "V", "version of .spz: 3, which viewers know, or 4, smaller; 3", NULL, &rq.spz_text,
         NULL},
        {"lossless", NULL, ".html with all bits: 32 bytes a splat and more instead of 11 to 14",
         NULL, NULL, &rq.format.lossless},
        {"crop", "X,Y,Z,X,Y,Z", "leave out splats outside this box; view.html tells its numbers",
         NULL, &rq.crop, NULL},
        {"without-guesses", NULL, "leave out splats that the photographs do not prove", NULL, NULL,
         &rq.without_guesses},
        {"json", "FILE", "figures as JSON, - for stdout", NULL, &rq.json, NULL},
        CMD_THREADS,
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {
        .name = "convert-scene",
        .synopsis = "IN --out FILE ",
        .what = "A scene (result folder, .hdrig, .ply, .spz, .glb; of other programs .splat,\n"
                ".ksplat, .sog and its folder) becomes another kind of file. Tone curve and\n"
                "cameras go into FILE.json beside .ply, .spz and .glb. Tells what the file lost:\n"
                "it is read back and drawn at the cameras of the scene.",
        .options = options,
        .n_options = sizeof options / sizeof options[0],
    };
    if (argc > 1 && argv[1][0] != '-') { // the scene comes before the options
        rq.in = *++argv;
        *argv = argv[-1];
        argc--;
    }
    if (!cmd_parse(&usage, argc, argv, &rq.cfg, &code))
        return code;
    if (check_request(&rq) != OK)
        return cmd_misuse(&usage, err_text());
    err_t e = engine_open(&st.engine, rq.cfg.threads);
    if (!e)
        e = convert_scene(&rq, &st);
    cmd_json_discard(&st.json);
    code = cmd_finish(usage.name, e);
    engine_close(&st.engine);
    return code;
}
