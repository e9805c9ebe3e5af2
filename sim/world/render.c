/* Every sample of a pixel is one ray to the first surface. Light that comes straight there is drawn
 * by light.c, light that comes by way of other surfaces is blended from the grid of light_probe.c.
 * Gloss takes Schlick's share F of the light (An Inexpensive BRDF Model, 1994): where F is large,
 * by a mirrored ray, whose hit is shaded without gloss; where it is small, as the highlight of each
 * light plus what the grid gives in the mirrored direction.
 * Few samples: pixels of a 4 x 4 pattern share out the points of each light between them (Keller
 * and Heidrich, Interleaved Sampling, 2001), and what came from large lights is averaged over 5 x 5
 * px of one plane with half weights at the edges, so that each window holds the whole pattern
 * evenly; what came from the sun, over 3 x 3. A neighbour belongs if its normal agrees and its
 * depth is that of the pixel's plane, whose 1 / z is linear in the picture. The irradiance is
 * averaged, not the colour, so that textures stay sharp. */
#include "sim/world/render.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/splat/raster.h"
#include "sim/world/light_probe.h"
#include "sim/world/vec.h"

#include <stdlib.h>
#include <string.h>

enum { SIDE_MAX = 4096, SAMPLES_MAX = 8, SHADOW_MAX = 64, DIM_BEND = 43, STRIP = 64 };

/* Parts of a pixel's light, three numbers each, and planes of a picture. */
enum {
    REST,   // radiance apart from:
    SOFT,   // irradiance from large lights,
    ALBEDO, // times this,
    GLOSS,  // radiance of rough gloss,
    SUN,    // and irradiance from the sun, times ALBEDO
    PARTS,
    DEPTH = PARTS, // 1 / z, 0 if nothing; its changes from px to px to the right and down
    NORMAL,
    PLANES = 3 * (NORMAL + 1)
};

static const float PI = (float)NUM_PI;
static const float RADIANCE_MAX = 1e9f;
static const float PLANE_WITHIN = 0.005f; // of 1 / z, how well a neighbour must lie in the plane
static const float AMBIENT = 0.05f;       // F up to which a surface mirrors no picture
static const float RAY_LEAST = 0.005f;    // weight from which a mirrored ray is worth its time
static const float CLEAR = 0.15f;         // weight from which a mirrored picture must have no grain
static const float ROUGH_RAY = 0.6f;      // roughness from which none is traced
static const float ROUGH_LAMP = 0.2f;     // from which lamps shine by their lobe, not by the ray
static const float ROUGH_SUN = 0.02f;     // the same of the sun
static const float ROUGH_BLUR = 0.05f;    // from which gloss is averaged over neighbours
static const float GLINT = 4; // most that one ray of it may bring, over what the grid has there
static const float SHINE = 8; // most that the highlights of a point may be, over its own light

struct render_world {
    const struct world *w;
    struct bvh bvh;
    struct light_set lights;
    struct light_probes probes;
};

static err_t alloc_world(struct arena *keep, struct render_world **out)
{
    return arena_alloc(keep, 1, sizeof **out, out);
}

void render_open_plan(struct plan *p)
{
    struct render_world *s;
    (void)alloc_world(&p->keep, &s); // a counter is never full
    bvh_plan(p);
    light_plan(p);
    light_probe_plan(p);
}

err_t render_open(const struct run *r, const struct world *w, struct render_world **out)
{
    struct render_world *s;
    *out = NULL;
    err_t e = alloc_world(r->keep, &s);
    if (e)
        return e;
    s->w = w;
    e = bvh_build(r->keep, w, &s->bvh);
    if (!e)
        e = light_open(r->keep, &s->bvh, &s->lights);
    if (!e)
        e = light_probe_build(r, &s->lights, &s->probes);
    if (!e)
        *out = s;
    return e;
}

float render_ray(const struct render_world *s, const float o[3], const float d[3])
{
    float t;
    bvh_first(&s->bvh, o, d, RENDER_FAR, &t);
    return t;
}

void render_light(const struct render_world *s, const float p[3], const float n[3],
                  const struct light_dice *dice, float out[3])
{
    struct light_spot spot = {0};
    struct light_sum sum;
    memcpy(spot.p, p, sizeof spot.p);
    memcpy(spot.n, n, sizeof spot.n);
    light_gather(&s->lights, &spot, dice, &sum);
    light_probe_irradiance(&s->probes, p, n, out);
    for (int k = 0; k < 3; k++)
        out[k] += sum.soft[k] + sum.sun[k];
}

/* ---- one ray ---- */

/* A ray of the eye, or a mirrored one. */
struct eye_ray {
    float o[3], d[3];  // m; unit
    float far, spread; // m, length of the way to o; widening of the footprint per m
    bool lamps, sun;   // whether listed lamps and the sun's disc are visible to it
    int looks;         // how often lights are drawn where it ends
};

struct pixel_sample {
    float t;    // m, RENDER_FAR if nothing
    float n[3]; // unit, towards the eye
    float part[PARTS][3];
};

/* The last solids in the way of each light, kept by a worker from pixel to pixel. */
struct occluders {
    struct light_spot first, second;
};

static void set_spot(const struct eye_ray *g, float t, const struct light_surface *on,
                     struct light_spot *spot)
{
    vec_along(g->o, t, g->d, spot->p);
    vec_along(spot->p, light_lift(g->far + t), on->n, spot->p);
    memcpy(spot->n, on->n, sizeof spot->n);
    memset(spot->shine, 0, sizeof spot->shine);
}

static int hit_surface(const struct render_world *s, const struct eye_ray *g,
                       struct light_surface *on, float *t)
{
    float p[3];
    int solid = bvh_first(&s->bvh, g->o, g->d, RENDER_FAR, t);
    if (solid < 0)
        return solid;
    vec_along(g->o, *t, g->d, p);
    light_surface(&s->bvh, solid, p, g->d, (g->far + *t) * g->spread, on);
    return solid;
}

/* Light of a mirrored ray; its hit is shaded without gloss. */
static void shade_mirrored(const struct render_world *s, const struct eye_ray *g,
                           struct light_spot *spot, const struct light_dice *dice, float out[3])
{
    struct light_surface on;
    struct light_sum sum;
    float t, light[3];
    int solid = hit_surface(s, g, &on, &t);
    if (solid < 0) {
        light_sky(s->w, g->d, g->sun, out);
        return;
    }
    set_spot(g, t, &on, spot);
    light_probe_irradiance(&s->probes, spot->p, spot->n, light);
    for (int i = 0; i < g->looks; i++) {
        struct light_dice one = *dice;
        one.index = dice->index * (uint32_t)g->looks + (uint32_t)i;
        one.noise += (uint32_t)i;
        one.bits = dice->bits + (g->looks > 1 ? 2 : 0);
        light_gather(&s->lights, spot, &one, &sum);
        for (int k = 0; k < 3; k++)
            light[k] += (sum.soft[k] + sum.sun[k]) / (float)g->looks;
    }
    bool glows = g->lamps || !s->lights.listed[solid];
    for (int k = 0; k < 3; k++)
        out[k] = on.albedo[k] / PI * light[k] + (glows ? on.material->emission[k] : 0);
}

/* Schlick's share of the gloss, less at grazing angles where the surface is rough. */
static float gloss_share(const struct world_material *m, float facing)
{
    float a = 1 - facing, a2 = a * a, most = vec_max(1 - m->roughness, m->specular);
    return m->specular + (most - m->specular) * a2 * a2 * a;
}

/* The part of the gloss that is traced: none up to AMBIENT, all from twice that. */
static float ray_share(const struct world_material *m, float share)
{
    float part = vec_min(vec_max(share / AMBIENT - 1, 0), 1);
    return m->roughness < ROUGH_RAY && part * share > RAY_LEAST ? part * share : 0;
}

static float lobe_of(float roughness)
{
    float square = roughness * roughness;
    return vec_max(2 / vec_max(square * square, 1e-6f) - 2, 1);
}

/* The mirrored ray, turned within the lobe of the surface. */
static void bend_ray(const struct light_spot *spot, float roughness, const struct light_dice *dice,
                     float d[3])
{
    float u[2], a[3], b[3], x, y;
    memcpy(d, spot->mirror, 3 * sizeof *d);
    if (roughness < 1e-3f)
        return;
    light_throw(dice, DIM_BEND, u);
    float c = powf(1 - u[0], 1 / (lobe_of(roughness) + 1)), side = sqrtf(vec_max(1 - c * c, 0));
    vec_basis(spot->mirror, a, b);
    vec_circle(u[1], &x, &y);
    for (int k = 0; k < 3; k++)
        d[k] = side * (x * a[k] + y * b[k]) + c * spot->mirror[k];
    if (vec_dot(d, spot->n) < 1e-3f)
        memcpy(d, spot->mirror, 3 * sizeof *d);
}

/* Limit the light of one ray of a wide lobe: a bright window would be a meaningless glint. */
static void limit_glint(const float even[3], float light[3])
{
    for (int k = 0; k < 3; k++)
        light[k] = vec_min(light[k], GLINT / PI * even[k]);
}

/* Add the mirrored surroundings, with weight `ray` by a ray and `ambient` from the grid. */
static void add_mirrored(const struct render_world *s, const struct eye_ray *g,
                         struct occluders *hand, const struct light_dice *dice,
                         const struct light_surface *on, struct pixel_sample *out)
{
    const struct light_spot *spot = &hand->first;
    float rough = on->material->roughness, share = gloss_share(on->material, on->facing);
    float ray = ray_share(on->material, share), light[3], even[3];
    float *to = rough < ROUGH_BLUR ? out->part[REST] : out->part[GLOSS];
    if (share > 1e-3f)
        light_probe_irradiance(&s->probes, spot->p, spot->mirror, even);
    if (ray > 0) {
        struct eye_ray next = {.far = g->far + out->t, .spread = g->spread + 0.5f * rough * rough};
        next.lamps = rough < ROUGH_LAMP;
        next.sun = rough < ROUGH_SUN;
        next.looks = ray > CLEAR && rough < ROUGH_BLUR && dice->bits < 6 ? 4 : 1;
        memcpy(next.o, spot->p, sizeof next.o);
        bend_ray(spot, rough, dice, next.d);
        shade_mirrored(s, &next, &hand->second, dice, light);
        if (rough >= ROUGH_BLUR)
            limit_glint(even, light);
        vec_along(to, ray, light, to);
    }
    if (share - ray > 1e-3f)
        vec_along(to, (share - ray) / PI, even, to);
}

static void set_gloss(const struct eye_ray *g, const struct light_surface *on,
                      struct light_spot *spot)
{
    float rough = on->material->roughness, share = gloss_share(on->material, on->facing);
    float part = share - ray_share(on->material, share);
    vec_along(g->d, 2 * on->facing, on->n, spot->mirror);
    spot->lobe = lobe_of(vec_max(rough, ROUGH_LAMP));
    spot->shine[0] = rough < ROUGH_LAMP ? part : share;
    spot->shine[1] = rough < ROUGH_SUN ? part : share;
    spot->shine[2] = part;
}

static void shade_ray(const struct render_world *s, const struct eye_ray *g, struct occluders *hand,
                      const struct light_dice *dice, struct pixel_sample *out)
{
    struct light_surface on;
    struct light_sum sum;
    struct light_spot *spot = &hand->first;
    float light[3];
    memset(out, 0, sizeof *out);
    if (hit_surface(s, g, &on, &out->t) < 0) {
        light_sky(s->w, g->d, true, out->part[REST]);
        return;
    }
    const struct world_material *m = on.material;
    bool glossy = m->specular > 0;
    set_spot(g, out->t, &on, spot);
    memcpy(out->n, on.n, sizeof out->n);
    if (glossy)
        set_gloss(g, &on, spot);
    light_gather(&s->lights, spot, dice, &sum);
    light_probe_irradiance(&s->probes, spot->p, spot->n, light);
    float share = glossy ? gloss_share(m, on.facing) : 0;
    float even = share <= AMBIENT ? share : 0; // of little gloss, which mirrors its own side
    for (int k = 0; k < 3; k++) {
        out->part[ALBEDO][k] = on.albedo[k] * (1 - share) / PI;
        out->part[REST][k] = m->emission[k] + (out->part[ALBEDO][k] + even / PI) * light[k];
        out->part[SOFT][k] = sum.soft[k];
        out->part[SUN][k] = sum.sun[k];
        out->part[GLOSS][k] = vec_min(sum.gloss[k], SHINE / PI * on.albedo[k] *
                                                        (sum.soft[k] + sum.sun[k] + light[k]));
    }
    if (share > AMBIENT)
        add_mirrored(s, g, hand, dice, &on, out);
}

/* ---- pictures ---- */

struct picture {
    const struct run *r;
    const struct render_world *s;
    const struct camera *cam;
    const struct render_quality *q;
    const struct render_maps *out;
    float turn[9], eye[3], spread; // world to camera; m; width of a pixel per m
    uint32_t seed;
    int period;   // px of the pattern: 4, 2, or 1 without smoothing
    float *plane; // (PLANES, h, w), NULL without smoothing
};

err_t render_check(const struct camera *c, const struct render_quality *q)
{
    float sum = c->fx + c->fy + c->cx + c->cy, length = 0;
    if (c->w < 1 || c->h < 1 || c->w > SIDE_MAX || c->h > SIDE_MAX)
        return err_fail(ERR_ARG, "render: picture of %d x %d px, allowed are 1 to %d", c->w, c->h,
                        SIDE_MAX);
    for (int k = 0; k < 4; k++)
        length += c->q[k] * c->q[k];
    for (int k = 0; k < 3; k++)
        sum += c->t[k];
    if (!(c->fx > 0) || !(c->fy > 0) || !isfinite(sum))
        return err_fail(ERR_ARG,
                        "camera with focal lengths %g, %g px, centre %g, %g px and translation %g, "
                        "%g, %g: all must be finite, the first two > 0",
                        (double)c->fx, (double)c->fy, (double)c->cx, (double)c->cy, (double)c->t[0],
                        (double)c->t[1], (double)c->t[2]);
    if (!(fabsf(length - 1) < 1e-3f))
        return err_fail(ERR_ARG, "render: the camera's quaternion has length %g, must be 1",
                        (double)sqrtf(length));
    if (q->samples < 1 || q->samples > SAMPLES_MAX)
        return err_fail(ERR_ARG,
                        "render: %d samples along each edge of a pixel, allowed are 1 to %d",
                        q->samples, SAMPLES_MAX);
    if (q->shadow < 1 || q->shadow > SHADOW_MAX)
        return err_fail(ERR_ARG, "render: %d shadow rays per light, allowed are 1 to %d", q->shadow,
                        SHADOW_MAX);
    return OK;
}

/* The ray of px (u, v). *z: of the camera per metre of the ray. False beyond the image circle. */
static bool aim_ray(const struct picture *p, float u, float v, struct eye_ray *g, float *z)
{
    float d[3] = {(u - p->cam->cx) / p->cam->fx, (v - p->cam->cy) / p->cam->fy, 1};
    double ray[3];
    if (p->q->lens && !lens_unproject(p->q->lens, (const double[2]){(double)u, (double)v}, ray))
        return false;
    for (int k = 0; k < 3 && p->q->lens; k++)
        d[k] = (float)ray[k];
    *g = (struct eye_ray){.spread = p->spread, .lamps = true, .sun = true};
    memcpy(g->o, p->eye, sizeof g->o);
    vec_turn_back(p->turn, d, g->d);
    *z = d[2] / vec_unit(g->d);
    return true;
}

/* The number of a pixel in its pattern: neighbours are far apart in the sequence. */
static uint32_t pattern_index(int i, int j, int period)
{
    uint32_t x = (uint32_t)j, y = (uint32_t)i, fine = ((x ^ y) & 1) | (y & 1) << 1;
    if (period == 1)
        return 0;
    return period == 2 ? fine : fine | ((x ^ y) & 2) << 1 | (y & 2) << 2;
}

static struct light_dice pixel_dice(const struct picture *p, int i, int j, int sample)
{
    int n = p->q->samples * p->q->samples * p->q->shadow, bits = 0;
    uint32_t px = (uint32_t)(p->period * p->period);
    uint32_t pixel = light_hash(p->seed, (uint32_t)(i * p->cam->w + j));
    while (1u << bits < px * (uint32_t)n)
        bits++;
    return (struct light_dice){
        .index = pattern_index(i, j, p->period) + px * (uint32_t)sample,
        .seed = p->period > 1 ? p->seed : pixel,
        .noise = light_hash(pixel, (uint32_t)sample),
        .bits = bits,
    };
}

/* The surface at the pixel's centre and the mean of all samples. */
static void sample_pixel(const struct picture *p, int i, int j, struct occluders *hand,
                         struct pixel_sample *out)
{
    int side = p->q->samples, shadow = p->q->shadow, all = side * side * shadow;
    struct pixel_sample one = {0};
    memset(out, 0, sizeof *out);
    for (int k = 0; k < all; k++) {
        int x = k / shadow % side, y = k / shadow / side;
        struct light_dice dice = pixel_dice(p, i, j, k);
        struct eye_ray g;
        float z;
        if (!aim_ray(p, (float)j + ((float)x + 0.5f) / (float)side,
                     (float)i + ((float)y + 0.5f) / (float)side, &g, &z))
            continue;
        shade_ray(p->s, &g, hand, &dice, &one);
        for (int c = 0; c < 3; c++) {
            float light = one.part[SOFT][c] + one.part[SUN][c];
            one.part[REST][c] += one.part[ALBEDO][c] * light + one.part[GLOSS][c];
            for (int part = 0; part < PARTS; part++)
                out->part[part][c] += one.part[part][c] / (float)all;
        }
    }
    out->t = one.t;
    memcpy(out->n, one.n, sizeof out->n);
}

/* 1 / z of the plane that a pixel shows, at its centre, and how it changes in the picture. */
static void fit_plane(const struct picture *p, const struct eye_ray *g,
                      const struct pixel_sample *seen, float z, float out[3])
{
    float n[3], off = seen->t * vec_dot(g->d, seen->n); // of the plane from the eye
    out[0] = out[1] = out[2] = 0;
    if (!(off < -1e-6f))
        return;
    vec_turn(p->turn, seen->n, n);
    out[0] = 1 / vec_max(z, 1e-6f);
    out[1] = n[0] / (p->cam->fx * off);
    out[2] = n[1] / (p->cam->fy * off);
}

static float finite_light(float x)
{
    return x > 0 ? vec_min(x, RADIANCE_MAX) : 0;
}

static void store_pixel(const struct picture *p, size_t at, const struct eye_ray *g,
                        const struct pixel_sample *seen, float z)
{
    size_t px = (size_t)p->cam->w * (size_t)p->cam->h;
    float plane[3];
    bool hit = seen->t < RENDER_FAR;
    if (p->out->depth)
        p->out->depth[at] = hit ? z : RENDER_FAR;
    for (int c = 0; c < 3; c++) {
        if (p->out->normal)
            p->out->normal[(size_t)c * px + at] = hit ? seen->n[c] : 0;
        if (p->out->radiance && !p->plane)
            p->out->radiance[(size_t)c * px + at] = finite_light(seen->part[REST][c]);
    }
    if (!p->plane)
        return;
    fit_plane(p, g, seen, z, plane);
    for (int c = 0; c < 3; c++) {
        for (int part = 0; part < PARTS; part++)
            p->plane[(size_t)(3 * part + c) * px + at] = seen->part[part][c];
        p->plane[(size_t)(3 * DEPTH + c) * px + at] = plane[c];
        p->plane[(size_t)(3 * NORMAL + c) * px + at] = hit ? seen->n[c] : 0;
    }
}

static err_t draw_row(void *ctx, int i, int worker)
{
    const struct picture *p = ctx;
    struct occluders hand = {0};
    (void)worker;
    err_t e = run_check(p->r, "picture");
    for (int j = 0; j < p->cam->w && !e; j++) {
        struct eye_ray g;
        struct pixel_sample seen = {0};
        struct light_surface on;
        float scale = 1;
        const bool aimed = aim_ray(p, (float)j + 0.5f, (float)i + 0.5f, &g, &scale);
        if (p->out->radiance)
            sample_pixel(p, i, j, &hand, &seen);
        if (!aimed) {
            seen.t = RENDER_FAR;
            memset(seen.n, 0, sizeof seen.n);
        } else if (!p->out->radiance || p->q->samples > 1) {
            memset(seen.n, 0, sizeof seen.n);
            if (hit_surface(p->s, &g, &on, &seen.t) >= 0)
                memcpy(seen.n, on.n, sizeof seen.n);
        }
        store_pixel(p, (size_t)i * (size_t)p->cam->w + (size_t)j, &g, &seen, seen.t * scale);
    }
    return e;
}

/* ---- smoothing ---- */

/* Sums over the windows of a strip of a row: of light from large lights, and of light from the sun,
 * whose shadows are sharper. */
struct strip {
    const float *plane; // of struct picture
    size_t px, at;      // of a plane; of the first pixel
    int w, first, n;
    float tight[STRIP];     // per difference of 1 / z
    float sum[3][3][STRIP]; // irradiance, gloss, irradiance of the sun
    float weight[2][STRIP];
};

/* Weights of each pixel's neighbour at x, y: whether both show the same plane. */
static void weigh_neighbours(const struct strip *s, int x, int y, const int range[2],
                             float *restrict out)
{
    const float *z = s->plane + 3 * DEPTH * s->px + s->at, *nx = z + 3 * s->px;
    const float *right = z + s->px, *down = right + s->px, *ny = nx + s->px, *nz = ny + s->px;
    const ptrdiff_t to = (ptrdiff_t)y * s->w + x;
    for (int j = range[0]; j < range[1]; j++) {
        float turn = nx[j] * nx[to + j] + ny[j] * ny[to + j] + nz[j] * nz[to + j];
        float there = z[j] + right[j] * (float)x + down[j] * (float)y;
        float off = fabsf(z[to + j] - there) * s->tight[j];
        out[j] = vec_max(10 * turn - 9, 0) * vec_max(1 - off, 0);
    }
}

static void add_plane(const float *restrict weight, float share, const float *restrict plane,
                      const int range[2], float *restrict sum)
{
    for (int j = range[0]; j < range[1]; j++)
        sum[j] += share * weight[j] * plane[j];
}

/* Add to every pixel of the strip its neighbour at x, y. */
static void add_neighbour(struct strip *s, int x, int y, const float share[2])
{
    static const int parts[3] = {SOFT, GLOSS, SUN};
    float weight[STRIP];
    int range[2] = {s->first + x < 0 ? -(s->first + x) : 0, s->n};
    if (s->first + s->n + x > s->w)
        range[1] = s->w - s->first - x;
    weigh_neighbours(s, x, y, range, weight);
    for (int window = 0; window < 2 && share[window] > 0; window++)
        for (int j = range[0]; j < range[1]; j++)
            s->weight[window][j] += share[window] * weight[j];
    for (int k = 0; k < 3; k++) {
        float part = share[parts[k] == SUN];
        const float *plane = s->plane + 3 * (size_t)parts[k] * s->px + s->at;
        plane += (ptrdiff_t)y * s->w + x;
        for (size_t c = 0; c < 3 && part > 0; c++)
            add_plane(weight, part, plane + c * s->px, range, s->sum[k][c]);
    }
}

/* Weights of a window from -reach to reach, half at both ends. */
static float window_share(int x, int y, int reach)
{
    int a = abs(x), b = abs(y);
    return a > reach || b > reach ? 0 : (a == reach ? 0.5f : 1) * (b == reach ? 0.5f : 1);
}

static void smooth_pixel(const struct picture *p, const struct strip *s, size_t c, int j)
{
    const size_t px = s->px;
    const float *at = s->plane + c * px + s->at + (size_t)j;
    float change = 0;
    if (s->weight[0][j] > 0.1f && s->weight[1][j] > 0.1f) {
        float soft = s->sum[0][c][j] / s->weight[0][j] - at[3 * SOFT * px];
        float gloss = s->sum[1][c][j] / s->weight[0][j] - at[3 * GLOSS * px];
        float sun = s->sum[2][c][j] / s->weight[1][j] - at[3 * SUN * px];
        change = at[3 * ALBEDO * px] * (soft + sun) + gloss;
    }
    p->out->radiance[c * px + s->at + (size_t)j] = finite_light(*at + change);
}

static void smooth_strip(const struct picture *p, struct strip *s, int i)
{
    int reach = p->period / 2;
    const float *z = s->plane + 3 * DEPTH * s->px + s->at;
    for (int j = 0; j < s->n; j++)
        s->tight[j] = 1 / vec_max(PLANE_WITHIN * z[j], 1e-9f);
    for (int y = -reach; y <= reach; y++) {
        for (int x = -reach; x <= reach && i + y >= 0 && i + y < p->cam->h; x++) {
            float share[2] = {window_share(x, y, reach), window_share(x, y, 1)};
            add_neighbour(s, x, y, share);
        }
    }
    for (size_t c = 0; c < 3; c++)
        for (int j = 0; j < s->n; j++)
            smooth_pixel(p, s, c, j);
}

static err_t smooth_row(void *ctx, int i, int worker)
{
    const struct picture *p = ctx;
    int w = p->cam->w;
    (void)worker;
    err_t e = run_check(p->r, "picture");
    for (int first = 0; first < w && !e; first += STRIP) {
        struct strip s = {.plane = p->plane, .w = w, .first = first};
        s.px = (size_t)w * (size_t)p->cam->h;
        s.at = (size_t)i * (size_t)w + (size_t)first;
        s.n = w - first < STRIP ? w - first : STRIP;
        smooth_strip(p, &s, i);
    }
    return e;
}

static err_t alloc_planes(struct arena *tmp, int w, int h, struct picture *p)
{
    return arena_alloc(tmp, (size_t)w * (size_t)h, PLANES * sizeof(float), &p->plane);
}

void render_plan(struct plan *p, int w, int h)
{
    struct picture picture;
    size_t mark = arena_mark(&p->tmp);
    (void)alloc_planes(&p->tmp, w, h, &picture); // a counter is never full
    arena_reset(&p->tmp, mark);
}

err_t render_run(const struct run *r, const struct render_world *s, const struct camera *cam,
                 const struct render_quality *q, uint64_t seed, const struct render_maps *out)
{
    struct picture p = {.r = r, .s = s, .cam = cam, .q = q, .out = out};
    float back[3] = {-cam->t[0], -cam->t[1], -cam->t[2]};
    err_t e = render_check(cam, q);
    if (e)
        return e;
    size_t mark = arena_mark(r->tmp);
    int rays = q->samples * q->samples * q->shadow;
    rotation_from_unit(cam->q, p.turn);
    vec_turn_back(p.turn, back, p.eye);
    const float f2 = q->lens ? (float)(q->lens->fx * q->lens->fy) : cam->fx * cam->fy;
    p.spread = 1 / (sqrtf(f2) * (float)q->samples);
    p.seed = light_hash((uint32_t)seed, (uint32_t)(seed >> 32));
    p.period = q->lens || rays >= 16 ? 1 : rays < 4 ? 4 : 2; // planes are smoothed if straight
    if (p.period > 1 && out->radiance)
        e = alloc_planes(r->tmp, cam->w, cam->h, &p);
    if (!e)
        e = pool_for(r->pool, cam->h, draw_row, &p);
    if (!e && p.plane)
        e = pool_for(r->pool, cam->h, smooth_row, &p);
    arena_reset(r->tmp, mark);
    return e;
}
