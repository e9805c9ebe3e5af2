/* rawframe.h - numbers of a sensor in a file, as the driver of a camera gave them.
 * thread: any. */
#ifndef FORMAT_RAWFRAME_H
#define FORMAT_RAWFRAME_H

#include "core/base/types.h"
#include "core/photo/develop.h"
#include "drivers/device/camera.h"
#include "drivers/format/file.h"

struct rawframe {
    char path[FILE_PATH_CAP];
    struct camera_info info; // format, w, h, stride, bits and black count
    struct develop how;      // white balance
};

/* Whether its file holds linear numbers of that format, by the size of the file.
 * err:  ERR_IO (no such file), ERR_FORMAT (too short; size, bits or black level out of range; no
 *       linear format). */
MUST_USE err_t rawframe_check(const struct rawframe *f);

/* Black level off, white balance, demosaiced, through the curve of sRGB in 16 bits; the value 1 is
 * where the sensor is full.
 * own:  pixels_free16.
 * err:  those of rawframe_check; ERR_FORMAT (numbers above its bits; nearly all of them below the
 *       black level), ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t rawframe_read(const struct rawframe *f, struct image16 *out);

/* The same of unpacked numbers; `name` begins the sentence.
 * own:  free(out->px).
 * err:  ERR_FORMAT (nearly all below the black level), ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t rawframe_develop(const char *name, const struct raw *raw, const struct develop *how,
                                struct image16 *out);

#endif
