/* Seen well means FIGURES_DARK <= brightest colour < FIGURES_CLIPPED. What another exposure would
 * show of a pixel that is seen well follows from the tone curve D: display value z becomes
 * D(D^-1(z) + d), d stops longer; a table per exposure and colour.
 * The tone curve is compared with families of core/photo/response_family.h. Radiance has no scale
 * of its own and the white balance lies in it, so each colour is moved along the exposure axis to
 * where the family fits best (search in steps of half a stop, then by golden section); the distance
 * is the rms of the display values over the exposures where the curve is between 2 and 98 %. */
#include "firmware/recon/figures.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/photo/metrics.h"
#include "core/photo/response.h"
#include "core/photo/response_family.h"
#include "core/sfm/similarity.h"

#include <math.h>
#include <string.h>

static const double MERGE = 0.1; // stops, at least

/* ---- photographs ---- */

struct codes { // display values at another exposure
    uint8_t z[3][256];
};

static int photographs_used(const struct views *v)
{
    return v->n + v->n_more;
}

static bool seen_well(int brightest)
{
    return brightest >= FIGURES_DARK && brightest < FIGURES_CLIPPED;
}

static int brightest_channel(const uint8_t *rgb)
{
    int m = rgb[0] > rgb[1] ? rgb[0] : rgb[1];
    return m > rgb[2] ? m : rgb[2];
}

static bool seen_elsewhere(const uint8_t *rgb, const struct codes *other, int n)
{
    for (int k = 0; k < n; k++) {
        const uint8_t z[3] = {other[k].z[0][rgb[0]], other[k].z[1][rgb[1]], other[k].z[2][rgb[2]]};
        if (seen_well(brightest_channel(z)))
            return true;
    }
    return false;
}

/* The smallest exposure of the set that is more than `apart` above `last`; infinite if there is
 * none. */
static double next_exposure(const struct views *v, double last, double apart)
{
    double next = INFINITY;
    for (int i = 0; i < photographs_used(v); i++)
        if ((double)views_set_log2t(v, i) > last + apart && (double)views_set_log2t(v, i) < next)
            next = (double)views_set_log2t(v, i);
    return next;
}

/* Stops within which exposures are one, so that all find room. */
static double exposure_tolerance(const struct views *v)
{
    double lo = INFINITY, hi = -INFINITY;
    for (int i = 0; i < photographs_used(v); i++) {
        lo = fmin(lo, (double)views_set_log2t(v, i));
        hi = fmax(hi, (double)views_set_log2t(v, i));
    }
    return fmax(MERGE, (hi - lo) / (FIGURES_EXPOSURES - 1));
}

void figures_init(struct figures *f, const struct views *v, const struct tonemap *tone)
{
    f->v = v;
    f->tone = tone;
    f->n = 0;
    response_tabulate(tone, &f->table);
    const double merge = exposure_tolerance(v);
    for (double t = next_exposure(v, -INFINITY, merge); f->n < FIGURES_EXPOSURES && isfinite(t);
         t = next_exposure(v, t, merge)) {
        double stops = t - (double)tone->mid_log2t;
        struct figures_exposure *e = &f->exposure[f->n++];
        *e = (struct figures_exposure){.log2t = t, .stops = stops, .from = -stops, .to = -stops};
        for (int c = 0; c < 3; c++) {
            e->from += (double)f->table.x[c][FIGURES_DARK] / 3;
            e->to += (double)f->table.x[c][FIGURES_CLIPPED - 1] / 3;
        }
    }
}

/* The nearest one to that of photograph i. */
static int exposure_of(const struct figures *f, int i)
{
    int best = 0;
    for (int k = 1; k < f->n; k++)
        if (fabs(f->exposure[k].log2t - (double)views_set_log2t(f->v, i)) <
            fabs(f->exposure[best].log2t - (double)views_set_log2t(f->v, i)))
            best = k;
    return best;
}

/* Tables of all exposures but `own`. */
static void expose_others(const struct figures *f, int own, struct codes *out)
{
    for (int k = 0; k < f->n; k++) {
        float stops = (float)(f->exposure[k].log2t - f->exposure[own].log2t);
        for (int i = 0; i < 3 * 256 && k != own; i++) {
            float x = f->table.x[i / 256][i % 256] + stops;
            out->z[i / 256][i % 256] = (uint8_t)lrintf(255 * response_display(f->tone, i / 256, x));
        }
        out += k != own;
    }
}

static void add_figure(struct figures_exposure *e, const struct figures_input *in)
{
    e->n++;
    e->clipped += (in->clipped - e->clipped) / e->n;
    e->dark += (in->dark - e->dark) / e->n;
    e->alone += (in->alone - e->alone) / e->n;
}

void figures_input(struct figures *f, int i, struct figures_input *out)
{
    const size_t n = extent_pixels(&f->v->extent[i]);
    const uint8_t *rgb = views_rgb(f->v, i);
    struct codes other[FIGURES_EXPOSURES];
    int own = exposure_of(f, i);
    size_t clipped = 0, dark = 0, alone = 0;
    memset(out, 0, sizeof *out);
    expose_others(f, own, other);
    for (size_t p = 0; p < n; p++, rgb += 3) {
        int m = brightest_channel(rgb);
        for (int c = 0; c < 3; c++)
            out->histogram[c][rgb[c] * FIGURES_BINS / 256]++;
        clipped += m >= FIGURES_CLIPPED;
        dark += m < FIGURES_DARK;
        alone += seen_well(m) && !seen_elsewhere(rgb, other, f->n - 1);
    }
    out->clipped = (double)clipped / (double)n;
    out->dark = (double)dark / (double)n;
    out->alone = (double)alone / (double)n;
    add_figure(&f->exposure[own], out);
}

#define BLACK_BRIGHT 1e-4    // most pixels of a black photograph that are not dark
#define SATURATED_BELOW 1e-2 // most pixels of a saturated one that are not clipped

const char *figures_blank(const struct views *v, int i)
{
    const size_t n = extent_pixels(&v->extent[i]);
    const uint8_t *rgb = views_rgb(v, i);
    size_t clipped = 0, dark = 0;
    for (size_t p = 0; p < n; p++, rgb += 3) {
        int m = brightest_channel(rgb);
        clipped += m >= FIGURES_CLIPPED;
        dark += m < FIGURES_DARK;
    }
    return (double)(n - dark) <= BLACK_BRIGHT * (double)n         ? "black"
           : (double)(n - clipped) <= SATURATED_BELOW * (double)n ? "saturated"
                                                                  : NULL;
}

int figures_copied(const struct views *v, int i)
{
    const struct extent *own = &v->extent[i];
    for (int k = 0; k < i; k++)
        if (v->extent[k].w == own->w && v->extent[k].h == own->h &&
            memcmp(views_rgb(v, k), views_rgb(v, i), 3 * extent_pixels(own)) == 0)
            return figures_blank(v, i) ? -1 : k;
    return -1;
}

/* ---- report ---- */

static void report_camera(const struct camera *cam, struct report *rep)
{
    const double w = cam->q[0], x = cam->q[1], y = cam->q[2], z = cam->q[3];
    const double up[3] = {-2 * (x * y + w * z), 2 * (x * x + z * z) - 1, -2 * (y * z - w * x)};
    const double forward[3] = {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
    double centre[3];
    rotation_centre(cam, centre);
    report_open(rep, "camera", '{');
    report_row(rep, "centre", centre, 3);
    report_row(rep, "forward", forward, 3);
    report_row(rep, "up", up, 3);
    report_number(rep, "focal_px", (double)cam->fx);
    report_number(rep, "fov_deg", 2 * atan2(cam->w / 2.0, (double)cam->fx) * 180 / NUM_PI);
    report_close(rep);
}

static void report_input(const struct job_result *j, int i, const struct figures_input *in,
                         struct report *rep)
{
    static const char *const colour[3] = {"red", "green", "blue"};
    const struct views *v = &j->views;
    const struct camera *cams = j->measured_only ? v->cams : j->scene.cams; // refined, if they were
    double row[FIGURES_BINS];
    report_open(rep, NULL, '{');
    report_text(rep, "name", v->names[i]);
    report_int(rep, "place", i < v->n ? i : v->place[i - v->n]);
    report_number(rep, "exposure_log2", (double)views_set_log2t(v, i));
    report_number(rep, "stops", (double)(v->log2t[i] - j->scene.tone.mid_log2t));
    if (v->drift)
        report_number(rep, "light_stops", (double)v->drift[i]);
    if (j->drift.coloured)
        report_row(rep, "gain_stops", v->shade[i < v->n ? i : v->place[i - v->n]].model.gain, 3);
    if (j->n_other_light > 0 && j->other_light[i < v->n ? i : v->place[i - v->n]])
        report_bool(rep, "other_light", true);
    report_number(rep, "clipped", in->clipped);
    report_number(rep, "dark", in->dark);
    report_number(rep, "alone", in->alone);
    const struct job_left_out left_out = job_result_left_out(j, i, NULL);
    if (left_out.masked > 0)
        report_number(rep, "masked", left_out.masked);
    if (left_out.moved > 0)
        report_number(rep, "moved", left_out.moved);
    report_number(rep, "psnr", j->input_db ? (double)j->input_db[i] : NAN);
    report_camera(&cams[i < v->n ? i : v->place[i - v->n]], rep);
    report_open(rep, "histogram", '{');
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < FIGURES_BINS; k++)
            row[k] = in->histogram[c][k];
        report_row(rep, colour[c], row, FIGURES_BINS);
    }
    report_close(rep);
    report_close(rep);
}

static void report_exposures(const struct figures *f, struct report *rep)
{
    report_open(rep, "exposures", '[');
    for (int k = 0; k < f->n; k++) {
        const struct figures_exposure *e = &f->exposure[k];
        report_open(rep, NULL, '{');
        report_number(rep, "exposure_log2", e->log2t);
        report_number(rep, "stops", e->stops);
        report_int(rep, "views", e->n);
        report_number(rep, "clipped", e->clipped);
        report_number(rep, "dark", e->dark);
        report_number(rep, "alone", e->alone);
        report_row(rep, "radiance_stops", (const double[]){e->from, e->to}, 2);
        report_close(rep);
    }
    report_close(rep);
}

static void report_photographs(const struct job_result *j, struct report *rep)
{
    struct figures f;
    struct figures_input in;
    figures_init(&f, &j->views, &j->scene.tone);
    report_open(rep, "inputs", '[');
    for (int i = 0; i < photographs_used(&j->views); i++) {
        figures_input(&f, i, &in);
        report_input(j, i, &in, rep);
    }
    report_close(rep);
    if (j->views.srgb)
        report_bool(rep, "response_known", true);
    report_exposures(&f, rep);
}

/* ---- tone curve ---- */

enum { SAMPLES = 73 };

static double stops_of_sample(int k) // stops from the middle exposure
{
    return -12 + 0.25 * k;
}

struct fit {
    const double *curve; // (SAMPLES) of one colour
    enum response_family family;
};

/* Mean square of the distance to the family, moved by `shift` stops; NAN if the curve has no part
 * between black and white. */
static double distance(const struct fit *f, double shift)
{
    double sum = 0;
    int n = 0;
    for (int k = 0; k < SAMPLES; k++) {
        if (!(f->curve[k] > 0.02 && f->curve[k] < 0.98))
            continue;
        double d =
            f->curve[k] - response_family_display(f->family, response_family_usual(f->family),
                                                  stops_of_sample(k) + shift);
        sum += d * d;
        n++;
    }
    return n > 0 ? sum / n : NAN;
}

/* Where the family is nearest: stops to add to the exposure. */
static double best_shift(const struct fit *f)
{
    const double golden = 0.6180339887;
    double best = 0, a, b;
    for (double s = -16; s <= 16; s += 0.5)
        if (distance(f, s) < distance(f, best))
            best = s;
    for (a = best - 0.5, b = best + 0.5; b - a > 1e-3;) {
        double p = b - golden * (b - a), q = a + golden * (b - a);
        if (distance(f, p) < distance(f, q))
            b = q;
        else
            a = p;
    }
    return (a + b) / 2;
}

/* Member of "families"; returns the rms over the colours. */
static double report_family(double curve[3][SAMPLES], enum response_family family,
                            struct report *rep)
{
    double square = 0, shift = 0, row[SAMPLES];
    for (int c = 0; c < 3; c++) {
        struct fit f = {curve[c], family};
        double s = best_shift(&f);
        square += distance(&f, s) / 3;
        shift += s / 3;
    }
    for (int k = 0; k < SAMPLES; k++)
        row[k] = response_family_display(family, response_family_usual(family),
                                         stops_of_sample(k) + shift);
    report_open(rep, NULL, '{');
    report_text(rep, "name", response_family_name(family));
    if (response_family_usual(family) > 0)
        report_number(rep, "parameter", response_family_usual(family));
    report_number(rep, "rms", sqrt(square));
    report_row(rep, "display", row, SAMPLES);
    report_close(rep);
    return sqrt(square);
}

static void report_tone(const struct tonemap *tone, struct report *rep)
{
    static const char *const colour[3] = {"red", "green", "blue"};
    double x[SAMPLES], curve[3][SAMPLES], best = INFINITY;
    const char *name = NULL;
    for (int k = 0; k < SAMPLES; k++) {
        x[k] = stops_of_sample(k);
        for (int c = 0; c < 3; c++)
            curve[c][k] = (double)response_display(tone, c, (float)x[k]);
    }
    report_open(rep, "tone", '{');
    report_row(rep, "stops", x, SAMPLES);
    for (int c = 0; c < 3; c++)
        report_row(rep, colour[c], curve[c], SAMPLES);
    report_open(rep, "families", '[');
    for (int f = 0; f < RESPONSE_FAMILIES; f++) {
        double rms = report_family(curve, (enum response_family)f, rep);
        if (rms < best) {
            best = rms;
            name = response_family_name((enum response_family)f);
        }
    }
    report_close(rep);
    report_text(rep, "nearest", name);
    report_close(rep);
}

void figures_report(const struct job_result *j, struct report *rep)
{
    if (j->views.n > 0)
        report_photographs(j, rep);
    report_tone(&j->scene.tone, rep);
}

/* ---- warnings ---- */

static void warn_exposures(const struct figures *f, struct job_result *j)
{
    const struct figures_exposure *e = f->exposure, *last = &e[f->n - 1];
    if (f->n == 1 || !response_is_told(&j->views))
        job_result_warn(
            j,
            "all photographs have %s exposure: %snothing is known of what is clipped or dark; "
            "take them at exposures 2 to 4 stops apart",
            f->n == 1 ? "one" : "nearly one",
            j->views.srgb ? "" : "the tone curve is a guess, and ");
    for (int k = 0; k + 1 < f->n; k++)
        if (e[k].from > e[k + 1].to)
            job_result_warn(
                j,
                "exposures %+.1f and %+.1f stops lie too far apart: the %.1f stops of radiance "
                "between them are seen well in neither; add one in between",
                e[k].stops, e[k + 1].stops, e[k].from - e[k + 1].to);
    if (e[0].clipped > 0.01)
        job_result_warn(
            j,
            "%.0f %% of the pixels are clipped even at the shortest exposure: lamps and "
            "highlights are brighter than the scene shows; add a shorter exposure",
            100 * e[0].clipped);
    if (last->dark > 0.05)
        job_result_warn(
            j,
            "%.0f %% of the pixels are dark even at the longest exposure: little is known of "
            "the shadows; add a longer exposure or light",
            100 * last->dark);
}

/* Photographs that show nothing, or nothing new. */
static void warn_empty(struct job_result *j)
{
    const struct views *v = &j->views;
    int copies = 0, copy = 0;
    for (int i = 0; i < photographs_used(v); i++) {
        const char *blank = figures_blank(v, i);
        if (blank)
            job_result_warn(
                j, "%s is %s all over and shows nothing: take it at a %s exposure, or leave it out",
                v->names[i], blank, *blank == 'b' ? "longer" : "shorter");
        if (figures_copied(v, i) < 0)
            continue;
        copy = i;
        copies++;
    }
    if (copies)
        job_result_warn(
            j,
            "%d of %d photographs are copies of others (%s is %s): they show nothing new; take "
            "each from another place or at another exposure",
            copies, photographs_used(v), v->names[copy], v->names[figures_copied(v, copy)]);
}

/* A view that fits far worse than usual. */
static void warn_views(struct job_result *j)
{
    double median;
    int n = photographs_used(&j->views);
    if (!j->input_db || n < 3 || metrics_quantile(j->input_db, (size_t)n, 0.5, &median) != OK)
        return;
    for (int i = 0; i < n; i++)
        if ((double)j->input_db[i] < median - 8 && j->input_db[i] < 22 &&
            !figures_blank(&j->views, i))
            job_result_warn(
                j,
                "%s fits the scene %.0f dB worse than the others: something moved, it shows what "
                "no other shows, or its exposure is wrong; take it again",
                j->views.names[i], median - (double)j->input_db[i]);
}

void figures_warn(struct job_result *j)
{
    struct figures f;
    struct figures_input in;
    if (j->views.n == 0)
        return;
    figures_init(&f, &j->views, &j->scene.tone);
    for (int i = 0; i < photographs_used(&j->views); i++)
        figures_input(&f, i, &in);
    warn_exposures(&f, j);
    warn_empty(j);
    warn_views(j);
}
