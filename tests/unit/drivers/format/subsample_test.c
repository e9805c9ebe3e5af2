/* Thin pictures against full ones, in every format. */
#include "drivers/format/subsample.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* Bytes that a row of w px takes at least, and of a frame. */
static int row_of(enum camera_format f, int w)
{
    return f == CAMERA_RGB8 || f == CAMERA_BGR8         ? 3 * w
           : f == CAMERA_GREY || f == CAMERA_NV12       ? w
           : f >= CAMERA_RGGB10P && f <= CAMERA_GBRG10P ? (w + 3) / 4 * 5
           : f >= CAMERA_RGGB12P && f <= CAMERA_GBRG12P ? (w + 1) / 2 * 3
                                                        : 2 * w;
}

/* Whether block (bx, by) of the thin picture is that at (x, y) of the full one. */
static bool is_block(const struct raw *thin, int bx, int by, const struct raw *full, int x, int y)
{
    int c = full->cfa == RAW_RGB ? 3 : 1;
    for (int r = 0; r < 4; r++)
        if (memcmp(thin->px + ((by * 4 + r) * thin->w + bx * 4) * c,
                   full->px + ((y + r) * full->w + x) * c, 4 * (size_t)c * sizeof *full->px) != 0)
            return false;
    return true;
}

/* Where it is, behind (x, y) in its row; -1: nowhere. */
static int find_x(const struct raw *thin, int bx, int by, const struct raw *full, int x, int y)
{
    for (x += 4; x + 4 <= full->w; x += 4)
        if (is_block(thin, bx, by, full, x, y))
            return x;
    return -1;
}

static int find_y(const struct raw *thin, int by, const struct raw *full, int y)
{
    for (y += 4; y + 4 <= full->h; y += 4)
        if (find_x(thin, 0, by, full, -4, y) >= 0)
            return y;
    return -1;
}

/* Every block of the thin picture is a block of the full one, at a multiple of 4, in order. */
static void check_blocks(const struct raw *thin, const struct raw *full)
{
    int y = -4;
    assert_int_equal(thin->cfa, full->cfa);
    assert_true(thin->w <= 128 && thin->h <= 128 && thin->w % 4 == 0 && thin->h % 4 == 0);
    for (int by = 0; by < thin->h / 4; by++) {
        int x = -4;
        y = find_y(thin, by, full, y);
        assert_true(y >= 0);
        for (int bx = 0; bx < thin->w / 4; bx++) {
            x = find_x(thin, bx, by, full, x, y);
            assert_true(x >= 0);
        }
        assert_true(x >= full->w * 9 / 10 - 8); // spread to the end
    }
    assert_true(y >= full->h * 9 / 10 - 8);
}

static void check_format(enum camera_format format, int w, int h)
{
    struct camera_info info = {.w = w, .h = h, .format = format, .bits = 16};
    if (format >= CAMERA_RGGB10P)
        info.bits = format <= CAMERA_GBRG10P ? 10 : 12;
    if (format < CAMERA_GREY16)
        info.bits = 8;
    info.stride = row_of(format, w) + 6;
    size_t bytes = (size_t)info.stride * (size_t)(format == CAMERA_NV12 ? h * 3 / 2 : h);
    uint8_t *data = malloc(bytes);
    struct raw full = {.px = malloc(unpack_count(&info) * 2)};
    struct raw thin = {.px = malloc(subsample_count(&info) * 2)};
    uint32_t x = 1;
    for (size_t i = 0; i < bytes; i++)
        data[i] = (uint8_t)((x = x * 1664525 + 1013904223) >> 24);
    struct frame f = {
        .data = data, .bytes = bytes, .w = w, .h = h, .stride = info.stride, .format = format};
    if (unpack_run(&info, &f, &full) != OK)
        fail_msg("format %d %dx%d: %s", format, w, h, err_text());
    assert_int_equal(subsample_run(&info, &f, &thin), OK);
    struct raw kind = subsample_kind(&info);
    assert_true(kind.linear == full.linear && kind.bits == full.bits && kind.black == full.black);
    assert_true((kind.cfa >= RAW_RGGB) == (full.cfa >= RAW_RGGB));
    if (w <= 128 && h <= 128) {
        assert_true(thin.w == w && thin.h == h);
        assert_memory_equal(thin.px, full.px, unpack_count(&info) * 2);
    } else
        check_blocks(&thin, &full);
    f.bytes -= 7; // the padding of the last row and a byte
    assert_int_equal(subsample_run(&info, &f, &thin), ERR_FORMAT);
    free(data);
    free(full.px);
    free(thin.px);
}

static void every_format(void **state)
{
    (void)state;
    for (int f = CAMERA_RGB8; f < CAMERA_FORMATS; f++) {
        if (f == CAMERA_MJPG)
            continue;
        check_format((enum camera_format)f, 640, 360);
        check_format((enum camera_format)f, 130, 66);
        check_format((enum camera_format)f, 4, 1000);
        check_format((enum camera_format)f, 128, 96);
        check_format((enum camera_format)f, 2, 2);
    }
}

static void nothing_that_unpack_refuses(void **state)
{
    (void)state;
    struct camera_info info = {.w = 0, .h = 10, .format = CAMERA_RGB8};
    assert_int_equal(subsample_count(&info), 0);
    info.w = 20000;
    assert_int_equal(subsample_count(&info), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_format),
        cmocka_unit_test(nothing_that_unpack_refuses),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
