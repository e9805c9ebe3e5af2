/* dotsplat.h - Gaussians of a .splat file (github.com/antimatter15/splat): 32 bytes a splat and
 * nothing else, little-endian:
 *    0  f32  x, y, z
 *   12  f32  length of the three axes (sigma)
 *   24  u8   red, green, blue: 255 times the display colour; 255 times the opacity
 *   28  u8   rotation w, x, y, z: 128 + 128 times the quaternion's
 * Axes are those of .ply files. What is brighter than white was cut off by whoever wrote it.
 * thread: any. */
#ifndef FORMAT_DOTSPLAT_H
#define FORMAT_DOTSPLAT_H

#include "drivers/format/splats.h"

/* err:  ERR_FORMAT (a size that 32 does not divide, or more than GAUSSIANS_MAX splats), ERR_NOMEM.
 */
extern const struct splats_format dotsplat_format;

#endif
