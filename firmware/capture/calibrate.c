/* Base. From 10 ms in steps of two stops towards the light or the dark, the exposure at which most
 * patches of the probe are good.
 * Delay (Android's test of latching is the model). From rest, steps of two stops up and down at
 * phases spread by the golden ratio. A frame shows the step if its ratio to the frame before the
 * request is nearer to the final ratio than to 0, so no response curve is needed. Steps
 * around whose first frame one was lost do not count, unless all are so.
 * Curve. Five pictures at rest, 0, 1.4, 3.2, 5.4 and 8 stops below the longest: ratios that differ
 * hold a curve better than equal ones (core/photo/crf.h). If no curve explains them, exposure may
 * not obey in all of that: five more above the base, then below.
 * Range. Each exposure of the sweep against the one before, by the median ratio of common patches,
 * else by the bounds of dark and clipped ones. A wrong pair is measured twice more: flicker and
 * movement in the scene do not make it wrong each time. The range reaches from the base to the
 * first wrong pair; its upper end is then narrowed by halving. Where pixels show nothing, the range
 * that the device reports is used. */
#include "firmware/capture/calibrate.h"

#include "drivers/device/clocks.h"

#include "core/base/num.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum {
    UNKNOWN = 8, // frames, delay of devices that report none
    IDLE_MAX = 3,
    SETTLE = 2, // frames beyond the delay
    GOOD_PATCHES = EXPOSURE_PROBE_PATCHES * 2 / 5,
    FEW_PATCHES = EXPOSURE_PROBE_PATCHES / 20,
    LEAST_PATCHES = EXPOSURE_PROBE_PATCHES / 200 + 1, // as firmware/capture/label.c
    TRIALS = 14,                                      // steps of the delay
    ATTEMPTS = 3 * TRIALS,
    DELAY_MAX = 32, // frames
    TRACK = DELAY_MAX + 16,
    AFTER = 6, // frames watched after a change
    PICTURES = 5,
    AGAIN = 3, // times that a pair must be wrong
    HALVINGS = 4
};
#define START_S 0.01
#define CHANGE 0.4       // stops, of two that are asked for
#define STEP 0.9         // stops of the sweep
#define CURVE_ERROR 0.12 // stops rms: a curve that is worse does not count
#define CURVE_STOPS 2.0  // least range of pictures
#define STILL 0.15       // stops that the same exposure may differ by

static const double picture_stops[PICTURES] = {0.0, 1.4, 3.2, 5.4, 8.0};

double calibrate_slack(const struct device_probe *w)
{
    return w->linear ? BRACKET_TOLERANCE_LINEAR : 2.0 * BRACKET_TOLERANCE_LINEAR;
}

static double limit_exposure(const struct device_probe *w, double t, double longest_s)
{
    return fmax(fmin(t, fmin(w->info.time_max_s, longest_s)), w->info.time_min_s);
}

/* Frames until a request has settled, while the delay is not measured. */
static int settle_frames(const struct calibrate *c)
{
    return (c->calib.delay_hi > UNKNOWN ? c->calib.delay_hi : UNKNOWN) + SETTLE;
}

static err_t ask_and_rest(struct device_probe *w, double time_s, int frames,
                          struct device_probe_frame *out)
{
    err_t e = device_probe_ask(w, time_s, 0);
    return e ? e : device_probe_rest(w, frames, out);
}

/* ---- base ---- */

static err_t check_base(const struct exposure_probe *best, double t)
{
    if (best->good >= FEW_PATCHES)
        return OK;
    return err_fail(
        ERR_LIMIT,
        "the scene is too %s: at %.3g s %d %% of the picture can be measured, %d %% are needed",
        best->dark > best->clipped ? "dark" : "bright", t,
        100 * best->good / EXPOSURE_PROBE_PATCHES, 100 * FEW_PATCHES / EXPOSURE_PROBE_PATCHES);
}

err_t calibrate_base(struct device_probe *w, struct calibrate *c)
{
    double t = limit_exposure(w, fmin(START_S, 0.5 * w->info.period_s), c->longest_s);
    struct exposure_probe best = {.good = -1};
    int way = 0;
    for (int i = 0; i < 16; i++) {
        struct device_probe_frame s;
        device_probe_tell(w, "exposure", i, 16);
        err_t e = ask_and_rest(w, t, settle_frames(c), &s);
        if (e)
            return e;
        if (s.seen.good > best.good) {
            best = s.seen;
            c->base_s = t;
        }
        int to = s.seen.dark > s.seen.clipped ? 1 : -1;
        double next = limit_exposure(w, to > 0 ? 4.0 * t : 0.25 * t, c->longest_s);
        if (best.good >= GOOD_PATCHES || to == -way || next == t)
            break;
        way = to;
        t = next;
    }
    device_probe_tell(w, "exposure", 16, 16);
    return check_base(&best, c->base_s);
}

/* ---- delay ---- */

struct trial {
    int n;
    float stops[TRACK];       // to the frame before the request
    int lo[TRACK], hi[TRACK]; // frames since
};

static void wait_for_phase(const struct device_probe *w, int i)
{
    double s = fmod(0.618034 * i, 1.0) * w->info.period_s;
    struct timespec t = {.tv_sec = (time_t)s, .tv_nsec = (long)((s - floor(s)) * 1e9)};
    nanosleep(&t, NULL);
}

/* Requests an exposure and records frames until a few after the change. */
static err_t step_to(struct device_probe *w, double time_s, const struct exposure_probe *from,
                     struct trial *t, struct device_probe_frame *last)
{
    int left = TRACK;
    t->n = 0;
    err_t e = device_probe_ask(w, time_s, 0);
    for (int age = 0; !e && left > 0 && t->n < TRACK && age <= DELAY_MAX + AFTER;) {
        struct device_probe_frame s;
        struct exposure_probe_ratio r;
        e = device_probe_next(w, true, &s);
        age = s.age_lo;
        if (e || !s.usable)
            continue;
        *last = s;
        exposure_probe_compare(from, &s.seen, 0, &r);
        t->stops[t->n] = r.log2;
        t->lo[t->n] = s.age_lo;
        t->hi[t->n++] = s.age_hi;
        left = left > AFTER && fabsf(r.log2) > CHANGE ? AFTER : left - 1;
    }
    return e;
}

/* The first frame that shows the step; -1: none. */
static int first_changed(const struct trial *t)
{
    if (t->n < 3)
        return -1;
    float end[3] = {t->stops[t->n - 1], t->stops[t->n - 2], t->stops[t->n - 3]};
    float final = num_median(end, 3);
    if (fabsf(final) < CHANGE)
        return -1;
    int i = 0;
    while (fabsf(t->stops[i] - final) >= fabsf(t->stops[i]))
        i++;
    return i;
}

struct delays {
    int n, lo, hi;
};

static void add_delay(struct delays *d, int lo, int hi)
{
    d->lo = d->n == 0 || lo < d->lo ? lo : d->lo;
    d->hi = d->n == 0 || hi > d->hi ? hi : d->hi;
    d->n++;
}

/* Adds the delay that a step shows; false: nothing changed. */
static bool add_trial(const struct trial *t, struct delays *exact, struct delays *wide)
{
    int i = first_changed(t);
    if (i < 0)
        return false;
    int before = i > 0 ? t->lo[i - 1] : -1;
    bool sure =
        t->lo[i] == t->hi[i] && t->lo[i] == before + 1 && (i == 0 || before == t->hi[i - 1]);
    add_delay(sure ? exact : wide, before + 1, t->hi[i]);
    return true;
}

static err_t fail_no_effect(const struct device_probe *w, const struct trial *t, double from,
                            double to)
{
    if (t->n == 0)
        return device_probe_unusable(w, TRACK);
    return err_fail(ERR_UNSUPPORTED,
                    "exposure has no effect: from %.3g s to %.3g s, %d frames later the picture is "
                    "%.2f times as bright; an automatic mode may be on",
                    from, to, t->hi[t->n - 1], (double)exp2f(t->stops[t->n - 1]));
}

static err_t choose_ends(const struct device_probe *w, double base_s, double end[2])
{
    end[0] = limit_exposure(w, 0.5 * base_s, INFINITY);
    end[1] = limit_exposure(w, 4.0 * end[0], INFINITY);
    end[0] = limit_exposure(w, 0.25 * end[1], INFINITY);
    if (end[1] < 2.0 * end[0])
        return err_fail(
            ERR_UNSUPPORTED,
            "exposure can only be varied from %g s to %g s, at least a factor of 2 is needed",
            end[0], end[1]);
    return OK;
}

err_t calibrate_delay(struct device_probe *w, struct calibrate *c)
{
    struct delays exact = {0}, wide = {0};
    struct trial t;
    struct device_probe_frame at;
    double end[2];
    int idle = 0; // steps in a row without a change
    err_t e = choose_ends(w, c->base_s, end);
    if (!e)
        e = ask_and_rest(w, end[0], DELAY_MAX + SETTLE, &at);
    for (int i = 0; !e && i < ATTEMPTS && exact.n < TRIALS; i++) {
        device_probe_tell(w, "latency", exact.n, TRIALS);
        wait_for_phase(w, i);
        e = device_probe_drain(w);
        struct exposure_probe from = at.seen;
        if (!e)
            e = step_to(w, end[(i + 1) % 2], &from, &t, &at);
        bool learnt = !e && add_trial(&t, &exact, &wide);
        idle = learnt ? 0 : idle + 1;
        if (!e && (idle == IDLE_MAX || (idle > 0 && (t.n == 0 || exact.n + wide.n == 0))))
            e = fail_no_effect(w, &t, end[i % 2], end[(i + 1) % 2]);
    }
    if (e)
        return e;
    device_probe_tell(w, "latency", TRIALS, TRIALS);
    const struct delays *d = exact.n >= TRIALS / 3 ? &exact : &wide;
    if (d->hi - d->lo > UNKNOWN)
        return err_fail(
            ERR_LIMIT,
            "the delay cannot be measured, it is in %d..%d frames: %d of %d frames were lost, "
            "perhaps because this machine is too slow",
            d->lo, d->hi, w->count.lost + w->count.hidden, w->count.frames);
    int waited = settle_frames(c);
    c->calib.delay_lo = num_min(d->lo, DELAY_MAX);
    c->calib.delay_hi = num_min(d->hi, DELAY_MAX);
    c->trials = d->n;
    c->unsure = wide.n;
    c->parts |= CALIBRATE_LATENCY;
    return c->calib.delay_hi > waited ? calibrate_base(w, c) : OK;
}

/* ---- response ---- */

struct pictures {
    uint8_t *px[PICTURES];
    double exposure[PICTURES];
};

/* Exposures over a window of stops around the base. */
static err_t take_pictures(struct device_probe *w, const double shortest_longest[2],
                           const struct calibrate *c, struct pictures *p)
{
    double range = log2(shortest_longest[1] / shortest_longest[0]);
    size_t n = (size_t)w->info.w * (size_t)w->info.h * 3;
    err_t e = OK;
    for (int i = 0; !e && i < PICTURES; i++) {
        double stops = picture_stops[i] * range / picture_stops[PICTURES - 1];
        device_probe_tell(w, "response", i, PICTURES);
        p->px[i] = p->px[i] ? p->px[i] : malloc(n);
        if (!p->px[i])
            return err_fail(ERR_NOMEM, "%s: no memory for %d pictures", w->uri, PICTURES);
        e = device_probe_ask(w, shortest_longest[1] * exp2(-stops), 0);
        if (!e)
            e = device_probe_picture(w, c->calib.delay_hi + 1, p->px[i]);
        p->exposure[i] = device_probe_expected(w);
    }
    device_probe_tell(w, "response", PICTURES, PICTURES);
    return e;
}

/* The better of two methods; an error only for lack of memory. */
static err_t recover_curve(const struct device_probe *w, const struct pictures *p,
                           struct calibrate *c)
{
    struct crf_stack s = {PICTURES, w->info.w, w->info.h, (const uint8_t *const *)p->px,
                          p->exposure};
    struct crf curve;
    size_t bytes = (crf_plan(&s) + 63) / 64 * 64;
    void *tmp = aligned_alloc(64, bytes);
    if (!tmp)
        return err_fail(ERR_NOMEM, "%s: no memory for the response curve", w->uri);
    err_t e = crf_recover(CRF_FAMILY, &s, tmp, &c->calib.crf);
    if (e)
        snprintf(c->curve_why, sizeof c->curve_why, "%s", err_text());
    else if (crf_recover(CRF_DEBEVEC, &s, tmp, &curve) == OK && curve.error < c->calib.crf.error)
        c->calib.crf = curve;
    free(tmp);
    c->curve_why[0] = e ? c->curve_why[0] : 0;
    c->calib.has_crf = !e && c->calib.crf.error <= (float)CURVE_ERROR;
    if (!e && !c->calib.has_crf)
        snprintf(c->curve_why, sizeof c->curve_why,
                 "no curve explains the pictures: %.2f stops off, at most %.2f are allowed",
                 (double)c->calib.crf.error, CURVE_ERROR);
    return OK;
}

static void use_curve(struct device_probe *w, struct calibrate *c)
{
    w->has_crf = c->calib.has_crf;
    w->crf = c->calib.crf;
    c->calib.tolerance =
        w->linear || w->has_crf ? BRACKET_TOLERANCE_LINEAR : BRACKET_TOLERANCE_DISPLAY;
}

/* Pictures and curve of one window; *c tells whether there is one. */
static err_t try_window(struct device_probe *w, const double stops[2], struct calibrate *c,
                        struct pictures *p)
{
    double ends[2];
    for (int i = 0; i < 2; i++)
        ends[i] = limit_exposure(w, c->base_s * exp2(stops[i]), c->longest_s);
    if (log2(ends[1] / ends[0]) < CURVE_STOPS) {
        snprintf(c->curve_why, sizeof c->curve_why,
                 "exposures of %.3g..%.3g s span less than %g stops", ends[0], ends[1],
                 CURVE_STOPS);
        return OK;
    }
    err_t e = take_pictures(w, ends, c, p);
    if (!e)
        e = recover_curve(w, p, c);
    return e ? e : device_probe_resume(w);
}

err_t calibrate_curve(struct device_probe *w, struct calibrate *c)
{
    static const double windows[][2] = {{-4.0, 4.0}, {0.0, 5.0}, {-6.0, 1.0}};
    enum { WINDOWS = sizeof windows / sizeof windows[0] };
    struct pictures p = {0};
    err_t e = OK;
    c->calib.has_crf = false;
    c->curve_why[0] = 0;
    for (int i = 0; !e && i < WINDOWS && !w->linear && !c->calib.has_crf; i++)
        e = try_window(w, windows[i], c, &p);
    for (int i = 0; i < PICTURES; i++)
        free(p.px[i]);
    use_curve(w, c);
    if (!e)
        c->parts |= CALIBRATE_RESPONSE;
    return e;
}

/* ---- range ---- */

/* Compares b with a, which was `asked` stops shorter. */
static void judge_step(const struct device_probe *w, const struct exposure_probe *a,
                       const struct exposure_probe *b, struct calibrate_step *s)
{
    struct exposure_probe_ratio r;
    exposure_probe_compare(a, b, 0, &r);
    double slack = calibrate_slack(w) * (r.patches < FEW_PATCHES ? 2.0 : 1.0);
    bool loose = !w->linear && !w->has_crf; // only what no curve could do is wrong
    double least = loose ? 0.25 * s->requested : s->requested - slack;
    double most = loose ? 2.5 * s->requested : s->requested + slack;
    double error = r.error;
    bool seen = r.patches >= LEAST_PATCHES && 4.0 * error <= slack;
    double lo = seen ? r.log2 : r.lo, hi = seen ? r.log2 : r.hi;
    s->measured = seen ? r.log2 : NAN;
    s->rises = lo > 0.0 || !seen;
    s->verdict = lo > most || hi < least ? CALIBRATE_WRONG
                 : seen                  ? CALIBRATE_OBEYS
                                         : CALIBRATE_UNSEEN;
}

struct sweep {
    struct device_probe *w;
    struct calibrate *c;
    struct exposure_probe last;
    double last_s; // as asked
};

/* Measures the pair of last_s and time_s, again while it is wrong. */
static err_t measure_step(struct sweep *k, double time_s, struct calibrate_step *out)
{
    struct device_probe_frame s;
    int frames = k->c->calib.delay_hi + 1;
    for (int i = 0; i < AGAIN; i++) {
        err_t e = i > 0 ? ask_and_rest(k->w, k->last_s, frames, &s) : OK;
        if (!e && i > 0)
            k->last = s.seen;
        if (!e)
            e = ask_and_rest(k->w, time_s, frames, &s);
        if (e)
            return e;
        judge_step(k->w, &k->last, &s.seen, out);
        if (out->verdict != CALIBRATE_WRONG)
            break;
    }
    k->last = s.seen;
    k->last_s = time_s;
    return OK;
}

static err_t sweep_range(struct device_probe *w, struct calibrate *c)
{
    struct sweep k = {.w = w, .c = c, .last_s = w->info.time_min_s};
    struct device_probe_frame s;
    double longest = limit_exposure(w, INFINITY, c->longest_s), from = w->info.time_min_s;
    int most = num_min((int)ceil(log2(longest / from) / STEP), CALIBRATE_STEPS_MAX - 1);
    err_t e = ask_and_rest(w, from, c->calib.delay_hi + 1, &s);
    k.last = s.seen;
    c->step[0] =
        (struct calibrate_step){.time_s = device_probe_expected(w), .measured = NAN, .rises = true};
    c->n = 1;
    for (int i = 1; !e && i <= most; i++) {
        double t = fmin(from * exp2(STEP * i), longest);
        struct exposure requested = {t, 1.0}, x = label_rounded(&w->label, &requested);
        struct calibrate_step *to = &c->step[c->n];
        device_probe_tell(w, "range", i, most);
        *to = (struct calibrate_step){.time_s = x.time_s};
        to->requested = log2(x.time_s / c->step[c->n - 1].time_s);
        if (!(to->requested > 0.5 * STEP) && i < most)
            continue; // rounded to the same, or nearly
        e = measure_step(&k, t, to);
        c->n++;
    }
    return e;
}

/* The longest exposure that obeys, between one that does and one that does not. */
static err_t narrow_range(struct device_probe *w, struct calibrate *c, double good_s,
                          double wrong_s, double *out)
{
    for (int i = 0; i < HALVINGS; i++) {
        struct sweep k = {.w = w, .c = c, .last_s = good_s};
        struct device_probe_frame s;
        struct calibrate_step to = {.time_s = sqrt(good_s * wrong_s)};
        err_t e = ask_and_rest(w, good_s, c->calib.delay_hi + 1, &s);
        double from = device_probe_expected(w);
        k.last = s.seen;
        struct exposure requested = {to.time_s, 1.0}, x = label_rounded(&w->label, &requested);
        to.requested = log2(x.time_s / from);
        if (!e && to.requested <= c->calib.tolerance)
            break;
        if (!e)
            e = measure_step(&k, to.time_s, &to);
        if (e)
            return e;
        good_s = to.verdict == CALIBRATE_WRONG ? good_s : x.time_s;
        wrong_s = to.verdict == CALIBRATE_WRONG ? x.time_s : wrong_s;
    }
    *out = good_s;
    return OK;
}

/* A curve that does not fit neighbouring steps is too inexact for the tight tolerance. */
static void check_curve(struct device_probe *w, struct calibrate *c, int lo, int hi)
{
    for (int i = lo + 1; i <= hi && !w->linear; i++)
        if (c->step[i].verdict == CALIBRATE_OBEYS &&
            fabs(c->step[i].measured - c->step[i].requested) > BRACKET_TOLERANCE_LINEAR)
            c->calib.tolerance = BRACKET_TOLERANCE_DISPLAY;
}

/* The range around the base, to the first wrong pair either way. */
static err_t find_range(struct device_probe *w, struct calibrate *c)
{
    int at = 0, lo, hi;
    while (at + 1 < c->n && c->step[at].time_s < c->base_s * 0.99)
        at++;
    for (lo = at; lo > 0 && c->step[lo].verdict != CALIBRATE_WRONG;)
        lo--;
    for (hi = at; hi + 1 < c->n && c->step[hi + 1].verdict != CALIBRATE_WRONG;)
        hi++;
    check_curve(w, c, lo, hi);
    c->calib.time_min_s = lo > 0 ? c->step[lo].time_s : w->info.time_min_s;
    c->calib.time_max_s = w->info.time_max_s;
    c->seen_min_s = c->seen_max_s = c->step[at].time_s;
    for (int i = lo + 1; i <= hi; i++)
        if (c->step[i].verdict == CALIBRATE_OBEYS) {
            c->seen_min_s = fmin(c->seen_min_s, c->step[i - 1].time_s);
            c->seen_max_s = fmax(c->seen_max_s, c->step[i].time_s);
        }
    if (hi + 1 == c->n)
        return OK;
    err_t e = narrow_range(w, c, c->step[hi].time_s, c->step[hi + 1].time_s, &c->calib.time_max_s);
    c->seen_max_s = fmin(fmax(c->seen_max_s, c->calib.time_max_s), c->calib.time_max_s);
    return e;
}

err_t calibrate_range(struct device_probe *w, struct calibrate *c)
{
    struct device_probe_frame before, after;
    struct exposure_probe_ratio r;
    int frames = c->calib.delay_hi + 1;
    err_t e = ask_and_rest(w, c->base_s, frames, &before);
    if (!e)
        e = sweep_range(w, c);
    if (!e)
        e = ask_and_rest(w, c->base_s, frames, &after);
    if (e)
        return e;
    exposure_probe_compare(&before.seen, &after.seen, 0, &r);
    c->drift = r.log2;
    if (fabs(c->drift) > STILL || r.patches < LEAST_PATCHES)
        return err_fail(ERR_LIMIT,
                        "the light or the scene changed: the same exposure differs by %.2f "
                        "stops",
                        c->drift);
    e = find_range(w, c);
    if (!e)
        c->parts |= CALIBRATE_RANGE;
    return e;
}

/* ---- all of it ---- */

err_t calibrate_run(struct device_probe *w, unsigned parts, double longest_s,
                    const struct calib *known, struct calibrate *c)
{
    memset(c, 0, sizeof *c);
    c->longest_s = longest_s;
    c->calib = *known;
    use_curve(w, c);
    if (w->info.chooses) // its exposures are known, and steps between them have no effect
        parts = CALIBRATE_RESPONSE;
    if ((parts & CALIBRATE_RANGE) && !c->calib.has_crf)
        parts |= CALIBRATE_RESPONSE;
    err_t e = calibrate_base(w, c);
    if (!e && (parts & CALIBRATE_LATENCY))
        e = calibrate_delay(w, c);
    if (!e && (parts & CALIBRATE_RESPONSE))
        e = calibrate_curve(w, c);
    if (!e && (parts & CALIBRATE_RANGE))
        e = calibrate_range(w, c);
    c->calib.when_s = clocks_at(clocks_now()).realtime_ns / 1000000000;
    return e;
}
