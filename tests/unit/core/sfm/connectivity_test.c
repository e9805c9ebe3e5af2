/* Two groups of views side by side, by what they see in common. All observations fit. */
#include "core/sfm/connectivity.h"
#include "tests/unit/core/sfm/bundle_job.h"

enum { VIEWS = 9, FIRST = 5, POINTS = 400, GATE = 4 }; // FIRST: views of the first group

static struct {
    struct adjust a;
    struct adjust_lens lens;
    struct adjust_observation obs[POINTS * VIEWS];
    double pose[VIEWS][ADJUST_POSE], point[POINTS][4];
    struct viewgraph_edge edge[VIEWS * (VIEWS - 1) / 2];
    int first[POINTS + 1], lens_of[VIEWS];
    bool placed[VIEWS], in[POINTS * VIEWS];
} t;

/* Views that look ahead, those of a group `step` apart in a row, the groups `gap` apart. */
static void open_row(double step, double gap)
{
    memset(&t, 0, sizeof t);
    t.lens.lens = (struct lens){.model = LENS_PINHOLE, .fx = 400, .fy = 400};
    t.a = (struct adjust){.n_views = VIEWS,
                          .first = t.first,
                          .obs = t.obs,
                          .n_lenses = 1,
                          .lens = &t.lens,
                          .lens_of = t.lens_of,
                          .pose = t.pose[0],
                          .placed = t.placed,
                          .point = t.point[0],
                          .in = t.in};
    scene_state = 5;
    for (int v = 0; v < VIEWS; v++) {
        for (int k = 0; k < 3; k++)
            t.pose[v][4 * k] = 1;
        t.pose[v][9] = -step * v - (v < FIRST ? 0 : gap);
        t.placed[v] = true;
    }
}

/* n points at a depth before one of the views from..to, seen by all of these. */
static void add_points(int n, double depth, int from, int to)
{
    for (int i = 0; i < n; i++) {
        const int track = t.a.n_tracks++, own = (int)scene_uniform(from, to + 1);
        const double x[3] = {scene_uniform(-0.3, 0.3) * depth - t.pose[own][9],
                             scene_uniform(-0.3, 0.3) * depth, depth};
        double *point = t.point[track];
        const double length = sqrt(lin_dot(x, x) + 1);
        int at = t.first[track];
        assert_true(track < POINTS);
        for (int k = 0; k < 4; k++)
            point[k] = (k < 3 ? x[k] : 1) / length;
        for (int v = from; v <= to; v++, at++) {
            const double px[2] = {400 * (x[0] + t.pose[v][9]) / depth,
                                  400 * (x[1] + t.pose[v][10]) / depth};
            t.obs[at] = (struct adjust_observation){(float)px[0], (float)px[1], 2, v};
            t.in[at] = true;
        }
        t.first[track + 1] = at;
    }
}

/* Each group sees things of its own, near by. */
static void add_things(void)
{
    add_points(100, 3, 0, FIRST - 1);
    add_points(100, 3, FIRST, VIEWS - 1);
}

static int count_placed(void)
{
    struct run r = {0};
    struct arena tmp;
    struct viewgraph g = {VIEWS, t.edge};
    int n = 0;
    assert_int_equal(arena_init(&tmp, "tmp", connectivity_plan(VIEWS)), OK);
    r.tmp = &tmp;
    assert_int_equal(connectivity_prune(&r, &g, &t.a, GATE), OK);
    arena_free(&tmp);
    for (int v = 0; v < VIEWS; v++)
        n += t.placed[v];
    return n;
}

/* The skyline holds directions only: the second group may have any size, anywhere. */
static void groups_under_one_sky(void **state)
{
    (void)state;
    open_row(0.2, 10);
    add_things();
    add_points(100, 5000, 0, VIEWS - 1);
    assert_int_equal(count_placed(), FIRST);
    for (int v = 0; v < VIEWS; v++)
        assert_int_equal(t.placed[v], v < FIRST);
}

/* Nor does what is far for each group and near for both together: from one group, all views of the
 * other are in one direction. */
static void groups_far_apart(void **state)
{
    (void)state;
    open_row(0.2, 500);
    add_things();
    add_points(100, 2000, 0, VIEWS - 1);
    assert_int_equal(count_placed(), FIRST);
}

static void groups_before_one_house(void **state)
{
    (void)state;
    open_row(0.2, 2);
    add_things();
    add_points(CONNECTIVITY_LINK, 8, 0, VIEWS - 1);
    assert_int_equal(count_placed(), VIEWS);
}

/* One point fewer than needed. */
static void groups_before_too_little(void **state)
{
    (void)state;
    open_row(0.2, 2);
    add_things();
    add_points(CONNECTIVITY_LINK - 1, 8, 0, VIEWS - 1);
    assert_int_equal(count_placed(), FIRST);
}

/* Nothing tells a distance: views are held by directions as well as these can hold. */
static void camera_that_turns(void **state)
{
    (void)state;
    open_row(0, 0);
    add_things();
    add_points(100, 8, 0, VIEWS - 1);
    assert_int_equal(count_placed(), VIEWS);
}

/* The last view sees things together with two others each: their distances to it are known unless
 * all three stand in a row. */
static void held_by_two(void **state)
{
    (void)state;
    for (int aside = 0; aside < 2; aside++) {
        open_row(0.2, 0.4);
        for (int v = FIRST; v < VIEWS - 1; v++)
            t.placed[v] = false;
        t.pose[0][10] = aside ? -1 : 0;
        add_points(100, 3, 1, FIRST - 1);
        add_points(100, 3, 0, 1);
        add_points(100, 3, 0, 2);
        for (int k = 0; k < 2; k++) {
            const int from = t.a.n_tracks, other = 2 * k;
            add_points(20, 3, other, VIEWS - 1);
            for (int i = t.first[from]; i < t.first[t.a.n_tracks]; i++)
                t.in[i] = t.obs[i].view == other || t.obs[i].view == VIEWS - 1;
        }
        assert_int_equal(count_placed(), aside ? FIRST + 1 : FIRST);
        assert_int_equal(t.placed[VIEWS - 1], aside);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(groups_under_one_sky),    cmocka_unit_test(groups_far_apart),
        cmocka_unit_test(groups_before_one_house), cmocka_unit_test(groups_before_too_little),
        cmocka_unit_test(camera_that_turns),       cmocka_unit_test(held_by_two),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
