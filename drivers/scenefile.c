/* One table (make_specs) says what tensors a scene has and where they live in struct scene; writer
 * and reader both walk it. The reader first builds a struct layout from the header, checked
 * completely, and only then takes memory. */
#include "drivers/scenefile.h"

#include "core/base/bytes.h"
#include "core/net/tonemap.h"
#include "core/splat/gaussians.h"
#include "drivers/cameras.h"
#include "drivers/file.h"
#include "drivers/json.h"
#include "drivers/name.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "floats are copied as they are");

enum { CAMERA_FLOATS = 11, DATA_ALIGN = 64, SIZE_LIMIT_PX = 65536 };

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
    };
    memcpy(out, specs, sizeof specs);
}

/* Floats of a tensor. No overflow: shapes are within the limits of step 6 before anyone asks. */
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

static struct camera unpack_camera(const float v[CAMERA_FLOATS], int size)
{
    return (struct camera){
        size, size, v[0], v[1], v[2], v[3], {v[4], v[5], v[6], v[7]}, {v[8], v[9], v[10]}};
}

/* ---- writing ---- */

static err_t check_finite(const char *path, const struct gaussians *g)
{
    for (int p = 0; p < gaussians_planes(g->degree); p++)
        for (int i = 0; i < g->n; i++)
            if (!isfinite(g->plane[p][i]))
                return err_fail(ERR_ARG, "%s: splat %d of %d: plane %d is %g, not finite", path, i,
                                g->n, p, (double)g->plane[p][i]);
    return OK;
}

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

static void put_header(FILE *f, const struct scene *s, const char *names,
                       const struct spec specs[N_TENSORS])
{
    fprintf(f, "{\"__metadata__\":{\"format\":\"%s\",\"version\":\"%s\",\"size\":\"%d\",\"names\":",
            FORMAT_NAME, FORMAT_VERSION, s->size);
    json_put_string(f, names);
    putc('}', f);
    size_t at = 0;
    for (int k = 0; k < N_TENSORS; k++) {
        size_t n = count_floats(&specs[k]) * sizeof(float);
        fprintf(f, ",\"%s\":{\"dtype\":\"F32\",\"shape\":[", specs[k].name);
        for (int d = 0; d < specs[k].rank; d++)
            fprintf(f, d ? ",%zu" : "%zu", specs[k].shape[d]);
        fprintf(f, "],\"data_offsets\":[%zu,%zu]}", at, at + n);
        at += n;
    }
    putc('}', f);
}

/* The header with blanks after it up to DATA_ALIGN; own: free. */
static err_t header_text(const char *path, const struct scene *s,
                         const struct spec specs[N_TENSORS], char **out, size_t *n)
{
    *out = NULL;
    char *names = names_text(s);
    FILE *f = names ? open_memstream(out, n) : NULL;
    bool bad = !f;
    if (f) {
        put_header(f, s, names, specs);
        for (long at = ftell(f); (at + 8) % DATA_ALIGN != 0; at++)
            putc(' ', f);
        bad = ferror(f);
        bad |= fclose(f) != 0 || !*out; // glibc: a failed last growth leaves NULL and returns 0
    }
    free(names);
    if (!bad)
        return OK;
    free(*out);
    *out = NULL;
    return err_fail(ERR_NOMEM, "%s: no memory for the header of %d views", path, s->n_views);
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
}

err_t scenefile_write(const char *path, const struct scene *s)
{
    struct scenefile_info info = {.n = s->g.n, .degree = s->g.degree, .n_views = s->n_views};
    struct spec specs[N_TENSORS];
    FILE *f;
    char *header;
    size_t n;
    err_t e = check_finite(path, &s->g);
    if (e)
        return e;
    make_specs(&info, specs);
    e = header_text(path, s, specs, &header, &n);
    if (e)
        return e;
    e = file_create(path, &f);
    if (!e) {
        uint8_t length[8];
        bytes_put_u64(length, n);
        fwrite(length, 1, sizeof length, f);
        fwrite(header, 1, n, f);
        put_data(f, s);
        e = file_finish(f, path);
    }
    free(header);
    return e;
}

/* ---- reading the header ---- */

struct layout {
    struct scenefile_info info;
    struct spec specs[N_TENSORS];
    size_t begin[N_TENSORS], end[N_TENSORS]; // bytes in data
    const uint8_t *data;
    size_t n_data;
};

static err_t get_whole(const struct scenefile_bytes *f, const struct cJSON *v, const char *what,
                       double max, size_t *out)
{
    double number;
    if (!json_number(v, &number) || number < 0 || number != floor(number))
        return err_fail(ERR_FORMAT, "%s: %s is not a whole number", f->what, what);
    if (number > max)
        return err_fail(ERR_FORMAT, "%s: %s is %.0f, at most %.0f is read", f->what, what, number,
                        max);
    *out = (size_t)number;
    return OK;
}

/* A list of n whole numbers up to max. */
static err_t get_list(const struct scenefile_bytes *f, const struct cJSON *tensor, const char *key,
                      int n, double max, size_t *out)
{
    const struct cJSON *list = json_member(tensor, key);
    if (!json_is_array(list) || json_count(list) != n)
        return err_fail(ERR_FORMAT, "%s: tensor %s: \"%s\" is not a list of %d numbers", f->what,
                        json_key(tensor), key, n);
    for (const struct cJSON *v = json_first(list); v; v = json_next(v)) {
        err_t e = get_whole(f, v, json_key(tensor), max, out++);
        if (e)
            return e;
    }
    return OK;
}

static err_t get_metadata(const struct scenefile_bytes *f, const struct cJSON *doc,
                          struct layout *l)
{
    const struct cJSON *meta = json_member(doc, "__metadata__");
    const char *format = json_string(json_member(meta, "format"));
    const char *version = json_string(json_member(meta, "version"));
    const char *size = json_string(json_member(meta, "size"));
    if (!format || strcmp(format, FORMAT_NAME) != 0)
        return err_fail(ERR_FORMAT, "%s: not a scene: its format is \"%.32s\"", f->what,
                        format ? format : "");
    if (!version || strcmp(version, FORMAT_VERSION) != 0)
        return err_fail(ERR_UNSUPPORTED, "%s: scene of version \"%.32s\", this program reads %s",
                        f->what, version ? version : "", FORMAT_VERSION);
    char *end = NULL;
    long px = size ? strtol(size, &end, 10) : 0;
    if (px < 1 || px > SIZE_LIMIT_PX || *end)
        return err_fail(ERR_FORMAT, "%s: size \"%.32s\", allowed are 1 to %d px", f->what,
                        size ? size : "", SIZE_LIMIT_PX);
    l->info.size = (int)px;
    return OK;
}

/* Exactly the tensors of the table, each once. */
static err_t check_members(const struct scenefile_bytes *f, const struct cJSON *doc,
                           const struct layout *l)
{
    unsigned seen = 0;
    for (const struct cJSON *m = json_first(doc); m; m = json_next(m)) {
        int k = 0;
        while (k < N_TENSORS && strcmp(l->specs[k].name, json_key(m)) != 0)
            k++;
        if (k == N_TENSORS && strcmp(json_key(m), "__metadata__") != 0)
            return err_fail(ERR_FORMAT, "%s: unknown tensor %.64s", f->what, json_key(m));
        if (seen & 1u << k)
            return err_fail(ERR_FORMAT, "%s: %s is there twice", f->what, json_key(m));
        seen |= 1u << k;
    }
    for (int k = 0; k < N_TENSORS; k++)
        if (!(seen & 1u << k))
            return err_fail(ERR_FORMAT, "%s: tensor %s is missing", f->what, l->specs[k].name);
    return OK;
}

/* Numbers of splats, coefficients and views from the shapes of sh and cameras. */
static err_t get_counts(const struct scenefile_bytes *f, const struct cJSON *doc, struct layout *l)
{
    size_t sh[3], cameras[2];
    err_t e = get_list(f, json_member(doc, "sh"), "shape", 3, GAUSSIANS_MAX, sh);
    if (!e)
        e = get_list(f, json_member(doc, "cameras"), "shape", 2, CAMERAS_MAX, cameras);
    if (e)
        return e;
    size_t degree = 0;
    while (degree < SH_DEGREE_MAX && (degree + 1) * (degree + 1) != sh[0])
        degree++;
    if ((degree + 1) * (degree + 1) != sh[0])
        return err_fail(ERR_FORMAT, "%s: %zu harmonics, no degree of 0 to %d has as many", f->what,
                        sh[0], SH_DEGREE_MAX);
    l->info.n = (int)sh[2];
    l->info.degree = (int)degree;
    l->info.n_views = (int)cameras[0];
    return OK;
}

static err_t get_tensor(const struct scenefile_bytes *f, const struct cJSON *tensor, int k,
                        struct layout *l)
{
    const struct spec *spec = &l->specs[k];
    const char *dtype = json_string(json_member(tensor, "dtype"));
    size_t shape[3], offsets[2];
    if (!dtype || strcmp(dtype, "F32") != 0 || json_count(tensor) != 3)
        return err_fail(ERR_FORMAT, "%s: tensor %s is not F32 with dtype, shape and data_offsets",
                        f->what, spec->name);
    err_t e = get_list(f, tensor, "shape", spec->rank, GAUSSIANS_MAX, shape);
    if (!e)
        e = get_list(f, tensor, "data_offsets", 2, (double)FILE_BYTES_MAX, offsets);
    if (e)
        return e;
    for (int d = 0; d < spec->rank; d++)
        if (shape[d] != spec->shape[d])
            return err_fail(ERR_FORMAT,
                            "%s: tensor %s: extent %d is %zu, the other tensors need %zu", f->what,
                            spec->name, d, shape[d], spec->shape[d]);
    size_t bytes = count_floats(spec) * sizeof(float);
    if (offsets[1] > l->n_data || offsets[0] > offsets[1] || offsets[1] - offsets[0] != bytes)
        return err_fail(ERR_FORMAT,
                        "%s: tensor %s: data from %zu to %zu of %zu bytes, its shape needs %zu",
                        f->what, spec->name, offsets[0], offsets[1], l->n_data, bytes);
    l->begin[k] = offsets[0];
    l->end[k] = offsets[1];
    return OK;
}

/* Each tensor must begin where another ends: with the right total no overlap or hole is left. */
static err_t check_tiling(const struct scenefile_bytes *f, const struct layout *l)
{
    bool done[N_TENSORS] = {false};
    size_t at = 0;
    for (int turn = 0; turn < N_TENSORS; turn++) {
        int next = -1;
        for (int k = 0; k < N_TENSORS; k++)
            if (!done[k] && l->begin[k] == at && (next < 0 || l->end[k] < l->end[next]))
                next = k; // empty ones first
        if (next < 0)
            return err_fail(ERR_FORMAT,
                            "%s: no tensor begins at byte %zu of the data: overlap or hole",
                            f->what, at);
        done[next] = true;
        at = l->end[next];
    }
    if (at != l->n_data)
        return err_fail(ERR_FORMAT, "%s: the tensors end at byte %zu of %zu bytes of data", f->what,
                        at, l->n_data);
    return OK;
}

static err_t read_layout(const struct scenefile_bytes *f, const struct cJSON *doc, struct layout *l)
{
    make_specs(&l->info, l->specs);
    err_t e = get_metadata(f, doc, l);
    if (!e)
        e = check_members(f, doc, l);
    if (!e)
        e = get_counts(f, doc, l);
    if (e)
        return e;
    make_specs(&l->info, l->specs);
    for (int k = 0; k < N_TENSORS && !e; k++)
        e = get_tensor(f, json_member(doc, l->specs[k].name), k, l);
    if (!e)
        e = check_tiling(f, l);
    size_t v = (size_t)l->info.n_views, need = gaussians_need(l->info.n, l->info.degree);
    need = arena_add(need, arena_need(v, NAME_CAP));
    need = arena_add(need, arena_need(v, sizeof(float)));
    l->info.need = arena_add(need, arena_need(v, sizeof(struct camera)));
    return e;
}

/* Steps 1 to 8. own: json_free(*doc). */
static err_t open_header(const struct scenefile_bytes *f, struct layout *l, struct cJSON **doc)
{
    memset(l, 0, sizeof *l);
    *doc = NULL;
    struct bytes b = bytes_of(f->p, f->n);
    uint64_t n = bytes_u64(&b);
    if (b.bad || n > JSON_BYTES_MAX || n > b.left)
        return err_fail(ERR_FORMAT, "%s: header of %ju bytes in a file of %zu, at most %d are read",
                        f->what, (uintmax_t)n, f->n, JSON_BYTES_MAX);
    err_t e = json_parse(f->what, bytes_take(&b, n), n, doc);
    if (e)
        return e;
    l->data = b.p;
    l->n_data = b.left;
    e = read_layout(f, *doc, l);
    if (e) {
        json_free(*doc);
        *doc = NULL;
    }
    return e;
}

/* ---- reading the data ---- */

static void get_floats(const struct layout *l, int k, size_t first, size_t n, float *out)
{
    if (n > 0)
        memcpy(out, l->data + l->begin[k] + first * sizeof(float), n * sizeof(float));
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

static err_t get_names(const struct scenefile_bytes *f, const struct cJSON *doc, struct scene *s)
{
    const char *text = json_string(json_member(json_member(doc, "__metadata__"), "names"));
    struct cJSON *list;
    err_t e = json_parse(f->what, text ? text : "", text ? strlen(text) : 0, &list);
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

static err_t get_views(const struct scenefile_bytes *f, const struct layout *l, struct arena *a,
                       struct scene *s)
{
    size_t n = (size_t)l->info.n_views;
    err_t e = arena_zalloc(a, n, NAME_CAP, &s->names);
    if (!e)
        e = arena_zalloc(a, n, sizeof *s->log2t, &s->log2t);
    if (!e)
        e = arena_zalloc(a, n, sizeof *s->cams, &s->cams);
    if (e)
        return e;
    s->n_views = l->info.n_views;
    s->size = l->info.size;
    get_floats(l, T_LOG2T, 0, n, s->log2t);
    for (size_t i = 0; i < n && !e; i++) {
        float v[CAMERA_FLOATS];
        char name[32];
        snprintf(name, sizeof name, "view %zu", i);
        if (!isfinite(s->log2t[i]))
            return err_fail(ERR_FORMAT, "%s: %s: exposure is not finite", f->what, name);
        get_floats(l, T_CAMERAS, i * CAMERA_FLOATS, CAMERA_FLOATS, v);
        s->cams[i] = unpack_camera(v, s->size);
        e = cameras_check(f->what, name, &s->cams[i]);
    }
    return e;
}

err_t scenefile_parse(const struct scenefile_bytes *file, struct arena *a, struct scene *s)
{
    struct layout l;
    struct cJSON *doc;
    size_t mark = arena_mark(a);
    memset(s, 0, sizeof *s);
    err_t e = open_header(file, &l, &doc);
    if (e)
        return e;
    e = get_splats(file, &l, a, &s->g);
    if (!e)
        e = get_globals(file, &l, s);
    if (!e)
        e = get_views(file, &l, a, s);
    if (!e)
        e = get_names(file, doc, s);
    json_free(doc);
    if (e) {
        arena_reset(a, mark);
        memset(s, 0, sizeof *s);
    }
    return e;
}

err_t scenefile_peek_bytes(const struct scenefile_bytes *file, struct scenefile_info *out)
{
    struct layout l;
    struct cJSON *doc;
    memset(out, 0, sizeof *out);
    err_t e = open_header(file, &l, &doc);
    if (e)
        return e;
    json_free(doc);
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
