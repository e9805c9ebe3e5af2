/* widen_body.h - products of int8 where nothing multiplies them directly: both sides become int16,
 * and pairs of products are summed to int32. Exact for all values. Compiled once per instruction
 * set; included by gemm_<isa>.c after these functions on vectors of VEC int16:
 * v_widen (VEC int8 from memory), v_quad (four int16 from memory, repeated), v_madd, v_plus, and
 * v_fold(x, y), the sums of neighbouring int32 of x, then of y.
 * A vector of weights is VEC / 4 columns of 4 inputs; a tile keeps the sums of ROWS rows and two
 * such vectors. Rows of activations are widened once, CHUNK inputs at a time. */
#include "core/kernels/kernels.h"

#include <string.h>

enum { ROWS = 6, CHUNK = 1024, COLS = VEC / 2 };

/* Rows of CHUNK int16 from an array without gaps at input k on. */
static int widen_rows(const struct gemm_s8 *g, int i, int rows, int k, int16_t *out)
{
    int n = g->segs * g->seg - k < CHUNK ? g->segs * g->seg - k : CHUNK;
    for (int r = 0; r < rows; r++, out += CHUNK) {
        const int8_t *row = g->a + (size_t)(i + r) * g->lda;
        for (int done = 0, run; done < n; done += run) {
            int s = (k + done) / g->seg, l = (k + done) % g->seg;
            const int8_t *a = row + (size_t)s * g->seg_stride + l;
            run = g->seg - l < n - done ? g->seg - l : n - done;
            for (int x = 0; x < run; x++)
                out[done + x] = a[x];
        }
    }
    return n;
}

/* c of `rows` rows and COLS columns, first = 0, else +=, over n inputs. */
static inline __attribute__((always_inline)) void tile(const int16_t *a, const int8_t *w, int n,
                                                       int32_t *c, size_t ldc, int rows, bool add)
{
    vec sum[ROWS][2];
    for (int r = 0; r < rows; r++)
        sum[r][0] = sum[r][1] = (vec){0};
    for (int l = 0; l < n; l += 4, w += 4 * PANEL) {
        vec w0 = v_widen(w), w1 = v_widen(w + VEC);
        for (int r = 0; r < rows; r++) {
            vec x = v_quad(a + r * CHUNK + l);
            sum[r][0] = v_plus(sum[r][0], v_madd(w0, x));
            sum[r][1] = v_plus(sum[r][1], v_madd(w1, x));
            /* One row after the other: gcc would run out of registers. */
            __asm__ volatile("" : "+x"(sum[r][0]), "+x"(sum[r][1]));
        }
    }
    for (int r = 0; r < rows; r++, c += ldc) {
        vec total = v_fold(sum[r][0], sum[r][1]), before = {0};
        if (add)
            memcpy(&before, c, sizeof before);
        total = v_plus(total, before);
        memcpy(c, &total, sizeof total);
    }
}

/* Rows [i, i + ROWS) ask for their share of the panel that comes `panels` later, inputs [k, k + n):
 * most weights come from beyond the second cache. */
static void ask_ahead(const struct gemm_s8 *g, int i, int panel, int k, int n)
{
    const size_t m = (size_t)g->m, bytes = (size_t)n * PANEL, at = (size_t)i;
    const size_t end = at + ROWS < m ? at + ROWS : m;
    const int8_t *w = g->w + (size_t)(panel + g->panels) * g->ldw + (size_t)k * PANEL;
    for (size_t x = bytes * at / m; x < bytes * end / m; x += 64)
        __builtin_prefetch(w + x, 0, 2);
}

/* All columns of up to ROWS rows. */
static void columns(const struct gemm_s8 *g, int i, int k, const int16_t *a, int n)
{
    for (int col = 0; col < PANEL * g->panels; col += COLS) {
        const int8_t *w =
            g->w + (size_t)(col / PANEL) * g->ldw + (size_t)k * PANEL + 4 * (col % PANEL);
        int32_t *c = g->c + (size_t)i * g->ldc + col;
        if (col % PANEL == 0)
            ask_ahead(g, i, col / PANEL, k, n);
        switch (g->m - i) {
        case 1:
            tile(a, w, n, c, g->ldc, 1, k > 0);
            break;
        case 2:
            tile(a, w, n, c, g->ldc, 2, k > 0);
            break;
        case 3:
            tile(a, w, n, c, g->ldc, 3, k > 0);
            break;
        case 4:
            tile(a, w, n, c, g->ldc, 4, k > 0);
            break;
        case 5:
            tile(a, w, n, c, g->ldc, 5, k > 0);
            break;
        default:
            tile(a, w, n, c, g->ldc, ROWS, k > 0);
        }
    }
}

static void gemm_s8(const struct gemm_s8 *g)
{
    int16_t a[ROWS * CHUNK];
    for (int i = 0; i < g->m; i += ROWS)
        for (int k = 0; k < g->segs * g->seg; k += CHUNK) {
            int n = widen_rows(g, i, g->m - i < ROWS ? g->m - i : ROWS, k, a);
            columns(g, i, k, a, n);
        }
}
