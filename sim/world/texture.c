/* A pattern is drawn in the plane that the normal faces most (u, v; v is up on upright surfaces):
 * cells are numbered, and a hash of the number gives each brick, plank or letter its own look.
 * Lines are drawn by their distance over the footprint, cells smaller than the footprint become
 * their mean. On top lies a grain of value noise in the three coordinates, in octaves of which
 * those finer than the footprint are left out.
 * Value noise and sums of octaves: Ebert et al., Texturing and Modeling (2003), chapter 2. Cells of
 * random points: Worley, A Cellular Texture Basis Function (SIGGRAPH 1996). The hash is one round
 * of multiply and shift over the products of the coordinates with odd numbers. */
#include "sim/world/texture.h"

#include <math.h>
#include <stdbool.h>

static const float FAR = 1e4f;          // m, coordinates are clamped to
static const float SCALE_MIN = 1e-3f;   // m; FAR / SCALE_MIN * 64 fits an int
static const float WIDTH_MIN = 1e-6f;   // m, of the footprint
static const float WIDTH_MAX = 1e4f;    // m
static const float REFLECT_LO = 0.005f; // bounds of the result
static const float REFLECT_HI = 0.95f;

struct point {
    const struct texture *t;
    float p[3], u, v;             // m
    uint32_t seed, face;          // for the texture; and for the side of the solid
    float width, scale, contrast; // footprint, m; m; 0..1
};

static float clamp(float x, float lo, float hi)
{
    return x > lo ? (x < hi ? x : hi) : lo; // NaN: lo
}

/* The integer part, rounded down, for |x| < 2^31. */
static int floor_int(float x)
{
    int i = (int)x;
    return i - (x < (float)i);
}

static uint32_t mix_bits(uint32_t h)
{
    h = (h ^ (h >> 16)) * 0x7feb352du;
    h = (h ^ (h >> 15)) * 0x846ca68bu;
    return h ^ (h >> 16);
}

static uint32_t hash_cell(int i, int j, uint32_t seed)
{
    return mix_bits((uint32_t)i * 0x8da6b343u + (uint32_t)j * 0xd8163841u + seed);
}

/* 0..1 from the upper bits; unit(h * odd) is another number. */
static float unit_from_hash(uint32_t h)
{
    return (float)(h >> 8) * (1.0f / 16777216.0f);
}

static float mix_values(float a, float b, float t)
{
    return a + (b - a) * t;
}

static void mix3(const float a[3], const float b[3], float t, float out[3])
{
    for (int c = 0; c < 3; c++)
        out[c] = mix_values(a[c], b[c], t);
}

static float smooth_step(float t)
{
    return t * t * (3.0f - 2.0f * t);
}

/* 1 where `size` is well above the footprint, 0 where it is below. */
static float visibility_of(const struct point *s, float size)
{
    return clamp((size - s->width) / (0.75f * size), 0.0f, 1.0f);
}

/* Share of the footprint on the positive side of a border at the distance d. */
static float border_share(const struct point *s, float d)
{
    return clamp(d / s->width + 0.5f, 0.0f, 1.0f);
}

/* Share of the footprint in a strip of that half width, x from its middle. */
static float strip_share(const struct point *s, float x, float half)
{
    return border_share(s, half + x) - border_share(s, x - half);
}

static float corner_value(uint32_t h)
{
    h = (h ^ (h >> 15)) * 0x2c1b3c6du;
    return (float)(int32_t)(h ^ (h >> 13)); // -2^31 .. 2^31
}

/* Value noise, -1..1. */
static float noise3(float x, float y, float z, uint32_t seed)
{
    int i = floor_int(x), j = floor_int(y), k = floor_int(z);
    float a = smooth_step(x - (float)i), b = smooth_step(y - (float)j),
          c = smooth_step(z - (float)k);
    uint32_t x0 = (uint32_t)i * 0x8da6b343u + seed, x1 = x0 + 0x8da6b343u;
    uint32_t y0 = (uint32_t)j * 0xd8163841u, y1 = y0 + 0xd8163841u;
    uint32_t z0 = (uint32_t)k * 0xcb1ab31fu, z1 = z0 + 0xcb1ab31fu;
    float low =
        mix_values(mix_values(corner_value(x0 ^ y0 ^ z0), corner_value(x1 ^ y0 ^ z0), a),
                   mix_values(corner_value(x0 ^ y1 ^ z0), corner_value(x1 ^ y1 ^ z0), a), b);
    float high =
        mix_values(mix_values(corner_value(x0 ^ y0 ^ z1), corner_value(x1 ^ y0 ^ z1), a),
                   mix_values(corner_value(x0 ^ y1 ^ z1), corner_value(x1 ^ y1 ^ z1), a), b);
    return mix_values(low, high, c) * (1.0f / 2147483648.0f);
}

static float noise2(float x, float y, uint32_t seed)
{
    int i = floor_int(x), j = floor_int(y);
    float a = smooth_step(x - (float)i), b = smooth_step(y - (float)j);
    uint32_t x0 = (uint32_t)i * 0x8da6b343u + seed, x1 = x0 + 0x8da6b343u;
    uint32_t y0 = (uint32_t)j * 0xd8163841u, y1 = y0 + 0xd8163841u;
    return mix_values(mix_values(corner_value(x0 ^ y0), corner_value(x1 ^ y0), a),
                      mix_values(corner_value(x0 ^ y1), corner_value(x1 ^ y1), a), b) *
           (1.0f / 2147483648.0f);
}

/* Noise with cells of that size, 0 where they are below the footprint. */
static float octave(const struct point *s, float size, uint32_t salt)
{
    float keep = visibility_of(s, size);
    if (keep <= 0.0f)
        return 0.0f;
    float f = 1.0f / size;
    return keep * noise3(s->p[0] * f, s->p[1] * f, s->p[2] * f, s->seed + salt * 0x9e3779b9u);
}

static float octaves(const struct point *s, float size, int n, uint32_t salt)
{
    float sum = 0.0f, part = 0.55f;
    for (int i = 0; i < n; i++) {
        sum += part * octave(s, size, salt + (uint32_t)i);
        size *= 0.43f;
        part *= 0.62f;
    }
    return sum;
}

static void flat_texture(const struct point *s, float out[3])
{
    mix3(s->t->colour[0], s->t->colour[0], 0.0f, out);
}

/* Plaster, stone or marble: the same sums of noise, as they are, in steps, or as veins. */
static void clouds_texture(const struct point *s, float out[3])
{
    float a = octaves(s, s->scale, 5, 1), b = octave(s, s->scale * 0.61f, 17);
    float strong = 0.4f + 0.6f * s->contrast;
    float t = 0.5f + strong * a;
    if (s->seed % 3 == 1) // patches with soft borders
        t = 0.5f + strong * clamp(5.0f * (a + 0.2f * b), -0.7f, 0.7f);
    else if (s->seed % 3 == 2) // veins where the sum crosses zero
        t = 1.0f -
            strong * mix_values(0.25f, clamp(1.0f - 7.0f * fabsf(a), 0.0f, 1.0f),
                                visibility_of(s, 0.4f * s->scale)) +
            0.25f * strong * b;
    mix3(s->t->colour[0], s->t->colour[1], clamp(t, 0.0f, 1.0f), out);
    mix3(out, s->t->colour[2], clamp(strong * (b + 0.4f * a - 0.1f), 0.0f, 0.8f), out);
}

static void checker_texture(const struct point *s, float out[3])
{
    float u = s->u / s->scale, v = s->v / s->scale;
    int i = floor_int(u), j = floor_int(v);
    uint32_t h = hash_cell(i, j, s->face);
    float du = 0.5f - fabsf(u - (float)i - 0.5f), dv = 0.5f - fabsf(v - (float)j - 0.5f);
    float near = border_share(s, (du < dv ? du : dv) * s->scale); // 0.5 on the border: half of each
    float t = ((i + j) & 1) != 0 ? near : 1.0f - near;
    float keep = visibility_of(s, s->scale);
    mix3(s->t->colour[0], s->t->colour[1], mix_values(0.5f, t, keep), out);
    float own = 1.0f + keep * 0.5f * s->contrast * (unit_from_hash(h) - 0.5f);
    for (int c = 0; c < 3; c++)
        out[c] *= own;
    float dirt = octaves(s, s->scale * 1.9f, 2, 31) - 0.1f;
    mix3(out, s->t->colour[2], clamp(1.2f * s->contrast * dirt, 0.0f, 0.6f), out);
}

static void brick_texture(const struct point *s, float out[3])
{
    const struct texture *t = s->t;
    float height = s->scale * (0.28f + 0.25f * unit_from_hash(s->seed * 0x9e3779b9u));
    float joint = height * (0.05f + 0.12f * unit_from_hash(s->seed * 0x85ebca6bu));
    float v = s->v / height;
    int j = floor_int(v);
    bool stone = (s->seed & 4) != 0; // courses shifted at random
    float shift = stone ? unit_from_hash(hash_cell(j, 7, s->face)) : 0.5f * (float)(j & 1);
    float u = s->u / s->scale + shift;
    int i = floor_int(u);
    uint32_t h = hash_cell(i, j, s->face);
    float du = (0.5f - fabsf(u - (float)i - 0.5f)) * s->scale;
    float dv = (0.5f - fabsf(v - (float)j - 0.5f)) * height;
    float rough = octave(s, height * 0.35f, 41);
    float gap = strip_share(s, du < dv ? du : dv, joint * (0.5f + 0.4f * rough));

    float mean[3], own[3];
    mix3(t->colour[0], t->colour[1], 0.325f, mean);
    mix3(t->colour[0], t->colour[1],
         unit_from_hash(h) * (0.3f + 0.7f * unit_from_hash(h * 0x9e3779b1u)), own);
    float tone = 1.0f + (0.3f + 0.9f * s->contrast) * (unit_from_hash(h * 0x85ebca77u) - 0.5f);
    for (int c = 0; c < 3; c++)
        own[c] *= tone;
    mix3(mean, own, visibility_of(s, height), own);
    float share = joint / height + joint / s->scale; // share of mortar
    mix3(own, t->colour[2], mix_values(share, gap, visibility_of(s, height)), out);
}

/* Whether and how far (x, y), -0.5..0.5, lies inside of the motif `h` of a tile. */
static float motif_share(float x, float y, uint32_t h)
{
    if (h & 8)
        x = -x;
    float ax = fabsf(x), ay = fabsf(y), r = 0.18f + 0.2f * unit_from_hash(h * 0x9e3779b1u);
    switch (h & 7) {
    case 0:
        return r - sqrtf(x * x + y * y);
    case 1:
        return r - (ax + ay);
    case 2: // two quarter rings
    case 3: {
        float dx = 0.5f - ax, dy = 0.5f - ay;
        float ring = sqrtf(dx * dx + dy * dy);
        return x * y > 0.0f ? 0.09f - fabsf(ring - 0.5f) : -0.1f;
    }
    case 4:
        return 0.1f - (ax < ay ? ax : ay);
    case 5:
        return x + y;
    case 6:
        return 0.06f - fabsf(sqrtf(x * x + y * y) - r);
    default:
        return 0.3f * r - fabsf(ax - ay);
    }
}

static void tiles_texture(const struct point *s, float out[3])
{
    const struct texture *t = s->t;
    float size = s->scale, u = s->u / size, v = s->v / size;
    int i = floor_int(u), j = floor_int(v);
    uint32_t h = hash_cell(i, j, s->face);
    float x = u - (float)i - 0.5f, y = v - (float)j - 0.5f;
    float joint = 0.02f + 0.03f * unit_from_hash(s->seed * 0x85ebca6bu);
    float own[3], mark[3], mean[3];
    mix3(t->colour[0], t->colour[1], 0.325f, mean);
    mix3(t->colour[0], t->colour[1], unit_from_hash(h) * unit_from_hash(h * 0x9e3779b1u) * 1.3f,
         own);
    float tone = 1.0f + (0.1f + 0.8f * s->contrast) * (unit_from_hash(h * 0x85ebca77u) - 0.5f);
    mix3(t->colour[1], t->colour[2], unit_from_hash(h * 0xc2b2ae35u), mark);
    uint32_t share = s->seed % 3; // motifs on none, a third, all
    uint32_t m = mix_bits(h + 3);
    bool has = share == 2 || (share == 1 && m % 3 == 0);
    if (has) {
        uint32_t shape = (s->seed & 64) ? s->seed >> 8 : m;
        mix3(own, mark, border_share(s, motif_share(x, y, shape) * size), own);
    }
    for (int c = 0; c < 3; c++)
        own[c] *= tone;
    float d = 0.5f - (fabsf(x) > fabsf(y) ? fabsf(x) : fabsf(y)), keep = visibility_of(s, size);
    mix3(mean, own, keep, own);
    const float dark[3] = {0.4f * mean[0], 0.4f * mean[1], 0.4f * mean[2]};
    mix3(own, dark, mix_values(2.0f * joint, strip_share(s, d * size, 0.5f * joint * size), keep),
         out);
}

/* Planks along u, in every second texture along v. Rings are bands across the plank, bent by noise
 * and by a knot. */
static void wood_texture(const struct point *s, float out[3])
{
    const struct texture *t = s->t;
    bool upright = (s->seed & 2) != 0;
    float wide = s->scale, v = (upright ? s->u : s->v) / wide;
    int j = floor_int(v);
    uint32_t row = hash_cell(j, 3, s->face);
    float length = 7.0f + 5.0f * unit_from_hash(row);
    float u = (upright ? s->v : s->u) / wide / length + unit_from_hash(row * 0x9e3779b1u);
    int i = floor_int(u);
    uint32_t h = hash_cell(i, j, s->face + 1);
    float x = (u - (float)i) * length, y = v - (float)j; // in widths of the plank

    float kx = x - length * (0.2f + 0.6f * unit_from_hash(h)),
          ky = y - unit_from_hash(h * 0x85ebca77u);
    float knot = 1.0f / (1.0f + 14.0f * (0.15f * kx * kx + ky * ky));
    float turn = unit_from_hash(h * 0xc2b2ae35u) * 61.0f;
    float bend = noise2(0.45f * x + turn, 0.9f * y + turn, s->seed) + 1.6f * knot;
    float ring = 4.0f * (y * (0.6f + unit_from_hash(h * 0x27d4eb2fu)) + bend) + turn;
    ring = fabsf(ring - (float)floor_int(ring) - 0.5f) * 2.0f;
    float keep = visibility_of(s, wide * 0.2f);
    float fibre = 0.0f;
    for (int o = 0; o < 2; o++) {
        float f = o ? 23.0f : 9.0f, k = visibility_of(s, wide / f);
        if (k > 0.0f)
            fibre += k * noise2(x * f * 0.07f + turn, y * f, s->seed + 5 + (uint32_t)o);
    }
    float grain = mix_values(0.333f, ring * ring, keep) + 0.35f * fibre;
    float dark = (0.25f + 0.75f * s->contrast) * grain + 0.8f * keep * clamp(knot - 0.75f, 0, 1);
    mix3(t->colour[0], t->colour[1], clamp(dark, 0.0f, 1.0f), out);
    float own = visibility_of(s, wide),
          tone = 1.0f + own * (0.25f + 0.6f * s->contrast) *
                            (unit_from_hash(row * 0x165667b1u + h) - 0.5f);
    float gap = 0.02f + 0.02f * unit_from_hash(s->seed), dv = y < 0.5f ? y : 1.0f - y;
    float du = x < 0.5f * length ? x : length - x;
    float gaps = strip_share(s, (du < dv ? du : dv) * wide, gap * wide);
    for (int c = 0; c < 3; c++)
        out[c] *= tone * (1.0f - 0.75f * mix_values(2.2f * gap, gaps, own));
}

/* Stripes of random width and colour along one coordinate: position in stripe k of a period. */
static void stripe_colour(const struct point *s, float x, uint32_t salt, float out[3])
{
    float period = s->scale, a = x / period;
    int k = floor_int(a);
    float in = a - (float)k;
    bool random = (s->seed & 32) == 0; // else every period looks the same
    uint32_t h = mix_bits(s->seed + salt + (random ? (uint32_t)k * 0x9e3779b9u : 0u));
    float first = 0.25f + 0.35f * unit_from_hash(h),
          second = first + 0.1f + 0.25f * unit_from_hash(h * 0x9e3779b1u);
    const float(*colour)[3] = s->t->colour;
    float b = border_share(s, (in - first) * period), c = border_share(s, (in - second) * period);
    float keep = visibility_of(s, 0.4f * period), mean[3];
    const float *second_colour = colour[1 + (h >> 31)], *third = colour[(h >> 30) & 1 ? 0 : 2];
    mix3(colour[0], second_colour, b, out);
    mix3(out, third, c, out);
    if (random) { // widths and colours of all periods together
        mix3(colour[1], colour[2], 0.72f, mean);
        mix3(colour[0], mean, 0.4f, mean);
    } else
        for (int i = 0; i < 3; i++)
            mean[i] = first * colour[0][i] + (second - first) * second_colour[i] +
                      (1.0f - second) * third[i];
    mix3(mean, out, keep, out);
}

static void fabric_texture(const struct point *s, float out[3])
{
    stripe_colour(s, s->u, 0, out);
    if (s->seed % 3 != 0) { // plaid, or rows of diamonds
        float across[3];
        stripe_colour(s, s->v, 0x51u, across);
        mix3(out, across, 0.5f, out);
    }
    if (s->seed % 5 < 2) {
        float size = 0.5f * s->scale, u = s->u / size, v = s->v / size;
        int i = floor_int(u), j = floor_int(v);
        uint32_t h = hash_cell((s->seed & 128) ? i : 0, j, s->face);
        float d = motif_share(u - (float)i - 0.5f, v - (float)j - 0.5f, h) * size;
        mix3(out, s->t->colour[1 + (h >> 31)], 0.85f * border_share(s, d) * visibility_of(s, size),
             out);
    }
    float thread = s->scale * 0.04f, keep = visibility_of(s, thread);
    if (keep <= 0.0f)
        return;
    float u = s->u / thread, v = s->v / thread;
    int i = floor_int(u), j = floor_int(v);
    float along = ((i + j) & 1) ? u - (float)i : v - (float)j; // over and under
    float high = 4.0f * along * (1.0f - along);
    float own = unit_from_hash(((i + j) & 1) ? hash_cell(i, 1, s->face) : hash_cell(j, 2, s->face));
    float tone = 1.0f + keep * s->contrast * (0.5f * (high - 0.67f) + 0.5f * (own - 0.5f));
    for (int c = 0; c < 3; c++)
        out[c] *= tone;
}

static float distance_outside(float x, float lo, float hi)
{
    return x < lo ? lo - x : (x > hi ? x - hi : 0.0f);
}

/* Distance of (x, y), both 0..1, y up, from the strokes of letter h. */
static float stroke_distance(float x, float y, uint32_t h)
{
    static const float LINE[7][4] = {// x, y: from, to
                                     {0.2f, 0.2f, 0.1f, 0.9f}, {0.8f, 0.8f, 0.1f, 0.9f},
                                     {0.2f, 0.8f, 0.9f, 0.9f}, {0.2f, 0.8f, 0.1f, 0.1f},
                                     {0.2f, 0.8f, 0.5f, 0.5f}, {0.5f, 0.5f, 0.1f, 0.9f},
                                     {0.2f, 0.5f, 0.7f, 0.7f}};
    float best = 1.0f;
    uint32_t set = h % 127 + 1;
    for (int i = 0; i < 7; i++) {
        float dx = distance_outside(x, LINE[i][0], LINE[i][1]),
              dy = distance_outside(y, LINE[i][2], LINE[i][3]);
        float d = dx > dy ? dx : dy;
        if ((set >> i & 1) && d < best)
            best = d;
    }
    if (h >> 31) {
        float d = 0.7f * fabsf(y - 0.1f - 1.33f * (x - 0.2f));
        if (y > 0.1f && y < 0.9f && d < best)
            best = d;
    }
    return best;
}

/* Share of ink in a line of text that is `height` m high; (x, y) in heights, y up. */
static float text_ink(const struct point *s, float height, float x, float y, uint32_t line)
{
    float keep = visibility_of(s, 0.3f * height);
    if (keep <= 0.0f)
        return 0.25f * visibility_of(s, height);
    float a = x / 0.62f;
    int i = floor_int(a);
    uint32_t h = mix_bits(line + (uint32_t)i * 0x9e3779b9u);
    if ((h >> 4) % 6 == 0) // between words
        return 0.0f;
    float stroke = 0.075f - stroke_distance(a - (float)i, 1.3f * y - 0.15f, h);
    return mix_values(0.25f, border_share(s, stroke * height), keep);
}

/* A picture in a box of a page: two hills of noise and a disc. (x, y) 0..1, y up. */
static void picture_texture(const struct point *s, float x, float y, uint32_t h, float out[3])
{
    const struct texture *t = s->t;
    float hill = 0.5f + 0.25f * noise2(3.0f * x, unit_from_hash(h) * 50.0f, h);
    float far = 0.6f + 0.2f * noise2(5.0f * x, unit_from_hash(h * 0x9e3779b1u) * 50.0f, h + 1);
    float dx = x - 0.2f - 0.6f * unit_from_hash(h), dy = y - 0.75f, size = 0.25f * s->scale;
    float disc = 0.12f + 0.1f * unit_from_hash(h * 0x85ebca77u) - sqrtf(dx * dx + dy * dy);
    float sky[3];
    mix3(t->colour[0], t->colour[2], 0.8f * y, sky);
    mix3(sky, t->colour[1 + (h & 1)], border_share(s, disc * size), out);
    mix3(out, t->colour[1], 0.6f * border_share(s, (far - y) * size), out);
    mix3(out, t->colour[2], border_share(s, (hill - y) * size), out);
}

/* Pages, each of rows of four lines: a heading, text in columns, or a picture with a caption. */
static void print_texture(const struct point *s, float out[3])
{
    const struct texture *t = s->t;
    float u = s->u / s->scale, v = s->v / s->scale;
    int i = floor_int(u), j = floor_int(v);
    uint32_t page = hash_cell(i, j, s->face);
    float x = (u - (float)i - 0.06f) / 0.88f, y = (1.0f - v + (float)j - 0.06f) / 0.88f;
    float mean[3], ink[3], paper[3];
    float tint = mix_values(0.175f, (page & 3) == 0 ? 0.7f : 0.0f,
                            visibility_of(s, s->scale)); // one of four
    mix3(t->colour[0], t->colour[2], tint, paper);
    mix3(paper, t->colour[1], 0.2f, mean);
    if (!(x >= 0.0f && x < 1.0f && y >= 0.0f && y < 1.0f)) {
        mix3(mean, paper, visibility_of(s, s->scale), out);
        return;
    }
    float lines = 4.0f * (float)(3 + (page >> 8) % 5), height = 0.88f * s->scale / lines;
    int line = (int)(y * lines), row = line / 4;
    uint32_t h = hash_cell(row, (int)(page >> 16), s->seed);
    float down = y * lines - 4.0f * (float)row; // 0..4 in the row
    float split = 0.3f + 0.4f * unit_from_hash(h * 0x9e3779b1u);
    bool right = x > split;
    mix3(paper, t->colour[1], 0.0f, out);
    mix3(t->colour[1], t->colour[2], (h >> 20) % 3 == 0 ? 1.0f : 0.0f, ink);
    float share = 0.0f;
    if (h % 5 == 0) { // heading
        share = text_ink(s, 3.4f * height, x * lines / 3.4f, 1.0f - down / 3.8f, h);
    } else if ((h % 5 < 3) == right && (h % 5 != 2 || down < 3.6f)) {
        float wide = right ? 1.0f - split : split, from = right ? split : 0.0f;
        picture_texture(s, (x - from) / wide, 1.0f - down / 4.0f, h, out);
    } else {
        int k = (int)down;
        float end = k == 3 ? 0.4f + 0.5f * unit_from_hash(h) : 0.97f;
        if ((right ? x : x / split) < end)
            share = text_ink(s, height, x * lines, 1.0f - down + (float)k, h + (uint32_t)line);
    }
    mix3(out, ink, share, out);
    mix3(mean, out, visibility_of(s, 4.0f * height), out);
}

/* Nearest of the random points of the cells around; out: distances to it and to the next. */
static uint32_t nearest_points(float x, float y, uint32_t seed, float d[2])
{
    int i = floor_int(x), j = floor_int(y);
    uint32_t best = 0;
    d[0] = d[1] = 9.0f;
    for (int k = 0; k < 9; k++) {
        int a = i + k % 3 - 1, b = j + k / 3 - 1;
        uint32_t h = (uint32_t)a * 0x8da6b343u + (uint32_t)b * 0xd8163841u + seed;
        h = (h ^ (h >> 15)) * 0x2c1b3c6du;
        h ^= h >> 13;
        float dx = (float)a + 0.1f + 0.8f * unit_from_hash(h) - x;
        float dy = (float)b + 0.1f + 0.8f * unit_from_hash(h << 11) - y;
        float near = dx * dx + dy * dy;
        bool first = near < d[0];
        d[1] = first ? d[0] : (near < d[1] ? near : d[1]);
        d[0] = first ? near : d[0];
        best = first ? h : best;
    }
    d[0] = sqrtf(d[0]);
    d[1] = sqrtf(d[1]);
    return mix_bits(best);
}

static void spots_texture(const struct point *s, float out[3])
{
    const struct texture *t = s->t;
    float mean[3], own[3];
    mix3(t->colour[0], t->colour[1], 0.4f, mean);
    mix3(mean, t->colour[2], 0.2f, mean);
    for (int c = 0; c < 3; c++)
        out[c] = mean[c];
    float size = s->scale;
    for (int layer = 0; layer < 2; layer++, size *= 0.37f) {
        float keep = visibility_of(s, size), d[2];
        if (keep <= 0.0f)
            return;
        uint32_t h = nearest_points(s->u / size, s->v / size, s->face + (uint32_t)layer, d);
        float a = unit_from_hash(h), cover;
        mix3(t->colour[0], t->colour[1], a, own);
        mix3(own, t->colour[2], (h & 3) == 0 ? 0.8f : 0.0f, own);
        float tone = 1.0f + (0.3f + 0.8f * s->contrast) * (unit_from_hash(h * 0x85ebca77u) - 0.5f);
        for (int c = 0; c < 3; c++)
            own[c] *= tone;
        if (s->seed & 16) // cells side by side with dark gaps; the small ones lie in the gaps
            cover = border_share(s, (0.5f * (d[1] - d[0]) - 0.04f) * size) * (layer ? 0.5f : 1.0f);
        else // round grains of random size
            cover = border_share(s, (0.15f + 0.4f * unit_from_hash(h * 0x9e3779b1u) - d[0]) * size);
        if (layer == 0 && (s->seed & 16))
            mix3(t->colour[2], own, 0.0f, out);
        mix3(out, own, cover * keep, out);
    }
}

/* Fine structure on everything except flat colour: stains above the pattern, grain below it. */
static void add_weathering(const struct point *s, float out[3])
{
    float stain = octave(s, 2.3f * s->scale, 101) + 0.6f * octave(s, 0.71f * s->scale, 102);
    float grain = octave(s, 0.23f * s->scale, 103) + octave(s, 0.067f * s->scale, 104);
    float tone = 1.0f + s->contrast * (0.3f * stain + 0.3f * grain);
    for (int c = 0; c < 3; c++)
        out[c] *= tone;
}

static void project_point(struct point *s, const float p[3], const float n[3])
{
    float a[3];
    for (int i = 0; i < 3; i++) {
        s->p[i] = clamp(p[i], -FAR, FAR);
        a[i] = fabsf(n[i]);
    }
    int axis = a[2] >= a[0] && a[2] >= a[1] ? 2 : (a[0] >= a[1] ? 0 : 1);
    s->u = s->p[axis == 0 ? 1 : 0];
    if ((axis == 1) == (n[axis] > 0.0f)) // so that print reads from left to right from outside
        s->u = -s->u;
    s->v = s->p[axis == 2 ? 1 : 2];
    s->face = s->seed + (uint32_t)axis * 0x27d4eb2fu + (n[axis] < 0.0f ? 0x165667b1u : 0u);
}

/* Overlap of from..to with the cell i, in cells. */
static float cell_overlap(int i, float from, float to)
{
    const float lo = from > (float)i ? from : (float)i, hi = to < (float)i + 1 ? to : (float)i + 1;
    return hi > lo ? hi - lo : 0.0f;
}

/* Black share of the footprint, a square. */
static float black_share(const struct texture_cells *c, const float p[3], float footprint)
{
    const float half = 0.5f * clamp(footprint / c->size, 1e-3f, 16.0f);
    const float w = (float)c->cols, h = (float)c->rows,
                x = clamp(p[0] / c->size + 0.5f * w, -100.0f, w + 100.0f),
                y = clamp(p[1] / c->size + 0.5f * h, -100.0f, h + 100.0f);
    float sum = 0.0f;
    for (int j = floor_int(y - half); (float)j < y + half; j++)
        for (int i = floor_int(x - half); (float)i < x + half; i++)
            if (i >= 0 && i < c->cols && j >= 0 && j < c->rows && c->black[j * c->cols + i])
                sum += cell_overlap(i, x - half, x + half) * cell_overlap(j, y - half, y + half);
    return sum / (4.0f * half * half);
}

void texture_eval(const struct texture *t, const float p[3], const float n[3], float footprint,
                  float out[3])
{
    static void (*const PATTERN[TEXTURE_KINDS])(const struct point *, float *) = {
        flat_texture, clouds_texture, checker_texture, brick_texture, tiles_texture,
        wood_texture, fabric_texture, print_texture,   spots_texture};
    struct point s = {.t = t};
    if (t->cells) {
        mix3(t->colour[0], t->colour[1], black_share(t->cells, p, footprint), out);
        return;
    }
    s.seed = mix_bits(t->seed + 0x9e3779b9u);
    s.width = clamp(footprint, WIDTH_MIN, WIDTH_MAX);
    s.scale = clamp(t->scale, SCALE_MIN, FAR);
    s.contrast = clamp(t->contrast, 0.0f, 1.0f);
    project_point(&s, p, n);
    unsigned kind = (unsigned)t->kind < TEXTURE_KINDS ? (unsigned)t->kind : TEXTURE_FLAT;
    PATTERN[kind](&s, out);
    if (kind != TEXTURE_FLAT && kind != TEXTURE_NOISE)
        add_weathering(&s, out);
    for (int c = 0; c < 3; c++)
        out[c] = clamp(out[c], REFLECT_LO, REFLECT_HI);
}
