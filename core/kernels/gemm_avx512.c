/* Products of int8 by VNNI, which multiplies unsigned with signed: a weight w becomes the unsigned
 * w + 128 by one exclusive or per vector, so that sums start at -128 times those of the
 * activations. Sums in between wrap; the results are exact. */
#if !defined(__AVX512VNNI__) || !defined(__AVX512BW__)
#error "compile this file with the AVX-512 flags"
#endif
#define SIMD_AVX512
#include "core/kernels/gemm_body.h"

enum { ROWS = 8, BLOCK = 64 };

/* Where the sums of rows [i, i + rows) start. */
static void start_sums(const struct gemm_s8 *g, int i, int rows, int32_t *start)
{
    const __m512i one = _mm512_set1_epi8(1);
    for (int r = 0; r < rows; r++) {
        __m512i sum = _mm512_setzero_si512();
        for (int s = 0; s < g->segs; s++) {
            const int8_t *a = g->a + (size_t)(i + r) * g->lda + (size_t)s * g->seg_stride;
            int l = 0;
            for (; l <= g->seg - 64; l += 64)
                sum = _mm512_dpbusd_epi32(sum, one, _mm512_loadu_si512(a + l));
            __mmask64 rest = ((__mmask64)1 << (g->seg - l)) - 1;
            sum = _mm512_dpbusd_epi32(sum, one, _mm512_maskz_loadu_epi8(rest, a + l));
        }
        start[r] = -128 * _mm512_reduce_add_epi32(sum);
    }
}

static inline __attribute__((always_inline)) void s8_tile(const struct gemm_s8 *g, int i, int panel,
                                                          const int32_t *start, int rows, int vecs)
{
    __m512i sum[ROWS][2];
    const __m512i flip = _mm512_set1_epi8(-128);
    const int8_t *w0 = g->w + (size_t)panel * g->ldw, *w1 = vecs == 2 ? w0 + g->ldw : w0;
    int32_t *c = g->c + (size_t)i * g->ldc + PANEL * panel;
    for (int r = 0; r < rows; r++)
        sum[r][0] = sum[r][1] = _mm512_set1_epi32(start[r]);
    for (int s = 0; s < g->segs; s++) {
        const int8_t *a = g->a + (size_t)i * g->lda + (size_t)s * g->seg_stride;
        for (int l = 0; l < g->seg; l += 4, w0 += 4 * PANEL, w1 += 4 * PANEL) {
            __m512i x0 = _mm512_xor_si512(_mm512_loadu_si512(w0), flip), x1 = x0;
            if (vecs == 2)
                x1 = _mm512_xor_si512(_mm512_loadu_si512(w1), flip);
            for (int r = 0; r < rows; r++) {
                int quad;
                memcpy(&quad, a + (size_t)r * g->lda + l, sizeof quad);
                __m512i y = _mm512_set1_epi32(quad);
                sum[r][0] = _mm512_dpbusd_epi32(sum[r][0], x0, y);
                if (vecs == 2)
                    sum[r][1] = _mm512_dpbusd_epi32(sum[r][1], x1, y);
            }
        }
    }
    for (int r = 0; r < rows; r++, c += g->ldc)
        for (int v = 0; v < vecs; v++)
            _mm512_storeu_si512(c + PANEL * v, sum[r][v]);
}

/* One or two panels of rows [i, end). */
static inline __attribute__((always_inline)) void
s8_panels(const struct gemm_s8 *g, int i, int end, int panel, const int32_t *start, int vecs)
{
    for (; i < end; i += ROWS, start += ROWS)
        switch (end - i) {
        case 1:
            s8_tile(g, i, panel, start, 1, vecs);
            break;
        case 2:
            s8_tile(g, i, panel, start, 2, vecs);
            break;
        case 3:
            s8_tile(g, i, panel, start, 3, vecs);
            break;
        case 4:
            s8_tile(g, i, panel, start, 4, vecs);
            break;
        case 5:
            s8_tile(g, i, panel, start, 5, vecs);
            break;
        case 6:
            s8_tile(g, i, panel, start, 6, vecs);
            break;
        case 7:
            s8_tile(g, i, panel, start, 7, vecs);
            break;
        default:
            s8_tile(g, i, panel, start, ROWS, vecs);
        }
}

static void gemm_s8(const struct gemm_s8 *g)
{
    for (int i = 0; i < g->m; i += BLOCK) {
        int32_t start[BLOCK];
        int end = g->m - i < BLOCK ? g->m : i + BLOCK, panel = 0;
        start_sums(g, i, end - i, start);
        for (; panel + 2 <= g->panels; panel += 2)
            s8_panels(g, i, end, panel, start, 2);
        if (panel < g->panels)
            s8_panels(g, i, end, panel, start, 1);
    }
}

void gemm_avx512(struct gemm_kernels *k)
{
    gemm_fill(k, "avx512");
    k->s8_name = "avx512";
    k->s8 = gemm_s8;
    k->s8_rows = ROWS;
}
