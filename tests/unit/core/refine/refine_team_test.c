/* Refinement by a team: ranks are threads, each with its own scene (team_local.h). All ranks end
 * with the same bytes, and with those of a single process up to rounding. */
#include "core/refine/loss.h"
#include "core/refine/refine.h"

#include "tests/unit/core/base/team_local.h"
#include "tests/unit/core/refine/refine_world.h"
#include "tests/unit/some_of.h"

#include <stdlib.h>

enum { RANKS = 4, STEPS = 240, STATE_MAX = 4 << 20 };

/* What belongs to a rank. */
struct mate {
    struct arena keep, tmp;
    struct run r;
    struct scene s;
    struct camera cams[V];
    struct refine_report rep;
};

static struct mate mates[RANKS];

static void open_mates(int size)
{
    for (int i = 0; i < size; i++) {
        struct mate *m = &mates[i];
        memset(m, 0, sizeof *m);
        assert_int_equal(arena_init(&m->keep, "keep", 4 << 20), OK);
        assert_int_equal(arena_init(&m->tmp, "tmp", (size_t)96 << 20), OK);
        m->r = W.r;
        m->r.keep = &m->keep;
        m->r.tmp = &m->tmp;
        assert_int_equal(pool_open(&m->r.pool, 1 + i % 2), OK);
        m->s = W.start;
        assert_int_equal(gaussians_init(&m->s.g, &m->keep, CAP, 2), OK);
        m->s.g.degree = W.start.g.degree;
        gaussians_copy(&W.start.g, 2, &m->s.g);
        memcpy(m->cams, W.cams, sizeof m->cams);
        m->s.cams = m->cams;
    }
}

static void close_mates(int size)
{
    for (int i = 0; i < size; i++) {
        assert_int_equal(arena_mark(&mates[i].tmp), 0);
        pool_close(mates[i].r.pool);
        arena_free(&mates[i].keep);
        arena_free(&mates[i].tmp);
    }
}

static struct refine_config config = {STEPS, 1, CAP, 5, true, false, 2, 0, NULL, NULL};

/* Of rank 0 alone. */
static struct refine_saver *saver;

static err_t refine_rank(void *ctx, struct team *t)
{
    struct mate *m = &mates[team_rank(t)];
    struct refine_config cfg = config;
    (void)ctx;
    m->r.team = t;
    cfg.saver = team_rank(t) == 0 ? saver : NULL;
    return refine_run(&m->r, &W.v, &cfg, &m->s, &m->rep);
}

static void assert_same_scene(const struct mate *a, const struct mate *b)
{
    assert_int_equal(a->s.g.n, b->s.g.n);
    assert_int_equal(a->s.g.degree, b->s.g.degree);
    for (int p = 0; p < gaussians_planes(a->s.g.degree); p++)
        assert_memory_equal(a->s.g.plane[p], b->s.g.plane[p], (size_t)a->s.g.n * sizeof(float));
    assert_memory_equal(&a->s.tone, &b->s.tone, sizeof a->s.tone);
    assert_memory_equal(a->cams, b->cams, sizeof a->cams);
    assert_memory_equal(&a->rep, &b->rep, sizeof a->rep);
}

/* Which outcome is kept from one run to the next. */
static struct mate kept;
static float kept_planes[G_PLANES_MAX][CAP];

static void keep_outcome(void)
{
    kept = mates[0];
    for (int p = 0; p < gaussians_planes(kept.s.g.degree); p++) {
        memcpy(kept_planes[p], kept.s.g.plane[p], (size_t)kept.s.g.n * sizeof(float));
        kept.s.g.plane[p] = kept_planes[p];
    }
}

static void open_start(bool wide)
{
    if (wide) {
        open_wide_world(2);
    } else {
        open_world(2, 1);
        take_brackets(2);
        stand_before(4);
    }
}

static void run_team(int size, const int *share, bool wide)
{
    open_start(wide);
    open_mates(size);
    assert_int_equal(team_local_run(size, share, refine_rank, NULL, NULL), OK);
    for (int i = 1; i < size; i++)
        assert_same_scene(&mates[0], &mates[i]);
}

static void end_team(int size)
{
    close_mates(size);
    close_world();
}

static void test_same_bytes(void **state)
{
    (void)state;
    static const int shares[][RANKS] = {{1}, {1, 1}, {3, 1, 1}, {1, 1, 1, 1}};
    float alone = 0;
    for (int size = 1; size <= RANKS; size += some_of(3))
        for (int again = 0; again < 2; again++) {
            run_team(size, shares[size - 1], false);
            if (again)
                assert_same_scene(&kept, &mates[0]);
            keep_outcome();
            end_team(size);
            const float db = kept.rep.held_out_db[1];
            alone = size == 1 ? db : alone;
            if (again)
                print_message("  %d: held-out %.3f dB, %d Gaussians of degree %d\n", size,
                              (double)db, kept.rep.gaussians, kept.rep.degree);
            assert_true(db > alone - 0.1f);
        }
}

static void test_parts(void **state)
{
    (void)state;
    const struct refine_config was = config;
    config.steps = 60;
    run_team(2, NULL, true); // pictures of two rows of tiles
    assert_true(mates[0].rep.held_out_db[1] > mates[0].rep.held_out_db[0] + 3);
    end_team(2);
    run_team(4, NULL, true); // two ranks have nothing to draw
    end_team(4);
    config = was;
}

/* ---- one step ---- */

enum { GRAD_PLANES = 14 };

/* Of a view: what each rank has. */
struct step {
    float radiance[3 * PX], d_radiance[3 * PX], grad[GRAD_PLANES][CAP], pose[POSE_GRAD];
    int first, end;
    struct loss_output out;
};

static struct step steps[RANKS], single;

static void keep_gradient(void *ctx, int first, int count, const float *grad, const float *seen)
{
    struct step *s = ctx;
    (void)seen;
    for (int p = 0; p < GRAD_PLANES; p++)
        memcpy(s->grad[p] + first, grad + p * SPLAT_BLOCK, (size_t)count * sizeof(float));
}

static err_t step_rank(void *ctx, struct team *t)
{
    static float alpha[RANKS][PX];
    static uint8_t photo[3 * PX];
    struct mate *m = &mates[team_rank(t)];
    struct step *s = t ? &steps[t->rank] : ctx;
    struct raster rs;
    struct loss l;
    const struct raster_input in = {&m->s.g, &m->cams[2], {0.1f, 0.1f, 0.1f}};
    struct render pic = {0, 0, s->radiance, NULL, alpha[team_rank(t)]};
    struct loss_input li = {.pic = &pic, .tone = &m->s.tone, .photo = photo, .w_l1 = 0.8f};
    li.w_ssim = 0.2f;
    err_t e = raster_init(&rs, &m->tmp, CAP, S, S, true);
    if (!e)
        e = loss_init(&l, &m->tmp, S, S, 2);
    rs.team = l.team = t;
    if (!e)
        e = raster_run(&m->r, &rs, &in, &pic);
    raster_rows(&rs, &s->first, &s->end);
    li.first = s->first;
    li.end = s->end;
    if (!e)
        e = loss_run(&m->r, &l, &li, &s->out);
    const struct render_grad up = {l.d_radiance, NULL, l.d_alpha};
    const struct raster_sink sink = {keep_gradient, s, s->pose, NULL};
    if (!e)
        e = raster_grad_run(&m->r, &rs, &in, &up, &sink);
    memcpy(s->d_radiance, l.d_radiance, sizeof s->d_radiance);
    arena_reset(&m->tmp, 0);
    return e;
}

static void assert_rows_equal(const float *a, const float *b, int first, int end)
{
    for (int c = 0; c < 3; c++)
        assert_memory_equal(a + c * PX + first * S, b + c * PX + first * S,
                            (size_t)(end - first) * S * sizeof *a);
}

/* Relative to the length of the whole: sums are rounded to 8 bits. */
static double difference(const float *a, const float *b, int n)
{
    double sum = 0, all = 0;
    for (int i = 0; i < n; i++) {
        sum += (double)(a[i] - b[i]) * (double)(a[i] - b[i]);
        all += (double)b[i] * (double)b[i];
    }
    return all > 0 ? sqrt(sum / all) : 0;
}

static void test_step(void **state)
{
    (void)state;
    enum { GROUPS = 5 };
    static const int share[RANKS] = {3, 1, 1, 2}; // of 4 ranks one gets no row
    static const int group[GROUPS + 1] = {G_MU, G_LOG_SCALE, G_QUAT, G_LOGIT, G_SH, GRAD_PLANES};
    open_world(1, 0);
    open_mates(RANKS);
    assert_int_equal(step_rank(&single, NULL), OK);
    assert_true(single.first == 0 && single.end == S);
    for (int size = 2; size <= RANKS; size++) {
        double most = 0;
        int at = 0;
        assert_int_equal(team_local_run(size, share, step_rank, NULL, NULL), OK);
        for (int i = 0; i < size; i++) {
            struct step *s = &steps[i];
            assert_int_equal(s->first, at);
            at = s->end;
            assert_rows_equal(s->radiance, single.radiance, s->first, s->end);
            assert_rows_equal(s->d_radiance, single.d_radiance, s->first, s->end);
            assert_float_equal(s->out.loss, single.out.loss, 1e-12);
            assert_true(difference(s->out.tone, single.out.tone, TONE_PARAMS) < 1e-6);
            assert_memory_equal(s->grad, steps[0].grad, sizeof s->grad);
            assert_memory_equal(s->pose, steps[0].pose, sizeof s->pose);
            for (int g = 0; g < GROUPS; g++)
                most = fmax(most, difference(s->grad[group[g]], single.grad[group[g]],
                                             (group[g + 1] - group[g]) * CAP));
        }
        assert_int_equal(at, S);
        print_message("  %d ranks: gradient within %.2g of a single one\n", size, most);
        assert_true(most > 0 && most < 1.0 / 256);
    }
    end_team(RANKS);
}

/* ---- checkpoints, plan, time ---- */

struct notebook {
    size_t n;
    uint8_t bytes[STATE_MAX];
};

static struct notebook note;
static atomic_bool cancel;
static int stop;

static bool begin_state(void *ctx, int step, bool ends)
{
    (void)ctx;
    if (ends || step != stop)
        return false;
    note.n = 0;
    atomic_store(&cancel, true);
    return true;
}

static void put_piece(void *ctx, const void *p, size_t n)
{
    (void)ctx;
    assert_true(note.n + n <= sizeof note.bytes);
    memcpy(note.bytes + note.n, p, n);
    note.n += n;
}

static void end_state(void *ctx)
{
    (void)ctx;
}

static void test_checkpoint(void **state)
{
    (void)state;
    struct refine_saver s = {NULL, begin_state, put_piece, end_state, NULL, 0};
    err_t results[2];
    config.steps = 120;
    saver = NULL;
    run_team(2, NULL, false);
    keep_outcome();
    end_team(2);

    saver = &s;
    stop = 77;
    open_start(false);
    open_mates(2);
    mates[0].r.cancel = &cancel;
    assert_int_not_equal(team_local_run(2, NULL, refine_rank, NULL, results), OK);
    assert_int_equal(results[0], ERR_CANCELLED);
    assert_int_equal(results[1], ERR_LOST);
    end_team(2);

    static const int other[] = {3, 1}; // speeds that were measured in the second run
    stop = 0;
    s.state = note.bytes;
    s.bytes = note.n;
    run_team(2, other, false);
    assert_same_scene(&kept, &mates[0]);
    end_team(2);

    open_start(false);
    open_mates(3);
    assert_int_equal(team_local_run(3, NULL, refine_rank, NULL, NULL), ERR_ARG);
    assert_non_null(strstr(err_text(), "another number of boards"));
    end_team(3);
    saver = NULL;
    config.steps = STEPS;
}

static void test_plan(void **state)
{
    (void)state;
    config.steps = 120; // with a split
    open_start(false);
    open_mates(2);
    for (int i = 0; i < 2; i++) {
        arena_free(&mates[i].tmp);
        assert_int_equal(arena_init(&mates[i].tmp, "exact", refine_plan(&W.v, &config, 1 + i % 2)),
                         OK);
    }
    assert_int_equal(team_local_run(2, NULL, refine_rank, NULL, NULL), OK);
    assert_true(mates[0].tmp.peak > mates[0].tmp.size * 9 / 10);
    end_team(2);
    config.steps = STEPS;
}

static double slow_clock(void)
{
    static double s;
    return s += 1;
}

static double fast_clock(void)
{
    static double s;
    return s += 1e-3;
}

/* The clock of rank 0 decides. */
static void test_time(void **state)
{
    (void)state;
    config.seconds = 60;
    open_start(false);
    open_mates(2);
    mates[0].r.clock = slow_clock;
    mates[1].r.clock = fast_clock;
    assert_int_equal(team_local_run(2, NULL, refine_rank, NULL, NULL), OK);
    assert_in_range(mates[0].rep.steps, 1, STEPS - 1);
    assert_same_scene(&mates[0], &mates[1]);
    end_team(2);
    config.seconds = 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_step),  cmocka_unit_test(test_same_bytes),
        cmocka_unit_test(test_parts), cmocka_unit_test(test_checkpoint),
        cmocka_unit_test(test_plan),  cmocka_unit_test(test_time)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
