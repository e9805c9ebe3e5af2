#include "drivers/format/scenefile.h"

#include "core/base/bytes.h"
#include "core/base/gaussians.h"
#include "core/photo/tonemap.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static struct arena arena;

/* Every number different and awkward. */
static struct scene make(int n, int degree, int n_views)
{
    static char names[8][NAME_CAP];
    static float log2t[8];
    static struct camera cams[8];
    struct scene s = {.background = {0, 0.1f, 3e7f},
                      .n_views = n_views,
                      .size = 56,
                      .names = names,
                      .log2t = log2t,
                      .cams = cams};
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", 1 << 20), OK);
    assert_int_equal(gaussians_init(&s.g, &arena, n, degree), OK);
    s.g.n = n;
    if (degree % 2) {
        assert_int_equal(arena_alloc(&arena, (size_t)n, sizeof(float), &s.confidence), OK);
        for (int i = 0; i < n; i++)
            s.confidence[i] = (float)i / (float)n;
    }
    for (int p = 0; p < gaussians_planes(degree); p++)
        for (int i = 0; i < n; i++)
            s.g.plane[p][i] = (float)(i + 1) / (float)(p + 3) * (i % 2 ? -1.f : 1.f);
    for (int i = 0; i < TONE_PARAMS; i++)
        s.tone.p[i] = 1.f / (float)(i - 300.5f);
    s.tone.mid_log2t = -0.3f;
    for (int i = 0; i < n_views; i++) {
        snprintf(names[i], sizeof names[i], "view \"%d\" \\ \xc3\xa9.png", i);
        log2t[i] = 0.1f * (float)i - 3;
        cams[i] = (struct camera){56,
                                  56,
                                  50.1f,
                                  51.7f,
                                  28.3f,
                                  (float)i,
                                  {0.694912981f, 0.7071484f, -0.0930978648f, 0.0914870255f},
                                  {1e-40f, -1.f / 3, 1e30f}};
    }
    return s;
}

static void check_same(const struct scene *a, const struct scene *b)
{
    assert_true(a->g.n == b->g.n && a->g.degree == b->g.degree && a->n_views == b->n_views &&
                a->size == b->size);
    for (int p = 0; p < gaussians_planes(a->g.degree); p++)
        assert_memory_equal(a->g.plane[p], b->g.plane[p], sizeof(float) * (size_t)a->g.n);
    assert_memory_equal(&a->tone, &b->tone, sizeof a->tone);
    assert_memory_equal(a->background, b->background, sizeof a->background);
    assert_true(!a->confidence == !b->confidence);
    if (a->confidence)
        assert_memory_equal(a->confidence, b->confidence, sizeof(float) * (size_t)a->g.n);
    for (int i = 0; i < a->n_views; i++) {
        assert_string_equal(a->names[i], b->names[i]);
        assert_true(a->log2t[i] == b->log2t[i]);
        assert_memory_equal(&a->cams[i], &b->cams[i], sizeof a->cams[i]);
    }
}

static void what_is_written_is_read_bit_for_bit(void **state)
{
    (void)state;
    const char *path = tmpdir_path("scene.hdrig");
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree++) {
        for (int n = 0; n < 40; n += 13) {
            struct scene in = make(n, degree, n % 8), out;
            in.metres = degree == 2;
            struct scenefile_info info;
            struct arena exact;
            assert_int_equal(scenefile_write(path, &in), OK);
            assert_int_equal(scenefile_peek(path, &info), OK);
            assert_true(info.n == n && info.degree == degree && info.n_views == n % 8 &&
                        info.size == 56);
            assert_int_equal(arena_init(&exact, "exact", info.need), OK);
            assert_int_equal(scenefile_read(path, &exact, &out), OK);
            assert_true(exact.used == info.need);
            check_same(&in, &out);
            assert_true(in.metres == out.metres);
            arena_free(&exact);
        }
    }
}

static void what_cannot_be_written_leaves_no_file(void **state)
{
    (void)state;
    struct scene s = make(5, 1, 2);
    s.g.plane[G_SH + 2][3] = INFINITY;
    assert_int_equal(scenefile_write(tmpdir_path("bad.hdrig"), &s), ERR_ARG);
    assert_non_null(strstr(err_text(), "splat 3 of 5: plane 13"));
    assert_false(file_is_regular(tmpdir_path("bad.hdrig")));
    s.g.plane[G_SH + 2][3] = 0;
    assert_int_equal(scenefile_write("/dev/full", &s), ERR_LIMIT);
}

/* A small written scene in memory. */
static struct file_map written(void)
{
    struct scene s = make(3, 0, 2);
    struct file_map m;
    assert_int_equal(scenefile_write(tmpdir_path("small.hdrig"), &s), OK);
    assert_int_equal(file_map(tmpdir_path("small.hdrig"), 1 << 20, &m), OK);
    return m;
}

static err_t parse(const void *p, size_t n)
{
    struct scene s;
    struct arena room;
    assert_int_equal(arena_init(&room, "room", 1 << 16), OK);
    err_t e = scenefile_parse(&(struct scenefile_bytes){"f", p, n}, &room, &s);
    if (e)
        assert_true(room.used == 0 && s.g.n == 0 && s.names == NULL);
    arena_free(&room);
    return e;
}

static void every_cut_and_every_extra_byte_is_refused(void **state)
{
    (void)state;
    struct file_map m = written();
    char *copy = calloc(m.n + 2, 1);
    assert_int_equal(parse(m.p, m.n), OK);
    for (size_t n = 0; n < m.n; n++) {
        char *cut = malloc(n + 1); // exact length, for the address sanitiser
        memcpy(cut + 1, m.p, n);
        assert_int_equal(parse(cut + 1, n), ERR_FORMAT);
        free(cut);
    }
    memcpy(copy, m.p, m.n);
    assert_int_equal(parse(copy, m.n + 1), ERR_FORMAT);
    free(copy);
    file_unmap(&m);
}

/* The small scene with the first `from` of its header replaced by `to`. */
static err_t parse_changed(const char *from, const char *to)
{
    struct file_map m = written();
    uint8_t *out = malloc(m.n + strlen(to) + 8);
    const uint8_t *at = memmem(m.p, m.n, from, strlen(from));
    assert_non_null(at);
    size_t before = (size_t)(at - m.p), rest = m.n - before - strlen(from);
    memcpy(out, m.p, before);
    memcpy(out + before, to, strlen(to));
    memcpy(out + before + strlen(to), at + strlen(from), rest);
    struct bytes b = bytes_of(m.p, m.n);
    bytes_put_u64(out, bytes_u64(&b) - strlen(from) + strlen(to));
    err_t e = parse(out, before + strlen(to) + rest);
    free(out);
    file_unmap(&m);
    return e;
}

static void hostile_headers_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *from, *to, *sentence;
        err_t code;
    } wrong[] = {
        {"hdrig-scene", "pytorch", "pytorch", ERR_FORMAT},
        {"\"version\":\"1\"", "\"version\":\"2\"", "version \"2\"", ERR_UNSUPPORTED},
        {"\"size\":\"56\"", "\"size\":\"0\"", "size \"0\"", ERR_FORMAT},
        {"\"size\":\"56\"", "\"size\":\"56x\"", "size \"56x\"", ERR_FORMAT},
        {"\"size\":\"56\"", "\"size\":56", "size", ERR_FORMAT},
        {"\"quat\"", "\"quatt\"", "quatt", ERR_FORMAT},
        {"\"quat\"", "\"mu\"", "mu is there twice", ERR_FORMAT},
        {"\"F32\"", "\"I32\"", "mu is not F32", ERR_FORMAT},
        {"\"F32\"", "\"F16\"", "its shape needs 18", ERR_FORMAT},
        {"\"F32\"", "\"F31\"", "unknown type F31", ERR_FORMAT},
        {"\"F32\"", "\"F32\",\"dtype\":\"F16\"", "mu has other members", ERR_FORMAT},
        {"\"shape\":[3,3]", "\"shape\":[3,4]", "its shape needs 48", ERR_FORMAT},
        {"\"shape\":[3,3]", "\"shape\":[1,9]", "extent 0 is 1", ERR_FORMAT},
        {"\"shape\":[3,3]", "\"shape\":[3,3,1]", "has 3 extents", ERR_FORMAT},
        {"\"shape\":[3,3]", "\"shape\":[3,-3]", "whole number", ERR_FORMAT},
        {"\"shape\":[3,3]", "\"shape\":[3,3.5]", "whole number", ERR_FORMAT},
        {"\"shape\":[3,3]", "\"shape\":[3,5e15]", "up to 2^52", ERR_FORMAT},
        {"\"shape\":[3,3]", "\"shape\":[4e15,4e15]", "overflows", ERR_FORMAT},
        {"\"shape\":[3,3]", "\"shape\":[1,1,1,1,1,1,1,3,3]", "list of up to 8", ERR_FORMAT},
        {"\"shape\":[1,3,3]", "\"shape\":[3,1,3]", "3 harmonics", ERR_FORMAT},
        {"\"data_offsets\":[0,36]", "\"data_offsets\":[36,0]", "from 36 to 0", ERR_FORMAT},
        {"\"data_offsets\":[0,36]", "\"data_offsets\":[0,32]", "needs 36", ERR_FORMAT},
        {"\"data_offsets\":[0,36]", "\"data_offsets\":[99999964,100000000]", "from 99999964",
         ERR_FORMAT},
        {"\"data_offsets\":[0,36]", "\"data_offsets\":[36,72]", "overlap or hole", ERR_FORMAT},
        {"\"data_offsets\":[36,72]", "\"data_offsets\":[0,36]", "overlap or hole", ERR_FORMAT},
        {"\"names\":\"[", "\"names\":\"[1,", "not a list of 2", ERR_FORMAT},
        {"\"names\":\"[", "\"names\":\"", "not JSON", ERR_FORMAT},
        {"\"names\"", "\"name\"", "not JSON", ERR_FORMAT},
        {"view \\\\\\\"1", "view \\\\\\\"0", "there twice", ERR_FORMAT},
        {"view \\\\\\\"1", "view /\\\\\\\"1", "slashes", ERR_FORMAT},
        {"{\"__meta", "[\"__meta", "not JSON", ERR_FORMAT},
    };
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        assert_int_equal(parse_changed(wrong[i].from, wrong[i].to), wrong[i].code);
        assert_non_null(strstr(err_text(), wrong[i].sentence));
    }
    assert_int_equal(parse_changed("{\"__meta", "{ \"__meta"), OK); // the change itself is sound
}

/* The small scene with one float of its data replaced; `at` counts from the end if negative. */
static err_t parse_float(long at, float v)
{
    struct file_map m = written();
    struct bytes b = bytes_of(m.p, m.n);
    size_t data = 8 + bytes_u64(&b);
    uint8_t *copy = malloc(m.n);
    memcpy(copy, m.p, m.n);
    bytes_put_f32(copy + (at < 0 ? (long)m.n : (long)data) + 4 * at, v);
    err_t e = parse(copy, m.n);
    free(copy);
    file_unmap(&m);
    return e;
}

static void numbers_are_checked(void **state)
{
    (void)state;
    enum {
        TONE = 3 * (11 + 3),
        MID = TONE + TONE_PARAMS,
        BACKGROUND = MID + 1,
        LOG2T = BACKGROUND + 3
    };
    assert_int_equal(parse_float(0, NAN), ERR_FORMAT);
    assert_int_equal(parse_float(TONE - 1, INFINITY), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "1 of 3 splats"));
    assert_int_equal(parse_float(MID - 1, NAN), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "tone parameter 578"));
    assert_int_equal(parse_float(MID, NAN), ERR_FORMAT);
    assert_int_equal(parse_float(BACKGROUND + 1, -1), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "background 1"));
    assert_int_equal(parse_float(LOG2T + 1, INFINITY), ERR_FORMAT);
    assert_int_equal(parse_float(-11, 0), ERR_FORMAT); // focal length of the last camera
    assert_non_null(strstr(err_text(), "view 1: focal"));
    assert_int_equal(parse_float(-7, 9), ERR_FORMAT);
    assert_int_equal(parse_float(G_LOG_SCALE * 3, 999), OK); // brought back, not refused
}

static void tone_json_says_what_the_curve_does(void **state)
{
    (void)state;
    struct tonemap tone;
    struct cJSON *doc;
    tonemap_linear(&tone, 0.5f, -20, 10, 1.25f);
    assert_int_equal(scenefile_write_tone(tmpdir_path("tone.json"), &tone), OK);
    assert_int_equal(json_read(tmpdir_path("tone.json"), &doc), OK);
    double v, x, shown;
    assert_true(json_number(json_member(doc, "mid_log2t"), &v) && v == 1.25);
    int c = 0;
    for (const struct cJSON *m = json_first(json_member(doc, "curves")); m; m = json_next(m), c++) {
        static const char *const keys[3] = {"w1", "b1", "w2"};
        const float *p = tone.p + c * TONE_PER_COLOUR;
        for (int k = 0; k < 3; k++)
            for (const struct cJSON *w = json_first(json_member(m, keys[k])); w; w = json_next(w))
                assert_true(json_number(w, &v) && (float)v == *p++);
        assert_true(json_number(json_member(m, "b2"), &v) && (float)v == *p++);
        assert_ptr_equal(p, tone.p + (c + 1) * TONE_PER_COLOUR);
    }
    assert_int_equal(c, 3);
    const struct cJSON *samples = json_member(doc, "samples");
    assert_int_equal(json_count(samples), 49);
    for (const struct cJSON *m = json_first(samples); m; m = json_next(m)) {
        assert_true(json_number(json_member(m, "log2_exposure_relative"), &x));
        assert_true(json_number(json_next(json_first(json_member(m, "rgb"))), &shown));
        assert_true(fabs(shown - 1 / (1 + exp(-0.5 * x))) < 1e-5);
    }
    json_free(doc);
    assert_int_equal(scenefile_write_tone("/dev/full", &tone), ERR_LIMIT);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_written_is_read_bit_for_bit),
        cmocka_unit_test(what_cannot_be_written_leaves_no_file),
        cmocka_unit_test(every_cut_and_every_extra_byte_is_refused),
        cmocka_unit_test(hostile_headers_are_refused),
        cmocka_unit_test(numbers_are_checked),
        cmocka_unit_test(tone_json_says_what_the_curve_does),
    };
    tmpdir_make();
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    arena_free(&arena);
    tmpdir_remove();
    return failed;
}
