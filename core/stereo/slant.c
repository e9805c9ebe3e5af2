#include "core/stereo/slant.h"

#include "core/base/splitmix.h"
#include "core/stereo/transfer.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

enum { PASSES = 4, TRIES = 2, WINDOW = MATCH_TAPS * MATCH_TAPS };

static const float APART = 0.1f; // cost of a step between the depth and a neighbour's that is sure
static const float APART_MAX = 3;
static const float BETTER = 2e-3f; // by which another plane must cost less: more than all that
                                   // windows of MATCH_INSIDE differ
static const float FLAT = 3;       // steps: pixels around that are no further show the slope

/* Inverse depth, and its change per pixel. */
struct plane {
    float rho, u, v;
};

/* The window of the pixel at work. */
struct window {
    int x, y, at;
    float light[WINDOW], known[WINDOW]; // known: -1 outside the picture
};

static void read_window(const struct slant *s, int at, struct window *p)
{
    const struct match_light *own = s->own;
    p->at = at;
    p->x = at % own->w;
    p->y = at / own->w;
    for (int i = 0; i < WINDOW; i++) {
        const int u = p->x + i % MATCH_TAPS - MATCH_RADIUS;
        const int v = p->y + i / MATCH_TAPS - MATCH_RADIUS;
        const bool in = u >= 0 && v >= 0 && u < own->w && v < own->h;
        const float *px = own->px + 2 * (in ? v * own->w + u : 0);
        p->light[i] = px[0];
        p->known[i] = in ? px[1] : -1;
    }
}

static struct plane plane_of(const struct slant *s, const float *rho, int at)
{
    return (struct plane){rho[at], s->slope[2 * at], s->slope[2 * at + 1]};
}

/* ---- cost ---- */

/* The window in the plane against what the neighbour has there. */
static float unlike_light(const struct slant_neighbour *n, const struct window *p,
                          const struct plane *f, float contrast)
{
    const float right = (float)n->light->w - 1.0f, bottom = (float)n->light->h - 1.0f;
    float base[3], du[3], dv[3], m[3] = {0};
    bool centre = false;
    for (int i = 0; i < 3; i++) {
        const double *h = n->h + 4 * i;
        base[i] = (float)(h[0] * (p->x + 0.5) + h[1] * (p->y + 0.5) + h[2] + h[3] * (double)f->rho);
        du[i] = (float)(h[0] + h[3] * (double)f->u);
        dv[i] = (float)(h[1] + h[3] * (double)f->v);
    }
    for (int i = 0; i < WINDOW; i++) {
        const float dx = (float)(i % MATCH_TAPS - MATCH_RADIUS);
        const float dy = (float)(i / MATCH_TAPS - MATCH_RADIUS);
        const float z = base[2] + dx * du[2] + dy * dv[2], inv = 1.0f / z;
        const float u = (base[0] + dx * du[0] + dy * dv[0]) * inv - 0.5f;
        const float v = (base[1] + dx * du[1] + dy * dv[1]) * inv - 0.5f;
        float q[2];
        if (p->known[i] < 0 || !(z > 1e-6f && u >= 0 && v >= 0 && u < right && v < bottom))
            continue;
        match_sample(n->light, u, v, q);
        const float weight = q[1] * p->known[i] + MATCH_INSIDE, diff = p->light[i] - q[0];
        m[0] += weight;
        m[1] += weight * diff;
        m[2] += weight * diff * diff;
        centre = centre || i == WINDOW / 2;
    }
    return centre ? match_cost(m, contrast) : MATCH_OUTSIDE;
}

/* How far the depth is from the neighbour's own. */
static float unlike_depth(const struct slant *s, const struct slant_neighbour *n,
                          const struct window *p, float rho)
{
    double q[3];
    if (!transfer_apply(n->h, p->x + 0.5, p->y + 0.5, (double)rho, q) ||
        !(q[0] >= 0 && q[1] >= 0 && q[0] < n->light->w && q[1] < n->light->h))
        return APART * APART_MAX;
    const int j = (int)q[1] * n->light->w + (int)q[0];
    return APART * n->sure[j] * fminf(fabsf(n->rho[j] * (float)q[2] - rho) / s->step, APART_MAX);
}

/* Of the better half of the neighbours. */
static float cost_of(const struct slant *s, const struct window *p, const struct plane *f,
                     bool depth)
{
    float cost[MATCH_NEAR_MAX] = {0}, sum = 0;
    const int kept = (s->n_near + 1) / 2;
    for (int k = 0; k < s->n_near; k++) {
        float c = unlike_light(&s->near[k], p, f, s->contrast[p->at]);
        if (depth)
            c += unlike_depth(s, &s->near[k], p, f->rho);
        int i = k;
        for (; i > 0 && cost[i - 1] > c; i--)
            cost[i] = cost[i - 1];
        cost[i] = c;
    }
    for (int k = 0; k < kept; k++)
        sum += fminf(cost[k], cost[0] + MATCH_HIDDEN);
    return sum / (float)kept;
}

/* ---- planes ---- */

static void try_plane(const struct slant *s, const struct window *p, const struct plane *f,
                      float *rho)
{
    if (!(f->rho > 0))
        return;
    const float c = cost_of(s, p, f, true);
    if (!(c < s->cost[p->at] - BETTER))
        return;
    s->cost[p->at] = c;
    rho[p->at] = f->rho;
    s->slope[2 * p->at] = f->u;
    s->slope[2 * p->at + 1] = f->v;
}

/* The slope of the map around a pixel. */
static struct plane fit_plane(const struct slant *s, const float *rho, const struct window *p)
{
    const int w = s->own->w;
    struct plane f = {.rho = rho[p->at]};
    float n = 0;
    for (int i = 0; i < WINDOW; i++) {
        const int dx = i % MATCH_TAPS - MATCH_RADIUS, dy = i / MATCH_TAPS - MATCH_RADIUS;
        if (p->known[i] < 0)
            continue;
        const float d = rho[p->at + dy * w + dx] - f.rho;
        if (fabsf(d) > FLAT * s->step)
            continue;
        f.u += (float)dx * d;
        f.v += (float)dy * d;
        n += (float)(dx * dx);
    }
    f.u = n > 0 ? f.u / n : 0;
    f.v = n > 0 ? f.v / n : 0;
    return f;
}

static void begin_plane(const struct slant *s, const struct window *p, float *rho)
{
    const struct plane f = fit_plane(s, rho, p);
    float *slope = s->slope + 2 * p->at;
    slope[0] = slope[1] = 0;
    const struct plane flat = {.rho = rho[p->at]};
    s->cost[p->at] = cost_of(s, p, &flat, true);
    try_plane(s, p, &f, rho);
}

/* -1 .. 1 */
static float spread(uint64_t *state)
{
    return (float)((double)(splitmix_next(state) >> 11) * 0x1p-52 - 1);
}

/* The plane of the pixel so far away, extended to this one. */
static void try_neighbour(const struct slant *s, const struct window *p, int dx, int dy, float *rho)
{
    const int w = s->own->w, h = s->own->h, x = p->x + dx, y = p->y + dy;
    if (x < 0 || y < 0 || x >= w || y >= h)
        return;
    struct plane f = plane_of(s, rho, y * w + x);
    f.rho -= (float)dx * f.u + (float)dy * f.v;
    try_plane(s, p, &f, rho);
}

/* The planes of the pixels before it in the order of the pass, then random ones near its own. */
static void improve(const struct slant *s, const struct window *p, int pass, uint64_t *state,
                    float *rho)
{
    const int back = pass % 2 ? 1 : -1;
    try_neighbour(s, p, back, 0, rho);
    try_neighbour(s, p, 0, back, rho);
    const float reach = s->step * ldexpf(2, -pass);
    for (int k = 0; k < TRIES; k++) {
        struct plane f = plane_of(s, rho, p->at);
        f.rho += reach * spread(state);
        f.u += 0.5f * reach * spread(state);
        f.v += 0.5f * reach * spread(state);
        try_plane(s, p, &f, rho);
    }
}

void slant_refine(const struct slant *s, float *rho)
{
    const int n = s->own->w * s->own->h;
    uint64_t state = 1;
    struct window p;
    for (int i = 0; i < n; i++) {
        read_window(s, i, &p);
        begin_plane(s, &p, rho);
    }
    for (int pass = 0; pass < PASSES; pass++) {
        for (int i = 0; i < n; i++) {
            read_window(s, pass % 2 ? n - 1 - i : i, &p);
            improve(s, &p, pass, &state, rho);
        }
    }
    for (int i = 0; i < n; i++) {
        const struct plane f = plane_of(s, rho, i);
        read_window(s, i, &p);
        s->cost[i] = cost_of(s, &p, &f, false);
    }
}
