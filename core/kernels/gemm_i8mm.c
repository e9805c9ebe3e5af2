/* Integer products by SMMLA: 2 rows times 2 columns of 8 inputs, 32 multiplications.
 * Packed weights hold words of 4 inputs, so zips of two words of 4 columns give two pairs of
 * columns; an odd last row is paired with itself. A tile of 6 rows and 16 columns keeps 24 vectors
 * of sums, each (2 rows, 2 columns). */
#if !defined(__ARM_FEATURE_MATMUL_INT8)
#error "compile this file with int8 matrix products"
#endif
#include "core/kernels/kernels.h"

#include <arm_neon.h>
#include <string.h>

enum { ROWS = 6, PAIRS = ROWS / 2, COLS = PANEL / 4 };

/* One pair of rows, all columns. */
typedef int32x4_t pair_sums[2 * COLS];

static inline __attribute__((always_inline)) int8x16_t pair8(const int8_t *a, const int8_t *b)
{
    return vcombine_s8(vld1_s8(a), vld1_s8(b));
}

/* 4 inputs of each row and 4 zeros. */
static inline __attribute__((always_inline)) int8x16_t pair4(const int8_t *a, const int8_t *b)
{
    uint32_t x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    return vreinterpretq_s8_u64(vcombine_u64(vcreate_u64(x), vcreate_u64(y)));
}

/* sum += the pairs of rows times the words at w and at w1. */
static inline __attribute__((always_inline)) void
add_words(pair_sums *sum, const int8x16_t *x, const int8_t *w, const int8_t *w1, int pairs)
{
    for (int j = 0; j < COLS; j++) {
        int32x4_t u = vreinterpretq_s32_s8(vld1q_s8(w + 16 * j));
        int32x4_t v = vreinterpretq_s32_s8(vld1q_s8(w1 + 16 * j));
        int8x16_t low = vreinterpretq_s8_s32(vzip1q_s32(u, v));
        int8x16_t high = vreinterpretq_s8_s32(vzip2q_s32(u, v));
        for (int i = 0; i < pairs; i++) {
            sum[i][2 * j] = vmmlaq_s32(sum[i][2 * j], x[i], low);
            sum[i][2 * j + 1] = vmmlaq_s32(sum[i][2 * j + 1], x[i], high);
        }
    }
}

static inline int32x4_t row_of(const int32x4_t *s, int odd)
{
    int64x2_t a = vreinterpretq_s64_s32(s[0]), b = vreinterpretq_s64_s32(s[1]);
    return vreinterpretq_s32_s64(odd ? vzip2q_s64(a, b) : vzip1q_s64(a, b));
}

/* rows <= 2 pairs; an odd last row is computed twice. */
static inline __attribute__((always_inline)) void
multiply_tile(const struct gemm_s8 *g, const int8_t *a, const int8_t *w, int32_t *c, int rows)
{
    const int pairs = (rows + 1) / 2;
    pair_sums sum[PAIRS];
    int8x16_t x[PAIRS];
    size_t row[ROWS];
    for (int i = 0; i < 2 * pairs; i++)
        row[i] = (size_t)(i < rows ? i : rows - 1) * g->lda;
    for (int i = 0; i < pairs; i++)
        for (int v = 0; v < 2 * COLS; v++)
            sum[i][v] = vdupq_n_s32(0);
    for (int s = 0; s < g->segs; s++, a += g->seg_stride) {
        int l = 0;
        for (; l <= g->seg - 8; l += 8, w += 8 * PANEL) {
            for (int i = 0; i < pairs; i++)
                x[i] = pair8(a + row[2 * i] + l, a + row[2 * i + 1] + l);
            add_words(sum, x, w, w + 4 * PANEL, pairs);
        }
        if (l < g->seg) {
            for (int i = 0; i < pairs; i++)
                x[i] = pair4(a + row[2 * i] + l, a + row[2 * i + 1] + l);
            add_words(sum, x, w, w, pairs);
            w += 4 * PANEL;
        }
    }
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < COLS; j++)
            vst1q_s32(c + (size_t)i * g->ldc + 4 * j, row_of(&sum[i / 2][2 * j], i % 2));
}

#define PRODUCT gemm_s8
#define ELEM int8_t
#define SUM int32_t
#include "core/kernels/tiles_body.h"

void gemm_i8mm(struct gemm_kernels *k)
{
    k->s8_name = "i8mm";
    k->s8 = gemm_by_tiles;
}
