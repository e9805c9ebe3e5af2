/* Worlds photographed by a rig: exposure, limits, the same result however it is shared out, and the
 * entry points for ctypes. */
#include "sim/train/sample.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 3, SIZE = 28, PX = SIZE * SIZE };

struct result {
    float radiance[VIEWS * 3 * PX], depth[VIEWS * PX];
    struct camera cams[VIEWS];
    double key;
};

static const struct sample_scene usual = {.seed = 5,
                                          .kind = WORLD_ROOM,
                                          .n_views = VIEWS,
                                          .size = SIZE,
                                          .spread = 0.3f,
                                          .quality = {.samples = 1, .shadow = 1}};

static void open_arena(struct arena *tmp, int threads)
{
    struct plan p = plan_begin(threads);
    sample_plan(&p, &usual, LOCAL_TONE_NONE);
    assert_int_equal(arena_init(tmp, "tmp", p.tmp.peak), OK);
}

static err_t make(const struct sample_scene *a, int threads, struct result *out)
{
    struct arena tmp = {0};
    struct pool *pool = NULL;
    open_arena(&tmp, threads);
    if (threads > 1)
        assert_int_equal(pool_open(&pool, threads), OK);
    struct run r = {.pool = pool, .tmp = &tmp};
    err_t e = sample_make(&r, a, out->radiance, out->depth, out->cams, &out->key);
    assert_int_equal((int)arena_mark(&tmp), 0);
    pool_close(pool);
    arena_free(&tmp);
    return e;
}

static int by_value(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static float median_of(const struct result *r, int view)
{
    static float grey[PX];
    const float *c = r->radiance + 3 * PX * view;
    for (int i = 0; i < PX; i++)
        grey[i] = 0.2126f * c[i] + 0.7152f * c[PX + i] + 0.0722f * c[2 * PX + i];
    qsort(grey, PX, sizeof *grey, by_value);
    return grey[PX / 2];
}

static void key_puts_the_middle_view_at_18_percent(void **state)
{
    (void)state;
    static struct result r;
    for (int kind = 0; kind < WORLD_KINDS; kind++) {
        struct sample_scene a = usual;
        float median[VIEWS];
        a.kind = kind;
        assert_int_equal(make(&a, 1, &r), OK);
        for (int i = 0; i < VIEWS; i++)
            median[i] = median_of(&r, i);
        qsort(median, VIEWS, sizeof *median, by_value);
        double full =
            ((1 << sensor_default.bits) - 1 - sensor_default.black) / (double)sensor_default.gain;
        full = fmin(full, (double)sensor_default.full_well);
        double level = (double)median[VIEWS / 2] * (double)sensor_default.electrons * r.key / full;
        assert_true(fabs(level - 0.18) < 1e-5);
    }
}

static void sharing_out_does_not_matter(void **state)
{
    (void)state;
    static struct result one, many;
    for (int threads = 2; threads <= 5; threads += 3) { // a view each, and all for one view
        assert_int_equal(make(&usual, 1, &one), OK);
        assert_int_equal(make(&usual, threads, &many), OK);
        assert_memory_equal(one.radiance, many.radiance, sizeof one.radiance);
        assert_memory_equal(one.depth, many.depth, sizeof one.depth);
        assert_memory_equal(one.cams, many.cams, sizeof one.cams);
        assert_true(one.key == many.key);
    }
}

/* A point that one view shows is as far away in the next one as the depth there says, mostly. */
static void views_agree_about_depth(void **state)
{
    (void)state;
    static struct result r;
    int seen = 0, agree = 0;
    struct sample_scene a = usual;
    a.spread = 0.1f;
    assert_int_equal(make(&a, 1, &r), OK);
    for (int i = 0; i < PX; i++) {
        double x[3], y[3], z = (double)r.depth[i], p[3] = {0, 0, 0};
        const struct camera *from = &r.cams[0], *to = &r.cams[1];
        double m[2][9];
        for (int c = 0; c < 2; c++) {
            const float *q = r.cams[c].q;
            double w = q[0], a1 = q[1], b = q[2], d = q[3];
            const double rows[9] = {
                1 - 2 * (b * b + d * d), 2 * (a1 * b - w * d),      2 * (a1 * d + w * b),
                2 * (a1 * b + w * d),    1 - 2 * (a1 * a1 + d * d), 2 * (b * d - w * a1),
                2 * (a1 * d - w * b),    2 * (b * d + w * a1),      1 - 2 * (a1 * a1 + b * b)};
            memcpy(m[c], rows, sizeof rows);
        }
        x[0] = (i % SIZE + 0.5 - (double)from->cx) / (double)from->fx * z - (double)from->t[0];
        x[1] = (i / SIZE + 0.5 - (double)from->cy) / (double)from->fy * z - (double)from->t[1];
        x[2] = z - (double)from->t[2];
        for (int k = 0; k < 9; k++)
            p[k % 3] += m[0][k] * x[k / 3];
        for (int k = 0; k < 3; k++)
            y[k] = m[1][3 * k] * p[0] + m[1][3 * k + 1] * p[1] + m[1][3 * k + 2] * p[2] +
                   (double)to->t[k];
        int u = (int)floor((double)to->fx * y[0] / y[2] + (double)to->cx);
        int v = (int)floor((double)to->fy * y[1] / y[2] + (double)to->cy);
        if (z >= (double)RENDER_FAR || y[2] <= 0 || u < 0 || v < 0 || u >= SIZE || v >= SIZE)
            continue;
        seen++;
        agree += fabs((double)r.depth[PX + v * SIZE + u] - y[2]) < 0.1 * y[2];
    }
    assert_true(seen > PX / 3);
    assert_true(agree > 0.75 * seen);
}

static void wrong_requests_are_refused(void **state)
{
    (void)state;
    static struct result r;
    struct sample_scene bad[] = {usual, usual, usual, usual, usual,
                                 usual, usual, usual, usual, usual};
    const char *const words[] = {
        "kind",          "views",  "views",         "px",     "px", "spread",
        "field of view", "spread", "field of view", "samples"};
    bad[0].kind = WORLD_KINDS;
    bad[1].n_views = 0;
    bad[2].n_views = SAMPLE_VIEWS + 1;
    bad[3].size = 13;
    bad[4].size = SAMPLE_SIZE + 1;
    bad[5].spread = 1.01f;
    bad[6].fov_deg = 19;
    bad[7].spread = NAN;
    bad[8].fov_deg = NAN;
    bad[9].quality.samples = 0;
    for (int i = 0; i < 10; i++) {
        assert_int_equal(make(&bad[i], 1, &r), ERR_ARG);
        assert_non_null(strstr(err_text(), words[i]));
    }
    struct sample_scene room = usual;
    room.orbit_deg = 20;
    assert_int_equal(make(&room, 1, &r), ERR_ARG);
    assert_non_null(strstr(err_text(), "orbit"));
    room.orbit_deg = 0;
    room.walk = 1;
    assert_int_equal(make(&room, 1, &r), ERR_ARG);
    assert_non_null(strstr(err_text(), "walk"));
    struct sample_scene large = usual;
    large.n_views = 64;
    large.size = SAMPLE_SIZE;
    assert_int_equal(make(&large, 1, &r), ERR_ARG);
}

/* Cameras of several kinds take turns, two views each; their pictures lie one after another. */
static void cameras_take_turns(void **state)
{
    (void)state;
    static struct result r;
    struct optics optics[2];
    struct sample_scene a = usual;
    struct extent x[VIEWS];
    assert_int_equal(optics_parse("a", "size=20x24,fov=90,k1=-0.1", SIZE, 60, &optics[0]), OK);
    assert_int_equal(optics_parse("b", "fisheye,size=28x14,fov=150", SIZE, 60, &optics[1]), OK);
    a.n_optics = 2;
    a.optics = optics;
    sample_extents(&a, x);
    assert_int_equal(make(&a, 1, &r), OK);
    for (int i = 0; i < VIEWS; i++) {
        const struct optics *o = &optics[i / 2];
        assert_int_equal(sample_camera_of(&a, i), i / 2);
        assert_int_equal(x[i].w, o->w);
        assert_int_equal(x[i].h, o->h);
        assert_int_equal((int)x[i].at, i * 480);
        assert_int_equal(r.cams[i].w, o->w);
        assert_true(r.cams[i].fx == (float)o->lens.fx && r.cams[i].cy == (float)o->lens.cy);
        for (size_t k = 0; k < extent_pixels(&x[i]); k++)
            assert_true(r.depth[x[i].at + k] > 0);
    }
}

/* ---- photographs ---- */

static void exposures_brighten(void **state)
{
    (void)state;
    static struct result r;
    static uint8_t px[2][4 * 3 * PX];
    struct sample_request q = {.scene = usual, .curve_family = CURVE_LINEAR, .noise_seed = 3};
    const float stops[4] = {-40, -2, 0, 40};
    float cams[11 * VIEWS];
    assert_int_equal(sample_photograph(&q, r.radiance, r.depth, cams, &r.key), OK);
    for (q.noise = 0; q.noise < 2; q.noise++) {
        double mean[4] = {0};
        uint8_t *out = px[q.noise];
        assert_int_equal(sample_develop(&q, r.key, r.radiance, 4, stops, out), OK);
        for (int i = 0; i < 4 * 3 * PX; i++)
            mean[i / (3 * PX)] += out[i] / (3.0 * PX);
        assert_true(mean[0] < 1 && mean[1] > 3 && mean[2] > 1.5 * mean[1] && mean[3] > 250);
    }
    int differ = 0, far = 0; // noise is there, but small
    for (int i = 6 * PX; i < 9 * PX; i++) {
        differ += px[0][i] != px[1][i];
        far += abs(px[0][i] - px[1][i]) > 24;
    }
    assert_true(differ > PX && far < 3 * PX / 50);
}

/* Without noise and with a straight curve, pixels are radiance x exposure. */
static void clean_photographs_are_exact(void **state)
{
    (void)state;
    static float radiance[3 * PX];
    static uint8_t px[3 * PX];
    struct sample_request q = {.scene = usual, .curve_family = CURVE_LINEAR};
    const float none = 0;
    double full =
        fmin(((1 << sensor_default.bits) - 1 - sensor_default.black) / (double)sensor_default.gain,
             (double)sensor_default.full_well);
    double key = full / (double)sensor_default.electrons; // radiance 1 is full scale
    for (int i = 0; i < 3 * PX; i++)
        radiance[i] = (float)(i % 300) / 255;
    assert_int_equal(sample_develop(&q, key, radiance, 1, &none, px), OK);
    for (int i = 0; i < 3 * PX; i++) {
        int want = (i % 3 * PX + i / 3) % 300;
        assert_true(abs(px[i] - (want < 255 ? want : 255)) <= 1);
    }
}

static void ctypes_entries_give_the_same(void **state)
{
    (void)state;
    static struct result one, two;
    float cams[11 * VIEWS];
    struct sample_request q = {.scene = usual, .curve_family = -1};
    assert_int_equal(make(&usual, 1, &one), OK);
    assert_int_equal(sample_photograph(&q, two.radiance, two.depth, cams, &two.key), OK);
    assert_memory_equal(one.radiance, two.radiance, sizeof one.radiance);
    assert_memory_equal(one.depth, two.depth, sizeof one.depth);
    assert_true(one.key == two.key);
    for (int i = 0; i < VIEWS; i++) {
        assert_true(cams[11 * i] == one.cams[i].fx && cams[11 * i + 3] == one.cams[i].cy);
        assert_memory_equal(cams + 11 * i + 4, one.cams[i].q, sizeof one.cams[i].q);
        assert_memory_equal(cams + 11 * i + 8, one.cams[i].t, sizeof one.cams[i].t);
    }
    assert_int_equal(sample_photograph(&q, NULL, two.depth, cams, &two.key), OK);
    assert_true(one.key == two.key);
    assert_int_equal(sample_photograph(&q, two.radiance, NULL, cams, &two.key), OK);
}

static void ctypes_entries_refuse(void **state)
{
    (void)state;
    static struct result r;
    static uint8_t px[3 * PX];
    float cams[11 * VIEWS], stop = 0;
    struct sample_request q = {.scene = usual}, bad = q;
    bad.scene.n_views = 1000;
    assert_int_equal(sample_photograph(&bad, r.radiance, r.depth, cams, &r.key), ERR_ARG);
    assert_non_null(strstr(sample_error(), "1000"));
    bad = q;
    bad.curve_family = CURVE_FAMILIES;
    assert_int_equal(sample_develop(&bad, 1, r.radiance, 1, &stop, px), ERR_ARG);
    assert_non_null(strstr(sample_error(), "curve"));
    bad = q;
    bad.scene.size = -1;
    assert_int_equal(sample_develop(&bad, 1, r.radiance, 1, &stop, px), ERR_ARG);
    assert_int_equal(sample_develop(&q, NAN, r.radiance, 1, &stop, px), ERR_ARG);
    assert_int_equal(sample_develop(&q, 0, r.radiance, 1, &stop, px), ERR_ARG);
    assert_int_equal(sample_develop(&q, 1, r.radiance, 0, &stop, px), ERR_ARG);
    stop = NAN;
    assert_int_equal(sample_develop(&q, 1, r.radiance, 1, &stop, px), ERR_ARG);
    stop = 41;
    assert_int_equal(sample_develop(&q, 1, r.radiance, 1, &stop, px), ERR_ARG);
}

static void cancel_and_memory(void **state)
{
    (void)state;
    static struct result r;
    struct arena tmp;
    atomic_bool cancel = true;
    open_arena(&tmp, 1);
    struct run run = {.tmp = &tmp, .cancel = &cancel};
    assert_int_equal(sample_make(&run, &usual, r.radiance, r.depth, r.cams, &r.key), ERR_CANCELLED);
    cancel = false;
    size_t size = tmp.size;
    for (int i = 1; i < 5; i++) {
        tmp.size = size / 8 * (size_t)i / ARENA_ALIGN * ARENA_ALIGN;
        assert_int_equal(sample_make(&run, &usual, r.radiance, r.depth, r.cams, &r.key), ERR_NOMEM);
        assert_int_equal((int)arena_mark(&tmp), 0);
    }
    tmp.size = size;
    assert_int_equal(sample_make(&run, &usual, r.radiance, r.depth, r.cams, &r.key), OK);
    arena_free(&tmp);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(key_puts_the_middle_view_at_18_percent),
        cmocka_unit_test(sharing_out_does_not_matter),
        cmocka_unit_test(views_agree_about_depth),
        cmocka_unit_test(wrong_requests_are_refused),
        cmocka_unit_test(cameras_take_turns),
        cmocka_unit_test(exposures_brighten),
        cmocka_unit_test(clean_photographs_are_exact),
        cmocka_unit_test(ctypes_entries_give_the_same),
        cmocka_unit_test(ctypes_entries_refuse),
        cmocka_unit_test(cancel_and_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
