#include "drivers/format/rawphoto.h"

#include "drivers/format/rawframe.h"
#include "drivers/format/turn.h"

#include <libraw/libraw.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    QUIET = 1, // libraw_init: no words on stderr when memory is short; 0.21 has none, nor the name
    PEDESTAL = 4096, // of no light, so that noise below it is kept
    FULL = 65535,    // of the sensor
    PX_A_BYTE = 16   // at most: lossless JPEG has a bit or more for each
};

/* A raw photograph while it is read. */
struct reader {
    const char *name;
    size_t n; // bytes
    libraw_data_t *raw;
    bool is_broken; // LibRaw met data that end or cannot be
};

bool rawphoto_is(const void *bytes, size_t n)
{
    return n >= 16 && (memcmp(bytes, "II*\0", 4) == 0 || memcmp(bytes, "MM\0*", 4) == 0);
}

/* Instead of LibRaw's words on stderr. */
static void note_broken(void *ctx, const char *file, const int offset)
{
    (void)file;
    (void)offset;
    ((struct reader *)ctx)->is_broken = true;
}

static err_t libraw_error(const char *name, int code)
{
    if (code == LIBRAW_UNSUFFICIENT_MEMORY)
        return err_fail(ERR_NOMEM, "%s: no memory for a raw photograph", name);
    return err_fail(
        ERR_FORMAT,
        "%s: TIFF, but no raw photograph that LibRaw reads (%s): save it as PNG or JPEG", name,
        code < 0 ? libraw_strerror(code) : strerror(code));
}

static err_t check_size(const struct reader *r)
{
    const libraw_image_sizes_t *s = &r->raw->sizes;
    const uint64_t px = (uint64_t)s->raw_width * s->raw_height;
    const unsigned side = IMG_SIDE_MAX;
    if (s->width < 2 || s->height < 2 || s->raw_width > side || s->raw_height > side ||
        px > IMG_PX_MAX)
        return err_fail(ERR_FORMAT, "%s: %u x %u px, allowed are 2 to %d a side and %d in all",
                        r->name, s->raw_width, s->raw_height, IMG_SIDE_MAX, IMG_PX_MAX);
    if (px / PX_A_BYTE > r->n)
        return err_fail(ERR_FORMAT, "%s: %zu bytes cannot hold %u x %u px", r->name, r->n,
                        s->raw_width, s->raw_height);
    if (s->left_margin + s->width > s->raw_width || s->top_margin + s->height > s->raw_height)
        return err_fail(ERR_FORMAT, "%s: its picture is larger than the %u x %u px of its sensor",
                        r->name, s->raw_width, s->raw_height);
    return OK;
}

/* The 2 x 2 sites that the whole mosaic repeats; false: others, as X-Trans. */
static bool find_cfa(libraw_data_t *raw, enum raw_cfa *out)
{
    for (int cfa = RAW_RGGB; cfa <= RAW_GBRG; cfa++) {
        bool same = raw->idata.colors == 3 && raw->idata.filters > 1000;
        for (int i = 0; i < 16 && same; i++) { // `filters` has 8 rows of 2
            const int c = libraw_COLOR(raw, i / 2, i & 1);
            same = (c == 3 ? 1 : c) == raw_colour((enum raw_cfa)cfa, i / 2, i & 1);
        }
        if (same) {
            *out = (enum raw_cfa)cfa;
            return true;
        }
    }
    return false;
}

/* own: libraw_close(r->raw), NULL on errors. */
static err_t open_raw(const void *bytes, size_t n, const char *name, struct reader *r)
{
    enum raw_cfa cfa;
    *r = (struct reader){.name = name, .n = n};
    if (!rawphoto_is(bytes, n) || n > IMG_FILE_MAX)
        return err_fail(ERR_FORMAT, "%s: no raw photograph below %d bytes", name, IMG_FILE_MAX);
    r->raw = libraw_init(QUIET);
    if (!r->raw)
        return libraw_error(name, LIBRAW_UNSUFFICIENT_MEMORY);
    libraw_set_dataerror_handler(r->raw, note_broken, r);
    const int code = libraw_open_buffer(r->raw, (void *)(uintptr_t)bytes, n);
    err_t e = code ? libraw_error(name, code) : check_size(r);
    if (!e && (!find_cfa(r->raw, &cfa) || strcmp(r->raw->idata.cdesc, "RGBG") != 0))
        e = err_fail(ERR_FORMAT, "%s: not a Bayer mosaic of red, green and blue", name);
    if (e) {
        libraw_close(r->raw);
        r->raw = NULL;
    }
    return e;
}

static int orientation_of(const libraw_data_t *raw)
{
    static const int8_t by_flip[] = {1, 2, 4, 3, 5, 8, 6, 7}; // bits: mirrored, upside down, turned
    return by_flip[raw->sizes.flip & 7];
}

/* Whole cells of the mosaic. */
static int whole_cells(unsigned v)
{
    return (int)(v & ~1u);
}

static void name_camera(const libraw_data_t *raw, char out[NAME_CAP])
{
    int n = snprintf(out, NAME_CAP, "%.50s %.50s", raw->idata.make, raw->idata.model);
    if (raw->other.focal_len > 0 && n < NAME_CAP)
        snprintf(out + n, NAME_CAP - (size_t)n, " %g mm", (double)raw->other.focal_len);
    for (char *p = out; *p; p++)
        *p = *p >= ' ' && *p < 127 ? *p : '_';
}

/* A finite number above 0, else 0. */
static double positive_or_zero(float v)
{
    return v > 0 && v < 1e9f ? (double)v : 0;
}

err_t rawphoto_look(const void *bytes, size_t n, const char *name, struct img_info *out)
{
    struct reader r;
    *out = (struct img_info){0};
    err_t e = open_raw(bytes, n, name, &r);
    if (e)
        return e;
    const libraw_data_t *raw = r.raw;
    const bool lies = orientation_of(raw) >= 5;
    out->w = whole_cells(lies ? raw->sizes.height : raw->sizes.width);
    out->h = whole_cells(lies ? raw->sizes.width : raw->sizes.height);
    out->exif.seconds = positive_or_zero(raw->other.shutter);
    out->exif.iso = positive_or_zero(raw->other.iso_speed);
    out->exif.f_number = positive_or_zero(raw->other.aperture);
    out->camera.focal_35mm = raw->lens.FocalLengthIn35mmFormat;
    name_camera(raw, out->camera.name);
    out->camera.orientation = 1;
    libraw_close(r.raw);
    return OK;
}

/* Code of no light at a site: of all, of its colour, and of a pattern that repeats. */
static double black_at(const libraw_colordata_t *c, int colour, int y, int x)
{
    const unsigned rows = c->cblack[4], columns = c->cblack[5];
    double black = c->black + (double)c->cblack[colour];
    if (rows > 0 && columns > 0)
        black += c->cblack[6 + (unsigned)y % rows * columns + (unsigned)x % columns];
    return black;
}

static err_t check_levels(const struct reader *r, const libraw_colordata_t *c)
{
    const unsigned cap = sizeof c->cblack / sizeof c->cblack[0] - 6;
    if (c->cblack[4] > cap || c->cblack[5] > cap || c->cblack[4] * c->cblack[5] > cap)
        return err_fail(ERR_FORMAT, "%s: %u x %u black levels, allowed are %u", r->name,
                        c->cblack[4], c->cblack[5], cap);
    for (int i = 0; i < 4; i++)
        if (black_at(c, i, 0, 0) + 16 > c->maximum)
            return err_fail(ERR_FORMAT, "%s: black level %.0f, but its white level is %u", r->name,
                            black_at(c, i, 0, 0), c->maximum);
    return OK;
}

/* All sites with one black level and 16 bits, FULL where the sensor is. */
static void level_mosaic(libraw_data_t *raw, struct raw *io)
{
    const libraw_colordata_t *c = &raw->color;
    const libraw_image_sizes_t *s = &raw->sizes;
    for (int y = 0; y < io->h; y++) {
        const uint16_t *p =
            (const uint16_t *)(const void *)((const char *)raw->rawdata.raw_image +
                                             (size_t)(y + s->top_margin) * s->raw_pitch) +
            s->left_margin;
        for (int x = 0; x < io->w; x++) {
            const double black = black_at(c, libraw_COLOR(raw, y, x), y, x);
            const double v = (p[x] - black) / fmax(c->maximum - black, 1);
            io->px[(size_t)y * (size_t)io->w + (size_t)x] =
                (uint16_t)(fmin(fmax(v * (FULL - PEDESTAL) + PEDESTAL, 0), FULL) + 0.5);
        }
    }
}

/* As the camera had set it, else for the light of day, else none. */
static void set_balance(const libraw_colordata_t *c, struct develop *out)
{
    const float *sets[] = {c->cam_mul, c->pre_mul};
    *out = (struct develop){1, 1};
    for (int i = 0; i < 2; i++) {
        const float red = sets[i][0] / sets[i][1], blue = sets[i][2] / sets[i][1];
        if (red >= 1.0f / 64 && red <= 64 && blue >= 1.0f / 64 && blue <= 64) {
            *out = (struct develop){red, blue};
            return;
        }
    }
}

static err_t develop_mosaic(const struct reader *r, struct image16 *out)
{
    const libraw_image_sizes_t *s = &r->raw->sizes;
    struct raw mosaic = {.w = whole_cells(s->width),
                         .h = whole_cells(s->height),
                         .bits = 16,
                         .black = PEDESTAL,
                         .linear = true};
    struct develop how;
    if (!find_cfa(r->raw, &mosaic.cfa))
        return err_fail(ERR_FORMAT, "%s: not a Bayer mosaic of red, green and blue", r->name);
    mosaic.px = malloc((size_t)mosaic.w * (size_t)mosaic.h * sizeof *mosaic.px);
    if (!mosaic.px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", r->name, mosaic.w, mosaic.h);
    level_mosaic(r->raw, &mosaic);
    set_balance(&r->raw->color, &how);
    err_t e = rawframe_develop(r->name, &mosaic, &how, out);
    free(mosaic.px);
    if (!e)
        e = turn_image16(orientation_of(r->raw), r->name, out);
    return e;
}

static err_t unpack_mosaic(const struct reader *r)
{
    const int code = libraw_unpack(r->raw);
    if (code || r->is_broken)
        return code == LIBRAW_UNSUFFICIENT_MEMORY
                   ? libraw_error(r->name, code)
                   : err_fail(ERR_FORMAT, "%s: its data are cut off or broken", r->name);
    err_t e = check_size(r);
    if (!e && (!r->raw->rawdata.raw_image ||
               r->raw->sizes.raw_pitch < r->raw->sizes.raw_width * sizeof(uint16_t)))
        e = err_fail(ERR_FORMAT, "%s: not a Bayer mosaic of red, green and blue", r->name);
    return e ? e : check_levels(r, &r->raw->color);
}

err_t rawphoto_read(const void *bytes, size_t n, const char *name, struct image16 *out)
{
    struct reader r;
    *out = (struct image16){0};
    err_t e = open_raw(bytes, n, name, &r);
    if (e)
        return e;
    e = unpack_mosaic(&r);
    if (!e)
        e = develop_mosaic(&r, out);
    if (e) {
        free(out->px);
        *out = (struct image16){0};
    }
    libraw_close(r.raw);
    return e;
}
