/* Each view becomes corners with descriptors (corner.h), each pair of views a list of matches that
 * one epipolar geometry explains (pair.h). Corners joined by matches, the surest first, are one
 * track, unless two of them lie in one view. The strongest observation of a track is located in the
 * other views to a fraction of a pixel (patch.h). The epipolar geometry of the refined points then
 * removes observations that slid away or never belonged. Long tracks come first; a track whose
 * surroundings are crowded in all of its views is left out. */
#include "core/sfm/match.h"

#include "core/base/num.h"
#include "core/sfm/pairs.h"
#include "core/sfm/patch.h"

#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    SPREAD = 20, // cells of the grid that tracks are spread over, across
    REFINE = 32  // tracks of a chunk
};

#define SIGMA_MIN 0.05f       // px of a level
#define SAME 0.7f             // px of a level, corners of one place
#define CORRELATION_MIN 0.85f // least correlation of a patch that is found again
#define STRETCH_MAX 0.5f      // log2 of areas, up to which no other level is tried
#define SLIDE_MAX 3.0f        // px of a level, from the corner to the patch
#define EXACT 0.8f            // px, Sampson distance of refined observations

struct matcher {
    const struct run *r;
    const struct views *v;
    struct pairs pairs;
    int cap;        // corners of a view
    int *parent;    // (n cap) of union and find
    int *first;     // (n cap) node of a corner's place
    int *next;      // (n cap) members of a track, a ring
    int words;      // of a mask
    uint64_t *mask; // (n cap, words) views of a track
    int n_tracks;
    struct track *track;           // (n cap / 2)
    struct match_observation *obs; // (n cap)
};

struct track {
    int root, at, n;   // node; first observation; observations
    float correlation; // mean
};

/* ---- sizes ---- */

/* So many for PAIR_ALL views, or in proportion for more. */
static size_t for_views(int n_views, size_t most)
{
    return most * (size_t)num_max(n_views, PAIR_ALL) / PAIR_ALL;
}

static size_t obs_cap(int n_views, int size)
{
    const size_t n = (size_t)n_views * (size_t)corner_cap(size),
                 most = for_views(n_views, MATCH_SEEN_MAX);
    return n < most ? n : most;
}

static int tracks_cap(int n_views)
{
    return (int)for_views(n_views, MATCH_TRACKS_MAX);
}

/* ---- tracks ---- */

static int root_of(int *parent, int i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

/* Join the tracks of nodes i and j, unless they share a view. */
static void join_tracks(struct matcher *m, int i, int j)
{
    int a = root_of(m->parent, i), b = root_of(m->parent, j);
    uint64_t *to = m->mask + (size_t)a * (size_t)m->words, both = 0;
    const uint64_t *from = m->mask + (size_t)b * (size_t)m->words;
    for (int k = 0; k < m->words; k++)
        both |= to[k] & from[k];
    if (a == b || both)
        return;
    m->parent[b] = a;
    for (int k = 0; k < m->words; k++)
        to[k] |= from[k];
    int t = m->next[a];
    m->next[a] = m->next[b];
    m->next[b] = t;
}

/* The first corner of a view at the position of corner k, which may be on another level. */
static int corner_at_same_position(const struct corner_view *c, const int *parent, int at, int k)
{
    for (int i = 0; i < k; i++) {
        float reach = SAME * c->level[c->at[i].level].scale;
        float du = c->at[i].u - c->at[k].u, dv = c->at[i].v - c->at[k].v;
        if (parent[at + i] == at + i && du * du + dv * dv < reach * reach)
            return i;
    }
    return k;
}

static void start_nodes(struct matcher *m)
{
    for (int i = 0; i < m->v->n; i++) {
        for (int k = 0; k < m->pairs.views.view[i].n; k++) {
            int at = i * m->cap, node = at + k;
            m->parent[node] = m->first[node] =
                at + corner_at_same_position(m->pairs.views.view + i, m->parent, at, k);
            m->next[node] = node;
            m->mask[(size_t)node * (size_t)m->words + (size_t)i / 64] = (uint64_t)1 << (i % 64);
        }
    }
}

struct edge {
    float doubt;
    int a, b;
};

static int by_edge(const void *x, const void *y)
{
    const struct edge *p = x, *q = y;
    if (p->doubt != q->doubt)
        return p->doubt < q->doubt ? -1 : 1;
    return p->a != q->a ? (p->a < q->a ? -1 : 1) : p->b - q->b;
}

static err_t layout_edges(struct edge **edge, struct arena *tmp, const struct matcher *m)
{
    return arena_alloc(tmp, (size_t)m->pairs.cap * (size_t)m->cap + 1, sizeof **edge, edge);
}

static err_t join_all(struct matcher *m)
{
    size_t n = 0, mark = arena_mark(m->r->tmp);
    struct edge *edge;
    err_t e = layout_edges(&edge, m->r->tmp, m);
    if (e)
        return e;
    for (int i = 0; i < m->pairs.n; i++) {
        const struct pair *c = m->pairs.pair + i;
        for (int k = 0; k < c->n; k++)
            edge[n++] = (struct edge){c->link[k].doubt, m->first[c->a * m->cap + c->link[k].a],
                                      m->first[c->b * m->cap + c->link[k].b]};
    }
    qsort(edge, n, sizeof *edge, by_edge);
    for (size_t i = 0; i < n; i++)
        join_tracks(m, edge[i].a, edge[i].b);
    arena_reset(m->r->tmp, mark);
    return OK;
}

/* ---- refinement ---- */

/* Patches of the reference, from two successive levels. */
struct view_of {
    int level;
    bool cut[2];
    struct patch patch[2];
    int view;
};

/* |log2| of the magnification of a patch where it is found. */
static float log_magnification(const struct patch_position *at)
{
    return fabsf(log2f(fmaxf(fabsf(at->m[0] * at->m[3] - at->m[1] * at->m[2]), 1e-3f)));
}

/* Find the reference at a node's position, on the level where it has the same size and smoothness;
 * otherwise corners seem to move. */
static bool find_member(const struct matcher *m, const struct view_of *o, int node,
                        struct match_observation *out, float *correlation)
{
    const int from[3] = {0, 0, o->level == 0}, to[3] = {0, 1, o->level == 0 ? 0 : -1};
    const struct corner_view *c = m->pairs.views.view + node / m->cap;
    const struct corner *at = c->at + node % m->cap;
    const float roll = m->pairs.roll[node / m->cap] - m->pairs.roll[o->view], x = cosf(roll),
                y = sinf(roll);
    float least = INFINITY;
    for (int i = 0; i < 3 && least > STRETCH_MAX; i++) {
        const struct corner_level *l = c->level + o->level + to[i];
        float u = at->u / l->scale, v = at->v / l->scale;
        struct patch_position found = {.u = u, .v = v, .m = {x, -y, y, x}};
        if (!o->cut[from[i]] || !patch_find(o->patch + from[i], l, &found) ||
            found.correlation < CORRELATION_MIN || log_magnification(&found) >= least ||
            hypotf(found.u - u, found.v - v) > SLIDE_MAX)
            continue;
        least = log_magnification(&found);
        *correlation = found.correlation;
        *out = (struct match_observation){.view = node / m->cap,
                                          .u = found.u * l->scale,
                                          .v = found.v * l->scale,
                                          .sigma = fmaxf(found.sigma, SIGMA_MIN) * l->scale};
    }
    return least < INFINITY;
}

/* The member of a track with the strongest corner. */
static int best_member(const struct matcher *m, int root)
{
    int best = root;
    float top = 0;
    for (int i = m->next[root], k = 0; i != root || !k; i = m->next[i], k++) {
        float strength = m->pairs.views.view[i / m->cap].at[i % m->cap].strength;
        if (strength > top) {
            top = strength;
            best = i;
        }
    }
    return best;
}

static int by_view(const void *a, const void *b)
{
    return ((const struct match_observation *)a)->view -
           ((const struct match_observation *)b)->view;
}

/* Locate a track in its other views; members that are not found are dropped. */
static void refine_track(const struct matcher *m, struct track *t)
{
    int best = best_member(m, t->root);
    struct match_observation *out = m->obs + t->at;
    const struct corner_view *c = m->pairs.views.view + best / m->cap;
    const struct corner *at = c->at + best % m->cap;
    struct view_of reference = {.level = at->level, .view = best / m->cap};
    float sum = 0, least = INFINITY;
    for (int k = 0; k < 2; k++) {
        const struct corner_level *l = c->level + at->level + k;
        reference.cut[k] = patch_make(l, at->u / l->scale, at->v / l->scale, reference.patch + k);
    }
    t->n = 0;
    out[t->n++] = (struct match_observation){.view = best / m->cap, .u = at->u, .v = at->v};
    for (int i = m->next[best]; i != best; i = m->next[i]) {
        float correlation = 0;
        if (!find_member(m, &reference, i, out + t->n, &correlation))
            continue;
        least = fminf(least, out[t->n++].sigma);
        sum += correlation;
    }
    out->sigma = least;
    t->correlation = t->n > 1 ? sum / (float)(t->n - 1) : 0;
    qsort(out, (size_t)t->n, sizeof *out, by_view);
}

static err_t refine_chunk(void *ctx, int chunk, int worker)
{
    struct matcher *m = ctx;
    (void)worker;
    for (int i = chunk * REFINE; i < num_min((chunk + 1) * REFINE, m->n_tracks); i++)
        refine_track(m, m->track + i);
    return run_check(m->r, "matching");
}

static void list_tracks(struct matcher *m)
{
    int at = 0;
    m->n_tracks = 0;
    for (int i = 0; i < m->v->n; i++) {
        for (int node = i * m->cap; node < i * m->cap + m->pairs.views.view[i].n; node++) {
            int n = 1;
            if (m->parent[node] != node || m->next[node] == node)
                continue;
            for (int k = m->next[node]; k != node; k = m->next[k])
                n++;
            m->track[m->n_tracks++] = (struct track){.root = node, .at = at, .n = n};
            at += n;
        }
    }
}

/* ---- pruning ---- */

/* Observation of a track in a view, or NULL. */
static const struct match_observation *seen_in(const struct matcher *m, const struct track *t,
                                               int view)
{
    for (int k = t->at; k < t->at + t->n; k++)
        if (m->obs[k].view == view)
            return m->obs + k;
    return NULL;
}

/* Epipolar geometry of the refined observations of two views. */
static err_t refit_couple(void *ctx, int i_couple, int worker)
{
    struct matcher *m = ctx;
    struct pair *c = m->pairs.pair + i_couple;
    struct epipolar_match *match = m->pairs.rooms[worker].pair.match;
    int n = 0;
    for (int i = 0; i < m->n_tracks && n < m->cap; i++) {
        const struct match_observation *a = seen_in(m, m->track + i, c->a);
        const struct match_observation *b = a ? seen_in(m, m->track + i, c->b) : NULL;
        if (b)
            match[n++] =
                pair_match(&m->pairs.views, c->a, c->b, (float[4]){a->u, a->v, b->u, b->v});
    }
    const struct epipolar_search how = {(float)m->v->size, EXACT, EPIPOLAR_DRAWS};
    int agree = epipolar_run(&how, pair_bend(&m->pairs.views, c), match, n, c->f);
    c->known = agree >= PAIR_LEAST && agree * 2 > n;
    return run_check(m->r, "matching");
}

/* Number of views whose geometry contradicts observation k of a track, less those that confirm it.
 * */
static int votes_against(const struct matcher *m, const struct track *t, int k)
{
    int sum = 0;
    for (int i = 0; i < t->n; i++) {
        const struct match_observation *a = m->obs + t->at + (i < k ? i : k);
        const struct match_observation *b = m->obs + t->at + (i < k ? k : i);
        if (i == k)
            continue;
        const struct pair *c = pairs_of(&m->pairs, a->view, b->view);
        if (!c || !c->known)
            continue;
        const struct epipolar_match match =
            pair_match(&m->pairs.views, a->view, b->view, (float[4]){a->u, a->v, b->u, b->v});
        const double distance = epipolar_distance(c->f, pair_bend(&m->pairs.views, c), &match);
        sum += distance > (double)(EXACT * EXACT) ? 1 : -1;
    }
    return sum;
}

/* Remove the observation with the most views against it, until each has a majority for it. */
static void prune_track(const struct matcher *m, struct track *t)
{
    struct match_observation *at = m->obs + t->at;
    while (t->n >= 2) {
        int worst = 0, most = INT_MIN;
        for (int k = 0; k < t->n; k++) {
            int sum = votes_against(m, t, k);
            worst = sum > most ? k : worst;
            most = sum > most ? sum : most;
        }
        if (most < 0)
            break;
        memmove(at + worst, at + worst + 1, (size_t)(--t->n - worst) * sizeof *at);
    }
}

static err_t prune_chunk(void *ctx, int chunk, int worker)
{
    struct matcher *m = ctx;
    (void)worker;
    for (int i = chunk * REFINE; i < num_min((chunk + 1) * REFINE, m->n_tracks); i++)
        prune_track(m, m->track + i);
    return run_check(m->r, "matching");
}

/* ---- result ---- */

static int by_length(const void *a, const void *b)
{
    const struct track *p = a, *q = b;
    if (p->n != q->n)
        return q->n - p->n;
    if (p->correlation != q->correlation)
        return p->correlation > q->correlation ? -1 : 1;
    return p->root - q->root;
}

/* Whether some view of the track still lacks tracks at its position; if so, counts it. */
static bool adds_coverage(const struct matcher *m, const struct track *t, int crowd,
                          uint16_t *count)
{
    bool room = false;
    for (int turn = 0; turn < 2; turn++) {
        for (int k = t->at; k < t->at + t->n; k++) {
            const struct match_observation *s = m->obs + k;
            const struct extent *px = &m->v->extent[s->view];
            int x = num_min((int)fmaxf(s->u * (SPREAD / (float)px->w), 0), SPREAD - 1);
            int y = num_min((int)fmaxf(s->v * (SPREAD / (float)px->h), 0), SPREAD - 1);
            uint16_t *here = count + (s->view * SPREAD + y) * SPREAD + x;
            room = room || *here < crowd;
            *here = (uint16_t)(*here + turn);
        }
        if (!room)
            return false;
    }
    return true;
}

static err_t layout_count(uint16_t **count, struct arena *tmp, int n_views)
{
    return arena_zalloc(tmp, (size_t)n_views * SPREAD * SPREAD, sizeof **count, count);
}

static err_t layout_tracks(struct match_tracks *t, struct arena *keep, int n_views, int size)
{
    return arena_alloc(keep, obs_cap(n_views, size), sizeof *t->obs, &t->obs);
}

static err_t collect_tracks(struct matcher *m, struct match_tracks *out)
{
    size_t mark = arena_mark(m->r->tmp), keep = arena_mark(m->r->keep);
    int n = 0, crowd = 2 * MATCH_TRACKS_MAX / (SPREAD * SPREAD);
    uint16_t *count;
    err_t e = layout_count(&count, m->r->tmp, m->v->n);
    if (!e)
        e = layout_tracks(out, m->r->keep, m->v->n, m->v->size);
    if (e) {
        arena_reset(m->r->keep, keep);
        arena_reset(m->r->tmp, mark);
        return e;
    }
    qsort(m->track, (size_t)m->n_tracks, sizeof *m->track, by_length);
    for (int i = 0; i < m->n_tracks && m->track[i].n >= 2 && out->n_tracks < tracks_cap(m->v->n);
         i++) {
        const struct track *t = m->track + i;
        if (n + t->n > (int)obs_cap(m->v->n, m->v->size) || !adds_coverage(m, t, crowd, count))
            continue;
        for (int k = 0; k < t->n; k++) {
            out->obs[n] = m->obs[t->at + k];
            out->obs[n++].track = out->n_tracks;
        }
        out->n_tracks++;
    }
    out->n = n;
    arena_reset(m->r->tmp, mark);
    return OK;
}

/* ---- the whole ---- */

static err_t layout(struct matcher *m, struct arena *tmp, int threads)
{
    m->cap = corner_cap(m->v->size);
    m->words = (m->v->n + 63) / 64;
    const size_t nodes = (size_t)m->v->n * (size_t)m->cap;
    err_t e = pairs_layout(&m->pairs, tmp, m->v, threads);
    if (!e)
        e = arena_alloc(tmp, nodes, sizeof *m->parent, &m->parent);
    if (!e)
        e = arena_alloc(tmp, nodes, sizeof *m->first, &m->first);
    if (!e)
        e = arena_alloc(tmp, nodes, sizeof *m->next, &m->next);
    if (!e)
        e = arena_zalloc(tmp, nodes * (size_t)m->words, sizeof *m->mask, &m->mask);
    if (!e)
        e = arena_alloc(tmp, nodes / 2 + 1, sizeof *m->track, &m->track);
    return e ? e : arena_alloc(tmp, nodes, sizeof *m->obs, &m->obs);
}

void match_plan(struct plan *p, const struct views *v, int n_lenses, struct match_tracks *out)
{
    const struct correspondence prior = {.grid = v->size / CORRESPONDENCE_PATCH + 1};
    struct matcher m = {.v = v, .pairs.views.prior = &prior};
    const size_t mark = arena_mark(&p->tmp);
    struct edge *edge;
    uint16_t *count;
    err_t e = layout(&m, &p->tmp, p->threads);
    const size_t level = arena_mark(&p->tmp);
    pairs_plan(p, &m.pairs, n_lenses);
    if (!e)
        e = layout_edges(&edge, &p->tmp, &m);
    arena_reset(&p->tmp, level);
    if (!e)
        e = layout_count(&count, &p->tmp, v->n);
    if (!e)
        e = layout_tracks(out, &p->keep, v->n, v->size);
    if (e)
        plan_refuse(p);
    out->n = (int)obs_cap(v->n, v->size);
    out->n_tracks = num_min(out->n / 2, tracks_cap(v->n));
    arena_reset(&p->tmp, mark);
}

/* Corners, pairs, tracks, refinement, choice. */
static err_t find_tracks(struct matcher *m, struct division_lenses *lenses,
                         struct match_tracks *out)
{
    err_t e = layout(m, m->r->tmp, pool_size(m->r->pool));
    if (!e)
        e = pairs_run(m->r, m->v, lenses, &m->pairs);
    if (e)
        return e;
    start_nodes(m);
    e = join_all(m);
    if (e)
        return e;
    list_tracks(m);
    e = pool_for(m->r->pool, (m->n_tracks + REFINE - 1) / REFINE, refine_chunk, m);
    if (!e)
        e = pool_for(m->r->pool, m->pairs.n, refit_couple, m);
    if (!e)
        e = pool_for(m->r->pool, (m->n_tracks + REFINE - 1) / REFINE, prune_chunk, m);
    return e ? e : collect_tracks(m, out);
}

err_t match_run(const struct run *r, const struct views *v, const struct correspondence *prior,
                struct division_lenses *lenses, struct match_tracks *out)
{
    struct matcher m = {.r = r, .v = v};
    m.pairs.views.k = r->k;
    m.pairs.views.prior = prior && prior->token && prior->n_views == v->n ? prior : NULL;
    size_t mark = arena_mark(r->tmp);
    memset(out, 0, sizeof *out);
    if (v->n < 2 || v->size < CORNER_SIZE_MIN)
        return OK;
    err_t e = find_tracks(&m, lenses, out);
    arena_reset(r->tmp, mark);
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}
