/* simd.h - the few vector operations that the float kernels are written in.
 * The including file defines exactly one of SIMD_C, SIMD_SSE41, SIMD_AVX2, SIMD_AVX512, SIMD_NEON.
 * vf: LANES floats; vm: one truth value per lane. The operators + - * / work on vf everywhere.
 * v_fma(a, b, c) = a b + c; v_fnma(a, b, c) = c - a b; v_recip: 1 / a within 2e-7.
 * Comparisons with NaN are false. v_min/v_max return the second operand if the first is NaN.
 * Not with SIMD_C:
 * _n: only the first n lanes, 1 <= n <= LANES; loads set the others to 0.
 * v_swap(a, d): lanes i and i ^ d change places, d a power of two below LANES. v_top: largest lane.
 * vint: LANES int32. i_magnitude: bits of |a|. i_top: largest lane. i_round: to nearest, half to
 * even. i_store8: the first n lanes as int8, saturated; i_store8x4 all lanes of four vectors. */
#ifndef KERNELS_SIMD_H
#define KERNELS_SIMD_H

#include <math.h>
#include <stdint.h>
#include <string.h>

/* One line per operation where it fits. */
// clang-format off

#if defined(SIMD_AVX512)
#if !defined(__AVX512F__) || !defined(__AVX512DQ__) || !defined(__AVX512VL__)
#error "compile this file with the AVX-512 flags"
#endif
#include <immintrin.h>
#define LANES 16
typedef __m512 vf;
typedef __mmask16 vm;
static inline vf v_load(const float *p) { return _mm512_loadu_ps(p); }
static inline void v_store(float *p, vf a) { _mm512_storeu_ps(p, a); }
static inline vf v_set(float x) { return _mm512_set1_ps(x); }
static inline vf v_fma(vf a, vf b, vf c) { return _mm512_fmadd_ps(a, b, c); }
static inline vf v_fnma(vf a, vf b, vf c) { return _mm512_fnmadd_ps(a, b, c); }
static inline vf v_recip(vf a)
{
    vf r = _mm512_rcp14_ps(a);
    return _mm512_mul_ps(r, _mm512_fnmadd_ps(a, r, _mm512_set1_ps(2.0f)));
}
static inline vf v_min(vf a, vf b) { return _mm512_min_ps(a, b); }
static inline vf v_max(vf a, vf b) { return _mm512_max_ps(a, b); }
static inline vf v_sqrt(vf a) { return _mm512_sqrt_ps(a); }
static inline vf v_floor(vf a) { return _mm512_roundscale_ps(a, 0x09); }
static inline vf v_round(vf a) { return _mm512_roundscale_ps(a, 0x08); }
static inline vm v_lt(vf a, vf b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
static inline vm v_le(vf a, vf b) { return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ); }
static inline vm m_and(vm a, vm b) { return a & b; }
static inline vm m_or(vm a, vm b) { return a | b; }
static inline vm m_none(void) { return 0; }
static inline vm m_andnot(vm a, vm b) { return (vm)(a & ~b); }
static inline int m_any(vm a) { return a != 0; }
static inline int m_bits(vm a) { return a; }
static inline vf v_sel(vm m, vf a, vf b) { return _mm512_mask_blend_ps(m, b, a); }
static inline vf v_exp2i(vf n) /* 2^n, n integral in [-126, 127] */
{
    __m512i biased = _mm512_add_epi32(_mm512_cvtps_epi32(n), _mm512_set1_epi32(127));
    return _mm512_castsi512_ps(_mm512_slli_epi32(biased, 23));
}
static inline vf v_scale2(vf a, vf n) { return _mm512_scalef_ps(a, n); } /* a 2^n */
static inline vf v_shrink2(vf a, vf x) { return _mm512_scalef_ps(a, x); } /* a 2^floor(x), x < 1 */
static inline vf v_exponent(vf a) /* biased exponent bits as float, a > 0 */
{
    return _mm512_cvtepi32_ps(_mm512_srli_epi32(_mm512_castps_si512(a), 23));
}
static inline vf v_mantissa(vf a) /* in [1, 2), a > 0 normal */
{
    __m512i i = _mm512_and_si512(_mm512_castps_si512(a), _mm512_set1_epi32(0x007fffff));
    return _mm512_castsi512_ps(_mm512_or_si512(i, _mm512_set1_epi32(0x3f800000)));
}
static inline float v_sum(vf a) { return _mm512_reduce_add_ps(a); }
static inline float v_top(vf a) { return _mm512_reduce_max_ps(a); }
static inline vm m_first(int n) { return (vm)((1u << n) - 1); }
static inline vf v_load_n(const float *p, int n) { return _mm512_maskz_loadu_ps(m_first(n), p); }
static inline void v_store_n(float *p, vf a, int n) { _mm512_mask_storeu_ps(p, m_first(n), a); }
static inline vf v_swap(vf a, int d)
{
    return d == 1   ? _mm512_permute_ps(a, 0xb1)
           : d == 2 ? _mm512_permute_ps(a, 0x4e)
           : d == 4 ? _mm512_shuffle_f32x4(a, a, 0xb1)
                    : _mm512_shuffle_f32x4(a, a, 0x4e);
}
typedef __m512i vint;
static inline vint i_load(const int32_t *p) { return _mm512_loadu_si512(p); }
static inline vint i_load_n(const int32_t *p, int n)
{
    return _mm512_maskz_loadu_epi32(m_first(n), p);
}
static inline vint i_set(int x) { return _mm512_set1_epi32(x); }
static inline vint i_add(vint a, vint b) { return _mm512_add_epi32(a, b); }
static inline vint i_max(vint a, vint b) { return _mm512_max_epi32(a, b); }
static inline vint i_magnitude(vf a)
{
    return _mm512_and_si512(_mm512_castps_si512(a), _mm512_set1_epi32(0x7fffffff));
}
static inline int32_t i_top(vint a) { return _mm512_reduce_max_epi32(a); }
static inline int32_t i_sum(vint a) { return _mm512_reduce_add_epi32(a); }
static inline vf i_float(vint a) { return _mm512_cvtepi32_ps(a); }
static inline vint i_round(vf a) { return _mm512_cvtps_epi32(a); }
static inline void i_store8(int8_t *p, vint a, int n)
{
    __m128i bytes = _mm512_cvtsepi32_epi8(a);
    if (n == LANES)
        _mm_storeu_si128((__m128i *)p, bytes);
    else
        _mm_mask_storeu_epi8(p, m_first(n), bytes);
}
static inline void i_store8x4(int8_t *p, const vint a[4])
{
    const __m512i order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
    __m512i b = _mm512_packs_epi32(a[0], a[1]), c = _mm512_packs_epi32(a[2], a[3]);
    _mm512_storeu_si512(p, _mm512_permutexvar_epi32(order, _mm512_packs_epi16(b, c)));
}

#elif defined(SIMD_AVX2)
#if !defined(__AVX2__) || !defined(__FMA__)
#error "compile this file with -mavx2 -mfma"
#endif
#include <immintrin.h>
#define LANES 8
typedef __m256 vf;
typedef __m256 vm;
static inline vf v_load(const float *p) { return _mm256_loadu_ps(p); }
static inline void v_store(float *p, vf a) { _mm256_storeu_ps(p, a); }
static inline vf v_set(float x) { return _mm256_set1_ps(x); }
static inline vf v_fma(vf a, vf b, vf c) { return _mm256_fmadd_ps(a, b, c); }
static inline vf v_fnma(vf a, vf b, vf c) { return _mm256_fnmadd_ps(a, b, c); }
static inline vf v_recip(vf a) { return _mm256_set1_ps(1.0f) / a; }
static inline vf v_min(vf a, vf b) { return _mm256_min_ps(a, b); }
static inline vf v_max(vf a, vf b) { return _mm256_max_ps(a, b); }
static inline vf v_sqrt(vf a) { return _mm256_sqrt_ps(a); }
static inline vf v_floor(vf a) { return _mm256_floor_ps(a); }
static inline vf v_round(vf a) { return _mm256_round_ps(a, 0x08); }
static inline vm v_lt(vf a, vf b) { return _mm256_cmp_ps(a, b, _CMP_LT_OQ); }
static inline vm v_le(vf a, vf b) { return _mm256_cmp_ps(a, b, _CMP_LE_OQ); }
static inline vm m_and(vm a, vm b) { return _mm256_and_ps(a, b); }
static inline vm m_or(vm a, vm b) { return _mm256_or_ps(a, b); }
static inline vm m_none(void) { return _mm256_setzero_ps(); }
static inline vm m_andnot(vm a, vm b) { return _mm256_andnot_ps(b, a); }
static inline int m_bits(vm a) { return _mm256_movemask_ps(a); }
static inline int m_any(vm a) { return m_bits(a) != 0; }
static inline vf v_sel(vm m, vf a, vf b) { return _mm256_blendv_ps(b, a, m); }
static inline vf v_exp2i(vf n)
{
    __m256i biased = _mm256_add_epi32(_mm256_cvtps_epi32(n), _mm256_set1_epi32(127));
    return _mm256_castsi256_ps(_mm256_slli_epi32(biased, 23));
}
static inline vf v_exponent(vf a)
{
    return _mm256_cvtepi32_ps(_mm256_srli_epi32(_mm256_castps_si256(a), 23));
}
static inline vf v_mantissa(vf a)
{
    __m256i i = _mm256_and_si256(_mm256_castps_si256(a), _mm256_set1_epi32(0x007fffff));
    return _mm256_castsi256_ps(_mm256_or_si256(i, _mm256_set1_epi32(0x3f800000)));
}
static inline float v_sum(vf a)
{
    __m128 s = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps(a, 1));
    s = _mm_add_ps(s, _mm_movehl_ps(s, s));
    return _mm_cvtss_f32(_mm_add_ss(s, _mm_movehdup_ps(s)));
}
static inline float v_top(vf a)
{
    __m128 s = _mm_max_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps(a, 1));
    s = _mm_max_ps(s, _mm_movehl_ps(s, s));
    return _mm_cvtss_f32(_mm_max_ss(s, _mm_movehdup_ps(s)));
}
typedef __m256i vint;
static inline vint i_first(int n)
{
    const vint lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    return _mm256_cmpgt_epi32(_mm256_set1_epi32(n), lane);
}
static inline vm m_first(int n) { return _mm256_castsi256_ps(i_first(n)); }
static inline vf v_load_n(const float *p, int n) { return _mm256_maskload_ps(p, i_first(n)); }
static inline void v_store_n(float *p, vf a, int n) { _mm256_maskstore_ps(p, i_first(n), a); }
static inline vf v_swap(vf a, int d)
{
    return d == 1   ? _mm256_permute_ps(a, 0xb1)
           : d == 2 ? _mm256_permute_ps(a, 0x4e)
                    : _mm256_permute2f128_ps(a, a, 1);
}
static inline vint i_load(const int32_t *p) { return _mm256_loadu_si256((const __m256i *)p); }
static inline vint i_load_n(const int32_t *p, int n)
{
    return _mm256_maskload_epi32(p, i_first(n));
}
static inline vint i_set(int x) { return _mm256_set1_epi32(x); }
static inline vint i_add(vint a, vint b) { return _mm256_add_epi32(a, b); }
static inline vint i_max(vint a, vint b) { return _mm256_max_epi32(a, b); }
static inline vint i_magnitude(vf a)
{
    return _mm256_and_si256(_mm256_castps_si256(a), _mm256_set1_epi32(0x7fffffff));
}
static inline int32_t i_top(vint a)
{
    __m128i s = _mm_max_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
    s = _mm_max_epi32(s, _mm_shuffle_epi32(s, 0x4e));
    return _mm_cvtsi128_si32(_mm_max_epi32(s, _mm_shuffle_epi32(s, 0xb1)));
}
static inline int32_t i_sum(vint a)
{
    __m128i s = _mm_add_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
    s = _mm_add_epi32(s, _mm_shuffle_epi32(s, 0x4e));
    return _mm_cvtsi128_si32(_mm_add_epi32(s, _mm_shuffle_epi32(s, 0xb1)));
}
static inline vf i_float(vint a) { return _mm256_cvtepi32_ps(a); }
static inline vint i_round(vf a) { return _mm256_cvtps_epi32(a); }
static inline void i_store8(int8_t *p, vint a, int n)
{
    __m128i b = _mm_packs_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
    int64_t bytes = _mm_cvtsi128_si64(_mm_packs_epi16(b, b));
    memcpy(p, &bytes, (size_t)n);
}
static inline void i_store8x4(int8_t *p, const vint a[4])
{
    const __m256i order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
    __m256i b = _mm256_packs_epi32(a[0], a[1]), c = _mm256_packs_epi32(a[2], a[3]);
    b = _mm256_permutevar8x32_epi32(_mm256_packs_epi16(b, c), order);
    _mm256_storeu_si256((__m256i *)p, b);
}

#elif defined(SIMD_SSE41)
#if !defined(__SSE4_1__)
#error "compile this file with -msse4.1"
#endif
#include <smmintrin.h>
#define LANES 4
typedef __m128 vf;
typedef __m128 vm;
static inline vf v_load(const float *p) { return _mm_loadu_ps(p); }
static inline void v_store(float *p, vf a) { _mm_storeu_ps(p, a); }
static inline vf v_set(float x) { return _mm_set1_ps(x); }
static inline vf v_fma(vf a, vf b, vf c) { return a * b + c; }
static inline vf v_fnma(vf a, vf b, vf c) { return c - a * b; }
static inline vf v_recip(vf a) { return _mm_set1_ps(1.0f) / a; }
static inline vf v_min(vf a, vf b) { return _mm_min_ps(a, b); }
static inline vf v_max(vf a, vf b) { return _mm_max_ps(a, b); }
static inline vf v_sqrt(vf a) { return _mm_sqrt_ps(a); }
static inline vf v_floor(vf a) { return _mm_floor_ps(a); }
static inline vf v_round(vf a) { return _mm_round_ps(a, 0x08); }
static inline vm v_lt(vf a, vf b) { return _mm_cmplt_ps(a, b); }
static inline vm v_le(vf a, vf b) { return _mm_cmple_ps(a, b); }
static inline vm m_and(vm a, vm b) { return _mm_and_ps(a, b); }
static inline vm m_or(vm a, vm b) { return _mm_or_ps(a, b); }
static inline vm m_none(void) { return _mm_setzero_ps(); }
static inline vm m_andnot(vm a, vm b) { return _mm_andnot_ps(b, a); }
static inline int m_bits(vm a) { return _mm_movemask_ps(a); }
static inline int m_any(vm a) { return m_bits(a) != 0; }
static inline vf v_sel(vm m, vf a, vf b) { return _mm_blendv_ps(b, a, m); }
static inline vf v_exp2i(vf n)
{
    __m128i biased = _mm_add_epi32(_mm_cvtps_epi32(n), _mm_set1_epi32(127));
    return _mm_castsi128_ps(_mm_slli_epi32(biased, 23));
}
static inline vf v_exponent(vf a)
{
    return _mm_cvtepi32_ps(_mm_srli_epi32(_mm_castps_si128(a), 23));
}
static inline vf v_mantissa(vf a)
{
    __m128i i = _mm_and_si128(_mm_castps_si128(a), _mm_set1_epi32(0x007fffff));
    return _mm_castsi128_ps(_mm_or_si128(i, _mm_set1_epi32(0x3f800000)));
}
static inline float v_sum(vf a)
{
    a = _mm_add_ps(a, _mm_movehl_ps(a, a));
    return _mm_cvtss_f32(_mm_add_ss(a, _mm_movehdup_ps(a)));
}
static inline float v_top(vf a)
{
    a = _mm_max_ps(a, _mm_movehl_ps(a, a));
    return _mm_cvtss_f32(_mm_max_ss(a, _mm_movehdup_ps(a)));
}
typedef __m128i vint;
static inline vm m_first(int n)
{
    return _mm_castsi128_ps(_mm_cmpgt_epi32(_mm_set1_epi32(n), _mm_setr_epi32(0, 1, 2, 3)));
}
static inline vf v_swap(vf a, int d)
{
    return d == 1 ? _mm_shuffle_ps(a, a, 0xb1) : _mm_shuffle_ps(a, a, 0x4e);
}
static inline vint i_load(const int32_t *p) { return _mm_loadu_si128((const __m128i *)p); }
static inline vint i_set(int x) { return _mm_set1_epi32(x); }
static inline vint i_add(vint a, vint b) { return _mm_add_epi32(a, b); }
static inline vint i_max(vint a, vint b) { return _mm_max_epi32(a, b); }
static inline vint i_magnitude(vf a)
{
    return _mm_and_si128(_mm_castps_si128(a), _mm_set1_epi32(0x7fffffff));
}
static inline int32_t i_top(vint a)
{
    a = _mm_max_epi32(a, _mm_shuffle_epi32(a, 0x4e));
    return _mm_cvtsi128_si32(_mm_max_epi32(a, _mm_shuffle_epi32(a, 0xb1)));
}
static inline int32_t i_sum(vint a)
{
    a = _mm_add_epi32(a, _mm_shuffle_epi32(a, 0x4e));
    return _mm_cvtsi128_si32(_mm_add_epi32(a, _mm_shuffle_epi32(a, 0xb1)));
}
static inline vf i_float(vint a) { return _mm_cvtepi32_ps(a); }
static inline vint i_round(vf a) { return _mm_cvtps_epi32(a); }
static inline void i_store8(int8_t *p, vint a, int n)
{
    a = _mm_packs_epi32(a, a);
    int32_t bytes = _mm_cvtsi128_si32(_mm_packs_epi16(a, a));
    memcpy(p, &bytes, (size_t)n);
}
static inline void i_store8x4(int8_t *p, const vint a[4])
{
    __m128i b = _mm_packs_epi32(a[0], a[1]), c = _mm_packs_epi32(a[2], a[3]);
    _mm_storeu_si128((__m128i *)p, _mm_packs_epi16(b, c));
}

#elif defined(SIMD_NEON)
#include <arm_neon.h>
#define LANES 4
typedef float32x4_t vf;
typedef uint32x4_t vm;
static inline vf v_load(const float *p) { return vld1q_f32(p); }
static inline void v_store(float *p, vf a) { vst1q_f32(p, a); }
static inline vf v_set(float x) { return vdupq_n_f32(x); }
static inline vf v_fma(vf a, vf b, vf c) { return vfmaq_f32(c, a, b); }
static inline vf v_fnma(vf a, vf b, vf c) { return vfmsq_f32(c, a, b); }
static inline vf v_recip(vf a) { return vdupq_n_f32(1.0f) / a; }
static inline vf v_min(vf a, vf b) { return vbslq_f32(vcltq_f32(a, b), a, b); }
static inline vf v_max(vf a, vf b) { return vbslq_f32(vcgtq_f32(a, b), a, b); }
static inline vf v_sqrt(vf a) { return vsqrtq_f32(a); }
static inline vf v_floor(vf a) { return vrndmq_f32(a); }
static inline vf v_round(vf a) { return vrndnq_f32(a); }
static inline vm v_lt(vf a, vf b) { return vcltq_f32(a, b); }
static inline vm v_le(vf a, vf b) { return vcleq_f32(a, b); }
static inline vm m_and(vm a, vm b) { return vandq_u32(a, b); }
static inline vm m_or(vm a, vm b) { return vorrq_u32(a, b); }
static inline vm m_none(void) { return vdupq_n_u32(0); }
static inline vm m_andnot(vm a, vm b) { return vbicq_u32(a, b); }
static inline int m_any(vm a) { return vmaxvq_u32(a) != 0; }
static inline int m_bits(vm a)
{
    static const uint32_t bit[4] = {1, 2, 4, 8};
    return (int)vaddvq_u32(vandq_u32(a, vld1q_u32(bit)));
}
static inline vf v_sel(vm m, vf a, vf b) { return vbslq_f32(m, a, b); }
static inline vf v_exp2i(vf n)
{
    return vreinterpretq_f32_s32(vshlq_n_s32(vaddq_s32(vcvtnq_s32_f32(n), vdupq_n_s32(127)), 23));
}
static inline vf v_exponent(vf a)
{
    return vcvtq_f32_u32(vshrq_n_u32(vreinterpretq_u32_f32(a), 23));
}
static inline vf v_mantissa(vf a)
{
    uint32x4_t i = vandq_u32(vreinterpretq_u32_f32(a), vdupq_n_u32(0x007fffff));
    return vreinterpretq_f32_u32(vorrq_u32(i, vdupq_n_u32(0x3f800000)));
}
static inline float v_sum(vf a) { return vaddvq_f32(a); }
static inline float v_top(vf a) { return vmaxvq_f32(a); }
typedef int32x4_t vint;
static inline vm m_first(int n)
{
    static const int32_t lane[4] = {0, 1, 2, 3};
    return vcltq_s32(vld1q_s32(lane), vdupq_n_s32(n));
}
static inline vf v_swap(vf a, int d) { return d == 1 ? vrev64q_f32(a) : vextq_f32(a, a, 2); }
static inline vint i_load(const int32_t *p) { return vld1q_s32(p); }
static inline vint i_set(int x) { return vdupq_n_s32(x); }
static inline vint i_add(vint a, vint b) { return vaddq_s32(a, b); }
static inline vint i_max(vint a, vint b) { return vmaxq_s32(a, b); }
static inline vint i_magnitude(vf a) { return vreinterpretq_s32_f32(vabsq_f32(a)); }
static inline int32_t i_top(vint a) { return vmaxvq_s32(a); }
static inline int32_t i_sum(vint a) { return vaddvq_s32(a); }
static inline vf i_float(vint a) { return vcvtq_f32_s32(a); }
static inline vint i_round(vf a) { return vcvtnq_s32_f32(a); }
static inline void i_store8(int8_t *p, vint a, int n)
{
    int16x4_t b = vqmovn_s32(a);
    int8x8_t c = vqmovn_s16(vcombine_s16(b, b));
    uint32_t bytes = vget_lane_u32(vreinterpret_u32_s8(c), 0);
    memcpy(p, &bytes, (size_t)n);
}
static inline void i_store8x4(int8_t *p, const vint a[4])
{
    int16x8_t b = vqmovn_high_s32(vqmovn_s32(a[0]), a[1]);
    int16x8_t c = vqmovn_high_s32(vqmovn_s32(a[2]), a[3]);
    vst1q_s8(p, vqmovn_high_s16(vqmovn_s16(b), c));
}

#else
#define LANES 1
typedef float vf;
typedef int vm;
static inline vf v_load(const float *p) { return *p; }
static inline void v_store(float *p, vf a) { *p = a; }
static inline vf v_set(float x) { return x; }
static inline vf v_fma(vf a, vf b, vf c) { return a * b + c; }
static inline vf v_fnma(vf a, vf b, vf c) { return c - a * b; }
static inline vf v_recip(vf a) { return 1.0f / a; }
static inline vf v_min(vf a, vf b) { return a < b ? a : b; }
static inline vf v_max(vf a, vf b) { return a > b ? a : b; }
static inline vf v_sqrt(vf a) { return sqrtf(a); }
static inline vf v_floor(vf a) { return floorf(a); }
static inline vf v_round(vf a) { return rintf(a); }
static inline vm v_lt(vf a, vf b) { return a < b; }
static inline vm v_le(vf a, vf b) { return a <= b; }
static inline vm m_and(vm a, vm b) { return a & b; }
static inline vm m_or(vm a, vm b) { return a | b; }
static inline vm m_none(void) { return 0; }
static inline vm m_andnot(vm a, vm b) { return a & !b; }
static inline int m_any(vm a) { return a; }
static inline int m_bits(vm a) { return a; }
static inline vf v_sel(vm m, vf a, vf b) { return m ? a : b; }
static inline vf v_exp2i(vf n)
{
    uint32_t i = (uint32_t)((int32_t)fminf(fmaxf(n, -127.0f), 128.0f) + 127) << 23;
    float f;
    memcpy(&f, &i, 4);
    return f;
}
static inline vf v_exponent(vf a)
{
    uint32_t i;
    memcpy(&i, &a, 4);
    return (float)(i >> 23);
}
static inline vf v_mantissa(vf a)
{
    uint32_t i;
    memcpy(&i, &a, 4);
    i = (i & 0x007fffffu) | 0x3f800000u;
    memcpy(&a, &i, 4);
    return a;
}
static inline float v_sum(vf a) { return a; }
#endif
// clang-format on

#if defined(SIMD_SSE41) || defined(SIMD_NEON)
static inline vf v_load_n(const float *p, int n)
{
    float lanes[LANES] = {0};
    memcpy(lanes, p, (size_t)n * sizeof *p);
    return v_load(lanes);
}
static inline void v_store_n(float *p, vf a, int n)
{
    float lanes[LANES];
    v_store(lanes, a);
    memcpy(p, lanes, (size_t)n * sizeof *p);
}
static inline vint i_load_n(const int32_t *p, int n)
{
    int32_t lanes[LANES] = {0};
    memcpy(lanes, p, (size_t)n * sizeof *p);
    return i_load(lanes);
}
#endif

#if !defined(SIMD_AVX512)
static inline vf v_scale2(vf a, vf n)
{
    return a * v_exp2i(n);
}
static inline vf v_shrink2(vf a, vf x)
{
    return a * v_exp2i(v_max(v_floor(x), v_set(-126.0f)));
}
#endif

static inline vf v_clamp(vf a, float lo, float hi)
{
    return v_min(v_max(a, v_set(lo)), v_set(hi));
}

/* e^x for x clamped to [-87, 87]; relative error below 3e-7. Cephes' reduction by ln 2 in two parts
 * and a polynomial of degree 5 for (e^r - 1 - r) / r^2. NaN gives e^-87. */
static inline vf v_exp(vf x)
{
    x = v_clamp(x, -87.0f, 87.0f);
    vf n = v_round(x * v_set(1.44269504088896341f));
    vf r = v_fma(n, v_set(-0.693359375f), x);
    r = v_fma(n, v_set(2.12194440e-4f), r);
    vf p = v_set(1.9875691500e-4f);
    p = v_fma(p, r, v_set(1.3981999507e-3f));
    p = v_fma(p, r, v_set(8.3334519073e-3f));
    p = v_fma(p, r, v_set(4.1665795894e-2f));
    p = v_fma(p, r, v_set(1.6666665459e-1f));
    p = v_fma(p, r, v_set(5.0000001201e-1f));
    p = v_fma(p * r, r, r) + v_set(1.0f);
    return p * v_exp2i(n);
}

/* 2^x for x in [-126, 127], relative error below 3e-7; any other x gives some number. Minimax
 * polynomial of degree 5 for 2^f on [-1/2, 1/2], itself within 1e-7. */
static inline vf v_exp2(vf x)
{
    vf n = v_round(x), f = x - n;
    vf p = v_set(1.326472717e-03f);
    p = v_fma(p, f, v_set(9.671512833e-03f));
    p = v_fma(p, f, v_set(5.550733745e-02f));
    p = v_fma(p, f, v_set(2.402224208e-01f));
    p = v_fma(p, f, v_set(6.931469776e-01f));
    p = v_fma(p, f, v_set(1.0f));
    return v_scale2(p, n);
}

/* log2(x) for normal x > 0; absolute error below 2e-7 + 1e-7 |log2 x|. Mantissa folded to
 * [sqrt 1/2, sqrt 2], then the odd series of atanh in s = (m-1)/(m+1) to s^9. */
static inline vf v_log2(vf x)
{
    vf e = v_exponent(x) - v_set(127.0f);
    vf m = v_mantissa(x);
    vm big = v_lt(v_set(1.41421356f), m);
    m = v_sel(big, m * v_set(0.5f), m);
    e = v_sel(big, e + v_set(1.0f), e);
    vf s = (m - v_set(1.0f)) / (m + v_set(1.0f));
    vf z = s * s;
    vf p = v_set(2.0f / 9.0f * 1.44269504f);
    p = v_fma(p, z, v_set(2.0f / 7.0f * 1.44269504f));
    p = v_fma(p, z, v_set(2.0f / 5.0f * 1.44269504f));
    p = v_fma(p, z, v_set(2.0f / 3.0f * 1.44269504f));
    p = v_fma(p, z, v_set(2.0f * 1.44269504f));
    return v_fma(p, s, e);
}

#endif
