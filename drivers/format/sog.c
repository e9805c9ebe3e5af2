/* Pictures are decoded one after the other, each straight into the planes that it tells of; only
 * the centroids stay until the labels are there. */
#include "drivers/format/sog.h"

#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/name.h"
#include "drivers/format/webp.h"
#include "drivers/format/zipfile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum picture { LOW, HIGH, SCALES, QUATS, SH0, CENTROIDS, LABELS, PICTURES };

enum {
    BYTES = 256, // values of one
    DEGREE_MAX = 3,
    IN_ROW = 64,                       // centroids
    CENTROIDS_PX_MAX = 15 * (1 << 16), // labels have 16 bits
    QUAT_TAG = 252,
    SPARE_PX = 1 << 16, // of a picture beyond four for each splat
    PX_BYTES = 8,       // a picture takes fewer for each pixel, by far
    WHAT_CAP = 256
};
#define SQRT1_2 0.70710678f

struct sog {
    const struct splats_bytes *file;
    struct zipfile zip; // of an archive
    int version, n, degree;
    float least[3], most[3];          // of means
    float values[PICTURES][4][BYTES]; // what a byte of a channel stands for
    char names[PICTURES][NAME_CAP];   // "": none
};

/* A file of the set, for as long as it is read. */
struct member {
    char what[FILE_PATH_CAP];
    size_t n;
    void *unpacked; // or:
    struct file_map map;
};

static const void *bytes_in(const struct member *m)
{
    return m->unpacked ? m->unpacked : m->map.p;
}

/* ---- files ---- */

static void close_member(struct member *m)
{
    free(m->unpacked);
    file_unmap(&m->map);
}

/* own: close_member, also on errors. */
static err_t open_member(const struct sog *s, const char *name, size_t max, struct member *m)
{
    char folder[FILE_PATH_CAP];
    uint64_t index;
    *m = (struct member){.n = 0};
    if (s->zip.zip) {
        snprintf(m->what, sizeof m->what, "%.3800s: %s", s->file->what, name);
        return zipfile_find(&s->zip, name, &index)
                   ? zipfile_load(&s->zip, index, max, &m->unpacked, &m->n)
                   : err_fail(ERR_FORMAT, "%s: not in the archive", m->what);
    }
    err_t e = file_parent(s->file->what, folder);
    if (!e)
        e = file_join(folder, name, m->what);
    if (!e)
        e = file_map(m->what, max, &m->map);
    m->n = m->map.n;
    return e;
}

/* Harmonics above the first, of one colour. */
static int harmonics(int degree)
{
    return degree * (degree + 2);
}

static size_t px_max(const struct sog *s, enum picture k)
{
    return k == CENTROIDS ? CENTROIDS_PX_MAX : 4 * (size_t)s->n + SPARE_PX;
}

/* own: free(out->px). */
static err_t read_picture(const struct sog *s, enum picture k, struct webp_picture *out)
{
    struct member m;
    *out = (struct webp_picture){0};
    err_t e = open_member(s, s->names[k], PX_BYTES * px_max(s, k), &m);
    if (!e)
        e = webp_read(m.what, bytes_in(&m), m.n, px_max(s, k), out);
    if (!e && k != CENTROIDS && (size_t)out->w * (size_t)out->h < (size_t)s->n)
        e = err_fail(ERR_FORMAT, "%s: %d x %d px for %d splats", m.what, out->w, out->h, s->n);
    close_member(&m);
    return e;
}

/* ---- meta.json ---- */

static err_t take_files(const char *where, const struct cJSON *object, int n,
                        char names[][NAME_CAP])
{
    const struct cJSON *files = json_member(object, "files");
    if (!json_is_array(files) || json_count(files) != n)
        return err_fail(ERR_FORMAT, "%s: no %d \"files\"", where, n);
    err_t e = OK;
    for (const struct cJSON *f = json_first(files); f && !e; f = json_next(f)) {
        const char *text = json_string(f);
        e = text ? name_copy(where, text, strlen(text), *names++)
                 : err_fail(ERR_FORMAT, "%s: \"files\" holds what is no name", where);
    }
    return e;
}

/* Writers of 2025 began with a null, which the engine takes for the next step below the others
 * (gsplat-sog-data of playcanvas 2.23). */
static err_t take_codebook(const char *where, const struct cJSON *object, float out[BYTES])
{
    const struct cJSON *array = json_member(object, "codebook");
    int i = 0;
    if (!json_is_array(array) || json_count(array) != BYTES)
        return err_fail(ERR_FORMAT, "%s: no \"codebook\" of %d numbers", where, BYTES);
    for (const struct cJSON *v = json_first(array); v; v = json_next(v)) {
        double number = NAN;
        if (!json_number(v, &number) && i > 0)
            return err_fail(ERR_FORMAT, "%s: \"codebook\" element %d is no number", where, i);
        out[i++] = (float)number;
    }
    if (isnan(out[0]))
        out[0] = out[1] + (out[1] - out[BYTES - 1]) / (BYTES - 1);
    return OK;
}

/* mins and maxs: of one channel a number each, of more an array. */
static err_t take_range(const char *where, const struct cJSON *object, int n, float *least,
                        float *most)
{
    if (n > 1) {
        err_t e = json_floats(where, object, "mins", n, least);
        return e ? e : json_floats(where, object, "maxs", n, most);
    }
    err_t e = json_float(where, object, "mins", least);
    return e ? e : json_float(where, object, "maxs", most);
}

/* What the bytes of n channels stand for. */
static err_t take_values(const char *where, const struct cJSON *object, int version, int n,
                         float out[][BYTES])
{
    float least[4], most[4];
    err_t e = version == 2 ? take_codebook(where, object, out[0])
                           : take_range(where, object, n, least, most);
    for (int c = 0; c < n && !e; c++)
        for (int b = 0; b < BYTES; b++)
            out[c][b] =
                version == 2 ? out[0][b] : least[c] + (most[c] - least[c]) * (float)b / (BYTES - 1);
    return e;
}

static err_t take_count(const char *what, const struct cJSON *doc, struct sog *s)
{
    const struct cJSON *version = json_member(doc, "version");
    double number = 1;
    float n[2] = {0};
    if (version && !json_number(version, &number))
        number = 0;
    if (number != 1 && number != 2)
        return err_fail(ERR_UNSUPPORTED, "%s: version %g of SOG, 1 and 2 are read", what, number);
    s->version = (int)number;
    err_t e = s->version == 2 ? json_float(what, doc, "count", n)
                              : json_floats(what, json_member(doc, "means"), "shape", 2, n);
    if (!e && (n[0] != floorf(n[0]) || n[0] < 0 || n[0] > GAUSSIANS_MAX))
        e = err_fail(ERR_FORMAT, "%s: %g splats, 0 to %d are read", what, (double)n[0],
                     GAUSSIANS_MAX);
    s->n = e ? 0 : (int)n[0];
    return e;
}

static err_t take_meta(const char *what, const struct cJSON *doc, void *out)
{
    static const struct {
        const char *key;
        enum picture first;
        int files, channels; // of values; 0: none
    } parts[] = {{"means", LOW, 2, 0},
                 {"scales", SCALES, 1, 3},
                 {"quats", QUATS, 1, 0},
                 {"sh0", SH0, 1, 4},
                 {"shN", CENTROIDS, 2, 1}};
    struct sog *s = out;
    err_t e = take_count(what, doc, s);
    for (size_t i = 0; i < sizeof parts / sizeof *parts && !e; i++) {
        char where[WHAT_CAP];
        const struct cJSON *object = json_member(doc, parts[i].key);
        if (!object && parts[i].first == CENTROIDS)
            break;
        snprintf(where, sizeof where, "%.200s: \"%s\"", what, parts[i].key);
        e = take_files(where, object, parts[i].files, &s->names[parts[i].first]);
        if (!e && parts[i].first == LOW)
            e = take_range(where, object, 3, s->least, s->most);
        if (!e && parts[i].channels > 0)
            e = take_values(where, object, s->version, parts[i].channels,
                            s->values[parts[i].first]);
    }
    for (int b = 0; b < BYTES && s->version == 2; b++)
        s->values[SH0][3][b] = splats_logit(b);
    return e;
}

static err_t read_meta(struct sog *s)
{
    struct member m;
    if (!s->zip.zip)
        return json_parse_with(s->file->what, s->file->p, s->file->n, take_meta, s);
    err_t e = open_member(s, SOG_META, JSON_BYTES_MAX, &m);
    if (!e)
        e = json_parse_with(m.what, m.unpacked, m.n, take_meta, s);
    close_member(&m);
    return e;
}

/* By the centroids, as the engine has it: not all writers tell it. */
static err_t find_degree(struct sog *s)
{
    struct member m;
    int w = 0, h;
    if (!s->names[CENTROIDS][0])
        return OK;
    err_t e = open_member(s, s->names[CENTROIDS], PX_BYTES * px_max(s, CENTROIDS), &m);
    if (!e)
        e = webp_size(m.what, bytes_in(&m), m.n, &w, &h);
    while (!e && s->degree <= DEGREE_MAX && IN_ROW * harmonics(s->degree) != w)
        s->degree++;
    if (!e && s->degree > DEGREE_MAX)
        e = err_fail(ERR_FORMAT, "%s: %d px wide, centroids are 192, 512 or 960", m.what, w);
    close_member(&m);
    return e;
}

/* own: zipfile_close(&s->zip), also on errors. */
static err_t open_sog(const struct splats_bytes *file, struct sog *s)
{
    *s = (struct sog){.file = file};
    const bool packed = file->n >= 2 && memcmp(file->p, "PK", 2) == 0;
    err_t e = packed ? zipfile_open_bytes(file->what, file->p, file->n, &s->zip) : OK;
    if (!e)
        e = read_meta(s);
    return e ? e : find_degree(s);
}

static err_t peek_sog(const struct splats_bytes *file, struct splats_info *out)
{
    struct sog s;
    memset(out, 0, sizeof *out);
    err_t e = open_sog(file, &s);
    zipfile_close(&s.zip);
    if (!e)
        *out = (struct splats_info){.n = s.n, .degree = s.degree};
    return e;
}

/* ---- pictures ---- */

/* What pixel p tells of splat i. */
typedef void take_fn(const struct sog *s, const uint8_t *p, int i, struct gaussians *g);

static void take_low(const struct sog *s, const uint8_t *p, int i, struct gaussians *g)
{
    (void)s;
    for (int k = 0; k < 3; k++)
        g->plane[G_MU + k][i] = p[k];
}

static void take_high(const struct sog *s, const uint8_t *p, int i, struct gaussians *g)
{
    for (int k = 0; k < 3; k++) {
        float *x = &g->plane[G_MU + k][i];
        const float u = s->least[k] + (s->most[k] - s->least[k]) * (*x + 256 * p[k]) / 65535;
        *x = copysignf(expm1f(fabsf(u)), u);
    }
}

static void take_scales(const struct sog *s, const uint8_t *p, int i, struct gaussians *g)
{
    for (int k = 0; k < 3; k++)
        g->plane[G_LOG_SCALE + k][i] = s->values[SCALES][k][p[k]];
}

static void take_quat(const struct sog *s, const uint8_t *p, int i, struct gaussians *g)
{
    const bool turned = p[3] >= QUAT_TAG;
    const int largest = turned ? p[3] - QUAT_TAG : 0;
    float left = 1;
    (void)s;
    for (int k = 0; k < 4; k++) {
        if (k == largest)
            continue;
        const float v = turned ? (2 * (float)*p++ / 255 - 1) * SQRT1_2 : 0;
        g->plane[G_QUAT + k][i] = v;
        left -= v * v;
    }
    g->plane[G_QUAT + largest][i] = sqrtf(fmaxf(left, 0));
}

static void take_sh0(const struct sog *s, const uint8_t *p, int i, struct gaussians *g)
{
    for (int c = 0; c < 3; c++)
        g->plane[G_SH + c][i] = s->values[SH0][c][p[c]];
    g->plane[G_LOGIT][i] = s->values[SH0][3][p[3]];
}

static err_t read_planes(const struct sog *s, struct gaussians *g)
{
    static take_fn *const take[] = {take_low, take_high, take_scales, take_quat, take_sh0};
    err_t e = OK;
    for (int k = LOW; k <= SH0 && !e; k++) {
        struct webp_picture p;
        e = read_picture(s, (enum picture)k, &p);
        for (int i = 0; i < s->n && !e; i++)
            take[k](s, p.px + 4 * (size_t)i, i, g);
        free(p.px);
    }
    return e;
}

static err_t take_harmonics(const struct sog *s, const struct webp_picture *centroids,
                            const struct webp_picture *labels, struct gaussians *g)
{
    const int k = harmonics(s->degree), n = centroids->w * centroids->h / k;
    for (int i = 0; i < s->n; i++) {
        const uint8_t *l = labels->px + 4 * (size_t)i;
        const int label = l[0] | l[1] << 8;
        if (label >= n)
            return err_fail(ERR_FORMAT, "%s: splat %d has harmonics %d of %d", s->file->what, i,
                            label, n);
        const uint8_t *p = centroids->px + 4 * (size_t)k * (size_t)label; // rows follow each other
        for (int j = 1; j <= k; j++, p += 4)
            for (int c = 0; c < 3; c++)
                g->plane[G_SH + 3 * j + c][i] = s->values[CENTROIDS][0][p[c]];
    }
    return OK;
}

static err_t read_harmonics(const struct sog *s, struct gaussians *g)
{
    struct webp_picture centroids = {0}, labels = {0};
    err_t e = read_picture(s, CENTROIDS, &centroids);
    if (!e)
        e = read_picture(s, LABELS, &labels);
    if (!e)
        e = take_harmonics(s, &centroids, &labels, g);
    free(labels.px);
    free(centroids.px);
    return e;
}

static err_t parse_sog(const struct splats_bytes *file, float ev, struct arena *a,
                       struct gaussians *g, struct gaussians_report *report)
{
    struct sog s;
    memset(g, 0, sizeof *g);
    err_t e = open_sog(file, &s);
    if (!e)
        e = gaussians_init(g, a, s.n, s.degree);
    if (!e)
        e = read_planes(&s, g);
    if (!e && s.degree > 0)
        e = read_harmonics(&s, g);
    zipfile_close(&s.zip);
    if (e) {
        memset(g, 0, sizeof *g);
        return e;
    }
    g->n = s.n;
    splats_to_radiance(g, ev);
    gaussians_sanitize(g, report);
    return OK;
}

const struct splats_format sog_format = {(uint64_t)128 * GAUSSIANS_MAX, INFINITY, peek_sog,
                                         parse_sog};
