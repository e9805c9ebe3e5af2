/* base64.h - bytes as text (RFC 4648): section 4, with padding, and section 5, whose digits need no
 * quoting anywhere, without. Pure computation.
 * thread: any. */
#ifndef BASE_BASE64_H
#define BASE_BASE64_H

#include <stdbool.h>
#include <stddef.h>

/* Characters of n bytes. */
static inline size_t base64_chars(size_t n)
{
    return (n / 3 + (n % 3 != 0)) * 4;
}

/* Write base64_chars(n) characters without a terminating 0. returns: the next position. */
char *base64_encode(char *out, const void *bytes, size_t n);

/* The same by section 5, which may take fewer of them. */
char *base64_encode_url(char *out, const void *bytes, size_t n);

/* Bytes of n digits of section 5, n / 4 * 3 + 2 at most. returns: false if they are none, or not
 * those that base64_encode_url writes. */
bool base64_decode_url(const char *text, size_t n, void *out, size_t *bytes);

#endif
