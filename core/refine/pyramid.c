#include "core/refine/pyramid.h"

void pyramid_split(const uint8_t *rgb, size_t n, uint8_t *out)
{
    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < n; i++)
            out[c * n + i] = rgb[3 * i + c];
}

void pyramid_halve(const uint8_t *in, int w, int h, uint8_t *out)
{
    const size_t across = (size_t)w, m = across / 2, down = (size_t)h / 2;
    for (size_t c = 0; c < 3; c++, in += across * (size_t)h)
        for (size_t at = 0; at < m * down; at++) {
            const uint8_t *p = in + 2 * (at / m) * across + 2 * (at % m);
            *out++ = (uint8_t)((p[0] + p[1] + p[across] + p[across + 1] + 2) / 4);
        }
}

void pyramid_halve_deep(const uint16_t *in, int w, int h, uint16_t *out)
{
    const size_t across = (size_t)w, m = across / 2, down = (size_t)h / 2;
    for (size_t c = 0; c < 3; c++, in += across * (size_t)h)
        for (size_t at = 0; at < m * down; at++) {
            const uint16_t *p = in + 2 * (at / m) * across + 2 * (at % m);
            *out++ = (uint16_t)((p[0] + p[1] + p[across] + p[across + 1] + 2) / 4);
        }
}
