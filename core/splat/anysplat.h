/* anysplat.h - a network without tone curve gives display colours (AnySplat): they become radiance
 * under a curve that shows them as they are. Pure computation; thread: any. */
#ifndef SPLAT_ANYSPLAT_H
#define SPLAT_ANYSPLAT_H

#include "core/base/types.h"

/* Display colours minus 0.5, become log radiance for the curve of
 * anysplat_curve: exactly for the mean over all directions, to first order for the bands
 * above. What would be darker than 1/512 is that, without bands. */
void anysplat_radiance(struct gaussians *g);

/* A curve that shows radiance as it is, 0..1, within 1/1000, at the middle exposure. */
void anysplat_curve(float mid_log2t, struct tonemap *out);

#endif
