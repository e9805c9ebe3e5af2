/* Integer products by SDOT: 16 multiplications of int8 an instruction, two instructions a cycle on
 * Cortex-A76. */
#if !defined(__ARM_FEATURE_DOTPROD)
#error "compile this file with dot products"
#endif
#include "core/kernels/kernels.h"

#include <arm_neon.h>
#include <string.h>

#define PRODUCT gemm_s8
#define ELEM int8_t
#define SUM int32_t
enum { WORD = 4 };
typedef int8x16_t vin;
typedef int32x4_t vsum;

static inline vin v_load(const int8_t *p)
{
    return vld1q_s8(p);
}

static inline vin v_word(const int8_t *p)
{
    int32_t word;
    memcpy(&word, p, sizeof word);
    return vreinterpretq_s8_s32(vsetq_lane_s32(word, vdupq_n_s32(0), 0));
}

static inline vsum v_lane(vsum sum, vin w, vin a, int lane)
{
    switch (lane) {
    case 0:
        return vdotq_laneq_s32(sum, w, a, 0);
    case 1:
        return vdotq_laneq_s32(sum, w, a, 1);
    case 2:
        return vdotq_laneq_s32(sum, w, a, 2);
    default:
        return vdotq_laneq_s32(sum, w, a, 3);
    }
}

static inline vsum v_start(const struct gemm_s8 *g, const int32_t *c)
{
    (void)g, (void)c;
    return vdupq_n_s32(0);
}

static inline void v_store(int32_t *c, vsum sum)
{
    vst1q_s32(c, sum);
}

#include "core/kernels/lane_body.h"

void gemm_neondot(struct gemm_kernels *k)
{
    k->s8_name = "neondot";
    k->s8 = gemm_by_tiles;
}
