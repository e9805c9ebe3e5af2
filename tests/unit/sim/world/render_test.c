/* The renderer against closed forms; worlds are built by hand. */
#include "sim/world/render.h"

#include "sim/world/bvh.h"
#include "sim/world/light.h"
#include "sim/world/vec.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIZE = 33, PX = SIZE * SIZE, SOLIDS = 300 };

static const float PI = 3.14159265f;
static const struct render_quality quick = {.samples = 1, .shadow = 1};

struct stage {
    struct arena keep, tmp;
    struct run r;
    struct world w;
    struct world_solid solids[SOLIDS];
    struct world_material materials[8];
    struct world_light lights[4];
    struct render_world *scene;
    struct camera cam;
    float radiance[3 * PX], depth[PX], normal[3 * PX];
};

static struct stage s;

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

/* An empty world, whose grid of indirect light is a small box far below, and a camera at 0, 0, 0
 * that looks along +x with z up. */
static void open_stage(void)
{
    memset(&s, 0, sizeof s);
    struct plan p = plan_begin(1);
    render_open_plan(&p);
    render_plan(&p, SIZE, SIZE);
    assert_int_equal(arena_init(&s.keep, "keep", p.keep.peak), OK);
    assert_int_equal(arena_init(&s.tmp, "tmp", p.tmp.peak), OK);
    s.r = (struct run){.keep = &s.keep, .tmp = &s.tmp};
    s.w.solids = s.solids;
    s.w.materials = s.materials;
    s.w.lights = s.lights;
    s.w.kind = WORLD_ROOM;
    s.w.sun_dir[2] = 1;
    s.w.sun_cos = 1;
    for (int k = 0; k < 3; k++) {
        s.w.lo[k] = -1;
        s.w.hi[k] = 1;
    }
    s.cam = (struct camera){.w = SIZE, .h = SIZE, .fx = SIZE, .fy = SIZE};
    s.cam.cx = s.cam.cy = SIZE / 2.0f;
    const float q[4] = {0.5f, 0.5f, -0.5f, 0.5f}; // x_cam = -y, y_cam = -z, z_cam = x
    memcpy(s.cam.q, q, sizeof q);
}

static void close_stage(void)
{
    arena_free(&s.keep);
    arena_free(&s.tmp);
}

static int add_material(float albedo, float emission)
{
    struct world_material *m = s.materials + s.w.n_materials;
    memset(m, 0, sizeof *m);
    m->albedo = (struct texture){.kind = TEXTURE_FLAT, .scale = 1};
    for (int k = 0; k < 9; k++)
        m->albedo.colour[k / 3][k % 3] = albedo;
    for (int k = 0; k < 3; k++)
        m->emission[k] = emission;
    return s.w.n_materials++;
}

static struct world_solid *add_solid(enum world_shape shape, const float at[3], const float size[3])
{
    struct world_solid *o = s.solids + s.w.n_solids++;
    *o = (struct world_solid){.shape = shape, .taper = 1, .r = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    memcpy(o->t, at, sizeof o->t);
    memcpy(o->size, size, sizeof o->size);
    o->material = s.w.n_materials - 1;
    return o;
}

static void add_lamp(int solid)
{
    s.lights[s.w.n_lights++].solid = solid;
}

static void open_scene(void)
{
    assert_int_equal(render_open(&s.r, &s.w, &s.scene), OK);
}

static void draw(const struct render_quality *q)
{
    struct render_maps maps = {s.radiance, s.depth, s.normal};
    assert_int_equal(render_run(&s.r, s.scene, &s.cam, q, 1, &maps), OK);
    for (int i = 0; i < 3 * PX; i++)
        assert_true(s.radiance[i] >= 0 && isfinite(s.radiance[i]) && isfinite(s.normal[i]));
    for (int i = 0; i < PX; i++)
        assert_true(s.depth[i] > 0 && s.depth[i] <= RENDER_FAR);
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

/* ---- closed forms ---- */

static void glowing_sphere_is_exact(void **state)
{
    (void)state;
    open_stage();
    add_material(0.5f, 7);
    add_solid(WORLD_ELLIPSOID, (float[]){4, 0, 0}, (float[]){1.5f, 1.5f, 1.5f});
    add_lamp(0);
    open_scene();
    draw(&quick);
    for (int i = 0; i < PX; i++) {
        double x = (i % SIZE + 0.5 - s.cam.cx) / SIZE, y = (i / SIZE + 0.5 - s.cam.cy) / SIZE;
        double dd = 1 + x * x + y * y, root = 16 - dd * (16 - 2.25); // roots of |z d - c|^2 = 1.5^2
        if (fabs(root) < 0.1)
            continue;
        bool hit = root > 0;
        double z = (4 - sqrt(fabs(root))) / dd;
        double n[3] = {(z - 4) / 1.5, -x * z / 1.5, -y * z / 1.5};
        assert_near(s.depth[i], hit ? z : (double)RENDER_FAR, 1e-5);
        for (int c = 0; c < 3; c++) {
            assert_near(s.radiance[c * PX + i], hit ? 7 : 0, 0);
            assert_near(s.normal[c * PX + i], hit ? n[c] : 0, 2e-5);
        }
    }
    close_stage();
}

static void plane_under_the_sun(void **state)
{
    (void)state;
    for (int disc = 0; disc < 2; disc++) {
        open_stage();
        add_material(0.6f, 0);
        add_solid(WORLD_RECT, (float[]){0, 0, -2}, (float[]){500, 500, 1});
        const float sun[3] = {3, 2, 1}, dir[3] = {0.6f, 0, 0.8f};
        memcpy(s.w.sun, sun, sizeof sun);
        memcpy(s.w.sun_dir, dir, sizeof dir);
        s.w.sun_cos = disc ? 0.999f : 1;
        open_scene();
        draw(&quick);
        for (int c = 0; c < 3; c++)
            assert_near(s.radiance[c * PX + (SIZE - 1) * SIZE + SIZE / 2], 0.6 / PI * sun[c] * 0.8,
                        disc ? 0.01 : 1e-5);
        assert_near(s.radiance[SIZE / 2], 0, 0);
        close_stage();
    }
}

/* Irradiance at the middle below a parallel square of half edge a at height h (Howell, A Catalog of
 * Radiation Heat Transfer Configuration Factors, B-3, four quarters). */
static double square_above(double a, double h)
{
    double x = a / h, root = sqrt(1 + x * x);
    return 4 * x / root * atan(x / root);
}

/* A camera that looks straight down from height 1 over the plane z = -1. */
static void look_down(void)
{
    const float q[4] = {0, 1, 0, 0};
    memcpy(s.cam.q, q, sizeof q);
    s.cam.fx = s.cam.fy = 50 * SIZE;
}

static double mean_radiance(void)
{
    double sum = 0;
    for (int i = 0; i < PX; i++)
        sum += (double)s.radiance[i] / PX;
    return sum;
}

static void square_lamp_has_its_form_factor(void **state)
{
    (void)state;
    const enum world_shape shapes[] = {WORLD_RECT, WORLD_BOX};
    for (int i = 0; i < 3; i++) { // a lamp of each shape, and an opening to a sky of radiance 5
        open_stage();
        add_material(0.5f, 0);
        add_solid(WORLD_RECT, (float[]){0, 0, -1}, (float[]){50, 50, 1});
        add_material(0, 5);
        const float size[3] = {0.8f, 0.8f, 0.01f};
        if (i < 2) {
            add_solid(shapes[i], (float[]){0, 0, i ? 1.01f : 1}, size);
            add_lamp(1);
        } else {
            s.lights[s.w.n_lights++] =
                (struct world_light){-1, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 1}, {0.8f, 0.8f}};
            for (int k = 0; k < 6; k++)
                s.w.sky[k / 3][k % 3] = 5;
        }
        look_down();
        open_scene();
        draw(&quick);
        double want = 0.5 / (double)PI * 5 * square_above(0.8, 2);
        assert_near(mean_radiance(), want, 0.01 * want);
        close_stage();
    }
}

/* A ball of radius r and radiance L at distance d gives pi L (r / d)^2 on a plane that faces it;
 * the same for an ellipsoid seen along a half axis of any length is that of its outline, nearly.
 * A cylinder that shows only its disc gives that of the disc, pi L r^2 / (r^2 + d^2). */
static void round_lamps_give_their_irradiance(void **state)
{
    (void)state;
    for (int i = 0; i < 3; i++) {
        open_stage();
        add_material(0.5f, 0);
        add_solid(WORLD_RECT, (float[]){0, 0, -1}, (float[]){50, 50, 1});
        add_material(0, 5);
        const float size[3] = {0.5f, 0.5f, i == 1 ? 0.05f : 0.5f};
        add_solid(i == 2 ? WORLD_FRUSTUM : WORLD_ELLIPSOID, (float[]){0, 0, 1}, size);
        add_lamp(1);
        look_down();
        open_scene();
        draw(&quick);
        double share = i == 0 ? 0.25 * 0.25 : i == 1 ? 0.25 / 4.25 : 0.25 / (0.25 + 1.5 * 1.5);
        assert_near(mean_radiance(), 0.5 * 5 * share, 0.015 * 0.5 * 5 * share);
        close_stage();
    }
}

/* A lamp of any shape against many rays in all directions that count what glows. */
static void lamps_agree_with_rays(void **state)
{
    (void)state;
    enum { RAYS = 40000 };
    for (int shape = 0; shape < WORLD_SHAPES; shape++) {
        uint32_t x = 5;
        open_stage();
        add_material(0.5f, 3);
        struct world_solid *o = add_solid((enum world_shape)shape, (float[]){0.3f, -0.2f, 1},
                                          (float[]){0.7f, 0.3f, 0.5f});
        o->taper = 0.4f;
        rotation_of(&x, o->r);
        add_lamp(0);
        open_scene();
        struct bvh b;
        struct light_set set;
        arena_reset(&s.keep, 0);
        assert_int_equal(bvh_build(&s.keep, &s.w, &b), OK);
        assert_int_equal(light_open(&s.keep, &b, &set), OK);
        double direct = 0, rays = 0;
        for (int i = 0; i < RAYS; i++) {
            struct light_spot spot = {.n = {0, 0.6f, 0.8f}};
            struct light_dice dice = {(uint32_t)i, 9, light_hash(77, (uint32_t)i), 16};
            struct light_sum sum;
            float u[2], t, a[3], c[3], d[3], px, py;
            light_gather(&set, &spot, &dice, &sum);
            direct += (double)sum.soft[1] / RAYS;
            light_throw(&dice, 50, u);
            vec_basis(spot.n, a, c);
            vec_circle(u[1], &px, &py);
            for (int k = 0; k < 3; k++)
                d[k] = sqrtf(u[0]) * (px * a[k] + py * c[k]) + sqrtf(1 - u[0]) * spot.n[k];
            rays += bvh_first(&b, spot.p, d, 100, &t) == 0 ? 3 * (double)PI / RAYS : 0;
        }
        assert_true(rays > 0.1);
        assert_near(direct, rays, 0.03 * rays);
        close_stage();
    }
}

/* A white-ish ball under an even sky: radiance albedo x sky, everywhere. */
static void furnace_of_the_sky(void **state)
{
    (void)state;
    open_stage();
    add_material(0.7f, 0);
    add_solid(WORLD_ELLIPSOID, (float[]){4, 0, 0}, (float[]){1.5f, 1.5f, 1.5f});
    for (int k = 0; k < 6; k++)
        s.w.sky[k / 3][k % 3] = 2;
    open_scene();
    draw(&quick);
    for (int i = 0; i < PX; i++)
        assert_near(s.radiance[i], s.depth[i] < RENDER_FAR ? 1.4 : 2, 0.03);
    close_stage();
}

/* A closed box whose walls glow: e / (1 - a), less what comes after three bounces. */
static void furnace_of_walls(void **state)
{
    (void)state;
    open_stage();
    add_material(0.5f, 1);
    for (int k = 0; k < 6; k++) {
        float at[3] = {0}, size[3] = {2.2f, 2.2f, 2.2f};
        at[k / 2] = k & 1 ? 2.1f : -2.1f;
        size[k / 2] = 0.1f;
        add_solid(WORLD_BOX, at, size);
    }
    for (int k = 0; k < 3; k++) {
        s.w.lo[k] = -2;
        s.w.hi[k] = 2;
    }
    open_scene();
    draw(&quick);
    double want = 1 + 0.5 + 0.25 + 0.125;
    for (int i = 0; i < PX; i++)
        assert_near(s.radiance[i], want, 0.03 * want);
    close_stage();
}

/* A mirror shows the glowing ball behind the camera in its place, reduced by its reflectance. */
static void mirror_shows_what_is_behind(void **state)
{
    (void)state;
    open_stage();
    add_material(0.5f, 4);
    add_solid(WORLD_ELLIPSOID, (float[]){-3, 0, 0}, (float[]){1, 1, 1});
    add_material(0.01f, 0);
    s.materials[1].specular = 0.9f;
    add_solid(WORLD_BOX, (float[]){3, 0, 0}, (float[]){0.5f, 9, 9});
    open_scene();
    draw(&quick);
    const int middle = SIZE / 2 * SIZE + SIZE / 2;
    assert_near(s.depth[middle], 2.5, 1e-5);
    assert_near(s.radiance[middle], 0.9 * 4, 0.2);
    assert_near(s.radiance[SIZE / 2], 0, 0.2);
    close_stage();
}

/* ---- pictures ---- */

static void random_world(uint32_t seed, int n)
{
    uint32_t x = seed;
    open_stage();
    add_material(0.5f, 0);
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

static void busy_world(void)
{
    random_world(21, 60);
    add_material(0.6f, 0);
    s.materials[1].specular = 0.3f;
    s.materials[1].roughness = 0.3f;
    for (int i = 0; i < 60; i += 3)
        s.solids[i].material = 1;
    add_material(0.3f, 9);
    for (int i = 0; i < 3; i++) {
        s.solids[7 * i + 1].material = 2;
        add_lamp(7 * i + 1);
    }
    s.w.kind = WORLD_YARD;
    for (int k = 0; k < 3; k++) {
        s.w.sun[k] = 2;
        s.w.sun_dir[k] = 0.57735f;
        s.w.sky[0][k] = s.w.sky[1][k] = 0.7f;
        s.w.lo[k] = -5;
        s.w.hi[k] = 5;
    }
    s.w.sun_cos = 0.9999f;
    s.cam.t[2] = 7;
}

static void threads_do_not_matter(void **state)
{
    (void)state;
    static float first[2][3 * PX];
    for (int threads = 1; threads <= 3; threads++) {
        struct pool *pool;
        assert_int_equal(pool_open(&pool, threads), OK);
        busy_world();
        s.r.pool = pool;
        open_scene();
        for (int i = 0; i < 2; i++) {
            draw(&(struct render_quality){.samples = 1 + i, .shadow = 1 + i});
            if (threads == 1)
                memcpy(first[i], s.radiance, sizeof first[i]);
            assert_memory_equal(first[i], s.radiance, sizeof first[i]);
        }
        close_stage();
        pool_close(pool);
    }
}

/* One ray a pixel, smoothed, has the light of many, and its depth is theirs. */
static void quick_pictures_agree_with_slow_ones(void **state)
{
    (void)state;
    static float many[3 * PX], depth[PX];
    busy_world();
    open_scene();
    draw(&(struct render_quality){.samples = 1, .shadow = 64});
    memcpy(many, s.radiance, sizeof many);
    memcpy(depth, s.depth, sizeof depth);
    double full = mean_radiance(), off = 0;
    draw(&quick);
    assert_near(mean_radiance(), full, 0.02 * full);
    assert_memory_equal(depth, s.depth, sizeof depth);
    for (int i = 0; i < PX; i++)
        off += fabs((double)(many[i] - s.radiance[i])) / PX;
    assert_true(off < 0.08 * full);
    draw(&(struct render_quality){.samples = 4, .shadow = 1});
    assert_near(mean_radiance(), full, 0.06 * full);
    assert_memory_equal(depth, s.depth, sizeof depth);
    close_stage();
}

static void maps_may_be_left_out(void **state)
{
    (void)state;
    static float depth[PX], radiance[3 * PX];
    busy_world();
    open_scene();
    draw(&quick);
    struct render_maps none = {0}, one = {.depth = depth}, other = {.radiance = radiance};
    assert_int_equal(render_run(&s.r, s.scene, &s.cam, &quick, 1, &none), OK);
    assert_int_equal(render_run(&s.r, s.scene, &s.cam, &quick, 1, &one), OK);
    assert_int_equal(render_run(&s.r, s.scene, &s.cam, &quick, 1, &other), OK);
    assert_memory_equal(depth, s.depth, sizeof depth);
    assert_memory_equal(radiance, s.radiance, sizeof radiance);
    close_stage();
}

static void rays_agree_with_depth(void **state)
{
    (void)state;
    busy_world();
    open_scene();
    draw(&quick);
    for (int i = 0; i < PX; i += 7) {
        float x = ((float)(i % SIZE) + 0.5f - s.cam.cx) / SIZE;
        float y = ((float)(i / SIZE) + 0.5f - s.cam.cy) / SIZE;
        float d[3] = {1, -x, -y}, o[3] = {-7, 0, 0};
        float length = vec_unit(d), t = render_ray(s.scene, o, d);
        assert_near(t < RENDER_FAR ? t / length : t, s.depth[i], 1e-4);
    }
    close_stage();
}

static void empty_world_is_sky(void **state)
{
    (void)state;
    open_stage();
    s.w.sky[0][0] = s.w.sky[1][0] = 0.25f;
    open_scene();
    draw(&quick);
    for (int i = 0; i < PX; i++) {
        assert_true(s.radiance[i] == 0.25f && s.radiance[PX + i] == 0);
        assert_true(s.depth[i] == RENDER_FAR && s.normal[i] == 0);
    }
    close_stage();
}

/* The disc of the sun has the irradiance that the world says. */
static void sun_is_seen(void **state)
{
    (void)state;
    open_stage();
    s.w.sun[0] = 3;
    s.w.sun_dir[0] = 1;
    s.w.sun_dir[2] = 0;
    s.w.sun_cos = 0.995f;
    open_scene();
    draw(&(struct render_quality){.samples = 4, .shadow = 1});
    double sum = 0;
    for (int i = 0; i < PX; i++) {
        double x = (i % SIZE + 0.5 - s.cam.cx) / SIZE, y = (i / SIZE + 0.5 - s.cam.cy) / SIZE;
        sum += (double)s.radiance[i] / (SIZE * SIZE * pow(1 + x * x + y * y, 1.5));
    }
    assert_near(sum, 3, 0.1);
    close_stage();
}

static void refused(const struct render_quality *q, const char *word)
{
    struct render_maps maps = {s.radiance, s.depth, s.normal};
    assert_int_equal(render_run(&s.r, s.scene, &s.cam, q, 1, &maps), ERR_ARG);
    assert_non_null(strstr(err_text(), word));
}

static void wrong_requests_are_refused(void **state)
{
    (void)state;
    open_stage();
    open_scene();
    const struct camera good = s.cam;
    float *const fields[] = {&s.cam.fx,   &s.cam.fy,   &s.cam.cx,  &s.cam.cy,
                             &s.cam.t[1], &s.cam.q[2], &s.cam.q[0]};
    for (int i = 0; i < 7; i++) {
        *fields[i] = i < 6 ? NAN : 2;
        refused(&quick, "camera");
        s.cam = good;
    }
    s.cam.fx = 0;
    refused(&quick, "camera");
    s.cam = good;
    s.cam.w = 0;
    refused(&quick, "4096");
    s.cam = good;
    s.cam.h = 4097;
    refused(&quick, "4096");
    s.cam = good;
    refused(&(struct render_quality){.samples = 0, .shadow = 1}, "samples");
    refused(&(struct render_quality){.samples = 9, .shadow = 1}, "samples");
    refused(&(struct render_quality){.samples = 1, .shadow = 65}, "shadow");
    close_stage();
}

static void memory_and_cancel_are_checked(void **state)
{
    (void)state;
    atomic_bool cancel = true;
    struct render_maps maps = {s.radiance, s.depth, s.normal};
    busy_world();
    s.r.cancel = &cancel;
    assert_int_equal(render_open(&s.r, &s.w, &s.scene), ERR_CANCELLED);
    cancel = false;
    arena_reset(&s.keep, 0);
    open_scene();
    cancel = true;
    assert_int_equal(render_run(&s.r, s.scene, &s.cam, &quick, 1, &maps), ERR_CANCELLED);
    cancel = false;
    assert_int_equal((int)arena_mark(&s.tmp), 0);
    s.tmp.size = 4096;
    assert_int_equal(render_run(&s.r, s.scene, &s.cam, &quick, 1, &maps), ERR_NOMEM);
    arena_reset(&s.keep, 0);
    assert_int_equal(render_open(&s.r, &s.w, &s.scene), ERR_NOMEM);
    assert_null(s.scene);
    close_stage();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(glowing_sphere_is_exact),
        cmocka_unit_test(plane_under_the_sun),
        cmocka_unit_test(square_lamp_has_its_form_factor),
        cmocka_unit_test(round_lamps_give_their_irradiance),
        cmocka_unit_test(lamps_agree_with_rays),
        cmocka_unit_test(furnace_of_the_sky),
        cmocka_unit_test(furnace_of_walls),
        cmocka_unit_test(mirror_shows_what_is_behind),
        cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(quick_pictures_agree_with_slow_ones),
        cmocka_unit_test(maps_may_be_left_out),
        cmocka_unit_test(rays_agree_with_depth),
        cmocka_unit_test(empty_world_is_sky),
        cmocka_unit_test(sun_is_seen),
        cmocka_unit_test(wrong_requests_are_refused),
        cmocka_unit_test(memory_and_cancel_are_checked),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
