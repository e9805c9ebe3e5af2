/* Sums of rows of the short frames, over those of the long ones and the ratio of times, are
 * 1 + depth m sin(phase + 2 pi hz t) with m = sinc(hz time) and t in the middle of the row's
 * exposure. For both frequencies and for readouts from 0 to a whole period the amplitudes of sine
 * and cosine follow by least squares, each figure by its noise. The fit that explains most counts,
 * if what it leaves is little or noise, and its depth is at most 1: noise, passers-by and exposures
 * that were not applied fail this. */
#include "core/photo/flicker.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { READOUTS = 96, FIGURES_MIN = 24 }; // rows of all short frames

#define SHORT_S 0.00125  // an exposure that should see the patches that count: they are brighter in
#define LEAST_CODES 2.0f // it than the floor; numbers with a black level, than so many codes
#define BRIGHTEST 0.7f   // relative to saturation
#define EXPLAINED 0.8    // least share of the squares,
#define SIGNIFICANT 50.0 // or squared standard errors, if what is left is noise:
#define NOISE_MOST 1.5   // squared standard errors a figure
#define ERROR 0.01       // of a figure without noise: scenes are not quite still
#define LEAST_DEPTH 0.02 // less is within any tolerance
#define DEPTH_MOST 1.05  // depth, errors included
#define DEPTH_MAX 0.95   // logarithms are finite

/* Whether a patch of a long frame counts. */
static bool patch_counts(const struct exposure_probe *w, int i, double time_s)
{
    float least = w->linear ? LEAST_CODES * w->step : w->floor[i];
    return w->state[i] == EXPOSURE_PROBE_GOOD && w->x[i] <= BRIGHTEST &&
           (double)w->x[i] * SHORT_S / time_s >= (double)least;
}

void flicker_add_long(struct flicker *f, const struct exposure_probe *w, double time_s)
{
    f->long_s = time_s;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        if (f->n_long == 0) {
            f->counts[i] = patch_counts(w, i, time_s);
            f->patches[i / EXPOSURE_PROBE_EDGE] += f->counts[i];
        }
        f->even[i / EXPOSURE_PROBE_EDGE] += f->counts[i] ? (double)w->x[i] : 0.0;
    }
    f->n_long++;
}

void flicker_add_short(struct flicker *f, const struct exposure_probe *w, double start_s,
                       double time_s)
{
    if (f->n_short == FLICKER_FRAMES)
        return;
    double *row = f->row[f->n_short], *var = f->var[f->n_short];
    memset(row, 0, sizeof f->row[0]);
    memset(var, 0, sizeof f->var[0]);
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        row[i / EXPOSURE_PROBE_EDGE] += f->counts[i] ? (double)w->x[i] : 0.0;
        var[i / EXPOSURE_PROBE_EDGE] += f->counts[i] ? (double)(w->sd[i] * w->sd[i]) : 0.0;
    }
    f->time_s[f->n_short] = time_s;
    f->start_s[f->n_short++] = start_s;
}

static double sinc(double x)
{
    return fabs(x) < 1e-9 ? 1.0 : sin(NUM_PI * x) / (NUM_PI * x);
}

/* Normal equations of sine and cosine; n: samples, w: sum of their weights. */
struct fit {
    double n, w, uu, uv, vv, yu, yv, yy;
};

static void add_sample(struct fit *t, double y, double angle, double m, double weight)
{
    double u = m * sin(angle), v = m * cos(angle);
    t->n += 1.0;
    t->w += weight;
    t->uu += weight * u * u;
    t->uv += weight * u * v;
    t->vv += weight * v * v;
    t->yu += weight * y * u;
    t->yv += weight * y * v;
    t->yy += weight * y * y;
}

/* Share of the squares that the fit explains; 0 if what it leaves cannot be noise. */
static double solve_amplitude(const struct fit *t, double *amplitude)
{
    double det = t->uu * t->vv - t->uv * t->uv;
    *amplitude = 0.0;
    if (!(det > 1e-4 * t->w * t->w) || !(t->yy > 0.0))
        return 0.0; // all samples have one phase
    double u = (t->vv * t->yu - t->uv * t->yv) / det, v = (t->uu * t->yv - t->uv * t->yu) / det;
    double explained = u * t->yu + v * t->yv;
    bool noise = explained >= SIGNIFICANT && t->yy - explained <= NOISE_MOST * t->n;
    *amplitude = hypot(u, v);
    return noise || explained > EXPLAINED * t->yy ? explained / t->yy : 0.0;
}

static double explained_share(const struct flicker *f, double hz, double readout_s,
                              double *amplitude)
{
    struct fit t = {0};
    for (int k = 0; k < f->n_short; k++)
        for (int j = 0; j < EXPOSURE_PROBE_EDGE; j++) {
            if (f->patches[j] == 0)
                continue;
            double at = f->start_s[k] - f->start_s[0] + readout_s * j / EXPOSURE_PROBE_EDGE;
            double time = f->time_s[k], m = sinc(hz * time);
            double even = f->even[j] / f->n_long * time / f->long_s;
            add_sample(&t, f->row[k][j] / even - 1.0, 2.0 * NUM_PI * hz * (at + 0.5 * time), m,
                       1.0 / (f->var[k][j] / (even * even) + ERROR * ERROR));
        }
    *amplitude = 0.0;
    return t.n < FIGURES_MIN ? 0.0 : solve_amplitude(&t, amplitude);
}

void flicker_find(const struct flicker *f, double period_s, struct flicker_light *out)
{
    static const double frequency[] = {100.0, 120.0};
    double best = 0.0;
    *out = (struct flicker_light){0};
    for (int i = 0; i < 2 && f->n_long > 0; i++)
        for (int r = 0; r <= READOUTS; r++) {
            double depth, share = explained_share(f, frequency[i], period_s * r / READOUTS, &depth);
            if (share <= best || !(depth >= LEAST_DEPTH && depth <= DEPTH_MOST))
                continue;
            best = share;
            *out = (struct flicker_light){frequency[i], fmin(depth, DEPTH_MAX)};
        }
}

double flicker_stops(const struct flicker_light *l, double time_s)
{
    return l->hz > 0.0 ? -log2(1.0 - l->depth * fabs(sinc(l->hz * time_s))) : 0.0;
}

double flicker_steady_s(const struct flicker_light *l, double time_s)
{
    if (!(l->hz > 0.0) || time_s * l->hz < 0.5)
        return time_s;
    return fmax(floor(time_s * l->hz + 0.5), 1.0) / l->hz;
}
