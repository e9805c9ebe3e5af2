/* Two fields of sky of different colours, apart by a given angle, on the shell of two cameras. */
#include "core/stereo/gap.h"

#include "core/base/gaussians.h"
#include "tests/unit/expect.h"

#include <math.h>
#include <string.h>

enum { ACROSS = 20, FIELD = ACROSS * ACROSS, MAX = 4000 };

static const float SPACING = 0.01f; // rad

struct world {
    struct camera cams[2];
    struct shell shell;
    struct gaussians g;
    struct arena keep, tmp;
    struct run run;
};

static void direction(float right, float down, float *d)
{
    d[0] = sinf(right) * cosf(down);
    d[1] = sinf(down);
    d[2] = cosf(right) * cosf(down);
}

static void add(struct world *w, float right, float down, float radius, float colour)
{
    const int i = w->g.n++;
    float d[3];
    direction(right, down, d);
    for (int k = 0; k < 3; k++) {
        w->g.plane[G_MU + k][i] = w->shell.middle[k] + radius * d[k];
        w->g.plane[G_LOG_SCALE + k][i] = logf(0.8f * SPACING * radius);
        w->g.plane[G_SH + k][i] = colour;
    }
    w->g.plane[G_QUAT][i] = 1;
}

/* The fields begin at +-gap / 2 on both sides of the direction z. */
static void make_world(struct world *w, float gap, float radius)
{
    memset(w, 0, sizeof *w);
    for (int i = 0; i < 2; i++)
        w->cams[i] = (struct camera){.w = 64, .h = 64, .fx = 64, .fy = 64, .q = {1}};
    w->cams[1].t[0] = -1;
    w->shell = shell_of(w->cams, 2);
    struct plan plan = plan_begin(1);
    expect_ok(gaussians_init(&w->g, &plan.keep, MAX, 0));
    gap_plan(&plan);
    assert_int_equal(arena_init(&w->tmp, "tmp", plan.tmp.peak), OK);
    assert_int_equal(arena_init(&w->keep, "keep", plan.keep.peak), OK);
    w->run = (struct run){.keep = &w->keep, .tmp = &w->tmp};
    expect_ok(gaussians_init(&w->g, &w->keep, MAX, 0));
    for (int k = 0; k < FIELD; k++) {
        const float right = 0.5f * gap + SPACING * (float)(k % ACROSS);
        const float down = SPACING * ((float)(k / ACROSS) - 0.5f * ACROSS);
        add(w, right, down, radius * w->shell.radius, 1);
        add(w, -right, down, radius * w->shell.radius, 3);
    }
}

static void free_world(struct world *w)
{
    arena_free(&w->keep);
    arena_free(&w->tmp);
}

/* Share of the directions between the fields that a new splat covers. */
static float covered(const struct world *w, float gap)
{
    int n = 0, hit = 0;
    for (int k = 0; k < 100; k++) {
        float d[3], best = 1;
        direction(gap * ((float)(k % 10) + 0.5f) / 10 - 0.5f * gap, 0.015f * (float)(k / 10 - 5),
                  d);
        for (int i = 2 * FIELD; i < w->g.n; i++) {
            float off = 0;
            for (int c = 0; c < 3; c++) {
                const float to =
                    (w->g.plane[G_MU + c][i] - w->shell.middle[c]) / w->shell.radius - d[c];
                off += to * to;
            }
            best = fminf(best, sqrtf(off));
        }
        n++;
        hit += best < 0.02f;
    }
    return (float)hit / (float)n;
}

static void sky_between_sky_is_filled(void **state)
{
    (void)state;
    static struct world w;
    const float gap = 0.15f;
    make_world(&w, gap, 1);
    expect_ok(gap_fill(&w.run, &w.shell, &w.g, MAX));
    assert_int_equal(w.tmp.used, 0);
    assert_true(covered(&w, gap) > 0.95f);
    for (int i = 2 * FIELD; i < w.g.n; i++) {
        const float x = (w.g.plane[G_MU][i] - w.shell.middle[0]) / w.shell.radius;
        const float y = (w.g.plane[G_MU + 1][i] - w.shell.middle[1]) / w.shell.radius;
        const float colour = w.g.plane[G_SH + 1][i];
        assert_true(fabsf(x) < 0.5f * gap && fabsf(y) < 0.5f * ACROSS * SPACING + 0.08f);
        assert_true(colour > 0.99f && colour < 3.01f && w.g.plane[G_LOGIT][i] > 3);
        if (fabsf(x) > 0.03f) // nearer to one of them
            assert_true((colour < 2) == (x > 0));
    }
    free_world(&w);
}

static void what_is_far_from_sky_or_no_sky_stays(void **state)
{
    (void)state;
    static struct world w;
    make_world(&w, 0.6f, 1); // 34 degrees
    expect_ok(gap_fill(&w.run, &w.shell, &w.g, MAX));
    assert_int_equal(w.g.n, 2 * FIELD);
    free_world(&w);
    make_world(&w, 0.15f, 0.1f); // inside the shell
    expect_ok(gap_fill(&w.run, &w.shell, &w.g, MAX));
    assert_int_equal(w.g.n, 2 * FIELD);
    free_world(&w);
}

static void limits_hold(void **state)
{
    (void)state;
    static struct world w;
    make_world(&w, 0.15f, 1);
    expect_ok(gap_fill(&w.run, &w.shell, &w.g, 2 * FIELD + 5));
    assert_int_equal(w.g.n, 2 * FIELD + 5);
    w.tmp.size = 1000;
    assert_int_equal(gap_fill(&w.run, &w.shell, &w.g, MAX), ERR_NOMEM);
    assert_int_equal(w.g.n, 2 * FIELD + 5);
    free_world(&w);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sky_between_sky_is_filled),
        cmocka_unit_test(what_is_far_from_sky_or_no_sky_stays),
        cmocka_unit_test(limits_hold),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
