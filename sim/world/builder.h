/* builder.h - builds a world: random numbers, materials by their use, solids in nested frames, and
 * the areas of the floor that are occupied.
 * Pure computation; any thread. No sine of libm: the same world on every machine. */
#ifndef WORLD_BUILDER_H
#define WORLD_BUILDER_H

#include "sim/world/solids.h"

/* The use of a material determines kinds and sizes of texture, colours and gloss. */
enum builder_role {
    ROLE_WALL,
    ROLE_FLOOR,
    ROLE_CEILING,
    ROLE_TIMBER,
    ROLE_PAINTED,
    ROLE_CLOTH,
    ROLE_RUG,
    ROLE_BOOK,
    ROLE_POSTER,
    ROLE_CERAMIC,
    ROLE_METAL,
    ROLE_CARTON,
    ROLE_LEAF,
    ROLE_BARK,
    ROLE_GROUND,
    ROLE_STONE,
    ROLE_COUNT
};

struct frame { // x_parent = turn by (c, s) about z, then + at
    float at[3], c, s;
};

/* A rectangle of the floor. */
struct area {
    float lo[2], hi[2]; // m
};

enum { BUILDER_AREAS = 192, BUILDER_BOOKS = 10 };

struct builder {
    struct world *w;
    uint64_t state; // state of the random numbers
    bool plain, mirrors;
    int n_areas;
    struct area areas[BUILDER_AREAS]; // occupied floor, in the frame of the place
    int books[BUILDER_BOOKS], timber; // shared materials
};

/* A solid as furniture describes it. */
struct part {
    enum world_shape shape;
    float size[3]; // as in struct world_solid
    float at[3];   // m, its middle in the frame
    int material;
    float taper;   // for a frustum; 1: a cylinder
    float turn[3]; // rad, about x, then y, then z
    int cut;       // enum builder_cut
};

/* The piece of the texture that a part shows: a random one, the one of its place in the frame, or
 * one that begins at its lower corner. */
enum builder_cut { CUT_RANDOM, CUT_JOINED, CUT_CORNER };

/* A piece stands on z = 0 of its frame, its middle at the origin, its front towards y, within
 * half[0] x half[1] and about `height`. */
struct piece {
    void (*make)(struct builder *b, const struct frame *f, const float half[2], float height);
    float lo[3], hi[3]; // m, range of half width, half depth, height
};

float builder_draw(struct builder *b, float lo, float hi);
int builder_pick(struct builder *b, int n); // 0 .. n-1
bool builder_chance(struct builder *b, float share);
float builder_power(float octaves); // 2^octaves, -60..60
void builder_turn(float angle, float *c, float *s);

/* A frame within a frame, turned by `angle`, rad. */
struct frame builder_frame(const struct frame *in, float x, float y, float z, float angle);

/* Index of a new material, which the caller may change. Without room it is an existing one, but not
 * a lamp's. */
int builder_material(struct builder *b, enum builder_role role);

/* A material for furniture: often the shared one of the place, else a new one. */
int builder_timber(struct builder *b);

/* Index of a new material that emits `radiance`. cold: 0 amber, 0.5 white, 1 blue. */
int builder_glow(struct builder *b, float radiance, float cold);

/* Add a solid. Returns its index, -1 without room. */
int builder_add(struct builder *b, const struct frame *f, const struct part *p);

/* Add a box of half edges size; an upright cylinder of radius size[0] and half height size[1]. */
int builder_box(struct builder *b, const struct frame *f, const float size[3], const float at[3],
                int material);
int builder_rod(struct builder *b, const struct frame *f, const float size[2], const float at[3],
                int material);

static inline float builder_least(float a, float b)
{
    return a < b ? a : b;
}

/* List a solid that emits as a lamp, to gather light from directly, if there is room. */
void builder_lamp(struct builder *b, int solid);

/* Occupy the floor within half[] of (x, y), unless part of it is occupied. */
bool builder_claim(struct builder *b, float x, float y, const float half[2]);

#endif
