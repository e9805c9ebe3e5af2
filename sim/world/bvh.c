/* A binary tree is built from the top by the surface area heuristic: the centres of the solids are
 * sorted along each axis and the cheapest of all cuts is taken (Wald, On fast Construction of
 * SAH-based Bounding Volume Hierarchies, 2007, without bins: there are at most 1024 solids). Every
 * second level is left out, so that a node holds the boxes of four children, which are tested at
 * once; a leaf is one solid. First hits are searched from the nearest child to the farthest. */
#include "sim/world/bvh.h"

#include "sim/world/vec.h"

#include <stdlib.h>
#include <string.h>

/* Below LEVELS solids are halved: 10 more levels at most, of which each leaves 3 on the stack. */
enum { WIDE = 4, LEVELS = 30, STACK = 128 };

static const float FAR_OFF = 1e30f; // m, of the box of an empty child, which no ray meets

struct bvh_node {
    float box[6][WIDE]; // lo x, y, z, hi x, y, z
    int child[WIDE];    // node, or -1 - solid
    int unused[WIDE];   // to two lines of the cache
};

/* ---- construction ---- */

struct item {
    float lo[3], hi[3], middle[3];
    int solid;
};

struct builder {
    struct item *items; // (n) in the order of the tree
    float *area;        // (n) of the box of the last i items
    struct bvh_node *nodes;
    int n_nodes;
};

struct range {
    int first, n;
};

static void box_none(float lo[3], float hi[3])
{
    for (int k = 0; k < 3; k++) {
        lo[k] = FAR_OFF;
        hi[k] = -FAR_OFF;
    }
}

static void box_add(const struct item *i, float lo[3], float hi[3])
{
    for (int k = 0; k < 3; k++) {
        lo[k] = vec_min(lo[k], i->lo[k]);
        hi[k] = vec_max(hi[k], i->hi[k]);
    }
}

static float box_area(const float lo[3], const float hi[3])
{
    float x = hi[0] - lo[0], y = hi[1] - lo[1], z = hi[2] - lo[2];
    return x * y + y * z + z * x;
}

#define ORDER(axis)                                                                                \
    static int order_##axis(const void *a, const void *b)                                          \
    {                                                                                              \
        const struct item *x = a, *y = b;                                                          \
        float d = x->middle[axis] - y->middle[axis];                                               \
        return d < 0 ? -1 : d > 0 ? 1 : (x->solid > y->solid) - (x->solid < y->solid);             \
    }
ORDER(0)
ORDER(1)
ORDER(2)

static int (*const orders[3])(const void *, const void *) = {order_0, order_1, order_2};

/* Sort along the axis; *cost of the best cut, which is before item number `return`. */
static int cut_along(struct builder *b, struct range r, int axis, float *cost)
{
    struct item *i = b->items + r.first;
    float lo[3], hi[3];
    int best = r.n / 2;
    qsort(i, (size_t)r.n, sizeof *i, orders[axis]);
    box_none(lo, hi);
    for (int k = r.n - 1; k > 0; k--) {
        box_add(i + k, lo, hi);
        b->area[k] = box_area(lo, hi);
    }
    box_none(lo, hi);
    *cost = INFINITY;
    for (int k = 1; k < r.n; k++) {
        box_add(i + k - 1, lo, hi);
        float c = (float)k * box_area(lo, hi) + (float)(r.n - k) * b->area[k];
        if (c < *cost) {
            *cost = c;
            best = k;
        }
    }
    return best;
}

static void halve_range(struct builder *b, struct range r, bool cheap, struct range out[2])
{
    float cost[3];
    int at = 0, best = 0;
    for (int axis = 0; axis < 3; axis++) {
        cut_along(b, r, axis, &cost[axis]);
        best = cost[axis] < cost[best] ? axis : best;
    }
    at = cut_along(b, r, best, &cost[best]);
    at = cheap ? at : r.n / 2;
    out[0] = (struct range){r.first, at};
    out[1] = (struct range){r.first + at, r.n - at};
}

/* Up to four parts of r: the cheapest, or of equal numbers. */
static int split_four(struct builder *b, struct range r, bool cheap, struct range out[WIDE])
{
    struct range half[2];
    int n = 0;
    if (r.n == 1) {
        out[0] = r;
        return 1;
    }
    halve_range(b, r, cheap, half);
    for (int k = 0; k < 2; k++) {
        if (half[k].n > 1) {
            halve_range(b, half[k], cheap, out + n);
            n += 2;
        } else {
            out[n++] = half[k];
        }
    }
    return n;
}

static int make_node(struct builder *b, struct range r, int level)
{
    struct range part[WIDE];
    int at = b->n_nodes++, n = split_four(b, r, level < LEVELS, part);
    for (int k = 0; k < WIDE; k++) {
        float lo[3], hi[3];
        box_none(lo, hi);
        for (int i = 0; k < n && i < part[k].n; i++)
            box_add(b->items + part[k].first + i, lo, hi);
        for (int j = 0; j < 3; j++) {
            b->nodes[at].box[j][k] = k < n ? lo[j] : FAR_OFF;
            b->nodes[at].box[3 + j][k] = k < n ? hi[j] : FAR_OFF;
        }
        int child = 0;
        if (k < n)
            child = part[k].n == 1 ? -1 - b->items[part[k].first].solid
                                   : make_node(b, part[k], level + 1);
        b->nodes[at].child[k] = child;
    }
    return at;
}

/* The results, and above *mark the scratch memory of building, for up to n solids. */
static err_t alloc_tree(struct arena *keep, size_t n, struct bvh *out, struct builder *b,
                        size_t *mark)
{
    const size_t room = n ? n : 1;
    err_t e = arena_alloc(keep, room, sizeof *out->solids, &out->solids);
    if (!e)
        e = arena_alloc(keep, room, sizeof *out->nodes, &out->nodes);
    *mark = arena_mark(keep);
    if (!e)
        e = arena_alloc(keep, room, sizeof *b->items, &b->items);
    if (!e)
        e = arena_alloc(keep, room, sizeof *b->area, &b->area);
    return e;
}

void bvh_plan(struct plan *p)
{
    struct bvh tree;
    struct builder b;
    size_t mark;
    (void)alloc_tree(&p->keep, WORLD_SOLIDS, &tree, &b, &mark); // a counter is never full
    arena_reset(&p->keep, mark);
}

err_t bvh_build(struct arena *keep, const struct world *w, struct bvh *out)
{
    struct builder b = {0};
    size_t n = (size_t)w->n_solids, mark;
    *out = (struct bvh){.n = w->n_solids, .w = w};
    err_t e = alloc_tree(keep, n, out, &b, &mark);
    if (e)
        return e;
    b.nodes = out->nodes;
    for (int i = 0; i < w->n_solids; i++) {
        struct item *it = b.items + i;
        solid_of(w->solids + i, out->solids + i);
        solid_bounds(w->solids + i, it->lo, it->hi);
        for (int k = 0; k < 3; k++)
            it->middle[k] = 0.5f * (it->lo[k] + it->hi[k]);
        it->solid = i;
    }
    if (n)
        make_node(&b, (struct range){0, w->n_solids}, 0);
    arena_reset(keep, mark);
    return OK;
}

/* ---- rays ---- */

struct ray {
    float o[3][WIDE], inverse[3][WIDE]; // once for each child
    size_t near[3], far[3];             // bytes of the rows in bvh_node.box
};

static struct ray make_ray(const float o[3], const float d[3])
{
    struct ray r;
    const size_t row = sizeof(float[WIDE]);
    for (size_t k = 0; k < 3; k++) {
        float inverse = 1 / (fabsf(d[k]) > 1e-20f ? d[k] : 1e-20f);
        for (int i = 0; i < WIDE; i++) {
            r.o[k][i] = o[k];
            r.inverse[k][i] = inverse;
        }
        r.near[k] = row * (inverse < 0 ? 3 + k : k);
        r.far[k] = row * (inverse < 0 ? k : 3 + k);
    }
    return r;
}

static inline const float *row_of(const struct bvh_node *n, size_t at)
{
    return (const float *)(const void *)((const char *)n->box + at);
}

/* Where the ray enters the four children, and whether it meets them; gcc vectorises this only as a
 * function. */
__attribute__((noinline)) static void cross_boxes(const struct bvh_node *restrict n,
                                                  const struct ray *restrict r, float most,
                                                  float *restrict in, int *restrict met)
{
    const float *x0 = row_of(n, r->near[0]), *x1 = row_of(n, r->far[0]);
    const float *y0 = row_of(n, r->near[1]), *y1 = row_of(n, r->far[1]);
    const float *z0 = row_of(n, r->near[2]), *z1 = row_of(n, r->far[2]);
    for (int i = 0; i < WIDE; i++) {
        float x = r->o[0][i], y = r->o[1][i], z = r->o[2][i];
        float a = r->inverse[0][i], b = r->inverse[1][i], c = r->inverse[2][i];
        float near = vec_max((x0[i] - x) * a, vec_max((y0[i] - y) * b, (z0[i] - z) * c));
        float far = vec_min((x1[i] - x) * a, vec_min((y1[i] - y) * b, (z1[i] - z) * c));
        in[i] = vec_max(near, 0);
        met[i] = in[i] <= vec_min(far, most) ? -1 : 0;
    }
}

/* A bit for each child that the ray meets. */
static inline unsigned meet_children(const struct bvh_node *n, const struct ray *r, float most,
                                     float in[WIDE])
{
    int met[WIDE];
    cross_boxes(n, r, most, in, met);
    return ((unsigned)met[0] & 1) | ((unsigned)met[1] & 2) | ((unsigned)met[2] & 4) |
           ((unsigned)met[3] & 8);
}

struct pending {
    int node;
    float t;
};

/* Push the children that the ray meets, the nearest last. */
static int push_nearest_last(const struct bvh_node *n, unsigned met, const float in[WIDE],
                             struct pending stack[WIDE])
{
    int depth = 0;
    for (; met; met &= met - 1) {
        int k = __builtin_ctz(met), at = depth++;
        for (; at > 0 && stack[at - 1].t < in[k]; at--)
            stack[at] = stack[at - 1];
        stack[at] = (struct pending){n->child[k], in[k]};
    }
    return depth;
}

int bvh_first(const struct bvh *b, const float o[3], const float d[3], float most, float *t)
{
    struct pending stack[STACK];
    struct ray r = make_ray(o, d);
    int depth = 0, best = -1;
    *t = most;
    if (b->n)
        stack[depth++] = (struct pending){0, 0};
    while (depth) {
        struct pending next = stack[--depth];
        if (next.t > *t)
            continue;
        if (next.node < 0) {
            float at = solid_hit(b->solids - 1 - next.node, o, d, *t);
            best = at < *t ? -1 - next.node : best;
            *t = at;
            continue;
        }
        float in[WIDE];
        unsigned met = meet_children(b->nodes + next.node, &r, *t, in);
        depth += push_nearest_last(b->nodes + next.node, met, in, stack + depth);
    }
    return best;
}

int bvh_any(const struct bvh *b, const float o[3], const float d[3], float most,
            const int skip_guess[2])
{
    int stack[STACK], depth = 0, skip = skip_guess[0], guess = skip_guess[1];
    if (guess >= 0 && guess != skip && solid_hit(b->solids + guess, o, d, most) < most)
        return guess;
    struct ray r = make_ray(o, d);
    if (b->n)
        stack[depth++] = 0;
    while (depth) {
        const struct bvh_node *n = b->nodes + stack[--depth];
        float in[WIDE];
        for (unsigned met = meet_children(n, &r, most, in); met; met &= met - 1) {
            int child = n->child[__builtin_ctz(met)], solid = -1 - child;
            if (child >= 0)
                stack[depth++] = child;
            else if (solid != skip && solid_hit(b->solids + solid, o, d, most) < most)
                return solid;
        }
    }
    return -1;
}
