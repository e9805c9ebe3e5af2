/* base64.h - bytes as text (RFC 4648, section 4, with padding). Pure computation.
 * thread: any. */
#ifndef BASE_BASE64_H
#define BASE_BASE64_H

#include <stddef.h>

/* Characters of n bytes. */
static inline size_t base64_chars(size_t n)
{
    return (n / 3 + (n % 3 != 0)) * 4;
}

/* Write base64_chars(n) characters without a terminating 0. returns: the next position. */
char *base64_encode(char *out, const void *bytes, size_t n);

#endif
