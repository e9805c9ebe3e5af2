/* Products of int8 by VNNI, which multiplies unsigned with signed: a weight w becomes the unsigned
 * w + 128 by one exclusive or per vector, so that sums start at -128 times those of the
 * activations. Sums in between wrap; the results are exact.
 * While the rows are multiplied by a panel, the next one is prefetched step by step: most weights
 * come from beyond the second-level cache. */
#if !defined(__AVX512VNNI__) || !defined(__AVX512BW__)
#error "compile this file with the AVX-512 flags and VNNI"
#endif
#include "core/kernels/kernels.h"

#include <immintrin.h>
#include <string.h>

/* Rows of a tile; rows whose activations are summed at a time; rows whose start values are kept. */
enum { ROWS = 8, QUAD = 4, BLOCK = 64 };

/* sum[q] += 64 or fewer inputs of row q. */
static inline __attribute__((always_inline)) void add_inputs(__m512i *sum, const int8_t *const *a,
                                                             size_t at, __mmask64 which)
{
    const __m512i one = _mm512_set1_epi8(1);
    for (int q = 0; q < QUAD; q++)
        sum[q] = _mm512_dpbusd_epi32(sum[q], one, _mm512_maskz_loadu_epi8(which, a[q] + at));
}

static inline __m512i add_neighbours(__m512i x, __m512i y)
{
    return _mm512_add_epi32(_mm512_unpacklo_epi32(x, y), _mm512_unpackhi_epi32(x, y));
}

/* The sums of the elements of four vectors. */
static inline __m128i sum_each_of_four(const __m512i *x)
{
    __m512i a = add_neighbours(x[0], x[1]), b = add_neighbours(x[2], x[3]);
    a = _mm512_add_epi32(_mm512_unpacklo_epi64(a, b), _mm512_unpackhi_epi64(a, b));
    __m256i c = _mm256_add_epi32(_mm512_castsi512_si256(a), _mm512_extracti64x4_epi64(a, 1));
    return _mm_add_epi32(_mm256_castsi256_si128(c), _mm256_extracti128_si256(c, 1));
}

/* Start values of the sums of rows [i, i + rows), rounded up to a multiple of QUAD rows. */
static void start_sums(const struct gemm_s8 *g, int i, int rows, int32_t *start)
{
    for (int r = 0; r < rows; r += QUAD) {
        __m512i sum[QUAD];
        const int8_t *a[QUAD];
        for (int q = 0; q < QUAD; q++) {
            sum[q] = _mm512_setzero_si512();
            a[q] = g->a + (size_t)(i + (r + q < rows ? r + q : rows - 1)) * g->lda;
        }
        for (int s = 0; s < g->segs; s++) {
            size_t at = (size_t)s * g->seg_stride;
            int l = 0;
            for (; l <= g->seg - 64; l += 64)
                add_inputs(sum, a, at + (size_t)l, ~(__mmask64)0);
            if (l < g->seg)
                add_inputs(sum, a, at + (size_t)l, ((__mmask64)1 << (g->seg - l)) - 1);
        }
        __m128i total = _mm_mullo_epi32(sum_each_of_four(sum), _mm_set1_epi32(-128));
        _mm_storeu_si128((__m128i *)(start + r), total);
    }
}

/* Four inputs of each row times those of one or two panels. */
static inline __attribute__((always_inline)) void
add_quads(__m512i sum[][2], const int8_t *a, size_t lda, __m512i w0, __m512i w1, const int shape[2])
{
    for (int r = 0; r < shape[0]; r++) {
        int quad;
        memcpy(&quad, a + (size_t)r * lda, sizeof quad);
        __m512i x = _mm512_set1_epi32(quad);
        sum[r][0] = _mm512_dpbusd_epi32(sum[r][0], w0, x);
        if (shape[1] == 2)
            sum[r][1] = _mm512_dpbusd_epi32(sum[r][1], w1, x);
    }
}

/* The weights to prefetch, `step` bytes further each step. */
struct prefetch {
    const int8_t *at;
    size_t step;
};

static inline __attribute__((always_inline)) void multiply_tile(const struct gemm_s8 *g, int i,
                                                                int panel, const int32_t *start,
                                                                struct prefetch *prefetch,
                                                                const int shape[2])
{
    const int rows = shape[0], vecs = shape[1];
    __m512i sum[ROWS][2];
    const __m512i flip = _mm512_set1_epi8(-128);
    const int8_t *w0 = g->w + (size_t)panel * g->ldw, *w1 = vecs == 2 ? w0 + g->ldw : w0;
    int32_t *c = g->c + (size_t)i * g->ldc + PANEL * panel;
    for (int r = 0; r < rows; r++)
        sum[r][0] = sum[r][1] = _mm512_set1_epi32(start[r]);
    for (int s = 0; s < g->segs; s++) {
        const int8_t *a = g->a + (size_t)i * g->lda + (size_t)s * g->seg_stride;
        for (int l = 0; l < g->seg; l += 4, w0 += 4 * PANEL, w1 += 4 * PANEL) {
            __builtin_prefetch(prefetch->at, 0, 2);
            prefetch->at += prefetch->step;
            add_quads(sum, a + l, g->lda, _mm512_xor_si512(_mm512_loadu_si512(w0), flip),
                      _mm512_xor_si512(_mm512_loadu_si512(w1), flip), shape);
        }
    }
    for (int r = 0; r < rows; r++, c += g->ldc)
        for (int v = 0; v < vecs; v++)
            _mm512_storeu_si512(c + PANEL * v, sum[r][v]);
}

/* One or two panels of rows [i, end). */
static inline __attribute__((always_inline)) void
multiply_panels(const struct gemm_s8 *g, int i, int end, int panel, const int32_t *start, int vecs)
{
    const unsigned tiles = (unsigned)(end - i + ROWS - 1) / ROWS;
    struct prefetch prefetch = {g->w + (size_t)(panel + vecs) * g->ldw,
                                4u * PANEL * (unsigned)vecs / tiles};
    for (; i < end; i += ROWS, start += ROWS)
        switch (end - i) {
        case 1:
            multiply_tile(g, i, panel, start, &prefetch, (const int[]){1, vecs});
            break;
        case 2:
            multiply_tile(g, i, panel, start, &prefetch, (const int[]){2, vecs});
            break;
        case 3:
            multiply_tile(g, i, panel, start, &prefetch, (const int[]){3, vecs});
            break;
        case 4:
            multiply_tile(g, i, panel, start, &prefetch, (const int[]){4, vecs});
            break;
        case 5:
            multiply_tile(g, i, panel, start, &prefetch, (const int[]){5, vecs});
            break;
        case 6:
            multiply_tile(g, i, panel, start, &prefetch, (const int[]){6, vecs});
            break;
        case 7:
            multiply_tile(g, i, panel, start, &prefetch, (const int[]){7, vecs});
            break;
        default:
            multiply_tile(g, i, panel, start, &prefetch, (const int[]){ROWS, vecs});
        }
}

static void gemm_s8(const struct gemm_s8 *g)
{
    for (int i = 0; i < g->m; i += BLOCK) {
        int32_t start[BLOCK];
        int end = g->m - i < BLOCK ? g->m : i + BLOCK, panel = 0;
        start_sums(g, i, end - i, start);
        for (; panel + 2 <= g->panels; panel += 2)
            multiply_panels(g, i, end, panel, start, 2);
        if (panel < g->panels)
            multiply_panels(g, i, end, panel, start, 1);
    }
}

void gemm_avx512vnni(struct gemm_kernels *k)
{
    k->s8_name = "avx512vnni";
    k->s8 = gemm_s8;
}
