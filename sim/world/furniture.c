/* Every piece draws its own proportions and materials, one random number a statement: C leaves the
 * order within an expression open. */
#include "sim/world/furniture.h"

#include "core/base/num.h"
#include "sim/world/clutter.h"
#include "sim/world/plant.h"

static const float PI = (float)NUM_PI;

static void legs(struct builder *b, const struct frame *f, const float half[2], float height, int m)
{
    float r = builder_draw(b, 0.015f, 0.035f), taper = builder_draw(b, 0.4f, 1.0f);
    bool square = builder_chance(b, 0.5f);
    for (int i = 0; i < 4; i++) {
        float x = (i & 1) ? half[0] - 1.5f * r : 1.5f * r - half[0];
        float y = (i & 2) ? half[1] - 1.5f * r : 1.5f * r - half[1];
        struct part p = {square ? WORLD_BOX : WORLD_FRUSTUM,
                         {r, r, 0.5f * height},
                         {x, y, 0.5f * height},
                         m,
                         taper,
                         {PI, 0, 0},
                         CUT_RANDOM};
        builder_add(b, f, &p);
    }
}

static void table(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_timber(b);
    float thick = builder_draw(b, 0.012f, 0.03f);
    legs(b, f, half, height - 2 * thick, m);
    builder_box(b, f, (float[]){half[0], half[1], thick}, (float[]){0, 0, height - thick}, m);
    if (builder_chance(b, 0.5f))
        builder_box(b, f, (float[]){0.93f * half[0], 0.93f * half[1], 0.04f},
                    (float[]){0, 0, height - 2 * thick - 0.04f}, builder_timber(b));
    float top = height;
    if (builder_chance(b, 0.4f)) { // a runner
        builder_box(b, f, (float[]){0.4f * half[0], 0.95f * half[1], 0.002f},
                    (float[]){0, 0, top + 0.002f}, builder_material(b, ROLE_RUG));
        top += 0.004f;
    }
    struct frame on = builder_frame(f, 0, 0, top, 0);
    clutter_put(b, &on, (const float[]){half[0] - 0.03f, half[1] - 0.03f});
}

static void round_table(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_timber(b), foot = builder_timber(b);
    float r = builder_least(half[0], half[1]);
    builder_rod(b, f, (float[]){r, 0.018f}, (float[]){0, 0, height - 0.018f}, m);
    builder_rod(b, f, (float[]){0.045f, 0.5f * height - 0.02f}, (float[]){0, 0, 0.5f * height},
                foot);
    builder_add(b, f,
                &(struct part){WORLD_FRUSTUM,
                               {0.6f * r, 0.6f * r, 0.03f},
                               {0, 0, 0.03f},
                               foot,
                               0.4f,
                               {0, 0, 0},
                               CUT_RANDOM});
    struct frame on = builder_frame(f, 0, 0, height, 0);
    clutter_put(b, &on, (const float[]){0.68f * r, 0.68f * r});
}

void furniture_chair(struct builder *b, const struct frame *f)
{
    int m = builder_timber(b), seat = builder_chance(b, 0.5f) ? builder_material(b, ROLE_CLOTH) : m;
    float x = builder_draw(b, 0.19f, 0.23f), height = builder_draw(b, 0.42f, 0.48f);
    float back = builder_draw(b, 0.22f, 0.3f);
    legs(b, f, (const float[]){x, x}, height - 0.04f, m);
    builder_box(b, f, (float[]){x, x, 0.02f}, (float[]){0, 0, height - 0.02f}, seat);
    int bars = 2 + builder_pick(b, 4);
    if (builder_chance(b, 0.3f))
        bars = 0;
    for (int i = 0; i < bars; i++) {
        float at = x * (2.0f * ((float)i + 0.5f) / (float)bars - 1.0f);
        builder_box(b, f, (float[]){0.012f, 0.01f, back}, (float[]){at, 0.015f - x, height + back},
                    m);
    }
    if (bars == 0)
        builder_box(b, f, (float[]){x, 0.012f, back}, (float[]){0, 0.012f - x, height + back},
                    seat);
    builder_box(b, f, (float[]){x, 0.014f, 0.04f}, (float[]){0, 0.014f - x, height + 2 * back}, m);
}

/* A row of books from x0 to x1, standing on z before a board, at most `room` high. */
static void books(struct builder *b, const struct frame *f, const float x[2], float z, float room)
{
    float at = x[0], end = x[0] + builder_draw(b, 0.6f, 1.0f) * (x[1] - x[0]);
    while (at < end) {
        float thick = builder_draw(b, 0.008f, 0.028f), tall = builder_draw(b, 0.6f, 0.95f);
        tall *= 0.5f * builder_least(room, 0.34f);
        float deep = builder_draw(b, 0.07f, 0.1f);
        if (at + 2 * thick > x[1])
            break;
        builder_box(b, f, (float[]){thick, deep, tall},
                    (float[]){at + thick, deep - 0.08f, z + tall},
                    b->books[builder_pick(b, BUILDER_BOOKS)]);
        at += 2 * thick + 0.001f;
        if (builder_chance(b, 0.06f))
            at += 0.12f;
    }
    if (x[1] - at > 0.3f && room > 0.25f) {
        float half = 0.5f * (x[1] - at) - 0.02f;
        struct frame rest = builder_frame(f, at + 0.02f + half, 0, z, 0);
        clutter_put(b, &rest, (const float[]){half, 0.1f});
    }
}

static void shelf(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_timber(b), rows = (int)(height / builder_draw(b, 0.3f, 0.42f));
    float gap = (height - 0.1f) / (float)(rows > 0 ? rows : 1), y = half[1] - 0.015f;
    for (int i = -1; i <= 1; i += 2)
        builder_box(b, f, (float[]){0.014f, half[1], 0.5f * height},
                    (float[]){(float)i * (half[0] - 0.014f), 0, 0.5f * height}, m);
    builder_box(b, f, (float[]){half[0] - 0.028f, 0.008f, 0.5f * height},
                (float[]){0, 0.008f - half[1], 0.5f * height}, builder_timber(b));
    for (int i = 0; i <= rows; i++) {
        float z = 0.08f + gap * (float)i;
        builder_box(b, f, (float[]){half[0] - 0.028f, y, 0.011f}, (float[]){0, 0.015f, z - 0.011f},
                    m);
        if (i == rows)
            break;
        const float x[2] = {0.035f - half[0], half[0] - 0.035f};
        struct frame row = builder_frame(f, 0, 0.02f, 0, 0);
        if (builder_chance(b, 0.72f)) {
            books(b, &row, x, z, gap - 0.03f);
        } else {
            row.at[2] += z;
            clutter_put(b, &row, (const float[]){x[1], half[1] - 0.05f});
        }
    }
}

static void cupboard(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_timber(b), front = builder_chance(b, 0.5f) ? m : builder_timber(b);
    int knob = builder_material(b, ROLE_METAL);
    float foot = 0.05f, mid = 0.5f * (height + foot), tall = 0.5f * (height - foot);
    builder_box(b, f, (float[]){half[0], half[1], tall}, (float[]){0, -0.012f, mid}, m);
    builder_box(b, f, (float[]){0.95f * half[0], 0.9f * half[1], 0.5f * foot},
                (float[]){0, -0.02f, 0.5f * foot}, m);
    int nx = 1 + (int)(half[0] / 0.28f), nz = height > 1.2f ? 2 : 1 + builder_pick(b, 3);
    float wx = half[0] / (float)nx, wz = tall / (float)nz;
    for (int i = 0; i < nx * nz; i++) {
        float x = (float)(2 * (i % nx) + 1) * wx - half[0];
        float z = (float)(2 * (i / nx) + 1) * wz + foot;
        builder_box(b, f, (float[]){wx - 0.008f, 0.01f, wz - 0.008f},
                    (float[]){x, half[1] - 0.002f, z}, front);
        float side = (i % nx) & 1 ? -0.75f : 0.75f;
        builder_add(b, f,
                    &(struct part){WORLD_ELLIPSOID,
                                   {0.016f, 0.016f, 0.016f},
                                   {x + side * wx, half[1] + 0.018f, z},
                                   .material = knob});
    }
    struct frame on = builder_frame(f, 0, -0.012f, height, 0);
    if (height < 1.7f)
        clutter_put(b, &on, (const float[]){half[0] - 0.02f, half[1] - 0.03f});
}

static void sofa(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_material(b, ROLE_CLOTH), soft = builder_material(b, ROLE_CLOTH);
    float seat = 0.42f, arm = builder_draw(b, 0.06f, 0.11f), x = half[0] - 2 * arm;
    builder_box(b, f, (float[]){half[0], half[1], 0.14f}, (float[]){0, 0, 0.2f}, m);
    builder_box(b, f, (float[]){half[0], 0.1f, 0.5f * height - 0.05f},
                (float[]){0, 0.1f - half[1], 0.5f * height + 0.05f}, m);
    for (int i = -1; i <= 1; i += 2) {
        float at = (float)i * (half[0] - arm);
        builder_box(b, f, (float[]){arm, half[1], 0.15f}, (float[]){at, 0, 0.45f}, m);
        builder_add(b, f,
                    &(struct part){WORLD_FRUSTUM,
                                   {arm, arm, half[1]},
                                   {at, 0, 0.6f},
                                   m,
                                   1.0f,
                                   {0.5f * PI, 0, 0},
                                   CUT_RANDOM});
        builder_rod(b, f, (float[]){0.03f, 0.03f}, (float[]){at, half[1] - 0.06f, 0.03f},
                    b->timber);
    }
    int n = 1 + (int)(x / 0.4f);
    float w = x / (float)n;
    for (int i = 0; i < n; i++) {
        float at = (float)(2 * i + 1) * w - x;
        builder_box(b, f, (float[]){w - 0.006f, half[1] - 0.11f, 0.06f},
                    (float[]){at, 0.09f, seat - 0.02f}, m);
        float lean = builder_draw(b, 0.15f, 0.5f), turn = builder_draw(b, -0.5f, 0.5f);
        if (builder_chance(b, 0.7f))
            builder_add(b, f,
                        &(struct part){WORLD_ELLIPSOID,
                                       {0.2f, 0.08f, 0.19f},
                                       {at, 0.3f - half[1], seat + 0.22f},
                                       builder_chance(b, 0.5f) ? soft : m,
                                       0,
                                       {lean, 0, turn},
                                       CUT_RANDOM});
    }
}

static void bed(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_timber(b), sheet = builder_material(b, ROLE_CLOTH),
        rug = builder_material(b, ROLE_RUG);
    builder_box(b, f, (float[]){half[0], half[1], 0.1f}, (float[]){0, 0, 0.2f}, m);
    legs(b, f, half, 0.1f, m);
    builder_box(b, f, (float[]){half[0], 0.025f, 0.5f * height},
                (float[]){0, 0.025f - half[1], 0.5f * height}, m);
    builder_box(b, f, (float[]){half[0] - 0.02f, half[1] - 0.04f, 0.09f},
                (float[]){0, 0.02f, 0.39f}, sheet);
    float cover = builder_draw(b, 0.45f, 0.7f) * half[1];
    builder_box(b, f, (float[]){half[0] + 0.015f, cover, 0.085f},
                (float[]){0, half[1] - cover + 0.015f, 0.42f}, rug);
    for (int i = -1; i <= 1; i += 2) {
        float turn = builder_draw(b, -0.3f, 0.3f);
        builder_add(b, f,
                    &(struct part){WORLD_ELLIPSOID,
                                   {0.42f * half[0], 0.2f, 0.09f},
                                   {(float)i * 0.47f * half[0], 0.32f - half[1], 0.53f},
                                   builder_material(b, ROLE_CLOTH),
                                   0,
                                   {0.2f, 0, turn},
                                   CUT_RANDOM});
    }
}

static void cartons(struct builder *b, const struct frame *f, const float half[2], float height)
{
    float z = 0.0f, shrink = 1.0f;
    while (z < height && shrink > 0.4f) {
        float tall = builder_draw(b, 0.1f, 0.22f), turn = builder_draw(b, -0.25f, 0.25f);
        float x = 0.75f * shrink * half[0], y = 0.75f * shrink * half[1];
        int m = builder_material(b, ROLE_CARTON);
        builder_add(b, f,
                    &(struct part){
                        WORLD_BOX, {x, y, tall}, {0, 0, z + tall}, m, 0, {0, 0, turn}, CUT_CORNER});
        z += 2 * tall;
        shrink *= builder_draw(b, 0.65f, 0.95f);
    }
    struct frame on = builder_frame(f, 0, 0, z, 0);
    clutter_put(b, &on, (const float[]){0.4f * shrink * half[0], 0.4f * shrink * half[1]});
}

/* A thing on a column, as in a gallery. */
static void column(struct builder *b, const struct frame *f, const float half[2], float height)
{
    int m = builder_material(b, builder_chance(b, 0.5f) ? ROLE_STONE : ROLE_PAINTED);
    float r = builder_least(half[0], half[1]), tall = 0.55f * height;
    float twist = builder_draw(b, 0, 1.5f);
    if (builder_chance(b, 0.5f))
        builder_rod(b, f, (float[]){0.7f * r, 0.5f * tall}, (float[]){0, 0, 0.5f * tall}, m);
    else
        builder_box(b, f, (float[]){0.65f * r, 0.65f * r, 0.5f * tall},
                    (float[]){0, 0, 0.5f * tall}, m);
    builder_box(b, f, (float[]){0.8f * r, 0.8f * r, 0.03f}, (float[]){0, 0, 0.03f}, m);
    struct frame on = builder_frame(f, 0, 0, tall, twist);
    clutter_one(b, &on, 0.75f * r);
}

void furniture_set(struct builder *b, const struct frame *f, const float half[2], float height)
{
    const float top[2] = {half[0] - 0.35f, half[1] - 0.35f};
    if (builder_chance(b, 0.5f))
        round_table(b, f, top, height);
    else
        table(b, f, top, height);
    int n = 2 + builder_pick(b, 3);
    for (int i = 0; i < n; i++) {
        float angle = 0.5f * PI * (float)i + builder_draw(b, -0.2f, 0.2f), c, s;
        builder_turn(0.5f * PI * (float)i, &c, &s);
        float x = s * (half[0] - 0.22f), y = -c * (half[1] - 0.22f);
        struct frame at = builder_frame(f, x, y, 0, angle);
        furniture_chair(b, &at);
    }
}

/* ---- on walls, and lamps ------------------------------------------------------------------- */

static void clock_face(struct builder *b, const struct frame *f, float r)
{
    int m = builder_material(b, ROLE_POSTER), dark = builder_material(b, ROLE_METAL);
    builder_add(
        b, f,
        &(struct part){
            WORLD_FRUSTUM, {r, r, 0.012f}, {0, 0.012f, 0}, m, 1.0f, {0.5f * PI, 0, 0}, CUT_RANDOM});
    builder_add(b, f,
                &(struct part){WORLD_TORUS,
                               {r, 0.018f, 0},
                               {0, 0.02f, 0},
                               b->timber,
                               0,
                               {0.5f * PI, 0, 0},
                               CUT_RANDOM});
    for (int i = 0; i < 2; i++) {
        float angle = builder_draw(b, 0, 2 * PI), c, s, length = (i ? 0.4f : 0.28f) * r;
        builder_turn(angle, &c, &s);
        builder_add(b, f,
                    &(struct part){WORLD_BOX,
                                   {0.03f * r, 0.003f, length},
                                   {length * s, 0.03f, length * c},
                                   dark,
                                   0,
                                   {0, angle, 0},
                                   CUT_RANDOM});
    }
}

void furniture_picture(struct builder *b, const struct frame *f, const float half[2])
{
    if (builder_chance(b, 0.12f)) {
        clock_face(b, f, builder_least(half[0], half[1]));
        return;
    }
    int m = builder_material(b, ROLE_POSTER);
    struct world_material *k = &b->w->materials[m];
    k->albedo.scale = 2.0f * (k->albedo.kind == TEXTURE_PRINT ? half[1] : 0.5f * half[0]);
    if (b->mirrors && builder_chance(b, 0.6f)) {
        k->specular = 0.9f;
        k->roughness = 0.0f;
    }
    float rim = builder_chance(b, 0.75f) ? builder_draw(b, 0.015f, 0.06f) : 0.0f;
    builder_add(
        b, f,
        &(struct part){
            WORLD_BOX, {half[0], 0.008f, half[1]}, {0, 0.008f, 0}, m, 0, {0, 0, 0}, CUT_CORNER});
    if (rim == 0.0f)
        return;
    int wood = builder_timber(b);
    for (int i = -1; i <= 1; i += 2) {
        builder_box(b, f, (float[]){half[0] + 2 * rim, 0.015f, rim},
                    (float[]){0, 0.015f, (float)i * (half[1] + rim)}, wood);
        builder_box(b, f, (float[]){rim, 0.015f, half[1]},
                    (float[]){(float)i * (half[0] + rim), 0.015f, 0}, wood);
    }
}

void furniture_floor_lamp(struct builder *b, const struct frame *f, float radiance)
{
    int m = builder_material(b, ROLE_METAL), style = builder_pick(b, 3);
    float tall = builder_draw(b, 0.6f, 0.8f), r = builder_draw(b, 0.13f, 0.22f);
    float taper = builder_draw(b, 0.5f, 1.0f), z = 2 * tall + r;
    builder_rod(b, f, (float[]){0.15f, 0.015f}, (float[]){0, 0, 0.015f}, m);
    builder_rod(b, f, (float[]){0.013f, tall}, (float[]){0, 0, tall}, m);
    struct part p = {.shape = style == 0 ? WORLD_ELLIPSOID : WORLD_FRUSTUM,
                     .size = {r, r, style == 0 ? r : 0.13f},
                     .at = {0, 0, style == 0 ? z : 2 * tall + 0.13f},
                     .taper = taper};
    if (style == 2) { // a cloth shade that lets no light through, its bulb below
        p.material = builder_material(b, ROLE_CLOTH);
        builder_add(b, f, &p);
        p = (struct part){.shape = WORLD_ELLIPSOID,
                          .size = {0.035f, 0.035f, 0.05f},
                          .at = {0.06f, 0, 2 * tall - 0.06f}};
        radiance *= 18.0f;
    }
    p.material = builder_glow(b, radiance, 0.15f);
    builder_lamp(b, builder_add(b, f, &p));
}

void furniture_size(struct builder *b, const struct piece *p, float half[2], float *height)
{
    half[0] = builder_draw(b, p->lo[0], p->hi[0]);
    half[1] = builder_draw(b, p->lo[1], p->hi[1]);
    *height = builder_draw(b, p->lo[2], p->hi[2]);
}

const struct piece furniture_wall[FURNITURE_WALL] = {
    {shelf, {0.35f, 0.14f, 0.9f}, {0.8f, 0.18f, 2.1f}},
    {shelf, {0.35f, 0.14f, 1.5f}, {0.6f, 0.18f, 2.1f}},
    {cupboard, {0.3f, 0.2f, 0.6f}, {0.8f, 0.3f, 1.1f}},
    {cupboard, {0.35f, 0.25f, 1.6f}, {0.7f, 0.3f, 2.1f}},
    {table, {0.4f, 0.25f, 0.7f}, {0.8f, 0.36f, 0.8f}},
    {cartons, {0.22f, 0.2f, 0.4f}, {0.4f, 0.3f, 1.2f}},
    {plant_pot, {0.2f, 0.2f, 0.6f}, {0.4f, 0.4f, 1.5f}},
};

const struct piece furniture_middle[FURNITURE_MIDDLE] = {
    {furniture_set, {0.8f, 0.75f, 0.68f}, {1.2f, 0.95f, 0.78f}},
    {table, {0.4f, 0.35f, 0.4f}, {0.8f, 0.5f, 0.75f}},
    {column, {0.2f, 0.2f, 1.2f}, {0.3f, 0.3f, 1.9f}},
    {sofa, {0.5f, 0.42f, 0.75f}, {1.1f, 0.5f, 0.95f}},
    {bed, {0.5f, 0.95f, 0.7f}, {0.85f, 1.05f, 1.1f}},
};
