/* Both ways walk one list: the attributes of the primitive, each with the offset that its numbers
 * have among the planes of struct gaussians. Writing fills all attributes of some thousand splats
 * at a time, each at its offset in the file, so the display colours are computed once and need no
 * memory. Reading resolves every attribute to an offset in the file first - accessor, view,
 * buffer - and checks it completely; only then is memory taken.
 * Sources: glTF 2.0, 3.6 and 4; KHR_gaussian_splatting, "Attributes" and "Improving Fallback". */
#include "drivers/format/glb.h"

#include "core/base/bytes.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/splat/display.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/splats.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define SPLATTING "KHR_gaussian_splatting"
#define RADIANCE "HDRIG_gaussian_splatting_radiance"

enum {
    MAGIC = 0x46546c67,
    VERSION = 2,
    HEADER = 12, // bytes of the file's, 8 of a chunk's
    CHUNK = 8,
    CHUNK_JSON = 0x4e4f534a,
    CHUNK_BIN = 0x004e4942,
    TYPE_BYTE = 5120,
    TYPE_UBYTE,
    TYPE_SHORT,
    TYPE_USHORT,
    TYPE_UINT = 5125,
    TYPE_FLOAT,
    BATCH = 2048,
    STRIDE_MAX = 252,
    RADIANCE_VERSION = 2,
    ATTRIBUTES_MAX = 5 + (DISPLAY_DEGREE_MAX + 1) * (DISPLAY_DEGREE_MAX + 1) + SH_COEFS_MAX
};

enum source { POSITION, COLOUR_0, ROTATION, SCALE, OPACITY, DISPLAY, LOG_RADIANCE };

struct attribute {
    enum source source;
    int harmonic; // for the last two
    int components, type;
    char name[96];
    /* when read */
    const uint8_t *p;
    size_t stride;
    bool normalized;
    int view;
    size_t from, to; // within its view
};

struct list {
    int n;
    struct attribute a[ATTRIBUTES_MAX];
};

static int sh_values(int degree)
{
    return (degree + 1) * (degree + 1);
}

static struct attribute *add_attribute(struct list *l, enum source source, int components,
                                       const char *name)
{
    struct attribute *a = &l->a[l->n++];
    *a = (struct attribute){.source = source, .components = components, .type = TYPE_FLOAT};
    snprintf(a->name, sizeof a->name, "%s", name);
    return a;
}

static void add_harmonics(struct list *l, enum source source, int degree, const char *prefix)
{
    for (int band = 0; band <= degree; band++)
        for (int k = 0; k < 2 * band + 1; k++) {
            struct attribute *a = add_attribute(l, source, 3, "");
            a->harmonic = band * band + k;
            snprintf(a->name, sizeof a->name, "%s:SH_DEGREE_%d_COEF_%d", prefix, band, k);
        }
}

/* degree: of the display colours; radiance: -1 = none. */
static void make_list(struct list *l, int degree, int radiance, int version)
{
    l->n = 0;
    add_attribute(l, POSITION, 3, "POSITION");
    add_attribute(l, ROTATION, 4, SPLATTING ":ROTATION");
    add_attribute(l, SCALE, 3, SPLATTING ":SCALE");
    add_attribute(l, OPACITY, 1, SPLATTING ":OPACITY");
    add_harmonics(l, DISPLAY, degree, SPLATTING);
    if (radiance >= 0)
        add_harmonics(l, LOG_RADIANCE, radiance, version == 1 ? RADIANCE : "_" RADIANCE);
}

static int bytes_of_type(int type)
{
    return type == TYPE_BYTE || type == TYPE_UBYTE     ? 1
           : type == TYPE_SHORT || type == TYPE_USHORT ? 2
           : type == TYPE_UINT || type == TYPE_FLOAT   ? 4
                                                       : 0;
}

static size_t size_of(const struct attribute *a)
{
    return (size_t)a->components * (size_t)bytes_of_type(a->type);
}

static const char *const shapes[] = {NULL, "SCALAR", NULL, "VEC3", "VEC4"};

/* ---- writing ---- */

static float splat_position(const struct gaussians *g, int k, int i)
{
    return g->plane[G_MU + k][i] * (float)splats_sign(G_MU + k, SPLATS_LUF);
}

/* "min" and "max" of the positions, which glTF requires. */
static void put_bounds(FILE *f, const struct gaussians *g)
{
    float v[2][3];
    for (int k = 0; k < 3; k++) {
        v[0][k] = v[1][k] = splat_position(g, k, 0);
        for (int i = 1; i < g->n; i++) {
            v[0][k] = fminf(v[0][k], splat_position(g, k, i));
            v[1][k] = fmaxf(v[1][k], splat_position(g, k, i));
        }
    }
    for (int end = 0; end < 2; end++)
        fprintf(f, ",\"%s\":[%.9g,%.9g,%.9g]", end ? "max" : "min", (double)v[end][0],
                (double)v[end][1], (double)v[end][2]);
}

static void put_accessors(FILE *f, const struct gaussians *g, const struct list *l)
{
    fputs("\"bufferViews\":[", f);
    for (int i = 0; i < l->n; i++)
        fprintf(f, "%s{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu,\"target\":34962}",
                i ? "," : "", l->a[i].from, l->a[i].to - l->a[i].from);
    fputs("],\"accessors\":[", f);
    for (int i = 0; i < l->n; i++) {
        const struct attribute *a = &l->a[i];
        fprintf(f, "%s{\"bufferView\":%d,\"componentType\":%d,\"count\":%d,\"type\":\"%s\"%s",
                i ? "," : "", i, a->type, g->n, shapes[a->components],
                a->normalized ? ",\"normalized\":true" : "");
        if (a->source == POSITION)
            put_bounds(f, g);
        putc('}', f);
    }
    putc(']', f);
}

/* The first view, where viewers may begin. glTF's cameras look along -z with y up: their turn is
 * k conj(q) i, k and i being the half turns that change the axes of the world and of cameras. */
static void put_camera(FILE *f, const struct camera *c, const char *name)
{
    double at[3], length = 0;
    for (int k = 0; k < 4; k++)
        length += (double)c->q[k] * (double)c->q[k];
    length = sqrt(length);
    rotation_centre(c, at);
    fputs(",{\"camera\":0,\"name\":", f);
    json_put_string(f, name);
    fprintf(f, ",\"translation\":[%.9g,%.9g,%.9g],\"rotation\":[%.9g,%.9g,%.9g,%.9g]}],", -at[0],
            -at[1], at[2], (double)c->q[3] / length, (double)c->q[0] / length,
            (double)c->q[1] / length, -(double)c->q[2] / length);
    fprintf(f,
            "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":%.9g,"
            "\"aspectRatio\":%.9g,\"znear\":0.01}}],",
            2 * atan(c->h / (2 * (double)c->fy)), (double)c->w / c->h);
}

static void put_nodes(FILE *f, const struct scene *s)
{
    fprintf(f, "\"scene\":0,\"scenes\":[{\"nodes\":[0%s]}],\"nodes\":[{\"mesh\":0}",
            s->n_views > 0 ? ",1" : "");
    if (s->n_views > 0)
        put_camera(f, &s->cams[0], s->names[0]);
    else
        fputs("],", f);
}

static void put_json(FILE *f, const struct scene *s, const struct list *l)
{
    fputs("{\"asset\":{\"version\":\"2.0\",\"generator\":\"hdrig\"},\"extensionsUsed\":["
          "\"" SPLATTING "\",\"" RADIANCE "\"],",
          f);
    put_nodes(f, s);
    fputs("\"meshes\":[{\"primitives\":[{\"mode\":0,\"attributes\":{", f);
    for (int i = 0; i < l->n; i++)
        fprintf(f, "%s\"%s\":%d", i ? "," : "", l->a[i].name, i);
    fprintf(f,
            "},\"extensions\":{\"" SPLATTING "\":{\"kernel\":\"ellipse\",\"colorSpace\":"
            "\"srgb_rec709_display\",\"projection\":\"perspective\",\"sortingMethod\":"
            "\"cameraDistance\",\"extensions\":{\"" RADIANCE "\":{\"version\":%d,\"degree\":%d,"
            "\"ev\":%.9g}}}}}]}],\"buffers\":[{\"byteLength\":%zu}],",
            RADIANCE_VERSION, s->g.degree, (double)display_ev(&s->tone), l->a[l->n - 1].to);
    put_accessors(f, &s->g, l);
    putc('}', f);
}

static float shown_colour(const float *display, int c)
{
    return fminf(fmaxf((float)(0.5 + SH_BASIS0 * (double)display[c]), 0), 1);
}

static double opacity(const struct gaussians *g, int i)
{
    return 1 / (1 + exp(-(double)g->plane[G_LOGIT][i]));
}

/* Linear light and opacity, of 16 bits. */
static uint8_t *put_colour_0(const struct gaussians *g, const float *display, int i, uint8_t *b)
{
    for (int c = 0; c < 3; c++)
        b = bytes_put_u16(b, (uint16_t)lrintf(65535 * display_decode(shown_colour(display, c))));
    return bytes_put_u16(b, (uint16_t)lrint(65535 * opacity(g, i)));
}

static uint8_t *put_rotation(const struct gaussians *g, int i, uint8_t *b)
{
    double sum = 0;
    for (int k = 0; k < 4; k++)
        sum += (double)g->plane[G_QUAT + k][i] * (double)g->plane[G_QUAT + k][i];
    for (int k = 0; k < 4; k++) {
        int plane = G_QUAT + (k + 1) % 4;
        double v = (double)g->plane[plane][i] * splats_sign(plane, SPLATS_LUF);
        b = bytes_put_f32(b, (float)(v / sqrt(sum)));
    }
    return b;
}

/* Attribute a of splat i; display: its display harmonics. */
static uint8_t *put_value(const struct attribute *a, const struct gaussians *g,
                          const float *display, int i, uint8_t *b)
{
    switch (a->source) {
    case POSITION:
        for (int k = 0; k < 3; k++)
            b = bytes_put_f32(b, splat_position(g, k, i));
        return b;
    case COLOUR_0:
        return put_colour_0(g, display, i, b);
    case ROTATION:
        return put_rotation(g, i, b);
    case SCALE:
        for (int k = 0; k < 3; k++) {
            float v = fmaxf(g->plane[G_LOG_SCALE + k][i], GAUSSIANS_LOG_SCALE_MIN);
            b = bytes_put_f32(b, (float)exp((double)fminf(v, GAUSSIANS_LOG_SCALE_MAX)));
        }
        return b;
    case OPACITY:
        return bytes_put_f32(b, (float)opacity(g, i));
    case DISPLAY:
    case LOG_RADIANCE:
        break;
    }
    for (int c = 0; c < 3; c++) {
        int plane = G_SH + 3 * a->harmonic + c;
        float v = a->source == DISPLAY ? display[plane - G_SH] : g->plane[plane][i];
        b = bytes_put_f32(b, v * (float)splats_sign(plane, SPLATS_LUF));
    }
    return b;
}

struct room {
    float display[BATCH][3 * (DISPLAY_DEGREE_MAX + 1) * (DISPLAY_DEGREE_MAX + 1)];
    uint8_t b[BATCH * 16];
};

static bool put_splats(FILE *f, long start, const struct list *l, const struct scene *s,
                       struct room *room)
{
    const struct gaussians *g = &s->g;
    float ev = display_ev(&s->tone), sh[3 * SH_COEFS_MAX];
    for (int i = 0, m; i < g->n; i += m) {
        m = g->n - i < BATCH ? g->n - i : BATCH;
        for (int j = 0; j < m; j++) {
            for (int k = 0; k < 3 * sh_values(g->degree); k++)
                sh[k] = g->plane[G_SH + k][i + j];
            display_from_radiance(sh, g->degree, ev, room->display[j]);
        }
        for (int k = 0; k < l->n; k++) {
            const struct attribute *a = &l->a[k];
            uint8_t *end = room->b;
            for (int j = 0; j < m; j++)
                end = put_value(a, g, room->display[j], i + j, end);
            if (fseek(f, start + (long)(a->from + (size_t)i * size_of(a)), SEEK_SET) != 0)
                return false;
            fwrite(room->b, 1, (size_t)(end - room->b), f);
        }
    }
    return true;
}

/* The text, filled up with blanks to whole words. own: free. NULL if there is no memory. */
static char *make_json(const struct scene *s, const struct list *l, size_t *bytes)
{
    char *text = NULL;
    FILE *f = open_memstream(&text, bytes);
    if (!f)
        return NULL;
    put_json(f, s, l);
    while (!ferror(f) && ftell(f) % 4 != 0)
        putc(' ', f);
    bool bad = ferror(f);
    if (fclose(f) == 0 && !bad)
        return text;
    free(text);
    return NULL;
}

static err_t write_file(const char *path, const struct scene *s, const struct list *l,
                        const char *json, size_t json_bytes)
{
    uint8_t head[HEADER + CHUNK], chunk[CHUNK];
    struct room *room = malloc(sizeof *room);
    FILE *f;
    if (!room)
        return err_fail(ERR_NOMEM, "%s: no memory for %d splats", path, BATCH);
    err_t e = file_create(path, &f);
    if (!e) {
        size_t data = l->a[l->n - 1].to;
        uint8_t *b = bytes_put_u32(head, MAGIC);
        b = bytes_put_u32(b, VERSION);
        b = bytes_put_u32(b, (uint32_t)(sizeof head + json_bytes + CHUNK + data));
        b = bytes_put_u32(b, (uint32_t)json_bytes);
        bytes_put_u32(b, CHUNK_JSON);
        bytes_put_u32(bytes_put_u32(chunk, (uint32_t)data), CHUNK_BIN);
        fwrite(head, 1, sizeof head, f);
        fwrite(json, 1, json_bytes, f);
        fwrite(chunk, 1, sizeof chunk, f);
        if (!put_splats(f, (long)(sizeof head + json_bytes + CHUNK), l, s, room)) {
            e = err_fail(file_code(errno), "%s: writing failed: %s", path, strerror(errno));
            file_discard(f, path);
        } else {
            e = file_finish(f, path);
        }
    }
    free(room);
    return e;
}

err_t glb_write(const char *path, const struct scene *s)
{
    const struct gaussians *g = &s->g;
    struct list l;
    size_t json_bytes, at = 0;
    err_t e = splats_check(path, g);
    if (e)
        return e;
    if (g->n == 0)
        return err_fail(ERR_ARG, "%s: a scene without splats: glTF holds at least one", path);
    make_list(&l, g->degree < DISPLAY_DEGREE_MAX ? g->degree : DISPLAY_DEGREE_MAX, g->degree,
              RADIANCE_VERSION);
    struct attribute *colour = add_attribute(&l, COLOUR_0, 4, "COLOR_0");
    colour->type = TYPE_USHORT;
    colour->normalized = true;
    for (int i = 0; i < l.n; i++) {
        l.a[i].from = at;
        l.a[i].to = at += (size_t)g->n * size_of(&l.a[i]);
    }
    if (at > UINT32_MAX - JSON_BYTES_MAX)
        return err_fail(ERR_ARG, "%s: %d splats of degree %d take %zu bytes, glTF holds 4 GB", path,
                        g->n, g->degree, at);
    char *json = make_json(s, &l, &json_bytes);
    if (!json)
        return err_fail(ERR_NOMEM, "%s: no memory for its header", path);
    e = write_file(path, s, &l, json, json_bytes);
    free(json);
    return e;
}

/* ---- reading the header ---- */

struct layout {
    const char *what;
    struct cJSON *json;
    const uint8_t *bin;
    size_t bin_bytes;
    struct splats_info info;
    struct list list;
};

/* Whole number below 2^32; fallback if the member is absent.
 * err:  ERR_FORMAT. */
static err_t get_index(const char *what, const struct cJSON *object, const char *key,
                       const size_t *fallback, size_t *out)
{
    const struct cJSON *node = json_member(object, key);
    double v;
    if (!node && fallback) {
        *out = *fallback;
        return OK;
    }
    if (!json_number(node, &v) || !(v >= 0 && v <= UINT32_MAX) || v != floor(v))
        return err_fail(ERR_FORMAT, "%s: \"%s\" is missing or no whole number", what, key);
    *out = (size_t)v;
    return OK;
}

static const struct cJSON *element(const struct cJSON *array, size_t i)
{
    const struct cJSON *node = json_is_array(array) ? json_first(array) : NULL;
    for (; node && i > 0; i--)
        node = json_next(node);
    return node;
}

static err_t open_chunks(const struct splats_bytes *f, struct layout *l)
{
    struct bytes b = bytes_of(f->p, f->n);
    uint32_t magic = bytes_u32(&b), version = bytes_u32(&b), length = bytes_u32(&b);
    uint32_t json_bytes = bytes_u32(&b), kind = bytes_u32(&b);
    if (b.bad || magic != MAGIC)
        return err_fail(ERR_FORMAT, "%s: not a binary glTF file", f->what);
    if (version != VERSION)
        return err_fail(ERR_UNSUPPORTED, "%s: version %u of binary glTF, %d is read", f->what,
                        version, VERSION);
    if (length > f->n || length < HEADER + CHUNK)
        return err_fail(ERR_FORMAT, "%s: its header says %u bytes, the file has %zu", f->what,
                        length, f->n);
    b.left = length - HEADER - CHUNK;
    const uint8_t *json = bytes_take(&b, json_bytes);
    if (!json || kind != CHUNK_JSON)
        return err_fail(ERR_FORMAT, "%s: no JSON chunk, or of %u bytes where %zu are left", f->what,
                        json_bytes, b.left);
    uint32_t bin_bytes = bytes_u32(&b);
    kind = bytes_u32(&b);
    l->bin = bytes_take(&b, bin_bytes);
    l->bin_bytes = bin_bytes;
    if (!l->bin || kind != CHUNK_BIN)
        return err_fail(ERR_FORMAT, "%s: no binary chunk, or of %u bytes where %zu are left",
                        f->what, bin_bytes, b.left);
    return json_parse(f->what, json, json_bytes, &l->json);
}

static err_t check_document(const struct layout *l)
{
    const struct cJSON *need = json_member(l->json, "extensionsRequired");
    const struct cJSON *buffer = element(json_member(l->json, "buffers"), 0);
    static const char *const moves[] = {"matrix", "translation", "rotation", "scale"};
    for (const struct cJSON *v = need ? json_first(need) : NULL; v; v = json_next(v)) {
        const char *name = json_string(v);
        if (!name || (strcmp(name, SPLATTING) != 0 && strcmp(name, RADIANCE) != 0))
            return err_fail(ERR_UNSUPPORTED, "%s: extensionsRequired: %.64s is not read", l->what,
                            name ? name : "?");
    }
    if (!buffer || json_member(buffer, "uri"))
        return err_fail(ERR_UNSUPPORTED, "%s: buffer 0 is not the binary chunk", l->what);
    const struct cJSON *nodes = json_member(l->json, "nodes");
    for (const struct cJSON *v = nodes ? json_first(nodes) : NULL; v; v = json_next(v))
        for (int k = 0; k < 4; k++)
            if (json_member(v, moves[k]) && (json_member(v, "mesh") || json_member(v, "children")))
                return err_fail(ERR_UNSUPPORTED, "%s: a node has a %s: moved scenes are not read",
                                l->what, moves[k]);
    return OK;
}

static const struct cJSON *splatting_of(const struct cJSON *primitive)
{
    return json_member(json_member(primitive, "extensions"), SPLATTING);
}

/* The only primitive of splats. */
static err_t find_primitive(const struct layout *l, const struct cJSON **out)
{
    const struct cJSON *meshes = json_member(l->json, "meshes"), *list;
    int n = 0;
    for (const struct cJSON *m = meshes ? json_first(meshes) : NULL; m; m = json_next(m)) {
        list = json_member(m, "primitives");
        for (const struct cJSON *p = list ? json_first(list) : NULL; p; p = json_next(p)) {
            n += splatting_of(p) != NULL;
            *out = n == 1 && splatting_of(p) ? p : *out;
        }
    }
    if (n != 1)
        return err_fail(n ? ERR_UNSUPPORTED : ERR_FORMAT,
                        "%s: %d primitives with " SPLATTING ", files with one are read", l->what,
                        n);
    return OK;
}

static err_t check_word(const struct layout *l, const struct cJSON *object, const char *key,
                        const char *want)
{
    const char *got = json_string(json_member(object, key));
    if (!got || strcmp(got, want) != 0)
        return err_fail(got ? ERR_UNSUPPORTED : ERR_FORMAT, "%s: %s \"%.64s\", only %s is read",
                        l->what, key, got ? got : "", want);
    return OK;
}

/* Degree of the display colours from their attributes, degree of the radiance from its member. */
static err_t take_extension(struct layout *l, const struct cJSON *primitive)
{
    const struct cJSON *attributes = json_member(primitive, "attributes");
    const struct cJSON *ext = splatting_of(primitive);
    const struct cJSON *radiance = json_member(json_member(ext, "extensions"), RADIANCE);
    static const size_t points = 4; // glTF's default: triangles
    size_t mode = 0, degree = 0, version = 0;
    int display = 0;
    char name[96];
    double ev = 0;
    err_t e = check_word(l, ext, "kernel", "ellipse");
    if (!e)
        e = check_word(l, ext, "colorSpace", "srgb_rec709_display");
    if (!e)
        e = get_index(l->what, primitive, "mode", &points, &mode);
    if (!e && mode != 0)
        e = err_fail(ERR_FORMAT, "%s: mode %zu, splats are points, 0", l->what, mode);
    for (int d = 1; d <= SH_DEGREE_MAX; d++) {
        snprintf(name, sizeof name, SPLATTING ":SH_DEGREE_%d_COEF_0", d);
        l->info.band_lost = d > DISPLAY_DEGREE_MAX && !radiance && json_member(attributes, name);
        display = d <= DISPLAY_DEGREE_MAX && json_member(attributes, name) ? d : display;
    }
    if (e || !radiance) {
        make_list(&l->list, display, -1, 0);
        l->info.degree = display;
        return e;
    }
    e = get_index(l->what, radiance, "version", NULL, &version);
    if (!e && (version < 1 || version > RADIANCE_VERSION))
        e = err_fail(ERR_UNSUPPORTED, "%s: " RADIANCE " of version %zu, 1 to %d are read", l->what,
                     version, RADIANCE_VERSION);
    if (!e)
        e = get_index(l->what, radiance, "degree", NULL, &degree);
    if (!e && (degree > SH_DEGREE_MAX || !json_number(json_member(radiance, "ev"), &ev) ||
               !(fabs(ev) <= 128)))
        e = err_fail(ERR_FORMAT, "%s: " RADIANCE ": degree %zu, ev %g", l->what, degree, ev);
    make_list(&l->list, 0, e ? -1 : (int)degree, (int)version);
    l->info.degree = (int)degree;
    l->info.has_hdr = true;
    l->info.ev = (float)ev;
    return e;
}

/* ---- attributes ---- */

/* Find the view in the binary chunk. */
static err_t take_view(const struct layout *l, struct attribute *a, size_t *stride)
{
    static const size_t zero = 0;
    const struct cJSON *view = element(json_member(l->json, "bufferViews"), (size_t)a->view);
    size_t buffer, bytes;
    if (!view)
        return err_fail(ERR_FORMAT, "%s: %s: no bufferView %d", l->what, a->name, a->view);
    err_t e = get_index(l->what, view, "buffer", NULL, &buffer);
    if (!e)
        e = get_index(l->what, view, "byteOffset", &zero, &a->from);
    if (!e)
        e = get_index(l->what, view, "byteLength", NULL, &bytes);
    if (!e)
        e = get_index(l->what, view, "byteStride", &zero, stride);
    if (e)
        return e;
    a->to = a->from + bytes;
    if (buffer != 0 || a->to > l->bin_bytes || *stride > STRIDE_MAX)
        return err_fail(ERR_FORMAT,
                        "%s: %s: bufferView %d: bytes %zu to %zu of buffer %zu, stride %zu; buffer "
                        "0 has %zu",
                        l->what, a->name, a->view, a->from, a->to, buffer, *stride, l->bin_bytes);
    return OK;
}

static err_t take_type(const struct layout *l, const struct cJSON *accessor, struct attribute *a)
{
    const char *shape = json_string(json_member(accessor, "type"));
    size_t type;
    err_t e = get_index(l->what, accessor, "componentType", NULL, &type);
    if (e)
        return e;
    a->type = type > TYPE_FLOAT ? 0 : (int)type;
    if (bytes_of_type(a->type) == 0)
        return err_fail(ERR_FORMAT, "%s: %s: componentType %zu", l->what, a->name, type);
    if (!shape || strcmp(shape, shapes[a->components]) != 0)
        return err_fail(ERR_FORMAT, "%s: %s: type \"%.16s\", it must be %s", l->what, a->name,
                        shape ? shape : "", shapes[a->components]);
    if (json_member(accessor, "sparse"))
        return err_fail(ERR_UNSUPPORTED, "%s: %s: sparse accessors are not read", l->what, a->name);
    json_truth(json_member(accessor, "normalized"), &a->normalized);
    return OK;
}

/* Everything about attribute a; the first one tells how many splats there are. */
static err_t take_attribute(struct layout *l, const struct cJSON *attributes, struct attribute *a)
{
    static const size_t zero = 0;
    size_t index, count, view, offset, stride;
    err_t e = json_member(attributes, a->name)
                  ? get_index(l->what, attributes, a->name, NULL, &index)
                  : err_fail(ERR_FORMAT, "%s: no attribute %s", l->what, a->name);
    if (e)
        return e;
    const struct cJSON *accessor = element(json_member(l->json, "accessors"), index);
    if (!accessor)
        return err_fail(ERR_FORMAT, "%s: %s: no accessor %zu", l->what, a->name, index);
    e = take_type(l, accessor, a);
    if (!e)
        e = get_index(l->what, accessor, "count", NULL, &count);
    if (!e)
        e = get_index(l->what, accessor, "byteOffset", &zero, &offset);
    if (!e)
        e = get_index(l->what, accessor, "bufferView", NULL, &view);
    if (e)
        return e;
    a->view = view > INT32_MAX ? INT32_MAX : (int)view;
    e = take_view(l, a, &stride);
    if (e)
        return e;
    if (a == l->list.a)
        l->info.n = count > GAUSSIANS_MAX ? -1 : (int)count;
    if (count < 1 || count != (size_t)l->info.n)
        return err_fail(ERR_FORMAT, "%s: %s: %zu splats, expected are %d and at most %d", l->what,
                        a->name, count, l->info.n, GAUSSIANS_MAX);
    a->stride = stride ? stride : size_of(a);
    if (a->stride < size_of(a) || offset + (count - 1) * a->stride + size_of(a) > a->to - a->from)
        return err_fail(ERR_FORMAT, "%s: %s: %zu of %zu bytes from %zu on leave bufferView %d",
                        l->what, a->name, count, a->stride, offset, a->view);
    a->p = l->bin + a->from + offset;
    return OK;
}

/* Views of different number have no byte in common. */
static err_t check_views(const struct layout *l)
{
    for (int i = 0; i < l->list.n; i++)
        for (int j = 0; j < i; j++) {
            const struct attribute *a = &l->list.a[i], *b = &l->list.a[j];
            if (a->view != b->view && a->from < b->to && b->from < a->to)
                return err_fail(ERR_FORMAT, "%s: bufferViews %d and %d overlap", l->what, a->view,
                                b->view);
        }
    return OK;
}

/* own:  json_free(l->json). */
static err_t open_layout(const struct splats_bytes *f, struct layout *l)
{
    const struct cJSON *primitive = NULL;
    memset(l, 0, sizeof *l);
    l->what = f->what;
    err_t e = open_chunks(f, l);
    if (!e)
        e = check_document(l);
    if (!e)
        e = find_primitive(l, &primitive);
    if (!e)
        e = take_extension(l, primitive);
    for (int i = 0; i < l->list.n && !e; i++)
        e = take_attribute(l, json_member(primitive, "attributes"), &l->list.a[i]);
    return e ? e : check_views(l);
}

/* ---- numbers ---- */

static float read_number(const struct attribute *a, const uint8_t *p)
{
    struct bytes b = bytes_of(p, (size_t)bytes_of_type(a->type));
    bool n = a->normalized;
    switch (a->type) {
    case TYPE_BYTE:
        return n ? fmaxf((float)(int8_t)bytes_u8(&b) / 127, -1) : (float)(int8_t)bytes_u8(&b);
    case TYPE_UBYTE:
        return (float)bytes_u8(&b) / (n ? 255 : 1);
    case TYPE_SHORT:
        return n ? fmaxf((float)(int16_t)bytes_u16(&b) / 32767, -1) : (float)(int16_t)bytes_u16(&b);
    case TYPE_USHORT:
        return (float)bytes_u16(&b) / (n ? 65535 : 1);
    case TYPE_UINT:
        return (float)bytes_u32(&b);
    default:
        return bytes_f32(&b);
    }
}

/* Plane of component k. */
static int plane_of(const struct attribute *a, int k)
{
    switch (a->source) {
    case POSITION:
        return G_MU + k;
    case ROTATION:
        return G_QUAT + (k + 1) % 4;
    case SCALE:
        return G_LOG_SCALE + k;
    case OPACITY:
        return G_LOGIT;
    default:
        return G_SH + 3 * a->harmonic + k;
    }
}

static float logit(float v)
{
    double a = fmin(fmax((double)v, 1e-9), 1 - 1e-9);
    return isfinite(v) ? (float)num_logit(a) : NAN;
}

static err_t read_attribute(const struct layout *l, const struct attribute *a, struct gaussians *g)
{
    for (int k = 0; k < a->components; k++) {
        int plane = plane_of(a, k);
        const uint8_t *p = a->p + k * bytes_of_type(a->type);
        float sign = (float)splats_sign(plane, SPLATS_LUF), *out = g->plane[plane];
        for (int i = 0; i < l->info.n; i++, p += a->stride) {
            float v = read_number(a, p);
            if (a->source == SCALE && v < 0)
                return err_fail(ERR_FORMAT,
                                "%s: %s of splat %d is %g: negative, as in drafts of the extension",
                                l->what, a->name, i, (double)v);
            out[i] = a->source == SCALE     ? splats_log_scale(v)
                     : a->source == OPACITY ? logit(v)
                                            : v * sign;
        }
    }
    return OK;
}

static err_t peek_glb(const struct splats_bytes *file, struct splats_info *out)
{
    struct layout l;
    memset(out, 0, sizeof *out);
    err_t e = open_layout(file, &l);
    json_free(l.json);
    if (!e)
        *out = l.info;
    return e;
}

static err_t parse_glb(const struct splats_bytes *file, float ev, struct arena *a,
                       struct gaussians *g, struct gaussians_report *report)
{
    struct layout l;
    size_t mark = arena_mark(a);
    memset(g, 0, sizeof *g);
    err_t e = open_layout(file, &l);
    json_free(l.json);
    if (!e)
        e = gaussians_init(g, a, l.info.n, l.info.degree);
    for (int i = 0; i < l.list.n && !e; i++)
        if (!(l.info.has_hdr && l.list.a[i].source == DISPLAY))
            e = read_attribute(&l, &l.list.a[i], g);
    if (e) {
        arena_reset(a, mark);
        memset(g, 0, sizeof *g);
        return e;
    }
    g->n = l.info.n;
    if (!l.info.has_hdr)
        splats_to_radiance(g, ev);
    gaussians_sanitize(g, report);
    return OK;
}

const struct splats_format glb_format = {UINT32_MAX, INFINITY, peek_glb, parse_glb};
