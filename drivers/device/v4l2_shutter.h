/* v4l2_shutter.h - exposure and gain of a V4L2 device in seconds and factors; automatic
 * modes are switched off.
 * thread: as camera.h. */
#ifndef DEVICE_V4L2_SHUTTER_H
#define DEVICE_V4L2_SHUTTER_H

#include "drivers/device/camera.h"
#include "drivers/device/v4l2_format.h"
#include "drivers/device/v4l2_sensor.h"

enum v4l2_shutter_kind {
    V4L2_SHUTTER_FIXED, // no exposure control whose unit is known
    V4L2_SHUTTER_TICKS, // EXPOSURE_ABSOLUTE: 100 us, within the frame interval
    V4L2_SHUTTER_LINES  // EXPOSURE: lines of the sensor, within a frame that VBLANK stretches
};

struct v4l2_shutter {
    struct v4l2_node node; // that has the controls; not owned
    const struct v4l2_sensor *sensor;
    enum v4l2_shutter_kind kind;
    double unit_s;             // one exposure code: 100 us, or the time of a line
    int64_t least, most, step; // exposure codes
    int64_t vblank, vblank_base, vblank_lo, vblank_hi, vblank_step; // lo == hi: cannot be changed
    bool shifted;             // one frame is longer: with the next one back to
    int64_t vblank_usual;     // this
    int64_t gain_lo, gain_hi; // codes; lo == hi: cannot be changed, or the factor is not known
    int64_t code, gain;       // in force, as read back
    int h;                    // lines of the picture
    double period_s;          // between frames; for TICKS and FIXED as given to open
};

/* Automatic exposure, gain, white balance and focus off; controls that shape the response to
 * default. Missing controls are skipped.
 * err:  ERR_UNSUPPORTED (an automatic mode stays on: names it), ERR_LOST, ERR_IO */
MUST_USE err_t v4l2_shutter_freeze(const struct v4l2_node *n);

/* Find the controls and set a first exposure. Before the stream starts, after v4l2_shutter_freeze.
 * longest_s: exposures up to this are to fit into frames of the usual length. period_s: as
 * v4l2_format_pace.
 * err:  ERR_UNSUPPORTED (values that make no sense), ERR_BUSY, ERR_LOST, ERR_IO */
MUST_USE err_t v4l2_shutter_open(struct v4l2_shutter *c, const struct v4l2_layout *l,
                                 double longest_s, double period_s);

/* See camera_ops.shift. With the next frame that arrives, v4l2_shutter_shifted makes frames as long
 * as before: both writes go to the sensor one frame apart, and so take effect.
 * err:  as camera_ops.shift; of v4l2_shutter_shifted those that set a control */
MUST_USE err_t v4l2_shutter_shift(struct v4l2_shutter *c, double seconds, double *shift);
MUST_USE err_t v4l2_shutter_shifted(struct v4l2_shutter *c);

/* See camera_ops.request, camera_info. */
MUST_USE err_t v4l2_shutter_request(struct v4l2_shutter *c, const struct exposure *requested,
                                    struct exposure *set);
void v4l2_shutter_info(const struct v4l2_shutter *c, struct camera_info *out);

#endif
