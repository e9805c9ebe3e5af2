/* A ray is taken to the frame of the unit shape by the inverse of the solid's map, where t stays
 * the same. Quadrics are solved about the point of the ray that is nearest to the frame's
 * origin, since b^2 - ac of a far and small solid would cancel (Haines et al., Precision
 * Improvements for Ray/Sphere Intersection, Ray Tracing Gems, 2019, chapter 7). Boxes are three
 * slabs. A torus is approached by steps of its distance (Hart, Sphere Tracing, 1996), which no
 * step can pass; the last step goes along the slope. A normal of the frame goes to the world by
 * the transposed map. Roots before 0 are behind the ray; a ray from inside meets the way out. */
#include "sim/world/solid.h"

#include "sim/world/vec.h"

static const float LEAST = 1e-20f; // component of a direction: 1 / it and products stay finite
static const float GRAZE = 2e-6f;  // relative to the frame: nearer is on the surface of a torus

enum { TORUS_STEPS = 128 };

void solid_of(const struct world_solid *w, struct solid *out)
{
    float inverse[3];
    for (int k = 0; k < 3; k++)
        inverse[k] = 1 / w->size[k];
    if (w->shape == WORLD_TORUS)
        inverse[0] = inverse[1] = inverse[2] = 1 / w->size[0];
    if (w->shape == WORLD_RECT)
        inverse[2] = 1;
    for (int i = 0; i < 3; i++) {
        out->b[i] = 0;
        for (int j = 0; j < 3; j++) {
            out->m[3 * i + j] = w->r[3 * j + i] * inverse[i];
            out->b[i] -= out->m[3 * i + j] * w->t[j];
        }
    }
    out->k = w->shape == WORLD_TORUS ? w->size[1] / w->size[0] : w->taper;
    out->shape = w->shape;
    out->material = w->material;
    out->det = 1 / (inverse[0] * inverse[1] * inverse[2]);
}

/* ---- bounds ---- */

static float reach_of(const struct world_solid *w, int axis, float end)
{
    const float *r = w->r + 3 * axis, *s = w->size;
    float a = r[0] * s[0], b = r[1] * s[1], c = r[2] * s[2];
    switch (w->shape) {
    case WORLD_BOX:
        return fabsf(a) + fabsf(b) + fabsf(c);
    case WORLD_ELLIPSOID:
        return sqrtf(a * a + b * b + c * c);
    case WORLD_TORUS:
        return sqrtf(r[0] * r[0] + r[1] * r[1]) * s[0] + s[1];
    case WORLD_FRUSTUM:
        return (end > 0 ? w->taper : 1) * sqrtf(a * a + b * b);
    default:
        return fabsf(a) + fabsf(b);
    }
}

void solid_bounds(const struct world_solid *w, float lo[3], float hi[3])
{
    for (int k = 0; k < 3; k++) {
        float up = w->shape == WORLD_FRUSTUM ? w->r[3 * k + 2] * w->size[2] : 0;
        float top = reach_of(w, k, 1), bottom = reach_of(w, k, -1);
        lo[k] = w->t[k] + vec_min(up - top, -up - bottom);
        hi[k] = w->t[k] + vec_max(up + top, -up + bottom);
        float pad = 1e-5f * (1 + vec_max(fabsf(lo[k]), fabsf(hi[k])));
        lo[k] -= pad;
        hi[k] += pad;
    }
}

/* ---- rays in the frame of the unit shape ---- */

static float away_from_0(float x)
{
    return fabsf(x) > LEAST ? x : LEAST;
}

static float hit_box(const float o[3], const float d[3], float most)
{
    float in = -INFINITY, out = INFINITY;
    for (int k = 0; k < 3; k++) {
        float inverse = 1 / away_from_0(d[k]);
        float a = (-1 - o[k]) * inverse, b = (1 - o[k]) * inverse;
        in = vec_max(vec_min(a, b), in);
        out = vec_min(vec_max(a, b), out);
    }
    float t = in > 0 ? in : out;
    return in <= out && t > 0 && t < most ? t : most;
}

static float hit_rect(const float o[3], const float d[3], float most)
{
    float t = -o[2] / away_from_0(d[2]);
    bool on = fabsf(o[0] + t * d[0]) <= 1 && fabsf(o[1] + t * d[1]) <= 1;
    return on && t > 0 && t < most ? t : most;
}

static float hit_sphere(const float o[3], const float d[3], float most)
{
    float dd = vec_dot(d, d), middle = -vec_dot(o, d) / dd, near[3];
    vec_along(o, middle, d, near);
    float left = 1 - vec_dot(near, near);
    if (!(left >= 0))
        return most;
    float half = sqrtf(left / dd);
    float t = middle - half > 0 ? middle - half : middle + half;
    return t > 0 && t < most ? t : most;
}

/* Where a frustum's side, x^2 + y^2 = (mean - slope z)^2 with |z| <= 1, is met after `least`;
 * infinite if nowhere. */
static float hit_side(const struct solid *s, const float o[3], const float d[3], float least)
{
    float mean = (1 + s->k) / 2, slope = (1 - s->k) / 2;
    float ro = mean - slope * o[2], rd = -slope * d[2];
    float a = d[0] * d[0] + d[1] * d[1] - rd * rd;
    float b = o[0] * d[0] + o[1] * d[1] - ro * rd;
    float c = o[0] * o[0] + o[1] * o[1] - ro * ro;
    float square = b * b - a * c;
    if (!(square >= 0))
        return INFINITY;
    float q = -(b + (b < 0 ? -sqrtf(square) : sqrtf(square)));
    float roots[2] = {c / away_from_0(q), q / away_from_0(a)}, best = INFINITY;
    for (int i = 0; i < 2; i++) {
        float t = roots[i];
        bool on = fabsf(o[2] + t * d[2]) <= 1;
        best = on && t > least && t < best ? t : best;
    }
    return best;
}

static float hit_frustum(const struct solid *s, const float o[3], const float d[3], float most)
{
    float middle = -vec_dot(o, d) / vec_dot(d, d), near[3];
    vec_along(o, middle, d, near);
    float best = hit_side(s, near, d, -middle);
    float up = away_from_0(d[2]);
    for (int end = -1; end <= 1; end += 2) {
        float t = ((float)end - near[2]) / up;
        float x = near[0] + t * d[0], y = near[1] + t * d[1], radius = end > 0 ? s->k : 1;
        bool on = x * x + y * y <= radius * radius;
        best = on && t > -middle && t < best ? t : best;
    }
    float t = best + middle;
    return t > 0 && t < most ? t : most;
}

static float torus_distance(float tube, const float p[3])
{
    float ring = sqrtf(p[0] * p[0] + p[1] * p[1]) - 1;
    return sqrtf(ring * ring + p[2] * p[2]) - tube;
}

/* The part of the ray inside the box around a torus. */
static bool torus_span(const struct solid *s, const float o[3], const float d[3], float span[2])
{
    float half[3] = {1 + s->k, 1 + s->k, s->k};
    for (int k = 0; k < 3; k++) {
        float inverse = 1 / away_from_0(d[k]);
        float a = (-half[k] - o[k]) * inverse, b = (half[k] - o[k]) * inverse;
        span[0] = vec_max(span[0], vec_min(a, b));
        span[1] = vec_min(span[1], vec_max(a, b));
    }
    return span[0] <= span[1];
}

static float hit_torus(const struct solid *s, const float o[3], const float d[3], float most)
{
    float span[2] = {0, most}, p[3];
    if (!torus_span(s, o, d, span))
        return most;
    float length = sqrtf(vec_dot(d, d)), t = span[0], last = 0, step = 0;
    vec_along(o, t, d, p);
    float at = torus_distance(s->k, p), side = at < 0 ? -1 : 1;
    if (fabsf(at) < 2 * GRAZE) { // starts on the surface: leave it before the search
        t += 8 * GRAZE / length;
        vec_along(o, t, d, p);
        at = torus_distance(s->k, p);
        side = at < 0 ? -1 : 1;
    }
    for (int i = 0; i < TORUS_STEPS && t <= span[1]; i++) {
        at = side * torus_distance(s->k, p);
        if (at < GRAZE) {
            float slope = (last - at) / away_from_0(step);
            t += i && slope > 0.01f * length ? at / slope : 0;
            return t > 0 && t < most ? t : most;
        }
        last = at;
        step = at / length;
        t += step;
        vec_along(o, t, d, p);
    }
    return most;
}

float solid_hit(const struct solid *s, const float o[3], const float d[3], float most)
{
    float p[3], q[3];
    vec_turn(s->m, o, p);
    vec_along(p, 1, s->b, p);
    vec_turn(s->m, d, q);
    switch (s->shape) {
    case WORLD_BOX:
        return hit_box(p, q, most);
    case WORLD_ELLIPSOID:
        return hit_sphere(p, q, most);
    case WORLD_FRUSTUM:
        return hit_frustum(s, p, q, most);
    case WORLD_TORUS:
        return hit_torus(s, p, q, most);
    default:
        return hit_rect(p, q, most);
    }
}

/* ---- surfaces ---- */

static void normal_of_box(const float p[3], float n[3])
{
    int axis = 0;
    for (int k = 1; k < 3; k++)
        axis = fabsf(p[k]) > fabsf(p[axis]) ? k : axis;
    n[0] = n[1] = n[2] = 0;
    n[axis] = p[axis] < 0 ? -1 : 1;
}

static void normal_of_frustum(const struct solid *s, const float p[3], float n[3])
{
    float slope = (1 - s->k) / 2, radius = (1 + s->k) / 2 - slope * p[2];
    float length = sqrtf(p[0] * p[0] + p[1] * p[1]);
    bool on_end = 1 - fabsf(p[2]) < fabsf(radius - length) || length < LEAST;
    n[0] = on_end ? 0 : p[0] / length;
    n[1] = on_end ? 0 : p[1] / length;
    n[2] = on_end ? (p[2] < 0 ? -1 : 1) : slope;
}

static void normal_of_torus(const float p[3], float n[3])
{
    float length = vec_max(sqrtf(p[0] * p[0] + p[1] * p[1]), LEAST);
    n[0] = p[0] - p[0] / length;
    n[1] = p[1] - p[1] / length;
    n[2] = p[2];
}

void solid_normal(const struct solid *s, const struct world_solid *w, const float p[3],
                  float world[3], float local[3])
{
    float q[3], n[3] = {0, 0, 1};
    vec_turn(s->m, p, q);
    vec_along(q, 1, s->b, q);
    if (s->shape == WORLD_BOX)
        normal_of_box(q, n);
    else if (s->shape == WORLD_ELLIPSOID)
        vec_along(q, 0, q, n);
    else if (s->shape == WORLD_FRUSTUM)
        normal_of_frustum(s, q, n);
    else if (s->shape == WORLD_TORUS)
        normal_of_torus(q, n);
    vec_turn_back(s->m, n, world);
    vec_unit(world);
    vec_turn_back(w->r, world, local);
}

bool solid_inside(const struct solid *s, const float p[3])
{
    float q[3];
    vec_turn(s->m, p, q);
    vec_along(q, 1, s->b, q);
    float radius = (1 + s->k) / 2 - (1 - s->k) / 2 * q[2];
    switch (s->shape) {
    case WORLD_BOX:
        return fabsf(q[0]) < 1 && fabsf(q[1]) < 1 && fabsf(q[2]) < 1;
    case WORLD_ELLIPSOID:
        return vec_dot(q, q) < 1;
    case WORLD_FRUSTUM:
        return fabsf(q[2]) < 1 && q[0] * q[0] + q[1] * q[1] < radius * radius;
    case WORLD_TORUS:
        return torus_distance(s->k, q) < 0;
    default:
        return false;
    }
}
