/* ksplat.h - Gaussians of a .ksplat file (github.com/mkkellogg/GaussianSplats3D), version 0.1 and
 * up to below 1; little-endian:
 *   4096 bytes   0 u8 0, u8 version   4 u32 S: headers of sections   16 u32 N: splats
 *               20 u16 level   36 f32 least, most: range of harmonics at level 2, 0: -1.5, 1.5
 *   S x 1024     0 u32 n   4 u32 room for splats   8 u32 splats of a bucket   12 u32 B: buckets
 *               16 f32 edge of a block   20 u16 bytes of a bucket   24 u32 R: range, 0: 32767
 *               32 u32 full buckets   36 u32 P: buckets that are not full   40 u16 degree 0..3
 * then for each section P u32 (splats of each bucket that is not full), B buckets (f32 x, y, z),
 * and its splats, n of which count:
 *   level       0         1, 2
 *   position    3 f32     3 u16: bucket + (v - R) edge / 2 / R; buckets take turns, full ones first
 *   scales      3 f32     3 half floats, linear
 *   rotation    4 f32     4 half floats, w, x, y, z
 *   colour      4 u8      4 u8: display colour and opacity
 *   harmonics   f32       1: half float, 2: u8; band by band, all of red, green, blue
 * Axes are those of .ply files. What is brighter than white was cut off by whoever wrote it.
 * thread: any. */
#ifndef FORMAT_KSPLAT_H
#define FORMAT_KSPLAT_H

#include "drivers/format/splats.h"

/* err:  ERR_FORMAT (sections that leave the file; more splats than there is room for, or than their
 *       buckets hold; counts that contradict each other; degree), ERR_UNSUPPORTED (version, level),
 *       ERR_NOMEM. */
extern const struct splats_format ksplat_format;

#endif
