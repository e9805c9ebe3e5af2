/* Plants are ellipsoids around a stem, in turns of the golden angle. Random numbers are drawn one a
 * statement: C leaves the order within an expression open. */
#include "sim/world/garden.h"

#include "core/base/num.h"
#include "sim/world/clutter.h"

static const float PI = (float)NUM_PI;

void garden_plant(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int pot = builder_material(b, ROLE_CERAMIC), leaf = builder_material(b, ROLE_LEAF);
    float r = builder_least(half[0], half[1]), foot = 0.28f * height;
    builder_add(b, f,
                &(struct part){WORLD_FRUSTUM,
                               {0.5f * r, 0.5f * r, 0.5f * foot},
                               {0, 0, 0.5f * foot},
                               pot,
                               0.75f,
                               {PI, 0, 0},
                               CUT_JOINED});
    builder_add(
        b, f, &(struct part){WORLD_TORUS, {0.5f * r, 0.05f * r, 0}, {0, 0, foot}, .material = pot});
    int n = 9 + builder_pick(b, 12);
    float slim = builder_draw(b, 0.15f, 0.5f);
    for (int i = 0; i < n; i++) {
        float c, s, angle = 2.4f * (float)i + builder_draw(b, -0.4f, 0.4f);
        float up = builder_draw(b, 0.35f, 0.92f), lean = builder_draw(b, 0.3f, 1.1f);
        builder_turn(angle, &c, &s);
        float length = 0.5f * r * builder_draw(b, 0.6f, 1.0f), out = 0.5f * r;
        builder_add(b, f,
                    &(struct part){WORLD_ELLIPSOID,
                                   {0.1f * length, slim * length, length},
                                   {out * c, out * s, height * up},
                                   leaf,
                                   0,
                                   {0, lean, angle},
                                   CUT_RANDOM});
    }
    builder_rod(b, f, (float[]){0.05f * r, 0.3f * height}, (float[]){0, 0, foot + 0.28f * height},
                builder_material(b, ROLE_BARK));
}

void garden_tree(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int bark = builder_material(b, ROLE_BARK);
    int leaf[2] = {builder_material(b, ROLE_LEAF), 0};
    leaf[1] = builder_material(b, ROLE_LEAF);
    float r = builder_least(half[0], half[1]), trunk = 0.09f * r + 0.03f;
    float crown = builder_draw(b, 0.35f, 0.5f) * height;
    if (builder_chance(b, 0.25f)) { // a fir
        builder_rod(b, f, (float[]){trunk, 0.3f * height}, (float[]){0, 0, 0.3f * height}, bark);
        for (int i = 0; i < 5; i++) {
            float wide = r * (1.0f - 0.17f * (float)i), tall = 0.13f * height;
            float z = height * (0.27f + 0.15f * (float)i);
            builder_add(b, f,
                        &(struct part){WORLD_FRUSTUM,
                                       {wide, wide, tall},
                                       {0, 0, z},
                                       leaf[i & 1],
                                       0.15f,
                                       {0, 0, 0},
                                       CUT_RANDOM});
        }
        return;
    }
    builder_add(b, f,
                &(struct part){WORLD_FRUSTUM,
                               {trunk, trunk, 0.35f * height},
                               {0, 0, 0.35f * height},
                               bark,
                               0.5f,
                               {0, 0, 0},
                               CUT_JOINED});
    int n = 14 + builder_pick(b, 14);
    for (int i = 0; i < n; i++) {
        float c, s, angle = 2.4f * (float)i;
        builder_turn(angle, &c, &s);
        float out = r * builder_draw(b, 0.1f, 0.75f),
              z = crown + (height - crown) * builder_draw(b, 0.1f, 0.9f);
        float q = r * builder_draw(b, 0.18f, 0.36f), flat = builder_draw(b, 0.5f, 0.9f);
        builder_add(b, f,
                    &(struct part){WORLD_ELLIPSOID,
                                   {q, 0.9f * q, flat * q},
                                   {out * c, out * s, z},
                                   leaf[builder_pick(b, 2)],
                                   0,
                                   {0.3f, 0, angle},
                                   CUT_RANDOM});
        float lean = 0.9f, length = 0.7f * out;
        if (i % 3 == 0) // a branch towards it
            builder_add(b, f,
                        &(struct part){WORLD_FRUSTUM,
                                       {0.3f * trunk, 0.3f * trunk, length},
                                       {0.5f * out * c, 0.5f * out * s, z - 0.35f * out},
                                       bark,
                                       0.5f,
                                       {0, lean, angle},
                                       CUT_RANDOM});
    }
}

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
    {garden_tree, {0.5f, 0.5f, 1.6f}, {1.1f, 1.1f, 3.2f}},
};
