/* A pixel's mean number of electrons is radiance x sensitivity x time x its own gain (PRNU), times
 * the mean of the light's ripple over the row's exposure, plus dark current. Shot noise is Poisson;
 * the well clips; then come the pixel's own offset (DSNU), read noise and row noise, gain, black
 * level, rounding and the converter's range (EMVA 1288 release 4, section 2).
 * Random numbers: a 64-bit mix of key + counter x odd constant (Stafford's variant 13, as in
 * SplitMix64); a normal one is the inverse distribution function of one uniform (Wichura, AS 241,
 * PPND7). The keys are made of seed, frame, plane and row, the counter of the column. Neither libm
 * nor fused products take part, so raw pictures are the same bytes everywhere (but for flicker).
 * Development: bilinear demosaicing, mirrored at the edges. */
#include "sim/sensor/sensor.h"

#include "core/base/num.h"
#include "core/base/splitmix.h"
#include "sim/sensor/variate.h"

#include <math.h>
#include <string.h>

enum { ROWS = 8 }; // of one chunk

const struct sensor sensor_default = {
    .cfa = SENSOR_RGB,
    .electrons = 1e6f,
    .prnu = 0.005f,
    .dsnu = 0.5f,
    .dark_per_s = 5.0f,
    .read_noise = 2.5f,
    .row_noise = 0.2f,
    .full_well = 10000.0f,
    .gain = 0.4f, // the converter ends just below the full well
    .bits = 12,
    .black = 256,
    .balance = {0.6f, 1.0f, 0.7f},
    .unit = 1,
};

/* ---- random numbers ---- */

static inline double min_double(double a, double b)
{
    return a < b ? a : b; // fmin would be a call
}

/* exp(-x) for 0 <= x <= 30, to 1e-8 of itself. */
static inline double exp_minus(double x)
{
    double n = (double)(int)(x * 1.4426950408889634 + 0.5);
    double r = n * 0.6931471805599453 - x, p = 1.0;
    for (int k = 7; k >= 1; k--)
        p = 1.0 + p * r * (1.0 / k);
    uint64_t bits = (uint64_t)(1023 - (int)n) << 52;
    double scale;
    memcpy(&scale, &bits, sizeof scale);
    return p * scale;
}

/* For a mean below 30, P(X > 96) < 1e-20. */
enum { POISSON_MAX = 96 };
static const double inverse[POISSON_MAX] = {
    1.0 / 1,  1.0 / 2,  1.0 / 3,  1.0 / 4,  1.0 / 5,  1.0 / 6,  1.0 / 7,  1.0 / 8,  1.0 / 9,
    1.0 / 10, 1.0 / 11, 1.0 / 12, 1.0 / 13, 1.0 / 14, 1.0 / 15, 1.0 / 16, 1.0 / 17, 1.0 / 18,
    1.0 / 19, 1.0 / 20, 1.0 / 21, 1.0 / 22, 1.0 / 23, 1.0 / 24, 1.0 / 25, 1.0 / 26, 1.0 / 27,
    1.0 / 28, 1.0 / 29, 1.0 / 30, 1.0 / 31, 1.0 / 32, 1.0 / 33, 1.0 / 34, 1.0 / 35, 1.0 / 36,
    1.0 / 37, 1.0 / 38, 1.0 / 39, 1.0 / 40, 1.0 / 41, 1.0 / 42, 1.0 / 43, 1.0 / 44, 1.0 / 45,
    1.0 / 46, 1.0 / 47, 1.0 / 48, 1.0 / 49, 1.0 / 50, 1.0 / 51, 1.0 / 52, 1.0 / 53, 1.0 / 54,
    1.0 / 55, 1.0 / 56, 1.0 / 57, 1.0 / 58, 1.0 / 59, 1.0 / 60, 1.0 / 61, 1.0 / 62, 1.0 / 63,
    1.0 / 64, 1.0 / 65, 1.0 / 66, 1.0 / 67, 1.0 / 68, 1.0 / 69, 1.0 / 70, 1.0 / 71, 1.0 / 72,
    1.0 / 73, 1.0 / 74, 1.0 / 75, 1.0 / 76, 1.0 / 77, 1.0 / 78, 1.0 / 79, 1.0 / 80, 1.0 / 81,
    1.0 / 82, 1.0 / 83, 1.0 / 84, 1.0 / 85, 1.0 / 86, 1.0 / 87, 1.0 / 88, 1.0 / 89, 1.0 / 90,
    1.0 / 91, 1.0 / 92, 1.0 / 93, 1.0 / 94, 1.0 / 95, 1.0 / 96};

/* Smallest k with P(X <= k) > u. */
static inline double small_poisson(double u, double mean)
{
    double p = exp_minus(mean), sum = p;
    int k = 0;
    while (u > sum && k < POISSON_MAX) {
        p *= mean * inverse[k++];
        sum += p;
    }
    return k;
}

static inline double poisson(uint64_t key, uint64_t counter, double mean)
{
    if (!(mean > 0.0))
        return 0.0;
    if (mean < 30.0)
        return small_poisson(variate_uniform(key, counter), mean);
    if (!(mean < 1e12))
        mean = 1e12;
    double v = mean + sqrt(mean) * variate_normal(key, counter) + 0.5;
    return v > 0.0 ? (double)(int64_t)v : 0.0;
}

double sensor_uniform(uint64_t key, uint64_t counter)
{
    return variate_uniform(splitmix_mix(key), counter);
}

double sensor_normal(uint64_t key, uint64_t counter)
{
    return variate_normal(splitmix_mix(key), counter);
}

double sensor_poisson(uint64_t key, uint64_t counter, double mean)
{
    return poisson(splitmix_mix(key), counter, mean);
}

/* ---- checks ---- */

static err_t check_value(const char *name, double v, double lo, double hi)
{
    if (!(v >= lo && v <= hi))
        return err_fail(ERR_ARG, "sensor: %s is %g, must be %g..%g", name, v, lo, hi);
    return OK;
}

err_t sensor_check(const struct sensor *s)
{
    const struct {
        const char *name;
        double v, lo, hi;
    } field[] = {
        {"cfa", s->cfa, SENSOR_RGB, SENSOR_BGGR},
        {"electrons", s->electrons, 1e-3, 1e12},
        {"prnu", s->prnu, 0.0, 0.5},
        {"dsnu", s->dsnu, 0.0, 1e4},
        {"dark_per_s", s->dark_per_s, 0.0, 1e6},
        {"read_noise", s->read_noise, 0.0, 1e4},
        {"row_noise", s->row_noise, 0.0, 1e4},
        {"full_well", s->full_well, 1.0, 1e7},
        {"gain", s->gain, 1e-6, 1e3},
        {"bits", s->bits, 8, 16},
        {"black", s->black, 0, (1 << s->bits % 32) / 2},
        {"balance of red", s->balance[0], 0.01, 1.0},
        {"balance of green", s->balance[1], 0.01, 1.0},
        {"balance of blue", s->balance[2], 0.01, 1.0},
        {"line_s", s->line_s, 0.0, 1.0},
        {"flicker", s->flicker, 0.0, 1.0},
        {"flicker_hz", s->flicker_hz, 0.0, 1e6},
    };
    err_t e = OK;
    for (size_t i = 0; !e && i < sizeof field / sizeof field[0]; i++)
        e = check_value(field[i].name, field[i].v, field[i].lo, field[i].hi);
    return e;
}

static err_t check_all(const struct sensor *s, const struct sensor_shot *shot,
                       const struct sensor_raw *raw)
{
    err_t e = sensor_check(s);
    if (!e)
        e = check_value("exposure_s", shot->exposure_s, 0.0, 3600.0);
    if (!e)
        e = check_value("gain of the shot", shot->gain, 1.0, 1e3);
    if (!e)
        e = check_value("start_s", shot->start_s, -1e12, 1e12);
    if (e)
        return e;
    if (raw->w < 1 || raw->h < 1 || raw->w > 1 << 15 || raw->h > 1 << 15)
        return err_fail(ERR_ARG, "sensor: picture of %d x %d px, allowed are 1 to 32768", raw->w,
                        raw->h);
    if (s->cfa != SENSOR_RGB && (raw->w % 2 || raw->h % 2))
        return err_fail(ERR_ARG, "sensor: a mosaic of %d x %d px, both must be even", raw->w,
                        raw->h);
    return OK;
}

/* ---- exposure ---- */

/* Colour of a site of the mosaic. */
static inline int site_colour(enum sensor_cfa cfa, int y, int x)
{
    int c = (y & 1) + (x & 1); // 0 red, 1 green, 2 blue
    return cfa == SENSOR_BGGR ? 2 - c : c;
}

struct expose {
    const struct run *r;
    const struct sensor *s;
    const struct sensor_shot *shot;
    const struct image *radiance;
    struct sensor_raw *out;
};

/* Values that are constant along a row. */
struct row {
    uint64_t noise, unit; // keys
    double light[3];      // mean electrons of radiance 1, per colour
    double dark, offset;  // e-
};

/* Mean of 1 + depth sin(2 pi f t) over the exposure of a row. */
static double mean_flicker(const struct sensor *s, const struct sensor_shot *shot, int row)
{
    double w = 2.0 * NUM_PI * s->flicker_hz;
    double t = shot->start_s + row * (double)s->line_s, d = w * shot->exposure_s;
    if (s->flicker <= 0.0f || w <= 0.0)
        return 1.0;
    if (d < 1e-6)
        return 1.0 + s->flicker * sin(w * t);
    return 1.0 + s->flicker * sin(w * t + 0.5 * d) * sin(0.5 * d) / (0.5 * d);
}

static struct row row_begin(const struct expose *x, int plane, int y)
{
    const struct sensor *s = x->s;
    uint64_t where = (uint64_t)plane << 32 | (uint64_t)y;
    struct row w = {.dark = s->dark_per_s * x->shot->exposure_s};
    w.noise = splitmix_mix(splitmix_mix(splitmix_mix(x->shot->seed + 1) + x->shot->frame) + where);
    w.unit = splitmix_mix(splitmix_mix(~s->unit) + where);
    double light = s->electrons * x->shot->exposure_s * mean_flicker(s, x->shot, y);
    for (int c = 0; c < 3; c++)
        w.light[c] = light * s->balance[c];
    if (s->row_noise > 0.0f)
        w.offset = s->row_noise * variate_normal(w.noise, UINT32_MAX);
    return w;
}

/* Electrons read from a pixel that receives `radiance`. */
static inline double read_pixel(const struct sensor *s, const struct row *w, int c, int i,
                                float radiance)
{
    uint64_t n = 2 * (uint64_t)i;
    double mean = radiance > 0.0f ? radiance * w->light[c] : 0.0; // NaN is dark
    if (s->prnu > 0.0f)
        mean *= 1.0 - min_double(-s->prnu * variate_normal(w->unit, n), 1.0);
    double e = min_double(poisson(w->noise, n, mean + w->dark), s->full_well) + w->offset;
    if (s->dsnu > 0.0f)
        e += s->dsnu * variate_normal(w->unit, n + 1);
    if (s->read_noise > 0.0f)
        e += s->read_noise * variate_normal(w->noise, n + 1);
    return e;
}

static void expose_row(const struct expose *x, int plane, int y)
{
    const struct sensor *s = x->s;
    int w = x->out->w, h = x->out->h, top = (1 << s->bits) - 1;
    size_t area = (size_t)w * (size_t)h, at = (size_t)y * (size_t)w;
    const float *px = x->radiance->px + at;
    uint16_t *out = x->out->px + (size_t)plane * area + at;
    struct row row = row_begin(x, plane, y);
    double gain = (double)s->gain * x->shot->gain, half = s->black + 0.5;
    for (int i = 0; i < w; i++) {
        int c = s->cfa == SENSOR_RGB ? plane : site_colour(s->cfa, y, i);
        double v = read_pixel(s, &row, c, i, px[(size_t)c * area + (size_t)i]) * gain + half;
        out[i] = v <= 0.0 ? 0 : v >= top ? (uint16_t)top : (uint16_t)v;
    }
}

static err_t expose_chunk(void *ctx, int chunk, int worker)
{
    const struct expose *x = ctx;
    (void)worker;
    err_t e = run_check(x->r, "sensor");
    int planes = x->s->cfa == SENSOR_RGB ? 3 : 1;
    for (int y = chunk * ROWS; !e && y < (chunk + 1) * ROWS && y < x->out->h; y++)
        for (int p = 0; p < planes; p++)
            expose_row(x, p, y);
    return e;
}

err_t sensor_expose(const struct run *r, const struct sensor *s, const struct sensor_shot *shot,
                    const struct image *radiance, struct sensor_raw *out)
{
    struct expose x = {r, s, shot, radiance, out};
    err_t e = check_all(s, shot, out);
    if (e)
        return e;
    if (radiance->channels != 3 || radiance->w != out->w || radiance->h != out->h)
        return err_fail(ERR_ARG, "sensor: radiance is %d x %d x %d, the picture 3 x %d x %d",
                        radiance->channels, radiance->h, radiance->w, out->h, out->w);
    return pool_for(r->pool, (out->h + ROWS - 1) / ROWS, expose_chunk, &x);
}

/* ---- development ---- */

struct develop {
    const struct run *r;
    const struct sensor *s;
    const struct curve *curve;
    const struct sensor_raw *raw;
    float scale[3]; // exposure of one digital number
    uint8_t *px;    // or
    float *linear;
};

static inline int mirror_index(int i, int n)
{
    return i < 0 ? -i : i >= n ? 2 * n - 2 - i : i;
}

/* Digital number of colour c at a pixel of the mosaic. */
static float demosaic(const struct develop *d, int c, int y, int x)
{
    const struct sensor_raw *raw = d->raw;
    int here = site_colour(d->s->cfa, y, x);
    const uint16_t *row[3];
    for (int k = 0; k < 3; k++)
        row[k] = raw->px + (size_t)mirror_index(y + k - 1, raw->h) * (size_t)raw->w;
    int l = mirror_index(x - 1, raw->w), r = mirror_index(x + 1, raw->w);
    if (here == c)
        return row[1][x];
    if (c == 1)
        return 0.25f * (float)(row[0][x] + row[2][x] + row[1][l] + row[1][r]);
    if (here != 1)
        return 0.25f * (float)(row[0][l] + row[0][r] + row[2][l] + row[2][r]);
    if (site_colour(d->s->cfa, y, x + 1) == c)
        return 0.5f * (float)(row[1][l] + row[1][r]);
    return 0.5f * (float)(row[0][x] + row[2][x]);
}

static void develop_row(const struct develop *d, int y)
{
    int w = d->raw->w;
    size_t area = (size_t)w * (size_t)d->raw->h, at = (size_t)y * (size_t)w;
    for (int x = 0; x < w; x++)
        for (int c = 0; c < 3; c++) {
            size_t i = at + (size_t)x;
            float v = d->s->cfa == SENSOR_RGB ? (float)d->raw->px[(size_t)c * area + i]
                                              : demosaic(d, c, y, x);
            float exposure = (v - (float)d->s->black) * d->scale[c];
            if (d->linear)
                d->linear[(size_t)c * area + i] = exposure;
            else
                d->px[3 * i + (size_t)c] =
                    (uint8_t)(255.0f * curve_display(d->curve, exposure) + 0.5f);
        }
}

static err_t develop_chunk(void *ctx, int chunk, int worker)
{
    const struct develop *d = ctx;
    (void)worker;
    err_t e = run_check(d->r, "sensor");
    for (int y = chunk * ROWS; !e && y < (chunk + 1) * ROWS && y < d->raw->h; y++)
        develop_row(d, y);
    return e;
}

static err_t develop_all(struct develop *d, const struct sensor_shot *shot)
{
    const struct sensor *s = d->s;
    err_t e = check_all(s, shot, d->raw);
    if (e)
        return e;
    double top = (1 << s->bits) - 1 - s->black;
    double white = fmin((double)s->full_well * s->gain * shot->gain, top);
    for (int k = 0; k < 3; k++)
        d->scale[k] = (float)(1.0 / (white * s->balance[k]));
    return pool_for(d->r->pool, (d->raw->h + ROWS - 1) / ROWS, develop_chunk, d);
}

err_t sensor_develop(const struct run *r, const struct sensor *s, const struct sensor_shot *shot,
                     const struct curve *c, const struct sensor_raw *raw, uint8_t *px)
{
    struct develop d = {.r = r, .s = s, .curve = c, .raw = raw, .px = px};
    return develop_all(&d, shot);
}

err_t sensor_linear(const struct run *r, const struct sensor *s, const struct sensor_shot *shot,
                    const struct sensor_raw *raw, float *out)
{
    struct develop d = {.r = r, .s = s, .raw = raw, .linear = out};
    return develop_all(&d, shot);
}
