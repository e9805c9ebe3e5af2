/* Positions, as multiples of a step that the sizes of the splats choose, give the order: by
 * Morton's code of their 16 highest bits, the most important splats before the rest. Then one field
 * after the other is made as an array of numbers, and goes byte by byte into the stream. */
#include "firmware/result/pagepack.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "drivers/format/compressed.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    SAMPLE_MAX = 20000, // splats that choose the steps of positions
    POSITION_MAX = (1 << 23) - 2,
    KEY_BITS = 16,
    BLOCK = 1 << 12
};

#define POSITION_SHARE 0.0625 // of a small splat's size: a step
#define SMALL_QUANTILE 0.25f
#define SH_STEP 0.1

struct place {
    uint64_t key;
    int splat;
};

struct packer {
    const struct pagesplats *p;
    struct pagepack *out;
    struct place *place;                     // (n) in the order of the stream
    uint16_t (*numbers)[PAGESPLATS_NUMBERS]; // (n)
    float *sample;                           // (n) for what positions and order ask
    int32_t *value;                          // (n) of the field that is being made
    int from, end;                           // places in the stream that is being made
    struct compressed_out stream;
};

/* ---- positions ---- */

static double warp(const struct pagepack *o, int k, float x)
{
    return asinh(((double)x - o->at[k]) / o->reach);
}

/* Natural logarithm of the length that a step of 1 has at splat i. */
static double log_spacing(const struct pagepack *o, const struct gaussians *g, int i)
{
    double most = 0;
    for (int k = 0; k < 3; k++)
        most = fmax(most, fabs(warp(o, k, g->plane[G_MU + k][i])));
    return log(o->reach * cosh(most));
}

static double log_middle_scale(const struct gaussians *g, int i)
{
    float s[3];
    for (int k = 0; k < 3; k++)
        s[k] = g->plane[G_LOG_SCALE + k][i];
    return (double)fmaxf(fminf(s[0], s[1]), fminf(fmaxf(s[0], s[1]), s[2]));
}

/* at, reach: medians of positions and of the distances from there. */
static void find_middle(const struct packer *k, int n, int every)
{
    float *v = k->sample;
    const struct gaussians *g = &k->p->scene->g;
    struct pagepack *o = k->out;
    o->reach = 0;
    for (int c = 0; c < 3; c++) {
        for (int i = 0; i < n; i++)
            v[i] = g->plane[G_MU + c][k->place[i * every].splat];
        o->at[c] = (double)num_median(v, (size_t)n);
        for (int i = 0; i < n; i++)
            v[i] = fabsf(v[i] - (float)o->at[c]);
        o->reach = fmax(o->reach, (double)num_median(v, (size_t)n));
    }
    if (!(o->reach > 0 && isfinite(o->reach)))
        o->reach = 1;
}

/* A step that most splats hardly notice, and with which all positions have 23 bits. */
static void find_step(const struct packer *k, int n, int every)
{
    float *v = k->sample;
    const struct gaussians *g = &k->p->scene->g;
    struct pagepack *o = k->out;
    double widest = 0, lo[3];
    for (int i = 0; i < n; i++) {
        int splat = k->place[i * every].splat;
        v[i] = (float)(log_middle_scale(g, splat) - log_spacing(o, g, splat));
    }
    o->step = POSITION_SHARE * exp((double)num_quantile(v, (size_t)n, SMALL_QUANTILE));
    for (int c = 0; c < 3; c++) {
        double hi = -INFINITY;
        lo[c] = INFINITY;
        for (int i = 0; i < k->p->n; i++) {
            double u = warp(o, c, g->plane[G_MU + c][k->place[i].splat]);
            lo[c] = fmin(lo[c], u);
            hi = fmax(hi, u);
        }
        widest = fmax(widest, fmax(hi - lo[c], fmax(fabs(lo[c]), fabs(hi))));
    }
    o->step = fmax(o->step, widest / POSITION_MAX);
    if (!(o->step > 0))
        o->step = 1; // all of them at one place
    for (int c = 0; c < 3; c++)
        o->low[c] = (int)lrint(lo[c] / o->step);
}

static void plan_positions(const struct packer *k)
{
    const int every = k->p->n / SAMPLE_MAX + 1, n = (k->p->n + every - 1) / every;
    if (k->p->n == 0)
        return;
    find_middle(k, n, every);
    find_step(k, n, every);
}

static int32_t position(const struct packer *k, int c, int splat)
{
    const struct gaussians *g = &k->p->scene->g;
    return (int32_t)lrint(warp(k->out, c, g->plane[G_MU + c][splat]) / k->out->step) -
           k->out->low[c];
}

/* ---- order ---- */

/* Bit i goes to bit 3 i. */
static uint64_t spread_bits(uint32_t v)
{
    uint64_t out = 0;
    for (int i = 0; i < KEY_BITS; i++)
        out |= (uint64_t)(v >> i & 1) << (3 * i);
    return out;
}

static int by_key(const void *a, const void *b)
{
    const struct place *x = a, *y = b;
    if (x->key != y->key)
        return x->key < y->key ? -1 : 1;
    return (x->splat > y->splat) - (x->splat < y->splat);
}

/* Natural logarithm of opacity times the area that the middle of the scene sees. */
static float importance(const struct packer *k, int i)
{
    const struct gaussians *g = &k->p->scene->g;
    double opacity = 1 / (1 + exp(-(double)g->plane[G_LOGIT][i])), area = 0, least = INFINITY;
    for (int c = 0; c < 3; c++) {
        area += (double)g->plane[G_LOG_SCALE + c][i];
        least = fmin(least, (double)g->plane[G_LOG_SCALE + c][i]);
    }
    return (float)(log(opacity) + area - least - 2 * log_spacing(k->out, g, i));
}

/* The keys of what comes later are larger than all others. */
static void put_rest_behind(const struct packer *k)
{
    const int n = k->p->n;
    float *v = k->sample;
    k->out->first = n;
    if (n <= 2 * PAGEPACK_FIRST)
        return;
    for (int i = 0; i < n; i++)
        v[i] = importance(k, k->place[i].splat);
    const float least = num_quantile(v, (size_t)n, 1 - (float)PAGEPACK_FIRST / (float)n);
    for (int i = 0; i < n; i++)
        if (importance(k, k->place[i].splat) < least) {
            k->place[i].key |= (uint64_t)1 << (3 * KEY_BITS);
            k->out->first--;
        }
}

static void find_order(const struct packer *k)
{
    int32_t most = 0;
    int shift = 0;
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < k->p->n; i++) {
            const int32_t v = position(k, c, k->place[i].splat);
            most = v > most ? v : most;
        }
    while (most >> shift >= 1 << KEY_BITS)
        shift++;
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < k->p->n; i++) {
            struct place *p = &k->place[i];
            p->key |= spread_bits((uint32_t)(position(k, c, p->splat) >> shift)) << c;
        }
    put_rest_behind(k);
    qsort(k->place, (size_t)k->p->n, sizeof *k->place, by_key);
}

/* ---- fields ---- */

/* 0, -1, 1, -2 ... become 0, 1, 2, 3 ... */
static int32_t zigzag(int32_t v)
{
    return v < 0 ? -2 * v - 1 : 2 * v;
}

/* The numbers of the field, lowest bytes first. */
static err_t put_field(struct packer *k, int bytes)
{
    uint8_t block[BLOCK];
    err_t e = OK;
    for (int b = 0; b < bytes; b++)
        for (int i = k->from, m; i < k->end && !e; i += m) {
            m = num_min(k->end - i, BLOCK);
            for (int j = 0; j < m; j++)
                block[j] = (uint8_t)((uint32_t)k->value[i + j] >> (8 * b));
            e = compressed_put(&k->stream, block, (size_t)m);
        }
    return e;
}

static err_t put_position(struct packer *k, int c)
{
    int32_t before = 0;
    for (int i = k->from; i < k->end; i++) {
        const int32_t v = position(k, c, k->place[i].splat);
        k->value[i] = zigzag(v - before);
        before = v;
    }
    return put_field(k, 3);
}

/* Number `from` of pagesplats.h as it is; minus > 0: less that one. */
static err_t put_numbers(struct packer *k, int from, int minus)
{
    for (int i = k->from; i < k->end; i++) {
        const uint16_t *v = k->numbers[i];
        k->value[i] = minus > 0 ? zigzag(v[from] - v[minus]) : v[from];
    }
    return put_field(k, 2);
}

static err_t put_quats(struct packer *k)
{
    err_t e = OK;
    for (int c = 0; c < 3 && !e; c++) {
        for (int i = k->from; i < k->end; i++) {
            const int v = (k->numbers[i][PAGESPLATS_QUAT + c] & 0x7fff) - 16383;
            const long most = 16383 / PAGEPACK_QUAT, step = lround((double)v / PAGEPACK_QUAT);
            k->value[i] = zigzag((int32_t)(step < -most ? -most : step > most ? most : step));
        }
        e = put_field(k, 2);
    }
    for (int i = k->from; i < k->end; i++) {
        const uint16_t *v = k->numbers[i] + PAGESPLATS_QUAT;
        k->value[i] = v[0] >> 15 | v[1] >> 15 << 1 | v[2] >> 15 << 2;
    }
    return e ? e : put_field(k, 1);
}

static err_t put_harmonics(struct packer *k)
{
    const struct gaussians *g = &k->p->scene->g;
    const int planes = 3 * (k->p->degree + 1) * (k->p->degree + 1);
    err_t e = OK;
    for (int p = G_SH + 3; p < G_SH + planes && !e; p++) {
        for (int i = k->from; i < k->end; i++) {
            const double v = (double)g->plane[p][k->place[i].splat] / k->out->sh;
            k->value[i] = zigzag((int32_t)lrint(fmax(fmin(v, INT16_MAX), -INT16_MAX)));
        }
        e = put_field(k, 2);
    }
    return e;
}

static err_t put_fields(struct packer *k)
{
    err_t e = OK;
    for (int i = k->from; i < k->end; i++)
        pagesplats_numbers(k->p, k->place[i].splat, k->numbers[i]);
    for (int c = 0; c < 3 && !e; c++)
        e = put_position(k, c);
    for (int f = PAGESPLATS_SCALE; f <= PAGESPLATS_LOGIT && !e; f++)
        e = put_numbers(k, f, 0);
    if (!e)
        e = put_quats(k);
    if (!e)
        e = put_numbers(k, PAGESPLATS_LIGHT + 1, 0);
    for (int c = 0; c < 3 && !e; c += 2)
        e = put_numbers(k, PAGESPLATS_LIGHT + c, PAGESPLATS_LIGHT + 1);
    return e ? e : put_harmonics(k);
}

/* ---- the streams ---- */

static err_t put_stream(struct packer *k, FILE *f, int from, int end)
{
    k->from = from;
    k->end = end;
    err_t e = compressed_begin(&k->stream, "page of the scene", COMPRESSED_GZIP_LONG, f, 0), ended;
    if (!e)
        e = put_fields(k);
    ended = compressed_end(&k->stream);
    return e ? e : ended;
}

static err_t put_streams(struct packer *k)
{
    struct pagepack *o = k->out;
    size_t n;
    FILE *f = open_memstream(&o->bytes, &n);
    if (!f)
        return err_fail(ERR_NOMEM, "page of the scene: no memory");
    err_t e = put_stream(k, f, 0, o->first);
    o->n_bytes[0] = fflush(f) == 0 ? n : 0;
    if (!e && o->first < k->p->n)
        e = put_stream(k, f, o->first, k->p->n);
    if (fclose(f) != 0 && !e)
        e = err_fail(ERR_NOMEM, "page of the scene: no memory for its %d splats", k->p->n);
    o->n_bytes[1] = e ? 0 : n - o->n_bytes[0];
    return e;
}

static void list_splats(const struct packer *k)
{
    const struct gaussians *g = &k->p->scene->g;
    for (int i = 0, n = 0; i < g->n; i++)
        if (pagesplats_is_drawn(g, i))
            k->place[n++].splat = i;
}

err_t pagepack_run(const struct pagesplats *p, struct pagepack *out)
{
    struct packer k = {.p = p, .out = out};
    const size_t n = (size_t)p->n + 1;
    err_t e = OK;
    *out = (struct pagepack){.step = 1, .reach = 1, .sh = SH_STEP};
    k.place = calloc(n, sizeof *k.place);
    k.numbers = calloc(n, sizeof *k.numbers);
    k.sample = calloc(n, sizeof *k.sample);
    k.value = calloc(n, sizeof *k.value);
    if (!k.place || !k.numbers || !k.sample || !k.value)
        e = err_fail(ERR_NOMEM, "page of the scene: no memory for its %d splats", p->n);
    if (!e) {
        list_splats(&k);
        plan_positions(&k);
        find_order(&k);
        e = put_streams(&k);
    }
    free(k.place);
    free(k.numbers);
    free(k.sample);
    free(k.value);
    if (e)
        pagepack_free(out);
    return e;
}

size_t pagepack_plan(int n, int degree)
{
    const size_t numbers = 3 * 3 + 10 * 2 + 1 + 2 * 3 * (size_t)(degree * (degree + 2));
    const size_t each = sizeof(struct place) + PAGESPLATS_NUMBERS * 2 + 8;
    return (size_t)n * (each + 2 * numbers); // a stream in memory doubles as it grows
}

void pagepack_free(struct pagepack *p)
{
    free(p->bytes);
    p->bytes = NULL;
    memset(p->n_bytes, 0, sizeof p->n_bytes);
}
