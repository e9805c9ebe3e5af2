/* light.h - light that arrives at a point straight from lamps, openings, sky and sun: one random
 * point on each of a few of them, chosen by their unshadowed light, and a ray to it.
 * Pure computation; any thread. */
#ifndef WORLD_LIGHT_H
#define WORLD_LIGHT_H

#include "sim/world/bvh.h"

struct light {
    int solid;                   // as in struct world_light
    const struct world_light *w; // the opening
    float radiance[3];           // for an opening: an estimate, for the choice of lights
    float centre[3], radius;     // m, of a ball around it
    float power;                 // luminance x mean visible area
};

struct light_set {
    const struct bvh *bvh;
    int n;
    struct light l[WORLD_LIGHTS];
    bool dome, sun; // light comes from the whole sky; there is a sun
    float across[2][3];
    bool *listed; // (solids) is in l
};

/* Collect the lights of bvh->w.
 * out:  lives in `keep`
 * err:  ERR_NOMEM (see light_plan) */
MUST_USE err_t light_open(struct arena *keep, const struct bvh *bvh, struct light_set *out);
void light_plan(struct plan *p);

/* Random numbers of one sample in a pattern of 2^bits samples that cover the unit square. */
struct light_dice {
    uint32_t index; // index of the sample
    uint32_t seed;  // seed of the pattern
    uint32_t noise; // random number per sample, for detail finer than the pattern
    int bits;
};

/* The point in the unit square for dimension `dim`, 0..63. */
void light_throw(const struct light_dice *d, uint32_t dim, float u[2]);

/* A point that receives light. */
struct light_spot {
    float p[3], n[3];                // m, above the surface by light_lift; unit
    float mirror[3];                 // unit, where the eye's ray is reflected to
    float lobe;                      // exponent of the cosine around it
    float shine[3];                  // share in the gloss of lamps, of the sun, of the sky; 0: none
    uint32_t last[WORLD_LIGHTS + 2]; // 1 + solid that was last in the way, by light: a guess
};

/* The light that arrives. */
struct light_sum {
    float soft[3], sun[3]; // irradiance from lamps, openings and sky; from the sun
    float gloss[3];        // radiance that the gloss sends to the eye
};

void light_gather(const struct light_set *s, struct light_spot *spot, const struct light_dice *d,
                  struct light_sum *out);

/* Radiance of the sky in the unit direction d, with the disc of the sun or without. */
void light_sky(const struct world *w, const float d[3], bool disc, float out[3]);

/* The height above a surface, m, at which rays start if the surface was hit t metres away. */
float light_lift(float t);

/* A hash of two numbers. */
uint32_t light_hash(uint32_t a, uint32_t b);

/* The surface of a solid at the point p of the world, m, hit by a ray `width` m wide in the
 * direction d. */
struct light_surface {
    int solid;
    const struct world_material *material;
    float albedo[3], n[3]; // n: unit, on the side that the ray comes from
    float facing;          // cosine between -d and n
};
void light_surface(const struct bvh *b, int solid, const float p[3], const float d[3], float width,
                   struct light_surface *out);

#endif
