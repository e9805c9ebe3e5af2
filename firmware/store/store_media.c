/* White balance is measured on all frames at once, for which each mosaic is thinned to a grid of
 * whole 2 x 2 cells. A frame is unpacked again when it is developed, and again when its camera's
 * bracket is merged: numbers of one camera are in memory at a time. */
#include "firmware/store/store_media.h"

#include "firmware/store/manifest.h"

#include "core/base/num.h"
#include "core/photo/merge.h"
#include "drivers/device/unpack.h"
#include "drivers/format/exrfile.h"
#include "drivers/format/thumbnail.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { THIN_EDGE = 64, PARTS_MAX = BRACKET_EXPOSURES_MAX + 1, EXPONENTS = 256 };

err_t store_media_unpack(const struct take *t, const struct take_frame *f, struct raw *out)
{
    const struct camera_info *info = &t->camera[f->camera].info;
    const struct frame frame = {.data = f->data,
                                .bytes = f->bytes,
                                .w = info->w,
                                .h = info->h,
                                .stride = info->stride,
                                .format = info->format};
    size_t n = unpack_count(info);
    *out = (struct raw){.px = malloc((n ? n : 1) * sizeof *out->px)};
    if (!out->px)
        return err_fail(ERR_NOMEM, "camera %d: no memory for %d x %d px", f->camera, info->w,
                        info->h);
    err_t e = unpack_run(info, &frame, out);
    if (e) {
        free(out->px);
        out->px = NULL;
    }
    return e;
}

/* ---- white balance ---- */

/* Every step'th cell of 2 x 2; own: free(small->px). */
static err_t subsample_mosaic(const struct raw *in, struct raw *small)
{
    int sx = num_min(in->w / 2, (in->w / 2 + THIN_EDGE - 1) / THIN_EDGE);
    int sy = num_min(in->h / 2, (in->h / 2 + THIN_EDGE - 1) / THIN_EDGE);
    *small = *in;
    small->w = in->w / 2 / sx * 2;
    small->h = in->h / 2 / sy * 2;
    small->px = malloc((size_t)small->w * (size_t)small->h * sizeof *small->px);
    if (!small->px)
        return err_fail(ERR_NOMEM, "white balance: no memory for %d x %d px", small->w, small->h);
    for (int y = 0; y < small->h; y++)
        for (int x = 0; x < small->w; x++) {
            size_t row = (size_t)(y / 2 * sy * 2 + y % 2),
                   column = (size_t)(x / 2 * sx * 2 + x % 2);
            small->px[(size_t)y * (size_t)small->w + (size_t)x] =
                in->px[row * (size_t)in->w + column];
        }
    return OK;
}

err_t store_media_balance(const struct take *t, struct develop *out)
{
    struct raw small[TAKE_FRAMES_MAX], full;
    int n = 0;
    err_t e = OK;
    *out = (struct develop){1.0f, 1.0f};
    for (int i = 0; i < t->n && !e; i++) {
        if (t->camera[t->frame[i].camera].info.format < CAMERA_RGGB16)
            continue;
        e = store_media_unpack(t, &t->frame[i], &full);
        if (e)
            break;
        e = subsample_mosaic(&full, &small[n]);
        free(full.px);
        n += !e;
    }
    if (!e && n > 0)
        develop_balance(small, n, out);
    while (n > 0)
        free(small[--n].px);
    return e;
}

/* ---- pictures ---- */

err_t store_media_develop(const struct take *t, const struct take_frame *f,
                          const struct develop *how, struct image8 *out)
{
    struct raw raw;
    *out = (struct image8){0};
    err_t e = store_media_unpack(t, f, &raw);
    if (e)
        return e;
    *out = (struct image8){raw.w, raw.h, 3, malloc((size_t)raw.w * (size_t)raw.h * 3)};
    if (out->px) {
        develop_run(&raw, how, out->px);
    } else {
        e = err_fail(ERR_NOMEM, "camera %d: no memory for %d x %d px", f->camera, raw.w, raw.h);
        *out = (struct image8){0};
    }
    free(raw.px);
    return e;
}

/* ---- merging ---- */

enum { ATTRS_MAX = 12 };

struct part_attrs {
    char name[8], date[24], monotonic[24], boottime[24], realtime[24], sequence[16];
    struct exrfile_attr v[ATTRS_MAX];
    int n;
};

struct merge {
    const struct take *t;
    const struct develop *how;
    const struct crf *crf;
    struct raw raw[BRACKET_EXPOSURES_MAX];
    double exposure_s[BRACKET_EXPOSURES_MAX];
    const struct take_frame *frame[BRACKET_EXPOSURES_MAX];
    struct ghost_mask moved[BRACKET_EXPOSURES_MAX]; // the take's
    bool is_masked;                                 // one of them is not empty
    int n;
    float scale; // scale of `merged`
    struct image im;
    struct part_attrs attrs[PARTS_MAX];
    struct exrfile_part part[PARTS_MAX];
};

static void add_text(struct part_attrs *a, const char *name, const char *text)
{
    a->v[a->n++] = (struct exrfile_attr){name, text, 0};
}

static void add_number(struct part_attrs *a, const char *name, double v)
{
    a->v[a->n++] = (struct exrfile_attr){name, NULL, (float)v};
}

/* Standard attributes, then our own with their prefix. capDate is UTC, so utcOffset is 0. */
static void describe_part(struct part_attrs *a, const struct take *t, const struct clocks *at)
{
    time_t seconds = (time_t)(at->realtime_ns / 1000000000 - (at->realtime_ns % 1000000000 < 0));
    struct tm tm;
    if (gmtime_r(&seconds, &tm) && strftime(a->date, sizeof a->date, "%Y:%m:%d %H:%M:%S", &tm)) {
        add_text(a, "capDate", a->date);
        add_number(a, "utcOffset", 0);
    }
    snprintf(a->monotonic, sizeof a->monotonic, "%" PRId64, at->monotonic_ns);
    snprintf(a->boottime, sizeof a->boottime, "%" PRId64, at->boottime_ns);
    snprintf(a->realtime, sizeof a->realtime, "%" PRId64, at->realtime_ns);
    add_text(a, "hdrigMonotonicNs", a->monotonic);
    add_text(a, "hdrigBoottimeNs", a->boottime);
    add_text(a, "hdrigRealtimeNs", a->realtime);
    add_text(a, "hdrigClockSynced", t->clock_synced ? "yes" : "no");
}

static void describe_frame(struct part_attrs *a, const struct take *t, const struct take_frame *f)
{
    double exposure_s = take_exposure_s(f);
    describe_part(a, t, &f->start);
    add_number(a, "expTime", take_exposure(f)->time_s);
    add_number(a, "hdrigGain", take_exposure(f)->gain);
    add_number(a, "hdrigRadianceScale", 1.0 / exposure_s);
    add_text(a, "hdrigProof", manifest_proof(f->evidence.proof));
    snprintf(a->sequence, sizeof a->sequence, "%" PRIu32, f->evidence.sequence);
    add_text(a, "hdrigSequence", a->sequence);
}

static void describe_parts(struct merge *m)
{
    for (int i = 0; i <= m->n; i++) {
        struct part_attrs *a = &m->attrs[i];
        snprintf(a->name, sizeof a->name, i ? "e%02d" : "merged", i ? m->frame[i - 1]->index : 0);
        if (i) {
            describe_frame(a, m->t, m->frame[i - 1]);
        } else {
            describe_part(a, m->t, &m->t->trigger);
            add_number(a, "hdrigRadianceScale", (double)m->scale);
        }
        m->part[i] = (struct exrfile_part){a->name, a->v, a->n};
    }
}

/* The least power of two that 99.9 % of the samples above 0 stay below. */
static float scale_of(const struct image *im)
{
    size_t count[EXPONENTS] = {0}, n = (size_t)im->w * (size_t)im->h * 3, above = 0;
    for (size_t i = 0; i < n; i++)
        if (isnormal(im->px[i]) && im->px[i] > 0.0f) {
            count[ilogbf(im->px[i]) + EXPONENTS / 2]++;
            above++;
        }
    int top = EXPONENTS - 1;
    size_t left = above / 1000;
    while (top > 0 && count[top] <= left)
        left -= count[top--];
    return above ? ldexpf(1.0f, num_min(top - EXPONENTS / 2 + 1, 127)) : 1.0f;
}

static err_t fill_part(void *ctx, int i, const struct image **out)
{
    struct merge *m = ctx;
    const double one = 1.0;
    *out = &m->im;
    if (i > 0) {
        struct merge_set set = {&m->raw[i - 1], 1, &one, m->crf, m->how, NULL};
        merge_rows(&set, 0, m->im.h, &m->im);
    }
    return OK;
}

static err_t merge_open(struct merge *m)
{
    size_t plane = (size_t)m->raw[0].w * (size_t)m->raw[0].h;
    m->im = (struct image){m->raw[0].w, m->raw[0].h, 3, malloc(plane * 3 * sizeof(float))};
    if (!m->im.px)
        return err_fail(ERR_NOMEM, "merging: no memory for %d x %d px", m->im.w, m->im.h);
    struct merge_set set = {m->raw, m->n,   m->exposure_s,
                            m->crf, m->how, m->is_masked ? m->moved : NULL};
    merge_rows(&set, 0, m->im.h, &m->im);
    m->scale = scale_of(&m->im);
    for (size_t i = 0; i < 3 * plane; i++)
        m->im.px[i] /= m->scale;
    describe_parts(m);
    return OK;
}

static err_t merge_write(const struct store_fs *fs, struct merge *m, const char *path)
{
    struct exrfile_parts parts = {m->n + 1, m->im.w, m->im.h, m->part, fill_part, m};
    struct store_fs_file f;
    err_t e = store_fs_create(fs, path, &f);
    if (e)
        return e;
    e = exrfile_put_parts(f.stream, path, &parts);
    if (!e || ferror(f.stream)) // the stream knows the system's reason
        return store_fs_finish(&f);
    store_fs_discard(&f);
    return e;
}

err_t store_media_merge(const struct store_fs *fs, const struct take *t, int camera,
                        const struct develop *how, const char *path)
{
    struct merge *m = calloc(1, sizeof *m);
    if (!m)
        return err_fail(ERR_NOMEM, "%s: no memory", path);
    m->t = t;
    m->how = how;
    m->crf = t->camera[camera].has_crf ? &t->camera[camera].crf : NULL;
    err_t e = OK;
    for (int i = 0; i < t->n && !e; i++)
        if (t->frame[i].camera == camera) {
            m->frame[m->n] = &t->frame[i];
            m->moved[m->n] = t->frame[i].ghost;
            m->is_masked = m->is_masked || t->frame[i].ghost.moved;
            m->exposure_s[m->n] = take_exposure_s(&t->frame[i]);
            e = store_media_unpack(t, &t->frame[i], &m->raw[m->n]);
            m->n += !e;
        }
    if (!e)
        e = merge_open(m);
    if (!e)
        e = merge_write(fs, m, path);
    while (m->n > 0)
        free(m->raw[--m->n].px);
    free(m->im.px);
    free(m);
    return e;
}

/* ---- space ---- */

uint64_t store_media_need(const struct camera_info *info, int frames, bool merge)
{
    enum { OVERHEAD = 1 << 16 }; // headers, and what a file fills of its last block
    if (info->w < 1 || info->h < 1 || frames < 1)
        return 0;
    uint64_t px = (uint64_t)info->w * (uint64_t)info->h, n = (uint64_t)frames;
    uint64_t row = info->stride > 0 ? (uint64_t)info->stride : (uint64_t)info->w;
    bool jpeg = info->format == CAMERA_MJPG;
    uint64_t need = n * (row * (uint64_t)info->h * 3 / 2 + OVERHEAD); // NV12 has half as many rows
    if (!jpeg)
        need += n * (3 * px + 3 * px / 64 + OVERHEAD);
    need += n * (thumbnail_need(info->w, info->h) + OVERHEAD);
    if (frames > 1)
        need += n * (px / 4 + OVERHEAD); // masks
    if (merge && frames > 1)
        need += (n + 1) * (6 * px + OVERHEAD);
    return need;
}
