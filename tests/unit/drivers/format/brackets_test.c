/* Which photographs of a plain folder are brackets of one place. */
#include "drivers/format/imageset.h"

#include "drivers/format/img.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <unistd.h>

#include <cmocka.h>

enum { W = 320, H = 224, N = 9 };

/* A picture of place `place`, and its line of exposure.json. */
static void put(const char *name, int w, int place, double exposure, char *json)
{
    static uint8_t px[W * H * 3];
    for (int i = 0; i < w * H; i++) {
        const double x = i % w + 11 * place, y = i / w;
        const double s = sin(0.31 * x + 0.2 * y) + sin(0.17 * x - 0.37 * y + place);
        const double light = 0.2 * exposure * exp2(1.2 * s);
        px[3 * i] = px[3 * i + 1] = px[3 * i + 2] =
            (uint8_t)(255 * pow(fmin(light, 1), 1 / 2.2) + 0.5);
    }
    struct image8 im = {w, H, 3, px};
    assert_int_equal(img_write_png(tmpdir_path(name), &im), OK);
    sprintf(json + strlen(json), "%c\"%s\": %g", json[0] ? ',' : '{', name, exposure);
}

static void make_folder(void)
{
    static const struct {
        int w, place;
        double exposure;
    } shots[N] = {{W, 0, 1},      {W, 0, 0.25}, {W, 0, 4}, // a bracket
                  {W, 1, 1},      {W, 1, 4},               // another
                  {W, 1, 1},                               // the same exposure again
                  {W, 2, 0.25},                            // from elsewhere
                  {W - 8, 2, 1},                           // of another size
                  {W - 8, 2, 1.1}};                        // hardly another exposure
    char json[1024] = "", name[32];
    for (int i = 0; i < N; i++) {
        snprintf(name, sizeof name, "DSC_%02d.png", i);
        put(name, shots[i].w, shots[i].place, shots[i].exposure, json);
    }
    tmpdir_text("exposure.json", strcat(json, "}"));
}

static void check_request(const struct imageset_request *rq, const char *want)
{
    struct imageset set;
    assert_int_equal(imageset_list(rq, &set), OK);
    assert_int_equal(set.capture.n, strlen(want));
    for (int i = 0, first = 0; i < set.capture.n; i++) {
        const struct shot *s = &set.capture.shots[i];
        first = s->again ? first : i;
        if (s->again != (want[i] == '+'))
            fail_msg("%s: again is %d", s->name, s->again);
        assert_true(s->cam.t[0] == set.capture.shots[first].cam.t[0]);
    }
    imageset_free(&set);
}

static void check(bool brackets, const char *want)
{
    check_request(&(struct imageset_request){.images = tmpdir_root, .brackets = brackets}, want);
}

static void make_sparse(void)
{
    tmpdir_mkdir("sparse");
    tmpdir_mkdir("sparse/0");
}

/* Cameras of the shots whose letter of `which` is not '-'. */
static void put_cameras(const char *which)
{
    char images[1024] = "";
    tmpdir_text("sparse/0/cameras.txt", "1 PINHOLE 320 224 300 300 160 112\n"
                                        "2 PINHOLE 312 224 300 300 156 112\n");
    for (int i = 0; i < N; i++)
        if (which[i] != '-')
            sprintf(images + strlen(images), "%d 1 0 0 0 %d 0 0 %d DSC_%02d.png\n\n", i + 1, i,
                    i < 7 ? 1 : 2, i);
    tmpdir_text("sparse/0/images.txt", images);
}

static void a_tripod_makes_brackets(void **state)
{
    (void)state;
    make_folder();
    check(true, ".++.+....");
    check(false, ".........");
}

static void known_cameras_are_kept_apart(void **state)
{
    (void)state;
    make_folder();
    make_sparse();
    put_cameras(".........");
    check(true, ".........");
}

/* As after a scene was made: cameras.json has the first of each place. */
static void places_lend_their_cameras(void **state)
{
    (void)state;
    const struct imageset_request some = {
        .images = tmpdir_root, .every_exposure = true, .some_cameras = true};
    make_folder();
    make_sparse();
    put_cameras(".--.-....");
    check(true, ".++.+....");
    check_request(&some, ".++.+....");
    put_cameras("---.--...");
    check_request(&some, ".+...");
    put_cameras(".-..-...."); // the third has its own
    check(true, ".+..+....");
    const struct imageset_request all = {.images = tmpdir_root, .brackets = true};
    struct imageset set;
    put_cameras("---.-....");
    assert_int_equal(imageset_list(&all, &set), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "no camera for image DSC_00.png"));
}

static void a_broken_file_is_named(void **state)
{
    (void)state;
    struct imageset set;
    const struct imageset_request rq = {.images = tmpdir_root, .brackets = true};
    make_folder();
    assert_int_equal(truncate(tmpdir_path("DSC_01.png"), 5000), 0);
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "DSC_01.png"));
    assert_null(set.capture.shots);
}

#define IN_FOLDER(f) cmocka_unit_test_setup_teardown(f, tmpdir_setup, tmpdir_teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {
        IN_FOLDER(a_tripod_makes_brackets),
        IN_FOLDER(known_cameras_are_kept_apart),
        IN_FOLDER(places_lend_their_cameras),
        IN_FOLDER(a_broken_file_is_named),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
