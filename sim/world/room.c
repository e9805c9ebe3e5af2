/* A room is planned in a frame in which cameras stand at small x and look towards large x; the root
 * frame turns it by a multiple of a right angle. Order: walls with windows and a door; the floor
 * where cameras stand is taken; the subject, around the focus; furniture along the walls, at random
 * places until some number of tries is used up; pictures where a wall is free; lamps; the view
 * through the windows.
 * Amounts of light: a lamp of radius r and radiance L puts L (r / d)^2 on a white wall at d; the
 * lamps are chosen so that this is 0.2 to 1.2 at 2 m. Windows take 5 to 10 % of what a wall sees,
 * so the sky is 3 to 14. */
#include "sim/world/room.h"

#include "core/base/num.h"
#include "sim/world/clutter.h"
#include "sim/world/furniture.h"
#include "sim/world/plant.h"

#include <math.h>

static const float PI = (float)NUM_PI;
static const float THICK = 0.16f; // m, of walls

enum { WALLS = 4, SPANS = 24, OPENINGS = 2, SOLIDS_FULL = 760 };

struct span { // part of a wall, m from its middle, taken between z[0] and z[1]
    float x[2], z[2];
};

struct opening { // m, middle and half size
    float x, z, hx, hz;
};

struct room {
    struct builder *b;
    struct frame root, wall[WALLS]; // for a wall: x along it, y into the room, z = 0 the floor
    float half[2], height, margin;  // m; of the stand from the walls
    float stand[2][3], focus[3];
    struct span span[WALLS][SPANS];
    int n_spans[WALLS];
    int wood, cloth; // window frames and skirting; curtains
    bool day;
};

static float wall_half(const struct room *r, int k)
{
    return r->half[k & 1 ? 0 : 1];
}

/* Take a piece of a wall, unless part of it is taken. */
static bool wall_claim(struct room *r, int k, const struct span *s)
{
    if (s->x[0] < -wall_half(r, k) || s->x[1] > wall_half(r, k) || r->n_spans[k] >= SPANS)
        return false;
    for (int i = 0; i < r->n_spans[k]; i++) {
        const struct span *o = &r->span[k][i];
        if (s->x[0] < o->x[1] && o->x[0] < s->x[1] && s->z[0] < o->z[1] && o->z[0] < s->z[1])
            return false;
    }
    r->span[k][r->n_spans[k]++] = *s;
    return true;
}

static void wall_piece(struct room *r, int k, const float x[2], const float z[2], int m)
{
    struct part p = {.shape = WORLD_BOX, .material = m, .cut = CUT_JOINED};
    p.size[0] = 0.5f * (x[1] - x[0]);
    p.size[1] = 0.5f * THICK;
    p.size[2] = 0.5f * (z[1] - z[0]);
    p.at[0] = 0.5f * (x[1] + x[0]);
    p.at[1] = -0.5f * THICK;
    p.at[2] = 0.5f * (z[1] + z[0]);
    if (p.size[0] > 0.0f && p.size[2] > 0.0f)
        builder_add(r->b, &r->wall[k], &p);
}

static void wall_build(struct room *r, int k, const struct opening *o, int n, int m)
{
    float end = wall_half(r, k) + (k & 1 ? THICK : 0.0f), from = -end;
    for (int i = 0; i <= n; i++) {
        float to = i < n ? o[i].x - o[i].hx : end;
        wall_piece(r, k, (float[]){from, to}, (float[]){0, r->height}, m);
        if (i == n)
            break;
        from = o[i].x + o[i].hx;
        wall_piece(r, k, (float[]){to, from}, (float[]){0, o[i].z - o[i].hz}, m);
        wall_piece(r, k, (float[]){to, from}, (float[]){o[i].z + o[i].hz, r->height}, m);
    }
}

static void hang_curtains(struct room *r, const struct frame *f, const struct opening *o)
{
    struct builder *b = r->b;
    float top = o->z + o->hz + 0.1f, low = builder_chance(b, 0.5f) ? 0.05f : o->z - o->hz - 0.1f;
    float wide = builder_draw(b, 0.15f, 0.5f) * o->hx;
    for (int i = -1; i <= 1; i += 2) {
        for (int j = 0; j < 6; j++) {
            float x = (float)i * (o->hx + 0.12f - wide * ((float)j + 0.5f) / 3.0f);
            float y = 0.07f + 0.012f * (float)(j & 1), q = 0.25f * wide;
            builder_add(b, f,
                        &(struct part){WORLD_FRUSTUM,
                                       {q, 0.03f, 0.5f * (top - low)},
                                       {o->x + x, y, 0.5f * (top + low)},
                                       r->cloth,
                                       1.0f,
                                       {0, 0, 0},
                                       CUT_JOINED});
        }
    }
    builder_add(b, f,
                &(struct part){WORLD_FRUSTUM,
                               {0.012f, 0.012f, o->hx + 0.2f},
                               {o->x, 0.07f, top},
                               r->wood,
                               1.0f,
                               {0, 0.5f * PI, 0},
                               CUT_RANDOM});
}

/* Frame, bars, sill and curtains of a window, and its light. */
static void build_window(struct room *r, int k, const struct opening *o)
{
    struct builder *b = r->b;
    const struct frame *f = &r->wall[k];
    float bar = builder_draw(b, 0.02f, 0.04f), y = -0.5f * THICK;
    int nx = 1 + builder_pick(b, 3), nz = 1 + builder_pick(b, 3);
    for (int i = 0; i <= nx; i++) {
        float x = o->x + (o->hx - bar) * (2.0f * (float)i / (float)nx - 1.0f);
        float w = i == 0 || i == nx ? bar : 0.6f * bar;
        builder_box(b, f, (float[]){w, 0.03f, o->hz}, (float[]){x, y, o->z}, r->wood);
    }
    for (int i = 0; i <= nz; i++) {
        float z = o->z + (o->hz - bar) * (2.0f * (float)i / (float)nz - 1.0f);
        float w = i == 0 || i == nz ? bar : 0.6f * bar;
        builder_box(b, f, (float[]){o->hx, 0.028f, w}, (float[]){o->x, y, z}, r->wood);
    }
    builder_box(b, f, (float[]){o->hx + 0.04f, 0.1f, 0.015f},
                (float[]){o->x, 0.02f, o->z - o->hz + 0.015f}, r->wood);
    struct frame sill = builder_frame(f, o->x, 0.05f, o->z - o->hz + 0.03f, 0);
    if (builder_chance(b, 0.5f))
        clutter_put(b, &sill, (const float[]){0.9f * o->hx, 0.06f});
    if (builder_chance(b, 0.5f))
        hang_curtains(r, f, o);
    struct world *w = b->w;
    if (w->n_lights >= WORLD_LIGHTS)
        return;
    struct frame at = builder_frame(f, o->x, y, o->z, 0);
    w->lights[w->n_lights++] = (struct world_light){
        .solid = -1,
        .r = {-at.c, 0, -at.s, -at.s, 0, at.c, 0, 1, 0}, // x along the wall, y up, z into the room
        .t = {at.at[0], at.at[1], at.at[2]},
        .size = {o->hx, o->hz}};
}

static int plan_openings(struct room *r, int k, struct opening o[OPENINGS])
{
    struct builder *b = r->b;
    float half = wall_half(r, k);
    int n = half > 2.2f && builder_chance(b, 0.5f) ? 2 : 1;
    float room = 2.0f * half / (float)n;
    float z = builder_draw(b, 1.3f, 1.6f), hz = builder_draw(b, 0.45f, 0.8f);
    hz = builder_least(hz, r->height - 0.2f - z);
    for (int i = 0; i < n; i++) {
        o[i].hx = builder_draw(b, 0.18f, 0.38f) * room;
        o[i].hx = builder_least(o[i].hx, 1.3f);
        float free = 0.5f * room - o[i].hx - 0.12f;
        o[i].x = room * ((float)i + 0.5f) - half + builder_draw(b, -0.8f, 0.8f) * free;
        o[i].z = z;
        o[i].hz = hz;
        const struct span s = {{o[i].x - o[i].hx - 0.15f, o[i].x + o[i].hx + 0.15f},
                               {z - hz - 0.05f, z + hz + 0.1f}};
        (void)wall_claim(r, k, &s);
    }
    return n;
}

static void build_door(struct room *r, int k)
{
    struct builder *b = r->b;
    const struct frame *f = &r->wall[k];
    float wide = builder_draw(b, 0.38f, 0.5f), tall = builder_draw(b, 0.98f, 1.05f);
    float free = wall_half(r, k) - wide - 0.15f;
    float x = builder_draw(b, -free, free);
    int m = builder_timber(b), knob = builder_material(b, ROLE_METAL);
    const struct span s = {{x - wide - 0.1f, x + wide + 0.1f}, {0, 2 * tall + 0.1f}};
    if (!wall_claim(r, k, &s))
        return;
    builder_box(b, f, (float[]){wide, 0.02f, tall}, (float[]){x, 0.005f, tall}, m);
    for (int i = 0; i < 4; i++)
        builder_box(
            b, f, (float[]){0.36f * wide, 0.008f, 0.38f * tall},
            (float[]){x + (i & 1 ? 0.47f : -0.47f) * wide, 0.027f, tall * (i & 2 ? 1.48f : 0.52f)},
            m);
    for (int i = -1; i <= 1; i += 2)
        builder_box(b, f, (float[]){0.04f, 0.03f, tall + 0.04f},
                    (float[]){x + (float)i * (wide + 0.04f), 0.01f, tall + 0.04f}, r->wood);
    builder_box(b, f, (float[]){wide + 0.08f, 0.03f, 0.04f}, (float[]){x, 0.01f, 2 * tall + 0.04f},
                r->wood);
    builder_add(b, f,
                &(struct part){WORLD_ELLIPSOID,
                               {0.03f, 0.03f, 0.03f},
                               {x + 0.85f * wide, 0.06f, tall},
                               .material = knob});
    struct frame at = builder_frame(f, x, 0.25f, 0, 0);
    float hx = fabsf(at.c) * wide + fabsf(at.s) * 0.25f;
    float hy = fabsf(at.s) * wide + fabsf(at.c) * 0.25f;
    (void)builder_claim(b, at.at[0], at.at[1], (float[]){hx, hy});
}

static void build_shell(struct room *r)
{
    struct builder *b = r->b;
    int wall = builder_material(b, ROLE_WALL), floor = builder_material(b, ROLE_FLOOR);
    int other = builder_chance(b, 0.4f) ? builder_material(b, ROLE_WALL) : wall;
    int ceiling = builder_material(b, ROLE_CEILING);
    float x = r->half[0] + THICK, y = r->half[1] + THICK;
    builder_box(b, &r->root, (float[]){x, y, 0.1f}, (float[]){0, 0, -0.1f}, floor);
    builder_box(b, &r->root, (float[]){x, y, 0.1f}, (float[]){0, 0, r->height + 0.1f}, ceiling);
    bool none = b->w->kind == WORLD_DARK;
    int sure = 1 + 2 * builder_pick(b, 2), doors = builder_pick(b, WALLS);
    for (int k = 0; k < WALLS; k++) {
        struct opening o[OPENINGS];
        int n = 0;
        if (!none && k != doors && (k == sure || builder_chance(b, 0.45f)))
            n = plan_openings(r, k, o);
        wall_build(r, k, o, n, k == 0 ? other : wall);
        for (int i = 0; i < n; i++)
            build_window(r, k, &o[i]);
        builder_box(b, &r->wall[k], (float[]){wall_half(r, k), 0.012f, 0.045f},
                    (float[]){0, 0.012f, 0.045f}, r->wood);
        if (k == doors)
            build_door(r, k);
    }
    int beams = builder_chance(b, 0.3f) ? 2 + builder_pick(b, 4) : 0, beam = builder_timber(b);
    for (int i = 0; i < beams; i++) {
        float at = r->half[0] * ((float)(2 * i + 1) / (float)beams - 1.0f);
        builder_box(b, &r->root, (float[]){0.06f, r->half[1], 0.07f},
                    (float[]){at, 0, r->height - 0.07f}, beam);
    }
}

/* Where cameras stand and what they look at; the floor of the stand is taken. */
static void plan_room(struct room *r)
{
    struct builder *b = r->b;
    float x = r->half[0], y = r->half[1];
    r->margin = x > 2.0f && y > 2.0f ? builder_draw(b, 0.5f, 0.8f) : 0.38f;
    r->focus[0] = builder_draw(b, 0.25f, 0.5f) * x;
    r->focus[1] = builder_draw(b, -0.2f, 0.2f) * y;
    r->focus[2] = builder_draw(b, 0.55f, 1.0f);
    float free = builder_draw(b, 0.75f, 1.2f);
    r->stand[0][0] = r->margin - x;
    r->stand[1][0] = fmaxf(r->focus[0] - free, r->stand[0][0] + 0.5f);
    r->stand[0][1] = r->margin - y;
    r->stand[1][1] = y - r->margin;
    r->stand[0][2] = 0.75f;
    r->stand[1][2] = builder_least(1.95f, r->height - 0.55f);
    const float half[2] = {0.5f * (r->stand[1][0] - r->stand[0][0]) + 0.12f, y - r->margin + 0.12f};
    (void)builder_claim(b, 0.5f * (r->stand[1][0] + r->stand[0][0]), 0.0f, half);
}

/* Put a piece of furniture at (x, y), turned by `angle`, if there is room. */
static bool put_piece(struct room *r, const struct piece *p, const float at[3])
{
    struct builder *b = r->b;
    float half[2], height;
    furniture_size(b, p, half, &height);
    struct frame f = builder_frame(&r->root, at[0], at[1], 0, at[2]);
    float c, s;
    builder_turn(at[2], &c, &s);
    const float wide[2] = {fabsf(c) * half[0] + fabsf(s) * half[1],
                           fabsf(s) * half[0] + fabsf(c) * half[1]};
    if (fabsf(at[0]) + wide[0] > r->half[0] || fabsf(at[1]) + wide[1] > r->half[1] ||
        !builder_claim(b, at[0], at[1], wide))
        return false;
    p->make(b, &f, half, builder_least(height, r->height - 0.3f));
    return true;
}

static void place_subject(struct room *r)
{
    struct builder *b = r->b;
    if (builder_chance(b, 0.7f)) {
        int rug = builder_material(b, ROLE_RUG);
        float hx = builder_draw(b, 0.5f, 0.9f) * (r->half[0] - fabsf(r->focus[0]));
        float hy = builder_draw(b, 0.4f, 0.8f) * r->half[1];
        builder_box(b, &r->root, (float[]){hx, hy, 0.005f},
                    (float[]){r->focus[0], 0.3f * r->focus[1], 0.005f}, rug);
    }
    static const uint8_t OFTEN[] = {0, 0, 0, 1, 1, 1, 2, 3, 4};
    bool done = false;
    for (int i = 0; i < 12 && !done; i++) {
        float turn = 0.5f * PI + builder_draw(b, -0.6f, 0.6f);
        float x = r->focus[0] + 0.02f * (float)i;
        done = put_piece(r, &furniture_middle[OFTEN[builder_pick(b, (int)sizeof OFTEN)]],
                         (float[]){x, r->focus[1], turn});
    }
    for (int i = 0; i < 14; i++) {
        float x = builder_draw(b, r->stand[1][0], r->half[0]);
        float y = builder_draw(b, -0.95f, 0.95f) * r->half[1], turn = builder_draw(b, 0, 2 * PI);
        const struct piece *p = &furniture_middle[2]; // a column, or something that turns no back
        if (builder_chance(b, 0.7f))
            p = &furniture_wall[5 + builder_pick(b, 2)];
        if (i < 3)
            p = &furniture_middle[builder_pick(b, 3)];
        (void)put_piece(r, p, (float[]){x, y, turn});
    }
    for (int i = 0; i < 4; i++) {
        float x = builder_draw(b, r->stand[1][0], 0.9f * r->half[0]);
        float y = builder_draw(b, -0.9f, 0.9f) * r->half[1], turn = builder_draw(b, 0, 2 * PI);
        if (builder_claim(b, x, y, (float[]){0.3f, 0.3f})) {
            struct frame f = builder_frame(&r->root, x, y, 0, turn);
            furniture_chair(b, &f);
        }
    }
}

static void furnish_walls(struct room *r)
{
    struct builder *b = r->b;
    int tries = 10 + (int)(6.0f * (r->half[0] + r->half[1]));
    for (int i = 0; i < tries && b->w->n_solids < SOLIDS_FULL; i++) {
        int k = builder_pick(b, WALLS + 2) % WALLS; // more often those that are looked at
        const struct piece *p = &furniture_wall[builder_pick(b, FURNITURE_WALL)];
        float half[2], height, wall = wall_half(r, k);
        furniture_size(b, p, half, &height);
        height = builder_least(height, r->height - 0.25f);
        float x = builder_draw(b, half[0] - wall, wall - half[0]);
        struct frame f = builder_frame(&r->wall[k], x, half[1] + 0.03f, 0, 0);
        float c, s;
        builder_turn(0.5f * PI * (float)(k + 1), &c, &s);
        bool along = k & 1;
        float depth = half[1] + 0.03f, away = r->half[k & 1] - depth;
        const float wide[2] = {along ? half[0] : depth, along ? depth : half[0]};
        float px = c * x - s * -away, py = s * x + c * -away;
        const struct span span = {{x - half[0], x + half[0]}, {0, height + 0.1f}};
        int before = b->n_areas;
        if (!builder_claim(b, px, py, wide))
            continue;
        if (!wall_claim(r, k, &span)) {
            b->n_areas = before;
            continue;
        }
        p->make(b, &f, half, height);
    }
}

static void hang_pictures(struct room *r)
{
    struct builder *b = r->b;
    for (int i = 0; i < 48 && b->w->n_solids < WORLD_SOLIDS - 180; i++) {
        int k = builder_pick(b, WALLS);
        float hx = builder_draw(b, 0.12f, 0.6f), hz = builder_draw(b, 0.15f, 0.55f);
        float wall = wall_half(r, k) - hx;
        float x = builder_draw(b, -wall, wall), z = builder_draw(b, 1.2f, 2.0f);
        const struct span s = {{x - hx - 0.1f, x + hx + 0.1f}, {z - hz - 0.1f, z + hz + 0.1f}};
        if (z + hz > r->height - 0.15f || !wall_claim(r, k, &s))
            continue;
        bool board = builder_chance(b, 0.25f);
        struct frame f = builder_frame(&r->wall[k], x, 0, board ? z - hz : z, 0);
        if (!board) {
            furniture_picture(b, &f, (float[]){hx, hz});
            continue;
        }
        builder_box(b, &f, (float[]){hx, 0.1f, 0.012f}, (float[]){0, 0.1f, 0}, builder_timber(b));
        struct frame on = builder_frame(&f, 0, 0.1f, 0.012f, 0);
        clutter_put(b, &on, (const float[]){hx - 0.02f, 0.09f});
    }
}

/* A lamp from the ceiling at (x, y): bulb under a shade, globe or panel. */
static void ceiling_lamp(struct room *r, float x, float y, float share)
{
    struct builder *b = r->b;
    struct frame f = builder_frame(&r->root, x, y, 0, 0);
    bool dark = b->w->kind == WORLD_DARK;
    int style = dark ? 0 : builder_pick(b, 3), m = builder_material(b, ROLE_METAL);
    float cold = builder_draw(b, 0.1f, 0.7f), top = r->height;
    if (style == 2) {
        float hx = builder_draw(b, 0.15f, 0.4f), hy = builder_draw(b, 0.08f, 0.4f);
        int glow = builder_glow(b, share * PI / (hx * hy), cold);
        builder_box(b, &f, (float[]){hx + 0.02f, hy + 0.02f, 0.02f}, (float[]){0, 0, top - 0.02f},
                    m);
        builder_lamp(
            b, builder_box(b, &f, (float[]){hx, hy, 0.006f}, (float[]){0, 0, top - 0.046f}, glow));
        return;
    }
    float low = x < r->stand[1][0] + 0.3f ? 2.1f : 1.7f;
    float radius = style == 1 ? builder_draw(b, 0.1f, 0.17f) : builder_draw(b, 0.03f, 0.045f);
    if (dark)
        radius = 0.02f;
    float z = builder_draw(b, low, top - 0.1f);
    z = builder_least(z, top - radius - 0.06f);
    int glow = builder_glow(b, share * 4.0f / (radius * radius), cold);
    builder_rod(b, &f, (float[]){0.005f, 0.5f * (top - z)}, (float[]){0, 0, 0.5f * (top + z)}, m);
    builder_lamp(
        b,
        builder_add(b, &f,
                    &(struct part){
                        WORLD_ELLIPSOID, {radius, radius, radius}, {0, 0, z}, .material = glow}));
    builder_rod(b, &f, (float[]){0.02f, 0.03f}, (float[]){0, 0, z + radius + 0.03f}, m);
    if (style == 0 && !dark && builder_chance(b, 0.7f))
        builder_add(b, &f,
                    &(struct part){WORLD_FRUSTUM,
                                   {0.2f, 0.2f, 0.07f},
                                   {0, 0, z + radius + 0.08f},
                                   builder_material(b, ROLE_PAINTED),
                                   0.2f,
                                   {0, 0, 0},
                                   CUT_RANDOM});
}

static void place_lamps(struct room *r)
{
    struct builder *b = r->b;
    if (b->w->kind == WORLD_DARK) {
        ceiling_lamp(r, r->focus[0] + 0.1f, r->focus[1] + 0.25f, 1.0f);
        return;
    }
    float power = r->day ? 0.35f : 1.0f;
    int n = r->day ? builder_pick(b, 2) : 1 + builder_pick(b, 2);
    for (int i = 0; i < n; i++) {
        float x = builder_draw(b, -0.6f, 0.8f) * r->half[0];
        float y = builder_draw(b, -0.6f, 0.6f) * r->half[1];
        ceiling_lamp(r, x, y, power * builder_draw(b, 0.3f, 1.2f));
    }
    int tries = n == 0 && !r->day ? 20 : (builder_chance(b, 0.5f) ? 6 : 0);
    for (int i = 0; i < tries; i++) {
        float x = builder_draw(b, -0.9f, 0.9f) * r->half[0];
        float y = builder_draw(b, -0.9f, 0.9f) * r->half[1];
        float share = builder_draw(b, 0.15f, 0.6f);
        if (b->w->n_lights > 7 || !builder_claim(b, x, y, (float[]){0.24f, 0.24f}))
            continue;
        struct frame f = builder_frame(&r->root, x, y, 0, 0);
        furniture_floor_lamp(b, &f, share * power * 180.0f);
        break;
    }
}

static void build_house(struct builder *b, const struct frame *f)
{
    int m = builder_material(b, builder_chance(b, 0.5f) ? ROLE_STONE : ROLE_WALL);
    int glass = builder_material(b, ROLE_METAL), roof = builder_timber(b);
    float x = builder_draw(b, 2.0f, 4.0f), y = builder_draw(b, 2.0f, 4.0f);
    float z = builder_draw(b, 1.5f, 4.0f);
    builder_box(b, f, (float[]){x, y, z}, (float[]){0, 0, z}, m);
    builder_box(b, f, (float[]){x + 0.3f, y + 0.3f, 0.15f}, (float[]){0, 0, 2 * z + 0.15f}, roof);
    int nx = 2 + builder_pick(b, 3), nz = z > 2.4f ? 2 : 1;
    for (int i = 0; i < nx * nz; i++) {
        float at = x * ((float)(2 * (i % nx) + 1) / (float)nx - 1.0f);
        float up = z * (float)(2 * (i / nx) + 1) / (float)nz;
        for (int k = -1; k <= 1; k += 2)
            builder_box(b, f, (float[]){0.4f, 0.03f, 0.6f}, (float[]){at, (float)k * y, up}, glass);
    }
}

void room_outside(struct builder *b, const struct frame *root, const struct room_view *v)
{
    struct frame ground = builder_frame(root, 0, 0, -v->depth, 0);
    int m = builder_material(b, ROLE_GROUND);
    b->w->materials[m].albedo.scale *= 2.0f;
    builder_box(b, &ground, (float[]){90, 90, 0.5f}, (float[]){0, 0, -0.5f}, m);
    float turn = builder_draw(b, 0, 6.2831853f);
    for (int i = 0; i < v->count; i++) {
        float c, s, away = builder_draw(b, v->near, v->far);
        turn += 6.2831853f / (float)v->count;
        builder_turn(turn, &c, &s);
        float skew = builder_draw(b, -0.4f, 0.4f);
        struct frame f = builder_frame(&ground, away * c, away * s, 0, turn + 0.5f * PI + skew);
        if (builder_chance(b, 0.45f)) {
            build_house(b, &f);
        } else {
            float wide = builder_draw(b, 1.2f, 2.6f), tall = builder_draw(b, 1.8f, 3.0f) * wide;
            plant_tree(b, &f, (const float[]){wide, wide}, tall);
        }
    }
}

void room_light(struct builder *b, const struct frame *root, const struct room_sky *s)
{
    struct world *w = b->w;
    float ca, sa, ch, sh, haze = builder_draw(b, 0.0f, 1.0f);
    builder_turn(s->azimuth, &ca, &sa);
    builder_turn(s->height, &ch, &sh);
    w->sun_dir[0] = ch * (root->c * ca - root->s * sa);
    w->sun_dir[1] = ch * (root->s * ca + root->c * sa);
    w->sun_dir[2] = sh;
    w->sun_cos = 0.99998920f; // 0.266 degrees
    const float blue[3] = {0.45f, 0.75f, 1.3f}, grey[3] = {0.95f, 1.0f, 1.05f};
    for (int c = 0; c < 3; c++) {
        w->sky[0][c] = s->radiance * (blue[c] + haze * (grey[c] - blue[c]));
        w->sky[1][c] = s->radiance * (0.6f * grey[c] + 0.4f * w->sky[0][c] / s->radiance) * 1.2f;
        float warm = 1.0f + (0.9f - 0.9f * sh) * (c == 0 ? 0.15f : (c == 1 ? -0.05f : -0.4f));
        w->sun[c] = s->radiance * s->sun * PI * warm;
    }
}

void room_box(const struct frame *root, const float box[2][3], float lo[3], float hi[3])
{
    for (int i = 0; i < 2; i++) {
        float x = box[i][0], y = box[i][1];
        const float p[3] = {root->at[0] + root->c * x - root->s * y,
                            root->at[1] + root->s * x + root->c * y, root->at[2] + box[i][2]};
        for (int c = 0; c < 3; c++) {
            lo[c] = i == 0 ? p[c] : builder_least(lo[c], p[c]);
            hi[c] = i == 0 ? p[c] : fmaxf(hi[c], p[c]);
        }
    }
}

static void light_room(struct room *r)
{
    struct builder *b = r->b;
    struct room_sky s = {.radiance = 0.0f};
    s.radiance = r->day ? 3.0f * builder_power(builder_draw(b, 0, 2.2f))
                        : 0.002f * builder_power(builder_draw(b, 0, 4.0f));
    s.sun = r->day && builder_chance(b, 0.65f) ? builder_draw(b, 1.5f, 6.0f) : 0.0f;
    int n = 0, choice = builder_pick(b, 16);
    for (int i = 0; i < b->w->n_lights; i++) // towards one of the windows
        n += b->w->lights[i].solid < 0;
    s.azimuth = builder_draw(b, 0, 2 * PI);
    for (int i = 0, at = 0; i < b->w->n_lights && n > 0; i++) {
        const struct world_light *l = &b->w->lights[i];
        if (l->solid >= 0 || at++ != choice % n)
            continue;
        float x = -l->r[2], y = -l->r[5]; // outwards, in the world
        float rx = r->root.c * x + r->root.s * y, ry = r->root.c * y - r->root.s * x;
        float base = fabsf(rx) > fabsf(ry) ? (rx > 0 ? 0.0f : PI) : (ry > 0 ? 0.5f : -0.5f) * PI;
        s.azimuth = base + builder_draw(b, -0.9f, 0.9f);
    }
    s.height = builder_draw(b, 0.25f, 0.85f);
    room_light(b, &r->root, &s);
    if (b->w->kind == WORLD_DARK) {
        for (int c = 0; c < 6; c++)
            b->w->sky[c / 3][c % 3] = 0.0f;
        return;
    }
    float depth = builder_chance(b, 0.5f) ? 0.3f : builder_draw(b, 2.0f, 6.0f);
    float near = fmaxf(r->half[0], r->half[1]) + 6.0f;
    int room = (WORLD_SOLIDS - b->w->n_solids) / 45;
    const struct room_view v = {depth, near, near + 14.0f, room < 9 ? room : 9};
    room_outside(b, &r->root, &v);
}

void room_build(struct builder *b)
{
    static const float COS[WALLS] = {1, 0, -1, 0}, SIN[WALLS] = {0, 1, 0, -1};
    struct room r = {.b = b};
    int quarter = builder_pick(b, WALLS);
    r.root = (struct frame){.c = COS[quarter], .s = SIN[quarter]};
    r.half[0] = builder_draw(b, 1.6f, 4.0f);
    r.half[1] = builder_draw(b, 1.5f, 3.5f);
    r.height = builder_draw(b, 2.4f, 3.3f);
    r.day = b->w->kind != WORLD_DARK && builder_chance(b, 0.72f);
    r.wood = builder_material(b, builder_chance(b, 0.5f) ? ROLE_CEILING : ROLE_TIMBER);
    r.cloth = builder_material(b, ROLE_CLOTH);
    for (int k = 0; k < WALLS; k++) {
        float away = r.half[k & 1];
        struct frame f = {.c = -SIN[k], .s = COS[k]}; // y of the wall's frame points inwards
        f.at[0] = COS[k] * away;
        f.at[1] = SIN[k] * away;
        r.wall[k] = (struct frame){.c = r.root.c * f.c - r.root.s * f.s,
                                   .s = r.root.s * f.c + r.root.c * f.s};
        r.wall[k].at[0] = r.root.c * f.at[0] - r.root.s * f.at[1];
        r.wall[k].at[1] = r.root.s * f.at[0] + r.root.c * f.at[1];
    }
    plan_room(&r);
    build_shell(&r);
    place_lamps(&r);
    place_subject(&r);
    furnish_walls(&r);
    hang_pictures(&r);
    light_room(&r);
    struct world *w = b->w;
    const float inside[2][3] = {{-r.half[0], -r.half[1], 0}, {r.half[0], r.half[1], r.height}};
    room_box(&r.root, inside, w->lo, w->hi);
    room_box(&r.root, (const float(*)[3])r.stand, w->stand[0], w->stand[1]);
    float unused[3] = {0};
    const float focus[2][3] = {{r.focus[0], r.focus[1], r.focus[2]},
                               {r.focus[0], r.focus[1], r.focus[2]}};
    room_box(&r.root, focus, w->focus, unused);
}
