/* Both formats have the same values in the same order: one emitter, which puts numbers as bytes or
 * as words of a line. */
#include "drivers/format/colmapwrite.h"

#include "core/base/bytes.h"
#include "drivers/format/file.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

#define ERROR_UNKNOWN (-1.0) // of a point: COLMAP's value for that

struct sink {
    FILE *f;
    bool binary;
    char path[FILE_PATH_CAP];
};

static err_t sink_open(const char *dir, const char *stem, bool binary, struct sink *s)
{
    char name[32];
    s->binary = binary;
    snprintf(name, sizeof name, "%s.%s", stem, binary ? "bin" : "txt");
    err_t e = file_join(dir, name, s->path);
    return e ? e : file_create(s->path, &s->f);
}

/* A whole number of this many bytes, or a word. */
static void put_whole(struct sink *s, uint64_t v, size_t bytes)
{
    uint8_t raw[8];
    bytes_put_u64(raw, v);
    if (s->binary)
        fwrite(raw, 1, bytes, s->f);
    else
        fprintf(s->f, "%" PRIu64 " ", v);
}

static void put_number(struct sink *s, double v)
{
    uint64_t bits;
    memcpy(&bits, &v, sizeof bits);
    if (s->binary)
        put_whole(s, bits, sizeof bits);
    else
        fprintf(s->f, "%.17g ", v);
}

/* The count, which only the binary format has. */
static void put_count(struct sink *s, uint64_t n)
{
    if (s->binary)
        put_whole(s, n, 8);
}

static void put_text(struct sink *s, const char *text)
{
    if (!s->binary)
        fputs(text, s->f);
}

/* ---- cameras ---- */

/* The lens that is written for a view: its own, or the pinhole that its camera is. */
static struct lens lens_of(const struct rig_view *v)
{
    if (lens_distorts(&v->lens))
        return v->lens;
    return (struct lens){.model = LENS_PINHOLE,
                         .fx = (double)v->cam.fx,
                         .fy = (double)v->cam.fy,
                         .cx = (double)v->cam.cx,
                         .cy = (double)v->cam.cy};
}

static bool same_camera(const struct rig_view *a, const struct rig_view *b)
{
    const struct lens x = lens_of(a), y = lens_of(b);
    double px[LENS_PARAMS], py[LENS_PARAMS];
    const size_t n = (size_t)lens_params(&x, px);
    (void)lens_params(&y, py);
    return x.model == y.model && a->cam.w == b->cam.w && a->cam.h == b->cam.h &&
           memcmp(px, py, n * sizeof *px) == 0;
}

/* Number of each view's camera, from 1. Returns how many there are. */
static uint32_t number_cameras(const struct rig *rig, uint32_t *id)
{
    uint32_t n = 0;
    for (int i = 0; i < rig->n; i++) {
        id[i] = 0;
        for (int k = 0; k < i && !id[i]; k++)
            if (same_camera(&rig->views[k], &rig->views[i]))
                id[i] = id[k];
        if (!id[i])
            id[i] = ++n;
    }
    return n;
}

static void put_camera(struct sink *s, uint32_t id, const struct rig_view *v)
{
    const struct lens l = lens_of(v);
    double values[LENS_PARAMS];
    const int n = lens_params(&l, values);
    put_whole(s, id, 4);
    if (s->binary)
        put_whole(s, 1 + (uint64_t)l.model, 4); // COLMAP has SIMPLE_PINHOLE before them
    else
        fprintf(s->f, "%s ", lens_name(l.model));
    put_whole(s, (uint64_t)v->cam.w, 8);
    put_whole(s, (uint64_t)v->cam.h, 8);
    for (int i = 0; i < n; i++)
        put_number(s, values[i]);
    put_text(s, "\n");
}

static err_t write_cameras(const char *dir, bool binary, const struct rig *rig, const uint32_t *id,
                           uint32_t n)
{
    struct sink s;
    uint32_t next = 1;
    err_t e = sink_open(dir, "cameras", binary, &s);
    if (e)
        return e;
    put_count(&s, n);
    put_text(&s, "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
    for (int i = 0; i < rig->n; i++)
        if (id[i] == next)
            put_camera(&s, next++, &rig->views[i]);
    return file_finish(s.f, s.path);
}

/* ---- images ---- */

static void put_image(struct sink *s, uint32_t id, const struct rig_view *v, uint32_t camera)
{
    put_whole(s, id, 4);
    for (int k = 0; k < 4; k++)
        put_number(s, (double)v->cam.q[k]);
    for (int k = 0; k < 3; k++)
        put_number(s, (double)v->cam.t[k]);
    put_whole(s, camera, 4);
    fputs(v->name, s->f);
    if (s->binary)
        putc(0, s->f);
    put_count(s, 0); // points of this image
    put_text(s, "\n\n");
}

static err_t write_images(const char *dir, bool binary, const struct rig *rig, const uint32_t *id)
{
    struct sink s;
    err_t e = sink_open(dir, "images", binary, &s);
    if (e)
        return e;
    put_count(&s, (uint64_t)rig->n);
    put_text(&s, "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
                 "# POINTS2D[] as (X, Y, POINT3D_ID)\n");
    for (int i = 0; i < rig->n; i++)
        put_image(&s, (uint32_t)i + 1, &rig->views[i], id[i]);
    return file_finish(s.f, s.path);
}

/* ---- points ---- */

static err_t write_points(const char *dir, bool binary, const struct colmap_points *points)
{
    struct sink s;
    const int n = points ? points->n : 0;
    err_t e = sink_open(dir, "points3D", binary, &s);
    if (e)
        return e;
    put_count(&s, (uint64_t)n);
    put_text(&s, "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
    for (int i = 0; i < n; i++) {
        put_whole(&s, (uint64_t)i + 1, 8);
        for (int k = 0; k < 3; k++)
            put_number(&s, (double)points->p[i].xyz[k]);
        for (int k = 0; k < 3; k++)
            put_whole(&s, points->p[i].rgb[k], 1);
        put_number(&s, ERROR_UNKNOWN);
        put_count(&s, 0); // images that see it
        put_text(&s, "\n");
    }
    return file_finish(s.f, s.path);
}

err_t colmapwrite_run(const char *dir, bool binary, const struct rig *rig,
                      const struct colmap_points *points)
{
    uint32_t *id = calloc((size_t)rig->n + 1, sizeof *id);
    if (!id)
        return err_fail(ERR_NOMEM, "%s: no memory for %d cameras", dir, rig->n);
    const uint32_t n = number_cameras(rig, id);
    err_t e = write_cameras(dir, binary, rig, id, n);
    if (!e)
        e = write_images(dir, binary, rig, id);
    if (!e)
        e = write_points(dir, binary, points);
    free(id);
    return e;
}
