/* The resize against Pillow, sample by sample (data: the preprocessing set of the golden data) and
 * by hash, where Pillow 12.0, the version of the release, made the hashes from these pictures
 * (Pillow 13 resizes tall pictures vertically first, which moves some samples by one):
 *     n = numpy.arange(w * h * 3, dtype=uint64)
 *     px = ((n * 2654435761) % 2**32 >> 24).astype(uint8).reshape(h, w, 3)
 *     fnv1a64(numpy.asarray(PIL.Image.fromarray(px).resize((size, size), BICUBIC)).tobytes()) */
#include "core/photo/prep.h"
#include "drivers/format/img.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIZE = 448, N_SAMPLES = 16384, NPY_HEAD = 128 };

/* The array behind the fixed 128-byte head of a .npy file of 4-byte elements. */
static void read_npy(const char *name, void *out)
{
    char path[128], head[NPY_HEAD];
    snprintf(path, sizeof path, "tests/data/prep/%s", name);
    FILE *f = fopen(path, "rb");
    assert_non_null(f);
    assert_int_equal(fread(head, 1, NPY_HEAD, f), NPY_HEAD);
    assert_memory_equal(head, "\x93NUMPY\x01\x00\x76\x00", 10);
    assert_int_equal(fread(out, 4, N_SAMPLES, f), N_SAMPLES);
    fclose(f);
}

static void equals_golden(const char *picture, int i)
{
    static uint32_t index[N_SAMPLES];
    static int32_t u8[N_SAMPLES];
    static float tensor[N_SAMPLES];
    static uint8_t out[SIZE * SIZE * 3];
    static float planar[3 * SIZE * SIZE];
    char name[128];
    struct image8 im;
    struct arena tmp;
    read_npy("idx_602112_16384.npy", index);
    snprintf(name, sizeof name, "out%d.u8.npy", i);
    read_npy(name, u8);
    snprintf(name, sizeof name, "out%d.tensor.npy", i);
    read_npy(name, tensor);
    snprintf(name, sizeof name, "tests/data/prep/%s", picture);
    assert_int_equal(img_read(name, &im), OK);
    assert_int_equal(arena_init(&tmp, "tmp", 1 << 20), OK);
    assert_int_equal(prep_resize(&im, SIZE, &tmp, out), OK);
    assert_int_equal(tmp.used, 0);
    prep_to_float(out, SIZE, planar);
    for (int k = 0; k < N_SAMPLES; k++) {
        assert_int_equal(out[index[k]], u8[k]);
        assert_memory_equal(&planar[index[k]], &tensor[k], sizeof(float));
    }
    arena_free(&tmp);
    img_free(&im);
}

static void resize_equals_golden(void **state)
{
    (void)state;
    equals_golden("src0_640x480.png", 0);
    equals_golden("src1_320x240.png", 1);
}

static void fill_pattern(struct image8 *im)
{
    size_t n = (size_t)im->w * (size_t)im->h * 3;
    im->channels = 3;
    im->px = malloc(n);
    assert_non_null(im->px);
    for (size_t i = 0; i < n; i++)
        im->px[i] = (uint8_t)((uint32_t)(i * 2654435761u) >> 24);
}

static uint64_t fnv1a64(const uint8_t *p, size_t n)
{
    uint64_t h = 0xcbf29ce484222325u;
    for (size_t i = 0; i < n; i++)
        h = (h ^ p[i]) * 0x100000001b3u;
    return h;
}

static void resize_equals_pillow_on_odd_shapes(void **state)
{
    (void)state;
    static const struct {
        int w, h, size;
        uint64_t hash;
    } cases[] = {
        {97, 31, 56, 0x7f14794e2478ff6cu}, {31, 97, 14, 0x972da39d9fa9d175u},
        {1, 1, 28, 0xbc20052c2d152825u},   {3000, 2, 42, 0xdb6f5dfeb959cbe6u},
        {56, 90, 56, 0x0751ac89d1b36c0cu}, {5, 700, 3, 0xb4d9d9fd17c4678cu},
    };
    static uint8_t out[64 * 64 * 3];
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct image8 im = {.w = cases[i].w, .h = cases[i].h};
        struct arena tmp;
        fill_pattern(&im);
        assert_int_equal(arena_init(&tmp, "tmp", 1 << 20), OK);
        assert_int_equal(prep_resize(&im, cases[i].size, &tmp, out), OK);
        assert_int_equal(fnv1a64(out, 3 * (size_t)(cases[i].size * cases[i].size)), cases[i].hash);
        arena_free(&tmp);
        free(im.px);
    }
}

/* Three shots of different shapes with exposures 2, 0.125, 32: log2 1, -3, 5, middle 1. */
static void capture_open(struct capture *c, struct shot shots[3])
{
    static const double exposure[3] = {2.0, 0.125, 32.0};
    memset(shots, 0, 3 * sizeof *shots);
    for (int i = 0; i < 3; i++) {
        struct shot *s = &shots[i];
        s->image.w = 60 + 10 * i;
        s->image.h = 40;
        fill_pattern(&s->image);
        s->exposure = exposure[i];
        s->has_camera = true;
        s->cam = (struct camera){
            .w = s->image.w, .h = 40, .fx = 50, .fy = 52, .cx = 30, .cy = 20, .q = {1}, .t = {7}};
        snprintf(s->name, NAME_CAP, "shot_%d.png", i);
    }
    *c = (struct capture){3, shots};
}

static void capture_close(struct capture *c)
{
    for (int i = 0; i < c->n; i++)
        free(c->shots[i].image.px);
}

static struct prep_size square = {56, true};

/* Runs with exactly the planned memory; the caller frees the arenas. */
static err_t run_planned(const struct capture *c, int threads, struct arena *keep, struct views *v)
{
    struct plan plan = plan_begin(threads);
    struct arena tmp;
    struct run r = {.keep = keep, .tmp = &tmp};
    prep_plan_capture(&plan, c, NULL, square);
    assert_int_equal(pool_open(&r.pool, threads), OK);
    assert_int_equal(arena_init(keep, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
    err_t e = prep_run(&r, c, square, v);
    assert_int_equal(tmp.used, 0);
    if (!e)
        assert_true(tmp.peak <= plan.tmp.peak && keep->used <= plan.keep.peak);
    else
        assert_int_equal(keep->used, 0);
    arena_free(&tmp);
    pool_close(r.pool);
    return e;
}

static void run_fills_views(void **state)
{
    (void)state;
    struct shot shots[3];
    struct capture c;
    struct views one, three;
    struct arena keep1, keep3, tmp;
    static uint8_t alone[56 * 56 * 3];
    capture_open(&c, shots);
    assert_int_equal(run_planned(&c, 1, &keep1, &one), OK);
    assert_int_equal(run_planned(&c, 3, &keep3, &three), OK);
    assert_memory_equal(one.rgb, three.rgb, 3 * sizeof alone);
    assert_int_equal(arena_init(&tmp, "tmp", 1 << 20), OK);
    assert_int_equal(prep_resize(&shots[2].image, 56, &tmp, alone), OK);
    assert_memory_equal(one.rgb + 2 * sizeof alone, alone, sizeof alone);
    assert_int_equal(one.n, 3);
    assert_int_equal(one.size, 56);
    assert_string_equal(one.names[1], "shot_1.png");
    assert_true(one.log2t[0] == 1.0f && one.log2t[1] == -3.0f && one.log2t[2] == 5.0f &&
                one.mid_log2t == 1.0f);
    const struct camera *cam = &one.cams[1]; // 70 x 40 -> 56 x 56
    assert_true(cam->w == 56 && cam->h == 56 && cam->t[0] == 7.0f && cam->q[0] == 1.0f);
    assert_true(fabsf(cam->fx - 40.0f) < 1e-5f && fabsf(cam->cx - 24.0f) < 1e-5f);
    assert_true(fabsf(cam->fy - 72.8f) < 1e-5f && fabsf(cam->cy - 28.0f) < 1e-5f);
    arena_free(&tmp);
    arena_free(&keep1);
    arena_free(&keep3);
    shots[1].has_camera = false;
    assert_int_equal(run_planned(&c, 2, &keep1, &one), OK);
    assert_null(one.cams);
    arena_free(&keep1);
    capture_close(&c);
}

/* The long edge is that of the view, and each keeps its shape. */
static void views_keep_their_shapes(void **state)
{
    (void)state;
    static const int h[3] = {37, 32, 28}; // of 60, 70, 80 x 40
    struct shot shots[3];
    struct capture c;
    struct views v;
    struct arena keep;
    size_t at = 0;
    capture_open(&c, shots);
    square.square = false;
    assert_int_equal(run_planned(&c, 2, &keep, &v), OK);
    for (int i = 0; i < 3; i++) {
        const struct extent *e = &v.extent[i];
        assert_true(e->w == 56 && e->h == h[i] && e->at == at);
        assert_true(v.cams[i].w == 56 && v.cams[i].h == h[i]);
        assert_float_equal(v.cams[i].fx, 50 * 56.0f / (float)(60 + 10 * i), 1e-4);
        assert_float_equal(v.cams[i].fy, 52 * (float)h[i] / 40, 1e-4);
        at += extent_pixels(e);
    }
    assert_true(extent_total(v.extent, 3) == at && v.size == 56 && v.aspect == 1);
    const struct extent cover = extent_cover(v.extent, 3), high = prep_extent(square, 10, 4000);
    assert_true(cover.w == 56 && cover.h == 37 && cover.at == 56 * 37);
    assert_true(high.w == 1 && high.h == 56); // never nothing
    arena_free(&keep);
    shots[1].again = true;
    assert_int_equal(run_planned(&c, 2, &keep, &v), ERR_ARG);
    assert_non_null(strstr(err_text(), "shot_1.png: 70 x 40 px, but shot_0.png from the same"));
    arena_free(&keep);
    square.square = true;
    capture_close(&c);
}

/* Shots 0 and 1 are one place: the second goes behind the third. */
static void exposures_go_behind_places(void **state)
{
    (void)state;
    struct shot shots[3];
    struct capture c;
    struct views each, v;
    struct arena keep[2];
    const size_t bytes = 3 * 56 * 56;
    capture_open(&c, shots);
    shots[1].image.w = shots[1].cam.w = 60; // as shot 0
    assert_int_equal(run_planned(&c, 1, &keep[0], &each), OK);
    assert_int_equal(prep_places(&c), 3);
    shots[0].again = true; // of nothing before it
    shots[1].again = true;
    shots[2].cam.t[0] = 8;
    assert_int_equal(prep_places(&c), 2);
    assert_int_equal(run_planned(&c, 2, &keep[1], &v), OK);
    assert_true(v.n == 2 && v.n_more == 1 && v.place[0] == 0);
    assert_string_equal(v.names[1], "shot_2.png");
    assert_string_equal(v.names[2], "shot_1.png");
    assert_true(v.log2t[1] == 5 && v.log2t[2] == -3 && v.mid_log2t == 1);
    assert_float_equal(v.aspect, (float)c.shots[0].image.h / (float)c.shots[0].image.w, 1e-6f);
    assert_true(v.cams[0].t[0] == 7 && v.cams[1].t[0] == 8);
    assert_memory_equal(v.rgb + bytes, each.rgb + 2 * bytes, bytes);
    assert_memory_equal(v.rgb + 2 * bytes, each.rgb + bytes, bytes);
    assert_true(views_next(&v, 0, 0) == 2 && views_next(&v, 0, 2) == -1);
    assert_int_equal(views_next(&v, 1, 1), -1);
    arena_free(&keep[0]);
    arena_free(&keep[1]);
    capture_close(&c);
}

static const struct capture *stored;
static int decoded, released, broken;

static err_t decode(void *ctx, int i, struct image8 *out)
{
    assert_ptr_equal(ctx, &decoded);
    if (i == broken)
        return err_fail(ERR_IO, "%s: torn", stored->shots[i].name);
    *out = stored->shots[i].image;
    decoded++;
    return OK;
}

static void release(struct image8 *im)
{
    assert_non_null(im->px);
    released++;
    assert_int_equal(decoded, released); // one at a time with one thread
}

/* Pixels that are read shot by shot give the same views. */
static void pixels_may_come_later(void **state)
{
    (void)state;
    struct shot shots[3], bare[3];
    struct capture c, later = {3, bare};
    struct views now, v;
    struct arena keep, more, tmp;
    struct run r = {.keep = &more, .tmp = &tmp};
    const struct prep_source from = {.decode = decode, .release = release, .ctx = &decoded};
    capture_open(&c, shots);
    memcpy(bare, shots, sizeof bare);
    for (int i = 0; i < 3; i++)
        bare[i].image.px = NULL;
    stored = &c;
    assert_int_equal(run_planned(&c, 1, &keep, &now), OK);
    struct plan plan = plan_begin(1);
    prep_plan_capture(&plan, &later, &from, square);
    assert_int_equal(arena_init(&more, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
    assert_int_equal(prep_run(&r, &later, square, &v), ERR_ARG); // no pixels
    broken = 2;
    assert_int_equal(prep_read(&r, &later, &from, square, &v), ERR_IO);
    assert_true(more.used == 0 && tmp.used == 0 && decoded == released);
    broken = -1;
    assert_int_equal(prep_read(&r, &later, &from, square, &v), OK);
    assert_true(decoded == 5 && released == 5);
    assert_memory_equal(v.rgb, now.rgb, 3 * 3 * 56 * 56);
    arena_free(&keep);
    arena_free(&more);
    arena_free(&tmp);
    capture_close(&c);
}

static err_t decode16(void *ctx, int i, struct image16 *out)
{
    const struct image8 *in = &stored->shots[i].image;
    (void)ctx;
    *out = (struct image16){in->w, in->h, 3, malloc(6 * (size_t)in->w * (size_t)in->h)};
    for (int k = 0; k < 3 * in->w * in->h; k++)
        out->px[k] = (uint16_t)(257 * in->px[k]);
    return OK;
}

static void release16(struct image16 *im)
{
    free(im->px);
}

/* Shots of 16 bits give planes of both kinds; a shot of 8 among them takes the deep ones away. */
static void deep_shots_have_planes_of_16_bits(void **state)
{
    (void)state;
    struct shot shots[3], bare[3];
    struct capture c, later = {3, bare};
    struct views now, v;
    struct arena keep, more, tmp;
    struct run r = {.keep = &more, .tmp = &tmp};
    const struct prep_source from = {decode, release, &decoded, decode16, release16, NULL};
    capture_open(&c, shots);
    memcpy(bare, shots, sizeof bare);
    for (int i = 0; i < 3; i++)
        bare[i].deep = true;
    stored = &c;
    assert_int_equal(run_planned(&c, 1, &keep, &now), OK);
    struct plan plan = plan_begin(1);
    prep_plan_capture(&plan, &later, &from, square);
    assert_int_equal(arena_init(&more, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
    assert_int_equal(prep_read(&r, &later, &from, square, &v), OK);
    assert_true(v.deep);
    for (int i = 0; i < 3 * 3 * 56 * 56; i++) { // 8-bit passes round once more
        assert_true(abs(v.rgb16[i] - 257 * now.rgb[i]) <= 2 * 257);
        assert_int_equal(v.rgb[i], (v.rgb16[i] + 128) / 257);
    }
    arena_reset(&more, 0);
    bare[1].deep = false;
    assert_false(prep_is_deep(&later, &from));
    assert_int_equal(prep_read(&r, &later, NULL, square, &v), OK);
    assert_true(!v.deep && !v.rgb16);
    arena_free(&keep);
    arena_free(&more);
    arena_free(&tmp);
    capture_close(&c);
}

/* The left half of every shot is masked, but for shot 1. */
static err_t decode_mask(void *ctx, int i, struct image8 *out)
{
    static uint8_t px[1 << 17];
    const struct image8 *in = &stored->shots[i].image;
    ++*(int *)ctx;
    assert_true(3 * in->w * in->h <= 1 << 17);
    *out = (struct image8){in->w, in->h, 3, px};
    for (int k = 0; k < in->w * in->h; k++)
        memset(px + 3 * k, k % in->w < in->w / 2 ? 0 : 255, 3);
    return OK;
}

/* Masks are resized with the photographs; two pixels more on their border are masked. */
static void masks_become_those_of_views(void **state)
{
    (void)state;
    struct shot shots[3], bare[3];
    struct capture c, later = {3, bare};
    struct views now, v;
    struct arena keep, more, tmp;
    struct run r = {.keep = &more, .tmp = &tmp};
    const struct prep_source from = {
        .decode = decode, .release = release, .ctx = &decoded, .decode_mask = decode_mask};
    decoded = released = 0;
    capture_open(&c, shots);
    memcpy(bare, shots, sizeof bare);
    bare[0].masked = bare[2].masked = true;
    stored = &c;
    assert_int_equal(run_planned(&c, 1, &keep, &now), OK);
    assert_null(now.masked);
    struct plan plan = plan_begin(1);
    prep_plan_capture(&plan, &later, &from, square);
    assert_int_equal(arena_init(&more, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
    assert_int_equal(prep_read(&r, &later, &from, square, &v), OK);
    assert_true(decoded == 5 && released == 5);
    assert_memory_equal(v.rgb, now.rgb, 3 * 3 * 56 * 56);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 56 * 56; k++)
            if (k % 56 < 28 || k % 56 > 31)
                assert_int_equal(views_masked(&v, i)[k], i != 1 && k % 56 < 28);
    assert_true(views_hides(&v, 0, 28) && views_hides_any(&v, 0, 26, 3, 3));
    assert_false(views_hides_any(&v, 0, 32, 3, 3) || views_hides_any(&v, 1, 0, 0, 9));
    arena_free(&keep);
    arena_free(&more);
    arena_free(&tmp);
    capture_close(&c);
}

static void refused(struct capture *c, const char *words)
{
    struct arena keep;
    struct views v;
    assert_int_equal(run_planned(c, 2, &keep, &v), ERR_ARG);
    if (!strstr(err_text(), words))
        fail_msg("no \"%s\" in \"%s\"", words, err_text());
    assert_int_equal(v.n, 0);
    assert_null(v.rgb);
    arena_free(&keep);
}

static void run_refuses(void **state)
{
    (void)state;
    static const double bad[4] = {0.0, -1.0, NAN, INFINITY};
    struct shot shots[3];
    struct capture c, none = {0, shots};
    capture_open(&c, shots);
    refused(&none, "no photograph");
    for (int i = 0; i < 4; i++) {
        shots[1].exposure = bad[i];
        refused(&c, "shot_1.png");
    }
    shots[1].exposure = 1.0;
    shots[2].cam.w = 81;
    refused(&c, "shot_2.png");
    shots[2].cam.w = 80;
    shots[0].image.channels = 4;
    refused(&c, "shot_0.png");
    capture_close(&c);
}

static void run_can_be_cancelled(void **state)
{
    (void)state;
    struct shot shots[3];
    struct capture c;
    struct views v;
    struct arena keep, tmp;
    atomic_bool cancel = true;
    struct run r = {.keep = &keep, .tmp = &tmp, .cancel = &cancel};
    capture_open(&c, shots);
    assert_int_equal(arena_init(&keep, "keep", 1 << 20), OK);
    assert_int_equal(arena_init(&tmp, "tmp", 1 << 20), OK);
    assert_int_equal(prep_run(&r, &c, square, &v), ERR_CANCELLED);
    assert_int_equal(keep.used + tmp.used, 0);
    cancel = false;
    assert_int_equal(prep_run(&r, &c, (struct prep_size){PREP_SIZE_MAX + 1, true}, &v), ERR_ARG);
    assert_int_equal(prep_run(&r, &c, (struct prep_size){0, true}, &v), ERR_ARG);
    arena_free(&keep);
    assert_int_equal(arena_init(&keep, "keep", 1000), OK);
    assert_int_equal(prep_run(&r, &c, square, &v), ERR_NOMEM);
    assert_int_equal(keep.used + tmp.used, 0);
    arena_free(&keep);
    arena_free(&tmp);
    capture_close(&c);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(resize_equals_golden),
        cmocka_unit_test(resize_equals_pillow_on_odd_shapes),
        cmocka_unit_test(run_fills_views),
        cmocka_unit_test(views_keep_their_shapes),
        cmocka_unit_test(exposures_go_behind_places),
        cmocka_unit_test(pixels_may_come_later),
        cmocka_unit_test(deep_shots_have_planes_of_16_bits),
        cmocka_unit_test(masks_become_those_of_views),
        cmocka_unit_test(run_refuses),
        cmocka_unit_test(run_can_be_cancelled),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
