#if !defined(__AVX2__)
#error "compile this file with the AVX2 flags"
#endif
#define SIMD_AVX2
#include "core/kernels/gemm_body.h"

#define VEC 16
#define V_REGISTER "x"
typedef __m256i vec;

static inline vec v_widen(const int8_t *p)
{
    return _mm256_cvtepi8_epi16(_mm_loadu_si128((const __m128i *)p));
}

static inline vec v_quad(const int16_t *p)
{
    long long x;
    memcpy(&x, p, sizeof x);
    return _mm256_set1_epi64x(x);
}

static inline vec v_madd(vec a, vec b)
{
    return _mm256_madd_epi16(a, b);
}

static inline vec v_plus(vec a, vec b)
{
    return _mm256_add_epi32(a, b);
}

static inline vec v_fold(vec x, vec y)
{
    return _mm256_permute4x64_epi64(_mm256_hadd_epi32(x, y), 0xd8); // halves sum apart
}

#include "core/kernels/widen_body.h"

void gemm_avx2(struct gemm_kernels *k)
{
    gemm_fill(k, "avx2");
    k->s8_name = "avx2";
    k->s8 = gemm_s8;
}
