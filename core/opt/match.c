/* Each view becomes corners with descriptors (corner.h). For each pair of views all descriptors
 * are multiplied with each other in integers; a match is the best of both views for each other and
 * clearly better than the next one elsewhere (Lowe 2004, 7.1), where places that the network does
 * not look at count as worse. Of the matches of a pair those are kept that one epipolar geometry
 * explains. Corners joined by matches, the surest first, are one track, unless two of them lie in
 * one view. The strongest sighting of a track is cut out and found to a fraction of a pixel in the
 * others (patch.h); a last look at the epipolar geometry of the result drops what slid away. */
#include "core/opt/match.h"

#include "core/base/num.h"
#include "core/kernels/kernels.h"
#include "core/opt/corner.h"
#include "core/opt/epipolar.h"
#include "core/opt/patch.h"

#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    ROWS = 32,       // corners of a block of products
    PAIR_LEAST = 12, // matches of a pair
    TRACKS_MAX = 4000,
    SPREAD = 20,    // cells of the grid that tracks are spread over, across
    REFINE = 32,    // tracks of a chunk
    UNLIKE = 50000, // squared distance of descriptors that have nothing in common
    FAR = 1 << 28,  // no distance between descriptors
    NONE = -1
};

#define SIGMA_MIN 0.05f // px of a level
#define RATIO 0.8f      // of distances to the nearest corner and another (Lowe 2004)
#define RATIO_LINE 0.7f // the same on an epipolar line
#define APART 5.0f      // px, corners that are not the same place
#define ELSEWHERE 1.5f  // how much farther descriptors count where the network does not look
#define SHARE_MIN 0.1f  // of the attention that the best tokens need to be believed
#define SAME 0.7f       // px of a level, corners of one place
#define LIKE_MIN 0.85f  // correlation of a patch that is found again
#define LIKE_SURE 0.95f // the same, and no other level is tried
#define SLIDE_MAX 3.0f  // px of a level, from the corner to the patch
#define EXACT 0.8f      // px, Sampson distance of refined sightings
#define BOUND 1.5f      // px, Sampson distance of corners that agree
#define BAND 2.0f       // px, from the epipolar line

/* One match: corners of two views. */
struct link {
    float doubt; // distance over that of the next best
    int16_t a, b;
};

/* Two views; links are good ones, at most corner_cap. */
struct couple {
    int a, b, n;
    struct link *link;
    double f[9]; // epipolar geometry of the refined points
    bool known;  // f
};

struct room {                     // of a worker
    float *picture;               // (corner_scratch)
    int32_t *product;             // (ROWS, pitch)
    int32_t *column;              // (cap) smallest distance to each corner of b
    int16_t *from;                // (cap) where it is
    int16_t *to;                  // (cap) nearest in b of each corner of a
    float *doubt;                 // (cap)
    int16_t *near;                // (cap) corners of b on a line
    struct epipolar_match *match; // (cap)
    uint8_t *look;                // (grid^2) whether the network looks at this token
};

struct matcher {
    const struct run *r;
    const struct views *v;
    const struct correspondence *prior;
    int cap, pitch, n_couples;
    struct corner_view *view; // (n)
    int8_t **panels;          // (n) descriptors as gemm_s8 wants them
    struct couple *couple;    // (n_couples)
    struct room *rooms;
    int *token;        // (n cap) patch of the network that a corner lies in
    int *parent;       // (n cap) of union and find
    int *first, *next; // (n cap) members of a track, a ring
    uint64_t *mask;    // (n cap) views of a track, modulo 64
    int n_tracks;
    struct track *track;     // (n cap / 2)
    struct match_seen *seen; // (n cap)
};

struct track {
    int root, at, n; // node; first sighting; sightings
    float like;      // mean
};

/* ---- sizes ---- */

static size_t seen_cap(int n_views, int size)
{
    size_t n = (size_t)n_views * (size_t)corner_cap(size);
    return n < MATCH_SEEN_MAX ? n : MATCH_SEEN_MAX;
}

/* Place of a pair of views, a < b, among all of n. */
static int couple_of(int n, int a, int b)
{
    return a * (2 * n - a - 1) / 2 + b - a - 1;
}

static size_t pitch_of(int cap)
{
    return (size_t)(cap + PANEL - 1) / PANEL * PANEL;
}

/* ---- pairs ---- */

static int token_of(const struct matcher *m, const struct corner *c)
{
    int g = m->prior->grid;
    int x = num_min((int)(c->u * (float)g / (float)m->v->size), g - 1);
    int y = num_min((int)(c->v * (float)g / (float)m->v->size), g - 1);
    return y * g + x;
}

static err_t prepare_view(void *ctx, int i, int worker)
{
    struct matcher *m = ctx;
    size_t size = (size_t)m->v->size;
    struct corner_view *c = m->view + i;
    err_t e = run_check(m->r, "matching");
    if (e)
        return e;
    corner_run(m->v->rgb + (size_t)i * size * size * 3, m->v->size, m->rooms[worker].picture, c);
    memset(m->panels[i], 0, (size_t)m->pitch * CORNER_WORD);
    for (int k = 0; k < c->n; k++) {
        int8_t *to = m->panels[i] + k / PANEL * PANEL * CORNER_WORD + k % PANEL * 4;
        for (int q = 0; q < CORNER_WORD; q += 4)
            memcpy(to + q * PANEL, c->word + (size_t)k * CORNER_WORD + q, 4);
    }
    for (int k = 0; m->prior && k < c->n; k++)
        m->token[i * m->cap + k] = token_of(m, c->at + k);
    return OK;
}

/* Mark the tokens of view b around those where the network finds token t of view a. False if it
 * does not know. */
static bool look_for(const struct matcher *m, const struct couple *c, int t, uint8_t *look)
{
    const struct correspondence *p = m->prior;
    int g = p->grid;
    size_t at = (((size_t)c->a * (size_t)(g * g) + (size_t)t) * (size_t)p->n_views + (size_t)c->b) *
                CORRESPONDENCE_BEST;
    float sum = 0;
    for (int k = 0; k < CORRESPONDENCE_BEST; k++)
        sum += p->token[at + k] >= 0 ? p->share[at + k] : 0;
    if (sum < SHARE_MIN)
        return false;
    memset(look, 0, (size_t)(g * g));
    for (int k = 0; k < CORRESPONDENCE_BEST; k++) {
        int x = p->token[at + k] % g, y = p->token[at + k] / g;
        if (p->token[at + k] < 0 || p->share[at + k] < 0.25f * sum / CORRESPONDENCE_BEST)
            continue;
        for (int j = y > 0 ? y - 1 : 0; j <= num_min(y + 1, g - 1); j++)
            for (int i = x > 0 ? x - 1 : 0; i <= num_min(x + 1, g - 1); i++)
                look[j * g + i] = 1;
    }
    return true;
}

static bool near_by(const struct corner *a, const struct corner *b)
{
    return fabsf(a->u - b->u) < APART && fabsf(a->v - b->v) < APART;
}

/* What corner i of a may be compared with: corners of b and squared distances. */
struct trial {
    int i, n;
    const int16_t *at; // (n) corners of b; NULL: all, in order
    int32_t *square;   // (n)
};

/* Places that the network does not look at count as farther. */
static void narrow(const struct matcher *m, const struct couple *c, const struct trial *t,
                   uint8_t *look)
{
    const int *token = m->token + c->b * m->cap;
    if (!m->prior || !look_for(m, c, m->token[c->a * m->cap + t->i], look))
        return;
    for (int k = 0; k < t->n; k++)
        if (!look[token[t->at ? t->at[k] : k]])
            t->square[k] = (int32_t)(ELSEWHERE * (float)t->square[k]);
}

/* Remember the nearest corner of b, how much nearer it is than any elsewhere, and for each of b
 * whether this one is the nearest so far. */
static void nearest(const struct matcher *m, const struct couple *c, const struct trial *t,
                    struct room *w)
{
    const struct corner *b = m->view[c->b].at;
    int32_t best = FAR, next = UNLIKE;
    int to = NONE;
    narrow(m, c, t, w->look);
    for (int k = 0; k < t->n; k++) {
        int j = t->at ? t->at[k] : k;
        if (t->square[k] < best) {
            best = t->square[k];
            to = j;
        }
        if (t->square[k] < w->column[j]) {
            w->column[j] = t->square[k];
            w->from[j] = (int16_t)t->i;
        }
    }
    for (int k = 0; k < t->n; k++)
        if (t->square[k] < next && !near_by(b + to, b + (t->at ? t->at[k] : k)))
            next = t->square[k];
    w->to[t->i] = (int16_t)to;
    w->doubt[t->i] = ((float)best + 1) / ((float)next + 1);
}

/* Compare all with all. */
static void search(const struct matcher *m, const struct couple *c, struct room *w)
{
    const struct corner_view *a = m->view + c->a, *b = m->view + c->b;
    for (int i = 0; i < a->n; i++) {
        int32_t *row = w->product + (size_t)(i % ROWS) * (size_t)m->pitch;
        if (i % ROWS == 0)
            m->r->k->net.s8(&(struct gemm_s8){.m = num_min(ROWS, a->n - i),
                                              .panels = (b->n + PANEL - 1) / PANEL,
                                              .segs = 1,
                                              .seg = CORNER_WORD,
                                              .a = a->word + (size_t)i * CORNER_WORD,
                                              .lda = CORNER_WORD,
                                              .w = m->panels[c->b],
                                              .ldw = PANEL * CORNER_WORD,
                                              .c = w->product,
                                              .ldc = (size_t)m->pitch});
        for (int j = 0; j < b->n; j++)
            row[j] = a->square[i] + b->square[j] - 2 * row[j];
        nearest(m, c, &(struct trial){i, b->n, NULL, row}, w);
    }
}

/* Compare with what lies along the epipolar line only. */
static void search_lines(const struct matcher *m, const struct couple *c, struct room *w)
{
    const struct corner_view *a = m->view + c->a, *b = m->view + c->b;
    const float middle = 0.5f * (float)m->v->size;
    for (int i = 0; i < a->n; i++) {
        float x = a->at[i].u - middle, y = a->at[i].v - middle, line[3];
        for (int k = 0; k < 3; k++)
            line[k] = (float)(c->f[3 * k] * x + c->f[3 * k + 1] * y + c->f[3 * k + 2]);
        float reach = BAND * sqrtf(line[0] * line[0] + line[1] * line[1]);
        struct trial t = {i, 0, w->near, w->product};
        line[2] -= middle * (line[0] + line[1]);
        for (int j = 0; j < b->n; j++)
            if (fabsf(line[0] * b->at[j].u + line[1] * b->at[j].v + line[2]) < reach)
                w->near[t.n++] = (int16_t)j;
        for (int k = 0; k < t.n; k++) {
            const int8_t *p = a->word + (size_t)i * CORNER_WORD;
            const int8_t *q = b->word + (size_t)w->near[k] * CORNER_WORD;
            int32_t sum = 0;
            for (int n = 0; n < CORNER_WORD; n++)
                sum += p[n] * q[n];
            t.square[k] = a->square[i] + b->square[w->near[k]] - 2 * sum;
        }
        nearest(m, c, &t, w);
    }
}

static int by_doubt(const void *a, const void *b)
{
    const struct link *p = a, *q = b;
    if (p->doubt != q->doubt)
        return p->doubt < q->doubt ? -1 : 1;
    return p->a - q->a;
}

/* Links of corners that are each other's nearest, the surest first. */
static void link_up(const struct matcher *m, struct couple *c, const struct room *w, float ratio)
{
    c->n = 0;
    for (int i = 0; i < m->view[c->a].n; i++)
        if (w->to[i] != NONE && w->from[w->to[i]] == i && w->doubt[i] < ratio * ratio)
            c->link[c->n++] = (struct link){w->doubt[i], (int16_t)i, w->to[i]};
    qsort(c->link, (size_t)c->n, sizeof *c->link, by_doubt);
}

static struct epipolar_match meeting(const struct matcher *m, float au, float av, float bu,
                                     float bv)
{
    const float middle = 0.5f * (float)m->v->size;
    return (struct epipolar_match){{au - middle, av - middle}, {bu - middle, bv - middle}};
}

/* The epipolar geometry that most links agree with. */
static void find_geometry(const struct matcher *m, struct couple *c, struct epipolar_match *match)
{
    for (int k = 0; k < c->n; k++) {
        const struct corner *a = m->view[c->a].at + c->link[k].a;
        const struct corner *b = m->view[c->b].at + c->link[k].b;
        match[k] = meeting(m, a->u, a->v, b->u, b->v);
    }
    int agree = epipolar_run(match, c->n, (float)m->v->size, BOUND, c->f);
    c->known = agree >= PAIR_LEAST + c->n / 16;
}

static err_t match_couple(void *ctx, int i_couple, int worker)
{
    struct matcher *m = ctx;
    struct couple *c = m->couple + i_couple;
    struct room *w = m->rooms + worker;
    err_t e = run_check(m->r, "matching");
    c->n = 0;
    if (e || m->view[c->a].n < PAIR_LEAST || m->view[c->b].n < PAIR_LEAST)
        return e;
    for (int turn = 0; turn < 2; turn++) {
        for (int j = 0; j < m->view[c->b].n; j++)
            w->column[j] = FAR;
        if (turn)
            search_lines(m, c, w);
        else
            search(m, c, w);
        link_up(m, c, w, turn ? RATIO_LINE : RATIO);
        if (!turn)
            find_geometry(m, c, w->match);
        if (!c->known) {
            c->n = 0;
            break;
        }
    }
    return OK;
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

/* Make one track of those of nodes i and j, unless they share a view. */
static void join(struct matcher *m, int i, int j)
{
    int a = root_of(m->parent, i), b = root_of(m->parent, j);
    if (a == b || (m->mask[a] & m->mask[b]))
        return;
    m->parent[b] = a;
    m->mask[a] |= m->mask[b];
    int t = m->next[a];
    m->next[a] = m->next[b];
    m->next[b] = t;
}

/* Corners of one place on several levels are one node: the finest. */
static void start_nodes(struct matcher *m)
{
    for (int i = 0; i < m->v->n; i++) {
        const struct corner_view *c = m->view + i;
        for (int k = 0; k < c->n; k++) {
            int node = i * m->cap + k, p = 0;
            while (p < k) {
                float reach = SAME * c->level[c->at[p].level].scale;
                float du = c->at[p].u - c->at[k].u, dv = c->at[p].v - c->at[k].v;
                if (m->parent[i * m->cap + p] == i * m->cap + p &&
                    du * du + dv * dv < reach * reach)
                    break;
                p++;
            }
            m->parent[node] = i * m->cap + p;
            m->next[node] = node;
            m->mask[node] = (uint64_t)1 << (i % 64);
        }
    }
    memcpy(m->first, m->parent, (size_t)m->v->n * (size_t)m->cap * sizeof *m->first);
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

static err_t join_all(struct matcher *m)
{
    size_t n = 0, mark = arena_mark(m->r->tmp);
    struct edge *edge;
    for (int i = 0; i < m->n_couples; i++)
        n += (size_t)m->couple[i].n;
    err_t e = arena_alloc(m->r->tmp, n + 1, sizeof *edge, &edge);
    if (e)
        return e;
    n = 0;
    for (int i = 0; i < m->n_couples; i++) {
        const struct couple *c = m->couple + i;
        for (int k = 0; k < c->n; k++)
            edge[n++] = (struct edge){c->link[k].doubt, m->first[c->a * m->cap + c->link[k].a],
                                      m->first[c->b * m->cap + c->link[k].b]};
    }
    qsort(edge, n, sizeof *edge, by_edge);
    for (size_t i = 0; i < n; i++)
        join(m, edge[i].a, edge[i].b);
    arena_reset(m->r->tmp, mark);
    return OK;
}

/* ---- refinement ---- */

/* Find a patch of `level` at a node's place on the level that shows it best: this one, or a
 * neighbour where the camera was nearer or farther. */
static bool find_member(const struct matcher *m, const struct patch *p, int level, int node,
                        struct match_seen *out, float *like)
{
    static const int other[3] = {0, 1, -1};
    const struct corner_view *c = m->view + node / m->cap;
    const struct corner *at = c->at + node % m->cap;
    *like = -1;
    for (int i = 0; i < 3 && *like < LIKE_SURE; i++) {
        if (level + other[i] < 0)
            continue;
        const struct corner_level *l = c->level + level + other[i];
        float u = at->u / l->scale, v = at->v / l->scale;
        struct patch_place place = {.u = u, .v = v, .m = {1, 0, 0, 1}};
        if (!patch_find(p, l, &place) || place.like <= *like ||
            hypotf(place.u - u, place.v - v) > SLIDE_MAX)
            continue;
        *like = place.like;
        *out = (struct match_seen){.view = node / m->cap,
                                   .u = place.u * l->scale,
                                   .v = place.v * l->scale,
                                   .sigma = fmaxf(place.sigma, SIGMA_MIN) * l->scale};
    }
    return *like > LIKE_MIN;
}

/* Member of a track that shows it best. */
static int reference(const struct matcher *m, int root)
{
    int best = root;
    float top = 0;
    for (int i = m->next[root], k = 0; i != root || !k; i = m->next[i], k++) {
        float strength = m->view[i / m->cap].at[i % m->cap].strength;
        if (strength > top) {
            top = strength;
            best = i;
        }
    }
    return best;
}

static int by_view(const void *a, const void *b)
{
    return ((const struct match_seen *)a)->view - ((const struct match_seen *)b)->view;
}

/* Sightings of a track where it is found again. */
static void refine_track(const struct matcher *m, struct track *t)
{
    int best = reference(m, t->root);
    struct match_seen *out = m->seen + t->at;
    struct patch p;
    const struct corner_view *c = m->view + best / m->cap;
    const struct corner *at = c->at + best % m->cap;
    const struct corner_level *l = c->level + at->level;
    float sum = 0, least = INFINITY;
    t->n = 0;
    if (!patch_make(l, at->u / l->scale, at->v / l->scale, &p))
        return;
    out[t->n++] = (struct match_seen){.view = best / m->cap, .u = at->u, .v = at->v};
    for (int i = m->next[best]; i != best; i = m->next[i]) {
        float like;
        if (!find_member(m, &p, at->level, i, out + t->n, &like))
            continue;
        least = fminf(least, out[t->n++].sigma);
        sum += like;
    }
    out->sigma = least;
    t->like = t->n > 1 ? sum / (float)(t->n - 1) : 0;
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
        for (int node = i * m->cap; node < i * m->cap + m->view[i].n; node++) {
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

/* ---- a last look ---- */

/* Sighting of a track in a view, or NULL. */
static const struct match_seen *seen_in(const struct matcher *m, const struct track *t, int view)
{
    for (int k = t->at; k < t->at + t->n; k++)
        if (m->seen[k].view == view)
            return m->seen + k;
    return NULL;
}

/* Epipolar geometry of the refined sightings of two views. */
static err_t look_again(void *ctx, int i_couple, int worker)
{
    struct matcher *m = ctx;
    struct couple *c = m->couple + i_couple;
    struct epipolar_match *match = m->rooms[worker].match;
    int n = 0;
    for (int i = 0; i < m->n_tracks && n < m->cap; i++) {
        const struct match_seen *a = seen_in(m, m->track + i, c->a);
        const struct match_seen *b = a ? seen_in(m, m->track + i, c->b) : NULL;
        if (b)
            match[n++] = meeting(m, a->u, a->v, b->u, b->v);
    }
    int agree = epipolar_run(match, n, (float)m->v->size, EXACT, c->f);
    c->known = agree >= PAIR_LEAST && agree * 2 > n;
    return run_check(m->r, "matching");
}

/* Views that speak against sighting k of a track, less those that speak for it. */
static int against(const struct matcher *m, const struct track *t, int k)
{
    int sum = 0;
    for (int i = 0; i < t->n; i++) {
        const struct match_seen *a = m->seen + t->at + (i < k ? i : k);
        const struct match_seen *b = m->seen + t->at + (i < k ? k : i);
        if (i == k)
            continue;
        const struct couple *c = m->couple + couple_of(m->v->n, a->view, b->view);
        const struct epipolar_match match = meeting(m, a->u, a->v, b->u, b->v);
        if (c->known)
            sum += epipolar_distance(c->f, &match) > (double)(EXACT * EXACT) ? 1 : -1;
    }
    return sum;
}

/* Take away the sighting that most views speak against, until none is left. */
static err_t settle_chunk(void *ctx, int chunk, int worker)
{
    struct matcher *m = ctx;
    (void)worker;
    for (int i = chunk * REFINE; i < num_min((chunk + 1) * REFINE, m->n_tracks); i++) {
        struct track *t = m->track + i;
        while (t->n > 0) {
            int worst = 0, most = INT_MIN;
            for (int k = 0; k < t->n; k++) {
                int sum = against(m, t, k);
                if (sum > most) {
                    most = sum;
                    worst = k;
                }
            }
            if (most < 0 || t->n < 2)
                break;
            struct match_seen *at = m->seen + t->at;
            memmove(at + worst, at + worst + 1, (size_t)(--t->n - worst) * sizeof *at);
        }
    }
    return run_check(m->r, "matching");
}

/* ---- result ---- */

static int by_length(const void *a, const void *b)
{
    const struct track *p = a, *q = b;
    if (p->n != q->n)
        return q->n - p->n;
    if (p->like != q->like)
        return p->like > q->like ? -1 : 1;
    return p->root - q->root;
}

/* Whether some view of the track still lacks tracks where this one is; counts it. */
static bool wanted(const struct matcher *m, const struct track *t, int crowd, uint16_t *count)
{
    bool room = false;
    for (int turn = 0; turn < 2; turn++) {
        for (int k = t->at; k < t->at + t->n; k++) {
            const struct match_seen *s = m->seen + k;
            float cell = SPREAD / (float)m->v->size;
            int x = num_min((int)fmaxf(s->u * cell, 0), SPREAD - 1);
            int y = num_min((int)fmaxf(s->v * cell, 0), SPREAD - 1);
            uint16_t *here = count + (s->view * SPREAD + y) * SPREAD + x;
            room = room || *here < crowd;
            *here = (uint16_t)(*here + turn);
        }
        if (!room)
            return false;
    }
    return true;
}

static err_t collect(struct matcher *m, struct match_tracks *out)
{
    size_t mark = arena_mark(m->r->tmp), keep = arena_mark(m->r->keep);
    int n = 0, crowd = 2 * TRACKS_MAX / (SPREAD * SPREAD);
    uint16_t *count;
    err_t e = arena_zalloc(m->r->tmp, (size_t)m->v->n * SPREAD * SPREAD, sizeof *count, &count);
    if (!e)
        e = arena_alloc(m->r->keep, seen_cap(m->v->n, m->v->size), sizeof *out->seen, &out->seen);
    if (e) {
        arena_reset(m->r->keep, keep);
        arena_reset(m->r->tmp, mark);
        return e;
    }
    qsort(m->track, (size_t)m->n_tracks, sizeof *m->track, by_length);
    for (int i = 0; i < m->n_tracks && m->track[i].n >= 2 && out->n_tracks < TRACKS_MAX; i++) {
        const struct track *t = m->track + i;
        if (n + t->n > (int)seen_cap(m->v->n, m->v->size) || !wanted(m, t, crowd, count))
            continue;
        for (int k = 0; k < t->n; k++) {
            out->seen[n] = m->seen[t->at + k];
            out->seen[n++].track = out->n_tracks;
        }
        out->n_tracks++;
    }
    out->n = n;
    arena_reset(m->r->tmp, mark);
    return OK;
}

/* ---- the whole ---- */

static err_t alloc_room(const struct matcher *m, struct room *w)
{
    struct arena *tmp = m->r->tmp;
    size_t cap = (size_t)m->cap, grid = m->prior ? (size_t)m->prior->grid : 0;
    err_t e = arena_alloc(tmp, corner_scratch(m->v->size), sizeof(float), &w->picture);
    if (!e)
        e = arena_alloc(tmp, ROWS * (size_t)m->pitch, sizeof(int32_t), &w->product);
    if (!e)
        e = arena_alloc(tmp, cap, sizeof *w->column, &w->column);
    if (!e)
        e = arena_alloc(tmp, cap, sizeof *w->from, &w->from);
    if (!e)
        e = arena_alloc(tmp, cap, sizeof *w->to, &w->to);
    if (!e)
        e = arena_alloc(tmp, cap, sizeof *w->doubt, &w->doubt);
    if (!e)
        e = arena_alloc(tmp, cap, sizeof *w->near, &w->near);
    if (!e)
        e = arena_alloc(tmp, cap, sizeof *w->match, &w->match);
    if (!e)
        e = arena_alloc(tmp, grid * grid, 1, &w->look);
    return e;
}

static err_t alloc_views(struct matcher *m)
{
    struct arena *tmp = m->r->tmp;
    size_t n = (size_t)m->v->n, workers = (size_t)pool_size(m->r->pool);
    err_t e = arena_alloc(tmp, n, sizeof *m->view, &m->view);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *m->panels, &m->panels);
    if (!e)
        e = arena_alloc(tmp, workers, sizeof *m->rooms, &m->rooms);
    for (size_t i = 0; i < n && !e; i++) {
        e = corner_alloc(tmp, m->v->size, m->view + i);
        if (!e)
            e = arena_alloc(tmp, (size_t)m->pitch, CORNER_WORD, m->panels + i);
    }
    for (size_t i = 0; i < workers && !e; i++)
        e = alloc_room(m, m->rooms + i);
    return e;
}

static err_t alloc_pairs(struct matcher *m)
{
    struct arena *tmp = m->r->tmp;
    size_t cap = (size_t)m->cap, nodes = (size_t)m->v->n * cap;
    err_t e = arena_alloc(tmp, (size_t)m->n_couples, sizeof *m->couple, &m->couple);
    for (int a = 0, k = 0; a < m->v->n; a++) {
        for (int b = a + 1; b < m->v->n && !e; b++, k++) {
            m->couple[k] = (struct couple){.a = a, .b = b};
            e = arena_alloc(tmp, cap, sizeof(struct link), &m->couple[k].link);
        }
    }
    if (!e)
        e = arena_alloc(tmp, nodes, sizeof *m->token, &m->token);
    if (!e)
        e = arena_alloc(tmp, nodes, sizeof *m->parent, &m->parent);
    if (!e)
        e = arena_alloc(tmp, nodes, sizeof *m->first, &m->first);
    if (!e)
        e = arena_alloc(tmp, nodes, sizeof *m->next, &m->next);
    if (!e)
        e = arena_alloc(tmp, nodes, sizeof *m->mask, &m->mask);
    if (!e)
        e = arena_alloc(tmp, nodes / 2 + 1, sizeof *m->track, &m->track);
    if (!e)
        e = arena_alloc(tmp, nodes, sizeof *m->seen, &m->seen);
    return e;
}

size_t match_plan(int n_views, int size, int threads)
{
    size_t n = (size_t)n_views, w = (size_t)threads, cap = (size_t)corner_cap(size);
    size_t couples = n * (n - 1) / 2, nodes = n * cap, grid = (size_t)size / NET_PATCH + 1;
    size_t each = arena_add(corner_keep(size), arena_need(pitch_of((int)cap), CORNER_WORD));
    size_t room = arena_add(arena_need(corner_scratch(size), sizeof(float)),
                            arena_need(ROWS * pitch_of((int)cap), sizeof(int32_t)));
    room = arena_add(room, arena_need(cap, 64));
    room = arena_add(room, arena_need(grid * grid + 8 * ARENA_ALIGN, 1));
    size_t sum = arena_need(n, each);
    sum = arena_add(sum, arena_need(w, arena_add(room, sizeof(struct room))));
    sum = arena_add(sum, arena_need(n, sizeof(struct corner_view) + 64));
    sum = arena_add(sum, arena_need(couples, arena_need(cap, sizeof(struct link))));
    sum = arena_add(sum, arena_need(couples, sizeof(struct couple)));
    sum = arena_add(sum, arena_need(couples * cap + 1, sizeof(struct edge)));
    sum = arena_add(sum, arena_need(nodes, 4 * sizeof(int) + sizeof(uint64_t) +
                                               sizeof(struct match_seen) + sizeof(struct track)));
    return arena_add(sum, arena_need(n * SPREAD * SPREAD + 64, 16 * sizeof(uint16_t)));
}

size_t match_keep(int n_views, int size)
{
    return arena_need(seen_cap(n_views, size), sizeof(struct match_seen));
}

/* Corners, pairs, tracks, refinement, choice. */
static err_t find_tracks(struct matcher *m, struct match_tracks *out)
{
    err_t e = alloc_views(m);
    if (!e)
        e = alloc_pairs(m);
    if (!e)
        e = pool_for(m->r->pool, m->v->n, prepare_view, m);
    if (!e)
        e = pool_for(m->r->pool, m->n_couples, match_couple, m);
    if (e)
        return e;
    start_nodes(m);
    e = join_all(m);
    if (e)
        return e;
    list_tracks(m);
    e = pool_for(m->r->pool, (m->n_tracks + REFINE - 1) / REFINE, refine_chunk, m);
    if (!e)
        e = pool_for(m->r->pool, m->n_couples, look_again, m);
    if (!e)
        e = pool_for(m->r->pool, (m->n_tracks + REFINE - 1) / REFINE, settle_chunk, m);
    return e ? e : collect(m, out);
}

err_t match_run(const struct run *r, const struct views *v, const struct correspondence *prior,
                struct match_tracks *out)
{
    int cap = corner_cap(v->size);
    struct matcher m = {.r = r,
                        .v = v,
                        .prior = prior && prior->token ? prior : NULL,
                        .cap = cap,
                        .pitch = (int)pitch_of(cap),
                        .n_couples = v->n * (v->n - 1) / 2};
    size_t mark = arena_mark(r->tmp);
    memset(out, 0, sizeof *out);
    if (v->n < 2 || v->size < CORNER_SIZE_MIN)
        return OK;
    err_t e = find_tracks(&m, out);
    arena_reset(r->tmp, mark);
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}
