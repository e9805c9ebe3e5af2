/* A refinement that is interrupted goes on to the same bytes; a state of another job, or a damaged
 * one, is refused. */
#include "core/refine/refine.h"

#include "tests/unit/core/refine/refine_world.h"
#include "tests/unit/some_of.h"

#include <stdlib.h>

enum { STEPS = 150, STATE_MAX = 4 << 20 };

/* Cancels in the middle of a step, or of what follows the last one, and saves what is kept then. */
struct notebook {
    int stop; // the step; one more than all: what follows
    size_t n;
    uint8_t bytes[STATE_MAX];
    int ended;
};

static struct notebook note;
static atomic_bool cancel;

static bool begin_state(void *ctx, int step, bool ends)
{
    struct notebook *b = ctx;
    if (!ends && step == b->stop - 1)
        atomic_store(&cancel, true);
    b->n = 0;
    return ends;
}

static void put_piece(void *ctx, const void *p, size_t n)
{
    struct notebook *b = ctx;
    assert_true(b->n + n <= sizeof b->bytes);
    memcpy(b->bytes + b->n, p, n);
    b->n += n;
}

static void end_state(void *ctx)
{
    ((struct notebook *)ctx)->ended++;
}

static struct refine_saver saver = {&note, begin_state, put_piece, end_state, NULL, 0};

static struct refine_config config = {STEPS, 2, CAP, 5, true, false, 2, 0, &saver, NULL};

/* The wall shines; two places have five exposures, a camera is off. */
static bool wide; // steps see parts of photographs instead

static void open_start(void)
{
    const float off[6] = {0.002f, 0, 0.001f, 0.01f, 0, 0};
    if (wide) {
        open_wide_world(2);
    } else {
        open_world(2, 1);
        take_brackets(2);
        stand_before(4);
    }
    pose_move(&W.cams[1], off);
    W.r.cancel = &cancel;
    atomic_store(&cancel, false);
}

static err_t refine(struct refine_report *rep)
{
    err_t e = refine_run(&W.r, &W.v, &config, &W.start, rep);
    assert_int_equal(arena_mark(&W.tmp), 0);
    return e;
}

struct outcome {
    struct refine_report rep;
    int n, degree;
    struct tonemap tone;
    struct camera cams[V];
    float plane[G_PLANES_MAX][CAP];
};

static void keep_outcome(const struct refine_report *rep, struct outcome *out)
{
    const struct gaussians *g = &W.start.g;
    memset(out, 0, sizeof *out);
    out->rep = *rep;
    out->n = g->n;
    out->degree = g->degree;
    out->tone = W.start.tone;
    memcpy(out->cams, W.cams, sizeof out->cams);
    for (int p = 0; p < gaussians_planes(g->degree); p++)
        memcpy(out->plane[p], g->plane[p], (size_t)g->n * sizeof(float));
}

static struct outcome whole, resumed;

static void run_whole(void)
{
    struct refine_report rep;
    open_start();
    note.stop = 0;
    saver.state = NULL;
    assert_int_equal(refine(&rep), OK);
    keep_outcome(&rep, &whole);
    close_world();
}

/* The state after step `stop`, in the notebook. */
static void interrupt(int stop)
{
    struct refine_report rep;
    open_start();
    note.stop = stop;
    note.ended = 0;
    saver.state = NULL;
    assert_int_equal(refine(&rep), ERR_CANCELLED);
    assert_int_equal(rep.steps, stop <= config.steps ? stop : config.steps);
    assert_int_equal(note.ended, 1);
    close_world();
}

static void assert_same(const int *stops, int n)
{
    for (int i = 0; i < n; i += some_of(3)) {
        struct refine_report rep;
        interrupt(stops[i]);
        open_start();
        note.stop = 0;
        saver.state = note.bytes;
        saver.bytes = note.n;
        assert_int_equal(refine(&rep), OK);
        keep_outcome(&rep, &resumed);
        assert_memory_equal(&whole, &resumed, sizeof whole);
        close_world();
    }
}

static void test_same_bytes(void **state)
{
    (void)state;
    static const int stops[] = {2, 33, 50, 76, 97, 100, 101, 149, 150, 151};
    run_whole();
    assert_true(whole.n > SIDE * SIDE);
    assert_int_equal(whole.rep.steps, STEPS);
    assert_non_null(strstr(whole.rep.notes[0], "SH band 1"));
    assert_same(stops, sizeof stops / sizeof *stops);
}

/* The best scene is one before the interruption. */
static void test_best_before(void **state)
{
    (void)state;
    static const int stops[] = {300, 499, 501};
    config.steps = 500;
    config.seed = 1;
    run_whole();
    assert_in_range(whole.rep.step_kept, 1, 299);
    assert_same(stops, sizeof stops / sizeof *stops);
    config.steps = STEPS;
    config.seed = 5;
}

static void test_same_parts(void **state)
{
    (void)state;
    static const int stops[] = {40, 99};
    wide = true;
    run_whole();
    assert_same(stops, sizeof stops / sizeof *stops);
    wide = false;
}

/* Go on from the first n bytes of the notebook. */
static err_t go_on(size_t n)
{
    struct refine_report rep;
    uint8_t *exact = malloc(n + 1); // ASan sees a read beyond
    assert_non_null(exact);
    memcpy(exact, note.bytes, n);
    note.stop = 0;
    saver.bytes = n;
    saver.state = exact;
    err_t e = refine(&rep);
    free(exact);
    return e;
}

static void assert_damaged(size_t n)
{
    open_start();
    assert_int_equal(go_on(n), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "damaged"));
    close_world();
}

static void test_other_jobs(void **state)
{
    (void)state;
    interrupt(120);
    const struct refine_config was = config;
    for (int kind = 0; kind < 5; kind++) {
        open_start();
        if (kind == 0)
            W.rgb[3 * PX + 5] ^= 1;
        else if (kind == 1)
            config.seed++;
        else if (kind == 2)
            config.steps++;
        else if (kind == 3)
            W.cams[2].t[0] += 0.01f;
        else
            W.start.g.plane[G_LOGIT][7] += 0.5f;
        assert_int_equal(go_on(note.n), ERR_ARG);
        assert_non_null(strstr(err_text(), kind == 0   ? "other photographs"
                                           : kind <= 2 ? "other options"
                                                       : "other cameras"));
        config = was;
        close_world();
    }
}

/* Any byte may be wrong: the job ends with a sentence or goes on, without harm. */
static void test_damage(void **state)
{
    (void)state;
    interrupt(120);
    const size_t n = note.n, names = 3 * 65;
    uint32_t random = 1;
    assert_damaged(n - 1);
    assert_damaged(n / 2);
    assert_damaged(1);
    put_piece(&note, "", 1);
    assert_damaged(n + 1);
    for (int i = 0; i < 40; i += some_of(3)) {
        random = random * 1664525u + 1013904223u;
        /* counters first, then anything */
        const size_t at = names + (i < 30 ? (size_t)i * 3 : random % (n - names));
        const uint8_t was = note.bytes[at];
        note.bytes[at] ^= (uint8_t)(1u << (random >> 29));
        open_start();
        err_t e = go_on(n);
        assert_true(e == OK || e == ERR_FORMAT || e == ERR_ARG);
        note.bytes[at] = was;
        close_world();
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_same_bytes), cmocka_unit_test(test_best_before),
        cmocka_unit_test(test_same_parts), cmocka_unit_test(test_other_jobs),
        cmocka_unit_test(test_damage)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
