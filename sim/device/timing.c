/* The model of libcamera's DelayedControls and of the sensors behind it: each control is a register
 * that is latched a constant number of frames after the write. Frame length follows the exposure in
 * the same frame, as if the driver wrote VBLANK and EXPOSURE together. */
#include "sim/device/timing.h"

#include "sim/sensor/sensor.h"

#include <math.h>
#include <string.h>

#define WOBBLE_KEY (UINT64_C(1) << 32)

double timing_time(const struct timing_cfg *c, double time_s)
{
    double longest = c->longest_s;
    if (c->length == TIMING_LIMIT)
        longest = fmin(longest, c->period_s);
    if (c->step_s <= 0.0)
        return fmin(time_s, longest);
    double steps = floor(fmin(time_s, longest) / c->step_s * (1.0 + 1e-9)); // 3 * 0.1 are 3 steps
    return fmax(steps, 1.0) * c->step_s;
}

double timing_gain(const struct timing_cfg *c, double gain)
{
    return fmax(fmin(gain, c->gain_max), 1.0);
}

static void control_write(struct timing_control *c, int64_t from, double value)
{
    int last = c->n - 1;
    if (c->n > 0 &&
        from <= c->pending[last].from) { // not before an earlier write, which it replaces
        c->pending[last].value = value;
        return;
    }
    c->pending[c->n].from = from; // `pending` has room for every frame ahead
    c->pending[c->n++].value = value;
}

static void control_step(struct timing_control *c, int64_t frame)
{
    int k = 0;
    while (k < c->n && c->pending[k].from <= frame)
        c->value = c->pending[k++].value;
    memmove(c->pending, c->pending + k, (size_t)(c->n - k) * sizeof c->pending[0]);
    c->n -= k;
}

static int64_t wobble_of(const struct timing *t, int64_t number)
{
    double share = 2.0 * sensor_uniform(t->cfg.seed + WOBBLE_KEY, (uint64_t)number) - 1.0;
    return (int64_t)(t->cfg.wobble_s * share * 1e9);
}

static void frame_begin(struct timing *t, int64_t number, int64_t start_ns)
{
    control_step(&t->time, number);
    control_step(&t->gain, number);
    double length = t->cfg.period_s * (1.0 + t->cfg.drift);
    if (t->cfg.length == TIMING_STRETCH)
        length = fmax(length, t->time.value + 2.0 * t->cfg.wobble_s);
    t->grid_ns += (int64_t)llround(length * 1e9);
    if (number >= t->shift_from) {
        t->grid_ns += t->shift_ns;
        t->shift_ns = 0;
    }
    t->now = (struct timing_frame){number, start_ns, t->grid_ns + wobble_of(t, number + 1),
                                   t->time.value, t->gain.value};
}

void timing_open(struct timing *t, const struct timing_cfg *cfg, int64_t start_ns, double time_s)
{
    memset(t, 0, sizeof *t);
    t->cfg = *cfg;
    t->time.value = timing_time(cfg, time_s);
    t->gain.value = 1.0;
    t->grid_ns = start_ns;
    frame_begin(t, 0, start_ns);
}

void timing_write(struct timing *t, double time_s, double gain)
{
    int late = (int)(sensor_uniform(t->cfg.seed, t->writes++) * (t->cfg.jitter + 1));
    control_write(&t->time, t->now.number + t->cfg.delay + late, timing_time(&t->cfg, time_s));
    control_write(&t->gain, t->now.number + t->cfg.gain_delay + late, timing_gain(&t->cfg, gain));
}

bool timing_shift(struct timing *t, int64_t ns)
{
    if (t->shift_ns > 0)
        return false;
    t->shift_from = t->now.number + t->cfg.delay;
    t->shift_ns = ns;
    return true;
}

struct timing_frame timing_step(struct timing *t)
{
    struct timing_frame done = t->now;
    frame_begin(t, done.number + 1, done.end_ns);
    return done;
}

void timing_stall(struct timing *t, int64_t ns)
{
    t->now.start_ns += ns;
    t->now.end_ns += ns;
    t->grid_ns += ns;
}
