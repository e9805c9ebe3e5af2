/* Bends: the sum over all pairs of the scores of their best epipolar geometry is climbed, one lens
 * at a time and all together, from the best of two starts: one bend for all lenses; and for each
 * lens the bend that explains the matches among its own views, which says how strong it is, while
 * two different lenses also agree when both are wrong. Focal lengths: the same climb for what
 * the pairs' essential matrices explain. Views that look at one point say little of focal lengths
 * (Sturm, "On focal length calibration from two views", 2001); then all explain the same that have
 * the right ratios, and those nearest to what was expected win. */
#include "core/sfm/division.h"

#include "core/sfm/twoview.h"

#include <math.h>
#include <string.h>

enum {
    DRAWS = 200,       // samples of a geometry
    CLIMB_DRAWS = 60,  // the same, where one of about these bends is known
    TRIES = 6,         // steps from the bends found to none, on which straight ones are scored
    PAIR_MATCHES = 24, // of a pair that tells
    LENS_PAIRS = 16,   // of a lens, the best ones, that are looked at
    CLIMBS = 4,        // passes over all lenses with one step
    SIDES = 200        // points of a lens along its frame
};

#define GAIN 0.04        // share of the score that distortion must bring
#define GAIN_LEAST 15    // matches, the same
#define EXPECTED 4.0     // matches, for a focal length e times as long as expected
#define PLANE_LEAST 0.05 // of the third coordinate, farther out a ray is taken to be there
#define WIDEST_COS 0.454 // of 63 degrees: corners beyond are those of a fisheye
#define FIT_COS 0.087    // of 85 degrees, up to which a fisheye is fitted

/* Bends of a frame of 1, and focal lengths over what is expected, that are tried first. */
static const double BENDS[] = {-1.6, -1.1, -0.8, -0.55, -0.35, -0.2, -0.1, 0, 0.1, 0.2};
static const double FOCALS[] = {0.3, 0.45, 0.65, 1, 1.5, 2.2};
static const double BEND_STEPS[] = {0.16, 0.08, 0.04}, FOCAL_STEPS[] = {0.24, 0.12, 0.06};

struct division {
    const struct run *r;
    const struct division_views *v;
    struct division_lens *lens;   // (n_lenses) that are scored
    bool *moved;                  // (n_lenses) since the scores that are kept
    int *pairs;                   // (n_lenses) that are used
    double *score, *kept;         // (n_pairs)
    double (*f)[9], (*kept_f)[9]; // (n_pairs) geometries of the present bends
    bool *used;                   // (n_pairs)
    bool focals;                  // what is scored
    int draws;                    // samples of a geometry
    int own;                      // only pairs within this lens; -1: all
};

static err_t layout(struct division *d, struct arena *tmp, int n_lenses, int n_pairs)
{
    err_t e = arena_zalloc(tmp, (size_t)n_lenses, sizeof *d->lens, &d->lens);
    if (!e)
        e = arena_zalloc(tmp, (size_t)n_lenses, sizeof *d->moved, &d->moved);
    if (!e)
        e = arena_zalloc(tmp, (size_t)n_lenses, sizeof *d->pairs, &d->pairs);
    if (!e)
        e = arena_zalloc(tmp, (size_t)n_pairs, sizeof *d->score, &d->score);
    if (!e)
        e = arena_zalloc(tmp, (size_t)n_pairs, sizeof *d->kept, &d->kept);
    if (!e)
        e = arena_zalloc(tmp, (size_t)n_pairs, sizeof *d->f, &d->f);
    if (!e)
        e = arena_zalloc(tmp, (size_t)n_pairs, sizeof *d->kept_f, &d->kept_f);
    return e ? e : arena_zalloc(tmp, (size_t)n_pairs, sizeof *d->used, &d->used);
}

size_t division_plan(int n_lenses, int n_pairs)
{
    struct arena tmp = arena_counter();
    struct division d;
    return layout(&d, &tmp, n_lenses, n_pairs) ? SIZE_MAX : tmp.peak;
}

/* Use pairs while one of their lenses has too few, those with the most matches first. */
static void choose_pairs(struct division *d)
{
    for (;;) {
        int best = -1;
        for (int i = 0; i < d->v->n_pairs; i++) {
            const struct division_pair *p = &d->v->pair[i];
            const int a = d->pairs[d->v->lens_of[p->a]], b = d->pairs[d->v->lens_of[p->b]];
            if (!d->used[i] && p->n >= PAIR_MATCHES && (a < LENS_PAIRS || b < LENS_PAIRS) &&
                (best < 0 || p->n > d->v->pair[best].n))
                best = i;
        }
        if (best < 0)
            return;
        d->used[best] = true;
        d->pairs[d->v->lens_of[d->v->pair[best].a]]++;
        d->pairs[d->v->lens_of[d->v->pair[best].b]]++;
    }
}

/* ---- scores of pairs ---- */

static struct epipolar_bend bend_of(const struct division *d, const struct division_pair *p)
{
    return (struct epipolar_bend){d->lens[d->v->lens_of[p->a]].bend,
                                  d->lens[d->v->lens_of[p->b]].bend};
}

/* Of the best geometry, a new one or what was before. */
static double score_bends(const struct division *d, int i, double f[9])
{
    const struct division_pair *p = &d->v->pair[i];
    const struct epipolar_bend bend = bend_of(d, p);
    struct epipolar_search how = d->v->search;
    double old[9];
    int agree;
    how.draws = d->draws;
    (void)epipolar_run(&how, bend, p->match, p->n, f);
    const double score = epipolar_score(f, bend, p->match, p->n, how.bound, &agree);
    if (d->kept[i] == 0)
        return score;
    memcpy(old, d->kept_f[i], sizeof old);
    (void)epipolar_polish(&how, bend, p->match, p->n, old);
    const double kept = epipolar_score(old, bend, p->match, p->n, how.bound, &agree);
    if (score > kept)
        return score;
    memcpy(f, old, sizeof old);
    return kept;
}

/* x/z and y/z of a point's ray, and the error of a pixel there, across and along the radius in the
 * mean. */
static void plane_of(const float px[2], const struct division_lens *l, double x[2], double *error)
{
    const double r2 = (double)(px[0] * px[0] + px[1] * px[1]);
    const double w = fmax(1 + l->bend * r2, PLANE_LEAST), across = 1 / w;
    const double along = fmax(1 - l->bend * r2, PLANE_LEAST) / (w * w);
    for (int k = 0; k < 2; k++)
        x[k] = (double)px[k] / (w * l->focal);
    *error = sqrt(across * along) / l->focal;
}

/* Matches that the pair's essential matrix explains. */
static double score_focals(const struct division *d, const struct division_pair *p,
                           const double f[9])
{
    struct twoview_match m[DIVISION_MATCHES];
    const struct division_lens *a = &d->lens[d->v->lens_of[p->a]];
    const struct division_lens *b = &d->lens[d->v->lens_of[p->b]];
    const double sigma = (double)d->v->search.bound / TWOVIEW_GATE;
    double e[9];
    for (int i = 0; i < p->n; i++) {
        plane_of(p->match[i].a, a, m[i].a, &m[i].sigma_a);
        plane_of(p->match[i].b, b, m[i].b, &m[i].sigma_b);
        m[i].sigma_a *= sigma;
        m[i].sigma_b *= sigma;
    }
    for (int k = 0; k < 9; k++)
        e[k] = f[k] * (k / 3 < 2 ? b->focal : 1) * (k % 3 < 2 ? a->focal : 1);
    return p->n - twoview_polish(m, p->n, e) / (TWOVIEW_GATE * TWOVIEW_GATE);
}

static bool concerns(const struct division *d, const struct division_pair *p)
{
    const int a = d->v->lens_of[p->a], b = d->v->lens_of[p->b];
    return d->own < 0 ? d->moved[a] || d->moved[b] : a == d->own && b == d->own;
}

static err_t score_pair(void *ctx, int i, int worker)
{
    struct division *d = ctx;
    const struct division_pair *p = &d->v->pair[i];
    (void)worker;
    d->score[i] = d->kept[i];
    memcpy(d->f[i], d->kept_f[i], sizeof d->f[i]);
    if (!d->used[i] || !concerns(d, p))
        return OK;
    d->score[i] = d->focals ? score_focals(d, p, d->f[i]) : score_bends(d, i, d->f[i]);
    return run_check(d->r, "lenses");
}

/* Sum of the scores of the lenses as they are. */
static err_t score_all(struct division *d, double *total)
{
    const err_t e = pool_for(d->r->pool, d->v->n_pairs, score_pair, d);
    *total = 0;
    for (int i = 0; i < d->v->n_pairs; i++) {
        const struct division_pair *p = &d->v->pair[i];
        const int a = d->v->lens_of[p->a], b = d->v->lens_of[p->b];
        if (d->own < 0 || (a == d->own && b == d->own))
            *total += d->score[i];
    }
    for (int i = 0; i < d->v->n_lenses && d->focals; i++)
        *total -= EXPECTED * pow(log(d->lens[i].focal / d->v->focal[i]), 2);
    return e;
}

static void keep_scores(struct division *d)
{
    memcpy(d->kept, d->score, (size_t)d->v->n_pairs * sizeof *d->kept);
    memcpy(d->kept_f, d->f, (size_t)d->v->n_pairs * sizeof *d->f);
}

/* ---- climbing ---- */

static void move_lens(struct division *d, int lens, double step)
{
    struct division_lens *l = &d->lens[lens];
    const double frame = d->v->frame[lens];
    if (d->focals)
        l->focal *= exp(step);
    else
        l->bend += step / (frame * frame);
}

/* Move a lens, or all of them (-1), by a step, while that is better. */
static err_t climb_lens(struct division *d, int lens, double step, double *best, bool *any)
{
    const int first = lens < 0 ? 0 : lens, end = lens < 0 ? d->v->n_lenses : lens + 1;
    for (int k = 0; k < CLIMBS; k++) {
        double total;
        for (int i = first; i < end; i++) {
            move_lens(d, i, step);
            d->moved[i] = true;
        }
        const err_t e = score_all(d, &total);
        const bool better = !e && total > *best;
        for (int i = first; i < end; i++) {
            d->moved[i] = false;
            if (!better)
                move_lens(d, i, -step);
        }
        if (!better)
            return e;
        *any = true;
        *best = total;
        keep_scores(d);
    }
    return OK;
}

static err_t climb_all(struct division *d, double step, double *best)
{
    bool any = true;
    err_t e = OK;
    for (int k = 0; k < CLIMBS && any && !e; k++) {
        any = false;
        for (int lens = d->v->n_lenses > 1 ? -1 : 0; lens < d->v->n_lenses && !e; lens++) {
            bool moved = false;
            e = climb_lens(d, lens, step, best, &moved);
            if (!e && !moved)
                e = climb_lens(d, lens, -step, best, &moved);
            any = any || moved;
        }
    }
    return e;
}

/* Score everything anew. */
static err_t score_start(struct division *d, double *total)
{
    d->own = -1;
    memset(d->moved, true, (size_t)d->v->n_lenses * sizeof *d->moved);
    const err_t e = score_all(d, total);
    memset(d->moved, false, (size_t)d->v->n_lenses * sizeof *d->moved);
    keep_scores(d);
    return e;
}

/* ---- bends ---- */

static void set_bend(struct division *d, int lens, double bend)
{
    d->lens[lens].bend = bend / (d->v->frame[lens] * d->v->frame[lens]);
}

/* One bend for all. */
static err_t start_common(struct division *d, double *straight)
{
    double most = 0, at = 0;
    for (size_t k = 0; k < sizeof BENDS / sizeof *BENDS; k++) {
        double total;
        for (int i = 0; i < d->v->n_lenses; i++)
            set_bend(d, i, BENDS[k]);
        const err_t e = score_start(d, &total);
        if (e)
            return e;
        if (BENDS[k] == 0)
            *straight = total;
        if (total > most) {
            most = total;
            at = BENDS[k];
        }
    }
    for (int i = 0; i < d->v->n_lenses; i++)
        set_bend(d, i, at);
    return OK;
}

/* For each lens the bend that suits its own views best. */
static err_t start_own(struct division *d)
{
    err_t e = OK;
    for (int i = 0; i < d->v->n_lenses && !e; i++) {
        const double before = d->lens[i].bend;
        double most = 0, at = 0, total;
        d->own = i;
        for (size_t k = 0; k < sizeof BENDS / sizeof *BENDS && !e; k++) {
            set_bend(d, i, BENDS[k]);
            e = score_all(d, &total);
            if (total > most) {
                most = total;
                at = BENDS[k];
            }
        }
        set_bend(d, i, at);
        if (most == 0) // no such pairs
            d->lens[i].bend = before;
    }
    d->own = -1;
    return e;
}

static err_t climb_bends(struct division *d, double *best)
{
    err_t e = score_start(d, best);
    d->draws = CLIMB_DRAWS;
    for (size_t k = 0; k < sizeof BEND_STEPS / sizeof *BEND_STEPS && !e; k++)
        e = climb_all(d, BEND_STEPS[k], best);
    d->draws = DRAWS;
    return e;
}

/* What straight lenses explain, with as many tries as the bends had: scores are the best of many
 * draws, so that the more often tried would win. Ends with the lenses as they are. end: (n_lenses)
 */
static err_t score_straight(struct division *d, struct division_lens *end, double *best)
{
    const size_t bytes = (size_t)d->v->n_lenses * sizeof *end;
    double total;
    memcpy(end, d->lens, bytes);
    err_t e = score_start(d, &total);
    d->draws = d->v->search.draws;
    for (int k = TRIES - 1; k >= 0 && !e; k--) {
        for (int i = 0; i < d->v->n_lenses; i++)
            d->lens[i].bend = end[i].bend * k / TRIES;
        e = score_start(d, &total);
    }
    d->draws = DRAWS;
    *best = fmax(*best, total);
    memcpy(d->lens, end, bytes);
    return e;
}

/* other: (n_lenses) */
static err_t find_bends(struct division *d, struct division_lens *other, bool *found)
{
    const size_t bytes = (size_t)d->v->n_lenses * sizeof *other;
    double straight = 0, same = 0, own = 0;
    err_t e = start_common(d, &straight);
    memcpy(other, d->lens, bytes);
    if (!e)
        e = climb_bends(d, &same);
    for (int i = 0; i < d->v->n_lenses; i++) {
        const struct division_lens climbed = d->lens[i];
        d->lens[i] = other[i];
        other[i] = climbed;
    }
    if (!e && d->v->n_lenses > 1)
        e = start_own(d);
    if (!e && d->v->n_lenses > 1)
        e = climb_bends(d, &own);
    if (own < same)
        memcpy(d->lens, other, bytes);
    const double best = fmax(own, same);
    if (!e)
        e = score_straight(d, other, &straight);
    *found = best > (1 + GAIN) * straight && best > straight + GAIN_LEAST;
    return e || !*found ? e : score_start(d, &own); // geometries of these bends
}

/* ---- focal lengths ---- */

/* The best of the focal lengths to try for one lens, the others as they are. */
static err_t try_focals(struct division *d, int lens, double *best)
{
    double at = d->lens[lens].focal, total;
    err_t e = OK;
    for (size_t k = 0; k < sizeof FOCALS / sizeof *FOCALS && !e; k++) {
        d->lens[lens].focal = FOCALS[k] * d->v->focal[lens];
        d->moved[lens] = true;
        e = score_all(d, &total);
        d->moved[lens] = false;
        if (!e && total > *best) {
            *best = total;
            at = d->lens[lens].focal;
            keep_scores(d);
        }
    }
    d->lens[lens].focal = at;
    return e;
}

/* From one ratio to what is expected, for all lenses. */
static err_t climb_focals(struct division *d, double ratio, double *best)
{
    const struct division_views *v = d->v;
    for (int i = 0; i < v->n_lenses; i++)
        d->lens[i].focal = ratio * v->focal[i];
    err_t e = score_start(d, best);
    for (int k = 0; k < 2 * v->n_lenses && !e; k++)
        e = try_focals(d, k % v->n_lenses, best);
    for (size_t k = 0; k < sizeof FOCAL_STEPS / sizeof *FOCAL_STEPS && !e; k++)
        e = climb_all(d, FOCAL_STEPS[k], best);
    return e;
}

/* out: (n_lenses) */
static err_t find_focals(struct division *d, struct division_lens *out)
{
    double most = 0, total = 0;
    err_t e = OK;
    d->focals = true;
    for (size_t k = 0; k < sizeof FOCALS / sizeof *FOCALS && !e; k++) {
        e = climb_focals(d, FOCALS[k], &total);
        if (total <= most)
            continue;
        most = total;
        memcpy(out, d->lens, (size_t)d->v->n_lenses * sizeof *out);
    }
    return e;
}

err_t division_run(const struct run *r, const struct division_views *v, struct division_lens *out)
{
    const size_t mark = arena_mark(r->tmp);
    struct division d = {.r = r, .v = v, .draws = DRAWS, .own = -1};
    bool found = false;
    for (int i = 0; i < v->n_lenses; i++)
        out[i] = (struct division_lens){0, v->focal[i]};
    err_t e = layout(&d, r->tmp, v->n_lenses, v->n_pairs);
    if (!e)
        choose_pairs(&d);
    if (!e)
        e = find_bends(&d, out, &found);
    if (!e && found)
        e = find_focals(&d, out);
    for (int i = 0; i < v->n_lenses && (e || !found); i++)
        out[i] = (struct division_lens){0, v->focal[i]};
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- as a lens ---- */

/* Least squares of y by s x + t x^2; t 0 where one term is asked. */
static void fit_terms(const double *x, const double *y, int n, int terms, double out[2])
{
    double xx = 0, xq = 0, qq = 0, xy = 0, qy = 0;
    for (int i = 0; i < n; i++) {
        const double q = x[i] * x[i];
        xx += q;
        xq += x[i] * q;
        qq += q * q;
        xy += x[i] * y[i];
        qy += q * y[i];
    }
    const double det = xx * qq - xq * xq;
    out[0] = xx > 0 ? xy / xx : 0;
    out[1] = 0;
    if (terms < 2 || !(det > 1e-12 * xx * qq))
        return;
    out[0] = (xy * qq - qy * xq) / det;
    out[1] = (qy * xx - xy * xq) / det;
}

err_t division_fit(const struct division_lens *d, double frame, struct lens *out)
{
    double x[SIDES], y[SIDES];
    int n = 0;
    *out = (struct lens){.model = LENS_PINHOLE, .fx = d->focal, .fy = d->focal};
    if (d->bend == 0)
        return lens_init(out);
    const double corner = d->focal * (1 + d->bend * frame * frame);
    const bool fisheye = corner < WIDEST_COS * hypot(corner, frame);
    for (int i = 1; i <= SIDES; i++) {
        const double r = frame * i / SIDES, z = d->focal * (1 + d->bend * r * r);
        const double rho = fisheye ? atan2(r, z) : r / z;
        if (z < (fisheye ? FIT_COS : WIDEST_COS) * hypot(r, z))
            break;
        x[n] = rho * rho;
        y[n++] = r / d->focal / rho - 1;
    }
    out->model = fisheye ? LENS_OPENCV_FISHEYE : LENS_RADIAL;
    fit_terms(x, y, n, fisheye ? 1 : 2, out->term);
    return lens_init(out);
}
