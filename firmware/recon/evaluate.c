#include "firmware/recon/evaluate.h"

#include "firmware/recon/shading.h"
#include "firmware/recon/testview.h"

#include "core/refine/confidence.h"
#include "core/splat/path.h"
#include "firmware/result/draw.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/photo/distort.h"
#include "core/photo/metrics.h"
#include "core/photo/prep.h"
#include "core/photo/response.h"
#include "core/photo/undistort.h"
#include "core/sfm/pose.h"
#include "drivers/format/exrfile.h"
#include "drivers/format/img.h"
#include "drivers/format/name.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The photograph that is looked at. */
struct view {
    struct extent px;
    const uint8_t *rgb;    // (h, w, 3)
    const uint8_t *masked; // (h, w) 1: does not count; NULL: nothing is
    float log2t;
    struct camera cam;
    bool lensed;         // as it was taken, through:
    struct lens lens;    // for px
    struct camera drawn; // what is drawn for it: cam, or the pinhole that covers the lens
};

struct bench {
    const struct run *r;
    struct job_result *j;
    const struct imageset *test;
    const struct evaluate_seen *inputs;
    const struct lpips *lpips; // or NULL
    struct outdir *o;
    struct draw draw;
    struct image truth,
        other;       // (3, h, w): the photograph; nearest view or mu-law of the truth
    struct image mu; // (3, h, w): mu-law of the prediction
    struct draw_confidence confidence; // of the view drawn last
    float *room;                       // (4, h, w)
    const uint8_t *seen;               // (h, w) pixels that count; NULL: all
    uint8_t *shown[2];                 // (h, w) what *drawn and the nearest view show of a lens
    uint8_t *counts; // (h, w) of a masked photograph: what *drawn shows and no mask hides
    size_t clipped;
    struct evaluate_result *out;
};

enum { IMAGES = 3, LENS_SIDES = 2 }; // of the view at most, what is drawn for a lens

static const double STOPS_BELOW = 14; // radiance that counts, below the 99 % quantile of the truth
static const float SAME_EXPOSURE = 0.05f; // stops
static const float STRANGE_STOPS = 5;     // from the middle exposure to that of other pictures

static void add_score(struct evaluate_score *s, const struct evaluate_score *one)
{
    s->n++;
    s->psnr += (one->psnr - s->psnr) / s->n;
    s->ssim += (one->ssim - s->ssim) / s->n;
    s->lpips += (one->lpips - s->lpips) / s->n;
}

/* What does not count becomes the same in both: windows reach over it. */
static err_t compare_picture(struct bench *b, const struct image *picture, struct image *truth,
                             struct evaluate_score *one)
{
    const size_t n = (size_t)truth->w * (size_t)truth->h;
    for (size_t i = 0; i < 3 * n && b->seen; i++)
        if (!b->seen[i % n])
            truth->px[i] = picture->px[i];
    *one = (struct evaluate_score){.n = 1, .lpips = NAN};
    err_t e = metrics_psnr(picture, truth, b->seen, &one->psnr);
    if (!e)
        e = metrics_ssim(picture, truth, b->seen, b->r->tmp, &one->ssim);
    return e || !b->lpips ? e : lpips_run(b->r, b->lpips, picture, truth, &one->lpips);
}

/* ---- LDR ---- */

static void to_planar(const uint8_t *rgb, struct image *out)
{
    size_t pixels = (size_t)out->w * (size_t)out->h;
    for (size_t i = 0; i < pixels; i++)
        for (size_t c = 0; c < 3; c++)
            out->px[c * pixels + i] = (float)rgb[3 * i + c] / 255.0f;
}

/* Input view i_view as it would look at exposure log2t, into b->other. */
static void reexpose_picture(struct bench *b, int i_view, float log2t)
{
    const struct views *v = &b->j->views;
    const struct tonemap *tone = &b->j->response;
    const size_t pixels = extent_pixels(&v->extent[i_view]);
    const uint8_t *rgb = views_rgb(v, i_view);
    for (int c = 0; c < 3; c++) {
        float to[256];
        for (int z = 0; z < 256; z++) {
            float nats = response_radiance_log(tone, c, (float)z / 255.0f, v->log2t[i_view]);
            to[z] = response_display(tone, c, nats * 1.44269504f + log2t - tone->mid_log2t);
        }
        for (size_t i = 0; i < pixels; i++)
            b->other.px[(size_t)c * pixels + i] = to[rgb[3 * i + (size_t)c]];
    }
}

static err_t find_exposure(struct evaluate_result *out, double exposure,
                           struct evaluate_score **score)
{
    int i = 0;
    while (i < out->n_exposures && out->exposures[i].exposure < exposure)
        i++;
    *score = &out->exposures[i].score;
    if (i < out->n_exposures && out->exposures[i].exposure <= exposure)
        return OK;
    if (out->n_exposures == EVALUATE_EXPOSURES)
        return err_fail(ERR_FORMAT, "the test pictures have more than %d different exposures",
                        EVALUATE_EXPOSURES);
    memmove(&out->exposures[i + 1], &out->exposures[i],
            (size_t)(out->n_exposures++ - i) * sizeof out->exposures[0]);
    out->exposures[i] = (struct evaluate_exposure){.exposure = exposure};
    return OK;
}

static void add_trust(const struct bench *b, struct evaluate_trust *t)
{
    const size_t pixels = (size_t)b->truth.w * (size_t)b->truth.h;
    for (size_t i = 0; i < 3 * pixels; i++) {
        const double d = (double)b->draw.display.px[i] - (double)b->truth.px[i];
        if (b->seen && !b->seen[i % pixels])
            continue;
        const int known = b->confidence.map[i % pixels] >= CONFIDENCE_GUESS;
        t->pixels[known] += 1.0 / 3;
        t->squares[known] += d * d / 3;
    }
}

/* The nearest input view in b->other, as the photograph's lens takes it. */
static err_t lens_nearest(struct bench *b, const struct view *v, int near)
{
    const size_t n = extent_pixels(&v->px);
    const struct extent *px = &b->j->views.extent[near];
    const struct camera cam = pose_scaled(&b->j->views.cams[near], px->w, px->h);
    const struct distort_job j = {&v->lens, &cam,        3,       v->px.w,
                                  v->px.h,  b->other.px, b->room, b->shown[1]};
    err_t e = distort_run(b->r->pool, &j);
    memcpy(b->other.px, b->room, 3 * n * sizeof *b->room);
    for (size_t i = 0; i < n; i++)
        b->shown[1][i] &= b->seen[i];
    b->seen = b->shown[1];
    return e;
}

/* The nearest input view at this exposure. */
static err_t measure_nearest(struct bench *b, const struct view *v)
{
    const struct views *inputs = &b->j->views;
    const int near = inputs->n > 0 ? path_nearest(inputs->cams, inputs->n, &v->cam) : -1;
    if (near < 0 ||
        (!v->lensed && (inputs->extent[near].w != v->px.w || inputs->extent[near].h != v->px.h)))
        return OK;
    struct evaluate_score one;
    reexpose_picture(b, near, v->log2t);
    err_t e = v->lensed ? lens_nearest(b, v, near) : OK;
    if (!e)
        e = compare_picture(b, &b->other, &b->truth, &one);
    if (!e)
        add_score(&b->out->nearest, &one);
    return e;
}

static bool is_seen(const struct evaluate_seen *s, float log2t)
{
    for (int i = 0; i < s->n; i++)
        if (fabsf(s->log2t[i] - log2t) < SAME_EXPOSURE)
            return true;
    return false;
}

void evaluate_see(struct evaluate_seen *s, float log2t)
{
    if (s->n < EVALUATE_EXPOSURES && !is_seen(s, log2t))
        s->log2t[s->n++] = log2t;
}

static float middle_of(const struct evaluate_seen *s)
{
    float least = s->log2t[0], most = least;
    for (int i = 1; i < s->n; i++) {
        least = fminf(least, s->log2t[i]);
        most = fmaxf(most, s->log2t[i]);
    }
    return (least + most) / 2;
}

void evaluate_compare_units(const struct evaluate_seen *inputs, const struct capture *test,
                            struct job_result *j)
{
    struct evaluate_seen seen = {0};
    if (!inputs->n || !test->n)
        return;
    for (int i = 0; i < test->n; i++)
        evaluate_see(&seen, log2f((float)test->shots[i].exposure));
    const float away = middle_of(&seen) - middle_of(inputs);
    if (fabsf(away) > STRANGE_STOPS)
        job_result_warn(j,
                        "the test pictures are exposed %.0f stops %s than the scene's photographs: "
                        "unless they were taken so, one of the two has its exposures in another "
                        "unit (EXIF has seconds, exposure.json may have any)",
                        (double)fabsf(away), away > 0 ? "more" : "less");
}

static err_t measure_ldr(struct bench *b, const struct shot *s, const struct view *v)
{
    struct evaluate_result *out = b->out;
    struct evaluate_score *score = NULL, one;
    err_t e = find_exposure(out, s->exposure, &score);
    if (e)
        return e;
    to_planar(v->rgb, &b->truth);
    if (b->j->scene.confidence)
        add_trust(b, &out->trust);
    e = compare_picture(b, &b->draw.display, &b->truth, &one);
    if (e)
        return e;
    const bool seen = is_seen(b->inputs, v->log2t);
    add_score(score, &one);
    add_score(&out->ldr, &one);
    add_score(seen ? &out->ldr_seen : &out->ldr_unseen, &one);
    out->pictures[out->n_pictures++] =
        (struct evaluate_picture){s->name, s->exposure, one.psnr, one.ssim, one.lpips, seen};
    return measure_nearest(b, v);
}

/* ---- HDR ---- */

/* File of the radiance of a test picture: test_ldr_000_2.png has images_hdr/test_hdr_000.exr, or
 * 1_2.png has exr/1.exr. */
static err_t radiance_path(const struct imageset *set, const char *picture,
                           char path[FILE_PATH_CAP])
{
    static const char *const folders[] = {"images_hdr", "../images_hdr", "../exr"};
    char name[NAME_CAP + 32];
    int stem = (int)name_view(picture);
    err_t e = OK;
    for (size_t i = 0; i < sizeof folders / sizeof folders[0]; i++) {
        int n = snprintf(name, sizeof name, "%s/", folders[i]);
        snprintf(name + n, sizeof name - (size_t)n, "%.*s.exr", stem, picture);
        char *ldr = strstr(name + n, "_ldr_");
        if (ldr)
            ldr[1] = 'h', ldr[2] = 'd', ldr[3] = 'r';
        e = file_join(set->dir, name, path);
        if (e || file_is_regular(path))
            return e;
    }
    path[0] = 0;
    return OK;
}

struct taps {
    int from, to; // half open
    double centre, scale;
};

/* Triangle filter, widened when it shrinks: bilinear with antialiasing. */
static struct taps taps_of(int i, int out, int in)
{
    double ratio = (double)in / out, scale = ratio > 1 ? ratio : 1, centre = (i + 0.5) * ratio;
    int from = (int)(centre - scale + 0.5), to = (int)(centre + scale + 0.5);
    return (struct taps){from > 0 ? from : 0, to < in ? to : in, centre, scale};
}

static double tap_weight(const struct taps *t, int k)
{
    double w = 1 - fabs((k + 0.5 - t->centre) / t->scale);
    return w > 0 ? w : 0;
}

static float sample_taps(const struct image *in, int c, const struct taps *tx,
                         const struct taps *ty)
{
    double sum = 0, weight = 0;
    for (int y = ty->from; y < ty->to; y++)
        for (int x = tx->from; x < tx->to; x++) {
            double w = tap_weight(tx, x) * tap_weight(ty, y);
            sum +=
                w *
                (double)in->px[((size_t)c * (size_t)in->h + (size_t)y) * (size_t)in->w + (size_t)x];
            weight += w;
        }
    return (float)(sum / weight);
}

static void resize_image(const struct image *in, struct image *out)
{
    float *px = out->px;
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < out->h; y++) {
            struct taps ty = taps_of(y, out->h, in->h);
            for (int x = 0; x < out->w; x++) {
                struct taps tx = taps_of(x, out->w, in->w);
                *px++ = sample_taps(in, c, &tx, &ty);
            }
        }
}

static err_t brightest(const struct image *in, double *out)
{
    return metrics_quantile(in->px, 3 * (size_t)in->w * (size_t)in->h, 0.99, out);
}

static err_t mu_law(const struct image *in, struct image *out)
{
    double q;
    err_t e = brightest(in, &q);
    return e ? e : metrics_mu_law(in, q, out);
}

/* Radiance against the truth in b->other, in stops; b->mu is room. */
static err_t measure_stops(struct bench *b, const struct image *radiance)
{
    double top, stops = NAN;
    err_t e = brightest(&b->other, &top);
    if (!e && top > 0)
        e = metrics_stops(radiance, &b->other, b->seen, top * exp2(-STOPS_BELOW), b->mu.px, &stops);
    if (!e && isfinite(stops))
        b->out->stops += (stops - b->out->stops) / ++b->out->n_stops;
    return e;
}

static void hide_unseen(const struct bench *b, struct image *io)
{
    const size_t n = (size_t)io->w * (size_t)io->h;
    for (size_t i = 0; i < 3 * n && b->seen; i++)
        if (!b->seen[i % n])
            io->px[i] = 0;
}

/* The radiance of a photograph that is compared undistorted is undistorted as that was. */
static err_t undistort_truth(const struct run *r, const struct shot *s, struct image *io)
{
    struct lens lens = s->lens;
    struct camera pinhole = s->cam;
    const double across = (double)io->w / s->taken_w, down = (double)io->h / s->taken_h;
    if (!lens_distorts(&lens))
        return OK;
    lens_scale(&lens, across, down);
    pinhole = pose_scaled(&pinhole, num_max(1, (int)lround(pinhole.w * across)),
                          num_max(1, (int)lround(pinhole.h * down)));
    struct image out = {pinhole.w, pinhole.h, 3, NULL};
    out.px = malloc(3 * (size_t)out.w * (size_t)out.h * sizeof *out.px);
    if (!out.px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px of radiance", s->name, out.w,
                        out.h);
    err_t e = undistort_image(r->pool, &lens, io, &pinhole, out.px);
    exrfile_free(io);
    *io = out;
    return e;
}

static err_t measure_hdr(struct bench *b, const struct shot *s, const struct view *v)
{
    char path[FILE_PATH_CAP];
    struct image file, radiance = {b->draw.maps.w, b->draw.maps.h, 3, b->draw.maps.radiance};
    err_t e = radiance_path(b->test, s->name, path);
    if (e || !path[0])
        return e;
    e = exrfile_read(path, &file);
    if (e)
        return e;
    if (!v->lensed) // else it is looked at as taken
        e = undistort_truth(b->r, s, &file);
    if (!e)
        resize_image(&file, &b->other);
    exrfile_free(&file);
    hide_unseen(b, &b->other);
    if (!e)
        e = measure_stops(b, &radiance);
    if (!e)
        e = mu_law(&b->other, &b->other);
    if (!e) {
        memcpy(b->mu.px, radiance.px, 3 * (size_t)radiance.w * (size_t)radiance.h * sizeof(float));
        hide_unseen(b, &b->mu); // in both, or their brightest would be of other pixels
        e = mu_law(&b->mu, &b->mu);
    }
    struct evaluate_score one;
    if (!e)
        e = compare_picture(b, &b->mu, &b->other, &one);
    if (!e)
        add_score(&b->out->hdr, &one);
    return e;
}

/* ---- pictures ---- */

/* The maps drawn last, as the lens of the photograph takes them. */
static err_t take_maps(struct bench *b, const struct view *v)
{
    const struct draw_lens through = {&v->lens, &v->drawn, v->px, b->room, b->shown[0]};
    return v->lensed ? draw_through_lens(b->r->pool, &b->draw, &through) : OK;
}

static err_t draw_maps(struct bench *b, const struct view *v)
{
    err_t e = OK;
    if (b->j->scene.confidence) {
        e = draw_run(b->r, &b->draw, &b->confidence.splats, &v->drawn);
        if (!e)
            e = take_maps(b, v);
        if (!e)
            memcpy(b->confidence.map, b->draw.maps.radiance,
                   extent_pixels(&v->px) * sizeof *b->confidence.map);
    }
    if (!e)
        e = draw_run(b->r, &b->draw, &b->j->scene, &v->drawn);
    if (!e)
        e = take_maps(b, v);
    b->out->views++;
    job_result_lap(b->j, JOB_RENDER);
    return e;
}

/* Whether enough of a photograph counts to measure it. */
static bool choose_pixels(struct bench *b, const struct view *v)
{
    const int w = v->px.w, h = v->px.h, rim = METRICS_SSIM_TAPS / 2;
    bool any = false;
    b->seen = v->lensed ? b->shown[0] : NULL;
    if (!v->masked)
        return true;
    for (int i = 0; i < w * h; i++) {
        const int x = i % w, y = i / w;
        b->counts[i] = (!b->seen || b->seen[i]) && !v->masked[i];
        any = any || (b->counts[i] && x >= rim && y >= rim && x < w - rim && y < h - rim);
    }
    b->seen = b->counts;
    return any;
}

/* The radiance of a place, measured where its first photograph counts. */
static err_t keep_radiance(struct bench *b, const struct shot *s, const struct view *v, bool counts)
{
    char name[DRAW_NAME_CAP], path[FILE_PATH_CAP];
    size_t clipped = 0;
    err_t e = counts ? measure_hdr(b, s, v) : OK;
    job_result_lap(b->j, JOB_MEASURE);
    if (e || !b->o)
        return e;
    draw_name("hdr", s->name, "exr", name);
    e = outdir_path(b->o, name, path);
    if (!e)
        e = draw_write_exr(&b->draw, v->lensed ? NULL : &v->cam, v->log2t, path, &clipped);
    b->clipped += clipped;
    job_result_lap(b->j, JOB_WRITE);
    return e;
}

/* ---- photographs ---- */

/* Photographs through lenses that distort are looked at as they were taken, so that the pixels are
 * the same whatever lens was found; not those that are squeezed to squares. */
static bool is_lensed(const struct bench *b, const struct shot *s)
{
    return lens_distorts(&s->lens) && !job_result_size(&b->j->scene).square;
}

/* Its lens in px of the view, and what is drawn for it. */
static err_t set_lens(const struct shot *s, struct view *v)
{
    v->lens = s->lens;
    lens_scale(&v->lens, (double)v->px.w / s->taken_w, (double)v->px.h / s->taken_h);
    v->cam = s->cam;
    v->cam.w = v->px.w;
    v->cam.h = v->px.h;
    v->cam.fx = (float)v->lens.fx;
    v->cam.fy = (float)v->lens.fy;
    v->cam.cx = (float)v->lens.cx;
    v->cam.cy = (float)v->lens.cy;
    return draw_lens_camera(&v->lens, &v->cam, LENS_SIDES * num_max(v->px.w, v->px.h), &v->drawn);
}

/* out: rgb and masked in r->keep. */
static err_t read_view(struct bench *b, int i, struct view *out)
{
    const struct shot *s = &b->test->capture.shots[i];
    struct views v;
    *out = (struct view){.lensed = is_lensed(b, s)};
    if (!s->has_camera)
        return err_fail(ERR_ARG,
                        "%s: its camera is not known; eval needs the cameras of the test views",
                        s->name);
    err_t e = testview_read(b->r, b->test, i, out->lensed, job_result_size(&b->j->scene), &v);
    if (e)
        return e;
    out->px = v.extent[0];
    out->rgb = v.rgb;
    out->masked = v.masked;
    out->log2t = v.log2t[0];
    if (out->lensed)
        return set_lens(s, out);
    out->cam = out->drawn = v.cams[0];
    return OK;
}

/* Gives all pictures of this photograph its size. */
static void set_shape(struct bench *b, const struct extent *px)
{
    struct image *images[IMAGES] = {&b->truth, &b->other, &b->mu};
    for (int i = 0; i < IMAGES; i++) {
        images[i]->w = px->w;
        images[i]->h = px->h;
    }
}

static bool find_shade(const struct bench *b, const struct shot *s, const struct view *v,
                       struct shade *out)
{
    if (!v->lensed)
        return shading_of(b->j, s, &v->cam, out);
    if (!shading_model(b->j, s->camera_id, &out->model))
        return false;
    shade_map(NULL, v->px.w, v->px.h, &v->cam, out);
    return true;
}

static err_t do_shot(struct bench *b, int i)
{
    char name[DRAW_NAME_CAP], path[FILE_PATH_CAP];
    const struct shot *s = &b->test->capture.shots[i];
    const bool first = i == 0 || !name_same_view(s->name, b->test->capture.shots[i - 1].name);
    struct view v;
    struct shade shade;
    err_t e = read_view(b, i, &v);
    job_result_lap(b->j, JOB_PREPROCESS);
    if (!e)
        set_shape(b, &v.px);
    if (!e && first)
        e = draw_maps(b, &v);
    if (e)
        return e;
    const bool counts = choose_pixels(b, &v);
    if (first)
        e = keep_radiance(b, s, &v, counts);
    if (e)
        return e;
    draw_display(&b->draw, find_shade(b, s, &v, &shade) ? &shade : NULL, v.log2t);
    job_result_lap(b->j, JOB_RENDER);
    if (counts)
        e = measure_ldr(b, s, &v);
    else
        job_result_warn(b->j, "%s: its mask hides all of it: it is not measured", s->name);
    job_result_lap(b->j, JOB_MEASURE);
    if (e || !b->o)
        return e;
    draw_name("ldr", s->name, "png", name);
    e = outdir_path(b->o, name, path);
    if (!e)
        e = img_write_ldr(path, &b->draw.display);
    job_result_lap(b->j, JOB_WRITE);
    return e;
}

static err_t measure_shot(struct bench *b, int i)
{
    size_t keep = arena_mark(b->r->keep), tmp = arena_mark(b->r->tmp);
    if (atomic_load(b->r->cancel))
        return err_fail(ERR_CANCELLED, "eval: interrupted");
    err_t e = do_shot(b, i);
    arena_reset(b->r->keep, keep);
    arena_reset(b->r->tmp, tmp);
    return e;
}

/* ---- all ---- */

/* most: px of a photograph; drawn: of the picture that is drawn for it. */
static err_t layout(struct bench *b, struct arena *tmp, const struct extent *most,
                    const struct extent *drawn, int cap)
{
    const size_t values = 3 * most->at;
    struct image *images[IMAGES] = {&b->truth, &b->other, &b->mu};
    float *px;
    err_t e = draw_init(&b->draw, tmp, cap, drawn->w, drawn->h);
    if (!e)
        e = draw_confidence_init(&b->confidence, tmp, cap, drawn->w, drawn->h);
    if (!e)
        e = arena_alloc(tmp, values, IMAGES * sizeof *px, &px);
    for (int i = 0; i < IMAGES && !e; i++)
        *images[i] = (struct image){0, 0, 3, px + values * (size_t)i};
    if (!e)
        e = arena_alloc(tmp, most->at, 4 * sizeof *b->room, &b->room);
    for (int i = 0; i < 2 && !e; i++)
        e = arena_alloc(tmp, most->at, 1, &b->shown[i]);
    return e ? e : arena_alloc(tmp, most->at, 1, &b->counts);
}

static void cover_view(const struct extent *shape, struct extent *io)
{
    const struct extent both[2] = {*io, *shape};
    *io = extent_cover(both, 2);
    io->at = num_max_size(both[0].at, extent_pixels(&both[1]));
}

/* Shapes that a test picture may have as a view; returns their number. */
static int shapes_of(const struct shot *s, struct prep_size size, struct extent out[2])
{
    out[0] = prep_extent(size, s->image.w, s->image.h);
    if (!lens_distorts(&s->lens))
        return 1;
    out[1] = prep_extent(size, s->taken_w, s->taken_h);
    return 2;
}

err_t evaluate_check(const struct evaluate_pictures *p)
{
    struct evaluate_result seen = {0};
    struct evaluate_score *score;
    struct extent shape[2];
    err_t e = OK;
    for (int i = 0; i < p->test->n && !e; i++) {
        const struct shot *s = &p->test->shots[i];
        e = find_exposure(&seen, s->exposure, &score);
        for (int k = p->lpips ? shapes_of(s, p->size, shape) : 0; k > 0 && !e; k--)
            if (lpips_check(p->lpips, shape[k - 1].w, shape[k - 1].h) != OK)
                e = err_fail(ERR_ARG, "%s: %s", s->name, err_text());
    }
    return e;
}

/* Room for any of the test pictures as a view. */
static struct extent largest_view(const struct capture *test, struct prep_size size)
{
    struct extent out = {0, 0, 0}, shape[2];
    for (int i = 0; i < test->n; i++)
        for (int k = shapes_of(&test->shots[i], size, shape); k > 0; k--)
            cover_view(&shape[k - 1], &out);
    return out;
}

/* Of any of them; sizes of convolutions do not rise evenly with those of pictures. */
static void plan_lpips(struct plan *p, const struct evaluate_pictures *e)
{
    struct extent shape[2], last = {0, 0, 0};
    for (int i = 0; i < e->test->n; i++)
        for (int k = shapes_of(&e->test->shots[i], e->size, shape); k > 0; k--) {
            if (shape[k - 1].w != last.w || shape[k - 1].h != last.h)
                lpips_plan(p, e->lpips, shape[k - 1].w, shape[k - 1].h);
            last = shape[k - 1];
        }
}

/* The same for what is drawn for them; of lenses that are yet to be found nothing is known. Where
 * there are lenses *most holds any input view, too. */
static struct extent largest_drawn(const struct capture *test, struct prep_size size,
                                   struct extent *most)
{
    bool lensed = false;
    for (int i = 0; i < test->n; i++)
        lensed = lensed || lens_distorts(&test->shots[i].lens) ||
                 !(size.square || test->shots[i].has_camera);
    const int side = num_min(LENS_SIDES * num_max(most->w, most->h), RASTER_SIDE_MAX);
    if (!lensed)
        return *most;
    most->at = (size_t)size.edge * (size_t)size.edge;
    return (struct extent){side, side, 0};
}

void evaluate_plan(struct plan *p, const struct evaluate_pictures *e, int cap)
{
    const struct capture *test = e->test;
    const struct prep_size size = e->size;
    const size_t keep = arena_mark(&p->keep), tmp = arena_mark(&p->tmp);
    struct extent most = largest_view(test, size);
    const struct extent drawn = largest_drawn(test, size, &most);
    struct arena planes = arena_counter();
    struct gaussians g;
    struct bench b;
    struct evaluate_picture *pictures;
    if (gaussians_init(&g, &planes, cap, 0) || layout(&b, &p->tmp, &most, &drawn, g.cap) ||
        arena_alloc(&p->keep, (size_t)test->n, sizeof *pictures, &pictures))
        plan_refuse(p);
    testview_plan(p, test, most.at, size.edge);
    arena_step(&p->tmp, metrics_ssim_plan(most.w));
    if (e->lpips)
        plan_lpips(p, e);
    arena_reset(&p->keep, keep);
    arena_reset(&p->tmp, tmp);
}

err_t evaluate_run(const struct run *r, struct job_result *j, const struct evaluate_job *what,
                   struct evaluate_result *out)
{
    const struct imageset *test = what->test;
    struct outdir *o = what->o;
    struct bench b = {.r = r,
                      .j = j,
                      .test = test,
                      .inputs = what->inputs,
                      .lpips = what->lpips,
                      .o = o,
                      .out = out};
    const int n = test->capture.n;
    size_t mark = arena_mark(r->tmp);
    memset(out, 0, sizeof *out);
    const struct prep_size size = job_result_size(&j->scene);
    struct extent most = largest_view(&test->capture, size);
    const struct extent drawn = largest_drawn(&test->capture, size, &most);
    err_t e = layout(&b, r->tmp, &most, &drawn, j->scene.g.cap);
    if (!e)
        e = arena_alloc(r->keep, (size_t)n, sizeof *out->pictures, &out->pictures);
    if (!e && j->scene.confidence)
        draw_confidence_set(&b.confidence, &j->scene);
    if (!e && o)
        e = outdir_mkdir(o, "ldr");
    if (!e && o)
        e = outdir_mkdir(o, "hdr");
    for (int i = 0; i < n && !e; i++) {
        e = measure_shot(&b, i);
        if (!e && r->progress)
            r->progress(r->progress_ctx, "evaluate", i + 1, n, NULL);
    }
    arena_reset(r->tmp, mark);
    if (!e && out->n_pictures == 0)
        e = err_fail(ERR_ARG, "masks hide all of every test photograph: what is black in a mask "
                              "does not count, white does");
    if (b.clipped)
        job_result_warn(
            j, "%zu values of the EXR files are above the largest half float and stored as 65504",
            b.clipped);
    return e;
}
