#include "drivers/format/heic.h"

#include <libheif/heif.h>
#include <stdlib.h>
#include <string.h>

enum {
    /* Intra coding spends at least the bit of a prediction mode, which is coded without a model, on
     * a block of at most 64 x 64 px (ITU-T H.265 7.3.8.5, 9.3.4.2). */
    PX_A_BYTE = 8 * 64 * 64,
    EXIF_MAX = 1 << 20 // bytes
};

struct reader {
    const char *name;
    struct heif_context *context;
    struct heif_image_handle *picture;
    int w, h, bits;
};

bool heic_is(const void *bytes, size_t n)
{
    static const char brand[][5] = {"heic", "heix", "heim", "heis", "mif1"};
    if (n < 12 || memcmp((const char *)bytes + 4, "ftyp", 4) != 0)
        return false;
    for (size_t i = 0; i < sizeof brand / sizeof *brand; i++)
        if (memcmp((const char *)bytes + 8, brand[i], 4) == 0)
            return true;
    return false;
}

static err_t heic_error(const char *name, struct heif_error why)
{
    if (why.code == heif_error_Unsupported_filetype || why.code == heif_error_Unsupported_feature ||
        why.subcode == heif_suberror_Unsupported_codec)
        return err_fail(ERR_UNSUPPORTED,
                        "%s: HEIC: %s; if libheif has no decoder here, install "
                        "libheif-plugin-libde265, or save it as JPEG",
                        name, why.message);
    const bool full = why.code == heif_error_Memory_allocation_error &&
                      why.subcode != heif_suberror_Security_limit_exceeded;
    return err_fail(full ? ERR_NOMEM : ERR_FORMAT, "%s: HEIC: %s", name, why.message);
}

static err_t check_size(const struct reader *r, size_t n)
{
    const int64_t px = (int64_t)r->w * r->h;
    if (r->w < 1 || r->h < 1 || r->w > IMG_SIDE_MAX || r->h > IMG_SIDE_MAX || px > IMG_PX_MAX)
        return err_fail(ERR_FORMAT, "%s: %d x %d px, allowed are 1 to %d a side and %d in all",
                        r->name, r->w, r->h, IMG_SIDE_MAX, IMG_PX_MAX);
    if ((size_t)px / PX_A_BYTE > n)
        return err_fail(ERR_FORMAT, "%s: %zu bytes cannot hold %d x %d px", r->name, n, r->w, r->h);
    if (r->bits < 8 || r->bits > 16)
        return err_fail(ERR_FORMAT, "%s: HEIC of %d bits, 8 to 16 are read", r->name, r->bits);
    return OK;
}

static void close_heic(struct reader *r)
{
    heif_image_handle_release(r->picture);
    heif_context_free(r->context);
}

/* own: close_heic, also on errors. */
static err_t open_heic(const void *bytes, size_t n, const char *name, struct reader *r)
{
    *r = (struct reader){.name = name};
    if (!heic_is(bytes, n) || n > IMG_FILE_MAX)
        return err_fail(ERR_FORMAT, "%s: no HEIC below %d bytes", name, IMG_FILE_MAX);
    r->context = heif_context_alloc();
    if (!r->context)
        return err_fail(ERR_NOMEM, "%s: no memory for a HEIC", name);
    heif_context_set_maximum_image_size_limit(r->context, IMG_SIDE_MAX);
    struct heif_error why = heif_context_read_from_memory_without_copy(r->context, bytes, n, NULL);
    if (why.code == heif_error_Ok)
        why = heif_context_get_primary_image_handle(r->context, &r->picture);
    if (why.code != heif_error_Ok)
        return heic_error(name, why);
    r->w = heif_image_handle_get_width(r->picture);
    r->h = heif_image_handle_get_height(r->picture);
    r->bits = heif_image_handle_get_luma_bits_per_pixel(r->picture);
    return check_size(r, n);
}

/* The block begins with the position of its TIFF header behind these four bytes (ISO 23008-12,
 * A.2.1); telephones put "Exif\0\0" between. */
static err_t parse_block(const struct reader *r, uint8_t *block, size_t n, struct img_info *out)
{
    if (n < 4)
        return OK;
    const size_t at =
        (size_t)block[0] << 24 | (size_t)block[1] << 16 | (size_t)block[2] << 8 | (size_t)block[3];
    if (at >= n - 4)
        return OK;
    return img_exif_block(block + 4 + at, n - 4 - at, r->name, out);
}

static err_t read_exif(const struct reader *r, struct img_info *out)
{
    heif_item_id id;
    if (heif_image_handle_get_list_of_metadata_block_IDs(r->picture, "Exif", &id, 1) != 1)
        return OK;
    const size_t n = heif_image_handle_get_metadata_size(r->picture, id);
    if (n == 0 || n > EXIF_MAX)
        return OK;
    uint8_t *block = malloc(n);
    if (!block)
        return err_fail(ERR_NOMEM, "%s: no memory for EXIF data", r->name);
    err_t e = OK;
    if (heif_image_handle_get_metadata(r->picture, id, block).code == heif_error_Ok)
        e = parse_block(r, block, n, out);
    free(block);
    return e;
}

err_t heic_look(const void *bytes, size_t n, const char *name, struct img_info *out)
{
    struct reader r;
    *out = (struct img_info){0};
    err_t e = open_heic(bytes, n, name, &r);
    if (!e)
        e = read_exif(&r, out);
    out->w = r.w;
    out->h = r.h;
    out->camera.orientation = 1; // libheif has turned it: what EXIF data say came before
    close_heic(&r);
    if (e)
        *out = (struct img_info){0};
    return e;
}

/* in: interleaved R,G,B of 16 bits, little-endian. */
static err_t copy_picture(const struct reader *r, const struct heif_image *in, struct image16 *out)
{
    int stride;
    const int w = heif_image_get_width(in, heif_channel_interleaved);
    const int h = heif_image_get_height(in, heif_channel_interleaved);
    const int bits = heif_image_get_bits_per_pixel_range(in, heif_channel_interleaved);
    const uint8_t *px = heif_image_get_plane_readonly(in, heif_channel_interleaved, &stride);
    if (!px || w != r->w || h != r->h || bits < 8 || bits > 16 || stride / 6 < w)
        return err_fail(ERR_FORMAT, "%s: HEIC of %d x %d px became %d x %d of %d bits", r->name,
                        r->w, r->h, w, h, bits);
    *out = (struct image16){w, h, 3, malloc(3 * (size_t)w * (size_t)h * sizeof *out->px)};
    if (!out->px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", r->name, w, h);
    const uint32_t white = (1u << bits) - 1;
    for (int y = 0; y < h; y++) {
        const uint8_t *row = px + (size_t)y * (size_t)stride;
        uint16_t *to = out->px + 3 * (size_t)y * (size_t)w;
        for (size_t i = 0; i < 3 * (size_t)w; i++) {
            const uint32_t v = (uint32_t)row[2 * i] | (uint32_t)row[2 * i + 1] << 8;
            to[i] = (uint16_t)(((v < white ? v : white) * 65535 + white / 2) / white);
        }
    }
    return OK;
}

static err_t decode(const struct reader *r, struct image16 *out)
{
    struct heif_image *in = NULL;
    struct heif_decoding_options *options = heif_decoding_options_alloc();
    if (!options)
        return err_fail(ERR_NOMEM, "%s: no memory for a HEIC", r->name);
    options->strict_decoding = 1;
    const struct heif_error why = heif_decode_image(r->picture, &in, heif_colorspace_RGB,
                                                    heif_chroma_interleaved_RRGGBB_LE, options);
    heif_decoding_options_free(options);
    err_t e = why.code == heif_error_Ok ? copy_picture(r, in, out) : heic_error(r->name, why);
    heif_image_release(in);
    return e;
}

err_t heic_read(const void *bytes, size_t n, const char *name, struct image16 *out)
{
    struct reader r;
    *out = (struct image16){0};
    err_t e = open_heic(bytes, n, name, &r);
    if (!e)
        e = decode(&r, out);
    close_heic(&r);
    if (e) {
        free(out->px);
        *out = (struct image16){0};
    }
    return e;
}
