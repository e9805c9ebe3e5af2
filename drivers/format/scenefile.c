/* One table (make_specs) says what tensors a scene has and where they live in struct scene; writer
 * and reader both walk it. The reader first builds a struct layout from the header, checked
 * completely, and only then takes memory. */
#include "drivers/format/scenefile.h"

#include "core/base/gaussians.h"
#include "core/photo/tonemap.h"
#include "drivers/format/cameras.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/name.h"
#include "drivers/format/safetensors.h"
#include "drivers/format/splats.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "floats are copied as they are");

enum { CAMERA_FLOATS = 11, SIZE_LIMIT_PX = 65536 };

static const uint64_t FILE_BYTES_MAX = (uint64_t)64 << 30;
static const char *const FORMAT_NAME = "hdrig-scene", *const FORMAT_VERSION = "1";

enum {
    T_MU,
    T_LOG_SCALE,
    T_QUAT,
    T_LOGIT,
    T_SH,
    T_TONE,
    T_MID,
    T_BACKGROUND,
    T_LOG2T,
    T_CAMERAS,
    T_CONFIDENCE, // optional
    N_TENSORS
};

struct spec {
    const char *name;
    int rank;
    size_t shape[3];
    int plane; // first plane of struct gaussians, -1 for the others
};

static void make_specs(const struct scenefile_info *info, struct spec out[N_TENSORS])
{
    size_t n = (size_t)info->n, v = (size_t)info->n_views, d = (size_t)info->degree + 1;
    const struct spec specs[N_TENSORS] = {
        [T_MU] = {"mu", 2, {3, n}, G_MU},
        [T_LOG_SCALE] = {"log_scale", 2, {3, n}, G_LOG_SCALE},
        [T_QUAT] = {"quat", 2, {4, n}, G_QUAT},
        [T_LOGIT] = {"logit", 1, {n}, G_LOGIT},
        [T_SH] = {"sh", 3, {d * d, 3, n}, G_SH},
        [T_TONE] = {"tone", 2, {3, TONE_PER_COLOUR}, -1},
        [T_MID] = {"mid_log2t", 1, {1}, -1},
        [T_BACKGROUND] = {"background", 1, {3}, -1},
        [T_LOG2T] = {"log2t", 1, {v}, -1},
        [T_CAMERAS] = {"cameras", 2, {v, CAMERA_FLOATS}, -1},
        [T_CONFIDENCE] = {"confidence", 1, {n}, -1},
    };
    memcpy(out, specs, sizeof specs);
}

/* Floats of a tensor. No overflow: shapes are within the limits of step 3 before anyone asks. */
static size_t count_floats(const struct spec *t)
{
    size_t n = 1;
    for (int k = 0; k < t->rank; k++)
        n *= t->shape[k];
    return n;
}

static void pack_camera(const struct camera *c, float out[CAMERA_FLOATS])
{
    const float v[CAMERA_FLOATS] = {c->fx,   c->fy,   c->cx,   c->cy,   c->q[0], c->q[1],
                                    c->q[2], c->q[3], c->t[0], c->t[1], c->t[2]};
    memcpy(out, v, sizeof v);
}

/* w and h are set already. */
static void unpack_camera(const float v[CAMERA_FLOATS], struct camera *c)
{
    *c = (struct camera){
        c->w, c->h, v[0], v[1], v[2], v[3], {v[4], v[5], v[6], v[7]}, {v[8], v[9], v[10]}};
}

/* ---- writing ---- */

/* The list of names as JSON inside a JSON string; own: free. NULL if there is no memory. */
static char *names_text(const struct scene *s)
{
    char *text = NULL;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    if (!f)
        return NULL;
    putc('[', f);
    for (int i = 0; i < s->n_views; i++) {
        if (i > 0)
            putc(',', f);
        json_put_string(f, s->names[i]);
    }
    putc(']', f);
    bool bad = ferror(f);
    if (fclose(f) == 0 && !bad)
        return text;
    free(text);
    return NULL;
}

static bool has_squares(const struct scene *s)
{
    for (int i = 0; i < s->n_views; i++)
        if (s->cams[i].w != s->size || s->cams[i].h != s->size)
            return false;
    return true;
}

/* Shapes of the views as a JSON list; own: free. NULL if there is no memory. */
static char *shapes_text(const struct scene *s)
{
    const size_t cap = 24 * (size_t)s->n_views + 3;
    char *text = malloc(cap);
    size_t n = 0;
    for (int i = 0; i < s->n_views && text; i++)
        n += (size_t)snprintf(text + n, cap - n, "%c%d,%d", i ? ',' : '[', s->cams[i].w,
                              s->cams[i].h);
    if (text)
        snprintf(text + n, cap - n, "]");
    return text;
}

/* err:  ERR_NOMEM. */
static err_t put_header(FILE *f, const char *path, const struct scene *s,
                        const struct spec specs[N_TENSORS])
{
    struct safetensors_writer h;
    char size[16];
    const bool squares = has_squares(s);
    char *names = names_text(s), *shapes = squares ? NULL : shapes_text(s);
    const bool whole = names && (squares || shapes);
    snprintf(size, sizeof size, "%d", s->size);
    safetensors_begin(&h);
    safetensors_put_word(&h, "format", FORMAT_NAME);
    safetensors_put_word(&h, "version", FORMAT_VERSION);
    safetensors_put_word(&h, "size", size);
    safetensors_put_word(&h, "names", names ? names : "");
    if (shapes)
        safetensors_put_word(&h, "shapes", shapes);
    if (s->metres)
        safetensors_put_word(&h, "unit", "m");
    for (int k = 0; k < N_TENSORS; k++) {
        if (k == T_CONFIDENCE && !s->confidence)
            continue;
        struct safetensors_tensor t = {.name = specs[k].name, .type = "F32", .rank = specs[k].rank};
        memcpy(t.shape, specs[k].shape, sizeof specs[k].shape);
        safetensors_put(&h, &t);
    }
    err_t e = safetensors_end(&h, whole ? f : NULL);
    if (!whole || e)
        e = err_fail(ERR_NOMEM, "%s: no memory for the header of %d views", path, s->n_views);
    free(names);
    free(shapes);
    return e;
}

static void put_floats(FILE *f, const float *v, size_t n)
{
    if (n > 0)
        fwrite(v, sizeof *v, n, f);
}

static void put_data(FILE *f, const struct scene *s)
{
    for (int p = 0; p < gaussians_planes(s->g.degree); p++)
        put_floats(f, s->g.plane[p], (size_t)s->g.n);
    put_floats(f, s->tone.p, TONE_PARAMS);
    put_floats(f, &s->tone.mid_log2t, 1);
    put_floats(f, s->background, 3);
    put_floats(f, s->log2t, (size_t)s->n_views);
    for (int i = 0; i < s->n_views; i++) {
        float v[CAMERA_FLOATS];
        pack_camera(&s->cams[i], v);
        put_floats(f, v, CAMERA_FLOATS);
    }
    if (s->confidence)
        put_floats(f, s->confidence, (size_t)s->g.n);
}

err_t scenefile_write(const char *path, const struct scene *s)
{
    struct scenefile_info info = {.n = s->g.n, .degree = s->g.degree, .n_views = s->n_views};
    struct spec specs[N_TENSORS];
    FILE *f;
    err_t e = splats_check_finite(path, &s->g);
    if (e)
        return e;
    make_specs(&info, specs);
    e = file_create(path, &f);
    if (e)
        return e;
    e = put_header(f, path, s, specs);
    if (e) {
        file_discard(f, path);
        return e;
    }
    put_data(f, s);
    return file_finish(f, path);
}

/* ---- reading the header ---- */

struct layout {
    struct scenefile_info info;
    struct spec specs[N_TENSORS];
    struct safetensors head;
    const uint8_t *at[N_TENSORS]; // data; NULL: not there
};

static err_t get_metadata(struct layout *l)
{
    const char *what = l->head.what, *format = safetensors_word(&l->head, "format"),
               *version = safetensors_word(&l->head, "version"),
               *size = safetensors_word(&l->head, "size");
    if (strcmp(format, FORMAT_NAME) != 0)
        return err_fail(ERR_FORMAT, "%s: not a scene: its format is \"%.32s\"", what, format);
    if (strcmp(version, FORMAT_VERSION) != 0)
        return err_fail(ERR_UNSUPPORTED, "%s: scene of version \"%.32s\", this program reads %s",
                        what, version, FORMAT_VERSION);
    char *end;
    long px = strtol(size, &end, 10);
    if (px < 1 || px > SIZE_LIMIT_PX || *end)
        return err_fail(ERR_FORMAT, "%s: size \"%.32s\", allowed are 1 to %d px", what, size,
                        SIZE_LIMIT_PX);
    l->info.size = (int)px;
    return OK;
}

/* The tensors of the table and no others: the container has none twice. */
static err_t check_members(const struct layout *l)
{
    const struct safetensors *head = &l->head;
    for (int i = 0; i < head->n; i++) {
        int k = 0;
        while (k < N_TENSORS && strcmp(l->specs[k].name, head->tensors[i].name) != 0)
            k++;
        if (k == N_TENSORS)
            return err_fail(ERR_FORMAT, "%s: unknown tensor %.64s", head->what,
                            head->tensors[i].name);
    }
    for (int k = 0; k < N_TENSORS; k++) {
        const struct safetensors_tensor *t = safetensors_find(head, l->specs[k].name);
        if (!t && k == T_CONFIDENCE)
            continue;
        if (!t)
            return err_fail(ERR_FORMAT, "%s: tensor %s is missing", head->what, l->specs[k].name);
        if (strcmp(t->type, "F32") != 0)
            return err_fail(ERR_FORMAT, "%s: tensor %s is not F32", head->what, t->name);
        if (t->rank != l->specs[k].rank)
            return err_fail(ERR_FORMAT, "%s: tensor %s has %d extents, it must have %d", head->what,
                            t->name, t->rank, l->specs[k].rank);
    }
    return OK;
}

/* Numbers of splats, coefficients and views from the shapes of sh and cameras. */
static err_t get_counts(struct layout *l)
{
    const char *what = l->head.what;
    const size_t *sh = safetensors_find(&l->head, "sh")->shape;
    size_t views = safetensors_find(&l->head, "cameras")->shape[0], degree = 0;
    if (sh[2] > GAUSSIANS_MAX || views > CAMERAS_MAX)
        return err_fail(ERR_FORMAT, "%s: %zu splats and %zu views, at most %d and %d are read",
                        what, sh[2], views, GAUSSIANS_MAX, CAMERAS_MAX);
    while (degree < SH_DEGREE_MAX && (degree + 1) * (degree + 1) != sh[0])
        degree++;
    if ((degree + 1) * (degree + 1) != sh[0])
        return err_fail(ERR_FORMAT, "%s: %zu harmonics, no degree of 0 to %d has as many", what,
                        sh[0], SH_DEGREE_MAX);
    l->info.n = (int)sh[2];
    l->info.degree = (int)degree;
    l->info.n_views = (int)views;
    return OK;
}

static err_t check_shapes(const struct layout *l)
{
    for (int k = 0; k < N_TENSORS; k++) {
        const struct safetensors_tensor *t = safetensors_find(&l->head, l->specs[k].name);
        for (int d = 0; t && d < t->rank; d++)
            if (t->shape[d] != l->specs[k].shape[d])
                return err_fail(ERR_FORMAT,
                                "%s: tensor %s: extent %d is %zu, the other tensors need %zu",
                                l->head.what, t->name, d, t->shape[d], l->specs[k].shape[d]);
    }
    return OK;
}

err_t scenefile_alloc_views(struct arena *a, int n_views, struct scene *s)
{
    const size_t n = (size_t)n_views;
    err_t e = arena_zalloc(a, n, NAME_CAP, &s->names);
    if (!e)
        e = arena_zalloc(a, n, sizeof *s->log2t, &s->log2t);
    if (!e)
        e = arena_zalloc(a, n, sizeof *s->cams, &s->cams);
    return e;
}

size_t scenefile_views_need(int n_views)
{
    struct arena count = arena_counter();
    struct scene s;
    return scenefile_alloc_views(&count, n_views, &s) ? SIZE_MAX : count.peak;
}

/* Steps 1 to 3. own: safetensors_close(&l->head). */
static err_t open_header(const struct scenefile_bytes *f, struct layout *l)
{
    memset(l, 0, sizeof *l);
    err_t e = safetensors_open(f->what, f->p, f->n, f->n, &l->head);
    if (e)
        return e;
    make_specs(&l->info, l->specs); // names and ranks
    e = get_metadata(l);
    if (!e)
        e = check_members(l);
    if (!e)
        e = get_counts(l);
    make_specs(&l->info, l->specs);
    if (!e)
        e = check_shapes(l);
    if (e) {
        safetensors_close(&l->head);
        return e;
    }
    for (int k = 0; k < N_TENSORS; k++) {
        const struct safetensors_tensor *t = safetensors_find(&l->head, l->specs[k].name);
        l->at[k] = t ? (const uint8_t *)f->p + l->head.data + t->begin : NULL;
    }
    l->info.need =
        arena_add(gaussians_need(l->info.n, l->info.degree), scenefile_views_need(l->info.n_views));
    if (l->at[T_CONFIDENCE])
        l->info.need = arena_add(l->info.need, arena_need((size_t)l->info.n, sizeof(float)));
    return OK;
}

/* ---- reading the data ---- */

static void get_floats(const struct layout *l, int k, size_t first, size_t n, float *out)
{
    if (n > 0)
        memcpy(out, l->at[k] + first * sizeof(float), n * sizeof(float));
}

static err_t get_splats(const struct scenefile_bytes *f, const struct layout *l, struct arena *a,
                        struct gaussians *g)
{
    err_t e = gaussians_init(g, a, l->info.n, l->info.degree);
    if (e)
        return e;
    size_t n = (size_t)l->info.n;
    for (int k = 0; k < N_TENSORS; k++)
        for (size_t p = 0; l->specs[k].plane >= 0 && n > 0 && p < count_floats(&l->specs[k]) / n;
             p++)
            get_floats(l, k, p * n, n, g->plane[(size_t)l->specs[k].plane + p]);
    g->n = l->info.n;
    struct gaussians_report report;
    gaussians_sanitize(g, &report);
    if (report.dropped > 0)
        return err_fail(ERR_FORMAT, "%s: %d of %d splats are not finite", f->what, report.dropped,
                        l->info.n);
    return OK;
}

static err_t get_globals(const struct scenefile_bytes *f, const struct layout *l, struct scene *s)
{
    get_floats(l, T_TONE, 0, TONE_PARAMS, s->tone.p);
    get_floats(l, T_MID, 0, 1, &s->tone.mid_log2t);
    get_floats(l, T_BACKGROUND, 0, 3, s->background);
    for (int i = 0; i < TONE_PARAMS; i++)
        if (!isfinite(s->tone.p[i]))
            return err_fail(ERR_FORMAT, "%s: tone parameter %d is not finite", f->what, i);
    if (!isfinite(s->tone.mid_log2t))
        return err_fail(ERR_FORMAT, "%s: mid_log2t is not finite", f->what);
    for (int c = 0; c < 3; c++)
        if (!isfinite(s->background[c]) || s->background[c] < 0)
            return err_fail(ERR_FORMAT, "%s: background %d is %g, must be finite and >= 0", f->what,
                            c, (double)s->background[c]);
    return OK;
}

static err_t get_names(const struct scenefile_bytes *f, const struct layout *l, struct scene *s)
{
    const char *text = safetensors_word(&l->head, "names");
    struct cJSON *list;
    err_t e = json_parse(f->what, text, strlen(text), &list);
    if (e)
        return e;
    int i = 0;
    if (!json_is_array(list) || json_count(list) != s->n_views)
        e = err_fail(ERR_FORMAT, "%s: names is not a list of %d strings", f->what, s->n_views);
    for (const struct cJSON *v = e ? NULL : json_first(list); v && !e; v = json_next(v), i++) {
        const char *name = json_string(v) ? json_string(v) : "";
        e = name_copy(f->what, name, strlen(name), s->names[i]);
        for (int j = 0; j < i && !e; j++)
            if (strcmp(s->names[i], s->names[j]) == 0)
                e = err_fail(ERR_FORMAT, "%s: view %s is there twice", f->what, s->names[i]);
    }
    json_free(list);
    return e;
}

static err_t get_shapes(const struct scenefile_bytes *f, const struct layout *l, struct scene *s)
{
    const char *text = safetensors_word(&l->head, "shapes");
    struct cJSON *list = NULL;
    err_t e = *text ? json_parse(f->what, text, strlen(text), &list) : OK;
    for (int i = 0; i < s->n_views; i++)
        s->cams[i].w = s->cams[i].h = s->size;
    if (!e && *text && (!json_is_array(list) || json_count(list) != 2 * s->n_views))
        e = err_fail(ERR_FORMAT, "%s: shapes is not a list of %d numbers", f->what, 2 * s->n_views);
    int i = 0;
    for (const struct cJSON *v = e || !list ? NULL : json_first(list); v && !e; v = json_next(v)) {
        double px = 0;
        if (!json_number(v, &px) || px != floor(px) || px < 1 || px > s->size)
            e = err_fail(ERR_FORMAT, "%s: a shape of view %d is no whole number from 1 to %d",
                         f->what, i / 2, s->size);
        *(i % 2 ? &s->cams[i / 2].h : &s->cams[i / 2].w) = (int)px;
        i++;
    }
    json_free(list);
    return e;
}

static err_t get_views(const struct scenefile_bytes *f, const struct layout *l, struct arena *a,
                       struct scene *s)
{
    size_t n = (size_t)l->info.n_views;
    err_t e = scenefile_alloc_views(a, l->info.n_views, s);
    if (e)
        return e;
    s->n_views = l->info.n_views;
    s->size = l->info.size;
    s->metres = strcmp(safetensors_word(&l->head, "unit"), "m") == 0;
    get_floats(l, T_LOG2T, 0, n, s->log2t);
    e = get_shapes(f, l, s);
    for (size_t i = 0; i < n && !e; i++) {
        float v[CAMERA_FLOATS];
        char name[32];
        snprintf(name, sizeof name, "view %zu", i);
        if (!isfinite(s->log2t[i]))
            return err_fail(ERR_FORMAT, "%s: %s: exposure is not finite", f->what, name);
        get_floats(l, T_CAMERAS, i * CAMERA_FLOATS, CAMERA_FLOATS, v);
        unpack_camera(v, &s->cams[i]);
        e = cameras_check(f->what, name, &s->cams[i]);
    }
    return e;
}

static err_t get_confidence(const struct scenefile_bytes *f, const struct layout *l,
                            struct arena *a, struct scene *s)
{
    const size_t n = (size_t)l->info.n;
    if (!l->at[T_CONFIDENCE])
        return OK;
    err_t e = arena_alloc(a, n, sizeof *s->confidence, &s->confidence);
    if (!e)
        get_floats(l, T_CONFIDENCE, 0, n, s->confidence);
    for (size_t i = 0; i < n && !e; i++)
        if (!(s->confidence[i] >= 0 && s->confidence[i] <= 1))
            e = err_fail(ERR_FORMAT, "%s: confidence of splat %zu is %g, must be 0 to 1", f->what,
                         i, (double)s->confidence[i]);
    return e;
}

err_t scenefile_parse(const struct scenefile_bytes *file, struct arena *a, struct scene *s)
{
    struct layout l;
    size_t mark = arena_mark(a);
    memset(s, 0, sizeof *s);
    err_t e = open_header(file, &l);
    if (e)
        return e;
    e = get_splats(file, &l, a, &s->g);
    if (!e)
        e = get_globals(file, &l, s);
    if (!e)
        e = get_views(file, &l, a, s);
    if (!e)
        e = get_names(file, &l, s);
    if (!e)
        e = get_confidence(file, &l, a, s);
    safetensors_close(&l.head);
    if (e) {
        arena_reset(a, mark);
        memset(s, 0, sizeof *s);
    }
    return e;
}

err_t scenefile_peek_bytes(const struct scenefile_bytes *file, struct scenefile_info *out)
{
    struct layout l;
    memset(out, 0, sizeof *out);
    err_t e = open_header(file, &l);
    if (e)
        return e;
    safetensors_close(&l.head);
    *out = l.info;
    return OK;
}

err_t scenefile_read(const char *path, struct arena *a, struct scene *s)
{
    struct file_map m;
    memset(s, 0, sizeof *s);
    err_t e = file_map(path, FILE_BYTES_MAX, &m);
    if (e)
        return e;
    e = scenefile_parse(&(struct scenefile_bytes){path, m.p, m.n}, a, s);
    file_unmap(&m);
    return e;
}

err_t scenefile_peek(const char *path, struct scenefile_info *out)
{
    struct file_map m;
    memset(out, 0, sizeof *out);
    err_t e = file_map(path, FILE_BYTES_MAX, &m);
    if (e)
        return e;
    e = scenefile_peek_bytes(&(struct scenefile_bytes){path, m.p, m.n}, out);
    file_unmap(&m);
    return e;
}

/* ---- tone.json ---- */

static void put_numbers(FILE *f, const char *key, const float *v, int n)
{
    fprintf(f, ", \"%s\": [", key);
    for (int i = 0; i < n; i++)
        fprintf(f, i ? ", %.9g" : "%.9g", (double)v[i]);
    putc(']', f);
}

static void put_samples(FILE *f, const struct tonemap *tone)
{
    enum { HALF_STOPS = 24 }; // on each side of the middle
    struct tonemap_table table;
    tonemap_table_init(&table, tone);
    for (int i = -HALF_STOPS; i <= HALF_STOPS; i++) {
        float x = 0.5f * (float)i, one = 1 - TONEMAP_FLOOR, rgb[3];
        for (int c = 0; c < 3; c++)
            tonemap_run(&table.c[c], &one, x, 1, &rgb[c]);
        fprintf(f, "    {\"log2_exposure_relative\": %g, \"rgb\": [%.6f, %.6f, %.6f]}%s\n",
                (double)x, (double)rgb[0], (double)rgb[1], (double)rgb[2],
                i < HALF_STOPS ? "," : "");
    }
}

err_t scenefile_write_tone(const char *path, const struct tonemap *tone)
{
    static const char *const colours[3] = {"red", "green", "blue"};
    FILE *f;
    err_t e = file_create(path, &f);
    if (e)
        return e;
    fprintf(
        f,
        "{\n  \"formula\": \"display = 1 / (1 + exp(-(b2 + sum_k w2[k] max(0, w1[k] x + b1[k])))), "
        "x = log2(radiance + 1e-6) + log2(t) - mid_log2t\",\n  \"mid_log2t\": %.9g,\n  \"curves\": "
        "[\n",
        (double)tone->mid_log2t);
    for (int c = 0; c < 3; c++) {
        const float *p = tone->p + c * TONE_PER_COLOUR;
        fprintf(f, "    {\"colour\": \"%s\"", colours[c]);
        put_numbers(f, "w1", p, TONE_HIDDEN);
        put_numbers(f, "b1", p + TONE_HIDDEN, TONE_HIDDEN);
        put_numbers(f, "w2", p + 2 * TONE_HIDDEN, TONE_HIDDEN);
        fprintf(f, ", \"b2\": %.9g}%s\n", (double)p[3 * TONE_HIDDEN], c < 2 ? "," : "");
    }
    fputs("  ],\n  \"samples\": [\n", f);
    put_samples(f, tone);
    fputs("  ]\n}\n", f);
    return file_finish(f, path);
}
