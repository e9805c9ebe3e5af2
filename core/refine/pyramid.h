/* pyramid.h - photographs at half the size.
 * Pure functions; any thread. */
#ifndef REFINE_PYRAMID_H
#define REFINE_PYRAMID_H

#include <stdint.h>

/* Means of four pixels each. in: planes (3, h, w); out: (3, h / 2, w / 2), not in. */
void pyramid_halve(const uint8_t *in, int w, int h, uint8_t *out);
void pyramid_halve_deep(const uint16_t *in, int w, int h, uint16_t *out);

#endif
