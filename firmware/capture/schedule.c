#include "firmware/capture/schedule.h"

#include <math.h>

#define LIMIT 0.01       // beyond the range of the device: rounding of requests
#define STEADY_LIST 0.25 // stops
#define STEADY_AUTO 0.5
#define LINK 5.0 // stops between frames that are sure to show the same patches

void schedule_order(const struct config *c, int64_t press_ns, struct session_order *o)
{
    *o = (struct session_order){
        .mode = c->bracket_mode == CONFIG_AUTO ? SESSION_AUTO : SESSION_LIST,
        .middle_s = c->bracket_middle_us * 1e-6,
        .stagger = c->bracket_stagger != 0,
        .turn = -1,
        .verify = true,
        .snr = pow(10, c->bracket_snr_db / 20.0),
        .skew_s = c->bracket_skew_ms * 1e-3,
        .trigger_ns = press_ns,
    };
    err_t e = config_stops("bracket.ev", c->bracket_ev, o->ev, BRACKET_EXPOSURES_MAX, &o->n);
    (void)e; // config_check_rig has read it before
}

bool schedule_is_metered(const struct session_order *o)
{
    return o->mode != SESSION_LIST || !(o->middle_s > 0);
}

int schedule_frames(const struct session_order *o)
{
    if (o->mode == SESSION_METER)
        return 0;
    return o->stagger ? 1 : o->mode == SESSION_LIST ? o->n : BRACKET_EXPOSURES_MAX;
}

static void add_exposure(struct bracket_plan *p, double time_s)
{
    if (p->n < BRACKET_EXPOSURES_MAX)
        p->requested[p->n++] = (struct exposure){time_s, 1};
}

void schedule_probe(double time_s, double base_s, const struct camera_info *info,
                    struct bracket_plan *out)
{
    out->n = 0;
    if (!(time_s > 0))
        return;
    double stops = log2(time_s / base_s);
    int links = (int)fmin(ceil(fabs(stops) / LINK), BRACKET_EXPOSURES_MAX) - 1;
    for (int k = 1; k <= links; k++) {
        double t = base_s * exp2(stops * k / (links + 1));
        add_exposure(out, fmin(fmax(t, info->time_min_s), info->time_max_s));
    }
    add_exposure(out, time_s);
}

/* Exposure k of the list, in stops around the middle one. */
static double list_time(const struct session_order *o, const struct meter_result *r, int k)
{
    double middle = o->middle_s;
    if (schedule_is_metered(o))
        middle = sqrt(r->time_s[0] * r->time_s[r->n - 1]);
    return middle * exp2(o->ev[k]);
}

static void add_list(const struct session_order *o, const struct camera_info *info,
                     const struct meter_result *r, struct bracket_plan *out)
{
    for (int k = 0; k < o->n; k++)
        add_exposure(out, fmin(fmax(list_time(o, r, k), info->time_min_s), info->time_max_s));
}

const char *schedule_limit(const struct session_order *o, const struct camera_info *info,
                           const struct meter_result *r)
{
    for (int k = 0; o->mode == SESSION_LIST && k < o->n; k++) {
        double t = list_time(o, r, k);
        if (t < info->time_min_s * (1 - LIMIT) || t > info->time_max_s * (1 + LIMIT))
            return t < info->time_min_s ? "it has no exposures as short as some of these"
                                        : "it has no exposures as long as some of these";
    }
    if (o->mode == SESSION_LIST || !(r->too_bright || r->too_dark))
        return NULL;
    return r->too_bright ? "the scene is too bright for it" : "the scene is too dark for it";
}

/* A probe whose only evidence is rest is taken again, next to other exposures. */
static bool is_proven(const struct frame_buffer *r, int probe)
{
    return probe >= 0 && probe < r->n && r->kept[probe].frame.evidence.proof < BRACKET_UNVERIFIED;
}

void schedule_shots(const struct session_order *o, int turn, const struct camera_info *info,
                    const struct meter_result *r, struct frame_buffer *roll,
                    struct bracket_plan *out)
{
    out->n = 0;
    if (o->mode == SESSION_LIST)
        add_list(o, info, r, out);
    for (int k = 0; o->mode == SESSION_AUTO && k < r->n; k++) {
        int probe = o->stagger ? -1 : r->probe[k];
        if (is_proven(roll, probe))
            roll->kept[probe].used = true;
        else
            add_exposure(out, r->time_s[k]);
    }
    if (o->stagger && out->n > 1) {
        out->requested[0] = out->requested[turn % out->n];
        out->n = 1;
    }
}

void schedule_steady(const struct session_order *o, const struct take_camera *c,
                     struct bracket_plan *io)
{
    double most = o->mode == SESSION_LIST ? STEADY_LIST : STEADY_AUTO;
    for (int k = 0; k < io->n; k++) {
        double t = flicker_steady_s(&c->light, io->requested[k].time_s);
        bool possible = t >= c->info.time_min_s && t <= c->info.time_max_s;
        if (possible && fabs(log2(t / io->requested[k].time_s)) <= most)
            io->requested[k].time_s = t;
    }
}
