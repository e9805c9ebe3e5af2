/* Rigs in rooms against the cameras that made their tracks; input that says little or nothing. */
#include "core/base/rotation.h"
#include "core/sfm/similarity.h"
#include "tests/unit/core/sfm/bundle_job.h"

/* The true cameras, each turned about an axis of its own and moved. */
static void disturb_cameras(const struct scene_rig *s, double degrees, double focal,
                            struct camera *out)
{
    scene_state = 77;
    for (int v = 0; v < s->n_views; v++) {
        const struct camera *c = &s->cams[v];
        double w[3] = {scene_normal(), scene_normal(), scene_normal()}, turn[9], r[9], moved[9];
        double q[4] = {(double)c->q[0], (double)c->q[1], (double)c->q[2], (double)c->q[3]};
        double at[3], t[3];
        lin_normalise(w);
        for (int k = 0; k < 3; k++)
            w[k] *= degrees * DEGREE;
        rotation_exp(w, turn);
        rotation_from_quat(q, r);
        lin_product(turn, r, moved);
        rotation_centre(c, at);
        for (int k = 0; k < 3; k++)
            at[k] += 0.02 * degrees * scene_normal();
        lin_apply(moved, at, t);
        rotation_to_quat(moved, q);
        out[v] = *c;
        out[v].fx = out[v].fy = (float)focal;
        for (int k = 0; k < 4; k++)
            out[v].q[k] = (float)q[k];
        for (int k = 0; k < 3; k++)
            out[v].t[k] = (float)-t[k];
    }
}

/* ---- rigs ---- */

static void narrow_grid_from_tracks(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(1000, 381, 0.3, 15)};
    scene_grid(&j.rig);
    scene_make(&j.rig, &j.tracks);
    run_ok(&j, &(struct bundle_config){0});
    assert_right(&j, 0.1, 0.01, 0.02);
    assert_true(j.out.from_tracks);
    assert_true(j.out.confidence > 0.5f);
    assert_true(j.out.rms_px > 0.4f && j.out.rms_px < 0.8f);
    assert_true(j.out.cams[0].q[0] > 0.99999f); // world of the first camera
    assert_true(fabsf(j.out.cams[0].t[0]) < 1e-5f);
    job_free(&j);
}

static void wide_arc_from_tracks(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(1100, 520, 0.3, 25)};
    scene_arc(&j.rig, 12, 110);
    scene_make(&j.rig, &j.tracks);
    run_ok(&j, &(struct bundle_config){0});
    assert_right(&j, 0.2, 0.01, 0.02);
    job_free(&j);
}

/* 15 degrees off and a focal length wrong by 15 %: world and scale are those of the start. */
static void start_that_is_off(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(250, 381, 0.3, 15)};
    struct camera start[SCENE_VIEWS];
    scene_grid(&j.rig);
    scene_make(&j.rig, &j.tracks);
    disturb_cameras(&j.rig, 15, 1.15 * 381, start);
    run_ok(&j, &(struct bundle_config){.start = start});
    assert_right(&j, 0.1, 0.01, 0.02);
    job_free(&j);
}

/* Too few common tracks for two views: cameras decide, and are adjusted. */
static void start_without_pairs(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(22, 381, 0, 60)};
    struct camera start[SCENE_VIEWS];
    double turn, centre;
    scene_grid(&j.rig);
    scene_make(&j.rig, &j.tracks);
    assert_true(j.tracks.t.n_tracks > 10 && j.tracks.t.n_tracks < 20);
    disturb_cameras(&j.rig, 10, 381, start);
    run_ok(&j, &(struct bundle_config){.start = start});
    compare(&j, &turn, &centre);
    assert_false(j.out.from_tracks);
    assert_true(j.out.n_placed > 12);
    assert_true(turn < 1.5);
    job_free(&j);
}

static double median_of(double *v, int n)
{
    qsort(v, (size_t)n, sizeof *v, ascending);
    return v[n / 2];
}

/* Root of the mean squared distance of the cameras from their middle. */
static double spread_of(const struct camera *cams, int n)
{
    double sum[3] = {0}, square = 0, c[3];
    for (int v = 0; v < n; v++) {
        rotation_centre(&cams[v], c);
        square += lin_dot(c, c) / n;
        for (int k = 0; k < 3; k++)
            sum[k] += c[k] / n;
    }
    return sqrt(square - lin_dot(sum, sum));
}

/* But for its unit: that of the cameras is 1. */
static void world_of_the_start(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(500, 381, 0.2, 15)};
    struct scene_rig *s = &j.rig;
    const size_t plane = (size_t)SCENE_SIZE * SCENE_SIZE;
    scene_grid(s);
    scene_make(s, &j.tracks);
    float *depth = calloc((size_t)s->n_views * plane, sizeof *depth);
    double *off = calloc((size_t)j.tracks.t.n_tracks, sizeof *off);
    int n = 0;
    for (int i = 0; i < j.tracks.t.n; i++) {
        const struct match_observation *obs = &j.tracks.t.obs[i];
        const struct camera *c = &s->cams[obs->view];
        const double q[4] = {(double)c->q[0], (double)c->q[1], (double)c->q[2], (double)c->q[3]};
        double r[9];
        rotation_from_quat(q, r);
        double z = lin_dot(r + 6, j.tracks.point[obs->track]) + (double)c->t[2];
        if (obs->u >= 0 && obs->v >= 0 && obs->u < SCENE_SIZE && obs->v < SCENE_SIZE)
            depth[(size_t)obs->view * plane + (size_t)obs->v * SCENE_SIZE + (size_t)obs->u] =
                (float)(obs->view == 3 ? 2 * z : z);
    }
    run_ok(&j, &(struct bundle_config){.start = s->cams, .start_depth = depth});
    const double unit = spread_of(s->cams, s->n_views);
    assert_float_equal(spread_of(j.out.cams, s->n_views), 1, 1e-4);
    for (int v = 0; v < s->n_views; v++) {
        double a[3], b[3];
        rotation_centre(&j.out.cams[v], a);
        rotation_centre(&s->cams[v], b);
        for (int k = 0; k < 3; k++)
            assert_float_equal(unit * a[k], b[k], 0.03);
        assert_float_equal(unit * (double)j.out.depth_scale[v], v == 3 ? 0.5 : 1,
                           v == 3 ? 0.015 : 0.03);
    }
    for (int t = 0; t < j.tracks.t.n_tracks; t++) {
        const float *p = j.out.points + 3 * t;
        double d[3];
        for (int k = 0; k < 3; k++)
            d[k] = unit * (double)p[k] - j.tracks.point[t][k];
        if (!isnan(p[0]))
            off[n++] = sqrt(lin_dot(d, d));
    }
    assert_true(n > j.tracks.t.n_tracks / 2);
    assert_true(median_of(off, n) < 0.05);
    free(depth);
    free(off);
    job_free(&j);
}

static void what_is_known_stays(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(600, 381, 0.3, 15)};
    struct camera start[SCENE_VIEWS];
    scene_grid(&j.rig);
    scene_make(&j.rig, &j.tracks);
    disturb_cameras(&j.rig, 0, 381, start);
    for (int v = 0; v < j.rig.n_views; v++)
        start[v].fx = start[v].fy = 420;
    run_ok(&j, &(struct bundle_config){.start = start, .rig_known = true});
    assert_float_equal(j.out.cams[0].fx, 381, 4);
    for (int v = 0; v < j.rig.n_views; v++) {
        assert_memory_equal(j.out.cams[v].q, start[v].q, sizeof start[v].q);
        assert_memory_equal(j.out.cams[v].t, start[v].t, sizeof start[v].t);
    }
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(390), .focal_known = true});
    assert_true(j.out.cams[0].fx == 390);
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(2 * 381)}); // of a photograph that was cut
    assert_right(&j, 0.1, 0.01, 0.02);
    job_free(&j);
}

static void threads_change_nothing(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(100, 381, 0.3, 15)};
    struct camera start[SCENE_VIEWS], cams[SCENE_VIEWS];
    scene_grid(&j.rig);
    j.rig.n_views = 8;
    scene_make(&j.rig, &j.tracks);
    disturb_cameras(&j.rig, 5, 381, start);
    const struct bundle_config cfg = {.start = start};
    float *points = calloc((size_t)j.tracks.t.n_tracks, 3 * sizeof *points);
    static const int threads[] = {1, 2, 7};
    for (int k = 0; k < 3; k++) {
        assert_int_equal(run_on(&j, &cfg, threads[k]), OK);
        if (k == 0) {
            memcpy(cams, j.out.cams, sizeof *cams * 8);
            memcpy(points, j.out.points, 3 * (size_t)j.tracks.t.n_tracks * sizeof *points);
        }
        assert_memory_equal(cams, j.out.cams, sizeof *cams * 8);
        assert_memory_equal(points, j.out.points, 3 * (size_t)j.tracks.t.n_tracks * sizeof *points);
    }
    free(points);
    job_free(&j);
}

/* A view whose every observation is wrong is not placed, and harms no other. */
static void view_that_fits_nowhere(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(800, 381, 0.1, 15)};
    scene_arc(&j.rig, 8, 40);
    scene_make(&j.rig, &j.tracks);
    for (int i = 0; i < j.tracks.t.n; i++)
        if (j.tracks.t.obs[i].view == 3) {
            j.tracks.t.obs[i].u = (float)scene_uniform(0, SCENE_SIZE);
            j.tracks.t.obs[i].v = (float)scene_uniform(0, SCENE_SIZE);
        }
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(381), .focal_known = true});
    assert_int_equal(j.out.n_placed, 7);
    for (int v = 0; v < 8; v++)
        assert_int_equal(j.out.placed[v], v != 3);
    assert_memory_equal(j.out.cams[3].q, j.out.cams[2].q, sizeof j.out.cams[2].q);
    j.out.cams[3] = j.out.cams[7]; // only the others are judged
    j.rig.cams[3] = j.rig.cams[7];
    j.out.n_placed = 8;
    assert_right(&j, 0.2, 0.02, 0.05);
    run_ok(&j, &(struct bundle_config){.start = j.rig.cams});
    assert_memory_equal(j.out.cams[3].q, j.rig.cams[3].q, sizeof j.out.cams[3].q);
    job_free(&j);
}

/* More views than centres are found of at once: once around a room, each sees what its neighbours
 * see. */
static void many_views(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(2500, 381, 0.2, 25)}, again;
    scene_arc(&j.rig, 72, 355);
    scene_make(&j.rig, &j.tracks);
    run_ok(&j, &(struct bundle_config){0});
    assert_right(&j, 0.1, 0.01, 0.02);
    again = j;
    again.keep = again.tmp = (struct arena){0};
    assert_int_equal(run_on(&again, &(struct bundle_config){0}, 1), OK);
    assert_memory_equal(again.out.cams, j.out.cams, 72 * sizeof *j.out.cams);
    arena_free(&again.keep);
    arena_free(&again.tmp);
    job_free(&j);
}

/* Move the observations of one side, views below 40 or the others, of a track to `to`, if there are
 * two or more. returns: the first observation of the next track. */
static int split_track(const struct match_tracks *t, int from, bool side, struct match_tracks *to)
{
    const int before = to->n;
    int end = from;
    for (; end < t->n && t->obs[end].track == t->obs[from].track; end++) {
        if ((t->obs[end].view >= 40) != side)
            continue;
        to->obs[to->n] = t->obs[end];
        to->obs[to->n++].track = to->n_tracks;
    }
    to->n = to->n - before < 2 ? before : to->n;
    to->n_tracks += to->n > before;
    return end;
}

/* Views of two places that have no point in common: the cameras of the larger one are found. */
static void two_places(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(2500, 381, 0.2, 25)};
    scene_arc(&j.rig, 72, 355);
    scene_make(&j.rig, &j.tracks);
    struct match_tracks whole = j.tracks.t,
                        split = {.obs = calloc((size_t)whole.n, sizeof *whole.obs)};
    for (int side = 0; side < 2; side++)
        for (int i = 0; i < whole.n;)
            i = split_track(&whole, i, side, &split);
    free(whole.obs);
    j.tracks.t = split;
    run_ok(&j, &(struct bundle_config){0});
    assert_int_equal(j.out.n_placed, 40);
    for (int v = 0; v < 72; v++)
        assert_int_equal(j.out.placed[v], v < 40);
    job_free(&j);
}

/* Observations of view 3 are kept in `right` tracks, and in `wrong` ones that see it where the
 * camera at `degrees` around would be, anywhere without; in the others it is not seen. */
static void mislead_view(struct job *j, int right, int wrong, const double degrees[2])
{
    struct match_tracks *t = &j->tracks.t;
    const int all = t->n;
    int kept = 0;
    for (int i = t->n = 0; i < all; i++) {
        struct match_observation s = t->obs[i];
        if (s.view == 3 && kept++ >= right + wrong)
            continue;
        if (s.view == 3 && (kept - 1) % (right + wrong) >= right) {
            double u = scene_uniform(0, SCENE_SIZE), v = scene_uniform(0, SCENE_SIZE);
            struct camera c = scene_dome(degrees ? degrees[kept % 2] : 0, 4, j->rig.focal);
            if (degrees)
                scene_see(&c, NULL, j->tracks.point[s.track], &u, &v);
            s.u = (float)(u + 0.5 * scene_normal());
            s.v = (float)(v + 0.5 * scene_normal());
        }
        t->obs[t->n++] = s;
    }
    assert_true(kept >= right + wrong);
}

/* The seven views besides view 3. */
static void assert_others_right(struct job *j, double degrees)
{
    const struct camera cam = j->rig.cams[3];
    const int placed = j->out.n_placed;
    for (int v = 0; v < 8; v++)
        assert_true(v == 3 || j->out.placed[v]);
    j->out.cams[3] = j->out.cams[7];
    j->rig.cams[3] = j->rig.cams[7];
    j->out.n_placed = 8;
    assert_right(j, degrees, 0.02, 0.02);
    j->rig.cams[3] = cam;
    j->out.n_placed = placed;
}

/* Matches of one view that tell of another place than its own, as repeats of a pattern do. */
static void view_in_two_places(void **unused)
{
    (void)unused;
    static const int right[] = {0, 90, 30}, wrong[] = {60, 45, 30};
    static const double away[][2] = {{-25, 20}, {25, 25}, {-15, -15}};
    for (int k = 0; k < 3; k++) {
        struct job j = {.rig = make_room(500, 381, 0.1, 25)};
        scene_arc(&j.rig, 8, 40);
        scene_make(&j.rig, &j.tracks);
        mislead_view(&j, right[k], wrong[k], away[k]);
        run_ok(&j, &(struct bundle_config){KNOWN_LENS(381)});
        assert_int_equal(j.out.placed[3], k == 1);
        if (k == 1)
            assert_right(&j, 0.1, 0.02, 0.02);
        assert_others_right(&j, 0.1);
        job_free(&j);
    }
}

/* More wrong matches than right ones, as facades have, which tell of no other place. */
static void view_among_wrong_matches(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(500, 381, 0.1, 25)};
    scene_arc(&j.rig, 8, 40);
    scene_make(&j.rig, &j.tracks);
    mislead_view(&j, 50, 55, NULL);
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(381)});
    assert_right(&j, 0.2, 0.02, 0.02);
    job_free(&j);
}

/* Views of sides 1 and 2 are only tied by the points that view `one` of 1 and `other` of 2 see, and
 * of these no other observation stays. What else both sides saw is left to side 2. returns: ties */
static int keep_ties(struct match_tracks *t, const int *side, int one, int other)
{
    int *in = calloc((size_t)t->n_tracks, sizeof *in), n = 0, ties = 0;
    for (int i = 0; i < t->n; i++) {
        const int v = t->obs[i].view;
        in[t->obs[i].track] |= side[v] | (v == one ? 4 : v == other ? 8 : 0);
    }
    for (int i = 0; i < t->n; i++) {
        const struct match_observation s = t->obs[i];
        const bool both = (in[s.track] & 3) == 3, tie = in[s.track] == 15;
        ties += tie && s.view == one;
        if (tie ? s.view == one || s.view == other : !both || side[s.view] == 2)
            t->obs[n++] = s;
    }
    free(in);
    t->n = n;
    return ties;
}

/* How far away such a view is, nobody knows. */
static void view_that_hangs_on_one(void **unused)
{
    (void)unused;
    static const int side[] = {2, 2, 2, 1, 2, 2, 2, 2};
    for (uint32_t seed = 17; seed < 20; seed++) {
        struct job j = {.rig = make_room(700, 381, 0.1, 25)};
        j.rig.seed = seed;
        scene_arc(&j.rig, 8, 40);
        scene_make(&j.rig, &j.tracks);
        assert_true(keep_ties(&j.tracks.t, side, 3, 4) > 100);
        run_ok(&j, &(struct bundle_config){KNOWN_LENS(381)});
        assert_false(j.out.placed[3]);
        assert_others_right(&j, 0.3);
        job_free(&j);
    }
}

/* How large such a group is beside the others, nobody knows, however well its views fit. */
static void group_that_hangs_on_one(void **unused)
{
    (void)unused;
    static const int side[] = {1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2};
    struct job j = {.rig = make_room(2500, 381, 0.1, 25)};
    scene_arc(&j.rig, 12, 60);
    scene_make(&j.rig, &j.tracks);
    assert_true(keep_ties(&j.tracks.t, side, 6, 7) > 100);
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(381)});
    for (int v = 0; v < 12; v++)
        assert_int_equal(j.out.placed[v], v < 7);
    j.out.n_placed = j.rig.n_views = 7;
    assert_right(&j, 0.3, 0.02, 0.02);
    job_free(&j);
}

/* Photographs of another shape, squeezed to squares: from the tracks alone, and from cameras that
 * look so, with depth. */
static void squeezed_views(void **unused)
{
    (void)unused;
    static const float aspects[] = {1.5f, 0.75f};
    static float depth[8 * SCENE_SIZE * SCENE_SIZE];
    for (size_t i = 0; i < sizeof depth / sizeof *depth; i++)
        depth[i] = 1;
    for (int k = 0; k < 4; k++) {
        const float aspect = aspects[k / 2];
        struct job j = {.rig = make_room(600, 381, 0.2, 15)};
        struct camera start[SCENE_VIEWS];
        scene_arc(&j.rig, 8, 40);
        scene_make(&j.rig, &j.tracks);
        for (int i = 0; i < j.tracks.t.n; i++)
            j.tracks.t.obs[i].v = SCENE_SIZE / 2 + (j.tracks.t.obs[i].v - SCENE_SIZE / 2) / aspect;
        memcpy(start, j.rig.cams, sizeof start);
        for (int v = 0; v < j.rig.n_views; v++)
            start[v].fy /= aspect;
        struct bundle_config cfg = {.rig_known = false};
        squeezed = aspect;
        if (k % 2) {
            cfg.start = start;
            cfg.start_depth = depth;
        }
        assert_int_equal(run_on(&j, &cfg, 2), OK);
        double turn, centre;
        compare(&j, &turn, &centre);
        assert_true(turn < 0.2 && centre < 0.01 && j.out.confidence > 0.5f);
        for (int v = 0; v < j.rig.n_views; v++) {
            assert_float_equal(j.out.cams[v].fx, 381, 0.02 * 381);
            assert_float_equal(j.out.cams[v].fy * aspect, j.out.cams[v].fx, 1e-3);
            assert_true(j.out.cams[v].cy == SCENE_SIZE / 2);
        }
        job_free(&j);
    }
    squeezed = 1;
}

/* ---- little or nothing to go by ---- */

static void no_tracks(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(0, 381, 0, 15)};
    scene_grid(&j.rig);
    run_ok(&j, &(struct bundle_config){0});
    assert_true(j.out.confidence == 0);
    assert_int_equal(j.out.n_placed, 0);
    assert_float_equal(j.out.cams[5].fx, 448 * sqrt(3) / 2, 0.01);
    run_ok(&j, &(struct bundle_config){.start = j.rig.cams});
    assert_true(j.out.confidence == 0);
    assert_memory_equal(j.out.cams[7].q, j.rig.cams[7].q, sizeof j.rig.cams[7].q);
    assert_memory_equal(j.out.cams[7].t, j.rig.cams[7].t, sizeof j.rig.cams[7].t);
    j.rig.n_views = 1;
    run_ok(&j, &(struct bundle_config){0});
    assert_true(j.out.confidence == 0);
    job_free(&j);
}

static void views_in_one_place(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(600, 381, 0.2, 180)};
    double turn, centre;
    for (j.rig.n_views = 0; j.rig.n_views < 5; j.rig.n_views++) {
        double from[3] = {0, 0, -3}, to[3] = {0.1 * j.rig.n_views, 0.05, 0};
        j.rig.cams[j.rig.n_views] = scene_look(from, to, 381);
    }
    scene_make(&j.rig, &j.tracks);
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(381)});
    assert_true(j.out.confidence < 0.1f && j.out.agreement > 0.5f);
    compare(&j, &turn, &centre);
    assert_true(turn < 0.2);
    for (int v = 1; v < 5; v++)
        j.rig.cams[v] = j.rig.cams[0]; // the same picture five times
    scene_free(&j.tracks);
    scene_make(&j.rig, &j.tracks);
    run_ok(&j, &(struct bundle_config){0});
    assert_true(j.out.confidence < 0.1f && j.out.agreement > 0.5f);
    compare(&j, &turn, &centre);
    assert_true(turn < 0.2);
    job_free(&j);
}

static void two_and_three_views(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(1000, 381, 0.3, 20)};
    scene_arc(&j.rig, 2, 8);
    scene_make(&j.rig, &j.tracks);
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(381), .focal_known = true});
    assert_right(&j, 0.5, 0.1, 0.001);
    scene_free(&j.tracks);
    scene_arc(&j.rig, 3, 10);
    scene_make(&j.rig, &j.tracks);
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(381)});
    assert_right(&j, 0.5, 0.05, 0.06);
    job_free(&j);
}

static void centres_in_a_row(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(800, 381, 0.3, 180)};
    for (j.rig.n_views = 0; j.rig.n_views < 6; j.rig.n_views++) {
        double x = 0.15 * j.rig.n_views, from[3] = {x, 0, -3}, to[3] = {x, 0, 0};
        j.rig.cams[j.rig.n_views] = scene_look(from, to, 381);
    }
    scene_make(&j.rig, &j.tracks);
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(381)});
    assert_right(&j, 0.2, 0.02, 0.05);
    scene_free(&j.tracks);
    for (int v = 0; v < 6; v++) { // forwards
        double from[3] = {0.05, 0, -3 + 0.2 * v}, to[3] = {0.05, 0, 1};
        j.rig.cams[v] = scene_look(from, to, 381);
    }
    scene_make(&j.rig, &j.tracks);
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(381)});
    assert_right(&j, 0.3, 0.05, 0.1);
    job_free(&j);
}

/* One point of a street of the given length, on a wall of it or at its end, and its tracks: each is
 * found again where it is about as far away. */
static void add_street_point(struct job *j, double length)
{
    struct match_tracks *t = &j->tracks.t;
    struct match_observation *obs = t->obs + t->n;
    const bool far = scene_uniform(0, 1) < 0.15;
    const double side = scene_uniform(0, 1) < 0.5 ? -1.5 : 1.5;
    const double x[3] = {far ? scene_uniform(-6, 6) : side, scene_uniform(-2, 1),
                         far ? length + scene_uniform(20, 30) : scene_uniform(1, length + 4)};
    double c[3], first = 0, u, v;
    int n = 0;
    const bool spoilt = scene_uniform(0, 1) < j->rig.wrong;
    for (int k = 0; k < j->rig.n_views; k++) {
        rotation_centre(&j->rig.cams[k], c);
        const double away = hypot(x[0] - c[0], x[2] - c[2]);
        if (!scene_see(&j->rig.cams[k], NULL, x, &u, &v) || (n > 0 && first > 1.5 * away) ||
            scene_uniform(0, 1) > 0.6)
            continue;
        first = n > 0 ? first : away;
        obs[n] =
            (struct match_observation){t->n_tracks, k, (float)(u + j->rig.noise * scene_normal()),
                                       (float)(v + j->rig.noise * scene_normal()), 0.5f};
        if (spoilt && n > 0)
            scene_spoil(&obs[n]);
        n++;
    }
    t->n += n > 1 ? n : 0;
    t->n_tracks += n > 1;
}

/* Photographs straight ahead see little in common with those some steps on: all centres at once
 * can shrink a part of the walk to a point. */
static void down_a_street(void **unused)
{
    (void)unused;
    for (int seed = 7; seed <= 9; seed += 2) {
        double turn, centre;
        struct job j = {.rig = make_room(500, 300, seed == 7 ? 0.5 : 0.3, 0)};
        j.rig.n_views = 9;
        scene_state = (uint32_t)seed;
        for (int v = 0; v < 9; v++) {
            const double from[3] = {scene_uniform(-0.1, 0.1), scene_uniform(-0.05, 0.05), v};
            const double to[3] = {from[0] + scene_uniform(-0.5, 0.5), from[1], from[2] + 10};
            j.rig.cams[v] = scene_look(from, to, 300);
        }
        j.tracks.t.obs = calloc((size_t)(j.rig.n_points * 9), sizeof *j.tracks.t.obs);
        for (int i = 0; i < j.rig.n_points; i++)
            add_street_point(&j, 9);
        run_ok(&j, &(struct bundle_config){KNOWN_LENS(300)});
        compare(&j, &turn, &centre);
        assert_int_equal(j.out.n_placed, 9);
        assert_true(turn < 0.4 && centre < 0.05);
        job_free(&j);
    }
}

/* One point of a field with furrows, and its tracks through a lens. */
static void add_field_point(struct job *j, const struct lens *lens)
{
    struct match_tracks *t = &j->tracks.t;
    struct match_observation *obs = t->obs + t->n;
    const double x[3] = {scene_uniform(-3, 6), scene_uniform(-3, 5), 4 + scene_uniform(0, 0.3)};
    double u, v;
    int n = 0;
    for (int k = 0; k < j->rig.n_views; k++) {
        if (!scene_see(&j->rig.cams[k], lens, x, &u, &v) || scene_uniform(0, 1) > 0.6)
            continue;
        obs[n++] =
            (struct match_observation){t->n_tracks, k, (float)(u + j->rig.noise * scene_normal()),
                                       (float)(v + j->rig.noise * scene_normal()), 0.5f};
    }
    t->n += n > 1 ? n : 0;
    t->n_tracks += n > 1;
}

/* Straight down on a field, focal length and height tell little of each other: what is known of the
 * lens must not be lost to what it bends. */
static void above_a_field(double bend, double known)
{
    struct job j = {.rig = make_room(900, 300, 0.1, 0)};
    struct lens bent = {.model = LENS_SIMPLE_RADIAL, .fx = 300, .fy = 300, .term = {bend}};
    assert_int_equal(lens_init(&bent), OK);
    j.rig.n_views = 12;
    scene_state = 5;
    for (int v = 0; v < 12; v++) {
        const double from[3] = {v % 4 + scene_uniform(-0.1, 0.1), v / 4 + scene_uniform(-0.1, 0.1),
                                scene_uniform(-0.05, 0.05)};
        const double to[3] = {from[0] + scene_uniform(-0.1, 0.1),
                              from[1] + scene_uniform(-0.1, 0.1), 4};
        j.rig.cams[v] = scene_look(from, to, 300);
    }
    j.tracks.t.obs = calloc((size_t)(j.rig.n_points * 12), sizeof *j.tracks.t.obs);
    for (int i = 0; i < j.rig.n_points; i++)
        add_field_point(&j, &bent);
    run_ok(&j, &(struct bundle_config){KNOWN_LENS((float)known)});
    assert_int_equal(j.out.n_placed, 12);
    assert_true(fabs((double)j.out.cams[0].fx / 300 - 1) < 0.05);
    job_free(&j);
}

static void fields_are_as_high_as_exif_says(void **unused)
{
    (void)unused;
    above_a_field(-0.05, 318);
    above_a_field(-0.08, 300);
}

/* All points on one slanted wall. */
static void a_wall(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(600, 381, 0.2, 20)};
    scene_grid(&j.rig);
    scene_make(&j.rig, &j.tracks);
    for (int i = 0; i < j.tracks.t.n; i++) {
        struct match_observation *s = &j.tracks.t.obs[i];
        double *x = j.tracks.point[s->track], u, v;
        x[2] = 0.3 * x[0] + 0.2 * x[1];
        scene_see(&j.rig.cams[s->view], NULL, x, &u, &v);
        s->u = (float)(u + 0.5 * scene_normal());
        s->v = (float)(v + 0.5 * scene_normal());
    }
    run_ok(&j, &(struct bundle_config){KNOWN_LENS(381), .focal_known = true});
    assert_right(&j, 1, 0.1, 0.001);
    job_free(&j);
}

static void every_match_wrong(void **unused)
{
    (void)unused;
    static const int views[] = {2, 3, 6};
    for (int k = 0; k < 3; k++) {
        struct job j = {.rig = make_room(250, 381, 0, 20)};
        scene_arc(&j.rig, views[k], 2.0 * views[k]);
        scene_make(&j.rig, &j.tracks);
        for (int i = 0; i < j.tracks.t.n; i++) {
            j.tracks.t.obs[i].u = (float)scene_uniform(0, SCENE_SIZE);
            j.tracks.t.obs[i].v = (float)scene_uniform(0, SCENE_SIZE);
        }
        run_ok(&j, &(struct bundle_config){0});
        assert_true(j.out.confidence < 0.1f && j.out.agreement < 0.1f);
        run_ok(&j, &(struct bundle_config){.start = j.rig.cams});
        assert_true(j.out.confidence < 0.1f);
        job_free(&j);
    }
}

static void start_that_is_no_number(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(400, 381, 0.2, 20)};
    struct camera start[SCENE_VIEWS];
    scene_arc(&j.rig, 6, 30);
    scene_make(&j.rig, &j.tracks);
    for (int k = 0; k < 4; k++) {
        disturb_cameras(&j.rig, 0, 381, start);
        start[2].t[1] = k == 0 ? NAN : start[2].t[1];
        start[3].q[0] = k == 1 ? INFINITY : start[3].q[0];
        start[0].fx = k == 2 ? 0 : start[0].fx;
        for (int i = 0; i < 4 && k == 3; i++)
            start[1].q[i] = 0;
        run_ok(&j, &(struct bundle_config){.start = start, .rig_known = k % 2});
        assert_right(&j, 0.5, 0.05, 0.06);
    }
    job_free(&j);
}

static void wrong_requests(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(100, 381, 0, 30)};
    struct bundle_config none = {0};
    scene_arc(&j.rig, 4, 10);
    scene_make(&j.rig, &j.tracks);
    struct match_observation *s = &j.tracks.t.obs[5], good = *s;
    for (int k = 0; k < 7; k++) {
        *s = good;
        s->view = k == 0 ? 4 : k == 1 ? -1 : s->view;
        s->track = k == 2 ? j.tracks.t.n_tracks : k == 3 ? 0 : s->track;
        s->u = k == 4 ? NAN : s->u;
        s->sigma = k == 5 ? 0 : k == 6 ? -1 : s->sigma;
        assert_int_equal(run_on(&j, &none, 1), ERR_ARG);
        assert_null(j.out.cams);
    }
    *s = good;
    struct run r = {.keep = &j.keep, .tmp = &j.tmp};
    struct plan plan = plan_begin(1);
    bundle_plan(&plan, 4, 1, &j.tracks.t);
    struct views crowd = views_of(4);
    const struct views four = crowd, nobody = views_of(0);
    crowd.n = BUNDLE_VIEWS_MAX + 1;
    struct views empty = four;
    empty.size = 0;
    assert_int_equal(bundle_run(&r, &nobody, &j.tracks.t, &none, &j.out), ERR_ARG);
    assert_int_equal(bundle_run(&r, &crowd, &j.tracks.t, &none, &j.out), ERR_ARG);
    assert_int_equal(bundle_run(&r, &empty, &j.tracks.t, &none, &j.out), ERR_ARG);
    arena_free(&j.tmp);
    assert_int_equal(arena_init(&j.tmp, "tmp", plan.tmp.peak / 2), OK);
    assert_int_equal(bundle_run(&r, &four, &j.tracks.t, &none, &j.out), ERR_NOMEM);
    assert_null(j.out.cams);
    atomic_bool stop = true;
    arena_reset(&j.keep, 0);
    arena_free(&j.tmp);
    assert_int_equal(arena_init(&j.tmp, "tmp", plan.tmp.peak), OK);
    r.cancel = &stop;
    assert_int_equal(bundle_run(&r, &four, &j.tracks.t, &none, &j.out), ERR_CANCELLED);
    job_free(&j);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(narrow_grid_from_tracks),
        cmocka_unit_test(wide_arc_from_tracks),
        cmocka_unit_test(start_that_is_off),
        cmocka_unit_test(start_without_pairs),
        cmocka_unit_test(world_of_the_start),
        cmocka_unit_test(what_is_known_stays),
        cmocka_unit_test(threads_change_nothing),
        cmocka_unit_test(view_that_fits_nowhere),
        cmocka_unit_test(view_in_two_places),
        cmocka_unit_test(view_among_wrong_matches),
        cmocka_unit_test(view_that_hangs_on_one),
        cmocka_unit_test(group_that_hangs_on_one),
        cmocka_unit_test(squeezed_views),
        cmocka_unit_test(no_tracks),
        cmocka_unit_test(views_in_one_place),
        cmocka_unit_test(two_and_three_views),
        cmocka_unit_test(centres_in_a_row),
        cmocka_unit_test(down_a_street),
        cmocka_unit_test(fields_are_as_high_as_exif_says),
        cmocka_unit_test(a_wall),
        cmocka_unit_test(every_match_wrong),
        cmocka_unit_test(start_that_is_no_number),
        cmocka_unit_test(many_views),
        cmocka_unit_test(two_places),
        cmocka_unit_test(wrong_requests),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
