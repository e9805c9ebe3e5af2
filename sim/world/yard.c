/* Planned like a room: cameras stand at small x and look towards large x, where a house closes the
 * view; fences or hedges on the sides. The subject is a piece of garden furniture on a paved
 * square, with more of them and trees around. White in the sun has radiance 1. */
#include "sim/world/yard.h"

#include "core/base/num.h"
#include "sim/world/furniture.h"
#include "sim/world/garden.h"
#include "sim/world/room.h"

#include <math.h>

static const float PI = (float)NUM_PI;

struct yard {
    struct builder *b;
    struct frame root;
    float half[2];
    float stand[2][3], focus[3];
    bool night;
};

void yard_front(struct builder *b, const struct frame *f, float wide, bool night)
{
    int wall = builder_material(b, ROLE_WALL), base = builder_material(b, ROLE_STONE);
    int wood = builder_timber(b), glass = builder_material(b, ROLE_METAL);
    b->w->materials[wall].albedo.kind = b->plain ? TEXTURE_FLAT : TEXTURE_BRICK;
    int lit = builder_glow(b, night ? 2.0f : 0.2f, 0.2f);
    float tall = builder_draw(b, 1.5f, 3.0f);
    builder_box(b, f, (float[]){wide, 1.5f, tall}, (float[]){0, -1.5f, tall}, wall);
    builder_box(b, f, (float[]){wide + 0.02f, 1.53f, 0.2f}, (float[]){0, -1.5f, 0.2f}, base);
    builder_add(b, f,
                &(struct part){WORLD_BOX,
                               {wide + 0.3f, 1.3f, 0.06f},
                               {0, -0.7f, 2 * tall + 0.4f},
                               builder_material(b, ROLE_FLOOR),
                               0,
                               {-0.45f, 0, 0},
                               CUT_RANDOM});
    int nx = 2 + (int)(wide / 1.3f), nz = tall > 2.3f ? 2 : 1, door = builder_pick(b, nx);
    for (int i = 0; i < nx * nz; i++) {
        float x = wide * ((float)(2 * (i % nx) + 1) / (float)nx - 1.0f);
        float hx = 0.4f, hz = 0.6f, z = 1.6f + 2.6f * (float)(i / nx);
        if (i == door)
            z = hz = 1.0f;
        bool light = builder_chance(b, night ? 0.5f : 0.0f);
        int pane = builder_box(b, f, (float[]){hx, 0.01f, hz}, (float[]){x, 0.005f, z},
                               i == door ? wood : (light ? lit : glass));
        if (light && i != door)
            builder_lamp(b, pane);
        for (int k = -1; k <= 1; k++)
            builder_box(b, f, (float[]){0.03f, 0.03f, hz}, (float[]){x + (float)k * hx, 0.02f, z},
                        wood);
        for (int k = -1; k <= 1; k++)
            builder_box(b, f, (float[]){hx + 0.03f, 0.035f, 0.03f},
                        (float[]){x, 0.02f, z + (float)k * hz}, wood);
        if (i != door)
            builder_box(b, f, (float[]){hx + 0.1f, 0.1f, 0.03f},
                        (float[]){x, 0.06f, z - hz - 0.05f}, base);
    }
}

/* Boards along one side of the yard. */
static void build_fence(struct yard *y, float side)
{
    struct builder *b = y->b;
    struct frame f = builder_frame(&y->root, 0, side * y->half[1], 0, side > 0 ? PI : 0);
    int m[3];
    for (int i = 0; i < 3; i++)
        m[i] = builder_timber(b);
    float tall = builder_draw(b, 0.5f, 0.95f), wide = builder_draw(b, 0.05f, 0.12f);
    int kind = builder_pick(b, 3);
    if (kind == 0) { // a wall
        builder_box(b, &f, (float[]){y->half[0], 0.12f, tall}, (float[]){0, -0.12f, tall},
                    builder_material(b, ROLE_WALL));
        builder_box(b, &f, (float[]){y->half[0], 0.16f, 0.04f},
                    (float[]){0, -0.12f, 2 * tall + 0.04f}, builder_material(b, ROLE_STONE));
        return;
    }
    if (kind == 1) { // a hedge
        int leaf = builder_material(b, ROLE_LEAF), n = (int)(y->half[0] / 0.35f);
        for (int i = 0; i < n; i++) {
            float x = y->half[0] * ((float)(2 * i + 1) / (float)n - 1.0f);
            float q = builder_draw(b, 0.35f, 0.5f), z = builder_draw(b, 0.8f, 1.1f) * tall;
            builder_add(b, &f,
                        &(struct part){WORLD_ELLIPSOID,
                                       {1.2f * q, q, z},
                                       {x, -0.5f, z},
                                       leaf,
                                       0,
                                       {0, 0, q},
                                       CUT_RANDOM});
        }
        return;
    }
    int n = (int)(y->half[0] / (1.25f * wide));
    n = n < 60 ? n : 60;
    float step = y->half[0] / (float)n;
    for (int i = 0; i < n; i++) {
        float z = tall * builder_draw(b, 0.95f, 1.0f);
        builder_box(b, &f, (float[]){0.8f * step, 0.012f, z},
                    (float[]){step * (float)(2 * i + 1) - y->half[0], 0, z}, m[builder_pick(b, 3)]);
    }
    for (int i = 0; i < 2; i++)
        builder_box(b, &f, (float[]){y->half[0], 0.02f, 0.04f},
                    (float[]){0, -0.03f, tall * (i ? 1.6f : 0.5f)}, m[0]);
}

static void lay_paving(struct yard *y)
{
    struct builder *b = y->b;
    int m = builder_material(b, ROLE_STONE), n = 3 + builder_pick(b, 5);
    builder_box(b, &y->root, (float[]){1.6f, 1.6f, 0.01f},
                (float[]){y->focus[0], y->focus[1], 0.008f}, builder_material(b, ROLE_FLOOR));
    for (int i = 0; i < n; i++) {
        float x = y->stand[0][0] + 0.8f * (float)i, turn = builder_draw(b, -0.2f, 0.2f);
        float skew = builder_draw(b, -0.15f, 0.15f);
        if (x > y->focus[0] - 2.0f)
            break;
        builder_add(b, &y->root,
                    &(struct part){WORLD_BOX,
                                   {0.33f, 0.28f, 0.015f},
                                   {x, skew, 0.01f},
                                   m,
                                   0,
                                   {0, 0, turn},
                                   CUT_RANDOM});
    }
}

static bool put_piece(struct yard *y, const struct piece *p, const float at[3])
{
    struct builder *b = y->b;
    float half[2], height, c, s;
    furniture_size(b, p, half, &height);
    builder_turn(at[2], &c, &s);
    const float wide[2] = {fabsf(c) * half[0] + fabsf(s) * half[1],
                           fabsf(s) * half[0] + fabsf(c) * half[1]};
    if (fabsf(at[0]) + wide[0] > y->half[0] - 0.1f || fabsf(at[1]) + wide[1] > y->half[1] ||
        !builder_claim(b, at[0], at[1], wide))
        return false;
    struct frame f = builder_frame(&y->root, at[0], at[1], 0.015f, at[2]);
    p->make(b, &f, half, height);
    return true;
}

static void place_pieces(struct yard *y)
{
    struct builder *b = y->b;
    bool done = false;
    for (int i = 0; i < 8 && !done; i++) {
        float turn = 0.5f * PI + builder_draw(b, -0.7f, 0.7f);
        done = put_piece(y, &garden_pieces[builder_pick(b, GARDEN_PIECES - 1)],
                         (float[]){y->focus[0], y->focus[1], turn});
    }
    for (int i = 0; i < 40 && b->w->n_solids < 620; i++) {
        float x = builder_draw(b, -1.0f, 1.0f) * y->half[0];
        float v = builder_draw(b, -1.0f, 1.0f) * y->half[1], turn = builder_draw(b, 0, 2 * PI);
        if (builder_chance(b, 0.6f)) { // most of them where they are seen
            x = y->stand[1][0] + 0.5f * (x + y->half[0]);
            turn = 0.5f * PI + 0.2f * (turn - PI);
        }
        (void)put_piece(y, &garden_pieces[builder_pick(b, GARDEN_PIECES)], (float[]){x, v, turn});
    }
}

static void place_post(struct yard *y)
{
    struct builder *b = y->b;
    float v = builder_draw(b, -0.8f, 0.8f) * y->half[1], cold = builder_draw(b, 0, 0.5f);
    if (!builder_claim(b, y->focus[0] + 0.8f, v, (float[]){0.2f, 0.2f}))
        return;
    struct frame f = builder_frame(&y->root, y->focus[0] + 0.8f, v, 0, 0);
    int m = builder_material(b, ROLE_METAL), glow = builder_glow(b, y->night ? 150.0f : 1.0f, cold);
    builder_rod(b, &f, (float[]){0.1f, 0.1f}, (float[]){0, 0, 0.1f}, m);
    builder_rod(b, &f, (float[]){0.03f, 1.2f}, (float[]){0, 0, 1.2f}, m);
    builder_lamp(
        b,
        builder_add(b, &f,
                    &(struct part){
                        WORLD_ELLIPSOID, {0.13f, 0.13f, 0.13f}, {0, 0, 2.53f}, .material = glow}));
    builder_add(
        b, &f,
        &(struct part){
            WORLD_FRUSTUM, {0.22f, 0.22f, 0.06f}, {0, 0, 2.73f}, m, 0.1f, {0, 0, 0}, CUT_RANDOM});
}

static void plan_yard(struct yard *y)
{
    struct builder *b = y->b;
    y->half[0] = builder_draw(b, 4.5f, 7.0f);
    y->half[1] = builder_draw(b, 3.5f, 6.0f);
    y->focus[0] = builder_draw(b, 0.1f, 0.3f) * y->half[0];
    y->focus[1] = builder_draw(b, -0.6f, 0.6f);
    y->focus[2] = builder_draw(b, 0.5f, 1.0f);
    y->stand[0][0] = 0.8f - y->half[0];
    y->stand[1][0] = y->focus[0] - builder_draw(b, 1.5f, 2.4f);
    y->stand[0][1] = 1.1f - y->half[1];
    y->stand[1][1] = y->half[1] - 1.1f;
    y->stand[0][2] = 0.7f;
    y->stand[1][2] = 2.2f;
    const float half[2] = {0.5f * (y->stand[1][0] - y->stand[0][0]) + 0.15f,
                           y->half[1] - 1.1f + 0.15f};
    (void)builder_claim(b, 0.5f * (y->stand[1][0] + y->stand[0][0]), 0, half);
}

void yard_build(struct builder *b)
{
    static const float COS[4] = {1, 0, -1, 0}, SIN[4] = {0, 1, 0, -1};
    int quarter = builder_pick(b, 4);
    struct yard y = {.b = b, .root = {.c = COS[quarter], .s = SIN[quarter]}};
    y.night = builder_chance(b, 0.12f);
    plan_yard(&y);
    const struct frame house = builder_frame(&y.root, y.half[0], 0, 0, 0.5f * PI);
    yard_front(b, &house, y.half[1] + 1.0f, y.night); // y towards the yard
    build_fence(&y, 1.0f);
    build_fence(&y, -1.0f);
    lay_paving(&y);
    if (y.night || builder_chance(b, 0.3f))
        place_post(&y);
    place_pieces(&y);
    struct room_sky s = {.radiance = 0.003f};
    if (!y.night)
        s.radiance = builder_draw(b, 0.15f, 0.5f);
    s.sun = !y.night && builder_chance(b, 0.8f) ? builder_draw(b, 1.5f, 7.0f) : 0.0f;
    s.azimuth = builder_draw(b, 0, 2 * PI);
    s.height = builder_draw(b, 0.2f, 1.2f);
    room_light(b, &y.root, &s);
    int left = (WORLD_SOLIDS - b->w->n_solids) / 45;
    float near = fmaxf(y.half[0], y.half[1]) + 8.0f;
    const struct room_view v = {0, near, near + 18.0f, left < 10 ? left : 10};
    room_outside(b, &y.root, &v);
    struct world *w = b->w;
    const float inside[2][3] = {{-y.half[0], -y.half[1], 0}, {y.half[0], y.half[1], 4.0f}};
    room_box(&y.root, inside, w->lo, w->hi);
    room_box(&y.root, (const float(*)[3])y.stand, w->stand[0], w->stand[1]);
    const float focus[2][3] = {{y.focus[0], y.focus[1], y.focus[2]},
                               {y.focus[0], y.focus[1], y.focus[2]}};
    float unused[3];
    room_box(&y.root, focus, w->focus, unused);
}
