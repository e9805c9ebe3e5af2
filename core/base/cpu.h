/* cpu.h - the vector instructions that processor and system support.
 * Levels are groups that are used together; a higher x86 level is reported only with the ones below
 * it.
 * thread: any. */
#ifndef BASE_CPU_H
#define BASE_CPU_H

#include "core/base/err.h"

enum {
    CPU_SSE41 = 1,
    CPU_AVX2 = 2,   // with FMA and F16C
    CPU_AVX512 = 4, // F, BW, VL and DQ
    CPU_NEON = 8,
    CPU_NEONDOT = 16,     // int8 dot product
    CPU_I8MM = 32,        // int8 matrix product
    CPU_AMX = 64,         // tiles and their int8 product
    CPU_AVX512VNNI = 128, // int8 dot product
    CPU_ALL = 255
};

enum { CPU_NAMES_CAP = 64 }; // bytes that hold every list of names

/* The levels that processor and operating system both support, as bits; 0 = plain C. Requests
 * permission for AMX tiles, which the system grants to the whole process. */
unsigned cpu_detect(void);

/* Read a list of levels to allow, separated by blanks or commas: "sse41,avx2". "c" names no level;
 * NULL and "" are CPU_ALL.
 * err:  ERR_ARG names the unknown word. */
MUST_USE err_t cpu_parse_mask(const char *text, unsigned *mask);

/* The names in `mask`, separated by blanks, "c" if there are none. returns: buf. */
const char *cpu_names(unsigned mask, char buf[CPU_NAMES_CAP]);

#endif
