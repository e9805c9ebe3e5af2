/* Differences of a wall that all views see: light that is added to a part of it in some photographs
 * is told from noise, gain, gloss, exposures and cameras. */
#include "core/refine/light_change.h"

#include "core/base/num.h"
#include "core/base/splitmix.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 12, EACH = 192, MOST = VIEWS * VIEWS * EACH };

static struct world {
    struct light_change_seen seen[MOST];
    struct camera cams[VIEWS];
    float log2t[VIEWS], gain[VIEWS]; // stops
    int camera[VIEWS], n_views;
    int reach;         // views on, of the farthest that shares surfaces
    int each, squares; // surfaces of a pair in this order, and how many squares they are in
    bool lit[VIEWS], blind[VIEWS];
    float lamp, gloss, noise; // stops, at the brightest place; of neighbours; of a surface
    bool other[VIEWS];
    struct light_change found;
    uint64_t dice;
} w;

/* Of a place far from others, with noise of 0.1 stops, and exposures that take turns. */
static void begin(int n_views)
{
    memset(&w, 0, sizeof w);
    w.n_views = n_views;
    w.noise = 0.1f;
    w.reach = VIEWS;
    w.each = EACH;
    w.squares = LIGHT_CHANGE_SQUARES;
    w.found.other = w.other;
    for (int i = 0; i < VIEWS; i++) {
        w.cams[i] = (struct camera){.q = {1, 0, 0, 0}, .t = {-(float)i, 0, 0}};
        w.log2t[i] = (float)(2 * (i % 3));
    }
}

static void light(int n, const int *view, float lamp)
{
    for (int i = 0; i < n; i++)
        w.lit[view[i]] = true;
    w.lamp = lamp;
}

static float draw(void)
{
    w.dice += SPLITMIX_STEP;
    return (float)((double)(splitmix_mix(w.dice) >> 11) * 0x1p-52 - 1);
}

/* Log2 radiance of a surface in a view, less that with nothing. */
static float added(int view, int square)
{
    const float x = (float)(square % 8) / 7, y = (float)(square / 8) / 7;
    return w.gain[view] + (w.lit[view] ? w.lamp * (1 - x) * (1 - y) : 0) +
           w.gloss * (float)view * sinf(9 * x);
}

static void look(void)
{
    static unsigned char room[1 << 20];
    struct arena tmp = {.base = room, .size = sizeof room, .name = "tmp"};
    const struct light_change_input in = {w.n_views, w.seen, 0, w.cams, w.log2t, w.camera};
    struct light_change_input all = in;
    for (int i = 0; i < w.n_views; i++)
        for (int j = 0; j < w.n_views; j++)
            for (int k = 0;
                 k < w.each && i != j && abs(i - j) <= w.reach && !w.blind[i] && !w.blind[j]; k++) {
                const int square = k % w.squares;
                const float noise = 1.7f * w.noise * (draw() + draw()) / 1.4f;
                w.seen[all.n++] =
                    (struct light_change_seen){{(uint16_t)i, (uint16_t)j},
                                               (uint16_t)square,
                                               added(i, square) - added(j, square) + noise};
            }
    assert_true(light_change_plan(all.n_views, all.n) <= sizeof room);
    assert_int_equal(light_change_find(&all, &tmp, &w.found), OK);
    assert_int_equal((int)arena_mark(&tmp), 0);
}

static void assert_others(int n, const int *view)
{
    bool want[VIEWS] = {false};
    for (int i = 0; i < n; i++)
        want[view[i]] = true;
    assert_int_equal(w.found.others, n);
    assert_memory_equal(w.other, want, sizeof want);
}

static void two_groups_are_told(void **state)
{
    static const int third[] = {1, 2, 6, 9}, pair[] = {0, 2}, most[] = {0, 1, 2, 4, 5, 7},
                     rest[] = {3, 6}, half[] = {0, 3, 4}, last[] = {1, 2, 5};
    (void)state;
    begin(12);
    light(4, third, 1);
    look();
    assert_others(4, third);
    assert_true(w.found.between > 0.15 && w.found.between < 0.35);
    assert_true(w.found.within < 0.05 && w.found.larger > 0.99);
    begin(4);
    memset(w.log2t, 0, sizeof w.log2t);
    light(2, pair, 1);
    look();
    assert_others(2, (const int[]){1, 3}); // that of the last
    begin(8);
    light(6, most, -1); // the smaller group has more light
    look();
    assert_others(2, rest);
    begin(6);
    light(3, half, 1.5f);
    look();
    assert_others(3, last);
}

/* The bound is 0.12 stops; a lamp has a spread of a quarter of its brightest place. */
static void weak_light_is_not(void **state)
{
    static const int some[] = {1, 2, 6, 9};
    (void)state;
    for (int strong = 0; strong < 2; strong++) {
        begin(12);
        light(4, some, strong ? 0.75f : 0.35f);
        look();
        assert_int_equal(w.found.others, strong ? 4 : 0);
    }
}

static void noise_and_gain_are_not(void **state)
{
    (void)state;
    for (int i = 0; i < 8; i++) {
        begin(4 + i % 3 * 4);
        w.dice = (uint64_t)i << 32;
        w.noise = i < 4 ? 0.4f : 0.05f;
        for (int k = 0; k < VIEWS; k++)
            w.gain[k] = i % 2 ? 2 * draw() : 0;
        look();
        assert_others(0, NULL);
    }
}

/* Where few views share few surfaces, the best of all groups seems to be one. */
static void chance_is_not(void **state)
{
    static const int pair[] = {1, 4};
    int chance = 0, lamps = 0;
    (void)state;
    for (int i = 0; i < 200; i++) {
        begin(6);
        w.dice = (uint64_t)i << 32;
        if (i % 2) {
            w.noise = 0.3f;
            light(2, pair, 1.5f);
        } else {
            w.noise = 0.5f;
            w.reach = 2;
            w.each = 48;
            w.squares = 16;
        }
        look();
        chance += i % 2 == 0 && w.found.others > 0;
        lamps += i % 2 && w.found.others == 2 && w.other[1] && w.other[4];
    }
    assert_int_equal(chance, 0);
    assert_int_equal(lamps, 100);
}

/* Gloss is another one from far away, of which two groups of places have much between them. */
static void gloss_is_not(void **state)
{
    (void)state;
    for (int apart = 0; apart < 2; apart++) {
        begin(8);
        w.gloss = 0.1f;
        look();
        assert_true(w.found.between > 0.12 || w.found.between == 0);
        assert_others(0, NULL);
        begin(8);
        for (int i = 4; i < 8; i++) {
            w.cams[i].t[0] -= 40;
            w.lit[i] = true; // what shines there only
        }
        w.lamp = 1;
        look();
        assert_others(0, NULL);
    }
}

/* What all photographs of one exposure have, or of one camera, is the curve's or the camera's. */
static void curve_and_cameras_are_not(void **state)
{
    static const int third[] = {0, 3, 6, 9};
    (void)state;
    begin(12);
    light(4, third, 1);
    look();
    assert_others(0, NULL);
    w.log2t[0] = 3; // of one at least
    look();
    assert_others(4, third);
    for (int i = 0; i < VIEWS; i++)
        w.camera[i] = w.lit[i];
    look();
    assert_others(0, NULL);
}

static void too_few_say_nothing(void **state)
{
    static const int one[] = {2}, some[] = {1, 2, 6}, seen[] = {1, 2};
    (void)state;
    for (int n = 1; n <= 3; n++) {
        begin(n);
        light(n == 3, one, 1);
        look();
        assert_others(0, NULL);
    }
    begin(12);
    light(1, one, 1);
    look();
    assert_others(0, NULL);
    begin(12);
    light(3, some, 1);
    w.blind[6] = true; // shares nothing: nobody knows
    look();
    assert_others(2, seen);
    memset(w.blind, 1, sizeof w.blind);
    look();
    assert_others(0, NULL);
    struct arena none = {.name = "tmp"};
    const struct light_change_input in = {w.n_views, w.seen, 0, w.cams, w.log2t, w.camera};
    assert_int_equal(light_change_find(&in, &none, &w.found), ERR_NOMEM);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(two_groups_are_told),    cmocka_unit_test(weak_light_is_not),
        cmocka_unit_test(noise_and_gain_are_not), cmocka_unit_test(gloss_is_not),
        cmocka_unit_test(chance_is_not),          cmocka_unit_test(curve_and_cameras_are_not),
        cmocka_unit_test(too_few_say_nothing)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
