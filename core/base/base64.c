#include "core/base/base64.h"

#include <stdint.h>

char *base64_encode(char *out, const void *bytes, size_t n)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const uint8_t *p = bytes;
    for (; n > 0; p += 3) {
        uint32_t v = (uint32_t)p[0] << 16 | (n > 1 ? (uint32_t)p[1] << 8 : 0) | (n > 2 ? p[2] : 0);
        *out++ = digits[v >> 18];
        *out++ = digits[v >> 12 & 63];
        *out++ = n > 1 ? digits[v >> 6 & 63] : '=';
        *out++ = n > 2 ? digits[v & 63] : '=';
        n -= n < 3 ? n : 3;
    }
    return out;
}

char *base64_encode_url(char *out, const void *bytes, size_t n)
{
    char *end = base64_encode(out, bytes, n);
    while (end > out && end[-1] == '=')
        end--;
    for (char *p = out; p < end; p++)
        *p = *p == '+' ? '-' : *p == '/' ? '_' : *p;
    return end;
}

static int value_of(char digit)
{
    if (digit >= 'A' && digit <= 'Z')
        return digit - 'A';
    if (digit >= 'a' && digit <= 'z')
        return digit - 'a' + 26;
    if (digit >= '0' && digit <= '9')
        return digit - '0' + 52;
    return digit == '-' ? 62 : digit == '_' ? 63 : -1;
}

bool base64_decode_url(const char *text, size_t n, void *out, size_t *bytes)
{
    uint8_t *to = out;
    uint32_t v = 0;
    int bits = 0; // of v that are not written yet
    *bytes = 0;
    for (size_t i = 0; i < n; i++) {
        const int digit = value_of(text[i]);
        if (digit < 0)
            return false;
        v = v << 6 | (uint32_t)digit;
        bits += 6;
        if (bits < 8)
            continue;
        bits -= 8;
        *to++ = (uint8_t)(v >> bits);
        v &= (1u << bits) - 1;
        (*bytes)++;
    }
    return n % 4 != 1 && v == 0;
}
