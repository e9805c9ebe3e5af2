#include "drivers/format/imgsize.h"

#include "core/base/bytes.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"
#include "drivers/format/photofile.h"

#include <string.h>

static uint32_t read_be(struct bytes *b, int n)
{
    uint32_t v = 0;
    for (int i = 0; i < n; i++)
        v = v << 8 | bytes_u8(b);
    return v;
}

static bool png_size(struct bytes b, uint32_t *w, uint32_t *h)
{
    bytes_skip(&b, 12, 1); // signature, length of the first chunk
    const uint8_t *kind = bytes_take(&b, 4);
    *w = read_be(&b, 4);
    *h = read_be(&b, 4);
    return !b.bad && memcmp(kind, "IHDR", 4) == 0;
}

/* SOF0..SOF15 hold the size; C4, C8 and CC in their midst are tables. */
static bool is_frame(uint8_t marker)
{
    return marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
}

static bool jpeg_size(struct bytes b, uint32_t *w, uint32_t *h)
{
    bytes_skip(&b, 2, 1); // start of image
    while (!b.bad) {
        if (bytes_u8(&b) != 0xff)
            return false;
        uint8_t marker = 0xff;
        while (marker == 0xff && !b.bad) // fill bytes
            marker = bytes_u8(&b);
        uint32_t length = read_be(&b, 2);
        if (length < 2 || marker == 0xda) // pixels before any size
            return false;
        if (is_frame(marker)) {
            bytes_skip(&b, 1, 1); // bits per sample
            *h = read_be(&b, 2);
            *w = read_be(&b, 2);
            return !b.bad;
        }
        bytes_skip(&b, length - 2, 1);
    }
    return false;
}

bool imgsize_is_exr(const void *p, size_t n)
{
    return n >= 8 && memcmp(p, "\x76\x2f\x31\x01", 4) == 0;
}

static bool skip_text(struct bytes *b)
{
    int n = 0;
    while (bytes_u8(b) && !b->bad)
        n++;
    return n > 0 && !b->bad;
}

/* Attributes of the first part, as far as its data window. */
static bool exr_size(struct bytes b, uint32_t *w, uint32_t *h)
{
    bytes_skip(&b, 8, 1);
    while (!b.bad) {
        const char *name = (const char *)b.p;
        if (!skip_text(&b) || !skip_text(&b))
            return false;
        const uint32_t n = bytes_u32(&b);
        if (strcmp(name, "dataWindow") != 0) {
            bytes_skip(&b, n, 1);
            continue;
        }
        int64_t end[4];
        for (int i = 0; i < 4; i++)
            end[i] = (int32_t)bytes_u32(&b);
        if (b.bad || n != 16 || end[2] < end[0] || end[3] < end[1])
            return false;
        *w = (uint32_t)(end[2] - end[0] + 1);
        *h = (uint32_t)(end[3] - end[1] + 1);
        return true;
    }
    return false;
}

/* Name of another picture format by its first bytes; NULL: not known. */
static const char *other_kind(const char *p, size_t n)
{
    if (n < 12)
        return NULL;
    return memcmp(p + 4, "ftypavif", 8) == 0                            ? "AVIF"
           : memcmp(p, "II*", 4) == 0 || memcmp(p, "MM\0*", 4) == 0     ? "TIFF or raw"
           : memcmp(p, "RIFF", 4) == 0 && memcmp(p + 8, "WEBP", 4) == 0 ? "WebP"
           : memcmp(p, "GIF8", 4) == 0                                  ? "GIF"
           : memcmp(p, "BM", 2) == 0                                    ? "BMP"
                                                                        : NULL;
}

err_t imgsize_parse(const char *what, const void *p, size_t n, int *w, int *h)
{
    struct bytes b = bytes_of(p, n);
    uint32_t width = 0, height = 0;
    bool found = false;
    const struct photofile *photo = photofile_of(p, n);
    *w = *h = 0;
    if (n >= 8 && memcmp(p, "\x89PNG\r\n\x1a\n", 8) == 0)
        found = png_size(b, &width, &height);
    else if (n >= 2 && memcmp(p, "\xff\xd8", 2) == 0)
        found = jpeg_size(b, &width, &height);
    else if (imgsize_is_exr(p, n))
        found = exr_size(b, &width, &height);
    else if (photo) { // LibRaw, for one, knows the margins that a header includes
        struct img_info info;
        err_t e = photo->look(p, n, what, &info);
        *w = info.w;
        *h = info.h;
        return e;
    }
    const char *kind = found ? NULL : other_kind(p, n);
    if (kind)
        return err_fail(ERR_FORMAT, "%s: its bytes are %s: save it as PNG or JPEG", what, kind);
    if (!found || width == 0 || height == 0)
        return err_fail(ERR_FORMAT, "%s: no PNG, JPEG, TIFF, HEIC, raw or EXR header with a size",
                        what);
    if (width > IMG_SIDE_MAX || height > IMG_SIDE_MAX)
        return err_fail(ERR_FORMAT, "%s: %u x %u px, at most %d a side", what, width, height,
                        IMG_SIDE_MAX);
    const bool lies = img_orientation(p, n) >= 5;
    *w = (int)(lies ? height : width);
    *h = (int)(lies ? width : height);
    return OK;
}

err_t imgsize_read(const char *path, int *w, int *h)
{
    struct file_map m;
    *w = *h = 0;
    err_t e = file_map(path, IMG_FILE_MAX, &m);
    if (e)
        return e;
    e = imgsize_parse(path, m.p, m.n, w, h);
    file_unmap(&m);
    return e;
}

err_t imgsize_orientation(const char *path, int *orientation)
{
    struct file_map m;
    *orientation = 1;
    err_t e = file_map(path, IMG_FILE_MAX, &m);
    if (e)
        return e;
    *orientation = img_orientation(m.p, m.n);
    file_unmap(&m);
    return OK;
}
