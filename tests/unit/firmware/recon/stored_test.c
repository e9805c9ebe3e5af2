/* Lenses and light of physical cameras, through the cameras of a result and back. */
#include "firmware/recon/stored.h"

#include "firmware/recon/lenses.h"
#include "firmware/recon/shading.h"
#include "tests/unit/expect.h"

#include <math.h>
#include <string.h>

enum { SHOTS = 3 };

/* A landscape and a portrait of camera A, which has a lens and light; B has neither. */
static void make_shots(struct shot shots[SHOTS], struct capture *c)
{
    static const char *const names[SHOTS] = {"0.jpg", "1.jpg", "2.jpg"};
    memset(shots, 0, SHOTS * sizeof *shots);
    for (int i = 0; i < SHOTS; i++) {
        strcpy(shots[i].name, names[i]);
        strcpy(shots[i].camera_id, i < 2 ? "A" : "B");
        shots[i].taken_w = i == 1 ? 600 : 800;
        shots[i].taken_h = i == 1 ? 800 : 600;
        shots[i].turned = i == 1;
    }
    *c = (struct capture){SHOTS, shots};
}

static void make_result(const struct capture *c, struct job_result *j)
{
    *j = (struct job_result){.capture = c, .n_found = 2, .n_light = 1};
    j->found[0] =
        (struct job_lens){.camera_id = "A",
                          .edge = 400,
                          .resampled = true,
                          .lens = {LENS_OPENCV, 300, 300, 4, -1, {-0.1, 0.01, 0.002, 0.001}, 0}};
    j->found[1] = (struct job_lens){.camera_id = "B", .edge = 400, .lens = {.fx = 500, .fy = 500}};
    for (int k = 0; k < 2; k++)
        expect_ok(lens_init(&j->found[k].lens));
    strcpy(j->light[0].camera_id, "A");
    j->light[0].found.model = (struct shade_model){{-0.5, 0.1, 0}, {0.25, 0, -0.25}};
    j->light[0].found.kept[SHADE_FIT_V2] = true;
}

/* What a result writes; order: of its views. */
static void write_rig(const struct job_result *j, const int order[SHOTS], struct rig_view *v)
{
    memset(v, 0, SHOTS * sizeof *v);
    for (int i = 0; i < SHOTS; i++) {
        const struct shot *s = &j->capture->shots[order[i]];
        bool resampled;
        strcpy(v[i].name, s->name);
        stored_put(j, s, &v[i]);
        assert_true(lenses_find(j, s, &v[i].photograph.lens, &resampled));
        v[i].cam = (struct camera){400, 300, 250, 250, 200, 150, {1}, {0}};
        if (resampled) {
            v[i].photograph.w = s->taken_w;
            v[i].photograph.h = s->taken_h;
        }
    }
}

static void cameras_come_back(void **state)
{
    (void)state;
    static struct job_result j, back;
    static const int orders[2][SHOTS] = {{0, 1, 2}, {1, 2, 0}}; // the portrait first
    struct shot shots[SHOTS];
    struct capture c;
    make_shots(shots, &c);
    make_result(&c, &j);
    for (int k = 0; k < 2; k++) {
        struct rig_view views[SHOTS];
        struct rig rig = {.n = SHOTS, .views = views};
        write_rig(&j, orders[k], views);
        memset(&back, 0, sizeof back);
        stored_light(&rig, &back);
        stored_lenses(&rig, &c, &back);
        assert_int_equal(back.n_light, 1);
        assert_true(shading_found(&back) && back.light[0].photographs == 2);
        assert_int_equal(back.n_found, 2);
        for (int i = 0; i < SHOTS; i++) {
            struct lens was, is;
            struct shade_model light, stored;
            bool resampled, again;
            assert_true(lenses_find(&j, &shots[i], &was, &resampled));
            assert_true(lenses_find(&back, &shots[i], &is, &again));
            assert_true(again == resampled && is.model == was.model);
            double x[LENS_PARAMS], y[LENS_PARAMS];
            (void)lens_params(&was, x);
            for (int p = lens_params(&is, y) - 1; p >= 0 && resampled; p--)
                assert_true(fabs(x[p] - y[p]) < 1e-9);
            assert_true(resampled || is.fx == 250.0 * 800 / 400);
            assert_true(shading_model(&j, shots[i].camera_id, &light) ==
                        shading_model(&back, shots[i].camera_id, &stored));
            if (i < 2)
                assert_memory_equal(&light, &stored, sizeof light);
        }
    }
}

/* Results that say nothing about physical cameras. */
static void nothing_is_made_up(void **state)
{
    (void)state;
    static struct job_result back;
    struct rig_view views[SHOTS];
    struct rig rig = {.n = SHOTS, .views = views};
    struct shot shots[SHOTS];
    struct capture c;
    make_shots(shots, &c);
    memset(views, 0, sizeof views);
    stored_light(&rig, &back);
    stored_lenses(&rig, &c, &back);
    assert_true(back.n_light == 0 && back.n_found == 0 && !shading_found(&back));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(cameras_come_back),
        cmocka_unit_test(nothing_is_made_up),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
