/* Finds a set of times that covers the bins of a histogram.
 * Count: exposure t covers the bins from x_hi / t down to x_lo / t. The least cover that may leave
 * a share is a recurrence from dark to bright over (bins, exposures left): leave the brightest bin,
 * or begin an exposure at it. The first begins where `clip` allows. Where even the largest number
 * of exposures leaves too much, it takes the fewest after which one more gains less than half of
 * `clip`.
 * Times are rounded down to legal ones and improved by coordinate search. The rating of a set
 * compares first the shares above the bounds, with each bin merged at its worse edge; then the
 * number of members that are probes; then the mean log2 signal to noise less the cost of time. If
 * rounding opens a gap that the search does not close, the set gets one exposure more.
 * Sources: Barakat, Hone & Darcie, IEEE TIP 2008 (minimal sets); Gallo et al., Eurographics 2012
 * (noise over the histogram, a share ignored). */
#include "core/photo/coverage.h"

#include "core/base/num.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum {
    SEARCH = 3 * METER_PER_STOP, // steps of a bin to either side
    MOST = METER_EXPOSURES_MAX
};
#define TIME_COST 0.25  // mean log2 SNR that a doubling of the sum of times must bring
#define TIME_FREE_S 0.1 // sums of times below do not count
#define DARK_AIM 0.85   // part of the share that may be dark; the noise of the probes adds the rest
#define GAIN_LEAST 0.5  // times `clip`: least gain of another exposure beyond the device
#define SLIGHT 1e-9     // rounding of shares

double coverage_legal_s(const struct meter_config *c, double t)
{
    t = fmin(fmax(t, c->time_min_s), c->time_max_s);
    if (!(c->time_step_s > 0.0))
        return t;
    double steps = floor((t - c->time_min_s) / c->time_step_s + 1e-6);
    return fmin(c->time_min_s + steps * c->time_step_s, c->time_max_s);
}

double coverage_longest_s(const struct meter_config *c)
{
    double t = c->time_max_s;
    if (c->blur_s > 0.0)
        t = fmin(t, c->blur_s);
    if (c->budget_s > 0.0)
        t = fmin(t, c->budget_s);
    return coverage_legal_s(c, t);
}

int coverage_clip_bin(const struct meter *m, double t)
{
    double b = floor((m->hi - log2(t) - m->bin_lo) * METER_PER_STOP + 1e-6);
    return (int)fmin(fmax(b, 0.0), METER_BINS - 1);
}

int coverage_bins(const struct meter *m)
{
    int n = (int)floor((m->hi - m->lo) * METER_PER_STOP + 1e-6);
    return n > 1 ? n : 1;
}

double coverage_snr2(const struct meter_config *c, double x)
{
    double e = x * c->electrons;
    return e * e / (e + c->read_noise * c->read_noise);
}

/* --- count ---------------------------------------------------------------------------------- */

/* A scene to plan for. */
struct task {
    const struct meter *m;
    double most_s;              // longest time
    const double *top, *bottom; // [METER_BINS] shares
    double mass[METER_BINS];    // share of a bin that must be covered
    double low[METER_BINS];     // radiance of the lower edge
    int length;                 // bins that an exposure covers
    int bright, dim;            // highest bin of the shortest, longest exposure
    double left[METER_EXPOSURES_MAX + 1][METER_BINS + 1]; // [exposures][bins] uncovered at best
};

static void set_reach(const struct meter *m, double most_s, struct task *t)
{
    t->most_s = most_s;
    t->bright = coverage_clip_bin(m, m->cfg.time_min_s) - 1;
    t->dim = coverage_clip_bin(m, most_s) - 1;
}

/* Bins left below an exposure that begins at bin b, or as near to it as possible. */
static int bins_below(const struct task *t, int b)
{
    return num_max((b > t->dim ? b : t->dim) - t->length + 1, 0);
}

/* left[k][n]: the least share of the n darkest bins that k exposures leave uncovered. */
static void solve_cover(struct task *t)
{
    for (int k = 0; k <= MOST; k++) {
        t->left[k][0] = 0.0;
        for (int n = 1; n <= METER_BINS; n++) {
            double leave = t->mass[n - 1] + t->left[k][n - 1], begin = DBL_MAX;
            int rest = bins_below(t, n - 1);
            if (k > 0 && n - 1 <= t->bright)
                begin = t->left[k - 1][rest < n ? rest : n];
            t->left[k][n] = fmin(leave, begin);
        }
    }
}

static void task_init(const struct meter *m, const double *top, const double *bottom,
                      struct task *t)
{
    t->m = m;
    t->top = top;
    t->bottom = bottom;
    t->length = coverage_bins(m);
    for (int b = 0; b < METER_BINS; b++) {
        t->mass[b] = fmax(top[b], bottom[b]);
        t->low[b] = exp2(m->bin_lo + (double)b / METER_PER_STOP);
    }
}

/* Bin at which the first exposure begins so that a share of at most `clip` lies above it. */
static int first_bin(const struct task *t)
{
    double above = 0.0;
    int b = METER_BINS - 1;
    while (b > 0 && above + t->top[b] <= t->m->cfg.clip + SLIGHT)
        above += t->top[b--];
    b = b < t->bright ? b : t->bright;
    return num_max(b, t->dim);
}

/* Times of the best k exposures, rising; the first begins at bin `first`, -1: where it is best.
 * returns: their number. */
static int trace_times(const struct task *t, int k, int first, double *times)
{
    int n = 0, bins = METER_BINS;
    while (k > 0 && bins > 0) {
        bool begin = first >= 0 && n == 0;
        if (begin)
            bins = first + 1;
        int rest = bins_below(t, bins - 1);
        if (!begin && t->left[k][bins] == t->mass[bins - 1] + t->left[k][bins - 1]) {
            bins--; // leave it
            continue;
        }
        int start = num_max(bins - 1, t->dim);
        times[n++] = exp2(t->m->hi) / t->low[start] * exp2(-1.0 / METER_PER_STOP);
        bins = rest < bins ? rest : bins;
        k--;
    }
    return n;
}

/* --- a set of times ------------------------------------------------------------------------- */

struct rating {
    double bad;     // shares above the bounds
    int reused;     // members that are probes
    double quality; // mean log2 SNR less costs
    double clipped, dark;
};

/* Square of the merged signal to noise of a bin at its worse edges; 0: clipped in all. */
static double bin_snr2(const struct task *t, int b, const double *times, int n)
{
    double hi = exp2(t->m->hi) * (1.0 + 1e-6), high = t->low[b] * exp2(1.0 / METER_PER_STOP),
           s = 0.0;
    for (int i = 0; i < n && high * times[i] <= hi; i++)
        s += coverage_snr2(&t->m->cfg, t->low[b] * times[i]);
    return s;
}

static int probe_of(const struct meter *m, double time)
{
    for (int i = 0; i < m->probes; i++)
        if (fabs(log2(m->probe_s[i] / time)) < 1e-6)
            return i;
    return -1;
}

static void rate_times(const struct task *t, const double *times, int n, struct rating *out)
{
    const struct meter_config *c = &t->m->cfg;
    double need = c->snr * c->snr, dark[2] = {0.0, 0.0}, total = 0.0;
    memset(out, 0, sizeof *out);
    for (int b = 0; b < METER_BINS; b++) {
        if (t->mass[b] <= 0.0)
            continue;
        double s = bin_snr2(t, b, times, n);
        if (s == 0.0)
            out->clipped += t->top[b];
        else if (s < need * (1.0 - 1e-9)) {
            dark[0] += t->top[b];
            dark[1] += t->bottom[b];
        }
        out->quality += 0.5 * t->mass[b] * log2(s + 1.0);
    }
    for (int i = 0; i < n; i++) {
        out->reused += probe_of(t->m, times[i]) >= 0;
        total += times[i];
    }
    out->dark = fmax(dark[0], dark[1]);
    out->bad = fmax(out->clipped - c->clip - SLIGHT, 0.0) +
               fmax(out->dark - DARK_AIM * c->dark - SLIGHT, 0.0);
    if (out->bad <= SLIGHT) // where something stays uncovered, time has no price
        out->quality -= TIME_COST * log2(total + TIME_FREE_S);
}

static bool is_better(const struct rating *a, const struct rating *b)
{
    if (fabs(a->bad - b->bad) > SLIGHT)
        return a->bad < b->bad;
    if (a->reused != b->reused)
        return a->reused > b->reused;
    return a->quality > b->quality + 1e-9;
}

/* Legal, rising, within the bounds of time. */
static bool is_allowed(const struct task *t, const double *times, int n)
{
    double total = 0.0;
    for (int i = 0; i < n; i++) {
        total += times[i];
        if ((i > 0 && times[i] <= times[i - 1] * (1.0 + 1e-9)) ||
            times[i] > t->most_s * (1.0 + 1e-9))
            return false;
    }
    double budget = t->m->cfg.budget_s;
    return !(budget > 0.0) || total <= budget * (1.0 + 1e-9);
}

/* Keep `next` instead of `times` if it is allowed and better. */
static bool try_times(const struct task *t, const double *next, int n, double *times,
                      struct rating *w)
{
    struct rating now;
    if (!is_allowed(t, next, n))
        return false;
    rate_times(t, next, n, &now);
    if (!is_better(&now, w))
        return false;
    memcpy(times, next, (size_t)n * sizeof *times);
    *w = now;
    return true;
}

/* Multiply times range[0]..range[1]-1 by every step of the search, and by the factors that make one
 * of them a probe. Keeps what is better. returns: whether something was. */
static bool scale_times(const struct task *t, const int range[2], int n, double *times,
                        struct rating *w)
{
    const struct meter *m = t->m;
    double from[MOST], next[MOST];
    int i0 = range[0], i1 = range[1], probes = (i1 - i0) * m->probes;
    bool moved = false;
    memcpy(from, times, (size_t)n * sizeof *from);
    for (int k = -SEARCH; k <= SEARCH + probes; k++) {
        double factor = exp2((double)k / METER_PER_STOP);
        if (k > SEARCH) {
            int p = (k - SEARCH - 1) % m->probes, i = i0 + (k - SEARCH - 1) / m->probes;
            factor = m->probe_s[p] / from[i];
        }
        memcpy(next, from, (size_t)n * sizeof *next);
        for (int i = i0; i < i1; i++)
            next[i] = coverage_legal_s(&m->cfg, from[i] * factor);
        moved = try_times(t, next, n, times, w) || moved;
    }
    return moved;
}

static void search_times(const struct task *t, int n, double *times, struct rating *w)
{
    bool moved = true;
    rate_times(t, times, n, w);
    for (int sweep = 0; sweep < 4 && moved; sweep++) {
        moved = scale_times(t, (int[2]){0, n}, n, times, w);
        for (int i = 0; i < n; i++)
            moved = scale_times(t, (int[2]){i, i + 1}, n, times, w) || moved;
        for (int i = 1; i < n; i++)
            moved = scale_times(t, (int[2]){i, n}, n, times, w) || moved;
    }
}

/* --- plan ----------------------------------------------------------------------------------- */

/* Round the times of the cover down to legal ones; equal ones become one. */
static int round_down(const struct task *t, double *times, int n)
{
    int kept = 0;
    for (int i = 0; i < n; i++) {
        double legal_s = coverage_legal_s(&t->m->cfg, fmin(times[i], t->most_s));
        if (kept == 0 || legal_s > times[kept - 1] * (1.0 + 1e-9))
            times[kept++] = legal_s;
    }
    return kept;
}

/* Add an exposure in the widest gap, which rounding may have opened. */
static int add_exposure(const struct task *t, double *times, int n)
{
    double next[MOST];
    int at = 1;
    for (int i = 2; i < n; i++)
        if (times[i] / times[i - 1] > times[at] / times[at - 1])
            at = i;
    at = n > 1 ? at : 0;
    double middle_s = n > 1 ? sqrt(times[at - 1] * times[at]) : 0.5 * times[0];
    memcpy(next, times, (size_t)at * sizeof *next);
    next[at] = coverage_legal_s(&t->m->cfg, middle_s);
    memcpy(next + at + 1, times + at, (size_t)(n - at) * sizeof *next);
    if (!is_allowed(t, next, n + 1))
        return n;
    memcpy(times, next, (size_t)(n + 1) * sizeof *times);
    return n + 1;
}

/* The best k exposures with shorter and shorter longest times, until they fit the budget. */
static int fit_budget(struct task *t, int k, bool hold_top, double *times)
{
    const struct meter_config *c = &t->m->cfg;
    double most = coverage_longest_s(c);
    for (;;) {
        set_reach(t->m, most, t);
        solve_cover(t);
        int n = round_down(t, times, trace_times(t, k, hold_top ? first_bin(t) : -1, times));
        if (n > 0 && is_allowed(t, times, n))
            return n;
        if (most <= c->time_min_s || n == 0) {
            times[0] = coverage_legal_s(c, most);
            return 1;
        }
        most = coverage_legal_s(c, most * exp2(-1.0 / METER_PER_STOP));
    }
}

/* The fewest exposures within the bounds; none is added that gains too little. */
static int choose_count(struct task *t, double *times, struct rating *best)
{
    const struct meter_config *c = &t->m->cfg;
    double next[MOST];
    struct rating w;
    int n = 0;
    *best = (struct rating){.bad = INFINITY};
    for (int k = 1; k <= c->exposures_max && best->bad > SLIGHT; k++) {
        int got = fit_budget(t, k, true, next);
        bool spare = got < k; // the cover needs no more
        got = spare ? add_exposure(t, next, got) : got;
        search_times(t, got, next, &w);
        if (w.bad > SLIGHT && (spare || w.bad > best->bad - GAIN_LEAST * c->clip - SLIGHT))
            continue;
        n = got;
        memcpy(times, next, sizeof next);
        *best = w;
    }
    if (best->bad > SLIGHT) { // the bright end may have to go
        int got = fit_budget(t, c->exposures_max, false, next);
        search_times(t, got, next, &w);
        if (w.bad < best->bad - GAIN_LEAST * c->clip - SLIGHT) {
            n = got;
            memcpy(times, next, sizeof next);
            *best = w;
        }
    }
    return n;
}

static double scene_stops(const struct task *t)
{
    double above = 0.0, under = 0.0;
    int hi = METER_BINS - 1, lo = 0;
    while (hi > 0 && above + t->top[hi] <= t->m->cfg.clip + SLIGHT)
        above += t->top[hi--];
    while (lo < hi && under + t->bottom[lo] <= t->m->cfg.dark + SLIGHT)
        under += t->bottom[lo++];
    return (double)(hi + 1 - lo) / METER_PER_STOP;
}

/* Least signal to noise of unclipped bins, without the share `dark` that has the least; 0: none. */
static double worst_snr(const struct task *t, const double *mass, const double *times, int n)
{
    double s[METER_BINS], last = 0.0, left = t->m->cfg.dark + SLIGHT;
    for (int b = 0; b < METER_BINS; b++)
        s[b] = mass[b] > 0.0 ? bin_snr2(t, b, times, n) : 0.0;
    for (;;) {
        int least = -1;
        for (int b = 0; b < METER_BINS; b++)
            if (s[b] > 0.0 && (least < 0 || s[b] < s[least]))
                least = b;
        if (least < 0)
            return sqrt(last);
        last = s[least];
        s[least] = 0.0;
        left -= mass[least];
        if (left < 0.0)
            return sqrt(last);
    }
}

void coverage_run(const struct meter *m, const double *top, const double *bottom,
                  struct meter_result *out)
{
    struct task t;
    struct rating w;
    memset(out, 0, sizeof *out);
    task_init(m, top, bottom, &t);
    out->n = choose_count(&t, out->time_s, &w);
    for (int i = 0; i < out->n; i++)
        out->probe[i] = probe_of(m, out->time_s[i]);
    out->stops = scene_stops(&t);
    out->snr =
        fmin(worst_snr(&t, top, out->time_s, out->n), worst_snr(&t, bottom, out->time_s, out->n));
    out->clipped = w.clipped;
    out->dark = w.dark;
    out->too_bright = w.clipped > m->cfg.clip + SLIGHT;
    out->too_dark = w.dark > m->cfg.dark + SLIGHT;
}
