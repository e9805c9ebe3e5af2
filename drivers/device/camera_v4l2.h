/* camera_v4l2.h - the camera `v4l2:NODE[,subdev=NODE][,longest_ms=X][,focus=X][,lens=NODE]`: a
 * capture node of Linux.
 *
 *   NODE        /dev/v4l/by-path/...-video-index0, which stays the same when the camera comes back
 *   subdev      of the sensor that feeds it (/dev/v4l-subdevN), where that has the controls:
 *               Raspberry Pi up to 4 and others whose sensor leads straight to memory
 *   longest_ms  exposures up to this fit into frames of the usual length (33; 0.1 .. 60000). USB
 *               cameras cannot expose longer than a frame, sensors stretch single frames
 *   focus       a position of the lens, in the device's units; or once: see camera_ops.focus
 *   lens        of the lens, where it is a sub-device of its own (v4l2-ctl -L shows focus_absolute)
 *
 * open switches automatic modes off and puts the controls that shape the response to their
 * defaults. gain_max is 1 where the factors behind the codes are not known (USB cameras).
 * See drivers/device/camera.h. */
#ifndef DEVICE_CAMERA_V4L2_H
#define DEVICE_CAMERA_V4L2_H

#include "drivers/device/camera.h"
#include "drivers/device/v4l2_sys.h"

/* extern const struct camera_ops camera_v4l2; is in drivers/device/camera.h. */

/* camera_v4l2.open with other system calls, which must outlive the camera. */
MUST_USE err_t camera_v4l2_open_with(void *st, const struct camera_cfg *cfg,
                                     const struct v4l2_sys *sys);

#endif
