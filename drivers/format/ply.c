/* Reading: the header becomes a table of properties with their offset in a row; that table becomes
 * one source (offset and kind) per plane of struct gaussians; then every row (plyrows.h) is read
 * through the sources. Where there are two kinds of colours, some splats tell whether they still
 * agree. */
#include "drivers/format/ply.h"

#include "core/base/bytes.h"
#include "core/base/half.h"
#include "core/base/num.h"
#include "core/splat/display.h"
#include "drivers/format/file.h"
#include "drivers/format/plyrows.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    HEADER_MAX = 65536, // bytes; viewers stop at 10 kB to 64 kB
    WORD_CAP = 32,
    LINE_WORDS = 5, // property list uchar int vertex_indices
    SHOWN_COEFS_MAX = (DISPLAY_DEGREE_MAX + 1) * (DISPLAY_DEGREE_MAX + 1),
    FLOATS_MAX = 14 + 3 * SHOWN_COEFS_MAX,
    ROW_MAX = 4 * FLOATS_MAX + 2 * 3 * SH_COEFS_MAX
};

#define EV_MAX 200         // stops; two floats are never further apart
#define EV_FOUND_MAX 64.0f // for scenes without a given ev
#define STALE_RATIO 0.03   // ten times what half floats do
#define STALE_LEAST 1e-3
#define BLACK 4e-4                      // for f_dc: too near to black to estimate an ev
#define SHOWN_MIDDLE 1.7724538509055159 // 0.5 / Y0, which f_dc lacks

/* ---- writing ---- */

static int coefs_of(int degree)
{
    return (degree + 1) * (degree + 1);
}

static int shown_degree(int degree)
{
    return degree < DISPLAY_DEGREE_MAX ? degree : DISPLAY_DEGREE_MAX;
}

/* f_dc of all colours, then f_rest of one colour after the other. */
static uint8_t *put_shown(const float *sh, int coefs, uint8_t *p)
{
    for (int c = 0; c < 3; c++)
        p = bytes_put_f32(p, sh[c]);
    for (int c = 0; c < 3; c++)
        for (int k = 1; k < coefs; k++)
            p = bytes_put_f32(p, sh[3 * k + c]);
    return p;
}

static uint8_t *put_row(const struct gaussians *g, float ev, int i, uint8_t *p)
{
    float log_sh[3 * SH_COEFS_MAX], shown[3 * SHOWN_COEFS_MAX];
    int coefs = coefs_of(g->degree);
    double length = 0;
    for (int k = 0; k < 4; k++)
        length += (double)g->plane[G_QUAT + k][i] * g->plane[G_QUAT + k][i];
    length = sqrt(length);
    for (int j = 0; j < 3 * coefs; j++)
        log_sh[j] = g->plane[G_SH + j][i];
    display_from_radiance(log_sh, g->degree, ev, shown);
    for (int k = 0; k < 3; k++)
        p = bytes_put_f32(p, g->plane[G_MU + k][i]);
    for (int k = 0; k < 3; k++)
        p = bytes_put_f32(p, 0); // normals, which splats do not have
    p = put_shown(shown, coefs_of(shown_degree(g->degree)), p);
    p = bytes_put_f32(p, g->plane[G_LOGIT][i]);
    for (int k = 0; k < 3; k++)
        p = bytes_put_f32(p, fmaxf(g->plane[G_LOG_SCALE + k][i], GAUSSIANS_LOG_SCALE_MIN));
    for (int k = 0; k < 4; k++)
        p = bytes_put_f32(p, (float)(g->plane[G_QUAT + k][i] / length));
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < coefs; k++)
            p = bytes_put_u16(p, half_from_float_sat(log_sh[3 * k + c]));
    return p;
}

static void put_names(FILE *f, const char *type, const char *prefix, int n)
{
    for (int k = 0; k < n; k++)
        fprintf(f, "property %s %s%d\n", type, prefix, k);
}

static void put_header(FILE *f, const struct scene *s, float ev)
{
    static const char *const first[] = {"x", "y", "z", "nx", "ny", "nz"};
    fprintf(f, "ply\nformat binary_little_endian 1.0\n");
    fprintf(f, "comment ihdr ev %.9g\n", (double)ev);
    fprintf(f, "comment ihdr mid_exposure_log2 %.9g\n", (double)s->tone.mid_log2t);
    fprintf(f, "comment ihdr background %.9g %.9g %.9g\n", (double)s->background[0],
            (double)s->background[1], (double)s->background[2]);
    fprintf(f, "element vertex %d\n", s->g.n);
    for (size_t k = 0; k < sizeof first / sizeof first[0]; k++)
        fprintf(f, "property float %s\n", first[k]);
    put_names(f, "float", "f_dc_", 3);
    put_names(f, "float", "f_rest_", 3 * coefs_of(shown_degree(s->g.degree)) - 3);
    fprintf(f, "property float opacity\n");
    put_names(f, "float", "scale_", 3);
    put_names(f, "float", "rot_", 4);
    put_names(f, "ushort", "ihdr_log_", 3 * coefs_of(s->g.degree));
    fprintf(f, "end_header\n");
}

err_t ply_write(const char *path, const struct scene *s)
{
    FILE *f;
    float ev = display_ev(&s->tone);
    uint8_t row[ROW_MAX] = {0};
    err_t e = splats_check(path, &s->g);
    if (!e)
        e = file_create(path, &f);
    if (e)
        return e;
    put_header(f, s, ev);
    for (int i = 0; i < s->g.n && !ferror(f); i++)
        fwrite(row, 1, (size_t)(put_row(&s->g, ev, i, row) - row), f);
    return file_finish(f, path);
}

/* ---- the header ---- */

struct property {
    char name[WORD_CAP];
    int type;      // index in types
    size_t offset; // bytes from the start of a row
};

struct header {
    size_t bytes; // size of the header
    int n;
    bool has_format, in_vertex, past_vertex;
    bool has_ev;
    float ev; // from the comment
    struct property v[PLYROWS_CELLS_MAX];
    struct plyrows rows;
};

struct words {
    int n;
    char v[LINE_WORDS][WORD_CAP];
};

/* Words of a line: at most LINE_WORDS of fewer than WORD_CAP bytes; false if they do not fit. */
static bool split_words(const char *line, size_t n, struct words *out)
{
    out->n = 0;
    for (size_t at = 0; at < n;) {
        size_t from = at;
        while (at < n && line[at] != ' ' && line[at] != '\t' && line[at] != '\r')
            at++;
        if (at == from) {
            at++;
            continue;
        }
        if (out->n == LINE_WORDS || at - from >= WORD_CAP)
            return false;
        memcpy(out->v[out->n], line + from, at - from);
        out->v[out->n++][at - from] = 0;
    }
    return true;
}

static bool word_is(const struct words *w, int n, const char *first)
{
    return w->n == n && strcmp(w->v[0], first) == 0;
}

static const struct property *find_property(const struct header *h, const char *name)
{
    for (int i = 0; i < h->n; i++)
        if (strcmp(h->v[i].name, name) == 0)
            return &h->v[i];
    return NULL;
}

static err_t take_property(const char *what, const struct words *w, struct header *h)
{
    if (!word_is(w, 3, "property"))
        return err_fail(ERR_UNSUPPORTED, "%s: lists in the vertex element are not read", what);
    const int type = plyrows_type(w->v[1]);
    if (type < 0)
        return err_fail(ERR_FORMAT, "%s: property %s has the unknown type %s", what, w->v[2],
                        w->v[1]);
    if (h->n == PLYROWS_CELLS_MAX)
        return err_fail(ERR_FORMAT, "%s: more than %d properties", what, PLYROWS_CELLS_MAX);
    if (find_property(h, w->v[2]))
        return err_fail(ERR_FORMAT, "%s: property %s is there twice", what, w->v[2]);
    struct property *p = &h->v[h->n];
    memcpy(p->name, w->v[2], WORD_CAP);
    p->type = h->rows.type[h->n++] = type;
    p->offset = h->rows.row;
    h->rows.row += plyrows_type_bytes(type);
    return OK;
}

static err_t take_element(const char *what, const struct words *w, struct header *h)
{
    bool vertex = strcmp(w->v[1], "vertex") == 0;
    if (h->in_vertex || h->past_vertex) {
        h->in_vertex = false;
        h->past_vertex = true;
        return vertex ? err_fail(ERR_FORMAT, "%s: two vertex elements", what) : OK;
    }
    if (!vertex)
        return err_fail(ERR_UNSUPPORTED, "%s: element %s before vertex is not read", what, w->v[1]);
    uint64_t n = 0;
    for (const char *c = w->v[2]; *c; c++) {
        if (*c < '0' || *c > '9')
            return err_fail(ERR_FORMAT, "%s: vertex count \"%s\"", what, w->v[2]);
        n = n > GAUSSIANS_MAX ? n : 10 * n + (uint64_t)(*c - '0');
    }
    if (n > GAUSSIANS_MAX)
        return err_fail(ERR_FORMAT, "%s: %s splats, at most %d are read", what, w->v[2],
                        GAUSSIANS_MAX);
    h->rows.n = (int)n;
    h->in_vertex = true;
    return OK;
}

static err_t take_format(const char *what, const struct words *w, struct header *h)
{
    static const char *const names[] = {"ascii", "binary_little_endian", "binary_big_endian"};
    for (int k = PLYROWS_ASCII; k <= PLYROWS_BIG; k++)
        if (strcmp(w->v[1], names[k]) == 0 && strcmp(w->v[2], "1.0") == 0) {
            h->rows.kind = (enum plyrows_kind)k;
            h->has_format = true;
            return OK;
        }
    return err_fail(ERR_UNSUPPORTED, "%s: format %s %s is none of PLY 1.0", what, w->v[1], w->v[2]);
}

static err_t take_line(const char *what, const struct words *w, struct header *h)
{
    if (word_is(w, 3, "format"))
        return take_format(what, w, h);
    if (word_is(w, 3, "element"))
        return take_element(what, w, h);
    if (w->n > 0 && strcmp(w->v[0], "property") == 0)
        return h->in_vertex ? take_property(what, w, h) : OK; // later elements are ignored
    return err_fail(ERR_FORMAT, "%s: header line that begins with \"%s\"", what,
                    w->n ? w->v[0] : "");
}

/* "comment ihdr ev X"; other comments say nothing that is needed here. */
static err_t take_comment(const char *what, const char *line, size_t n, struct header *h)
{
    struct words w;
    if (!split_words(line, n, &w) || !word_is(&w, 4, "comment") || strcmp(w.v[1], "ihdr") != 0 ||
        strcmp(w.v[2], "ev") != 0)
        return OK;
    char *end;
    h->ev = strtof(w.v[3], &end);
    if (*end || !(fabsf(h->ev) <= EV_MAX))
        return err_fail(ERR_FORMAT, "%s: comment ihdr ev \"%s\", allowed are -%d to %d stops", what,
                        w.v[3], EV_MAX, EV_MAX);
    h->has_ev = true;
    return OK;
}

static bool is_comment(const char *line, size_t n)
{
    return (n >= 7 && memcmp(line, "comment", 7) == 0) ||
           (n >= 8 && memcmp(line, "obj_info", 8) == 0);
}

static err_t take_lines(const struct splats_bytes *file, struct header *h)
{
    const char *text = file->p;
    size_t at = 0, limit = file->n < HEADER_MAX ? file->n : HEADER_MAX;
    for (int number = 1;; number++) {
        const char *stop = at < limit ? memchr(text + at, '\n', limit - at) : NULL;
        if (!stop)
            return err_fail(ERR_FORMAT, "%s: no end of a PLY header in its first %zu bytes",
                            file->what, limit);
        const char *line = text + at;
        size_t n = (size_t)(stop - line);
        at += n + 1;
        struct words w;
        if (number > 1 && is_comment(line, n)) {
            err_t e = take_comment(file->what, line, n, h);
            if (e)
                return e;
            continue;
        }
        if (!split_words(line, n, &w))
            return err_fail(ERR_FORMAT, "%s: header line %d has words too many or too long",
                            file->what, number);
        if (number == 1 && !word_is(&w, 1, "ply"))
            return err_fail(ERR_FORMAT, "%s: not a PLY file", file->what);
        if (word_is(&w, 1, "end_header"))
            break;
        err_t e = number > 1 ? take_line(file->what, &w, h) : OK;
        if (e)
            return e;
    }
    h->bytes = at;
    return OK;
}

static err_t read_header(const struct splats_bytes *file, struct header *h)
{
    memset(h, 0, sizeof *h);
    err_t e = take_lines(file, h);
    if (e)
        return e;
    if (!h->has_format || !(h->in_vertex || h->past_vertex))
        return err_fail(ERR_FORMAT, "%s: the header lacks a format or a vertex element",
                        file->what);
    h->rows.what = file->what;
    h->rows.p = (const uint8_t *)file->p + h->bytes;
    h->rows.bytes = file->n - h->bytes;
    h->rows.n_cells = h->n;
    return plyrows_check(&h->rows);
}

/* ---- sources of the planes ---- */

struct sources {
    struct splats_info info;
    size_t offset[G_PLANES_MAX]; // in a row, of plane p; of f_dc and f_rest for SH if not has_hdr
};

static err_t find_source(const char *what, const struct header *h, const char *name, int type,
                         size_t *offset)
{
    const struct property *p = find_property(h, name);
    if (!p)
        return err_fail(ERR_FORMAT, "%s: no property %s", what, name);
    if (p->type / 2 != type / 2) // names of a type come in pairs
        return err_fail(ERR_FORMAT, "%s: property %s is %s, expected %s", what, name,
                        plyrows_type_name(p->type), plyrows_type_name(type));
    *offset = p->offset;
    return OK;
}

static int count_numbered(const struct header *h, const char *prefix)
{
    char name[WORD_CAP];
    for (int n = 0;; n++) {
        snprintf(name, sizeof name, "%s%d", prefix, n);
        if (!find_property(h, name))
            return n;
    }
}

static err_t find_degree(const char *what, const struct header *h, int n_log,
                         struct splats_info *out)
{
    int n_rest = count_numbered(h, "f_rest_");
    out->has_hdr = n_log > 0;
    out->n = h->rows.n;
    out->ev = h->ev;
    int numbers = out->has_hdr ? n_log : n_rest + 3;
    for (out->degree = 0; out->degree <= SH_DEGREE_MAX; out->degree++)
        if (3 * coefs_of(out->degree) == numbers)
            return OK;
    return err_fail(ERR_UNSUPPORTED, "%s: %d properties %s*: no SH degree of 0 to %d has as many",
                    what, out->has_hdr ? n_log : n_rest, out->has_hdr ? "ihdr_log_" : "f_rest_",
                    SH_DEGREE_MAX);
}

/* Name of the property of an SH plane: the coefficients of one colour follow each other. */
static void sh_name(const struct splats_info *info, int k, int c, char name[WORD_CAP])
{
    int coefs = coefs_of(info->degree);
    if (info->has_hdr)
        snprintf(name, WORD_CAP, "ihdr_log_%d", c * coefs + k);
    else if (k == 0)
        snprintf(name, WORD_CAP, "f_dc_%d", c);
    else
        snprintf(name, WORD_CAP, "f_rest_%d", c * (coefs - 1) + k - 1);
}

/* n_log: properties of radiance; 0: of the display colours. */
static err_t find_sources(const char *what, const struct header *h, int n_log, struct sources *out)
{
    static const char *const names[G_SH] = {"x",       "y",       "z",      "scale_0",
                                            "scale_1", "scale_2", "rot_0",  "rot_1",
                                            "rot_2",   "rot_3",   "opacity"};
    memset(out, 0, sizeof *out);
    err_t e = find_degree(what, h, n_log, &out->info);
    for (int p = 0; p < G_SH && !e; p++)
        e = find_source(what, h, names[p], PLYROWS_TYPE_FLOAT, &out->offset[p]);
    for (int j = 0; !e && j < 3 * coefs_of(out->info.degree); j++) {
        char name[WORD_CAP];
        sh_name(&out->info, j / 3, j % 3, name);
        e = find_source(what, h, name, out->info.has_hdr ? PLYROWS_TYPE_USHORT : PLYROWS_TYPE_FLOAT,
                        &out->offset[G_SH + j]);
    }
    return e;
}

/* ---- rows ---- */

static float float_at(const uint8_t *row, size_t offset)
{
    struct bytes b = bytes_of(row + offset, 4);
    return bytes_f32(&b);
}

static float half_at(const uint8_t *row, size_t offset)
{
    struct bytes b = bytes_of(row + offset, 2);
    return half_to_float(bytes_u16(&b));
}

static void take_colours(const struct sources *s, const uint8_t *row, float sh[3 * SH_COEFS_MAX])
{
    for (int j = 0; j < 3 * coefs_of(s->info.degree); j++)
        sh[j] = s->info.has_hdr ? half_at(row, s->offset[G_SH + j])
                                : float_at(row, s->offset[G_SH + j]);
}

static void take_row(const struct sources *s, const uint8_t *row, float ev, int i,
                     struct gaussians *g)
{
    float sh[3 * SH_COEFS_MAX], log_sh[3 * SH_COEFS_MAX] = {0};
    for (int p = 0; p < G_SH; p++)
        g->plane[p][i] = float_at(row, s->offset[p]);
    take_colours(s, row, sh);
    if (!s->info.has_hdr)
        display_to_radiance(sh, s->info.degree, ev, log_sh);
    for (int j = 0; j < 3 * coefs_of(s->info.degree); j++)
        g->plane[G_SH + j][i] = s->info.has_hdr ? sh[j] : log_sh[j];
}

/* ---- stale radiance ---- */

/* Other programs rotate or recolour f_dc and f_rest and leave ihdr_log_* unchanged. In a file of
 * ours both agree to within half floats, so a sample of splats shows whether they still do. */
struct both {
    const struct sources *radiance, *shown;
    struct plyrows *rows;
};

/* Display harmonics of splat i from its radiance at ev, and those of the file. */
static void read_both(const struct both *b, int i, float ev, float made[3 * SH_COEFS_MAX],
                      float shown[3 * SH_COEFS_MAX])
{
    const uint8_t *row = plyrows_get(b->rows, i);
    float log_sh[3 * SH_COEFS_MAX];
    take_colours(b->radiance, row, log_sh);
    take_colours(b->shown, row, shown);
    display_from_radiance(log_sh, b->radiance->info.degree, ev, made);
}

/* The ev of a file that has lost the comment: the one that maps the mean green of a splat to its
 * display colour, as the median of some splats; false if all of these are black. */
static bool find_ev(const struct both *b, float *out)
{
    enum { TRIED = 15, HALVINGS = 22 };
    float ev[TRIED], made[3 * SH_COEFS_MAX], shown[3 * SH_COEFS_MAX];
    int n = 0;
    for (int t = 0; t < TRIED; t++) {
        float low = -EV_FOUND_MAX, high = EV_FOUND_MAX, v = 0;
        for (int k = 0; k < HALVINGS; k++, v = (low + high) / 2) {
            read_both(b, (int)((int64_t)t * b->rows->n / TRIED), v, made, shown);
            low = made[1] < shown[1] ? v : low;
            high = made[1] < shown[1] ? high : v;
        }
        if ((double)shown[1] + SHOWN_MIDDLE > BLACK)
            ev[n++] = v;
    }
    *out = num_median(ev, (size_t)n);
    return n > 0;
}

/* Whether the two disagree, by more than STALE_RATIO of their size, in a tenth of the sampled
 * splats. */
static bool is_stale(const struct both *b, float ev)
{
    enum { LOOKED_AT = 100 };
    int n = b->rows->n < LOOKED_AT ? b->rows->n : LOOKED_AT, wrong = 0;
    int degree = shown_degree(b->radiance->info.degree);
    if (b->shown->info.degree < degree)
        degree = b->shown->info.degree;
    for (int t = 0; t < n; t++) {
        float made[3 * SH_COEFS_MAX], shown[3 * SH_COEFS_MAX];
        double off = 0, size = 0;
        read_both(b, (int)((int64_t)t * b->rows->n / n), ev, made, shown);
        for (int j = 0; j < 3 * coefs_of(degree); j++) {
            double v = (double)made[j] + (j < 3 ? SHOWN_MIDDLE : 0);
            off += pow((double)made[j] - (double)shown[j], 2);
            size += v * v;
        }
        wrong += sqrt(off) > STALE_RATIO * sqrt(size) + STALE_LEAST; // not if it is no number
    }
    return 10 * wrong > n;
}

/* ---- the file ---- */

static err_t open_file(const struct splats_bytes *file, struct header *h, struct sources *out)
{
    struct sources shown;
    err_t e = read_header(file, h);
    if (!e)
        e = find_sources(file->what, h, count_numbered(h, "ihdr_log_"), out);
    if (e || !out->info.has_hdr || h->rows.n == 0 || find_sources(file->what, h, 0, &shown) != OK)
        return e;
    const struct both both = {out, &shown, &h->rows};
    float ev = h->ev;
    if ((h->has_ev || find_ev(&both, &ev)) && is_stale(&both, ev)) {
        *out = shown;
        out->info.hdr_stale = true;
    }
    out->info.ev = ev;
    return OK;
}

static err_t peek_ply(const struct splats_bytes *file, struct splats_info *out)
{
    struct header h;
    struct sources s;
    memset(out, 0, sizeof *out);
    err_t e = open_file(file, &h, &s);
    if (!e)
        *out = s.info;
    return e;
}

static err_t parse_ply(const struct splats_bytes *file, float ev, struct arena *a,
                       struct gaussians *g, struct gaussians_report *report)
{
    struct header h;
    struct sources s;
    memset(g, 0, sizeof *g);
    err_t e = open_file(file, &h, &s);
    if (!e)
        e = gaussians_init(g, a, s.info.n, s.info.degree);
    if (e)
        return e;
    for (int i = 0; i < s.info.n; i++)
        take_row(&s, plyrows_get(&h.rows, i), ev, i, g);
    g->n = s.info.n;
    gaussians_sanitize(g, report);
    return OK;
}

const struct splats_format ply_format = {(uint64_t)64 << 30, INFINITY, peek_ply, parse_ply};
