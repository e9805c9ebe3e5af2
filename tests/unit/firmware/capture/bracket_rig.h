/* bracket_rig.h - a rig that does what it promises, whose bracket must be complete. */
#ifndef CAPTURE_BRACKET_RIG_H
#define CAPTURE_BRACKET_RIG_H

#include "tests/unit/firmware/capture/bracket_sim.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define TOLERANCE 0.10

struct rig {
    struct sim sim;
    struct sim_camera camera[BRACKET_CAMERAS_MAX];
    struct bracket_camera cfg[BRACKET_CAMERAS_MAX];
    struct bracket_plan plan[BRACKET_CAMERAS_MAX];
    struct timing_cfg timing;
    double base_s;
};

static struct rig rig;

/* Cameras that do what they promise; n exposures, `step` stops apart, around base. */
static inline void rig_open(int cameras, int delay, int n, double step)
{
    memset(&rig, 0, sizeof rig);
    rig.sim = (struct sim){.n = cameras, .camera = rig.camera, .random = 7};
    rig.base_s = 0.01;
    rig.timing = (struct timing_cfg){.period_s = 1.0 / 30.0,
                                     .longest_s = 100.0,
                                     .gain_max = 1.0,
                                     .delay = delay,
                                     .length = TIMING_STRETCH};
    for (int i = 0; i < cameras; i++) {
        rig.cfg[i] = (struct bracket_camera){.period_s = rig.timing.period_s,
                                             .time_min_s = 1e-6,
                                             .time_max_s = 60.0,
                                             .delay_lo = delay,
                                             .delay_hi = delay,
                                             .reports = true,
                                             .tolerance = TOLERANCE};
        sim_camera_init(&rig.camera[i]);
        sim_scene(&rig.sim, &rig.camera[i], 10.0, 0.05, rig.base_s);
        rig.plan[i].n = n;
        for (int k = 0; k < n; k++)
            rig.plan[i].requested[k] =
                (struct exposure){rig.base_s * exp2(step * (k - 0.5 * (n - 1))), 1.0};
    }
}

static inline void rig_arm(int64_t start_ns)
{
    for (int i = 0; i < rig.sim.n; i++)
        sim_start(&rig.sim, i, &rig.timing, start_ns + 1000000 * i, rig.base_s);
}

static inline void rig_ready(void)
{
    assert_int_equal(bracket_new(rig.cfg, rig.sim.n, &rig.sim.b), OK);
    rig_arm(1000000000);
    for (int i = 0; i < 16 * rig.sim.n; i++)
        sim_step(&rig.sim);
}

static inline void rig_close(void)
{
    bracket_free(rig.sim.b);
}

static inline enum bracket_reason rig_shoot(void)
{
    int camera;
    sim_begin(&rig.sim, rig.plan);
    assert_true(sim_run(&rig.sim, 200000));
    return bracket_reason(rig.sim.b, &camera);
}

/* Every frame of the plans is kept, rightly labelled; with what proof at least. */
static inline void assert_complete(enum bracket_proof weakest)
{
    assert_int_equal(bracket_state(rig.sim.b), BRACKET_DONE);
    for (int c = 0; c < rig.sim.n; c++)
        for (int i = 0; i < rig.plan[c].n; i++) {
            const struct bracket_evidence *v = bracket_evidence(rig.sim.b, c, i);
            double t = rig.plan[c].requested[i].time_s;
            assert_non_null(v);
            assert_true(v->proof <= weakest);
            assert_true(fabs(log2(v->exposure.time_s / t)) < 0.01 && v->requested.time_s == t);
            assert_true(fabs(log2(rig.camera[c].truth[i] / t)) < 0.01);
            assert_true(!v->ratio_known || fabs(v->ratio - v->ratio_asked) < TOLERANCE);
        }
}

static inline void tell(enum bracket_event_kind kind, int camera)
{
    sim_tell(&rig.sim,
             &(struct bracket_event){.kind = kind, .camera = camera, .set = {rig.base_s, 1.0}});
}

static inline struct sim_camera *rig_plain(void)
{
    rig_open(1, 2, 3, 2.0);
    rig_ready();
    return &rig.camera[0];
}

#endif
