/* spzwrite.h - Gaussians into an SPZ file (spz.h has the format).
 * thread: any. */
#ifndef FORMAT_SPZWRITE_H
#define FORMAT_SPZWRITE_H

#include "core/base/types.h"

enum { SPZWRITE_VERSION = 3 }; // what viewers know

/* Write the splats of s as version 3 or 4, with their radiance. Rooms took 11 to 12 bytes a splat
 * at degree 0 and kept 44 dB at the middle exposure; version 4 takes 8 % less.
 * err:  ERR_ARG (version; a value is not finite or a quaternion has no length: splat and plane
 *       named), ERR_IO, ERR_LIMIT (no space), ERR_NOMEM. The partial file is removed. */
MUST_USE err_t spzwrite_scene(const char *path, const struct scene *s, int version);

#endif
