#include "drivers/format/imageset.h"

#include "drivers/format/img.h"
#include "drivers/format/imgsize.h"

#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <unistd.h>

#include <cmocka.h>

static void put_picture(const char *name, int w, int h)
{
    static uint8_t px[64 * 64 * 3];
    for (int i = 0; i < w * h * 3; i++)
        px[i] = (uint8_t)(i * 7 + name[strlen(name) - 5]);
    struct image8 im = {w, h, 3, px};
    assert_int_equal(img_write_png(tmpdir_path(name), &im), OK);
}

/* The released layout: train views 000 and 001 .. at exposures 0, 2, 4, one test view. */
static void make_released(int n_views)
{
    char json[4096] = "{", name[64], line[256], images[4096] = "";
    tmpdir_mkdir("images");
    tmpdir_mkdir("sparse");
    tmpdir_mkdir("sparse/0");
    for (int v = 0; v < n_views; v++) {
        for (int k = 0; k < 5; k += 2) {
            snprintf(name, sizeof name, "images/train_ldr_%03d_%d.png", v, k);
            put_picture(name, 8, 6);
            snprintf(line, sizeof line, "\"%s\": %g,\n", name + 7,
                     k == 0   ? 0.125
                     : k == 2 ? 2.0
                              : 32.0);
            strcat(json, line);
        }
        snprintf(line, sizeof line, "%d 1 0 0 0 %d 0 0 1 train_ldr_%03d_2.png\n\n", v + 1, v, v);
        strcat(images, line);
    }
    put_picture("images/test_ldr_000_0.png", 8, 6);
    put_picture("images/test_ldr_000_1.png", 8, 6);
    strcat(images, "99 1 0 0 0 50 0 0 1 test_ldr_000_1.png\n\n");
    strcat(json, "\"test_ldr_000_0.png\": 1, \"test_ldr_000_1.png\": 4}");
    tmpdir_text("exposure.json", json);
    tmpdir_text("images/notes.txt", "not a picture");
    tmpdir_text("images/.hidden.png", "nor is this");
    tmpdir_text("sparse/0/cameras.txt", "1 PINHOLE 8 6 5 5 4 3\n");
    tmpdir_text("sparse/0/images.txt", images);
}

static void check_names(const struct imageset *set, int n, const char *const *names)
{
    assert_int_equal(set->capture.n, n);
    for (int i = 0; i < n; i++)
        assert_string_equal(set->capture.shots[i].name, names[i]);
}

static void one_exposure_per_view_interleaved(void **state)
{
    (void)state;
    static const char *const want[] = {"train_ldr_000_2.png", "train_ldr_001_0.png",
                                       "train_ldr_002_4.png", "train_ldr_003_2.png"};
    static const double times[] = {2, 0.125, 32, 2};
    struct imageset set;
    make_released(4);
    for (int k = 0; k < 2; k++) { // the folder above and images/ itself are the same set
        struct imageset_request rq = {.images = k ? tmpdir_path("images") : tmpdir_root};
        assert_int_equal(imageset_list(&rq, &set), OK);
        check_names(&set, 4, want);
        for (int i = 0; i < 4; i++) {
            const struct shot *s = &set.capture.shots[i];
            assert_true(s->exposure == times[i] && s->has_camera && s->cam.t[0] == (float)i);
            assert_true(s->image.w == 8 && s->image.h == 6 && s->image.px == NULL);
        }
        imageset_free(&set);
    }
    struct imageset_request two = {.images = tmpdir_root, .n_views = 2};
    assert_int_equal(imageset_list(&two, &set), OK);
    check_names(&set, 2, (const char *const[]){"train_ldr_000_2.png", "train_ldr_003_0.png"});
    imageset_free(&set);
    struct imageset_request five = {.images = tmpdir_root, .n_views = 5};
    assert_int_equal(imageset_list(&five, &set), ERR_ARG);
    assert_null(set.capture.shots);
}

static void test_pictures_come_with_all_exposures_when_asked(void **state)
{
    (void)state;
    struct imageset set;
    make_released(2);
    struct imageset_request rq = {
        .images = tmpdir_root, .which = IMAGESET_TEST, .every_exposure = true};
    assert_int_equal(imageset_list(&rq, &set), OK);
    check_names(&set, 2, (const char *const[]){"test_ldr_000_0.png", "test_ldr_000_1.png"});
    assert_true(set.capture.shots[0].cam.t[0] == 50); // by the pose of exposure 1
    imageset_free(&set);
    rq.which = IMAGESET_ALL;
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_int_equal(set.capture.n, 2 + 2 * 3);
    imageset_free(&set);
}

/* Brackets come whole, a protocol comes first. */
static void brackets_come_whole_when_asked(void **state)
{
    (void)state;
    struct imageset set;
    make_released(2);
    struct imageset_request rq = {.images = tmpdir_root, .brackets = true};
    assert_int_equal(imageset_list(&rq, &set), OK);
    check_names(&set, 6,
                (const char *const[]){"train_ldr_000_0.png", "train_ldr_000_2.png",
                                      "train_ldr_000_4.png", "train_ldr_001_0.png",
                                      "train_ldr_001_2.png", "train_ldr_001_4.png"});
    for (int i = 0; i < 6; i++) {
        assert_int_equal(set.capture.shots[i].again, i % 3 != 0);
        assert_true(set.capture.shots[i].cam.t[0] == (float)(i / 3));
    }
    imageset_free(&set);
    rq.n_views = 1;
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_int_equal(set.capture.n, 3);
    imageset_free(&set);
    tmpdir_text("protocol.json",
                "{\"inputs\": {\"2\": [\"train_ldr_000_4.png\", \"train_ldr_001_0.png\"]}}");
    rq.n_views = 0;
    assert_int_equal(imageset_list(&rq, &set), OK);
    check_names(&set, 2, (const char *const[]){"train_ldr_000_4.png", "train_ldr_001_0.png"});
    assert_false(set.capture.shots[1].again);
    imageset_free(&set);
}

/* The set has the times 0.125, 1, 2, 4, 32; 1 and 4 are those of its test pictures. */
static void inputs_only_at_some_exposures(void **state)
{
    (void)state;
    struct imageset set;
    make_released(3);
    tmpdir_text("protocol.json", "{\"inputs\": {\"3\": [\"train_ldr_000_4.png\"]}}");
    struct imageset_request rq = {.images = tmpdir_root, .exposure_set = 1 << 2};
    assert_int_equal(imageset_list(&rq, &set), OK);
    check_names(
        &set, 3,
        (const char *const[]){"train_ldr_000_2.png", "train_ldr_001_2.png", "train_ldr_002_2.png"});
    imageset_free(&set);
    rq.exposure_set = 1 << 0 | 1 << 4;
    assert_int_equal(imageset_list(&rq, &set), OK);
    check_names(
        &set, 3,
        (const char *const[]){"train_ldr_000_4.png", "train_ldr_001_0.png", "train_ldr_002_4.png"});
    imageset_free(&set);
    rq.exposure_set = 1 << 1;
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT); // no train picture there
    rq.exposure_set = 1 << 5 | 1;
    assert_int_equal(imageset_list(&rq, &set), ERR_ARG);
    assert_non_null(strstr(err_text(), "exposure 6 requested, its pictures have 5 different ones"));
}

static void a_protocol_names_the_inputs(void **state)
{
    (void)state;
    struct imageset set;
    make_released(3);
    tmpdir_text("protocol.json",
                "{\"inputs\": {\"3\": [\"train_ldr_002_0.png\", \"train_ldr_000_4.png\", "
                "\"train_ldr_001_4.png\"], \"2\": [\"train_ldr_009_0.png\"], \"1\": "
                "[\"train_ldr_000_0.png\", \"train_ldr_000_0.png\"]}}");
    struct imageset_request rq = {.images = tmpdir_root};
    assert_int_equal(imageset_list(&rq, &set), OK);
    check_names(
        &set, 3,
        (const char *const[]){"train_ldr_000_4.png", "train_ldr_001_4.png", "train_ldr_002_0.png"});
    imageset_free(&set);
    rq.n_views = 2;
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "train_ldr_009_0.png"));
    rq.n_views = 1;
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "twice"));
}

static void a_plain_folder_is_all_input(void **state)
{
    (void)state;
    struct imageset set;
    put_picture("b.PNG", 8, 6);
    put_picture("a_1_2.Png", 8, 6);
    put_picture("a_1_1.png", 8, 6);
    put_picture("test_1.png", 8, 6);
    tmpdir_mkdir("folder.png");
    tmpdir_text(
        "times",
        "{\"b.PNG\": 1, \"a_1_2.Png\": 2, \"a_1_1.png\": 3, \"test_1.png\": 4, \"gone.png\": 5}");
    struct imageset_request rq = {.images = tmpdir_root, .exposures = tmpdir_path("times")};
    assert_int_equal(imageset_list(&rq, &set), OK);
    check_names(&set, 4, (const char *const[]){"a_1_1.png", "a_1_2.Png", "b.PNG", "test_1.png"});
    assert_false(set.capture.shots[0].has_camera);
    imageset_free(&set);
    rq.which = IMAGESET_TEST;
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "none of its 4"));
}

static void pixels_come_when_asked(void **state)
{
    (void)state;
    struct imageset set;
    struct image8 image;
    make_released(2);
    struct imageset_request rq = {.images = tmpdir_root};
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_int_equal(imageset_decode(&set, 1, &image), OK);
    assert_true(image.w == 8 && image.px[1] == 7 + '0'); // see put_picture
    assert_null(set.capture.shots[1].image.px);
    img_free(&image);
    assert_int_equal(imageset_load(&set), OK);
    assert_int_equal(set.capture.shots[0].image.px[0], '2');
    assert_int_equal(set.capture.shots[1].image.px[8 * 6 * 3 - 1],
                     ((8 * 6 * 3 - 1) * 7 + '0') % 256);
    put_picture("images/train_ldr_001_0.png", 6, 8);
    assert_int_equal(imageset_decode(&set, 1, &image), ERR_FORMAT);
    assert_null(image.px);
    imageset_free(&set);
}

/* Decoded through its lens, with the size and the camera that were promised before. */
static void photographs_are_undistorted(void **state)
{
    (void)state;
    struct imageset_request rq = {.images = tmpdir_root};
    struct imageset set;
    struct image8 straight, bent;
    put_picture("a.png", 40, 30);
    put_picture("b.png", 40, 30);
    tmpdir_text("exposure.json", "{\"a.png\": 1, \"b.png\": 1}");
    rq.rig = tmpdir_text(
        "rig.json",
        "{\"cameras\":[{\"name\":\"a.png\",\"w\":40,\"h\":30,\"fx\":30,\"fy\":30,\"cx\":20,"
        "\"cy\":15,\"q\":[1,0,0,0],\"t\":[0,0,0]},"
        "{\"name\":\"b.png\",\"w\":80,\"h\":60,\"model\":\"RADIAL\",\"params\":[60,40,30,-0.2,0],"
        "\"q\":[1,0,0,0],\"t\":[1,0,0]}]}");
    assert_int_equal(imageset_list(&rq, &set), OK);
    const struct shot *a = &set.capture.shots[0], *b = &set.capture.shots[1];
    assert_true(a->image.w == 40 && a->cam.fx == 30 && !lens_distorts(&a->lens));
    assert_true(b->taken_w == 40 && b->taken_h == 30 && b->lens.fx == 30 && b->cam.t[0] == 1);
    assert_true(b->image.w == b->cam.w && b->image.h == b->cam.h);
    assert_true(imageset_bytes(&set.capture, 1) >= 2 * 3 * 40 * 30);
    assert_int_equal(imageset_decode(&set, 0, &straight), OK);
    assert_int_equal(imageset_decode(&set, 1, &bent), OK);
    assert_true(straight.w == 40 && bent.w == b->cam.w && bent.h == b->cam.h);
    img_free(&straight);
    img_free(&bent);
    imageset_free(&set);
    put_picture("b.png", 40, 20);
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "another aspect"));
}

static err_t list(const struct imageset_request *rq)
{
    struct imageset set;
    err_t e = imageset_list(rq, &set);
    if (e)
        assert_null(set.capture.shots);
    imageset_free(&set);
    return e;
}

/* Photographs whose data a program removed are taken for photographs of one exposure, unless names
 * tell of brackets. */
static void exposures_that_nothing_tells(void **state)
{
    static const char *const brackets[][2] = {
        {"v_0_0.png", "v_0_1.png"}, {"train_0.png", "train_1.png"}, {"test_0.png", "test_1.png"}};
    (void)state;
    struct imageset set;
    struct imageset_request rq = {.images = tmpdir_root, .which = IMAGESET_ALL};
    put_picture("a.png", 8, 6);
    put_picture("b.png", 8, 6);
    if (imageset_list(&rq, &set) != OK)
        fail_msg("%s", err_text());
    assert_int_equal(set.capture.n, 2);
    assert_true(set.capture.shots[0].exposure == 1 && set.capture.shots[1].exposure == 1);
    assert_int_equal(set.n_notes, 1);
    assert_non_null(strstr(set.notes[0], "taken for photographs of one exposure"));
    assert_non_null(strstr(set.notes[0], "or {\"*\": 1} for all")); // whole
    imageset_free(&set);
    rq.may_lack_times = true;
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_true(set.capture.shots[0].exposure == 0 && set.n_notes == 0);
    imageset_free(&set);
    rq.may_lack_times = false;
    assert_int_equal(unlink(tmpdir_path("a.png")) | unlink(tmpdir_path("b.png")), 0);
    for (int i = 0; i < 3; i++) {
        put_picture(brackets[i][0], 8, 6);
        put_picture(brackets[i][1], 8, 6);
        assert_int_equal(list(&rq), ERR_FORMAT);
        assert_non_null(strstr(err_text(), "EXIF has no exposure for "));
        assert_non_null(strstr(err_text(), "or {\"*\": 1} for all"));
        assert_int_equal(unlink(tmpdir_path(brackets[i][0])), 0);
        assert_int_equal(unlink(tmpdir_path(brackets[i][1])), 0);
    }
}

static void contradictions_are_named(void **state)
{
    (void)state;
    struct imageset_request rq = {.images = tmpdir_path("no such folder")};
    assert_int_equal(list(&rq), ERR_IO);
    rq.images = tmpdir_root;
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "no pictures"));
    put_picture("a.png", 8, 6);
    put_picture("b.png", 6, 8);
    put_picture("c.png", 8, 6);
    assert_int_equal(list(&rq), OK); // nothing tells an exposure
    tmpdir_text("exposure.json", "{\"a.png\": 1, \"c.png\": 1}");
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "no exposure for b.png, of 3 pictures"));
    tmpdir_text("exposure.json", "{\"a.png\": 1, \"b.png\": 1, \"c.png\": 1}");
    assert_int_equal(list(&rq), OK); // each has its own size
    tmpdir_text("c.png", "not a picture");
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "c.png"));
    char name[NAME_CAP + 8];
    memset(name, 'x', sizeof name);
    strcpy(name + NAME_CAP, ".png");
    tmpdir_text(name, "");
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "132 bytes"));
}

static void copy(const char *from, const char *name)
{
    static char bytes[1 << 16];
    FILE *f = fopen(from, "rb"), *to = fopen(tmpdir_path(name), "wb");
    assert_true(f && to);
    size_t n = fread(bytes, 1, sizeof bytes, f);
    assert_true(n > 0 && n < sizeof bytes && fwrite(bytes, 1, n, to) == n);
    fclose(f);
    assert_int_equal(fclose(to), 0);
}

/* rgb.jpg tells f-number and ISO, progressive.jpg neither. */
static void exposures_of_exif_must_be_made_of_the_same(void **state)
{
    (void)state;
    struct imageset set;
    struct imageset_request rq = {.images = tmpdir_root};
    copy("tests/data/img/rgb.jpg", "a.jpg");
    copy("tests/data/img/rgb.jpg", "c.jpg");
    assert_int_equal(list(&rq), OK);
    copy("tests/data/img/progressive.jpg", "b.jpg");
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "EXIF of b.jpg lacks the f-number, that of a.jpg and c.jpg "
                                       "has it"));
    assert_non_null(strstr(err_text(), "write exposure.json"));
    rq.may_lack_times = true; // none is used then
    put_picture("d.png", 8, 6);
    err_t e = imageset_list(&rq, &set);
    assert_true(e == OK || strstr(err_text(), " px but ")); // sizes may differ here
    imageset_free(&set);
    rq.may_lack_times = false;
    assert_int_equal(list(&rq), ERR_FORMAT); // what lacks the rest is not mixed in
    assert_non_null(strstr(err_text(), "lacks the f-number"));
    tmpdir_text("exposure.json", "{\"a.jpg\":1,\"b.jpg\":1,\"c.jpg\":1,\"d.png\":1}");
    e = imageset_list(&rq, &set);
    assert_true(e == OK || strstr(err_text(), " px but "));
    imageset_free(&set);
}

/* "*" is the exposure of all that are not named. */
static void one_exposure_for_all(void **state)
{
    (void)state;
    struct imageset set;
    struct imageset_request rq = {.images = tmpdir_root};
    put_picture("a.png", 8, 6);
    put_picture("b.png", 8, 6);
    tmpdir_text("exposure.json", "{\"*\": 3, \"b.png\": 2}");
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_true(set.capture.shots[0].exposure == 3 && set.capture.shots[1].exposure == 2);
    imageset_free(&set);
}

/* A sentence for each reason, with the first names in order. */
static void what_is_not_read_is_told(void **state)
{
    (void)state;
    struct imageset set;
    struct imageset_request rq = {.images = tmpdir_root};
    tmpdir_text("IMG_2.WebP", "");
    tmpdir_text("IMG_1.raf", "");
    tmpdir_text(".hidden.heic", "");
    tmpdir_text("notes.txt", "");
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(),
                           "no pictures (*.png, *.jpg, *.jpeg, *.tif, *.tiff, *.heic, *.dng, "
                           "*.cr2, *.nef, *.arw, *.exr) in it; "
                           "2 files are not read (IMG_1.raf and IMG_2.WebP): pictures must be PNG, "
                           "JPEG or TIFF, or all HEIC, all raw"));
    put_picture("a.png", 8, 6);
    tmpdir_text("exposure.json", "{\"a.png\": 1, \"IMG_2.WebP\": 1, \"b.scan\": 1, \"gone.x\": 1}");
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_int_equal(set.n_notes, 1);
    imageset_free(&set);
    tmpdir_text("IMG_3.bmp", "");
    tmpdir_text("IMG_4.bmp", "");
    tmpdir_text("b.scan", "");
    assert_int_equal(symlink("nowhere", tmpdir_path("z.jpg")), 0);
    rq.exposure_set = 1; // reads the times twice
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_int_equal(set.n_notes, 3);
    assert_non_null(strstr(set.notes[0],
                           "4 files are not read (IMG_1.raf, IMG_2.WebP, IMG_3.bmp and 1 other)"));
    assert_non_null(strstr(set.notes[1], "1 file is not read (z.jpg): no regular files"));
    assert_non_null(strstr(set.notes[2], "1 file is not read (b.scan): pictures must be PNG"));
    imageset_free(&set);
}

/* Pictures that the layout hides. */
static void pictures_that_do_not_count_are_told(void **state)
{
    (void)state;
    struct imageset set;
    struct imageset_request rq = {.images = tmpdir_root};
    make_released(2);
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_int_equal(set.n_notes, 0);
    imageset_free(&set);
    put_picture("beside.png", 8, 6);
    put_picture("images/bridge.png", 8, 6);
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_int_equal(set.n_notes, 2);
    assert_non_null(strstr(set.notes[0], "(beside.png): they lie beside the folder images"));
    assert_non_null(strstr(set.notes[1], "(bridge.png): beside pictures called train"));
    imageset_free(&set);
}

static void rigs_come_from_three_places(void **state)
{
    (void)state;
    static const char *const rig =
        "{\"cameras\":[{\"name\":\"a.png\",\"w\":16,\"h\":12,\"fx\":10,\"fy\":10,\"cx\":8,"
        "\"cy\":6,\"q\":[1,0,0,0],\"t\":[7,0,0]}]}";
    struct imageset set;
    put_picture("a.png", 8, 6);
    tmpdir_text("exposure.json", "{\"a.png\": 1, \"b.png\": 1}");
    struct imageset_request rq = {.images = tmpdir_root, .rig = tmpdir_text("rig.json", rig)};
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_true(set.capture.shots[0].has_camera &&
                set.capture.shots[0].cam.fx == 5); // scaled to the picture
    assert_false(set.capture.shots[0].metres);
    imageset_free(&set);
    rq.rig = "tests/data/sets/colmap_bin";
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "no camera for image a.png among 3"));
    assert_null(strstr(err_text(), "--rig none"));
    rq.rig = tmpdir_text("rig.conf", "");
    assert_int_equal(list(&rq), ERR_UNSUPPORTED);
    rq.rig = tmpdir_path("gone.json");
    assert_int_equal(list(&rq), ERR_IO);
    rq.rig = NULL;
    tmpdir_text("transforms.json", "{\"fl_x\": 5, \"w\": 8, \"h\": 6, \"frames\": []}");
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "--rig none"));
    rq.rig = tmpdir_path("rig.json");
    put_picture("b.png", 8, 6);
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "b.png"));
}

/* A JPEG that EXIF turns: stored w x h px, of which the left half is dark. */
static void put_turned(const char *name, int w, int h, uint8_t orientation)
{
    static const uint8_t zero[64 * 64 * 3];
    const uint8_t app1[] = {0xff, 0xe1, 0, 34, 'E', 'x',         'i', 'f', 0, 0,    'M', 'M',
                            0,    42,   0, 0,  0,   8,           0,   1,   1, 0x12, 0,   3,
                            0,    0,    0, 1,  0,   orientation, 0,   0,   0, 0,    0,   0};
    uint8_t px[64 * 64 * 3];
    const struct image8 im = {w, h, 3, px};
    void *jpeg;
    size_t n;
    FILE *f;
    memset(px, 250, sizeof px);
    for (int y = 0; y < h; y++)
        memcpy(px + 3 * y * w, zero, (size_t)(3 * (w / 2)));
    assert_int_equal(img_encode_jpeg(&im, 95, name, &jpeg, &n), OK);
    assert_int_equal(file_create(tmpdir_path(name), &f), OK);
    fwrite(jpeg, 1, 2, f);
    fwrite(app1, 1, sizeof app1, f);
    fwrite((uint8_t *)jpeg + 2, 1, n - 2, f);
    assert_int_equal(file_finish(f, tmpdir_path(name)), OK);
    free(jpeg);
}

/* COLMAP sees pictures as they are stored. */
static void cameras_of_colmap_turn_with_the_photograph(void **state)
{
    (void)state;
    struct imageset set;
    struct image8 image;
    put_turned("a.jpg", 32, 16, 6);
    put_turned("b.jpg", 32, 16, 1);
    tmpdir_text("exposure.json", "{\"a.jpg\": 1, \"b.jpg\": 1}");
    tmpdir_mkdir("sparse");
    tmpdir_mkdir("sparse/0");
    tmpdir_text("sparse/0/cameras.txt", "1 OPENCV 32 16 40 41 17 9 -0.05 0 0.001 0.002\n");
    tmpdir_text("sparse/0/images.txt", "1 1 0 0 0 1 2 3 1 a.jpg\n\n2 1 0 0 0 1 2 3 1 b.jpg\n\n");
    struct imageset_request rq = {.images = tmpdir_root};
    err_t e = imageset_list(&rq, &set);
    if (e)
        fail_msg("%s", err_text());
    const struct shot *s = set.capture.shots;
    assert_true(s[0].taken_w == 16 && s[0].taken_h == 32);
    assert_true(s[0].lens.cx == 7 && s[0].lens.cy == 17 && s[0].lens.fx == 41);
    assert_true(s[0].lens.term[2] == 0.002 && s[0].lens.term[3] == -0.001);
    assert_true(s[0].cam.t[0] == -2 && s[0].cam.t[1] == 1 && s[0].cam.t[2] == 3);
    assert_true(s[1].cam.t[0] == 1 && s[1].lens.cx == 17);
    assert_int_equal(imageset_decode(&set, 0, &image), OK);
    assert_true(image.px[0] < 40 && image.px[3 * (image.h - 1) * image.w] > 200); // above, below
    img_free(&image);
    imageset_free(&set);
    put_turned("a.jpg", 32, 16, 7);
    assert_int_equal(list(&rq), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "mirrors image a.jpg"));
}

static void sizes_are_read_from_headers(void **state)
{
    (void)state;
    static const uint8_t jpeg[] = {0xff, 0xd8, 0xff, 0xe1, 0, 4,  0xff, 0xc0, 0xff, 0xff, 0xc4, 0,
                                   3,    9,    0xff, 0xc2, 0, 17, 8,    0x01, 0x02, 0x03, 0x04, 3};
    int w, h;
    put_picture("a.png", 8, 6);
    assert_int_equal(imgsize_read(tmpdir_path("a.png"), &w, &h), OK);
    assert_true(w == 8 && h == 6);
    for (size_t n = 0; n < sizeof jpeg - 1; n++)
        assert_int_equal(imgsize_parse("j", jpeg, n, &w, &h), ERR_FORMAT);
    static const char *const others[] = {("\0\0\0\x18"
                                          "ftypavif"),
                                         "II*\0\x08\0\0\0....", "RIFF....WEBP"};
    static const char *const kinds[] = {"AVIF", "TIFF or raw", "WebP"};
    for (int i = 0; i < 3; i++) {
        assert_int_equal(imgsize_parse("a.jpg", others[i], 12, &w, &h), ERR_FORMAT);
        assert_non_null(strstr(err_text(), kinds[i]));
    }
    assert_int_equal(imgsize_parse("j", jpeg, sizeof jpeg, &w, &h), OK);
    assert_true(w == 0x304 && h == 0x102);
}

/* A place of two exposures, the first of which has this time. */
static void make_place(const char *folder, int w, double time)
{
    char name[64], json[128];
    if (!file_is_dir(tmpdir_path(folder))) {
        tmpdir_mkdir(folder);
        snprintf(name, sizeof name, "%s/images", folder);
        tmpdir_mkdir(name);
    }
    for (int k = 0; k < 2; k++) {
        snprintf(name, sizeof name, "%s/images/train_00_%02d.png", folder, k);
        put_picture(name, w, 6);
    }
    snprintf(name, sizeof name, "%s/exposure.json", folder);
    snprintf(json, sizeof json, "{\"train_00_00.png\": %g, \"train_00_01.png\": 8}", time);
    tmpdir_text(name, json);
}

static void several_folders_are_places(void **state)
{
    (void)state;
    char path[3][600];
    const char *more[] = {path[1], path[2], NULL};
    struct imageset set;
    struct image8 im;
    for (int i = 0; i < 3; i++) {
        snprintf(path[i], sizeof path[i], "%s/p%d%s", tmpdir_root, i, i == 1 ? "//" : "");
        make_place((const char *const[]){"p0", "p1", "p2"}[i], 8, i + 1);
    }
    struct imageset_request rq = {.images = path[0], .more = more, .brackets = true};
    assert_int_equal(imageset_list(&rq, &set), OK);
    check_names(&set, 6,
                (const char *const[]){"p0_train_00_00.png", "p0_train_00_01.png",
                                      "p1_train_00_00.png", "p1_train_00_01.png",
                                      "p2_train_00_00.png", "p2_train_00_01.png"});
    for (int i = 0; i < 6; i++) {
        assert_int_equal(set.capture.shots[i].again, i % 2);
        assert_true(set.capture.shots[i].exposure == (i % 2 ? 8 : i / 2 + 1));
        assert_int_equal(imageset_decode(&set, i, &im), OK);
        img_free(&im);
    }
    imageset_free(&set);
    make_place("p2", 10, 1);
    assert_int_equal(imageset_list(&rq, &set), OK); // each folder has its own size
    assert_true(set.capture.shots[0].image.w == 8 && set.capture.shots[4].image.w == 10);
    imageset_free(&set);
    assert_int_equal(unlink(tmpdir_path("p2/exposure.json")), 0);
    assert_int_equal(imageset_list(&rq, &set), ERR_ARG); // it is looked for before EXIF
    assert_non_null(strstr(err_text(), "p2: has no exposure.json"));
    snprintf(path[2], sizeof path[2], "%s/p1/../p1", tmpdir_root);
    assert_int_equal(imageset_list(&rq, &set), ERR_ARG);
    assert_non_null(
        strstr(err_text(), "another folder has its name and a picture train_00_00.png"));
    rq.n_views = 2;
    assert_int_equal(imageset_list(&rq, &set), ERR_ARG);
}

/* Names in the rig are those with the folder; what it lacks may be left out of each folder. */
static void several_folders_have_one_rig(void **state)
{
    (void)state;
    static const char *const rig =
        "{\"cameras\":[{\"name\":\"p1_train_00_00.png\",\"w\":8,\"h\":6,\"fx\":5,\"fy\":5,"
        "\"cx\":4,\"cy\":3,\"q\":[1,0,0,0],\"t\":[1,0,0]},{\"name\":\"p2_train_00_00.png\","
        "\"w\":8,\"h\":6,\"fx\":5,\"fy\":5,\"cx\":4,\"cy\":3,\"q\":[1,0,0,0],\"t\":[2,0,0]}]}";
    char path[3][600];
    const char *more[] = {path[1], path[2], NULL};
    struct imageset set;
    struct image8 im;
    for (int i = 0; i < 3; i++) {
        snprintf(path[i], sizeof path[i], "%s/p%d", tmpdir_root, i);
        make_place((const char *const[]){"p0", "p1", "p2"}[i], 8, i + 1);
    }
    struct imageset_request rq = {
        .images = path[0], .more = more, .brackets = true, .rig = tmpdir_text("rig.json", rig)};
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "no camera for image p0_train_00_00.png among 2"));
    rq.some_cameras = true;
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_true(set.capture.n == 4 && set.n_unplaced == 2);
    for (int i = 0; i < 4; i++) {
        assert_true(set.capture.shots[i].cam.t[0] == i / 2 + 1);
        assert_int_equal(imageset_decode(&set, i, &im), OK); // 8 px wide, unlike those of p0
        img_free(&im);
    }
    imageset_free(&set);
}

/* COLMAP's layout of rigs: a folder for each camera, and the same names in them; the cameras have
 * other sizes and models. */
static void a_rig_has_a_folder_for_each_camera(void **state)
{
    (void)state;
    static const char *const folder[2] = {"left", "right"};
    char path[2][600], name[64];
    const char *more[] = {path[1], NULL};
    struct imageset set;
    struct image8 im;
    for (int i = 0; i < 2; i++) {
        tmpdir_mkdir(folder[i]);
        snprintf(path[i], sizeof path[i], "%s/%s", tmpdir_root, folder[i]);
        for (int k = 0; k < 2; k++) {
            snprintf(name, sizeof name, "%s/%d.png", folder[i], k);
            put_picture(name, i ? 40 : 32, i ? 30 : 32);
        }
        snprintf(name, sizeof name, "%s/exposure.json", folder[i]);
        tmpdir_text(name, "{\"0.png\": 1, \"1.png\": 2}");
    }
    tmpdir_mkdir("model");
    tmpdir_text("model/cameras.txt", "7 SIMPLE_RADIAL 32 32 30 16 16 -0.02\n"
                                     "9 OPENCV_FISHEYE 40 30 20 21 20 15 0.01 0 0 0\n");
    tmpdir_text("model/images.txt",
                "1 1 0 0 0 0 0 0 7 left/0.png\n\n2 1 0 0 0 1 0 0 9 right/0.png\n\n"
                "3 1 0 0 0 2 0 0 7 left/1.png\n\n4 1 0 0 0 3 0 0 9 in/right/1.png\n\n");
    struct imageset_request rq = {
        .images = path[0], .more = more, .rig = tmpdir_path("model"), .brackets = true};
    if (imageset_list(&rq, &set) != OK)
        fail_msg("%s", err_text());
    static const float x[4] = {0, 2, 1, 3};
    assert_int_equal(set.capture.n, 4);
    for (int i = 0; i < 4; i++) {
        const struct shot *s = &set.capture.shots[i];
        assert_true(s->cam.t[0] == x[i] && s->taken_w == (i < 2 ? 32 : 40));
        assert_int_equal(s->lens.model, i < 2 ? LENS_SIMPLE_RADIAL : LENS_OPENCV_FISHEYE);
        assert_int_equal(imageset_decode(&set, i, &im), OK);
        assert_true(im.w == s->image.w && im.h == s->cam.h);
        img_free(&im);
    }
    imageset_free(&set);
    tmpdir_text("model/images.txt",
                "1 1 0 0 0 0 0 0 7 left/0.png\n\n2 1 0 0 0 1 0 0 9 left/0.png\n");
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "left_0.png is named twice"));
}

#define IN_FOLDER(f) cmocka_unit_test_setup_teardown(f, tmpdir_setup, tmpdir_teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {
        IN_FOLDER(one_exposure_per_view_interleaved),
        IN_FOLDER(test_pictures_come_with_all_exposures_when_asked),
        IN_FOLDER(brackets_come_whole_when_asked),
        IN_FOLDER(inputs_only_at_some_exposures),
        IN_FOLDER(a_protocol_names_the_inputs),
        IN_FOLDER(a_plain_folder_is_all_input),
        IN_FOLDER(pixels_come_when_asked),
        IN_FOLDER(photographs_are_undistorted),
        IN_FOLDER(exposures_that_nothing_tells),
        IN_FOLDER(contradictions_are_named),
        IN_FOLDER(exposures_of_exif_must_be_made_of_the_same),
        IN_FOLDER(one_exposure_for_all),
        IN_FOLDER(what_is_not_read_is_told),
        IN_FOLDER(pictures_that_do_not_count_are_told),
        IN_FOLDER(rigs_come_from_three_places),
        IN_FOLDER(cameras_of_colmap_turn_with_the_photograph),
        IN_FOLDER(sizes_are_read_from_headers),
        IN_FOLDER(several_folders_are_places),
        IN_FOLDER(several_folders_have_one_rig),
        IN_FOLDER(a_rig_has_a_folder_for_each_camera),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
