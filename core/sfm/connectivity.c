/* A view is held by the observations that are in if
 * 1. they are enough;
 * 2. it sees most points that two other views place, and that were matched to it, at their
 *    positions, or two fifths if no other pose explains half as many of the rest; otherwise its
 *    matches show another place than its pose, or two places, or its lens is another.
 * The view with the fewest inliers that is not held is removed, and the others are tested again
 * without it, until all are held. Of these a set grows from the two views with most common points
 * by the views that see enough of the points that two of the set place, or have common points with
 * two of the set that are not in one direction: points in common with only one view determine a
 * direction but not a distance. Points count that are seen from directions that differ: under one
 * sky, groups of views fit at any size and distance.
 * Sets grow from views that are in none so far; the largest stays, and is tested again. Two views
 * make a set of their own. Where no two views have parallax, a camera turned: all points count. */
#include "core/sfm/connectivity.h"

#include "core/base/lin.h"
#include "core/sfm/resect.h"

#include <math.h>
#include <string.h>

static const double AGREE = 0.6;       // least share of the points of others that a view sees
static const double AGREE_ALONE = 0.4; // where no other pose explains half as many
static const double PARALLAX = 2;      // least angle at a point, in gates
static const double BEARING = 0.1;     // between two views that hold a third, sine

struct links_of_views {
    int *common; // (n, n) inliers of a view, on the diagonal; of both with parallax, below it
    int *matched, *agreed; // (n) points that two others place: matched; in
    int *fixed;            // (n) inliers that two others of the set place
    int *set, *best;       // (n) the last set that a view is in, 0: none; 1: in the largest set
    int n;
    double parallax; // least angle between the rays of a point, expected errors of a direction
};

static err_t layout(struct links_of_views *s, struct arena *tmp, int n_views)
{
    const size_t n = (size_t)n_views;
    s->n = n_views;
    err_t e = arena_alloc(tmp, n * n, sizeof *s->common, &s->common);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *s->matched, &s->matched);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *s->agreed, &s->agreed);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *s->fixed, &s->fixed);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *s->best, &s->best);
    return e ? e : arena_alloc(tmp, n, sizeof *s->set, &s->set);
}

size_t connectivity_plan(int n_views)
{
    struct arena tmp = arena_counter();
    struct links_of_views s;
    return layout(&s, &tmp, n_views) ? SIZE_MAX : tmp.peak;
}

static bool is_counted(const struct adjust *a, int i)
{
    return a->in[i] && a->placed[a->obs[i].view];
}

static void centre_of(const struct adjust *a, int view, double out[3])
{
    const double *pose = a->pose + (size_t)ADJUST_POSE * (size_t)view;
    lin_apply_t(pose, pose + 9, out);
    for (int k = 0; k < 3; k++)
        out[k] = -out[k];
}

/* From a camera to a homogeneous point. */
static void direction_of(const struct adjust *a, int view, const double to[4], double out[3])
{
    double centre[3];
    centre_of(a, view, centre);
    for (int k = 0; k < 3; k++)
        out[k] = to[k] - to[3] * centre[k];
}

/* Square of the sine of the angle between two directions. */
static double sine2(const double a[3], const double b[3])
{
    double c[3];
    lin_cross(a, b, c);
    return lin_dot(c, c) / fmax(lin_dot(a, a) * lin_dot(b, b), 1e-300);
}

/* Whether two observations of a point see it from directions that differ by more than errors
 * explain. Of what is far, no view tells where it is. */
static bool has_parallax(const struct adjust *a, const struct links_of_views *s, int track, int i,
                         int j)
{
    const struct adjust_observation *o = &a->obs[i], *q = &a->obs[j];
    const double *point = a->point + 4 * (size_t)track;
    const double least = s->parallax / ((double)o->weight * adjust_focal(a, o->view));
    double d[3], e[3];
    direction_of(a, o->view, point, d);
    direction_of(a, q->view, point, e);
    return sine2(d, e) >= least * least;
}

static void count_links(const struct adjust *a, struct links_of_views *out)
{
    const size_t all = (size_t)out->n;
    memset(out->common, 0, all * all * sizeof *out->common);
    memset(out->matched, 0, all * sizeof *out->matched);
    memset(out->agreed, 0, all * sizeof *out->agreed);
    for (int t = 0; t < a->n_tracks; t++) {
        int n = 0;
        for (int i = a->first[t]; i < a->first[t + 1]; i++)
            n += is_counted(a, i);
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            const int v = a->obs[i].view, in = is_counted(a, i);
            out->matched[v] += n - in > 1;
            out->agreed[v] += in && n > 2;
            for (int j = a->first[t]; j <= i && in; j++)
                out->common[v * out->n + a->obs[j].view] +=
                    is_counted(a, j) && (i == j || has_parallax(a, out, t, i, j));
        }
    }
}

static int common_of(const struct links_of_views *s, int u, int v)
{
    return u < v ? s->common[v * s->n + u] : s->common[u * s->n + v];
}

static bool has_links(const struct links_of_views *s)
{
    bool any = false;
    for (int v = 0; v < s->n; v++)
        for (int u = 0; u < v; u++)
            any = any || common_of(s, u, v) >= CONNECTIVITY_LINK;
    return any;
}

static bool is_held(const struct viewgraph *g, struct adjust *a, double gate,
                    const struct links_of_views *s, int v)
{
    const int seen = s->agreed[v], n = s->matched[v];
    if (common_of(s, v, v) < CONNECTIVITY_VIEW)
        return false;
    return seen >= AGREE * n || (seen >= AGREE_ALONE * n && seen > 2 * resect_other(g, a, v, gate));
}

/* Unplace the view with the fewest inliers that is not held; false if all are held. */
static bool unplace_worst(const struct viewgraph *g, struct adjust *a, double gate,
                          const struct links_of_views *s)
{
    int worst = -1;
    for (int v = 0; v < a->n_views; v++)
        if (a->placed[v] && (worst < 0 || common_of(s, v, v) < common_of(s, worst, worst)) &&
            !is_held(g, a, gate, s, v))
            worst = v;
    if (worst >= 0)
        a->placed[worst] = false;
    return worst >= 0;
}

/* Whether the views of a set place a point of a track. */
static bool is_placed_by(const struct adjust *a, const struct links_of_views *s, int set, int track)
{
    int first = -1;
    for (int i = a->first[track]; i < a->first[track + 1]; i++) {
        if (!is_counted(a, i) || s->set[a->obs[i].view] != set)
            continue;
        if (first >= 0 && has_parallax(a, s, track, first, i))
            return true;
        first = first < 0 ? i : first;
    }
    return false;
}

/* Of each view, the inliers that two others of the set place. */
static void count_fixed(const struct adjust *a, const struct links_of_views *s, int set)
{
    memset(s->fixed, 0, (size_t)s->n * sizeof *s->fixed);
    for (int t = 0; t < a->n_tracks; t++)
        if (is_placed_by(a, s, set, t))
            for (int i = a->first[t]; i < a->first[t + 1]; i++)
                s->fixed[a->obs[i].view] += is_counted(a, i);
}

/* Whether the distance of a view depends on the set. */
static bool is_fixed(const struct adjust *a, const struct links_of_views *s, int v, int set)
{
    double first[3], d[3], centre[4] = {0, 0, 0, 1};
    int links = 0;
    for (int u = 0; u < s->n; u++) {
        if (s->set[u] != set || common_of(s, u, v) < CONNECTIVITY_LINK)
            continue;
        centre_of(a, u, centre);
        direction_of(a, v, centre, links ? d : first);
        if (links++ > 0 && sine2(first, d) > BEARING * BEARING)
            return true;
    }
    return s->fixed[v] >= CONNECTIVITY_LINK;
}

/* The two views of no set that have most in common begin a new one, which grows; returns its size,
 * 0: there are none. */
static int grow_set(const struct adjust *a, struct links_of_views *s, int set)
{
    int most = CONNECTIVITY_LINK - 1, from[2] = {0, 0}, size = 2;
    for (int v = 0; v < s->n; v++)
        for (int u = 0; u < v; u++)
            if (!s->set[u] && !s->set[v] && common_of(s, u, v) > most) {
                most = common_of(s, u, v);
                from[0] = u;
                from[1] = v;
            }
    if (from[1] == 0)
        return 0;
    s->set[from[0]] = s->set[from[1]] = set;
    for (int before = 0; before < size;) {
        before = size;
        count_fixed(a, s, set);
        for (int v = 0; v < s->n; v++)
            if (a->placed[v] && s->set[v] != set && is_fixed(a, s, v, set)) {
                s->set[v] = set;
                size++;
            }
    }
    return size;
}

/* Unplace all but the largest set; false if it is all. */
static bool keep_largest(struct adjust *a, struct links_of_views *s)
{
    bool any = false;
    memset(s->set, 0, (size_t)s->n * sizeof *s->set);
    memset(s->best, 0, (size_t)s->n * sizeof *s->best);
    for (int k = 1, most = 0, size = 1; size > 0; k++) {
        size = grow_set(a, s, k);
        for (int v = 0; v < s->n && size > most; v++)
            s->best[v] = s->set[v] == k;
        most = size > most ? size : most;
    }
    for (int v = 0; v < s->n; v++) {
        any |= a->placed[v] && !s->best[v];
        a->placed[v] &= s->best[v] != 0;
    }
    return any;
}

err_t connectivity_prune(const struct run *r, const struct viewgraph *g, struct adjust *a,
                         double gate)
{
    const size_t mark = arena_mark(r->tmp);
    struct links_of_views s = {.parallax = PARALLAX * gate};
    err_t e = layout(&s, r->tmp, a->n_views);
    if (e)
        return e;
    count_links(a, &s);
    if (!has_links(&s))
        s.parallax = 0;
    do
        do
            count_links(a, &s);
        while (unplace_worst(g, a, gate, &s));
    while (keep_largest(a, &s));
    arena_reset(r->tmp, mark);
    return run_check(r, "connections of views");
}
