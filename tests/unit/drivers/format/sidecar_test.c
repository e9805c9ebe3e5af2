#include "drivers/format/sidecar.h"

#include "core/photo/tonemap.h"
#include "core/splat/display.h"
#include "drivers/format/cameras.h"
#include "drivers/format/file.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <unistd.h>

#include <cmocka.h>

enum { VIEWS = 3, SIZE = 112, TEXT_CAP = 1 << 16 };

static struct arena arena;
static char names[VIEWS][NAME_CAP] = {"a.png", "\"quoted\\.png", "\xc3\xa4.png"};
static float log2t[VIEWS] = {-1.23456789f, 0, 1e-30f};
static struct camera cams[VIEWS];

static struct scene make(void)
{
    struct scene s = {.background = {0.1f, 0, 1e5f},
                      .n_views = VIEWS,
                      .size = SIZE,
                      .names = names,
                      .log2t = log2t,
                      .cams = cams};
    tonemap_linear(&s.tone, 0.1f, -20, 10, 1.5f);
    for (int i = 0; i < TONE_PARAMS; i++)
        s.tone.p[i] *= 1 + (float)i / 7919;
    for (int i = 0; i < VIEWS; i++)
        cams[i] = (struct camera){SIZE,  SIZE,  100.1f / (float)(i + 1), 99,
                                  56.3f, 1e-7f, {0.6f, 0, 0.8f, 0},      {1e9f, -(float)i / 3, 0}};
    return s;
}

static void read_scene(const char *splats, float ev, struct scene *s)
{
    struct sidecar_info info;
    arena_free(&arena);
    assert_int_equal(sidecar_peek(splats, &info), OK);
    assert_int_equal(arena_init(&arena, "test", info.need), OK);
    assert_int_equal(sidecar_read(splats, ev, &arena, s), OK);
    assert_int_equal(s->n_views, info.n_views);
    assert_int_equal(arena.used, info.need);
}

static void what_is_written_is_read_bit_for_bit(void **state)
{
    (void)state;
    struct scene s = make(), back = {.g = {.n = 77}};
    assert_int_equal(sidecar_write(tmpdir_path("scene.ply"), &s), OK);
    assert_true(file_is_regular(tmpdir_path("scene.json")));
    read_scene(tmpdir_path("scene.spz"), 0, &back);
    assert_true(back.g.n == 77 && back.size == SIZE && back.n_views == VIEWS && !back.metres);
    assert_memory_equal(&back.tone, &s.tone, sizeof s.tone);
    assert_memory_equal(back.background, s.background, sizeof s.background);
    assert_memory_equal(back.log2t, log2t, sizeof log2t);
    assert_memory_equal(back.cams, cams, sizeof cams);
    for (int i = 0; i < VIEWS; i++)
        assert_string_equal(back.names[i], names[i]);
    s.metres = true; // and over what is there
    assert_int_equal(sidecar_write(tmpdir_path("scene.ply"), &s), OK);
    read_scene(tmpdir_path("scene.ply"), 0, &back);
    assert_true(back.metres && back.n_views == VIEWS);
    s.n_views = 0;
    assert_int_equal(sidecar_write(tmpdir_path("scene.glb"), &s), OK);
    read_scene(tmpdir_path("scene.ply"), 0, &back);
    assert_true(back.n_views == 0 && back.size == SIZE);
}

static void without_a_sidecar_colours_are_srgb(void **state)
{
    (void)state;
    struct scene s = {.g = {.n = 5}, .background = {1, 1, 1}};
    struct tonemap want;
    display_tonemap(2, &want);
    read_scene(tmpdir_path("alone.ply"), 2, &s);
    assert_true(s.g.n == 5 && s.n_views == 0 && s.size == SIDECAR_SIZE && s.background[1] == 0);
    assert_memory_equal(&s.tone, &want, sizeof want);
}

static void files_of_others_are_left_alone(void **state)
{
    (void)state;
    struct scene s = make(), back = {0};
    struct file_map m;
    const char *text = "{\"cameras\": [1], \"format\": \"other\"}";
    tmpdir_text("cameras.json", text);
    read_scene(tmpdir_path("cameras.ply"), 0, &back);
    assert_int_equal(back.n_views, 0);
    assert_int_equal(sidecar_write(tmpdir_path("cameras.ply"), &s), ERR_ARG);
    assert_non_null(strstr(err_text(), "cameras.json is not a sidecar"));
    assert_int_equal(file_map(tmpdir_path("cameras.json"), 1000, &m), OK);
    assert_true(m.n == strlen(text));
    file_unmap(&m);
}

static void the_path_is_that_of_the_splats(void **state)
{
    (void)state;
    static const char *const paths[][2] = {{"a/b.ply", "a/b.json"},
                                           {"a.d/b", "a.d/b.json"},
                                           {"b.x.spz", "b.x.json"},
                                           {"a/.ply", "a/.ply.json"}};
    char out[FILE_PATH_CAP];
    for (size_t i = 0; i < sizeof paths / sizeof paths[0]; i++) {
        assert_int_equal(sidecar_path(paths[i][0], out, sizeof out), OK);
        assert_string_equal(out, paths[i][1]);
    }
    assert_int_equal(sidecar_path("b.ply", out, 7), OK);
    assert_int_equal(sidecar_path("b.ply", out, 6), ERR_ARG);
}

static void what_cannot_be_read_is_not_written(void **state)
{
    (void)state;
    float *const places[] = {&log2t[1], &cams[2].t[0]};
    const char *path = tmpdir_path("bad.ply");
    for (size_t i = 0; i < sizeof places / sizeof places[0]; i++) {
        struct scene s = make();
        *places[i] = NAN;
        assert_int_not_equal(sidecar_write(path, &s), OK);
        *places[i] = 0;
    }
    struct scene s = make();
    s.tone.p[3] = INFINITY;
    assert_int_equal(sidecar_write(path, &s), ERR_ARG);
    assert_non_null(strstr(err_text(), "\"tone\" 3 of 579 is inf"));
    s = make();
    s.background[2] = NAN;
    assert_int_equal(sidecar_write(path, &s), ERR_ARG);
    s = make();
    s.background[1] = -1e-9f;
    assert_int_equal(sidecar_write(path, &s), ERR_ARG);
    assert_non_null(strstr(err_text(), "\"background\" 1 is -1e-09, must be >= 0"));
    s = make();
    cams[2].h++;
    assert_int_equal(sidecar_write(path, &s), ERR_ARG);
    assert_non_null(strstr(err_text(), "is for 112 x 113 px, above \"size\" 112"));
    s = make();
    s.n_views = CAMERAS_MAX + 1;
    assert_int_equal(sidecar_write(path, &s), ERR_ARG);
    assert_non_null(strstr(err_text(), "4097 cameras, allowed are 4096"));
    s = make();
    s.size = 0;
    assert_int_equal(sidecar_write(path, &s), ERR_ARG);
    assert_false(file_exists(tmpdir_path("bad.json")));
    assert_int_equal(symlink("/dev/full", tmpdir_path("full.json")), 0);
    s = make();
    assert_int_equal(sidecar_write(tmpdir_path("full.ply"), &s), ERR_ARG); // not a regular file
}

/* The text of a good sidecar with the first `old` replaced. */
static size_t changed(const char *old, const char *new, char out[TEXT_CAP])
{
    struct scene s = make();
    struct file_map m;
    assert_int_equal(sidecar_write(tmpdir_path("good.ply"), &s), OK);
    assert_int_equal(file_map(tmpdir_path("good.json"), TEXT_CAP, &m), OK);
    const char *text = (const char *)m.p, *at = memmem(text, m.n, old, strlen(old));
    assert_non_null(at);
    int before = (int)(at - text), after = (int)(m.n - strlen(old)) - before;
    int n = snprintf(out, TEXT_CAP, "%.*s%s%.*s", before, text, new, after, at + strlen(old));
    assert_in_range(n, 1, TEXT_CAP - 1);
    file_unmap(&m);
    return (size_t)n;
}

static void hostile_files_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *old, *new, *sentence;
        err_t code;
    } wrong[] = {
        {"\"version\": 1", "\"version\": 2", "\"version\" 2", ERR_UNSUPPORTED},
        {"\"version\": 1,", "", "\"version\" 0", ERR_UNSUPPORTED},
        {"\"mid_exposure_log2\": 1.5", "\"mid_exposure_log2\": 1e99", "\"mid_exposure_log2\"",
         ERR_FORMAT},
        {"\"background\": [0.1", "\"background\": [-0.1", "\"background\" 0 is -0.1", ERR_FORMAT},
        {"\"background\": [0.1", "\"background\": [0, 0.1", "\"background\" is not", ERR_FORMAT},
        {"\"tone\": [", "\"tone\": [{},", "\"tone\" is not an array of 3", ERR_FORMAT},
        {"\"b2\": ", "\"b3\": ", "tone curve 0: \"b2\"", ERR_FORMAT},
        {"\"w1\": [", "\"w1\": [1,", "tone curve 0: \"w1\" is not an array of 64", ERR_FORMAT},
        {"\"b1\": [", "\"b1\": [null] , \"b0\": [", "tone curve 0: \"b1\"", ERR_FORMAT},
        {"\"size\": 112", "\"size\": 0", "\"size\" is not a whole", ERR_FORMAT},
        {"\"size\": 112", "\"size\": 111", "camera 0 (a.png) is for 112 x 112", ERR_FORMAT},
        {"\"cameras\": [", "\"cameras\": [1,", "camera 0: \"name\"", ERR_FORMAT},
        {"\"cameras\"", "\"camera\"", "no array \"cameras\"", ERR_FORMAT},
        {"a.png", "../a.png", "camera 0: byte 2 of a name", ERR_FORMAT},
        {"\"q\": [0.6", "\"q\": [0.7", "quaternion", ERR_FORMAT},
        {", \"exposure_log2\": -1.23456788", "", "camera 0 (a.png) has no \"exposure_log2\"",
         ERR_FORMAT},
    };
    static char text[TEXT_CAP];
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", 1 << 16), OK);
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        struct scene s = {.n_views = 9}, was = s;
        size_t n = changed(wrong[i].old, wrong[i].new, text);
        struct sidecar_bytes file = {"f", text, n};
        size_t mark = arena_mark(&arena);
        assert_int_equal(sidecar_parse(&file, 0, &arena, &s), wrong[i].code);
        if (!strstr(err_text(), wrong[i].sentence))
            fail_msg("\"%s\" lacks \"%s\"", err_text(), wrong[i].sentence);
        assert_memory_equal(&s, &was, sizeof s);
        assert_int_equal(arena_mark(&arena), mark);
    }
}

static void cameras_are_counted_before_memory_is_asked_for(void **state)
{
    (void)state;
    static char text[TEXT_CAP];
    int n = snprintf(text, sizeof text,
                     "{\"format\": \"hdrig-sidecar\", \"version\": 1, "
                     "\"cameras\": [0");
    for (int i = 0; i < CAMERAS_MAX; i++)
        n += snprintf(text + n, sizeof text - (size_t)n, ",0");
    n += snprintf(text + n, sizeof text - (size_t)n, "]}");
    struct sidecar_bytes file = {"f", text, (size_t)n};
    struct sidecar_info info;
    assert_int_equal(sidecar_peek_bytes(&file, &info), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "f: 4097 cameras, at most 4096 are read"));
    assert_true(!info.found && info.need == 0);
}

static void every_cut_is_refused(void **state)
{
    (void)state;
    static char text[TEXT_CAP];
    size_t n = changed("\n}\n", "}", text);
    struct scene s = {0};
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", 1 << 16), OK);
    assert_int_equal(sidecar_parse(&(struct sidecar_bytes){"f", text, n}, 0, &arena, &s), OK);
    for (size_t cut = 0; cut < n; cut += 1 + cut % 7) {
        struct sidecar_bytes file = {"f", text, cut};
        assert_int_equal(sidecar_parse(&file, 0, &arena, &s), ERR_FORMAT);
    }
    struct arena small;
    assert_int_equal(arena_init(&small, "small", 256), OK);
    assert_int_equal(sidecar_parse(&(struct sidecar_bytes){"f", text, n}, 0, &small, &s),
                     ERR_NOMEM);
    arena_free(&small);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_written_is_read_bit_for_bit),
        cmocka_unit_test(without_a_sidecar_colours_are_srgb),
        cmocka_unit_test(files_of_others_are_left_alone),
        cmocka_unit_test(the_path_is_that_of_the_splats),
        cmocka_unit_test(what_cannot_be_read_is_not_written),
        cmocka_unit_test(hostile_files_are_refused),
        cmocka_unit_test(cameras_are_counted_before_memory_is_asked_for),
        cmocka_unit_test(every_cut_is_refused),
    };
    tmpdir_make();
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    arena_free(&arena);
    tmpdir_remove();
    return failed;
}
