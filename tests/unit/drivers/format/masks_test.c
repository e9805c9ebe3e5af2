/* Masks of photographs: where they are looked for, what they say, and what is refused. */
#include "drivers/format/masks.h"

#include "drivers/format/imageset.h"
#include "drivers/format/img.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

enum { W = 8, H = 6 };

static void put(const char *name, int w, const uint8_t px[3 * W * H])
{
    struct image8 im = {w, H, 3, (uint8_t *)px};
    assert_int_equal(img_write_png(tmpdir_path(name), &im), OK);
}

/* Three photographs in images/. */
static void put_photographs(void)
{
    static const uint8_t grey[3 * W * H];
    tmpdir_mkdir("images");
    tmpdir_mkdir("masks");
    put("images/a.png", W, grey);
    put("images/b.tif.png", W, grey);
    put("images/c.png", W, grey);
    tmpdir_text("exposure.json", "{\"a.png\": 1, \"b.tif.png\": 2, \"c.png\": 3}");
}

static err_t list(struct imageset *set)
{
    const struct imageset_request rq = {.images = tmpdir_root};
    return imageset_list(&rq, set);
}

static void masks_are_found_by_name(void **state)
{
    (void)state;
    uint8_t px[3 * W * H] = {0};
    struct imageset set;
    struct image8 mask;
    put_photographs();
    px[3 * 5 + 1] = 1; // anything but black counts
    put("masks/a.png", W, px);
    put("masks/b.tif.png.png", W, px);
    put("masks/d.png", W, px);
    tmpdir_text("masks/notes.txt", "no mask");
    assert_int_equal(list(&set), OK);
    for (int i = 0; i < 3; i++)
        assert_int_equal(set.capture.shots[i].masked, i < 2);
    assert_int_equal(set.n_notes, 1);
    assert_string_equal(set.notes[0],
                        "1 file is not read (d.png): in masks, but no photograph has their name");
    for (int i = 0; i < 2; i++) {
        assert_int_equal(imageset_decode_mask(&set, i, false, &mask), OK);
        assert_true(mask.w == W && mask.h == H && mask.channels == 3);
        for (int k = 0; k < 3 * W * H; k++)
            assert_int_equal(mask.px[k], k / 3 == 5 ? 255 : 0);
        img_free(&mask);
    }
    imageset_free(&set);
}

/* A mask is undistorted with its photograph. */
static void masks_go_through_the_lens(void **state)
{
    (void)state;
    uint8_t px[3 * W * H];
    struct imageset set;
    struct image8 mask;
    put_photographs();
    for (int k = 0; k < W * H; k++)
        memset(px + 3 * k, k % W < W / 2 ? 0 : 200, 3);
    put("masks/c.png", W, px);
    tmpdir_mkdir("sparse");
    tmpdir_mkdir("sparse/0");
    tmpdir_text("sparse/0/cameras.txt", "1 SIMPLE_RADIAL 8 6 6 4 3 0.2\n");
    tmpdir_text("sparse/0/images.txt", "1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 1 0 0 1 b.tif.png\n\n"
                                       "3 1 0 0 0 2 0 0 1 c.png\n\n");
    assert_int_equal(list(&set), OK);
    assert_true(set.capture.shots[2].image.w != W);
    assert_int_equal(imageset_decode_mask(&set, 2, false, &mask), OK);
    assert_int_equal(mask.w, set.capture.shots[2].image.w);
    assert_true(mask.px[0] < 10 && mask.px[3 * (mask.w - 1)] > 245);
    img_free(&mask);
    imageset_free(&set);
}

static void other_shapes_are_refused(void **state)
{
    (void)state;
    static const uint8_t px[3 * W * H];
    struct imageset set;
    put_photographs();
    put("masks/c.png", W - 1, px);
    assert_int_equal(list(&set), ERR_FORMAT);
    assert_non_null(
        strstr(err_text(), "masks/c.png: 7 x 6 px, but the photograph c.png has 8 x 6"));
    tmpdir_text("masks/c.png", "nothing");
    assert_int_equal(list(&set), ERR_FORMAT);
}

#define IN_FOLDER(f) cmocka_unit_test_setup_teardown(f, tmpdir_setup, tmpdir_teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {
        IN_FOLDER(masks_are_found_by_name),
        IN_FOLDER(masks_go_through_the_lens),
        IN_FOLDER(other_shapes_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
