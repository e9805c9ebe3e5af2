/* Figures of hand-made pictures, and the page around them. */
#include "core/photo/response_family.h"
#include "drivers/format/img.h"
#include "drivers/format/json.h"
#include "firmware/recon/figures.h"
#include "firmware/result/report_page.h"
#include "tests/unit/small_job.h"
#include "tests/unit/squares.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cmocka.h>

enum { SIDE = 4, PX = SIDE * SIDE, MOST = 40 };

/* Display value: sigmoid of the log2 exposure. Seen well are x = -3.43 .. 4.13. */
static struct tonemap tone;
static uint8_t rgb[MOST][PX][3];
static float log2t[MOST];
static struct views views = {.size = SIDE, .rgb = &rgb[0][0][0], .log2t = log2t};
static struct figures f;

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    tonemap_linear(&tone, 1, -16, 16, 0);
    memset(rgb, 128, sizeof rgb);
    views.extent = squares(MOST, SIDE);
    return 0;
}

static void expose(int n, const float *t)
{
    views.n = n;
    memcpy(log2t, t, (size_t)n * sizeof *t);
    figures_init(&f, &views, &tone);
}

static void near(double a, double b)
{
    assert_true(fabs(a - b) < 0.02);
}

/* ---- photographs ---- */

static void shares_of_a_picture(void **state)
{
    (void)state;
    struct figures_input in;
    static const uint8_t kinds[8][3] = {{255, 0, 0}, {0, 252, 9}, {251, 251, 251}, {0, 0, 8},
                                        {7, 7, 7},   {0, 0, 0},   {128, 128, 128}, {0, 90, 0}};
    for (int i = 0; i < PX; i++)
        memcpy(rgb[0][i], kinds[i % 8], 3);
    expose(1, (const float[]){-2});
    figures_input(&f, 0, &in);
    near(in.clipped, 0.25);
    near(in.dark, 0.25);
    near(in.alone, 0.5); // there is no other exposure
    assert_int_equal(in.histogram[0][63], 2);
    assert_int_equal(in.histogram[0][62], 2);
    assert_int_equal(in.histogram[1][63], 2);
    assert_int_equal(in.histogram[2][2], 4); // 8 and 9
    assert_int_equal(in.histogram[2][0] + in.histogram[2][1], 2 * 4);
}

/* 128 is in the middle of what is seen well, and so it is four stops away: sigmoid(+-4) is 250 and
 * 5. 200 is 253 there, 40 is 1. */
static void what_one_exposure_sees_alone(void **state)
{
    (void)state;
    struct figures_input in;
    for (int i = 0; i < PX; i++)
        memset(rgb[0][i], i < 4 ? 255 : i < 8 ? 0 : i < 10 ? 128 : i < 15 ? 200 : 40, 3);
    memcpy(rgb[1], rgb[0], sizeof rgb[0]);
    memcpy(rgb[2], rgb[0], sizeof rgb[0]);
    expose(3, (const float[]){-4, 4, 0});
    for (int i = 0; i < 3; i++) {
        figures_input(&f, i, &in);
        near(in.clipped, 4.0 / PX);
        near(in.dark, 4.0 / PX);
        near(in.alone, i == 0 ? 5.0 / PX : i == 1 ? 3.0 / PX : 0);
    }
    assert_int_equal(f.n, 3);
    for (int k = 0; k < 3; k++) {
        assert_int_equal(f.exposure[k].n, 1);
        near(f.exposure[k].stops, 4 * k - 4);
        near(f.exposure[k].from, log(8 / 247.0) - (4 * k - 4));
        near(f.exposure[k].to, log(251 / 4.0) - (4 * k - 4));
    }
    near(f.exposure[0].alone, 5.0 / PX);
    near(f.exposure[1].alone, 0);
    near(f.exposure[2].alone, 3.0 / PX);
}

static void equal_and_many_exposures(void **state)
{
    (void)state;
    struct figures_input in;
    float t[MOST] = {0, 0.04f, -0.04f};
    expose(3, t);
    assert_int_equal(f.n, 1);
    for (int i = 0; i < 3; i++) {
        figures_input(&f, i, &in);
        near(in.alone, 1);
    }
    assert_int_equal(f.exposure[0].n, 3);
    int n = 0;
    for (int i = 0; i < MOST; i++)
        t[i] = (float)(MOST - i);
    expose(MOST, t);
    assert_in_range(f.n, MOST / 2, FIGURES_EXPOSURES);
    for (int i = 0; i < MOST; i++)
        figures_input(&f, i, &in);
    for (int k = 0; k < f.n; k++) {
        n += f.exposure[k].n;
        assert_in_range(f.exposure[k].n, 1, 2);
    }
    assert_int_equal(n, MOST);
    near(f.exposure[0].log2t, 1);
    assert_true(f.exposure[f.n - 1].log2t > MOST - 1.5); // the longest are not left out
}

/* Photographs of one place count like any others. */
static void brackets(void **state)
{
    (void)state;
    struct figures_input in;
    int place[2] = {0, 0};
    memset(rgb[2], 240, sizeof rgb[2]); // x = 2.77, six stops below -3.23: still seen well
    views.n_more = 2;
    views.place = place;
    views.n = 1;
    memcpy(log2t, (const float[]){0, -6, 6}, 3 * sizeof *log2t);
    figures_init(&f, &views, &tone);
    assert_int_equal(f.n, 3);
    figures_input(&f, 2, &in);
    near(in.alone, 0);
    memset(rgb[1], 128, sizeof rgb[1]);
    figures_input(&f, 1, &in);
    near(in.alone, 1); // clipped at the others
    views.n_more = 0;
}

/* ---- warnings ---- */

static struct small_job job;

static int setup_job(void **state)
{
    setup(state);
    small_job_init(&job, 16);
    job.result.scene.tone = tone;
    return 0;
}

static int teardown_job(void **state)
{
    small_job_free(&job);
    return tmpdir_teardown(state);
}

static bool warned(const char *words)
{
    for (int i = 0; i < job.result.n_warnings; i++)
        if (strstr(job.result.warnings[i], words))
            return true;
    return false;
}

static void warn(const float t[2], int dark, int bright)
{
    job.result.n_warnings = 0;
    memcpy(job.log2t, t, sizeof job.log2t);
    memset(job.rgb, dark, sizeof job.rgb / 2);
    memset(job.rgb + sizeof job.rgb / 2, bright, sizeof job.rgb / 2);
    job.rgb[sizeof job.rgb / 2] ^= 1; // no copy
    figures_warn(&job.result);
}

static void every_warning(void **state)
{
    (void)state;
    warn((const float[]){-2, 2}, 60, 190);
    assert_int_equal(job.result.n_warnings, 0);
    warn((const float[]){1, 1}, 60, 60);
    assert_true(warned("one exposure") && job.result.n_warnings == 1);
    warn((const float[]){-5, 5}, 60, 190);
    assert_true(warned("-5.0 and +5.0 stops lie too far apart: the 2.4 stops"));
    assert_int_equal(job.result.n_warnings, 1);
    warn((const float[]){-2, 2}, 255, 255);
    assert_true(warned("100 % of the pixels are clipped even at the shortest"));
    assert_true(warned("a.png is saturated all over and shows nothing: take it at a shorter"));
    assert_int_equal(job.result.n_warnings, 3);
    warn((const float[]){-2, 2}, 0, 0);
    assert_true(warned("100 % of the pixels are dark even at the longest"));
    assert_true(warned("b.png is black all over and shows nothing: take it at a longer"));
    assert_int_equal(job.result.n_warnings, 3);
    warn((const float[]){2, -2}, 255, 190); // the shortest is not clipped
    assert_true(warned("a.png is saturated"));
    assert_int_equal(job.result.n_warnings, 1);
    warn((const float[]){-2, 2}, 0, 190); // the longest is not dark
    assert_true(warned("a.png is black"));
    assert_int_equal(job.result.n_warnings, 1);
}

/* A lamp in the dark is something; copies of nothing are none. */
static void photographs_that_show_nothing_or_nothing_new(void **state)
{
    (void)state;
    memset(rgb, 0, sizeof rgb);
    expose(3, (const float[]){0, 0, 0});
    assert_string_equal(figures_blank(&views, 0), "black");
    assert_int_equal(figures_copied(&views, 1), -1);
    rgb[0][5][1] = 200;
    assert_null(figures_blank(&views, 0));
    memset(rgb, 255, sizeof rgb);
    assert_string_equal(figures_blank(&views, 0), "saturated");
    memset(rgb[0], 100, sizeof rgb[0] / 4);
    assert_null(figures_blank(&views, 0));
    memset(rgb, 100, sizeof rgb);
    assert_null(figures_blank(&views, 0));
    assert_int_equal(figures_copied(&views, 0), -1);
    assert_int_equal(figures_copied(&views, 2), 0);
    rgb[0][5][1]++;
    assert_int_equal(figures_copied(&views, 2), 1);
    rgb[2][5][2]++;
    assert_int_equal(figures_copied(&views, 2), -1);
}

static void the_view_that_does_not_fit(void **state)
{
    (void)state;
    char names[5][NAME_CAP] = {"a", "b", "moved.png", "d", "e"};
    static const char tail[] = "take it again";
    float db[5] = {30, 29, 12, 31, 28};
    memset(rgb, 128, sizeof rgb);
    expose(5, (const float[]){-1, 0, 1, 0, 1});
    for (int i = 0; i < 5; i++)
        rgb[i][0][0] = (uint8_t)(120 + i);
    job.result.views = views;
    job.result.views.names = names;
    job.result.input_db = db;
    figures_warn(&job.result);
    assert_true(warned("moved.png fits the scene 17 dB worse"));
    assert_int_equal(job.result.n_warnings, 1);
    memset(names[2], 'x', NAME_CAP - 1); // the longest name leaves room for the sentence
    job.result.n_warnings = 0;
    figures_warn(&job.result);
    assert_string_equal(strstr(job.result.warnings[0], tail), tail);
    job.result.n_warnings = 0;
    memset(rgb[2], 255, sizeof rgb[2]);
    figures_warn(&job.result);
    assert_true(warned("is saturated all over and shows nothing") && !warned("fits the scene"));
    memset(rgb[2], 129, sizeof rgb[2]);
    job.result.n_warnings = 0;
    db[2] = 23;
    figures_warn(&job.result);
    job.result.input_db = NULL;
    figures_warn(&job.result);
    assert_int_equal(job.result.n_warnings, 0);
}

/* ---- report.json ---- */

static struct cJSON *report(void)
{
    struct cJSON *doc;
    struct report rep;
    char *text;
    size_t n;
    FILE *file = open_memstream(&text, &n);
    report_begin(&rep, file);
    figures_report(&job.result, &rep);
    report_close(&rep);
    fclose(file);
    assert_int_equal(json_parse("report", text, n, &doc), OK);
    free(text);
    return doc;
}

static double at(const struct cJSON *object, const char *key, int i)
{
    const struct cJSON *v = json_first(json_member(object, key));
    double out;
    while (i-- > 0)
        v = json_next(v);
    assert_true(json_number(v, &out));
    return out;
}

static double number(const struct cJSON *object, const char *key)
{
    double out;
    assert_true(json_number(json_member(object, key), &out));
    return out;
}

/* Turned by 90 degrees about its vertical axis, two units before the origin. */
static void cameras_in_the_report(void **state)
{
    (void)state;
    const float half = (float)sqrt(0.5);
    job.cams[1] =
        (struct camera){SMALL_SIZE, SMALL_SIZE, 8, 8, 8, 8, {half, 0, half, 0}, {0, 0, 2}};
    job.db[1] = 33;
    struct cJSON *doc = report();
    const struct cJSON *in = json_next(json_first(json_member(doc, "inputs")));
    const struct cJSON *cam = json_member(in, "camera");
    const double forward[3] = {-1, 0, 0}, centre[3] = {2, 0, 0}, up[3] = {0, -1, 0};
    for (int k = 0; k < 3; k++) {
        near(at(cam, "forward", k), forward[k]);
        near(at(cam, "centre", k), centre[k]);
        near(at(cam, "up", k), up[k]);
    }
    near(number(cam, "fov_deg"), 90);
    near(number(in, "psnr"), 33);
    near(number(in, "place"), 1);
    near(number(in, "stops"), 1);
    assert_string_equal(json_string(json_member(in, "name")), "b.png");
    assert_int_equal(json_count(json_member(json_member(in, "histogram"), "red")), FIGURES_BINS);
    json_free(doc);
}

/* A curve through the points of a family, as a camera's would be found. */
static void like(enum response_family family)
{
    struct response_pair pair[400];
    int n = 0;
    for (double u = -11; u < -0.1; u += 0.1)
        for (double d = 0.5; d < 3 && u + d < -0.05 && n < 400; d += 0.7) {
            double a = response_family_display(family, response_family_usual(family), u);
            double b = response_family_display(family, response_family_usual(family), u + d);
            if (a > 0.004)
                pair[n++] = (struct response_pair){(float)a, (float)b, (float)d, 1};
        }
    response_fit(pair, n, 0, &job.result.scene.tone);
}

static void the_nearest_family(void **state)
{
    (void)state;
    for (int k = 0; k < RESPONSE_FAMILIES; k++) {
        like((enum response_family)k);
        for (int h = 0; h < TONE_HIDDEN; h++) { // white balance: red a stop brighter
            float *p = job.result.scene.tone.p;
            p[TONE_HIDDEN + h] += p[h];
        }
        struct cJSON *doc = report();
        const struct cJSON *t = json_member(doc, "tone"), *all = json_member(t, "families");
        assert_string_equal(json_string(json_member(t, "nearest")),
                            response_family_name((enum response_family)k));
        const struct cJSON *own = json_first(all);
        for (int i = 0; i < k; i++)
            own = json_next(own);
        assert_true(number(own, "rms") < 0.005);
        json_free(doc);
    }
}

static void brackets_in_the_report(void **state)
{
    (void)state;
    job.result.views.n = 1;
    job.result.views.n_more = 1;
    job.result.views.place = (int[]){0};
    struct cJSON *doc = report();
    const struct cJSON *in = json_first(json_member(doc, "inputs"));
    near(number(in, "place"), 0);
    near(number(json_next(in), "place"), 0);
    json_free(doc);
}

/* A curve that never leaves black has no neighbour. */
static void no_curve_at_all(void **state)
{
    (void)state;
    memset(&job.result.scene.tone, 0, sizeof job.result.scene.tone);
    for (int c = 0; c < 3; c++)
        job.result.scene.tone.p[(c + 1) * TONE_PER_COLOUR - 1] = -20;
    struct cJSON *doc = report();
    const struct cJSON *t = json_member(doc, "tone");
    assert_null(json_string(json_member(t, "nearest")));
    json_free(doc);
}

/* ---- page ---- */

static char *page(const char *path)
{
    struct file_map map;
    assert_int_equal(file_map(path, 1 << 24, &map), OK);
    char *text = calloc(map.n + 1, 1);
    memcpy(text, map.p, map.n);
    file_unmap(&map);
    return text;
}

static int occurrences(const char *text, const char *what)
{
    int n = 0;
    for (; (text = strstr(text, what)); text++)
        n++;
    return n;
}

static void names_cannot_end_the_data(void **state)
{
    (void)state;
    static const char name[] = "</script><script>alert(1)</script>\\\"<!--\xc3\xa4\xe2\x82\xac.png";
    struct cJSON *doc;
    const char *json = tmpdir_path("report.json");
    FILE *file = fopen(json, "w");
    struct report rep;
    report_begin(&rep, file);
    report_text(&rep, "name", name);
    report_close(&rep);
    fclose(file);
    assert_int_equal(report_page_write(tmpdir_path("r.html"), &job.result, json), OK);
    char *text = page(tmpdir_path("r.html")), *data = strstr(text, "id=\"data\">");
    assert_int_equal(occurrences(text, "</script"), 3);
    assert_int_equal(occurrences(text, "<!--"), 0);
    assert_non_null(data);
    data += strlen("id=\"data\">");
    assert_int_equal(json_parse("page", data, (size_t)(strstr(data, "</script") - data), &doc), OK);
    assert_string_equal(json_string(json_member(doc, "name")), name);
    json_free(doc);
    free(text);
}

static void small_and_alone(void **state)
{
    (void)state;
    job.result.views.n = 0;
    assert_int_equal(
        report_page_write(tmpdir_path("r.html"), &job.result, tmpdir_text("r.json", "{}")), OK);
    char *text = page(tmpdir_path("r.html"));
    assert_true(strlen(text) < 60000);
    assert_true(strlen(text) <= report_page_bytes(0));
    assert_non_null(strstr(text, "default-src 'none'"));
    assert_int_equal(occurrences(text, "'sha256-"), 2);
    assert_int_equal(occurrences(text, "unsafe-inline"), 0);
    assert_int_equal(occurrences(text, "http://") + occurrences(text, "https://"),
                     1); // the name space of SVG
    for (const char *on = text; (on = strstr(on, " on")); on++)
        assert_true(strspn(on + 3, "abcdefghijklmnopqrstuvwxyz") == 0 ||
                    on[3 + strspn(on + 3, "abcdefghijklmnopqrstuvwxyz")] != '=');
    free(text);
}

/* Bytes behind "data:image/jpeg;base64,". */
static void decode(const char *text, struct image8 *out)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    static uint8_t bytes[1 << 16];
    size_t n = 0;
    uint32_t v = 0;
    text = strstr(text, "base64,") + 7;
    for (int i = 1; *text != '"' && *text != '='; text++, i++) {
        v = v << 6 | (uint32_t)(strchr(digits, *text) - digits);
        if (i % 4 != 1)
            bytes[n++] = (uint8_t)(v >> (i % 4 == 2 ? 4 : i % 4 == 3 ? 2 : 0));
    }
    assert_int_equal(img_read_mem(bytes, n, "thumbnail", out), OK);
}

static void colour_at(const struct image8 *im, int x, int y, int r, int g, int b)
{
    const uint8_t *p = im->px + 3 * (y * im->w + x);
    assert_true(abs(p[0] - r) < 12 && abs(p[1] - g) < 12 && abs(p[2] - b) < 12);
}

/* Red photograph, its upper half missed by 3/8 of full scale in one colour: an eighth on average,
 * half way to white. */
static void photograph_scene_distance_and_confidence(void **state)
{
    (void)state;
    enum { N = 300, THUMB = 192 }; // not a multiple
    static float px[3 * N * N];
    static uint8_t photograph[3 * N * N];
    static float sure[N * N];
    static uint8_t left_out[N * N];
    const struct image display = {N, N, 3, px};
    const struct report_page_drawing drawing = {&display, sure, left_out};
    struct image8 strip;
    struct report_page s;
    for (int i = 0; i < N * N; i++) {
        photograph[3 * i] = 255;
        px[i] = i < N * N / 2 ? 0.625f : 1;
        sure[i] = i < N * N / 2 ? 0.2f : 1;
        left_out[i] = i % N >= N / 2;
    }
    assert_int_equal(report_page_open(tmpdir_path("p.html"), &s), OK);
    assert_int_equal(report_page_picture(&s, 7, &(struct image8){N, N, 3, photograph}, &drawing),
                     OK);
    assert_int_equal(report_page_close(&s, tmpdir_text("r.json", "{}")), OK);
    char *text = page(tmpdir_path("p.html"));
    assert_non_null(strstr(text, "\"7\": \"data:image/jpeg;base64,"));
    decode(text, &strip);
    assert_true(strip.w == 4 * THUMB && strip.h == THUMB);
    colour_at(&strip, 20, 20, 255, 0, 0);
    colour_at(&strip, THUMB + 20, 20, 159, 0, 0);
    colour_at(&strip, THUMB + 20, THUMB - 20, 255, 0, 0);
    colour_at(&strip, 2 * THUMB + 20, 20, 255, 128, 0);
    colour_at(&strip, 2 * THUMB + 20, THUMB - 20, 0, 0, 0);
    int blue = 0;
    for (int x = THUMB / 2 + 8; x < THUMB - 8; x++)
        blue += strip.px[3 * (20 * strip.w + 2 * THUMB + x) + 2] > 170;
    assert_true(blue > 20 && blue < THUMB / 2 - 16 - 20); // striped where it is left out
    colour_at(&strip, 3 * THUMB + 20, 20, 51, 51, 51);
    colour_at(&strip, 3 * THUMB + 20, THUMB - 20, 255, 255, 255);
    img_free(&strip);
    free(text);
}

static void a_photograph_alone(void **state)
{
    (void)state;
    struct image8 strip;
    struct report_page s = {0};
    const struct image other = {1, 1, 3, (float[]){0, 0, 0}};
    const struct report_page_drawing drawing = {&other, other.px, NULL};
    memset(job.rgb, 200, sizeof job.rgb);
    assert_int_equal(
        report_page_write(tmpdir_path("s.html"), &job.result, tmpdir_text("r.json", "{}")), OK);
    char *text = page(tmpdir_path("s.html"));
    assert_int_equal(occurrences(text, "data:image/jpeg"), SMALL_VIEWS);
    decode(text, &strip);
    assert_true(strip.w == SMALL_SIZE && strip.h == SMALL_SIZE); // not enlarged
    colour_at(&strip, 3, 3, 200, 200, 200);
    img_free(&strip);
    free(text);
    assert_int_equal(
        report_page_picture(&s, 0, &(struct image8){SMALL_SIZE, SMALL_SIZE, 3, (uint8_t *)job.rgb},
                            &drawing),
        ERR_ARG);
}

static void trouble_leaves_no_file(void **state)
{
    (void)state;
    struct rlimit was, small = {.rlim_cur = 1000};
    struct report_page s;
    assert_int_equal(
        report_page_write(tmpdir_path("no/r.html"), &job.result, tmpdir_text("r.json", "{}")),
        ERR_IO);
    getrlimit(RLIMIT_FSIZE, &was);
    small.rlim_max = was.rlim_max;
    signal(SIGXFSZ, SIG_IGN);
    const char *json = tmpdir_text("r.json", "{}");
    setrlimit(RLIMIT_FSIZE, &small);
    err_t e = report_page_write(tmpdir_path("r.html"), &job.result, json);
    setrlimit(RLIMIT_FSIZE, &was);
    assert_int_equal(e, ERR_IO);
    assert_int_not_equal(access(tmpdir_path("r.html"), F_OK), 0);
    assert_int_equal(report_page_write(tmpdir_path("r.html"), &job.result, tmpdir_path("no.json")),
                     ERR_IO);
    assert_int_not_equal(access(tmpdir_path("r.html"), F_OK), 0);
    assert_int_equal(report_page_open(tmpdir_path("r.html"), &s), OK);
    report_page_discard(&s);
    report_page_discard(&s);
    assert_int_not_equal(access(tmpdir_path("r.html"), F_OK), 0);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, setup, tmpdir_teardown)
#define JOB_TEST(f) cmocka_unit_test_setup_teardown(f, setup_job, teardown_job)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(shares_of_a_picture),
        TEST(what_one_exposure_sees_alone),
        TEST(equal_and_many_exposures),
        TEST(brackets),
        JOB_TEST(every_warning),
        TEST(photographs_that_show_nothing_or_nothing_new),
        JOB_TEST(the_view_that_does_not_fit),
        JOB_TEST(cameras_in_the_report),
        JOB_TEST(the_nearest_family),
        JOB_TEST(no_curve_at_all),
        JOB_TEST(brackets_in_the_report),
        JOB_TEST(names_cannot_end_the_data),
        JOB_TEST(small_and_alone),
        JOB_TEST(photograph_scene_distance_and_confidence),
        JOB_TEST(a_photograph_alone),
        JOB_TEST(trouble_leaves_no_file),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
