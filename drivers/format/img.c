/* Decoders work on the whole file in memory. Before a picture is allocated its size is compared
 * with the bytes of the file: DEFLATE expands at most 1032-fold, and a JPEG spends at least one bit
 * on each 8 x 8 block of its largest component, so a short file cannot ask for a gigabyte. */
#include "drivers/format/img.h"

#include "drivers/format/file.h"
#include "drivers/format/turn.h"

#include <libexif/exif-data.h>
#include <math.h>
#include <spng.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <turbojpeg.h>

enum {
    DEFLATE_RATIO_MAX = 1032, // RFC 1951: 258 bytes from two 1-bit codes
    JPEG_PX_PER_BYTE_MAX = 8 * 64,
    PNG_CHUNK_MAX = 16 << 20,  // bytes of one text, profile or EXIF chunk, unpacked
    PNG_CHUNKS_MAX = 64 << 20, // bytes of all of them
    EXIF_MAX = 1 << 16         // bytes of EXIF data: a JPEG segment holds no more
};

static err_t check_size(const char *name, uint32_t w, uint32_t h)
{
    if (w < 1 || h < 1 || w > IMG_SIDE_MAX || h > IMG_SIDE_MAX || (uint64_t)w * h > IMG_PX_MAX)
        return err_fail(ERR_FORMAT, "%s: %u x %u px, allowed are 1 to %d a side and %d in all",
                        name, w, h, IMG_SIDE_MAX, IMG_PX_MAX);
    return OK;
}

static err_t alloc_px(const char *name, uint32_t w, uint32_t h, struct image8 *out)
{
    out->px = malloc((size_t)w * h * 3);
    if (!out->px)
        return err_fail(ERR_NOMEM, "%s: no memory for %u x %u px", name, w, h);
    out->w = (int)w;
    out->h = (int)h;
    out->channels = 3;
    return OK;
}

static bool is_png(const void *bytes, size_t n)
{
    return n >= 8 && memcmp(bytes, "\x89PNG\r\n\x1a\n", 8) == 0;
}

static bool is_jpeg(const void *bytes, size_t n)
{
    return n >= 3 && memcmp(bytes, "\xff\xd8\xff", 3) == 0;
}

static err_t png_error(const char *name, int code)
{
    return err_fail(code == SPNG_EMEM ? ERR_NOMEM : ERR_FORMAT, "%s: PNG: %s", name,
                    spng_strerror(code));
}

/* A decoder on the bytes, with limits set. own: spng_ctx_free, also on error. */
static err_t png_open(const void *bytes, size_t n, const char *name, spng_ctx **out)
{
    *out = spng_ctx_new(0);
    if (!*out)
        return err_fail(ERR_NOMEM, "%s: no memory for the PNG decoder", name);
    int code = spng_set_chunk_limits(*out, PNG_CHUNK_MAX, PNG_CHUNKS_MAX);
    if (!code)
        code = spng_set_png_buffer(*out, bytes, n);
    return code ? png_error(name, code) : OK;
}

static err_t check_png(const struct spng_ihdr *head, size_t n, const char *name)
{
    const uint64_t bits = (uint64_t)head->width * head->height * head->bit_depth;
    err_t e = check_size(name, head->width, head->height);
    if (!e && bits / 8 / DEFLATE_RATIO_MAX > n)
        e = err_fail(ERR_FORMAT, "%s: PNG: %zu bytes cannot hold %u x %u px", name, n, head->width,
                     head->height);
    return e;
}

static err_t png_decode(spng_ctx *ctx, size_t n, const char *name, struct image8 *out)
{
    struct spng_ihdr head;
    int code = spng_get_ihdr(ctx, &head);
    if (code)
        return png_error(name, code);
    err_t e = check_png(&head, n, name);
    if (e)
        return e;
    e = alloc_px(name, head.width, head.height, out);
    if (e)
        return e;
    code = spng_decode_image(ctx, out->px, (size_t)head.width * head.height * 3, SPNG_FMT_RGB8, 0);
    return code ? png_error(name, code) : OK;
}

static err_t png_decode16(spng_ctx *ctx, size_t n, const char *name, struct image16 *out)
{
    struct spng_ihdr head;
    int code = spng_get_ihdr(ctx, &head);
    if (code)
        return png_error(name, code);
    err_t e = check_png(&head, n, name);
    if (e)
        return e;
    const size_t px = (size_t)head.width * head.height;
    *out = (struct image16){(int)head.width, (int)head.height, 3, malloc(px * 8)};
    if (!out->px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", name, out->w, out->h);
    code = spng_decode_image(ctx, out->px, px * 8, SPNG_FMT_RGBA16, 0);
    for (size_t i = 0; i < px && !code; i++)
        memmove(out->px + 3 * i, out->px + 4 * i, 6);
    return code ? png_error(name, code) : OK;
}

bool img_is_deep(const void *bytes, size_t n, bool *linear)
{
    spng_ctx *ctx = NULL;
    struct spng_ihdr head = {0};
    double gamma = 0;
    *linear = false;
    if (!is_png(bytes, n) || n > IMG_FILE_MAX)
        return false;
    const bool deep = png_open(bytes, n, "PNG", &ctx) == OK && spng_get_ihdr(ctx, &head) == 0 &&
                      head.bit_depth == 16;
    if (deep && spng_get_gama(ctx, &gamma) == 0)
        *linear = gamma > 0.99 && gamma < 1.01;
    spng_ctx_free(ctx);
    return deep;
}

err_t img_read16_mem(const void *bytes, size_t n, const char *name, struct image16 *out)
{
    spng_ctx *ctx;
    *out = (struct image16){0};
    err_t e = png_open(bytes, n, name, &ctx);
    if (!e)
        e = png_decode16(ctx, n, name, out);
    spng_ctx_free(ctx);
    if (e) {
        free(out->px);
        *out = (struct image16){0};
    }
    return e;
}

static err_t read_png(const void *bytes, size_t n, const char *name, struct image8 *out)
{
    spng_ctx *ctx;
    err_t e = png_open(bytes, n, name, &ctx);
    if (!e)
        e = png_decode(ctx, n, name, out);
    spng_ctx_free(ctx);
    return e;
}

static err_t jpeg_error(tjhandle tj, const char *name)
{
    return err_fail(ERR_FORMAT, "%s: JPEG: %s", name, tjGetErrorStr2(tj));
}

/* Size of a picture that may be decoded. */
static err_t jpeg_head(tjhandle tj, const void *bytes, size_t n, const char *name,
                       struct image8 *out)
{
    int sampling, colours;
    if (tjDecompressHeader3(tj, bytes, n, &out->w, &out->h, &sampling, &colours) != 0)
        return jpeg_error(tj, name);
    err_t e = check_size(name, (uint32_t)out->w, (uint32_t)out->h);
    if (e)
        return e;
    if (colours == TJCS_CMYK || colours == TJCS_YCCK)
        return err_fail(ERR_UNSUPPORTED,
                        "%s: JPEG: CMYK pictures are not supported, convert it to RGB", name);
    if ((uint64_t)out->w * (uint64_t)out->h / JPEG_PX_PER_BYTE_MAX > n)
        return err_fail(ERR_FORMAT, "%s: JPEG: %zu bytes cannot hold %d x %d px", name, n, out->w,
                        out->h);
    return OK;
}

static err_t jpeg_pixels(tjhandle tj, const void *bytes, size_t n, const char *name,
                         const struct image8 *out)
{
    const int flags = TJFLAG_STOPONWARNING | TJFLAG_LIMITSCANS | TJFLAG_ACCURATEDCT;
    if (tjDecompress2(tj, bytes, n, out->px, out->w, 0, out->h, TJPF_RGB, flags) != 0)
        return jpeg_error(tj, name);
    return OK;
}

/* out->px NULL: allocated; else for a picture of out's size. */
static err_t read_jpeg(const void *bytes, size_t n, const char *name, struct image8 *out)
{
    struct image8 head = {0};
    tjhandle tj = tjInitDecompress();
    if (!tj)
        return err_fail(ERR_NOMEM, "%s: no memory for the JPEG decoder", name);
    err_t e = jpeg_head(tj, bytes, n, name, &head);
    if (!e && out->px && (head.w != out->w || head.h != out->h))
        e = err_fail(ERR_FORMAT, "%s: JPEG of %d x %d px, not %d x %d", name, head.w, head.h,
                     out->w, out->h);
    if (!e && !out->px)
        e = alloc_px(name, (uint32_t)head.w, (uint32_t)head.h, out);
    if (!e)
        e = jpeg_pixels(tj, bytes, n, name, out);
    tjDestroy(tj);
    return e;
}

err_t img_decode_jpeg(const void *bytes, size_t n, const char *name, const struct image8 *out)
{
    struct image8 to = *out;
    if (!is_jpeg(bytes, n))
        return err_fail(ERR_FORMAT, "%s: does not begin as a JPEG does", name);
    return read_jpeg(bytes, n, name, &to);
}

static int short_of(ExifData *data, ExifIfd ifd, ExifTag tag)
{
    ExifEntry *entry = exif_content_get_entry(data->ifd[ifd], tag);
    if (!entry || !entry->data || entry->format != EXIF_FORMAT_SHORT || entry->components < 1 ||
        entry->size < 2)
        return 0;
    return exif_get_short(entry->data, exif_data_get_byte_order(data));
}

int img_orientation(const void *bytes, size_t n)
{
    if (!is_jpeg(bytes, n) || n > IMG_FILE_MAX)
        return 1;
    ExifData *data = exif_data_new();
    if (!data)
        return 1;
    exif_data_load_data(data, bytes, (unsigned)n);
    const int o = short_of(data, EXIF_IFD_0, EXIF_TAG_ORIENTATION);
    exif_data_unref(data);
    return o >= 1 && o <= 8 ? o : 1;
}

static err_t make_upright(int orientation, const char *name, struct image8 *io)
{
    const bool swap = orientation >= 5;
    struct image8 out = {0};
    if (orientation == 1)
        return OK;
    err_t e =
        alloc_px(name, (uint32_t)(swap ? io->h : io->w), (uint32_t)(swap ? io->w : io->h), &out);
    if (e)
        return e;
    turn_upright(orientation, io->px, io->w, io->h, 3, out.px);
    img_free(io);
    *io = out;
    return OK;
}

/* The least size that the decoder has whose longer side is at least `edge` px. */
static void scale_down(int edge, struct image8 *io)
{
    int n;
    const tjscalingfactor *f = tjGetScalingFactors(&n);
    const int w = io->w, h = io->h;
    for (int i = 0; f && i < n; i++) {
        const int x = TJSCALED(w, f[i]), y = TJSCALED(h, f[i]);
        if ((x >= edge || y >= edge) && x <= io->w && y <= io->h) {
            io->w = x;
            io->h = y;
        }
    }
}

err_t img_read_jpeg_small(const void *bytes, size_t n, const char *name, int edge,
                          struct image8 *out)
{
    struct image8 size = {0};
    memset(out, 0, sizeof *out);
    if (!is_jpeg(bytes, n))
        return err_fail(ERR_FORMAT, "%s: does not begin as a JPEG does", name);
    tjhandle tj = tjInitDecompress();
    if (!tj)
        return err_fail(ERR_NOMEM, "%s: no memory for the JPEG decoder", name);
    err_t e = jpeg_head(tj, bytes, n, name, &size);
    if (!e) {
        scale_down(edge, &size);
        e = alloc_px(name, (uint32_t)size.w, (uint32_t)size.h, out);
    }
    if (!e)
        e = jpeg_pixels(tj, bytes, n, name, out);
    tjDestroy(tj);
    if (!e)
        e = make_upright(img_orientation(bytes, n), name, out);
    if (e)
        img_free(out);
    return e;
}

err_t img_read_mem(const void *bytes, size_t n, const char *name, struct image8 *out)
{
    err_t e;
    memset(out, 0, sizeof *out);
    if (is_png(bytes, n))
        e = read_png(bytes, n, name, out);
    else if (is_jpeg(bytes, n))
        e = read_jpeg(bytes, n, name, out);
    else
        e = err_fail(ERR_FORMAT, "%s: neither PNG nor JPEG", name);
    if (!e)
        e = make_upright(img_orientation(bytes, n), name, out);
    if (e)
        img_free(out);
    return e;
}

err_t img_read(const char *path, struct image8 *out)
{
    struct file_map m;
    memset(out, 0, sizeof *out);
    err_t e = file_map(path, IMG_FILE_MAX, &m);
    if (!e)
        e = img_read_mem(m.p, m.n, path, out);
    file_unmap(&m);
    return e;
}

void img_free(struct image8 *im)
{
    free(im->px);
    memset(im, 0, sizeof *im);
}

static err_t write_file(const char *path, const void *bytes, size_t n)
{
    FILE *f;
    err_t e = file_create(path, &f);
    if (e)
        return e;
    fwrite(bytes, 1, n, f); // file_finish asks whether it worked
    return file_finish(f, path);
}

enum { MAKER_MAX = 256 };

/* One directory with Make and Model, as TIFF in little-endian order (Exif 2.32, 4.6). Returns its
 * length; texts are cut to fit. */
static size_t put_maker(const struct img_maker *by, unsigned char out[MAKER_MAX])
{
    enum { ENTRIES = 2, TEXTS = 8 + 2 + 12 * ENTRIES + 4, TEXT_MAX = 64 };
    static const uint16_t tag[ENTRIES] = {EXIF_TAG_MAKE, EXIF_TAG_MODEL};
    const char *const text[ENTRIES] = {by->make, by->model};
    unsigned at = TEXTS;
    memset(out, 0, MAKER_MAX);
    memcpy(out, "II*\0\10\0\0\0\2", 9); // directory at 8, two entries
    for (int i = 0; i < ENTRIES; i++) {
        unsigned char *e = out + 10 + 12 * i;
        const unsigned n = (unsigned)strnlen(text[i], TEXT_MAX) + 1;
        const unsigned word[3] = {tag[i] | 2u << 16, n, at}; // type 2: ASCII
        for (int k = 0; k < 12; k++)
            e[k] = (unsigned char)(word[k / 4] >> 8 * (k % 4));
        memcpy(out + at, text[i], n - 1);
        at += n + n % 2;
    }
    return at;
}

static int png_encode(spng_ctx *ctx, const struct image8 *im, bool fast, const struct img_maker *by)
{
    struct spng_ihdr head = {.width = (uint32_t)im->w,
                             .height = (uint32_t)im->h,
                             .bit_depth = 8,
                             .color_type = SPNG_COLOR_TYPE_TRUECOLOR};
    unsigned char exif[MAKER_MAX]; // copied by spng_set_exif
    int code = spng_set_option(ctx, SPNG_ENCODE_TO_BUFFER, 1);
    if (!code && fast)
        code = spng_set_option(ctx, SPNG_IMG_COMPRESSION_LEVEL, 1);
    if (!code && fast) // the cheapest filter that helps, by measurement
        code = spng_set_option(ctx, SPNG_FILTER_CHOICE, SPNG_FILTER_CHOICE_UP);
    if (!code)
        code = spng_set_ihdr(ctx, &head);
    if (!code && by) {
        struct spng_exif chunk = {.length = put_maker(by, exif), .data = (char *)exif};
        code = spng_set_exif(ctx, &chunk);
    }
    if (!code)
        code = spng_encode_image(ctx, im->px, (size_t)im->w * (size_t)im->h * 3, SPNG_FMT_PNG,
                                 SPNG_ENCODE_FINALIZE);
    return code;
}

static err_t check_picture(const struct image8 *im, const char *name)
{
    if (!im->px || im->channels != 3 || im->w < 1 || im->h < 1)
        return err_fail(ERR_ARG, "%s: no RGB picture to write (%d x %d, %d channels)", name, im->w,
                        im->h, im->channels);
    return OK;
}

/* own: free(*bytes). */
static err_t encode_png(const struct image8 *im, const char *name, bool fast,
                        const struct img_maker *by, void **bytes, size_t *n)
{
    *bytes = NULL;
    err_t e = check_picture(im, name);
    if (e)
        return e;
    spng_ctx *ctx = spng_ctx_new(SPNG_CTX_ENCODER);
    if (!ctx)
        return err_fail(ERR_NOMEM, "%s: no memory for the PNG encoder", name);
    int code = png_encode(ctx, im, fast, by);
    if (!code)
        *bytes = spng_get_png_buffer(ctx, n, &code);
    spng_ctx_free(ctx);
    return *bytes ? OK
                  : err_fail(code == SPNG_EMEM ? ERR_NOMEM : ERR_ARG, "%s: PNG: %s", name,
                             spng_strerror(code));
}

err_t img_encode_png_fast(const struct image8 *im, const char *name, void **bytes, size_t *n)
{
    return encode_png(im, name, true, NULL, bytes, n);
}

err_t img_encode_jpeg(const struct image8 *im, int quality, const char *name, void **bytes,
                      size_t *n)
{
    *bytes = NULL;
    err_t e = check_picture(im, name);
    if (e)
        return e;
    unsigned char *out = malloc(tjBufSize(im->w, im->h, TJSAMP_444));
    tjhandle tj = tjInitCompress();
    unsigned long used = 0;
    if (!out || !tj)
        e = err_fail(ERR_NOMEM, "%s: no memory for the JPEG encoder", name);
    else if (tjCompress2(tj, im->px, im->w, 0, im->h, TJPF_RGB, &out, &used, TJSAMP_444, quality,
                         TJFLAG_NOREALLOC | TJFLAG_PROGRESSIVE) != 0) // a twentieth smaller
        e = err_fail(ERR_ARG, "%s: JPEG: %s", name, tjGetErrorStr2(tj));
    if (tj)
        tjDestroy(tj);
    if (e) {
        free(out);
        return e;
    }
    *bytes = out;
    *n = used;
    return OK;
}

err_t img_write_png(const char *path, const struct image8 *im)
{
    return img_write_png_by(path, im, NULL);
}

err_t img_write_png_by(const char *path, const struct image8 *im, const struct img_maker *by)
{
    void *bytes;
    size_t n;
    err_t e = encode_png(im, path, false, by, &bytes, &n);
    if (e)
        return e;
    e = write_file(path, bytes, n);
    free(bytes);
    return e;
}

err_t img_write_ldr(const char *path, const struct image *im)
{
    if (!im->px || im->channels < 3 || im->w < 1 || im->h < 1)
        return err_fail(ERR_ARG, "%s: no RGB image to write (%d x %d, %d channels)", path, im->w,
                        im->h, im->channels);
    struct image8 out = {0};
    err_t e = alloc_px(path, (uint32_t)im->w, (uint32_t)im->h, &out);
    if (e)
        return e;
    size_t n = (size_t)im->w * (size_t)im->h;
    for (size_t i = 0; i < 3 * n; i++) {
        float v = im->px[i % 3 * n + i / 3];
        out.px[i] = (uint8_t)(v >= 1.0f  ? 255.0f
                              : v > 0.0f ? v * 255.0f + 0.5f
                                         : 0.0f); // a NaN fails both
    }
    e = img_write_png(path, &out);
    img_free(&out);
    return e;
}

/* A block behind the six bytes that JPEG puts before it and libexif wants. own: free(*exif). */
static err_t head_exif(const void *block, size_t n, const char *name, unsigned char **exif,
                       size_t *n_exif)
{
    static const char head[6] = "Exif\0";
    *n_exif = sizeof head + n;
    *exif = malloc(*n_exif);
    if (!*exif)
        return err_fail(ERR_NOMEM, "%s: no memory for EXIF data", name);
    memcpy(*exif, head, sizeof head);
    memcpy(*exif + sizeof head, block, n);
    return OK;
}

/* own: free(*exif). */
static err_t exif_of_png(const void *bytes, size_t n, const char *name, unsigned char **exif,
                         size_t *n_exif)
{
    spng_ctx *ctx;
    struct spng_exif chunk = {0};
    *exif = NULL;
    err_t e = png_open(bytes, n, name, &ctx);
    int code = e ? 0 : spng_get_exif(ctx, &chunk);
    if (code == SPNG_ECHUNKAVAIL || (!e && !code && chunk.length > EXIF_MAX))
        e = err_fail(ERR_FORMAT, "%s: no EXIF data", name);
    else if (code)
        e = png_error(name, code);
    if (!e)
        e = head_exif(chunk.data, chunk.length, name, exif, n_exif);
    spng_ctx_free(ctx);
    return e;
}

/* A positive rational or integer of the EXIF directory; 0 if the tag is absent or something
 * else. */
static double exif_number(ExifData *data, ExifTag tag)
{
    ExifEntry *entry = exif_content_get_entry(data->ifd[EXIF_IFD_EXIF], tag);
    ExifByteOrder order = exif_data_get_byte_order(data);
    if (!entry || !entry->data || entry->components < 1 ||
        entry->size < exif_format_get_size(entry->format) * entry->components)
        return 0.0;
    switch (entry->format) {
    case EXIF_FORMAT_RATIONAL: {
        ExifRational r = exif_get_rational(entry->data, order);
        return r.denominator ? (double)r.numerator / r.denominator : 0.0;
    }
    case EXIF_FORMAT_SHORT:
        return exif_get_short(entry->data, order);
    case EXIF_FORMAT_LONG:
        return exif_get_long(entry->data, order);
    default:
        return 0.0;
    }
}

/* A text of the camera's name, printable, behind those before. */
static void add_text(ExifData *data, ExifIfd ifd, int tag, char name[NAME_CAP])
{
    ExifEntry *entry = exif_content_get_entry(data->ifd[ifd], (ExifTag)tag);
    size_t n = strlen(name);
    if (!entry || !entry->data || entry->format != EXIF_FORMAT_ASCII || entry->size < 2)
        return;
    if (n > 0 && n + 1 < NAME_CAP)
        name[n++] = ' ';
    for (unsigned i = 0; i < entry->size && entry->data[i] && n + 1 < NAME_CAP; i++)
        name[n++] = entry->data[i] >= ' ' && entry->data[i] < 127 ? (char)entry->data[i] : '_';
    name[n] = 0;
}

double img_focal_plane(const struct img_plane *p)
{
    enum { UNITS = 6 };
    static const double millimetres[UNITS] = {[3] = 10, [4] = 1, [5] = 1e-3};
    const double inch = 25.4, given = p->unit > 0 && p->unit < UNITS ? millimetres[p->unit] : 0;
    const double edge = fmax(p->w, p->h) * (given > 0 ? given : inch) / p->resolution; // mm
    const double focal = p->focal_mm / edge;
    return p->resolution > 0 && focal > 0.1 && focal < 100 ? focal : 0;
}

static err_t parse_camera(const unsigned char *bytes, size_t n, const char *name,
                          struct img_camera *out)
{
    static const int text[][2] = {{EXIF_IFD_0, EXIF_TAG_MAKE},
                                  {EXIF_IFD_0, EXIF_TAG_MODEL},
                                  {EXIF_IFD_EXIF, EXIF_TAG_BODY_SERIAL_NUMBER},
                                  {EXIF_IFD_EXIF, EXIF_TAG_LENS_MODEL},
                                  {EXIF_IFD_EXIF, EXIF_TAG_LENS_SERIAL_NUMBER}};
    ExifData *data = exif_data_new();
    if (!data)
        return err_fail(ERR_NOMEM, "%s: no memory for EXIF data", name);
    exif_data_load_data(data, bytes, (unsigned)n);
    for (size_t i = 0; i < sizeof text / sizeof *text; i++)
        add_text(data, (ExifIfd)text[i][0], text[i][1], out->name);
    const struct img_plane plane = {
        exif_number(data, EXIF_TAG_FOCAL_LENGTH),
        exif_number(data, EXIF_TAG_FOCAL_PLANE_X_RESOLUTION),
        short_of(data, EXIF_IFD_EXIF, EXIF_TAG_FOCAL_PLANE_RESOLUTION_UNIT),
        exif_number(data, EXIF_TAG_PIXEL_X_DIMENSION),
        exif_number(data, EXIF_TAG_PIXEL_Y_DIMENSION)};
    const size_t used = strlen(out->name);
    if (plane.focal_mm > 0)
        snprintf(out->name + used, NAME_CAP - used, "%s%g mm", used ? " " : "", plane.focal_mm);
    out->focal_plane = img_focal_plane(&plane);
    out->focal_35mm = exif_number(data, EXIF_TAG_FOCAL_LENGTH_IN_35MM_FILM);
    const int o = short_of(data, EXIF_IFD_0, EXIF_TAG_ORIENTATION);
    out->orientation = o >= 1 && o <= 8 ? o : 1;
    exif_data_unref(data);
    return OK;
}

err_t img_camera(const char *path, struct img_camera *out)
{
    struct file_map m;
    unsigned char *exif = NULL;
    size_t n_exif;
    *out = (struct img_camera){.orientation = 1};
    err_t e = file_map(path, IMG_FILE_MAX, &m);
    if (!e && is_jpeg(m.p, m.n))
        e = parse_camera(m.p, m.n, path, out);
    else if (!e && is_png(m.p, m.n) && exif_of_png(m.p, m.n, path, &exif, &n_exif) == OK)
        e = parse_camera(exif, n_exif, path, out);
    out->orientation = !e && is_jpeg(m.p, m.n) ? out->orientation : 1; // PNG is not turned
    free(exif);
    file_unmap(&m);
    return e;
}

static err_t parse_exif(const unsigned char *bytes, size_t n, const char *name,
                        struct img_exif *out)
{
    ExifData *data = exif_data_new();
    if (!data)
        return err_fail(ERR_NOMEM, "%s: no memory for EXIF data", name);
    exif_data_load_data(data, bytes, (unsigned)n);
    const struct img_exif x = {exif_number(data, EXIF_TAG_EXPOSURE_TIME),
                               exif_number(data, EXIF_TAG_ISO_SPEED_RATINGS),
                               exif_number(data, EXIF_TAG_FNUMBER)};
    exif_data_unref(data);
    if (!(x.seconds > 0.0))
        return err_fail(ERR_FORMAT, "%s: no ExposureTime above 0 in its EXIF data", name);
    *out = x;
    return OK;
}

err_t img_exif_block(const void *block, size_t n, const char *name, struct img_info *out)
{
    unsigned char *exif;
    size_t n_exif;
    if (n >= 6 && memcmp(block, "Exif\0", 6) == 0) {
        block = (const char *)block + 6;
        n -= 6;
    }
    err_t e = head_exif(block, n, name, &exif, &n_exif);
    if (e)
        return e;
    e = parse_camera(exif, n_exif, name, &out->camera);
    if (!e && parse_exif(exif, n_exif, name, &out->exif) != OK) // without a time it is as good
        out->exif = (struct img_exif){0};
    free(exif);
    return e;
}

err_t img_exif_mem(const void *bytes, size_t n, const char *name, struct img_exif *out)
{
    *out = (struct img_exif){0};
    if (n > IMG_FILE_MAX)
        return err_fail(ERR_FORMAT, "%s: %zu bytes, allowed are %d", name, n, IMG_FILE_MAX);
    if (is_jpeg(bytes, n))
        return parse_exif(bytes, n, name, out);
    if (!is_png(bytes, n))
        return err_fail(ERR_FORMAT, "%s: neither PNG nor JPEG", name);
    unsigned char *exif;
    size_t n_exif;
    err_t e = exif_of_png(bytes, n, name, &exif, &n_exif);
    if (!e)
        e = parse_exif(exif, n_exif, name, out);
    free(exif);
    return e;
}

err_t img_exif(const char *path, struct img_exif *out)
{
    struct file_map m;
    *out = (struct img_exif){0};
    err_t e = file_map(path, IMG_FILE_MAX, &m);
    if (!e)
        e = img_exif_mem(m.p, m.n, path, out);
    file_unmap(&m);
    return e;
}

double img_exif_exposure(const struct img_exif *x)
{
    double iso = x->iso > 0 ? x->iso : 100.0, f_number = x->f_number > 0 ? x->f_number : 1.0;
    return x->seconds * (iso / 100.0) / (f_number * f_number);
}
