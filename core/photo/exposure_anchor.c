#include "core/photo/exposure_anchor.h"

#include <math.h>

enum { PATCHES_MIN = EXPOSURE_PROBE_PATCHES / 200 + 1 }; // 0.5 %: fewer prove nothing

/* The error of the anchor is common to all frames compared with it, so a ratio must be so accurate
 * that SURE standard errors fit into the tolerance after DOUBTED of them are taken off. */
#define SURE 4.0 // standard errors that are not expected to occur
#define ACCURATE (SURE + EXPOSURE_ANCHOR_DOUBTED)
#define TORN 0.1 // stops, beyond errors
#define BENT 0.2 // stops per stop

/* An uncalibrated response bends ratios with the brightness. */
static double tolerance_of_ratio(double tolerance, double ratio)
{
    return tolerance < EXPOSURE_ANCHOR_LOOSE ? 0.0 : BENT * fabs(ratio);
}

/* Whether parts of the picture changed. The spread of few patches is often large, and the noise is
 * estimated from few pixels. */
static bool parts_changed(const struct exposure_probe_ratio *r, double tolerance, double slack)
{
    double lucky = 2.0 * (double)r->noise * (1.0 + SURE / sqrt(fmax(r->patches, 1.0)));
    return r->patches >= PATCHES_MIN && r->spread > 2.0 * tolerance + slack &&
           (double)r->spread > lucky;
}

/* Whether rows side by side differ. */
static bool rows_differ(const struct exposure_probe_ratio *r, double tolerance, double slack)
{
    double most =
        fmin(TORN + tolerance_of_ratio(tolerance, (double)r->log2), 2.0 * tolerance) + slack;
    return r->patches >= PATCHES_MIN && r->band > most;
}

void exposure_anchor_compare(const struct exposure_anchor *a, const struct exposure_probe *w,
                             const struct exposure_anchor_doubt *doubt,
                             struct exposure_anchor_ratio *out)
{
    const double tolerance = doubt->tolerance;
    struct exposure_probe_ratio r;
    exposure_probe_compare(&a->seen, w, doubt->moving, &r);
    const double both = 2.0 * (a->slack + doubt->slack); // rows of both may differ by their slacks
    const double error = hypot(a->error, (double)r.error);
    *out = (struct exposure_anchor_ratio){.changed = parts_changed(&r, tolerance, both),
                                          .torn = rows_differ(&r, tolerance, both),
                                          .accurate = r.patches >= PATCHES_MIN &&
                                                      ACCURATE * error <= tolerance,
                                          .stops = a->stops + r.log2,
                                          .error = error,
                                          .lo = a->stops + r.lo - a->slack,
                                          .hi = a->stops + r.hi + a->slack,
                                          .ratio = r.log2,
                                          .patches = r.patches};
}

bool exposure_anchor_alike(const struct exposure_anchor *a, const struct exposure_probe *w,
                           const struct exposure_anchor_doubt *doubt, float *moved)
{
    const double tolerance = doubt->tolerance, slack = doubt->slack;
    struct exposure_probe_ratio r;
    exposure_probe_compare(&a->seen, w, 0, &r);
    *moved = r.moved;
    return !parts_changed(&r, tolerance, slack) && !rows_differ(&r, tolerance, slack) &&
           (r.patches < PATCHES_MIN ||
            fabs((double)r.log2) <= 0.5 * tolerance + SURE * (double)r.error + slack);
}

void exposure_anchor_refute(const struct exposure_anchor *a, const struct exposure_probe *w,
                            const struct exposure_anchor_pair *pair,
                            const struct exposure_anchor_doubt *doubt,
                            struct exposure_probe_rows *rows)
{
    struct exposure_probe_rows by;
    bool same = fabs(a->recorded - pair->other) <= EXPOSURE_ANCHOR_SAME;
    double at = same ? pair->other : a->stops;
    double r = pair->stops - at, o = pair->other - at;
    double most = tolerance_of_ratio(doubt->tolerance, o) + a->slack + doubt->slack;
    if (fabs(r - o) <= most)
        return;
    const struct exposure_probe_rivals rivals = {r, o + copysign(most, r - o), doubt->moving};
    exposure_probe_refuted(&a->seen, w, &rivals, &by);
    rows->refuted |= by.refuted & a->sure;
    rows->alike |= by.alike & a->sure;
}
