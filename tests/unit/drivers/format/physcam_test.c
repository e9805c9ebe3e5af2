/* Which physical camera EXIF data name, and what they say about its lens. */
#include "drivers/format/physcam.h"

#include "drivers/format/file.h"
#include "drivers/format/img.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <stdlib.h>

enum { W = 32, H = 24 };

static void put_tag(uint8_t *at, uint16_t tag, uint16_t type, uint32_t n, uint32_t value)
{
    const uint32_t word[3] = {tag | (uint32_t)type << 16, n, value};
    for (int k = 0; k < 12; k++)
        at[k] = (uint8_t)(word[k / 4] >> 8 * (k % 4));
}

/* A JPEG with Model, Orientation and FocalLengthIn35mmFilm. */
static void put_photo(const char *name, int w, int h, uint32_t orientation, uint32_t film_mm)
{
    enum { TIFF = 10, LENGTH = 10 + 8 + 2 + 3 * 12 + 4 + 2 + 12 + 4 + 8 };
    uint8_t app1[LENGTH] = {0xff, 0xe1, 0,  LENGTH - 2, 'E', 'x', 'i', 'f', 0, 0,
                            'I',  'I',  42, 0,          8,   0,   0,   0,   3};
    uint8_t px[W * W * 3];
    const struct image8 im = {w, h, 3, px};
    void *jpeg;
    size_t n;
    FILE *f;
    memset(px, 99, sizeof px);
    uint8_t *entry = app1 + TIFF + 10;
    put_tag(entry, 0x0110, 2, 8, 8 + 2 + 36 + 4 + 2 + 12 + 4); // Model, behind both directories
    put_tag(entry + 12, 0x0112, 3, 1, orientation);
    put_tag(entry + 24, 0x8769, 4, 1, 8 + 2 + 36 + 4); // the EXIF directory
    app1[TIFF + 50] = 1;
    put_tag(app1 + TIFF + 52, 0xa405, 3, 1, film_mm);
    memcpy(app1 + TIFF + 68, "Cam\x01ra7", 8);
    assert_int_equal(img_encode_jpeg(&im, 95, name, &jpeg, &n), OK);
    assert_int_equal(file_create(tmpdir_path(name), &f), OK);
    fwrite(jpeg, 1, 2, f);
    fwrite(app1, 1, sizeof app1, f);
    fwrite((uint8_t *)jpeg + 2, 1, n - 2, f);
    assert_int_equal(file_finish(f, tmpdir_path(name)), OK);
    free(jpeg);
}

static struct shot read_shot(const char *name, int w, int h, enum physcam_rule rule)
{
    struct shot s = {.taken_w = w, .taken_h = h};
    snprintf(s.name, sizeof s.name, "%s", name);
    expect_ok(physcam_read(tmpdir_path(name), rule, &s));
    return s;
}

static void exif_names_the_camera(void **state)
{
    (void)state;
    put_photo("wide.jpg", W, H, 1, 28);
    put_photo("high.jpg", W, H, 6, 28);
    put_photo("mirror.jpg", W, H, 2, 28);
    const struct shot wide = read_shot("wide.jpg", W, H, PHYSCAM_EXIF);
    const struct shot high = read_shot("high.jpg", H, W, PHYSCAM_EXIF);
    const struct shot mirror = read_shot("mirror.jpg", W, H, PHYSCAM_EXIF);
    const struct shot small = read_shot("wide.jpg", W / 2, H / 2, PHYSCAM_EXIF);
    assert_string_equal(wide.camera_id, "32x24 Cam_ra7");
    assert_string_equal(high.camera_id, wide.camera_id);
    assert_string_not_equal(mirror.camera_id, wide.camera_id);
    assert_string_not_equal(small.camera_id, wide.camera_id);
    assert_true(wide.turned == 0 && high.turned == 1);
    assert_true(fabs(wide.focal_px - 28 / 43.2666 * 40) < 1e-9); // the diagonal is 40 px
}

static void rules_overrule_exif(void **state)
{
    (void)state;
    put_photo("a.jpg", W, H, 1, 28);
    put_photo("b.jpg", W, H, 1, 0);
    const struct shot a = read_shot("a.jpg", W, H, PHYSCAM_SIZE);
    const struct shot high = read_shot("a.jpg", H, W, PHYSCAM_SIZE);
    const struct shot each = read_shot("a.jpg", W, H, PHYSCAM_EACH);
    const struct shot b = read_shot("b.jpg", W, H, PHYSCAM_EACH);
    assert_string_equal(a.camera_id, read_shot("b.jpg", W, H, PHYSCAM_SIZE).camera_id);
    assert_string_not_equal(a.camera_id, high.camera_id);
    assert_string_not_equal(each.camera_id, b.camera_id);
    assert_true(b.focal_px == 0);
}

static void without_exif_the_size_tells(void **state)
{
    (void)state;
    static uint8_t px[W * H * 3];
    const struct image8 im = {W, H, 3, px};
    expect_ok(img_write_png(tmpdir_path("a.png"), &im));
    const struct shot a = read_shot("a.png", W, H, PHYSCAM_EXIF);
    assert_string_equal(a.camera_id, "32x24 ");
    assert_true(a.focal_px == 0 && a.turned == 0);
    struct shot none = {.taken_w = W, .taken_h = H};
    assert_int_equal(physcam_read(tmpdir_path("none.png"), PHYSCAM_EXIF, &none), ERR_IO);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(exif_names_the_camera, tmpdir_setup, tmpdir_teardown),
        cmocka_unit_test_setup_teardown(rules_overrule_exif, tmpdir_setup, tmpdir_teardown),
        cmocka_unit_test_setup_teardown(without_exif_the_size_tells, tmpdir_setup, tmpdir_teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
