#include "firmware/rig/rigplan.h"

#include <math.h>

#define SAME 0.25 // stops: one exposure serves cameras that want so little different ones

bool rigplan_is_metered(const struct config *c)
{
    return c->bracket_mode == CONFIG_AUTO || c->bracket_middle_us == 0;
}

struct range {
    double low, high; // s
    double step;      // stops
};

static struct range range_of(const struct message_meter *meters, int n)
{
    struct range r = {INFINITY, 0, 0};
    for (int i = 0; i < n; i++)
        for (int k = 0; k < meters[i].n; k++) {
            const double t = meters[i].time_s[k];
            r.low = fmin(r.low, t);
            r.high = fmax(r.high, t);
            if (k > 0)
                r.step = fmax(r.step, fabs(log2(t / meters[i].time_s[k - 1])));
        }
    return r;
}

static err_t make_list(const struct config *c, double middle_s, struct rigplan *out)
{
    double ev[BRACKET_EXPOSURES_MAX];
    err_t e = config_stops("bracket.ev", c->bracket_ev, ev, BRACKET_EXPOSURES_MAX, &out->n);
    for (int i = 0; i < out->n && !e; i++) {
        int k = i;
        const double t = fmin(fmax(middle_s * exp2(ev[i]), MESSAGE_TIME_MIN_S), MESSAGE_TIME_MAX_S);
        for (; k > 0 && out->time_s[k - 1] > t; k--)
            out->time_s[k] = out->time_s[k - 1];
        out->time_s[k] = t;
    }
    return e;
}

err_t rigplan_make(const struct config *c, const struct message_meter *meters, int n,
                   struct rigplan *out)
{
    *out = (struct rigplan){0};
    if (!rigplan_is_metered(c))
        return make_list(c, c->bracket_middle_us * 1e-6, out);
    const struct range r = range_of(meters, n);
    if (!(r.high > 0))
        return err_fail(ERR_ARG, "no camera of the rig could be metered");
    if (c->bracket_mode == CONFIG_LIST)
        return make_list(c, sqrt(r.low * r.high), out);
    const double stops = log2(r.high / r.low), step = r.step > 0 ? r.step : RIGPLAN_STEP;
    int steps = stops <= SAME ? 0 : (int)fmin(ceil(stops / step - 1e-3), BRACKET_EXPOSURES_MAX - 1);
    out->n = steps + 1;
    for (int i = 0; i <= steps; i++)
        out->time_s[i] = steps ? r.low * exp2(stops * i / steps) : sqrt(r.low * r.high);
    return OK;
}
