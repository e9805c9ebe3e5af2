/* Worlds of every kind and many seeds hold what world.h promises; cameras of every sort of rig. */
#include "sim/world/world.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { SEEDS = 200, VIEWS = 64 };

static struct arena arena;

static int set_up(void **state)
{
    (void)state;
    struct plan p = plan_begin(1);
    world_plan(&p);
    return arena_init(&arena, "test", p.keep.peak) ? -1 : 0;
}

static int tear_down(void **state)
{
    (void)state;
    arena_free(&arena);
    return 0;
}

static void make(uint64_t seed, int kind, struct world *w)
{
    arena_reset(&arena, 0);
    assert_int_equal(world_make(&arena, seed, (enum world_kind)kind, w), OK);
}

static void all_finite(const float *x, int n)
{
    for (int i = 0; i < n; i++)
        assert_true(isfinite(x[i]));
}

static void rotation(const float r[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            float dot =
                r[3 * i] * r[3 * j] + r[3 * i + 1] * r[3 * j + 1] + r[3 * i + 2] * r[3 * j + 2];
            assert_true(fabsf(dot - (i == j ? 1.0f : 0.0f)) < 1e-5f);
        }
    float det = r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) +
                r[2] * (r[3] * r[7] - r[4] * r[6]);
    assert_true(det > 0.9f);
}

static void check_solids(const struct world *w)
{
    assert_true(w->n_solids > 20 && w->n_solids <= WORLD_SOLIDS);
    for (int i = 0; i < w->n_solids; i++) {
        const struct world_solid *s = &w->solids[i];
        assert_true(s->shape < WORLD_SHAPES);
        all_finite(s->t, 3);
        all_finite(s->origin, 3);
        rotation(s->r);
        for (int c = 0; c < 3; c++)
            assert_true(s->size[c] >= 1e-3f && s->size[c] <= 100.0f);
        assert_true(s->taper >= 0.0f && s->taper <= 1.0f);
        assert_true(s->material >= 0 && s->material < w->n_materials);
        if (s->shape == WORLD_TORUS)
            assert_true(s->size[1] < s->size[0]);
    }
}

static void check_materials(const struct world *w)
{
    assert_true(w->n_materials > 0 && w->n_materials <= WORLD_MATERIALS);
    for (int i = 0; i < w->n_materials; i++) {
        const struct world_material *m = &w->materials[i];
        assert_true(m->albedo.kind < TEXTURE_KINDS && m->albedo.scale > 0.0f);
        assert_true(m->albedo.contrast >= 0.0f && m->albedo.contrast <= 1.0f);
        for (int c = 0; c < 9; c++)
            assert_true(m->albedo.colour[c / 3][c % 3] >= 0.0f &&
                        m->albedo.colour[c / 3][c % 3] <= 1.0f);
        assert_true(m->specular >= 0.0f && m->specular <= 1.0f);
        assert_true(m->roughness >= 0.0f && m->roughness <= 1.0f);
        all_finite(m->emission, 3);
        for (int c = 0; c < 3; c++)
            assert_true(m->emission[c] >= 0.0f);
    }
}

static void check_lights(const struct world *w)
{
    assert_true(w->n_lights >= 0 && w->n_lights <= WORLD_LIGHTS);
    for (int i = 0; i < w->n_lights; i++) {
        const struct world_light *l = &w->lights[i];
        assert_true(l->solid >= -1 && l->solid < w->n_solids);
        if (l->solid >= 0) {
            assert_true(w->materials[w->solids[l->solid].material].emission[1] > 0.0f);
            continue;
        }
        rotation(l->r);
        assert_true(l->size[0] > 0.05f && l->size[1] > 0.05f);
        float inwards = 0.0f; // the frame's z points to the middle of the room
        for (int c = 0; c < 3; c++)
            inwards += l->r[3 * c + 2] * (0.5f * (w->lo[c] + w->hi[c]) - l->t[c]);
        assert_true(inwards > 1.0f);
    }
    float sky = 0.0f, sun = w->sun[0] + w->sun[1] + w->sun[2], dir = 0.0f;
    all_finite(w->sky[0], 6);
    all_finite(w->sun, 3);
    for (int c = 0; c < 3; c++) {
        assert_true(w->sky[0][c] >= 0.0f && w->sky[1][c] >= 0.0f && w->sun[c] >= 0.0f);
        sky += w->sky[0][c];
        dir += w->sun_dir[c] * w->sun_dir[c];
    }
    assert_true(w->n_lights > 0 || sky + sun > 0.0f);
    assert_true(sun == 0.0f || (fabsf(dir - 1.0f) < 1e-4f && w->sun_dir[2] > 0.0f));
}

static void check_places(const struct world *w)
{
    for (int c = 0; c < 3; c++) {
        assert_true(w->lo[c] < w->hi[c]);
        assert_true(w->lo[c] <= w->stand[0][c] && w->stand[1][c] <= w->hi[c]);
        assert_true(w->stand[1][c] - w->stand[0][c] > 0.4f);
        assert_true(w->lo[c] < w->focus[c] && w->focus[c] < w->hi[c]);
    }
}

static void promises(void **state)
{
    (void)state;
    for (int kind = WORLD_ANY; kind < WORLD_KINDS; kind++)
        for (uint64_t seed = 0; seed < SEEDS; seed++) {
            struct world w;
            make(kind == WORLD_ANY ? seed * 0x123456789abcdefull : seed, kind, &w);
            if (kind != WORLD_ANY)
                assert_int_equal(w.kind, kind);
            check_solids(&w);
            check_materials(&w);
            check_lights(&w);
            check_places(&w);
        }
}

static uint64_t bytes_of(const struct world *w)
{
    uint64_t h = 14695981039346656037ull; // FNV-1a
    const struct {
        const void *p;
        size_t n;
    } part[] = {{w->solids, (size_t)w->n_solids * sizeof *w->solids},
                {w->materials, (size_t)w->n_materials * sizeof *w->materials},
                {w->sun_dir, sizeof w->sun_dir},
                {w->sky, sizeof w->sky},
                {w->stand, sizeof w->stand}};
    for (size_t i = 0; i < sizeof part / sizeof *part; i++)
        for (size_t k = 0; k < part[i].n; k++)
            h = (h ^ ((const unsigned char *)part[i].p)[k]) * 1099511628211ull;
    return h;
}

static void same_seed_same_bytes(void **state)
{
    (void)state;
    uint64_t last = 0;
    for (int kind = 0; kind < WORLD_KINDS; kind++)
        for (uint64_t seed = 0; seed < 20; seed++) {
            struct world w;
            make(seed, kind, &w);
            uint64_t first = bytes_of(&w);
            memset(arena.base, 0xa5, arena_need(WORLD_SOLIDS, sizeof *w.solids) / 2);
            make(seed, kind, &w);
            assert_true(bytes_of(&w) == first);
            assert_true(first != last);
            last = first;
        }
}

static void kinds_are_what_they_say(void **state)
{
    (void)state;
    int yards = 0, rooms = 0, suns = 0, mirrors = 0, used[TEXTURE_KINDS] = {0};
    for (uint64_t seed = 0; seed < 60; seed++) {
        struct world w;
        make(seed, WORLD_ANY, &w);
        yards += w.kind == WORLD_YARD;
        rooms += w.kind == WORLD_ROOM;
        suns += w.sun[1] > 0.0f;
        for (int i = 0; i < w.n_solids; i++)
            used[w.materials[w.solids[i].material].albedo.kind]++;
        make(seed, WORLD_PLAIN, &w);
        for (int i = 0; i < w.n_materials; i++)
            assert_int_equal(w.materials[i].albedo.kind, TEXTURE_FLAT);
        make(seed, WORLD_DARK, &w);
        assert_int_equal(w.n_lights, 1);
        assert_true(w.lights[0].solid >= 0 && w.sky[0][1] == 0.0f && w.sun[1] == 0.0f);
        const struct world_material *m = &w.materials[w.solids[w.lights[0].solid].material];
        assert_true(m->emission[1] > 3000.0f);
        for (int i = 0; i < w.n_solids; i++)
            assert_true(w.materials[w.solids[i].material].emission[1] == 0.0f ||
                        i == w.lights[0].solid);
        make(seed, WORLD_MIRROR, &w);
        for (int i = 0; i < w.n_materials; i++)
            mirrors += w.materials[i].specular > 0.3f && w.materials[i].roughness < 0.05f;
    }
    assert_true(yards > 5 && rooms > 20 && suns > 20 && mirrors > 60 * 4);
    for (int i = 1; i < TEXTURE_KINDS; i++)
        assert_true(used[i] > 60);
}

static void centre(const struct camera *cam, float out[3])
{
    const float *q = cam->q, *t = cam->t;
    const float r[9] = {1 - 2 * (q[2] * q[2] + q[3] * q[3]), 2 * (q[1] * q[2] - q[0] * q[3]),
                        2 * (q[1] * q[3] + q[0] * q[2]),     2 * (q[1] * q[2] + q[0] * q[3]),
                        1 - 2 * (q[1] * q[1] + q[3] * q[3]), 2 * (q[2] * q[3] - q[0] * q[1]),
                        2 * (q[1] * q[3] - q[0] * q[2]),     2 * (q[2] * q[3] + q[0] * q[1]),
                        1 - 2 * (q[1] * q[1] + q[2] * q[2])};
    for (int c = 0; c < 3; c++)
        out[c] = -(r[c] * t[0] + r[3 + c] * t[1] + r[6 + c] * t[2]);
}

static bool inside(const struct world_solid *s, const float p[3])
{
    float q[3];
    for (int c = 0; c < 3; c++)
        q[c] = s->r[c] * (p[0] - s->t[0]) + s->r[3 + c] * (p[1] - s->t[1]) +
               s->r[6 + c] * (p[2] - s->t[2]);
    float x = q[0] / s->size[0], y = q[1] / s->size[1], z = q[2] / s->size[2];
    if (s->shape == WORLD_BOX)
        return fabsf(x) < 1.0f && fabsf(y) < 1.0f && fabsf(z) < 1.0f;
    if (s->shape == WORLD_ELLIPSOID)
        return x * x + y * y + z * z < 1.0f;
    if (s->shape == WORLD_FRUSTUM) {
        float wide = 1.0f + (s->taper - 1.0f) * 0.5f * (z + 1.0f);
        return fabsf(z) < 1.0f && x * x + y * y < wide * wide;
    }
    return false;
}

static void outside_of_all(const struct world *w, const float p[3])
{
    for (int i = 0; i < w->n_solids; i++)
        assert_false(inside(&w->solids[i], p));
}

/* Point of the world in the picture, as a share of its width from the middle; false: behind. */
static bool project(const struct camera *cam, const float p[3], float out[2])
{
    const float *q = cam->q;
    float u[3] = {q[2] * p[2] - q[3] * p[1], q[3] * p[0] - q[1] * p[2], q[1] * p[1] - q[2] * p[0]};
    for (int c = 0; c < 3; c++)
        u[c] += q[0] * p[c];
    const float v[3] = {q[2] * u[2] - q[3] * u[1], q[3] * u[0] - q[1] * u[2],
                        q[1] * u[1] - q[2] * u[0]};
    float d[3];
    for (int c = 0; c < 3; c++)
        d[c] = p[c] + 2.0f * v[c] + cam->t[c];
    for (int k = 0; k < 2; k++)
        out[k] = cam->fx * d[k] / d[2] / (float)cam->w;
    return d[2] > 0.0f;
}

static void check_camera(const struct world *w, const struct camera *cam, float fov)
{
    all_finite(cam->t, 3);
    all_finite(cam->q, 4);
    float norm = 0.0f, p[3], at[2];
    for (int c = 0; c < 4; c++)
        norm += cam->q[c] * cam->q[c];
    assert_true(fabsf(norm - 1.0f) < 1e-5f);
    assert_true(cam->w == 224 && cam->h == 224 && cam->cx == 112.0f && cam->cy == 112.0f);
    assert_true(cam->fx == cam->fy);
    float half = atanf(112.0f / cam->fx) * 57.29578f;
    assert_true(fov > 0.0f ? fabsf(2.0f * half - fov) < 0.01f : half > 19.9f && half < 42.6f);
    centre(cam, p);
    for (int c = 0; c < 3; c++)
        assert_true(p[c] > w->stand[0][c] - 1e-3f && p[c] < w->stand[1][c] + 1e-3f);
    outside_of_all(w, p);
    assert_true(project(cam, w->focus, at)); // near the middle, the right way up
    assert_true(fabsf(at[0]) < 1.2f && fabsf(at[1]) < 1.2f);
    const float above[3] = {w->focus[0], w->focus[1], w->focus[2] + 0.1f};
    float higher[2];
    assert_true(project(cam, above, higher));
    assert_true(higher[1] < at[1]);
}

static void cameras(void **state)
{
    (void)state;
    static const int N[] = {1, 2, 3, 10, 12, 64};
    static const float SPREAD[] = {0.0f, 0.2f, 1.0f}, FOV[] = {0.0f, 20.0f, 120.0f};
    for (uint64_t seed = 0; seed < 60; seed++) {
        struct world w;
        make(seed, (int)(seed % (WORLD_KINDS + 1)) - 1, &w);
        for (int i = 0; i < 36; i++) {
            struct world_path path = {N[i % 6], SPREAD[i % 3], FOV[i / 6 % 3], i & 1, 0, false};
            path.spread = SPREAD[i / 12];
            struct camera cams[VIEWS], again[VIEWS];
            world_cameras(&w, &path, seed + (uint64_t)i, 224, cams);
            world_cameras(&w, &path, seed + (uint64_t)i, 224, again);
            assert_memory_equal(cams, again, (size_t)path.n * sizeof *cams);
            for (int k = 0; k < path.n; k++)
                check_camera(&w, &cams[k], path.fov_deg);
        }
    }
}

/* Angle at the focus between two cameras, degrees. */
static float angle(const struct world *w, const struct camera *a, const struct camera *b)
{
    float p[3], q[3], dot = 0.0f, pp = 0.0f, qq = 0.0f;
    centre(a, p);
    centre(b, q);
    for (int c = 0; c < 3; c++) {
        p[c] -= w->focus[c];
        q[c] -= w->focus[c];
        dot += p[c] * q[c];
        pp += p[c] * p[c];
        qq += q[c] * q[c];
    }
    return acosf(fminf(dot / sqrtf(pp * qq), 1.0f)) * 57.29578f;
}

static void spread_sets_the_steps(void **state)
{
    (void)state;
    double small = 0.0, whole = 0.0;
    for (uint64_t seed = 0; seed < 100; seed++) {
        struct world w;
        make(seed, WORLD_ANY, &w);
        for (int n = 2; n <= 12; n += 5) {
            struct camera cams[VIEWS];
            struct world_path path = {n, 0.0f, 60.0f, seed & 1, 0, false};
            world_cameras(&w, &path, seed, 224, cams);
            for (int i = 1; i < n; i++)
                assert_true(angle(&w, &cams[0], &cams[i]) < 0.1f);
            path.spread = 0.2f;
            world_cameras(&w, &path, seed, 224, cams);
            for (int i = 1; i < n; i++)
                small += (double)angle(&w, &cams[i - 1], &cams[i]) / (n - 1) / 300;
            path.spread = 1.0f;
            world_cameras(&w, &path, seed, 224, cams);
            for (int i = 1; i < n && n == 12; i++)
                whole += (double)angle(&w, &cams[0], &cams[i]) / (n - 1) / 100;
        }
    }
    assert_true(small > 2.0 && small < 8.0);
    assert_true(whole > 30.0);
}

/* Neighbours of an orbit are as far apart as said, seen from above; all look at the focus from
 * outside of solids. */
static void orbits_go_around(void **state)
{
    (void)state;
    for (uint64_t seed = 0; seed < 20; seed++) {
        struct world w;
        make(seed, WORLD_PARK, &w);
        assert_true(w.around > 3.0f);
        for (int deg = 5; deg <= 45; deg += 10) {
            struct camera cams[8];
            const struct world_path path = {8, 0.3f, 60.0f, false, (float)deg, false};
            world_cameras(&w, &path, seed, 224, cams);
            for (int i = 0; i < 8; i++) {
                float p[3], q[3], at[2];
                centre(&cams[i], p);
                centre(&cams[i > 0 ? i - 1 : 1], q);
                float px = p[0] - w.focus[0], py = p[1] - w.focus[1];
                float qx = q[0] - w.focus[0], qy = q[1] - w.focus[1];
                float cosine = (px * qx + py * qy) / (hypotf(px, py) * hypotf(qx, qy));
                assert_true(fabsf(acosf(cosine) * 57.29578f - (float)deg) < 0.05f);
                assert_true(project(&cams[i], w.focus, at));
                assert_true(fabsf(at[0]) < 1e-3f && fabsf(at[1]) < 1e-3f);
                outside_of_all(&w, p);
            }
        }
    }
}

/* A walk goes twice around and comes back; its cameras look to both sides of the focus. */
static void walks_come_back(void **state)
{
    (void)state;
    for (uint64_t seed = 0; seed < 10; seed++) {
        enum { N = 60 };
        struct camera cams[N];
        struct world w;
        float around = 0, left = 0, right = 0;
        make(seed, WORLD_PARK, &w);
        const struct world_path path = {N, 0.3f, 60.0f, false, 0.0f, true};
        world_cameras(&w, &path, seed, 224, cams);
        for (int i = 0; i < N; i++) {
            float p[3], q[3], at[2];
            centre(&cams[i], p);
            centre(&cams[(i + 1) % N], q);
            outside_of_all(&w, p);
            assert_true(hypotf(p[0] - q[0], p[1] - q[1]) < 0.45f * w.around);
            const float px = p[0] - w.focus[0], py = p[1] - w.focus[1];
            const float qx = q[0] - w.focus[0], qy = q[1] - w.focus[1];
            around += atan2f(px * qy - py * qx, px * qx + py * qy);
            assert_true(project(&cams[i], w.focus, at));
            left = fminf(left, at[0]);
            right = fmaxf(right, at[0]);
        }
        assert_true(fabsf(around - 4 * 3.14159265f) < 1e-3f);
        assert_true(left < -0.5f && right > 0.5f); // beyond the picture
    }
}

static void refusals(void **state)
{
    (void)state;
    struct world w;
    arena_reset(&arena, 0);
    assert_int_equal(world_make(&arena, 1, WORLD_KINDS, &w), ERR_ARG);
    assert_non_null(strstr(err_text(), "world"));
    assert_null(w.solids);
    struct arena little;
    assert_int_equal(arena_init(&little, "little", 1000), OK);
    assert_int_equal(world_make(&little, 1, WORLD_ROOM, &w), ERR_NOMEM);
    assert_null(w.solids);
    assert_int_equal(w.n_solids, 0);
    arena_free(&little);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(promises),
        cmocka_unit_test(same_seed_same_bytes),
        cmocka_unit_test(kinds_are_what_they_say),
        cmocka_unit_test(orbits_go_around),
        cmocka_unit_test(walks_come_back),
        cmocka_unit_test(cameras),
        cmocka_unit_test(spread_sets_the_steps),
        cmocka_unit_test(refusals),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
