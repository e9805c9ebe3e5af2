/* A thing is a few shapes at most r wide whose proportions are drawn. Random numbers are drawn one
 * a statement: C leaves the order within an expression open. Things stand in a loose grid, so that
 * they do not meet. */
#include "sim/world/clutter.h"

#include "core/base/num.h"
#include "sim/world/plant.h"

#include <math.h>

static const float PI = (float)NUM_PI;

/* Slices of a turned body: radius goes through random values from foot to rim. */
static void vase(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_CERAMIC), slices = 2 + builder_pick(b, 4);
    float tall = builder_draw(b, 1.5f, 3.5f);
    tall *= r / (float)slices;
    float radius = builder_draw(b, 0.4f, 0.8f), z = 0.0f;
    for (int i = 0; i < slices; i++) {
        float next = builder_draw(b, 0.25f, 1.0f), wide = fmaxf(radius, next);
        struct part p = {WORLD_FRUSTUM,
                         {wide * r, wide * r, 0.5f * tall},
                         {0, 0, z + 0.5f * tall},
                         m,
                         builder_least(radius, next) / wide,
                         {0, 0, 0},
                         CUT_JOINED};
        if (next > radius)
            p.turn[0] = PI; // the wide end up
        builder_add(b, f, &p);
        z += tall;
        radius = next;
    }
    float tube = 0.12f * r;
    if (builder_chance(b, 0.6f))
        builder_add(b, f,
                    &(struct part){WORLD_TORUS, {radius * r, tube, 0}, {0, 0, z}, .material = m});
}

/* A frustum with its wide end up. size: radius of that end, half the height, foot's share of it. */
static void add_vessel(struct builder *b, const struct frame *f, int material, const float size[3])
{
    builder_add(b, f,
                &(struct part){WORLD_FRUSTUM,
                               {size[0], size[0], size[1]},
                               {0, 0, size[1]},
                               material,
                               size[2],
                               {PI, 0, 0},
                               CUT_JOINED});
}

static void bowl(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_CERAMIC);
    float tall = builder_draw(b, 0.2f, 0.5f) * r, foot = builder_draw(b, 0.35f, 0.7f);
    add_vessel(b, f, m, (float[]){0.92f * r, tall, foot});
    builder_add(
        b, f,
        &(struct part){WORLD_TORUS, {0.9f * r, 0.07f * r, 0}, {0, 0, 2 * tall}, .material = m});
    int fruit = builder_material(b, ROLE_CERAMIC), n = 3 + builder_pick(b, 4);
    for (int i = 0; i < n; i++) {
        float c, s, q = builder_draw(b, 0.2f, 0.3f) * r;
        builder_turn(6.2831853f * (float)i / (float)n, &c, &s);
        builder_add(b, f,
                    &(struct part){WORLD_ELLIPSOID,
                                   {q, q, 0.9f * q},
                                   {0.5f * r * c, 0.5f * r * s, 2 * tall + 0.5f * q},
                                   .material = fruit});
    }
}

static void cup(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_CERAMIC);
    float tall = builder_draw(b, 0.45f, 0.8f) * r, taper = builder_draw(b, 0.6f, 1.0f);
    add_vessel(b, f, m, (float[]){0.55f * r, tall, taper});
    builder_add(b, f,
                &(struct part){WORLD_TORUS,
                               {0.28f * r, 0.07f * r, 0},
                               {0.58f * r, 0, tall},
                               m,
                               0,
                               {0.5f * PI, 0, 0},
                               CUT_RANDOM});
    float top = 0.45f * r;
    builder_rod(b, f, (float[]){top, 0.002f}, (float[]){0, 0, 2 * tall},
                builder_material(b, ROLE_BARK));
}

static void bottle(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_CERAMIC), label = b->books[builder_pick(b, BUILDER_BOOKS)];
    float q = 0.4f * r, tall = builder_draw(b, 1.2f, 2.2f) * q;
    builder_rod(b, f, (float[]){q, tall}, (float[]){0, 0, tall}, m);
    builder_rod(b, f, (float[]){1.01f * q, 0.4f * tall}, (float[]){0, 0, tall}, label);
    builder_add(b, f,
                &(struct part){WORLD_FRUSTUM,
                               {q, q, 0.5f * q},
                               {0, 0, 2 * tall + 0.5f * q},
                               m,
                               0.35f,
                               {0, 0, 0},
                               CUT_JOINED});
    builder_rod(b, f, (float[]){0.35f * q, 0.6f * q}, (float[]){0, 0, 2 * tall + 1.6f * q}, m);
}

static void books_flat(struct builder *b, const struct frame *f, float r)
{
    int n = 2 + builder_pick(b, 4);
    float z = 0.0f;
    for (int i = 0; i < n; i++) {
        float thick = builder_draw(b, 0.01f, 0.025f), x = builder_draw(b, 0.55f, 0.85f) * r;
        float angle = builder_draw(b, -0.3f, 0.3f);
        struct part p = {WORLD_BOX,
                         {x, 0.68f * x, thick},
                         {0, 0, z + thick},
                         b->books[builder_pick(b, BUILDER_BOOKS)],
                         0,
                         {0, 0, angle},
                         CUT_RANDOM};
        builder_add(b, f, &p);
        z += 2 * thick;
    }
}

static void ball(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, builder_chance(b, 0.2f) ? ROLE_METAL : ROLE_CERAMIC);
    float x = builder_draw(b, 0.5f, 0.9f) * r, z = builder_draw(b, 0.6f, 1.2f) * x;
    builder_add(b, f, &(struct part){WORLD_ELLIPSOID, {x, x, z}, {0, 0, z}, .material = m});
}

static void ring(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_CERAMIC);
    float tube = builder_draw(b, 0.15f, 0.3f) * r, radius = 0.9f * r - tube;
    float angle = builder_draw(b, 0.0f, PI);
    bool upright = builder_chance(b, 0.5f);
    builder_add(b, f,
                &(struct part){WORLD_TORUS,
                               {radius, tube, 0},
                               {0, 0, upright ? radius + tube : tube},
                               m,
                               0,
                               {upright ? 0.5f * PI : 0, 0, angle},
                               CUT_RANDOM});
}

static void cone(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_PAINTED);
    float tall = builder_draw(b, 0.5f, 1.3f) * r, taper = builder_draw(b, 0.0f, 0.5f);
    builder_add(b, f,
                &(struct part){WORLD_FRUSTUM,
                               {0.7f * r, 0.7f * r, tall},
                               {0, 0, tall},
                               m,
                               taper,
                               {0, 0, 0},
                               CUT_RANDOM});
}

static void parcel(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_CARTON);
    float x = builder_draw(b, 0.4f, 0.7f) * r, y = builder_draw(b, 0.4f, 0.7f) * r;
    float z = builder_draw(b, 0.2f, 0.9f) * r;
    builder_box(b, f, (float[]){x, y, z}, (float[]){0, 0, z}, m);
    if (builder_chance(b, 0.5f))
        builder_box(b, f, (float[]){0.15f * r, 1.01f * y, 1.01f * z}, (float[]){0, 0, z},
                    builder_material(b, ROLE_CLOTH));
}

static void photo(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_POSTER);
    float x = 0.7f * r, z = builder_draw(b, 0.6f, 1.0f) * r;
    b->w->materials[m].albedo.scale = 2.0f * z;
    builder_add(b, f,
                &(struct part){
                    WORLD_BOX, {x, 0.006f, z}, {0, 0.007f, z}, m, 0, {-0.15f, 0, 0}, CUT_CORNER});
    builder_add(b, f,
                &(struct part){WORLD_BOX,
                               {1.1f * x, 0.006f, 1.1f * z},
                               {0, -0.006f, z},
                               b->timber,
                               0,
                               {-0.15f, 0, 0},
                               CUT_RANDOM});
}

static void pot_plant(struct builder *b, const struct frame *f, float r)
{
    float tall = builder_draw(b, 2.0f, 3.5f);
    plant_pot(b, f, (const float[]){r, r}, tall * r);
}

static void laptop(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_METAL), screen = builder_material(b, ROLE_POSTER);
    float x = 0.8f * r, y = 0.55f * r;
    b->w->materials[screen].albedo.scale = 2.0f * x;
    builder_box(b, f, (float[]){x, y, 0.008f}, (float[]){0, 0, 0.008f}, m);
    builder_box(b, f, (float[]){0.85f * x, 0.5f * y, 0.002f}, (float[]){0, 0, 0.017f},
                b->books[builder_pick(b, BUILDER_BOOKS)]);
    builder_add(
        b, f,
        &(struct part){WORLD_BOX, {x, 0.006f, y}, {0, -y, y}, m, 0, {0.25f, 0, 0}, CUT_RANDOM});
    builder_add(b, f,
                &(struct part){WORLD_BOX,
                               {0.92f * x, 0.004f, 0.88f * y},
                               {0, 0.008f - y, y},
                               screen,
                               0,
                               {0.25f, 0, 0},
                               CUT_CORNER});
}

static void desk_lamp(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_METAL);
    float tall = builder_draw(b, 0.14f, 0.22f);
    builder_rod(b, f, (float[]){0.6f * r, 0.012f}, (float[]){0, 0, 0.012f}, m);
    builder_rod(b, f, (float[]){0.01f, tall}, (float[]){0, 0, tall}, m);
    builder_add(b, f,
                &(struct part){WORLD_FRUSTUM,
                               {0.7f * r, 0.7f * r, 0.06f},
                               {0, 0, 2 * tall + 0.06f},
                               builder_material(b, ROLE_PAINTED),
                               0.4f,
                               {0, 0, 0},
                               CUT_RANDOM});
    if (b->w->kind == WORLD_DARK || b->w->n_lights > 5 || builder_chance(b, 0.5f))
        return;
    float light = builder_draw(b, 0.05f, 0.4f) * 4000.0f;
    int bulb = builder_glow(b, light, 0.3f);
    builder_lamp(b, builder_add(b, f,
                                &(struct part){WORLD_ELLIPSOID,
                                               {0.025f, 0.025f, 0.025f},
                                               {0, 0, 2 * tall - 0.03f},
                                               .material = bulb}));
}

static void (*const THING[])(struct builder *, const struct frame *, float) = {
    vase, vase, bowl,   cup,   bottle,    books_flat, books_flat, ball,
    ring, cone, parcel, photo, pot_plant, laptop,     desk_lamp,  ball};

void clutter_one(struct builder *b, const struct frame *f, float r)
{
    THING[builder_pick(b, (int)(sizeof THING / sizeof *THING))](b, f, r);
}

void clutter_put(struct builder *b, const struct frame *f, const float half[2])
{
    float cell = builder_draw(b, 0.11f, 0.19f);
    int nx = (int)(half[0] / cell), ny = (int)(half[1] / cell);
    nx = nx < 1 ? 1 : (nx > 8 ? 8 : nx);
    ny = ny < 1 ? 1 : (ny > 4 ? 4 : ny);
    float wx = half[0] / (float)nx, wy = half[1] / (float)ny, most = builder_least(wx, wy);
    for (int i = 0; i < nx * ny; i++) {
        if (!builder_chance(b, 0.62f))
            continue;
        float r = builder_draw(b, 0.5f, 0.9f) * builder_least(most, 0.17f), free = most - r;
        float x = (float)(2 * (i % nx) + 1) * wx - half[0] + builder_draw(b, -free, free);
        float y = (float)(2 * (i / nx) + 1) * wy - half[1] + builder_draw(b, -free, free);
        struct frame at = builder_frame(f, x, y, 0.0f, builder_draw(b, -0.7f, 0.7f));
        clutter_one(b, &at, r);
    }
}
