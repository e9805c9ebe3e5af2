/* widen_body.h - products of int8 where no instruction multiplies them directly: both sides become
 * int16, and pairs of products are summed to int32. Exact for all values: a pair is at most 2 127
 * 128, and all of them fit (gemm.h). Compiled once per instruction set; included by gemm_<isa>.c
 * after these functions on vectors of VEC int16:
 * V_REGISTER (the constraint of vec in assembly), v_widen (VEC int8 from memory), v_quad (four
 * int16 from memory, repeated), v_madd, v_plus, and v_fold(x, y), the sums of neighbouring int32 of
 * x, then of y.
 * A vector of weights is VEC / 4 columns of 4 inputs; a tile keeps the sums of ROWS rows and two
 * such vectors. Rows of activations are widened once, CHUNK inputs at a time. While the
 * rows are multiplied by a panel, the one g->panels further on is prefetched step by step: most
 * weights come from beyond the second-level cache. */
#include "core/kernels/kernels.h"

#include <string.h>

enum { ROWS = VEC == 32 ? 12 : 6, CHUNK = 1024, COLS = VEC / 2 };

/* n int8 to int16. */
static inline void widen_run(const int8_t *a, int n, int16_t *out)
{
    int x = 0;
    for (; x + VEC <= n; x += VEC) {
        const vec wide = v_widen(a + x);
        memcpy(out + x, &wide, sizeof wide);
    }
    for (; x < n; x++)
        out[x] = a[x];
}

/* Widen the inputs of `rows` rows from k on, at most CHUNK, to rows of CHUNK int16 without gaps.
 * returns: inputs per row. */
static int widen_rows(const struct gemm_s8 *g, int i, int rows, int k, int16_t *out)
{
    int n = g->segs * g->seg - k < CHUNK ? g->segs * g->seg - k : CHUNK;
    for (int r = 0; r < rows; r++, out += CHUNK) {
        const int8_t *row = g->a + (size_t)(i + r) * g->lda;
        for (int done = 0, run; done < n; done += run) {
            int s = (k + done) / g->seg, l = (k + done) % g->seg;
            run = g->seg - l < n - done ? g->seg - l : n - done;
            widen_run(row + (size_t)s * g->seg_stride + l, run, out + done);
        }
    }
    return n;
}

/* The weights to prefetch, `step` bytes further each step. */
struct prefetch_s8 {
    const int8_t *at;
    size_t step;
};

/* One chunk of widened rows and the COLS columns that multiply it. */
struct strip {
    const int16_t *a; // widened rows
    const int8_t *w;
    int n; // inputs
    int32_t *c;
    size_t ldc;
    bool add; // c += instead of c =
    struct prefetch_s8 prefetch;
};

/* Sums of `rows` rows and COLS columns. */
static inline __attribute__((always_inline)) void multiply_tile(const struct strip *s, int rows,
                                                                vec *out)
{
    const int8_t *w = s->w, *prefetch = s->prefetch.at;
    vec sum[ROWS][2];
    for (int r = 0; r < rows; r++)
        sum[r][0] = sum[r][1] = (vec){0};
    for (int l = 0; l < s->n; l += 4, w += 4 * PANEL, prefetch += s->prefetch.step) {
        __builtin_prefetch(prefetch, 0, 2);
        vec w0 = v_widen(w), w1 = v_widen(w + VEC);
        for (int r = 0; r < rows; r++) {
            vec x = v_quad(s->a + r * CHUNK + l);
            sum[r][0] = v_plus(sum[r][0], v_madd(w0, x));
            sum[r][1] = v_plus(sum[r][1], v_madd(w1, x));
            /* One row after the other: gcc would run out of registers. */
            __asm__ volatile("" : "+" V_REGISTER(sum[r][0]), "+" V_REGISTER(sum[r][1]));
        }
    }
    for (int r = 0; r < rows; r++)
        out[r] = v_fold(sum[r][0], sum[r][1]);
}

/* Height of the tile that computes `rows` rows, at most ROWS. */
static int tile_rows(int rows)
{
    const int even = rows > 1 ? (rows + 1) / 2 * 2 : 1;
    return even > 8 ? ROWS : even;
}

/* COLS columns of `rows` rows; sums that the tile computes beyond them are dropped. */
static void multiply_strip(const struct strip *s, int rows)
{
    vec sum[ROWS];
    switch (tile_rows(rows)) {
    case 1:
        multiply_tile(s, 1, sum);
        break;
    case 2:
        multiply_tile(s, 2, sum);
        break;
    case 4:
        multiply_tile(s, 4, sum);
        break;
    case 8:
        multiply_tile(s, ROWS < 8 ? ROWS : 8, sum);
        break;
    case ROWS:
        multiply_tile(s, ROWS, sum);
        break;
    default:
        multiply_tile(s, 6, sum);
    }
    for (int r = 0; r < rows; r++) {
        int32_t *c = s->c + (size_t)r * s->ldc;
        vec before = {0};
        if (s->add)
            memcpy(&before, c, sizeof before);
        before = v_plus(before, sum[r]);
        memcpy(c, &before, sizeof before);
    }
}

/* All columns of up to ROWS rows from row i on, n inputs from k on. */
static void multiply_columns(const struct gemm_s8 *g, int i, int k, const int16_t *a, int n)
{
    const int tiles = (g->m + ROWS - 1) / ROWS * (PANEL / COLS); // per panel
    const size_t step = (size_t)(4 * PANEL + tiles - 1) / (size_t)tiles;
    for (int col = 0; col < PANEL * g->panels; col += COLS) {
        const int8_t *panel = g->w + (size_t)(col / PANEL) * g->ldw + (size_t)k * PANEL;
        const int strip_at = i / ROWS * (PANEL / COLS) + col % PANEL / COLS;
        const struct strip s = {
            .a = a,
            .w = panel + 4 * (col % PANEL),
            .n = n,
            .c = g->c + (size_t)i * g->ldc + col,
            .ldc = g->ldc,
            .add = k > 0,
            .prefetch = {panel + (size_t)g->panels * g->ldw + (size_t)(strip_at * n / 4) * step,
                         step}};
        multiply_strip(&s, g->m - i < ROWS ? g->m - i : ROWS);
    }
}

static void gemm_s8(const struct gemm_s8 *g)
{
    int16_t a[ROWS * CHUNK];
    for (int i = 0; i < g->m; i += ROWS)
        for (int k = 0; k < g->segs * g->seg; k += CHUNK) {
            const int rows = g->m - i < ROWS ? g->m - i : ROWS;
            int n = widen_rows(g, i, rows, k, a);
            memset(a + rows * CHUNK, 0, (size_t)(tile_rows(rows) - rows) * CHUNK * sizeof *a);
            multiply_columns(g, i, k, a, n);
        }
}
