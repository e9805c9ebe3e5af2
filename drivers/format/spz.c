/* Reading: the header says how wide each array is; the arrays follow each other in one gzip stream
 * (versions 2 and 3) or in one zstd stream each, listed in a table (4). They are unpacked in small
 * batches straight into the planes of struct gaussians: once to see which records there are, for
 * version 3 has them at its very end, and once more to keep the numbers.
 * Source: load-spz.cc of the reference; that reads 4 as 3 reads, with other packing.
 * Checked are: magic, version, number of splats against GAUSSIANS_MAX and what gzip can do,
 * degree, fractional bits; of version 4 the table: sizes that the header gives, nothing missing or
 * left over; of records: length within the stream, ours in all fields. */
#include "drivers/format/spz.h"

#include "core/base/bytes.h"
#include "core/splat/display.h"
#include "drivers/format/compressed.h"
#include "drivers/format/file.h"
#include "drivers/format/splats.h"

#include <math.h>
#include <string.h>

#define SQRT1_2 0.70710678118654752

enum {
    FRACTIONAL_MAX = 30,
    RECORD_AXES = (int)0xadbe0003, // "SPZ_ADOBE_coordinate_system"
    GZIP_RATIO_MAX = 1032,         // nothing shrinks more
    ZSTD_RATIO_MAX = 32768         // blocks of at most 128 kB, at least 4 bytes each
};

static const char *const array_names[SPZ_ARRAYS] = {"positions", "alphas",    "colors",
                                                    "scales",    "rotations", "harmonics"};

struct record {
    bool found;
    int degree, steps;
    float ev, unit;
};

struct layout {
    const struct splats_bytes *file;
    struct splats_info info;
    int version, fractional, flags;
    int degree;                                      // degree of the display colours
    size_t width[SPZ_ARRAYS];                        // bytes of a splat
    struct splats_bytes stream[SPZ_ARRAYS], records; // for version 4
    unsigned axes;
    struct record record;
    float colour[256]; // first harmonic, by byte
};

static int sh_values(int degree)
{
    return (degree + 1) * (degree + 1);
}

void spz_widths(int version, int degree, size_t out[SPZ_ARRAYS])
{
    const size_t width[SPZ_ARRAYS] = {
        9, 1, 3, 3, version > 2 ? 4 : 3, 3 * (size_t)(sh_values(degree) - 1)};
    memcpy(out, width, sizeof width);
}

static double display_of(int byte)
{
    return (byte / 255.0 - 0.5) / SPZ_COLOUR_SCALE;
}

double spz_log(int byte, float ev)
{
    double linear = (double)display_decode((float)(0.5 + SH_BASIS0 * display_of(byte)));
    return log(fmax(linear, (double)DISPLAY_FLOOR)) - (double)ev * log(2);
}

/* ---- the header ---- */

static err_t take_header(const struct splats_bytes *f, const uint8_t *h, struct layout *l)
{
    struct bytes b = bytes_of(h, SPZ_HEADER_3);
    uint32_t magic = bytes_u32(&b), version = bytes_u32(&b), n = bytes_u32(&b);
    l->degree = bytes_u8(&b);
    l->fractional = bytes_u8(&b);
    l->flags = bytes_u8(&b);
    l->file = f;
    if (magic != SPZ_MAGIC)
        return err_fail(ERR_FORMAT, "%s: not an SPZ file", f->what);
    if (version < 2 || version > 4)
        return err_fail(ERR_UNSUPPORTED, "%s: version %u of SPZ, 2 to 4 are read", f->what,
                        version);
    bool impossible = version < 4 && (uint64_t)n * 9 > (uint64_t)f->n * GZIP_RATIO_MAX;
    if (n > GAUSSIANS_MAX || impossible)
        return err_fail(ERR_FORMAT, "%s: %u splats in %zu bytes, at most %d are read", f->what, n,
                        f->n, GAUSSIANS_MAX);
    if (l->degree > SH_DEGREE_MAX)
        return err_fail(ERR_FORMAT, "%s: harmonics of degree %d, 0 to %d are read", f->what,
                        l->degree, SH_DEGREE_MAX);
    if (l->fractional > FRACTIONAL_MAX)
        return err_fail(ERR_FORMAT, "%s: %d fractional bits, at most %d are read", f->what,
                        l->fractional, FRACTIONAL_MAX);
    l->version = (int)version;
    l->info.n = (int)n;
    spz_widths(l->version, l->degree, l->width);
    return OK;
}

/* Refuse counts that the packed bytes cannot hold, before memory is taken. */
static err_t check_ratio(const char *what, const char *part, size_t packed, size_t plain)
{
    if (packed >= plain / ZSTD_RATIO_MAX)
        return OK;
    return err_fail(ERR_FORMAT, "%s: %s: %zu bytes cannot unpack to %zu", what, part, packed,
                    plain);
}

/* Table of version 4: where the arrays and the records are. */
static err_t take_table(const struct splats_bytes *f, struct layout *l)
{
    const uint8_t *p = f->p;
    struct bytes b = bytes_of(p + SPZ_HEADER_3 - 1, SPZ_HEADER_4 - SPZ_HEADER_3 + 1);
    int streams = bytes_u8(&b), want = 0;
    size_t at = bytes_u32(&b), end = at + SPZ_TOC_ENTRY * (size_t)streams;
    for (int a = 0; a < SPZ_ARRAYS; a++)
        want += l->info.n > 0 && l->width[a] > 0;
    if (streams != want)
        return err_fail(ERR_FORMAT, "%s: %d streams, its header needs %d", f->what, streams, want);
    if (at < SPZ_HEADER_4 || end > f->n)
        return err_fail(ERR_FORMAT, "%s: table of %d streams at byte %zu of %zu", f->what, streams,
                        at, f->n);
    l->records = (struct splats_bytes){f->what, p + SPZ_HEADER_4, at - SPZ_HEADER_4};
    b = bytes_of(p + at, end - at);
    for (int a = 0; a < SPZ_ARRAYS && streams > 0; a++) {
        size_t size = (size_t)l->info.n * l->width[a];
        if (size == 0)
            continue;
        uint64_t packed = bytes_u64(&b), plain = bytes_u64(&b);
        if (plain != size || packed > f->n - end)
            return err_fail(ERR_FORMAT,
                            "%s: %s: %llu bytes that unpack to %llu, expected are at most %zu that "
                            "unpack to %zu",
                            f->what, array_names[a], (unsigned long long)packed,
                            (unsigned long long)plain, f->n - end, size);
        err_t e = check_ratio(f->what, array_names[a], (size_t)packed, size);
        if (e)
            return e;
        l->stream[a] = (struct splats_bytes){f->what, p + end, (size_t)packed};
        end += (size_t)packed;
    }
    if (end != f->n)
        return err_fail(ERR_FORMAT, "%s: %zu bytes behind the last stream", f->what, f->n - end);
    return OK;
}

/* ---- arrays ---- */

typedef void take_fn(const struct layout *l, const uint8_t *b, int i, struct gaussians *g);

static void take_position(const struct layout *l, const uint8_t *b, int i, struct gaussians *g)
{
    for (int k = 0; k < 3; k++, b += 3) {
        int32_t v = b[0] | b[1] << 8 | b[2] << 16;
        g->plane[G_MU + k][i] = ldexpf((float)(v < 1 << 23 ? v : v - (1 << 24)), -l->fractional);
    }
}

static void take_opacity(const struct layout *l, const uint8_t *b, int i, struct gaussians *g)
{
    (void)l;
    g->plane[G_LOGIT][i] = splats_logit(b[0]);
}

static void take_colour(const struct layout *l, const uint8_t *b, int i, struct gaussians *g)
{
    for (int c = 0; c < 3; c++)
        g->plane[G_SH + c][i] = l->colour[b[c]];
}

static void take_scale(const struct layout *l, const uint8_t *b, int i, struct gaussians *g)
{
    (void)l;
    for (int k = 0; k < 3; k++)
        g->plane[G_LOG_SCALE + k][i] = (float)(b[k] * SPZ_LOG_SCALE_STEP + SPZ_LOG_SCALE_MIN);
}

/* Version 2: x, y, z. Later: which is the largest in 2 bits, then sign and magnitude of the others
 * in x, y, z, w. */
static void take_rotation(const struct layout *l, const uint8_t *b, int i, struct gaussians *g)
{
    double q[4], rest = 1; // x, y, z, w
    int largest = 3;
    if (l->version == 2) {
        for (int k = 0; k < 3; k++)
            q[k] = b[k] / 127.5 - 1;
    } else {
        uint32_t v = b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
        largest = (int)(v >> 30);
        for (int k = 3; k >= 0; k--) {
            if (k == largest)
                continue;
            q[k] = (v & SPZ_MAGNITUDE_MAX) * SQRT1_2 / SPZ_MAGNITUDE_MAX * (v >> 9 & 1 ? -1 : 1);
            v >>= 10;
        }
    }
    for (int k = 0; k < 4; k++)
        rest -= k == largest ? 0 : q[k] * q[k];
    q[largest] = sqrt(fmax(rest, 0));
    for (int k = 0; k < 4; k++)
        g->plane[G_QUAT + (k + 1) % 4][i] = (float)q[k];
}

static void take_harmonics(const struct layout *l, const uint8_t *b, int i, struct gaussians *g)
{
    for (int j = 0; j < 3 * (sh_values(l->info.degree) - 1); j++)
        g->plane[G_SH + 3 + j][i] = (float)(b[j] - 128) / 128;
}

/* g: NULL skips the array. */
static err_t read_array(const struct layout *l, struct compressed_in *in, int a,
                        struct gaussians *g)
{
    static take_fn *const take[SPZ_ARRAYS] = {take_position, take_opacity,  take_colour,
                                              take_scale,    take_rotation, take_harmonics};
    uint8_t b[SPZ_BATCH * SPZ_WIDTH_MAX];
    for (int i = 0, m; i < l->info.n; i += m) {
        m = l->info.n - i < SPZ_BATCH ? l->info.n - i : SPZ_BATCH;
        err_t e = compressed_read(in, array_names[a], b, (size_t)m * l->width[a]);
        if (e)
            return e;
        for (int j = 0; j < m && g; j++)
            take[a](l, b + (size_t)j * l->width[a], i + j, g);
    }
    return OK;
}

/* ---- records ---- */

static err_t skip_bytes(struct compressed_in *in, size_t n)
{
    uint8_t b[4096];
    err_t e = OK;
    for (size_t m; n > 0 && !e; n -= m) {
        m = n < sizeof b ? n : sizeof b;
        e = compressed_read(in, "extension record", b, m);
    }
    return e;
}

static err_t read_plane(struct compressed_in *in, int n, float step, bool high, float *v)
{
    uint8_t b[SPZ_BATCH];
    for (int i = 0, m; i < n; i += m) {
        m = n - i < SPZ_BATCH ? n - i : SPZ_BATCH;
        err_t e = compressed_read(in, "radiance", b, (size_t)m);
        if (e)
            return e;
        for (int j = 0; j < m; j++)
            v[i + j] += step * (float)(high ? 256 * (int8_t)b[j] : b[j] - 128);
    }
    return OK;
}

static err_t read_planes(const struct layout *l, struct compressed_in *in, struct gaussians *g)
{
    err_t e = OK;
    for (int j = 0; j < 6 * sh_values(l->record.degree) && !e; j++) {
        double step = 1.0 / l->record.steps;
        e = read_plane(in, l->info.n, (float)(j < 6 ? step / SH_BASIS0 : step), j & 1,
                       g->plane[G_SH + j / 2]);
    }
    return e;
}

static err_t read_packed_planes(const struct layout *l, struct compressed_in *in, size_t n,
                                struct gaussians *g)
{
    struct compressed_in planes;
    if (in->kind != COMPRESSED_PLAIN || n > in->left)
        return err_fail(ERR_FORMAT, "%s: radiance record of %zu packed bytes, %zu are left",
                        l->file->what, n, in->left);
    size_t size = 6 * (size_t)sh_values(l->record.degree) * (size_t)l->info.n;
    err_t e = check_ratio(l->file->what, "radiance", n, size);
    if (e || !g)
        return e ? e : skip_bytes(in, n);
    e = compressed_open(&planes, l->file->what, COMPRESSED_ZSTD, in->p, n);
    if (!e)
        e = read_planes(l, &planes, g);
    if (!e)
        e = compressed_finish(&planes, "radiance");
    compressed_close(&planes);
    return e ? e : skip_bytes(in, n);
}

static err_t read_radiance(struct layout *l, struct compressed_in *in, size_t n,
                           struct gaussians *g)
{
    const char *what = l->file->what;
    uint8_t head[SPZ_RADIANCE_HEAD];
    if (n < SPZ_RADIANCE_HEAD)
        return err_fail(ERR_FORMAT, "%s: radiance record of %zu bytes", what, n);
    err_t e = compressed_read(in, "radiance record", head, SPZ_RADIANCE_HEAD);
    if (e)
        return e;
    struct bytes b = bytes_of(head, SPZ_RADIANCE_HEAD);
    int version = bytes_u8(&b), degree = bytes_u8(&b), steps = bytes_u8(&b), form = bytes_u8(&b);
    float ev = bytes_f32(&b), unit = bytes_f32(&b);
    if (version != SPZ_RADIANCE_VERSION)
        return err_fail(ERR_UNSUPPORTED, "%s: radiance record of version %d, this program reads %d",
                        what, version, SPZ_RADIANCE_VERSION);
    if (degree > SH_DEGREE_MAX || steps < 1 || form > 1 || !(fabsf(ev) <= 128) ||
        !(fabs(log2((double)unit)) <= SPZ_UNIT_LOG2_MAX))
        return err_fail(ERR_FORMAT,
                        "%s: radiance record: degree %d, %d steps, form %d, ev %g, unit %g", what,
                        degree, steps, form, (double)ev, (double)unit);
    l->record = (struct record){true, degree, steps, ev, unit};
    size_t planes = 6 * (size_t)sh_values(degree) * (size_t)l->info.n;
    n -= SPZ_RADIANCE_HEAD;
    if (form == 1)
        return read_packed_planes(l, in, n, g);
    if (n != planes)
        return err_fail(ERR_FORMAT, "%s: radiance record of %zu bytes, %d splats need %zu", what, n,
                        l->info.n, planes);
    return g ? read_planes(l, in, g) : skip_bytes(in, n);
}

/* Names of axes in the reference: bits right, up, forward; 9 to 16 are turned by 90 degrees. */
static err_t read_axes(struct layout *l, struct compressed_in *in, size_t n)
{
    uint8_t b[4];
    if (n != sizeof b)
        return err_fail(ERR_FORMAT, "%s: record of axes of %zu bytes", l->file->what, n);
    err_t e = compressed_read(in, "record of axes", b, sizeof b);
    if (e)
        return e;
    struct bytes at = bytes_of(b, sizeof b);
    uint32_t v = bytes_u32(&at);
    if (v < 1 || v > 8)
        return err_fail(ERR_UNSUPPORTED, "%s: axes %u, 1 to 8 are read", l->file->what, v);
    l->axes = (v - 1) ^ 5;
    return OK;
}

/* Without the flag for them only ours counts, and what else may follow is none. */
static err_t read_records(struct layout *l, struct compressed_in *in, struct gaussians *g)
{
    const bool flagged = l->flags & SPZ_HAS_RECORDS;
    bool seen = false;
    for (;;) {
        uint8_t head[8];
        size_t got;
        err_t e = compressed_some(in, "extension record", head, sizeof head, &got);
        if (e || got == 0)
            return e;
        struct bytes b = bytes_of(head, got);
        uint32_t type = bytes_u32(&b), n = bytes_u32(&b);
        if (!flagged && (seen || type != SPZ_RADIANCE))
            return OK;
        if (b.bad)
            return err_fail(ERR_FORMAT, "%s: extension record: cut off", l->file->what);
        if (type == SPZ_RADIANCE && seen)
            return err_fail(ERR_FORMAT, "%s: two radiance records", l->file->what);
        seen |= type == SPZ_RADIANCE;
        if (type == SPZ_RADIANCE)
            e = read_radiance(l, in, n, g);
        else
            e = type == (uint32_t)RECORD_AXES ? read_axes(l, in, n) : skip_bytes(in, n);
        if (e)
            return e;
    }
}

/* ---- the file ---- */

static bool is_wanted(const struct layout *l, int a)
{
    return a != SPZ_HARMONICS || !l->record.found;
}

/* Versions 2 and 3. */
static err_t read_stream(struct layout *l, struct gaussians *g)
{
    struct compressed_in in;
    uint8_t head[SPZ_HEADER_3], more;
    size_t got;
    err_t e = compressed_open(&in, l->file->what, COMPRESSED_GZIP, l->file->p, l->file->n);
    if (!e)
        e = compressed_read(&in, "header", head, sizeof head);
    if (!e && !g)
        e = take_header(l->file, head, l);
    if (!e && !g && l->version > 3)
        e = err_fail(ERR_FORMAT, "%s: version %d in a gzip stream", l->file->what, l->version);
    for (int a = 0; a < SPZ_ARRAYS && !e; a++)
        e = read_array(l, &in, a, is_wanted(l, a) ? g : NULL);
    if (!e)
        e = read_records(l, &in, g);
    if (!e)
        e = compressed_some(&in, "end", &more, 1, &got); // its checksum
    compressed_close(&in);
    return e;
}

/* Version 4. */
static err_t read_streams(struct layout *l, struct gaussians *g)
{
    struct compressed_in in;
    err_t e = OK;
    for (int a = 0; a < SPZ_ARRAYS && !e && g; a++) {
        if (!is_wanted(l, a) || l->stream[a].n == 0)
            continue;
        e = compressed_open(&in, l->file->what, COMPRESSED_ZSTD, l->stream[a].p, l->stream[a].n);
        if (!e)
            e = read_array(l, &in, a, g);
        if (!e)
            e = compressed_finish(&in, array_names[a]);
        compressed_close(&in);
    }
    if (e)
        return e;
    e = compressed_open(&in, l->file->what, COMPRESSED_PLAIN, l->records.p, l->records.n);
    return e ? e : read_records(l, &in, g);
}

static err_t read_layout(const struct splats_bytes *f, struct layout *l)
{
    const uint8_t *p = f->p;
    err_t e;
    memset(l, 0, sizeof *l);
    l->file = f;
    l->axes = SPLATS_RUB;
    if (f->n >= 2 && p[0] == 0x1f && p[1] == 0x8b) {
        e = read_stream(l, NULL);
    } else {
        if (f->n < SPZ_HEADER_4)
            return err_fail(ERR_FORMAT, "%s: not an SPZ file", f->what);
        e = take_header(f, p, l);
        if (!e && l->version != 4)
            e = err_fail(ERR_FORMAT, "%s: version %d outside a gzip stream", f->what, l->version);
        if (!e)
            e = take_table(f, l);
        if (!e)
            e = read_streams(l, NULL);
    }
    l->info.has_hdr = l->record.found;
    l->info.ev = l->record.ev;
    l->info.band_lost = !l->record.found && l->degree > DISPLAY_DEGREE_MAX;
    l->info.degree = l->record.found                  ? l->record.degree
                     : l->degree > DISPLAY_DEGREE_MAX ? DISPLAY_DEGREE_MAX
                                                      : l->degree;
    return e;
}

/* From the file's axes and lengths to the scene's. */
static void to_scene(const struct layout *l, struct gaussians *g)
{
    float unit = l->record.found ? l->record.unit : 1;
    for (int p = 0; p < gaussians_planes(g->degree); p++) {
        bool length = p >= G_MU && p < G_MU + 3;
        float factor = (float)splats_sign(p, l->axes) / (length ? unit : 1);
        float shift = p >= G_LOG_SCALE && p < G_LOG_SCALE + 3 ? -logf(unit) : 0;
        for (int i = 0; i < l->info.n; i++)
            g->plane[p][i] = g->plane[p][i] * factor + shift;
    }
}

static err_t peek_spz(const struct splats_bytes *file, struct splats_info *out)
{
    struct layout l;
    memset(out, 0, sizeof *out);
    err_t e = read_layout(file, &l);
    if (!e)
        *out = l.info;
    return e;
}

static err_t parse_spz(const struct splats_bytes *file, float ev, struct arena *a,
                       struct gaussians *g, struct gaussians_report *report)
{
    struct layout l;
    size_t mark = arena_mark(a);
    memset(g, 0, sizeof *g);
    err_t e = read_layout(file, &l);
    if (!e)
        e = gaussians_init(g, a, l.info.n, l.info.degree);
    if (e)
        return e;
    for (int b = 0; b < 256; b++)
        l.colour[b] = (float)(l.record.found ? spz_log(b, l.record.ev) / SH_BASIS0 : display_of(b));
    e = l.version < 4 ? read_stream(&l, g) : read_streams(&l, g);
    if (e) {
        arena_reset(a, mark);
        memset(g, 0, sizeof *g);
        return e;
    }
    g->n = l.info.n;
    to_scene(&l, g);
    if (!l.record.found)
        splats_to_radiance(g, ev);
    gaussians_sanitize(g, report);
    return OK;
}

const struct splats_format spz_format = {(uint64_t)64 << 30, SPZ_HEADROOM, peek_spz, parse_spz};
