/* calib.h - what was measured about a device, by `hdrig calibrate`: one small file per device, size
 * and format in a folder, "key = value" as everywhere.
 * thread: any. */
#ifndef CAPTURE_CALIB_H
#define CAPTURE_CALIB_H

#include "firmware/capture/bracket.h"

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
 * err:  ERR_FORMAT (file, line), ERR_IO, ERR_ARG (path too long). On error as if there were none.
 */
MUST_USE err_t calib_load(const char *dir, const struct camera_info *info, struct calib *out,
                          bool *found);

/* As calib_load, from n bytes of text; `what` begins the sentence. */
MUST_USE err_t calib_parse(const char *what, const char *text, size_t n,
                           const struct camera_info *info, struct calib *out);

/* Refuse before the measurement a folder that calib_save could not write to.
 * err:  ERR_IO. */
MUST_USE err_t calib_check_place(const char *dir);

/* Replaces the file atomically; an assumed curve is not written.
 * err:  ERR_IO, ERR_LIMIT (no space), ERR_ARG (path too long, values that calib_load would refuse)
 */
MUST_USE err_t calib_save(const char *dir, const struct camera_info *info, const struct calib *c);

/* Both together: what the bracket machine is told. c NULL: no calibration. The calibrated range of
 * exposures holds within that of the device; its tolerance and delay replace the promise. */
void calib_camera(const struct camera_info *info, const struct calib *c,
                  struct bracket_camera *out);

#endif
