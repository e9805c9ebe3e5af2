/* The bytes of the blocks are gathered into a small frame of the same format, which is then
 * unpacked like any other: blocks of 4 x 4 px at multiples of 4 keep pairs of YUV, mosaics and
 * packed groups whole. Of a JPEG, which must be decoded, blocks of numbers are gathered. */
#include "drivers/format/subsample.h"

#include <string.h>

enum { EDGE = SUBSAMPLE_BLOCK * SUBSAMPLE_BLOCKS, BYTES_MAX = 3 }; // bytes per pixel at most

/* Bytes of SUBSAMPLE_BLOCK pixels in a row. */
static size_t block_bytes(enum camera_format f)
{
    switch (f) {
    case CAMERA_RGB8:
    case CAMERA_BGR8:
        return 12;
    case CAMERA_GREY:
    case CAMERA_NV12:
        return 4;
    case CAMERA_RGGB10P:
    case CAMERA_BGGR10P:
    case CAMERA_GRBG10P:
    case CAMERA_GBRG10P:
        return 5;
    case CAMERA_RGGB12P:
    case CAMERA_BGGR12P:
    case CAMERA_GRBG12P:
    case CAMERA_GBRG12P:
        return 6;
    default: // YUYV and 16-bit words
        return 8;
    }
}

/* Blocks along a side of n px. */
static int count_blocks(int n)
{
    return n < EDGE ? n / SUBSAMPLE_BLOCK : SUBSAMPLE_BLOCKS;
}

/* Position of block i of a side of n px, in blocks. */
static int block_start(int i, int n)
{
    int b = count_blocks(n);
    return (int)((2 * (int64_t)i + 1) * (n / SUBSAMPLE_BLOCK) / (2 * b));
}

static bool is_small(const struct camera_info *info)
{
    return info->w <= EDGE && info->h <= EDGE;
}

static struct camera_info small_info(const struct camera_info *info)
{
    struct camera_info s = *info;
    s.w = SUBSAMPLE_BLOCK * count_blocks(info->w);
    s.h = SUBSAMPLE_BLOCK * count_blocks(info->h);
    s.stride = (int)block_bytes(info->format) * count_blocks(info->w);
    return s;
}

size_t subsample_count(const struct camera_info *info)
{
    struct camera_info s = small_info(info);
    size_t all = unpack_count(info);
    if (!all || is_small(info) || info->format == CAMERA_MJPG || s.w == 0 || s.h == 0)
        return all;
    return unpack_count(&s);
}

/* Rows y of the small frame's blocks, `bytes` for each block. */
static void gather_row(const uint8_t *row, int w, size_t bytes, uint8_t *out)
{
    for (int i = 0; i < count_blocks(w); i++)
        memcpy(out + (size_t)i * bytes, row + (size_t)block_start(i, w) * bytes, bytes);
}

static err_t thin_bytes(const struct camera_info *info, const struct frame *f, struct raw *out)
{
    uint8_t bytes[BYTES_MAX * EDGE * EDGE];
    struct camera_info s = small_info(info);
    size_t block = block_bytes(info->format), stride = (size_t)s.stride, from = (size_t)f->stride;
    for (int y = 0; y < s.h; y++) {
        size_t row = (size_t)(block_start(y / SUBSAMPLE_BLOCK, f->h) * SUBSAMPLE_BLOCK +
                              y % SUBSAMPLE_BLOCK);
        gather_row(f->data + row * from, f->w, block, bytes + (size_t)y * stride);
    }
    const uint8_t *chroma = f->data + (size_t)f->h * from;
    for (int y = 0; y < s.h / 2 && info->format == CAMERA_NV12; y++) {
        size_t row = (size_t)(block_start(y / 2, f->h) * 2 + y % 2);
        gather_row(chroma + row * from, f->w, block, bytes + (size_t)(s.h + y) * stride);
    }
    struct frame small = *f;
    small.data = bytes;
    small.w = s.w;
    small.h = s.h;
    small.stride = s.stride;
    small.bytes = stride * (size_t)(info->format == CAMERA_NV12 ? s.h * 3 / 2 : s.h);
    return unpack_run(&s, &small, out);
}

/* Blocks of the unpacked picture, to its own beginning: none is overwritten before it is read. */
static void thin_numbers(struct raw *p)
{
    enum { COLOURS = 3 };
    int w = p->w, h = p->h;
    size_t n = 0;
    for (int y = 0; y < SUBSAMPLE_BLOCK * count_blocks(h); y++) {
        int row = block_start(y / SUBSAMPLE_BLOCK, h) * SUBSAMPLE_BLOCK + y % SUBSAMPLE_BLOCK;
        for (int i = 0; i < count_blocks(w); i++, n += COLOURS * SUBSAMPLE_BLOCK)
            memmove(p->px + n,
                    p->px + COLOURS * ((size_t)row * (size_t)w +
                                       (size_t)block_start(i, w) * SUBSAMPLE_BLOCK),
                    COLOURS * SUBSAMPLE_BLOCK * sizeof *p->px);
    }
    p->w = SUBSAMPLE_BLOCK * count_blocks(w);
    p->h = SUBSAMPLE_BLOCK * count_blocks(h);
}

err_t subsample_run(const struct camera_info *info, const struct frame *f, struct raw *out)
{
    err_t e = unpack_check(info, f);
    if (e)
        return e;
    bool whole = is_small(info) || count_blocks(info->w) == 0 || count_blocks(info->h) == 0;
    if (!whole && info->format != CAMERA_MJPG)
        return thin_bytes(info, f, out);
    e = unpack_run(info, f, out);
    if (!e && !whole)
        thin_numbers(out);
    return e;
}

struct raw subsample_kind(const struct camera_info *info)
{
    bool mono = info->format == CAMERA_GREY || info->format == CAMERA_GREY16;
    bool display = info->format <= CAMERA_GREY;
    enum raw_cfa cfa = mono ? RAW_MONO : display ? RAW_RGB : RAW_RGGB;
    return (struct raw){.w = info->w,
                        .h = info->h,
                        .cfa = cfa,
                        .bits = display ? 8 : info->bits,
                        .black = display ? 0 : info->black,
                        .linear = !display};
}
