/* With the axes of its camera flipped (y and z), the matrix is the inverse of X_cam = R X + t. */
#include "drivers/format/transforms.h"

#include "core/base/bytes.h"
#include "core/base/lin.h"
#include "core/base/rotation.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/name.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { POINT_BYTES = 3 * 4 + 3, WHAT_CAP = 256 };

/* Names of the distortion terms of struct lens. */
static const char *const perspective_terms[LENS_TERMS] = {"k1", "k2", "p1", "p2"};
static const char *const fisheye_terms[LENS_TERMS] = {"k1", "k2", "k3", "k4"};

/* ---- reading ---- */

/* A frame, and the document with the numbers that it lacks. */
struct frame {
    char what[WHAT_CAP]; // begins sentences
    const struct cJSON *own, *all;
};

/* A number that may be absent. */
static err_t get_number(const struct frame *f, const char *key, double *out, bool *found)
{
    const struct cJSON *v = json_member(f->own, key);
    if (!v)
        v = json_member(f->all, key);
    *found = v != NULL;
    if (v && !json_number(v, out))
        return err_fail(ERR_FORMAT, "%s: \"%s\" is not a finite number", f->what, key);
    return OK;
}

static err_t get_size(const struct frame *f, const char *key, int *out)
{
    double v = 0;
    bool found;
    err_t e = get_number(f, key, &v, &found);
    if (e)
        return e;
    if (!found || v != floor(v) || v < 1 || v > INT32_MAX)
        return err_fail(ERR_FORMAT, "%s: \"%s\" is absent or not a whole number of pixels", f->what,
                        key);
    *out = (int)v;
    return OK;
}

static err_t get_focal(const struct frame *f, int w, struct lens *l)
{
    double angle = 0;
    bool found, has_y;
    err_t e = get_number(f, "fl_x", &l->fx, &found);
    if (!e && !found) {
        e = get_number(f, "camera_angle_x", &angle, &found);
        if (!e && (!found || !(angle > 0 && angle < 3.14)))
            e = err_fail(ERR_FORMAT, "%s: neither \"fl_x\" nor a \"camera_angle_x\" in 0..3.14",
                         f->what);
        l->fx = w / 2.0 / tan(angle / 2);
    }
    if (e)
        return e;
    l->fy = l->fx;
    return get_number(f, "fl_y", &l->fy, &has_y);
}

static bool model_holds_lens(enum lens_model m, const struct lens *l)
{
    const int terms = m == LENS_PINHOLE         ? 0
                      : m == LENS_SIMPLE_RADIAL ? 1
                      : m == LENS_RADIAL        ? 2
                                                : 4;
    bool fits = m == LENS_PINHOLE || m == LENS_OPENCV || l->fx == l->fy;
    for (int i = terms; i < LENS_TERMS; i++)
        fits = fits && l->term[i] == 0;
    return fits;
}

/* Programs apply all terms to every perspective model: the named one is kept if it has them. */
static err_t get_terms(const struct frame *f, struct lens *l)
{
    const bool fisheye = l->model == LENS_OPENCV_FISHEYE;
    const char *const *names = fisheye ? fisheye_terms : perspective_terms;
    bool found;
    err_t e = OK;
    for (int i = 0; i < LENS_TERMS && !e; i++)
        e = get_number(f, names[i], &l->term[i], &found);
    for (int i = 2; i < LENS_TERMS && !e; i++) {
        const char *key = fisheye ? perspective_terms[i] : fisheye_terms[i];
        double other = 0;
        e = get_number(f, key, &other, &found);
        if (!e && other != 0)
            e = err_fail(ERR_UNSUPPORTED, "%s: \"%s\" is %g, and %s has no such term", f->what, key,
                         other, lens_name(fisheye ? LENS_OPENCV_FISHEYE : LENS_OPENCV));
    }
    if (!fisheye && !model_holds_lens(l->model, l))
        l->model = LENS_OPENCV;
    return e;
}

static err_t get_model(const struct frame *f, enum lens_model *out)
{
    const struct cJSON *v = json_member(f->own, "camera_model");
    if (!v)
        v = json_member(f->all, "camera_model");
    const char *name = v ? json_string(v) : "PINHOLE";
    *out = name && strcmp(name, "SIMPLE_PINHOLE") == 0 ? LENS_PINHOLE : lens_find(name ? name : "");
    if (*out == LENS_MODELS)
        return err_fail(ERR_UNSUPPORTED, "%s: \"camera_model\" %.32s is not read", f->what,
                        name ? name : "(no text)");
    return OK;
}

static err_t get_lens(const struct frame *f, struct rig_view *out)
{
    struct lens l = {.model = LENS_PINHOLE};
    bool found;
    err_t e = get_size(f, "w", &out->cam.w);
    if (!e)
        e = get_size(f, "h", &out->cam.h);
    if (!e)
        e = get_model(f, &l.model);
    if (!e)
        e = get_focal(f, out->cam.w, &l);
    l.cx = out->cam.w / 2.0;
    l.cy = out->cam.h / 2.0;
    if (!e)
        e = get_number(f, "cx", &l.cx, &found);
    if (!e)
        e = get_number(f, "cy", &l.cy, &found);
    if (!e)
        e = get_terms(f, &l);
    return e ? e : cameras_set_lens(f->what, out->name, &l, out);
}

/* The first three rows. */
static err_t get_matrix(const struct frame *f, double m[12])
{
    const struct cJSON *rows = json_member(f->own, "transform_matrix");
    const int n = json_is_array(rows) ? json_count(rows) : 0;
    const struct cJSON *row = n == 3 || n == 4 ? json_first(rows) : NULL;
    bool good = row != NULL;
    for (int i = 0; i < 3 && good; i++, row = json_next(row)) {
        good = json_is_array(row) && json_count(row) == 4;
        const struct cJSON *v = good ? json_first(row) : NULL;
        for (int k = 0; k < 4 && good; k++, v = json_next(v))
            good = json_number(v, &m[4 * i + k]);
    }
    if (!good)
        return err_fail(ERR_FORMAT, "%s: \"transform_matrix\" is not 4 x 4 numbers", f->what);
    return OK;
}

static err_t set_pose(const struct frame *f, const double m[12], struct camera *out)
{
    double r[9], q[4], t[3];
    for (int i = 0; i < 3; i++) // row i of R: axis i of the camera in the world
        for (int k = 0; k < 3; k++)
            r[3 * i + k] = (i == 0 ? 1 : -1) * m[4 * k + i];
    if (!rotation_is(r, CAMERAS_NOT_ROTATED))
        return err_fail(ERR_FORMAT, "%s: \"transform_matrix\" is no rotation within %g", f->what,
                        CAMERAS_NOT_ROTATED);
    rotation_to_quat(r, q);
    for (int i = 0; i < 3; i++)
        t[i] = -(r[3 * i] * m[3] + r[3 * i + 1] * m[7] + r[3 * i + 2] * m[11]);
    for (int i = 0; i < 4; i++)
        out->q[i] = (float)q[i];
    for (int i = 0; i < 3; i++)
        out->t[i] = (float)t[i];
    return OK;
}

static err_t get_exposure(const struct frame *f, struct rig_view *out)
{
    double exposure = 0;
    const struct cJSON *v = json_member(f->own, "exposure");
    if (!v)
        return OK;
    if (!json_number(v, &exposure) || !(exposure > 0))
        return err_fail(ERR_FORMAT, "%s: \"exposure\" is not a finite number > 0", f->what);
    out->has_exposure = true;
    out->exposure_log2 = (float)log2(exposure);
    return OK;
}

/* folders: pictures are called FOLDER_NAME. */
static err_t get_view(const char *file, const struct cJSON *all, const struct cJSON *own,
                      bool folders, struct rig *rig)
{
    struct rig_view *out = &rig->views[rig->n++];
    struct frame f = {.own = own, .all = all};
    double m[12];
    snprintf(f.what, sizeof f.what, "%.160s: frame %d", file, rig->n - 1);
    const char *path = json_string(json_member(own, "file_path"));
    if (!path)
        return err_fail(ERR_FORMAT, "%s: \"file_path\" is absent or not a string", f.what);
    err_t e = name_of_path(f.what, path, strlen(path), folders, out->name);
    if (!e)
        e = get_lens(&f, out);
    if (!e)
        e = get_matrix(&f, m);
    if (!e)
        e = set_pose(&f, m, &out->cam);
    if (!e)
        e = get_exposure(&f, out);
    return e ? e : cameras_check(file, out->name, &out->cam);
}

static err_t get_views(const char *what, const struct cJSON *doc, bool folders, struct rig *out)
{
    err_t e = OK;
    const struct cJSON *v = json_first(json_member(doc, "frames"));
    out->n = 0;
    for (; v && !e; v = json_next(v)) {
        out->views[out->n] = (struct rig_view){0};
        e = get_view(what, doc, v, folders, out);
    }
    return e;
}

static err_t get_rig(const char *what, const struct cJSON *doc, void *rig)
{
    struct rig *out = rig;
    const struct cJSON *frames = json_member(doc, "frames");
    if (!transforms_is(doc))
        return err_fail(ERR_FORMAT, "%s: no array \"frames\"", what);
    const int n = json_count(frames);
    if (n < 1 || n > CAMERAS_MAX)
        return err_fail(ERR_FORMAT, "%s: %d frames, allowed are 1 to %d", what, n, CAMERAS_MAX);
    out->stored = true;
    out->views = calloc((size_t)n, sizeof *out->views);
    if (!out->views)
        return err_fail(ERR_NOMEM, "%s: no memory for %d cameras", what, n);
    err_t e = get_views(what, doc, false, out);
    if (!e && cameras_check_names(what, out) == ERR_FORMAT)
        e = get_views(what, doc, true, out); // a rig: a folder for each camera
    return e ? e : cameras_check_names(what, out);
}

bool transforms_is(const struct cJSON *doc)
{
    return json_is_array(json_member(doc, "frames"));
}

err_t transforms_parse(const char *what, const void *text, size_t n, struct rig *out)
{
    *out = (struct rig){0};
    err_t e = json_parse_with(what, text, n, get_rig, out);
    if (e)
        cameras_free(out);
    return e;
}

err_t transforms_read(const char *path, struct rig *out)
{
    *out = (struct rig){0};
    err_t e = json_read_with(path, get_rig, out);
    if (e)
        cameras_free(out);
    return e;
}

/* ---- writing ---- */

static bool is_fisheye(const struct rig_view *v)
{
    return v->lens.model == LENS_OPENCV_FISHEYE;
}

/* Models of one lens, or the one that holds all. */
static enum lens_model common_model(const struct rig *rig)
{
    enum lens_model m = rig->views[0].lens.model;
    for (int i = 1; i < rig->n; i++)
        m = rig->views[i].lens.model == m ? m : LENS_OPENCV;
    return m;
}

static void put_lens(FILE *f, const struct rig_view *v)
{
    const struct camera *c = &v->cam;
    const bool bent = lens_distorts(&v->lens);
    const double px[4] = {bent ? v->lens.fx : (double)c->fx, bent ? v->lens.fy : (double)c->fy,
                          bent ? v->lens.cx : (double)c->cx, bent ? v->lens.cy : (double)c->cy};
    fprintf(f,
            "\"w\": %d, \"h\": %d, \"fl_x\": %.17g, \"fl_y\": %.17g, \"cx\": %.17g, "
            "\"cy\": %.17g",
            c->w, c->h, px[0], px[1], px[2], px[3]);
    for (int i = 0; i < LENS_TERMS && bent; i++)
        fprintf(f, ", \"%s\": %.17g", (is_fisheye(v) ? fisheye_terms : perspective_terms)[i],
                v->lens.term[i]);
}

static void put_matrix(FILE *f, const struct camera *c)
{
    double r[9], centre[3];
    rotation_of_camera(c, r);
    rotation_centre(c, centre);
    fputs(",\n     \"transform_matrix\": [", f);
    for (int k = 0; k < 3; k++)
        fprintf(f, "[%.17g, %.17g, %.17g, %.17g], ", r[k], -r[3 + k], -r[6 + k], centre[k]);
    fputs("[0, 0, 0, 1]]", f);
}

static void put_frame(FILE *f, const struct rig_view *v)
{
    char path[NAME_CAP + 8];
    snprintf(path, sizeof path, "images/%s", v->name);
    fputs("    {\"file_path\": ", f);
    json_put_string(f, path);
    fputs(", ", f);
    put_lens(f, v);
    put_matrix(f, &v->cam);
    if (v->has_exposure)
        fprintf(f, ", \"exposure\": %.9g", exp2((double)v->exposure_log2));
    putc('}', f);
}

err_t transforms_write(const char *path, const struct rig *rig, const char *ply)
{
    FILE *f;
    for (int i = 1; i < rig->n; i++)
        if (is_fisheye(&rig->views[i]) != is_fisheye(&rig->views[0]))
            return err_fail(ERR_ARG,
                            "%s: %s and %s were taken through lenses of different kinds, and this "
                            "format has one for all",
                            path, rig->views[0].name, rig->views[i].name);
    err_t e = file_create(path, &f);
    if (e)
        return e;
    fprintf(f, "{\n  \"camera_model\": \"%s\",\n", lens_name(common_model(rig)));
    if (ply) {
        fputs("  \"ply_file_path\": ", f);
        json_put_string(f, ply);
        fputs(",\n", f);
    }
    fputs("  \"frames\": [\n", f);
    for (int i = 0; i < rig->n; i++) {
        put_frame(f, &rig->views[i]);
        fputs(i + 1 < rig->n ? ",\n" : "\n", f);
    }
    fputs("  ]\n}\n", f);
    return file_finish(f, path);
}

err_t transforms_write_points(const char *path, const struct colmap_points *points)
{
    FILE *f;
    err_t e = file_create(path, &f);
    if (e)
        return e;
    fprintf(f,
            "ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\n"
            "property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
            "property uchar blue\nend_header\n",
            points->n);
    for (int i = 0; i < points->n; i++) {
        uint8_t row[POINT_BYTES], *at = row;
        for (int k = 0; k < 3; k++)
            at = bytes_put_f32(at, points->p[i].xyz[k]);
        memcpy(at, points->p[i].rgb, 3);
        fwrite(row, 1, sizeof row, f);
    }
    return file_finish(f, path);
}
