/* Plants are ellipsoids around a stem, in turns of the golden angle. Random numbers are drawn one a
 * statement: C leaves the order within an expression open. */
#include "sim/world/garden.h"

#include "core/base/num.h"
#include "sim/world/clutter.h"
#include "sim/world/furniture.h"
#include "sim/world/plant.h"

static const float PI = (float)NUM_PI;

static void bench(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_timber(b), foot = builder_material(b, ROLE_STONE);
    int slats = 3 + builder_pick(b, 3);
    for (int i = 0; i < slats; i++) {
        float w = half[1] / (float)slats, y = (float)(2 * i + 1) * w - half[1];
        builder_box(b, f, (float[]){half[0], 0.85f * w, 0.018f}, (float[]){0, y, 0.44f}, m);
        float z = 0.52f + (height - 0.52f) * (float)i / (float)slats;
        builder_add(b, f,
                    &(struct part){WORLD_BOX,
                                   {half[0], 0.012f, 0.05f},
                                   {0, 0.02f - half[1] - 0.15f * (z - 0.5f), z},
                                   m,
                                   0,
                                   {0.15f, 0, 0},
                                   CUT_RANDOM});
    }
    for (int i = -1; i <= 1; i += 2)
        builder_box(b, f, (float[]){0.05f, 0.8f * half[1], 0.21f},
                    (float[]){(float)i * 0.7f * half[0], 0, 0.21f}, foot);
}

static void rocks(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int n = 4 + builder_pick(b, 8);
    for (int i = 0; i < n; i++) {
        int m = builder_material(b, ROLE_STONE);
        float x = builder_draw(b, -0.7f, 0.7f) * half[0],
              y = builder_draw(b, -0.7f, 0.7f) * half[1];
        float q = builder_draw(b, 0.15f, 0.45f) * builder_least(half[0], half[1]);
        float z = builder_draw(b, 0.2f, 0.6f) * height, turn = builder_draw(b, 0.0f, PI);
        builder_add(b, f,
                    &(struct part){WORLD_ELLIPSOID,
                                   {q, 0.75f * q, z},
                                   {x, y, 0.6f * z},
                                   m,
                                   0,
                                   {0.2f, 0, turn},
                                   CUT_RANDOM});
    }
}

static void planter(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_material(b, builder_chance(b, 0.5f) ? ROLE_STONE : ROLE_TIMBER);
    float tall = 0.4f * height;
    builder_box(b, f, (float[]){half[0], half[1], 0.5f * tall}, (float[]){0, 0, 0.5f * tall}, m);
    builder_box(b, f, (float[]){half[0] - 0.04f, half[1] - 0.04f, 0.01f},
                (float[]){0, 0, tall + 0.01f}, builder_material(b, ROLE_BARK));
    int n = 2 + (int)(half[0] / 0.12f);
    for (int i = 0; i < n; i++) {
        float x = half[0] * ((float)(2 * i + 1) / (float)n - 1.0f);
        float q = builder_draw(b, 0.5f, 1.0f) * half[1], up = builder_draw(b, 0.5f, 1.0f);
        int leaf = builder_material(b, builder_chance(b, 0.3f) ? ROLE_CLOTH : ROLE_LEAF);
        for (int k = 0; k < 4; k++) {
            float dx = builder_draw(b, -0.1f, 0.1f), dz = builder_draw(b, 0.1f, 0.6f) * up * height;
            builder_add(b, f,
                        &(struct part){WORLD_ELLIPSOID,
                                       {0.6f * q, 0.6f * q, 0.4f * q},
                                       {x + dx, 0.7f * dx, tall + dz},
                                       leaf,
                                       0,
                                       {0.4f, 0, dx * 20},
                                       CUT_RANDOM});
        }
    }
}

static void crates(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_timber(b), n = 1 + builder_pick(b, 3);
    float tall = height / (float)n, turn = 0.0f;
    for (int i = 0; i < n; i++) {
        struct frame at = builder_frame(f, 0, 0, tall * (float)i, turn);
        float x = 0.7f * half[0], y = 0.7f * half[1], z = 0.5f * tall;
        builder_box(b, &at, (float[]){0.96f * x, 0.96f * y, z}, (float[]){0, 0, z},
                    builder_timber(b));
        for (int k = -1; k <= 1; k += 2) {
            builder_box(b, &at, (float[]){x, y, 0.03f}, (float[]){0, 0, z + (float)k * (z - 0.03f)},
                        m);
            builder_box(b, &at, (float[]){0.04f, 1.01f * y, z},
                        (float[]){(float)k * (x - 0.04f), 0, z}, m);
        }
        turn = builder_draw(b, -0.4f, 0.4f);
    }
    struct frame on = builder_frame(f, 0, 0, height, 0);
    clutter_put(b, &on, (const float[]){0.5f * half[0], 0.5f * half[1]});
}

static void barrels(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_timber(b), hoop = builder_material(b, ROLE_METAL);
    float r = 0.9f * builder_least(half[0], half[1]), tall = 0.25f * height;
    for (int i = 0; i < 2; i++)
        builder_add(b, f,
                    &(struct part){WORLD_FRUSTUM,
                                   {r, r, tall},
                                   {0, 0, (float)(2 * i + 1) * tall},
                                   m,
                                   0.8f,
                                   {i ? 0 : PI, 0, 0},
                                   CUT_JOINED});
    for (int i = 1; i < 4; i++)
        builder_add(b, f,
                    &(struct part){WORLD_TORUS,
                                   {(i == 2 ? 0.99f : 0.89f) * r, 0.02f, 0},
                                   {0, 0, (float)i * tall},
                                   .material = hoop});
    struct frame on = builder_frame(f, 0, 0, height, 0);
    clutter_put(b, &on, (const float[]){0.5f * r, 0.5f * r});
}

const struct piece garden_pieces[GARDEN_PIECES] = {
    {bench, {0.6f, 0.22f, 0.8f}, {1.0f, 0.28f, 0.95f}},
    {rocks, {0.4f, 0.4f, 0.3f}, {0.9f, 0.9f, 0.9f}},
    {planter, {0.4f, 0.2f, 0.6f}, {1.0f, 0.35f, 1.2f}},
    {crates, {0.35f, 0.35f, 0.5f}, {0.6f, 0.6f, 1.4f}},
    {furniture_set, {0.8f, 0.75f, 0.68f}, {1.2f, 0.95f, 0.78f}},
    {barrels, {0.25f, 0.25f, 0.7f}, {0.35f, 0.35f, 1.0f}},
    {plant_tree, {0.5f, 0.5f, 1.6f}, {1.1f, 1.1f, 3.2f}},
};
