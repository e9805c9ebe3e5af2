#include "drivers/format/glb.h"

#include "core/base/bytes.h"
#include "core/base/rotation.h"
#include "core/splat/display.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"

#include "tests/unit/tmpdir.h"

#include <fcntl.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#define C0 0.28209479177387814

static struct arena arena;
static unsigned seed;

/* -1 to 1. */
static float noise(void)
{
    seed = seed * 1664525u + 1013904223u;
    return (float)((int)(seed >> 8) - (1 << 23)) / (1 << 23);
}

static struct scene make(int n, int degree)
{
    struct scene s = {0};
    seed = 7;
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", 4 << 20), OK);
    assert_int_equal(gaussians_init(&s.g, &arena, n, degree), OK);
    s.g.n = n;
    display_tonemap(0.5f, &s.tone);
    for (int i = 0; i < n; i++)
        for (int p = 0; p < gaussians_planes(degree); p++)
            s.g.plane[p][i] = 4 * noise();
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 4; k++)
            s.g.plane[G_QUAT + k][i] = k == i % 4 ? 1 : 0;
    return s;
}

static void what_is_written_is_read(void **state)
{
    (void)state;
    const char *path = tmpdir_path("scene.glb");
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree++) {
        struct scene s = make(2100, degree); // more than one batch
        struct gaussians g;
        struct gaussians_report report;
        struct splats_info info;
        assert_int_equal(glb_write(path, &s), OK);
        assert_int_equal(splats_peek(&glb_format, path, &info), OK);
        assert_true(info.n == 2100 && info.degree == degree && info.has_hdr);
        assert_true(info.ev == display_ev(&s.tone));
        assert_int_equal(splats_read(&glb_format, path, 9, &arena, &g, &report), OK);
        assert_true(g.n == 2100 && g.degree == degree && !report.dropped && !report.repaired);
        for (int p = 0; p < gaussians_planes(degree); p++) {
            bool rounded = (p >= G_LOG_SCALE && p < G_QUAT) || p == G_LOGIT;
            for (int i = 0; i < g.n; i++)
                assert_true(fabsf(s.g.plane[p][i] - g.plane[p][i]) <= (rounded ? 1e-5f : 0));
        }
    }
}

/* As written before names of our attributes began as glTF wants it. */
static void the_names_of_version_1_are_read(void **state)
{
    (void)state;
    const char *path = tmpdir_path("named.glb");
    struct scene s = make(3, 2);
    struct file_map m;
    struct gaussians g;
    struct gaussians_report report;
    int names = 0;
    assert_int_equal(glb_write(path, &s), OK);
    assert_int_equal(file_map(path, 1 << 20, &m), OK);
    char *copy = malloc(m.n), *at;
    memcpy(copy, m.p, m.n);
    while ((at = memmem(copy, m.n, "\"_HDRIG_", 8))) {
        memcpy(at, " \"HDRIG_", 8);
        names++;
    }
    assert_int_equal(names, 9);
    assert_non_null(at = memmem(copy, m.n, "{\"version\":2,", 13));
    at[11] = '1';
    const struct splats_bytes file = {"old.glb", copy, m.n};
    assert_int_equal(glb_format.parse(&file, 0, &arena, &g, &report), OK);
    for (int p = G_SH; p < gaussians_planes(2); p++)
        assert_memory_equal(g.plane[p], s.g.plane[p], 3 * sizeof(float));
    at[11] = '3';
    assert_int_equal(glb_format.parse(&file, 0, &arena, &g, &report), ERR_UNSUPPORTED);
    free(copy);
    file_unmap(&m);
}

/* ---- files of others ---- */

static uint8_t file[8192];

/* A GLB of this JSON and binary chunk. */
static struct splats_bytes build(const char *json, const void *bin, size_t n)
{
    size_t m = strlen(json);
    uint8_t *b = bytes_put_u32(file, 0x46546c67);
    assert_true(m + n + 28 <= sizeof file);
    b = bytes_put_u32(b, 2);
    b = bytes_put_u32(b, (uint32_t)(28 + m + n));
    b = bytes_put_u32(b, (uint32_t)m);
    b = bytes_put_u32(b, 0x4e4f534a);
    memcpy(b, json, m);
    b = bytes_put_u32(b + m, (uint32_t)n);
    b = bytes_put_u32(b, 0x004e4942);
    if (n > 0)
        memcpy(b, bin, n);
    return (struct splats_bytes){"built.glb", file, 28 + m + n};
}

/* Two splats in one interleaved view of small numbers, positions and colours in others. */
static const char small[] =
    "{\"extensionsRequired\":[\"KHR_gaussian_splatting\"],\"nodes\":[{\"mesh\":0}],"
    "\"meshes\":[{\"primitives\":[{\"mode\":0,\"attributes\":{\"POSITION\":0,"
    "\"KHR_gaussian_splatting:ROTATION\":1,\"KHR_gaussian_splatting:SCALE\":2,"
    "\"KHR_gaussian_splatting:OPACITY\":3,\"KHR_gaussian_splatting:SH_DEGREE_0_COEF_0\":4},"
    "\"extensions\":{\"KHR_gaussian_splatting\":{\"kernel\":\"ellipse\","
    "\"colorSpace\":\"srgb_rec709_display\"}}}]}],\"buffers\":[{\"byteLength\":72}],"
    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":24},"
    "{\"buffer\":0,\"byteOffset\":24,\"byteLength\":24,\"byteStride\":12},"
    "{\"buffer\":0,\"byteOffset\":48,\"byteLength\":24}],\"accessors\":["
    "{\"bufferView\":0,\"componentType\":5126,\"count\":2,\"type\":\"VEC3\"},"
    "{\"bufferView\":1,\"componentType\":5120,\"count\":2,\"type\":\"VEC4\",\"normalized\":true},"
    "{\"bufferView\":1,\"byteOffset\":4,\"componentType\":5121,\"count\":2,\"type\":\"VEC3\"},"
    "{\"bufferView\":1,\"byteOffset\":8,\"componentType\":5123,\"count\":2,\"type\":\"SCALAR\","
    "\"normalized\":true},"
    "{\"bufferView\":2,\"componentType\":5126,\"count\":2,\"type\":\"VEC3\"}]}";
static uint8_t small_bin[72];

static void fill_small(void)
{
    static const uint8_t middle[24] = {127,  0, 0,   0, 1,   2,    100, 0, 0x33, 0x33, 0, 0,
                                       0x80, 0, 129, 1, 255, 0xff, 1,   0, 0xff, 0xff, 0, 0};
    for (int i = 0; i < 6; i++) {
        bytes_put_f32(small_bin + 4 * i, (float)(i + 1));
        bytes_put_f32(small_bin + 48 + 4 * i, (float)(0.5 * (i - 2)));
    }
    memcpy(small_bin + 24, middle, sizeof middle);
}

static void assert_near(float a, double b)
{
    if (!(fabs((double)a - b) <= 2e-6 * fmax(1, fabs(b))))
        fail_msg("%.9g is not %.9g", (double)a, b);
}

static void numbers_of_any_type_are_understood(void **state)
{
    (void)state;
    struct gaussians g;
    struct gaussians_report report;
    struct splats_info info;
    fill_small();
    make(1, 0);
    struct splats_bytes f = build(small, small_bin, sizeof small_bin);
    assert_int_equal(glb_format.peek(&f, &info), OK);
    assert_true(info.n == 2 && info.degree == 0 && !info.has_hdr && info.ev == 0);
    assert_int_equal(glb_format.parse(&f, 0.5f, &arena, &g, &report), OK);
    assert_int_equal(g.n, 2);
    assert_near(g.plane[G_MU][0], -1); // left is right, up is down
    assert_near(g.plane[G_MU + 1][1], -5);
    assert_near(g.plane[G_MU + 2][1], 6);
    assert_near(g.plane[G_QUAT + 1][0], -1);
    assert_near(g.plane[G_QUAT + 1][1], 1); // -128 is -1 too
    assert_near(g.plane[G_QUAT + 3][1], -1);
    assert_near(g.plane[G_QUAT][1], 1 / 127.0);
    assert_near(g.plane[G_LOG_SCALE + 1][0], log(2));
    assert_near(g.plane[G_LOG_SCALE][1], log(255));
    assert_near(g.plane[G_LOGIT][0], log(0.2 / 0.8));
    assert_true(g.plane[G_LOGIT][1] > 15);
    float want[3];
    const float shown[3] = {-1, -0.5f, 0};
    display_to_radiance(shown, 0, 0.5f, want);
    for (int c = 0; c < 3; c++)
        assert_near(g.plane[G_SH + c][0], (double)want[c]);
}

/* `small` with the first `old` after `after` replaced. */
static const char *changed(const char *after, const char *old, const char *new)
{
    static char text[4096];
    const char *at = strstr(small, after);
    at = at ? strstr(at, old) : NULL;
    if (!at)
        fail_msg("no %s behind %s", old, after);
    snprintf(text, sizeof text, "%.*s%s%s", (int)(at - small), small, new, at + strlen(old));
    return text;
}

static void documents_that_lie_are_named(void **state)
{
    (void)state;
    static const struct {
        const char *after, *old, *new;
        err_t code;
        const char *word;
    } cases[] = {
        {"{", "Required\":[\"KHR_gaussian_splatting\"", "Required\":[\"KHR_x\"", ERR_UNSUPPORTED,
         "extensionsRequired: KHR_x"},
        {"{", "{\"mesh\":0}", "{\"mesh\":0,\"rotation\":[0,0,0,1]}", ERR_UNSUPPORTED,
         "a node has a rotation"},
        {"meshes", "\"mode\":0", "\"mode\":4", ERR_FORMAT, "mode 4"},
        {"meshes", "\"mode\":0,", "", ERR_FORMAT, "mode 4"},
        {"meshes", "ellipse", "sphere", ERR_UNSUPPORTED, "kernel \"sphere\""},
        {"meshes", "srgb_rec709_display", "lin_rec709_display", ERR_UNSUPPORTED, "colorSpace"},
        {"\"extensions\"", "KHR_gaussian_splatting", "KHR_other", ERR_FORMAT, "0 primitives"},
        {"POSITION", "POSITION\":0", "POSITION\":9", ERR_FORMAT, "no accessor 9"},
        {"POSITION", "POSITION\":0", "POSITION\":-1", ERR_FORMAT, "\"POSITION\" is"},
        {"POSITION", "POSITION\":0", "POSITION\":0.5", ERR_FORMAT, "\"POSITION\" is"},
        {"POSITION", ":OPACITY", ":OPACITX", ERR_FORMAT, "no attribute KHR_gaussian_splatting:OPA"},
        {"buffers", "\"byteLength\":72", "\"byteLength\":72,\"uri\":\"x\"", ERR_UNSUPPORTED,
         "buffer 0"},
        {"bufferViews", "\"byteLength\":24", "\"byteLength\":73", ERR_FORMAT, "bytes 0 to 73"},
        {"bufferViews", "\"byteLength\":24", "\"byteLength\":23", ERR_FORMAT, "leave bufferView 0"},
        {"bufferViews", "\"byteLength\":24", "\"byteLength\":1e99", ERR_FORMAT, "byteLength"},
        {"bufferViews", "\"byteOffset\":24", "\"byteOffset\":20", ERR_FORMAT,
         "bufferViews 1 and 0 overlap"},
        {"bufferViews", "\"byteOffset\":48", "\"byteOffset\":4294967295", ERR_FORMAT,
         "SH_DEGREE_0_COEF_0: bufferView 2"},
        {"bufferViews", "\"byteStride\":12", "\"byteStride\":2", ERR_FORMAT, "leave bufferView 1"},
        {"bufferViews", "\"byteStride\":12", "\"byteStride\":256", ERR_FORMAT, "stride 256"},
        {"bufferViews", "\"buffer\":0", "\"buffer\":1", ERR_FORMAT, "of buffer 1"},
        {"accessors", "5126", "5130", ERR_FORMAT, "POSITION: componentType 5130"},
        {"accessors", "5126", "5124", ERR_FORMAT, "POSITION: componentType 5124"},
        {"accessors", "VEC3", "VEC2", ERR_FORMAT, "type \"VEC2\", it must be VEC3"},
        {"accessors", "\"count\":2", "\"count\":0", ERR_FORMAT, "0 splats"},
        {"accessors", "\"count\":2", "\"count\":4294967295", ERR_FORMAT, "4294967295 splats"},
        {"accessors", "\"count\":2", "\"count\":16777216", ERR_FORMAT, "leave bufferView 0"},
        {"accessors", "\"count\":2", "\"count\":1", ERR_FORMAT, "2 splats, expected are 1"},
        {"accessors", "\"bufferView\":0,", "", ERR_FORMAT, "\"bufferView\" is missing"},
        {"accessors", "\"bufferView\":0", "\"bufferView\":7", ERR_FORMAT, "no bufferView 7"},
        {"accessors", "\"bufferView\":0", "\"sparse\":{},\"bufferView\":0", ERR_UNSUPPORTED,
         "sparse"},
        {"accessors", "\"byteOffset\":8", "\"byteOffset\":11", ERR_FORMAT, "leave bufferView 1"},
    };
    fill_small();
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const char *json = changed(cases[i].after, cases[i].old, cases[i].new);
        struct splats_bytes f = build(json, small_bin, sizeof small_bin);
        struct splats_info info;
        err_t e = glb_format.peek(&f, &info);
        if (e != cases[i].code || !strstr(err_text(), cases[i].word))
            fail_msg("case %zu: %d, \"%s\", not %d with \"%s\"", i, e, err_text(), cases[i].code,
                     cases[i].word);
    }
}

static void a_band_that_is_not_read_is_told(void **state)
{
    (void)state;
    struct splats_info info;
    fill_small();
    struct splats_bytes f = build(small, small_bin, sizeof small_bin);
    assert_int_equal(glb_format.peek(&f, &info), OK);
    assert_false(info.band_lost);
    const char *json =
        changed("OPACITY", ":3", ":3,\"KHR_gaussian_splatting:SH_DEGREE_4_COEF_0\":4");
    f = build(json, small_bin, sizeof small_bin);
    assert_int_equal(glb_format.peek(&f, &info), OK);
    assert_true(info.band_lost && info.degree == 0);
}

static void numbers_that_are_none_do_not_come_in(void **state)
{
    (void)state;
    struct gaussians g;
    struct gaussians_report report;
    fill_small();
    bytes_put_f32(small_bin + 4, NAN);
    make(1, 0);
    struct splats_bytes f = build(small, small_bin, sizeof small_bin);
    assert_int_equal(glb_format.parse(&f, 0, &arena, &g, &report), OK);
    assert_true(g.n == 1 && report.dropped == 1);
    const char *json = changed("\"byteOffset\":4,", "5121", "5120"); // scales as signed bytes
    fill_small();
    f = build(json, small_bin, sizeof small_bin);
    assert_int_equal(glb_format.parse(&f, 0, &arena, &g, &report), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "SCALE of splat 1 is -1: negative"));
    assert_true(g.n == 0 && g.plane[0] == NULL);
}

static void chunks_that_lie_are_named(void **state)
{
    (void)state;
    static const struct {
        size_t at;
        uint32_t value;
        err_t code;
        const char *word;
    } cases[] = {{0, 0, ERR_FORMAT, "not a binary glTF"}, {4, 1, ERR_UNSUPPORTED, "version 1"},
                 {8, 19, ERR_FORMAT, "says 19 bytes"},    {8, 8000, ERR_FORMAT, "says 8000"},
                 {12, 8000, ERR_FORMAT, "of 8000 bytes"}, {16, 0x004e4942, ERR_FORMAT, "no JSON"},
                 {12, 3, ERR_FORMAT, "binary chunk"}};
    struct splats_info info;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct splats_bytes f = build(small, small_bin, sizeof small_bin);
        bytes_put_u32(file + cases[i].at, cases[i].value);
        assert_int_equal(glb_format.peek(&f, &info), cases[i].code);
        if (!strstr(err_text(), cases[i].word))
            fail_msg("\"%s\" without \"%s\"", err_text(), cases[i].word);
    }
    struct splats_bytes f = build(small, small_bin, sizeof small_bin);
    for (f.n = 0; f.n < sizeof small - 1 + sizeof small_bin + 28; f.n += 7)
        assert_int_equal(glb_format.peek(&f, &info), ERR_FORMAT);
}

static void what_cannot_be_written_says_why(void **state)
{
    (void)state;
    const char *path = tmpdir_path("none.glb");
    struct scene s = make(3, 0);
    s.g.plane[G_SH + 1][2] = INFINITY;
    assert_int_equal(glb_write(path, &s), ERR_ARG);
    assert_non_null(strstr(err_text(), "splat 2 of 3: plane 12"));
    s = make(3, 0);
    assert_int_equal(glb_write("/dev/full", &s), ERR_LIMIT);
    assert_non_null(strstr(err_text(), "No space left"));
    s.g.n = 0;
    assert_int_equal(glb_write(path, &s), ERR_ARG);
    assert_false(file_is_regular(path));
}

/* A pipe takes no second look at what was written. */
static void a_place_without_seeking_is_refused(void **state)
{
    (void)state;
    const char *path = tmpdir_path("pipe.glb");
    struct scene s = make(3, 0);
    assert_int_equal(mkfifo(path, 0600), 0);
    int fd = open(path, O_RDONLY | O_NONBLOCK);
    assert_true(fd >= 0);
    assert_int_equal(glb_write(path, &s), ERR_IO);
    assert_non_null(strstr(err_text(), "pipe.glb: writing failed: Illegal seek"));
    close(fd);
}

/* Straight to the text that other programs see. */
static void points_have_linear_colours_and_bounds(void **state)
{
    (void)state;
    struct scene s = make(2, 0);
    struct file_map m;
    for (int c = 0; c < 3; c++)
        s.g.plane[G_SH + c][0] = (float)((log(0.25) - 0.5 * log(2)) / C0); // 0.25 at ev 0.5
    s.g.plane[G_MU][0] = -3;
    s.g.plane[G_MU][1] = 2;
    display_tonemap(0.5f, &s.tone);
    float ev = display_ev(&s.tone);
    assert_int_equal(glb_write(tmpdir_path("points.glb"), &s), OK);
    assert_int_equal(file_map(tmpdir_path("points.glb"), sizeof file, &m), OK);
    assert_non_null(memmem(m.p, m.n, "\"min\":[-2,", 10));
    assert_non_null(memmem(m.p, m.n, "\"max\":[3,", 9));
    struct bytes b = bytes_of(m.p + m.n - 16, 2); // COLOR_0 comes last
    assert_true(fabs(bytes_u16(&b) / 65535.0 - 0.25 * exp2((double)ev - 0.5)) <= 1 / 65535.0);
    file_unmap(&m);
}

static void read_numbers(const struct cJSON *node, const char *key, int n, double out[])
{
    const struct cJSON *v = json_first(json_member(node, key));
    for (int k = 0; k < n; k++, v = json_next(v))
        assert_true(json_number(v, &out[k]));
}

/* Where the vector v of glTF's camera points, in axes right, down, forward. */
static void camera_vector(const double q[4], const double v[3], double out[3])
{
    double t[3], u[3];
    for (int k = 0; k < 3; k++) // 2 q x v
        t[k] = 2 * (q[(k + 1) % 3] * v[(k + 2) % 3] - q[(k + 2) % 3] * v[(k + 1) % 3]);
    for (int k = 0; k < 3; k++)
        u[k] =
            v[k] + q[3] * t[k] + q[(k + 1) % 3] * t[(k + 2) % 3] - q[(k + 2) % 3] * t[(k + 1) % 3];
    for (int k = 0; k < 3; k++)
        out[k] = k < 2 ? -u[k] : u[k];
}

/* Viewers begin where the first photograph was taken. */
static void the_first_view_is_a_camera(void **state)
{
    (void)state;
    struct camera cam = {64, 48, 60, 60, 32, 24, {0.8f, 0.1f, -0.5f, 0.3f}, {1, 2, 3}};
    char name[NAME_CAP] = "a \"view\"";
    struct scene s = make(2, 0);
    struct file_map m;
    struct cJSON *json;
    double q[4], at[3], r[9], centre[3], v[3], fov;
    s.n_views = 1;
    s.cams = &cam;
    s.names = &name;
    assert_int_equal(glb_write(tmpdir_path("camera.glb"), &s), OK);
    assert_int_equal(file_map(tmpdir_path("camera.glb"), sizeof file, &m), OK);
    struct bytes b = bytes_of(m.p + 12, 4);
    assert_int_equal(json_parse("camera.glb", m.p + 20, bytes_u32(&b), &json), OK);
    const struct cJSON *node = json_next(json_first(json_member(json, "nodes")));
    const struct cJSON *lens = json_member(json_first(json_member(json, "cameras")), "perspective");
    read_numbers(node, "translation", 3, at);
    read_numbers(node, "rotation", 4, q);
    rotation_of_camera(&cam, r);
    rotation_centre(&cam, centre);
    for (int axis = 0; axis < 3; axis++) {
        const double own[3] = {axis == 0, axis == 1 ? -1 : 0, axis == 2 ? -1 : 0};
        camera_vector(q, own, v);
        for (int k = 0; k < 3; k++)
            assert_near((float)v[k], r[3 * axis + k]);
        assert_near((float)(axis < 2 ? -at[axis] : at[axis]), centre[axis]);
    }
    assert_true(json_number(json_member(lens, "yfov"), &fov));
    assert_near((float)tan(fov / 2), 0.4);
    assert_string_equal(json_string(json_member(node, "name")), name);
    json_free(json);
    file_unmap(&m);
    struct splats_info info;
    assert_int_equal(splats_peek(&glb_format, tmpdir_path("camera.glb"), &info), OK);
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
        cmocka_unit_test(what_is_written_is_read),
        cmocka_unit_test(the_names_of_version_1_are_read),
        cmocka_unit_test(numbers_of_any_type_are_understood),
        cmocka_unit_test(documents_that_lie_are_named),
        cmocka_unit_test(a_band_that_is_not_read_is_told),
        cmocka_unit_test(numbers_that_are_none_do_not_come_in),
        cmocka_unit_test(chunks_that_lie_are_named),
        cmocka_unit_test(points_have_linear_colours_and_bounds),
        cmocka_unit_test(the_first_view_is_a_camera),
        cmocka_unit_test(what_cannot_be_written_says_why),
        cmocka_unit_test(a_place_without_seeking_is_refused),
    };
    return cmocka_run_group_tests(tests, tmpdir_setup, remove_folder);
}
