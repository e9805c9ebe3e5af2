/* Each camera has its own phase (bracket.h); the machine ends when all cameras have ended.
 * With every frame the requests grow older (label_advance). Flagged, cut and resized frames are
 * refused, and those whose gains moved; label_look identifies the others. A proven frame is kept if
 * its exposure is missing, even if another was asked for; lost requests are made again. Two
 * conflicts, or three requests in vain, end pipelining. At rest a verdict against the exposure
 * counts when it is repeated; a frame at base then shows whether light or exposure changed.
 * The machine always ends: frames, refusals, restarts and changes of light are counted. */
#include "firmware/capture/bracket.h"

#include "firmware/capture/label.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    CONFLICTS_MAX = 2, // while pipelined
    TRIES_MAX = 3,     // requests for one exposure while pipelined
    JUDGED_MAX = 2,    // frames at rest with the same verdict
    BAD_MAX = 12,      // unusable frames in a row
    TORN_MAX = 3,      // torn frames in a row; beyond them the scene moves
    REFUSALS_MAX = 8,  // requests in a row
    FRAMES_MAX = 20    // per exposure and per frame of possible delay
};
#define GAINS 0.005    // W5: 0.5 %
#define WAITS 3.0      // times the longest frame, before a restart
#define PATIENCE_S 1.0 // added to these
#define RANGE 1e-6     // relative tolerance of exposure times: the plan's maker rounds

enum phase { OVER, WAIT, RUN, CHECK, REST };
enum request_state { MISSING, ASKED, KEPT };

struct camera_state {
    struct label label;
    struct bracket_plan plan;
    struct exposure base;
    double stops[BRACKET_EXPOSURES_MAX], base_stops; // log2 as the device rounds them
    bool armed, restarting, gains_known;
    enum phase phase;
    enum request_state state[BRACKET_EXPOSURES_MAX];
    int tries[BRACKET_EXPOSURES_MAX];
    struct bracket_evidence evidence[BRACKET_EXPOSURES_MAX];
    int64_t begin_ns, alive_ns;
    double slow_s;                     // longest frame before a restart: it may still run
    int since, frames, rejected, lost; // since BEGIN; `since` counts as ages do
    int settled;                       // frames at base that agree: 2 make the reference
    int conflicts, judged, bad, torn;  // in a row, or since the phase began
    int refusals, forgets, restarts;   // in a row; per set
    int target, suspect, keep;         // index, -1: none
    double still;                      // exposure of the last frames, stops; NAN: not known
    int still_since;                   // counts as `since` does
    enum bracket_reason cause;         // why the last frame was refused
    int w, h;                          // as in the reference
    enum camera_format format;
    double red, blue;
    bool forget, relit, restart, request, asking; // actions not fetched yet
    struct label_request next;
};

struct bracket {
    enum bracket_state state;
    enum bracket_reason reason;
    int culprit, n;
    struct camera_state cameras[];
};

err_t bracket_new(const struct bracket_camera *cameras, int n, struct bracket **out)
{
    *out = NULL;
    if (n < 1 || n > BRACKET_CAMERAS_MAX)
        return err_fail(ERR_ARG, "bracket: %d cameras, allowed are 1 to %d", n,
                        BRACKET_CAMERAS_MAX);
    for (int i = 0; i < n; i++) {
        err_t e = label_check(i, &cameras[i]);
        if (e)
            return e;
    }
    struct bracket *b = calloc(1, sizeof *b + (size_t)n * sizeof b->cameras[0]);
    if (!b)
        return err_fail(ERR_NOMEM, "bracket: no memory for %d cameras", n);
    b->n = n;
    for (int i = 0; i < n; i++) {
        label_init(&b->cameras[i].label, &cameras[i]);
        b->cameras[i].keep = -1;
    }
    *out = b;
    return OK;
}

void bracket_free(struct bracket *b)
{
    free(b);
}

/* ---- requests ---- */

static double rounded_stops(const struct camera_state *c, const struct exposure *e)
{
    struct exposure x = label_rounded(&c->label, e);
    return label_stops(&x);
}

static bool is_base(const struct camera_state *c, const struct label_request *r)
{
    return r && (r->index == LABEL_BASE || label_same(r->stops, c->base_stops));
}

static void request_exposure(struct camera_state *c, int index, int64_t now_ns)
{
    if (c->request || c->asking)
        return;
    c->request = true;
    c->next = (struct label_request){.index = index, .asked_ns = now_ns};
    c->next.requested = index == LABEL_BASE ? c->base : c->plan.requested[index];
    if (index == LABEL_BASE)
        return;
    c->state[index] = ASKED;
    c->tries[index]++;
}

static bool has_all_exposures(const struct camera_state *c)
{
    for (int i = 0; i < c->plan.n; i++)
        if (c->state[i] != KEPT)
            return false;
    return true;
}

static double anchor_distance(const struct camera_state *c, int index)
{
    return label_distance(&c->label, c->stops[index]);
}

/* The exposure to ask for next, -1: none. The first of the plan that was not tried; when all were,
 * or at rest, the one nearest to a frame to compare with. */
static int pick_exposure(const struct camera_state *c)
{
    int best = -1;
    for (int i = 0; i < c->plan.n; i++) {
        if (c->state[i] == KEPT || (c->state[i] == ASKED && c->phase == RUN))
            continue;
        if (c->tries[i] == 0 && c->phase == RUN)
            return i;
        if (best < 0 || anchor_distance(c, i) < anchor_distance(c, best))
            best = i;
    }
    return best;
}

static void request_next(struct camera_state *c, int64_t now_ns)
{
    const struct label_request *newest = label_newest(&c->label);
    if (c->phase == OVER || c->restarting)
        return;
    int i = c->phase == RUN ? pick_exposure(c) : -1;
    if (c->phase == REST && (c->target < 0 || c->state[c->target] == KEPT))
        c->target = pick_exposure(c);
    if (c->phase == REST)
        i = c->target;
    if (i >= 0 && (c->phase == RUN || !newest || newest->index != i))
        request_exposure(c, i, now_ns);
    else if (i < 0 && !is_base(c, newest))
        request_exposure(c, LABEL_BASE, now_ns);
}

/* Exposures whose requests were passed over are missing again. */
static void give_up_passed(struct camera_state *c)
{
    bool comes[LABEL_OTHER + 1] = {false};
    for (int i = 0; i < c->label.n; i++)
        comes[c->label.log[i].index] |= !label_passed(&c->label, i);
    if (c->request || c->asking)
        comes[c->next.index] = true;
    for (int i = 0; i < c->plan.n; i++)
        if (c->state[i] == ASKED && !comes[i])
            c->state[i] = MISSING;
}

/* ---- ends ---- */

static void forget_kept(struct camera_state *c)
{
    for (int i = 0; i < c->plan.n; i++) {
        c->forget |= c->state[i] == KEPT;
        c->state[i] = MISSING;
        c->tries[i] = 0;
    }
    label_forget(&c->label, false);
}

static void stop_bracket(struct bracket *b, struct camera_state *culprit, enum bracket_reason why,
                         int64_t now_ns)
{
    b->state = BRACKET_FAULT;
    b->reason = why;
    b->culprit = culprit ? (int)(culprit - b->cameras) : -1;
    for (int i = 0; i < b->n; i++) {
        struct camera_state *c = &b->cameras[i];
        c->forget = c->relit = c->restart = c->request = false;
        if (i == b->culprit && (why == BRACKET_INEFFECTIVE || why == BRACKET_SCENE_CHANGED ||
                                why == BRACKET_DISAGREES))
            forget_kept(c); // the frame that they were compared with is in doubt
        label_trust(&c->label);
        if (c->armed && !c->restarting && c->plan.n > 0 && !is_base(c, label_newest(&c->label)))
            request_exposure(c, LABEL_BASE, now_ns);
    }
}

static void enter_phase(struct camera_state *c, enum phase p)
{
    c->phase = p;
    c->conflicts = c->judged = 0;
    c->target = -1;
}

static enum phase first_phase(const struct camera_state *c)
{
    return label_unsteady(&c->label) ? REST : RUN;
}

static void end_camera(struct bracket *b, struct camera_state *c)
{
    enter_phase(c, OVER);
    for (int i = 0; i < b->n; i++)
        if (b->cameras[i].phase != OVER)
            return;
    b->state = BRACKET_DONE;
}

static void light_changed(struct bracket *b, struct camera_state *c, const struct label_look *k,
                          int64_t now_ns)
{
    // only once, and not when it is too dark or bright to compare anything
    if (c->forgets++ || !(k->measured || k->changed)) {
        stop_bracket(b, c, BRACKET_SCENE_CHANGED, now_ns);
        return;
    }
    forget_kept(c);
    c->relit = true;
    label_forget(&c->label, true);
    label_trust(&c->label);
    c->settled = 0;
    c->suspect = -1;
    enter_phase(c, WAIT);
}

/* ---- frames ---- */

static bool close_to(double a, double b)
{
    return fabs(a - b) <= GAINS * fabs(b);
}

/* Whether the reported gains are in the pixels. */
static bool has_gains(const struct frame *f)
{
    return f->gains_known && !f->gains_later;
}

static enum bracket_reason refusal_of(const struct camera_state *c, const struct bracket_event *ev)
{
    const struct frame *f = ev->frame;
    if (ev->kind == BRACKET_UNUSABLE || !ev->probe || (f->flags & (FRAME_ERROR | FRAME_SHORT)))
        return BRACKET_BAD_FRAMES;
    if (c->settled > 0 && (f->w != c->w || f->h != c->h || f->format != c->format))
        return BRACKET_BAD_FRAMES;
    if (has_gains(f) && !close_to(f->digital_gain, 1.0))
        return BRACKET_GAINS;
    bool moved = c->gains_known && has_gains(f) && c->phase != WAIT && c->phase != OVER &&
                 !(close_to(f->red_gain, c->red) && close_to(f->blue_gain, c->blue));
    return moved ? BRACKET_GAINS : BRACKET_NONE;
}

/* Takes a frame at base, in WAIT or while nothing runs, for the reference. */
static void settle_reference(struct camera_state *c, const struct bracket_event *ev)
{
    const struct frame *f = ev->frame;
    bool same;
    if (!label_rested(&c->label) || !is_base(c, label_newest(&c->label)))
        return;
    if (label_settle(&c->label, f, ev->probe, &same)) {
        c->cause = BRACKET_DISAGREES;
        c->settled = 0;
        c->judged++;
        return;
    }
    c->judged = 0;
    c->settled = same && c->settled > 0 ? 2 : 1;
    c->w = f->w;
    c->h = f->h;
    c->format = f->format;
    c->gains_known = has_gains(f);
    c->red = f->red_gain;
    c->blue = f->blue_gain;
}

/* The missing exposure that request `e` shows, -1: none. */
static int missing_index(const struct camera_state *c, const struct label_request *e)
{
    if (e->index < c->plan.n && c->state[e->index] != KEPT)
        return e->index;
    for (int i = 0; i < c->plan.n; i++)
        if (c->state[i] != KEPT && label_same(c->stops[i], e->stops))
            return i;
    return -1;
}

static void keep_frame(struct camera_state *c, int i, const struct bracket_event *ev,
                       const struct label_look *k)
{
    struct bracket_evidence *v = &c->evidence[i];
    label_evidence(&c->label, ev->frame, k, v);
    v->requested = c->plan.requested[i];
    v->attempts = c->tries[i];
    v->rested = c->phase != RUN;
    label_hold(&c->label, i, ev->probe, k);
    c->state[i] = KEPT;
    c->keep = i;
}

/* Uses a frame whose exposure is known. */
static void use_known(struct bracket *b, struct camera_state *c, const struct bracket_event *ev,
                      const struct label_look *k)
{
    const struct label_request *e = &c->label.log[k->entry];
    bool base = is_base(c, e), at_base = is_base(c, label_newest(&c->label));
    // asked for before the trigger: the frame may be from before it, too
    bool early = e->asked_ns < c->begin_ns &&
                 (c->since < 1 || (c->label.sane && ev->frame->timestamp_ns < c->begin_ns));
    int i = missing_index(c, e);
    c->judged = 0;
    // a torn frame has rows of the one before, which must look the same if flicker allows
    bool same = c->still_since < c->since || (c->label.light.hz > 0.0 && label_rested(&c->label));
    bool still = (!k->measured || same) && label_alone(&c->label);
    bool wanted = i >= 0 && !early;
    if (wanted && c->phase == RUN && !k->whole)
        c->tries[i] = TRIES_MAX; // only from rest now
    else if (wanted && (c->phase == RUN || (c->phase == REST && still)))
        keep_frame(c, i, ev, k);
    if (!base || !at_base)
        return;
    if (has_all_exposures(c))
        end_camera(b, c);
    else if (c->phase == CHECK && label_alone(&c->label) && c->suspect >= 0)
        stop_bracket(b, c, BRACKET_INEFFECTIVE, ev->now_ns);
    else if (c->phase == CHECK && label_alone(&c->label))
        enter_phase(c, REST);
}

/* Counts frames at rest that are not what was asked for, and acts on the last one allowed. */
static void judge_at_rest(struct bracket *b, struct camera_state *c, const struct label_look *k,
                          int64_t now_ns)
{
    const struct label_request *e = label_newest(&c->label);
    double tolerance = c->label.cfg.tolerance;
    if (++c->judged < JUDGED_MAX)
        return;
    // no change was seen since before the request
    bool still = c->since - c->still_since > e->age_hi - c->label.lo + 1 && !isnan(c->still) &&
                 fabs(e->stops - e->from) > 2.0 * tolerance;
    if (k->disagrees)
        stop_bracket(b, c, BRACKET_DISAGREES, now_ns);
    else if (still)
        stop_bracket(b, c, BRACKET_INEFFECTIVE, now_ns);
    else if (c->phase == CHECK)
        light_changed(b, c, k, now_ns);
    else {
        c->suspect = c->target;
        enter_phase(c, CHECK);
    }
}

/* The delay is not the promised one, or a flash of light made a frame look like its neighbour: the
 * kept frames may be mistaken, too. */
static void on_shifted_delay(struct camera_state *c)
{
    label_doubt(&c->label);
    forget_kept(c);
    if (c->phase == RUN)
        enter_phase(c, CHECK);
}

static bool tried_in_vain(const struct camera_state *c)
{
    for (int i = 0; i < c->plan.n; i++)
        if (c->state[i] == MISSING && c->tries[i] >= TRIES_MAX)
            return true;
    return false;
}

static void look_at(struct bracket *b, struct camera_state *c, const struct bracket_event *ev)
{
    struct label_look k;
    label_look(&c->label, ev->frame, ev->probe, &k);
    if (c->phase == RUN && !has_all_exposures(c)) // else frames are kept from rest only
        label_last(&c->label, ev->probe, &k);
    bool rested = label_rested(&c->label);
    if (!k.measured || !(fabs(k.stops - c->still) <= 0.5 * c->label.cfg.tolerance)) {
        c->still = k.measured ? k.stops : NAN;
        c->still_since = c->since;
    }
    c->torn = k.torn ? c->torn + 1 : 0;
    if (k.torn && c->torn <= TORN_MAX) {
        c->rejected++;
        c->cause = BRACKET_BAD_FRAMES;
        give_up_passed(c);
        return;
    }
    if (k.verdict == LABEL_SHIFTED)
        on_shifted_delay(c);
    if (k.verdict == LABEL_PROVEN && c->phase == RUN)
        label_narrow(&c->label, &k);
    if (k.verdict == LABEL_PROVEN || (k.verdict == LABEL_BLIND && rested && c->phase != RUN))
        use_known(b, c, ev, &k);
    if (k.verdict == LABEL_CONFLICT) {
        c->rejected++;
        c->conflicts++;
        c->cause = k.disagrees ? BRACKET_DISAGREES
                   : k.changed ? BRACKET_SCENE_CHANGED
                               : BRACKET_INEFFECTIVE;
        if (rested && c->phase != RUN)
            judge_at_rest(b, c, &k, ev->now_ns);
    }
    give_up_passed(c);
    if (c->phase == RUN && (c->conflicts >= CONFLICTS_MAX || tried_in_vain(c) ||
                            (rested && is_base(c, label_newest(&c->label)))))
        enter_phase(c, CHECK);
}

static void refuse_frame(struct bracket *b, struct camera_state *c, enum bracket_reason why,
                         int64_t now_ns)
{
    c->rejected++;
    c->cause = why;
    if (++c->bad >= BAD_MAX)
        stop_bracket(b, c, why, now_ns);
}

static void wait_at_base(struct bracket *b, struct camera_state *c, const struct bracket_event *ev)
{
    settle_reference(c, ev);
    if (c->judged >= BAD_MAX)
        stop_bracket(b, c, BRACKET_DISAGREES, ev->now_ns);
    else if (c->settled >= 2)
        enter_phase(c, first_phase(c));
}

static void handle_frame(struct bracket *b, struct camera_state *c, const struct bracket_event *ev,
                         enum bracket_reason why)
{
    if (why)
        refuse_frame(b, c, why, ev->now_ns);
    else if (c->restarting)
        return;
    else {
        c->bad = 0;
        if (c->phase == WAIT)
            wait_at_base(b, c, ev);
        else
            look_at(b, c, ev);
    }
    if (b->state != BRACKET_SHOOTING)
        return;
    if (c->frames >= FRAMES_MAX * (c->plan.n + c->label.doubt))
        stop_bracket(b, c, c->cause, ev->now_ns);
    else
        request_next(c, ev->now_ns);
}

static void on_frame(struct bracket *b, struct camera_state *c, const struct bracket_event *ev)
{
    const struct frame *f = ev->frame;
    bool shooting = b->state == BRACKET_SHOOTING && c->phase != OVER;
    bool repeated = f && label_duplicate(&c->label, f);
    if (shooting) {
        c->frames++;
        c->alive_ns = ev->now_ns;
    }
    if (!f || repeated) {
        if (shooting)
            refuse_frame(b, c, BRACKET_BAD_FRAMES, ev->now_ns);
        return;
    }
    int gap = label_advance(&c->label, f, ev->now_ns);
    c->since += gap;
    c->lost += gap - 1;
    enum bracket_reason why = refusal_of(c, ev);
    if (shooting)
        handle_frame(b, c, ev, why);
    else if (c->armed && !why)
        settle_reference(c, ev);
}

/* ---- other events ---- */

/* A reference that a frame of the plan before was like in the end. */
static bool keeps_reference(const struct camera_state *c, const struct bracket_event *ev)
{
    const struct label_request *newest = label_newest(&c->label);
    return ev->same && c->settled >= 2 && newest && is_base(c, newest) &&
           ev->set.time_s == c->base.time_s && ev->set.gain == c->base.gain;
}

static void on_arm(struct bracket *b, struct camera_state *c, const struct bracket_event *ev)
{
    if (b->state == BRACKET_DONE || b->state == BRACKET_FAULT)
        for (int i = 0; i < b->n; i++)
            b->cameras[i].armed = false;
    const bool kept = keeps_reference(c, ev);
    c->armed = true;
    c->base = ev->set;
    c->base_stops = rounded_stops(c, &ev->set);
    c->restarting = c->asking = c->request = false;
    c->phase = OVER;
    c->plan.n = 0;
    c->judged = 0;
    if (!kept) {
        c->settled = 0;
        label_forget(&c->label, true);
        label_restart(&c->label, &ev->set, ev->now_ns);
    }
    b->state = BRACKET_ARMED;
    b->reason = BRACKET_NONE;
    for (int i = 0; i < b->n; i++)
        if (!b->cameras[i].armed)
            b->state = BRACKET_IDLE;
}

static bool is_exposure(const struct exposure *e)
{
    return e->time_s > 0.0 && e->time_s < 1e6 && e->gain >= 1.0 && e->gain < 1e6;
}

static err_t check_plan(const struct bracket *b, const struct bracket_plan *plan)
{
    int wanted = 0;
    for (int c = 0; c < b->n; c++) {
        const struct bracket_camera *cfg = &b->cameras[c].label.cfg;
        if (plan[c].n < 0 || plan[c].n > BRACKET_EXPOSURES_MAX)
            return err_fail(ERR_ARG, "camera %d: the plan has %d exposures, 0 to %d are allowed", c,
                            plan[c].n, BRACKET_EXPOSURES_MAX);
        for (int i = 0; i < plan[c].n; i++) {
            const struct exposure *e = &plan[c].requested[i];
            if (!is_exposure(e) || e->time_s < cfg->time_min_s * (1.0 - RANGE) ||
                e->time_s > cfg->time_max_s * (1.0 + RANGE))
                return err_fail(ERR_ARG,
                                "camera %d: exposure %d of the plan is %g s at gain %g; it must be "
                                "%g to %g s at a gain of at least 1",
                                c, i, e->time_s, e->gain, cfg->time_min_s, cfg->time_max_s);
        }
        wanted += plan[c].n;
    }
    return wanted > 0 ? OK : err_fail(ERR_ARG, "the plan has no exposure for any camera");
}

static err_t on_begin(struct bracket *b, const struct bracket_event *ev)
{
    bool ready = b->state == BRACKET_ARMED || b->state == BRACKET_DONE;
    for (int i = 0; i < b->n; i++)
        ready = ready && b->cameras[i].armed;
    if (!ready || !ev->plan)
        return err_fail(ERR_ARG, "a bracket begins with a plan, once all cameras stream");
    err_t e = check_plan(b, ev->plan);
    if (e)
        return e;
    b->state = BRACKET_SHOOTING;
    for (int i = 0; i < b->n; i++) {
        struct camera_state *c = &b->cameras[i];
        c->plan = ev->plan[i];
        for (int k = 0; k < c->plan.n; k++)
            c->stops[k] = rounded_stops(c, &c->plan.requested[k]);
        memset(c->state, 0, sizeof c->state);
        memset(c->tries, 0, sizeof c->tries);
        label_forget(&c->label, false);
        for (int k = 0; k < c->label.n; k++) // left from the plan before
            if (c->label.log[k].index != LABEL_BASE)
                c->label.log[k].index = LABEL_OTHER;
        c->begin_ns = c->alive_ns = ev->now_ns;
        c->since = c->suspect = -1;
        c->frames = c->rejected = c->lost = c->bad = c->torn = 0;
        c->refusals = c->forgets = c->restarts = 0;
        c->slow_s = 0.0;
        c->still = NAN;
        c->cause = BRACKET_BAD_FRAMES;
        enter_phase(c, c->plan.n == 0 ? OVER : c->settled >= 2 ? first_phase(c) : WAIT);
        request_next(c, ev->now_ns);
    }
    return OK;
}

static void on_answer(struct bracket *b, struct camera_state *c, const struct bracket_event *ev)
{
    if (!c->asking)
        return;
    c->asking = false;
    if (!ev->err) {
        c->refusals = 0;
        c->next.set = ev->set;
        c->next.answered_ns = ev->now_ns;
        label_asked(&c->label, &c->next);
        return;
    }
    if (b->state != BRACKET_SHOOTING || c->phase == OVER)
        return;
    if (c->next.index != LABEL_BASE && c->state[c->next.index] == ASKED)
        c->state[c->next.index] = MISSING;
    if (ev->err == ERR_LOST)
        stop_bracket(b, c, BRACKET_DEVICE_LOST, ev->now_ns);
    else if (++c->refusals >= REFUSALS_MAX)
        stop_bracket(b, c, BRACKET_REFUSED, ev->now_ns);
}

static void on_lost(struct bracket *b, struct camera_state *c, const struct bracket_event *ev)
{
    c->armed = c->asking = c->restarting = c->request = false;
    c->settled = 0;
    if (b->state == BRACKET_SHOOTING && c->plan.n > 0)
        stop_bracket(b, c, BRACKET_DEVICE_LOST, ev->now_ns);
    else if (b->state == BRACKET_ARMED)
        b->state = BRACKET_IDLE;
}

static void on_opened(struct bracket *b, struct camera_state *c, const struct bracket_event *ev)
{
    if (!c->restarting)
        return;
    c->restarting = c->asking = c->request = false;
    c->alive_ns = ev->now_ns;
    c->slow_s = label_longest_s(&c->label);
    label_restart(&c->label, NULL, ev->now_ns);
    give_up_passed(c);
    enter_phase(c, c->settled >= 2 ? CHECK : WAIT);
    if (b->state == BRACKET_SHOOTING)
        request_next(c, ev->now_ns);
}

static int64_t camera_deadline(const struct camera_state *c)
{
    double wait_s = WAITS * fmax(label_longest_s(&c->label), c->slow_s) + PATIENCE_S;
    int64_t ns = (int64_t)fmin(wait_s * 1e9, 9e18);
    return c->alive_ns > INT64_MAX - ns ? INT64_MAX : c->alive_ns + ns;
}

static void on_tick(struct bracket *b, int64_t now_ns)
{
    for (int i = 0; i < b->n && b->state == BRACKET_SHOOTING; i++) {
        struct camera_state *c = &b->cameras[i];
        if (c->phase == OVER || now_ns < camera_deadline(c))
            continue;
        if (c->restarts++) {
            stop_bracket(b, c, BRACKET_STALLED, now_ns);
            return;
        }
        c->restarting = c->restart = true;
        c->request = false;
        c->alive_ns = now_ns;
    }
}

static err_t check_event(const struct bracket *b, const struct bracket_event *ev)
{
    bool names_camera =
        ev->kind != BRACKET_BEGIN && ev->kind != BRACKET_TICK && ev->kind != BRACKET_CANCEL;
    if (names_camera && (ev->camera < 0 || ev->camera >= b->n))
        return err_fail(ERR_ARG, "an event of camera %d, not 0 to %d", ev->camera, b->n - 1);
    if (ev->kind == BRACKET_ARM && (b->state == BRACKET_SHOOTING || !is_exposure(&ev->set)))
        return err_fail(ERR_ARG, "camera %d: cannot be armed at %g s and gain %g%s", ev->camera,
                        ev->set.time_s, ev->set.gain,
                        b->state == BRACKET_SHOOTING ? " while a bracket runs" : "");
    if (ev->kind == BRACKET_FRAME && !ev->frame)
        return err_fail(ERR_ARG, "camera %d: an event without a frame", ev->camera);
    if (ev->kind == BRACKET_ANSWER && !ev->err && !is_exposure(&ev->set))
        return err_fail(ERR_ARG, "camera %d: answers %g s at gain %g, which is no exposure",
                        ev->camera, ev->set.time_s, ev->set.gain);
    return OK;
}

err_t bracket_event(struct bracket *b, const struct bracket_event *ev)
{
    err_t e = check_event(b, ev);
    if (e)
        return e;
    struct camera_state *c = &b->cameras[ev->camera >= 0 && ev->camera < b->n ? ev->camera : 0];
    switch (ev->kind) {
    case BRACKET_ARM:
        on_arm(b, c, ev);
        break;
    case BRACKET_BEGIN:
        return on_begin(b, ev);
    case BRACKET_ANSWER:
        on_answer(b, c, ev);
        break;
    case BRACKET_FRAME:
    case BRACKET_UNUSABLE:
        on_frame(b, c, ev);
        break;
    case BRACKET_LOST:
        on_lost(b, c, ev);
        break;
    case BRACKET_OPENED:
        on_opened(b, c, ev);
        break;
    case BRACKET_TICK:
        on_tick(b, ev->now_ns);
        break;
    case BRACKET_CANCEL:
        if (b->state == BRACKET_SHOOTING)
            stop_bracket(b, NULL, BRACKET_CANCELLED, ev->now_ns);
        break;
    }
    return OK;
}

bool bracket_action(struct bracket *b, struct bracket_action *out)
{
    for (int i = 0; i < b->n; i++) {
        struct camera_state *c = &b->cameras[i];
        *out = (struct bracket_action){.camera = i};
        if (c->forget || c->relit) {
            out->kind = BRACKET_FORGET;
            out->index = c->relit;
            c->relit = false;
            c->forget = false;
        } else if (c->keep >= 0) {
            out->kind = BRACKET_KEEP;
            out->index = c->keep;
            out->exposure = c->evidence[c->keep].exposure;
            c->keep = -1;
        } else if (c->restart) {
            out->kind = BRACKET_RESTART;
            c->restart = false;
        } else if (c->request) {
            out->kind = BRACKET_REQUEST;
            out->index = c->next.index;
            out->exposure = c->next.requested;
            c->request = false;
            c->asking = true;
        } else {
            continue;
        }
        return true;
    }
    return false;
}

void bracket_light(struct bracket *b, int camera, const struct flicker_light *light)
{
    b->cameras[camera].label.light = *light;
}

/* ---- results ---- */

enum bracket_state bracket_state(const struct bracket *b)
{
    return b->state;
}

enum bracket_reason bracket_reason(const struct bracket *b, int *camera)
{
    *camera = b->state == BRACKET_FAULT ? b->culprit : -1;
    return b->state == BRACKET_FAULT ? b->reason : BRACKET_NONE;
}

bool bracket_settled(const struct bracket *b, int camera)
{
    return b->cameras[camera].armed && b->cameras[camera].settled >= 2;
}

const struct bracket_evidence *bracket_evidence(const struct bracket *b, int camera, int index)
{
    if (camera < 0 || camera >= b->n || index < 0 || index >= b->cameras[camera].plan.n)
        return NULL;
    const struct camera_state *c = &b->cameras[camera];
    return c->state[index] == KEPT ? &c->evidence[index] : NULL;
}

void bracket_progress(const struct bracket *b, struct bracket_progress *out)
{
    *out = (struct bracket_progress){0};
    for (int i = 0; i < b->n; i++) {
        const struct camera_state *c = &b->cameras[i];
        for (int k = 0; k < c->plan.n; k++)
            out->kept += c->state[k] == KEPT;
        out->wanted += c->plan.n;
        out->frames = c->frames > out->frames ? c->frames : out->frames;
        out->rejected += c->rejected;
        out->lost += c->lost;
        out->resting |= c->phase == CHECK || c->phase == REST || c->phase == WAIT;
    }
}

int64_t bracket_deadline(const struct bracket *b)
{
    int64_t first = INT64_MAX;
    for (int i = 0; i < b->n && b->state == BRACKET_SHOOTING; i++)
        if (b->cameras[i].phase != OVER && camera_deadline(&b->cameras[i]) < first)
            first = camera_deadline(&b->cameras[i]);
    return first;
}
