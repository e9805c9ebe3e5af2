/* One table gives the memory layout of each format. The bytes needed follow from width, height and
 * stride and are compared with the bytes of the frame before anything is read; then one function
 * per layout unpacks row by row.
 * YUV becomes RGB by the matrix of BT.601 or BT.709, in whole numbers scaled by 2^16; chroma is
 * repeated, not interpolated.
 * A JPEG is walked marker by marker (ITU-T T.81, annex B): segments by their lengths, scans up to
 * the next marker that is neither a stuffed 0 nor a restart, until EOI. It is decoded into the
 * upper half of the numbers, which are then widened from the lower end on: no byte is written
 * before it was read. */
#include "drivers/device/unpack.h"

#include "drivers/format/img.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum layout { NONE, RGB, BGR, YUYV, NV12, JPEG, BYTES, WORDS, PACKED10, PACKED12, LAYOUTS };

struct format {
    enum layout layout;
    enum raw_cfa cfa;
};

static const struct format formats[CAMERA_FORMATS] = {
    [CAMERA_RGB8] = {RGB, RAW_RGB},          [CAMERA_BGR8] = {BGR, RAW_RGB},
    [CAMERA_YUYV] = {YUYV, RAW_RGB},         [CAMERA_NV12] = {NV12, RAW_RGB},
    [CAMERA_MJPG] = {JPEG, RAW_RGB},         [CAMERA_GREY] = {BYTES, RAW_MONO},
    [CAMERA_GREY16] = {WORDS, RAW_MONO},     [CAMERA_RGGB16] = {WORDS, RAW_RGGB},
    [CAMERA_BGGR16] = {WORDS, RAW_BGGR},     [CAMERA_GRBG16] = {WORDS, RAW_GRBG},
    [CAMERA_GBRG16] = {WORDS, RAW_GBRG},     [CAMERA_RGGB10P] = {PACKED10, RAW_RGGB},
    [CAMERA_BGGR10P] = {PACKED10, RAW_BGGR}, [CAMERA_GRBG10P] = {PACKED10, RAW_GRBG},
    [CAMERA_GBRG10P] = {PACKED10, RAW_GBRG}, [CAMERA_RGGB12P] = {PACKED12, RAW_RGGB},
    [CAMERA_BGGR12P] = {PACKED12, RAW_BGGR}, [CAMERA_GRBG12P] = {PACKED12, RAW_GRBG},
    [CAMERA_GBRG12P] = {PACKED12, RAW_GBRG},
};

static struct format format_of(enum camera_format f)
{
    return (unsigned)f < CAMERA_FORMATS ? formats[f] : (struct format){NONE, RAW_MONO};
}

/* Bytes of a row's pixels. */
static uint64_t row_bytes(enum layout layout, uint64_t w)
{
    switch (layout) {
    case RGB:
    case BGR:
        return 3 * w;
    case YUYV:
    case WORDS:
        return 2 * w;
    case PACKED10:
        return (w + 3) / 4 * 5;
    case PACKED12:
        return (w + 1) / 2 * 3;
    default:
        return w;
    }
}

/* ---- bounds ---- */

static bool size_fits(const struct camera_info *info)
{
    struct format f = format_of(info->format);
    bool pairs = f.cfa >= RAW_RGGB || f.layout == YUYV || f.layout == NV12;
    bool rows = f.cfa >= RAW_RGGB || f.layout == NV12;
    if (f.layout == NONE || info->w < 1 || info->h < 1 || info->w > UNPACK_SIDE_MAX ||
        info->h > UNPACK_SIDE_MAX || (int64_t)info->w * info->h > UNPACK_PX_MAX)
        return false;
    return !(pairs && info->w % 2) && !(rows && info->h % 2);
}

size_t unpack_count(const struct camera_info *info)
{
    if (!size_fits(info))
        return 0;
    size_t area = (size_t)info->w * (size_t)info->h;
    return format_of(info->format).cfa == RAW_RGB ? 3 * area : area;
}

static int bits_of(enum layout layout, const struct camera_info *info)
{
    return layout == WORDS ? info->bits : layout == PACKED10 ? 10 : layout == PACKED12 ? 12 : 8;
}

static err_t check_info(const struct camera_info *info, const struct frame *f)
{
    if (f->format != info->format || f->w != info->w || f->h != info->h)
        return err_fail(ERR_FORMAT,
                        "frame %u: format %d of %d x %d px, the camera was opened for %d of %d x "
                        "%d px",
                        f->sequence, (int)f->format, f->w, f->h, (int)info->format, info->w,
                        info->h);
    if (!size_fits(info))
        return err_fail(ERR_FORMAT,
                        "frame %u: format %d of %d x %d px, allowed are 1 to %d a side, %d in all, "
                        "even for mosaics and YUV",
                        f->sequence, (int)f->format, f->w, f->h, UNPACK_SIDE_MAX, UNPACK_PX_MAX);
    int bits = bits_of(format_of(f->format).layout, info);
    if (bits < 8 || bits > 16 || info->black < 0 || info->black >= 1 << bits)
        return err_fail(ERR_FORMAT, "frame %u: %d bits with black %d, not 8..16 bits above black",
                        f->sequence, bits, info->black);
    return OK;
}

static err_t check_bytes(const struct camera_info *info, const struct frame *f)
{
    enum layout layout = format_of(f->format).layout;
    uint64_t row = row_bytes(layout, (uint64_t)f->w);
    uint64_t rows = layout == NV12 ? (uint64_t)f->h / 2 * 3 : (uint64_t)f->h;
    if (f->stride != info->stride || f->stride < 0 || (uint64_t)f->stride < row)
        return err_fail(ERR_FORMAT,
                        "frame %u: %d bytes from row to row, needed are %d, at least "
                        "%llu",
                        f->sequence, f->stride, info->stride, (unsigned long long)row);
    uint64_t need = (rows - 1) * (uint64_t)f->stride + row;
    if (!f->data || f->bytes < need)
        return err_fail(ERR_FORMAT, "frame %u: %zu bytes, its format needs %llu", f->sequence,
                        f->data ? f->bytes : 0, (unsigned long long)need);
    return OK;
}

/* ---- JPEG markers ---- */

enum { SOI = 0xD8, EOI = 0xD9, SOS = 0xDA, RST0 = 0xD0, RST7 = 0xD7, TEM = 0x01 };

struct walk {
    const uint8_t *p;
    size_t n, at;
    int w, h; // from the frame header; 0: not seen
    bool scan;
};

/* Step over the next marker and return it; 0 at the end of the bytes. */
static int next_marker(struct walk *j)
{
    if (j->at >= j->n || j->p[j->at] != 0xFF)
        return 0;
    while (j->at < j->n && j->p[j->at] == 0xFF) // any number of fill bytes
        j->at++;
    return j->at < j->n ? j->p[j->at++] : 0;
}

/* Go to the marker after the data of a scan, or to the end. */
static void skip_scan(struct walk *j)
{
    while (j->at + 1 < j->n) {
        const uint8_t *ff = memchr(j->p + j->at, 0xFF, j->n - j->at - 1);
        if (!ff)
            break;
        j->at = (size_t)(ff - j->p);
        if (ff[1] != 0 && ff[1] != 0xFF && (ff[1] < RST0 || ff[1] > RST7))
            return;
        j->at += ff[1] == 0xFF ? 1 : 2;
    }
    j->at = j->n;
}

static bool is_frame_header(int marker)
{
    return marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
}

/* Step over the segment after a marker. Returns its error, or NULL. */
static const char *step_segment(struct walk *j, int marker)
{
    const uint8_t *p = j->p + j->at;
    if (marker == TEM)
        return NULL;
    if (marker < 0xC0 || marker == SOI || (marker >= RST0 && marker <= RST7))
        return "a marker that may not stand there";
    size_t length = j->n - j->at < 2 ? 0 : (size_t)(p[0] << 8 | p[1]);
    if (length < 2 || length > j->n - j->at)
        return "a segment that is cut off";
    if (is_frame_header(marker) && length >= 8) {
        j->h = p[3] << 8 | p[4];
        j->w = p[5] << 8 | p[6];
    }
    j->at += length;
    if (marker == SOS) {
        j->scan = true;
        skip_scan(j);
    }
    return NULL;
}

static const char *walk_jpeg(struct walk *j)
{
    if (next_marker(j) != SOI || j->at != 2)
        return "no start of a picture";
    for (;;) {
        int marker = next_marker(j);
        if (marker == 0)
            return j->at >= j->n ? "no end of the picture" : "no marker where one belongs";
        if (marker == EOI)
            return j->scan ? NULL : "no picture";
        const char *wrong = step_segment(j, marker);
        if (wrong)
            return wrong;
    }
}

static err_t check_jpeg(const struct frame *f)
{
    struct walk j = {.p = f->data, .n = f->data ? f->bytes : 0};
    const char *wrong = walk_jpeg(&j);
    if (wrong)
        return err_fail(ERR_FORMAT, "frame %u: JPEG of %zu bytes: %s at byte %zu", f->sequence, j.n,
                        wrong, j.at);
    if (j.w != f->w || j.h != f->h)
        return err_fail(ERR_FORMAT, "frame %u: JPEG of %d x %d px, not %d x %d", f->sequence, j.w,
                        j.h, f->w, f->h);
    return OK;
}

err_t unpack_check(const struct camera_info *info, const struct frame *f)
{
    err_t e = check_info(info, f);
    if (e)
        return e;
    return f->format == CAMERA_MJPG ? check_jpeg(f) : check_bytes(info, f);
}

/* ---- rows ---- */

struct yuv { // scaled by 2^16
    int black, light, red_v, green_u, green_v, blue_u;
};

struct source {
    const uint8_t *p;
    size_t stride, w, h;
    struct yuv yuv;
    unsigned any; // bits that are set in some word
};

typedef void row_fn(struct source *s, size_t y, uint16_t *out);

static int fixed_point(double v)
{
    return (int)lround(v * 65536.0);
}

static struct yuv yuv_of(const struct camera_info *info)
{
    double kr = info->bt709 ? 0.2126 : 0.299, kb = info->bt709 ? 0.0722 : 0.114;
    double light = info->limited ? 255.0 / 219.0 : 1.0,
           chroma = info->limited ? 255.0 / 224.0 : 1.0;
    double red = 2.0 * (1.0 - kr) * chroma, blue = 2.0 * (1.0 - kb) * chroma, kg = 1.0 - kr - kb;
    return (struct yuv){.black = info->limited ? 16 : 0,
                        .light = fixed_point(light),
                        .red_v = fixed_point(red),
                        .green_u = fixed_point(-blue * kb / kg),
                        .green_v = fixed_point(-red * kr / kg),
                        .blue_u = fixed_point(blue)};
}

static uint16_t clamp_code(int v)
{
    return v <= 0 ? 0 : v >= 255 << 16 ? 255 : (uint16_t)((v + 32768) >> 16);
}

static void put_yuv(const struct yuv *k, int y, const uint8_t uv[2], uint16_t out[3])
{
    int l = (y - k->black) * k->light, u = uv[0] - 128, v = uv[1] - 128;
    out[0] = clamp_code(l + k->red_v * v);
    out[1] = clamp_code(l + k->green_u * u + k->green_v * v);
    out[2] = clamp_code(l + k->blue_u * u);
}

static void row_rgb(struct source *s, size_t y, uint16_t *out)
{
    const uint8_t *p = s->p + y * s->stride;
    for (size_t i = 0; i < 3 * s->w; i++)
        out[i] = p[i];
}

static void row_bgr(struct source *s, size_t y, uint16_t *out)
{
    const uint8_t *p = s->p + y * s->stride;
    for (size_t x = 0; x < 3 * s->w; x += 3) {
        out[x] = p[x + 2];
        out[x + 1] = p[x + 1];
        out[x + 2] = p[x];
    }
}

static void row_yuyv(struct source *s, size_t y, uint16_t *out)
{
    const uint8_t *p = s->p + y * s->stride;
    for (size_t x = 0; x < s->w; x += 2, p += 4) {
        const uint8_t uv[2] = {p[1], p[3]};
        put_yuv(&s->yuv, p[0], uv, out + 3 * x);
        put_yuv(&s->yuv, p[2], uv, out + 3 * x + 3);
    }
}

static void row_nv12(struct source *s, size_t y, uint16_t *out)
{
    const uint8_t *p = s->p + y * s->stride, *uv = s->p + (s->h + y / 2) * s->stride;
    for (size_t x = 0; x < s->w; x++)
        put_yuv(&s->yuv, p[x], uv + x / 2 * 2, out + 3 * x);
}

static void row_bytes8(struct source *s, size_t y, uint16_t *out)
{
    const uint8_t *p = s->p + y * s->stride;
    for (size_t x = 0; x < s->w; x++)
        out[x] = p[x];
}

static void row_words(struct source *s, size_t y, uint16_t *out)
{
    const uint8_t *p = s->p + y * s->stride;
    unsigned any = 0;
    for (size_t x = 0; x < s->w; x++) {
        unsigned v = p[2 * x] | (unsigned)p[2 * x + 1] << 8;
        out[x] = (uint16_t)v;
        any |= v;
    }
    s->any |= any;
}

static void row_10p(struct source *s, size_t y, uint16_t *out)
{
    const uint8_t *p = s->p + y * s->stride;
    for (size_t x = 0; x < s->w; x++) {
        const uint8_t *group = p + x / 4 * 5;
        out[x] = (uint16_t)(group[x % 4] << 2 | (group[4] >> 2 * (x % 4) & 3));
    }
}

static void row_12p(struct source *s, size_t y, uint16_t *out)
{
    const uint8_t *p = s->p + y * s->stride;
    for (size_t x = 0; x < s->w; x++) {
        const uint8_t *group = p + x / 2 * 3;
        out[x] = (uint16_t)(group[x % 2] << 4 | (group[2] >> 4 * (x % 2) & 15));
    }
}

static row_fn *const row_of[LAYOUTS] = {
    [RGB] = row_rgb,      [BGR] = row_bgr,     [YUYV] = row_yuyv,    [NV12] = row_nv12,
    [BYTES] = row_bytes8, [WORDS] = row_words, [PACKED10] = row_10p, [PACKED12] = row_12p,
};

static err_t run_rows(const struct camera_info *info, const struct frame *f, uint16_t *px)
{
    struct format format = format_of(f->format);
    size_t row = (size_t)f->w * (format.cfa == RAW_RGB ? 3 : 1);
    struct source s = {.p = f->data,
                       .stride = (size_t)f->stride,
                       .w = (size_t)f->w,
                       .h = (size_t)f->h,
                       .yuv = yuv_of(info)};
    for (size_t y = 0; y < s.h; y++)
        row_of[format.layout](&s, y, px + y * row);
    if (s.any >> bits_of(format.layout, info))
        return err_fail(ERR_FORMAT, "frame %u: words with bits %#x, not %d bits", f->sequence,
                        s.any, bits_of(format.layout, info));
    return OK;
}

static err_t run_jpeg(const struct frame *f, uint16_t *px)
{
    char name[32];
    size_t n = 3 * (size_t)f->w * (size_t)f->h;
    struct image8 to = {f->w, f->h, 3, (uint8_t *)px + n};
    snprintf(name, sizeof name, "frame %u", f->sequence);
    err_t e = img_decode_jpeg(f->data, f->bytes, name, &to);
    for (size_t i = 0; !e && i < n; i++)
        px[i] = to.px[i];
    return e;
}

err_t unpack_run(const struct camera_info *info, const struct frame *f, struct raw *out)
{
    struct format format = format_of(f->format);
    err_t e = unpack_check(info, f);
    if (!e && format.layout == JPEG)
        e = run_jpeg(f, out->px);
    else if (!e)
        e = run_rows(info, f, out->px);
    if (e)
        return e;
    bool linear = format.layout >= WORDS;
    *out = (struct raw){.w = f->w,
                        .h = f->h,
                        .cfa = format.cfa,
                        .bits = bits_of(format.layout, info),
                        .black = linear ? info->black : 0,
                        .linear = linear,
                        .px = out->px};
    return OK;
}
