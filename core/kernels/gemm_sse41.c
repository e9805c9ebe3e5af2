#if !defined(__SSE4_1__)
#error "compile this file with -msse4.1"
#endif
#define SIMD_SSE41
#include "core/kernels/gemm_body.h"

#define VEC 8
#define V_REGISTER "x"
typedef __m128i vec;

static inline vec v_widen(const int8_t *p)
{
    return _mm_cvtepi8_epi16(_mm_loadl_epi64((const __m128i *)p));
}

static inline vec v_quad(const int16_t *p)
{
    long long x;
    memcpy(&x, p, sizeof x);
    return _mm_set1_epi64x(x);
}

static inline vec v_madd(vec a, vec b)
{
    return _mm_madd_epi16(a, b);
}

static inline vec v_plus(vec a, vec b)
{
    return _mm_add_epi32(a, b);
}

static inline vec v_fold(vec x, vec y)
{
    return _mm_hadd_epi32(x, y);
}

#include "core/kernels/widen_body.h"

void gemm_sse41(struct gemm_kernels *k)
{
    gemm_fill(k, "sse41");
    k->s8_name = "sse41";
    k->s8 = gemm_s8;
}
