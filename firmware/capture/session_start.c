/* The start of a plan at a given time. Sensors run free: frame n of a camera begins at F(n) = at +
 * n len, and a request that is made during frame n shows in frame n + delay. A line through the
 * starts of the last frames gives `at` and `len`, so the clock of the sensor need not be ours.
 * Where exposures end with their frames, a shorter one begins later in its frame, by `late`.
 * One BEGIN serves all cameras: of the moments between two borders of any frames, that is taken
 * which makes the largest error |F(n + delay) + late - start| of all cameras least; of equals the
 * widest, and its middle, as far as possible from the frames before and after.
 * A camera that can lengthen a frame is moved by (start - late - at) mod len before; then its error
 * is that of the line, else it is up to half a frame. */
#include "firmware/capture/session_inner.h"

#include "firmware/base/backends.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    LEAST = 16, // frames that make a line
    SPARE = 4,  // frames between a shift that has been measured and the request
    ROUND = SESSION_SETTLE + LEAST + SPARE // frames that a shift takes until it has been measured
};
#define SLACK_NS 50e3      // error that is not worth another shift
#define LATE_NS 1000000000 // stamps older than this come from another clock
#define FITS 0.95          // of a period: sensors lengthen frames for exposures a little below it
#define AGREES 0.125       // of a frame: where one that is expected begins
#define NEAR 0.75          // stops that pixels may not tell apart
#define WIDTH 0.01         // error for which moments that are wider by 1 are taken

/* Frames of a camera that waits, ns from the start that was ordered. */
struct frame_line {
    double at, len; // begin of some frame
    double late;    // from the begin of a frame to that of the first exposure
    int delay;      // frames
    bool known;     // else as if a frame began at the start: then its middle is expected
};

/* ---- when frames begin ---- */

/* From the begin of a frame to that of its exposure, ns. */
static double lateness(const struct camera_info *info, double time_s)
{
    return info->ends_on_grid ? fmax(info->period_s - time_s, 0.0) * 1e9 : 0.0;
}

void session_start_forget(struct cam *c)
{
    c->starts.skip = SESSION_SETTLE;
    c->starts.n = c->starts.len_n = 0;
}

void session_start_asked(struct cam *c)
{
    c->starts.longer = c->starts.longer || c->set.time_s > FITS * c->about.info.period_s;
}

void session_start_rest(struct cam *c, bool settled)
{
    struct frame_starts *w = &c->starts;
    const bool longer = w->longer;
    w->longer = false;
    session_start_asked(c);
    if (longer)
        session_start_forget(c);
    w->skip = settled && !longer ? 0 : SESSION_SETTLE;
    w->gap = true;
}

static int by_length(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* The usual time from frame to frame, ns. */
static double median_length(const struct frame_starts *w)
{
    double length[SESSION_STARTS];
    int n = w->n - 1;
    for (int k = 0; k < n; k++)
        length[k] = (double)(w->ns[k + 1] - w->ns[k]);
    qsort(length, (size_t)n, sizeof length[0], by_length);
    return length[n / 2];
}

/* A frame after a gap: it begins whole frames after those before, or these tell nothing. */
static void close_gap(struct frame_starts *w, int64_t at)
{
    if (w->gap && w->n >= LEAST) {
        const double frames = (double)(at - w->ns[w->n - 1]) / median_length(w);
        if (fabs(frames - floor(frames + 0.5)) > AGREES || frames > SESSION_STARTS)
            w->n = w->len_n = 0;
    } else if (w->gap)
        w->n = w->len_n = 0;
    w->gap = false;
}

void session_start_see(struct session *s, int i, const struct frame *f, int64_t now)
{
    const struct cam *c = &s->cam[i];
    const struct camera_info *info = &c->about.info;
    struct frame_starts *w = &s->cam[i].starts;
    double time_s = f->exposure_known ? f->exposure.time_s : c->set.time_s;
    double end = info->stamp == CAMERA_STAMP_END ? time_s * 1e9 : 0.0;
    int64_t at = f->timestamp_ns;
    if (w->skip > 0) {
        w->skip--;
        return;
    }
    if (at <= 0 || at < now - LATE_NS || at > now + LATE_NS)
        at = now; // it came as the next one began
    else
        at -= (int64_t)(end + lateness(info, time_s));
    if (w->n > 0 && at <= w->ns[w->n - 1])
        w->n = 0; // the clock was set
    close_gap(w, at);
    if (w->n == SESSION_STARTS)
        memmove(w->ns, w->ns + 1, sizeof w->ns[0] * (size_t)--w->n);
    w->ns[w->n++] = at;
}

/* The line of least squares through the starts; frames may be missing. */
static void fit_line(const struct frame_starts *w, int64_t start_ns, struct frame_line *out)
{
    double usual = median_length(w), k = 0, sk = 0, st = 0, skk = 0, skt = 0, n = w->n;
    for (int i = 0; i < w->n; i++) {
        double t = (double)(w->ns[i] - w->ns[0]);
        k += i > 0 ? floor((double)(w->ns[i] - w->ns[i - 1]) / usual + 0.5) : 0.0;
        sk += k;
        st += t;
        skk += k * k;
        skt += k * t;
    }
    out->len = w->n < w->len_n ? w->len : (n * skt - sk * st) / (n * skk - sk * sk);
    out->at = (st - out->len * sk) / n + out->len * k + (double)(w->ns[0] - start_ns);
    out->known = true;
}

static struct frame_line line_of(const struct session *s, int i)
{
    const struct cam *c = &s->cam[i];
    struct bracket_camera about;
    calib_camera(&c->about.info, c->calibrated ? &c->calib : NULL, &about);
    struct frame_line l = {.len = fmax(about.period_s, c->set.time_s) * 1e9,
                           .late = lateness(&c->about.info, s->plan[i].requested[0].time_s),
                           .delay = (about.delay_lo + about.delay_hi + 1) / 2};
    l.at = -l.late;
    if (c->starts.n >= LEAST)
        fit_line(&c->starts, s->order.start_ns, &l);
    return l;
}

/* ---- when to begin ---- */

/* How far from the start the first frame of the plan begins if it is asked for at t. */
static double error_at(const struct frame_line *l, double t)
{
    return fabs(l->late + l->at + (floor((t - l->at) / l->len) + l->delay) * l->len);
}

/* The first border of a frame after t. */
static double border_after(const struct frame_line *l, double t)
{
    return l->at + (floor((t - l->at) / l->len + 1e-6) + 1.0) * l->len;
}

/* The least that can be had by a moment after the border `from`; out: that moment. */
static double weigh_moment(const struct frame_line *l, int n, double from, double *moment)
{
    double to = INFINITY, worst = 0.0;
    for (int i = 0; i < n; i++)
        to = fmin(to, border_after(&l[i], from));
    *moment = 0.5 * (from + to);
    for (int i = 0; i < n; i++)
        worst = fmax(worst, error_at(&l[i], *moment));
    return worst - WIDTH * (to - from);
}

static double best_moment(const struct frame_line *l, int n)
{
    double best = 0.0, least = INFINITY, moment;
    for (int i = 0; i < n; i++)
        for (int k = -1; k <= 1; k++) {
            double frames = floor(-(l[i].at + l[i].late) / l[i].len + 0.5) + k - l[i].delay;
            double weight = weigh_moment(l, n, l[i].at + frames * l[i].len, &moment);
            best = weight < least ? moment : best;
            least = fmin(weight, least);
        }
    return best;
}

static bool can_shift(const struct cam *c)
{
    return !c->starts.fixed;
}

double session_start_lead_s(const struct session *s)
{
    double most = 0.0;
    for (int i = 0; i < s->n; i++) {
        const struct cam *c = &s->cam[i];
        struct bracket_camera about;
        calib_camera(&c->about.info, c->calibrated ? &c->calib : NULL, &about);
        int frames = about.delay_hi + 2 + (can_shift(c) ? ROUND : 0);
        frames += c->starts.skip + (c->starts.n < LEAST ? LEAST - c->starts.n : 0);
        frames += c->starts.crowded ? SESSION_SETTLE + SPARE : 0;
        most = fmax(most, frames * fmax(about.period_s, c->set.time_s));
    }
    return most;
}

/* ---- alignment ---- */

/* Lengthens a frame so that one begins at the start, if there is time to see what became of it; if
 * there is time for two, only when the line is as good as it gets. */
static err_t align_camera(struct session *s, int i, const struct frame_line *l)
{
    struct cam *c = &s->cam[i];
    struct frame_starts *w = &c->starts;
    double rest = fmod(fmod(-l->at - l->late, l->len) + l->len, l->len), set_s = 0.0;
    double left = (double)(s->until_ns - backends_now(c->ops, c->st)) / l->len;
    bool ready = w->n == SESSION_STARTS || (l->known && left < 2 * ROUND);
    if (!can_shift(c) || !ready || left < ROUND || rest < SLACK_NS || rest > l->len - SLACK_NS)
        return OK;
    err_t e = c->ops->shift(c->st, rest * 1e-9, &set_s);
    if (e == ERR_LOST)
        return session_machine_name(c, e);
    w->fixed = e && e != ERR_BUSY;
    if (e || !(set_s > 0.0))
        return OK;
    w->len_n = w->n > w->len_n ? w->n : w->len_n;
    w->len = l->len;
    w->skip = SESSION_SETTLE;
    w->n = 0;
    return OK;
}

/* ---- waiting ---- */

/* A first exposure that is that of waiting shows too early, and one near it has to be proven from
 * rest, too late: if there is time, the camera waits at another. */
static err_t leave_exposure(struct session *s, int i)
{
    struct cam *c = &s->cam[i];
    const struct camera_info *info = &c->about.info;
    struct frame_line l = line_of(s, i);
    double left = (double)(s->order.start_ns - backends_now(c->ops, c->st));
    double first = s->plan[i].requested[0].time_s, base = 0.5 * first;
    if (base < info->time_min_s || c->about.light.hz > 0.0) // whole periods of it
        base = fmin(flicker_steady_s(&c->about.light, 2.0 * first), info->time_max_s);
    bool near = fabs(log2(c->set.time_s / first)) < NEAR;
    bool kept = base <= FITS * info->period_s && !c->starts.longer && c->starts.n >= LEAST;
    int need = kept && !can_shift(c) ? SESSION_SETTLE + SPARE : ROUND;
    bool time = left > (need + l.delay) * l.len;
    c->starts.crowded = near && !time;
    return near && time ? session_machine_arm(s, i, base) : OK;
}

err_t session_start_begin(struct session *s)
{
    err_t e = OK;
    s->phase = PHASE_WAIT;
    s->until_ns = session_machine_now(s); // to be found by session_start_wait
    for (int i = 0; i < s->n && !e; i++) {
        schedule_steady(&s->order, &s->cam[i].about, &s->plan[i]);
        e = leave_exposure(s, i);
    }
    return e;
}

bool session_start_due(const struct session *s, int i)
{
    const struct cam *c = &s->cam[i];
    int64_t now = backends_now(c->ops, c->st);
    // a clock of its own stands still between frames
    bool own = c->ops->now && c->ops->now(c->st) != 0;
    return now + (own ? (int64_t)line_of(s, i).len : 0) > s->until_ns;
}

err_t session_start_wait(struct session *s)
{
    struct frame_line line[BRACKET_CAMERAS_MAX];
    bool due = true;
    err_t e = OK;
    if (s->lost)
        return err_fail(ERR_LOST, "a camera was lost before the start");
    for (int i = 0; i < s->n; i++)
        line[i] = line_of(s, i);
    s->until_ns = s->order.start_ns + (int64_t)best_moment(line, s->n);
    for (int i = 0; i < s->n && !e; i++)
        e = align_camera(s, i, &line[i]);
    for (int i = 0; i < s->n; i++)
        due = due && session_start_due(s, i);
    return e ? e : due ? OK : err_fail(ERR_AGAIN, "the start is not yet");
}
