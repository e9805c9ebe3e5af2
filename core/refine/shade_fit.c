/* Linear in stops: log2 of the radiance of a surface in view i less that in view j is, but for
 * noise, what camera i adds at its r^2 less what camera j does. Robust least squares over all
 * terms, then terms are taken away, the least likely first, as long as the left-out squares bear
 * it: so what one term explains is not credited to another. */
#include "core/refine/shade_fit.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/splitmix.h"
#include "core/photo/response.h"
#include "core/stereo/visibility.h"

#include <math.h>
#include <string.h>

enum {
    PAIRS = 240, // ordered pairs of views that are compared at most
    EACH = 800,  // observations of a pair at most
    LEAST = 500, // observations in all
    BLOCKS = 8,  // squares across a view
    HELD_ONE_IN = 3,
    ROUNDS = 6, // of reweighting
    MEAN = 4,   // px, least edge of the square that is averaged
    DARK = 8,   // display values outside are black or saturated
    LIGHT = 247,
    OWN = 6, // v2 v4 v6, gain, balance: red, blue
    PARAMS = OWN * SHADE_FIT_CAMERAS
};

#define SURE 3.0        // standard errors of a gain that is believed
#define GAIN_LEAST 1e-5 // stops^2 of the mean squared error, of a gain that matters
#define PRIOR 0.1       // weight of "no effect", in observations a stop wrong
#define MAD 1.4826
#define DRIFT_PRIOR 0.1  // the same of light: 0.3 stops are expected, and errors of 0.1
#define DRIFT_LEAST 0.03 // stops, root mean square: less may be the curve's error
#define APART 0.25       // stops, exposures that differ
#define BY_EXPOSURE 16.0 // ratio of variances, from which on light is a function of the exposure
#define SMOOTH 0.1f      // weight of observations that the spread is measured with
#define ROUGH 0.1f       // stops across a square, of those that a slight shift changes little

struct observation {
    float r2[2], d[3], w[3]; // of views i and j; log2 radiance in i less that in j; weights
    uint16_t view[2];
    uint8_t camera[2];
    bool held;
    int block; // square of view i
};

struct fit {
    const struct shade_fit_input *in;
    struct visibility visibility;
    struct response_table table;
    struct observation *seen; // (n) of room for `cap`
    int n, cap;
    float *error;  // (3 cap) scratch
    double *gain;  // (views BLOCKS^2) scratch
    double *whole; // (PARAMS^2) normal equations, lower triangle
    double *part;  // (PARAMS^2) of the active ones
    double right[PARAMS], x[PARAMS];
    double *drift, *sum; // (3, n) stops of the views by colour; (n) scratch
    bool active[PARAMS];
    bool drifts, coloured;          // light is fitted, each colour by itself
    struct light_change_seen *left; // (n) what is not explained
    int params;
    double gate; // largest error of an inlier, stops
};

static int pairs_of(int n_views)
{
    return num_min(PAIRS, n_views * (n_views - 1));
}

static err_t layout(struct fit *f, struct arena *tmp, int n_views)
{
    f->cap = pairs_of(n_views) * EACH;
    const size_t cap = (size_t)num_max(f->cap, 1);
    const size_t most = (size_t)num_max(num_min(n_views, SHADE_FIT_PLACES), PARAMS);
    err_t e = visibility_layout(&f->visibility, tmp, n_views);
    if (!e)
        e = arena_alloc(tmp, cap, sizeof *f->seen, &f->seen);
    if (!e)
        e = arena_alloc(tmp, 3 * cap, sizeof *f->error, &f->error);
    if (!e)
        e = arena_alloc(tmp, (size_t)n_views * BLOCKS * BLOCKS, sizeof *f->gain, &f->gain);
    if (!e)
        e = arena_alloc(tmp, (size_t)PARAMS * PARAMS, sizeof *f->whole, &f->whole);
    if (!e)
        e = arena_alloc(tmp, cap, sizeof *f->left, &f->left);
    if (!e)
        e = arena_zalloc(tmp, 3 * (size_t)n_views, sizeof *f->drift, &f->drift);
    if (!e)
        e = arena_alloc(tmp, (size_t)n_views, sizeof *f->sum, &f->sum);
    return e ? e : arena_alloc(tmp, most * most, sizeof *f->part, &f->part);
}

size_t shade_fit_plan(int n_views)
{
    struct arena tmp = arena_counter();
    static const struct fit none;
    struct fit f = none;
    if (layout(&f, &tmp, n_views))
        return SIZE_MAX;
    arena_step(&tmp, light_change_plan(num_min(n_views, LIGHT_CHANGE_VIEWS), f.cap));
    return tmp.peak;
}

/* ---- observations ---- */

/* log2 radiance and weight of the mean of the pixels around px (u, v); weight 0: black, saturated
 * or masked. */
static void sample_at(const struct fit *f, int view, const float uv[2], float x[3], float w[3])
{
    const struct views *v = f->in->v;
    const struct extent *px = &v->extent[view];
    const int size[2] = {px->w, px->h};
    const int n = num_min(num_max(f->in->depth->scale, MEAN), num_min(size[0], size[1]));
    int first[2], sum[3] = {0}, least[3] = {255, 255, 255}, most[3] = {0};
    for (int k = 0; k < 2; k++)
        first[k] = num_max(0, num_min((int)(uv[k] - 0.5f * (float)n + 0.5f), size[k] - n));
    for (int i = 0; i < n * n; i++) {
        const size_t row = (size_t)(first[1] + i / n), column = (size_t)(first[0] + i % n);
        const uint8_t *p = views_rgb(v, view) + 3 * (row * (size_t)px->w + column);
        for (int c = 0; c < 3; c++) {
            sum[c] += p[c];
            least[c] = num_min(least[c], p[c]);
            most[c] = num_max(most[c], p[c]);
        }
    }
    const bool masked = views_hides_any(v, view, first[0], first[1], n);
    for (int c = 0; c < 3; c++) {
        const float mean = (float)sum[c] / (float)(n * n);
        const int z = num_min((int)mean, 254);
        const float *curve = f->table.x[c] + z, share = mean - (float)z;
        x[c] = curve[0] + share * (curve[1] - curve[0]) - views_set_log2t(v, view);
        const float rough = (f->table.x[c][most[c]] - f->table.x[c][least[c]]) / ROUGH;
        w[c] = masked || least[c] < DARK || most[c] > LIGHT
                   ? 0
                   : f->table.weight[c][z] / (1 + rough * rough);
    }
}

static bool is_held(int block)
{
    return splitmix_mix((uint64_t)block + SPLITMIX_STEP) % HELD_ONE_IN == 0;
}

/* The surface at px uv, z deep, of view i in view j. */
static void add_observation(struct fit *f, int i, int j, const float uvz[3])
{
    const struct extent *px = f->in->v->extent;
    struct projected there;
    float point[3], x[2][3], w[2][3];
    visibility_unproject(&f->visibility, i, uvz, point);
    if (!visibility_project(&f->visibility, j, point, &there) ||
        !visibility_on_surface(&f->visibility, &there))
        return;
    const float at[2][2] = {{uvz[0] / (float)px[i].w, uvz[1] / (float)px[i].h},
                            {there.u / (float)px[j].w, there.v / (float)px[j].h}};
    struct observation *s = &f->seen[f->n];
    sample_at(f, i, uvz, x[0], w[0]);
    sample_at(f, j, (const float[2]){there.u, there.v}, x[1], w[1]);
    float any = 0;
    for (int c = 0; c < 3; c++) {
        s->d[c] = x[0][c] - x[1][c];
        s->w[c] = fminf(w[0][c], w[1][c]);
        any += s->w[c];
    }
    if (!(any > 0))
        return;
    for (int k = 0; k < 2; k++) {
        const int view = k ? j : i;
        s->view[k] = (uint16_t)view;
        s->camera[k] = f->in->n_cameras ? (uint8_t)f->in->camera[view] : 0;
        s->r2[k] = f->in->n_cameras ? shade_r2(&f->in->shade[view], at[k][0], at[k][1]) : 0;
    }
    s->block = (i * BLOCKS + num_min((int)(at[0][1] * BLOCKS), BLOCKS - 1)) * BLOCKS +
               num_min((int)(at[0][0] * BLOCKS), BLOCKS - 1);
    s->held = is_held(s->block);
    f->n++;
}

static void compare_views(struct fit *f, int i, int j)
{
    const struct depthmaps *d = f->in->depth;
    const struct extent *map = &d->extent[i];
    const int step = num_max(1, (int)ceil(sqrt((double)map->w * map->h / EACH)));
    const int end = f->n + EACH;
    for (int y = step / 2; y < map->h; y += step)
        for (int x = step / 2; x < map->w && f->n < end; x += step) {
            const size_t k = map->at + (size_t)y * (size_t)map->w + (size_t)x;
            const float uvz[3] = {((float)x + 0.5f) * (float)d->scale,
                                  ((float)y + 0.5f) * (float)d->scale, d->depth[k]};
            if (visibility_confident(&f->visibility, k))
                add_observation(f, i, j, uvz);
        }
}

static err_t collect_observations(const struct run *r, struct fit *f)
{
    const int n = f->in->v->n, all = n * (n - 1);
    const int step = num_max(1, (all + PAIRS - 1) / PAIRS);
    for (int k = 0; k < all; k += step) {
        const int i = k / (n - 1), j = k % (n - 1);
        err_t e = run_check(r, "vignetting");
        if (e)
            return e;
        compare_views(f, i, j + (j >= i));
    }
    return OK;
}

/* ---- least squares ---- */

/* The part of a row of the equations by view 0 or 1, colour c: indices and factors of OWN terms. */
static void add_row(const struct observation *s, int view, int c, int index[OWN],
                    double factor[OWN])
{
    const double sign = view ? -1 : 1, r2 = (double)s->r2[view];
    const double all[OWN] = {
        r2, r2 * r2, r2 * r2 * r2, 1, c == 0 ? 1 : c == 1 ? -1 : 0, c == 2 ? 1 : c == 1 ? -1 : 0};
    for (int k = 0; k < OWN; k++) {
        index[k] = s->camera[view] * OWN + k;
        factor[k] = sign * all[k];
    }
}

/* The difference but for the light of the photographs. */
static double even_difference(const struct fit *f, const struct observation *s, int c)
{
    const double *drift = f->drift + c * f->in->v->n;
    return (double)s->d[c] - drift[s->view[0]] + drift[s->view[1]];
}

static double log_residual(const struct fit *f, const struct observation *s, int c)
{
    int index[OWN];
    double factor[OWN], e = even_difference(f, s, c);
    for (int view = 0; view < 2 && f->params; view++) {
        add_row(s, view, c, index, factor);
        for (int k = 0; k < OWN; k++)
            e -= factor[k] * f->x[index[k]];
    }
    return e;
}

/* One equation, row at index; wd: its weight and its right side. */
static void add_equation(struct fit *f, const int *index, const double *row, int terms,
                         const double wd[2])
{
    const size_t n = (size_t)f->params;
    for (int k = 0; k < terms * terms; k++) {
        const int a = k / terms, b = k % terms;
        if (index[b] <= index[a])
            f->whole[(size_t)index[a] * n + (size_t)index[b]] += wd[0] * row[a] * row[b];
    }
    for (int a = 0; a < terms; a++)
        f->right[index[a]] += wd[0] * row[a] * wd[1];
}

/* With its present error. held: what is left out counts, too. scale: stops. */
static double weight_of(const struct fit *f, int i, bool held, double scale)
{
    const struct observation *s = &f->seen[i / 3];
    if (s->w[i % 3] <= 0 || (s->held && !held))
        return 0;
    const double off = log_residual(f, s, i % 3) / scale, near = 1 / (1 + off * off);
    return (double)s->w[i % 3] * near * near;
}

/* Normal equations with the present weights. */
static void accumulate_normal(struct fit *f, bool held, double scale)
{
    const size_t n = (size_t)f->params;
    memset(f->whole, 0, n * n * sizeof *f->whole);
    memset(f->right, 0, sizeof f->right);
    for (int i = 0; i < 3 * f->n && n; i++) {
        const struct observation *s = &f->seen[i / 3];
        int index[2 * OWN], terms = 2 * OWN;
        double row[2 * OWN];
        const double wd[2] = {weight_of(f, i, held, scale), even_difference(f, s, i % 3)};
        if (!(wd[0] > 0))
            continue;
        add_row(s, 0, i % 3, index, row);
        add_row(s, 1, i % 3, index + OWN, row + OWN);
        for (int a = 0; a < OWN && s->camera[0] == s->camera[1]; a++) {
            row[a] += row[OWN + a];
            terms = OWN;
        }
        add_equation(f, index, row, terms, wd);
    }
}

/* Their solution in the active terms; the others are 0. */
static void solve_step(struct fit *f)
{
    int of[PARAMS], m = 0;
    double x[PARAMS];
    const size_t n = (size_t)f->params;
    for (int k = 0; k < f->params; k++)
        if (f->active[k])
            of[m++] = k;
    for (int a = 0; a < m; a++) {
        x[a] = f->right[of[a]];
        for (int b = 0; b <= a; b++) {
            const bool gauge = of[a] % OWN >= SHADE_TERMS && of[a] % OWN == of[b] % OWN;
            f->part[(size_t)a * (size_t)m + (size_t)b] =
                f->whole[(size_t)of[a] * n + (size_t)of[b]] + (a == b ? PRIOR : 0) +
                (gauge ? f->n : 0);
        }
    }
    memset(f->x, 0, sizeof f->x);
    if (!lin_cholesky(f->part, m))
        return;
    lin_solve(f->part, m, x);
    for (int a = 0; a < m; a++)
        f->x[of[a]] = x[a];
}

/* Median of the absolute errors, as a standard deviation. */
static double residual_spread(struct fit *f)
{
    size_t n = 0;
    for (int i = 0; i < 3 * f->n; i++)
        if (f->seen[i / 3].w[i % 3] > SMOOTH)
            f->error[n++] = (float)fabs(log_residual(f, &f->seen[i / 3], i % 3));
    return fmax(MAD * (double)num_median(f->error, n), 1e-3);
}

/* Mean drift of the n photographs at the exposure of view i. */
static double mean_of_exposure(const struct fit *f, const double *drift, int i, int *n)
{
    const struct views *v = f->in->v;
    double sum = 0;
    *n = 0;
    for (int k = 0; k < v->n; k++)
        if (fabsf(views_set_log2t(v, k) - views_set_log2t(v, i)) < (float)APART) {
            sum += drift[k];
            (*n)++;
        }
    return sum / *n;
}

/* Takes the means of the exposures away where these differ by far more than photographs of one
 * exposure let expect (analysis of variance): lamps and clouds do not know how long a camera
 * exposes, but its image processor does. */
static void level_exposures(struct fit *f, double *drift)
{
    const int n = f->in->v->n;
    double between = 0, within = 0, exposures = 0;
    for (int i = 0; i < n; i++) {
        int same;
        f->sum[i] = mean_of_exposure(f, drift, i, &same);
        between += f->sum[i] * f->sum[i];
        within += (drift[i] - f->sum[i]) * (drift[i] - f->sum[i]);
        exposures += 1.0 / same;
    }
    const double free[2] = {exposures - 2, n - exposures}; // mean and trend are gone
    if (free[0] < 0.5 || free[1] < 0.5 || between * free[1] <= BY_EXPOSURE * within * free[0])
        return;
    for (int i = 0; i < n; i++)
        drift[i] -= f->sum[i];
}

/* Into the gauge. */
static void centre_drift(struct fit *f, double *drift)
{
    const struct views *v = f->in->v;
    double mean = 0, middle = 0, xx = 0, xy = 0;
    for (int i = 0; i < v->n; i++) {
        mean += drift[i] / v->n;
        middle += (double)views_set_log2t(v, i) / v->n;
    }
    for (int i = 0; i < v->n; i++) {
        const double x = (double)views_set_log2t(v, i) - middle;
        xx += x * x;
        xy += x * drift[i];
    }
    const double slope = !f->in->tone_known && response_is_told(v) ? xy / xx : 0;
    for (int i = 0; i < v->n; i++) {
        const double x = (double)views_set_log2t(v, i) - middle;
        drift[i] -= mean + slope * x;
    }
    if (!f->in->tone_known)
        level_exposures(f, drift);
}

static void bound_drift(struct fit *f, struct shade_fit_drift *out)
{
    const int n = f->in->v->n;
    for (int i = 0; i < 3 * n; i++)
        f->drift[i] = fmin(fmax(f->drift[i], -SHADE_FIT_DRIFT_MOST), SHADE_FIT_DRIFT_MOST);
    for (int i = 0; i < n; i++) {
        const double *drift = f->drift + i;
        const double mean = f->coloured ? (drift[0] + drift[n] + drift[2 * n]) / 3 : drift[0];
        out->stops[i] = (float)mean;
        for (int c = 0; c < 3 && out->balance; c++)
            out->balance[i][c] = (float)(drift[c * n] - mean);
    }
}

/* The light of each photograph in a colour, in all alike if it is -1, the other terms as they
 * are. */
static void fit_colour(struct fit *f, int colour, bool held, double scale)
{
    const size_t n = (size_t)f->in->v->n;
    const int first = colour < 0 ? 0 : colour, end = colour < 0 ? 3 : colour + 1;
    double *x = f->sum;
    memset(f->part, 0, n * n * sizeof *f->part);
    memset(x, 0, n * sizeof *x);
    for (int i = 0; i < (end - first) * f->n; i++) {
        const int at = i / (end - first), c = first + i % (end - first);
        const struct observation *s = &f->seen[at];
        const double w = weight_of(f, 3 * at + c, held, scale);
        const size_t a = s->view[0], b = s->view[1];
        const double *drift = f->drift + (size_t)c * n;
        const double d = log_residual(f, s, c) + drift[a] - drift[b];
        f->part[a * n + a] += w;
        f->part[b * n + b] += w;
        f->part[a > b ? a * n + b : b * n + a] -= w;
        x[a] += w * d;
        x[b] -= w * d;
    }
    for (size_t a = 0; a < n; a++)
        for (size_t b = 0; b <= a; b++)
            f->part[a * n + b] += (a == b ? DRIFT_PRIOR : 0) + f->n;
    if (!lin_cholesky(f->part, (int)n))
        return;
    lin_solve(f->part, (int)n, x);
    double *drift = f->drift + (size_t)first * n;
    memcpy(drift, x, n * sizeof *x);
    centre_drift(f, drift);
    for (int c = first + 1; c < end; c++)
        memcpy(f->drift + (size_t)c * n, drift, n * sizeof *drift);
}

static void fit_drift(struct fit *f, bool held, double scale)
{
    if (!f->coloured)
        fit_colour(f, -1, held, scale);
    for (int c = 0; c < 3 && f->coloured; c++)
        fit_colour(f, c, held, scale);
}

static void fit_terms(struct fit *f, bool held)
{
    for (int k = 0; k < ROUNDS; k++) {
        double scale = 2 * residual_spread(f);
        if (f->drifts) // at first all photographs count, also one in much brighter light
            scale = fmax(scale, ldexp(SHADE_FIT_DRIFT_MOST, -k));
        accumulate_normal(f, held, scale);
        solve_step(f);
        if (f->drifts)
            fit_drift(f, held, scale);
    }
}

/* ---- judgement ---- */

static double truncated_loss(const struct fit *f, const struct observation *s, int c)
{
    const double e = log_residual(f, s, c);
    return fmin(e * e, f->gate * f->gate);
}

static bool is_of_camera(const struct observation *s, int camera)
{
    return camera < 0 || s->camera[0] == camera || s->camera[1] == camera;
}

/* Mean squared left-out error of a camera, of all if it is -1. */
static double held_error(const struct fit *f, int camera, int *count)
{
    double sum = 0, weight = 0;
    *count = 0;
    for (int i = 0; i < 3 * f->n; i++) {
        const struct observation *s = &f->seen[i / 3];
        if (!s->held || s->w[i % 3] <= 0 || !is_of_camera(s, camera))
            continue;
        sum += (double)s->w[i % 3] * truncated_loss(f, s, i % 3);
        weight += (double)s->w[i % 3];
        ++*count;
    }
    return weight > 0 ? sum / weight : 0;
}

/* Add the left-out errors of the present solution, times sign, to the squares they are in. */
static void add_errors(struct fit *f, int camera, double sign)
{
    for (int i = 0; i < 3 * f->n; i++) {
        const struct observation *s = &f->seen[i / 3];
        if (s->held && s->w[i % 3] > 0 && is_of_camera(s, camera))
            f->gain[s->block] += sign * (double)s->w[i % 3] * truncated_loss(f, s, i % 3);
    }
}

/* Whether the errors that were added say that something is needed; the squares are what varies. */
static bool is_clear(const struct fit *f, int camera)
{
    const int blocks = f->in->v->n * BLOCKS * BLOCKS;
    double sum = 0, square = 0, all = 0;
    for (int i = 0; i < 3 * f->n; i++) {
        const struct observation *s = &f->seen[i / 3];
        if (s->held && s->w[i % 3] > 0 && is_of_camera(s, camera))
            all += (double)s->w[i % 3];
    }
    for (int b = 0; b < blocks; b++) {
        sum += f->gain[b];
        square += f->gain[b] * f->gain[b];
    }
    return sum > SURE * sqrt(square) && sum > GAIN_LEAST * all;
}

static void clear_errors(struct fit *f)
{
    memset(f->gain, 0, (size_t)(f->in->v->n * BLOCKS * BLOCKS) * sizeof *f->gain);
}

/* Whether the solution without some terms is clearly worse than the one with them. */
static bool is_needed(struct fit *f, int camera, const bool without[PARAMS], double *error)
{
    bool with[PARAMS];
    int count;
    memcpy(with, f->active, sizeof with);
    clear_errors(f);
    solve_step(f);
    add_errors(f, camera, -1);
    memcpy(f->active, without, sizeof with);
    solve_step(f);
    add_errors(f, camera, 1);
    *error = sqrt(held_error(f, camera, &count));
    memcpy(f->active, with, sizeof with);
    return is_clear(f, camera);
}

/* Fit all terms with the light of the photographs as `out` says it is. */
static void fit_with(struct fit *f, const struct shade_fit_drift *out)
{
    const int n = f->in->v->n;
    f->drifts = out->kept;
    f->coloured = out->coloured;
    for (int i = 0; i < 3 * n; i++)
        f->drift[i] = out->kept ? (double)out->stops[i % n] : 0;
    fit_terms(f, false);
}

/* Fit all terms with a white balance of each photograph, or without where that does as well. */
static void choose_balance(struct fit *f, struct shade_fit_drift *out)
{
    const int n = f->in->v->n;
    double square = 0;
    clear_errors(f);
    add_errors(f, -1, 1);
    out->error_grey = sqrt(held_error(f, -1, &out->held));
    const struct shade_fit_drift grey = *out;
    out->kept = out->coloured = true;
    fit_with(f, out);
    add_errors(f, -1, -1);
    bound_drift(f, out);
    for (int i = 0; i < 3 * n; i++)
        square += pow((double)out->balance[i / 3][i % 3], 2) / 3;
    out->error = sqrt(held_error(f, -1, &out->held));
    if (is_clear(f, -1) && square > n * DRIFT_LEAST * DRIFT_LEAST)
        return;
    *out = grey;
    fit_with(f, out);
}

/* Fit all terms with the light of the photographs, or without it where that does as well. */
static void choose_drift(struct fit *f, struct shade_fit_drift *out)
{
    const int n = f->in->v->n;
    double square = 0;
    f->drifts = true;
    fit_terms(f, false);
    bound_drift(f, out);
    f->gate = 3 * residual_spread(f);
    out->error = sqrt(held_error(f, -1, &out->held));
    clear_errors(f);
    add_errors(f, -1, -1);
    for (int i = 0; i < n; i++)
        square += f->drift[i] * f->drift[i];
    f->drifts = false;
    memset(f->drift, 0, 3 * (size_t)n * sizeof *f->drift);
    memset(f->x, 0, sizeof f->x);
    fit_terms(f, false);
    add_errors(f, -1, 1);
    out->error_before = sqrt(held_error(f, -1, &out->held));
    out->kept = is_clear(f, -1) && square > n * DRIFT_LEAST * DRIFT_LEAST;
    if (out->kept)
        fit_with(f, out);
    if (out->balance)
        choose_balance(f, out);
}

/* Take a term away, of one camera or of all (-1), if it is not needed. */
static void try_without(struct fit *f, enum shade_fit_kind kind, int camera,
                        struct shade_fit_camera *out)
{
    static const int first[SHADE_FIT_KINDS] = {0, 1, 2, 3, 4},
                     count[SHADE_FIT_KINDS] = {1, 1, 1, 1, 2};
    const int from = camera < 0 ? 0 : camera, to = camera < 0 ? f->in->n_cameras : camera + 1;
    bool without[PARAMS];
    double error;
    memcpy(without, f->active, sizeof without);
    for (int k = from; k < to; k++)
        for (int i = 0; i < count[kind]; i++)
            without[k * OWN + first[kind] + i] = false;
    const bool needed = is_needed(f, camera, without, &error);
    if (!needed)
        memcpy(f->active, without, sizeof without);
    for (int k = from; k < to; k++) {
        out[k].kept[kind] = needed;
        out[k].without[kind] = error;
    }
}

/* From the last term of each ladder to the first. */
static void eliminate_terms(struct fit *f, struct shade_fit_camera *out)
{
    if (f->in->n_cameras > 1) {
        try_without(f, SHADE_FIT_BALANCE, -1, out);
        try_without(f, SHADE_FIT_GAIN, -1, out);
    }
    for (int kind = SHADE_FIT_V6; kind >= SHADE_FIT_V2; kind--)
        for (int k = 0; k < f->in->n_cameras; k++)
            if (kind == SHADE_FIT_V6 || !out[k].kept[kind + 1])
                try_without(f, (enum shade_fit_kind)kind, k, out);
            else
                out[k].kept[kind] = true;
}

static void take_models(const struct fit *f, struct shade_fit_camera *out)
{
    for (int k = 0; k < f->in->n_cameras; k++) {
        const double *x = f->x + (size_t)k * OWN;
        struct shade_model *m = &out[k].model;
        memcpy(m->term, x, sizeof m->term);
        m->gain[0] = x[3] + x[4];
        m->gain[1] = x[3] - x[4] - x[5];
        m->gain[2] = x[3] + x[5];
    }
}

static void choose_terms(struct fit *f, struct shade_fit_camera *out, struct shade_fit_drift *drift)
{
    const int cameras = f->in->n_cameras;
    f->params = OWN * cameras;
    for (int k = 0; k < f->params; k++)
        f->active[k] = cameras > 1 || k < SHADE_TERMS;
    if (f->in->v->n <= SHADE_FIT_PLACES)
        choose_drift(f, drift);
    else
        fit_terms(f, false);
    const double scale = residual_spread(f);
    f->gate = 3 * scale;
    accumulate_normal(f, false, 2 * scale);
    eliminate_terms(f, out);
    memset(f->x, 0, sizeof f->x);
    for (int k = 0; k < cameras; k++)
        out[k].error_before = sqrt(held_error(f, k, &out[k].held));
    solve_step(f);
    for (int k = 0; k < cameras; k++)
        out[k].error = sqrt(held_error(f, k, &out[k].held));
    fit_terms(f, true);
    take_models(f, out);
    bound_drift(f, drift);
}

/* Whether what is left of the differences, the mean of the colours, has two states. */
static err_t find_change(struct fit *f, struct arena *tmp, struct light_change *out)
{
    const struct views *v = f->in->v;
    float *set = f->error; // not needed any more
    const struct light_change_input in = {
        v->n, f->left, f->n, v->cams, f->in->tone_known ? NULL : set, f->in->camera};
    for (int i = 0; i < v->n; i++)
        set[i] = views_set_log2t(v, i);
    for (int i = 0; i < f->n; i++) {
        const struct observation *s = &f->seen[i];
        double sum = 0;
        int n = 0;
        for (int c = 0; c < 3; c++) {
            sum += s->w[c] > 0 ? log_residual(f, s, c) : 0;
            n += s->w[c] > 0;
        }
        f->left[i] = (struct light_change_seen){
            {s->view[0], s->view[1]}, (uint16_t)(s->block % (BLOCKS * BLOCKS)), (float)(sum / n)};
    }
    return light_change_find(&in, tmp, out);
}

err_t shade_fit_run(const struct run *r, const struct shade_fit_input *in,
                    struct shade_fit_camera *out, struct shade_fit_drift *drift,
                    struct light_change *change)
{
    struct fit f = {.in = in};
    const size_t mark = arena_mark(r->tmp);
    memset(out, 0, (size_t)in->n_cameras * sizeof *out);
    memset(drift->stops, 0, (size_t)in->v->n * sizeof *drift->stops);
    *drift = (struct shade_fit_drift){.stops = drift->stops, .balance = drift->balance};
    if (drift->balance)
        memset(drift->balance, 0, (size_t)in->v->n * sizeof *drift->balance);
    memset(change->other, 0, (size_t)in->v->n * sizeof *change->other);
    *change = (struct light_change){.other = change->other};
    err_t e = layout(&f, r->tmp, in->v->n);
    if (!e) {
        visibility_set(&f.visibility, in->depth, in->v->cams);
        response_tabulate(in->tone, &f.table);
        e = collect_observations(r, &f);
    }
    if (!e && f.n >= LEAST)
        choose_terms(&f, out, drift);
    if (!e && f.n >= LEAST && in->v->n <= LIGHT_CHANGE_VIEWS)
        e = find_change(&f, r->tmp, change);
    arena_reset(r->tmp, mark);
    return e;
}
