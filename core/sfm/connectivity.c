/* What holds a view, from the sightings that are in:
 * 1. enough of them;
 * 2. points that two other views place: it must see most of those that were matched to it where
 *    they are, else its matches tell of another place than its pose, or of two;
 * 3. such points in number, or common points with two other views: points that are common with one
 *    other view only give its direction, but not how far it is.
 * The view with fewest inliers that lacks one goes, and the others are looked at again without it,
 * until all are held or two are left, for which the last two say nothing. */
#include "core/sfm/connectivity.h"

#include <string.h>

static const double AGREE = 0.6; // least share of the points of others that a view sees

struct ties {
    int common[CONNECTIVITY_VIEWS_MAX][CONNECTIVITY_VIEWS_MAX]; // inliers of both
    int asked[CONNECTIVITY_VIEWS_MAX],
        agreed[CONNECTIVITY_VIEWS_MAX]; // points that two others place: seen, in
};

static bool counts(const struct adjust *a, int i)
{
    return a->in[i] && a->placed[a->seen[i].view];
}

static void count(const struct adjust *a, struct ties *out)
{
    memset(out, 0, sizeof *out);
    for (int t = 0; t < a->n_tracks; t++) {
        int n = 0;
        for (int i = a->first[t]; i < a->first[t + 1]; i++)
            n += counts(a, i);
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            const int v = a->seen[i].view, in = counts(a, i);
            out->asked[v] += n - in > 1;
            out->agreed[v] += in && n > 2;
            for (int j = a->first[t]; j <= i && in; j++)
                out->common[v][a->seen[j].view] += counts(a, j);
        }
    }
}

static int common_of(const struct ties *s, int u, int v)
{
    return u < v ? s->common[v][u] : s->common[u][v];
}

static bool held(const struct adjust *a, const struct ties *s, int v, int n_placed)
{
    int links = 0;
    if (s->common[v][v] < CONNECTIVITY_VIEW)
        return false;
    if (n_placed < 3)
        return true;
    for (int u = 0; u < a->n_views; u++)
        links += u != v && common_of(s, u, v) >= CONNECTIVITY_LINK;
    return s->agreed[v] >= AGREE * s->asked[v] && (s->agreed[v] >= CONNECTIVITY_LINK || links > 1);
}

/* Take back the view with fewest inliers that is not held; false if all are. */
static bool take_back(struct adjust *a, const struct ties *s)
{
    int worst = -1, n_placed = 0;
    for (int v = 0; v < a->n_views; v++)
        n_placed += a->placed[v];
    for (int v = 0; v < a->n_views; v++)
        if (a->placed[v] && !held(a, s, v, n_placed) &&
            (worst < 0 || s->common[v][v] < s->common[worst][worst]))
            worst = v;
    if (worst >= 0)
        a->placed[worst] = false;
    return worst >= 0;
}

static int root(const int *to, int v)
{
    while (to[v] != v)
        v = to[v];
    return v;
}

/* Only the largest set of views that are tied stays. */
static void keep_largest(struct adjust *a, const struct ties *s)
{
    int to[CONNECTIVITY_VIEWS_MAX], size[CONNECTIVITY_VIEWS_MAX] = {0}, best = 0;
    for (int v = 0; v < a->n_views; v++) {
        to[v] = v;
        for (int u = 0; u < v && a->placed[v]; u++)
            if (a->placed[u] && s->common[v][u] >= CONNECTIVITY_LINK)
                to[root(to, u)] = root(to, v);
    }
    for (int v = 0; v < a->n_views; v++)
        size[root(to, v)] += a->placed[v];
    for (int v = 0; v < a->n_views; v++)
        best = size[v] > size[best] ? v : best;
    for (int v = 0; v < a->n_views; v++)
        a->placed[v] &= root(to, v) == best && size[best] > 1;
}

void connectivity_prune(struct adjust *a)
{
    struct ties s;
    do
        count(a, &s);
    while (take_back(a, &s));
    keep_largest(a, &s);
}
