/* Light from a point y of a lamp: L cos(x) cos(y) dA / |x - y|^2 if nothing is between x and y.
 * Points are drawn in the frame of the unit shape and areas follow by the map (a normal of length
 * area goes to det m^T n): of a ball the part that is seen, evenly over its outline; of a box or
 * frustum one face by the area it shows; of a torus the cone around it. Light through an opening is
 * that of the sky behind a point of it, whatever is in the way on either side.
 * At most PICKS lights are drawn, each with a probability p that grows with what it would give
 * without shadows (systematic sampling, so that all p are exact), and count 1 / p.
 * Numbers of neighbouring pixels are points of one (0,2)-sequence (Kollig and Keller, Efficient
 * Multidimensional Sampling, 2002), scrambled by dimension, random below the strata.
 * Gloss: a cosine lobe around the mirrored ray (Lewis, Making Shaders More Physically Plausible,
 * 1994), (n + 1) / 2 pi cos^n. */
#include "sim/world/light.h"

#include "core/base/num.h"
#include "sim/world/vec.h"

#include <string.h>

enum { PICKS = 2, DIM_SUN = 40, DIM_DOME = 41, DIM_PICK = 42 };

static const float PI = (float)NUM_PI;
static const float SLANT = 0.15f; // least cosine, for the width of a footprint
static const float EVENLY = 0.4f; // share of the probabilities that is equal for all lights
static const float BEYOND = 1e4f; // m, how far rays to the sky go

float light_lift(float t)
{
    return 1e-4f + 2e-5f * t;
}

/* Wellons, Prospecting for Hash Functions (2018): lowbias32. */
uint32_t light_hash(uint32_t a, uint32_t b)
{
    uint32_t x = a ^ (b * 0x9e3779b9u + 0x7f4a7c15u);
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

void light_throw(const struct light_dice *d, uint32_t dim, float u[2])
{
    uint32_t x = 0, y = 0, v = 1u << 31, fine = d->bits < 31 ? 0xffffffffu >> d->bits : 0;
    for (uint32_t i = d->index, bit = 1u << 31; i; i >>= 1, bit >>= 1, v ^= v >> 1) {
        x ^= i & 1 ? bit : 0;
        y ^= i & 1 ? v : 0;
    }
    uint32_t whole = light_hash(d->seed, dim), single = light_hash(d->noise, dim);
    x ^= whole ^ (single & fine);
    y ^= whole * 0x2c1b3c6du ^ (single * 0x297a2d39u & fine);
    u[0] = (float)(x >> 8) * 0x1p-24f;
    u[1] = (float)(y >> 8) * 0x1p-24f;
}

void light_sky(const struct world *w, const float d[3], bool disc, float out[3])
{
    float up = d[2] > 0 ? sqrtf(d[2]) : 0;
    for (int k = 0; k < 3; k++)
        out[k] = w->sky[1][k] + vec_min(up, 1) * (w->sky[0][k] - w->sky[1][k]);
    float gap = 1 - w->sun_cos;
    if (!disc || !(gap > 1e-6f) || vec_dot(d, w->sun_dir) < w->sun_cos)
        return;
    vec_along(out, 1 / (2 * PI * gap), w->sun, out);
}

void light_surface(const struct bvh *b, int solid, const float p[3], const float d[3], float width,
                   struct light_surface *out)
{
    const struct world_solid *w = b->w->solids + solid;
    float local[3], from[3], at[3];
    out->material = b->w->materials + w->material;
    out->solid = solid;
    solid_normal(b->solids + solid, w, p, out->n, local);
    vec_sub(p, w->t, from);
    vec_turn_back(w->r, from, at);
    out->facing = -vec_dot(out->n, d);
    if (out->facing < 0)
        for (int k = 0; k < 3; k++)
            out->n[k] = -out->n[k];
    out->facing = fabsf(out->facing);
    texture_eval(&out->material->albedo, at, local, width / vec_max(out->facing, SLANT),
                 out->albedo);
}

/* ---- lights ---- */

static float bounding_radius(const struct world_solid *w)
{
    const float *s = w->size;
    if (w->shape == WORLD_ELLIPSOID)
        return vec_max(s[0], vec_max(s[1], s[2]));
    if (w->shape == WORLD_TORUS)
        return s[0] + s[1];
    float z = w->shape == WORLD_RECT ? 0 : s[2];
    return sqrtf(s[0] * s[0] + s[1] * s[1] + z * z);
}

static void add_lamp(const struct world *w, const struct world_light *from, struct light *l)
{
    const struct world_solid *s = w->solids + from->solid;
    float lo[3], hi[3], d[3];
    solid_bounds(s, lo, hi);
    vec_sub(hi, lo, d);
    *l = (struct light){.solid = from->solid, .radius = bounding_radius(s)};
    memcpy(l->radiance, w->materials[s->material].emission, sizeof l->radiance);
    memcpy(l->centre, s->t, sizeof l->centre);
    l->power = vec_grey(l->radiance) * (d[0] * d[1] + d[1] * d[2] + d[2] * d[0]) / 3;
}

static void add_opening(const struct world *w, const struct world_light *from, struct light *l)
{
    float x = from->size[0], y = from->size[1];
    *l = (struct light){.solid = -1, .w = from, .radius = sqrtf(x * x + y * y)};
    for (int k = 0; k < 3; k++)
        l->radiance[k] = 0.5f * (w->sky[0][k] + w->sky[1][k]);
    memcpy(l->centre, from->t, sizeof l->centre);
    l->power = vec_grey(l->radiance) * 4 * x * y;
}

static err_t alloc_listed(struct arena *keep, int n_solids, struct light_set *out)
{
    return arena_zalloc(keep, (size_t)(n_solids ? n_solids : 1), sizeof(bool), &out->listed);
}

void light_plan(struct plan *p)
{
    struct light_set set;
    (void)alloc_listed(&p->keep, WORLD_SOLIDS, &set); // a counter is never full
}

err_t light_open(struct arena *keep, const struct bvh *bvh, struct light_set *out)
{
    const struct world *w = bvh->w;
    int openings = 0;
    *out = (struct light_set){.bvh = bvh};
    err_t e = alloc_listed(keep, w->n_solids, out);
    if (e)
        return e;
    for (int i = 0; i < w->n_lights; i++)
        openings += w->lights[i].solid < 0;
    out->dome =
        vec_grey(w->sky[0]) + vec_grey(w->sky[1]) > 0 && (w->kind == WORLD_YARD || openings == 0);
    out->sun = vec_grey(w->sun) > 0;
    vec_basis(w->sun_dir, out->across[0], out->across[1]);
    for (int i = 0; i < w->n_lights; i++) {
        const struct world_light *from = w->lights + i;
        struct light *l = out->l + out->n;
        if (from->solid < 0)
            add_opening(w, from, l);
        else
            add_lamp(w, from, l);
        if (!(l->power > 0) || (from->solid < 0 && out->dome))
            continue;
        out->n++;
        if (from->solid >= 0)
            out->listed[from->solid] = true;
    }
    return OK;
}

/* ---- a point of a light ---- */

struct ray_to {
    float d[3], t; // unit; m
    float weight;  // sr, over the probability of this point
};

/* Point p of the unit shape that stands for the area and normal n there. */
static bool ray_from_point(const struct solid *s, const struct world_solid *w, const float p[3],
                           const float n[3], struct ray_to *r, const float at[3])
{
    const float *size = w->size;
    float scaled[3] = {p[0] * size[0], p[1] * size[1], w->shape == WORLD_RECT ? 0 : p[2] * size[2]};
    float y[3], area[3];
    vec_turn(w->r, scaled, y);
    vec_along(y, 1, w->t, y);
    vec_turn_back(s->m, n, area);
    vec_sub(y, at, r->d);
    r->t = vec_unit(r->d);
    r->weight = -s->det * vec_dot(area, r->d) / (r->t * r->t);
    r->weight = vec_min(r->weight, 2 * PI); // half of all directions, also from very near
    return r->weight > 0;
}

static bool sample_ball(const float o[3], const float u[2], float p[3], float *area)
{
    float axis[3] = {o[0], o[1], o[2]}, a[3], b[3], x, y;
    float far = vec_unit(axis);
    if (!(far > 1.0001f))
        return false;
    float seen = 1 - 1 / (far * far), radius = sqrtf(u[0] * seen), up = sqrtf(1 - u[0] * seen);
    vec_basis(axis, a, b);
    vec_circle(u[1], &x, &y);
    for (int k = 0; k < 3; k++)
        p[k] = radius * (x * a[k] + y * b[k]) + up * axis[k];
    *area = PI * seen / up;
    return true;
}

static bool sample_box(const float o[3], const float u[2], float p[3], float n[3])
{
    float show[3], all = 0, at, v = u[0];
    for (int k = 0; k < 3; k++)
        all += show[k] = vec_max(fabsf(o[k]) - 1, 0);
    if (!(all > 0))
        return false;
    int face = 0;
    for (at = v * all; face < 2 && at >= show[face]; face++)
        at -= show[face];
    if (!(show[face] > 0))
        return false;
    v = vec_min(at / show[face], 0.999999f);
    float side = o[face] < 0 ? -1 : 1;
    n[0] = n[1] = n[2] = 0;
    n[face] = side * 4 * all / show[face];
    p[face] = side;
    p[(face + 1) % 3] = 2 * v - 1;
    p[(face + 2) % 3] = 2 * u[1] - 1;
    return true;
}

static void sample_disc(float radius, float end, const float u[2], float p[3], float n[3])
{
    float x, y, r = radius * sqrtf(u[0]);
    vec_circle(u[1], &x, &y);
    p[0] = r * x;
    p[1] = r * y;
    p[2] = end;
    n[0] = n[1] = 0;
    n[2] = end * PI * radius * radius;
}

/* The side of a frustum is seen where its normal (cos, sin, slope) faces o: in a range of angles
 * that is the same at all heights. */
static void sample_side(const float cone[2], const float o[3], const float u[2], float p[3],
                        float n[3])
{
    float mean = cone[0], slope = cone[1], x, y;
    float off = vec_max(sqrtf(o[0] * o[0] + o[1] * o[1]), 1e-6f);
    float edge = (mean - slope * o[2]) / off;
    float half = edge > -1 ? acosf(vec_min(edge, 1)) / (2 * PI) : 0.5f; // turns
    float turn = (2 * u[0] - 1) * half;
    vec_circle(turn < 0 ? turn + 1 : turn, &x, &y);
    float c = (x * o[0] - y * o[1]) / off, s = (x * o[1] + y * o[0]) / off;
    p[2] = 2 * u[1] - 1;
    float radius = mean - slope * p[2], area = radius * 8 * PI * half;
    p[0] = radius * c;
    p[1] = radius * s;
    n[0] = area * c;
    n[1] = area * s;
    n[2] = area * slope;
}

static bool sample_frustum(const struct solid *s, const float o[3], const float u[2], float p[3],
                           float n[3])
{
    float cone[2] = {(1 + s->k) / 2, (1 - s->k) / 2};
    float off = sqrtf(o[0] * o[0] + o[1] * o[1]);
    float top = PI * s->k * s->k * vec_max(o[2] - 1, 0), bottom = PI * vec_max(-1 - o[2], 0);
    float side = 4 * cone[0] * vec_max(off + cone[1] * o[2] - cone[0], 0);
    float all = top + bottom + side, ends = top + bottom, at = u[0] * all, share;
    if (!(all > 0))
        return false;
    if (at < ends) {
        share = ends / all;
        float v[2] = {at / ends, u[1]};
        sample_disc(o[2] > 0 ? s->k : 1, o[2] > 0 ? 1 : -1, v, p, n);
    } else {
        share = side / all;
        float v[2] = {side > 0 ? vec_min((at - ends) / side, 1) : 0, u[1]};
        sample_side(cone, o, v, p, n);
    }
    for (int k = 0; k < 3; k++)
        n[k] /= share;
    return share > 0;
}

static bool sample_cone(const struct solid *s, const struct light *l, const float at[3],
                        const float u[2], struct ray_to *r)
{
    float axis[3], a[3], b[3], x, y;
    vec_sub(l->centre, at, axis);
    float far = vec_unit(axis), sine = l->radius / vec_max(far, 1e-6f);
    float least = sine < 1 ? sqrtf(1 - sine * sine) : -1;
    float c = 1 - u[0] * (1 - least), side = sqrtf(vec_max(1 - c * c, 0));
    vec_basis(axis, a, b);
    vec_circle(u[1], &x, &y);
    for (int k = 0; k < 3; k++)
        r->d[k] = side * (x * a[k] + y * b[k]) + c * axis[k];
    r->t = solid_hit(s, at, r->d, BEYOND);
    r->weight = 2 * PI * (1 - least);
    return r->t < BEYOND;
}

static bool sample_lamp(const struct light_set *set, const struct light *l, const float at[3],
                        const float u[2], struct ray_to *r)
{
    const struct solid *s = set->bvh->solids + l->solid;
    const struct world_solid *w = set->bvh->w->solids + l->solid;
    float o[3], p[3], n[3] = {0, 0, 1}, area;
    vec_turn(s->m, at, o);
    vec_along(o, 1, s->b, o);
    switch (s->shape) {
    case WORLD_ELLIPSOID:
        if (!sample_ball(o, u, p, &area))
            return false;
        vec_along((float[3]){0}, area, p, n);
        break;
    case WORLD_BOX:
        if (!sample_box(o, u, p, n))
            return false;
        break;
    case WORLD_FRUSTUM:
        if (!sample_frustum(s, o, u, p, n))
            return false;
        break;
    case WORLD_TORUS:
        return sample_cone(s, l, at, u, r);
    default:
        p[0] = 2 * u[0] - 1;
        p[1] = 2 * u[1] - 1;
        p[2] = 0;
        n[2] = o[2] < 0 ? -4 : 4;
    }
    return ray_from_point(s, w, p, n, r, at);
}

static bool sample_opening(const struct light *l, const float at[3], const float u[2],
                           struct ray_to *r)
{
    const struct world_light *w = l->w;
    float p[3] = {(2 * u[0] - 1) * w->size[0], (2 * u[1] - 1) * w->size[1], 0}, y[3];
    float n[3] = {w->r[2], w->r[5], w->r[8]};
    vec_turn(w->r, p, y);
    vec_along(y, 1, w->t, y);
    vec_sub(y, at, r->d);
    float t = vec_unit(r->d), area = 4 * w->size[0] * w->size[1];
    r->weight = vec_min(area * fabsf(vec_dot(n, r->d)) / vec_max(t * t, 1e-12f), 2 * PI);
    r->t = BEYOND;
    return r->weight > 0;
}

/* ---- gathering ---- */

static bool is_unoccluded(const struct light_set *s, struct light_spot *spot, int slot,
                          const struct ray_to *r, int skip)
{
    int in_way = bvh_any(s->bvh, spot->p, r->d, r->t, (int[2]){skip, (int)spot->last[slot] - 1});
    if (in_way >= 0)
        spot->last[slot] = (uint32_t)in_way + 1;
    return in_way < 0;
}

static void add_gloss(const struct light_spot *spot, const float d[3], const float light[3],
                      float share, float gloss[3])
{
    float c = vec_dot(spot->mirror, d);
    if (!(share > 0) || !(c > 0) || spot->lobe * (1 - c) > 12)
        return;
    vec_along(gloss, share * (spot->lobe + 1) / (2 * PI) * powf(c, spot->lobe), light, gloss);
}

/* One ray to light i, which counts `times`. */
static void gather_light(const struct light_set *s, struct light_spot *spot, int i,
                         const struct light_dice *d, float times, struct light_sum *out)
{
    const struct light *l = s->l + i;
    struct ray_to r;
    float u[2], light[3];
    light_throw(d, (uint32_t)i, u);
    bool seen =
        l->solid < 0 ? sample_opening(l, spot->p, u, &r) : sample_lamp(s, l, spot->p, u, &r);
    float c = seen ? vec_dot(spot->n, r.d) : 0;
    if (!(c > 0) || !is_unoccluded(s, spot, i, &r, l->solid))
        return;
    if (l->solid < 0)
        light_sky(s->bvh->w, r.d, false, light);
    else
        memcpy(light, l->radiance, sizeof light);
    for (int k = 0; k < 3; k++)
        light[k] *= r.weight * times;
    vec_along(out->soft, c, light, out->soft);
    add_gloss(spot, r.d, light, spot->shine[l->solid < 0 ? 2 : 0], out->gloss);
}

/* Cosine of the direction to a point of the sun's disc; 0 if something is in the way. */
static float sun_irradiance(const struct light_set *s, struct light_spot *spot, const float u[2],
                            struct ray_to *r)
{
    const struct world *w = s->bvh->w;
    float c = 1 - u[0] * (1 - w->sun_cos), side = sqrtf(vec_max(1 - c * c, 0)), x, y;
    vec_circle(u[1], &x, &y);
    for (int k = 0; k < 3; k++)
        r->d[k] = side * (x * s->across[0][k] + y * s->across[1][k]) + c * w->sun_dir[k];
    c = vec_dot(spot->n, r->d);
    return c > 0 && is_unoccluded(s, spot, WORLD_LIGHTS, r, -1) ? c : 0;
}

/* Two opposite points of the disc: their errors nearly cancel where an edge crosses its middle. */
static void gather_sun(const struct light_set *s, struct light_spot *spot,
                       const struct light_dice *d, struct light_sum *out)
{
    const struct world *w = s->bvh->w;
    struct ray_to r = {.t = BEYOND};
    float u[2];
    if (vec_dot(spot->n, w->sun_dir) < -0.05f)
        return;
    light_throw(d, DIM_SUN, u);
    float seen = sun_irradiance(s, spot, u, &r);
    u[1] = u[1] < 0.5f ? u[1] + 0.5f : u[1] - 0.5f;
    seen = 0.5f * (seen + sun_irradiance(s, spot, u, &r));
    if (!(seen > 0))
        return;
    vec_along(out->sun, seen, w->sun, out->sun);
    add_gloss(spot, w->sun_dir, w->sun, spot->shine[1], out->gloss);
}

/* Directions by their cosine, so that the mean of pi L is the irradiance. */
static void gather_dome(const struct light_set *s, struct light_spot *spot,
                        const struct light_dice *d, struct light_sum *out)
{
    struct ray_to r = {.t = BEYOND};
    float u[2], a[3], b[3], x, y, light[3];
    light_throw(d, DIM_DOME, u);
    float side = sqrtf(u[0]), up = sqrtf(1 - u[0]);
    vec_circle(u[1], &x, &y);
    vec_basis(spot->n, a, b);
    for (int k = 0; k < 3; k++)
        r.d[k] = side * (x * a[k] + y * b[k]) + up * spot->n[k];
    if (!is_unoccluded(s, spot, WORLD_LIGHTS + 1, &r, -1))
        return;
    light_sky(s->bvh->w, r.d, false, light);
    vec_along(out->soft, PI, light, out->soft);
    vec_along(out->gloss, spot->shine[2], light, out->gloss);
}

/* An estimate of the unshadowed light; 0 only if the whole light is below the surface. */
static float estimate_light(const struct light *l, const struct light_spot *spot)
{
    float to[3], reach = l->radius, turned = 1;
    vec_sub(l->centre, spot->p, to);
    float square = vec_dot(to, to), far = sqrtf(square) + 1e-6f, up = vec_dot(to, spot->n);
    if (l->solid < 0) {
        const float *r = l->w->r, *n = spot->n;
        reach = fabsf(r[0] * n[0] + r[3] * n[1] + r[6] * n[2]) * l->w->size[0] +
                fabsf(r[1] * n[0] + r[4] * n[1] + r[7] * n[2]) * l->w->size[1];
        turned = fabsf(r[2] * to[0] + r[5] * to[1] + r[8] * to[2]) / far + 0.1f;
    }
    if (!(up + reach > 0))
        return 0;
    up = vec_min(0.5f * (up + reach + vec_max(up, 0)) / far, 1);
    return l->power * turned * up / (square + l->radius * l->radius);
}

/* Chances to be drawn, partly by each light's estimate, partly equal; at most PICKS in all.
 * Returns whether all are 0 or 1. */
static bool choose_lights(const struct light_set *s, const struct light_spot *spot,
                          float probability[WORLD_LIGHTS])
{
    float all = 0;
    int some = 0;
    for (int i = 0; i < s->n; i++) {
        all += probability[i] = estimate_light(s->l + i, spot);
        some += probability[i] > 0;
    }
    for (int i = 0; i < s->n; i++) {
        float p = some <= PICKS ? 1 : 0;
        if (some > PICKS)
            p = PICKS * ((1 - EVENLY) * probability[i] / all + EVENLY / (float)some);
        probability[i] = probability[i] > 0 ? vec_min(p, 1) : 0;
    }
    return some <= PICKS;
}

void light_gather(const struct light_set *s, struct light_spot *spot, const struct light_dice *d,
                  struct light_sum *out)
{
    float probability[WORLD_LIGHTS], u[2] = {0, 0}, at = 0;
    memset(out, 0, sizeof *out);
    bool every = choose_lights(s, spot, probability);
    if (!every)
        light_throw(d, DIM_PICK, u);
    for (int i = 0; i < s->n; i++) {
        float p = probability[i];
        bool drawn = p > 0 && (every || floorf(at + p - u[0]) > floorf(at - u[0]));
        at += p;
        if (drawn)
            gather_light(s, spot, i, d, 1 / p, out);
    }
    if (s->sun)
        gather_sun(s, spot, d, out);
    if (s->dome)
        gather_dome(s, spot, d, out);
}
