/* Three kinds of evidence give the exposure of a frame (firmware/capture/README.md 2).
 *
 * Requests. Each has an age, an interval in frames: with every frame it grows by the gap of
 * sequence numbers if time stamps agree, else by all gaps that one of them allows. Its lower end
 * does not grow with frames whose stamps are older than the request. Entry i of the log may be in
 * force if it is `lo` frames old and entry i + 1 is not yet `hi` frames old (strict); `doubt`
 * bounds how wrong the promised delay may be (wide).
 * Pixels. The exposure is that of an anchor times the median ratio at the same patches. Anchors
 * chain outward from the reference; errors add up. An uncalibrated response stretches all ratios;
 * a kept frame then counts with its recorded exposure instead of the measured one.
 * Label. Exactly one strict candidate must be within the tolerance of the measured exposure. */
#include "firmware/capture/label.h"

#include <math.h>
#include <string.h>

enum {
    PATCHES_MANY = EXPOSURE_PROBE_PATCHES / 8, // enough: no other anchor is compared
    DOUBT = 8,                                 // frames, for devices with an unknown delay
    REST = 2,                                  // frames beyond doubt
    UNSURE = 2,                                // a wider range of delays is a guess, not jitter
    GAP_MAX = 64,                              // frames lost at once; larger gaps are errors
    AGE_MAX = 1 << 20
};
#define REPORT 0.005 // W1: 0.5 %
#define STILL 0.02f  // share of the picture that may move in a still scene: noise
#define CALM 0.9f    // share of a movement that is expected of the next frame
#define LATE_S 1.0   // stamps older than this and two frames come from another clock

double label_stops(const struct exposure *e)
{
    return log2(e->time_s * e->gain);
}

bool label_same(double a, double b)
{
    return fabs(a - b) <= EXPOSURE_ANCHOR_SAME;
}

static double seconds_between(int64_t from, int64_t to)
{
    return ((double)to - (double)from) * 1e-9;
}

/* ---- requests ---- */

err_t label_check(int i, const struct bracket_camera *c)
{
    bool times = c->time_min_s > 0.0 && c->time_max_s >= c->time_min_s && c->time_max_s < 1e6;
    if (!times || !(c->time_step_s >= 0.0 && c->time_step_s <= c->time_max_s))
        return err_fail(
            ERR_ARG, "camera %d: exposure times %g to %g s in steps of %g s are not a valid range",
            i, c->time_min_s, c->time_max_s, c->time_step_s);
    if (!(c->period_s > 0.0 && c->period_s < 1e6))
        return err_fail(ERR_ARG,
                        "camera %d: a frame takes %g s, it must be more than 0 and less than 1e6",
                        i, c->period_s);
    if (c->delay_lo < 0 || c->delay_hi < c->delay_lo || c->delay_hi > 32)
        return err_fail(ERR_ARG, "camera %d: the delay is %d to %d frames, allowed are 0 to 32", i,
                        c->delay_lo, c->delay_hi);
    if (!(c->tolerance >= 0.01 && c->tolerance <= 1.0))
        return err_fail(ERR_ARG, "camera %d: the tolerance is %g stops, allowed are 0.01 to 1", i,
                        c->tolerance);
    return OK;
}

void label_init(struct label *l, const struct bracket_camera *cfg)
{
    memset(l, 0, sizeof *l);
    l->cfg = *cfg;
    label_trust(l);
    l->doubt = cfg->delay_hi + REST > DOUBT ? cfg->delay_hi + REST : DOUBT;
}

void label_restart(struct label *l, const struct exposure *base, int64_t now_ns)
{
    l->n = 0;
    l->seen = false;
    if (!base)
        return;
    struct label_request r = {.index = LABEL_BASE, .requested = *base, .set = *base};
    r.asked_ns = r.answered_ns = now_ns;
    label_asked(l, &r);
}

struct exposure label_rounded(const struct label *l, const struct exposure *e)
{
    double step = l->cfg.time_step_s;
    struct exposure x = *e;
    if (step > 0.0)
        x.time_s = fmax(floor(x.time_s / step * (1.0 + 1e-9)), 1.0) * step;
    return x;
}

/* Some devices read back the former setting, or the request without rounding. */
static struct exposure expected_exposure(const struct label *l, const struct label_request *r)
{
    if (l->cfg.chooses)
        return r->set;
    double off = fabs(label_stops(&r->set) - label_stops(&r->requested));
    bool near = off <= 0.5 || fabs(r->set.time_s - r->requested.time_s) <= l->cfg.time_step_s;
    bool former = !(fabs(label_stops(&r->set) - r->from) >= off); // or the former is unknown
    return label_rounded(l, near && !former ? &r->set : &r->requested);
}

void label_asked(struct label *l, const struct label_request *r)
{
    if (l->n == LABEL_LOG) {
        memmove(l->log, l->log + 1, (LABEL_LOG - 1) * sizeof l->log[0]);
        l->n--;
    }
    struct label_request *e = &l->log[l->n];
    *e = *r;
    e->from = l->n > 0 ? l->log[l->n - 1].stops : NAN;
    e->expect = expected_exposure(l, e);
    e->stops = label_stops(&e->expect);
    e->age_lo = e->age_hi = -1; // the frame being exposed comes next
    l->n++;
}

const struct label_request *label_newest(const struct label *l)
{
    return l->n > 0 ? &l->log[l->n - 1] : NULL;
}

static bool in_force(const struct label *l, int i, int lo, int hi)
{
    bool begun = i == 0 || l->log[i].age_hi >= lo;
    return begun && (i + 1 == l->n || l->log[i + 1].age_lo < hi);
}

bool label_alone(const struct label *l)
{
    return l->n > 0 && l->log[l->n - 1].age_lo >= l->hi;
}

bool label_passed(const struct label *l, int entry)
{
    return entry + 1 < l->n && l->log[entry + 1].age_lo >= l->hi;
}

bool label_rested(const struct label *l)
{
    const struct label_request *r = label_newest(l);
    if (!r || r->age_lo < l->doubt + REST)
        return false;
    // frames that waited in a queue were exposed before the request
    return seconds_between(r->asked_ns, l->shown_ns) >= 0.9 * (l->doubt + 1) * l->cfg.period_s;
}

double label_longest_s(const struct label *l)
{
    double longest = l->cfg.period_s;
    for (int i = 0; i < l->n; i++)
        longest = fmax(longest, fmax(l->log[i].requested.time_s, l->log[i].expect.time_s));
    return longest;
}

bool label_duplicate(const struct label *l, const struct frame *f)
{
    return l->seen && f->timestamp_ns != 0 && f->timestamp_ns == l->stamp_ns &&
           f->sequence == l->sequence;
}

/* Frames since the one before, at least and at most. */
static void gap_of(const struct label *l, const struct frame *f, int *lo, int *hi)
{
    double longest = label_longest_s(l), dt = seconds_between(l->stamp_ns, f->timestamp_ns);
    double slack = l->cfg.stamp == CAMERA_STAMP_END ? longest : 0.0;
    uint32_t gap = f->sequence - l->sequence;
    bool counted = gap >= 1 && gap <= GAP_MAX;
    bool timed = f->timestamp_ns > 0 && l->stamp_ns > 0 && dt > 0.0 && dt < GAP_MAX * longest;
    *lo = 1;
    *hi = 2; // the frame itself, and perhaps one that was lost
    if (timed) {
        *lo = (int)fmin(fmax(floor((dt - slack) / longest + 0.5), 1.0), GAP_MAX);
        *hi = (int)fmin(fmax(floor((dt + slack) / l->cfg.period_s + 0.5), *lo), GAP_MAX);
    }
    if (!counted)
        return;
    bool agree = !timed || ((int)gap >= *lo && (int)gap <= *hi);
    *lo = agree || (int)gap < *lo ? (int)gap : *lo;
    *hi = agree || (int)gap > *hi ? (int)gap : *hi;
}

/* W3: the largest age of a request that the stamp allows. A frame that began or ended before the
 * request has waited since; no more frames than there are buffers can wait. */
static int largest_age(const struct label *l, const struct label_request *r, const struct frame *f)
{
    double before = l->sane ? seconds_between(f->timestamp_ns, r->asked_ns) : -1.0;
    int age = before < 0.0 ? AGE_MAX : before < l->cfg.period_s ? 0 : -1;
    return age > r->age_hi - CAMERA_BUFFERS_MAX ? age : r->age_hi - CAMERA_BUFFERS_MAX;
}

int label_advance(struct label *l, const struct frame *f, int64_t now_ns)
{
    int lo = 1, hi = 1;
    if (l->seen)
        gap_of(l, f, &lo, &hi);
    double age = seconds_between(f->timestamp_ns, now_ns);
    l->sane = f->timestamp_ns > 0 && age >= -1e-3 && age <= LATE_S + 2.0 * label_longest_s(l);
    l->shown_ns = l->sane ? f->timestamp_ns : now_ns;
    l->seen = true;
    l->sequence = f->sequence;
    l->stamp_ns = f->timestamp_ns;
    for (int i = 0; i < l->n; i++) {
        struct label_request *r = &l->log[i];
        r->age_hi = r->age_hi + hi < AGE_MAX ? r->age_hi + hi : AGE_MAX;
        r->age_lo = r->age_lo + lo < AGE_MAX ? r->age_lo + lo : AGE_MAX;
        int most = largest_age(l, r, f);
        r->age_lo = most < r->age_lo ? most : r->age_lo;
    }
    int gone = 0; // more than the doubt: a long frame may still run if frames were lost
    while (gone + 1 < l->n && l->log[gone + 1].age_lo >= 2 * l->doubt)
        gone++;
    l->n -= gone;
    memmove(l->log, l->log + gone, (size_t)l->n * sizeof l->log[0]);
    return lo;
}

void label_doubt(struct label *l)
{
    l->lo = 0;
    l->hi = l->doubt;
    l->guess = true;
}

bool label_unsteady(const struct label *l)
{
    return l->hi > l->lo && !l->guess && !l->cfg.reports;
}

void label_narrow(struct label *l, const struct label_look *k)
{
    const struct label_request *e = &l->log[k->entry];
    if (!l->guess || e->index == LABEL_BASE)
        return;
    int lo = k->entry + 1 < l->n ? e[1].age_lo + 1 : 0, hi = e->age_hi;
    l->lo = lo > l->lo ? lo : l->lo;
    l->hi = hi < l->hi ? hi : l->hi;
}

/* ---- pixels ---- */

/* The shortest exposure that may be in force, s. */
static double shortest_s(const struct label *l)
{
    double t = INFINITY;
    for (int i = 0; i < l->n; i++)
        if (in_force(l, i, 0, l->doubt))
            t = fmin(t, l->log[i].expect.time_s);
    return t;
}

/* A frame counts with the darkest candidate's slack. */
static struct exposure_anchor_doubt doubt_of(const struct label *l)
{
    return (struct exposure_anchor_doubt){l->cfg.tolerance, flicker_stops(&l->light, shortest_s(l)),
                                          l->moving};
}

static void compare_anchor(const struct label *l, int by, const struct exposure_probe *w,
                           struct label_look *k)
{
    const struct exposure_anchor *a = &l->anchor[by];
    struct exposure_anchor_ratio r;
    const struct exposure_anchor_doubt doubt = doubt_of(l);
    exposure_anchor_compare(a, w, &doubt, &r);
    // what moves may be most of what few patches show
    const bool weak = l->moving > STILL && (r.changed || r.patches < PATCHES_MANY);
    k->lo = fmax(k->lo, r.lo);
    k->hi = fmin(k->hi, r.hi);
    k->changed = k->changed || (r.changed && !weak);
    k->torn = k->torn || (r.torn && !(weak && label_rested(l))); // at rest all rows are alike
    if (!r.accurate || (k->measured && r.error + a->slack >= k->error + k->slack))
        return;
    k->measured = true;
    k->weak = weak;
    k->slack = a->slack;
    k->stops = r.stops;
    k->error = r.error;
    k->by = by;
    k->patches = r.patches;
    k->ratio = r.ratio;
}

double label_distance(const struct label *l, double stops)
{
    double best = INFINITY;
    for (int i = 0; i <= LABEL_REFERENCE; i++)
        if (l->anchor[i].held)
            best = fmin(best, fabs(stops - l->anchor[i].recorded));
    return best;
}

static struct exposure_probe_rows refute_rows(const struct label *l, const struct exposure_probe *w,
                                              double stops, double other)
{
    const struct exposure_anchor_pair pair = {stops, other};
    const struct exposure_anchor_doubt doubt = doubt_of(l);
    struct exposure_probe_rows rows = {0};
    for (int i = 0; i < LABEL_ANCHORS; i++)
        if (l->anchor[i].held)
            exposure_anchor_refute(&l->anchor[i], w, &pair, &doubt, &rows);
    return rows;
}

void label_whole(const struct label *l, const struct exposure_probe *w, struct label_look *k)
{
    double stops = label_stops(&k->exposure);
    k->whole = !k->torn && (k->verdict == LABEL_PROVEN || k->verdict == LABEL_BLIND);
    k->sure = k->whole ? UINT32_MAX : 0;
    for (int i = 0; i < l->n && k->sure; i++) {
        const struct label_request *r = &l->log[i];
        bool begun = i == 0 || r->age_hi > l->lo; // in the frame before
        bool over = i + 1 < l->n && r[1].age_lo > l->hi;
        if (!begun || over || label_same(r->stops, stops))
            continue;
        struct exposure_probe_rows rows = refute_rows(l, w, stops, r->stops);
        k->sure &= rows.refuted;
        k->whole = k->whole && (rows.refuted | rows.alike) == UINT32_MAX;
    }
}

void label_last(struct label *l, const struct exposure_probe *w, struct label_look *k)
{
    label_whole(l, w, k);
    l->anchor[LABEL_LAST].held = false;
    if (k->sure)
        label_hold(l, LABEL_LAST, w, k);
}

static void read_pixels(const struct label *l, const struct exposure_probe *w, struct label_look *k)
{
    const struct exposure_anchor *ref = &l->anchor[LABEL_REFERENCE];
    k->lo = -INFINITY;
    k->hi = INFINITY;
    k->by = -1;
    k->dark = w->dark + (ref->held ? ref->seen.dark : 0);
    k->clipped = w->clipped + (ref->held ? ref->seen.clipped : 0);
    for (int i = LABEL_REFERENCE; i >= 0 && k->patches < PATCHES_MANY; i--)
        if (l->anchor[i].held)
            compare_anchor(l, i, w, k);
}

void label_hold(struct label *l, int index, const struct exposure_probe *w,
                const struct label_look *k)
{
    struct exposure_anchor *a = &l->anchor[index];
    a->recorded = label_stops(&k->exposure);
    a->slack = flicker_stops(&l->light, k->exposure.time_s);
    bool measured = k->measured && l->cfg.tolerance < EXPOSURE_ANCHOR_LOOSE &&
                    k->slack + a->slack <= EXPOSURE_ANCHOR_SAME;
    a->stops = measured ? k->stops : a->recorded;
    a->error = measured ? k->error : 0.0;
    a->proven = k->measured && l->anchor[k->by].proven && k->slack <= l->cfg.tolerance;
    a->seen = *w;
    a->sure = k->sure;
    a->held = true;
}

void label_forget(struct label *l, bool reference)
{
    for (int i = 0; i < LABEL_ANCHORS; i++)
        if (i != LABEL_REFERENCE || reference)
            l->anchor[i].held = false;
}

void label_trust(struct label *l)
{
    l->lo = l->cfg.delay_lo;
    l->hi = l->cfg.delay_hi;
    l->guess = l->hi - l->lo > UNSURE;
}

/* ---- the device ---- */

static bool report_agrees(const struct label *l, const struct exposure *said,
                          const struct exposure *x)
{
    const struct bracket_camera *c = &l->cfg;
    // W1; if the steps are unknown, half of the tolerance of the pixels
    double share = c->time_step_s > 0.0 ? REPORT : exp2(0.5 * c->tolerance) - 1.0;
    double most = fmax(share * x->time_s, 0.5 * c->time_step_s) * (1.0 + 1e-9);
    return fabs(said->time_s - x->time_s) <= most &&
           fabs(log2(said->gain / x->gain)) <= 0.5 * c->tolerance;
}

err_t label_settle(struct label *l, const struct frame *f, const struct exposure_probe *w,
                   bool *same)
{
    struct exposure_anchor *a = &l->anchor[LABEL_REFERENCE];
    const struct exposure *x = &label_newest(l)->expect;
    float moved = 0;
    *same = false;
    if (f->exposure_known && !report_agrees(l, &f->exposure, x)) {
        a->held = false;
        return err_fail(ERR_AGAIN, "a frame at rest reports %g s x %g, but %g s x %g was set",
                        f->exposure.time_s, f->exposure.gain, x->time_s, x->gain);
    }
    const struct exposure_anchor_doubt doubt = {l->cfg.tolerance,
                                                2.0 * flicker_stops(&l->light, x->time_s), 0};
    if (a->held)
        *same = exposure_anchor_alike(a, w, &doubt, &moved);
    l->moving = fmaxf(moved, CALM * l->moving);
    a->recorded = a->stops = label_stops(f->exposure_known ? &f->exposure : x);
    a->error = 0.0;
    a->slack = flicker_stops(&l->light, x->time_s);
    a->held = a->proven = true;
    a->sure = UINT32_MAX; // from rest
    a->seen = *w;
    return OK;
}

/* ---- all together ---- */

struct candidate {
    int entry;
    bool strict, fits, agree;
    double stops;
    double off; // stops from the exposure that the pixels show
    struct exposure exposure;
};

static void weigh_candidate(const struct label *l, int i, const struct frame *f,
                            const struct label_look *k, struct candidate *out)
{
    const struct label_request *r = &l->log[i];
    bool agree = f->exposure_known && report_agrees(l, &f->exposure, &r->expect);
    *out = (struct candidate){.entry = i,
                              .strict = in_force(l, i, l->lo, l->hi),
                              .agree = agree || !f->exposure_known,
                              .exposure = agree ? f->exposure : r->expect};
    double s = out->stops = label_stops(&out->exposure);
    double slack = k->slack + flicker_stops(&l->light, out->exposure.time_s);
    double most = l->cfg.tolerance + slack;
    out->off = fmax(fmax(k->lo - s, s - k->hi), 0.0);
    // what moves in the picture makes bounds wrong, and hardly the median of many
    bool allowed = out->off <= most || (k->measured && k->patches >= PATCHES_MANY);
    if (k->measured) {
        out->off = fabs(s - k->stops);
        most -= EXPOSURE_ANCHOR_DOUBTED * k->error;
    }
    out->fits = !k->changed && !k->torn && allowed && out->off <= most;
}

/* The candidate that fits best, the oldest of equals; NULL: none. */
static const struct candidate *nearest_candidate(const struct candidate *c, int n, bool strict)
{
    const struct candidate *best = NULL;
    for (int i = 0; i < n; i++)
        if (c[i].fits && (c[i].strict || !strict) && (!best || c[i].off < best->off))
            best = &c[i];
    return best;
}

/* Whether another exposure fits, too. */
static bool has_rival(const struct label *l, const struct candidate *c, int n,
                      const struct candidate *best)
{
    for (int i = 0; i < n; i++)
        if (c[i].strict && c[i].fits && fabs(c[i].stops - best->stops) > 0.5 * l->cfg.tolerance)
            return true;
    return false;
}

/* returns: number of candidates, each in force perhaps. */
static int weigh_candidates(const struct label *l, const struct frame *f,
                            const struct label_look *k, struct candidate c[LABEL_LOG])
{
    int n = 0;
    for (int i = 0; i < l->n; i++)
        if (in_force(l, i, 0, l->doubt))
            weigh_candidate(l, i, f, k, &c[n++]);
    return n;
}

void label_look(const struct label *l, const struct frame *f, const struct exposure_probe *w,
                struct label_look *out)
{
    struct candidate c[LABEL_LOG];
    *out = (struct label_look){.verdict = LABEL_CONFLICT, .entry = -1, .sure = UINT32_MAX};
    read_pixels(l, w, out);
    int n = weigh_candidates(l, f, out, c);
    if (out->weak && !nearest_candidate(c, n, true)) {
        out->measured = false;
        n = weigh_candidates(l, f, out, c);
    }
    const struct candidate *best = nearest_candidate(c, n, true);
    const struct candidate *pick = best || !out->measured ? best : nearest_candidate(c, n, false);
    if (!pick)
        return;
    out->entry = pick->entry;
    out->exposure = pick->exposure;
    out->slack += flicker_stops(&l->light, pick->exposure.time_s);
    if (best && has_rival(l, c, n, best))
        out->verdict = LABEL_UNDECIDED;
    else if (!pick->agree)
        out->disagrees = true;
    else if (!best)
        out->verdict = LABEL_SHIFTED;
    else
        out->verdict = out->measured ? LABEL_PROVEN : LABEL_BLIND;
}

static enum bracket_proof proof_of(const struct label *l, const struct label_look *k, bool reported)
{
    if (!k->measured || !l->anchor[k->by].proven)
        return k->dark >= k->clipped ? BRACKET_UNVERIFIED_DARK : BRACKET_UNVERIFIED_BRIGHT;
    if (k->slack > l->cfg.tolerance)
        return BRACKET_UNVERIFIED_FLICKER;
    return reported ? BRACKET_REPORTED : BRACKET_PIXELS;
}

void label_evidence(const struct label *l, const struct frame *f, const struct label_look *k,
                    struct bracket_evidence *out)
{
    const struct label_request *e = &l->log[k->entry];
    *out = (struct bracket_evidence){.exposure = k->exposure,
                                     .set = e->set,
                                     .reported_known = f->exposure_known,
                                     .ratio_known = k->measured,
                                     .ratio = k->ratio,
                                     .patches = k->patches,
                                     .proof = proof_of(l, k, f->exposure_known),
                                     .sequence = f->sequence,
                                     .timestamp_ns = f->timestamp_ns,
                                     .start_ns = f->timestamp_ns,
                                     .request_ns = e->answered_ns,
                                     .frames_since = e->age_lo};
    if (f->exposure_known)
        out->reported = f->exposure;
    if (k->measured)
        out->ratio_asked = (float)(label_stops(&k->exposure) - l->anchor[k->by].recorded);
    if (l->cfg.stamp == CAMERA_STAMP_END)
        out->start_ns -= (int64_t)(k->exposure.time_s * 1e9);
}
