#include "core/photo/exposure_even.h"

#include "core/base/num.h"
#include "core/photo/response.h"

#include <math.h>
#include <string.h>

enum { PER_STOP = 64, REACH = 4, BINS = 2 * REACH * PER_STOP, PEERS_LEAST = 3 };

static const double SHARE_LEAST = 0.005; // of the values of a photograph, that two show well
static const float ALIKE = 0.05f;        // stops, exposures that are one

struct even {
    const struct run *r;
    const struct views *v;
    struct response_table table;
    float *stops;
    int *leader; // (n + n_more) the first photograph of this exposure; -1: alone in its place
};

/* Stops between the bins' lower end and the median; NAN: too few. */
static double find_median(const double bin[BINS], double least)
{
    double sum = 0, below = 0;
    for (int k = 0; k < BINS; k++)
        sum += bin[k];
    if (sum < least)
        return NAN;
    int k = 0;
    while (k < BINS - 1 && below + bin[k] < sum / 2)
        below += bin[k++];
    return (k + (sum / 2 - below) / fmax(bin[k], 1e-9)) / PER_STOP;
}

/* By how many stops photograph b is brighter against a than their exposures are apart. */
static double compare_photographs(const struct even *s, int a, int b)
{
    const struct views *v = s->v;
    const uint8_t *za = views_rgb(v, a), *zb = views_rgb(v, b);
    const size_t pixels = extent_pixels(&v->extent[a]);
    const float apart = v->log2t[b] - v->log2t[a];
    double bin[BINS] = {0};
    for (size_t k = 0; k < pixels; k++)
        for (size_t c = 0; c < 3 && !views_hides(v, a, k) && !views_hides(v, b, k); c++) {
            const uint8_t x = za[3 * k + c], y = zb[3 * k + c];
            const float weight = fminf(s->table.weight[c][x], s->table.weight[c][y]);
            const float d = s->table.x[c][y] - s->table.x[c][x] - apart;
            const int at = (int)((fminf(fmaxf(d, -REACH), REACH) + REACH) * PER_STOP);
            bin[num_min(at, BINS - 1)] += (double)weight;
        }
    const double d = find_median(bin, SHARE_LEAST * 3 * (double)pixels);
    return isnan(d) ? 0 : d - REACH;
}

/* The photograph of the place whose exposure is next above that of `from`; -1: none. */
static int next_longer(const struct views *v, int place, int from)
{
    const float t = from < 0 ? -INFINITY : v->log2t[from];
    int best = -1;
    for (int i = place; i >= 0; i = views_next(v, place, i)) {
        const float own = v->log2t[i];
        if ((own > t || (own == t && i > from)) && (best < 0 || own < v->log2t[best]))
            best = i;
    }
    return best;
}

static void centre_place(const struct even *s, int place)
{
    double sum = 0;
    int n = 0;
    for (int i = place; i >= 0; i = views_next(s->v, place, i), n++)
        sum += (double)s->stops[i];
    for (int i = place; i >= 0; i = views_next(s->v, place, i))
        s->stops[i] -= (float)(sum / n);
}

/* Each against the next longer one. */
static err_t measure_place(void *ctx, int place, int worker)
{
    const struct even *s = ctx;
    double stops = 0;
    (void)worker;
    for (int i = next_longer(s->v, place, -1), last = -1; i >= 0; i = next_longer(s->v, place, i)) {
        stops += last < 0 ? 0 : compare_photographs(s, last, i);
        s->stops[i] = (float)stops;
        last = i;
    }
    centre_place(s, place);
    return run_check(s->r, "exposures");
}

static void find_leaders(const struct even *s)
{
    const struct views *v = s->v;
    for (int i = 0; i < v->n; i++)
        s->leader[i] = -1;
    for (int k = 0; k < v->n_more; k++)
        s->leader[v->n + k] = s->leader[v->place[k]] = 0;
    for (int i = 0; i < v->n + v->n_more; i++) {
        int k = 0;
        while (k < i && !(s->leader[k] == k && fabsf(v->log2t[k] - v->log2t[i]) < ALIKE))
            k++;
        s->leader[i] = s->leader[i] < 0 ? -1 : k;
    }
}

/* Take the mean out of the photographs of an exposure; of few, nothing is known. */
static void centre_exposure(const struct even *s, int leader)
{
    const int all = s->v->n + s->v->n_more;
    double sum = 0;
    int n = 0;
    for (int i = leader; i < all; i++)
        if (s->leader[i] == leader) {
            sum += (double)s->stops[i];
            n++;
        }
    for (int i = leader; i < all; i++)
        if (s->leader[i] == leader)
            s->stops[i] = n < PEERS_LEAST ? 0 : s->stops[i] - (float)(sum / n);
}

static err_t layout(struct even *s, struct arena *tmp, const struct views *v)
{
    return arena_alloc(tmp, (size_t)(v->n + v->n_more), sizeof *s->leader, &s->leader);
}

void exposure_even_plan(struct plan *p, const struct views *v)
{
    struct even s;
    const size_t mark = arena_mark(&p->tmp);
    if (layout(&s, &p->tmp, v))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t exposure_even_run(const struct run *r, const struct views *v, const struct tonemap *tone,
                        float *stops)
{
    const int n = v->n + v->n_more;
    struct even s = {.r = r, .v = v, .stops = stops};
    double square = 0;
    const size_t mark = arena_mark(r->tmp);
    response_tabulate(tone, &s.table);
    err_t e = layout(&s, r->tmp, v);
    if (!e) {
        find_leaders(&s);
        e = pool_for(r->pool, v->n, measure_place, &s);
    }
    for (int i = 0; i < n && !e && !v->srgb; i++)
        if (s.leader[i] == i)
            centre_exposure(&s, i);
    arena_reset(r->tmp, mark);
    for (int i = 0; i < v->n && !e; i++)
        centre_place(&s, i);
    for (int i = 0; i < n && !e; i++)
        square += (double)stops[i] * (double)stops[i];
    if (e || square < n * EXPOSURE_EVEN_LEAST * EXPOSURE_EVEN_LEAST)
        memset(stops, 0, (size_t)n * sizeof *stops);
    return e;
}
