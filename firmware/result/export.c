#include "firmware/result/export.h"

#include "core/splat/display.h"
#include "drivers/format/colmapwrite.h"
#include "drivers/format/img.h"
#include "drivers/format/json.h"
#include "drivers/format/transforms.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char points_name[] = "points.ply";

/* ---- points ---- */

static bool is_confident(const struct gaussians *g, int i)
{
    return g->plane[G_LOGIT][i] > 0;
}

static void take_point(const struct scene *s, int i, float ev, struct colmap_point *out)
{
    const struct gaussians *g = &s->g;
    float log_sh[3], shown[3];
    for (int c = 0; c < 3; c++) {
        out->xyz[c] = g->plane[G_MU + c][i];
        log_sh[c] = g->plane[G_SH + c][i];
    }
    display_from_radiance(log_sh, 0, ev, shown);
    for (int c = 0; c < 3; c++) {
        const float v = 0.5f + (float)SH_BASIS0 * shown[c];
        out->rgb[c] = (uint8_t)(255 * fminf(fmaxf(v, 0), 1) + 0.5f);
    }
}

err_t export_points(const struct scene *s, struct colmap_points *out)
{
    const float ev = display_ev(&s->tone);
    int n = 0, seen = 0;
    *out = (struct colmap_points){0};
    for (int i = 0; i < s->g.n; i++)
        n += is_confident(&s->g, i);
    const int keep = n < EXPORT_POINTS_MAX ? n : EXPORT_POINTS_MAX;
    out->p = calloc((size_t)keep + 1, sizeof *out->p);
    if (!out->p)
        return err_fail(ERR_NOMEM, "no memory for %d points", keep);
    for (int i = 0; i < s->g.n; i++) // point k is confident splat k n / keep
        if (is_confident(&s->g, i) && (int64_t)seen++ * keep >= (int64_t)out->n * n)
            take_point(s, i, ev, &out->p[out->n++]);
    return OK;
}

/* ---- photographs ---- */

struct pictures {
    const struct run *run;
    const struct imageset *set; // as they are decoded
    const struct outdir *o;
    const struct rig *rig; // their names in the folder
};

static err_t write_picture(void *ctx, int i, int worker)
{
    const struct pictures *p = ctx;
    char name[NAME_CAP + 8], path[FILE_PATH_CAP];
    struct image8 im;
    void *bytes = NULL;
    size_t n;
    FILE *f;
    (void)worker;
    snprintf(name, sizeof name, "images/%s", p->rig->views[i].name);
    err_t e = run_check(p->run, "export");
    if (!e)
        e = outdir_path(p->o, name, path);
    if (!e)
        e = imageset_decode(p->set, i, &im);
    if (e)
        return e;
    e = img_encode_png_fast(&im, path, &bytes, &n);
    img_free(&im);
    if (!e)
        e = file_create(path, &f);
    if (!e) {
        fwrite(bytes, 1, n, f); // file_finish asks whether it worked
        e = file_finish(f, path);
    }
    free(bytes);
    return e;
}

size_t export_plan(const struct imageset *set, int threads)
{
    return 2 * imageset_bytes(&set->capture, threads); // and as PNG
}

/* ---- cameras ---- */

/* The name of a photograph's PNG. */
static err_t png_name(const char *name, char out[NAME_CAP])
{
    const char *dot = strrchr(name, '.');
    const int n = dot && dot != name ? (int)(dot - name) : (int)strlen(name);
    if (n + 5 > NAME_CAP)
        return err_fail(ERR_ARG, "%s: the name is too long for a .png at its end", name);
    snprintf(out, NAME_CAP, "%.*s.png", n, name);
    return OK;
}

static void take_camera(const struct shot *s, bool photographed, struct rig_view *v)
{
    v->cam = s->cam;
    v->has_exposure = s->exposure > 0;
    v->exposure_log2 = v->has_exposure ? (float)log2(s->exposure) : 0;
    if (!photographed || !lens_distorts(&s->lens))
        return;
    v->photograph.w = s->taken_w;
    v->photograph.h = s->taken_h;
    v->photograph.lens = s->lens;
}

/* own: cameras_free. */
static err_t make_rig(const struct capture *c, bool photographed, struct rig *out)
{
    *out = (struct rig){.views = calloc((size_t)c->n, sizeof *out->views)};
    if (!out->views)
        return err_fail(ERR_NOMEM, "no memory for %d cameras", c->n);
    err_t e = OK;
    for (int i = 0; i < c->n && !e; i++) {
        struct rig_view *v = &out->views[out->n++];
        take_camera(&c->shots[i], photographed, v);
        e = png_name(c->shots[i].name, v->name);
        for (int k = 0; k < i && !e; k++)
            if (strcmp(out->views[k].name, v->name) == 0)
                e = err_fail(ERR_ARG, "%s and %s would both be written as %s: rename one",
                             c->shots[k].name, c->shots[i].name, v->name);
    }
    cameras_use_photographs(out);
    if (e)
        cameras_free(out);
    return e;
}

/* Nothing if some exposure is not known. */
static err_t write_exposures(const struct capture *c, const struct rig *rig, const struct outdir *o)
{
    char path[FILE_PATH_CAP];
    FILE *f;
    for (int i = 0; i < c->n; i++)
        if (!(c->shots[i].exposure > 0))
            return OK;
    err_t e = outdir_path(o, "exposure.json", path);
    if (!e)
        e = file_create(path, &f);
    if (e)
        return e;
    for (int i = 0; i < c->n; i++) {
        fputs(i ? ",\n " : "{", f);
        json_put_string(f, rig->views[i].name);
        fprintf(f, ": %.17g", c->shots[i].exposure);
    }
    fputs("}\n", f);
    return file_finish(f, path);
}

static err_t write_model(const struct export_request *rq, const struct rig *rig,
                         const struct colmap_points *points, struct outdir *o)
{
    char path[FILE_PATH_CAP];
    if (rq->transforms) {
        err_t e = outdir_path(o, rq->transforms, path);
        if (!e)
            e = transforms_write(path, rig, points_name);
        if (!e)
            e = outdir_path(o, points_name, path);
        return e ? e : transforms_write_points(path, points);
    }
    err_t e = outdir_mkdir(o, "sparse");
    if (!e)
        e = outdir_mkdir(o, "sparse/0");
    if (!e)
        e = outdir_path(o, "sparse/0", path);
    return e ? e : colmapwrite_run(path, true, rig, points);
}

/* ---- all ---- */

static err_t write_all(const struct run *r, const struct export_request *rq, const struct rig *rig,
                       const struct colmap_points *points, struct outdir *o)
{
    struct imageset set = *rq->set;
    struct shot *shots = malloc((size_t)set.capture.n * sizeof *shots);
    if (!shots)
        return err_fail(ERR_NOMEM, "no memory for %d photographs", set.capture.n);
    memcpy(shots, set.capture.shots, (size_t)set.capture.n * sizeof *shots);
    set.capture.shots = shots;
    for (int i = 0; i < set.capture.n && rq->photographed; i++)
        shots[i].lens = (struct lens){0}; // then imageset_decode leaves it as taken
    struct pictures pictures = {r, &set, o, rig};
    err_t e = write_model(rq, rig, points, o);
    if (!e)
        e = write_exposures(&set.capture, rig, o);
    if (!e)
        e = outdir_mkdir(o, "images");
    if (!e)
        e = pool_for(r->pool, set.capture.n, write_picture, &pictures);
    free(shots);
    return e;
}

err_t export_run(const struct run *r, const struct export_request *rq, struct outdir *o,
                 struct export_result *out)
{
    struct colmap_points points = {0};
    struct rig rig;
    err_t e = make_rig(&rq->set->capture, rq->photographed, &rig);
    if (!e)
        e = export_points(rq->scene, &points);
    if (!e)
        e = write_all(r, rq, &rig, &points, o);
    *out = (struct export_result){rig.n, points.n};
    colmap_free_points(&points);
    cameras_free(&rig);
    return outdir_reason(o, e);
}
