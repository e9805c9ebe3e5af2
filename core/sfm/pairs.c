/* Pairs are compared upright: of many views those that look alike (retrieve.h) or were taken one
 * after the other, then those that have sure pairs with the same views: where a walk comes back,
 * one pair that was found shows the others. Each pair writes only its own matches.
 * Pairs that are sure connect views; the roll between connected views is known from them, so that
 * an unsure pair is compared in turns that are near it only, and not at all where it is upright.
 * Pairs of views that are not connected are compared in all turns. What is still unsure then, of
 * views that sure pairs connect by way of one view at most, and sure pairs that no third view
 * shares, are compared with stretched views. */
#include "core/sfm/pairs.h"

#include "core/base/num.h"
#include "core/base/share.h"
#include "core/sfm/retrieve.h"

#include <math.h>
#include <string.h>

enum {
    NOBODY = -1,
    ALIKE = 16, // views that look alike, which each of many is compared with
    AFTER = 3,  // views after it, the same
    COMMON = 8  // views that have sure pairs with the same ones, the same
};

struct work {
    const struct run *r;
    const struct views *v;
    struct pairs *s;
    int first; // pair of chunk 0
};

/* ---- rolls ---- */

/* Turn of the links of a pair about their middle. */
static float turn_of_links(const struct pairs *s, const struct pair *c)
{
    double mean[4] = {0}, along = 0, across = 0;
    for (int turn = 0; turn < 2; turn++) {
        for (int k = 0; k < c->n; k++) {
            const struct corner *a = s->views.view[c->a].at + c->link[k].a;
            const struct corner *b = s->views.view[c->b].at + c->link[k].b;
            const double at[4] = {a->u, a->v, b->u, b->v};
            const double x = at[0] - mean[0], y = at[1] - mean[1];
            const double u = at[2] - mean[2], v = at[3] - mean[3];
            along += turn * (x * u + y * v);
            across += turn * (x * v - y * u);
            for (int i = 0; i < 4 && !turn; i++)
                mean[i] += at[i] / c->n;
        }
    }
    return (float)atan2(across, along);
}

/* Radians, from x to y, that bring view a of a pair to look like b; 0 where both are upright. */
static float roll_of_pair(const struct pairs *s, const struct pair *c)
{
    const float full = (float)(2 * NUM_PI), step = full / CORNER_TURNS;
    float rough = (float)c->turn * step, off;
    if (!c->turn)
        return 0;
    off = remainderf(turn_of_links(s, c) - rough, full);
    return fabsf(off) < step ? rough + off : rough;
}

/* A roll for each view, over the pairs with the most links, of those in which at least so many
 * agree. exact: also where turns of less than an eighth are upright enough to be matched. */
static void find_rolls(struct pairs *s, int n_views, int agree, bool exact)
{
    for (int i = 0; i < n_views; i++) {
        s->tree[i] = i;
        s->roll[i] = 0;
    }
    for (;;) {
        const struct pair *best = NULL;
        for (int i = 0; i < s->n; i++) {
            const struct pair *c = s->pair + i;
            if (c->known && c->agree >= agree && s->tree[c->a] != s->tree[c->b] &&
                (!best || c->n > best->n))
                best = c;
        }
        if (!best)
            return;
        const float turn = exact ? turn_of_links(s, best) : roll_of_pair(s, best);
        const float shift = s->roll[best->a] + turn - s->roll[best->b];
        const int from = s->tree[best->b], to = s->tree[best->a];
        for (int i = 0; i < n_views; i++) {
            s->roll[i] += s->tree[i] == from ? shift : 0;
            s->tree[i] = s->tree[i] == from ? to : s->tree[i];
        }
    }
}

/* ---- views ---- */

static err_t prepare_view(void *ctx, int i, int worker)
{
    struct work *w = ctx;
    struct pairs *s = w->s;
    err_t e = run_check(w->r, "matching");
    if (e)
        return e;
    corner_run(views_rgb(w->v, i), views_masked(w->v, i), s->rooms[worker].picture,
               s->views.view + i);
    pair_prepare(&s->views, i);
    return OK;
}

/* View i stretched, if a pair needs it. */
static err_t tilt_view(void *ctx, int i, int worker)
{
    struct work *w = ctx;
    struct pairs *s = w->s;
    (void)worker;
    for (int k = 0; k < s->n; k++) {
        if (!s->isolated[k] || s->pair[k].b != i)
            continue;
        corner_tilt(s->views.view + i);
        break;
    }
    return run_check(w->r, "matching");
}

/* ---- choice ---- */

static void add_pair(struct pairs *s, int a, int b)
{
    const int n = s->views.n, low = num_min(a, b), high = num_max(a, b);
    if (low == high || high >= n || pairs_of(s, a, b) || s->n == s->cap)
        return;
    s->index[a * n + b] = s->index[b * n + a] = s->n;
    s->pair[s->n].a = low;
    s->pair[s->n++].b = high;
}

static void add_all(struct pairs *s)
{
    for (int a = 0; a < s->views.n; a++)
        for (int b = a + 1; b < s->views.n; b++)
            add_pair(s, a, b);
}

static err_t add_similar(const struct work *w)
{
    struct pairs *s = w->s;
    err_t e = retrieve_run(w->r, &s->views, ALIKE, s->near);
    for (int a = 0; a < s->views.n && !e; a++) {
        for (int k = 1; k <= AFTER; k++)
            add_pair(s, a, a + k);
        for (int k = 0; k < ALIKE; k++)
            add_pair(s, a, s->near[a * ALIKE + k]);
    }
    return e;
}

static bool is_sure(const struct pairs *s, int a, int b)
{
    const struct pair *c = pairs_of(s, a, b);
    return c && c->agree >= PAIR_SURE;
}

/* Views that view a has sure pairs in common with, of those that it was not compared with.
 * common: (views) */
static void count_common(const struct pairs *s, int a, int *common)
{
    const int n = s->views.n;
    memset(common, 0, (size_t)n * sizeof *common);
    for (int b = 0; b < n; b++)
        for (int c = 0; c < n && is_sure(s, a, b); c++)
            common[c] += c != a && is_sure(s, b, c) && !pairs_of(s, a, c);
}

static void add_common(struct pairs *s)
{
    const int n = s->views.n;
    for (int a = 0; a < n; a++) {
        int *common = s->tree; // (n), not in use yet
        count_common(s, a, common);
        for (int k = 0; k < COMMON; k++) {
            int best = 0;
            for (int c = 1; c < n; c++)
                best = common[c] > common[best] ? c : best;
            s->near[a * ALIKE + k] = common[best] ? best : a;
            common[best] = 0;
        }
    }
    for (int a = 0; a < n; a++)
        for (int k = 0; k < COMMON; k++)
            add_pair(s, a, s->near[a * ALIKE + k]);
}

/* ---- pairs ---- */

/* Pairs [first, n) were searched, each by the rank that it is dealt to: complete on all. */
static err_t gather_pairs(const struct work *w, int first)
{
    struct pairs *s = w->s;
    struct team *t = w->r->team;
    size_t at[TEAM_MAX + 1], links[TEAM_MAX + 1];
    const int n = s->n - first;
    struct pair_link *base = s->pair[0].link;
    const size_t pitch = (size_t)s->views.cap;
    if (!t || n == 0)
        return OK;
    for (int i = 0; i <= t->size; i++) {
        const size_t k = (size_t)(first + team_first(t, n, i));
        at[i] = k * sizeof *s->pair;
        links[i] = k * pitch * sizeof *base;
    }
    err_t e = team_spread(t, s->pair, at);
    for (int k = first; k < s->n; k++) // an address is a rank's own
        s->pair[k].link = base + (size_t)k * pitch;
    return e ? e : team_spread(t, base, links);
}

/* fn for pairs [first, n). */
static err_t share_pairs(struct work *w, int first, pool_fn *fn)
{
    w->first = first;
    err_t e = share_for(w->r, w->s->n - first, fn, w);
    return e ? e : gather_pairs(w, first);
}

static err_t search_pair(void *ctx, int i, int worker)
{
    struct work *w = ctx;
    err_t e = run_check(w->r, "matching");
    if (!e)
        pair_search(&w->s->views, &w->s->rooms[worker].pair, w->s->pair + w->first + i);
    return e;
}

/* Of many views, twice: pairs that are likely, and those that these suggest. */
static err_t search_pairs(struct work *w)
{
    struct pairs *s = w->s;
    const bool many = s->views.n > PAIR_ALL;
    err_t e = OK;
    if (many)
        e = add_similar(w);
    else
        add_all(s);
    if (!e)
        e = share_pairs(w, 0, search_pair);
    if (e || !many)
        return e;
    const int likely = s->n;
    add_common(s);
    return share_pairs(w, likely, search_pair);
}

/* The turns in which a pair is compared: bit k, k eighths. */
static unsigned turns_of(const struct pairs *s, const struct pair *c)
{
    const unsigned all = (1u << CORNER_TURNS) - 2;
    if (c->agree >= PAIR_SURE)
        return 0;
    if (s->tree[c->a] != s->tree[c->b])
        return all;
    const float eighth = (float)(2 * NUM_PI) / CORNER_TURNS;
    const int near = (int)lrintf((s->roll[c->b] - s->roll[c->a]) / eighth) & (CORNER_TURNS - 1);
    if (near == 0)
        return 0;
    return (1u << near | 1u << ((near + 1) % CORNER_TURNS) | 1u << (near - 1)) & all;
}

static err_t turn_pair(void *ctx, int i, int worker)
{
    struct work *w = ctx;
    struct pair *c = w->s->pair + i;
    const unsigned turns = turns_of(w->s, c);
    err_t e = run_check(w->r, "matching");
    if (!e && turns)
        pair_turn(&w->s->views, &w->s->rooms[worker].pair, c, turns);
    return e;
}

/* s->tree: the part of each view in the graph of sure pairs without view x. */
static void find_parts(struct pairs *s, int x)
{
    for (int i = 0; i < s->views.n; i++)
        s->tree[i] = i;
    for (int k = 0; k < s->n; k++) {
        const struct pair *c = s->pair + k;
        const int from = s->tree[c->b], to = s->tree[c->a];
        if (c->agree < PAIR_SURE || c->a == x || c->b == x || from == to)
            continue;
        for (int i = 0; i < s->views.n; i++)
            s->tree[i] = s->tree[i] == from ? to : s->tree[i];
    }
}

/* Whether a third view has sure pairs with both. */
static bool is_shared(const struct pairs *s, const struct pair *c)
{
    for (int x = 0; x < s->views.n; x++)
        if (x != c->a && x != c->b && is_sure(s, c->a, x) && is_sure(s, c->b, x))
            return true;
    return false;
}

/* Unsure pairs of views that no sure pairs connect, or only by way of one view; sure pairs that no
 * third view shares. */
static void choose_isolated(struct pairs *s)
{
    for (int k = 0; k < s->n; k++)
        s->isolated[k] = s->pair[k].agree >= PAIR_SURE && !is_shared(s, s->pair + k);
    for (int x = NOBODY; x < s->views.n; x++) {
        find_parts(s, x);
        for (int k = 0; k < s->n; k++) {
            const struct pair *c = s->pair + k;
            if (c->a != x && c->b != x && s->tree[c->a] != s->tree[c->b])
                s->isolated[k] = true; // unsure, or both were one part
        }
    }
}

/* Pair i, if it is isolated. */
static err_t tilt_pair(void *ctx, int i, int worker)
{
    struct work *w = ctx;
    const struct pairs *s = w->s;
    err_t e = run_check(w->r, "matching");
    if (!e && s->isolated[i])
        pair_tilt(&s->views, &s->rooms[worker].pair, s->pair + i);
    return e;
}

static err_t complete_pair(void *ctx, int i, int worker)
{
    struct work *w = ctx;
    err_t e = run_check(w->r, "matching");
    if (!e)
        pair_complete(&w->s->views, &w->s->rooms[worker].pair, w->s->pair + i, w->s->bent);
    return e;
}

/* ---- lenses ---- */

/* Pairs as struct division_views wants them. */
struct matches {
    struct division_pair *pair;   // (n_pairs)
    struct epipolar_match *match; // (n_pairs, DIVISION_MATCHES)
    double *frame, *focal;        // (n_lenses)
};

static err_t layout_matches(struct matches *c, struct arena *tmp, int n_pairs, int n_lenses)
{
    const size_t n = (size_t)n_pairs;
    err_t e = arena_alloc(tmp, n, sizeof *c->pair, &c->pair);
    if (!e)
        e = arena_alloc(tmp, n * DIVISION_MATCHES, sizeof *c->match, &c->match);
    if (!e)
        e = arena_zalloc(tmp, (size_t)n_lenses, sizeof *c->frame, &c->frame);
    return e ? e : arena_zalloc(tmp, (size_t)n_lenses, sizeof *c->focal, &c->focal);
}

/* How strongly the lenses distort, for the pairs of their views. */
static err_t find_bends(const struct work *w, struct division_lenses *lenses)
{
    struct pairs *s = w->s;
    const size_t mark = arena_mark(w->r->tmp);
    struct matches c;
    err_t e = layout_matches(&c, w->r->tmp, s->n, lenses->n);
    for (int i = 0; i < s->n && !e; i++) {
        struct epipolar_match *match = c.match + (size_t)i * DIVISION_MATCHES;
        const struct pair *p = s->pair + i;
        c.pair[i] = (struct division_pair){
            p->a, p->b, pair_matches(&s->views, p, DIVISION_MATCHES, match), match};
    }
    for (int v = 0; v < w->v->n && !e; v++) {
        const struct extent *px = &w->v->extent[v];
        c.frame[lenses->of[v]] = 0.5 * hypot(px->w, px->h);
        c.focal[lenses->of[v]] = lenses->lens[lenses->of[v]].focal;
    }
    const struct division_views v = {.n_lenses = lenses->n,
                                     .n_pairs = s->n,
                                     .lens_of = lenses->of,
                                     .frame = c.frame,
                                     .focal = c.focal,
                                     .search = {(float)w->v->size, PAIR_BOUND, EPIPOLAR_DRAWS},
                                     .pair = c.pair};
    if (!e)
        e = division_run(w->r, &v, lenses->lens);
    for (int i = 0; i < w->v->n && !e; i++) {
        s->views.bend[i] = lenses->lens[lenses->of[i]].bend;
        s->bent = s->bent || s->views.bend[i] != 0;
    }
    arena_reset(w->r->tmp, mark);
    return e;
}

/* ---- the whole ---- */

static err_t layout_rooms(struct pairs *s, struct arena *tmp, const struct views *v, int threads)
{
    const size_t most = extent_cover(v->extent, v->n).at;
    err_t e = arena_alloc(tmp, (size_t)threads, sizeof *s->rooms, &s->rooms);
    for (int i = 0; i < threads && !e; i++) {
        struct pairs_room w;
        e = arena_alloc(tmp, corner_scratch(most), sizeof *w.picture, &w.picture);
        if (!e)
            e = pair_workspace_init(tmp, &s->views, &w.pair);
        if (!e && !tmp->counts)
            s->rooms[i] = w;
    }
    return e;
}

err_t pairs_layout(struct pairs *s, struct arena *tmp, const struct views *v, int threads)
{
    struct pair_link *links;
    const size_t n = (size_t)v->n;
    s->n = 0;
    s->cap = num_min(v->n * (v->n - 1) / 2,
                     v->n <= PAIR_ALL ? PAIR_ALL * PAIR_ALL : v->n * (ALIKE + AFTER + COMMON));
    err_t e = pair_views_init(tmp, v, &s->views);
    if (!e)
        e = layout_rooms(s, tmp, v, threads);
    if (!e)
        e = arena_alloc(tmp, (size_t)s->cap, sizeof *s->pair, &s->pair);
    if (!e)
        e = arena_alloc(tmp, (size_t)s->cap, sizeof *s->isolated, &s->isolated);
    if (!e)
        e = arena_alloc(tmp, n * n, sizeof *s->index, &s->index);
    if (!e && v->n > PAIR_ALL)
        e = arena_alloc(tmp, n * ALIKE, sizeof *s->near, &s->near);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *s->tree, &s->tree);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *s->roll, &s->roll);
    if (!e) // in one piece: ranks exchange them
        e = arena_alloc(tmp, (size_t)s->cap * (size_t)s->views.cap, sizeof *links, &links);
    for (int k = 0; k < s->cap && !e && !tmp->counts; k++)
        s->pair[k] = (struct pair){.link = links + (size_t)k * (size_t)s->views.cap};
    if (!e && !tmp->counts)
        memset(s->index, -1, n * n * sizeof *s->index);
    return e;
}

void pairs_plan(struct plan *p, const struct pairs *s, int n_lenses)
{
    const size_t mark = arena_mark(&p->tmp);
    struct matches matches;
    if (s->views.n > PAIR_ALL)
        retrieve_plan(p, &s->views);
    if (layout_matches(&matches, &p->tmp, s->cap, n_lenses))
        plan_refuse(p);
    arena_step(&p->tmp, division_plan(n_lenses, s->cap));
    arena_reset(&p->tmp, mark);
}

err_t pairs_run(const struct run *r, const struct views *v, struct division_lenses *lenses,
                struct pairs *s)
{
    struct work w = {r, v, s, 0};
    err_t e = pool_for(r->pool, v->n, prepare_view, &w);
    if (!e)
        e = search_pairs(&w);
    if (e)
        return e;
    find_rolls(s, v->n, PAIR_SURE, true);
    e = share_pairs(&w, 0, turn_pair);
    if (e)
        return e;
    choose_isolated(s);
    e = pool_for(r->pool, v->n, tilt_view, &w);
    if (!e)
        e = share_pairs(&w, 0, tilt_pair);
    if (!e && lenses)
        e = find_bends(&w, lenses);
    if (!e)
        e = share_pairs(&w, 0, complete_pair);
    find_rolls(s, v->n, 0, false);
    return e;
}
