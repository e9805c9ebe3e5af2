#include "core/base/cpu.h"

#include <stdio.h>
#include <string.h>

#if defined(__x86_64__)
#include <cpuid.h>
#include <sys/syscall.h>
#include <unistd.h>
#elif defined(__aarch64__)
#include <asm/hwcap.h>
#include <sys/auxv.h>
#endif

static const struct {
    const char *name;
    unsigned bit;
} levels[] = {{"sse41", CPU_SSE41},           {"avx2", CPU_AVX2}, {"avx512", CPU_AVX512},
              {"avx512vnni", CPU_AVX512VNNI}, {"amx", CPU_AMX},   {"neon", CPU_NEON},
              {"neondot", CPU_NEONDOT},       {"i8mm", CPU_I8MM}};

enum { N_LEVELS = sizeof levels / sizeof levels[0] };

#if defined(__x86_64__)

/* Bits of XCR0 (Intel SDM vol. 1, 13.3): the system saves these registers with a task. */
enum { XCR0_AVX = 0x06, XCR0_AVX512 = 0xe6, XCR0_AMX = 0x60000 };

/* CPUID 7.0 EDX: tiles, int8; Linux's constants for its permission (asm/prctl.h since 5.16). */
enum { BIT_AMX = 1 << 24 | 1 << 25, REQ_XCOMP_PERM = 0x1023, XTILEDATA = 18 };

static unsigned saved_state(void)
{
    unsigned low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

static int has_all(unsigned reg, unsigned bits)
{
    return (reg & bits) == bits;
}

unsigned cpu_detect(void)
{
    unsigned a, b, c, d, b7 = 0, c7 = 0, d7 = 0, found = 0;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_SSE4_1))
        return 0;
    found |= CPU_SSE41;
    if (__get_cpuid_count(7, 0, &a, &b7, &c7, &d7) == 0 || !has_all(c, bit_OSXSAVE | bit_AVX))
        return found;
    unsigned saved = saved_state();
    if (!has_all(saved, XCR0_AVX) || !has_all(c, bit_FMA | bit_F16C) || !(b7 & bit_AVX2))
        return found;
    found |= CPU_AVX2;
    unsigned need7 = bit_AVX512F | bit_AVX512BW | bit_AVX512VL | bit_AVX512DQ;
    if (!has_all(saved, XCR0_AVX512) || !has_all(b7, need7))
        return found;
    found |= CPU_AVX512;
    if (!(c7 & bit_AVX512VNNI))
        return found;
    found |= CPU_AVX512VNNI;
    if (has_all(saved, XCR0_AMX) && has_all(d7, BIT_AMX) &&
        syscall(SYS_arch_prctl, REQ_XCOMP_PERM, XTILEDATA) == 0)
        found |= CPU_AMX;
    return found;
}

#elif defined(__aarch64__)

unsigned cpu_detect(void)
{
    unsigned long cap = getauxval(AT_HWCAP), cap2 = getauxval(AT_HWCAP2);
    unsigned found = cap & HWCAP_ASIMD ? CPU_NEON : 0;
    if (found && (cap & HWCAP_ASIMDDP))
        found |= CPU_NEONDOT;
    if (found && (cap2 & HWCAP2_I8MM))
        found |= CPU_I8MM;
    return found;
}

#else

unsigned cpu_detect(void)
{
    return 0;
}

#endif

static unsigned level_bit(const char *word, size_t len)
{
    for (int i = 0; i < N_LEVELS; i++)
        if (strlen(levels[i].name) == len && memcmp(levels[i].name, word, len) == 0)
            return levels[i].bit;
    return 0;
}

err_t cpu_parse_mask(const char *text, unsigned *mask)
{
    static const char gaps[] = " ,";
    *mask = text && *text ? 0 : CPU_ALL;
    if (*mask)
        return OK;
    for (const char *p = text + strspn(text, gaps); *p; p += strspn(p, gaps)) {
        size_t len = strcspn(p, gaps);
        unsigned bit = level_bit(p, len);
        if (!bit && !(len == 1 && *p == 'c')) {
            char all[CPU_NAMES_CAP];
            return err_fail(ERR_ARG, "cpu mask: \"%.*s\" is none of c %s",
                            (int)(len < 64 ? len : 64), p, cpu_names(CPU_ALL, all));
        }
        *mask |= bit;
        p += len;
    }
    return OK;
}

const char *cpu_names(unsigned mask, char buf[CPU_NAMES_CAP])
{
    int used = 0;
    for (int i = 0; i < N_LEVELS; i++)
        if (mask & levels[i].bit)
            used += snprintf(buf + used, (size_t)(CPU_NAMES_CAP - used), "%s%s", used ? " " : "",
                             levels[i].name);
    if (!used)
        strcpy(buf, "c");
    return buf;
}
