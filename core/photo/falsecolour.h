/* falsecolour.h - radiance as false colours: turbo over log2 of the luminance.
 * Pure functions. thread: any. */
#ifndef PHOTO_FALSECOLOUR_H
#define PHOTO_FALSECOLOUR_H

#include "core/base/types.h"

enum { FALSECOLOUR_STOPS = 8, FALSECOLOUR_LEGEND_W = 40, FALSECOLOUR_LEGEND_H = 288 };

/* Stops of linear R,G,B above the luminance 1, Rec. 709 weights; -infinity at or below 0. */
float falsecolour_stops(const float rgb[3]);

/* The colour of a luminance in stops: dark blue at -FALSECOLOUR_STOPS, green at 0, dark red at
 * +FALSECOLOUR_STOPS; below it black, above it white, NaN magenta. */
void falsecolour_of(float stops, uint8_t rgb[3]);

/* Colours of radiance x 2^log2t.
 * out:  of the shape of `radiance`. */
void falsecolour_run(const struct image *radiance, float log2t, const struct image8 *out);

/* Legend: from top to bottom the colours of +9..-9 stops with numbers beside them.
 * out:  any size; FALSECOLOUR_LEGEND_W x FALSECOLOUR_LEGEND_H px are legible. */
void falsecolour_legend(const struct image8 *out);

#endif
