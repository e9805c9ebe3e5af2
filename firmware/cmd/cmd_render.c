/* hdrig render: pictures of a scene from other places. */
#include "core/base/rotation.h"
#include "core/refine/confidence.h"
#include "core/splat/path.h"
#include "firmware/base/engine.h"
#include "firmware/cmd/cmd.h"
#include "firmware/result/draw.h"
#include "firmware/result/outdir.h"
#include "firmware/result/report.h"
#include "firmware/result/sceneio.h"
#include "firmware/result/video.h"

#include "core/base/log.h"
#include "core/base/num.h"
#include "core/photo/falsecolour.h"
#include "core/photo/metrics.h"
#include "drivers/format/cameras.h"
#include "drivers/format/img.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { FRAMES_MAX = 9999, FRAMES_DEFAULT = 60, FPS_DEFAULT = 30 };

struct request {
    const char *scene, *cameras, *path, *lens, *video, *out;
    const char *ev_text, *frames_text, *size_text, *fps_text;
    double ev[2], fps; // ev: of the first frame, the last
    int frames, size;  // size 0: that of the cameras
    bool hdr, false_colour, confidence;
    struct outdir_rules rules;
    struct config cfg;
};

struct state {
    struct engine engine;
    struct arena own; // holds the scene
    struct scene scene;
    struct rig rig; // cameras of the frames
    struct draw draw;
    struct image8 picture; // the frame drawn last
    float *lensed;         // (4, h, w) of a frame through a lens; NULL: all are pinholes
    struct outdir out;
    struct video video;
    err_t video_error; // the frames are written anyway
    char video_text[512];
    size_t clipped;
    double seconds[2]; // drawing, writing
};

/* ---- cameras ---- */

static void scale_camera(struct camera *c, int w, int h)
{
    float sx = (float)w / (float)c->w, sy = (float)h / (float)c->h;
    c->fx *= sx;
    c->cx *= sx;
    c->fy *= sy;
    c->cy *= sy;
    c->w = w;
    c->h = h;
}

/* Rows for one column of a frame with the shape of the photographs, which were squeezed to squares:
 * pixels are square again. What a network or noise makes of a square one is left as it is. */
static float frame_shape(const struct scene *s)
{
    float fx = 0, fy = 0;
    for (int i = 0; i < s->n_views; i++) {
        fx += s->cams[i].fx;
        fy += s->cams[i].fy;
    }
    return fabsf(fx / fy - 1) < 0.03f ? 1 : fx / fy;
}

static err_t layout_depths(struct arena *tmp, int n, float **z)
{
    return arena_alloc(tmp, (size_t)n, sizeof **z, z);
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
    err_t e = layout_depths(&st->engine.tmp, g->n, &z);
    if (e)
        return e;
    rotation_centre(cam, c);
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

/* Share of frame i on the way from the first to the last. */
static double frame_share(const struct state *st, int i)
{
    return st->rig.n > 1 ? (double)i / (st->rig.n - 1) : 0;
}

/* An orbit, or the input cameras: exactly these, or a way through them if anything moves. */
static err_t make_path(const struct request *rq, struct state *st)
{
    const struct scene *s = &st->scene;
    bool orbit = strcmp(rq->path, "orbit") == 0, moves = orbit || rq->video || rq->frames_text;
    double far = 1;
    if (s->n_views == 0)
        return err_fail(ERR_ARG, "%s: the scene has no input views: give --cameras FILE",
                        rq->scene);
    st->rig.n = moves ? rq->frames : s->n_views;
    st->rig.views = calloc((size_t)st->rig.n, sizeof *st->rig.views);
    if (!st->rig.views)
        return err_fail(ERR_NOMEM, "no memory for %d cameras", st->rig.n);
    err_t e = moves ? median_depth(st, &far) : OK;
    for (int i = 0; i < st->rig.n && !e; i++) {
        struct camera *cam = &st->rig.views[i].cam;
        if (orbit)
            path_orbit(s->cams, s->n_views, far, i, st->rig.n, cam);
        else if (moves)
            path_through(s->cams, s->n_views, far, frame_share(st, i), cam);
        else
            *cam = s->cams[i];
        if (!e)
            scale_camera(cam, cam->w, (int)lrintf((float)cam->h * frame_shape(s)));
    }
    return e;
}

/* The photographs' own: those of the file, or of the result's input views. --size is the longer
 * edge. */
static err_t read_photographed(const struct request *rq, struct state *st)
{
    char path[FILE_PATH_CAP];
    err_t e = rq->cameras ? OK : file_join(rq->scene, "cameras.json", path);
    if (!e)
        e = cameras_read(rq->cameras ? rq->cameras : path, &st->rig);
    if (e)
        return e;
    cameras_use_photographs(&st->rig);
    for (int i = 0; i < st->rig.n; i++) {
        struct rig_view *v = &st->rig.views[i];
        const int edge = num_max(v->cam.w, v->cam.h), most = rq->size ? rq->size : RASTER_SIDE_MAX;
        if (!rq->size && edge <= most)
            continue;
        const int w = num_max(1, (int)lround((double)v->cam.w * most / edge));
        const int h = num_max(1, (int)lround((double)v->cam.h * most / edge));
        lens_scale(&v->lens, (double)w / v->cam.w, (double)h / v->cam.h);
        scale_camera(&v->cam, w, h);
    }
    return OK;
}

static err_t place_cameras(const struct request *rq, struct state *st)
{
    if (rq->lens)
        return read_photographed(rq, st);
    err_t e = rq->cameras ? cameras_read(rq->cameras, &st->rig) : make_path(rq, st);
    for (int i = 0; i < st->rig.n && !e && rq->size > 0; i++)
        scale_camera(&st->rig.views[i].cam, rq->size, rq->size);
    const struct camera *first = e ? NULL : &st->rig.views[0].cam;
    for (int i = 1; i < st->rig.n && !e && rq->video; i++) {
        const struct camera *cam = &st->rig.views[i].cam;
        if (cam->w != first->w || cam->h != first->h)
            e = err_fail(ERR_ARG,
                         "camera %d is for %d x %d px, the first for %d x %d; a video has one "
                         "size: give --size",
                         i, cam->w, cam->h, first->w, first->h);
    }
    return e;
}

/* ---- pictures ---- */

/* The camera that is drawn for a frame: its own, or the pinhole that covers what its lens shows. */
static err_t drawn_camera(const struct request *rq, const struct rig_view *v, struct camera *out)
{
    *out = v->cam;
    if (!rq->lens)
        return OK;
    return draw_lens_camera(&v->lens, &v->cam, 4 * num_max(v->cam.w, v->cam.h), out);
}

/* Room for any frame and for the picture that is drawn for it. */
static err_t largest_frame(const struct request *rq, const struct rig *rig, int *w, int *h)
{
    *w = *h = 0;
    for (int i = 0; i < rig->n; i++) {
        const struct camera *frame = &rig->views[i].cam;
        struct camera drawn;
        err_t e = drawn_camera(rq, &rig->views[i], &drawn);
        if (e)
            return e;
        *w = num_max(*w, num_max(frame->w, drawn.w));
        *h = num_max(*h, num_max(frame->h, drawn.h));
    }
    return OK;
}

/* The last drawing at an exposure, in 8 bits. */
static void develop_frame(const struct request *rq, struct state *st, float log2t)
{
    const struct render *maps = &st->draw.maps;
    st->picture.w = maps->w;
    st->picture.h = maps->h;
    if (rq->false_colour) {
        const struct image radiance = {maps->w, maps->h, 3, maps->radiance};
        falsecolour_run(&radiance, log2t, &st->picture);
        return;
    }
    size_t n = (size_t)maps->w * (size_t)maps->h;
    const float *px = rq->confidence ? maps->radiance : st->draw.display.px;
    draw_display(&st->draw, NULL, log2t);
    for (size_t i = 0; i < 3 * n; i++) {
        float v = px[i % 3 * n + i / 3];
        st->picture.px[i] = (uint8_t)(v > 0 ? fminf(v, 1) * 255.0f + 0.5f : 0); // NaN is black
    }
}

/* From --ev A to B, slow at both ends. */
static float frame_exposure(const struct request *rq, const struct state *st, int i)
{
    double u = frame_share(st, i), ev = rq->ev[0] + (rq->ev[1] - rq->ev[0]) * u * u * (3 - 2 * u);
    return st->scene.tone.mid_log2t + (float)ev;
}

/* Files of the frame drawn last. */
static err_t write_frame(const struct request *rq, struct state *st, int i, float log2t)
{
    char name[32], path[FILE_PATH_CAP];
    size_t clipped = 0;
    err_t e;
    snprintf(name, sizeof name, "frame_%04d.png", i);
    e = outdir_path(&st->out, name, path);
    if (!e)
        e = img_write_png(path, &st->picture);
    snprintf(name, sizeof name, "frame_%04d.exr", i);
    if (!e && rq->hdr)
        e = outdir_path(&st->out, name, path);
    if (!e && rq->hdr)
        e = draw_write_exr(&st->draw, &st->rig.views[i].cam, log2t, path, &clipped);
    st->clipped += clipped;
    return e;
}

static err_t make_frame(const struct request *rq, struct state *st, int i)
{
    float log2t = frame_exposure(rq, st, i);
    double start = engine_seconds();
    const struct rig_view *v = &st->rig.views[i];
    struct camera cam;
    const struct draw_lens through = {&v->lens, &cam, {v->cam.w, v->cam.h, 0}, st->lensed, NULL};
    err_t e = drawn_camera(rq, v, &cam);
    if (!e)
        e = draw_run(&st->engine.run, &st->draw, &st->scene, &cam);
    if (!e && rq->lens && lens_distorts(&v->lens))
        e = draw_through_lens(st->engine.pool, &st->draw, &through);
    if (e)
        return e;
    develop_frame(rq, st, log2t);
    double drawn = engine_seconds();
    if (rq->out)
        e = write_frame(rq, st, i, log2t);
    st->seconds[0] += drawn - start;
    st->seconds[1] += engine_seconds() - drawn;
    return e;
}

/* Print the scale of the false colours. */
static err_t write_legend(const struct state *st)
{
    static uint8_t px[3 * FALSECOLOUR_LEGEND_W * FALSECOLOUR_LEGEND_H];
    const struct image8 legend = {FALSECOLOUR_LEGEND_W, FALSECOLOUR_LEGEND_H, 3, px};
    char path[FILE_PATH_CAP];
    falsecolour_legend(&legend);
    err_t e = outdir_path(&st->out, "legend.png", path);
    return e ? e : img_write_png(path, &legend);
}

/* Also if it does not exist yet. */
static bool is_place(const char *a, const char *b)
{
    char above_a[FILE_PATH_CAP], above_b[FILE_PATH_CAP];
    return file_is_same(a, b) ||
           (strcmp(file_name(a), file_name(b)) == 0 && file_parent(a, above_a) == OK &&
            file_parent(b, above_b) == OK && file_is_same(above_a, above_b));
}

/* A video in the folder of the frames appears with them: that folder is yet to get its name. */
static err_t video_path(const struct request *rq, const struct state *st, char path[FILE_PATH_CAP])
{
    char folder[FILE_PATH_CAP];
    err_t e = file_parent(rq->video, folder);
    if (e || (rq->out && is_place(folder, st->out.path)))
        return e ? e : outdir_path(&st->out, file_name(rq->video), path);
    int n = snprintf(path, FILE_PATH_CAP, "%s", rq->video);
    return n < FILE_PATH_CAP ? OK : err_fail(ERR_ARG, "%.64s...: path too long", rq->video);
}

/* Frames go on without a video; the reason is printed now and at the end. */
static err_t without_video(const struct request *rq, struct state *st, err_t e)
{
    if (!e || e == ERR_CANCELLED || !rq->out)
        return e;
    st->video_error = e;
    snprintf(st->video_text, sizeof st->video_text, "%s", err_text());
    progress_end(&st->engine.progress);
    log_warn("render: %s; the frames go on without a video", st->video_text);
    video_close(&st->video);
    return OK;
}

static err_t open_video(const struct request *rq, struct state *st)
{
    char path[FILE_PATH_CAP];
    const struct camera *cam = &st->rig.views[0].cam;
    err_t e = video_path(rq, st, path);
    if (!e)
        e = video_open(path, cam->w, cam->h, rq->fps, &st->video);
    return e == ERR_UNSUPPORTED ? e : without_video(rq, st, e);
}

static err_t open_folder(const struct request *rq, uint64_t pixels, struct state *st)
{
    uint64_t each = pixels * (rq->hdr ? 11 : 3);
    err_t e = outdir_open(rq->out, &rq->rules, &st->out);
    if (!e)
        e = outdir_reserve(&st->out, (uint64_t)st->rig.n * (each + each / 64 + 4096));
    return e || !rq->false_colour ? e : write_legend(st);
}

static err_t layout_pictures(const struct request *rq, struct state *st, struct arena *a, int w,
                             int h)
{
    err_t e = draw_init(&st->draw, a, st->scene.g.cap, w, h);
    if (!e && rq->lens)
        e = arena_alloc(a, (size_t)w * (size_t)h, 4 * sizeof *st->lensed, &st->lensed);
    return e ? e : arena_alloc(a, (size_t)w * (size_t)h, 3, &st->picture.px);
}

static err_t prepare_frames(const struct request *rq, struct state *st)
{
    int w, h;
    err_t e = largest_frame(rq, &st->rig, &w, &h);
    uint64_t pixels = (uint64_t)w * (uint64_t)h;
    if (!e && rq->out)
        e = open_folder(rq, pixels, st);
    if (!e)
        e = layout_pictures(rq, st, &st->engine.tmp, w, h);
    st->picture.channels = 3;
    return e || !rq->video ? e : open_video(rq, st);
}

static err_t make_frames(const struct request *rq, struct state *st)
{
    err_t e = prepare_frames(rq, st);
    for (int i = 0; i < st->rig.n && !e; i++) {
        e = make_frame(rq, st, i);
        if (!e && st->video.pipe)
            e = without_video(rq, st, video_put(&st->video, &st->picture));
        progress_step(&st->engine.progress, "render", i + 1, st->rig.n, NULL);
        if (!e && atomic_load(&engine_cancel))
            e = ERR_CANCELLED;
    }
    return e || !st->video.pipe ? e : without_video(rq, st, video_finish(&st->video));
}

static err_t write_report(const struct request *rq, const struct state *st)
{
    struct report rep;
    err_t e = outdir_report_open(&st->out, &rep);
    if (e)
        return e;
    report_int(&rep, "frames", st->rig.n);
    report_int(&rep, "gaussians", st->scene.g.n);
    report_number(&rep, "ev", rq->ev[0]);
    report_number(&rep, "ev_last", rq->ev[1]);
    if (rq->false_colour) // luminance of the scene where the colours show 0 stops, first frame
        report_number(&rep, "false_colour_0", exp2(-(double)frame_exposure(rq, st, 0)));
    if (rq->video)
        report_text(&rep, "video", st->video_error ? NULL : st->video.format->encoder);
    report_int(&rep, "clipped_values", (long long)st->clipped);
    report_open(&rep, "seconds", '{');
    report_number(&rep, "render", st->seconds[0]);
    report_number(&rep, "write", st->seconds[1]);
    report_close(&rep);
    report_number(&rep, "peak_rss_mb", engine_peak_rss_mb());
    return outdir_report_close(&st->out, &rep);
}

/* ---- command ---- */

/* For the colours of splats that show their confidence. */
static err_t layout_colours(struct arena *keep, int n, float **colour)
{
    return arena_alloc(keep, (size_t)n + 16, sizeof **colour, colour); // planes are padded
}

static err_t show_confidence(const struct request *rq, struct state *st)
{
    float *colour;
    if (!st->scene.confidence)
        return err_fail(ERR_ARG,
                        "%s: its confidence is not known, only scene.hdrig of a new "
                        "reconstruction has it",
                        rq->scene);
    err_t e = layout_colours(&st->engine.keep, st->scene.g.n, &colour);
    if (e)
        return e;
    confidence_splats(&st->scene, colour, &st->scene.g);
    memset(st->scene.background, 0, sizeof st->scene.background);
    return OK;
}

static err_t load_scene(const struct request *rq, struct state *st)
{
    struct sceneio_info info;
    struct gaussians_report report = {0};
    struct arena tmp = arena_counter(), keep = arena_counter();
    float *depths;
    if (!file_exists(rq->scene))
        return err_fail(ERR_IO, "%s: %s", rq->scene, strerror(ENOENT));
    err_t e = sceneio_peek(rq->scene, &info);
    if (!e)
        e = engine_open(&st->engine, rq->cfg.threads);
    if (!e)
        e = layout_depths(&tmp, info.n, &depths);
    if (!e)
        e = layout_colours(&keep, info.n, &depths);
    if (!e)
        e = engine_reserve(&st->engine, 0, arena_add(info.need, keep.peak), tmp.peak,
                           config_memory_mb(&rq->cfg));
    if (!e)
        e = sceneio_read(rq->scene, &st->engine.keep, &st->scene, &report);
    if (e)
        return e;
    if (!info.has_hdr)
        log_warn("%s: display colours without radiance, taken as sRGB", rq->scene);
    if (report.dropped > 0)
        log_warn("%s: %d splats were not finite and are left out", rq->scene, report.dropped);
    e = place_cameras(rq, st);
    return e || !rq->confidence ? e : show_confidence(rq, st);
}

/* Memory for the pictures, whose sizes are known once the scene is there. */
static err_t make_room(const struct request *rq, struct state *st)
{
    int w, h;
    err_t e = largest_frame(rq, &st->rig, &w, &h);
    if (e)
        return e;
    st->own = st->engine.keep;
    st->engine.keep = (struct arena){0};
    arena_free(&st->engine.tmp);
    struct arena tmp = arena_counter();
    e = layout_pictures(rq, st, &tmp, w, h);
    return e ? e
             : engine_reserve(&st->engine, st->own.size, 0, tmp.peak, config_memory_mb(&rq->cfg));
}

static err_t render_frames(const struct request *rq, struct state *st)
{
    err_t e = load_scene(rq, st);
    if (!e)
        e = make_room(rq, st);
    if (!e)
        e = make_frames(rq, st);
    progress_end(&st->engine.progress);
    if (!e && rq->out)
        e = write_report(rq, st);
    if (e)
        return st->out.partial.dir[0] ? outdir_reason(&st->out, e) : e;
    if (rq->out)
        e = outdir_commit(&st->out);
    if (!e && rq->out)
        printf("%s: %d frames, %.1f s\n", rq->out, st->rig.n, st->seconds[0] + st->seconds[1]);
    if (!e && st->video_error)
        return err_fail(st->video_error, "%s (the frames are in %s)", st->video_text, rq->out);
    if (!e && rq->video)
        printf("%s: %.1f s, %g frames/s, %s (%s)\n", rq->video, st->rig.n / rq->fps, rq->fps,
               st->video.format->codec, st->video.format->encoder);
    return e;
}

/* "X", or "A..B". */
static err_t read_ev(const char *text, double ev[2])
{
    char first[32];
    const char *dots = strstr(text, "..");
    size_t n = dots ? (size_t)(dots - text) : 0;
    if (n >= sizeof first)
        return err_fail(ERR_ARG, "--ev: \"%.64s\" is not like -3..3", text);
    snprintf(first, sizeof first, "%.*s", (int)n, text);
    err_t e = cmd_number("--ev", dots ? first : text, -40, 40, &ev[0]);
    ev[1] = ev[0];
    return e || !dots ? e : cmd_number("--ev", dots + 2, -40, 40, &ev[1]);
}

static bool is_mp4(const char *path)
{
    size_t n = strlen(path);
    return n > 4 && strcmp(path + n - 4, ".mp4") == 0 && path[n - 5] != '/';
}

static err_t check_lens(const struct request *rq)
{
    if (!rq->lens)
        return OK;
    if (strcmp(rq->lens, "photographed") != 0)
        return err_fail(ERR_ARG, "--lens is photographed, or nothing");
    if (rq->path && (strcmp(rq->path, "inputs") != 0 || rq->frames_text || rq->video))
        return err_fail(ERR_ARG, "--lens photographed: a path has no photographs; give --cameras "
                                 "FILE, or --path inputs without --frames and --video");
    return OK;
}

static err_t read_numbers(struct request *rq)
{
    rq->frames = FRAMES_DEFAULT;
    rq->fps = FPS_DEFAULT;
    err_t e = OK;
    if (rq->ev_text)
        e = read_ev(rq->ev_text, rq->ev);
    if (!e && rq->frames_text)
        e = cmd_whole("--frames", rq->frames_text, 1, FRAMES_MAX, &rq->frames);
    if (!e && rq->size_text)
        e = cmd_whole("--size", rq->size_text, 1, RASTER_SIDE_MAX, &rq->size);
    if (!e && rq->fps_text)
        e = cmd_number("--fps", rq->fps_text, 1, VIDEO_FPS_MAX, &rq->fps);
    if (!e && rq->fps_text && !rq->video)
        e = err_fail(ERR_ARG, "--fps is for --video");
    if (!e && rq->hdr && !rq->out)
        e = err_fail(ERR_ARG, "--hdr writes frames: give --out DIR");
    if (!e && rq->video && !is_mp4(rq->video))
        e = err_fail(ERR_ARG, "--video: \"%.64s\" does not end in .mp4", rq->video);
    if (!e && rq->confidence && (rq->ev_text || rq->false_colour))
        e = err_fail(ERR_ARG, "--confidence has no exposure: leave out --ev and --false-colour");
    if (!e && !rq->cameras == !rq->path)
        e = err_fail(ERR_ARG, "give either --cameras or --path");
    if (!e && rq->frames_text && rq->cameras)
        e = err_fail(ERR_ARG, "--frames is for --path: --cameras has one for each");
    if (!e && rq->path && strcmp(rq->path, "orbit") != 0 && strcmp(rq->path, "inputs") != 0)
        e = err_fail(ERR_ARG, "--path: \"%.64s\" is neither orbit nor inputs", rq->path);
    return e ? e : check_lens(rq);
}

int cmd_render_run(int argc, char **argv)
{
    static struct state st;
    struct request rq = {0};
    const struct cmd_option options[] = {
        {"scene", "PATH", "result of hdrig reconstruct, or a file .hdrig, .ply, .spz or .glb", NULL,
         &rq.scene, NULL},
        {"cameras", "FILE", "cameras.json: one frame for each of its cameras", NULL, &rq.cameras,
         NULL},
        {"path", "WHICH", "orbit: a circle within the input views; inputs: these, or through them",
         NULL, &rq.path, NULL},
        {"lens", "L", "photographed: with the lens of each photograph, its size and shape", NULL,
         &rq.lens, NULL},
        {"frames", "N", "of an orbit, or of a way through the inputs (with --video: 60)", NULL,
         &rq.frames_text, NULL},
        {"video", "FILE.mp4", "the frames as a film, by ffmpeg", NULL, &rq.video, NULL},
        {"fps", "N", "its frames a second, default 30", NULL, &rq.fps_text, NULL},
        {"ev", "X", "exposure in stops, 0 = the middle one of the photographs; A..B: from A to B",
         NULL, &rq.ev_text, NULL},
        {"false-colour", NULL, "radiance in colours, 8 stops around that exposure; legend.png",
         NULL, NULL, &rq.false_colour},
        {"confidence", NULL,
         "how much the photographs prove of each pixel: black nothing, white all", NULL, NULL,
         &rq.confidence},
        {"size", "N", "px, square; with --lens the longer edge; else that of the photographs", NULL,
         &rq.size_text, NULL},
        {"hdr", NULL, "write radiance as EXR too", NULL, NULL, &rq.hdr},
        {"out", "DIR", "where the frames go, if they are wanted; a former result is replaced", NULL,
         &rq.out, NULL},
        CMD_FORCE(rq.rules),
        CMD_THREADS,
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {
        "render", "--scene PATH --cameras FILE|--path orbit|inputs --out DIR|--video FILE ",
        "Pictures of a scene as PNG, EXR and video.", options, sizeof options / sizeof options[0]};
    int code;
    if (!cmd_parse(&usage, argc, argv, &rq.cfg, &code))
        return code;
    if (!rq.scene || (!rq.out && !rq.video))
        return cmd_misuse(&usage, "--scene is needed, and --out or --video");
    if (read_numbers(&rq) != OK)
        return cmd_misuse(&usage, err_text());
    rq.rules.inputs[0] = rq.scene;
    rq.rules.inputs[1] = rq.cameras;
    code = cmd_finish(usage.name, render_frames(&rq, &st));
    video_close(&st.video);
    outdir_close(&st.out);
    cameras_free(&st.rig);
    arena_free(&st.own);
    engine_close(&st.engine);
    return code;
}
