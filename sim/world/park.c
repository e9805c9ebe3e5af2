/* Rings around the subject in the middle: pieces of garden furniture, a free ring for cameras,
 * trees and the fronts of houses, distant houses and trees, hills. Random numbers are drawn one a
 * statement: C leaves the order within an expression open. */
#include "sim/world/park.h"

#include "core/base/num.h"
#include "sim/world/furniture.h"
#include "sim/world/garden.h"
#include "sim/world/plant.h"
#include "sim/world/room.h"
#include "sim/world/yard.h"

#include <math.h>

enum { TUFTS = 150, TREES = 8, HILLS = 11 };

static const float PI = (float)NUM_PI;
static const float FREE = 1.3f; // m, to both sides of the ring of the cameras

struct park {
    struct builder *b;
    struct frame root;
    float around, tall; // m, radius of the ring of the cameras; height of the subject
};

/* ---- subjects ---- */

/* Shapes upon each other on a stepped base. */
static void build_statue(struct park *k)
{
    struct builder *b = k->b;
    int base = builder_material(b, ROLE_STONE), body = builder_material(b, ROLE_STONE);
    int metal = builder_material(b, ROLE_METAL);
    float wide = builder_draw(b, 0.9f, 1.3f), z = 0.0f;
    for (int i = 0; i < 3; i++, z += 0.18f)
        builder_box(b, &k->root, (float[]){wide - 0.22f * (float)i, wide - 0.22f * (float)i, 0.09f},
                    (float[]){0, 0, z + 0.09f}, base);
    float foot = builder_draw(b, 0.35f, 0.6f);
    builder_box(b, &k->root, (float[]){0.4f, 0.4f, foot}, (float[]){0, 0, z + foot}, base);
    z += 2 * foot;
    int n = 5 + builder_pick(b, 4);
    for (int i = 0; i < n; i++) {
        float q = builder_draw(b, 0.14f, 0.32f), h = builder_draw(b, 0.12f, 0.26f);
        float x = builder_draw(b, -0.12f, 0.12f), y = builder_draw(b, -0.12f, 0.12f);
        float turn = builder_draw(b, 0, PI), lean = builder_draw(b, -0.3f, 0.3f);
        int shape = builder_pick(b, 4); // the tube of a ring must be thinner than the ring
        struct part p = {
            (enum world_shape)shape,     {q, 0.8f * q, h}, {x, y, z + h}, i % 3 ? body : metal,
            builder_draw(b, 0.3f, 1.0f), {lean, 0, turn},  CUT_RANDOM};
        if (shape == WORLD_TORUS) {
            p.size[1] = 0.3f * q;
            p.turn[0] = 0.5f * PI;
            h = q;
            p.at[2] = z + h;
        }
        builder_add(b, &k->root, &p);
        z += 1.7f * h;
    }
    k->tall = z;
}

static void build_pavilion(struct park *k)
{
    struct builder *b = k->b;
    int wood = builder_timber(b), roof = builder_material(b, ROLE_TIMBER);
    int stone = builder_material(b, ROLE_STONE);
    float wide = builder_draw(b, 1.1f, 1.6f), tall = builder_draw(b, 2.1f, 2.6f);
    builder_rod(b, &k->root, (float[]){wide + 0.2f, 0.08f}, (float[]){0, 0, 0.08f}, stone);
    for (int i = 0; i < 6; i++) {
        float c, s;
        builder_turn(PI / 3 * (float)i, &c, &s);
        builder_rod(b, &k->root, (float[]){0.07f, 0.5f * tall},
                    (float[]){wide * c, wide * s, 0.5f * tall}, wood);
    }
    float peak = builder_draw(b, 0.35f, 0.6f);
    builder_add(b, &k->root,
                &(struct part){WORLD_FRUSTUM,
                               {wide + 0.4f, wide + 0.4f, peak},
                               {0, 0, tall + peak},
                               roof,
                               0.1f,
                               {0, 0, 0},
                               CUT_RANDOM});
    struct frame f = builder_frame(&k->root, 0, 0, 0.16f, builder_draw(b, 0, 2 * PI));
    const struct piece *p = &garden_pieces[builder_pick(b, 3)];
    p->make(b, &f, (const float[]){0.7f, 0.3f}, 0.85f);
    k->tall = tall;
}

static void build_subject(struct park *k)
{
    struct builder *b = k->b;
    int kind = builder_pick(b, 3);
    if (kind == 0)
        build_statue(k);
    else if (kind == 1)
        build_pavilion(k);
    else {
        float wide = builder_draw(b, 1.2f, 1.7f);
        k->tall = builder_draw(b, 3.2f, 4.6f);
        plant_tree(b, &k->root, (const float[]){wide, wide}, k->tall);
    }
    (void)builder_claim(b, 0, 0, (const float[]){1.5f, 1.5f});
}

/* ---- what stands around ---- */

/* A place `away` from the middle, in a frame turned at random. False if it is taken. */
static bool claim_place(struct park *k, float away, const float half[2], struct frame *f)
{
    struct builder *b = k->b;
    float c, s, turn = builder_draw(b, 0, 2 * PI), way = builder_draw(b, 0, 2 * PI);
    const float r = sqrtf(half[0] * half[0] + half[1] * half[1]);
    builder_turn(way, &c, &s);
    *f = builder_frame(&k->root, away * c, away * s, 0.0f, turn);
    return builder_claim(b, away * c, away * s, (const float[]){r, r});
}

static void place_pieces(struct park *k)
{
    struct builder *b = k->b;
    int n = 4 + builder_pick(b, 4);
    for (int i = 0; i < n; i++) {
        const struct piece *p = &garden_pieces[builder_pick(b, GARDEN_PIECES - 1)];
        float half[2], height;
        furniture_size(b, p, half, &height);
        float away = builder_draw(b, 2.0f, k->around - FREE - 0.9f);
        struct frame f;
        if (claim_place(k, away, half, &f) && b->w->n_solids < 260)
            p->make(b, &f, half, height);
    }
}

static void place_trees(struct park *k)
{
    struct builder *b = k->b;
    for (int i = 0; i < TREES && b->w->n_solids < 620; i++) {
        float wide = builder_draw(b, 0.9f, 2.0f), tall = builder_draw(b, 1.8f, 2.8f) * wide;
        float away = k->around + FREE + 1.5f * wide + builder_draw(b, 0.0f, 7.0f);
        struct frame f;
        if (claim_place(k, away, (const float[]){0.7f * wide, 0.7f * wide}, &f))
            plant_tree(b, &f, (const float[]){wide, wide}, tall);
    }
}

/* The fronts of one or two houses. */
static void build_fronts(struct park *k)
{
    struct builder *b = k->b;
    int n = 1 + builder_pick(b, 2);
    float way = builder_draw(b, 0, 2 * PI);
    for (int i = 0; i < n; i++) {
        float c, s, away = k->around + builder_draw(b, 5.0f, 11.0f);
        float wide = builder_draw(b, 4.0f, 8.0f), skew = builder_draw(b, -0.3f, 0.3f);
        builder_turn(way, &c, &s);
        struct frame f = builder_frame(&k->root, away * c, away * s, 0, way + 0.5f * PI + skew);
        yard_front(b, &f, wide, false);
        (void)builder_claim(b, (away + 1.5f) * c, (away + 1.5f) * s, (const float[]){3, 3});
        way += builder_draw(b, 1.2f, 2.4f);
    }
}

/* Grass that stands out of the lawn. */
static void plant_tufts(struct park *k)
{
    struct builder *b = k->b;
    int leaf[3];
    for (int i = 0; i < 3; i++)
        leaf[i] = builder_material(b, ROLE_LEAF);
    for (int i = 0; i < TUFTS && b->w->n_solids < 780; i++) {
        float c, s, way = builder_draw(b, 0, 2 * PI), away = builder_draw(b, 1.5f, k->around + 4);
        float q = builder_draw(b, 0.02f, 0.08f), tall = builder_draw(b, 0.04f, 0.14f);
        builder_turn(way, &c, &s);
        builder_add(b, &k->root,
                    &(struct part){WORLD_ELLIPSOID,
                                   {q, 0.6f * q, tall},
                                   {away * c, away * s, 0.5f * tall},
                                   leaf[i % 3],
                                   0,
                                   {0.3f, 0, way},
                                   CUT_RANDOM});
    }
}

static void lay_paths(struct park *k)
{
    struct builder *b = k->b;
    int gravel = builder_material(b, ROLE_GROUND), n = 2 + builder_pick(b, 2);
    b->w->materials[gravel].albedo.kind = b->plain ? TEXTURE_FLAT : TEXTURE_SPOTS;
    b->w->materials[gravel].albedo.scale = 0.05f;
    builder_rod(b, &k->root, (float[]){2.2f, 0.005f}, (float[]){0, 0, 0.006f}, gravel);
    float way = builder_draw(b, 0, PI);
    for (int i = 0; i < n; i++, way += PI / (float)n) {
        float wide = builder_draw(b, 0.5f, 1.1f);
        builder_add(b, &k->root,
                    &(struct part){WORLD_BOX,
                                   {26.0f, wide, 0.004f},
                                   {0, 0, 0.004f},
                                   gravel,
                                   0,
                                   {0, 0, way},
                                   CUT_RANDOM});
    }
}

static void raise_hills(struct park *k)
{
    struct builder *b = k->b;
    int m[3];
    for (int i = 0; i < 3; i++) {
        m[i] = builder_material(b, i ? ROLE_LEAF : ROLE_GROUND);
        b->w->materials[m[i]].albedo.scale = 6.0f;
    }
    for (int i = 0; i < HILLS; i++) {
        float c, s, away = builder_draw(b, 150.0f, 260.0f), wide = builder_draw(b, 60.0f, 95.0f);
        float tall = builder_draw(b, 6.0f, 26.0f);
        builder_turn(2 * PI / (float)HILLS * (float)i, &c, &s);
        builder_add(b, &k->root,
                    &(struct part){WORLD_ELLIPSOID,
                                   {wide, 0.8f * wide, tall},
                                   {away * c, away * s, -1.0f},
                                   m[builder_pick(b, 3)],
                                   0,
                                   {0, 0, 0},
                                   CUT_RANDOM});
    }
}

/* ---- the whole ---- */

static void set_places(const struct park *k)
{
    struct world *w = k->b->w;
    const float far = k->around + FREE, z = 0.45f * fminf(k->tall, 3.2f);
    const float inside[2][3] = {{-far - 4, -far - 4, 0}, {far + 4, far + 4, 5.0f}};
    const float stand[2][3] = {{-far, -0.7f * k->around, 1.2f},
                               {1.0f - k->around, 0.7f * k->around, 2.0f}};
    const float focus[2][3] = {{0, 0, z}, {0, 0, z}};
    float unused[3];
    room_box(&k->root, inside, w->lo, w->hi);
    room_box(&k->root, stand, w->stand[0], w->stand[1]);
    room_box(&k->root, focus, w->focus, unused);
    w->around = k->around;
}

void park_build(struct builder *b)
{
    static const float COS[4] = {1, 0, -1, 0}, SIN[4] = {0, 1, 0, -1};
    int quarter = builder_pick(b, 4);
    struct park k = {.b = b, .root = {.c = COS[quarter], .s = SIN[quarter]}};
    k.around = builder_draw(b, 4.5f, 6.5f);
    lay_paths(&k);
    build_subject(&k);
    place_pieces(&k);
    build_fronts(&k);
    place_trees(&k);
    plant_tufts(&k);
    struct room_sky s = {.radiance = builder_draw(b, 0.15f, 0.5f)};
    s.sun = builder_chance(b, 0.75f) ? builder_draw(b, 1.5f, 6.0f) : 0.0f;
    s.azimuth = builder_draw(b, 0, 2 * PI);
    s.height = builder_draw(b, 0.3f, 1.2f);
    room_light(b, &k.root, &s);
    const struct room_view v = {0, 30.0f, 70.0f, 4 + builder_pick(b, 3)};
    room_outside(b, &k.root, &v);
    raise_hills(&k);
    set_places(&k);
}
