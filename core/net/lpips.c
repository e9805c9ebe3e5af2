/* Both pictures go through a stage together. A stage of 3 x 3 convolutions is done in bands of rows
 * whose neighbourhood is computed with them: a convolution treats the cut edges of a band as edges
 * of the picture, so that one more row at each is wrong after each of them and is left out at the
 * end. What remains is compared, and reduced to the input of the next stage. */
#include "core/net/lpips.h"

#include "core/base/num.h"
#include "core/net/layer.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum {
    COLOURS = 3,
    BAND_FLOATS = 2 << 20, // of a map
    BAND_ROWS = 16         // at least, without neighbourhood
};

static const float shift[COLOURS] = {-0.030f, -0.088f, -0.188f};
static const float scale[COLOURS] = {0.458f, 0.448f, 0.450f};
static const double EPS = 1e-10;

struct extents {
    int w, h, c;
};

/* What a stage reads: the pictures, or maps. */
struct input {
    struct extents px;
    const float *map[2]; // (h, w, c), but planar for the pictures
};

struct work {
    const struct run *r;
    const struct lpips *l;
    int stage;
    struct input in;
    struct extents out; // of the stage
    double *row;        // (out.h) sums of a row
    float *band[3];
    float *next[2]; // inputs of the next stage
};

/* Rows of the output [first, end) and of the input that they need. */
struct band {
    int first, end, from, to;
};

static const struct lpips_stage *stage_of(const struct work *k)
{
    return &k->l->layers->stage[k->stage];
}

static int reduced(int n, const struct lpips_stage *s)
{
    return conv_size(n, s->window, s->step, 0);
}

static struct extents stage_size(const struct extents *in, const struct lpips_stage *s)
{
    const struct lpips_conv *c = &s->conv[0]; // the others keep the size
    return (struct extents){conv_size(in->w, c->kernel, c->stride, c->pad),
                            conv_size(in->h, c->kernel, c->stride, c->pad), s->width};
}

static size_t map_floats(const struct extents *px)
{
    return (size_t)px->w * (size_t)px->h * (size_t)px->c;
}

/* ---- bands ---- */

/* Windows of the next stage must not reach into the next band. */
static bool has_bands(const struct lpips_layers *l, int stage)
{
    const struct lpips_stage *s = &l->stage[stage];
    const bool fits = stage + 1 == LPIPS_STAGES || l->stage[stage + 1].window <= 2;
    return s->conv[0].kernel == 3 && fits;
}

/* Rows of a band, even; or all of them. */
static int band_rows(const struct work *k)
{
    const int beside = 2 * stage_of(k)->n;
    if (map_floats(&k->out) <= BAND_FLOATS || !has_bands(k->l->layers, k->stage))
        return k->out.h;
    const int fit = BAND_FLOATS / (k->out.w * k->out.c) - beside;
    return num_max(fit, BAND_ROWS) / 2 * 2;
}

static size_t band_floats(const struct work *k)
{
    struct extents px = k->out;
    px.h = num_min(px.h, band_rows(k) + 2 * stage_of(k)->n);
    return map_floats(&px);
}

static struct band band_at(const struct work *k, int first)
{
    const int n = stage_of(k)->n, rows = band_rows(k);
    if (rows == k->out.h)
        return (struct band){0, rows, 0, k->in.px.h};
    const int end = num_min(first + rows, k->out.h);
    return (struct band){first, end, num_max(first - n, 0), num_min(end + n, k->out.h)};
}

/* ---- memory ---- */

/* Rows' sums and bands of all stages, for a work at its first one. */
static err_t layout(struct work *k, struct arena *tmp)
{
    struct work at = *k;
    size_t rows = 0, floats = 0;
    for (at.stage = 0; at.stage < LPIPS_STAGES; at.stage++) {
        const struct lpips_stage *s = stage_of(&at);
        at.in.px.w = reduced(at.in.px.w, s);
        at.in.px.h = reduced(at.in.px.h, s);
        at.out = stage_size(&at.in.px, s);
        rows = num_max_size(rows, (size_t)at.out.h);
        floats = num_max_size(floats, band_floats(&at));
        at.in.px = at.out;
    }
    err_t e = arena_alloc(tmp, rows, sizeof *k->row, &k->row);
    for (int i = 0; i < 3 && !e; i++)
        e = arena_alloc(tmp, floats, sizeof *k->band[i], &k->band[i]);
    return e;
}

/* Maps that the next stage reads. */
static err_t layout_next(struct work *k, struct arena *tmp, struct extents *px)
{
    *px = k->out;
    if (k->stage + 1 == LPIPS_STAGES)
        return OK;
    const struct lpips_stage *next = stage_of(k) + 1;
    px->w = reduced(px->w, next);
    px->h = reduced(px->h, next);
    err_t e = arena_alloc(tmp, map_floats(px), sizeof(float), &k->next[0]);
    return e ? e : arena_alloc(tmp, map_floats(px), sizeof(float), &k->next[1]);
}

static struct layer_conv conv_of(const struct lpips *l, int stage, int i, const struct extents *in)
{
    const struct lpips_conv *c = &l->layers->stage[stage].conv[i];
    return (struct layer_conv){.w = &l->conv[stage][i],
                               .kh = c->kernel,
                               .kw = c->kernel,
                               .stride = c->stride,
                               .pad = c->pad,
                               .channels = in->c,
                               .h = in->h,
                               .w_px = in->w};
}

static void plan_band(struct plan *p, const struct work *k, const struct band *b)
{
    struct extents px = k->in.px;
    px.h = b->to - b->from;
    for (int i = 0; i < stage_of(k)->n; i++) {
        const struct layer_conv c = conv_of(k->l, k->stage, i, &px);
        layer_conv_plan(p, &c);
        px = stage_size(&px, stage_of(k));
    }
}

void lpips_plan(struct plan *p, const struct lpips *l, int w, int h)
{
    const size_t mark = arena_mark(&p->tmp);
    struct work k = {.l = l, .in.px = {w, h, COLOURS}};
    err_t e = layout(&k, &p->tmp);
    for (; k.stage < LPIPS_STAGES && !e; k.stage++) {
        struct extents px;
        k.out = stage_size(&k.in.px, stage_of(&k));
        e = layout_next(&k, &p->tmp, &px);
        for (int y = 0; y < k.out.h; y += band_rows(&k)) {
            const struct band b = band_at(&k, y);
            plan_band(p, &k, &b);
        }
        k.in.px = px;
    }
    if (e)
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

/* ---- features ---- */

struct pixels {
    const float *px; // planar
    int w, h, from;  // first row
    bool centred;
};

static void fetch_pixels(const void *ctx, int y, int x, int n, float *out)
{
    const struct pixels *p = ctx;
    const float *row = p->px + (size_t)(p->from + y) * (size_t)p->w + (size_t)x;
    for (int i = 0; i < n; i++)
        for (int c = 0; c < COLOURS; c++) {
            const float v = row[(size_t)c * (size_t)p->w * (size_t)p->h + (size_t)i];
            *out++ = ((p->centred ? 2 * v - 1 : v) - shift[c]) / scale[c];
        }
}

/* The stage's features of picture i over a band, in one of two rooms. */
static err_t find_features(const struct work *k, int i, const struct band *b, float *const room[2],
                           float **out)
{
    const struct extents *in = &k->in.px;
    const struct pixels pixels = {k->in.map[i], in->w, in->h, b->from, k->l->centred};
    struct extents px = {in->w, b->to - b->from, in->c};
    struct layer_map map = {
        .px = k->in.map[i] + (size_t)b->from * (size_t)(in->w * in->c), .w = in->w, .c = in->c};
    err_t e = OK;
    for (int n = 0; n < stage_of(k)->n && !e; n++) {
        struct layer_conv c = conv_of(k->l, k->stage, n, &px);
        const bool first = k->stage == 0 && n == 0;
        c.fetch = first ? fetch_pixels : layer_map_fetch;
        c.ctx = first ? (const void *)&pixels : &map;
        *out = room[n % 2];
        e = layer_conv_run(
            k->r, &c, &(struct layer_out){.out = *out, .ldo = (size_t)c.w->n, .act = ACT_RELU});
        px = stage_size(&px, stage_of(k));
        map = (struct layer_map){.px = *out, .w = px.w, .c = px.c};
    }
    return e;
}

/* ---- comparison ---- */

struct compared {
    struct work *k;
    const struct band *b;
    const float *map[2]; // (rows, w, c) of the band, from row b->first on
    struct extents next; // of k->next
};

static double inverse_length(const float *v, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += (double)v[i] * (double)v[i];
    return 1 / (sqrt(sum) + EPS);
}

static err_t compare_row(void *ctx, int chunk, int worker)
{
    const struct compared *j = ctx;
    const struct extents *px = &j->k->out;
    const float *linear = j->k->l->linear[j->k->stage];
    const size_t at = (size_t)chunk * (size_t)px->w * (size_t)px->c;
    const float *a = j->map[0] + at, *b = j->map[1] + at;
    double sum = 0;
    (void)worker;
    for (int x = 0; x < px->w; x++, a += px->c, b += px->c) {
        const double of_a = inverse_length(a, px->c), of_b = inverse_length(b, px->c);
        for (int c = 0; c < px->c; c++) {
            const double d = (double)a[c] * of_a - (double)b[c] * of_b;
            sum += (double)linear[c] * d * d;
        }
    }
    j->k->row[j->b->first + chunk] = sum;
    return OK;
}

/* Largest values of the windows of a row of the next stage's input; y is of the whole map. */
static void reduce_row(const struct compared *j, int i, int y)
{
    const struct lpips_stage *s = stage_of(j->k) + 1;
    const size_t c = (size_t)j->next.c, pitch = (size_t)j->k->out.w * c;
    const float *from = j->map[i] + (size_t)(y * s->step - j->b->first) * pitch;
    float *out = j->k->next[i] + (size_t)y * (size_t)j->next.w * c;
    for (int x = 0; x < j->next.w; x++, out += c, from += (size_t)s->step * c) {
        memcpy(out, from, c * sizeof *out);
        for (int n = 1; n < s->window * s->window; n++) {
            const float *v = from + (size_t)(n / s->window) * pitch + (size_t)(n % s->window) * c;
            for (size_t k = 0; k < c; k++)
                out[k] = v[k] > out[k] ? v[k] : out[k];
        }
    }
}

static int first_reduced(const struct compared *j)
{
    return j->b->first / stage_of(j->k)[1].step;
}

static err_t reduce_chunk(void *ctx, int chunk, int worker)
{
    const struct compared *j = ctx;
    (void)worker;
    reduce_row(j, chunk % 2, first_reduced(j) + chunk / 2);
    return OK;
}

static err_t finish_band(struct compared *j)
{
    err_t e = pool_for(j->k->r->pool, j->b->end - j->b->first, compare_row, j);
    if (e || j->k->stage + 1 == LPIPS_STAGES)
        return e;
    const bool last = j->b->end == j->k->out.h;
    const int end = last ? j->next.h : j->b->end / stage_of(j->k)[1].step;
    return pool_for(j->k->r->pool, 2 * (end - first_reduced(j)), reduce_chunk, j);
}

static err_t run_band(struct work *k, const struct band *b, const struct extents *next)
{
    float *a = NULL, *other, *found = NULL;
    err_t e = find_features(k, 0, b, k->band, &a);
    if (e)
        return e;
    other = a == k->band[0] ? k->band[1] : k->band[0];
    e = find_features(k, 1, b, (float *const[2]){other, k->band[2]}, &found);
    if (e)
        return e;
    const size_t skip = (size_t)(b->first - b->from) * (size_t)(k->out.w * k->out.c);
    struct compared j = {k, b, {a + skip, found + skip}, *next};
    return finish_band(&j);
}

/* Adds the mean over the pixels of a stage and goes on to the next one. */
static err_t run_stage(struct work *k, double *sum)
{
    struct extents next;
    k->out = stage_size(&k->in.px, stage_of(k));
    err_t e = layout_next(k, k->r->tmp, &next);
    for (int y = 0; y < k->out.h && !e; y += band_rows(k)) {
        const struct band b = band_at(k, y);
        e = run_band(k, &b, &next);
    }
    double all = 0;
    for (int y = 0; y < k->out.h && !e; y++)
        all += k->row[y];
    *sum += all / ((double)k->out.w * (double)k->out.h);
    k->in = (struct input){next, {k->next[0], k->next[1]}};
    k->stage++;
    return e;
}

/* ---- all ---- */

err_t lpips_bind(const struct model *m, struct lpips *out)
{
    char name[NET_NAME_CAP];
    memset(out, 0, sizeof *out);
    out->layers = lpips_layers_of(m->dims.lpips);
    if (!out->layers)
        return err_fail(ERR_FORMAT, "these are weights of a network of scenes, not of LPIPS");
    err_t e = OK;
    for (int s = 0; s < LPIPS_STAGES && !e; s++) {
        const struct lpips_stage *stage = &out->layers->stage[s];
        for (int i = 0; i < stage->n && !e; i++) {
            snprintf(name, sizeof name, "features.%d", stage->conv[i].feature);
            e = model_weight(m, name, &out->conv[s][i]);
        }
        snprintf(name, sizeof name, TABLE_LINEAR "%d.model.1.weight", s);
        if (!e)
            e = model_plain(m, name, &out->linear[s]);
        for (int c = 0; c < stage->width && !e; c++)
            if (out->linear[s][c] < 0)
                e = err_fail(ERR_FORMAT, "tensor %s: element %d is %g, must be >= 0", name, c,
                             (double)out->linear[s][c]);
    }
    return e;
}

err_t lpips_check(const struct lpips *l, int w, int h)
{
    int least = 1;
    for (int s = LPIPS_STAGES - 1; s >= 0; s--) { // what gives one pixel at the end
        const struct lpips_conv *c = &l->layers->stage[s].conv[0];
        least = (least - 1) * c->stride + c->kernel - 2 * c->pad;
        least = (num_max(least, 1) - 1) * l->layers->stage[s].step + l->layers->stage[s].window;
    }
    if (w < least || h < least)
        return err_fail(ERR_ARG, "LPIPS of %s needs pictures of at least %d px, these have %d x %d",
                        l->layers->name, least, w, h);
    return OK;
}

err_t lpips_run(const struct run *r, const struct lpips *l, const struct image *a,
                const struct image *b, double *out)
{
    struct work k = {.r = r, .l = l, .in = {.px = {a->w, a->h, COLOURS}, .map = {a->px, b->px}}};
    const size_t mark = arena_mark(r->tmp);
    *out = 0;
    if (a->w != b->w || a->h != b->h || a->channels != COLOURS || b->channels != COLOURS)
        return err_fail(ERR_ARG, "LPIPS of pictures of %d x %d x %d and %d x %d x %d", a->w, a->h,
                        a->channels, b->w, b->h, b->channels);
    err_t e = lpips_check(l, a->w, a->h);
    if (!e)
        e = layout(&k, r->tmp);
    while (!e && k.stage < LPIPS_STAGES)
        e = run_stage(&k, out);
    arena_reset(r->tmp, mark);
    if (!e && !isfinite(*out))
        e = err_fail(ERR_ARG, "LPIPS is not a finite number: the pictures or the weights are not");
    return e;
}
