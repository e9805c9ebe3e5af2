#include "drivers/format/tiff.h"

#include "drivers/format/turn.h"

#include <stdlib.h>
#include <string.h>
#include <tiffio.h>

enum {
    TAG_PHOTOMETRIC = 262,
    TAG_SUB_IFDS = 330,
    TAG_DNG = 50706,
    ENTRIES_MAX = 4096,
    PX_A_BYTE = 1100 // at most: deflate, of which 1 byte can become 1032
};

/* A file in memory while it is read. */
struct reader {
    const char *name;
    const uint8_t *p;
    size_t n, at;
    TIFF *tif;
    char why[120]; // libtiff's last words
    uint32_t w, h;
    uint16_t bits, samples, planar, orientation;
};

/* ---- which kind ---- */

static uint32_t read_number(const uint8_t *p, int n, bool big)
{
    uint32_t v = 0;
    for (int i = 0; i < n; i++)
        v |= (uint32_t)p[i] << 8 * (big ? n - 1 - i : i);
    return v;
}

bool tiff_is(const void *bytes, size_t n)
{
    const uint8_t *p = bytes;
    if (n < 16 || (memcmp(p, "II*\0", 4) != 0 && memcmp(p, "MM\0*", 4) != 0) ||
        memcmp(p + 8, "CR", 2) == 0)
        return false;
    const bool big = p[0] == 'M';
    const size_t at = read_number(p + 4, 4, big);
    if (at > n - 2)
        return false;
    const size_t entries = read_number(p + at, 2, big);
    bool picture = false;
    if (entries > ENTRIES_MAX || 12 * entries > n - 2 - at)
        return false;
    for (size_t i = 0; i < entries; i++) {
        const uint8_t *entry = p + at + 2 + 12 * i;
        const uint32_t tag = read_number(entry, 2, big), value = read_number(entry + 8, 2, big);
        if (tag == TAG_SUB_IFDS || tag == TAG_DNG)
            return false;
        picture = picture || (tag == TAG_PHOTOMETRIC && value <= PHOTOMETRIC_YCBCR);
    }
    return picture;
}

/* ---- memory as a file ---- */

static tmsize_t read_bytes(thandle_t ctx, void *to, tmsize_t n)
{
    struct reader *r = ctx;
    const size_t left = r->at < r->n ? r->n - r->at : 0, take = (size_t)n < left ? (size_t)n : left;
    memcpy(to, r->p + (take ? r->at : 0), take);
    r->at += take;
    return (tmsize_t)take;
}

static tmsize_t write_nothing(thandle_t ctx, void *from, tmsize_t n)
{
    (void)ctx, (void)from, (void)n;
    return 0;
}

static toff_t seek_bytes(thandle_t ctx, toff_t offset, int whence)
{
    struct reader *r = ctx;
    r->at = (size_t)(offset + (whence == SEEK_CUR ? r->at : whence == SEEK_END ? r->n : 0));
    return r->at;
}

static int close_nothing(thandle_t ctx)
{
    (void)ctx;
    return 0;
}

static toff_t count_bytes(thandle_t ctx)
{
    const struct reader *r = ctx;
    return r->n;
}

static int note_error(TIFF *tif, void *ctx, const char *module, const char *format, va_list ap)
{
    struct reader *r = ctx;
    (void)tif, (void)module;
    vsnprintf(r->why, sizeof r->why, format, ap);
    return 1;
}

static int note_nothing(TIFF *tif, void *ctx, const char *module, const char *format, va_list ap)
{
    (void)tif, (void)ctx, (void)module, (void)format, (void)ap;
    return 1;
}

/* ---- header ---- */

static err_t check_layout(const struct reader *r)
{
    uint16_t kind = 0, format = SAMPLEFORMAT_UINT;
    TIFFGetField(r->tif, TIFFTAG_PHOTOMETRIC, &kind);
    TIFFGetFieldDefaulted(r->tif, TIFFTAG_SAMPLEFORMAT, &format);
    if ((r->bits != 8 && r->bits != 16) || format != SAMPLEFORMAT_UINT)
        return err_fail(ERR_FORMAT,
                        "%s: TIFF of %d bits%s: 8 and 16 are read; save it in 16 bits, or floats "
                        "as OpenEXR",
                        r->name, r->bits, format == SAMPLEFORMAT_IEEEFP ? " in floats" : "");
    if ((kind != PHOTOMETRIC_RGB || r->samples < 3) && kind != PHOTOMETRIC_MINISBLACK)
        return err_fail(ERR_FORMAT, "%s: TIFF of colours that are neither RGB nor grey (%d)",
                        r->name, kind);
    return r->samples >= 1 && r->samples <= 8
               ? OK
               : err_fail(ERR_FORMAT, "%s: TIFF of %d channels, 1 to 8 are read", r->name,
                          r->samples);
}

static err_t check_size(const struct reader *r)
{
    const uint64_t px = (uint64_t)r->w * r->h;
    if (r->w < 1 || r->h < 1 || r->w > IMG_SIDE_MAX || r->h > IMG_SIDE_MAX || px > IMG_PX_MAX)
        return err_fail(ERR_FORMAT, "%s: %u x %u px, allowed are 1 to %d a side and %d in all",
                        r->name, r->w, r->h, IMG_SIDE_MAX, IMG_PX_MAX);
    if (px / PX_A_BYTE > r->n)
        return err_fail(ERR_FORMAT, "%s: %zu bytes cannot hold %u x %u px", r->name, r->n, r->w,
                        r->h);
    return OK;
}

static err_t tiff_error(const struct reader *r)
{
    return err_fail(ERR_FORMAT, "%s: TIFF: %s", r->name, r->why[0] ? r->why : "damaged");
}

/* own: TIFFClose(r->tif), NULL on errors. */
static err_t open_tiff(const void *bytes, size_t n, const char *name, struct reader *r)
{
    *r = (struct reader){.name = name, .p = bytes, .n = n, .orientation = ORIENTATION_TOPLEFT};
    if (!tiff_is(bytes, n) || n > IMG_FILE_MAX)
        return err_fail(ERR_FORMAT, "%s: no TIFF below %d bytes", name, IMG_FILE_MAX);
    TIFFOpenOptions *options = TIFFOpenOptionsAlloc();
    if (!options)
        return err_fail(ERR_NOMEM, "%s: no memory for a TIFF", name);
    TIFFOpenOptionsSetMaxSingleMemAlloc(options, (tmsize_t)6 * IMG_PX_MAX);
    TIFFOpenOptionsSetErrorHandlerExtR(options, note_error, r);
    TIFFOpenOptionsSetWarningHandlerExtR(options, note_nothing, r);
    r->tif = TIFFClientOpenExt(name, "rm", r, read_bytes, write_nothing, seek_bytes, close_nothing,
                               count_bytes, NULL, NULL, options);
    TIFFOpenOptionsFree(options);
    if (!r->tif)
        return tiff_error(r);
    TIFFGetField(r->tif, TIFFTAG_IMAGEWIDTH, &r->w);
    TIFFGetField(r->tif, TIFFTAG_IMAGELENGTH, &r->h);
    TIFFGetFieldDefaulted(r->tif, TIFFTAG_BITSPERSAMPLE, &r->bits);
    TIFFGetFieldDefaulted(r->tif, TIFFTAG_SAMPLESPERPIXEL, &r->samples);
    TIFFGetFieldDefaulted(r->tif, TIFFTAG_PLANARCONFIG, &r->planar);
    TIFFGetField(r->tif, TIFFTAG_ORIENTATION, &r->orientation);
    if (r->orientation < 1 || r->orientation > 8)
        r->orientation = 1;
    err_t e = check_layout(r);
    if (!e)
        e = check_size(r);
    if (e) {
        TIFFClose(r->tif);
        r->tif = NULL;
    }
    return e;
}

/* A finite number above 0, else 0. Versions of libtiff differ in its type. */
static double exif_number(TIFF *tif, uint32_t tag)
{
    const TIFFField *field = TIFFFieldWithTag(tif, tag);
    double v = 0;
    float single = 0;
    if (!field)
        return 0;
    if (TIFFFieldSetGetSize(field) == sizeof v)
        TIFFGetField(tif, tag, &v);
    else if (TIFFFieldSetGetSize(field) == sizeof single && TIFFGetField(tif, tag, &single))
        v = (double)single;
    return v > 0 && v < 1e9 ? v : 0;
}

static void name_camera(TIFF *tif, char out[NAME_CAP])
{
    const char *make = NULL, *model = NULL;
    TIFFGetField(tif, TIFFTAG_MAKE, &make);
    TIFFGetField(tif, TIFFTAG_MODEL, &model);
    if (make || model)
        snprintf(out, NAME_CAP, "%.50s %.50s", make ? make : "", model ? model : "");
    for (char *p = out; *p; p++)
        *p = *p >= ' ' && *p < 127 ? *p : '_';
}

static void read_exif(TIFF *tif, struct img_info *out)
{
    uint64_t at = 0;
    uint16_t n = 0, focal = 0, unit = 0, *iso = NULL;
    uint32_t w = 0, h = 0;
    name_camera(tif, out->camera.name);
    if (!TIFFGetField(tif, TIFFTAG_EXIFIFD, &at) || !TIFFReadEXIFDirectory(tif, at))
        return;
    out->exif.seconds = exif_number(tif, EXIFTAG_EXPOSURETIME);
    out->exif.f_number = exif_number(tif, EXIFTAG_FNUMBER);
    if (TIFFGetField(tif, EXIFTAG_ISOSPEEDRATINGS, &n, &iso) && n > 0)
        out->exif.iso = iso[0];
    if (TIFFGetField(tif, EXIFTAG_FOCALLENGTHIN35MMFILM, &focal))
        out->camera.focal_35mm = focal;
    TIFFGetField(tif, EXIFTAG_FOCALPLANERESOLUTIONUNIT, &unit);
    TIFFGetField(tif, EXIFTAG_PIXELXDIMENSION, &w);
    TIFFGetField(tif, EXIFTAG_PIXELYDIMENSION, &h);
    const struct img_plane plane = {exif_number(tif, EXIFTAG_FOCALLENGTH),
                                    exif_number(tif, EXIFTAG_FOCALPLANEXRESOLUTION), unit, w, h};
    out->camera.focal_plane = img_focal_plane(&plane);
}

err_t tiff_look(const void *bytes, size_t n, const char *name, struct img_info *out)
{
    struct reader r;
    *out = (struct img_info){0};
    err_t e = open_tiff(bytes, n, name, &r);
    if (e)
        return e;
    const bool lies = r.orientation >= 5;
    out->w = (int)(lies ? r.h : r.w);
    out->h = (int)(lies ? r.w : r.h);
    out->camera.orientation = 1;
    read_exif(r.tif, out);
    TIFFClose(r.tif);
    return OK;
}

/* ---- pixels ---- */

/* Strips or tiles; strips are tiles of the picture's width. */
struct blocks {
    uint32_t w, h; // px
    bool tiled;
    int planes;       // one after the other; 0: all channels of a pixel together
    size_t row, most; // bytes of a row, of a block
    void *px;         // of one block
};

static uint16_t sample_of(const struct reader *r, const void *px, size_t i)
{
    return r->bits == 8 ? (uint16_t)(((const uint8_t *)px)[i] * 257) : ((const uint16_t *)px)[i];
}

/* A pixel from its channels, or from one: red, green or blue, or of grey all three. */
static void put_pixel(const struct reader *r, const struct blocks *b, int plane, size_t from,
                      uint16_t to[3])
{
    for (int c = 0; c < 3; c++) {
        if (b->planes == 0)
            to[c] = sample_of(r, b->px, from * r->samples + (r->samples < 3 ? 0 : (size_t)c));
        else if (r->samples < 3 || plane == c)
            to[c] = sample_of(r, b->px, from);
    }
}

/* The block at x, y; pixels beyond the picture are left out. */
static err_t read_block(const struct reader *r, const struct blocks *b, int plane,
                        const uint32_t at[2], struct image16 *out)
{
    const uint16_t s = (uint16_t)plane;
    const uint32_t rows = b->tiled || r->h - at[1] > b->h ? b->h : r->h - at[1];
    const tmsize_t cap = (tmsize_t)b->most;
    const tmsize_t got =
        b->tiled
            ? TIFFReadEncodedTile(r->tif, TIFFComputeTile(r->tif, at[0], at[1], 0, s), b->px, cap)
            : TIFFReadEncodedStrip(r->tif, TIFFComputeStrip(r->tif, at[1], s), b->px, cap);
    if (got < (tmsize_t)(b->row * rows))
        return tiff_error(r);
    for (uint32_t y = 0; y < rows && at[1] + y < r->h; y++)
        for (uint32_t x = 0; x < b->w && at[0] + x < r->w; x++)
            put_pixel(r, b, plane, (size_t)y * b->w + x,
                      out->px + 3 * ((size_t)(at[1] + y) * r->w + at[0] + x));
    return OK;
}

static err_t read_plane(const struct reader *r, const struct blocks *b, int plane,
                        struct image16 *out)
{
    err_t e = OK;
    for (uint32_t y = 0; y < r->h && !e; y += b->h)
        for (uint32_t x = 0; x < r->w && !e; x += b->w)
            e = read_block(r, b, plane, (const uint32_t[]){x, y}, out);
    return e;
}

static err_t find_blocks(const struct reader *r, struct blocks *b)
{
    *b = (struct blocks){.w = r->w, .tiled = TIFFIsTiled(r->tif)};
    if (b->tiled) {
        TIFFGetField(r->tif, TIFFTAG_TILEWIDTH, &b->w);
        TIFFGetField(r->tif, TIFFTAG_TILELENGTH, &b->h);
    } else {
        TIFFGetFieldDefaulted(r->tif, TIFFTAG_ROWSPERSTRIP, &b->h);
        b->h = b->h < r->h ? b->h : r->h;
    }
    if (r->planar == PLANARCONFIG_SEPARATE)
        b->planes = r->samples < 3 ? 1 : 3;
    b->row = (size_t)b->w * (b->planes ? 1 : r->samples) * (r->bits / 8);
    const tmsize_t most = b->tiled ? TIFFTileSize(r->tif) : TIFFStripSize(r->tif);
    if (b->w < 1 || b->h < 1 || b->w > 2 * IMG_SIDE_MAX || b->h > 2 * IMG_SIDE_MAX || most < 1 ||
        (size_t)most < b->row * b->h)
        return err_fail(ERR_FORMAT, "%s: TIFF: blocks of %u x %u px", r->name, b->w, b->h);
    b->most = (size_t)most;
    return OK;
}

static err_t read_picture(const struct reader *r, struct image16 *out)
{
    struct blocks b;
    err_t e = find_blocks(r, &b);
    if (e)
        return e;
    b.px = malloc(b.most);
    *out = (struct image16){(int)r->w, (int)r->h, 3, calloc(3 * (size_t)r->w * r->h, 2)};
    if (!out->px || !b.px)
        e = err_fail(ERR_NOMEM, "%s: no memory for %u x %u px", r->name, r->w, r->h);
    for (int plane = 0; plane < (b.planes ? b.planes : 1) && !e; plane++)
        e = read_plane(r, &b, plane, out);
    free(b.px);
    return e;
}

err_t tiff_read(const void *bytes, size_t n, const char *name, struct image16 *out)
{
    struct reader r;
    *out = (struct image16){0};
    err_t e = open_tiff(bytes, n, name, &r);
    if (e)
        return e;
    e = read_picture(&r, out);
    TIFFClose(r.tif);
    if (!e)
        e = turn_image16(r.orientation, name, out);
    if (e) {
        free(out->px);
        *out = (struct image16){0};
    }
    return e;
}
