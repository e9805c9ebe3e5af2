/* Which photographs share a lens, what is known of it before, and what other photographs of a
 * camera get from one that was found. */
#include "firmware/recon/lenses.h"

#include "tests/unit/expect.h"

#include <math.h>
#include <string.h>

enum { SHOTS = 5 };

/* Two landscapes and a portrait of one camera, and two of another. */
static void make_shots(struct shot shots[SHOTS], struct capture *c)
{
    static const char *const id[SHOTS] = {"A", "B", "A", "A", "B"};
    memset(shots, 0, SHOTS * sizeof *shots);
    for (int i = 0; i < SHOTS; i++) {
        struct shot *s = &shots[i];
        const bool wide = i != 3;
        snprintf(s->name, NAME_CAP, "%d.jpg", i);
        snprintf(s->camera_id, NAME_CAP, "%s", id[i]);
        s->taken_w = s->image.w = wide ? 800 : 600;
        s->taken_h = s->image.h = wide ? 600 : 800;
        s->turned = wide ? 0 : 1;
        s->focal_px = *id[i] == 'A' ? 640 : 0;
    }
    *c = (struct capture){SHOTS, shots};
}

static void make_views(const struct capture *c, char (*names)[NAME_CAP], struct extent *extent,
                       struct views *v)
{
    *v = (struct views){.n = c->n, .size = 400, .names = names, .extent = extent};
    prep_extents(c, (struct prep_size){400, false}, extent);
    for (int i = 0; i < c->n; i++)
        memcpy(names[i], c->shots[i].name, NAME_CAP);
}

static void photographs_are_grouped(void **state)
{
    (void)state;
    static const int want[SHOTS] = {0, 1, 0, 0, 1};
    char names[SHOTS][NAME_CAP];
    struct shot shots[SHOTS];
    struct extent extent[SHOTS];
    struct capture c;
    struct views v;
    struct lenses l;
    struct arena keep;
    expect_ok(arena_init(&keep, "keep", 1 << 20));
    make_shots(shots, &c);
    make_views(&c, names, extent, &v);
    expect_ok(lenses_layout(&l, &keep, v.n));
    lenses_group(&l, &c, &v, &(struct job_config){0});
    assert_int_equal(l.n, 2);
    assert_int_equal(lenses_count(&c), 2);
    for (int i = 0; i < SHOTS; i++)
        assert_int_equal(l.of[i], want[i]);
    assert_int_equal(l.turned[3], 1);
    assert_true(fabs(l.lens[0].start.fx - 320) < 1e-9); // of views half as large
    assert_true(l.lens[1].start.fx == 0);
    lenses_group(&l, &c, &v, &(struct job_config){.fov_deg = 90});
    assert_true(fabs(l.lens[0].start.fx - 200) < 1e-4 && !l.lens[0].focal_guessed);
    lenses_group(&l, &c, &v, &(struct job_config){.fov_deg = 90, .lens = RECIPE_LENS_FISHEYE});
    assert_true(fabs(l.lens[0].start.fx - 200 / (3.14159265358979 / 4)) < 1e-4);
    assert_int_equal(l.lens[0].start.model, LENS_OPENCV_FISHEYE);
    arena_free(&keep);
}

/* A lens found for views of 400 px, in photographs of 800 px, the portrait turned. */
static void others_get_the_lens_of_their_camera(void **state)
{
    (void)state;
    static struct job_result j;
    struct shot shots[SHOTS];
    struct capture c;
    struct lens lens;
    bool resampled;
    make_shots(shots, &c);
    j.n_found = 1;
    j.found[0] =
        (struct job_lens){.camera_id = "A",
                          .edge = 400,
                          .resampled = true,
                          .lens = {LENS_OPENCV, 300, 300, 4, -1, {-0.1, 0.01, 0.002, 0.001}, 0}};
    expect_ok(lens_init(&j.found[0].lens));
    assert_false(lenses_find(&j, &shots[1], &lens, &resampled));
    assert_true(lenses_find(&j, &shots[0], &lens, &resampled));
    assert_true(resampled && lens.fx == 600 && lens.cx == 408 && lens.cy == 298);
    assert_true(lens.term[2] == 0.002 && lens.term[3] == 0.001);
    assert_true(lenses_find(&j, &shots[3], &lens, &resampled));
    assert_true(lens.cx == 302 && lens.cy == 408);
    assert_true(lens.term[2] == 0.001 && lens.term[3] == -0.002);
    lenses_apply(&j, &c);
    assert_int_equal(shots[0].lens.model, LENS_OPENCV);
    assert_int_equal(shots[1].lens.model, LENS_PINHOLE);
    assert_true(shots[0].cam.w == 800 && shots[0].cam.fx < 600 && shots[0].cam.fx > 500);
    assert_true(shots[1].cam.fx == 0 && !shots[0].has_camera);
    j.found[0].resampled = false; // nothing was worth it: the photograph stays as it is
    shots[0].lens = (struct lens){.model = LENS_PINHOLE};
    lenses_apply(&j, &c);
    assert_int_equal(shots[0].lens.model, LENS_PINHOLE);
    assert_true(shots[0].cam.fx == 600);
}

/* The focal length of views that were squeezed to squares is along their width: portraits and
 * landscapes have it in photographs as it is there. */
static void squeezed_views_keep_the_focal_length(void **state)
{
    (void)state;
    static struct job_result j;
    struct lens found[2] = {{.fx = 300, .fy = 300}, {.fx = 300, .fy = 300}};
    struct selfcal_lens selfcal[2] = {{.deviation = {3}}, {.deviation = {3}}};
    const struct bundle_result b = {.lenses = found, .selfcal = selfcal};
    char names[SHOTS][NAME_CAP];
    struct shot shots[SHOTS];
    struct extent extent[SHOTS];
    struct capture c;
    struct lenses l;
    struct arena keep;
    expect_ok(arena_init(&keep, "keep", 1 << 20));
    for (int portrait = 0; portrait < 2; portrait++) {
        make_shots(shots, &c);
        c.shots = shots + (portrait ? 3 : 0);
        c.n = 1;
        make_views(&c, names, extent, &j.views);
        extent[0].w = extent[0].h = 400;
        expect_ok(lenses_layout(&l, &keep, 1));
        l.pinhole[0] = 0;
        lenses_group(&l, &c, &j.views, &(struct job_config){0});
        assert_true(fabs(l.lens[0].start.fx - 640.0 * 400 / shots[portrait ? 3 : 0].taken_w) <
                    1e-9);
        lenses_note(&l, &c, &b, &j);
        lenses_apply(&j, &c);
        assert_true(fabsf(c.shots[0].cam.fx - (portrait ? 450 : 600)) < 1e-3f);
        assert_true(j.found[0].selfcal.deviation[0] == 3); // of the logarithm
    }
    arena_free(&keep);
}

/* Larger views have the frames of the small ones, and no more pixels than were planned. */
static void larger_views_keep_their_frames(void **state)
{
    (void)state;
    static struct job_result j;
    struct extent few[3] = {{448, 286, 0}, {300, 448, 0}, {448, 336, 0}};
    struct extent many[3] = {{1600, 1200, 0}, {1200, 1600, 0}, {1600, 1200, 0}};
    const struct views small = {.n = 2, .n_more = 1, .extent = few};
    struct views large = {.n = 2, .n_more = 1, .extent = many};
    j.n_found = 1;
    j.found[0].resampled = false;
    lenses_reshape(&j, &small, &large);
    assert_true(many[0].w == 1600 && many[0].h == 1200);
    j.found[0].resampled = true;
    lenses_reshape(&j, &small, &large);
    assert_true(many[0].w == 1600 && many[0].h == 1021);
    assert_true(many[1].w == 1071 && many[1].h == 1600);
    assert_true(many[2].w == 1600 && many[2].h == 1200);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(photographs_are_grouped),
        cmocka_unit_test(squeezed_views_keep_the_focal_length),
        cmocka_unit_test(larger_views_keep_their_frames),
        cmocka_unit_test(others_get_the_lens_of_their_camera),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
