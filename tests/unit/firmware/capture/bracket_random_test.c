/* TAKES (1860) random sets of simulated cameras that know the truth: no frame is kept under an
 * exposure that it does not have, whatever goes wrong, and most sets are completed nevertheless. */
#include "tests/unit/firmware/capture/bracket_sim.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>

#include <cmocka.h>

enum { TRIALS = 60, TORN = 5 }; // per kind of misfortune; times as many of torn rows
#define TOLERANCE 0.10

/* ---- random sets ---- */

struct trial {
    struct sim sim;
    struct sim_camera camera;
    struct bracket_camera cfg;
    struct bracket_plan plan;
    double base_s;
    bool common;   // truth is known but for a factor
    int64_t begin; // frame
};

static void random_plan(struct trial *t)
{
    struct sim *s = &t->sim;
    double step = 1.0 + 3.0 * sim_uniform(s);
    int most = 1 + (int)(18.0 / step), n = 3 + sim_below(s, 7);
    t->plan.n = n < most ? n : most;
    double first = 1e-4 * exp2(4.0 * sim_uniform(s) - 2.0) * exp2(-0.3 * step * t->plan.n) * 30;
    for (int i = 0; i < t->plan.n; i++)
        t->plan.requested[i] = (struct exposure){first * exp2(step * i), 1.0};
    t->base_s = t->plan.requested[sim_below(s, t->plan.n)].time_s;
    if (sim_chance(s, 0.3))
        t->base_s *= exp2(step * (sim_uniform(s) - 0.5));
    int order = sim_below(s, 3);
    for (int i = t->plan.n - 1; i > 0 && order > 0; i--) {
        int k = order == 1 ? sim_below(s, i + 1) : t->plan.n - 1 - i;
        if (order == 2 && k >= i)
            break;
        struct exposure e = t->plan.requested[i];
        t->plan.requested[i] = t->plan.requested[k];
        t->plan.requested[k] = e;
    }
}

static void random_camera(struct trial *t)
{
    struct sim *s = &t->sim;
    struct sim_camera *c = &t->camera;
    double claim = sim_uniform(s);
    struct timing_cfg timing = {.period_s = 1.0 / 30.0,
                                .step_s = sim_chance(s, 0.5) ? 2e-7 : 0.0,
                                .longest_s = 100.0,
                                .gain_max = 8.0,
                                .delay = sim_below(s, 7),
                                .jitter = sim_chance(s, 0.2) ? 1 + sim_below(s, 2) : 0,
                                .length = sim_chance(s, 0.3) ? TIMING_FREE : TIMING_STRETCH,
                                .seed = s->random};
    timing.gain_delay = timing.delay;
    sim_camera_init(c);
    sim_scene(s, c, 6.0 + 8.0 * sim_uniform(s), 0.05, t->base_s);
    c->report = sim_chance(s, 0.5) ? SIM_HONEST : SIM_SILENT;
    c->readback = (enum sim_readback)sim_below(s, 3);
    c->stamp = (enum camera_stamp)sim_below(s, 2);
    t->cfg = (struct bracket_camera){.period_s = timing.period_s,
                                     .time_min_s = 1e-7,
                                     .time_max_s = 60.0,
                                     .time_step_s = sim_chance(s, 0.5) ? timing.step_s : 0.0,
                                     .delay_lo = timing.delay,
                                     .delay_hi = timing.delay + timing.jitter,
                                     .stamp = c->stamp,
                                     .reports = c->report != SIM_SILENT,
                                     .tolerance = TOLERANCE};
    if (claim < 0.15) { // unknown
        t->cfg.delay_lo = 0;
        t->cfg.delay_hi = 8;
    } else if (claim < 0.30) { // wrong
        t->cfg.delay_lo = t->cfg.delay_hi = sim_below(s, 7);
    }
    c->timing.cfg = timing;
}

/* ---- kinds of misfortune ---- */

static void some_drops(struct trial *t)
{
    t->camera.drop = 0.05;
    t->camera.hide = 0.5;
}

static void nothing(struct trial *t)
{
    (void)t;
}

static void drops_seen(struct trial *t)
{
    t->camera.drop = 0.05;
}

static void drops_hidden(struct trial *t)
{
    t->camera.drop = 0.05;
    t->camera.hide = 1.0;
}

static void report_late(struct trial *t)
{
    some_drops(t);
    t->camera.report = SIM_LATE;
}

static void report_early(struct trial *t)
{
    some_drops(t);
    t->camera.report = SIM_EARLY;
}

static void report_none(struct trial *t)
{
    some_drops(t);
    t->camera.report = SIM_SILENT;
}

static int64_t soon(struct trial *t)
{
    return t->begin - 3 + sim_below(&t->sim, 12);
}

static void ignores(struct trial *t)
{
    some_drops(t);
    t->camera.ignore_from = soon(t);
    t->camera.ignore_frames = -1;
}

static void ignores_some(struct trial *t)
{
    some_drops(t);
    t->camera.ignore_from = soon(t);
    t->camera.ignore_frames = 1 + sim_below(&t->sim, 8);
}

static void quantises(struct trial *t)
{
    some_drops(t);
    t->camera.quantum_s = t->base_s * exp2(4.0 * sim_uniform(&t->sim) - 3.0);
}

static void rolls_over(struct trial *t)
{
    some_drops(t);
    t->camera.rollover_s = t->base_s * (1.1 + 10.0 * sim_uniform(&t->sim));
}

static void errors(struct trial *t)
{
    some_drops(t);
    t->camera.error = 0.1;
}

static void duplicates(struct trial *t)
{
    some_drops(t);
    t->camera.twice = 0.1;
}

static void repeats(struct trial *t)
{
    some_drops(t);
    t->camera.repeat = 0.1;
}

static void tears(struct trial *t)
{
    t->camera.tear = 0.3;
}

static void garbles(struct trial *t)
{
    some_drops(t);
    t->camera.garble = 0.05;
}

static void sequence_stuck(struct trial *t)
{
    some_drops(t);
    t->camera.stuck = true;
    t->camera.from = sim_chance(&t->sim, 0.5) ? 0 : soon(t);
}

static void sequence_wraps(struct trial *t)
{
    some_drops(t);
    t->camera.from = soon(t);
    t->camera.sequence_add = UINT32_MAX - 2 - (uint32_t)t->camera.from;
}

static void stamp_zero(struct trial *t)
{
    some_drops(t);
    t->camera.stamp_fixed = true;
    t->camera.stuck = sim_chance(&t->sim, 0.3);
    t->camera.from = sim_chance(&t->sim, 0.5) ? 0 : soon(t);
}

static void stamp_jumps(struct trial *t)
{
    static const double by_s[] = {-0.1, -0.5, -2.0, -100.0, 0.05, 0.5, 5.0, 1.7e9};
    some_drops(t);
    t->camera.stamp_add_ns = (int64_t)(1e9 * by_s[sim_below(&t->sim, 8)]);
    t->camera.from = sim_chance(&t->sim, 0.5) ? 0 : soon(t);
}

static void lamp_on(struct trial *t)
{
    some_drops(t);
    t->camera.lamp_at = soon(t);
    t->camera.lamp_frames = sim_chance(&t->sim, 0.7) ? INT32_MAX : 1 + sim_below(&t->sim, 4);
    // often by exactly a step of the bracket, which looks like a label one frame off
    double ratio = t->plan.requested[1].time_s / t->plan.requested[0].time_s;
    t->camera.lamp = sim_chance(&t->sim, 0.5) ? ratio : exp2(4.0 * sim_uniform(&t->sim) - 2.0);
    t->camera.lamp_share = sim_chance(&t->sim, 0.6) ? 1.0 : 0.3 + 0.6 * sim_uniform(&t->sim);
}

static void gain_drifts(struct trial *t)
{
    some_drops(t);
    t->common = true;
    t->camera.from = soon(t);
    t->camera.gain_step = exp2(0.06 * (sim_uniform(&t->sim) - 0.5));
}

static void digital_gain(struct trial *t)
{
    some_drops(t);
    t->common = true;
    t->camera.from = soon(t);
    t->camera.digital = exp2(2.0 * sim_uniform(&t->sim) - 1.0);
    t->camera.tell_gains = sim_chance(&t->sim, 0.5);
}

static void balance_drifts(struct trial *t)
{
    some_drops(t);
    t->camera.from = soon(t);
    t->camera.balance_step = 1.003;
}

static void comes_late(struct trial *t)
{
    some_drops(t);
    t->camera.lag = 0.1;
}

static void stalls(struct trial *t)
{
    some_drops(t);
    t->camera.stall_at = t->begin + sim_below(&t->sim, 8);
    t->camera.stall_frames = sim_chance(&t->sim, 0.5) ? 1000000 : 1 + sim_below(&t->sim, 60);
}

static void refuses(struct trial *t)
{
    some_drops(t);
    t->camera.refuse = 1 + sim_below(&t->sim, 6);
    t->camera.refuse_with = sim_chance(&t->sim, 0.5) ? ERR_BUSY : ERR_IO;
}

static void many(struct trial *t)
{
    static void (*const some[])(struct trial *) = {
        report_late,    report_early, report_none, ignores_some, errors,     duplicates, repeats,
        sequence_stuck, stamp_zero,   stamp_jumps, lamp_on,      comes_late, refuses,    quantises};
    for (int i = 0; i < 3; i++)
        some[sim_below(&t->sim, (int)(sizeof some / sizeof some[0]))](t);
    t->common |= t->camera.quantum_s > 0.0;
}

static const struct misfortune {
    const char *name;
    void (*strike)(struct trial *t);
    double complete; // least share of complete sets
} misfortunes[] = {
    {"nothing", nothing, 0.99},
    {"drops, seen", drops_seen, 0.99},
    {"drops, hidden", drops_hidden, 0.99},
    {"report late", report_late, 0.99},
    {"report early", report_early, 0.99},
    {"report absent", report_none, 0.99},
    {"exposure ignored", ignores, 0.0},
    {"ignored for some frames", ignores_some, 0.99},
    {"exposure quantised", quantises, 0.0},
    {"exposure rolls over", rolls_over, 0.0},
    {"error flags", errors, 0.99},
    {"duplicates", duplicates, 0.99},
    {"pixels repeated", repeats, 0.99},
    {"pixels garbled", garbles, 0.99},
    {"rows torn", tears, 0.9},
    {"sequence stuck", sequence_stuck, 0.99},
    {"sequence wraps", sequence_wraps, 0.99},
    {"stamps zero", stamp_zero, 0.99},
    {"stamps jump", stamp_jumps, 0.999},
    {"lamp switched", lamp_on, 0.92},
    {"gain drifts", gain_drifts, 0.0},
    {"digital gain", digital_gain, 0.0},
    {"balance drifts", balance_drifts, 0.0},
    {"frames late", comes_late, 0.99},
    {"stalls", stalls, 0.99},
    {"requests refused", refuses, 0.99},
    {"three at once", many, 0.7},
};
enum { N_MISFORTUNES = sizeof misfortunes / sizeof misfortunes[0] };

struct tally {
    int sets, complete, frames, kept, wrong, unverified, wrong_unverified, endless, wrong_patches;
    int reason[BRACKET_REASONS];
    double worst;
};

/* Errors of the labels of what is kept, stops; a factor that the camera had at base from the
 * beginning is none. */
static void compare(struct trial *t, struct tally *out)
{
    const struct sim_camera *c = &t->camera;
    struct exposure base = {t->base_s, 1.0};
    double factor = log2(sim_true(c, base).time_s / t->base_s), lo = INFINITY, hi = -INFINITY;
    for (int i = 0; i < t->plan.n; i++) {
        const struct bracket_evidence *v = bracket_evidence(t->sim.b, 0, i);
        assert_true(c->kept[i] == (v != NULL));
        if (!v)
            continue;
        double e = log2(c->truth[i] / (c->recorded[i].time_s * c->recorded[i].gain)) - factor;
        out->kept++;
        if (v->proof >= BRACKET_UNVERIFIED) {
            out->unverified++;
            out->wrong_unverified += !t->common && !(fabs(e) <= TOLERANCE);
            continue;
        }
        lo = fmin(lo, e);
        hi = fmax(hi, e);
        out->wrong += isnan(e) || (!t->common && !(fabs(e) <= TOLERANCE));
        out->worst = fmax(out->worst, t->common ? 0.0 : fabs(e));
    }
    out->wrong += t->common && hi - lo > 2.0 * TOLERANCE;
}

/* Patches whose radiance, merged of all kept frames, is wrong by more than the tolerance and the
 * codes that a tear may hide in each torn one (core/photo/merge.h). */
static int wrong_patches(const struct trial *t)
{
    const struct sim_camera *c = &t->camera;
    int wrong = 0;
    for (int i = 0; i < SIM_PATCHES; i++) {
        double sum = 0.0, exposure = 0.0, hidden = 0.0;
        for (int k = 0; k < t->plan.n; k++) {
            const struct sim_shot *s = &c->kept_shot[k];
            bool torn = i < s->torn;
            double x = c->scene[i] * (torn ? s->former : s->pixels);
            if (!c->kept[k] || x >= 0.95)
                continue;
            sum += x;
            exposure += c->recorded[k].time_s * c->recorded[k].gain;
            hidden += torn ? SIM_TORN : 0.0;
        }
        double right = c->scene[i] * exposure;
        wrong += fabs(sum - right) > (exp2(TOLERANCE) - 1.0) * right + hidden;
    }
    return wrong;
}

static void run_set(struct trial *t, const struct misfortune *m, struct tally *out)
{
    int camera;
    sim_begin(&t->sim, &t->plan);
    out->endless += !sim_run(&t->sim, 5000);
    out->sets++;
    out->complete += bracket_state(t->sim.b) == BRACKET_DONE;
    out->reason[bracket_reason(t->sim.b, &camera)]++;
    if (bracket_state(t->sim.b) == BRACKET_DONE)
        out->frames += t->sim.frames - t->plan.n;
    compare(t, out);
    out->wrong_patches += m->strike == tears ? wrong_patches(t) : 0;
}

static void run_trial(const struct misfortune *m, uint64_t seed, struct tally *out)
{
    static struct trial t;
    memset(&t, 0, sizeof t);
    t.sim = (struct sim){.n = 1, .camera = &t.camera, .random = seed};
    random_plan(&t);
    random_camera(&t);
    t.begin = sim_chance(&t.sim, 0.8) ? 16 : sim_below(&t.sim, 16);
    m->strike(&t);
    assert_int_equal(bracket_new(&t.cfg, 1, &t.sim.b), OK);
    struct timing_cfg timing = t.camera.timing.cfg;
    sim_start(&t.sim, 0, &timing, (int64_t)(1e12 * sim_uniform(&t.sim)), t.base_s);
    for (int64_t i = 0; i < t.begin; i++)
        sim_step(&t.sim);
    run_set(&t, m, out);
    if (bracket_state(t.sim.b) == BRACKET_DONE && seed % 4 == 0) { // at once, with its reference
        sim_tell(&t.sim, &(struct bracket_event){
                             .kind = BRACKET_ARM, .set = {t.base_s, 1.0}, .same = true});
        run_set(&t, m, out);
    }
    bracket_free(t.sim.b);
}

static void test_never_mislabelled(void **state)
{
    (void)state;
    const char *takes = getenv("TAKES");
    int sets = 0, wrong = 0, bad = 0,
        trials = takes ? atoi(takes) / (N_MISFORTUNES + TORN - 1) : TRIALS;
    for (int m = 0; m < N_MISFORTUNES; m++) {
        struct tally k = {0};
        int n = misfortunes[m].strike == tears ? TORN * trials : trials;
        for (int i = 0; i < n; i++)
            run_trial(&misfortunes[m], (uint64_t)(m * 100000 + i) * 0x10001, &k);
        double share = (double)k.complete / k.sets;
        print_message(
            "%-24s %5.1f %% of %d sets, %4.1f frames more than exposures; %d of %d frames "
            "wrong (%.3f), unverified %d of %d |",
            misfortunes[m].name, 100.0 * share, k.sets,
            k.complete ? (double)k.frames / k.complete : 0.0, k.wrong, k.kept, k.worst,
            k.wrong_unverified, k.unverified);
        for (int r = 1; r < BRACKET_REASONS; r++)
            if (k.reason[r])
                print_message(" %d x %.20s;", k.reason[r],
                              bracket_sentence((enum bracket_reason)r));
        print_message("\n");
        sets += k.sets;
        wrong += k.wrong;
        bad += share < misfortunes[m].complete || k.endless || k.wrong_patches;
    }
    print_message("%d sets, %d frames wrong\n", sets, wrong);
    assert_int_equal(wrong, 0);
    assert_int_equal(bad, 0);
}

static int make_noise(void **state)
{
    struct sim s = {.random = 1};
    (void)state;
    sim_make_noise(&s);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_never_mislabelled),
    };
    return cmocka_run_group_tests(tests, make_noise, NULL);
}
