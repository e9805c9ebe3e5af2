#include "sim/world/plant.h"

#include "core/base/num.h"

static const float PI = (float)NUM_PI;

void plant_pot(struct builder *b, const struct frame *f, const float half[2], float height)
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

void plant_tree(struct builder *b, const struct frame *f, const float half[2], float height)
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
