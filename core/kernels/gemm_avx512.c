#if !defined(__AVX512BW__)
#error "compile this file with the AVX-512 flags"
#endif
#define SIMD_AVX512
#include "core/kernels/gemm_body.h"

#define VEC 32
#define V_REGISTER "v"
typedef __m512i vec;

static inline vec v_widen(const int8_t *p)
{
    return _mm512_cvtepi8_epi16(_mm256_loadu_si256((const __m256i *)p));
}

static inline vec v_quad(const int16_t *p)
{
    long long x;
    memcpy(&x, p, sizeof x);
    return _mm512_set1_epi64(x);
}

static inline vec v_madd(vec a, vec b)
{
    return _mm512_madd_epi16(a, b);
}

static inline vec v_plus(vec a, vec b)
{
    return _mm512_add_epi32(a, b);
}

static inline vec v_fold(vec x, vec y)
{
    const vec even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    const vec odd = _mm512_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
    return v_plus(_mm512_permutex2var_epi32(x, even, y), _mm512_permutex2var_epi32(x, odd, y));
}

#include "core/kernels/widen_body.h"

void gemm_avx512(struct gemm_kernels *k)
{
    gemm_fill(k, "avx512");
    k->s8_name = "avx512";
    k->s8 = gemm_s8;
}
