/* The page of a scene, read back: what the browser gets is what the scene holds, within the bounds
 * that viewer.c states. Its pictures are tested in tests/e2e/view.sh. */
#include "core/base/gaussians.h"
#include "core/base/half.h"
#include "core/photo/tonemap.h"
#include "core/splat/display.h"
#include "drivers/format/compressed.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"
#include "drivers/format/json.h"
#include "firmware/result/viewer.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/resource.h>

#include <cmocka.h>

enum { SPLATS = 300, DEGREE = 4, SIZE = 24, VIEWS = 2, SPLAT_BYTES = 32, FRAME_MAX = 90000 };

static const double sh_c0 = 0.28209479177387814;

static struct arena arena;
static struct scene scene;
static char names[VIEWS][NAME_CAP];
static float log2t[VIEWS];
static struct camera cams[VIEWS];

/* Of the second place there are two photographs. */
static uint8_t pixels[(VIEWS + 1) * SIZE * SIZE * 3];
static struct extent extent[VIEWS + 1];
static float taken_log2t[VIEWS + 1];
static struct views photos = {.n = VIEWS,
                              .n_more = 1,
                              .extent = extent,
                              .rgb = pixels,
                              .log2t = taken_log2t,
                              .place = (int[]){1}};
static struct viewer_input input;

/* The page in memory and its parts. */
static char *page;
static size_t page_bytes;
static struct cJSON *info;
static uint8_t *blob;
static size_t blob_bytes, info_chars, blob_chars;

/* Fields of the smaller kind of page, read as pagepack.h describes them. */
static struct {
    struct compressed_in in;
    uint8_t *plane;
    int n;
    int32_t *v; // of the field that was read last
} fields;

static double uniform(double lo, double hi)
{
    return lo + (hi - lo) * rand() / RAND_MAX;
}

static void random_splat(struct gaussians *g, int i)
{
    for (int p = 0; p < gaussians_planes(g->degree); p++)
        g->plane[p][i] = (float)uniform(-1, 1);
    for (int k = 0; k < 3; k++) {
        g->plane[G_LOG_SCALE + k][i] = (float)uniform(-9, 0);
        g->plane[G_SH + k][i] = (float)(uniform(log(1e-4), log(1e5)) / sh_c0);
    }
    g->plane[G_LOGIT][i] = (float)uniform(-5, 20);
}

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    srand(1);
    memset(&scene, 0, sizeof scene);
    if (arena_init(&arena, "scene", gaussians_need(SPLATS, DEGREE)) != OK ||
        gaussians_init(&scene.g, &arena, SPLATS, DEGREE) != OK)
        return -1;
    scene.g.n = SPLATS;
    for (int i = 0; i < SPLATS; i++)
        random_splat(&scene.g, i);
    tonemap_linear(&scene.tone, 1, -10, 10, -3);
    for (int i = 0; i < VIEWS; i++) {
        snprintf(names[i], NAME_CAP, "view%d.jpg", i);
        log2t[i] = (float)(2 * i - 4);
        cams[i] = (struct camera){SIZE, SIZE, 20, 21, 12, 13, {0.8f, 0, 0.6f, 0}, {1, 2, 3}};
    }
    photos.names = calloc(VIEWS + 1, sizeof *photos.names);
    for (int i = 0; i <= VIEWS; i++) {
        extent[i] = (struct extent){SIZE, SIZE, (size_t)i * SIZE * SIZE};
        memset(pixels + 3 * extent[i].at, 100 + 20 * i, 3 * SIZE * SIZE);
        taken_log2t[i] = i < VIEWS ? log2t[i] : 1.5f;
    }
    scene.n_views = VIEWS;
    scene.size = SIZE;
    scene.names = names;
    scene.log2t = log2t;
    scene.cams = cams;
    input = (struct viewer_input){.scene = &scene,
                                  .photos = &photos,
                                  .title = "a scene",
                                  .report = "report.html",
                                  .lossless = true};
    page = NULL;
    blob = NULL;
    info = NULL;
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    json_free(info);
    free(page);
    free(blob);
    free(photos.names);
    free(fields.plane);
    free(fields.v);
    fields.plane = NULL;
    fields.v = NULL;
    arena_free(&arena);
    tmpdir_remove();
    return 0;
}

static size_t decode(const char *text, size_t n, uint8_t *out)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    uint8_t *start = out;
    for (size_t i = 0; i < n; i += 4) {
        uint32_t v = 0;
        int bytes = 3;
        for (size_t k = 0; k < 4; k++) {
            const char *at = strchr(digits, text[i + k]);
            assert_true(at || text[i + k] == '=');
            bytes -= !at;
            v = v << 6 | (uint32_t)(at ? at - digits : 0);
        }
        for (int k = 0; k < bytes; k++)
            *out++ = (uint8_t)(v >> (16 - 8 * k));
    }
    return (size_t)(out - start);
}

/* The text between `open` and the end of its script. */
static const char *part(const char *open, size_t *n)
{
    const char *at = strstr(page, open);
    assert_non_null(at);
    at += strlen(open);
    *n = (size_t)(strstr(at, "</script>") - at);
    return at;
}

static void make_page(void)
{
    struct file_map map;
    const char *path = tmpdir_path("view.html");
    json_free(info);
    free(page);
    free(blob);
    info = NULL;
    assert_int_equal(viewer_write(path, &input), OK);
    assert_int_equal(file_map(path, SIZE_MAX / 2, &map), OK);
    page_bytes = map.n;
    page = calloc(1, map.n + 1);
    memcpy(page, map.p, map.n);
    file_unmap(&map);
    const char *text = part("<script id=\"info\" type=\"application/json\">", &info_chars);
    assert_int_equal(json_parse("info", text, info_chars, &info), OK);
    text = part("<script id=\"scene\" type=\"application/octet-stream\">", &blob_chars);
    blob = malloc(blob_chars + 1);
    blob_bytes = decode(text, blob_chars, blob);
}

static double number(const char *key)
{
    double v = NAN;
    assert_true(json_number(json_member(info, key), &v));
    return v;
}

static double stored(const char *range, int i, size_t at)
{
    const struct cJSON *lo = json_first(json_member(info, range)), *step = json_next(lo);
    double a = NAN, b = NAN;
    assert_true(json_number(lo, &a) && json_number(step, &b));
    const uint8_t *p = blob + (size_t)i * SPLAT_BYTES + at;
    return a + b * (p[0] | p[1] << 8);
}

/* The quaternion of splat i as the page's shader unpacks it. */
static void unpack_quat(int i, double q[4])
{
    const uint8_t *p = blob + (size_t)i * SPLAT_BYTES + 20;
    double sum = 0, v[3];
    unsigned u[3];
    for (int k = 0; k < 3; k++) {
        u[k] = p[2 * k] | (unsigned)p[2 * k + 1] << 8;
        v[k] = ((u[k] & 0x7fff) / 16383.0 - 1) * sqrt(0.5);
        sum += v[k] * v[k];
    }
    int largest = (int)(u[0] >> 15 | u[1] >> 15 << 1), n = 0;
    for (int k = 0; k < 4; k++)
        q[k] = k == largest ? sqrt(1 - sum) : v[n++];
}

static void splats_come_back(void **state)
{
    (void)state;
    const struct gaussians *g = &scene.g;
    const size_t halves = 3 * ((DEGREE + 1) * (DEGREE + 1) - 1);
    make_page();
    assert_int_equal((int)number("n"), SPLATS);
    assert_int_equal(blob_bytes, SPLATS * (SPLAT_BYTES + 2 * halves)); // 72 halves: 9 x 16 bytes
    for (int i = 0; i < SPLATS; i++) {
        const uint8_t *p = blob + (size_t)i * SPLAT_BYTES;
        for (int k = 0; k < 3; k++) {
            float mu;
            memcpy(&mu, p + 4 * k, 4);
            assert_true(mu == g->plane[G_MU + k][i]);
            size_t at = 2 * (size_t)k;
            double scale = stored("scale", i, 12 + at) - (double)g->plane[G_LOG_SCALE + k][i];
            double light = stored("light", i, 26 + at) - sh_c0 * (double)g->plane[G_SH + k][i];
            assert_true(fabs(scale) < 1e-4 && fabs(light) < 2e-4);
        }
        double logit = fmin((double)g->plane[G_LOGIT][i], 12), q[4], dot = 0, length = 0;
        assert_true(fabs(stored("logit", i, 18) - logit) < 2e-4);
        unpack_quat(i, q);
        for (int k = 0; k < 4; k++) {
            dot += q[k] * (double)g->plane[G_QUAT + k][i];
            length += pow((double)g->plane[G_QUAT + k][i], 2);
        }
        assert_true(dot / sqrt(length) > 1 - 1e-8 || dot / sqrt(length) < -1 + 1e-8);
        const uint8_t *sh = blob + SPLATS * SPLAT_BYTES + (size_t)i * 2 * halves;
        for (size_t j = 0; j < halves; j++)
            assert_int_equal(sh[2 * j] | sh[2 * j + 1] << 8,
                             half_from_float(g->plane[(size_t)G_SH + 3 + j][i]));
    }
}

/* ---- the smaller kind ---- */

static double packed_number(const char *key, int k)
{
    double v = NAN;
    const struct cJSON *node = json_member(json_member(info, "packed"), key);
    if (json_is_array(node))
        for (node = json_first(node); k > 0; k--)
            node = json_next(node);
    assert_true(json_number(node, &v));
    return v;
}

/* The first splats, or those behind them. */
static void open_fields(bool rest)
{
    const int first = (int)packed_number("first", 0);
    if (rest) {
        size_t n;
        const char *text = part("<script id=\"rest\" type=\"application/octet-stream\">", &n);
        blob = realloc(blob, n + 1);
        blob_bytes = decode(text, n, blob);
    }
    assert_int_equal((int)packed_number("bytes", rest), blob_bytes);
    fields.n = rest ? (int)number("n") - first : first;
    fields.plane = realloc(fields.plane, (size_t)fields.n + 1);
    fields.v = realloc(fields.v, (size_t)fields.n * sizeof *fields.v + 1);
    assert_int_equal(compressed_open(&fields.in, "page", COMPRESSED_GZIP, blob, blob_bytes), OK);
}

static void close_fields(void)
{
    assert_int_equal(compressed_finish(&fields.in, "scene"), OK);
    compressed_close(&fields.in);
}

static void read_field(int bytes, bool signs)
{
    for (int b = 0; b < bytes; b++) {
        assert_int_equal(compressed_read(&fields.in, "scene", fields.plane, (size_t)fields.n), OK);
        for (int i = 0; i < fields.n; i++)
            fields.v[i] = (b ? fields.v[i] : 0) | fields.plane[i] << (8 * b);
    }
    for (int i = 0; i < fields.n && signs; i++)
        fields.v[i] = fields.v[i] % 2 ? -(fields.v[i] + 1) / 2 : fields.v[i] / 2;
}

static double step_of(const char *range, double *lo)
{
    const struct cJSON *first = json_first(json_member(info, range));
    double step = NAN;
    assert_true(json_number(first, lo) && json_number(json_next(first), &step));
    return step;
}

/* Positions come first: which splat of the scene stands at place i. */
static void match_positions(int match[SPLATS])
{
    static double mu[3][SPLATS];
    bool taken[SPLATS] = {false};
    const double reach = packed_number("reach", 0), step = packed_number("step", 0);
    for (int k = 0; k < 3; k++) {
        double at = packed_number("low", k);
        read_field(3, true);
        for (int i = 0; i < SPLATS; i++) {
            at += fields.v[i];
            mu[k][i] = packed_number("at", k) + reach * sinh(at * step);
        }
    }
    for (int i = 0; i < SPLATS; i++) {
        double best = INFINITY, far = 0;
        for (int j = 0; j < SPLATS; j++) {
            double away = 0;
            for (int k = 0; k < 3; k++)
                away += pow(mu[k][i] - (double)scene.g.plane[G_MU + k][j], 2);
            if (away < best)
                match[i] = j;
            best = fmin(best, away);
        }
        for (int k = 0; k < 3; k++)
            far = fmax(far, fabs(mu[k][i] - packed_number("at", k)));
        assert_true(sqrt(best) <= 0.88 * step * hypot(far, reach)); // sqrt(3) / 2 steps
        assert_false(taken[match[i]]);
        taken[match[i]] = true;
    }
}

static void check_steps(const char *range, const int match[SPLATS], const float *want, double scale,
                        bool add)
{
    static int32_t before[SPLATS];
    double lo, step = step_of(range, &lo);
    assert_true(step == 1.0 / 48);
    read_field(2, add);
    for (int i = 0; i < SPLATS; i++) {
        int32_t v = fields.v[i] + (add ? before[i] : 0);
        double is = scale * (double)want[match[i]];
        assert_true(fabs(lo + step * v - fmin(is, want == scene.g.plane[G_LOGIT] ? 12 : is)) <=
                    step / 2 + 1e-6);
        before[i] = add ? before[i] : v;
    }
}

static void check_quats(const int match[SPLATS])
{
    static int32_t q[3][SPLATS];
    for (int k = 0; k < 3; k++) {
        read_field(2, true);
        memcpy(q[k], fields.v, sizeof q[k]);
    }
    read_field(1, false);
    for (int i = 0; i < SPLATS; i++) {
        double sum = 0, dot = 0, length = 0, v[3];
        const int largest = fields.v[i] & 3;
        for (int k = 0; k < 3; k++) {
            v[k] = q[k][i] * packed_number("quat", 0) / 16383.0 * sqrt(0.5);
            sum += v[k] * v[k];
        }
        for (int k = 0, n = 0; k < 4; k++) {
            const double want = (double)scene.g.plane[G_QUAT + k][match[i]];
            dot += want * (k == largest ? sqrt(fmax(1 - sum, 0)) : v[n++]);
            length += want * want;
        }
        assert_true(fabs(dot) / sqrt(length) > 1 - 2e-5); // 6 mrad
        assert_int_equal(fields.v[i] >> 2, match[i] % 2);
    }
}

static void packed_splats_come_back(void **state)
{
    (void)state;
    static float confidence[SPLATS];
    int match[SPLATS];
    for (int i = 0; i < SPLATS; i++)
        confidence[i] = i % 2 ? 0.1f : 0.9f;
    scene.confidence = confidence;
    scene.g.plane[G_MU][7] = 1e9f; // the sky
    scene.g.plane[G_LOG_SCALE][7] = scene.g.plane[G_LOG_SCALE + 1][7] = 13;
    scene.g.plane[G_LOG_SCALE][8] = -27;
    input.lossless = false;
    make_page();
    assert_true(page_bytes <= viewer_bytes(&input));
    open_fields(false);
    match_positions(match);
    for (int k = 0; k < 3; k++)
        check_steps("scale", match, scene.g.plane[G_LOG_SCALE + k], 1, false);
    check_steps("logit", match, scene.g.plane[G_LOGIT], 1, false);
    check_quats(match);
    check_steps("light", match, scene.g.plane[G_SH + 1], sh_c0, false);
    check_steps("light", match, scene.g.plane[G_SH], sh_c0, true);
    check_steps("light", match, scene.g.plane[G_SH + 2], sh_c0, true);
    for (int p = G_SH + 3; p < gaussians_planes(DEGREE); p++) {
        read_field(2, true);
        for (int i = 0; i < SPLATS; i++)
            assert_true(fabs(fields.v[i] * packed_number("sh", 0) -
                             (double)scene.g.plane[p][match[i]]) <= packed_number("sh", 0) / 2);
    }
    close_fields();
    assert_int_equal((int)packed_number("first", 0), SPLATS);
    const double coarse = log(packed_number("step", 0)), reach = log(packed_number("reach", 0));
    for (int i = 0; i < SPLATS; i++) { // the same scene in another unit
        for (int k = 0; k < 3; k++) {
            scene.g.plane[G_MU + k][i] /= 1024;
            scene.g.plane[G_LOG_SCALE + k][i] -= (float)log(1024);
        }
    }
    make_page();
    assert_true(fabs(log(packed_number("step", 0)) - coarse) < 1e-4);
    assert_true(fabs(log(1024 * packed_number("reach", 0)) - reach) < 1e-4);
}

/* No splat, one, and many at one place. */
static void few_packed_splats(void **state)
{
    (void)state;
    input.lossless = false;
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < SPLATS; i++)
            scene.g.plane[G_MU + k][i] = 5;
    for (int n = 0; n <= SPLATS; n = 2 * n + 1) {
        scene.g.n = n;
        make_page();
        open_fields(false);
        for (int k = 0; k < 3; k++) {
            read_field(3, true);
            for (int i = 0; i < n; i++)
                assert_int_equal(fields.v[i], 0);
            assert_true(n == 0 || packed_number("at", k) == 5);
        }
        compressed_close(&fields.in);
    }
}

/* Of large scenes the splats that matter come first. */
static void important_splats_come_first(void **state)
{
    (void)state;
    enum { MANY = 3 << 17 };
    struct arena a;
    assert_int_equal(arena_init(&a, "many", gaussians_need(MANY, 0)), OK);
    assert_int_equal(gaussians_init(&scene.g, &a, MANY, 0), OK);
    scene.g.n = MANY;
    for (int i = 0; i < MANY; i++) {
        random_splat(&scene.g, i);
        for (int k = 0; k < 3; k++)
            scene.g.plane[G_LOG_SCALE + k][i] = i % 3 ? -8 : -4;
        scene.g.plane[G_LOGIT][i] = i % 3 ? -4 : 4;
    }
    input.lossless = false;
    make_page();
    open_fields(false);
    const int first = (int)packed_number("first", 0);
    assert_true(first >= MANY / 3 && first < MANY / 3 + 10);
    for (int k = 0; k < 3; k++)
        read_field(3, true);
    double lo, step = step_of("scale", &lo);
    for (int k = 0; k < 3; k++)
        read_field(2, false);
    int large = 0;
    for (int i = 0; i < first; i++)
        large += lo + step * fields.v[i] > -6;
    assert_int_equal(large, MANY / 3);
    compressed_close(&fields.in);
    open_fields(true);
    assert_int_equal(fields.n, MANY - first);
    for (int k = 0; k < 3; k++)
        read_field(3, true);
    read_field(2, false);
    for (int i = 0; i < fields.n; i++)
        assert_true(lo + step * fields.v[i] < -7.9);
    for (int k = 1; k < 4; k++)
        read_field(2, false);
    for (int k = 0; k < 3; k++)
        read_field(2, true);
    read_field(1, false);
    read_field(2, false);
    for (int k = 0; k < 2; k++)
        read_field(2, true);
    close_fields(); // and nothing else
    arena_free(&a);
}

/* Photograph k of view i: its grey. */
static int photograph(int i, int k, double *stops)
{
    const struct cJSON *v = json_first(json_member(info, "views"));
    for (; i > 0; i--)
        v = json_next(v);
    for (v = json_first(json_member(v, "photos")); k > 0; k--)
        v = json_next(v);
    assert_true(json_number(json_member(v, "stops"), stops));
    const char *src = json_string(json_member(v, "src")), *comma = strchr(src, ',');
    assert_true(strncmp(src, "data:image/jpeg;base64,", 23) == 0);
    uint8_t *jpeg = malloc(strlen(comma));
    struct image8 im;
    assert_int_equal(img_read_mem(jpeg, decode(comma + 1, strlen(comma + 1), jpeg), "photo", &im),
                     OK);
    assert_true(im.w == SIZE && im.h == SIZE);
    int grey = im.px[700];
    img_free(&im);
    free(jpeg);
    return grey;
}

static int count_photographs(int i)
{
    const struct cJSON *v = json_first(json_member(info, "views"));
    for (; i > 0; i--)
        v = json_next(v);
    return json_count(json_member(v, "photos"));
}

static void every_exposure_of_a_place_comes_along(void **state)
{
    (void)state;
    double stops = NAN;
    make_page();
    assert_int_equal(count_photographs(0), 1);
    assert_int_equal(count_photographs(1), 2);
    assert_true(abs(photograph(0, 0, &stops) - 100) <= 2 && stops == -1);
    assert_true(abs(photograph(1, 0, &stops) - 120) <= 2 && stops == 1);
    assert_true(abs(photograph(1, 1, &stops) - 140) <= 2 && stops == 4.5);
    taken_log2t[VIEWS] = INFINITY;
    assert_int_equal(viewer_write(tmpdir_path("view.html"), &input), ERR_ARG);
    assert_non_null(strstr(err_text(), "the exposures is not finite"));
}

/* Of large photographs there are fewer exposures, but one of each place. */
static void large_photographs_have_fewer_exposures(void **state)
{
    (void)state;
    const struct extent large = {8192, 4096, 0}; // half of what a page holds
    const size_t at = extent_pixels(&large);
    photos.rgb = calloc(at + 2 * SIZE * SIZE, 3);
    extent[0] = large;
    extent[1].at = extent[2].at = at;
    make_page();
    assert_int_equal(count_photographs(0), 1);
    assert_int_equal(count_photographs(1), 1);
    scene.size = large.w; // nor do they need room on the disk
    const uint64_t few = viewer_bytes(&input);
    photos.n_more = 100;
    assert_true(viewer_bytes(&input) < few + 1000000);
    photos.n_more = 1;
    free(photos.rgb);
    photos.rgb = pixels;
}

static void what_stands_around_it(void **state)
{
    (void)state;
    float tone[TONE_PARAMS], k[4];
    input.lossless = false; // the longer of the two frames
    make_page();
    assert_true(json_floats("info", info, "tone", TONE_PARAMS, tone) == OK);
    assert_memory_equal(tone, scene.tone.p, sizeof tone);
    const struct cJSON *view = json_first(json_member(info, "views"));
    assert_int_equal(json_count(json_member(info, "views")), VIEWS);
    assert_true(json_floats("view", view, "k", 4, k) == OK);
    assert_true(k[0] == 20 && k[1] == 21 && k[2] == 12 && k[3] == 13);
    double stops = NAN;
    assert_true(json_number(json_member(view, "stops"), &stops) && stops == -1);
    const struct cJSON *marks = json_member(info, "taken");
    assert_int_equal(json_count(marks), VIEWS + 1);
    assert_true(json_number(json_first(marks), &stops) && stops == -1);
    assert_true(number("middle") == -3);
    assert_non_null(strstr(page, ",\"metres\":false,"));
    assert_string_equal(json_string(json_member(info, "report")), "report.html");
    /* the promise of the issue, and that of viewer_bytes */
    assert_true(page_bytes - info_chars - blob_chars < FRAME_MAX);
    assert_null(strstr(page, "\n  ")); // no indentation
    assert_null(strstr(page, " // "));
    assert_non_null(strstr(page, "const BATCH = 4096;\n"));
    assert_true(page_bytes <= viewer_bytes(&input));
    input.photos = NULL;
    input.report = NULL;
    scene.metres = true;
    make_page();
    assert_non_null(strstr(page, ",\"metres\":true,"));
    assert_int_equal(json_count(json_member(info, "taken")), VIEWS);
    assert_null(json_member(json_first(json_member(info, "views")), "photos"));
    assert_true(page_bytes <= viewer_bytes(&input));
}

/* A hundred splats all over a picture go before two hundred in a few places, these before twenty
 * elsewhere, and guesses do not count. */
static void the_page_begins_where_most_is_proven(void **state)
{
    (void)state;
    float confidence[SPLATS];
    struct gaussians *g = &scene.g;
    for (int i = 0; i < SPLATS; i++) {
        int column = i < 100 ? i % 10 : i % 4, row = i < 100 ? i / 10 : i % 3;
        g->plane[G_LOGIT][i] = 3;
        g->plane[G_MU][i] = (float)(0.14 * column - 0.63);
        g->plane[G_MU + 1][i] = (float)(0.14 * row - 0.63);
        g->plane[G_MU + 2][i] = i < 100 ? 4 : -4; // before the first camera, before the other
        confidence[i] = g->plane[G_MU][i] < 0.2f ? 0.1f : 0.9f;
    }
    input.photos = NULL;
    for (int i = 0; i < VIEWS; i++)
        cams[i] = (struct camera){SIZE, SIZE, 60, 60, 12, 12, {i == 0, 0, i != 0, 0}, {0, 0, 0}};
    make_page();
    assert_int_equal((int)number("first"), 0);
    cams[0].t[0] = 1.2f; // the first two columns are in its picture
    make_page();
    assert_int_equal((int)number("first"), 1);
    cams[1] = cams[0];
    cams[0].t[0] = 0.5f; // the left part
    cams[1].t[0] = -0.5f;
    make_page();
    assert_int_equal((int)number("first"), 0); // of two that see as much
    scene.confidence = confidence;
    make_page();
    assert_int_equal((int)number("first"), 1);
    scene.n_views = 0;
    make_page();
    assert_int_equal((int)number("first"), 0);
}

/* Nothing that a user names may end a part of the page. */
static void hostile_texts(void **state)
{
    (void)state;
    int scripts = 0;
    snprintf(names[0], NAME_CAP, "%s", "</script><script>alert(1)//\"\\\n\xc3\xa9");
    input.title = "</title><script>alert(2)</script>&amp;\"";
    input.report = "<report>";
    make_page();
    for (const char *at = page; (at = strstr(at, "<script")); at++)
        scripts++;
    assert_int_equal(scripts, 5); // info, scene, rest and two of the page's own
    assert_null(strstr(page, "alert(1)//\"\\\n"));
    assert_null(strstr(page, "</title><script>"));
    const struct cJSON *view = json_first(json_member(info, "views"));
    assert_string_equal(json_string(json_member(view, "name")), names[0]);
}

static void what_is_never_drawn_is_left_out(void **state)
{
    (void)state;
    struct gaussians *g = &scene.g;
    g->n = 5;
    g->plane[G_MU + 1][0] = NAN;
    g->plane[G_SH + 40][1] = INFINITY;
    g->plane[G_LOGIT][2] = -5.6f; // 1/271
    g->plane[G_LOGIT][3] = -5.5f; // 1/246
    for (int k = 0; k < 4; k++)
        g->plane[G_QUAT + k][4] = 0;
    double q[4];
    make_page();
    assert_int_equal((int)number("n"), 2);
    assert_memory_equal(blob, &g->plane[G_MU][3], 4);
    unpack_quat(1, q);
    assert_true(q[0] == 1 && q[1] == 0 && q[2] == 0 && q[3] == 0);
    g->n = 3;
    make_page();
    assert_int_equal((int)number("n"), 0);
    assert_int_equal(blob_bytes, 0);
    assert_true(number("unit") == 1);
}

/* The brightest thing lies in the upper octave of half floats, but never so high that nothing is
 * left below the middle tones. */
static void the_unit_suits_the_brightest(void **state)
{
    (void)state;
    struct gaussians *g = &scene.g;
    double middle = pow(0.5, (double)display_ev(&scene.tone));
    g->n = 1;
    for (int p = G_SH; p < gaussians_planes(DEGREE); p++)
        g->plane[p][0] = 0;
    for (double light = 1e-6; light < 1e6; light *= 10) {
        g->plane[G_SH + 1][0] = (float)(log(light) / sh_c0);
        g->plane[G_SH][0] = g->plane[G_SH + 2][0] = g->plane[G_SH + 1][0];
        make_page();
        double top = light / number("unit");
        assert_true(top <= (double)HALF_MAX * 1.001 && top > (double)HALF_MAX / 2.001);
    }
    g->plane[G_SH][0] = 200;
    make_page();
    double top = middle * exp2(24) / number("unit");
    assert_true(top <= (double)HALF_MAX * 1.001 && top > (double)HALF_MAX / 2.001);
    /* the background counts, and what the bands above add in some direction */
    g->plane[G_SH][0] = g->plane[G_SH + 1][0] = g->plane[G_SH + 2][0] = -50;
    scene.background[2] = 500;
    make_page();
    top = 500 / number("unit");
    assert_true(top <= (double)HALF_MAX * 1.001 && top > (double)HALF_MAX / 2.001);
    scene.background[2] = 0;
    make_page();
    double plain = number("unit");
    g->plane[G_SH + 3 * 2 + 1][0] = 10; // z: exp(10 * 0.4886) is 132
    make_page();
    assert_true(number("unit") >= 128 * plain && number("unit") <= 256 * plain);
}

static void what_cannot_be_written(void **state)
{
    (void)state;
    struct rlimit was, small = {.rlim_cur = 100000};
    assert_int_equal(viewer_write(tmpdir_path("no/view.html"), &input), ERR_IO);
    getrlimit(RLIMIT_FSIZE, &was);
    small.rlim_max = was.rlim_max;
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &small);
    err_t e = viewer_write(tmpdir_path("view.html"), &input);
    setrlimit(RLIMIT_FSIZE, &was);
    assert_int_equal(e, ERR_IO);
    assert_false(file_exists(tmpdir_path("view.html")));
    float *const numbers[] = {&cams[1].t[2], &log2t[0], &scene.background[1], &scene.tone.p[7],
                              &scene.tone.mid_log2t};
    for (size_t k = 0; k < sizeof numbers / sizeof *numbers; k++) {
        float kept = *numbers[k];
        *numbers[k] = k % 2 ? INFINITY : NAN;
        assert_int_equal(viewer_write(tmpdir_path("view.html"), &input), ERR_ARG);
        assert_non_null(strstr(err_text(), "is not finite"));
        assert_false(file_exists(tmpdir_path("view.html")));
        *numbers[k] = kept;
    }
    /* as many as fit lose bands, more are refused before anything is looked at */
    scene.g.n = VIEWER_SPLATS_MAX;
    input.photos = NULL;
    assert_true(viewer_bytes(&input) < (uint64_t)VIEWER_SCENE_MAX / 3 * 4 + (1 << 20));
    assert_true(viewer_bytes(&input) > (uint64_t)VIEWER_SPLATS_MAX * SPLAT_BYTES / 3 * 4);
    scene.g.n++;
    assert_int_equal(viewer_write(tmpdir_path("view.html"), &input), ERR_ARG);
    assert_non_null(strstr(err_text(), "4194305 splats"));
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, setup, teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(splats_come_back),
        TEST(packed_splats_come_back),
        TEST(few_packed_splats),
        TEST(important_splats_come_first),
        TEST(every_exposure_of_a_place_comes_along),
        TEST(large_photographs_have_fewer_exposures),
        TEST(what_stands_around_it),
        TEST(the_page_begins_where_most_is_proven),
        TEST(hostile_texts),
        TEST(what_is_never_drawn_is_left_out),
        TEST(the_unit_suits_the_brightest),
        TEST(what_cannot_be_written),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
