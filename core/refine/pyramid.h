/* pyramid.h - photographs as planes, and at half the size.
 * Pure functions; any thread. */
#ifndef REFINE_PYRAMID_H
#define REFINE_PYRAMID_H

#include <stddef.h>
#include <stdint.h>

/* n pixels R,G,B side by side become planes (3, n). */
void pyramid_split(const uint8_t *rgb, size_t n, uint8_t *out);

/* Means of four pixels each. in: planes (3, h, w); out: (3, h / 2, w / 2), not in. */
void pyramid_halve(const uint8_t *in, int w, int h, uint8_t *out);
void pyramid_halve_deep(const uint16_t *in, int w, int h, uint16_t *out);

#endif
