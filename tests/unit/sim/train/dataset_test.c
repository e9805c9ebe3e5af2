/* Data sets with somebody who passes by, with light that flickers, or with a lamp that is switched:
 * nothing else changes, and truth/ says where and how much. */
#include "sim/train/dataset.h"

#include "core/base/pool.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"

#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <string.h>

enum { INPUTS = 6, SHOTS = 3, SIZE = 64 };

static const struct dataset_request plain = {
    .sample = {.seed = 5,
               .kind = WORLD_ROOM,
               .n_views = 2 * INPUTS - 1,
               .size = SIZE,
               .spread = 0.3f,
               .fov_deg = 60,
               .quality = {.samples = 2, .shadow = 1}},
    .n_exposures = 4,
    .stops = {-4, -2, 0, 2},
    .noise = true,
};

static err_t write_request(const char *name, struct dataset_request a, int threads)
{
    struct arena keep, tmp;
    struct pool *pool = NULL;
    struct plan p = plan_begin(threads);
    curve_make(CURVE_SRGB, NAN, 1, &a.curve);
    dataset_plan(&p, &a);
    assert_int_equal(arena_init(&keep, "keep", p.keep.peak), OK);
    assert_int_equal(arena_init(&tmp, "tmp", p.tmp.peak), OK);
    assert_int_equal(pool_open(&pool, threads), OK);
    const struct run r = {.pool = pool, .keep = &keep, .tmp = &tmp};
    err_t e = dataset_write(&r, &a, tmpdir_mkdir(name));
    assert_int_equal((int)(arena_mark(&keep) + arena_mark(&tmp)), 0);
    pool_close(pool);
    arena_free(&keep);
    arena_free(&tmp);
    return e;
}

static err_t write_set(const char *name, float share, const struct optics *optics, int threads)
{
    struct dataset_request a = plain;
    a.passer = (struct passer){7, share};
    a.sample.n_optics = optics ? 1 : 0;
    a.sample.optics = optics;
    return write_request(name, a, threads);
}

static err_t write_balance(const char *name, float balance)
{
    struct dataset_request a = plain;
    a.balance = balance;
    return write_request(name, a, 1);
}

static err_t write_flicker(const char *name, float flicker, int threads)
{
    struct dataset_request a = plain;
    a.flicker = flicker;
    return write_request(name, a, threads);
}

static err_t write_switched(const char *name, float lit, int threads)
{
    struct dataset_request a = plain;
    a.sample.switched = SAMPLE_OFF;
    a.lit = lit;
    return write_request(name, a, threads);
}

static const char *in_set(const char *set, const char *folder, const char *name)
{
    static char path[96];
    snprintf(path, sizeof path, "%s/%s/%s", set, folder, name);
    return tmpdir_path(path);
}

/* The share of the photograph that is masked; 0 without a mask. */
static double compare_photographs(const char *with, const char *name, double *inside)
{
    struct image8 a, b, mask;
    int masked = 0, changed = 0;
    assert_int_equal(img_read(in_set("without", "images", name), &a), OK);
    assert_int_equal(img_read(in_set(with, "images", name), &b), OK);
    const char *path = in_set(with, "truth/masks", name);
    if (!file_exists(path)) {
        assert_memory_equal(a.px, b.px, 3 * SIZE * SIZE);
        img_free(&a);
        img_free(&b);
        return 0;
    }
    assert_int_equal(img_read(path, &mask), OK);
    for (int i = 0; i < SIZE * SIZE; i++) {
        const bool differs = memcmp(a.px + 3 * i, b.px + 3 * i, 3) != 0;
        assert_true(mask.px[3 * i] == 0 || (mask.px[3 * i] == 255 && !differs));
        masked += mask.px[3 * i] == 0;
        changed += differs;
    }
    *inside += (double)changed / masked;
    img_free(&a);
    img_free(&b);
    img_free(&mask);
    return (double)masked / (SIZE * SIZE);
}

static void others_stay(void **state)
{
    static const float shares[] = {0.02f, 0.2f};
    static const char *const names[] = {"small", "large"};
    (void)state;
    assert_int_equal(write_set("without", 0, NULL, 1), OK);
    assert_false(file_exists(tmpdir_path("without/truth")));
    for (int s = 0; s < 2; s++) {
        int passed = 0;
        double inside = 0;
        assert_int_equal(write_set(names[s], shares[s], NULL, 3), OK);
        for (int i = 0; i < INPUTS * SHOTS; i++) {
            char name[NAME_CAP];
            snprintf(name, sizeof name, "train_ldr_%03d_%d.png", i / SHOTS,
                     i % SHOTS + (i % SHOTS > 0));
            const double share = compare_photographs(names[s], name, &inside);
            passed += share > 0;
            assert_true(share == 0 || fabs(share / (double)shares[s] - 1) < 0.25);
        }
        assert_int_equal(passed, INPUTS * SHOTS / 3);
        assert_true(inside / passed > 0.6); // the rest is black or white with and without
        for (int i = 0; i < INPUTS - 1; i++) {
            char name[NAME_CAP];
            snprintf(name, sizeof name, "test_ldr_%03d_3.png", i);
            assert_true(compare_photographs(names[s], name, &inside) == 0);
        }
    }
}

/* A mask counts as many pixels behind a lens that bends lines. */
static void behind_a_lens(void **state)
{
    struct optics o;
    double inside = 0;
    int passed = 0;
    (void)state;
    assert_int_equal(optics_parse("a", "k1=-0.2,v2=-0.4", SIZE, 80, &o), OK);
    tmpdir_remove();
    tmpdir_make();
    assert_int_equal(write_set("without", 0, &o, 1), OK);
    assert_int_equal(write_set("lens", 0.1f, &o, 1), OK);
    for (int i = 0; i < INPUTS; i++) {
        char name[NAME_CAP];
        snprintf(name, sizeof name, "train_ldr_%03d_2.png", i);
        const double share = compare_photographs("lens", name, &inside);
        passed += share > 0;
        assert_true(share == 0 || fabs(share / 0.1 - 1) < 0.25);
    }
    assert_true(passed > 0);
}

static double mean_of_colour(const char *set, const char *name, int c)
{
    struct image8 im;
    double sum = 0;
    assert_int_equal(img_read(in_set(set, "images", name), &im), OK);
    for (int i = 0; i < SIZE * SIZE; i++)
        sum += im.px[3 * i + c];
    img_free(&im);
    return sum / (SIZE * SIZE);
}

static double mean_of(const char *set, const char *name)
{
    double sum = 0;
    for (int c = 0; c < 3; c++)
        sum += mean_of_colour(set, name, c) / 3;
    return sum;
}

/* Photographs are as much brighter as the file says, in the mean not at all; what is held out
 * stays. */
static void light_flickers(void **state)
{
    char name[NAME_CAP];
    double sum = 0, most = 0, stops, inside = 0;
    int n = 0;
    (void)state;
    tmpdir_remove();
    tmpdir_make();
    assert_int_equal(write_set("without", 0, NULL, 1), OK);
    assert_int_equal(write_flicker("flicker", 0.5f, 2), OK);
    FILE *f = fopen(tmpdir_path("flicker/truth/light.json"), "r");
    assert_non_null(f);
    while (fscanf(f, "%*[^\"]\"%127[^\"]\": %lf", name, &stops) == 2) {
        const double more = mean_of("flicker", name) - mean_of("without", name);
        assert_true(fabs(stops) < 0.03 || (more > 0) == (stops > 0));
        sum += stops;
        most = fmax(most, fabs(stops));
        n++;
    }
    fclose(f);
    assert_int_equal(n, INPUTS * SHOTS);
    assert_float_equal(sum, 0, 1e-4);
    assert_true(most > 0.35 && most < 0.7);
    for (int i = 0; i < INPUTS - 1; i++) {
        snprintf(name, sizeof name, "test_ldr_%03d_1.png", i);
        assert_true(compare_photographs("flicker", name, &inside) == 0);
    }
    assert_int_equal(write_flicker("dark", 3.1f, 1), ERR_ARG);
    assert_non_null(strstr(err_text(), "flicker"));
}

/* Red and blue of an input are as much brighter beside green as the files say, in the mean not at
 * all; green and what is held out stay. */
static void white_balance_changes(void **state)
{
    static const char *const file[3] = {"truth/red.json", NULL, "truth/blue.json"};
    char name[NAME_CAP];
    double inside = 0;
    (void)state;
    tmpdir_remove();
    tmpdir_make();
    assert_int_equal(write_set("without", 0, NULL, 1), OK);
    assert_int_equal(write_balance("balance", 0.5f), OK);
    for (int c = 0; c < 3; c += 2) {
        double sum = 0, most = 0, stops;
        int n = 0;
        char path[64];
        snprintf(path, sizeof path, "balance/%s", file[c]);
        FILE *f = fopen(tmpdir_path(path), "r");
        assert_non_null(f);
        while (fscanf(f, "%*[^\"]\"%127[^\"]\": %lf", name, &stops) == 2) {
            const double was = mean_of_colour("without", name, c);
            const double more = mean_of_colour("balance", name, c) - was;
            assert_true(fabs(stops) < 0.03 || (more > 0) == (stops > 0));
            assert_true(mean_of_colour("balance", name, 1) == mean_of_colour("without", name, 1));
            sum += stops;
            most = fmax(most, fabs(stops));
            n++;
        }
        fclose(f);
        assert_int_equal(n, INPUTS * SHOTS);
        assert_float_equal(sum, 0, 1e-4);
        assert_true(most > 0.2 && most < 0.8);
    }
    for (int i = 0; i < INPUTS - 1; i++) {
        snprintf(name, sizeof name, "test_ldr_%03d_1.png", i);
        assert_true(compare_photographs("balance", name, &inside) == 0);
    }
    assert_int_equal(write_balance("wrong", 3.1f), ERR_ARG);
    assert_non_null(strstr(err_text(), "white balance"));
}

/* The photographs that the file names are brighter than with the lamp off; the others, and what is
 * held out, are the same. */
static void a_lamp_is_switched(void **state)
{
    char name[NAME_CAP];
    double inside = 0;
    int n = 0, lit = 0, on;
    (void)state;
    tmpdir_remove();
    tmpdir_make();
    assert_int_equal(write_switched("without", 0, 1), OK);
    assert_int_equal(write_switched("some", 0.34f, 2), OK);
    FILE *f = fopen(tmpdir_path("some/truth/lamp.json"), "r");
    assert_non_null(f);
    while (fscanf(f, "%*[^\"]\"%127[^\"]\": %d", name, &on) == 2) {
        const double more = mean_of("some", name) - mean_of("without", name);
        assert_true(on ? more > 3 : more == 0);
        lit += on;
        n++;
    }
    fclose(f);
    assert_int_equal(n, INPUTS * SHOTS);
    assert_int_equal(lit, n / 3); // all photographs of two places
    for (int i = 0; i < INPUTS - 1; i++) {
        snprintf(name, sizeof name, "test_ldr_%03d_3.png", i);
        assert_true(compare_photographs("some", name, &inside) == 0);
    }
    assert_int_equal(write_switched("many", 1.1f, 1), ERR_ARG);
}

static void wrong_shares(void **state)
{
    (void)state;
    assert_int_equal(write_set("huge", 0.31f, NULL, 1), ERR_ARG);
    assert_non_null(strstr(err_text(), "passer-by"));
    assert_int_equal(write_set("tiny", 0.001f, NULL, 1), ERR_ARG);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(others_stay),        cmocka_unit_test(behind_a_lens),
        cmocka_unit_test(light_flickers),     cmocka_unit_test(white_balance_changes),
        cmocka_unit_test(a_lamp_is_switched), cmocka_unit_test(wrong_shares)};
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
