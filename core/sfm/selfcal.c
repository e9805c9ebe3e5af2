/* One observation of each track of three or more is left out, in turn the first, the second, ...:
 * all parts of a picture are judged. Both fits end in the same rounds, whose first gate is wide: a
 * lens that was wrong has thrown away what would have shown it. */
#include "core/sfm/selfcal.h"

#include "core/base/num.h"
#include "core/sfm/covariance.h"
#include "core/sfm/triangulate.h"

#include <math.h>
#include <string.h>

#define SURE 3.0        // standard errors of a gain that is believed
#define TERM_SURE 4.0   // of an unknown: 3 of errors that are 1.3 times as large (README.md)
#define FIRST_WORSE 1.0 // standard errors of a loss that it may bring
#define FIRST_LEAST 0.5 // px at the corner of a photograph: less is that of a pinhole
#define GAIN_LEAST 0.01 // of the error, of a gain that matters
#define BARREL -0.15    // k1 from which a fisheye is tried
#define WIDE 0.9        // distance from the middle over the focal length, the same

enum { STEPS = 6, CENTRE_STEP = 2 }; // the principal point comes before p1 p2, which do its work

static const struct lens_step {
    enum lens_model model;
    int terms;
} LENS_STEPS[STEPS] = {{LENS_SIMPLE_RADIAL, 1},  {LENS_RADIAL, 2},
                       {LENS_OPENCV, 4},         {LENS_OPENCV_FISHEYE, 1},
                       {LENS_OPENCV_FISHEYE, 2}, {LENS_OPENCV_FISHEYE, 4}};

int selfcal_terms(const struct lens *l)
{
    static const int least[LENS_MODELS] = {0, 1, 2, 4, 1};
    int n = LENS_TERMS;
    while (n > least[l->model] && l->term[n - 1] == 0)
        n--;
    return n;
}

struct state {
    double *pose, *point;
    struct adjust_lens *lens;
};

struct selfcal {
    const struct run *r;
    struct adjust *a;
    const struct selfcal_config *cfg;
    bool *held;            // (observations)
    float *before, *after; // (observations) truncated errors of those left out
    double *deviation;     // (lenses, ADJUST_LENS) of the fit that is judged
    struct state kept;
};

static err_t layout(struct selfcal *s, struct arena *tmp, const int count[4])
{
    const size_t seen = (size_t)count[3];
    err_t e = arena_zalloc(tmp, seen, sizeof *s->held, &s->held);
    if (!e)
        e = arena_alloc(tmp, seen, sizeof *s->before, &s->before);
    if (!e)
        e = arena_alloc(tmp, seen, sizeof *s->after, &s->after);
    if (!e)
        e = arena_alloc(tmp, ADJUST_LENS * (size_t)count[1], sizeof(double), &s->deviation);
    if (!e)
        e = arena_alloc(tmp, ADJUST_POSE * (size_t)count[0], sizeof(double), &s->kept.pose);
    if (!e)
        e = arena_alloc(tmp, 4 * (size_t)count[2], sizeof(double), &s->kept.point);
    return e ? e : arena_alloc(tmp, (size_t)count[1], sizeof *s->kept.lens, &s->kept.lens);
}

size_t selfcal_plan(int n_views, int n_lenses, int n_tracks, int n_obs)
{
    struct arena tmp = arena_counter();
    struct selfcal s;
    if (layout(&s, &tmp, (int[4]){n_views, n_lenses, n_tracks, n_obs}))
        return SIZE_MAX;
    return arena_add(tmp.peak, covariance_plan(n_views, n_lenses, n_tracks, n_obs));
}

static void keep_state(struct selfcal *s)
{
    const struct adjust *a = s->a;
    memcpy(s->kept.pose, a->pose, ADJUST_POSE * (size_t)a->n_views * sizeof *a->pose);
    memcpy(s->kept.point, a->point, 4 * (size_t)a->n_tracks * sizeof *a->point);
    memcpy(s->kept.lens, a->lens, (size_t)a->n_lenses * sizeof *a->lens);
}

static void restore_state(struct selfcal *s)
{
    struct adjust *a = s->a;
    memcpy(a->pose, s->kept.pose, ADJUST_POSE * (size_t)a->n_views * sizeof *a->pose);
    memcpy(a->point, s->kept.point, 4 * (size_t)a->n_tracks * sizeof *a->point);
    memcpy(a->lens, s->kept.lens, (size_t)a->n_lenses * sizeof *a->lens);
}

static void choose_held(struct selfcal *s, struct selfcal_lens *out)
{
    const struct adjust *a = s->a;
    for (int t = 0; t < a->n_tracks; t++) {
        const int n = a->first[t + 1] - a->first[t], i = a->first[t] + t % num_max(n, 1);
        if (n < 3 || !a->placed[a->obs[i].view])
            continue;
        s->held[i] = true;
        out[a->lens_of[a->obs[i].view]].held++;
    }
}

static err_t fit_lenses(struct selfcal *s)
{
    static const struct {
        double gate, kernel; // of the inliers' gate
        int steps;
    } round[] = {{6, 2, 12}, {2, 0.75, 10}, {1, 0.5, 10}, {1, 0.5, 15}};
    const double gate = s->cfg->gate * s->cfg->scale;
    err_t e = OK;
    for (size_t k = 0; k < sizeof round / sizeof *round && !e; k++) {
        e = triangulate_points(s->r, s->a, round[k].gate * gate);
        if (!e)
            e = adjust_run(s->r, s->a, round[k].kernel * gate, round[k].steps);
        adjust_normalise(s->a);
    }
    return e ? e : triangulate_points(s->r, s->a, gate);
}

static void measure_left_out(const struct selfcal *s, float *error)
{
    const struct adjust *a = s->a;
    const double most = pow(s->cfg->gate * s->cfg->scale, 2);
    for (int t = 0; t < a->n_tracks; t++)
        for (int i = a->first[t]; i < a->first[t + 1]; i++)
            if (s->held[i])
                error[i] = (float)fmin(most, adjust_error(a, a->point + 4 * (size_t)t, &a->obs[i]));
}

/* The error before, and the gain. */
struct judgement {
    double before;      // mean
    double sure, share; // gain in its standard errors, and of the error before
};

static struct judgement judge_lens(const struct selfcal *s, int lens)
{
    const struct adjust *a = s->a;
    struct judgement j = {0};
    double n = 0, sum = 0, square = 0;
    for (int i = 0; i < a->first[a->n_tracks]; i++) {
        if (!s->held[i] || a->lens_of[a->obs[i].view] != lens)
            continue;
        const double gain = (double)s->before[i] - (double)s->after[i];
        n++;
        j.before += (double)s->before[i];
        sum += gain;
        square += gain * gain;
    }
    n = fmax(n, 1);
    const double error = sqrt(fmax(0, square - sum * sum / n));
    j.sure = error > 0 ? sum / error : 0;
    j.share = j.before > 0 ? sum / j.before : 0;
    j.before /= n;
    return j;
}

/* Set the model of a step, starting where the present one is. */
static void set_model(struct adjust_lens *l, const struct lens_step *to)
{
    if (to->model == LENS_OPENCV_FISHEYE && l->lens.model != LENS_OPENCV_FISHEYE) {
        /* tan^-1 r = r - r^3 / 3 + ... */
        l->lens.term[0] += 1.0 / 3;
        for (int k = 1; k < LENS_TERMS; k++)
            l->lens.term[k] = 0;
    }
    l->lens.model = to->model;
    for (int k = 0; k < LENS_TERMS; k++)
        l->free[1 + k] = k < to->terms;
    if (lens_init(&l->lens) != OK) // finite numbers stay finite
        l->lens.model = LENS_PINHOLE;
}

static int free_terms(const struct adjust_lens *l)
{
    int n = 0;
    for (int k = 0; k < LENS_TERMS; k++)
        n += l->free[1 + k];
    return n;
}

/* Largest distance of an observation from the middle over the focal length. */
static double lens_reach(const struct adjust *a, int lens)
{
    double most = 0;
    for (int i = 0; i < a->first[a->n_tracks]; i++)
        if (a->in[i] && a->lens_of[a->obs[i].view] == lens)
            most = fmax(most, hypot((double)a->obs[i].u, (double)a->obs[i].v));
    return most / a->lens[lens].lens.fx;
}

/* Whether a lens may take a step. */
static bool may_climb(const struct adjust *a, int lens, const struct selfcal_lens *out, int step)
{
    const struct adjust_lens *l = &a->lens[lens];
    const struct lens_step *from =
        step ? &LENS_STEPS[step - 1] : &(struct lens_step){LENS_PINHOLE, 0};
    const bool to_fisheye =
        LENS_STEPS[step].model == LENS_OPENCV_FISHEYE && from->model == LENS_OPENCV;
    if (to_fisheye && adjust_too_wide(l))
        return true;
    if (out->held < SELFCAL_HELD_LEAST)
        return false;
    if (to_fisheye)
        return l->lens.model != LENS_OPENCV_FISHEYE && l->lens.term[0] < BARREL &&
               lens_reach(a, lens) > WIDE;
    return l->lens.model == from->model && free_terms(l) == from->terms;
}

static bool is_same_model(const struct adjust_lens *x, const struct adjust_lens *y)
{
    return x->lens.model == y->lens.model && memcmp(x->free, y->free, sizeof x->free) == 0;
}

/* Whether an unknown that the lens did not have is clearly not 0; that of another model always
 * is. */
static bool is_step_sure(const struct selfcal *s, int lens, bool centre)
{
    const struct adjust_lens *was = &s->kept.lens[lens], *is = &s->a->lens[lens];
    const double *error = s->deviation + (size_t)ADJUST_LENS * (size_t)lens;
    if (centre)
        return fabs(is->lens.cx) > TERM_SURE * error[ADJUST_CENTRE] ||
               fabs(is->lens.cy) > TERM_SURE * error[ADJUST_CENTRE + 1];
    bool any = was->lens.model != is->lens.model && is->lens.model == LENS_OPENCV_FISHEYE;
    for (int k = 0; k < LENS_TERMS; k++)
        any = any || (is->free[1 + k] && !was->free[1 + k] &&
                      fabs(is->lens.term[k]) > TERM_SURE * error[1 + k]);
    return any;
}

/* How far the first term moves the corner of a photograph, px. */
static double first_moves(const struct adjust_lens *l)
{
    return fabs(l->lens.term[0]) * pow(l->frame / l->lens.fx, 3) * l->lens.fx;
}

/* Nearly every lens has the first term, and without it focal length and poses are wrong by a
 * multiple of what they are with one that is none: less shows it, and few photographs predict too
 * little to. Little of a principal point shows in predictions, because the pose turns along: they
 * may be no worse. */
static bool is_step_kept(const struct selfcal *s, int lens)
{
    const struct adjust_lens *was = &s->kept.lens[lens], *is = &s->a->lens[lens];
    const struct judgement j = judge_lens(s, lens);
    const bool centre = is->free[ADJUST_CENTRE] && !was->free[ADJUST_CENTRE];
    const bool first = !centre && was->lens.model == LENS_PINHOLE;
    const bool better = j.sure > SURE && j.share > GAIN_LEAST,
               much_worse = j.sure < -SURE && j.share < -GAIN_LEAST;
    if (adjust_too_wide(was) && !adjust_too_wide(is) && !much_worse)
        return true;
    if (first)
        return j.sure > -FIRST_WORSE && first_moves(is) > FIRST_LEAST &&
               is_step_sure(s, lens, false);
    return (better || (centre && j.sure >= 0)) && is_step_sure(s, lens, centre);
}

/* Fit the lenses as they were changed, and keep what predicts better. */
static err_t try_change(struct selfcal *s)
{
    struct adjust *a = s->a;
    bool any = false, all = true;
    err_t e = fit_lenses(s);
    if (!e)
        e = covariance_run(s->r, a, s->deviation, NULL);
    measure_left_out(s, s->after);
    for (int i = 0; i < a->n_lenses && !e; i++) {
        const bool tried = !is_same_model(&a->lens[i], &s->kept.lens[i]);
        const bool better = tried && is_step_kept(s, i);
        any = any || better;
        all = all && better == tried;
        if (tried && !better)
            a->lens[i] = s->kept.lens[i];
    }
    if (e || !any) {
        restore_state(s);
        return e;
    }
    if (!all)
        e = fit_lenses(s);
    measure_left_out(s, s->before);
    keep_state(s);
    return e;
}

static err_t try_step(struct selfcal *s, int step, const struct selfcal_lens *out)
{
    struct adjust *a = s->a;
    bool any = false;
    for (int i = 0; i < a->n_lenses; i++)
        if (may_climb(a, i, &out[i], step)) {
            set_model(&a->lens[i], &LENS_STEPS[step]);
            any = true;
        }
    return any ? try_change(s) : OK;
}

/* The point that the distortion is around; so there is some. */
static err_t try_centre(struct selfcal *s, const struct selfcal_lens *out)
{
    struct adjust *a = s->a;
    bool any = false;
    for (int i = 0; i < a->n_lenses; i++) {
        struct adjust_lens *l = &a->lens[i];
        if (l->free[ADJUST_CENTRE] || out[i].held < SELFCAL_HELD_LEAST)
            continue;
        if (l->lens.model == LENS_PINHOLE)
            set_model(l, &LENS_STEPS[0]);
        l->free[ADJUST_CENTRE] = l->free[ADJUST_CENTRE + 1] = any = true;
    }
    return any ? try_change(s) : OK;
}

static void sum_up(struct selfcal *s, struct selfcal_lens *out)
{
    for (int i = 0; i < s->a->n_lenses; i++) {
        const struct judgement j = judge_lens(s, i);
        out[i].error = j.before;
        out[i].stop = out[i].held < SELFCAL_HELD_LEAST           ? SELFCAL_FEW
                      : free_terms(&s->a->lens[i]) == LENS_TERMS ? SELFCAL_FULL
                                                                 : SELFCAL_ENOUGH;
    }
}

/* First terms that a fit to all observations does not bear out; while some lenses had too few
 * terms, others may have got one instead. */
static err_t drop_idle_terms(struct selfcal *s, struct selfcal_lens *out)
{
    struct adjust *a = s->a;
    bool any = false;
    err_t e = covariance_run(s->r, a, s->deviation, NULL);
    for (int i = 0; i < a->n_lenses && !e; i++) {
        struct adjust_lens *l = &a->lens[i];
        const double error = s->deviation[ADJUST_LENS * i + 1];
        if (l->lens.model != LENS_SIMPLE_RADIAL || !l->free[1] || l->free[ADJUST_CENTRE] ||
            (first_moves(l) > FIRST_LEAST && fabs(l->lens.term[0]) > TERM_SURE * error))
            continue;
        l->lens.term[0] = 0;
        set_model(l, &(struct lens_step){LENS_PINHOLE, 0});
        out[i].error = out[i].error_before;
        any = true;
    }
    return any && !e ? fit_lenses(s) : e;
}

/* The ladder, then a last fit to all observations. */
static err_t choose_terms(struct selfcal *s, struct selfcal_lens *out)
{
    struct adjust *a = s->a;
    choose_held(s, out);
    a->held = s->held;
    err_t e = fit_lenses(s);
    measure_left_out(s, s->before);
    keep_state(s);
    for (int i = 0; i < a->n_lenses; i++)
        out[i].error_before = judge_lens(s, i).before;
    for (int k = 0; k < STEPS && !e; k++) {
        if (k == CENTRE_STEP && s->cfg->principal)
            e = try_centre(s, out);
        if (!e)
            e = try_step(s, k, out);
    }
    sum_up(s, out);
    a->held = NULL;
    if (!e)
        e = fit_lenses(s);
    return e ? e : drop_idle_terms(s, out);
}

err_t selfcal_run(const struct run *r, struct adjust *a, const struct selfcal_config *cfg,
                  struct selfcal_lens *out)
{
    const size_t mark = arena_mark(r->tmp);
    struct selfcal s = {.r = r, .a = a, .cfg = cfg};
    memset(out, 0, (size_t)a->n_lenses * sizeof *out);
    err_t e =
        layout(&s, r->tmp, (int[4]){a->n_views, a->n_lenses, a->n_tracks, a->first[a->n_tracks]});
    if (!e)
        e = choose_terms(&s, out);
    a->held = NULL;
    arena_reset(r->tmp, mark);
    return e;
}
