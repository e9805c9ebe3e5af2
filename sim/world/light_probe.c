/* Ambient cubes (McTaggart, Half-Life 2 / Valve Source Shading, GDC 2004): irradiance on the six
 * faces of a small cube at each point; on a normal n it is the sum of n_k^2 times the face that n_k
 * points to. Every point traces the same RAYS directions (a Fibonacci lattice) and stores the hits,
 * so that each further bounce costs no rays: the light of a surface is its direct light plus the
 * light from the cubes of the bounce before.
 * Interpolation leaves out points inside solids; it is
 * trilinear times a weight for points on the normal's side (Majercik et al., Dynamic Diffuse Global
 * Illumination with Ray-Traced Irradiance Fields, JCGT 8(2), 2019, section 5). */
#include "sim/world/light_probe.h"

#include "core/base/num.h"
#include "sim/world/vec.h"

#include <string.h>

enum {
    ALONG = 8,
    ALONG_Z = 5,
    LEAST = 2,
    POINTS = ALONG * ALONG * ALONG_Z,
    RAYS = 128,
    BOUNCES = 3
};

static const float PI = (float)NUM_PI;
static const float SPACING = 0.9f;   // m, wanted
static const float FAR = 1000;       // m
static const float SELDOM = 1e-3f;   // weight of a point whose light is the mean of its neighbours
static const float NEAR = 0.4f;      // of a step; how soft the choice of the normal's side is
static const float ALBEDO_AT = 0.3f; // m, footprint of remembered colours

struct light_probe_cube {
    float face[6][4]; // +x, -x, +y, -y, +z, -z: irradiance, r, g, b
    float weight;     // 0: inside a solid
    float unused[7];
};

/* The hit of one ray. */
struct meeting {
    float p[3], n[3];
    float straight[3], albedo[3]; // radiance emitted and reflected from direct light; albedo / pi
};

struct builder {
    const struct run *r;
    const struct light_set *lights;
    struct light_probes *out;
    struct light_probe_cube *last; // of the bounce before
    struct meeting *met;           // (points, RAYS); albedo < 0: nothing
    float d[RAYS][3];
};

static void fibonacci(float d[RAYS][3])
{
    for (int i = 0; i < RAYS; i++) {
        float z = 1 - (2 * (float)i + 1) / RAYS, side = sqrtf(1 - z * z);
        double turn = (double)i * 0.6180339887498949; // golden ratio - 1
        vec_circle((float)(turn - floor(turn)), &d[i][0], &d[i][1]);
        d[i][0] *= side;
        d[i][1] *= side;
        d[i][2] = z;
    }
}

static void probe_position(const struct light_probes *s, int i, float p[3])
{
    int at[3] = {i % s->n[0], i / s->n[0] % s->n[1], i / s->n[0] / s->n[1]};
    for (int k = 0; k < 3; k++)
        p[k] = s->lo[k] + (float)at[k] * s->step[k];
}

static bool inside_solid(const struct bvh *b, const float p[3])
{
    for (int i = 0; i < b->n; i++)
        if (solid_inside(b->solids + i, p))
            return true;
    return false;
}

/* Direct light that the hit surface reflects, and its emission unless it is a listed lamp: that is
 * gathered as direct light. */
static void trace_ray(const struct builder *b, const float o[3], int ray, uint32_t noise,
                      struct meeting *m)
{
    const struct light_set *ls = b->lights;
    struct light_surface on;
    struct light_spot spot = {0};
    struct light_sum sum;
    float t;
    int solid = bvh_first(ls->bvh, o, b->d[ray], FAR, &t);
    m->albedo[0] = -1;
    if (solid < 0)
        return;
    vec_along(o, t, b->d[ray], m->p);
    light_surface(ls->bvh, solid, m->p, b->d[ray], ALBEDO_AT, &on);
    vec_along(m->p, light_lift(t), on.n, m->p);
    memcpy(m->n, on.n, sizeof m->n);
    memcpy(spot.p, m->p, sizeof spot.p);
    memcpy(spot.n, on.n, sizeof spot.n);
    struct light_dice dice = {(uint32_t)ray, noise, light_hash(noise, (uint32_t)ray), 7};
    light_gather(ls, &spot, &dice, &sum);
    for (int k = 0; k < 3; k++) {
        float s = on.material->specular; // mirrored light counts as scattered
        m->albedo[k] = (on.albedo[k] + s * (1 - on.albedo[k])) / PI;
        m->straight[k] = m->albedo[k] * (sum.soft[k] + sum.sun[k]);
        m->straight[k] += ls->listed[solid] ? 0 : on.material->emission[k];
    }
}

static err_t trace_chunk(void *ctx, int chunk, int worker)
{
    const struct builder *b = ctx;
    struct light_probe_cube *c = b->out->all + chunk;
    float p[3];
    (void)worker;
    err_t e = run_check(b->r, "probes");
    if (e)
        return e;
    probe_position(b->out, chunk, p);
    memset(c, 0, sizeof *c);
    c->weight = inside_solid(b->lights->bvh, p) ? 0 : 1;
    for (int i = 0; i < RAYS; i++)
        trace_ray(b, p, i, (uint32_t)chunk, b->met + (size_t)chunk * RAYS + i);
    return OK;
}

static err_t bounce_chunk(void *ctx, int chunk, int worker)
{
    const struct builder *b = ctx;
    struct light_probe_cube *c = b->out->all + chunk;
    struct light_probes before = *b->out;
    before.all = b->last;
    (void)worker;
    memset(c->face, 0, sizeof c->face);
    for (int i = 0; i < RAYS; i++) {
        const struct meeting *m = b->met + (size_t)chunk * RAYS + i;
        float light[3];
        if (m->albedo[0] < 0)
            continue;
        light_probe_irradiance(&before, m->p, m->n, light);
        for (int k = 0; k < 3; k++)
            light[k] = m->straight[k] + m->albedo[k] * light[k];
        for (int axis = 0; axis < 3; axis++) {
            float *face = c->face[2 * axis + (b->d[i][axis] < 0)];
            vec_along(face, fabsf(b->d[i][axis]) * 4 * PI / RAYS, light, face);
        }
    }
    return OK;
}

/* Points inside solids take the mean of their neighbours, for places with no other point near. */
static void fill_hidden(struct light_probes *s)
{
    int jump[3] = {1, s->n[0], s->n[0] * s->n[1]}, n = jump[2] * s->n[2];
    for (int i = 0; i < n; i++) {
        struct light_probe_cube *c = s->all + i;
        float found = 0;
        for (int k = 0; k < 6 && c->weight <= SELDOM; k++) {
            int axis = k / 2, at = i / jump[axis] % s->n[axis] + (k & 1 ? 1 : -1);
            const struct light_probe_cube *near = c + (k & 1 ? jump[axis] : -jump[axis]);
            if (at < 0 || at >= s->n[axis] || near->weight <= SELDOM)
                continue;
            for (int j = 0; j < 24; j++)
                c->face[j / 4][j % 4] =
                    (c->face[j / 4][j % 4] * found + near->face[j / 4][j % 4]) / (found + 1);
            found++;
        }
        c->weight = c->weight > SELDOM ? c->weight : found > 0 ? SELDOM : 0;
    }
}

static void lay_grid(const struct world *w, struct light_probes *out)
{
    for (int k = 0; k < 3; k++) {
        float width = w->hi[k] - w->lo[k];
        int most = k == 2 ? ALONG_Z : ALONG, n = (int)vec_min(width / SPACING, (float)most) + 1;
        out->n[k] = n < LEAST ? LEAST : n > most ? most : n;
        out->step[k] = vec_max(width, 1e-3f) / (float)out->n[k];
        out->lo[k] = w->lo[k] + 0.5f * out->step[k];
    }
}

/* For n points: the cubes in `keep`, scratch memory in `tmp`. */
static err_t alloc_points(struct builder *b, size_t n, struct arena *keep, struct arena *tmp)
{
    err_t e = arena_alloc(keep, n, sizeof *b->out->all, &b->out->all);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *b->last, &b->last);
    if (!e)
        e = arena_alloc(tmp, n, RAYS * sizeof *b->met, &b->met);
    return e;
}

void light_probe_plan(struct plan *p)
{
    struct light_probes s;
    struct builder b = {.out = &s};
    size_t mark = arena_mark(&p->tmp);
    (void)alloc_points(&b, POINTS, &p->keep, &p->tmp); // a counter is never full
    arena_reset(&p->tmp, mark);
}

err_t light_probe_build(const struct run *r, const struct light_set *lights,
                        struct light_probes *out)
{
    struct builder b = {.r = r, .lights = lights, .out = out};
    *out = (struct light_probes){0};
    lay_grid(lights->bvh->w, out);
    fibonacci(b.d);
    int n = out->n[0] * out->n[1] * out->n[2];
    size_t mark = arena_mark(r->tmp);
    err_t e = alloc_points(&b, (size_t)n, r->keep, r->tmp);
    if (!e)
        e = pool_for(r->pool, n, trace_chunk, &b);
    for (int i = 0; i < BOUNCES && !e; i++) {
        fill_hidden(out);
        memcpy(b.last, out->all, (size_t)n * sizeof *out->all);
        e = pool_for(r->pool, n, bounce_chunk, &b);
    }
    if (!e)
        fill_hidden(out);
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- blending ---- */

/* Add the irradiance of one cube, four numbers at a time. */
static void add_cube(const struct light_probe_cube *c, const float squares[3], const int side[3],
                     float weight, float sum[4])
{
    const float *x = c->face[side[0]], *y = c->face[side[1]], *z = c->face[side[2]];
    for (int k = 0; k < 4; k++)
        sum[k] += weight * (squares[0] * x[k] + squares[1] * y[k] + squares[2] * z[k]);
}

void light_probe_irradiance(const struct light_probes *s, const float p[3], const float n[3],
                            float out[3])
{
    float part[3], sum[4] = {0}, all = 0, squares[3], to[3];
    int at[3], side[3], jump[3] = {1, s->n[0], s->n[0] * s->n[1]}, first = 0;
    for (int k = 0; k < 3; k++) {
        float x = (p[k] - s->lo[k]) / s->step[k];
        x = vec_min(vec_max(x, 0), (float)(s->n[k] - 1) - 1e-3f);
        at[k] = (int)x;
        part[k] = x - (float)at[k];
        first += at[k] * jump[k];
        squares[k] = n[k] * n[k];
        side[k] = 2 * k + (n[k] < 0);
    }
    for (int corner = 0; corner < 8; corner++) {
        float weight = 1;
        int i = first;
        for (int k = 0; k < 3; k++) {
            int up = corner >> k & 1;
            i += up ? jump[k] : 0;
            weight *= up ? part[k] : 1 - part[k];
            to[k] = ((float)up - part[k]) * s->step[k];
        }
        float above = vec_dot(to, n), facing = above / (fabsf(above) + NEAR * s->step[0]) + 1;
        weight = (weight + 1e-4f) * (facing * facing * 0.25f + 0.02f) * s->all[i].weight;
        all += weight;
        add_cube(s->all + i, squares, side, weight, sum);
    }
    for (int k = 0; k < 3; k++)
        out[k] = all > 0 ? sum[k] / all : 0;
}
