#include "firmware/result/sceneio.h"

#include "core/splat/display.h"
#include "drivers/format/file.h"
#include "drivers/format/ply.h"
#include "drivers/format/sidecar.h"

#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <math.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <sys/resource.h>

#include <cmocka.h>

static const struct sceneio_format spz3 = {.spz = 3};
static struct arena arena;

static struct scene make(int n, int degree)
{
    static char names[1][NAME_CAP] = {"a.png"};
    static float log2t[1] = {-3};
    static struct camera cams[1] = {{64, 64, 60, 60, 32, 32, {1, 0, 0, 0}, {0, 0, 4}}};
    struct scene s = {.n_views = 1, .size = 64, .names = names, .log2t = log2t, .cams = cams};
    unsigned seed = 7;
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", 1 << 20), OK);
    assert_int_equal(gaussians_init(&s.g, &arena, n, degree), OK);
    s.g.n = n;
    display_tonemap(1.5f, &s.tone);
    s.background[1] = 0.25f;
    for (int p = 0; p < gaussians_planes(degree); p++)
        for (int i = 0; i < n; i++) {
            seed = seed * 1664525u + 1013904223u;
            s.g.plane[p][i] = (float)((int)(seed >> 8) - (1 << 23)) / (1 << 23);
        }
    return s;
}

static const char *const kinds[] = {"s.hdrig", "s.ply", "s.spz", "s.glb"};
enum { N_KINDS = sizeof kinds / sizeof kinds[0] };

static void every_kind_keeps_the_scene(void **state)
{
    (void)state;
    for (int k = 0; k < N_KINDS; k++) {
        struct scene s = make(40, 2), back;
        struct sceneio_info info;
        struct gaussians_report report;
        const char *path = tmpdir_path(kinds[k]);
        bool readable;
        assert_int_equal(sceneio_check_place(path, &readable), OK);
        assert_true(readable);
        assert_int_equal(sceneio_write(path, &s, &spz3), OK);
        assert_int_equal(sceneio_peek(path, &info), OK);
        assert_true(info.n == 40 && info.degree == 2 && info.n_views == 1 && info.has_hdr);
        struct arena exact; // as many bytes as were promised
        assert_int_equal(arena_init(&exact, "exact", info.need), OK);
        assert_int_equal(sceneio_read(path, &exact, &back, &report), OK);
        assert_true(back.g.n == 40 && back.size == 64 && back.background[1] == 0.25f);
        assert_memory_equal(&back.tone, &s.tone, sizeof s.tone);
        assert_memory_equal(&back.cams[0], &s.cams[0], sizeof s.cams[0]);
        assert_true(back.log2t[0] == -3 && strcmp(back.names[0], "a.png") == 0);
        for (int p = G_SH; p < gaussians_planes(2); p++)
            for (int i = 0; i < 40; i++)
                assert_true(fabsf(back.g.plane[p][i] - s.g.plane[p][i]) < 0.12f);
        arena_free(&exact);
    }
}

/* A folder of SOG is found as that of a result is, whose scene comes first; its meta.json is no
 * sidecar. */
static void folders_of_sog_are_found(void **state)
{
    (void)state;
    static const char *const places[] = {"tests/data/splats/one", "tests/data/splats/one/meta.json",
                                         "tests/data/splats/one.sog"};
    struct sceneio_info info;
    bool readable;
    for (int i = 0; i < 3; i++) {
        assert_int_equal(sceneio_peek(places[i], &info), OK);
        assert_true(info.n == 48 && info.degree == 2 && !info.has_hdr && !info.has_sidecar);
        assert_true(isinf(info.headroom));
    }
    tmpdir_mkdir("both");
    tmpdir_text("both/meta.json", "{}");
    tmpdir_text("both/scene.hdrig", "");
    assert_int_equal(sceneio_peek(tmpdir_path("both"), &info), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "scene.hdrig"));
    assert_int_equal(sceneio_check_place(tmpdir_path("x.sog"), &readable), ERR_ARG);
    assert_int_equal(sceneio_check_place(tmpdir_path("meta.json"), &readable), ERR_ARG);
}

static int count_files(void)
{
    DIR *d = opendir(tmpdir_root);
    int n = 0;
    assert_non_null(d);
    while (readdir(d))
        n++;
    closedir(d);
    return n - 2;
}

static void a_failure_leaves_what_was_there(void **state)
{
    (void)state;
    struct scene s = make(4, 0), bad, back;
    struct gaussians_report report;
    for (int k = 0; k < N_KINDS; k++)
        assert_int_equal(sceneio_write(tmpdir_path(kinds[k]), &s, &spz3), OK);
    int files = count_files();
    for (int k = 0; k < N_KINDS; k++) {
        const char *path = tmpdir_path(kinds[k]);
        bad = make(4, 0);
        bad.g.plane[G_SH][3] = NAN; // found by the splats
        assert_int_equal(sceneio_write(path, &bad, &spz3), ERR_ARG);
        bad = make(4, 0);
        bad.background[0] = INFINITY; // found by the sidecar
        if (k > 0)
            assert_int_equal(sceneio_write(path, &bad, &spz3), ERR_ARG);
        assert_int_equal(count_files(), files);
        assert_int_equal(sceneio_read(path, &arena, &back, &report), OK);
        assert_int_equal(back.g.n, 4);
    }
}

/* Files of any kind may grow to `bytes` and no further. */
static void limit_files(rlim_t bytes)
{
    struct rlimit l;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &l), 0);
    l.rlim_cur = bytes;
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &l), 0);
}

static void a_disk_that_ends_leaves_what_was_there(void **state)
{
    (void)state;
    static const rlim_t ends[] = {0, 1, 4097, 40000};
    struct scene s = make(1200, 3), back;
    struct gaussians_report report;
    signal(SIGXFSZ, SIG_IGN); // write says it
    for (int k = 0; k < N_KINDS; k++) {
        const char *path = tmpdir_path(kinds[k]);
        s.g.n = 5;
        assert_int_equal(sceneio_write(path, &s, &(struct sceneio_format){.spz = 4}), OK);
        s.g.n = 1200;
        int files = count_files();
        for (size_t i = 0; i < sizeof ends / sizeof ends[0]; i++)
            for (int spz = 3; spz <= 4; spz++) {
                limit_files(ends[i]);
                err_t e = sceneio_write(path, &s, &(struct sceneio_format){.spz = spz});
                limit_files(RLIM_INFINITY);
                assert_int_equal(e, ERR_IO);
                assert_non_null(strstr(err_text(), "File too large"));
                assert_int_equal(count_files(), files);
            }
        s.g.n = 1; // now it is the sidecar that does not fit
        s.g.degree = 0;
        limit_files(5000);
        assert_int_equal(sceneio_write(path, &s, &spz3), k == 0 ? OK : ERR_IO);
        limit_files(RLIM_INFINITY);
        assert_true(k == 0 || strstr(err_text(), ".json: writing failed: File too large"));
        assert_int_equal(count_files(), files);
        s.g.degree = 3;
        size_t mark = arena_mark(&arena);
        assert_int_equal(sceneio_read(path, &arena, &back, &report), OK);
        assert_int_equal(back.g.n, k == 0 ? 1 : 5);
        arena_reset(&arena, mark);
    }
}

/* The file without its radiance and what goes with it, as if a tool had dropped them. */
static void strip(const char *name)
{
    struct file_map m;
    assert_int_equal(file_map(tmpdir_path(name), 1 << 20, &m), OK);
    uint8_t *copy = malloc(m.n);
    size_t n = m.n;
    assert_non_null(copy);
    memcpy(copy, m.p, n);
    file_unmap(&m);
    for (uint8_t *p; (p = memmem(copy, n, "ihdr_log", 8)) || (p = memmem(copy, n, "ihdr ev", 7));)
        p[0] = 'X';
    tmpdir_write(name, copy, n);
    free(copy);
}

static void a_sidecar_tells_what_display_colours_mean(void **state)
{
    (void)state;
    for (int n_views = 0; n_views < 2; n_views++) { // even without cameras
        struct scene s = make(3, 0), back;
        struct gaussians_report report;
        struct sceneio_info info;
        s.n_views = n_views;
        assert_int_equal(sceneio_write(tmpdir_path("ldr.ply"), &s, &spz3), OK);
        strip("ldr.ply");
        assert_int_equal(sceneio_peek(tmpdir_path("ldr.ply"), &info), OK);
        assert_true(!info.has_hdr && info.has_sidecar && info.ev == 0 && isinf(info.headroom));
        assert_int_equal(sceneio_read(tmpdir_path("ldr.ply"), &arena, &back, &report), OK);
        for (int i = 0; i < 3; i++)
            assert_true(fabsf(back.g.plane[G_SH][i] - s.g.plane[G_SH][i]) < 1e-3f);
        assert_int_equal(remove(tmpdir_path("ldr.json")), 0); // and now sRGB is all there is
        assert_int_equal(sceneio_read(tmpdir_path("ldr.ply"), &arena, &back, &report), OK);
        assert_true(back.n_views == 0 && back.size == SIDECAR_SIZE);
        assert_int_equal(sceneio_peek(tmpdir_path("ldr.ply"), &info), OK);
        assert_false(info.has_sidecar);
        for (int i = 0; i < 3; i++)
            assert_true(fabsf(back.g.plane[G_SH][i] - s.g.plane[G_SH][i]) > 1);
    }
}

static void places_that_do_not_do_are_refused(void **state)
{
    (void)state;
    struct scene s = make(3, 0), back;
    struct sceneio_info info;
    struct gaussians_report report;
    bool readable;
    tmpdir_text("taken.json", "{\"mine\": 1}");
    expect_err(sceneio_check_place(tmpdir_path("taken.glb"), &readable), ERR_ARG, "taken.json");
    expect_err(sceneio_write(tmpdir_path("taken.glb"), &s, &spz3), ERR_ARG, "taken.json");
    assert_false(file_exists(tmpdir_path("taken.glb")));
    assert_int_equal(sceneio_write(tmpdir_path("taken.hdrig"), &s, &spz3), OK); // needs none
    expect_err(sceneio_write(tmpdir_path("x.obj"), &s, &spz3), ERR_ARG, "x.obj: scenes are files");
    expect_err(sceneio_write(tmpdir_path(".ply/"), &s, &spz3), ERR_ARG, "scenes are files");
    expect_err(sceneio_write(tmpdir_path("none/x.ply"), &s, &spz3), ERR_IO, "none/");
    tmpdir_mkdir("folder.ply");
    expect_err(sceneio_write(tmpdir_path("folder.ply"), &s, &spz3), ERR_ARG, "a folder");
    expect_err(sceneio_read(tmpdir_path("folder.ply"), &arena, &back, &report), ERR_IO,
               "scene.hdrig");
    expect_err(sceneio_peek(tmpdir_path("x.html"), &info), ERR_ARG, "written, not read");
    expect_err(sceneio_peek(tmpdir_path("missing.spz"), &info), ERR_IO, "missing.spz");
    assert_int_equal(sceneio_check_place(tmpdir_path("x.html"), &readable), OK);
    assert_false(readable);
    static char longer[FILE_PATH_CAP + 8];
    memset(longer, 'a', sizeof longer - 5);
    memcpy(longer + sizeof longer - 5, ".ply", 5);
    expect_err(sceneio_peek(longer, &info), ERR_ARG, "4095 bytes");
    expect_err(sceneio_write(longer, &s, &spz3), ERR_ARG, "");
}

static void one_scene_does_not_take_the_sidecar_of_another(void **state)
{
    (void)state;
    struct scene s = make(3, 0), back;
    struct gaussians_report report;
    assert_int_equal(sceneio_write(tmpdir_path("one.ply"), &s, &spz3), OK);
    assert_int_equal(sceneio_write(tmpdir_path("one.spz"), &s, &spz3), OK); // the same scene
    int files = count_files();
    s.background[0] = 0.5f;
    expect_err(sceneio_write(tmpdir_path("one.ply"), &s, &spz3), ERR_ARG, "one.json belongs to ");
    assert_non_null(strstr(err_text(), "one.spz too and would change"));
    expect_err(sceneio_write(tmpdir_path("one.glb"), &s, &spz3), ERR_ARG, "one.ply too");
    assert_int_equal(count_files(), files);
    assert_int_equal(sceneio_read(tmpdir_path("one.ply"), &arena, &back, &report), OK);
    assert_true(back.background[0] == 0);
    assert_int_equal(remove(tmpdir_path("one.spz")), 0);
    assert_int_equal(sceneio_write(tmpdir_path("one.ply"), &s, &spz3), OK); // its own
}

static int remove_folder(void **state)
{
    (void)state;
    arena_free(&arena);
    tmpdir_remove();
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_kind_keeps_the_scene),
        cmocka_unit_test(folders_of_sog_are_found),
        cmocka_unit_test(a_failure_leaves_what_was_there),
        cmocka_unit_test(a_disk_that_ends_leaves_what_was_there),
        cmocka_unit_test(a_sidecar_tells_what_display_colours_mean),
        cmocka_unit_test(places_that_do_not_do_are_refused),
        cmocka_unit_test(one_scene_does_not_take_the_sidecar_of_another),
    };
    return cmocka_run_group_tests(tests, tmpdir_setup, remove_folder);
}
