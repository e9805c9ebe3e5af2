/* Solids against marches in double precision, the hierarchy against all solids one by one. */
#include "sim/world/bvh.h"

#include "sim/world/light.h"
#include "sim/world/vec.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { SOLIDS = 300 };

static const float FAR = 1000;

static uint32_t next_random(uint32_t *x)
{
    return *x = *x * 1664525u + 1013904223u;
}

static float uniform(uint32_t *x)
{
    return (float)(next_random(x) >> 8) * 0x1p-24f;
}

static void assert_near(double got, double want, double bound)
{
    if (!(fabs(got - want) <= bound))
        fail_msg("%.9g, wanted %.9g within %.3g", got, want, bound);
}

static const float *rotation_of(uint32_t *x, float r[9])
{
    float a[3], b[3], c[3];
    for (int k = 0; k < 3; k++)
        a[k] = uniform(x) - 0.5f;
    vec_unit(a);
    vec_basis(a, b, c);
    for (int k = 0; k < 3; k++) {
        r[3 * k] = b[k];
        r[3 * k + 1] = c[k];
        r[3 * k + 2] = a[k];
    }
    return r;
}

/* ---- intersections ---- */

/* Whether p is inside, in double, apart from solid.c. */
static double outside(const struct world_solid *o, const double p[3])
{
    double q[3] = {0}, r;
    for (int k = 0; k < 9; k++)
        q[k % 3] += (double)o->r[k] * (p[k / 3] - (double)o->t[k / 3]);
    double x = q[0] / (double)o->size[0], y = q[1] / (double)o->size[1];
    double z = q[2] / (double)o->size[2];
    switch (o->shape) {
    case WORLD_BOX:
        return fmax(fabs(x), fmax(fabs(y), fabs(z))) - 1;
    case WORLD_ELLIPSOID:
        return x * x + y * y + z * z - 1;
    case WORLD_FRUSTUM:
        r = (1 + (double)o->taper) / 2 - z * (1 - (double)o->taper) / 2;
        return fmax(sqrt(x * x + y * y) - r, fabs(z) - 1);
    case WORLD_TORUS:
        r = hypot(q[0], q[1]) - (double)o->size[0];
        return hypot(r, q[2]) - (double)o->size[1];
    default:
        return fabs(x) <= 1 && fabs(y) <= 1 ? q[2] : 1; // changes sign where it is crossed
    }
}

/* Distance to the first change of sign, found by small steps and halving; < 0 if none. */
static double march(const struct world_solid *o, const float from[3], const float d[3])
{
    const double step = 2e-3;
    double p[3], last = 0;
    for (int i = 0; i < 4000; i++) {
        for (int k = 0; k < 3; k++)
            p[k] = (double)from[k] + i * step * (double)d[k];
        double at = outside(o, p);
        bool crossed = i && (at < 0) != (last < 0) && fabs(at - last) < 0.5;
        last = at;
        if (!crossed)
            continue;
        double lo = (i - 1) * step, hi = i * step;
        for (int turn = 0; turn < 40; turn++) {
            double middle = (lo + hi) / 2;
            for (int k = 0; k < 3; k++)
                p[k] = (double)from[k] + middle * (double)d[k];
            if ((outside(o, p) < 0) == (at < 0))
                hi = middle;
            else
                lo = middle;
        }
        return hi;
    }
    return -1;
}

static void shapes_agree_with_a_march(void **state)
{
    (void)state;
    uint32_t x = 1;
    int disagree = 0, hits = 0;
    for (int turn = 0; turn < 500; turn++) {
        struct world_solid o = {.shape = (enum world_shape)(turn % WORLD_SHAPES)};
        struct solid one;
        float from[3], to[3], d[3], n[3], local[3], p[3];
        for (int k = 0; k < 3; k++) {
            o.size[k] = 0.2f + uniform(&x);
            o.t[k] = uniform(&x) - 0.5f;
            from[k] = (turn % 3 ? 5 : 1) * (uniform(&x) - 0.5f); // every third nearly inside
            to[k] = o.t[k] + 1.5f * (uniform(&x) - 0.5f);
        }
        o.size[1] = o.shape == WORLD_TORUS ? 0.4f * o.size[0] : o.size[1];
        o.taper = turn % 4 ? uniform(&x) : (float)(turn % 8 / 4);
        rotation_of(&x, o.r);
        vec_sub(to, from, d);
        vec_unit(d);
        solid_of(&o, &one);
        double want = march(&o, from, d);
        float got = solid_hit(&one, from, d, 8);
        bool miss = want < 0;
        if (miss != (got >= 8) || (!miss && fabs((double)got - want) > 2e-5)) {
            disagree++; // a graze between two steps of the march
            continue;
        }
        if (miss)
            continue;
        hits++;
        vec_along(from, got, d, p);
        solid_normal(&one, &o, p, n, local);
        assert_near(vec_dot(n, n), 1, 1e-5);
        double out[3], in[3];
        for (int k = 0; k < 3; k++) {
            out[k] = (double)p[k] + 1e-3 * (double)n[k];
            in[k] = (double)p[k] - 1e-3 * (double)n[k];
        }
        assert_true(outside(&o, out) > 0 && outside(&o, in) < 0);
    }
    assert_true(hits > 200);
    assert_true(disagree <= 5);
}

static void bounds_hold_every_hit(void **state)
{
    (void)state;
    uint32_t x = 3;
    for (int turn = 0; turn < 20000; turn++) {
        struct world_solid o = {.shape = (enum world_shape)(turn % WORLD_SHAPES)};
        struct solid one;
        float from[3], d[3], lo[3], hi[3];
        for (int k = 0; k < 3; k++) {
            o.size[k] = 0.1f + uniform(&x);
            from[k] = 4 * (uniform(&x) - 0.5f);
            d[k] = -from[k] + uniform(&x) - 0.5f;
        }
        o.size[1] = o.shape == WORLD_TORUS ? 0.3f * o.size[0] : o.size[1];
        o.taper = uniform(&x);
        rotation_of(&x, o.r);
        solid_of(&o, &one);
        solid_bounds(&o, lo, hi);
        float t = solid_hit(&one, from, d, 100);
        for (int k = 0; k < 3 && t < 100; k++)
            assert_true(from[k] + t * d[k] > lo[k] - 1e-5f && from[k] + t * d[k] < hi[k] + 1e-5f);
    }
}

/* Thin and small things, seen from far away. */
static void far_and_thin_solids_are_met(void **state)
{
    (void)state;
    const enum world_shape shapes[] = {WORLD_BOX, WORLD_ELLIPSOID, WORLD_FRUSTUM, WORLD_TORUS};
    for (int i = 0; i < 4; i++) {
        struct world_solid o = {.shape = shapes[i], .size = {0.01f, 0.005f, 0.4f}, .taper = 1};
        struct solid one;
        const float r[9] = {1, 0, 0, 0, 0, -1, 0, 1, 0};
        memcpy(o.r, r, sizeof r);
        o.t[0] = 100;
        solid_of(&o, &one);
        float from[3] = {0, 0, 0.001f}, d[3] = {1, 0, 0};
        float want = 100 - (shapes[i] == WORLD_TORUS ? 0.0149f : 0.01f);
        assert_near(solid_hit(&one, from, d, 1000), want, 5e-4);
    }
}

/* ---- the hierarchy ---- */

static struct world w;
static struct world_solid solids[SOLIDS];
static struct arena keep;

static void open_world(void)
{
    w = (struct world){.solids = solids};
    struct plan p = plan_begin(1);
    bvh_plan(&p);
    assert_int_equal(arena_init(&keep, "keep", p.keep.peak), OK);
}

static struct world_solid *add_solid(enum world_shape shape, const float at[3], const float size[3])
{
    struct world_solid *o = solids + w.n_solids++;
    *o = (struct world_solid){.shape = shape, .taper = 1, .r = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    memcpy(o->t, at, sizeof o->t);
    memcpy(o->size, size, sizeof o->size);
    return o;
}

static void random_world(uint32_t seed, int n)
{
    uint32_t x = seed;
    open_world();
    for (int i = 0; i < n; i++) {
        float at[3], size[3], grow = i % 7 == 0 ? 3 : 0.3f;
        for (int k = 0; k < 3; k++) {
            at[k] = 10 * (uniform(&x) - 0.5f);
            size[k] = 0.05f + grow * uniform(&x);
        }
        if (i % WORLD_SHAPES == WORLD_TORUS)
            size[1] = 0.3f * size[0];
        struct world_solid *o = add_solid((enum world_shape)(i % WORLD_SHAPES), at, size);
        o->taper = uniform(&x);
        if (i % 2)
            rotation_of(&x, o->r);
    }
}

static int first_of_all(const struct bvh *b, const float o[3], const float d[3], float *t)
{
    int best = -1;
    *t = FAR;
    for (int i = 0; i < b->n; i++) {
        float at = solid_hit(b->solids + i, o, d, *t);
        best = at < *t ? i : best;
        *t = at;
    }
    return best;
}

static void hierarchy_agrees_with_all_solids(void **state)
{
    (void)state;
    const int numbers[] = {0, 1, 2, 3, 5, 17, SOLIDS};
    for (int turn = 0; turn < 7; turn++) {
        struct bvh b;
        uint32_t x = 11;
        random_world((uint32_t)turn, numbers[turn]);
        assert_int_equal(bvh_build(&keep, &w, &b), OK);
        for (int i = 0; i < 3000; i++) {
            float o[3], d[3], want, got;
            for (int k = 0; k < 3; k++) {
                o[k] = 16 * (uniform(&x) - 0.5f);
                d[k] = uniform(&x) - 0.5f;
            }
            if (i % 5 == 0) // along an axis
                d[i % 3] = d[(i + 1) % 3] = 0;
            vec_unit(d);
            first_of_all(&b, o, d, &want);
            bvh_first(&b, o, d, FAR, &got);
            assert_true(got == want);
            float most = 10 * uniform(&x);
            bool some = bvh_any(&b, o, d, most, (int[2]){-1, -1}) >= 0;
            assert_int_equal(some, want < most);
            if (turn)
                assert_int_equal(bvh_any(&b, o, d, most, (int[2]){-1, i % b.n}) >= 0, some);
        }
        arena_free(&keep);
    }
}

/* Boxes in one another, each twice as large: no cut is better than one solid against the rest. */
static void deep_hierarchies_end(void **state)
{
    (void)state;
    struct bvh b;
    open_world();
    for (int i = 0; i < SOLIDS; i++) {
        float a = ldexpf(1, i % 120 - 60);
        add_solid(WORLD_BOX, (float[]){a, a, a}, (float[]){a, a, a});
    }
    assert_int_equal(bvh_build(&keep, &w, &b), OK);
    uint32_t x = 2;
    for (int i = 0; i < 500; i++) {
        float o[3], d[3], want, got;
        for (int k = 0; k < 3; k++) {
            o[k] = ldexpf(uniform(&x) + 0.1f, i % 60 - 30);
            d[k] = uniform(&x) - 0.5f;
        }
        vec_unit(d);
        first_of_all(&b, o, d, &want);
        bvh_first(&b, o, d, FAR, &got);
        assert_true(got == want);
    }
    arena_free(&keep);
}

/* From a surface outwards nothing of a convex solid is met, however far from 0 it is. */
static void rays_leave_the_surface_they_start_on(void **state)
{
    (void)state;
    uint32_t x = 4;
    int stuck = 0;
    for (int turn = 0; turn < 20000; turn++) {
        struct world_solid o = {.shape = (enum world_shape)(turn % 3), .taper = uniform(&x)};
        struct solid one;
        float from[3], d[3], n[3], local[3];
        for (int k = 0; k < 3; k++) {
            o.size[k] = turn % 2 ? 0.02f + 0.1f * uniform(&x) : 20;
            o.t[k] = 20 * (uniform(&x) - 0.5f);
            from[k] = 60 * (uniform(&x) - 0.5f);
            d[k] = o.t[k] - from[k] + 0.02f * uniform(&x);
        }
        rotation_of(&x, o.r);
        vec_unit(d);
        solid_of(&o, &one);
        if (solid_inside(&one, from))
            continue;
        float t = solid_hit(&one, from, d, 100);
        if (t >= 100)
            continue;
        vec_along(from, t, d, from);
        solid_normal(&one, &o, from, n, local);
        vec_along(from, light_lift(t), n, from);
        vec_along(n, 0.7f, d, d); // outwards
        stuck += solid_hit(&one, from, d, 100) < 100;
    }
    assert_int_equal(stuck, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(shapes_agree_with_a_march),
        cmocka_unit_test(bounds_hold_every_hit),
        cmocka_unit_test(far_and_thin_solids_are_met),
        cmocka_unit_test(hierarchy_agrees_with_all_solids),
        cmocka_unit_test(deep_hierarchies_end),
        cmocka_unit_test(rays_leave_the_surface_they_start_on),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
