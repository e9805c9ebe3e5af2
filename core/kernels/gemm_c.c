/* The reference of gemm.h: obvious loops, never optimised. */
#include "core/kernels/kernels.h"

#include <string.h>

static void gemm_s8(const struct gemm_s8 *g)
{
    for (int i = 0; i < g->m; i++)
        for (int n = 0; n < PANEL * g->panels; n++) {
            const int8_t *w = g->w + (size_t)(n / PANEL) * g->ldw + 4 * (n % PANEL);
            int32_t sum = 0;
            for (int k = 0; k < g->segs * g->seg; k++) {
                size_t at = (size_t)(k / g->seg) * g->seg_stride + (size_t)(k % g->seg);
                sum += g->a[(size_t)i * g->lda + at] * w[k / 4 * 4 * PANEL + k % 4];
            }
            g->c[(size_t)i * g->ldc + (size_t)n] = sum;
        }
}

static void gemm_f32(const struct gemm_f32 *g)
{
    for (int i = 0; i < g->m; i++)
        for (int n = 0; n < PANEL * g->panels; n++) {
            const float *w = g->w + (size_t)(n / PANEL) * g->ldw + n % PANEL;
            float *c = g->c + (size_t)i * g->ldc + n, sum = g->add ? *c : 0;
            for (int k = 0; k < g->segs * g->seg; k++) {
                size_t at = (size_t)(k / g->seg) * g->seg_stride + (size_t)(k % g->seg);
                sum += g->a[(size_t)i * g->lda + at] * w[(size_t)k * PANEL];
            }
            *c = sum;
        }
}

static void unpack_s8(const int8_t *w, int k, float *out)
{
    for (int i = 0; i < k; i++)
        for (int j = 0; j < PANEL; j++)
            out[i * PANEL + j] = w[i / 4 * 4 * PANEL + 4 * j + i % 4];
}

static void unpack_bf16(const uint16_t *w, int k, float *out)
{
    for (int i = 0; i < k * PANEL; i++) {
        uint32_t bits = (uint32_t)w[i] << 16;
        memcpy(out + i, &bits, sizeof bits);
    }
}

void gemm_c(struct gemm_kernels *k)
{
    k->s8_name = k->f32_name = "c";
    k->s8 = gemm_s8;
    k->f32 = gemm_f32;
    k->unpack_s8 = unpack_s8;
    k->unpack_bf16 = unpack_bf16;
}
