/* Base NEON: products of floats by FMLA, of int8 by widening multiplication.
 * Integers: a vector of packed weights is 4 columns of 4 inputs. Its products with an activation
 * word repeated 4 times fit in int16, and so do the sums of two such: 2 127 128 = 32512. SMULL and
 * SMLAL make these of two words; SADALP adds neighbours to int32. A tile of 2 rows and 16 columns
 * keeps 16 vectors of sums. */
#if !defined(__ARM_NEON)
#error "compile this file with NEON"
#endif
#include "core/kernels/kernels.h"

#include <arm_neon.h>
#include <string.h>

/* --- floats --------------------------------------------------------------------------------- */

#define PRODUCT gemm_f32
#define ELEM float
#define SUM float
enum { WORD = 1 };
typedef float32x4_t vin;
typedef float32x4_t vsum;

static inline vin v_load(const float *p)
{
    return vld1q_f32(p);
}

static inline vin v_word(const float *p)
{
    return vld1q_dup_f32(p);
}

static inline vsum v_lane(vsum sum, vin w, vin a, int lane)
{
    switch (lane) {
    case 0:
        return vfmaq_laneq_f32(sum, w, a, 0);
    case 1:
        return vfmaq_laneq_f32(sum, w, a, 1);
    case 2:
        return vfmaq_laneq_f32(sum, w, a, 2);
    default:
        return vfmaq_laneq_f32(sum, w, a, 3);
    }
}

static inline vsum v_start(const struct gemm_f32 *g, const float *c)
{
    return g->add ? vld1q_f32(c) : vdupq_n_f32(0);
}

static inline void v_store(float *c, vsum sum)
{
    vst1q_f32(c, sum);
}

#include "core/kernels/lane_body.h"

/* --- integers ------------------------------------------------------------------------------- */

enum { S8_ROWS = 2 };

/* (row): pairs of inputs of columns 2 v and 2 v + 1. */
typedef int32x4_t s8_sums[2 * COLS];

static inline int8x16_t s8_word(const int8_t *p)
{
    int32_t word;
    memcpy(&word, p, sizeof word);
    return vreinterpretq_s8_s32(vdupq_n_s32(word));
}

/* Add two words of each row at l and l + 4 times the panel at w. */
static inline __attribute__((always_inline)) void
s8_add_two_words(s8_sums *sum, const int8_t *a, size_t lda, const int8_t *w, int rows)
{
    int8x16_t x[S8_ROWS], y[S8_ROWS];
    for (int i = 0; i < rows; i++) {
        x[i] = s8_word(a + (size_t)i * lda);
        y[i] = s8_word(a + (size_t)i * lda + 4);
    }
    for (int j = 0; j < COLS; j++) {
        int8x16_t v = vld1q_s8(w + 16 * j), u = vld1q_s8(w + 4 * PANEL + 16 * j);
        for (int i = 0; i < rows; i++) {
            int16x8_t low = vmull_s8(vget_low_s8(v), vget_low_s8(x[i]));
            int16x8_t high = vmull_high_s8(v, x[i]);
            low = vmlal_s8(low, vget_low_s8(u), vget_low_s8(y[i]));
            high = vmlal_high_s8(high, u, y[i]);
            sum[i][2 * j] = vpadalq_s16(sum[i][2 * j], low);
            sum[i][2 * j + 1] = vpadalq_s16(sum[i][2 * j + 1], high);
        }
    }
}

static inline __attribute__((always_inline)) void s8_add_word(s8_sums *sum, const int8_t *a,
                                                              size_t lda, const int8_t *w, int rows)
{
    for (int i = 0; i < rows; i++) {
        int8x16_t x = s8_word(a + (size_t)i * lda);
        for (int j = 0; j < COLS; j++) {
            int8x16_t v = vld1q_s8(w + 16 * j);
            int16x8_t low = vmull_s8(vget_low_s8(v), vget_low_s8(x)), high = vmull_high_s8(v, x);
            sum[i][2 * j] = vpadalq_s16(sum[i][2 * j], low);
            sum[i][2 * j + 1] = vpadalq_s16(sum[i][2 * j + 1], high);
        }
    }
}

static inline __attribute__((always_inline)) void s8_tile(const struct gemm_s8 *g, const int8_t *a,
                                                          const int8_t *w, int32_t *c, int rows)
{
    s8_sums sum[S8_ROWS];
    for (int i = 0; i < rows; i++)
        for (int v = 0; v < 2 * COLS; v++)
            sum[i][v] = vdupq_n_s32(0);
    for (int s = 0; s < g->segs; s++, a += g->seg_stride) {
        int l = 0;
        for (; l <= g->seg - 8; l += 8, w += 8 * PANEL)
            s8_add_two_words(sum, a + l, g->lda, w, rows);
        if (l < g->seg) {
            s8_add_word(sum, a + l, g->lda, w, rows);
            w += 4 * PANEL;
        }
    }
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < COLS; j++)
            vst1q_s32(c + (size_t)i * g->ldc + 4 * j, vpaddq_s32(sum[i][2 * j], sum[i][2 * j + 1]));
}

static void s8_gemm(const struct gemm_s8 *g)
{
    for (int p = 0; p < g->panels; p++)
        for (int i = 0; i < g->m; i += S8_ROWS) {
            const int8_t *a = g->a + (size_t)i * g->lda, *w = g->w + (size_t)p * g->ldw;
            int32_t *c = g->c + (size_t)i * g->ldc + PANEL * p;
            if (g->m - i == 1)
                s8_tile(g, a, w, c, 1);
            else
                s8_tile(g, a, w, c, S8_ROWS);
        }
}

/* --- weights as floats ---------------------------------------------------------------------- */

static void unpack_s8(const int8_t *w, int k, float *out)
{
    for (; k > 0; k -= 4, w += 4 * PANEL) {
        int8x16x4_t rows = vld4q_s8(w);
        for (int i = 0; i < 4; i++, out += PANEL) {
            int8x16_t row = rows.val[i];
            int16x8_t half[2] = {vmovl_s8(vget_low_s8(row)), vmovl_high_s8(row)};
            for (int h = 0; h < 2; h++) {
                vst1q_f32(out + 8 * h, vcvtq_f32_s32(vmovl_s16(vget_low_s16(half[h]))));
                vst1q_f32(out + 8 * h + 4, vcvtq_f32_s32(vmovl_high_s16(half[h])));
            }
        }
    }
}

static void unpack_bf16(const uint16_t *w, int k, float *out)
{
    for (int i = 0; i < PANEL * k; i += 8) {
        uint16x8_t v = vld1q_u16(w + i);
        vst1q_f32(out + i, vreinterpretq_f32_u32(vshll_n_u16(vget_low_u16(v), 16)));
        vst1q_f32(out + i + 4, vreinterpretq_f32_u32(vshll_high_n_u16(v, 16)));
    }
}

void gemm_neon(struct gemm_kernels *k)
{
    k->s8_name = k->f32_name = "neon";
    k->s8 = s8_gemm;
    k->f32 = gemm_by_tiles;
    k->unpack_s8 = unpack_s8;
    k->unpack_bf16 = unpack_bf16;
}
