/* First the device alone, through firmware/capture/device_probe.h: rate, base exposure, delay,
 * response curve, latching (14 requests back to back), the sweep of exposures; then brackets by
 * firmware/capture/session.h, as captures are made, with the calibration that there is, else with
 * what was just measured, in a folder of its own for so long. A stage that fails leaves those that
 * need it skipped; what counts over all frames is judged in any case. */
#include "firmware/cmd/selftest.h"

#include "drivers/device/clocks.h"
#include "firmware/base/engine.h"
#include "firmware/base/tempdir.h"
#include "firmware/capture/session.h"
#include "firmware/cmd/cmd.h"

#include "core/base/num.h"
#include "drivers/format/file.h"

#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define SECOND INT64_C(1000000000)

enum {
    REST_FRAMES = 10,
    RATE_FRAMES = 100,
    SHOTS = 14,
    DROPS_PER = 500,                                  // one lost frame of so many is forgiven
    FEW_PATCHES = EXPOSURE_PROBE_PATCHES / 20,        // least patches of a usable picture
    LEAST_PATCHES = EXPOSURE_PROBE_PATCHES / 200 + 1, // as firmware/capture/label.c
    SESSION_MB = 1000
};
#define RATE_OFF 0.02    // part of the period
#define GAIN_OFF 0.005   // firmware/capture/README.md 3
#define CLASS 0.5        // stops: halfway to a step that an unknown curve may make smaller
#define REPORT_OFF 0.25  // stops, pixels against the report, if the curve is known
#define STAMP_LATE_S 3.0 // as firmware/capture/label.c
#define STILL 0.05       // stops, if the curve is known
#define WARM_S 0.6       // session: a reference is at hand
#define BRACKET_S 20.0   // and longer by exposures

struct stand {
    struct selftest *t;
    const struct selftest_order *o;
    struct device_probe *w;
    bool simulated;     // time stamps run faster than time
    struct calib known; // before this run
    double middle_s;    // exposure with room for two stops either way; 0: there is none
};

static const char *const names[SELFTEST_CHECKS] = {
    "stream", "rate",     "sequence", "drops",    "timestamps", "errors",
    "gains",  "requests", "effect",   "delay",    "latching",   "reported",
    "ratios", "monotone", "steady",   "bracket3", "bracket5"};

const char *selftest_name(enum selftest_check c)
{
    return names[c];
}

__attribute__((format(printf, 4, 5))) static void
set_finding(struct selftest *t, enum selftest_check c, enum selftest_result r, const char *fmt, ...)
{
    va_list args;
    t->check[c].result = r;
    va_start(args, fmt);
    vsnprintf(t->check[c].text, sizeof t->check[c].text, fmt, args);
    va_end(args);
}

static void add_figure(struct selftest *t, enum selftest_check c, const char *name, double v)
{
    struct selftest_finding *f = &t->check[c];
    f->figure[f->n].name = name;
    f->figure[f->n++].value = v;
}

static enum selftest_result pass_if(bool ok)
{
    return ok ? SELFTEST_PASS : SELFTEST_FAIL;
}

/* ---- rate ---- */

struct rate { // sums and the longest, of intervals; [0] by arrival, [1] by time stamps
    int n[2];
    double sum_s[2], worst_s[2];
    int early; // frames that arrive in less than half of the time that they took
};

static void sum_interval(struct rate *k, int by, double dt, double frames, double most)
{
    if (dt > most * frames)
        return; // a frame that is missing, or a clock that jumps: others count these
    k->n[by]++;
    k->sum_s[by] += dt / frames;
    k->worst_s[by] = fmax(k->worst_s[by], dt / frames);
}

static void add_interval(const struct stand *r, const struct device_probe_frame *a,
                         const struct device_probe_frame *b, struct rate *k)
{
    uint32_t gap = b->sequence - a->sequence;
    double frames = gap >= 1 && gap <= 64 ? gap : 1.0, period = r->w->info.period_s;
    double arrival = (double)(b->arrival_ns - a->arrival_ns) * 1e-9;
    double stamp = (double)(b->stamp_ns - a->stamp_ns) * 1e-9;
    sum_interval(k, 0, arrival, frames, INFINITY);
    if (a->stamp_ns <= 0 || stamp <= 0.0)
        return;
    sum_interval(k, 1, stamp, frames, 1.5 * period);
    k->early += arrival < 0.5 * stamp;
}

static err_t check_rate(struct stand *r)
{
    struct rate k = {.n = {0}};
    struct device_probe_frame a, b;
    double period = r->w->info.period_s;
    err_t e = device_probe_ask(r->w, fmax(0.5 * period, r->w->info.time_min_s), 0);
    for (int i = 0; !e && i < REST_FRAMES; i++)
        e = device_probe_next(r->w, false, &a);
    for (int i = 0; !e && i < RATE_FRAMES; i++) {
        device_probe_tell(r->w, "rate", i, RATE_FRAMES);
        e = device_probe_next(r->w, false, &b);
        if (!e)
            add_interval(r, &a, &b, &k);
        a = b;
    }
    if (e)
        return e;
    int by = k.n[1] >= RATE_FRAMES / 2;
    double mean = k.n[by] > 0 ? k.sum_s[by] / k.n[by] : 0.0;
    r->simulated = k.early > RATE_FRAMES / 2;
    set_finding(r->t, SELFTEST_RATE, pass_if(fabs(mean / period - 1.0) <= RATE_OFF),
                "a frame takes %.2f ms, at most %.2f ms; stated are %.2f ms (by %s)", mean * 1e3,
                k.worst_s[by] * 1e3, period * 1e3, by ? "time stamps" : "arrival");
    add_figure(r->t, SELFTEST_RATE, "stated_s", period);
    add_figure(r->t, SELFTEST_RATE, "mean_s", mean);
    add_figure(r->t, SELFTEST_RATE, "worst_s", k.worst_s[by]);
    return OK;
}

/* ---- delay ---- */

static void judge_delay(struct stand *r)
{
    const struct calib *m = &r->t->measured.calib;
    const struct calib *k = &r->known;
    const char *who = r->t->calibrated ? "calibrated" : "promised";
    int said = r->w->info.exposure_delay;
    bool inside = m->delay_lo >= k->delay_lo && m->delay_hi <= k->delay_hi;
    bool constant = m->delay_lo == m->delay_hi || r->t->calibrated;
    set_finding(r->t, SELFTEST_DELAY, pass_if(inside && constant),
                "exposure shows %d to %d frames after a request in %d steps; %s: %d to %d",
                m->delay_lo, m->delay_hi, r->t->measured.trials, who, k->delay_lo, k->delay_hi);
    add_figure(r->t, SELFTEST_DELAY, "least", m->delay_lo);
    add_figure(r->t, SELFTEST_DELAY, "most", m->delay_hi);
    add_figure(r->t, SELFTEST_DELAY, "promised", said);
    add_figure(r->t, SELFTEST_DELAY, "steps", r->t->measured.trials);
}

/* ---- latching ---- */

static const int pattern[SHOTS] = {0, 0, 1, 1, 0, 0, -1, 0, 1, 0, -1, 0, -1, -1}; // two stops each

struct latching {
    struct device_probe_frame rest;
    bool shown[SHOTS];
    int right, wrong, reports, lies;
    double lie; // stops, the worst
};

static int class_of(double stops)
{
    return stops > CLASS ? 1 : stops < -CLASS ? -1 : 0;
}

static void measure_shot(const struct stand *r, const struct device_probe_frame *s,
                         struct latching *k)
{
    int shot = device_probe_in_force(r->w, r->t->measured.calib.delay_lo) - 1;
    struct exposure_probe_ratio ratio;
    if (shot < 0 || !s->usable)
        return;
    exposure_probe_compare(&k->rest.seen, &s->seen, 0, &ratio);
    if (ratio.patches < LEAST_PATCHES)
        return;
    bool right = class_of(ratio.log2) == pattern[shot];
    k->shown[shot] = true;
    k->right += right;
    k->wrong += !right;
    if (!s->exposure_known || !k->rest.exposure_known)
        return;
    double said = label_stops(&s->exposure) - label_stops(&k->rest.exposure);
    double off = fabs(said - (double)ratio.log2);
    bool exact = r->w->linear || r->w->has_crf;
    k->reports++;
    k->lies += exact ? off > REPORT_OFF : class_of(said) != class_of(ratio.log2);
    k->lie = fmax(k->lie, off);
}

static err_t shoot_pattern(struct stand *r, struct latching *k)
{
    int hold = r->t->measured.calib.delay_hi + 1;
    struct device_probe_frame s = {0};
    err_t e = device_probe_ask(r->w, r->middle_s, 0);
    if (!e)
        e = device_probe_rest(r->w, hold, &k->rest);
    for (int i = 0; !e && i < SHOTS; i++) {
        device_probe_tell(r->w, "latching", i, SHOTS);
        e = device_probe_ask(r->w, r->middle_s * pow(4.0, pattern[i]), i + 1);
        if (!e)
            e = device_probe_next(r->w, true, &s);
        if (!e)
            measure_shot(r, &s, k);
    }
    while (!e && s.age_lo < hold) {
        e = device_probe_next(r->w, true, &s);
        if (!e)
            measure_shot(r, &s, k);
    }
    return e;
}

static err_t check_latching(struct stand *r)
{
    static const char varies[] = "the delay varies, so nobody can say which frame is the right one";
    struct latching k = {.right = 0};
    int shown = 0;
    const struct calib *m = &r->t->measured.calib;
    err_t e = shoot_pattern(r, &k);
    if (e)
        return e;
    for (int i = 0; i < SHOTS; i++)
        shown += k.shown[i];
    bool some = shown >= SHOTS / 2 || k.wrong > 0;
    if (m->delay_lo != m->delay_hi)
        set_finding(r->t, SELFTEST_LATCHING, SELFTEST_SKIPPED, varies);
    else
        set_finding(r->t, SELFTEST_LATCHING, pass_if(some && k.wrong == 0),
                    "of %d requests back to back %d could be seen; %d frames were right, %d wrong",
                    SHOTS, shown, k.right, k.wrong);
    add_figure(r->t, SELFTEST_LATCHING, "seen", shown);
    add_figure(r->t, SELFTEST_LATCHING, "right", k.right);
    add_figure(r->t, SELFTEST_LATCHING, "wrong", k.wrong);
    if (k.reports == 0) {
        set_finding(r->t, SELFTEST_REPORTED, SELFTEST_SKIPPED, "frames do not say their exposure");
        return OK;
    }
    set_finding(
        r->t, SELFTEST_REPORTED, pass_if(k.lies == 0),
        "of %d frames %d say another exposure than their pixels show, by %.2f stops at most",
        k.reports, k.lies, k.lie);
    add_figure(r->t, SELFTEST_REPORTED, "frames", k.reports);
    add_figure(r->t, SELFTEST_REPORTED, "wrong", k.lies);
    add_figure(r->t, SELFTEST_REPORTED, "worst_stops", k.lie);
    return OK;
}

/* ---- the sweep ---- */

static void judge_ratios(struct stand *r, int seen, const struct calibrate_step *worst, double off)
{
    const struct calibrate *c = &r->t->measured;
    int wrong = 0;
    for (int i = 1; i < c->n; i++)
        wrong += c->step[i].verdict == CALIBRATE_WRONG;
    if (!r->w->linear && !r->w->has_crf)
        set_finding(r->t, SELFTEST_RATIOS, SELFTEST_SKIPPED, "no response curve: %.120s",
                    c->curve_why);
    else if (seen == 0 && wrong == 0)
        set_finding(r->t, SELFTEST_RATIOS, SELFTEST_SKIPPED, "too dark or too bright to see any");
    else
        set_finding(
            r->t, SELFTEST_RATIOS, pass_if(wrong == 0),
            "%d ratios of neighbours up to %.3g s: %d wrong; the worst is %.3f stops off, at %.3g "
            "s; at most %.2f",
            seen, c->step[c->n - 1].time_s, wrong, off, worst ? worst->time_s : 0.0,
            calibrate_slack(r->w));
    add_figure(r->t, SELFTEST_RATIOS, "seen", seen);
    add_figure(r->t, SELFTEST_RATIOS, "wrong", wrong);
    add_figure(r->t, SELFTEST_RATIOS, "worst_stops", off);
    add_figure(r->t, SELFTEST_RATIOS, "tolerance", calibrate_slack(r->w));
}

static void judge_sweep(struct stand *r)
{
    const struct calibrate *c = &r->t->measured;
    const struct calibrate_step *worst = NULL, *fall = NULL;
    int seen = 0, falls = 0;
    double off = 0.0;
    for (int i = 1; i < c->n; i++) {
        const struct calibrate_step *s = &c->step[i];
        double d = isnan(s->measured) ? 0.0 : fabs(s->measured - s->requested);
        seen += !isnan(s->measured);
        worst = d > off ? s : worst;
        off = fmax(off, d);
        fall = s->rises || fall ? fall : s;
        falls += !s->rises;
    }
    judge_ratios(r, seen, worst, off);
    if (seen + falls == 0)
        set_finding(r->t, SELFTEST_MONOTONE, SELFTEST_SKIPPED, "too dark or too bright to see");
    else if (falls)
        set_finding(r->t, SELFTEST_MONOTONE, SELFTEST_FAIL,
                    "%d of %d longer exposures are not brighter, the first is %.3g s", falls,
                    c->n - 1, fall->time_s);
    else
        set_finding(r->t, SELFTEST_MONOTONE, SELFTEST_PASS, "%d exposures from %.3g s to %.3g s",
                    c->n, c->step[0].time_s, c->step[c->n - 1].time_s);
    add_figure(r->t, SELFTEST_MONOTONE, "exposures", c->n);
    add_figure(r->t, SELFTEST_MONOTONE, "wrong", falls);
}

static err_t run_sweep(struct stand *r)
{
    struct calibrate *c = &r->t->measured;
    err_t e = calibrate_range(r->w, c);
    if (e && e != ERR_LIMIT)
        return e;
    judge_sweep(r);
    bool exact = r->w->linear || r->w->has_crf;
    set_finding(r->t, SELFTEST_STEADY, pass_if(!e && (!exact || fabs(c->drift) <= STILL)),
                "the same exposure differs by %.3f stops before and "
                "after the sweep%s",
                c->drift, e ? ": light, scene or gain changed" : "");
    add_figure(r->t, SELFTEST_STEADY, "drift_stops", c->drift);
    return OK;
}

/* The middle of brackets, within the range that obeys; 0 if they would not show the scene. */
static err_t choose_middle(struct stand *r)
{
    const struct calib *m = &r->t->measured.calib;
    double lo = fmax(m->time_min_s, r->known.time_min_s);
    double hi = fmin(m->time_max_s, r->known.time_max_s);
    bool shows[3];
    r->middle_s = fmax(fmin(r->t->measured.base_s, 0.25 * hi), 4.0 * lo);
    for (int i = 0; i < 3; i++) {
        struct device_probe_frame s;
        err_t e = device_probe_ask(r->w, fmin(r->middle_s * pow(4.0, i - 1), hi), 0);
        if (!e)
            e = device_probe_rest(r->w, m->delay_hi + 1, &s);
        if (e)
            return e;
        shows[i] = s.seen.good >= FEW_PATCHES;
    }
    if (shows[0] && shows[1] && shows[2] && 4.0 * r->middle_s <= 1.01 * hi)
        return OK;
    for (int i = SELFTEST_BRACKET3; i <= SELFTEST_BRACKET5; i++)
        set_finding(r->t, (enum selftest_check)i, SELFTEST_SKIPPED,
                    "%.3g s to %.3g s, which can be used, do not show this scene", lo, hi);
    r->middle_s = 0.0;
    return OK;
}

/* ---- counts over all frames ---- */

static void judge_sequence(struct stand *r)
{
    const struct device_probe_count *n = &r->w->count;
    int lost = n->lost + n->hidden;
    set_finding(r->t, SELFTEST_SEQUENCE, pass_if(n->repeated + n->backward == 0),
                "of %d frames %d have the number of the one before, %d a smaller one", n->frames,
                n->repeated, n->backward);
    add_figure(r->t, SELFTEST_SEQUENCE, "frames", n->frames);
    add_figure(r->t, SELFTEST_SEQUENCE, "repeated", n->repeated);
    add_figure(r->t, SELFTEST_SEQUENCE, "backward", n->backward);
    set_finding(r->t, SELFTEST_DROPS, pass_if(lost * DROPS_PER <= n->frames),
                "%d of %d frames were lost%s", lost, n->frames,
                n->hidden ? ", and the sequence does not tell" : "");
    add_figure(r->t, SELFTEST_DROPS, "lost", n->lost);
    add_figure(r->t, SELFTEST_DROPS, "hidden", n->hidden);
    add_figure(r->t, SELFTEST_DROPS, "frames", n->frames);
}

static void judge_stamps(struct stand *r)
{
    const struct device_probe_count *n = &r->w->count;
    double most = STAMP_LATE_S + 3.0 * r->o->longest_s;
    bool timed = r->t->check[SELFTEST_RATE].result != SELFTEST_SKIPPED && !r->simulated;
    bool off = timed && (n->stamp_early_s < -1e-3 || n->stamp_late_s > most);
    bool wall = n->stamps_wall > 0, falls = n->stamps_back + n->jumps > 0;
    const char *what = n->unstamped   ? "missing"
                       : wall         ? "of the wall clock"
                       : off          ? "of another clock than CLOCK_MONOTONIC"
                       : falls        ? "not steady"
                       : r->simulated ? "of a simulation that has its own time"
                                      : "of CLOCK_MONOTONIC";
    set_finding(r->t, SELFTEST_STAMPS, pass_if(!n->unstamped && !wall && !off && !falls),
                "%s; of %d, %d are missing, %d not later than the one before, %d jump ahead", what,
                n->frames, n->unstamped, n->stamps_back, n->jumps);
    add_figure(r->t, SELFTEST_STAMPS, "missing", n->unstamped);
    add_figure(r->t, SELFTEST_STAMPS, "backward", n->stamps_back + n->jumps);
    add_figure(r->t, SELFTEST_STAMPS, "arrival_least_s", n->stamp_early_s);
    add_figure(r->t, SELFTEST_STAMPS, "arrival_most_s", n->stamp_late_s);
}

static void judge_counts(struct stand *r)
{
    const struct device_probe_count *n = &r->w->count;
    int bad = n->flagged + n->unreadable + n->failed;
    if (n->frames == 0)
        return;
    judge_sequence(r);
    judge_stamps(r);
    set_finding(
        r->t, SELFTEST_ERRORS, pass_if(bad == 0),
        "of %d frames %d are marked as bad or short, %d cannot be read, %d could not be had",
        n->frames, n->flagged, n->unreadable, n->failed);
    add_figure(r->t, SELFTEST_ERRORS, "flagged", n->flagged);
    add_figure(r->t, SELFTEST_ERRORS, "unreadable", n->unreadable);
    add_figure(r->t, SELFTEST_ERRORS, "failed", n->failed);
    if (!n->gains_known)
        set_finding(r->t, SELFTEST_GAINS, SELFTEST_SKIPPED, "frames do not say their gains");
    else
        set_finding(r->t, SELFTEST_GAINS, pass_if(fmax(n->gain_off, n->balance_off) <= GAIN_OFF),
                    "digital gain is off 1 by up to %.2f %%, white balance moves by up to %.2f %%",
                    100.0 * n->gain_off, 100.0 * n->balance_off);
    add_figure(r->t, SELFTEST_GAINS, "digital_off", n->gain_off);
    add_figure(r->t, SELFTEST_GAINS, "balance_off", n->balance_off);
    if (r->t->check[SELFTEST_REQUESTS].result != SELFTEST_FAIL)
        set_finding(r->t, SELFTEST_REQUESTS, pass_if(n->refused + n->misread == 0),
                    "of %d requests %d were refused, %d read back as something else", n->requests,
                    n->refused, n->misread);
    add_figure(r->t, SELFTEST_REQUESTS, "requests", n->requests);
    add_figure(r->t, SELFTEST_REQUESTS, "refused", n->refused);
    add_figure(r->t, SELFTEST_REQUESTS, "misread", n->misread);
}

/* ---- the device alone ---- */

static err_t check_device(struct stand *r)
{
    struct calibrate *c = &r->t->measured;
    const struct camera_info *info = &r->w->info;
    err_t e = calibrate_delay(r->w, c);
    if (e == ERR_UNSUPPORTED && r->w->count.refused == 0) {
        set_finding(r->t, SELFTEST_EFFECT, SELFTEST_FAIL, "%.190s", err_text());
        return OK;
    }
    if (e)
        return e;
    set_finding(r->t, SELFTEST_EFFECT, SELFTEST_PASS, "pixels follow exposure, seen at %.3g s",
                c->base_s);
    add_figure(r->t, SELFTEST_EFFECT, "base_s", c->base_s);
    judge_delay(r);
    r->middle_s = fmax(fmin(c->base_s, 0.25 * info->time_max_s), 4.0 * info->time_min_s);
    if (!c->calib.has_crf)
        e = calibrate_curve(r->w, c);
    if (!e)
        e = check_latching(r);
    if (!e)
        e = run_sweep(r);
    return e ? e : choose_middle(r);
}

static err_t measure_camera(struct stand *r)
{
    struct calibrate *c = &r->t->measured;
    err_t e = check_rate(r);
    if (!e)
        e = calibrate_base(r->w, c);
    if (e == ERR_LIMIT && r->w->count.refused == 0) {
        for (int i = SELFTEST_EFFECT; i < SELFTEST_CHECKS; i++)
            set_finding(r->t, (enum selftest_check)i, SELFTEST_SKIPPED, "%.190s", err_text());
        return OK;
    }
    return e ? e : check_device(r);
}

/* ---- brackets ---- */

/* Run the session until it is in that state, for least_s at least. */
static err_t run_session(struct session *s, enum session_state state, double least_s, double most_s)
{
    int64_t now = clocks_now(), least = now + (int64_t)(least_s * 1e9);
    int64_t most = now + (int64_t)(most_s * 1e9);
    err_t e = OK;
    while (!e && (now < least || (session_state(s) != state && now < most))) {
        if (atomic_load(&engine_cancel))
            return err_fail(ERR_CANCELLED, "cancelled");
        cmd_wait(s);
        e = session_step(s);
        now = clocks_now();
    }
    if (!e && session_state(s) != state)
        e = err_fail(ERR_TIMEOUT, "after %.3g s it still %s", most_s, session_status(s));
    return e;
}

static void judge_take(struct stand *r, enum selftest_check c, const struct take *t, int n,
                       int lost)
{
    const struct calib *m = &r->t->measured.calib;
    int most = n + m->delay_hi + 2;
    bool proven = t->status == TAKE_COMPLETE && t->n == n && !take_unverified(t);
    bool quick = t->frames_used <= most || lost + t->rejected > 0;
    set_finding(
        r->t, c, pass_if(proven && quick),
        "%d of %d frames, %s; %d frames were looked at, %d refused, %d lost; %d are enough%s%.80s",
        t->n, n, proven ? "all proven" : "not proven", t->frames_used, t->rejected, lost, most,
        t->reason[0] ? "; " : "", t->reason);
    add_figure(r->t, c, "kept", t->n);
    add_figure(r->t, c, "used", t->frames_used);
    add_figure(r->t, c, "enough", most);
    add_figure(r->t, c, "refused", t->rejected);
}

static err_t shoot_bracket(struct stand *r, struct session *s, enum selftest_check c, int n)
{
    struct session_order o = {.mode = SESSION_LIST, .n = n, .middle_s = r->middle_s};
    struct bracket_progress p;
    struct take *t = NULL;
    double long_s = 40.0 * r->middle_s;
    for (int i = 0; i < n; i++)
        o.ev[i] = 4.0 * i / (n - 1) - 2.0;
    err_t e = run_session(s, SESSION_ARMED, WARM_S + REST_FRAMES * r->t->info.period_s, BRACKET_S);
    if (!e)
        e = session_begin(s, &o);
    if (!e)
        e = run_session(s, SESSION_READY, 0.0, BRACKET_S + long_s);
    session_progress(s, &p);
    if (!e)
        e = session_collect(s, &t);
    if (!e)
        judge_take(r, c, t, n, p.lost);
    else if (e != ERR_CANCELLED && e != ERR_NOMEM)
        set_finding(r->t, c, SELFTEST_FAIL, "%.190s", err_text());
    take_free(t);
    return e == ERR_CANCELLED || e == ERR_NOMEM ? e : OK;
}

static err_t brackets_with(struct stand *r, const char *calibration)
{
    const struct camera_cfg *cfg = &r->o->camera;
    struct session_config c = {.n = 1,
                               .uri = {cfg->uri},
                               .w = cfg->w,
                               .h = cfg->h,
                               .format = cfg->format,
                               .calibration = calibration,
                               .memory = (size_t)SESSION_MB * 1000000};
    struct session *s;
    err_t e = session_open(&c, &s);
    if (e == ERR_NOMEM)
        return e;
    if (e) {
        set_finding(r->t, SELFTEST_BRACKET3, SELFTEST_FAIL, "%.190s", err_text());
        return OK;
    }
    e = shoot_bracket(r, s, SELFTEST_BRACKET3, 3);
    if (!e)
        e = shoot_bracket(r, s, SELFTEST_BRACKET5, 5);
    session_close(s);
    return e;
}

static err_t check_brackets(struct stand *r)
{
    char folder[FILE_PATH_CAP];
    if (r->t->calibrated)
        return brackets_with(r, r->o->calibration);
    if (!r->t->info.unit[0])
        return brackets_with(r, NULL);
    err_t e = tempdir_make("hdrig-selftest", folder); // for the calibration of this run
    if (e)
        return e;
    if (calib_save(folder, &r->t->info, &r->t->measured.calib) != OK)
        set_finding(r->t, SELFTEST_BRACKET3, SELFTEST_SKIPPED, "%.190s", err_text());
    else
        e = brackets_with(r, folder);
    tempdir_remove(folder);
    return e;
}

/* ---- all of it ---- */

static void begin_checks(struct stand *r)
{
    struct selftest *t = r->t;
    for (int i = 0; i < SELFTEST_CHECKS; i++)
        set_finding(t, (enum selftest_check)i, SELFTEST_SKIPPED, "not reached: see above");
    t->info = r->w->info;
    r->w->progress = r->o->progress;
    if (calib_load(r->o->calibration, &t->info, &t->measured.calib, &t->calibrated) != OK)
        t->calibrated = false;
    t->measured.longest_s = r->o->longest_s;
    r->known = t->measured.calib;
    r->w->has_crf = t->measured.calib.has_crf;
    r->w->crf = t->measured.calib.crf;
    t->measured.calib.tolerance = r->w->linear || r->w->has_crf ? 0.1 : 0.3;
}

/* Errors of the device become findings. */
static err_t judge_stream(struct stand *r, err_t e)
{
    bool request =
        r->w->count.refused > 0 && (e == ERR_UNSUPPORTED || e == ERR_ARG || e == ERR_BUSY);
    if (e == ERR_CANCELLED || e == ERR_NOMEM)
        return e;
    if (e)
        set_finding(r->t, request ? SELFTEST_REQUESTS : SELFTEST_STREAM, SELFTEST_FAIL, "%.190s",
                    err_text());
    if (!e || request)
        set_finding(r->t, SELFTEST_STREAM, SELFTEST_PASS, "%d frames", r->w->count.frames);
    add_figure(r->t, SELFTEST_STREAM, "frames", r->w->count.frames);
    return OK;
}

err_t selftest_run(const struct selftest_order *o, struct selftest *out)
{
    struct stand r = {.t = out, .o = o};
    memset(out, 0, sizeof *out);
    err_t e = device_probe_open(&o->camera, &r.w);
    if (e)
        return e;
    begin_checks(&r);
    e = judge_stream(&r, measure_camera(&r));
    if (!e)
        judge_counts(&r);
    device_probe_close(r.w);
    bool obeys = out->check[SELFTEST_STREAM].result == SELFTEST_PASS &&
                 out->check[SELFTEST_EFFECT].result == SELFTEST_PASS && r.middle_s > 0.0;
    return !e && obeys ? check_brackets(&r) : e;
}

bool selftest_passed(const struct selftest *t)
{
    bool any = false;
    for (int i = 0; i < SELFTEST_CHECKS; i++) {
        if (t->check[i].result == SELFTEST_FAIL)
            return false;
        any = any || t->check[i].result == SELFTEST_PASS;
    }
    return any;
}
