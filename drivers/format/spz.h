/* spz.h - Gaussians as an SPZ file (github.com/nianticlabs/spz): 8 bits a number, and radiance
 * beside the display colours.
 *
 * Versions 2 to 4 are read. 3 (gzip) is what is written unless 4 (zstd) is asked for: viewers know
 * it. Both carry the radiance in a record where those of extensions are, but without the flag that
 * announces these: other readers take no notice of it, where the reference warns of one that it
 * does not know. They see the display colours of display.h at display_ev of the tone curve, up to
 * degree 3.
 *
 * Record 0x48440001, "hdrig radiance", little-endian:
 *    0  u8   version, 1
 *    1  u8   D: degree of the harmonics, 0 to 4; K = (D+1)^2 per colour
 *    2  u8   steps: how fine, per natural logarithm of radiance
 *    3  u8   0: what follows is plain; 1: one zstd frame
 *    4  f32  ev: the display colours are sRGB of 2^ev radiance
 *    8  f32  unit: lengths in the file = unit times lengths in the scene
 *   12  3K pairs of arrays, pair 3k + colour: u8 low[N], then i8 high[N]
 * and r = low - 128 + 256 high. Harmonic k > 0 of the logarithm of radiance is r / steps. Harmonic
 * 0 is (r / steps + ln(max(S(c), 1e-4)) - ev ln 2) / Y0: the record only corrects what the colour
 * c = 0.5 + Y0 (byte / 255 - 0.5) / 0.15 already tells; S is sRGB to linear, Y0 is SH_BASIS0.
 *
 * Scenes are brought to lengths that SPZ can hold: ln sigma is -10 to 5.9375 there.
 * thread: any. */
#ifndef FORMAT_SPZ_H
#define FORMAT_SPZ_H

#include "drivers/format/splats.h"

/* The arrays of a file in their order. */
enum {
    SPZ_POSITIONS,
    SPZ_OPACITIES,
    SPZ_COLOURS,
    SPZ_SCALES,
    SPZ_ROTATIONS,
    SPZ_HARMONICS,
    SPZ_ARRAYS
};

/* Numbers of the format. */
enum {
    SPZ_MAGIC = 0x5053474e,
    SPZ_HEADER_3 = 16, // bytes
    SPZ_HEADER_4 = 32,
    SPZ_TOC_ENTRY = 16,
    SPZ_HAS_RECORDS = 2, // a bit of its flags
    SPZ_POSITION_MAX = (1 << 23) - 1,
    SPZ_MAGNITUDE_MAX = 511, // largest component of a quaternion
    SPZ_RADIANCE = 0x48440001,
    SPZ_RADIANCE_VERSION = 1,
    SPZ_RADIANCE_HEAD = 12, // bytes
    SPZ_UNIT_LOG2_MAX = 64, // either sign
    SPZ_BATCH = 256,        // splats that are packed and unpacked at once
    SPZ_WIDTH_MAX = 3 * (SH_COEFS_MAX - 1)
};
#define SPZ_LOG_SCALE_MIN -10.0
#define SPZ_LOG_SCALE_MAX 5.9375
#define SPZ_LOG_SCALE_STEP 0.0625
#define SPZ_COLOUR_SCALE 0.15
#define SPZ_HEADROOM 1.21f // stops above white: the linear light of 0.5 + Y0 0.5 / SPZ_COLOUR_SCALE

/* Bytes of a splat in each array; degree: of the display colours. */
void spz_widths(int version, int degree, size_t out[SPZ_ARRAYS]);

/* Natural logarithm of the radiance that the byte of a colour tells. */
double spz_log(int byte, float ev);

/* Reads versions 2 to 4. Radiance and ev are in the record; band 4 of display colours is left out.
 * err:  ERR_FORMAT (the part is named), ERR_UNSUPPORTED (version, axes that are turned),
 *       ERR_NOMEM. */
extern const struct splats_format spz_format;

#endif
