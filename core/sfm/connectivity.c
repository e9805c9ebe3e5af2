/* A view is held by the observations that are in if
 * 1. they are enough;
 * 2. it sees most points that two other views place, and that were matched to it, at their
 *    positions; otherwise its matches show another place than its pose, or two places;
 * 3. such points are enough, or it has common points with two other views: points in common with
 *    only one view determine its direction but not its distance.
 * The view with the fewest inliers that is not held is removed, and the others are tested again
 * without it, until all are held or two are left, for which only the first test applies. */
#include "core/sfm/connectivity.h"

#include <string.h>

static const double AGREE = 0.6; // least share of the points of others that a view sees

struct links_of_views {
    int *common;           // (n, n) inliers of both, in the lower triangle
    int *matched, *agreed; // (n) points that two others place: matched; in
    int *to, *size;        // (n) of union and find: another view of a part; views of a part
    int n;
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
        e = arena_alloc(tmp, n, sizeof *s->to, &s->to);
    return e ? e : arena_zalloc(tmp, n, sizeof *s->size, &s->size);
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
                out->common[v * out->n + a->obs[j].view] += is_counted(a, j);
        }
    }
}

static int common_of(const struct links_of_views *s, int u, int v)
{
    return u < v ? s->common[v * s->n + u] : s->common[u * s->n + v];
}

static bool is_held(const struct adjust *a, const struct links_of_views *s, int v, int n_placed)
{
    int links = 0;
    if (common_of(s, v, v) < CONNECTIVITY_VIEW)
        return false;
    if (n_placed < 3)
        return true;
    for (int u = 0; u < a->n_views; u++)
        links += u != v && common_of(s, u, v) >= CONNECTIVITY_LINK;
    return s->agreed[v] >= AGREE * s->matched[v] &&
           (s->agreed[v] >= CONNECTIVITY_LINK || links > 1);
}

/* Unplace the view with the fewest inliers that is not held; false if all are held. */
static bool unplace_worst(struct adjust *a, const struct links_of_views *s)
{
    int worst = -1, n_placed = 0;
    for (int v = 0; v < a->n_views; v++)
        n_placed += a->placed[v];
    for (int v = 0; v < a->n_views; v++)
        if (a->placed[v] && !is_held(a, s, v, n_placed) &&
            (worst < 0 || common_of(s, v, v) < common_of(s, worst, worst)))
            worst = v;
    if (worst >= 0)
        a->placed[worst] = false;
    return worst >= 0;
}

static int root_of(const int *to, int v)
{
    while (to[v] != v)
        v = to[v];
    return v;
}

/* Keep only the largest set of connected views. */
static void keep_largest(struct adjust *a, const struct links_of_views *s)
{
    int *to = s->to, *size = s->size, best = 0;
    for (int v = 0; v < a->n_views; v++) {
        to[v] = v;
        for (int u = 0; u < v && a->placed[v]; u++)
            if (a->placed[u] && common_of(s, u, v) >= CONNECTIVITY_LINK)
                to[root_of(to, u)] = root_of(to, v);
    }
    for (int v = 0; v < a->n_views; v++)
        size[root_of(to, v)] += a->placed[v];
    for (int v = 0; v < a->n_views; v++)
        best = size[v] > size[best] ? v : best;
    for (int v = 0; v < a->n_views; v++)
        a->placed[v] &= root_of(to, v) == best && size[best] > 1;
}

err_t connectivity_prune(const struct run *r, struct adjust *a)
{
    const size_t mark = arena_mark(r->tmp);
    struct links_of_views s;
    err_t e = layout(&s, r->tmp, a->n_views);
    if (e)
        return e;
    do
        count_links(a, &s);
    while (unplace_worst(a, &s));
    keep_largest(a, &s);
    arena_reset(r->tmp, mark);
    return run_check(r, "connections of views");
}
