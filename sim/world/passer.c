/* The ellipsoid lives in the frame of the camera. It stands as far away as a person of its height
 * in the picture would, or nearer, so that no surface lies before it. Perspective and lens stretch
 * it at the edge of a picture, hence its pixels are counted and its size is corrected. */
#include "sim/world/passer.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/base/splitmix.h"
#include "sim/world/light.h"
#include "sim/world/vec.h"

#include <string.h>

enum { LOOKS = 4, PROBES = 17, ROUNDS = 3 };

static const float SLENDER = 2.2f;    // height over width
static const float TALL = 1.7f;       // m
static const float BEFORE = 0.9f;     // of the distance to what is behind it
static const float SIDE_MOST = 0.47f; // half axis over the picture's side
static const float PI = (float)NUM_PI;

struct figure {
    const struct run *r;
    const struct render_world *s;
    const struct passer_shot *shot;
    float *radiance;
    uint8_t *mask;
    float turn[9], eye[3];    // world to camera; m
    float focal;              // px
    float at[2], half[2];     // px, middle and half axes without perspective
    float centre[3], axis[3]; // m, in the camera
    struct texture cloth;
};

/* Unit ray of a px, in the camera. False beyond the image circle. */
static bool aim_ray(const struct figure *f, float u, float v, float d[3])
{
    const struct camera *c = f->shot->cam;
    const struct lens *lens = f->shot->quality->lens;
    double ray[3];
    if (lens && !lens_unproject(lens, (const double[2]){(double)u, (double)v}, ray))
        return false;
    for (int k = 0; k < 3 && lens; k++)
        d[k] = (float)ray[k];
    if (lens)
        return true;
    d[0] = (u - c->cx) / c->fx;
    d[1] = (v - c->cy) / c->fy;
    d[2] = 1;
    vec_unit(d);
    return true;
}

/* Distance along the unit ray d; 0 if it misses. */
static float hit_figure(const struct figure *f, const float d[3])
{
    float aa = 0, ab = 0, bb = 0;
    for (int k = 0; k < 3; k++) {
        const float a = d[k] / f->axis[k], b = f->centre[k] / f->axis[k];
        aa += a * a;
        ab += a * b;
        bb += b * b;
    }
    const float inside = ab * ab - aa * (bb - 1);
    return inside > 0 && ab > 0 ? (ab - sqrtf(inside)) / aa : 0;
}

/* ---- where it stands ---- */

static float draw_number(uint64_t *state)
{
    return (float)(splitmix_next(state) >> 40) * 0x1p-24f;
}

/* Distance to the nearest surface that is seen where the figure will be. */
static float room_before(const struct figure *f)
{
    float least = RENDER_FAR, d[3], world[3];
    for (int i = 0; i < PROBES * PROBES; i++) {
        const float x = 2 * (float)(i % PROBES) / (PROBES - 1) - 1;
        const float y = 2 * (float)(i / PROBES) / (PROBES - 1) - 1;
        if (!aim_ray(f, f->at[0] + x * f->half[0], f->at[1] + y * f->half[1], d))
            continue;
        vec_turn_back(f->turn, d, world);
        least = vec_min(least, render_ray(f->s, f->eye, world));
    }
    return least;
}

static void stand(struct figure *f)
{
    float d[3] = {0, 0, 1};
    const float wide = f->half[0] / f->focal, high = f->half[1] / f->focal;
    const float away = vec_min(TALL / 2 / high, BEFORE * room_before(f) / (1 + wide));
    if (!aim_ray(f, f->at[0], f->at[1], d))
        d[2] = 1;
    for (int k = 0; k < 3; k++)
        f->centre[k] = away * d[k];
    f->axis[0] = f->axis[2] = away * wide;
    f->axis[1] = away * high;
}

static float covered_share(const struct figure *f)
{
    const struct camera *c = f->shot->cam;
    int n = 0;
    float d[3];
    for (int i = 0; i < c->w * c->h; i++)
        n += aim_ray(f, (float)(i % c->w) + 0.5f, (float)(i / c->w) + 0.5f, d) &&
             hit_figure(f, d) > 0;
    return (float)n / (float)(c->w * c->h);
}

static void place_figure(struct figure *f, const struct passer *p)
{
    const struct camera *c = f->shot->cam;
    const float side[2] = {(float)c->w, (float)c->h};
    uint64_t state = p->seed ^ splitmix_mix(f->shot->number + 1);
    const float at[2] = {draw_number(&state), draw_number(&state)};
    float area = p->share;
    for (int i = 0; i < ROUNDS; i++) {
        f->half[1] = sqrtf(SLENDER * area * side[0] * side[1] / PI);
        f->half[1] = vec_min(f->half[1], SIDE_MOST * side[1]);
        f->half[0] = vec_min(area * side[0] * side[1] / PI / f->half[1], SIDE_MOST * side[0]);
        for (int k = 0; k < 2; k++)
            f->at[k] = f->half[k] + at[k] * (side[k] - 2 * f->half[k]);
        stand(f);
        area *= vec_min(vec_max(p->share / vec_max(covered_share(f), 1e-6f), 0.5f), 2);
    }
}

/* What it wears: a cloth that differs from seed to seed. */
static void dress(struct figure *f, const struct passer *p)
{
    uint64_t state = splitmix_mix(p->seed + 1);
    f->cloth = (struct texture){.kind = splitmix_next(&state) & 1 ? TEXTURE_SPOTS : TEXTURE_FABRIC,
                                .seed = (uint32_t)splitmix_next(&state),
                                .scale = 0.25f * f->axis[1],
                                .contrast = 0.8f};
    for (int k = 0; k < 9; k++)
        f->cloth.colour[k / 3][k % 3] = 0.05f + 0.7f * draw_number(&state);
}

/* ---- pixels ---- */

/* Radiance of the figure where the ray d meets it at the distance t. */
static void shade_figure(const struct figure *f, const float d[3], float t,
                         const struct light_dice *dice, float out[3])
{
    float local[3], n[3], p[3], normal[3], albedo[3], light[3], sum[3] = {0};
    for (int k = 0; k < 3; k++) {
        local[k] = t * d[k] - f->centre[k];
        n[k] = local[k] / (f->axis[k] * f->axis[k]);
    }
    vec_unit(n);
    vec_turn_back(f->turn, n, normal);
    const float seen[3] = {t * d[0], t * d[1], t * d[2]};
    vec_turn_back(f->turn, seen, p);
    vec_along(p, 1, f->eye, p);
    for (int i = 0; i < LOOKS; i++) {
        struct light_dice one = *dice;
        one.index = dice->index * LOOKS + (uint32_t)i;
        one.noise += (uint32_t)i;
        render_light(f->s, p, normal, &one, light);
        vec_along(sum, 1.0f / LOOKS, light, sum);
    }
    texture_eval(&f->cloth, local, n, t / (f->focal * (float)f->shot->quality->samples), albedo);
    for (int k = 0; k < 3; k++)
        out[k] = albedo[k] / PI * sum[k];
}

static void paint_pixel(const struct figure *f, int i, int j)
{
    const struct camera *c = f->shot->cam;
    const int side = f->shot->quality->samples, all = side * side;
    const size_t at = (size_t)i * (size_t)c->w + (size_t)j, px = (size_t)c->w * (size_t)c->h;
    struct light_dice dice = {.seed = light_hash((uint32_t)at, (uint32_t)f->shot->number)};
    float sum[3] = {0}, one[3], d[3];
    int hits = 0;
    while (1 << dice.bits < all * LOOKS)
        dice.bits++;
    for (int k = 0; k < all; k++) {
        const float u = (float)j + ((float)(k % side) + 0.5f) / (float)side;
        const float v = (float)i + ((float)(k / side) + 0.5f) / (float)side;
        const float t = aim_ray(f, u, v, d) ? hit_figure(f, d) : 0;
        dice.index = (uint32_t)k;
        dice.noise = light_hash(dice.seed, (uint32_t)k);
        if (!(t > 0))
            continue;
        shade_figure(f, d, t, &dice, one);
        vec_along(sum, 1.0f / (float)all, one, sum);
        hits++;
    }
    f->mask[at] = hits ? 0 : 255;
    for (size_t k = 0; k < 3 && hits; k++) {
        const float behind = f->radiance[k * px + at];
        f->radiance[k * px + at] = behind * (float)(all - hits) / (float)all + sum[k];
    }
}

static err_t paint_row(void *ctx, int i, int worker)
{
    const struct figure *f = ctx;
    (void)worker;
    err_t e = run_check(f->r, "passer-by");
    for (int j = 0; j < f->shot->cam->w && !e; j++)
        paint_pixel(f, i, j);
    return e;
}

err_t passer_draw(const struct run *r, const struct render_world *s, const struct passer *p,
                  const struct passer_shot *shot, float *radiance, uint8_t *mask)
{
    const struct camera *c = shot->cam;
    const struct lens *lens = shot->quality->lens;
    struct figure f = {.r = r, .s = s, .shot = shot, .radiance = radiance, .mask = mask};
    const float back[3] = {-c->t[0], -c->t[1], -c->t[2]};
    if (!((double)p->share >= PASSER_SHARE_MIN && (double)p->share <= PASSER_SHARE_MAX))
        return err_fail(ERR_ARG, "passer-by: %g of a picture, allowed are %g to %g",
                        (double)p->share, PASSER_SHARE_MIN, PASSER_SHARE_MAX);
    err_t e = render_check(c, shot->quality);
    if (e)
        return e;
    f.focal = lens ? (float)sqrt(lens->fx * lens->fy) : sqrtf(c->fx * c->fy);
    rotation_from_unit(c->q, f.turn);
    vec_turn_back(f.turn, back, f.eye);
    place_figure(&f, p);
    dress(&f, p);
    return pool_for(r->pool, c->h, paint_row, &f);
}
