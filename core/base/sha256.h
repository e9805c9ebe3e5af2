/* sha256.h - the hash of FIPS 180-4, to name files by their content. Pure computation.
 * thread: any; a struct belongs to one thread. */
#ifndef BASE_SHA256_H
#define BASE_SHA256_H

#include <stddef.h>
#include <stdint.h>

enum { SHA256_HEX_CAP = 65 };

struct sha256 {
    uint32_t h[8];
    uint64_t bytes;
    uint8_t block[64]; // bytes % 64 of them are filled
};

void sha256_init(struct sha256 *s);
void sha256_add(struct sha256 *s, const void *p, size_t n);

/* The hash as 64 small hexadecimal digits; *s is used up. returns: out. */
const char *sha256_hex(struct sha256 *s, char out[SHA256_HEX_CAP]);

#endif
