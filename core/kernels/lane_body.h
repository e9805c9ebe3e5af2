/* lane_body.h - products by the Arm instructions that multiply a vector with one 32-bit lane of
 * another: FMLA, where a lane is a float, and SDOT, where it is four int8. Packed weights are then
 * words of 4 bytes in panels of (words, 16) for both.
 * A tile of 6 rows and 16 columns keeps 24 vectors of sums, one of activations per row (4 words)
 * and two of weights: all 32 registers, and 22 loads for 96 multiplications.
 * The including file defines PRODUCT (gemm_s8 or gemm_f32), ELEM and SUM (the element types), WORD
 * (elements in a lane), vin and vsum (vectors) and the functions of one line below:
 * v_load, v_word (one word, in lane 0), v_lane(sum, w, a, lane), v_start, v_store. */

enum { ROWS = 6, COLS = PANEL / 4 };

/* sum += one word of each row times the 16 words at w. */
static inline __attribute__((always_inline)) void add_word(vsum sum[][COLS], const vin *a,
                                                           const ELEM *w, int rows, int lane)
{
    for (int j = 0; j < COLS; j++) {
        vin b = v_load(w + 4 * WORD * j);
        for (int i = 0; i < rows; i++)
            sum[i][j] = v_lane(sum[i][j], b, a[i], lane);
    }
}

static inline __attribute__((always_inline)) void
multiply_tile(const struct PRODUCT *g, const ELEM *a, const ELEM *w, SUM *c, int rows)
{
    vsum sum[ROWS][COLS];
    vin x[ROWS];
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < COLS; j++)
            sum[i][j] = v_start(g, c + (size_t)i * g->ldc + 4 * j);
    for (int s = 0; s < g->segs; s++, a += g->seg_stride) {
        int l = 0;
        for (; l <= g->seg - 4 * WORD; l += 4 * WORD, w += 4 * WORD * PANEL) {
            for (int i = 0; i < rows; i++)
                x[i] = v_load(a + (size_t)i * g->lda + l);
            add_word(sum, x, w, rows, 0);
            add_word(sum, x, w + WORD * PANEL, rows, 1);
            add_word(sum, x, w + 2 * WORD * PANEL, rows, 2);
            add_word(sum, x, w + 3 * WORD * PANEL, rows, 3);
        }
        for (; l < g->seg; l += WORD, w += WORD * PANEL) {
            for (int i = 0; i < rows; i++)
                x[i] = v_word(a + (size_t)i * g->lda + l);
            add_word(sum, x, w, rows, 0);
        }
    }
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < COLS; j++)
            v_store(c + (size_t)i * g->ldc + 4 * j, sum[i][j]);
}

#include "core/kernels/tiles_body.h"
