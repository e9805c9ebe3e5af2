/* Writing walks the members in the order of the header's comment. Reading takes the document apart
 * member by member; the list of cameras is that of cameras.json, so cameras_parse reads it out of
 * the same text. */
#include "drivers/format/sidecar.h"

#include "core/splat/display.h"
#include "drivers/format/cameras.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/scenefile.h"

#include <math.h>
#include <string.h>

enum { VERSION = 1, SIZE_LIMIT_PX = 65536, WHAT_CAP = 256 };

static const char *const FORMAT_NAME = "hdrig-sidecar";

static const struct {
    const char *key;
    int first, n; // in struct tonemap, per colour
} curve_keys[] = {
    {"w1", 0, TONE_HIDDEN}, {"b1", TONE_HIDDEN, TONE_HIDDEN}, {"w2", 2 * TONE_HIDDEN, TONE_HIDDEN}};
enum { N_CURVE_KEYS = sizeof curve_keys / sizeof curve_keys[0], CURVE_B2 = 3 * TONE_HIDDEN };

err_t sidecar_path(const char *splats, char out[], size_t cap)
{
    const char *slash = strrchr(splats, '/'), *name = slash ? slash + 1 : splats;
    const char *dot = strrchr(name, '.');
    int n = (int)(dot && dot > name ? dot - splats : (ptrdiff_t)strlen(splats));
    if (snprintf(out, cap, "%.*s.json", n, splats) >= (int)cap)
        return err_fail(ERR_ARG, "%s: the name of its sidecar would be longer than %zu bytes",
                        splats, cap - 1);
    return OK;
}

/* ---- reading ---- */

static bool is_ours(const struct cJSON *doc)
{
    const char *format = json_string(json_member(doc, "format"));
    return format && strcmp(format, FORMAT_NAME) == 0;
}

static int count_views(const struct cJSON *doc)
{
    return json_count(json_member(doc, "cameras"));
}

/* The document; *out is NULL if it is not a sidecar of ours.
 * own:  json_free. */
static err_t open_document(const struct sidecar_bytes *file, struct cJSON **out)
{
    double version = 0;
    err_t e = json_parse(file->what, file->p, file->n, out);
    if (e)
        return e;
    if (!is_ours(*out)) {
        json_free(*out);
        *out = NULL;
        return OK;
    }
    if (!json_number(json_member(*out, "version"), &version) || version != VERSION)
        e = err_fail(ERR_UNSUPPORTED, "%s: \"version\" %g of the sidecar, this program reads %d",
                     file->what, version, VERSION);
    else if (!json_is_array(json_member(*out, "cameras")))
        e = err_fail(ERR_FORMAT, "%s: no array \"cameras\"", file->what);
    else if (count_views(*out) > CAMERAS_MAX)
        e = err_fail(ERR_FORMAT, "%s: %d cameras, at most %d are read", file->what,
                     count_views(*out), CAMERAS_MAX);
    if (!e)
        return OK;
    json_free(*out);
    *out = NULL;
    return e;
}

static size_t views_need(int n_views)
{
    return n_views > 0 ? scenefile_views_need(n_views) : 0;
}

static err_t get_tone(const char *what, const struct cJSON *doc, struct tonemap *t)
{
    const struct cJSON *curves = json_member(doc, "tone");
    if (!json_is_array(curves) || json_count(curves) != 3)
        return err_fail(ERR_FORMAT, "%s: \"tone\" is not an array of 3 curves", what);
    float *p = t->p;
    int c = 0;
    for (const struct cJSON *v = json_first(curves); v; v = json_next(v), p += TONE_PER_COLOUR) {
        char where[WHAT_CAP];
        snprintf(where, sizeof where, "%.160s: tone curve %d", what, c++);
        err_t e = json_float(where, v, "b2", &p[CURVE_B2]);
        for (int k = 0; k < N_CURVE_KEYS && !e; k++)
            e = json_floats(where, v, curve_keys[k].key, curve_keys[k].n, p + curve_keys[k].first);
        if (e)
            return e;
    }
    return OK;
}

static err_t get_globals(const char *what, const struct cJSON *doc, struct scene *s)
{
    double size;
    err_t e = json_float(what, doc, "mid_exposure_log2", &s->tone.mid_log2t);
    if (!e)
        e = json_floats(what, doc, "background", 3, s->background);
    if (!e)
        e = get_tone(what, doc, &s->tone);
    if (e)
        return e;
    for (int c = 0; c < 3; c++)
        if (s->background[c] < 0)
            return err_fail(ERR_FORMAT, "%s: \"background\" %d is %g, must be >= 0", what, c,
                            (double)s->background[c]);
    if (!json_number(json_member(doc, "size"), &size) || size != floor(size) || size < 1 ||
        size > SIZE_LIMIT_PX)
        return err_fail(ERR_FORMAT, "%s: \"size\" is not a whole number from 1 to %d", what,
                        SIZE_LIMIT_PX);
    s->size = (int)size;
    return OK;
}

static err_t take_views(const char *what, const struct rig *rig, struct arena *a, struct scene *s)
{
    err_t e = scenefile_alloc_views(a, rig->n, s);
    if (e)
        return e;
    s->n_views = rig->n;
    s->metres = rig->metres;
    for (int i = 0; i < rig->n; i++) {
        const struct rig_view *v = &rig->views[i];
        if (v->cam.w > s->size || v->cam.h > s->size)
            return err_fail(ERR_FORMAT, "%s: camera %d (%s) is for %d x %d px, above \"size\" %d",
                            what, i, v->name, v->cam.w, v->cam.h, s->size);
        if (!v->has_exposure)
            return err_fail(ERR_FORMAT, "%s: camera %d (%s) has no \"exposure_log2\"", what, i,
                            v->name);
        memcpy(s->names[i], v->name, NAME_CAP);
        s->log2t[i] = v->exposure_log2;
        s->cams[i] = v->cam;
    }
    return OK;
}

static err_t get_views(const struct sidecar_bytes *file, struct arena *a, struct scene *s)
{
    struct rig rig;
    size_t mark = arena_mark(a);
    err_t e = cameras_parse(file->what, file->p, file->n, &rig);
    if (e)
        return e;
    e = take_views(file->what, &rig, a, s);
    cameras_free(&rig);
    if (e)
        arena_reset(a, mark);
    return e;
}

/* The scene's values without a sidecar. */
static void fill_defaults(float ev, struct scene *s)
{
    *s = (struct scene){.g = s->g, .size = SIDECAR_SIZE};
    display_tonemap(ev, &s->tone);
}

err_t sidecar_peek_bytes(const struct sidecar_bytes *file, struct sidecar_info *out)
{
    struct cJSON *doc;
    *out = (struct sidecar_info){0};
    err_t e = open_document(file, &doc);
    if (e || !doc)
        return e;
    int n = count_views(doc);
    *out = (struct sidecar_info){true, n, views_need(n)};
    json_free(doc);
    return OK;
}

err_t sidecar_parse(const struct sidecar_bytes *file, float ev, struct arena *a, struct scene *s)
{
    struct cJSON *doc;
    struct scene out = {.g = s->g};
    err_t e = open_document(file, &doc);
    if (e)
        return e;
    if (!doc) {
        fill_defaults(ev, s);
        return OK;
    }
    e = get_globals(file->what, doc, &out);
    if (!e && count_views(doc) > 0)
        e = get_views(file, a, &out);
    json_free(doc);
    if (!e)
        *s = out;
    return e;
}

/* own: file_unmap. */
static err_t map_sidecar(const char *splats, char path[FILE_PATH_CAP], bool *found,
                         struct file_map *m)
{
    *m = (struct file_map){0};
    err_t e = sidecar_path(splats, path, FILE_PATH_CAP);
    *found = !e && file_exists(path);
    return *found ? file_map(path, JSON_BYTES_MAX, m) : e;
}

err_t sidecar_peek(const char *splats, struct sidecar_info *out)
{
    char path[FILE_PATH_CAP];
    struct file_map m;
    bool found;
    *out = (struct sidecar_info){0};
    err_t e = map_sidecar(splats, path, &found, &m);
    if (e || !found)
        return e;
    e = sidecar_peek_bytes(&(struct sidecar_bytes){path, m.p, m.n}, out);
    file_unmap(&m);
    return e;
}

err_t sidecar_read(const char *splats, float ev, struct arena *a, struct scene *s)
{
    char path[FILE_PATH_CAP];
    struct file_map m;
    bool found;
    err_t e = map_sidecar(splats, path, &found, &m);
    if (e)
        return e;
    if (!found) {
        fill_defaults(ev, s);
        return OK;
    }
    e = sidecar_parse(&(struct sidecar_bytes){path, m.p, m.n}, ev, a, s);
    file_unmap(&m);
    return e;
}

/* ---- writing ---- */

static err_t check_floats(const char *path, const char *key, const float *v, int n)
{
    for (int i = 0; i < n; i++)
        if (!isfinite(v[i]))
            return err_fail(ERR_ARG, "%s: \"%s\" %d of %d is %g, not finite", path, key, i, n,
                            (double)v[i]);
    return OK;
}

static err_t check_scene(const char *path, const struct scene *s)
{
    if (s->size < 1 || s->size > SIZE_LIMIT_PX)
        return err_fail(ERR_ARG, "%s: \"size\" %d, allowed are 1 to %d", path, s->size,
                        SIZE_LIMIT_PX);
    err_t e = check_floats(path, "tone", s->tone.p, TONE_PARAMS);
    if (!e)
        e = check_floats(path, "mid_exposure_log2", &s->tone.mid_log2t, 1);
    if (!e)
        e = check_floats(path, "background", s->background, 3);
    for (int c = 0; c < 3 && !e; c++)
        if (s->background[c] < 0)
            e = err_fail(ERR_ARG, "%s: \"background\" %d is %g, must be >= 0", path, c,
                         (double)s->background[c]);
    if (!e && s->n_views > CAMERAS_MAX)
        e = err_fail(ERR_ARG, "%s: %d cameras, allowed are %d", path, s->n_views, CAMERAS_MAX);
    if (!e)
        e = check_floats(path, "exposure_log2", s->log2t, s->n_views);
    for (int i = 0; i < s->n_views && !e; i++) {
        struct camera cam = s->cams[i];
        e = cameras_check(path, s->names[i], &cam);
        if (!e && (cam.w > s->size || cam.h > s->size))
            e = err_fail(ERR_ARG, "%s: camera %d (%s) is for %d x %d px, above \"size\" %d", path,
                         i, s->names[i], cam.w, cam.h, s->size);
    }
    return e;
}

err_t sidecar_check_place(const char *splats)
{
    char path[FILE_PATH_CAP];
    struct cJSON *doc;
    err_t e = sidecar_path(splats, path, sizeof path);
    if (e || !file_exists(path))
        return e;
    e = json_read(path, &doc);
    bool ours = !e && is_ours(doc);
    json_free(doc);
    if (e == ERR_NOMEM || ours)
        return e;
    return err_fail(ERR_ARG,
                    "%s is not a sidecar of this program and would be overwritten: choose "
                    "another name or remove it",
                    path);
}

static void put_floats(FILE *f, const char *key, const float *v, int n)
{
    fprintf(f, "\"%s\": [", key);
    for (int i = 0; i < n; i++)
        fprintf(f, i ? ", %.9g" : "%.9g", (double)v[i]);
    putc(']', f);
}

static void put_tone(FILE *f, const struct tonemap *t)
{
    fputs("  \"tone\": [\n", f);
    for (int c = 0; c < 3; c++) {
        const float *p = t->p + c * TONE_PER_COLOUR;
        fputs("    {", f);
        for (int k = 0; k < N_CURVE_KEYS; k++) {
            put_floats(f, curve_keys[k].key, p + curve_keys[k].first, curve_keys[k].n);
            fputs(",\n     ", f);
        }
        fprintf(f, "\"b2\": %.9g}%s\n", (double)p[CURVE_B2], c < 2 ? "," : "");
    }
    fputs("  ],\n", f);
}

static void put_scene(FILE *f, const struct scene *s)
{
    fprintf(f,
            "{\n  \"format\": \"%s\",\n  \"version\": %d,\n  \"ev\": %.9g,\n"
            "  \"mid_exposure_log2\": %.9g,\n  ",
            FORMAT_NAME, VERSION, (double)display_ev(&s->tone), (double)s->tone.mid_log2t);
    put_floats(f, "background", s->background, 3);
    fputs(",\n", f);
    put_tone(f, &s->tone);
    fprintf(f, "  \"size\": %d,\n%s  \"cameras\": [\n", s->size,
            s->metres ? "  \"unit\": \"m\",\n" : "");
    for (int i = 0; i < s->n_views; i++) {
        struct rig_view v = {.cam = s->cams[i], .has_exposure = true, .exposure_log2 = s->log2t[i]};
        memcpy(v.name, s->names[i], NAME_CAP);
        cameras_put(f, &v);
        fputs(i + 1 < s->n_views ? ",\n" : "\n", f);
    }
    fputs("  ]\n}\n", f);
}

err_t sidecar_write(const char *splats, const struct scene *s)
{
    char path[FILE_PATH_CAP];
    FILE *f;
    err_t e = sidecar_path(splats, path, sizeof path);
    if (!e)
        e = check_scene(path, s);
    if (!e)
        e = sidecar_check_place(splats);
    if (!e)
        e = file_create(path, &f);
    if (e)
        return e;
    put_scene(f, s);
    return file_finish(f, path);
}
