/* calib.h - what was measured about a device, by `hdrig calibrate`: one small file per device, size
 * and format in a folder, "key = value" as everywhere.
 * thread: any. */
#ifndef FIRMWARE_CALIB_H
#define FIRMWARE_CALIB_H

#include "firmware/bracket.h"

struct calib {
    int delay_lo, delay_hi;        // frames
    double time_min_s, time_max_s; // range in which exposure obeys
    bool has_crf;
    struct crf crf;
    double tolerance; // stops
    int64_t when_s;   // CLOCK_REALTIME
};

/* Values of the device's own promise where there is no file.
 * out:  *found tells whether there was one.
 * err:  ERR_FORMAT (file, line), ERR_IO. */
MUST_USE err_t calib_load(const char *dir, const struct camera_info *info, struct calib *out,
                          bool *found);

/* Replaces the file atomically. err: ERR_IO, ERR_ARG (path too long) */
MUST_USE err_t calib_save(const char *dir, const struct camera_info *info, const struct calib *c);

/* Both together: what the bracket machine is told. c NULL: no calibration. */
void calib_camera(const struct camera_info *info, const struct calib *c,
                  struct bracket_camera *out);

#endif
