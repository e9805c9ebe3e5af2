/* What is left out of photographs of the wall of refine_world.h, by scores that are made up. */
#include "core/refine/outliers.h"

#include "tests/unit/core/refine/refine_world.h"

enum { EDGE = S / OUTLIERS_PX, CELLS = EDGE * EDGE };

static struct outliers O;
static struct raster rs;

static void open_scores(void)
{
    open_world(2, 0);
    assert_int_equal(outliers_layout(&O, &W.keep, &W.v, OUTLIERS_PX), OK);
    assert_int_equal(raster_init(&rs, &W.tmp, CAP, S, S, false), OK);
    outliers_begin(&O);
    for (int i = 0; i < V * CELLS; i++)
        O.score[i] = 0.01f;
}

/* Cells [x0, x1) x [y0, y1) of photograph k. */
static void score(int k, const int x[2], const int y[2], float v)
{
    for (int i = 0; i < CELLS; i++)
        if (i % EDGE >= x[0] && i % EDGE < x[1] && i / EDGE >= y[0] && i / EDGE < y[1])
            O.score[k * CELLS + i] = v;
}

/* Cells that are left out of photograph k, after a judgement. */
static int judged(int k)
{
    struct scene s = W.start;
    int n = 0;
    bool changed;
    uint8_t before[V * CELLS];
    s.g = W.truth.g;
    memcpy(before, O.skip, sizeof before);
    assert_int_equal(outliers_judge(&W.r, &O, &rs, &s, &changed), OK);
    assert_int_equal(changed, memcmp(before, O.skip, sizeof before) != 0);
    for (int i = 0; i < CELLS; i++)
        n += O.skip[k * CELLS + i];
    assert_true((outliers_skip(&O, k) != NULL) == (n > 0));
    assert_float_equal(outliers_share(&O, k), (float)n / CELLS, 1e-6);
    return n;
}

static const int MIDDLE[2] = {4, 8};

static void test_patch(void **state)
{
    (void)state;
    open_scores();
    score(2, MIDDLE, MIDDLE, 0.3f);
    assert_int_equal(judged(2), 36 - 4); // with the cells around, but for the corners
    for (int k = 0; k < V; k++)
        assert_true(k == 2 || judged(k) == 0);
    score(2, MIDDLE, MIDDLE, 0.01f); // explained now
    assert_int_equal(judged(2), 0);
    close_world();
}

static void test_no_patch(void **state)
{
    (void)state;
    open_scores();
    score(2, MIDDLE, (const int[2]){5, 6}, 0.3f); // an edge
    assert_int_equal(judged(2), 0);
    score(2, MIDDLE, MIDDLE, 0.05f); // less than curves and cameras are off
    assert_int_equal(judged(2), 0);
    score(2, (const int[2]){0, EDGE}, (const int[2]){0, EDGE}, 0.1f); // all of it is off
    score(2, MIDDLE, MIDDLE, 0.3f);
    assert_int_equal(judged(2), 0);
    score(2, (const int[2]){0, EDGE}, (const int[2]){0, EDGE}, NAN); // a hostile checkpoint
    assert_int_equal(judged(2), 0);
    close_world();
}

/* Without two others that show the place and are explained, nobody knows who is right. */
static void test_witnesses(void **state)
{
    (void)state;
    for (int others = V - 1; others >= 0; others--) {
        open_scores();
        for (int k = 0; k < V; k++)
            if (k != 2 && k < V - others + (others < 3))
                score(k, (const int[2]){0, EDGE}, (const int[2]){0, EDGE}, -1);
        score(2, MIDDLE, MIDDLE, 0.3f);
        int known = 0;
        for (int k = 0; k < V; k++)
            known += k != 2 && O.score[k * CELLS] > 0;
        assert_true((judged(2) > 0) == (known >= 2));
        close_world();
    }
    open_scores(); // the others look elsewhere
    for (int k = 0; k < V; k++)
        W.cams[k].t[0] += k == 2 ? 0 : 50;
    score(2, MIDDLE, MIDDLE, 0.3f);
    assert_int_equal(judged(2), 0);
    close_world();
    open_scores(); // they stand behind another wall
    struct gaussians *g = &W.truth.g;
    for (int p = 0; p < gaussians_planes(0); p++)
        for (int i = 0; i < g->n; i++)
            g->plane[p][g->n + i] = p == G_MU + 2 ? -1 : g->plane[p][i];
    g->n *= 2;
    for (int k = 0; k < V; k++)
        W.cams[k].t[2] += k == 2 ? 0 : 2;
    score(2, MIDDLE, MIDDLE, 0.3f);
    assert_int_equal(judged(2), 0);
    close_world();
}

/* Most photographs have as many patches: the scene is wrong, not they. */
static void test_all(void **state)
{
    (void)state;
    open_scores();
    for (int k = 0; k < V; k++)
        score(k, MIDDLE, (const int[2]){k % 3 * 4, k % 3 * 4 + 4}, 0.3f);
    for (int k = 0; k < V; k++)
        assert_int_equal(judged(k), 0);
    close_world();
}

/* Other exposures of the place are witnesses, too; its cameras need not show it. */
static void test_exposures(void **state)
{
    (void)state;
    open_world(2, 0);
    take_brackets(1);
    assert_int_equal(outliers_layout(&O, &W.keep, &W.v, OUTLIERS_PX), OK);
    assert_int_equal(raster_init(&rs, &W.tmp, CAP, S, S, false), OK);
    outliers_begin(&O);
    for (int k = 0; k < V + BRACKET - 1; k++)
        score(k, (const int[2]){0, EDGE}, (const int[2]){0, EDGE}, k % V ? -1 : 0.01f);
    score(V, (const int[2]){0, EDGE}, (const int[2]){0, EDGE}, 0.01f);
    score(0, MIDDLE, MIDDLE, 0.3f);
    assert_int_equal(judged(0), 0); // one other
    score(V + 1, (const int[2]){0, EDGE}, (const int[2]){0, EDGE}, 0.01f);
    assert_int_equal(judged(0), 36 - 4);
    close_world();
}

static void test_see(void **state)
{
    (void)state;
    open_scores();
    outliers_begin(&O);
    for (int i = 0; i < 3 * CELLS; i++)
        O.excess[i] = (float)(i % (3 * EDGE) / EDGE == 1 ? -i : i % 7);
    const struct render pic = {.w = 3 * OUTLIERS_PX - 5, .h = 2 * OUTLIERS_PX - 5};
    const struct loss_input part = {
        .pic = &pic, .x = 2 * OUTLIERS_PX, .y = OUTLIERS_PX, .cell_px = OUTLIERS_PX};
    assert_int_equal(outliers_see(NULL, &O, 3, &part), OK);
    for (int k = 0; k <= 300; k++)
        assert_int_equal(outliers_due(k, 300),
                         k == 15 || k == 30 || k == 60 || k == 120 || k == 180 || k == 240);
    for (int i = 0; i < V * CELLS; i++) {
        const int x = i % EDGE, y = i / EDGE % EDGE;
        const bool in = i / CELLS == 3 && x >= 2 && x < 5 && y >= 1 && y < 3;
        assert_float_equal(O.score[i], in ? (float)((3 * y + 1) * EDGE + x) : -1, 0);
    }
    close_world();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_patch),     cmocka_unit_test(test_no_patch),
        cmocka_unit_test(test_witnesses), cmocka_unit_test(test_all),
        cmocka_unit_test(test_exposures), cmocka_unit_test(test_see),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
