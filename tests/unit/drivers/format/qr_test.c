/* Codes have the size of the standard, a margin, and the three marks in their corners; widths that
 * do not fit are refused. */
#include "drivers/format/qr.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIDE_MAX = 200 };

static char dark[SIDE_MAX][SIDE_MAX];

/* The modules of a code, with its margin. returns: columns. */
static int draw(const char *text)
{
    char *out = NULL;
    size_t n;
    FILE *f = open_memstream(&out, &n);
    int x = 0, y = 0, wide = 0;
    assert_int_equal(qr_print(text, 0, f), OK);
    fclose(f);
    memset(dark, 0, sizeof dark);
    for (const char *p = out; *p; p++) {
        if (*p == '\033')
            p += strcspn(p, "m");
        else if (*p == '\n') {
            wide = x;
            x = 0;
            y += 2;
        } else {
            const bool block = *p == '\xe2';
            dark[y][x] = !block || p[2] == '\x84';
            dark[y + 1][x++] = !block || p[2] == '\x80';
            p += block ? 2 : 0;
        }
        assert_in_range(x, 0, SIDE_MAX - 1);
        assert_in_range(y, 0, SIDE_MAX - 2);
    }
    free(out);
    return wide;
}

static void assert_mark(int x0, int y0)
{
    for (int y = -1; y < 8; y++)
        for (int x = -1; x < 8; x++) {
            const int dx = abs(x - 3), dy = abs(y - 3), ring = dx > dy ? dx : dy;
            assert_int_equal(dark[y0 + y][x0 + x], ring == 3 || ring < 2);
        }
}

static void codes_are_whole(void **state)
{
    (void)state;
    char text[QR_BYTES_MAX + 1] = "";
    static const int lengths[] = {1, 17, 18, 529, QR_BYTES_MAX}, sides[] = {21, 21, 25, 81, 177};
    for (int i = 0; i < 5; i++) {
        memset(text, 'a', (size_t)lengths[i]);
        text[lengths[i]] = 0;
        const int wide = draw(text);
        assert_int_equal(wide, sides[i] + 8);
        assert_mark(4, 4);
        assert_mark(wide - 11, 4);
        assert_mark(4, wide - 11);
        for (int k = 0; k < wide; k++)
            for (int m = 0; m < 4; m++)
                assert_false(dark[m][k] || dark[k][m] || dark[wide - 1 - m][k] ||
                             dark[k][wide - 1 - m]);
    }
}

static void what_does_not_fit(void **state)
{
    (void)state;
    static char text[QR_BYTES_MAX + 2];
    memset(text, 'a', sizeof text - 1);
    assert_int_equal(qr_print(text, 0, stdout), ERR_LIMIT);
    assert_int_equal(qr_print("", 0, stdout), ERR_ARG);
    assert_int_equal(qr_print("a", 28, stdout), ERR_LIMIT);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(codes_are_whole),
        cmocka_unit_test(what_does_not_fit),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
