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

/* A JPEG with Model, Orientation, FocalLengthIn35mmFilm, and FocalLength with as many pixels per
 * millimetre of the sensor as said, of a picture of W x H; what is 0 is absent. */
struct exif {
    uint32_t orientation, film_mm, focal_mm, per_mm;
};

static void put_photo(const char *name, int w, int h, const struct exif *x)
{
    enum { TIFF = 10, FIRST = 8, SECOND = FIRST + 2 + 3 * 12 + 4, MOST = 6 };
    enum {
        TEXT = SECOND + 2 + MOST * 12 + 4,
        RATIONALS = TEXT + 8,
        LENGTH = TIFF + RATIONALS + 16
    };
    uint8_t app1[LENGTH] = {0xff, 0xe1, 0,  LENGTH - 2, 'E',   'x', 'i', 'f', 0, 0,
                            'I',  'I',  42, 0,          FIRST, 0,   0,   0,   3};
    const uint32_t second[MOST][4] = {
        {0x920a, 5, x->focal_mm, RATIONALS}, {0xa002, 4, x->per_mm, W},
        {0xa003, 4, x->per_mm, H},           {0xa20e, 5, x->per_mm, RATIONALS + 8},
        {0xa210, 3, x->per_mm, 4},           {0xa405, 3, x->film_mm, x->film_mm}};
    const uint32_t rationals[4] = {x->focal_mm, 1, x->per_mm, 1};
    uint8_t px[W * W * 3];
    const struct image8 im = {w, h, 3, px};
    void *jpeg;
    size_t n;
    FILE *f;
    memset(px, 99, sizeof px);
    uint8_t *entry = app1 + TIFF + FIRST + 2;
    put_tag(entry, 0x0110, 2, 8, TEXT); // Model
    put_tag(entry + 12, 0x0112, 3, 1, x->orientation);
    put_tag(entry + 24, 0x8769, 4, 1, SECOND); // the EXIF directory
    entry = app1 + TIFF + SECOND + 2;
    for (int k = 0; k < MOST; k++)
        if (second[k][2]) {
            put_tag(entry, (uint16_t)second[k][0], (uint16_t)second[k][1], 1, second[k][3]);
            entry += 12;
            app1[TIFF + SECOND]++;
        }
    memcpy(app1 + TIFF + TEXT, "Cam\x01ra7", 8);
    memcpy(app1 + TIFF + RATIONALS, rationals, sizeof rationals);
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
    put_photo("wide.jpg", W, H, &(struct exif){.orientation = 1, .film_mm = 28});
    put_photo("high.jpg", W, H, &(struct exif){.orientation = 6, .film_mm = 28});
    put_photo("mirror.jpg", W, H, &(struct exif){.orientation = 2, .film_mm = 28});
    const struct shot wide = read_shot("wide.jpg", W, H, PHYSCAM_EXIF);
    const struct shot high = read_shot("high.jpg", H, W, PHYSCAM_EXIF);
    const struct shot mirror = read_shot("mirror.jpg", W, H, PHYSCAM_EXIF);
    const struct shot small = read_shot("wide.jpg", W / 2, H / 2, PHYSCAM_EXIF);
    assert_string_equal(wide.camera_id, "32x24 Cam_ra7");
    assert_string_equal(high.camera_id, wide.camera_id);
    assert_string_not_equal(mirror.camera_id, wide.camera_id);
    assert_string_not_equal(small.camera_id, wide.camera_id);
    assert_true(wide.turned == 0 && high.turned == 1);
}

static double focal_of(const struct exif *x, int w, int h)
{
    put_photo("f.jpg", w, h, x);
    return read_shot("f.jpg", w, h, PHYSCAM_EXIF).focal_px;
}

static void exif_tells_the_focal_length(void **state)
{
    (void)state;
    const struct exif film = {1, 28, 0, 0}, plane = {1, 0, 5, 6}, both = {1, 30, 5, 6},
                      odd = {1, 28, 5, 60}, zero = {1, 0, 0, 6}, wild = {1, 0, 5, 60000};
    assert_true(fabs(focal_of(&film, W, H) - 28 / 43.2666 * 40) < 1e-9);   // the diagonal is 40 px
    assert_true(fabs(focal_of(&film, 32, 18) - 28 / 43.2666 * 40) < 1e-9); // a strip of 4:3
    assert_true(fabs(focal_of(&film, 30, 20) - 28 / 43.2666 * sqrt(1300)) < 1e-9);
    assert_true(fabs(focal_of(&plane, W, H) - 30) < 1e-9);
    assert_true(fabs(focal_of(&plane, W / 2, H / 2) - 15) < 1e-9); // made smaller
    assert_true(fabs(focal_of(&plane, H, W) - 30) < 1e-9);
    assert_true(fabs(focal_of(&both, W, H) - 30) < 1e-9);
    assert_true(fabs(focal_of(&odd, W, H) - 28 / 43.2666 * 40) < 1e-9); // one is wrong
    assert_true(focal_of(&zero, W, H) == 0 && focal_of(&wild, W, H) == 0);
}

static void rules_overrule_exif(void **state)
{
    (void)state;
    put_photo("a.jpg", W, H, &(struct exif){.orientation = 1, .film_mm = 28});
    put_photo("b.jpg", W, H, &(struct exif){.orientation = 1, .film_mm = 0});
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
        cmocka_unit_test_setup_teardown(exif_tells_the_focal_length, tmpdir_setup, tmpdir_teardown),
        cmocka_unit_test_setup_teardown(rules_overrule_exif, tmpdir_setup, tmpdir_teardown),
        cmocka_unit_test_setup_teardown(without_exif_the_size_tells, tmpdir_setup, tmpdir_teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
