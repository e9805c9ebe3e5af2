/* What the status page shows of a waiting camera (firmware/capture/idle_view.h). */
#include "firmware/capture/idle_view.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static uint16_t px[3 * 640 * 480];
static struct idle_view_picture small;

static struct raw raw_of(int w, int h, enum raw_cfa cfa, int bits, int black)
{
    return (struct raw){.w = w, .h = h, .cfa = cfa, .bits = bits, .black = black, .px = px};
}

static void histograms_count_every_code(void **state)
{
    (void)state;
    static const int bits[] = {8, 10, 12, 16};
    for (int k = 0; k < 8; k++) {
        const int b = bits[k / 2], top = (1 << b) - 1, black = k == 5 ? 200 : 0;
        struct raw r = raw_of(256, 256, RAW_MONO, b, black);
        struct session_view v;
        uint32_t want[SESSION_BINS] = {0};
        r.linear = k & 1;
        for (int i = 0; i < 65536; i++) {
            px[i] = (uint16_t)(i & top);
            /* codes of more than 12 bits are told apart by their first 12 */
            const int code = b > 12 ? px[i] & ~15 : px[i];
            double x = fmax(0, code - black) / (top - black);
            int bin = (int)((r.linear ? pow(x, 1 / 2.2) : x) * SESSION_BINS);
            want[bin < SESSION_BINS ? bin : SESSION_BINS - 1]++;
        }
        idle_view_look(&r, &v);
        assert_memory_equal(v.histogram, want, sizeof want);
    }
}

/* A scene of two halves and a bright corner, through each mosaic. */
static int light_at(int x, int y, int c)
{
    const int corner = x < 64 && y < 64;
    return x < 320 ? (corner ? 900 : 300) : c == 0 ? 500 : 100;
}

/* The scene with 64 as the code of no light. */
static void put_scene(enum raw_cfa cfa)
{
    for (int i = 0; i < 640 * 480; i++)
        for (int c = 0; c < 3; c++) {
            const uint16_t code = (uint16_t)(64 + light_at(i % 640, i / 640, c));
            if (cfa == RAW_RGB)
                px[3 * i + c] = code;
            else if (raw_colour(cfa, i / 640, i % 640) == c)
                px[i] = code;
        }
}

static const uint8_t *small_at(int x, int y)
{
    return small.px + 3 * (y * small.w + x);
}

static void mosaics_give_one_picture(void **state)
{
    (void)state;
    static uint8_t first[sizeof small.px];
    static const enum raw_cfa cfas[] = {RAW_RGB, RAW_RGGB, RAW_BGGR, RAW_GRBG, RAW_GBRG};
    for (int k = 0; k < 5; k++) {
        struct raw r = raw_of(640, 480, cfas[k], 10, 64);
        r.linear = true;
        put_scene(cfas[k]);
        idle_view_shrink(&r, &small);
        assert_int_equal(small.w, 160);
        assert_int_equal(small.h, 120);
        if (k == 0)
            memcpy(first, small.px, sizeof first);
        for (int i = 0; i < 3 * small.w * small.h; i++)
            assert_true(abs(small.px[i] - first[i]) <= 1);
    }
    assert_true(small_at(5, 5)[1] > small_at(50, 60)[1] + 50);     // the corner
    assert_true(small_at(120, 60)[0] > small_at(120, 60)[2] + 50); // red, right
    assert_true(small_at(50, 60)[2] > small_at(120, 60)[2] + 30);
}

static void one_colour_is_grey_whatever_its_brightness(void **state)
{
    (void)state;
    for (int light = 3; light < 1000; light *= 6) {
        struct raw r = raw_of(320, 200, RAW_RGB, 10, 0);
        r.linear = true;
        for (int i = 0; i < 320 * 200; i++)
            for (int c = 0; c < 3; c++)
                px[3 * i + c] = (uint16_t)(c == 1 ? light : light * 2 / 3);
        idle_view_shrink(&r, &small);
        for (int c = 0; c < 3; c++)
            assert_in_range(small_at(80, 50)[c], 155, 161); // 255 0.35^(1/2.2) = 158
    }
}

static void extremes(void **state)
{
    (void)state;
    static const int sizes[][2] = {{2, 2}, {3, 5}, {640, 2}, {162, 160}, {1, 1}};
    for (int k = 0; k < 5; k++)
        for (int value = 0; value < 1024; value += 1023) {
            struct raw r = raw_of(sizes[k][0], sizes[k][1], RAW_MONO, 10, 1023 * (k == 3) / 2);
            for (int i = 0; i < r.w * r.h; i++)
                px[i] = (uint16_t)value;
            r.linear = true;
            idle_view_shrink(&r, &small);
            assert_int_equal(small.w, r.w == 1 ? 0 : r.w == 3 ? 1 : r.w == 640 ? 160 : r.w / 2);
            for (int i = 0; i < 3 * small.w * small.h; i++)
                assert_true(value == 0 ? small.px[i] == 0 : small.px[i] > 150);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(histograms_count_every_code),
        cmocka_unit_test(mosaics_give_one_picture),
        cmocka_unit_test(one_colour_is_grey_whatever_its_brightness),
        cmocka_unit_test(extremes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
