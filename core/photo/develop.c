/* A missing colour of a mosaic is the mean of its nearest sites plus a share of the Laplacian of
 * the colour that is there (Malvar, He & Cutler 2004: gains 1/2, 5/8 and 3/4, coefficients of their
 * figure 2). The picture is processed in strips of columns, top down, with a ring of five rows, so
 * that rows are computed only when they are needed. Beyond the border it is mirrored about the
 * outermost site, which preserves the pattern of colours.
 * Numbers are clipped at white before demosaicing: a value that a gain lifts above white would
 * spread its colour over the edges of highlights. Gains are scaled so that the least is 1, so that
 * all three colours reach white where the sensor clips.
 * Display codes come from a table over 2^16 steps of light, finer than the steepest code. */
#include "core/photo/develop.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { STRIP = 256, LIGHT = 65535 };

/* ---- demosaicing ---- */

static int mirror_index(int i, int n)
{
    i = i < 0 ? -i : i;
    i = i >= n ? 2 * (n - 1) - i : i;
    return i < 0 ? -i : i; // n is 2
}

/* Numbers x - 2 .. x + n + 1 of row y. */
static void load_row(const struct develop_mosaic *m, int y, int x, int n, float *v)
{
    int lo = x < 2 ? 0 : x - 2, hi = num_min(m->w, x + n + 2);
    m->read(m->ctx, mirror_index(y, m->h), lo, hi - lo, v + lo - x + 2);
    for (int i = x - 2; i < lo; i++)
        v[i - x + 2] = v[mirror_index(i, m->w) - x + 2];
    for (int i = hi; i < x + n + 2; i++)
        v[i - x + 2] = v[mirror_index(i, m->w) - x + 2];
}

/* r: rows y - 2 .. y + 2, each from x - 2 on. */
static void demosaic_row(const struct develop_mosaic *m, int y, int x, int n, float *const r[5],
                         float *const rgb[3])
{
    int c = raw_colour(m->cfa, y, x), across = raw_colour(m->cfa, y, x + 1), green = c == 1;
    int own = green ? across : c; // the other colour of this row
    for (int i = 0; i < n; i++) {
        const float *p = r[2] + i + 2, *up = r[1] + i + 2, *down = r[3] + i + 2;
        float h1 = p[-1] + p[1], h2 = p[-2] + p[2], v1 = *up + *down;
        float v2 = r[0][i + 2] + r[4][i + 2], d = up[-1] + up[1] + down[-1] + down[1];
        if ((i & 1) == green) {
            rgb[own][i] = *p;
            rgb[1][i] = 0.125f * (4.0f * *p + 2.0f * (h1 + v1) - (h2 + v2));
            rgb[2 - own][i] = 0.125f * (6.0f * *p + 2.0f * d - 1.5f * (h2 + v2));
        } else {
            rgb[1][i] = *p;
            rgb[own][i] = 0.125f * (5.0f * *p + 4.0f * h1 - d - h2 + 0.5f * v2);
            rgb[2 - own][i] = 0.125f * (5.0f * *p + 4.0f * v1 - d - v2 + 0.5f * h2);
        }
    }
}

void develop_rows(const struct develop_mosaic *m, int begin, int end)
{
    float ring[5][STRIP + 4], colour[3][STRIP];
    float *const rgb[3] = {colour[0], colour[1], colour[2]};
    for (int x = 0; x < m->w; x += STRIP) {
        int n = num_min(STRIP, m->w - x);
        for (int y = begin - 2; y < begin + 2; y++)
            load_row(m, y, x, n, ring[(y + 5) % 5]);
        for (int y = begin; y < end; y++) {
            float *const r[5] = {ring[(y + 3) % 5], ring[(y + 4) % 5], ring[y % 5],
                                 ring[(y + 1) % 5], ring[(y + 2) % 5]};
            load_row(m, y + 2, x, n, r[4]);
            demosaic_row(m, y, x, n, r, rgb);
            m->write(m->ctx, y, x, n, rgb);
        }
    }
}

/* ---- white balance ---- */

/* Sums over the cells of 2 x 2 sites without a clipped one. */
static void add_cells(const struct raw *f, int64_t sum[3])
{
    int clip = raw_clip(f);
    for (int y = 0; y + 1 < f->h; y += 2) {
        const uint16_t *p = f->px + (size_t)y * (size_t)f->w, *q = p + f->w;
        for (int x = 0; x + 1 < f->w; x += 2, p += 2, q += 2) {
            if (p[0] >= clip || p[1] >= clip || q[0] >= clip || q[1] >= clip)
                continue;
            sum[raw_colour(f->cfa, 0, 0)] += p[0] - f->black;
            sum[raw_colour(f->cfa, 0, 1)] += p[1] - f->black;
            sum[raw_colour(f->cfa, 1, 0)] += q[0] - f->black;
            sum[raw_colour(f->cfa, 1, 1)] += q[1] - f->black;
        }
    }
}

static float gain_of(int64_t two_green, int64_t other)
{
    if (two_green <= 0 || other <= 0)
        return 1.0f;
    return fminf(fmaxf((float)(0.5 * (double)two_green / (double)other), 0.25f), 4.0f);
}

void develop_balance(const struct raw *frames, int n, struct develop *out)
{
    int64_t sum[3] = {0};
    for (int i = 0; i < n; i++)
        if (frames[i].cfa != RAW_MONO && frames[i].cfa != RAW_RGB)
            add_cells(&frames[i], sum);
    out->red = gain_of(sum[1], sum[0]);
    out->blue = gain_of(sum[1], sum[2]);
}

/* ---- pictures ---- */

struct conversion {
    const struct raw *in;
    float scale[3]; // from codes above black, per colour: 1 is white
    uint8_t code[LIGHT + 1];
    uint8_t *px;
    uint16_t *px16; // instead of px
};

static double srgb_light(double z)
{
    return z <= 0.04045 ? z / 12.92 : pow((z + 0.055) / 1.055, 2.4);
}

uint16_t develop_srgb16(float v)
{
    if (!(v > 0))
        return 0;
    const float z = v >= 1 ? 1 : v <= 0.0031308f ? 12.92f * v : 1.055f * powf(v, 1 / 2.4f) - 0.055f;
    return (uint16_t)(z * LIGHT + 0.5f);
}

static void set_scale(const struct raw *in, const struct develop *how, struct conversion *p)
{
    float least = fminf(1.0f, fminf(how->red, how->blue));
    float unit = 1.0f / (float)((1 << in->bits) - 1 - in->black) / least;
    p->in = in;
    p->scale[0] = unit * how->red;
    p->scale[1] = unit;
    p->scale[2] = unit * how->blue;
}

static void conversion_init(const struct raw *in, const struct develop *how, uint8_t *px,
                            struct conversion *p)
{
    set_scale(in, how, p);
    p->px = px;
    for (int z = 0, i = 0; z < 256; z++) {
        double end = z < 255 ? srgb_light((z + 0.5) / 255.0) * LIGHT : LIGHT + 1;
        for (; i < end; i++)
            p->code[i] = (uint8_t)z;
    }
}

static inline uint8_t code_of(const struct conversion *p, float v)
{
    return p->code[v <= 0.0f ? 0 : v >= 1.0f ? LIGHT : (int)(v * LIGHT + 0.5f)];
}

static void read_sites(const void *ctx, int y, int x, int n, float *v)
{
    const struct conversion *p = ctx;
    const uint16_t *code = p->in->px + (size_t)y * (size_t)p->in->w + x;
    float scale[2];
    for (int k = 0; k < 2; k++)
        scale[k] = p->scale[raw_colour(p->in->cfa, y, x + k)];
    for (int i = 0; i < n; i++)
        v[i] = fminf((float)(code[i] - p->in->black) * scale[i & 1], 1.0f);
}

static void write_codes(const void *ctx, int y, int x, int n, float *const rgb[3])
{
    const struct conversion *p = ctx;
    uint8_t *to = p->px + 3 * ((size_t)y * (size_t)p->in->w + (size_t)x);
    for (int i = 0; i < n; i++, to += 3)
        for (int c = 0; c < 3; c++)
            to[c] = code_of(p, rgb[c][i]);
}

static void write_codes16(const void *ctx, int y, int x, int n, float *const rgb[3])
{
    const struct conversion *p = ctx;
    uint16_t *to = p->px16 + 3 * ((size_t)y * (size_t)p->in->w + (size_t)x);
    for (int i = 0; i < n; i++, to += 3)
        for (int c = 0; c < 3; c++)
            to[c] = develop_srgb16(rgb[c][i]);
}

/* Without a mosaic. */
static void develop_plain(const struct conversion *p)
{
    const struct raw *in = p->in;
    bool mono = in->cfa == RAW_MONO;
    size_t n = 3 * (size_t)in->w * (size_t)in->h;
    for (size_t i = 0; i < n; i++) {
        int v = in->px[mono ? i / 3 : i];
        p->px[i] = in->linear ? code_of(p, (float)(v - in->black) * p->scale[mono ? 1 : i % 3])
                              : (uint8_t)num_min(v, 255);
    }
}

void develop_run(const struct raw *in, const struct develop *how, uint8_t *px)
{
    struct conversion p;
    conversion_init(in, how, px, &p);
    struct develop_mosaic m = {in->cfa, in->w, in->h, &p, read_sites, write_codes};
    if (in->cfa == RAW_MONO || in->cfa == RAW_RGB)
        develop_plain(&p);
    else
        develop_rows(&m, 0, in->h);
}

void develop_run16(const struct raw *in, const struct develop *how, uint16_t *px)
{
    struct conversion p = {.px16 = px};
    set_scale(in, how, &p);
    struct develop_mosaic m = {in->cfa, in->w, in->h, &p, read_sites, write_codes16};
    const size_t n = 3 * (size_t)in->w * (size_t)in->h;
    const bool mono = in->cfa == RAW_MONO, plain = mono || in->cfa == RAW_RGB;
    for (size_t i = 0; i < n && plain; i++)
        px[i] = develop_srgb16((float)(in->px[mono ? i / 3 : i] - in->black) *
                               p.scale[mono ? 1 : i % 3]);
    if (!plain)
        develop_rows(&m, 0, in->h);
}
