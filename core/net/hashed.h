/* hashed.h - pseudorandom weights: every value follows from the tensor's name, its index
 * and a seed. They drive the golden tests, benches and examples without any trained file; other
 * programs make the same bits.
 *
 * With G = 0x9E3779B97F4A7C15 and h = FNV-1a 64 of the name, all modulo 2^64:
 *   z = h + seed G + (i + 1) G;  z = (z ^ z >> 30) 0xBF58476D1CE4E5B9
 *   z = (z ^ z >> 27) 0x94D049BB133111EB;  z = z ^ z >> 31
 *   v = ((z >> 40) - 2^23) / 2^23 in [-1, 1);  value = offset + scale v, rounded twice
 * Scale and offset depend on the name (hashed.c). Pure computation; thread: any. */
#ifndef NET_HASHED_H
#define NET_HASHED_H

#include "core/net/table.h"

#include <stdint.h>

/* Values [first, first + n) of tensor t, in the order of the checkpoint. */
void hashed_fill(const struct tensor_spec *t, uint64_t seed, size_t first, size_t n, float *out);

#endif
