/* Photographs, pictures and scenes when memory runs out anywhere, libraries included. */
#include "core/base/gaussians.h"
#include "drivers/format/cameras.h"
#include "drivers/format/colmapwrite.h"
#include "drivers/format/exrfile.h"
#include "drivers/format/glb.h"
#include "drivers/format/imageset.h"
#include "drivers/format/img.h"
#include "drivers/format/ply.h"
#include "drivers/format/scenefile.h"
#include "drivers/format/sidecar.h"
#include "drivers/format/sog.h"
#include "drivers/format/spz.h"
#include "drivers/format/spzwrite.h"
#include "drivers/format/transforms.h"
#include "tests/fault/alloc_fail.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

enum { W = 20, H = 12, N_SHOTS = 3, N_SPLATS = 5 };

/* A writer that fails must take its file away again. */
static err_t removed(err_t e, const char *path)
{
    return e && access(path, F_OK) == 0 ? err_fail(ERR_BUSY, "%s", "") : e;
}

static err_t picture(void *ctx)
{
    (void)ctx;
    uint8_t px[H * W * 3];
    for (size_t i = 0; i < sizeof px; i++)
        px[i] = (uint8_t)(i * 7);
    const char *path = tmpdir_path("picture.png");
    const struct image8 im = {W, H, 3, px};
    struct image8 back = {0};
    unlink(path);
    err_t e = removed(img_write_png(path, &im), path);
    if (!e)
        e = img_read(path, &back);
    img_free(&back);
    return e;
}

/* Reading only: OpenEXRCore 3.1.5 itself falls when exr_add_part finds no memory. */
static err_t radiance(void *ctx)
{
    (void)ctx;
    struct image back = {0};
    err_t e = exrfile_read("tests/data/exr/piz_half.exr", &back);
    exrfile_free(&back);
    return e;
}

static err_t set(void *ctx)
{
    (void)ctx;
    const char *rig = tmpdir_path("cameras.json");
    const struct imageset_request request = {.images = tmpdir_path("images"), .rig = rig};
    struct imageset s = {0};
    err_t e = imageset_list(&request, &s);
    if (!e)
        e = imageset_load(&s);
    imageset_free(&s);
    return e;
}

/* Cameras and points as other programs read them. */
static err_t rigs(void *ctx)
{
    (void)ctx;
    const char *json = tmpdir_path("transforms.json"), *ply = tmpdir_path("points.ply");
    struct colmap_point p[2] = {{{1, 2, 3}, {4, 5, 6}}, {{0, 0, 1}, {7, 8, 9}}};
    struct colmap_points points = {2, p}, back = {0};
    struct rig in, out = {0};
    err_t e = cameras_read(tmpdir_path("cameras.json"), &in);
    if (!e)
        e = colmapwrite_run(tmpdir_root, true, &in, &points);
    if (!e)
        e = colmap_read(tmpdir_root, &out);
    cameras_free(&out);
    if (!e)
        e = colmap_read_points(tmpdir_root, &back);
    colmap_free_points(&back);
    unlink(json), unlink(ply);
    if (!e)
        e = removed(transforms_write(json, &in, "points.ply"), json);
    if (!e)
        e = removed(transforms_write_points(ply, &points), ply);
    if (!e)
        e = transforms_read(json, &out);
    cameras_free(&out);
    cameras_free(&in);
    return e;
}

static char names[2][NAME_CAP] = {"a.png", "b.png"};
static float log2t[2] = {-1, 1};
static struct camera cams[2] = {
    {W, W, 10, 10, W / 2., W / 2., {1, 0, 0, 0}, {0, 0, 0}},
    {W, W, 10, 10, W / 2., W / 2., {1, 0, 0, 0}, {1, 0, 0}},
};

static err_t write_scene(const struct scene *s)
{
    const char *ply = tmpdir_path("scene.ply"), *full = tmpdir_path("scene.hdrig"),
               *tone = tmpdir_path("t.json"), *side = tmpdir_path("scene.json");
    unlink(ply), unlink(full), unlink(tone), unlink(side);
    err_t e = removed(ply_write(ply, s), ply);
    if (!e)
        e = removed(scenefile_write(full, s), full);
    if (!e)
        e = removed(sidecar_write(ply, s), side);
    return e ? e : removed(scenefile_write_tone(tone, &s->tone), tone);
}

static err_t read_scene(struct arena *a)
{
    struct splats_info info;
    struct scenefile_info full;
    struct gaussians g;
    struct gaussians_report report;
    struct scene back;
    err_t e = splats_peek(&ply_format, tmpdir_path("scene.ply"), &info);
    if (!e)
        e = splats_read(&ply_format, tmpdir_path("scene.ply"), info.ev, a, &g, &report);
    if (!e)
        e = sidecar_read(tmpdir_path("scene.ply"), info.ev, a, &back);
    if (!e)
        e = scenefile_peek(tmpdir_path("scene.hdrig"), &full);
    return e ? e : scenefile_read(tmpdir_path("scene.hdrig"), a, &back);
}

static err_t make_scene(struct arena *a, struct scene *s)
{
    *s = (struct scene){.n_views = 2, .size = W, .names = names, .log2t = log2t, .cams = cams};
    err_t e = arena_init(a, "test", 1 << 20);
    if (!e)
        e = gaussians_init(&s->g, a, N_SPLATS, 1);
    if (e)
        return e;
    s->g.n = N_SPLATS;
    for (int i = 0; i < N_SPLATS; i++)
        s->g.plane[G_QUAT][i] = 1;
    return OK;
}

static err_t scene(void *ctx)
{
    (void)ctx;
    struct scene s;
    struct arena a;
    err_t e = make_scene(&a, &s);
    if (!e)
        e = write_scene(&s);
    if (!e)
        e = read_scene(&a);
    arena_free(&a);
    return e;
}

struct kind {
    const char *name;
    const struct splats_format *format;
    int version; // for .spz
};

/* What is missing is memory, whatever else it leads to; of JSON the library does not tell. */
static err_t about_memory(err_t e)
{
    if (!e || strstr(err_text(), "memory") || strstr(err_text(), "the system refused"))
        return e;
    fprintf(stderr, "%s\n", err_text());
    return err_fail(e, "%s", "");
}

/* Files of splats that are packed or have a document in them; writing and reading apart, for only
 * one of them waits for the disk. */
static err_t write_packed(void *ctx)
{
    const struct kind *k = ctx;
    const char *path = tmpdir_path(k->name);
    struct scene s;
    struct arena a;
    unlink(path);
    err_t e = make_scene(&a, &s);
    if (!e)
        e = removed(k->version ? spzwrite_scene(path, &s, k->version) : glb_write(path, &s), path);
    arena_free(&a);
    return about_memory(e);
}

static err_t read_packed(void *ctx)
{
    const struct kind *k = ctx;
    const char *path = tmpdir_path(k->name);
    struct splats_info info;
    struct gaussians g;
    struct gaussians_report report;
    struct arena a;
    err_t e = arena_init(&a, "test", 1 << 20);
    if (!e)
        e = splats_peek(k->format, path, &info);
    if (!e)
        e = splats_read(k->format, path, info.ev, &a, &g, &report);
    arena_free(&a);
    return k->version ? about_memory(e) : e;
}

/* Neither its pictures, for libwebp 1.2.4 itself falls when it finds no memory for its Huffman
 * tables, nor its archive, of which libzip 1.7 loses blocks. */
static err_t peek_sog(void *ctx)
{
    struct splats_info info;
    return splats_peek(&sog_format, ctx, &info);
}

static void survives_with(alloc_fail_fn *fn, void *ctx)
{
    int refused = alloc_fail_sweep(fn, ctx);
    print_message("%d failing allocations refused\n", refused);
    assert_true(refused >= 2);
}

static void survives(alloc_fail_fn *fn)
{
    survives_with(fn, NULL);
}

static void pictures_survive(void **state)
{
    (void)state;
    survives(picture);
}

static void radiance_survives(void **state)
{
    (void)state;
    survives(radiance);
}

static void sets_survive(void **state)
{
    (void)state;
    survives(set);
}

static void rigs_survive(void **state)
{
    (void)state;
    survives(rigs);
}

static void scenes_survive(void **state)
{
    (void)state;
    survives(scene);
}

static void packed_splats_survive(void **state)
{
    (void)state;
    static struct kind kinds[] = {
        {"s3.spz", &spz_format, 3}, {"s4.spz", &spz_format, 4}, {"s.glb", &glb_format, 0}};
    for (int k = 0; k < 3; k++) {
        survives_with(write_packed, &kinds[k]);
        survives_with(read_packed, &kinds[k]);
    }
}

static void sog_survives(void **state)
{
    (void)state;
    static char meta[] = "tests/data/splats/one/meta.json";
    survives_with(peek_sog, meta);
}

static int make_set(void **state)
{
    (void)state;
    struct rig_view views[N_SHOTS];
    uint8_t px[H * W * 3] = {0};
    const struct image8 im = {W, H, 3, px};
    tmpdir_make();
    tmpdir_mkdir("images");
    FILE *f = fopen(tmpdir_path("exposure.json"), "w");
    assert_non_null(f);
    for (int i = 0; i < N_SHOTS; i++) {
        char name[32];
        snprintf(name, sizeof name, "images/%d.png", i);
        assert_int_equal(img_write_png(tmpdir_path(name), &im), OK);
        fprintf(f, "%c\"%d.png\": %d", i ? ',' : '{', i, i + 1);
        views[i] = (struct rig_view){.cam = cams[0]};
        views[i].cam.h = H;
        snprintf(views[i].name, NAME_CAP, "%d.png", i);
    }
    fputs("}\n", f);
    assert_int_equal(fclose(f), 0);
    const struct rig rig = {.n = N_SHOTS, .views = views};
    assert_int_equal(cameras_write(tmpdir_path("cameras.json"), &rig), OK);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pictures_survive), cmocka_unit_test(radiance_survives),
        cmocka_unit_test(sets_survive),     cmocka_unit_test(rigs_survive),
        cmocka_unit_test(scenes_survive),   cmocka_unit_test(packed_splats_survive),
        cmocka_unit_test(sog_survives),
    };
    return cmocka_run_group_tests(tests, make_set, tmpdir_teardown);
}
