/* Vectors of locally aggregated descriptors (Jegou et al., "Aggregating local descriptors into a
 * compact image representation", CVPR 2010): typical corners, the words, are found by k-means among
 * the views' own corners; a view is the sum, for each word, of what its corners nearest to that
 * word differ from it. Each word's part is brought to length 1 (Arandjelovic and Zisserman, "All
 * about VLAD", CVPR 2013), so that what repeats itself over a view, as leaves and bricks do, counts
 * once. All sums are whole numbers. */
#include "core/sfm/retrieve.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum {
    WORDS = 64,
    SAMPLE = 1 << 14, // corners that words are found from
    ROUNDS = 8,       // of k-means
    ROWS = 64,        // corners whose words are found at once
    GLOBAL = WORDS * CORNER_DESCRIPTOR
};

/* Scratch of a worker. */
struct room {
    int32_t *product; // (ROWS, WORDS)
    int32_t *sum;     // (WORDS, CORNER_DESCRIPTOR)
    int *word;        // (cap)
    float *alike;     // (views) of the most similar ones
};

struct retrieve {
    const struct run *r;
    const struct pair_views *m;
    int most, *near;
    int n;              // corners in the sample
    int8_t *sample;     // (n, CORNER_DESCRIPTOR)
    int *word;          // (n)
    int8_t *words;      // (WORDS, CORNER_DESCRIPTOR)
    int8_t *panels;     // the same, packed for gemm_s8
    int32_t *square;    // (WORDS)
    float *global;      // (views, GLOBAL) of length 1, or 0
    struct room *rooms; // (workers)
};

static err_t layout_room(struct room *w, struct arena *tmp, const struct pair_views *m)
{
    err_t e = arena_alloc(tmp, ROWS * WORDS, sizeof *w->product, &w->product);
    if (!e)
        e = arena_alloc(tmp, GLOBAL, sizeof *w->sum, &w->sum);
    if (!e)
        e = arena_alloc(tmp, (size_t)m->cap, sizeof *w->word, &w->word);
    return e ? e : arena_alloc(tmp, (size_t)m->n, sizeof *w->alike, &w->alike);
}

static err_t layout(struct retrieve *s, struct arena *tmp, int threads)
{
    err_t e = arena_alloc(tmp, SAMPLE, CORNER_DESCRIPTOR, &s->sample);
    if (!e)
        e = arena_alloc(tmp, SAMPLE, sizeof *s->word, &s->word);
    if (!e)
        e = arena_zalloc(tmp, WORDS, CORNER_DESCRIPTOR, &s->words);
    if (!e)
        e = arena_alloc(tmp, WORDS, CORNER_DESCRIPTOR, &s->panels);
    if (!e)
        e = arena_alloc(tmp, WORDS, sizeof *s->square, &s->square);
    if (!e)
        e = arena_alloc(tmp, (size_t)s->m->n * GLOBAL, sizeof *s->global, &s->global);
    if (!e)
        e = arena_alloc(tmp, (size_t)threads, sizeof *s->rooms, &s->rooms);
    for (int i = 0; i < threads && !e; i++) {
        struct room w;
        e = layout_room(&w, tmp, s->m);
        if (!e && !tmp->counts)
            s->rooms[i] = w;
    }
    return e;
}

/* ---- words ---- */

/* Corners evenly spread over all views. */
static void draw_sample(struct retrieve *s)
{
    int64_t all = 0, at = 0;
    for (int i = 0; i < s->m->n; i++)
        all += s->m->view[i].n;
    s->n = (int)(all < SAMPLE ? all : SAMPLE);
    for (int i = 0, k = 0; i < s->m->n; i++)
        for (int c = 0; c < s->m->view[i].n; c++, at++)
            if (k < s->n && at * s->n >= k * all)
                memcpy(s->sample + (size_t)k++ * CORNER_DESCRIPTOR,
                       s->m->view[i].descriptor[0] + (size_t)c * CORNER_DESCRIPTOR,
                       CORNER_DESCRIPTOR);
}

static void pack_words(struct retrieve *s)
{
    pair_pack(s->words, WORDS, s->panels);
    for (int k = 0; k < WORDS; k++) {
        s->square[k] = 0;
        for (int i = 0; i < CORNER_DESCRIPTOR; i++)
            s->square[k] +=
                s->words[k * CORNER_DESCRIPTOR + i] * s->words[k * CORNER_DESCRIPTOR + i];
    }
}

/* The nearest word of each of n descriptors; the first of equal ones. */
static void find_words(const struct retrieve *s, const int8_t *descriptor, int n, int32_t *product,
                       int *word)
{
    for (int from = 0; from < n; from += ROWS) {
        const int rows = num_min(ROWS, n - from);
        s->m->k->net.s8(&(struct gemm_s8){.m = rows,
                                          .panels = WORDS / PANEL,
                                          .segs = 1,
                                          .seg = CORNER_DESCRIPTOR,
                                          .a = descriptor + (size_t)from * CORNER_DESCRIPTOR,
                                          .lda = CORNER_DESCRIPTOR,
                                          .w = s->panels,
                                          .ldw = PANEL * CORNER_DESCRIPTOR,
                                          .c = product,
                                          .ldc = WORDS});
        for (int i = 0; i < rows; i++) {
            const int32_t *row = product + i * WORDS;
            int best = 0;
            for (int k = 1; k < WORDS; k++)
                best = 2 * row[k] - s->square[k] > 2 * row[best] - s->square[best] ? k : best;
            word[from + i] = best;
        }
    }
}

static err_t assign_chunk(void *ctx, int chunk, int worker)
{
    struct retrieve *s = ctx;
    const int from = chunk * ROWS, n = num_min(ROWS, s->n - from);
    find_words(s, s->sample + (size_t)from * CORNER_DESCRIPTOR, n, s->rooms[worker].product,
               s->word + from);
    return run_check(s->r, "similar views");
}

/* Each word becomes the mean of its corners; one without stays. sum: (WORDS, CORNER_DESCRIPTOR) */
static void move_words(struct retrieve *s, int32_t *sum)
{
    int count[WORDS] = {0};
    memset(sum, 0, GLOBAL * sizeof *sum);
    for (int k = 0; k < s->n; k++) {
        int32_t *to = sum + s->word[k] * CORNER_DESCRIPTOR;
        count[s->word[k]]++;
        for (int i = 0; i < CORNER_DESCRIPTOR; i++)
            to[i] += s->sample[(size_t)k * CORNER_DESCRIPTOR + (size_t)i];
    }
    for (int k = 0; k < GLOBAL; k++) {
        const int n = count[k / CORNER_DESCRIPTOR];
        s->words[k] = n ? (int8_t)((sum[k] + n / 2) / n) : s->words[k]; // parts are not below 0
    }
}

static err_t learn_words(struct retrieve *s)
{
    err_t e = OK;
    draw_sample(s);
    for (int k = 0; k < num_min(WORDS, s->n); k++)
        memcpy(s->words + (size_t)k * CORNER_DESCRIPTOR,
               s->sample + (size_t)k * (size_t)s->n / WORDS * CORNER_DESCRIPTOR, CORNER_DESCRIPTOR);
    pack_words(s);
    for (int round = 0; round < ROUNDS && !e; round++) {
        e = pool_for(s->r->pool, (s->n + ROWS - 1) / ROWS, assign_chunk, s);
        if (!e)
            move_words(s, s->rooms[0].sum);
        pack_words(s);
    }
    return e;
}

/* ---- views ---- */

/* Bring a vector to length 1 unless it is 0. */
static void normalise(float *x, int n)
{
    float sum = 0;
    for (int i = 0; i < n; i++)
        sum += x[i] * x[i];
    for (int i = 0; i < n && sum > 0; i++)
        x[i] /= sqrtf(sum);
}

static err_t describe_view(void *ctx, int i, int worker)
{
    struct retrieve *s = ctx;
    struct room *w = s->rooms + worker;
    const struct corner_view *c = s->m->view + i;
    float *out = s->global + (size_t)i * GLOBAL;
    memset(w->sum, 0, GLOBAL * sizeof *w->sum);
    find_words(s, c->descriptor[0], c->n, w->product, w->word);
    for (int k = 0; k < c->n; k++) {
        const int8_t *from = c->descriptor[0] + (size_t)k * CORNER_DESCRIPTOR;
        const int8_t *word = s->words + w->word[k] * CORNER_DESCRIPTOR;
        int32_t *to = w->sum + w->word[k] * CORNER_DESCRIPTOR;
        for (int q = 0; q < CORNER_DESCRIPTOR; q++)
            to[q] += from[q] - word[q];
    }
    for (int k = 0; k < GLOBAL; k++)
        out[k] = (float)w->sum[k];
    for (int k = 0; k < WORDS; k++)
        normalise(out + k * CORNER_DESCRIPTOR, CORNER_DESCRIPTOR);
    normalise(out, GLOBAL);
    return run_check(s->r, "similar views");
}

static float similarity_of(const float *a, const float *b)
{
    enum { LANES = 8 };
    float lane[LANES] = {0}, sum = 0;
    for (int k = 0; k < GLOBAL; k += LANES)
        for (int i = 0; i < LANES; i++)
            lane[i] += a[k + i] * b[k + i];
    for (int i = 0; i < LANES; i++)
        sum += lane[i];
    return sum;
}

/* The most similar views so far are in order; of equal ones the first stays first. */
static err_t compare_view(void *ctx, int i, int worker)
{
    struct retrieve *s = ctx;
    int *near = s->near + (size_t)i * (size_t)s->most, n = 0;
    float *alike = s->rooms[worker].alike;
    for (int j = 0; j < s->m->n; j++) {
        if (j == i)
            continue;
        const float x =
            similarity_of(s->global + (size_t)i * GLOBAL, s->global + (size_t)j * GLOBAL);
        int at = n;
        n = num_min(n + 1, s->most);
        for (; at > 0 && x > alike[at - 1]; at--) {
            if (at < s->most) {
                alike[at] = alike[at - 1];
                near[at] = near[at - 1];
            }
        }
        if (at < s->most) {
            alike[at] = x;
            near[at] = j;
        }
    }
    return run_check(s->r, "similar views");
}

/* ---- the whole ---- */

void retrieve_plan(struct plan *p, const struct pair_views *m)
{
    struct retrieve s = {.m = m};
    const size_t mark = arena_mark(&p->tmp);
    if (layout(&s, &p->tmp, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t retrieve_run(const struct run *r, const struct pair_views *m, int most, int *near)
{
    const size_t mark = arena_mark(r->tmp);
    struct retrieve s = {.r = r, .m = m, .most = most, .near = near};
    err_t e = layout(&s, r->tmp, pool_size(r->pool));
    if (!e)
        e = learn_words(&s);
    if (!e)
        e = pool_for(r->pool, m->n, describe_view, &s);
    if (!e)
        e = pool_for(r->pool, m->n, compare_view, &s);
    arena_reset(r->tmp, mark);
    return e;
}
