/* Sums of rows of the short frames, over those of the long ones, are c (1 + depth m sin(phase +
 * 2 pi hz t)) with m = sinc(hz time) and t in the middle of the row's exposure. For both
 * frequencies and for readouts from 0 to a whole period c, and the two amplitudes of sine and
 * cosine follow by least squares; the fit that explains most counts, if it explains enough: noise,
 * passers-by and disobeyed exposures have no frequency. */
#include "core/expo/flicker.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846

enum { READOUTS = 96, ROW_PLACES = 4, FIGURES_MIN = 24 };

#define DARKEST 8.0f     // of the floor, in a long frame: a short one still sees it
#define BRIGHTEST 0.7f   // of saturation
#define EXPLAINED 0.6    // share of the variance
#define LEAST_DEPTH 0.02 // what is less is within any tolerance
#define DEPTH_MAX 0.95

void flicker_add_long(struct flicker *f, const struct witness *w)
{
    for (int i = 0; i < WITNESS_PLACES; i++) {
        if (f->n_long == 0) {
            f->counts[i] = w->state[i] == WITNESS_GOOD && w->x[i] >= DARKEST * w->floor[i] &&
                           w->x[i] <= BRIGHTEST;
            f->places[i / WITNESS_EDGE] += f->counts[i];
        }
        f->even[i / WITNESS_EDGE] += f->counts[i] ? (double)w->x[i] : 0.0;
    }
    f->n_long++;
}

void flicker_add_short(struct flicker *f, const struct witness *w, double start_s)
{
    if (f->n_short == FLICKER_FRAMES)
        return;
    double *row = f->row[f->n_short];
    memset(row, 0, sizeof f->row[0]);
    for (int i = 0; i < WITNESS_PLACES; i++)
        row[i / WITNESS_EDGE] += f->counts[i] ? (double)w->x[i] : 0.0;
    f->start_s[f->n_short++] = start_s;
}

static double sinc(double x)
{
    return fabs(x) < 1e-9 ? 1.0 : sin(PI * x) / (PI * x);
}

/* Normal equations of 1, sine and cosine. */
struct fit {
    double n, s[2], ss[3], y, ys[2], yy;
};

static void add(struct fit *t, double y, double angle)
{
    double u = sin(angle), v = cos(angle);
    t->n += 1.0;
    t->s[0] += u;
    t->s[1] += v;
    t->ss[0] += u * u;
    t->ss[1] += u * v;
    t->ss[2] += v * v;
    t->y += y;
    t->ys[0] += y * u;
    t->ys[1] += y * v;
    t->yy += y * y;
}

/* Share of the variance that is explained; amplitude over the mean. */
static double solve(const struct fit *t, double *amplitude)
{
    double a = t->ss[0] - t->s[0] * t->s[0] / t->n, b = t->ss[1] - t->s[0] * t->s[1] / t->n;
    double c = t->ss[2] - t->s[1] * t->s[1] / t->n;
    double p = t->ys[0] - t->y * t->s[0] / t->n, q = t->ys[1] - t->y * t->s[1] / t->n;
    double var = t->yy - t->y * t->y / t->n, det = a * c - b * b;
    *amplitude = 0.0;
    if (!(det > 1e-4 * t->n * t->n) || !(var > 0.0))
        return 0.0; // all of one phase
    double u = (c * p - b * q) / det, v = (a * q - b * p) / det;
    double mean = (t->y - u * t->s[0] - v * t->s[1]) / t->n;
    *amplitude = mean > 0.0 ? hypot(u, v) / mean : 0.0;
    return (u * p + v * q) / var;
}

static double explained(const struct flicker *f, double hz, double readout_s, double time_s,
                        double *amplitude)
{
    struct fit t = {0};
    for (int k = 0; k < f->n_short; k++)
        for (int j = 0; j < WITNESS_EDGE; j++) {
            if (f->places[j] < ROW_PLACES)
                continue;
            double at = f->start_s[k] - f->start_s[0] + readout_s * j / WITNESS_EDGE;
            add(&t, f->row[k][j] / f->even[j] * f->n_long, 2.0 * PI * hz * (at + 0.5 * time_s));
        }
    *amplitude = 0.0;
    return t.n < FIGURES_MIN ? 0.0 : solve(&t, amplitude);
}

void flicker_find(const struct flicker *f, double time_s, double period_s,
                  struct flicker_light *out)
{
    static const double frequency[] = {100.0, 120.0};
    double best = EXPLAINED;
    *out = (struct flicker_light){0};
    for (int i = 0; i < 2 && f->n_long > 0; i++)
        for (int r = 0; r <= READOUTS; r++) {
            double amplitude;
            double share = explained(f, frequency[i], period_s * r / READOUTS, time_s, &amplitude);
            double depth = fmin(amplitude / fabs(sinc(frequency[i] * time_s)), DEPTH_MAX);
            if (share <= best || !(depth >= LEAST_DEPTH))
                continue;
            best = share;
            *out = (struct flicker_light){frequency[i], depth};
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
