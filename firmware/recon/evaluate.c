#include "firmware/recon/evaluate.h"

#include "firmware/recon/shading.h"

#include "core/refine/confidence.h"
#include "core/splat/path.h"
#include "firmware/result/draw.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
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

struct bench {
    const struct run *r;
    struct job_result *j;
    const struct imageset *test;
    struct outdir *o;
    struct draw draw;
    struct image truth,
        other;       // (3, h, w): the photograph; nearest view or mu-law of the truth
    struct image mu; // (3, h, w): mu-law of the prediction
    struct draw_confidence confidence; // of the view drawn last
    size_t clipped;
    struct evaluate_result *out;
};

enum { IMAGES = 3 };

static void add_score(struct evaluate_score *s, double psnr, double ssim)
{
    s->n++;
    s->psnr += (psnr - s->psnr) / s->n;
    s->ssim += (ssim - s->ssim) / s->n;
}

static err_t compare_picture(struct bench *b, const struct image *picture,
                             const struct image *truth, struct evaluate_score *score)
{
    double psnr, ssim;
    err_t e = metrics_psnr(picture, truth, &psnr);
    if (!e)
        e = metrics_ssim(picture, truth, b->r->tmp, &ssim);
    if (!e)
        add_score(score, psnr, ssim);
    return e;
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

err_t evaluate_check(const struct capture *test)
{
    struct evaluate_result seen = {0};
    struct evaluate_score *score;
    err_t e = OK;
    for (int i = 0; i < test->n && !e; i++)
        e = find_exposure(&seen, test->shots[i].exposure, &score);
    return e;
}

static void add_trust(const struct bench *b, struct evaluate_trust *t)
{
    const size_t pixels = (size_t)b->truth.w * (size_t)b->truth.h;
    for (size_t i = 0; i < 3 * pixels; i++) {
        const double d = (double)b->draw.display.px[i] - (double)b->truth.px[i];
        const int known = b->confidence.map[i % pixels] >= CONFIDENCE_GUESS;
        t->pixels[known] += 1.0 / 3;
        t->squares[known] += d * d / 3;
    }
}

static err_t measure_ldr(struct bench *b, const struct shot *s, const struct views *v)
{
    struct evaluate_score *score = NULL;
    err_t e = find_exposure(b->out, s->exposure, &score);
    if (e)
        return e;
    int before = score->n;
    double psnr = score->psnr, ssim = score->ssim;
    to_planar(v->rgb, &b->truth);
    if (b->j->scene.confidence)
        add_trust(b, &b->out->trust);
    e = compare_picture(b, &b->draw.display, &b->truth, score);
    if (!e) // the same figures go into the mean over all
        add_score(&b->out->ldr, psnr + (score->psnr - psnr) * (before + 1),
                  ssim + (score->ssim - ssim) * (before + 1));
    const struct views *inputs = &b->j->views;
    const int near = inputs->n > 0 ? path_nearest(inputs->cams, inputs->n, &v->cams[0]) : -1;
    if (e || near < 0 || inputs->extent[near].w != v->extent[0].w ||
        inputs->extent[near].h != v->extent[0].h)
        return e;
    reexpose_picture(b, near, v->log2t[0]);
    return compare_picture(b, &b->other, &b->truth, &b->out->nearest);
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

static err_t mu_law(const struct image *in, struct image *out)
{
    double q;
    err_t e = metrics_quantile(in->px, 3 * (size_t)in->w * (size_t)in->h, 0.99, &q);
    return e ? e : metrics_mu_law(in, q, out);
}

/* A map of radiance goes through the lens as its photograph did. */
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

static err_t measure_hdr(struct bench *b, const struct shot *s)
{
    char path[FILE_PATH_CAP];
    struct image file, radiance = {b->draw.maps.w, b->draw.maps.h, 3, b->draw.maps.radiance};
    err_t e = radiance_path(b->test, s->name, path);
    if (e || !path[0])
        return e;
    e = exrfile_read(path, &file);
    if (e)
        return e;
    e = undistort_truth(b->r, s, &file);
    if (!e)
        resize_image(&file, &b->other);
    exrfile_free(&file);
    if (!e)
        e = mu_law(&b->other, &b->other);
    if (!e)
        e = mu_law(&radiance, &b->mu);
    return e ? e : compare_picture(b, &b->mu, &b->other, &b->out->hdr);
}

/* ---- all ---- */

static err_t draw_view(struct bench *b, const struct shot *s, const struct views *v)
{
    char name[DRAW_NAME_CAP], path[FILE_PATH_CAP];
    size_t clipped = 0;
    b->out->views++;
    err_t e = OK;
    if (b->j->scene.confidence)
        e = draw_confidence_run(b->r, &b->draw, &b->confidence, &v->cams[0]);
    if (!e)
        e = draw_run(b->r, &b->draw, &b->j->scene, &v->cams[0]);
    job_result_lap(b->j, JOB_RENDER);
    if (!e)
        e = measure_hdr(b, s);
    job_result_lap(b->j, JOB_MEASURE);
    if (e || !b->o)
        return e;
    draw_name("hdr", s->name, "exr", name);
    e = outdir_path(b->o, name, path);
    if (!e)
        e = draw_write_exr(&b->draw, &v->cams[0], v->log2t[0], path, &clipped);
    b->clipped += clipped;
    job_result_lap(b->j, JOB_WRITE);
    return e;
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

static err_t do_shot(struct bench *b, int i, const struct shot *s)
{
    char name[DRAW_NAME_CAP], path[FILE_PATH_CAP];
    struct views v;
    struct shade shade;
    struct capture one = {1, (struct shot *)(uintptr_t)s};
    err_t e = prep_run(b->r, &one, job_result_size(&b->j->scene), &v);
    job_result_lap(b->j, JOB_PREPROCESS);
    if (!e)
        set_shape(b, v.extent);
    if (!e && !v.cams)
        e = err_fail(ERR_ARG,
                     "%s: its camera is not known; eval needs the cameras of the test views",
                     s->name);
    if (!e && (i == 0 || !name_same_view(s->name, b->test->capture.shots[i - 1].name)))
        e = draw_view(b, s, &v);
    if (e)
        return e;
    draw_display(&b->draw, shading_of(b->j, s, &v.cams[0], &shade) ? &shade : NULL, v.log2t[0]);
    job_result_lap(b->j, JOB_RENDER);
    e = measure_ldr(b, s, &v);
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

static err_t read_and_do(struct bench *b, int i)
{
    struct shot s = b->test->capture.shots[i];
    size_t keep = arena_mark(b->r->keep), tmp = arena_mark(b->r->tmp);
    if (atomic_load(b->r->cancel))
        return err_fail(ERR_CANCELLED, "eval: interrupted");
    err_t e = imageset_decode(b->test, i, &s.image);
    if (!e)
        e = do_shot(b, i, &s);
    img_free(&s.image);
    arena_reset(b->r->keep, keep);
    arena_reset(b->r->tmp, tmp);
    return e;
}

static err_t layout(struct bench *b, struct arena *tmp, const struct extent *most, int cap)
{
    const size_t values = 3 * most->at;
    struct image *images[IMAGES] = {&b->truth, &b->other, &b->mu};
    float *px;
    err_t e = draw_init(&b->draw, tmp, cap, most->w, most->h);
    if (!e)
        e = draw_confidence_init(&b->confidence, tmp, cap, most->w, most->h);
    if (!e)
        e = arena_alloc(tmp, values, IMAGES * sizeof *px, &px);
    for (int i = 0; i < IMAGES && !e; i++)
        *images[i] = (struct image){0, 0, 3, px + values * (size_t)i};
    return e;
}

/* Room for any of the test pictures as a view. */
static struct extent largest_view(const struct capture *test, struct prep_size size)
{
    struct extent both[2] = {{0, 0, 0}, {0, 0, 0}};
    for (int i = 0; i < test->n; i++) {
        both[1] = prep_extent(size, test->shots[i].image.w, test->shots[i].image.h);
        const size_t pixels = num_max_size(both[0].at, extent_pixels(&both[1]));
        both[0] = extent_cover(both, 2);
        both[0].at = pixels;
    }
    return both[0];
}

void evaluate_plan(struct plan *p, const struct capture *test, struct prep_size size, int cap)
{
    const size_t keep = arena_mark(&p->keep), tmp = arena_mark(&p->tmp);
    const struct extent most = largest_view(test, size);
    struct arena planes = arena_counter();
    struct gaussians g;
    struct bench b;
    if (gaussians_init(&g, &planes, cap, 0) || layout(&b, &p->tmp, &most, g.cap))
        plan_refuse(p);
    prep_plan(p, 1, most.at, prep_largest(test), size.edge);
    arena_step(&p->tmp, metrics_ssim_plan(most.w));
    arena_reset(&p->keep, keep);
    arena_reset(&p->tmp, tmp);
}

err_t evaluate_run(const struct run *r, struct job_result *j, const struct imageset *test,
                   struct outdir *o, struct evaluate_result *out)
{
    struct bench b = {.r = r, .j = j, .test = test, .o = o, .out = out};
    const int n = test->capture.n;
    size_t mark = arena_mark(r->tmp);
    memset(out, 0, sizeof *out);
    const struct extent most = largest_view(&test->capture, job_result_size(&j->scene));
    err_t e = layout(&b, r->tmp, &most, j->scene.g.cap);
    if (!e && j->scene.confidence)
        draw_confidence_set(&b.confidence, &j->scene);
    if (!e && o)
        e = outdir_mkdir(o, "ldr");
    if (!e && o)
        e = outdir_mkdir(o, "hdr");
    for (int i = 0; i < n && !e; i++) {
        e = read_and_do(&b, i);
        if (!e && r->progress)
            r->progress(r->progress_ctx, "evaluate", i + 1, n, NULL);
    }
    arena_reset(r->tmp, mark);
    if (b.clipped)
        job_result_warn(
            j, "%zu values of the EXR files are above the largest half float and stored as 65504",
            b.clipped);
    return e;
}
