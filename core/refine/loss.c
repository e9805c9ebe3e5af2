/* Three passes over chunks of rows:
 * 1. tone mapping of every colour: display value, position x on the curve and its segment;
 * 2. window means of x, y, xx, yy, xy (separable blur, a ring of 11 blurred rows), SSIM and its
 *    derivatives by three of the means, written to maps with a zero border;
 * 3. the same blur of these maps is the transposed one, so d SSIM / d x = blur(m0) + 2 x blur(m1) +
 *    y blur(m2); L1, held-out squares, then the chain rule of the tone curve.
 * Sums per chunk are added in chunk order. */
#include "core/refine/loss.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum {
    ROWS = 16, // per chunk
    EDGE = LOSS_WINDOW - 1,
    MEANS = 5,
    SEGMENTS = TONE_HIDDEN + 1
};

_Static_assert((int)ROWS == (int)TILE && (int)EDGE <= (int)RASTER_HALO,
               "a rank's rows begin with a chunk, and its picture reaches as far as its windows");

enum { // partial sums of one chunk
    P_L1,
    P_SSIM,
    P_SSE,
    P_HELD,
    P_G0,
    P_G1 = P_G0 + 3 * SEGMENTS,
    P_ALL = P_G1 + 3 * SEGMENTS
};

static int chunks_of(int rows)
{
    return (rows + ROWS - 1) / ROWS;
}

static size_t stride_of(int w)
{
    return ((size_t)w + EDGE + 15) / 16 * 16;
}

static size_t scratch_of(int w)
{
    return stride_of(w) * (MEANS * (LOSS_WINDOW + 1) + MEANS + 4);
}

err_t loss_init(struct loss *l, struct arena *a, int w, int h, int workers)
{
    memset(l, 0, sizeof *l);
    if (w < LOSS_WINDOW || h < LOSS_WINDOW || w > RASTER_SIDE_MAX || h > RASTER_SIDE_MAX)
        return err_fail(ERR_ARG, "loss: picture of %d x %d px, a side must be in [%d, %d]", w, h,
                        LOSS_WINDOW, RASTER_SIDE_MAX);
    l->w = w;
    l->h = h;
    size_t px = (size_t)w * (size_t)h, s = stride_of(w);
    double sum = 0;
    for (int k = 0; k < LOSS_WINDOW; k++)
        sum += exp(-0.5 * (k - 5) * (k - 5) / 2.25);
    for (int k = 0; k < LOSS_WINDOW; k++)
        l->taps[k] = (float)(exp(-0.5 * (k - 5) * (k - 5) / 2.25) / sum);
    l->scratch_floats = scratch_of(w);
    err_t e = arena_alloc(a, 3 * px, 4, &l->ldr);
    if (!e)
        e = arena_alloc(a, 3 * px, 4, &l->x);
    if (!e)
        e = arena_alloc(a, 3 * px, 4, &l->slope);
    if (!e)
        e = arena_alloc(a, 3 * px, 1, &l->segment);
    if (!e)
        e = arena_alloc(a, 9 * ((size_t)h + EDGE) * s, 4, &l->maps);
    if (!e)
        e = arena_alloc(a, l->scratch_floats * (size_t)workers, 4, &l->scratch);
    if (!e)
        e = arena_alloc(a, (size_t)chunks_of(h) * P_ALL, 8, &l->partial);
    if (!e)
        e = arena_alloc(a, (size_t)TEAM_MAX * P_ALL, 8, &l->totals);
    if (!e)
        e = arena_alloc(a, 3 * px, 4, &l->d_radiance);
    return e ? e : arena_alloc(a, px, 4, &l->d_alpha);
}

size_t loss_plan(int w, int h, int workers)
{
    struct arena a = arena_counter();
    struct loss l;
    return loss_init(&l, &a, w, h, workers) ? SIZE_MAX : a.peak;
}

struct job {
    const struct run *r;
    struct loss *l;
    const struct loss_input *in;
    struct tonemap_table table;
    int w, h;
    size_t px;
    int first, end; // rows that are compared here
};

struct span { // half open
    int row0, row1;
};

/* Rows of a chunk within [row0, row1). */
static struct span rows_of(int chunk, int row0, int row1)
{
    return (struct span){num_max(chunk * ROWS, row0), num_min((chunk + 1) * ROWS, row1)};
}

/* The first chunk with rows whose windows reach those that are compared here. */
static int chunk_above(const struct job *j)
{
    return num_max(j->first - EDGE, 0) / ROWS;
}

static struct tone_row tone_row_of(const struct job *j, int colour, int y)
{
    size_t row = (size_t)y * (size_t)j->w, at = (size_t)colour * j->px + row;
    return (struct tone_row){.curve = &j->table.c[colour],
                             .radiance = j->in->pic->radiance + at,
                             .alpha = j->in->pic->alpha + row,
                             .shift = j->in->shift,
                             .behind = j->in->behind[colour],
                             .x = j->l->x + at,
                             .slope = j->l->slope + at,
                             .ldr = j->l->ldr + at,
                             .segment = j->l->segment + at,
                             .n = j->w};
}

static err_t tone_chunk(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    (void)worker;
    const struct span s =
        rows_of(chunk + chunk_above(j), num_max(j->first - EDGE, 0), num_min(j->end + EDGE, j->h));
    for (int y = s.row0; y < s.row1; y++)
        for (int c = 0; c < 3; c++) {
            struct tone_row row = tone_row_of(j, c, y);
            j->r->k->tone_row(&row);
        }
    return OK;
}

static float *map_row(const struct job *j, int colour, int k, int row)
{
    size_t s = (size_t)j->l->stride;
    return j->l->maps + ((size_t)(3 * colour + k) * ((size_t)j->h + EDGE) + (size_t)row) * s;
}

static int photo_w(const struct job *j)
{
    return j->in->photo_w ? j->in->photo_w : j->w;
}

static int photo_h(const struct job *j)
{
    return j->in->photo_h ? j->in->photo_h : j->h;
}

/* Of a row of the picture in a plane of the photograph. */
static size_t row_at(const struct job *j, int y)
{
    return (size_t)(j->in->y + y) * (size_t)photo_w(j) + (size_t)j->in->x;
}

/* A row of the photograph as codes, 255 is 1. */
static void read_codes(const struct job *j, int colour, int y, float *out)
{
    const struct loss_input *in = j->in;
    const size_t plane = (size_t)photo_w(j) * (size_t)photo_h(j);
    const size_t at = (size_t)colour * plane + row_at(j, y);
    for (int i = 0; i < j->w; i++)
        out[i] = in->photo16 ? (float)in->photo16[at + (size_t)i] * (1.0f / 257.0f)
                             : (float)in->photo[at + (size_t)i];
}

static size_t cell_at(const struct job *j, int y)
{
    const struct loss_input *in = j->in;
    return (size_t)((in->y + y) / in->cell_px) * (size_t)in->cells_across +
           (size_t)(in->x / in->cell_px);
}

/* Where the photograph is left out, a row becomes the codes of ldr; NULL: 0. */
static void replace_skipped(const struct job *j, int y, const float *ldr, float *row)
{
    const int px = j->in->cell_px;
    if (!j->in->skip)
        return;
    const uint8_t *skip = j->in->skip + cell_at(j, y);
    for (int from = 0; from < j->w; from += px)
        for (int i = from; i < num_min(from + px, j->w) && skip[from / px]; i++)
            row[i] = ldr ? 255.0f * ldr[i] : 0;
}

/* The same where it is masked. */
static void replace_masked(const struct job *j, int y, const float *ldr, float *row)
{
    const struct loss_input *in = j->in;
    if (!in->masked)
        return;
    const uint8_t *masked = in->masked + row_at(j, y);
    for (int i = 0; i < j->w; i++)
        if (masked[i])
            row[i] = ldr ? 255.0f * ldr[i] : 0;
}

static const float *ldr_row(const struct job *j, int colour, int y)
{
    return j->l->ldr + (size_t)colour * j->px + (size_t)y * (size_t)j->w;
}

static void code_row(const struct job *j, int colour, int y, float *out)
{
    read_codes(j, colour, y, out);
    replace_masked(j, y, ldr_row(j, colour, y), out);
    replace_skipped(j, y, ldr_row(j, colour, y), out);
}

static void ssim_rows(const struct job *j, int colour, int row0, int row1, float *scratch,
                      double *sum)
{
    size_t s = (size_t)j->l->stride;
    int n = j->w - EDGE;
    float *ring = scratch, *means = scratch + s * MEANS * LOSS_WINDOW, *line = means + s * MEANS;
    float *d = line + 2 * s, *codes = d + 3 * s;
    for (int y = row0; y < row1 + EDGE; y++) {
        size_t at = (size_t)colour * j->px + (size_t)y * (size_t)j->w;
        code_row(j, colour, y, codes);
        j->r->k->moments_row(j->l->taps, j->l->ldr + at, codes, j->w, s, line,
                             ring + (size_t)(y % LOSS_WINDOW) * MEANS * s);
        int row = y - EDGE;
        if (row < row0)
            continue;
        for (size_t k = 0; k < MEANS; k++) {
            const float *rows[LOSS_WINDOW];
            for (int i = 0; i < LOSS_WINDOW; i++)
                rows[i] = ring + ((size_t)((row + i) % LOSS_WINDOW) * MEANS + k) * s;
            j->r->k->blur_col(j->l->taps, rows, n, means + k * s);
        }
        *sum += j->r->k->ssim_row(means, s, n, d);
        for (int k = 0; k < 3; k++) {
            float *to = map_row(j, colour, k, row + EDGE);
            memset(to, 0, EDGE * sizeof *to);
            memcpy(to + EDGE, d + (size_t)k * s, (size_t)n * sizeof *to);
            memset(to + EDGE + n, 0, (s - EDGE - (size_t)n) * sizeof *to);
        }
    }
}

static err_t ssim_chunk(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    struct loss *l = j->l;
    chunk += chunk_above(j);
    const struct span s = rows_of(chunk, num_max(j->first - EDGE, 0), num_min(j->end, j->h - EDGE));
    double sum = 0;
    for (int c = 0; c < 3 && s.row0 < s.row1; c++)
        ssim_rows(j, c, s.row0, s.row1, l->scratch + l->scratch_floats * (size_t)worker, &sum);
    if (chunk * ROWS >= j->first) // those above are counted by another rank
        l->partial[(size_t)chunk * P_ALL + P_SSIM] = sum;
    return OK;
}

/* The mean of a cell at the photograph's border is that of fewer pixels. */
static void measure_excess(const struct job *j, int colour, int y, const float *codes)
{
    const struct loss_input *in = j->in;
    const int px = in->cell_px, top = (in->y + y) / px * px;
    const float *ldr = ldr_row(j, colour, y);
    float *to = in->excess + ((size_t)(top / px) * 3 + (size_t)colour) * (size_t)in->cells_across +
                in->x / px;
    const int rows = num_min(px, photo_h(j) - top);
    for (int from = 0; from < j->w; from += px, to++) {
        const int end = num_min(from + px, j->w);
        float sum = 0;
        for (int i = from; i < end; i++)
            sum += ldr[i] - codes[i] * (1 / 255.0f);
        *to = ((in->y + y) > top ? *to : 0) + sum / (float)((end - from) * rows);
    }
}

/* Of the band of row y, from the first square of the picture on. */
static struct held_sum *sums_at(const struct job *j, int y)
{
    const struct loss_input *in = j->in;
    return in->sums ? in->sums + (size_t)((in->y + y) / ROWS) * (size_t)in->held_across +
                          in->x / in->held_px
                    : NULL;
}

static void measure_held_out(const struct job *j, int colour, int y, const float *codes, float *d,
                             double *p)
{
    const struct loss_input *in = j->in;
    int px = in->held_px, squares = (j->w + px - 1) / px;
    const uint8_t *held =
        in->held + (size_t)((in->y + y) / px) * (size_t)in->held_across + in->x / px;
    const uint8_t *skip = in->skip ? in->skip + cell_at(j, y) : NULL;
    const uint8_t *masked = in->masked ? in->masked + row_at(j, y) : NULL;
    const float *ldr = ldr_row(j, colour, y), behind = in->behind[colour];
    const float *alpha = in->pic->alpha + (size_t)y * (size_t)j->w;
    struct held_sum *sums = sums_at(j, y);
    if (sums && colour == 0 && y % ROWS == 0)
        memset(sums, 0, (size_t)squares * sizeof *sums);
    for (int s = 0; s < squares; s++) {
        struct held_sum here = {0};
        int end = (s + 1) * px < j->w ? (s + 1) * px : j->w;
        for (int i = s * px; i < end && held[s]; i++) {
            d[i] = 0;
            if ((skip && skip[i / in->cell_px]) || (masked && masked[i]))
                continue;
            const float shown = ldr[i] - behind * (1.0f - alpha[i]);
            double diff = (double)shown - (double)codes[i] / 255.0;
            here.sse += diff * diff;
            here.n += 1;
        }
        p[P_SSE] += here.sse;
        p[P_HELD] += here.n;
        if (sums) {
            sums[s].sse += here.sse;
            sums[s].n += here.n;
        }
    }
}

/* d loss / d display of one row and colour: SSIM through the blurred maps, L1, held-out squares. */
static void display_grad(const struct job *j, int colour, int y, float *line, float *d, double *p)
{
    const struct loss_input *in = j->in;
    size_t s = (size_t)j->l->stride, at = (size_t)colour * j->px + (size_t)y * (size_t)j->w;
    float *mixed = line + 3 * s, *codes = line + 5 * s;
    read_codes(j, colour, y, codes);
    replace_masked(j, y, ldr_row(j, colour, y), codes);
    if (in->excess)
        measure_excess(j, colour, y, codes);
    replace_skipped(j, y, ldr_row(j, colour, y), codes);
    for (int k = 0; k < 3; k++) {
        const float *rows[LOSS_WINDOW];
        for (int i = 0; i < LOSS_WINDOW; i++)
            rows[i] = map_row(j, colour, k, y + i);
        j->r->k->blur_col(j->l->taps, rows, j->w + EDGE, mixed);
        j->r->k->blur_row(j->l->taps, mixed, j->w + EDGE, line + (size_t)k * s);
    }
    struct display_row row = {.x = j->l->ldr + at,
                              .g = line,
                              .photo = codes,
                              .stride = s,
                              .l1 = in->w_l1 / (float)(3 * j->px),
                              .ssim = -in->w_ssim / (float)(3 * (j->h - EDGE) * (j->w - EDGE)),
                              .n = j->w};
    p[P_L1] += j->r->k->display_row(&row, d);
    replace_masked(j, y, NULL, d);
    replace_skipped(j, y, NULL, d);
    if (in->held)
        measure_held_out(j, colour, y, codes, d, p);
}

/* From d loss / d display to radiance, alpha and the segments of the curve. */
static void tone_grad(const struct job *j, int colour, int y, float *line, float *d, double *p)
{
    struct tone_row row = tone_row_of(j, colour, y);
    float *d_alpha = j->l->d_alpha + (size_t)y * (size_t)j->w;
    if (colour == 0 && !j->in->more)
        memset(d_alpha, 0, (size_t)j->w * sizeof *d_alpha);
    j->r->k->tone_row_grad(&row, d, line, d_alpha);
    double *g0 = p + P_G0 + colour * SEGMENTS, *g1 = p + P_G1 + colour * SEGMENTS;
    for (int i = 0; i < j->w; i++) {
        g0[row.segment[i]] += (double)line[i];
        g1[row.segment[i]] += (double)(line[i] * row.x[i]);
    }
}

static err_t grad_chunk(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    struct loss *l = j->l;
    chunk += j->first / ROWS;
    double *p = l->partial + (size_t)chunk * P_ALL, ssim = p[P_SSIM];
    memset(p, 0, P_ALL * sizeof *p);
    p[P_SSIM] = ssim;
    const struct span s = rows_of(chunk, j->first, j->end);
    for (int y = s.row0; y < s.row1; y++)
        for (int c = 0; c < 3; c++) {
            float *line = l->scratch + l->scratch_floats * (size_t)worker;
            float *to = l->d_radiance + (size_t)c * j->px + (size_t)y * (size_t)j->w;
            float *d = j->in->more ? line + 4 * (size_t)l->stride : to;
            display_grad(j, c, y, line, d, p);
            tone_grad(j, c, y, line, d, p);
            for (int i = 0; j->in->more && i < j->w; i++)
                to[i] += d[i];
        }
    return OK;
}

/* total: (P_ALL) */
static void sum_chunks(const struct job *j, double *total)
{
    memset(total, 0, P_ALL * sizeof *total);
    for (int c = j->first / ROWS; c < chunks_of(j->end); c++)
        for (int i = 0; i < P_ALL; i++)
            total[i] += j->l->partial[(size_t)c * P_ALL + (size_t)i];
}

/* The same of all ranks, in their order. */
static err_t sum_ranks(const struct job *j, double *total)
{
    struct team *t = j->l->team;
    double *all = j->l->totals;
    if (!t)
        return OK;
    memcpy(all + t->rank * P_ALL, total, P_ALL * sizeof *all);
    err_t e = team_collect(t, all, P_ALL * sizeof *all);
    memset(total, 0, P_ALL * sizeof *total);
    for (int k = 0; k < t->size && !e; k++)
        for (int i = 0; i < P_ALL; i++)
            total[i] += all[k * P_ALL + i];
    return e;
}

static void fill_output(const struct job *j, const double *total, struct loss_output *out)
{
    double windows = 3.0 * (j->h - EDGE) * (j->w - EDGE);
    out->loss = (double)j->in->w_l1 * total[P_L1] / (3.0 * (double)j->px) +
                (double)j->in->w_ssim * (1 - total[P_SSIM] / windows);
    out->held = (struct held_sum){total[P_SSE], total[P_HELD]};
    memset(out->tone, 0, sizeof out->tone);
    for (int c = 0; c < 3; c++)
        tonemap_grad(j->in->tone->p + c * TONE_PER_COLOUR, &j->table.c[c],
                     total + P_G0 + c * SEGMENTS, total + P_G1 + c * SEGMENTS,
                     out->tone + c * TONE_PER_COLOUR);
}

err_t loss_gather(struct team *t, const struct loss_input *in, int px, void *data, size_t row)
{
    int begin[TEAM_MAX];
    size_t at[TEAM_MAX + 1];
    if (!t)
        return OK;
    begin[t->rank] = in->first;
    err_t e = team_collect(t, begin, sizeof begin[0]);
    for (int k = 0; k < t->size; k++)
        at[k] = row * (size_t)((in->y + begin[k]) / px);
    at[t->size] = row * (size_t)((in->y + in->pic->h + px - 1) / px);
    return e ? e : team_spread(t, data, at);
}

err_t loss_run(const struct run *r, struct loss *l, const struct loss_input *in,
               struct loss_output *out)
{
    struct job j = {.r = r, .l = l, .in = in, .w = in->pic->w, .h = in->pic->h};
    double total[P_ALL];
    j.first = l->team ? in->first : 0;
    j.end = l->team ? in->end : j.h;
    if (j.w < LOSS_WINDOW || j.h < LOSS_WINDOW || j.w > l->w || j.h > l->h)
        return err_fail(ERR_ARG, "loss: picture of %d x %d px, planned for %d x %d", j.w, j.h, l->w,
                        l->h);
    j.px = (size_t)j.w * (size_t)j.h;
    l->stride = (int)stride_of(j.w);
    tonemap_table_init(&j.table, in->tone);
    for (int m = 0; m < 9; m++) { // zero border above and below the windows
        memset(map_row(&j, m / 3, m % 3, 0), 0, (size_t)l->stride * EDGE * 4);
        memset(map_row(&j, m / 3, m % 3, j.h), 0, (size_t)l->stride * EDGE * 4);
    }
    const int chunks = j.first < j.end ? chunks_of(j.end) - j.first / ROWS : 0;
    const int above = chunks ? j.first / ROWS - chunk_above(&j) : 0;
    const int below = chunks ? chunks_of(num_min(j.end + EDGE, j.h)) - chunks_of(j.end) : 0;
    err_t e = pool_for(r->pool, above + chunks + below, tone_chunk, &j);
    if (!e)
        e = pool_for(r->pool, above + chunks, ssim_chunk, &j);
    if (!e)
        e = pool_for(r->pool, chunks, grad_chunk, &j);
    if (e)
        return e;
    sum_chunks(&j, total);
    e = sum_ranks(&j, total);
    if (!e)
        fill_output(&j, total, out);
    return e;
}
