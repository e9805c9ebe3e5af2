#include "drivers/format/cameras.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/name.h"
#include "drivers/format/origin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SIZE_MAX_PX = 65536, STOPS_MAX = 20 };

void cameras_free(struct rig *rig)
{
    free(rig->views);
    *rig = (struct rig){0};
}

static err_t check_quat(const char *what, const char *name, float q[4])
{
    double sum = 0;
    for (int k = 0; k < 4; k++)
        sum += (double)q[k] * q[k];
    double length = sqrt(sum);
    if (!(fabs(length - 1) <= 1e-3))
        return err_fail(ERR_FORMAT, "%s: %s: quaternion of length %.6g, allowed is 1 within 0.001",
                        what, name, length);
    if (fabs(length - 1) > 1e-6) // else leave the bits: written and read back they must not creep
        for (int k = 0; k < 4; k++)
            q[k] = (float)(q[k] / length);
    return OK;
}

err_t cameras_check(const char *what, const char *name, struct camera *cam)
{
    if (cam->w < 1 || cam->h < 1 || cam->w > SIZE_MAX_PX || cam->h > SIZE_MAX_PX)
        return err_fail(ERR_FORMAT, "%s: %s: %d x %d px, allowed are 1 to %d", what, name, cam->w,
                        cam->h, SIZE_MAX_PX);
    if (!(cam->fx > 0) || !(cam->fy > 0) || !isfinite(cam->fx) || !isfinite(cam->fy))
        return err_fail(ERR_FORMAT, "%s: %s: focal lengths %g and %g px, both must be > 0", what,
                        name, (double)cam->fx, (double)cam->fy);
    if (!isfinite(cam->cx) || !isfinite(cam->cy))
        return err_fail(ERR_FORMAT, "%s: %s: principal point %g, %g is not finite", what, name,
                        (double)cam->cx, (double)cam->cy);
    for (int k = 0; k < 3; k++)
        if (!isfinite(cam->t[k]))
            return err_fail(ERR_FORMAT, "%s: %s: translation %d is %g, not finite", what, name, k,
                            (double)cam->t[k]);
    return check_quat(what, name, cam->q);
}

static int by_name(const void *a, const void *b)
{
    return strcmp(*(const char *const *)a, *(const char *const *)b);
}

err_t cameras_check_names(const char *what, const struct rig *rig)
{
    const char **names = malloc((size_t)(rig->n ? rig->n : 1) * sizeof *names);
    if (!names)
        return err_fail(ERR_NOMEM, "%s: no memory for %d names", what, rig->n);
    for (int i = 0; i < rig->n; i++)
        names[i] = rig->views[i].name;
    qsort(names, (size_t)rig->n, sizeof *names, by_name);
    err_t e = OK;
    for (int i = 1; i < rig->n && !e; i++)
        if (strcmp(names[i - 1], names[i]) == 0)
            e = err_fail(ERR_FORMAT, "%s: %s is named twice", what, names[i]);
    free(names);
    return e;
}

static err_t get_size(const char *what, const struct cJSON *object, const char *key, int *out)
{
    double v;
    if (!json_number(json_member(object, key), &v) || v != floor(v) || v < 1 || v > SIZE_MAX_PX)
        return err_fail(ERR_FORMAT, "%s: \"%s\" is not a whole number from 1 to %d", what, key,
                        SIZE_MAX_PX);
    *out = (int)v;
    return OK;
}

err_t cameras_set_lens(const char *what, const char *name, struct lens *l, struct rig_view *out)
{
    if (lens_init(l) != OK)
        return err_fail(ERR_FORMAT, "%s: %s: %s", what, name, err_text());
    out->cam.fx = (float)l->fx;
    out->cam.fy = (float)l->fy;
    out->cam.cx = (float)l->cx;
    out->cam.cy = (float)l->cy;
    out->lens = lens_distorts(l) ? *l : (struct lens){0};
    return OK;
}

void cameras_set_covariance(const double covariance[COVARIANCE_POSE], double unit, double depth,
                            struct rig_view *out)
{
    double deviation[2];
    covariance_deviations(covariance, deviation);
    out->has_deviation = out->has_covariance = isfinite(deviation[0] + deviation[1]) && depth > 0;
    if (!out->has_covariance)
        return;
    out->deviation[0] = (float)(deviation[0] * 180 / NUM_PI);
    out->deviation[1] = (float)(deviation[1] * unit / depth);
    for (int row = 0, k = 0; row < 6; row++)
        for (int i = 0; i <= row; i++)
            out->covariance[k++] =
                (float)(covariance[6 * row + i] * (row < 3 ? 1 : unit) * (i < 3 ? 1 : unit));
}

/* "model" and "params" of an object. */
static err_t get_lens(const char *what, const struct cJSON *object, struct lens *out)
{
    const struct cJSON *params = json_member(object, "params");
    const char *text = json_string(json_member(object, "model")), *model = text ? text : "";
    const enum lens_model m = lens_find(model);
    double values[LENS_PARAMS];
    int n = 0;
    if (m == LENS_MODELS)
        return err_fail(ERR_FORMAT, "%s: \"model\" %.32s is not known", what, model);
    const struct cJSON *v = json_is_array(params) ? json_first(params) : NULL;
    for (; v; v = json_next(v), n++)
        if (n < LENS_PARAMS && !json_number(v, &values[n]))
            return err_fail(ERR_FORMAT, "%s: \"params\" has something other than numbers", what);
    if (n != lens_count(m))
        return err_fail(ERR_FORMAT, "%s: \"params\" has %d numbers, %s has %d", what, n, model,
                        lens_count(m));
    if (lens_from_params(m, values, n, out) != OK)
        return err_fail(ERR_FORMAT, "%s: %s", what, err_text());
    return OK;
}

static err_t get_photograph(const char *what, const struct cJSON *object, struct rig_view *out)
{
    const struct cJSON *taken = json_member(object, "photograph");
    if (!taken)
        return OK;
    err_t e = get_size(what, taken, "w", &out->photograph.w);
    if (!e)
        e = get_size(what, taken, "h", &out->photograph.h);
    return e ? e : get_lens(what, taken, &out->photograph.lens);
}

static err_t get_stops(const char *what, const struct cJSON *object, const char *key, double out[3])
{
    float stops[3];
    err_t e = json_floats(what, object, key, 3, stops);
    for (int k = 0; k < 3 && !e; k++) {
        out[k] = (double)stops[k];
        if (!(fabsf(stops[k]) <= STOPS_MAX))
            e = err_fail(ERR_FORMAT, "%s: \"%s\" of %g, allowed are -%d to %d", what, key,
                         (double)stops[k], STOPS_MAX, STOPS_MAX);
    }
    return e;
}

static err_t get_deviation(const char *what, const struct cJSON *object, struct rig_view *out)
{
    out->has_deviation = json_member(object, "deviation") != NULL;
    err_t e = out->has_deviation ? json_floats(what, object, "deviation", 2, out->deviation) : OK;
    for (int k = 0; k < 2 && !e; k++)
        if (!(out->deviation[k] >= 0))
            e = err_fail(ERR_FORMAT, "%s: \"deviation\" of %g, must be 0 or more", what,
                         (double)out->deviation[k]);
    return e;
}

static err_t get_covariance(const char *what, const struct cJSON *object, struct rig_view *out)
{
    out->has_covariance = json_member(object, "covariance") != NULL;
    if (!out->has_covariance)
        return OK;
    err_t e = json_floats(what, object, "covariance", CAMERAS_COVARIANCE, out->covariance);
    for (int row = 0, k = 0; row < 6 && !e; k += ++row + 1)
        if (!(out->covariance[k] >= 0))
            e = err_fail(ERR_FORMAT, "%s: a variance in \"covariance\" is %g, must be 0 or more",
                         what, (double)out->covariance[k]);
    return e;
}

/* The physical camera, how well its pose is known, and its light. */
static err_t get_physical(const char *what, const struct cJSON *object, struct rig_view *out)
{
    const struct cJSON *light = json_member(object, "light");
    const char *camera = json_string(json_member(object, "camera"));
    if (camera && strlen(camera) >= sizeof out->camera)
        return err_fail(ERR_FORMAT, "%s: \"camera\" has %zu characters, at most %zu are allowed",
                        what, strlen(camera), sizeof out->camera - 1);
    if (camera)
        memcpy(out->camera, camera, strlen(camera) + 1);
    out->has_light = light != NULL;
    err_t e = get_deviation(what, object, out);
    if (!e)
        e = get_covariance(what, object, out);
    if (!light || e)
        return e;
    e = get_stops(what, light, "vignetting_stops", out->light.term);
    return e ? e : get_stops(what, light, "gain_stops", out->light.gain);
}

static err_t get_intrinsics(const char *what, const struct cJSON *object, struct rig_view *out)
{
    static const char *const keys[4] = {"fx", "fy", "cx", "cy"};
    struct camera *cam = &out->cam;
    float *const fields[4] = {&cam->fx, &cam->fy, &cam->cx, &cam->cy};
    struct lens l;
    err_t e = get_size(what, object, "w", &cam->w);
    if (!e)
        e = get_size(what, object, "h", &cam->h);
    if (!e && json_member(object, "model")) {
        e = get_lens(what, object, &l);
        return e ? e : cameras_set_lens(what, out->name, &l, out);
    }
    for (int k = 0; k < 4 && !e; k++)
        e = json_float(what, object, keys[k], fields[k]);
    return e;
}

static err_t get_view(const char *file, const struct cJSON *object, int i, struct rig_view *out)
{
    char what[256];
    snprintf(what, sizeof what, "%.160s: camera %d", file, i);
    const char *name = json_string(json_member(object, "name"));
    if (!name)
        return err_fail(ERR_FORMAT, "%s: \"name\" is absent or not a string", what);
    err_t e = name_copy(what, name, strlen(name), out->name);
    if (!e)
        e = get_intrinsics(what, object, out);
    if (!e)
        e = get_photograph(what, object, out);
    if (!e)
        e = get_physical(what, object, out);
    if (!e)
        e = json_floats(what, object, "q", 4, out->cam.q);
    if (!e)
        e = json_floats(what, object, "t", 3, out->cam.t);
    if (e)
        return e;
    out->has_exposure = json_member(object, "exposure_log2") != NULL;
    if (out->has_exposure && (e = json_float(what, object, "exposure_log2", &out->exposure_log2)))
        return e;
    return cameras_check(file, out->name, &out->cam);
}

static err_t get_rig(const char *what, const struct cJSON *doc, void *rig)
{
    struct rig *out = rig;
    const struct cJSON *array = json_member(doc, "cameras");
    const char *unit = json_string(json_member(doc, "unit"));
    out->metres = unit && strcmp(unit, "m") == 0;
    if (!json_is_array(array))
        return err_fail(ERR_FORMAT, "%s: no array \"cameras\"", what);
    int n = json_count(array);
    if (n < 1 || n > CAMERAS_MAX)
        return err_fail(ERR_FORMAT, "%s: %d cameras, allowed are 1 to %d", what, n, CAMERAS_MAX);
    out->views = calloc((size_t)n, sizeof *out->views);
    if (!out->views)
        return err_fail(ERR_NOMEM, "%s: no memory for %d cameras", what, n);
    for (const struct cJSON *v = json_first(array); v; v = json_next(v)) {
        err_t e = get_view(what, v, out->n, &out->views[out->n]);
        if (e)
            return e;
        out->n++;
    }
    return cameras_check_names(what, out);
}

err_t cameras_parse(const char *what, const void *text, size_t n, struct rig *out)
{
    *out = (struct rig){0};
    err_t e = json_parse_with(what, text, n, get_rig, out);
    if (e)
        cameras_free(out);
    return e;
}

err_t cameras_read(const char *path, struct rig *out)
{
    *out = (struct rig){0};
    err_t e = json_read_with(path, get_rig, out);
    if (e)
        cameras_free(out);
    return e;
}

static void put_lens(FILE *f, const struct lens *l)
{
    double values[LENS_PARAMS];
    const int n = lens_params(l, values);
    fprintf(f, "\"model\": \"%s\", \"params\": [", lens_name(l->model));
    for (int i = 0; i < n; i++)
        fprintf(f, "%s%.17g", i ? ", " : "", values[i]);
    putc(']', f);
}

static void put_stops(FILE *f, const char *key, const double stops[3])
{
    fprintf(f, "\"%s\": [%.9g, %.9g, %.9g]", key, stops[0], stops[1], stops[2]);
}

static void put_physical(FILE *f, const struct rig_view *v)
{
    if (v->camera[0]) {
        fputs(",\n     \"camera\": ", f);
        json_put_string(f, v->camera);
    }
    if (v->has_deviation)
        fprintf(f, ",\n     \"deviation\": [%.9g, %.9g]", (double)v->deviation[0],
                (double)v->deviation[1]);
    for (int k = 0; k < CAMERAS_COVARIANCE && v->has_covariance; k++)
        fprintf(f, "%s%.9g%s", k ? ", " : ",\n     \"covariance\": [", (double)v->covariance[k],
                k + 1 < CAMERAS_COVARIANCE ? "" : "]");
    if (!v->has_light)
        return;
    fputs(",\n     \"light\": {", f);
    put_stops(f, "vignetting_stops", v->light.term);
    fputs(", ", f);
    put_stops(f, "gain_stops", v->light.gain);
    putc('}', f);
}

void cameras_put(FILE *f, const struct rig_view *v)
{
    const struct camera *c = &v->cam;
    fputs("    {\"name\": ", f);
    json_put_string(f, v->name);
    fprintf(f, ", \"w\": %d, \"h\": %d, \"fx\": %.9g, \"fy\": %.9g, \"cx\": %.9g, \"cy\": %.9g,\n",
            c->w, c->h, (double)c->fx, (double)c->fy, (double)c->cx, (double)c->cy);
    fprintf(f, "     \"q\": [%.9g, %.9g, %.9g, %.9g], \"t\": [%.9g, %.9g, %.9g]", (double)c->q[0],
            (double)c->q[1], (double)c->q[2], (double)c->q[3], (double)c->t[0], (double)c->t[1],
            (double)c->t[2]);
    if (v->has_exposure)
        fprintf(f, ", \"exposure_log2\": %.9g", (double)v->exposure_log2);
    if (lens_distorts(&v->lens)) {
        fputs(",\n     ", f);
        put_lens(f, &v->lens);
    }
    if (v->photograph.w > 0) {
        fprintf(f, ",\n     \"photograph\": {\"w\": %d, \"h\": %d, ", v->photograph.w,
                v->photograph.h);
        put_lens(f, &v->photograph.lens);
        putc('}', f);
    }
    put_physical(f, v);
    putc('}', f);
}

err_t cameras_write(const char *path, const struct rig *rig)
{
    FILE *f;
    err_t e = file_create(path, &f);
    if (e)
        return e;
    fputs("{\n  \"generator\": \"" ORIGIN_GENERATOR "\",\n"
          "  \"convention\": \"x right, y down, z forward; X_cam = R(q) X_world + t, q = w,x,y,z; "
          "u = fx x/z + cx in px, pixel centres at .5\",\n",
          f);
    fputs(rig->metres ? "  \"unit\": \"m\",\n  \"cameras\": [\n" : "  \"cameras\": [\n", f);
    for (int i = 0; i < rig->n; i++) {
        cameras_put(f, &rig->views[i]);
        fputs(i + 1 < rig->n ? ",\n" : "\n", f);
    }
    fputs("  ]\n}\n", f);
    return file_finish(f, path);
}

static bool same_camera(const struct rig_view *x, const struct rig_view *y)
{
    const struct camera *a = &x->cam, *b = &y->cam;
    return x->lens.model == y->lens.model &&
           memcmp(x->lens.term, y->lens.term, sizeof x->lens.term) == 0 && a->w == b->w &&
           a->h == b->h && a->fx == b->fx && a->fy == b->fy && a->cx == b->cx && a->cy == b->cy &&
           memcmp(a->q, b->q, sizeof a->q) == 0 && memcmp(a->t, b->t, sizeof a->t) == 0;
}

void cameras_use_photographs(struct rig *rig)
{
    for (int i = 0; i < rig->n; i++) {
        struct rig_view *v = &rig->views[i];
        const struct lens *l = &v->photograph.lens;
        if (v->photograph.w == 0)
            continue;
        v->cam.w = v->photograph.w;
        v->cam.h = v->photograph.h;
        v->cam.fx = (float)l->fx;
        v->cam.fy = (float)l->fy;
        v->cam.cx = (float)l->cx;
        v->cam.cy = (float)l->cy;
        v->lens = lens_distorts(l) ? *l : (struct lens){0};
        v->photograph.w = v->photograph.h = 0;
    }
}

/* *out is NULL if there is none. */
static err_t look_up(const char *what, const struct rig *rig, const char *name,
                     const struct rig_view **out)
{
    const struct rig_view *found = NULL;
    *out = NULL;
    for (int i = 0; i < rig->n; i++) {
        const struct rig_view *v = &rig->views[i];
        if (strcmp(v->name, name) == 0) {
            *out = v;
            return OK;
        }
    }
    for (int i = 0; i < rig->n; i++) {
        const struct rig_view *v = &rig->views[i];
        if (!name_same_view(v->name, name))
            continue;
        if (found && !same_camera(found, v))
            return err_fail(ERR_FORMAT, "%s: cameras %s and %s both fit image %s but differ", what,
                            found->name, v->name, name);
        found = v;
    }
    *out = found;
    return OK;
}

err_t cameras_has(const char *what, const struct rig *rig, const char *name, bool *has)
{
    const struct rig_view *v;
    err_t e = look_up(what, rig, name, &v);
    *has = !e && v;
    return e;
}

/* One of the sizes may be rounded to whole pixels. */
static bool fits_picture(const struct camera *cam, int w, int h)
{
    const double sx = (double)w / cam->w;
    return (cam->w == w && cam->h == h) || fabs(sx * cam->h - h) <= 1 || fabs(h / sx - cam->h) <= 1;
}

static void scale_view(struct rig_view *v, int w, int h)
{
    struct camera *cam = &v->cam;
    const double sx = (double)w / cam->w, sy = (double)h / cam->h;
    if (cam->w == w && cam->h == h)
        return;
    cam->fx = (float)(cam->fx * sx);
    cam->cx = (float)(cam->cx * sx);
    cam->fy = (float)(cam->fy * sy);
    cam->cy = (float)(cam->cy * sy);
    cam->w = w;
    cam->h = h;
    lens_scale(&v->lens, sx, sy);
}

/* A quarter clockwise. */
static void turn_view(struct rig_view *v)
{
    struct camera *cam = &v->cam;
    const struct camera old = *cam;
    const double half = sqrt(0.5), quarter[4] = {half, 0, 0, half};
    const double q[4] = {(double)old.q[0], (double)old.q[1], (double)old.q[2], (double)old.q[3]};
    double turned[4];
    rotation_multiply(quarter, q, turned);
    for (int k = 0; k < 4; k++)
        cam->q[k] = (float)turned[k];
    cam->t[0] = -old.t[1];
    cam->t[1] = old.t[0];
    cam->w = old.h;
    cam->h = old.w;
    cam->fx = old.fy;
    cam->fy = old.fx;
    cam->cx = (float)(old.h - (double)old.cy);
    cam->cy = old.cx;
    lens_turn(&v->lens, old.h);
}

err_t cameras_find(const char *what, const struct rig *rig, const struct cameras_picture *picture,
                   struct rig_view *out)
{
    static const int quarters[9] = {0, 0, -1, 2, -1, -1, 1, -1, 3}; // CIPA DC-008; -1: mirrors
    const int o = picture->orientation, w = picture->w, h = picture->h;
    const bool lies = o >= 5;
    const struct rig_view *v;
    err_t e = look_up(what, rig, picture->name, &v);
    if (!e && !v)
        e = err_fail(ERR_FORMAT, "%s: no camera for image %s among %d", what, picture->name,
                     rig->n);
    if (e)
        return e;
    const bool upright = fits_picture(&v->cam, w, h);
    const bool turn =
        o > 1 && fits_picture(&v->cam, lies ? h : w, lies ? w : h) && (rig->stored || !upright);
    if (!turn && !upright)
        return err_fail(ERR_FORMAT,
                        "%s: camera %s is for %d x %d px, image %s has %d x %d: another aspect",
                        what, v->name, v->cam.w, v->cam.h, picture->name, w, h);
    if (turn && quarters[o] < 0)
        return err_fail(ERR_FORMAT,
                        "%s: EXIF orientation %d mirrors image %s, and camera %s is that of the "
                        "stored image: no camera sees its mirror image",
                        what, o, picture->name, v->name);
    *out = *v;
    scale_view(out, turn && lies ? h : w, turn && lies ? w : h);
    for (int i = 0; turn && i < quarters[o]; i++)
        turn_view(out);
    return OK;
}
