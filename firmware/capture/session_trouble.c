/* Why a bracket failed. A lamp that flickers looks like an exposure that is not obeyed, a scene
 * that changes, or torn frames: comparing long frames, which average over it, with short ones
 * tells which it is. If it is the lamp, the bracket is taken again, with exposures that hold whole
 * periods of it where that is possible, and with a tolerance for the others. */
#include "firmware/capture/schedule.h"
#include "firmware/capture/session_inner.h"

#include "drivers/format/subsample.h"

#include <math.h>
#include <stdio.h>

enum { LONG_FRAMES = 6, EACH = 2 }; // frames: to average; of each time
static const double shorter[FLICKER_FRAMES / EACH] = {0.25, 0.5, 0.125, 0.35}; // shares of LONG_S

#define SECOND INT64_C(1000000000)
#define LONG_S 0.01     // a whole period of 100 Hz, nearly one of 120 Hz
#define PATIENCE_S 2.0  // beyond twice the frames that it takes
#define LOST_SHARE 0.25 // lost share of the frames above which the machine is too slow

bool session_trouble_is_light(const struct session *s, enum bracket_reason r)
{
    bool like_light =
        r == BRACKET_INEFFECTIVE || r == BRACKET_SCENE_CHANGED || r == BRACKET_BAD_FRAMES;
    return like_light && !s->tried && !s->lost;
}

static err_t arm_probe(struct session *s, int i, double time_s)
{
    struct trouble *t = &s->cam[i].trouble;
    t->time_s = time_s;
    t->wait = SESSION_SETTLE;
    return session_machine_arm(s, i, time_s);
}

err_t session_trouble_begin(struct session *s)
{
    double longest = LONG_S;
    err_t e = OK;
    s->phase = PHASE_TROUBLE;
    s->tried = true;
    for (int i = 0; i < s->n && !e; i++) {
        struct cam *c = &s->cam[i];
        c->trouble = (struct trouble){.base_s = c->set.time_s};
        longest = fmax(longest, fmax(c->about.info.period_s, c->set.time_s));
        e = arm_probe(s, i, LONG_S);
    }
    double frames = 2.0 * ((1 + FLICKER_FRAMES / EACH) * (SESSION_SETTLE + EACH) + LONG_FRAMES);
    s->until_ns =
        session_machine_now(s) + (int64_t)((frames * longest + PATIENCE_S) * (double)SECOND);
    return e;
}

err_t session_trouble_see(struct session *s, int i, const struct frame *f,
                          const struct exposure_probe *w)
{
    struct cam *c = &s->cam[i];
    struct trouble *t = &c->trouble;
    if (t->over || t->wait-- > 0)
        return OK;
    if (!t->is_short) {
        flicker_add_long(&t->seen, w, c->set.time_s);
        if (t->seen.n_long < LONG_FRAMES)
            return OK;
        t->is_short = true;
        return arm_probe(s, i, LONG_S * shorter[0]);
    }
    bool ends = c->about.info.stamp == CAMERA_STAMP_END;
    flicker_add_short(&t->seen, w, (double)f->timestamp_ns * 1e-9 - ends * c->set.time_s,
                      c->set.time_s);
    int n = t->seen.n_short;
    if (n < FLICKER_FRAMES)
        return n % EACH ? OK : arm_probe(s, i, LONG_S * shorter[n / EACH]);
    flicker_find(&t->seen, c->about.info.period_s, &c->about.light);
    t->over = true;
    return OK;
}

err_t session_trouble_end(struct session *s, enum session_outcome *out)
{
    bool over = session_machine_now(s) >= s->until_ns, all = true, any = false;
    err_t e = OK;
    for (int i = 0; i < s->n; i++) {
        all = all && s->cam[i].trouble.over;
        any = any || (s->cam[i].trouble.over && s->cam[i].about.light.hz > 0.0);
    }
    *out = !all && !over ? SESSION_LOOKING : any ? SESSION_FLICKERS : SESSION_STEADY;
    for (int i = 0; i < s->n && any && *out == SESSION_FLICKERS && !e; i++) {
        struct cam *c = &s->cam[i];
        bracket_light(s->machine, i, &c->about.light);
        e = session_machine_arm(s, i, flicker_steady_s(&c->about.light, c->trouble.base_s));
    }
    return e;
}

/* ---- sentences ---- */

/* An unusual curve looks like an exposure that is not obeyed. */
static const char *advice_on(const struct cam *c, enum bracket_reason r)
{
    bool known = c->about.has_crf || subsample_kind(&c->about.info).linear;
    if (r == BRACKET_INEFFECTIVE && !known)
        return "; unless its response curve is an unusual one, which hdrig calibrate --camera URI "
               "measures";
    return r == BRACKET_SCENE_CHANGED ? ": keep both still and take it again" : "";
}

void session_trouble_sentence(struct session *s, int i, enum bracket_reason r)
{
    const struct cam *c = &s->cam[i];
    const struct camera_info *info = &c->about.info;
    struct bracket_progress p;
    char *out = s->reason;
    size_t n = sizeof s->reason;
    bool unclear = session_trouble_is_light(s, r) || (s->tried && r != BRACKET_CANCELLED);
    bracket_progress(s->machine, &p);
    if (unclear && p.lost > LOST_SHARE * (p.frames + p.lost))
        snprintf(out, n,
                 "camera %d: %d of %d frames were lost: this machine is too slow for "
                 "%dx%d px at %.3g frames/s; use fewer or smaller frames",
                 i + 1, p.lost, p.frames + p.lost, info->w, info->h, 1.0 / info->period_s);
    else if (unclear && c->about.light.hz > 0.0)
        snprintf(out, n,
                 "camera %d: the light flickers at %.0f Hz, by %.0f %%: use other lamps, or "
                 "exposures of %.3g ms and its multiples",
                 i + 1, c->about.light.hz, 100.0 * c->about.light.depth, 1e3 / c->about.light.hz);
    else
        snprintf(out, n, "camera %d: %s%s", i + 1, bracket_sentence(r), advice_on(c, r));
}
