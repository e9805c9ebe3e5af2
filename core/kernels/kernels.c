#include "core/kernels/kernels.h"

#include "core/base/cpu.h"

void kernels_init(struct kernels *k, unsigned cpu)
{
    splat_c(k);
    loss_c(k);
    gemm_c(&k->net);
    nn_c(&k->net);
    fft_c(&k->net);
#if defined(__x86_64__)
    if (cpu & CPU_SSE41) {
        splat_sse41(k);
        loss_sse41(k);
        gemm_sse41(&k->net);
        nn_sse41(&k->net);
        fft_sse41(&k->net);
    }
    if (cpu & CPU_AVX2) {
        splat_avx2(k);
        loss_avx2(k);
        gemm_avx2(&k->net);
        nn_avx2(&k->net);
        fft_avx2(&k->net);
    }
    if (cpu & CPU_AVX512) {
        splat_avx512(k);
        loss_avx512(k);
        gemm_avx512(&k->net);
        nn_avx512(&k->net);
        fft_avx512(&k->net);
    }
    if (cpu & CPU_AVX512VNNI)
        gemm_avx512vnni(&k->net);
    if (cpu & CPU_AMX) {
        gemm_amx(&k->net);
        k->net.s8_beats_fft = true;
    }
#elif defined(__aarch64__)
    if (cpu & CPU_NEON) {
        splat_neon(k);
        loss_neon(k);
        gemm_neon(&k->net);
        nn_neon(&k->net);
        fft_neon(&k->net);
    }
    if (cpu & CPU_NEONDOT)
        gemm_neondot(&k->net);
    if (cpu & CPU_I8MM)
        gemm_i8mm(&k->net);
#else
    (void)cpu;
#endif
}
