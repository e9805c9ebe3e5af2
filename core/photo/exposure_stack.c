/* The information of a pixel is the weight of its display value (response.h): zero if black or
 * saturated, little on the toe of the curve.
 * - Choice: first the photograph with the largest sum of weights, then the one that raises the
 *   best weight of every pixel most, until none raises the mean by GAIN (Hasinoff et al. 2010
 *   choose exposures by such a gain).
 *   Masked pixels have none.
 * - Picture: the mean of log radiance, each photograph by its inverse variance. Where none has
 *   information, a saturated photograph gives a lower and a black one an upper bound: the tightest
 *   counts, or the middle between both. It is written as the mean display value over all
 *   exposures between the shortest and the longest. */
#include "core/photo/exposure_stack.h"

#include "core/base/num.h"
#include "core/photo/response.h"

#include <math.h>
#include <string.h>

enum {
    CELLS = 64,
    REACH = 32,
    ENTRIES = 2 * REACH * CELLS
}; // table of the curve: entries per stop; stops; entries

static const double GAIN = 0.001; // relative to the largest mean weight

struct stack {
    const struct run *r;
    const struct views *v;
    struct response_table table;
    bool staggered;
    uint8_t level[3][256]; // weight
    size_t most;           // values of the largest photograph
    uint8_t *best;         // (workers, most) level
    bool *keep;            // (n + n_more)
    int *first;            // (n) the photograph that represents the place
    float x[3][256];       // log2 of radiance at exposure 0
    float w[3][256];       // inverse variance
    uint8_t (*code)[3];    // (ENTRIES) display value of log2 radiance
    uint8_t *out;          // (n) pictures (h, w, 3)
    uint8_t *masked;       // (n) pictures (h, w); NULL: nothing is
};

/* Values of a photograph of the place. */
static size_t count_values(const struct views *v, int place)
{
    return 3 * extent_pixels(&v->extent[place]);
}

/* ---- choice ---- */

/* Sum by which photograph i raises the best levels. */
static long gain_of(const struct stack *s, int i, const uint8_t *best)
{
    const uint8_t *p = views_rgb(s->v, i);
    long gain = 0;
    for (size_t k = 0; k < extent_pixels(&s->v->extent[i]); k++)
        for (size_t c = 0; c < 3 && !views_hides(s->v, i, k); c++) {
            int more = s->level[c][p[3 * k + c]] - best[3 * k + c];
            gain += more > 0 ? more : 0;
        }
    return gain;
}

static void raise_levels(const struct stack *s, int i, uint8_t *best)
{
    const uint8_t *p = views_rgb(s->v, i);
    for (size_t k = 0; k < extent_pixels(&s->v->extent[i]); k++)
        for (size_t c = 0; c < 3 && !views_hides(s->v, i, k); c++)
            if (s->level[c][p[3 * k + c]] > best[3 * k + c])
                best[3 * k + c] = s->level[c][p[3 * k + c]];
}

/* The kept photograph of a place with `rank` shorter ones. */
static int photo_of_rank(const struct stack *s, int place, int rank)
{
    for (int i = place; i >= 0; i = views_next(s->v, place, i)) {
        int shorter = 0;
        for (int k = place; k >= 0; k = views_next(s->v, place, k))
            shorter += s->keep[k] && (s->v->log2t[k] < s->v->log2t[i] ||
                                      (s->v->log2t[k] == s->v->log2t[i] && k < i));
        if (s->keep[i] && shorter == rank)
            return i;
    }
    return place;
}

static err_t choose_place(void *ctx, int place, int worker)
{
    struct stack *s = ctx;
    const size_t values = count_values(s->v, place);
    uint8_t *best = s->best + s->most * (size_t)worker;
    const long least = (long)(GAIN * 255 * (double)values);
    int n = 0;
    memset(best, 0, values);
    for (int top = place; top >= 0; n++) {
        long most = n ? least : -1; // one is always kept
        top = -1;
        for (int i = place; i >= 0; i = views_next(s->v, place, i)) {
            long gain = s->keep[i] ? 0 : gain_of(s, i, best);
            if (!s->keep[i] && gain > most) {
                most = gain;
                top = i;
            }
        }
        if (top < 0)
            break;
        s->keep[top] = true;
        raise_levels(s, top, best);
        s->first[place] = n ? s->first[place] : top;
    }
    const int turn[3] = {n / 2, 0, n - 1};
    if (s->staggered)
        s->first[place] = photo_of_rank(s, place, turn[place % 3]);
    return run_check(s->r, "exposures");
}

static void swap_bytes(void *a, void *b, size_t n)
{
    uint8_t *p = a, *q = b;
    for (size_t k = 0; k < n; k++) {
        const uint8_t x = p[k];
        p[k] = q[k];
        q[k] = x;
    }
}

static void swap_photos(struct views *v, int a, int b)
{
    const size_t pixels = extent_pixels(&v->extent[a]);
    if (a == b)
        return;
    swap_bytes(views_rgb(v, a), views_rgb(v, b), 3 * pixels);
    if (v->masked)
        swap_bytes(views_masked(v, a), views_masked(v, b), pixels);
    if (v->deep)
        swap_bytes(views_rgb16(v, a), views_rgb16(v, b), 6 * pixels);
    swap_bytes(v->names[a], v->names[b], NAME_CAP);
    swap_bytes(&v->log2t[a], &v->log2t[b], sizeof *v->log2t);
}

void exposure_stack_drop(struct views *v, const bool *keep)
{
    size_t at = 0;
    int n = 0, places = 0, before = v->n;
    for (int i = 0; i < before + v->n_more; i++) {
        int place = i < before ? i : v->place[i - before], rank = 0;
        if (!keep[i] || !keep[place])
            continue;
        for (int k = 0; k < place; k++)
            rank += keep[k];
        memmove(v->names[n], v->names[i], NAME_CAP);
        memmove(v->rgb + 3 * at, views_rgb(v, i), 3 * extent_pixels(&v->extent[i]));
        if (v->masked)
            memmove(v->masked + at, views_masked(v, i), extent_pixels(&v->extent[i]));
        if (v->deep)
            memmove(v->rgb16 + 3 * at, views_rgb16(v, i), 6 * extent_pixels(&v->extent[i]));
        v->extent[n] = (struct extent){v->extent[i].w, v->extent[i].h, at};
        at += extent_pixels(&v->extent[n]);
        v->log2t[n] = v->log2t[i];
        if (i < before && v->cams)
            v->cams[places] = v->cams[i];
        if (i >= before)
            v->place[n - places] = rank;
        places += i < before;
        n++;
    }
    v->n = places;
    v->n_more = n - places;
}

static void exposure_span(const float *log2t, int n, float *lo, float *hi)
{
    *lo = *hi = log2t[0];
    for (int i = 1; i < n; i++) {
        *lo = fminf(*lo, log2t[i]);
        *hi = fmaxf(*hi, log2t[i]);
    }
}

static err_t layout_choice(struct stack *s, struct arena *tmp, const struct views *v, int threads)
{
    s->most = 3 * extent_cover(v->extent, v->n).at;
    err_t e = arena_alloc(tmp, (size_t)threads, s->most, &s->best);
    if (!e)
        e = arena_zalloc(tmp, (size_t)(v->n + v->n_more), sizeof *s->keep, &s->keep);
    return e ? e : arena_zalloc(tmp, (size_t)v->n, sizeof *s->first, &s->first);
}

void exposure_stack_choose_plan(struct plan *p, const struct views *v)
{
    struct stack s = {.most = 0};
    const size_t mark = arena_mark(&p->tmp);
    if (v->n_more && layout_choice(&s, &p->tmp, v, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t exposure_stack_choose(const struct run *r, const struct tonemap *tone, bool staggered,
                            struct views *io)
{
    struct stack s = {.r = r, .v = io, .staggered = staggered};
    const size_t mark = arena_mark(r->tmp);
    if (io->n_more == 0)
        return OK;
    response_tabulate(tone, &s.table);
    for (int k = 0; k < 3 * 256; k++)
        s.level[k / 256][k % 256] = (uint8_t)lrintf(255 * s.table.weight[k / 256][k % 256]);
    err_t e = layout_choice(&s, r->tmp, io, pool_size(r->pool));
    if (!e)
        e = pool_for(r->pool, io->n, choose_place, &s);
    for (int i = 0; i < io->n && !e; i++) {
        swap_photos(io, i, s.first[i]);
        s.keep[s.first[i]] = s.keep[i];
        s.keep[i] = true;
    }
    if (!e) {
        float lo, hi;
        exposure_stack_drop(io, s.keep);
        exposure_span(io->log2t, staggered ? io->n : io->n + io->n_more, &lo, &hi);
        io->mid_log2t = (lo + hi) / 2;
    }
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- one picture ---- */

/* log2 of the radiance of one value, from all photographs of its place. */
static float pixel_radiance(const struct stack *s, int place, size_t at)
{
    const size_t c = at % 3;
    float sum = 0, weight = 0, least = -INFINITY, most = INFINITY;
    for (int i = place; i >= 0; i = views_next(s->v, place, i)) {
        const uint8_t z = views_rgb(s->v, i)[at];
        if (views_hides(s->v, i, at / 3))
            continue;
        const float x = s->x[c][z] - s->v->log2t[i];
        sum += s->w[c][z] * x;
        weight += s->w[c][z];
        if (z < 128)
            most = fminf(most, x);
        else
            least = fmaxf(least, x);
    }
    if (weight > 0)
        return sum / weight;
    if (isinf(least) && isinf(most)) // all are masked
        return 0;
    return isinf(least) ? most : isinf(most) ? least : (least + most) / 2;
}

/* What is masked in all photographs of the place. */
static void merge_masks(const struct stack *s, int place)
{
    uint8_t *out = s->masked + s->v->extent[place].at;
    const size_t n = extent_pixels(&s->v->extent[place]);
    memset(out, 1, n);
    for (int i = place; i >= 0; i = views_next(s->v, place, i))
        for (size_t k = 0; k < n; k++)
            out[k] &= views_masked(s->v, i)[k];
}

static err_t merge_place(void *ctx, int place, int worker)
{
    const struct stack *s = ctx;
    uint8_t *out = s->out + 3 * s->v->extent[place].at;
    (void)worker;
    if (s->masked)
        merge_masks(s, place);
    for (size_t at = 0; at < count_values(s->v, place); at++) {
        float x = (pixel_radiance(s, place, at) + REACH) * CELLS;
        int cell = !(x > 0) ? 0 : x < ENTRIES - 1 ? (int)x : ENTRIES - 1;
        out[at] = s->code[cell][at % 3];
    }
    return run_check(s->r, "exposures");
}

static void fill_tables(struct stack *s, const struct tonemap *tone, const struct tonemap *curve,
                        float log2t)
{
    response_tabulate(tone, &s->table);
    for (int k = 0; k < 3 * 256; k++) {
        const float w = s->table.weight[k / 256][k % 256];
        s->x[k / 256][k % 256] = s->table.x[k / 256][k % 256] + tone->mid_log2t;
        s->w[k / 256][k % 256] = w / (1.02f - w); // from w = 1 / (1 + variance)
    }
    for (int k = 0; k < 3 * ENTRIES; k++) {
        float x = ((float)(k / 3) + 0.5f) / CELLS - REACH + log2t - curve->mid_log2t;
        s->code[k / 3][k % 3] = (uint8_t)lrintf(255 * response_display(curve, k % 3, x));
    }
}

static err_t layout_merged(struct stack *s, struct arena *tmp, const struct views *v,
                           struct views *out)
{
    const size_t pixels = extent_total(v->extent, v->n);
    err_t e = arena_alloc(tmp, pixels, 3, &s->out);
    if (!e && (v->masked || tmp->counts)) // a plan does not know
        e = arena_alloc(tmp, pixels, 1, &s->masked);
    if (!e)
        e = arena_alloc(tmp, (size_t)v->n, sizeof *out->log2t, &out->log2t);
    return e ? e : arena_alloc(tmp, ENTRIES, sizeof *s->code, &s->code);
}

void exposure_stack_merge_plan(struct plan *p, const struct views *v)
{
    struct stack s;
    struct views out;
    if (v->n_more && layout_merged(&s, &p->tmp, v, &out))
        plan_refuse(p);
}

err_t exposure_stack_merge(const struct run *r, const struct views *v, const struct tonemap *tone,
                           struct views *out, struct tonemap *curve)
{
    struct stack s = {.r = r, .v = v};
    float lo, hi, counts_as;
    *out = *v;
    *curve = *tone;
    if (v->n_more == 0)
        return OK;
    exposure_span(v->log2t, v->n + v->n_more, &lo, &hi);
    response_spread(tone, lo - tone->mid_log2t, hi - tone->mid_log2t, curve, &counts_as);
    err_t e = layout_merged(&s, r->tmp, v, out);
    if (!e) {
        fill_tables(&s, tone, curve, counts_as);
        e = pool_for(r->pool, v->n, merge_place, &s);
    }
    for (int i = 0; i < v->n && !e; i++)
        out->log2t[i] = counts_as;
    out->rgb = s.out;
    out->masked = s.masked;
    out->rgb16 = NULL;
    out->deep = false;
    out->drift = NULL;
    out->mid_log2t = curve->mid_log2t;
    out->n_more = 0;
    return e;
}
