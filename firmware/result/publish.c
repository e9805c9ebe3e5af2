#include "firmware/result/publish.h"

#include "firmware/recon/figures.h"
#include "firmware/recon/lenses.h"
#include "firmware/recon/stored.h"
#include "firmware/result/draw.h"
#include "firmware/result/report_page.h"
#include "firmware/result/viewer.h"

#include "core/base/gaussians.h"
#include "core/photo/metrics.h"
#include "core/photo/prep.h"
#include "drivers/format/cameras.h"
#include "drivers/format/img.h"
#include "drivers/format/ply.h"
#include "drivers/format/scenefile.h"
#include "drivers/format/sidecar.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char VIEWER_NAME[] = "view.html";

static struct viewer_input viewer_of(const struct job_result *j, const struct outdir *o)
{
    return (struct viewer_input){.scene = &j->scene,
                                 .photos = j->views.n > 0 ? &j->views : NULL,
                                 .title = file_name(o->path),
                                 .report = REPORT_PAGE_NAME};
}

/* Upper bound of the folder: pictures as if they could not be compressed. */
static uint64_t result_bytes(const struct viewer_input *viewer, int n_photographs)
{
    const struct scene *s = viewer->scene;
    uint64_t n = (uint64_t)s->g.n, planes = (uint64_t)gaussians_planes(s->g.degree);
    uint64_t pixels = (uint64_t)s->size * (uint64_t)s->size, views = (uint64_t)s->n_views;
    uint64_t ply = n * (14 * 4 + 6 * (planes - G_SH)), whole = n * planes * 4;
    uint64_t pictures = views * pixels * (4 * 2 + 3);
    return ply + whole + pictures + pictures / 64 + views * 4096 + (1 << 20) +
           report_page_bytes(n_photographs) + viewer_bytes(viewer);
}

/* Two photographs that differ only in their extension. */
static err_t check_names(const struct capture *c)
{
    char a[DRAW_NAME_CAP], b[DRAW_NAME_CAP];
    for (int i = 0; i < c->n; i++) {
        draw_name("ldr", c->shots[i].name, "png", a);
        for (int k = 0; k < i; k++) {
            const char *other = c->shots[k].name;
            if (strncmp(a + 4, other, strcspn(other, ".")) != 0)
                continue;
            draw_name("ldr", other, "png", b);
            if (strcmp(a, b) == 0)
                return err_fail(ERR_ARG, "%s and %s would both be written as %s: rename one", other,
                                c->shots[i].name, a);
        }
    }
    return OK;
}

err_t publish_check(const struct capture *c, const struct job_config *cfg, struct outdir *o)
{
    const struct recipe recipe = recipe_choose(c, cfg, false);
    const struct scene most = {.g = {.n = recipe.gaussians_max, .degree = recipe.degree_max},
                               .n_views = recipe.places,
                               .size = cfg->size};
    const struct views photos = {.n = recipe.places, .n_more = c->n - recipe.places};
    const struct viewer_input viewer = {
        .scene = &most, .photos = &photos, .title = file_name(o->path)};
    err_t e = check_names(c);
    return e ? e : outdir_reserve(o, result_bytes(&viewer, c->n));
}

/* Mean of the squares of the errors of the view drawn last against its photograph i, 0..1 per
 * value, where it is not masked; NAN if all is. */
static double mean_square(const struct image *display, const struct views *v, int i)
{
    const size_t pixels = (size_t)display->w * (size_t)display->h;
    const uint8_t *rgb = views_rgb(v, i);
    double sum = 0;
    size_t n = 0;
    for (size_t c = 0; c < 3; c++)
        for (size_t k = 0; k < pixels; k++) {
            double d = display->px[c * pixels + k] - rgb[3 * k + c] / 255.0;
            const bool counts = !views_hides(v, i, k);
            sum += counts ? d * d : 0;
            n += counts;
        }
    return n ? sum / (double)n : NAN;
}

struct pictures {
    const struct run *r;
    struct job_result *j;
    struct outdir *o;
    struct report_page *sheet;
    struct draw draw;
    size_t clipped;                         // values above the largest half
    double psnr;                            // sum over those that are not masked all over
    int measured;                           // number of these
    struct draw_confidence confidence;      // of the view drawn last
    uint8_t *left_out;                      // of the photograph compared last
    double pixels, confidence_sum, guesses; // of all views
};

/* Photograph i of a place beside what was drawn last, which stays in draw.display. */
static err_t compare_photograph(struct pictures *p, int place, int i)
{
    const struct views *v = &p->j->views;
    const struct extent *px = &v->extent[i];
    const struct image8 photograph = {px->w, px->h, 3, views_rgb(v, i)};
    draw_display(&p->draw, v->shade ? &v->shade[place] : NULL, v->log2t[i]);
    const double mse = mean_square(&p->draw.display, v, i);
    p->j->input_db[i] = NAN;
    if (!isnan(mse)) {
        const double psnr = fmin(-10 * log10(mse), METRICS_PSNR_MAX);
        p->psnr += psnr;
        p->measured++;
        p->j->input_db[i] = (float)psnr;
    }
    job_result_left_out(p->j, i, p->left_out);
    const struct report_page_drawing drawing = {&p->draw.display, p->confidence.map, p->left_out};
    return report_page_picture(p->sheet, i, &photograph, &drawing);
}

/* The confidence of the pixels of view i. */
static err_t draw_confidence(struct pictures *p, int i)
{
    const struct camera *cam = &p->j->scene.cams[i];
    const size_t px = (size_t)cam->w * (size_t)cam->h;
    const float *map = p->confidence.map;
    err_t e = draw_confidence_run(p->r, &p->draw, &p->confidence, cam);
    if (e)
        return e;
    for (size_t k = 0; k < px; k++) {
        p->confidence_sum += (double)map[k];
        p->guesses += map[k] < CONFIDENCE_GUESS;
    }
    p->pixels += (double)px;
    return OK;
}

static err_t write_view(struct pictures *p, int i)
{
    const struct scene *s = &p->j->scene;
    const struct views *v = &p->j->views;
    char name[DRAW_NAME_CAP], path[FILE_PATH_CAP];
    size_t clipped = 0;
    err_t e = draw_confidence(p, i);
    if (!e)
        e = draw_run(p->r, &p->draw, s, &s->cams[i]);
    for (int k = views_next(v, i, i); k >= 0 && !e; k = views_next(v, i, k))
        e = compare_photograph(p, i, k);
    if (!e)
        e = compare_photograph(p, i, i); // the one whose exposure is written
    job_result_lap(p->j, JOB_RENDER);
    draw_name("ldr", s->names[i], "png", name);
    if (!e)
        e = outdir_path(p->o, name, path);
    if (!e)
        e = img_write_ldr(path, &p->draw.display);
    draw_name("hdr", s->names[i], "exr", name);
    if (!e)
        e = outdir_path(p->o, name, path);
    if (!e)
        e = draw_write_exr(&p->draw, &s->cams[i], s->log2t[i], path, &clipped);
    p->clipped += clipped;
    job_result_lap(p->j, JOB_WRITE);
    return e;
}

static err_t write_views(const struct run *r, struct job_result *j, struct outdir *o,
                         struct report_page *sheet)
{
    struct pictures p = {.r = r, .j = j, .o = o, .sheet = sheet};
    const struct scene *s = &j->scene;
    size_t mark = arena_mark(r->tmp);
    const struct extent most = draw_cover(s);
    err_t e = draw_init(&p.draw, r->tmp, s->g.cap, most.w, most.h);
    if (!e)
        e = draw_confidence_init(&p.confidence, r->tmp, s->g.cap, most.w, most.h);
    if (!e)
        e = arena_alloc(r->tmp, (size_t)most.w * (size_t)most.h, 1, &p.left_out);
    if (!e)
        draw_confidence_set(&p.confidence, s);
    for (int i = 0; i < s->n_views && !e; i++) {
        e = write_view(&p, i);
        if (!e && r->progress)
            r->progress(r->progress_ctx, "write", i + 1, s->n_views, NULL);
    }
    arena_reset(r->tmp, mark);
    j->input_psnr = p.measured ? p.psnr / p.measured : NAN;
    j->confidence_mean = p.confidence_sum / p.pixels;
    j->guesses = p.guesses / p.pixels;
    if (p.clipped)
        job_result_warn(
            j,
            "%zu values of the EXR files are above the largest half float and stored as 65504; "
            "scene.hdrig has them whole",
            p.clipped);
    return e;
}

/* The physical camera of view `v`, and where it was undistorted, how its photograph was taken. */
static void add_photograph(const struct job_result *j, struct rig_view *v)
{
    const struct capture *c = j->capture;
    const struct shot *s = NULL;
    for (int i = 0; c && i < c->n && !s; i++)
        s = strcmp(c->shots[i].name, v->name) == 0 ? &c->shots[i] : NULL;
    struct lens lens;
    bool resampled;
    if (!s)
        return;
    stored_put(j, s, v);
    if (!lenses_find(j, s, &lens, &resampled) || !resampled)
        lens = s->lens;
    if (!lens_distorts(&lens))
        return;
    v->photograph.w = s->taken_w;
    v->photograph.h = s->taken_h;
    v->photograph.lens = lens;
}

static err_t write_cameras(const struct job_result *j, const char *path)
{
    const struct scene *s = &j->scene;
    struct rig rig = {.n = s->n_views,
                      .views = calloc((size_t)s->n_views, sizeof *rig.views),
                      .metres = s->metres};
    if (!rig.views)
        return err_fail(ERR_NOMEM, "%s: no memory for %d cameras", path, s->n_views);
    for (int i = 0; i < s->n_views; i++) {
        struct rig_view *v = &rig.views[i];
        memcpy(v->name, s->names[i], NAME_CAP);
        v->cam = s->cams[i];
        v->has_exposure = true;
        v->exposure_log2 = s->log2t[i];
        add_photograph(j, v);
    }
    err_t e = cameras_write(path, &rig);
    cameras_free(&rig);
    return e;
}

static err_t write_scene(const struct job_result *j, const struct outdir *o)
{
    const struct scene *s = &j->scene;
    char path[FILE_PATH_CAP];
    err_t e = outdir_path(o, "scene.ply", path);
    if (!e)
        e = ply_write(path, s);
    if (!e)
        e = sidecar_write(path, s);
    if (!e)
        e = outdir_path(o, "scene.hdrig", path);
    if (!e)
        e = scenefile_write(path, s);
    if (!e)
        e = outdir_path(o, "tone.json", path);
    if (!e)
        e = scenefile_write_tone(path, &s->tone);
    if (!e)
        e = outdir_path(o, "cameras.json", path);
    return e ? e : write_cameras(j, path);
}

static bool has_viewer(const struct job_result *j)
{
    return j->scene.g.n <= VIEWER_SPLATS_MAX;
}

static err_t write_viewer(struct job_result *j, const struct outdir *o)
{
    char path[FILE_PATH_CAP];
    struct viewer_input viewer = viewer_of(j, o);
    if (!has_viewer(j)) {
        job_result_warn(j, "no view.html: %d splats are more than a page can hold", j->scene.g.n);
        return OK;
    }
    err_t e = outdir_path(o, VIEWER_NAME, path);
    return e ? e : viewer_write(path, &viewer);
}

static void report_times(const struct job_result *j, int threads, struct report *rep)
{
    job_report(j, threads, rep);
    report_text(rep, "viewer", has_viewer(j) ? VIEWER_NAME : NULL);
}

/* report.json, and with it the end of the page. */
static err_t write_report(const struct job_result *j, int threads, const struct outdir *o,
                          struct report_page *sheet)
{
    char path[FILE_PATH_CAP];
    struct report rep;
    err_t e = outdir_path(o, OUTDIR_REPORT, path);
    if (!e)
        e = outdir_report_open(o, &rep);
    if (e)
        return e;
    report_times(j, threads, &rep);
    e = outdir_report_close(o, &rep);
    return e ? e : report_page_close(sheet, path);
}

static err_t open_sheet(const struct outdir *o, struct report_page *sheet)
{
    char path[FILE_PATH_CAP];
    err_t e = outdir_path(o, REPORT_PAGE_NAME, path);
    return e ? e : report_page_open(path, sheet);
}

err_t publish_run(const struct run *r, struct job_result *j, struct outdir *o)
{
    const struct viewer_input viewer = viewer_of(j, o);
    struct report_page sheet = {0};
    err_t e = outdir_reserve(o, result_bytes(&viewer, j->views.n + j->views.n_more));
    if (!e)
        e = outdir_mkdir(o, "ldr");
    if (!e)
        e = outdir_mkdir(o, "hdr");
    if (!e)
        e = open_sheet(o, &sheet);
    if (!e)
        e = write_views(r, j, o, &sheet);
    if (!e)
        e = write_scene(j, o);
    if (!e)
        e = write_viewer(j, o);
    job_result_lap(j, JOB_WRITE);
    if (!e) {
        figures_warn(j);
        e = write_report(j, pool_size(r->pool), o, &sheet);
    }
    report_page_discard(&sheet);
    e = outdir_reason(o, e);
    if (!e && atomic_load(r->cancel))
        return ERR_CANCELLED;
    return e ? e : outdir_commit(o);
}

void publish_report(const struct job_result *j, int threads, FILE *f)
{
    struct report rep;
    report_begin(&rep, f);
    report_times(j, threads, &rep);
    report_close(&rep);
}
