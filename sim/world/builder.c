/* Random numbers: splitmix64 (Steele, Lea, Flood, OOPSLA 2014), so that a world depends on its
 * seed alone. A material is drawn from the row of its role: kind of texture, size, and a palette
 * of a light, a dark and an accent colour in hue, saturation, value. Solids come in frames that
 * turn about z only; a part may lean in addition. Areas of the floor are rectangles; one is taken
 * if it overlaps none. */
#include "sim/world/builder.h"

#include "core/base/splitmix.h"

#include <math.h>
#include <string.h>

float builder_draw(struct builder *b, float lo, float hi)
{
    return lo + (hi - lo) * ((float)(splitmix_next(&b->state) >> 40) * (1.0f / 16777216.0f));
}

int builder_pick(struct builder *b, int n)
{
    int i = (int)builder_draw(b, 0.0f, (float)n);
    return i < n ? i : n - 1;
}

bool builder_chance(struct builder *b, float share)
{
    return builder_draw(b, 0.0f, 1.0f) < share;
}

/* Taylor's series on -pi..pi; libm's last digit differs between machines. */
void builder_turn(float angle, float *c, float *s)
{
    double turns = (double)angle / 6.283185307179586;
    double x = ((double)angle - 6.283185307179586 * floor(turns + 0.5)) / 8.0;
    double term = 1.0, sum[2] = {0.0, 0.0}; // even and odd powers
    for (int k = 1; k < 16; k++) {
        sum[(k - 1) & 1] += ((k - 1) & 2) ? -term : term;
        term *= x / k;
    }
    for (int k = 0; k < 3; k++) { // three doublings
        double even = sum[0] * sum[0] - sum[1] * sum[1];
        sum[1] = 2.0 * sum[0] * sum[1];
        sum[0] = even;
    }
    *c = (float)sum[0];
    *s = (float)sum[1];
}

float builder_power(float octaves)
{
    double x = octaves < -60.0f ? -60.0 : (octaves < 60.0f ? (double)octaves : 60.0);
    double y = floor(x), rest = (x - y) * 0.6931471805599453, sum = 0.0, term = 1.0;
    for (int k = 1; k < 16; k++) {
        sum += term;
        term *= rest / k;
    }
    return (float)ldexp(sum, (int)y);
}

/* Linear colour of hue (any number, whole turns), saturation and value. */
static void colour_from_hsv(float hue, float saturation, float value, float out[3])
{
    hue -= floorf(hue);
    for (int c = 0; c < 3; c++) {
        float h = 6.0f * hue + (c == 0 ? 0.0f : (c == 1 ? 4.0f : 2.0f));
        h -= 6.0f * floorf(h / 6.0f);
        float ramp = fabsf(h - 3.0f) - 1.0f;
        ramp = ramp < 0.0f ? 0.0f : (ramp > 1.0f ? 1.0f : ramp);
        out[c] = value * (1.0f - saturation * (1.0f - ramp));
    }
}

struct range {
    float lo, hi;
};

struct look {
    uint8_t kinds[4]; // enum texture_kind
    struct range scale, contrast, hue, saturation, light, dark, specular, roughness;
};

#define N TEXTURE_NOISE
#define C TEXTURE_CHECKER
#define B TEXTURE_BRICK
#define T TEXTURE_TILES
#define W TEXTURE_WOOD
#define F TEXTURE_FABRIC
#define P TEXTURE_PRINT
#define S TEXTURE_SPOTS

static const struct look LOOK[ROLE_COUNT] = {
    [ROLE_WALL] = {{N, B, F, T},
                   {.2f, .8f},
                   {.3f, .9f},
                   {0, 1},
                   {.02f, .4f},
                   {.55f, .85f},
                   {.2f, .6f},
                   {0, 0},
                   {1, 1}},
    [ROLE_FLOOR] = {{W, T, S, C},
                    {.1f, .45f},
                    {.3f, .9f},
                    {0, .17f},
                    {.1f, .6f},
                    {.3f, .65f},
                    {.06f, .3f},
                    {.02f, .06f},
                    {.05f, .5f}},
    [ROLE_CEILING] = {{N, W, T, N},
                      {.2f, .7f},
                      {.3f, .8f},
                      {.05f, .2f},
                      {.02f, .2f},
                      {.7f, .88f},
                      {.4f, .7f},
                      {0, 0},
                      {1, 1}},
    [ROLE_TIMBER] = {{W, W, W, N},
                     {.06f, .22f},
                     {.4f, 1},
                     {.02f, .1f},
                     {.3f, .7f},
                     {.2f, .6f},
                     {.03f, .2f},
                     {0, .05f},
                     {.1f, .6f}},
    [ROLE_PAINTED] = {{N, T, S, W},
                      {.08f, .4f},
                      {.3f, .9f},
                      {0, 1},
                      {.2f, .85f},
                      {.3f, .8f},
                      {.04f, .3f},
                      {0, .06f},
                      {.1f, .6f}},
    [ROLE_CLOTH] = {{F, F, S, C},
                    {.06f, .3f},
                    {.4f, 1},
                    {0, 1},
                    {.2f, .85f},
                    {.35f, .8f},
                    {.03f, .3f},
                    {0, 0},
                    {1, 1}},
    [ROLE_RUG] = {{F, F, T, S},
                  {.15f, .6f},
                  {.4f, 1},
                  {0, 1},
                  {.3f, .85f},
                  {.3f, .7f},
                  {.03f, .25f},
                  {0, 0},
                  {1, 1}},
    [ROLE_BOOK] = {{P, P, F, N},
                   {.04f, .2f},
                   {.3f, .9f},
                   {0, 1},
                   {.2f, .9f},
                   {.2f, .8f},
                   {.02f, .3f},
                   {0, .05f},
                   {.1f, .5f}},
    [ROLE_POSTER] = {{P, P, S, T},
                     {.15f, .6f},
                     {.4f, 1},
                     {0, 1},
                     {.3f, .9f},
                     {.5f, .88f},
                     {.02f, .2f},
                     {0, .04f},
                     {.02f, .3f}},
    [ROLE_CERAMIC] = {{N, T, F, S},
                      {.03f, .14f},
                      {.3f, 1},
                      {0, 1},
                      {.1f, .9f},
                      {.4f, .85f},
                      {.03f, .4f},
                      {.03f, .08f},
                      {.02f, .2f}},
    [ROLE_METAL] = {{N, N, S, T},
                    {.05f, .3f},
                    {.2f, .6f},
                    {.05f, .15f},
                    {0, .4f},
                    {.2f, .5f},
                    {.05f, .2f},
                    {.2f, .6f},
                    {.1f, .5f}},
    [ROLE_CARTON] = {{P, N, P, T},
                     {.15f, .5f},
                     {.3f, .8f},
                     {.06f, .11f},
                     {.3f, .6f},
                     {.35f, .6f},
                     {.03f, .3f},
                     {0, 0},
                     {1, 1}},
    [ROLE_LEAF] = {{S, N, S, N},
                   {.03f, .16f},
                   {.6f, 1},
                   {.14f, .4f},
                   {.5f, .9f},
                   {.15f, .5f},
                   {.02f, .1f},
                   {0, .04f},
                   {.3f, .6f}},
    [ROLE_BARK] = {{N, W, N, B},
                   {.06f, .2f},
                   {.7f, 1},
                   {.03f, .1f},
                   {.2f, .5f},
                   {.15f, .35f},
                   {.03f, .1f},
                   {0, 0},
                   {1, 1}},
    [ROLE_GROUND] = {{N, S, T, N},
                     {.2f, .9f},
                     {.6f, 1},
                     {.08f, .32f},
                     {.15f, .7f},
                     {.25f, .5f},
                     {.05f, .2f},
                     {0, 0},
                     {1, 1}},
    [ROLE_STONE] = {{N, S, B, T},
                    {.1f, .5f},
                    {.5f, 1},
                    {.02f, .15f},
                    {.02f, .3f},
                    {.3f, .65f},
                    {.05f, .3f},
                    {0, .04f},
                    {.2f, .6f}},
};

#undef N
#undef C
#undef B
#undef T
#undef W
#undef F
#undef P
#undef S

static float draw_range(struct builder *b, struct range r)
{
    return builder_draw(b, r.lo, r.hi);
}

/* Hue within a range; of those that may be anything half are between red and yellow, as of clay,
 * timber and most paint. */
static float draw_hue(struct builder *b, struct range r)
{
    float hue = draw_range(b, r), choice = builder_draw(b, 0.0f, 1.0f);
    if (r.hi - r.lo < 0.9f || choice > 0.75f)
        return hue;
    return choice < 0.5f ? 0.98f + 0.15f * hue : 0.53f + 0.13f * hue;
}

int builder_material(struct builder *b, enum builder_role role)
{
    struct world *w = b->w;
    if (w->n_materials >= WORLD_MATERIALS - WORLD_LIGHTS) // the rest is for lamps
        return builder_pick(b, WORLD_MATERIALS - WORLD_LIGHTS);
    struct world_material *m = &w->materials[w->n_materials];
    const struct look *k = &LOOK[role];
    memset(m, 0, sizeof *m);
    m->albedo.kind = b->plain ? TEXTURE_FLAT : (enum texture_kind)k->kinds[builder_pick(b, 4)];
    m->albedo.seed = (uint32_t)builder_draw(b, 0.0f, 16777216.0f);
    m->albedo.scale = draw_range(b, k->scale);
    m->albedo.contrast = draw_range(b, k->contrast);
    float hue = draw_hue(b, k->hue), saturation = draw_range(b, k->saturation);
    colour_from_hsv(hue, saturation, draw_range(b, k->light), m->albedo.colour[0]);
    float other = hue + builder_draw(b, -0.07f, 0.07f);
    colour_from_hsv(other, saturation, draw_range(b, k->dark), m->albedo.colour[1]);
    float accent = builder_chance(b, 0.5f) ? hue + 0.5f : draw_hue(b, (struct range){0, 1});
    if (k->hue.hi - k->hue.lo < 0.3f) // what is not painted
        accent = hue + builder_draw(b, -0.06f, 0.06f);
    colour_from_hsv(accent, fminf(1.5f * saturation, 0.9f),
                    builder_draw(b, k->dark.lo, k->light.hi), m->albedo.colour[2]);
    m->specular = draw_range(b, k->specular);
    m->roughness = draw_range(b, k->roughness);
    if (b->mirrors && role != ROLE_CEILING && role != ROLE_WALL && builder_chance(b, 0.35f)) {
        m->specular = builder_draw(b, 0.4f, 0.9f);
        m->roughness = builder_chance(b, 0.6f) ? 0.0f : builder_draw(b, 0.0f, 0.15f);
    }
    return w->n_materials++;
}

int builder_timber(struct builder *b)
{
    if (builder_chance(b, 0.4f))
        return b->timber;
    return builder_material(b, builder_chance(b, 0.7f) ? ROLE_TIMBER : ROLE_PAINTED);
}

int builder_glow(struct builder *b, float radiance, float cold)
{
    struct world *w = b->w;
    if (w->n_materials >= WORLD_MATERIALS)
        return w->n_materials - 1;
    struct world_material *m = &w->materials[w->n_materials];
    *m = (struct world_material){.roughness = 1.0f};
    m->albedo = (struct texture){.scale = 0.1f, .colour[0] = {0.6f, 0.6f, 0.6f}};
    m->emission[0] = radiance * (1.3f - 0.6f * cold);
    m->emission[1] = radiance;
    m->emission[2] = radiance * (0.4f + 1.2f * cold);
    return w->n_materials++;
}

struct frame builder_frame(const struct frame *in, float x, float y, float z, float angle)
{
    float c, s;
    builder_turn(angle, &c, &s);
    struct frame f;
    f.at[0] = in->at[0] + in->c * x - in->s * y;
    f.at[1] = in->at[1] + in->s * x + in->c * y;
    f.at[2] = in->at[2] + z;
    f.c = in->c * c - in->s * s;
    f.s = in->s * c + in->c * s;
    return f;
}

/* Rotation of a part in the world: about x, y, z by `turn`, then by the frame about z. */
static void part_rotation(const struct frame *f, const float turn[3], float r[9])
{
    float cx, sx, cy, sy, cz, sz;
    builder_turn(turn[0], &cx, &sx);
    builder_turn(turn[1], &cy, &sy);
    builder_turn(turn[2], &cz, &sz);
    float c = f->c * cz - f->s * sz, s = f->s * cz + f->c * sz;
    r[0] = c * cy;
    r[1] = c * sy * sx - s * cx;
    r[2] = c * sy * cx + s * sx;
    r[3] = s * cy;
    r[4] = s * sy * sx + c * cx;
    r[5] = s * sy * cx - c * sx;
    r[6] = -sy;
    r[7] = cy * sx;
    r[8] = cy * cx;
}

int builder_add(struct builder *b, const struct frame *f, const struct part *p)
{
    struct world *w = b->w;
    if (w->n_solids >= WORLD_SOLIDS)
        return -1;
    struct world_solid *s = &w->solids[w->n_solids];
    memset(s, 0, sizeof *s);
    s->shape = p->shape;
    s->taper = p->taper;
    s->material = p->material;
    part_rotation(f, p->turn, s->r);
    s->t[0] = f->at[0] + f->c * p->at[0] - f->s * p->at[1];
    s->t[1] = f->at[1] + f->s * p->at[0] + f->c * p->at[1];
    s->t[2] = f->at[2] + p->at[2];
    for (int i = 0; i < 3; i++) {
        s->size[i] = fmaxf(p->size[i], 1e-3f);
        s->origin[i] = p->cut == CUT_JOINED   ? p->at[i]
                       : p->cut == CUT_CORNER ? p->size[i]
                                              : builder_draw(b, -20.0f, 20.0f);
    }
    return w->n_solids++;
}

int builder_box(struct builder *b, const struct frame *f, const float size[3], const float at[3],
                int material)
{
    const struct part p = {.shape = WORLD_BOX,
                           .size = {size[0], size[1], size[2]},
                           .at = {at[0], at[1], at[2]},
                           .material = material};
    return builder_add(b, f, &p);
}

int builder_rod(struct builder *b, const struct frame *f, const float size[2], const float at[3],
                int material)
{
    const struct part p = {.shape = WORLD_FRUSTUM,
                           .size = {size[0], size[0], size[1]},
                           .at = {at[0], at[1], at[2]},
                           .material = material,
                           .taper = 1.0f};
    return builder_add(b, f, &p);
}

void builder_lamp(struct builder *b, int solid)
{
    struct world *w = b->w;
    if (solid < 0 || w->n_lights >= WORLD_LIGHTS)
        return;
    w->lights[w->n_lights] = (struct world_light){.solid = solid};
    w->n_lights++;
}

bool builder_claim(struct builder *b, float x, float y, const float half[2])
{
    const struct area a = {{x - half[0], y - half[1]}, {x + half[0], y + half[1]}};
    for (int i = 0; i < b->n_areas; i++) {
        const struct area *o = &b->areas[i];
        if (a.lo[0] < o->hi[0] && o->lo[0] < a.hi[0] && a.lo[1] < o->hi[1] && o->lo[1] < a.hi[1])
            return false;
    }
    if (b->n_areas >= BUILDER_AREAS)
        return false;
    b->areas[b->n_areas++] = a;
    return true;
}
