/* The arrays are made in small batches straight from the planes of struct gaussians, each number as
 * the nearest that the format has; then the record with the radiance (spz.h). Lengths and angles
 * are no finer than pictures show, since noise in their last bits does not compress. */
#include "drivers/format/spzwrite.h"

#include "core/base/bytes.h"
#include "core/photo/metrics.h"
#include "core/splat/display.h"
#include "drivers/format/compressed.h"
#include "drivers/format/file.h"
#include "drivers/format/splats.h"
#include "drivers/format/spz.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define SQRT1_2 0.70710678118654752
#define POSITION_BITS 1.75 // below the median splat's sigma; one more bit is 4 dB and 0.6 bytes

enum {
    FRACTIONAL_MAX = 23, // a 24-bit number between -1 and 1
    COARSEST = 32,       // part of SPZ_MAGNITUDE_MAX
    THINNEST = 8,        // part of SPZ_LOG_SCALE_STEP
    STEPS = 16           // per natural logarithm of radiance
};

static int sh_values(int degree)
{
    return (degree + 1) * (degree + 1);
}

struct plan {
    const char *path;
    const struct gaussians *g;
    float ev, unit;
    int fractional;
    int degree; // degree of the display colours
    size_t width[SPZ_ARRAYS];
    uint8_t *shown; // (n, 3 K): bytes of SPZ_COLOURS and then of SPZ_HARMONICS
};

static uint8_t to_byte(double v)
{
    return (uint8_t)lrint(fmin(fmax(v, 0), 255));
}

/* Coarser than a byte, as the reference writes them: 5 bits for band 1, 4 for the others. */
static uint8_t to_bucket(double v, int size)
{
    return to_byte(rint((128 * v) / size) * size + 128);
}

static void find_display(struct plan *p)
{
    const struct gaussians *g = p->g;
    int planes = 3 * sh_values(g->degree), shown = 3 * sh_values(p->degree);
    for (int i = 0; i < g->n; i++) {
        float sh[3 * SH_COEFS_MAX], f[3 * SH_COEFS_MAX];
        uint8_t *b = p->shown + (size_t)i * (size_t)shown;
        for (int j = 0; j < planes; j++)
            sh[j] = g->plane[G_SH + j][i];
        display_from_radiance(sh, g->degree, p->ev, f);
        for (int j = 0; j < 3; j++)
            b[j] = to_byte(255 * (SPZ_COLOUR_SCALE * (double)f[j] + 0.5));
        for (int j = 3; j < shown; j++)
            b[j] = to_bucket((double)f[j] * splats_sign(G_SH + j, SPLATS_RUB), j < 12 ? 8 : 16);
    }
}

/* Unit: 1, or what brings the sizes of splats into the range that the format has. Positions get as
 * many bits as the size of the middle splat asks for, and all of them fit. */
static err_t choose_lengths(struct plan *p)
{
    const struct gaussians *g = p->g;
    double low = 0, middle = -INFINITY, high = -INFINITY, far = 0;
    for (int k = 0; k < 3 && g->n > 0; k++) {
        static const double at[3] = {0.01, 0.5, 1};
        double q[3];
        for (int j = 0; j < 3; j++) {
            err_t e = metrics_quantile(g->plane[G_LOG_SCALE + k], (size_t)g->n, at[j], &q[j]);
            if (e)
                return e;
        }
        low = fmin(low, q[0]);
        middle = fmax(middle, q[1]);
        high = fmax(high, q[2]);
        for (int i = 0; i < g->n; i++)
            far = fmax(far, fabs((double)g->plane[G_MU + k][i]));
    }
    double room = log2(SPZ_POSITION_MAX / fmax(far, 1e-30)),
           most = (SPZ_LOG_SCALE_MAX - high) / log(2);
    double shift = low < SPZ_LOG_SCALE_MIN ? ceil((SPZ_LOG_SCALE_MIN - low) / log(2)) : 0;
    shift = fmax(fmin(fmin(shift, floor(most)), floor(room)), -SPZ_UNIT_LOG2_MAX);
    double want = POSITION_BITS - middle / log(2) - shift;
    if (shift > 0 && shift + 1 <= most) // no length means anything: exactly as fine as wanted
        shift += want - floor(want);
    double bits = fmin(ceil(POSITION_BITS - middle / log(2) - shift - 1e-6), floor(room - shift));
    p->fractional = (int)fmax(fmin(bits, FRACTIONAL_MAX), 0);
    p->unit = (float)exp2(fmin(shift, SPZ_UNIT_LOG2_MAX));
    return OK;
}

typedef void put_fn(const struct plan *p, int i, uint8_t *b);

static void put_position(const struct plan *p, int i, uint8_t *b)
{
    for (int k = 0; k < 3; k++, b += 3) {
        double x = (double)p->g->plane[G_MU + k][i] * splats_sign(G_MU + k, SPLATS_RUB);
        double step = ldexp(x * (double)p->unit, p->fractional);
        int32_t v = (int32_t)lrint(fmin(fmax(step, -SPZ_POSITION_MAX), SPZ_POSITION_MAX));
        b[0] = (uint8_t)v;
        b[1] = (uint8_t)(v >> 8);
        b[2] = (uint8_t)(v >> 16);
    }
}

static void put_opacity(const struct plan *p, int i, uint8_t *b)
{
    b[0] = to_byte(255 / (1 + exp(-(double)p->g->plane[G_LOGIT][i])));
}

static void put_colour(const struct plan *p, int i, uint8_t *b)
{
    memcpy(b, p->shown + (size_t)i * 3 * (size_t)sh_values(p->degree), 3);
}

/* The same splat with its axes in another order or direction. */
struct pose {
    double q[4]; // w, x, y, z, of unit length and nearest to no rotation at all
    int axis[3]; // which axis of the splat is the first one, ...
};

/* Picks the naming of the axes with the largest w, out of 24: numbers that vary less pack better.
 * R S S R' stays as it is if R becomes R G and S becomes G' S G, for a G that permutes axes. */
static struct pose pose_of(const struct gaussians *g, int i)
{
    static const signed char turns[24][4] = {
        {1, 0, 0, 0},  {0, 1, 0, 0},   {0, 0, 1, 0},   {0, 0, 0, 1},   {1, 1, 0, 0},
        {1, -1, 0, 0}, {1, 0, 1, 0},   {1, 0, -1, 0},  {1, 0, 0, 1},   {1, 0, 0, -1},
        {0, 1, 1, 0},  {0, 1, -1, 0},  {0, 1, 0, 1},   {0, 1, 0, -1},  {0, 0, 1, 1},
        {0, 0, 1, -1}, {1, 1, 1, 1},   {1, 1, 1, -1},  {1, 1, -1, 1},  {1, 1, -1, -1},
        {1, -1, 1, 1}, {1, -1, 1, -1}, {1, -1, -1, 1}, {1, -1, -1, -1}};
    double q[4], length = 0, most = -1;
    const signed char *t = turns[0];
    for (int k = 0; k < 4; k++) {
        q[k] = (double)g->plane[G_QUAT + k][i] * splats_sign(G_QUAT + k, SPLATS_RUB);
        length += q[k] * q[k];
    }
    for (int j = 0; j < 24; j++) {
        const signed char *c = turns[j];
        double w = fabs(q[0] * c[0] - q[1] * c[1] - q[2] * c[2] - q[3] * c[3]) /
                   sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2] + c[3] * c[3]);
        if (w > most * (1 + 1e-9)) { // the first of those that are equal
            most = w;
            t = c;
        }
    }
    int w = t[0], x = t[1], y = t[2], z = t[3], square = w * w + x * x + y * y + z * z;
    length = sqrt(length * square);
    const int turned[3][3] = {
        {w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)},
        {2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)},
        {2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z}};
    struct pose out = {{(q[0] * w - q[1] * x - q[2] * y - q[3] * z) / length,
                        (q[0] * x + q[1] * w + q[2] * z - q[3] * y) / length,
                        (q[0] * y - q[1] * z + q[2] * w + q[3] * x) / length,
                        (q[0] * z + q[1] * y - q[2] * x + q[3] * w) / length},
                       {0, 0, 0}};
    for (int k = 0; k < 3; k++)
        out.axis[k] = turned[k][0] ? 0 : turned[k][1] ? 1 : 2;
    return out;
}

/* Step of the length of an axis, a power of two: an axis that is thin beside the middle one matters
 * by its square only. */
static int axis_step(const double length[3], int k)
{
    double lo = fmin(length[0], length[1]), hi = fmax(length[0], length[1]);
    double middle = fmax(lo, fmin(hi, length[2]));
    double step = exp(fmin(2 * (middle - length[k]), 20));
    return step >= THINNEST ? THINNEST : step >= 2 ? 1 << ilogb(step) : 1;
}

static void put_scale(const struct plan *p, int i, uint8_t *b)
{
    struct pose pose = pose_of(p->g, i);
    double length[3];
    for (int k = 0; k < 3; k++)
        length[k] = (double)p->g->plane[G_LOG_SCALE + pose.axis[k]][i] + log((double)p->unit);
    for (int k = 0; k < 3; k++) {
        int step = axis_step(length, k);
        double v = (length[k] - SPZ_LOG_SCALE_MIN) / SPZ_LOG_SCALE_STEP;
        b[k] = to_byte(fmin(rint(v / step) * step, 255));
    }
}

/* Step of the magnitudes in a quaternion, a power of two, that moves the ends of a splat no more
 * than a step of its position does. */
static int magnitude_step(const struct plan *p, int i)
{
    double longest = -INFINITY;
    for (int k = 0; k < 3; k++)
        longest = fmax(longest, (double)p->g->plane[G_LOG_SCALE + k][i]);
    double reach = exp(fmin(longest, GAUSSIANS_LOG_SCALE_MAX)) * (double)p->unit;
    double angle = ldexp(1, -p->fractional) / fmax(reach, 1e-30);
    double step = angle / (2 * SQRT1_2 / SPZ_MAGNITUDE_MAX);
    return step >= COARSEST ? COARSEST : step >= 2 ? 1 << ilogb(step) : 1;
}

/* The largest component is w, 3; sign and magnitude of x, y, z follow. */
static void put_rotation(const struct plan *p, int i, uint8_t *b)
{
    struct pose pose = pose_of(p->g, i);
    int step = magnitude_step(p, i);
    uint32_t v = 3;
    for (int k = 1; k < 4; k++) {
        double m = fabs(pose.q[k]) / SQRT1_2 * SPZ_MAGNITUDE_MAX;
        v = v << 10 | (uint32_t)(pose.q[k] * pose.q[0] < 0) << 9 |
            (uint32_t)lrint(m / step) * (uint32_t)step;
    }
    bytes_put_u32(b, v);
}

static void put_harmonics(const struct plan *p, int i, uint8_t *b)
{
    size_t n = 3 * (size_t)sh_values(p->degree);
    memcpy(b, p->shown + (size_t)i * n + 3, n - 3);
}

static err_t put_array(const struct plan *p, struct compressed_out *out, int a, size_t width)
{
    static put_fn *const put[SPZ_ARRAYS] = {put_position, put_opacity,  put_colour,
                                            put_scale,    put_rotation, put_harmonics};
    uint8_t b[SPZ_BATCH * SPZ_WIDTH_MAX];
    err_t e = OK;
    for (int i = 0, m; i < p->g->n && !e; i += m) {
        m = p->g->n - i < SPZ_BATCH ? p->g->n - i : SPZ_BATCH;
        for (int j = 0; j < m; j++)
            put[a](p, i + j, b + (size_t)j * width);
        e = compressed_put(out, b, (size_t)m * width);
    }
    return e;
}

/* Corrections of plane j, in steps, for one of the two arrays. */
static err_t put_plane(const struct plan *p, struct compressed_out *out, int j, bool high)
{
    int shown = 3 * sh_values(p->degree);
    double scale = (j < 3 ? SH_BASIS0 : splats_sign(G_SH + j, SPLATS_RUB)) * STEPS, told[256];
    uint8_t b[SPZ_BATCH];
    err_t e = OK;
    for (int v = 0; v < 256; v++)
        told[v] = j < 3 ? spz_log(v, p->ev) * STEPS : 0;
    for (int i = 0, m; i < p->g->n && !e; i += m) {
        m = p->g->n - i < SPZ_BATCH ? p->g->n - i : SPZ_BATCH;
        for (int k = 0; k < m; k++) {
            uint8_t byte = p->shown[(size_t)(i + k) * (size_t)shown + (size_t)(j < 3 ? j : 0)];
            double r = (double)p->g->plane[G_SH + j][i + k] * scale - told[byte];
            int v = (int)lrint(fmin(fmax(r, -32000), 32000)) + 128;
            b[k] = (uint8_t)(high ? v >> 8 : v);
        }
        e = compressed_put(out, b, (size_t)m);
    }
    return e;
}

static err_t put_planes(const struct plan *p, struct compressed_out *out)
{
    err_t e = OK;
    for (int j = 0; j < 6 * sh_values(p->g->degree) && !e; j++)
        e = put_plane(p, out, j / 2, j & 1);
    return e;
}

/* form 1: length is not known yet. Returns the position after it. */
static uint8_t *record_head(const struct plan *p, int form, uint32_t length, uint8_t *b)
{
    b = bytes_put_u32(b, SPZ_RADIANCE);
    b = bytes_put_u32(b, length);
    *b++ = SPZ_RADIANCE_VERSION;
    *b++ = (uint8_t)p->g->degree;
    *b++ = STEPS;
    *b++ = (uint8_t)form;
    b = bytes_put_f32(b, p->ev);
    return bytes_put_f32(b, p->unit);
}

static uint8_t *file_head(const struct plan *p, int version, uint8_t *b)
{
    b = bytes_put_u32(b, SPZ_MAGIC);
    b = bytes_put_u32(b, (uint32_t)version);
    b = bytes_put_u32(b, (uint32_t)p->g->n);
    *b++ = (uint8_t)p->degree;
    *b++ = (uint8_t)p->fractional;
    *b++ = 0; // flags: spz.h
    *b++ = 0;
    return b;
}

static err_t write_3(const struct plan *p, FILE *f)
{
    struct compressed_out out;
    uint8_t b[SPZ_HEADER_3 + 8 + SPZ_RADIANCE_HEAD];
    size_t planes = 6 * (size_t)sh_values(p->g->degree) * (size_t)p->g->n;
    file_head(p, 3, b);
    record_head(p, 0, (uint32_t)(SPZ_RADIANCE_HEAD + planes), b + SPZ_HEADER_3);
    err_t e = compressed_begin(&out, p->path, COMPRESSED_GZIP, f, 0), end;
    if (!e)
        e = compressed_put(&out, b, SPZ_HEADER_3);
    for (int a = 0; a < SPZ_ARRAYS && !e; a++)
        e = put_array(p, &out, a, p->width[a]);
    if (!e)
        e = compressed_put(&out, b + SPZ_HEADER_3, 8 + SPZ_RADIANCE_HEAD);
    if (!e)
        e = put_planes(p, &out);
    end = compressed_end(&out);
    return e ? e : end;
}

/* One zstd stream: array a, or for SPZ_ARRAYS the planes of the record. out: its bytes. */
static err_t put_stream(const struct plan *p, int a, FILE *f, long *bytes)
{
    struct compressed_out out;
    long from = ftell(f);
    size_t each = a < SPZ_ARRAYS ? p->width[a] : 6 * (size_t)sh_values(p->g->degree);
    err_t e = compressed_begin(&out, p->path, COMPRESSED_ZSTD, f, each * (size_t)p->g->n), end;
    if (!e)
        e = a < SPZ_ARRAYS ? put_array(p, &out, a, p->width[a]) : put_planes(p, &out);
    end = compressed_end(&out);
    *bytes = ftell(f) - from;
    return e ? e : end;
}

/* Sizes are known when everything is written: the head and the table are written twice. */
static err_t write_4(const struct plan *p, FILE *f)
{
    uint8_t head[SPZ_HEADER_4 + 8 + SPZ_RADIANCE_HEAD] = {0},
                                    table[SPZ_ARRAYS * SPZ_TOC_ENTRY] = {0}, *t = table;
    int streams = 0;
    long bytes;
    for (int a = 0; a < SPZ_ARRAYS; a++)
        streams += p->g->n > 0 && p->width[a] > 0;
    fwrite(head, 1, sizeof head, f);
    err_t e = put_stream(p, SPZ_ARRAYS, f, &bytes);
    long toc = ftell(f);
    file_head(p, 4, head);
    head[SPZ_HEADER_3 - 1] = (uint8_t)streams;
    bytes_put_u32(head + SPZ_HEADER_3, (uint32_t)toc);
    record_head(p, 1, (uint32_t)(SPZ_RADIANCE_HEAD + bytes), head + SPZ_HEADER_4);
    fwrite(table, SPZ_TOC_ENTRY, (size_t)streams, f);
    for (int a = 0; a < SPZ_ARRAYS && !e; a++) {
        if (p->g->n == 0 || p->width[a] == 0)
            continue;
        e = put_stream(p, a, f, &bytes);
        t = bytes_put_u64(t, (uint64_t)bytes);
        t = bytes_put_u64(t, (uint64_t)p->g->n * p->width[a]);
    }
    if (e)
        return e;
    if (fseek(f, 0, SEEK_SET) == 0) {
        fwrite(head, 1, sizeof head, f);
        if (fseek(f, toc, SEEK_SET) == 0) {
            fwrite(table, SPZ_TOC_ENTRY, (size_t)streams, f);
            return OK;
        }
    }
    return err_fail(file_code(errno), "%s: writing failed: %s", p->path, strerror(errno));
}

err_t spzwrite_scene(const char *path, const struct scene *s, int version)
{
    const struct gaussians *g = &s->g;
    struct plan p = {.path = path, .g = g, .ev = display_ev(&s->tone)};
    FILE *f = NULL;
    if (version != 3 && version != 4)
        return err_fail(ERR_ARG, "%s: version %d of SPZ, 3 and 4 are written", path, version);
    err_t e = splats_check(path, g);
    if (!e)
        e = choose_lengths(&p);
    if (e)
        return e;
    p.degree = g->degree < DISPLAY_DEGREE_MAX ? g->degree : DISPLAY_DEGREE_MAX;
    spz_widths(version, p.degree, p.width);
    p.shown = malloc((size_t)g->n * 3 * (size_t)sh_values(p.degree) + 1);
    if (!p.shown)
        return err_fail(ERR_NOMEM, "%s: no memory for the colours of %d splats", path, g->n);
    find_display(&p);
    e = file_create(path, &f);
    if (!e) {
        e = version == 3 ? write_3(&p, f) : write_4(&p, f);
        if (e)
            file_discard(f, path);
        else
            e = file_finish(f, path);
    }
    free(p.shown);
    return e;
}
