/* Every section is checked completely from its header and the lengths of its buckets; then its rows
 * are read one after the other, with the bucket that the next row belongs to. */
#include "drivers/format/ksplat.h"

#include "core/base/bytes.h"
#include "core/base/half.h"

#include <math.h>
#include <string.h>

enum {
    HEADER = 4096,
    SECTION = 1024,
    SECTIONS_MAX = 1 << 16,
    LEVELS = 3,
    BUCKET = 12, // bytes
    RANGE = 32767,
    DEGREE_MAX = 3
};
#define HARMONICS_RANGE 1.5f

struct layout {
    const char *what;
    const uint8_t *p;
    size_t n, next; // bytes; where the next section's data begin
    uint32_t n_sections, n_splats;
    int level;
    float least, most;
};

struct section {
    uint32_t n, in_bucket, n_buckets, n_full, n_partial;
    int degree;
    float step, range; // of positions
    const uint8_t *lengths, *buckets, *rows;
    size_t row; // bytes
};

static int harmonics(int degree)
{
    return 3 * degree * (degree + 2);
}

/* Bytes of a number of position, scale and rotation, and of a harmonic. */
static size_t number_bytes(int level)
{
    return level == 0 ? 4 : 2;
}

static size_t harmonic_bytes(int level)
{
    return level == 0 ? 4 : level == 1 ? 2 : 1;
}

static uint32_t u32_at(const uint8_t *p)
{
    struct bytes b = bytes_of(p, 4);
    return bytes_u32(&b);
}

static uint16_t u16_at(const uint8_t *p)
{
    struct bytes b = bytes_of(p, 2);
    return bytes_u16(&b);
}

static float f32_at(const uint8_t *p)
{
    struct bytes b = bytes_of(p, 4);
    return bytes_f32(&b);
}

/* ---- headers ---- */

static err_t open_layout(const struct splats_bytes *f, struct layout *l)
{
    *l = (struct layout){.what = f->what, .p = f->p, .n = f->n};
    if (f->n < HEADER)
        return err_fail(ERR_FORMAT, "%s: %zu bytes, a header of .ksplat has %d", f->what, f->n,
                        HEADER);
    if (l->p[0] != 0 || l->p[1] < 1)
        return err_fail(ERR_UNSUPPORTED, "%s: version %d.%d of .ksplat, 0.1 is read", f->what,
                        l->p[0], l->p[1]);
    l->n_sections = u32_at(l->p + 4);
    l->n_splats = u32_at(l->p + 16);
    l->level = u16_at(l->p + 20);
    l->least = f32_at(l->p + 36);
    l->most = f32_at(l->p + 40);
    l->least = l->least == 0 ? -HARMONICS_RANGE : l->least;
    l->most = l->most == 0 ? HARMONICS_RANGE : l->most;
    l->next = HEADER + (size_t)l->n_sections * SECTION;
    if (l->level >= LEVELS)
        return err_fail(ERR_UNSUPPORTED, "%s: level %d of .ksplat, 0 to %d are read", f->what,
                        l->level, LEVELS - 1);
    if (l->n_splats > GAUSSIANS_MAX || l->n_sections > SECTIONS_MAX || l->next > f->n)
        return err_fail(ERR_FORMAT, "%s: %u splats, at most %d are read, in %u sections; %zu bytes",
                        f->what, l->n_splats, GAUSSIANS_MAX, l->n_sections, f->n);
    return OK;
}

/* Its buckets hold all of its splats. */
static err_t check_buckets(const struct layout *l, uint32_t i, const struct section *s)
{
    uint64_t room = (uint64_t)s->n_full * s->in_bucket;
    for (uint32_t k = 0; k < s->n_partial; k++)
        room += u32_at(s->lengths + 4 * (size_t)k);
    if (l->level == 0 || (room >= s->n && (uint64_t)s->n_full + s->n_partial <= s->n_buckets))
        return OK;
    return err_fail(ERR_FORMAT, "%s: section %u: %u splats, %u full and %u other of %u buckets",
                    l->what, i, s->n, s->n_full, s->n_partial, s->n_buckets);
}

/* The header of section i, and where its data are. */
static err_t open_section(struct layout *l, uint32_t i, struct section *s)
{
    const uint8_t *h = l->p + HEADER + (size_t)i * SECTION;
    const uint32_t room = u32_at(h + 4), range = u32_at(h + 24);
    const size_t bucket = u16_at(h + 20);
    *s = (struct section){.n = u32_at(h),
                          .in_bucket = u32_at(h + 8),
                          .n_buckets = u32_at(h + 12),
                          .n_full = u32_at(h + 32),
                          .n_partial = u32_at(h + 36),
                          .degree = u16_at(h + 40),
                          .range = (float)(range ? range : RANGE)};
    s->step = f32_at(h + 16) / 2 / s->range;
    if (s->degree > DEGREE_MAX || s->n > room)
        return err_fail(ERR_FORMAT, "%s: section %u: degree %d, %u splats where %u have room",
                        l->what, i, s->degree, s->n, room);
    if (l->level > 0 && s->n > 0 && bucket != BUCKET)
        return err_fail(ERR_FORMAT, "%s: section %u: buckets of %zu bytes, expected %d", l->what, i,
                        bucket, BUCKET);
    s->row =
        10 * number_bytes(l->level) + 4 + (size_t)harmonics(s->degree) * harmonic_bytes(l->level);
    const uint64_t lengths = 4 * (uint64_t)s->n_partial, buckets = (uint64_t)bucket * s->n_buckets;
    const uint64_t rows = (uint64_t)s->row * room; // none of these nears 2^63
    if (lengths + buckets + rows > l->n - l->next)
        return err_fail(ERR_FORMAT, "%s: section %u leaves the file, which has %zu bytes", l->what,
                        i, l->n);
    s->lengths = l->p + l->next;
    s->buckets = s->lengths + lengths;
    s->rows = s->buckets + buckets;
    l->next += (size_t)(lengths + buckets + rows);
    return check_buckets(l, i, s);
}

static err_t peek_ksplat(const struct splats_bytes *file, struct splats_info *out)
{
    struct layout l;
    uint64_t n = 0;
    memset(out, 0, sizeof *out);
    err_t e = open_layout(file, &l);
    for (uint32_t i = 0; !e && i < l.n_sections; i++) {
        struct section s;
        e = open_section(&l, i, &s);
        n += s.n;
        out->degree = s.n > 0 && s.degree > out->degree ? s.degree : out->degree;
    }
    if (!e && n != l.n_splats)
        e = err_fail(ERR_FORMAT, "%s: %llu splats in its sections, its header says %u", file->what,
                     (unsigned long long)n, l.n_splats);
    if (e)
        memset(out, 0, sizeof *out);
    else
        out->n = (int)n;
    return e;
}

/* ---- rows ---- */

static float take_number(const struct layout *l, struct bytes *b)
{
    return l->level == 0 ? bytes_f32(b) : half_to_float(bytes_u16(b));
}

static float take_harmonic(const struct layout *l, struct bytes *b)
{
    if (l->level < 2)
        return take_number(l, b);
    return l->least + (float)bytes_u8(b) / 255 * (l->most - l->least);
}

/* bucket: the one of a row whose positions are relative. */
static void take_row(const struct layout *l, const struct section *s, uint32_t bucket,
                     struct bytes *b, struct gaussians *g)
{
    const int i = g->n++;
    for (int k = 0; k < 3; k++)
        g->plane[G_MU + k][i] =
            l->level == 0 ? bytes_f32(b)
                          : ((float)bytes_u16(b) - s->range) * s->step +
                                f32_at(s->buckets + (size_t)bucket * BUCKET + 4 * (size_t)k);
    for (int k = 0; k < 3; k++)
        g->plane[G_LOG_SCALE + k][i] = splats_log_scale(take_number(l, b));
    for (int k = 0; k < 4; k++)
        g->plane[G_QUAT + k][i] = take_number(l, b);
    for (int c = 0; c < 3; c++)
        g->plane[G_SH + c][i] = splats_colour(bytes_u8(b));
    g->plane[G_LOGIT][i] = splats_logit(bytes_u8(b));
    for (int band = 1; band <= s->degree; band++)
        for (int c = 0; c < 3; c++)
            for (int j = band * band; j < (band + 1) * (band + 1); j++)
                g->plane[G_SH + 3 * j + c][i] = take_harmonic(l, b);
}

/* Splats of bucket k; any number where there are none. */
static uint64_t bucket_room(const struct layout *l, const struct section *s, uint32_t k)
{
    if (l->level == 0)
        return UINT64_MAX;
    return k < s->n_full ? s->in_bucket : u32_at(s->lengths + 4 * (size_t)(k - s->n_full));
}

static void take_section(const struct layout *l, const struct section *s, struct gaussians *g)
{
    struct bytes b = bytes_of(s->rows, s->n * s->row);
    uint32_t bucket = 0;
    uint64_t left = s->n > 0 ? bucket_room(l, s, 0) : 0;
    for (uint32_t i = 0; i < s->n; i++, left--) {
        while (left == 0) // open_section has seen that there is one
            left = bucket_room(l, s, ++bucket);
        take_row(l, s, bucket, &b, g);
    }
}

static err_t parse_ksplat(const struct splats_bytes *file, float ev, struct arena *a,
                          struct gaussians *g, struct gaussians_report *report)
{
    struct splats_info info;
    struct layout l;
    memset(g, 0, sizeof *g);
    err_t e = peek_ksplat(file, &info);
    if (!e)
        e = gaussians_init(g, a, info.n, info.degree);
    if (!e)
        e = open_layout(file, &l);
    for (uint32_t i = 0; !e && i < l.n_sections; i++) {
        struct section s;
        e = open_section(&l, i, &s);
        if (!e)
            take_section(&l, &s, g);
    }
    if (e)
        return e;
    splats_to_radiance(g, ev);
    gaussians_sanitize(g, report);
    return OK;
}

const struct splats_format ksplat_format = {(uint64_t)8 << 30, 0, peek_ksplat, parse_ksplat};
