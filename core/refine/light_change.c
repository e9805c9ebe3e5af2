/* The mean product of what two surfaces of one square differ by, over all squares, is the variance
 * that the surfaces of a square have in common: noise has none. Its root is how far apart two
 * photographs are. Two groups: an edge of the minimum spanning tree is taken away (single linkage),
 * the one for which distances tell best which pairs are of two groups (point-biserial correlation);
 * then photographs change sides one by one as long as that gains. */
#include "core/refine/light_change.h"

#include "core/base/num.h"
#include "core/base/rotation.h"

#include <math.h>
#include <string.h>

enum {
    SEEN_LEAST = 40,      // surfaces of a pair of views, in this order
    PRODUCTS_LEAST = 100, // of those, in either order
    LINKS_LEAST = 2       // pairs between the groups that are compared, and within
};

#define CLIP 1.0           // stops, more is a wrong depth as likely as light
#define APART_LEAST 0.12   // stops between the groups, less does no harm
#define RATIO 2.5          // between the groups over within them
#define NOISE 0.02         // stops, within are no fewer
#define LARGER 0.85        // share of comparisons that pairs between the groups win
#define EXPOSURE_SAME 0.25 // stops

/* Two views that share surfaces. */
struct link {
    int view[2];
    double apart; // stops
};

struct groups {
    const struct light_change_input *in;
    int first, step;      // squares that are looked at
    double *sum, *weight; // (n_views^2) of products by pair, the lower view first; then sum: stops
    float *value;         // (n, n_views^2) scratch
    struct link *link;    // (n_links) of room for n_views^2
    int n_links;
    int *parent, *root; // (n_views) of the tree; parent of a root: -1
    int *order;         // (n_views) parents first
    bool *other;        // (n_views) scratch
};

static err_t layout(struct groups *g, struct arena *tmp, int n_views, int n)
{
    const size_t views = (size_t)num_max(n_views, 1), square = views * views;
    err_t e = arena_alloc(tmp, square, sizeof *g->sum, &g->sum);
    if (!e)
        e = arena_alloc(tmp, square, sizeof *g->weight, &g->weight);
    if (!e)
        e = arena_alloc(tmp, num_max_size(square, (size_t)n), sizeof *g->value, &g->value);
    if (!e)
        e = arena_alloc(tmp, square, sizeof *g->link, &g->link);
    if (!e)
        e = arena_alloc(tmp, views, sizeof *g->parent, &g->parent);
    if (!e)
        e = arena_alloc(tmp, views, sizeof *g->root, &g->root);
    if (!e)
        e = arena_alloc(tmp, views, sizeof *g->order, &g->order);
    return e ? e : arena_alloc(tmp, views, sizeof *g->other, &g->other);
}

size_t light_change_plan(int n_views, int n)
{
    struct arena tmp = arena_counter();
    struct groups g;
    return layout(&g, &tmp, n_views, n) ? SIZE_MAX : tmp.peak;
}

/* ---- distances ---- */

static size_t pair_of(const struct groups *g, int a, int b)
{
    return (size_t)num_min(a, b) * (size_t)g->in->n_views + (size_t)num_max(a, b);
}

/* Observations of one pair, from `at`, n of them. */
static void add_pair(struct groups *g, int at, int n)
{
    const struct light_change_seen *s = g->in->seen + at;
    const size_t pair = pair_of(g, s->view[0], s->view[1]);
    double sum[LIGHT_CHANGE_SQUARES] = {0}, square[LIGHT_CHANGE_SQUARES] = {0};
    int count[LIGHT_CHANGE_SQUARES] = {0};
    if (n < SEEN_LEAST)
        return;
    for (int i = 0; i < n; i++)
        g->value[i] = s[i].stops;
    const double median = (double)num_median(g->value, (size_t)n);
    for (int i = 0; i < n; i++) {
        const double x = fmin(fmax((double)s[i].stops - median, -CLIP), CLIP);
        sum[s[i].square] += x;
        square[s[i].square] += x * x;
        count[s[i].square]++;
    }
    for (int k = g->first; k < LIGHT_CHANGE_SQUARES; k += g->step) {
        g->sum[pair] += sum[k] * sum[k] - square[k];
        g->weight[pair] += (double)count[k] * (count[k] - 1);
    }
}

static bool is_same_pair(const struct light_change_seen *a, const struct light_change_seen *b)
{
    return a->view[0] == b->view[0] && a->view[1] == b->view[1];
}

/* By every `step`th square from the first. */
static void measure_pairs(struct groups *g, int first, int step)
{
    const int n = g->in->n_views;
    const size_t all = (size_t)n * (size_t)n;
    g->first = first;
    g->step = step;
    memset(g->sum, 0, all * sizeof *g->sum);
    memset(g->weight, 0, all * sizeof *g->weight);
    for (int at = 0, end = 0; at < g->in->n; at = end) {
        while (end < g->in->n && is_same_pair(&g->in->seen[at], &g->in->seen[end]))
            end++;
        add_pair(g, at, end - at);
    }
    g->n_links = 0;
    for (int a = 0; a < n; a++)
        for (int b = a + 1; b < n; b++) {
            const size_t k = pair_of(g, a, b);
            const bool known = g->weight[k] * g->step >= PRODUCTS_LEAST;
            g->sum[k] = known ? sqrt(fmax(g->sum[k] / g->weight[k], 0)) : INFINITY;
            if (known)
                g->link[g->n_links++] = (struct link){{a, b}, g->sum[k]};
        }
}

/* ---- groups ---- */

/* The minimum spanning tree, of every part that is connected (Prim). */
static void grow_tree(struct groups *g)
{
    const int n = g->in->n_views;
    double *near = g->weight; // not needed any more
    for (int i = 0; i < n; i++) {
        near[i] = INFINITY;
        g->parent[i] = g->root[i] = -1;
    }
    for (int k = 0; k < n; k++) {
        int next = -1;
        for (int i = 0; i < n; i++)
            if (g->root[i] < 0 && (next < 0 || near[i] < near[next]))
                next = i;
        g->order[k] = next;
        g->root[next] = g->parent[next] < 0 ? next : g->root[g->parent[next]];
        for (int i = 0; i < n; i++) {
            const double apart = i == next ? INFINITY : g->sum[pair_of(g, i, next)];
            if (g->root[i] >= 0 || !(apart < near[i]))
                continue;
            near[i] = apart;
            g->parent[i] = next;
        }
    }
}

static bool is_across(const struct link *l, const bool *other)
{
    return other[l->view[0]] != other[l->view[1]];
}

/* How well distances tell pairs of two groups from those of one; -1: there is nothing to tell. */
static double separation(const struct groups *g, const bool *other)
{
    double sum[2] = {0}, count[2] = {0};
    for (int i = 0; i < g->n_links; i++) {
        const struct link *l = &g->link[i];
        const int across = is_across(l, other);
        sum[across] += l->apart;
        count[across]++;
    }
    return count[0] > 0 && count[1] > 0
               ? (sum[1] / count[1] - sum[0] / count[0]) * sqrt(count[0] * count[1])
               : -1;
}

/* Views of the part of the tree that root is in, on a side. */
static int count_side(const struct groups *g, const bool *other, int root, bool side)
{
    int n = 0;
    for (int i = 0; i < g->in->n_views; i++)
        n += g->root[i] == root && other[i] == side;
    return n;
}

static bool is_split(const struct groups *g, const bool *other, int root)
{
    return count_side(g, other, root, false) >= 2 && count_side(g, other, root, true) >= 2;
}

/* Without the edge from a view to its parent. */
static void cut_tree(const struct groups *g, int view, bool *other)
{
    for (int k = 0; k < g->in->n_views; k++) {
        const int i = g->order[k];
        other[i] = i == view || (g->parent[i] >= 0 && other[g->parent[i]]);
    }
}

/* Views that change sides where that is better. */
static void improve_split(const struct groups *g, int root, bool *other)
{
    double best = separation(g, other);
    for (int i = 0, since = 0; since < g->in->n_views; i = (i + 1) % g->in->n_views, since++) {
        if (g->root[i] != root)
            continue;
        other[i] = !other[i];
        const double now = is_split(g, other, root) ? separation(g, other) : -1;
        if (now > best + 1e-9) {
            best = now;
            since = -1;
        } else
            other[i] = !other[i];
    }
}

/* The root of the part that is split; -1: none can be. */
static int find_split(const struct groups *g, bool *other)
{
    double best = 0;
    int root = -1;
    for (int view = 0; view < g->in->n_views; view++) {
        if (g->parent[view] < 0)
            continue;
        cut_tree(g, view, g->other);
        const double now = separation(g, g->other);
        if (!(now > best) || !is_split(g, g->other, g->root[view]))
            continue;
        best = now;
        root = g->root[view];
        memcpy(other, g->other, (size_t)g->in->n_views * sizeof *other);
    }
    if (root >= 0)
        improve_split(g, root, other);
    return root;
}

/* ---- judgement ---- */

static bool is_of_one_camera(const struct groups *g, const struct link *l)
{
    return g->in->camera[l->view[0]] == g->in->camera[l->view[1]];
}

/* Scene units between two places. */
static double distance_of(const struct groups *g, const struct link *l)
{
    double a[3], b[3];
    rotation_centre(&g->in->cams[l->view[0]], a);
    rotation_centre(&g->in->cams[l->view[1]], b);
    return hypot(hypot(a[0] - b[0], a[1] - b[1]), a[2] - b[2]);
}

static double exposure_step(const struct groups *g, const struct link *l)
{
    const float *log2t = g->in->log2t;
    return log2t ? fabs((double)(log2t[l->view[0]] - log2t[l->view[1]])) : 0;
}

/* Whether all exposures of one group are longer than those of the other. */
static bool is_by_exposure(const struct groups *g, const bool *other, int root)
{
    float lo[2] = {INFINITY, INFINITY}, hi[2] = {-INFINITY, -INFINITY};
    for (int i = 0; i < g->in->n_views && g->in->log2t; i++) {
        if (g->root[i] != root)
            continue;
        lo[other[i]] = fminf(lo[other[i]], g->in->log2t[i]);
        hi[other[i]] = fmaxf(hi[other[i]], g->in->log2t[i]);
    }
    return g->in->log2t && (lo[0] > hi[1] || lo[1] > hi[0]);
}

/* What pairs of one camera differ by at most within the groups. */
struct reach {
    double away, stops; // scene units, of exposure
};

static struct reach reach_within(const struct groups *g, const bool *other)
{
    struct reach most = {0, 0};
    for (int i = 0; i < g->n_links; i++) {
        const struct link *l = &g->link[i];
        if (is_across(l, other) || !is_of_one_camera(g, l))
            continue;
        most.away = fmax(most.away, distance_of(g, l));
        most.stops = fmax(most.stops, exposure_step(g, l));
    }
    return most;
}

/* How far apart the pairs of one camera within that reach are, across the groups or within them, in
 * ascending order. Returns their number. */
static size_t list_pairs(const struct groups *g, const bool *other, const struct reach *reach,
                         bool across, float *apart)
{
    size_t n = 0;
    for (int i = 0; i < g->n_links; i++) {
        const struct link *l = &g->link[i];
        if (is_across(l, other) == across && is_of_one_camera(g, l) &&
            distance_of(g, l) <= reach->away && exposure_step(g, l) <= reach->stops + EXPOSURE_SAME)
            apart[n++] = (float)l->apart;
    }
    (void)num_median(apart, n); // sorts them
    return n;
}

/* The share of all comparisons of a number in a with one in b, both in ascending order, in which it
 * is the larger one. */
static double share_larger(const float *a, size_t n_a, const float *b, size_t n_b)
{
    double larger = 0;
    for (size_t i = 0, below = 0; i < n_a; i++) {
        while (below < n_b && b[below] < a[i])
            below++;
        larger += (double)below;
    }
    return larger / ((double)n_a * (double)n_b);
}

static void compare_groups(const struct groups *g, struct light_change *out)
{
    const struct reach reach = reach_within(g, out->other);
    float *between = g->value;
    const size_t n = list_pairs(g, out->other, &reach, true, between);
    float *within = g->value + n;
    const size_t n_within = list_pairs(g, out->other, &reach, false, within);
    if (n < LINKS_LEAST || n_within < LINKS_LEAST)
        return;
    out->between = (double)num_sorted_quantile(between, n, 0.5f);
    out->within = (double)num_sorted_quantile(within, n_within, 0.5f);
    out->larger = share_larger(between, n, within, n_within);
}

static bool is_clear(const struct light_change *c)
{
    return c->between >= APART_LEAST && c->between >= RATIO * fmax(c->within, NOISE) &&
           c->larger >= LARGER;
}

/* Whether groups that half of the squares tell are clear in the other half, either way: the best of
 * many groups seems to be one by chance. */
static bool is_in_both_halves(struct groups *g, const struct light_change *of)
{
    for (int half = 0; half < 2; half++) {
        struct light_change now = {.other = of->other};
        measure_pairs(g, half, 2);
        grow_tree(g);
        if (find_split(g, now.other) < 0)
            return false;
        measure_pairs(g, 1 - half, 2);
        compare_groups(g, &now);
        if (now.between < APART_LEAST || now.larger < LARGER)
            return false;
    }
    return true;
}

/* Of the two groups of a part of the tree. */
static void take_smaller(const struct groups *g, int root, struct light_change *out)
{
    const int n = count_side(g, out->other, root, true),
              rest = count_side(g, out->other, root, false);
    const bool side = n < rest || (n == rest && out->other[g->in->n_views - 1]);
    for (int i = 0; i < g->in->n_views; i++)
        out->other[i] = g->root[i] == root && out->other[i] == side;
    out->others = num_min(n, rest);
}

err_t light_change_find(const struct light_change_input *in, struct arena *tmp,
                        struct light_change *out)
{
    struct groups g = {.in = in};
    const size_t mark = arena_mark(tmp), views = (size_t)in->n_views;
    *out = (struct light_change){.other = out->other};
    memset(out->other, 0, views * sizeof *out->other);
    err_t e = layout(&g, tmp, in->n_views, in->n);
    if (e)
        return e;
    const bool sure = is_in_both_halves(&g, out);
    measure_pairs(&g, 0, 1);
    grow_tree(&g);
    const int root = find_split(&g, out->other);
    if (root >= 0 && !is_by_exposure(&g, out->other, root))
        compare_groups(&g, out);
    if (sure && is_clear(out))
        take_smaller(&g, root, out);
    else
        memset(out->other, 0, views * sizeof *out->other);
    arena_reset(tmp, mark);
    return OK;
}
