/* sog.h - Gaussians in PlayCanvas' SOG, versions 1 and 2: numbers of 8 bits in WebP pictures that a
 * meta.json names. All lie in one zip archive, NAME.sog, or beside each other in a folder.
 *   version 2: {"version": 2, "count": N,
 *     "means": {"mins": [3], "maxs": [3], "files": [low, high]},
 *     "scales": {"codebook": [256], "files": [1]}, "quats": {"files": [1]},
 *     "sh0": {"codebook": [256], "files": [1]},
 *     "shN": {"codebook": [256], "files": [centroids, labels]}}           shN may be missing
 *   version 1: no "version", N is "means"."shape"[0]; instead of codebooks "mins" and "maxs" of
 *     each channel ([3], [4] with the logit of opacity, and of shN one number each)
 * Splat i is the pixel i of each picture, row by row, but of the centroids. A byte b stands for
 * codebook[b], or for mins + (maxs - mins) b / 255.
 *   means      v = low + 256 high; u = mins + (maxs - mins) v / 65535; x = sign(u) (e^|u| - 1)
 *   scales     natural logarithm of the three axes
 *   quats      A - 252: the largest of w, x, y, z; R, G, B: the others in that order, of which a
 *              byte b stands for (2 b / 255 - 1) / sqrt(2); another A: not turned
 *   sh0        R, G, B: display harmonic 0; A: opacity times 255
 *   labels     l = R + 256 G: the harmonics above are those of centroid l
 *   centroids  64 of K pixels in a row, red, green and blue of a harmonic each; K = 3, 8, 15 for
 *              degree 1 to 3
 * Axes are those of .ply files. What else meta.json tells (model, antialiasing) is not read.
 * Sources: "The SOG format" of developer.playcanvas.com; read-sog.ts, read-sog-v1.ts and
 * write-sog.ts of splat-transform 3.2.
 * thread: any. */
#ifndef FORMAT_SOG_H
#define FORMAT_SOG_H

#include "drivers/format/splats.h"

#define SOG_META "meta.json"

/* The bytes are those of the archive or of meta.json, whose pictures are looked for beside it.
 * err:  ERR_FORMAT (numbers that meta.json lacks or that are not finite; more than GAUSSIANS_MAX
 *       splats; names that lead elsewhere; pictures that are missing, damaged, too small for the
 *       splats, or more than four times as large and 65,536 px more; width of the centroids; a
 *       label above them), ERR_UNSUPPORTED (version), ERR_IO, ERR_NOMEM. */
extern const struct splats_format sog_format;

#endif
