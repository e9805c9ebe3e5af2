/* Something moves between two exposures: the mask, the manifest, the sentence, the joint rules. */
#include "firmware/store/ghosts.h"

#include "drivers/format/img.h"
#include "firmware/store/manifest.h"
#include "firmware/store/store.h"
#include "tests/unit/expect.h"
#include "tests/unit/small_take.h"
#include "tests/unit/tmpdir.h"

enum { LEFT = 8, RIGHT = 20, BELOW = 8 }; // where something moves: x in LEFT..RIGHT-1, y < BELOW

static bool is_moved(int x, int y)
{
    return x >= LEFT && x < RIGHT && y < BELOW;
}

/* Frames of camera 0 get light from somewhere else. */
static struct take *moved_take(int exposures, int moved_index)
{
    struct take *t = small_take(2, exposures, CAMERA_GREY16);
    assert_non_null(t);
    for (int i = 0; i < SMALL_W * SMALL_H && moved_index >= 0; i++) {
        uint8_t *p = t->frame[moved_index].data + 2 * i;
        const int v = SMALL_BLACK + (p[0] + 256 * p[1] - SMALL_BLACK) / 3;
        if (!is_moved(i % SMALL_W, i / SMALL_W))
            continue;
        p[0] = (uint8_t)(v & 255);
        p[1] = (uint8_t)(v >> 8);
    }
    return t;
}

static void store_take(struct take *t, double moved, char dir[512])
{
    const struct store_config cfg = {.path = tmpdir_path("store"), .merge = true, .moved = moved};
    struct store *s;
    char id[STORE_ID_CAP], name[64];
    expect_ok(store_open(&cfg, &s));
    expect_ok(store_commit(s, t, id));
    expect_ok(store_commit(s, t, id)); // again: nothing is found twice
    store_close(s);
    snprintf(name, sizeof name, "store/%s", id);
    snprintf(dir, 512, "%s", tmpdir_path(name));
    expect_ok(store_verify(dir));
}

static void masks_are_stored(void **state)
{
    struct take *t = moved_take(2, 0);
    struct image8 im;
    char dir[512], path[600];
    int wrong = 0;
    (void)state;
    store_take(t, 0.05, dir);
    const int other = t->frame[0].ghost.moved ? 0 : 1; // not the reference
    assert_true(t->frame[other].ghost.moved && !t->frame[1 - other].ghost.moved);
    assert_true(t->frame[other].ghost.share > 0.1);
    assert_true(t->frame[2].compared && !t->frame[2].ghost.moved && !t->frame[3].ghost.moved);
    assert_non_null(strstr(t->reason, "% of camera 1's picture moved between its exposures: take"));
    assert_null(strstr(strstr(t->reason, "again") + 1, "again"));
    snprintf(path, sizeof path, "%s/masks/train_00_%02d.png", dir, other);
    expect_ok(img_read(path, &im));
    for (int i = 0; i < SMALL_W * SMALL_H; i++)
        wrong += (im.px[3 * i] == 0) != is_moved(i % SMALL_W, i / SMALL_W);
    assert_true(wrong <= 8 * 4); // a cell or two of 4 x 4
    img_free(&im);
    snprintf(path, sizeof path, "%s/masks/train_00_%02d.png", dir, 1 - other);
    assert_false(file_exists(path));
    take_free(t);
}

static void nothing_is_said(void **state)
{
    char dir[512], path[600];
    struct take *t = moved_take(2, 0);
    (void)state;
    store_take(t, 0.9, dir); // so much may move
    assert_string_equal(t->reason, "");
    take_free(t);
    t = moved_take(2, -1); // nothing moves
    store_take(t, 0.01, dir);
    assert_true(t->frame[0].compared && t->frame[0].ghost.share == 0);
    snprintf(path, sizeof path, "%s/masks", dir);
    assert_false(file_exists(path));
    take_free(t);
    t = moved_take(1, 0); // nothing to compare with
    store_take(t, 0.01, dir);
    assert_false(t->frame[0].compared);
    take_free(t);
    t = moved_take(2, 0);
    t->status = TAKE_ABORTED;
    store_take(t, 0.01, dir);
    assert_false(t->frame[0].compared);
    take_free(t);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(masks_are_stored),
                                       cmocka_unit_test(nothing_is_said)};
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
