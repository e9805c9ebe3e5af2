/* All descriptors of one view are multiplied with all of the other in integers (gemm_s8). A match
 * is the best of both views for each other and clearly better than the next one at another place
 * (Lowe 2004, 7.1); places outside the network's attention count as farther, unless its attention
 * is flat. When one epipolar geometry explains enough matches, corners are compared once more along
 * the epipolar lines only: there fewer are alike, which finds half as many matches again. Where few
 * agree, view a is compared as if it were turned, and the turn with the most matches is tried: a
 * whole view has one roll, so corners need no direction of their own, which would cost matches.
 * Surfaces that look squeezed from elsewhere do so each in its own way: matches of all stretched
 * views of b come together. */
#include "core/sfm/pair.h"

#include "core/base/num.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    ROWS = 32,      // corners of a block of products
    UNLIKE = 50000, // squared distance of descriptors that have nothing in common
    FAR = 1 << 28,  // no distance between descriptors
    NONE = -1
};

#define RATIO 0.8f      // of distances to the nearest corner and another (Lowe 2004)
#define RATIO_LINE 0.7f // the same on an epipolar line
#define APART 5.0f      // px, corners that are not the same place
#define ELSEWHERE 1.5f  // factor on distances outside the network's attention
#define SHARE_MIN 0.1f  // least share of the attention on the best tokens, below which it is flat
#define BAND 2.0f       // px, from the epipolar line

/* ---- memory ---- */

static size_t pitch_of(int cap)
{
    return (size_t)(cap + PANEL - 1) / PANEL * PANEL;
}

err_t pair_views_init(struct arena *tmp, const struct views *v, struct pair_views *out)
{
    size_t views = (size_t)v->n, cap = (size_t)corner_cap(v->size);
    out->n = v->n;
    out->size = v->size;
    out->cap = (int)cap;
    err_t e = arena_alloc(tmp, views, sizeof *out->view, &out->view);
    if (!e)
        e = arena_zalloc(tmp, views, sizeof *out->bend, &out->bend);
    if (!e)
        e = arena_alloc(tmp, views * cap, sizeof *out->token, &out->token);
    for (size_t i = 0; i < views && !e; i++) {
        struct corner_view view;
        e = corner_alloc(tmp, v->extent[i].w, v->extent[i].h, &view);
        if (!e && !tmp->counts)
            out->view[i] = view;
    }
    return e;
}

err_t pair_workspace_init(struct arena *tmp, const struct pair_views *v, struct pair_workspace *w)
{
    size_t cap = (size_t)v->cap, grid = v->prior ? (size_t)v->prior->grid : 0;
    w->pitch = pitch_of(v->cap);
    err_t e = arena_alloc(tmp, ROWS * w->pitch, sizeof *w->product, &w->product);
    if (!e)
        e = arena_alloc(tmp, w->pitch, CORNER_DESCRIPTOR, &w->panels);
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
        e = arena_alloc(tmp, ROWS, CORNER_DESCRIPTOR, &w->turned);
    if (!e)
        e = arena_alloc(tmp, ROWS, sizeof *w->square, &w->square);
    if (!e)
        e = arena_alloc(tmp, cap, sizeof *w->match, &w->match);
    if (!e)
        e = arena_alloc(tmp, grid * grid, sizeof *w->expected, &w->expected);
    return e;
}

/* ---- views ---- */

/* The network saw the view squeezed to a square. */
static int token_of(const struct pair_views *m, int view, const struct corner *c)
{
    const struct corner_level *whole = m->view[view].level;
    int g = m->prior->grid;
    int x = num_min((int)(c->u * (float)g / (float)whole->w), g - 1);
    int y = num_min((int)(c->v * (float)g / (float)whole->h), g - 1);
    return y * g + x;
}

void pair_prepare(const struct pair_views *m, int i)
{
    const struct corner_view *c = m->view + i;
    for (int k = 0; k < c->n && m->prior; k++)
        m->token[i * m->cap + k] = token_of(m, i, c->at + k);
}

void pair_pack(const int8_t *descriptor, int n, int8_t *panels)
{
    memset(panels, 0, pitch_of(n) * CORNER_DESCRIPTOR);
    for (int k = 0; k < n; k++) {
        int8_t *to = panels + k / PANEL * PANEL * CORNER_DESCRIPTOR + k % PANEL * 4;
        for (int q = 0; q < CORNER_DESCRIPTOR; q += 4)
            memcpy(to + q * PANEL, descriptor + (size_t)k * CORNER_DESCRIPTOR + q, 4);
    }
}

/* Descriptors of b that are compared: of corner_view. */
static void choose_warp(const struct pair_views *m, const struct pair *c, int warp,
                        struct pair_workspace *w)
{
    const struct corner_view *b = m->view + c->b;
    w->descriptor = b->descriptor[warp];
    w->square_b = b->square[warp];
    pair_pack(w->descriptor, b->n, w->panels);
}

/* ---- search ---- */

/* Mark the tokens of view b around those where the network finds token t of view a. False if its
 * attention is flat. */
static bool mark_expected(const struct pair_views *m, const struct pair *c, int t,
                          uint8_t *expected)
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
    memset(expected, 0, (size_t)(g * g));
    for (int k = 0; k < CORRESPONDENCE_BEST; k++) {
        int x = p->token[at + k] % g, y = p->token[at + k] / g;
        if (p->token[at + k] < 0 || p->share[at + k] < 0.25f * sum / CORRESPONDENCE_BEST)
            continue;
        for (int j = y > 0 ? y - 1 : 0; j <= num_min(y + 1, g - 1); j++)
            for (int i = x > 0 ? x - 1 : 0; i <= num_min(x + 1, g - 1); i++)
                expected[j * g + i] = 1;
    }
    return true;
}

static bool near_by(const struct corner *a, const struct corner *b)
{
    return fabsf(a->u - b->u) < APART && fabsf(a->v - b->v) < APART;
}

/* Candidates for corner i of a: corners of b and squared distances. */
struct trial {
    int i, n;
    const int16_t *at; // (n) corners of b; NULL: all, in order
    int32_t *square;   // (n)
};

/* Increase the distances to corners outside the network's attention. */
static void penalise_unlikely(const struct pair_views *m, const struct pair *c,
                              const struct trial *t, uint8_t *expected)
{
    const int *token = m->token + c->b * m->cap;
    if (!m->prior || !mark_expected(m, c, m->token[c->a * m->cap + t->i], expected))
        return;
    for (int k = 0; k < t->n; k++)
        if (!expected[token[t->at ? t->at[k] : k]])
            t->square[k] = (int32_t)(ELSEWHERE * (float)t->square[k]);
}

/* Note the nearest corner of b and its distance over that of the nearest elsewhere; and for each
 * corner of b the nearest of a so far. */
static void find_nearest(const struct pair_views *m, const struct pair *c, const struct trial *t,
                         struct pair_workspace *w)
{
    const struct corner *b = m->view[c->b].at;
    int32_t best = FAR, next = UNLIKE;
    int to = NONE;
    penalise_unlikely(m, c, t, w->expected);
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

/* Descriptors of corners i .. i + n of a, turned; returns the first, the others follow. */
static const int8_t *turn_rows(const struct pair_views *m, const struct pair *c, int i, int n,
                               struct pair_workspace *w)
{
    const struct corner_view *a = m->view + c->a;
    const int8_t *first = w->turned;
    for (int k = 0; k < n; k++) {
        int8_t *room = w->turned + (size_t)k * CORNER_DESCRIPTOR;
        const int8_t *at = corner_turned(a, i + k, c->turn, room, w->square + k);
        first = k ? first : at;
    }
    return first;
}

/* Compare all with all. */
static void search_all(const struct pair_views *m, const struct pair *c, struct pair_workspace *w)
{
    const struct corner_view *a = m->view + c->a, *b = m->view + c->b;
    for (int i = 0; i < a->n; i++) {
        int32_t *row = w->product + (size_t)(i % ROWS) * w->pitch;
        const int rows = num_min(ROWS, a->n - i);
        if (i % ROWS == 0)
            m->k->net.s8(&(struct gemm_s8){.m = rows,
                                           .panels = (b->n + PANEL - 1) / PANEL,
                                           .segs = 1,
                                           .seg = CORNER_DESCRIPTOR,
                                           .a = turn_rows(m, c, i, rows, w),
                                           .lda = CORNER_DESCRIPTOR,
                                           .w = w->panels,
                                           .ldw = PANEL * CORNER_DESCRIPTOR,
                                           .c = w->product,
                                           .ldc = w->pitch});
        for (int j = 0; j < b->n; j++)
            row[j] = w->square[i % ROWS] + w->square_b[j] - 2 * row[j];
        find_nearest(m, c, &(struct trial){i, b->n, NULL, row}, w);
    }
}

/* The curve of b that a corner of a lies on, in b's lifted coordinates; straight without bend. */
struct curve {
    double line[3], bend;
};

static struct curve curve_of(const struct pair_views *m, const struct pair *c, int i)
{
    const struct epipolar_bend bend = pair_bend(m, c);
    const struct corner *at = m->view[c->a].at + i;
    const struct epipolar_match p = pair_match(m, c->a, c->b, (float[4]){at->u, at->v, 0, 0});
    const double x = p.a[0], y = p.a[1], w = 1 + bend.a * (x * x + y * y);
    struct curve out = {.bend = bend.b};
    for (int k = 0; k < 3; k++)
        out.line[k] = c->f[3 * k] * x + c->f[3 * k + 1] * y + c->f[3 * k + 2] * w;
    return out;
}

/* Whether a point, px from the middle of b, is in the band around the curve. */
static bool is_near(const struct curve *c, double u, double v)
{
    const double *l = c->line;
    const double e = l[0] * u + l[1] * v + l[2] * (1 + c->bend * (u * u + v * v));
    const double gu = l[0] + 2 * c->bend * u * l[2], gv = l[1] + 2 * c->bend * v * l[2];
    return e * e < (double)(BAND * BAND) * (gu * gu + gv * gv);
}

/* Compare with the corners along the epipolar line only. */
static void search_lines(const struct pair_views *m, const struct pair *c, struct pair_workspace *w)
{
    const struct corner_view *a = m->view + c->a, *b = m->view + c->b;
    const double middle[2] = {0.5 * b->level->w, 0.5 * b->level->h};
    for (int i = 0; i < a->n; i++) {
        const struct curve curve = curve_of(m, c, i);
        struct trial t = {i, 0, w->near, w->product};
        for (int j = 0; j < b->n; j++)
            if (is_near(&curve, (double)b->at[j].u - middle[0], (double)b->at[j].v - middle[1]))
                w->near[t.n++] = (int16_t)j;
        const int8_t *p = turn_rows(m, c, i, 1, w);
        for (int k = 0; k < t.n; k++) {
            const int8_t *q = w->descriptor + (size_t)w->near[k] * CORNER_DESCRIPTOR;
            int32_t sum = 0;
            for (int n = 0; n < CORNER_DESCRIPTOR; n++)
                sum += p[n] * q[n];
            t.square[k] = *w->square + w->square_b[w->near[k]] - 2 * sum;
        }
        find_nearest(m, c, &t, w);
    }
}

static int by_doubt(const void *a, const void *b)
{
    const struct pair_link *p = a, *q = b;
    if (p->doubt != q->doubt)
        return p->doubt < q->doubt ? -1 : 1;
    return p->a - q->a;
}

/* Add a link; of those with the same corner only the surest stays. */
static void add_link(const struct pair_link *link, struct pair *c)
{
    int n = 0;
    for (int k = 0; k < c->n; k++)
        if ((c->link[k].a == link->a || c->link[k].b == link->b) && c->link[k].doubt <= link->doubt)
            return;
    for (int k = 0; k < c->n; k++)
        if (c->link[k].a != link->a && c->link[k].b != link->b)
            c->link[n++] = c->link[k];
    c->link[n] = *link;
    c->n = n + 1;
}

/* Links of corners that are each other's nearest, with those before, the surest first. */
static void link_mutual(const struct pair_views *m, struct pair *c, const struct pair_workspace *w,
                        float ratio)
{
    for (int i = 0; i < m->view[c->a].n; i++) {
        const struct pair_link link = {w->doubt[i], (int16_t)i, w->to[i]};
        if (link.b == NONE || w->from[link.b] != i || link.doubt >= ratio * ratio)
            continue;
        if (c->tilted)
            add_link(&link, c);
        else
            c->link[c->n++] = link;
    }
    qsort(c->link, (size_t)c->n, sizeof *c->link, by_doubt);
}

struct epipolar_match pair_match(const struct pair_views *m, int a, int b, const float at[4])
{
    const struct corner_level *p = m->view[a].level, *q = m->view[b].level;
    return (struct epipolar_match){{at[0] - 0.5f * (float)p->w, at[1] - 0.5f * (float)p->h},
                                   {at[2] - 0.5f * (float)q->w, at[3] - 0.5f * (float)q->h}};
}

int pair_matches(const struct pair_views *m, const struct pair *c, int most,
                 struct epipolar_match *match)
{
    const int n = num_min(c->n, most);
    for (int k = 0; k < n; k++) {
        const struct corner *a = m->view[c->a].at + c->link[k].a;
        const struct corner *b = m->view[c->b].at + c->link[k].b;
        match[k] = pair_match(m, c->a, c->b, (float[4]){a->u, a->v, b->u, b->v});
    }
    return n;
}

/* The epipolar geometry that most links agree with. */
static void find_geometry(const struct pair_views *m, struct pair *c, struct epipolar_match *match)
{
    const struct epipolar_search how = {(float)m->size, PAIR_BOUND, EPIPOLAR_DRAWS};
    pair_matches(m, c, c->n, match);
    c->agree = epipolar_run(&how, pair_bend(m, c), match, c->n, c->f);
    c->known = c->agree >= PAIR_LEAST + c->n / 16;
}

static void clear_nearest(const struct pair_views *m, const struct pair *c,
                          struct pair_workspace *w)
{
    for (int j = 0; j < m->view[c->b].n; j++)
        w->column[j] = FAR;
}

/* Add the links with a warped view b. */
static void link_warp(const struct pair_views *m, struct pair *c, int warp,
                      struct pair_workspace *w)
{
    choose_warp(m, c, warp, w);
    clear_nearest(m, c, w);
    search_all(m, c, w);
    link_mutual(m, c, w, RATIO);
}

static bool has_corners(const struct pair_views *m, const struct pair *c)
{
    return m->view[c->a].n >= PAIR_LEAST && m->view[c->b].n >= PAIR_LEAST;
}

/* The links of upright b alone. */
static void link_upright(const struct pair_views *m, struct pair *c, struct pair_workspace *w)
{
    c->n = 0;
    link_warp(m, c, 0, w);
}

/* Whether one geometry explains more links than of the pair as it was before. */
static bool is_better(const struct pair *c, const struct pair *before)
{
    return c->known && c->agree > before->agree + PAIR_LEAST / 2;
}

void pair_search(const struct pair_views *m, struct pair_workspace *w, struct pair *c)
{
    c->n = c->agree = c->turn = 0;
    c->known = c->tilted = false;
    if (!has_corners(m, c))
        return;
    link_upright(m, c, w);
    find_geometry(m, c, w->match);
}

/* The turn that links most is tried. */
void pair_turn(const struct pair_views *m, struct pair_workspace *w, struct pair *c, unsigned turns)
{
    int most = 0, best = 0;
    const struct pair upright = *c;
    for (c->turn = 1; c->turn < CORNER_TURNS && has_corners(m, c); c->turn++) {
        if (turns >> c->turn & 1)
            link_upright(m, c, w);
        if (turns >> c->turn & 1 && c->n > most) {
            most = c->n;
            best = c->turn;
        }
    }
    *c = upright;
    if (!best)
        return;
    c->turn = best;
    link_upright(m, c, w);
    find_geometry(m, c, w->match);
    if (!is_better(c, &upright)) {
        *c = upright;
        link_upright(m, c, w);
    }
}

void pair_tilt(const struct pair_views *m, struct pair_workspace *w, struct pair *c)
{
    const struct pair flat = *c;
    if (!has_corners(m, c))
        return;
    c->tilted = true;
    for (int i = 2; i < CORNER_WARPS; i++)
        link_warp(m, c, i, w);
    find_geometry(m, c, w->match);
    if (!is_better(c, &flat)) {
        *c = flat;
        link_upright(m, c, w);
    }
}

void pair_complete(const struct pair_views *m, struct pair_workspace *w, struct pair *c, bool again)
{
    if (again)
        find_geometry(m, c, w->match);
    c->n = 0;
    for (int i = 0; i < CORNER_WARPS && c->known; i++) {
        if (i == 1 || (i > 1 && !c->tilted)) // a is turned, never b
            continue;
        choose_warp(m, c, i, w);
        clear_nearest(m, c, w);
        search_lines(m, c, w);
        link_mutual(m, c, w, RATIO_LINE);
    }
}
