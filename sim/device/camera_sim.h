/* camera_sim.h - the camera `sim:KEY=VALUE,...`: photographs a procedural world. The same URI gives
 * the same frames; opening renders the view, which takes a second or so.
 *
 *   at=FILE                                          file with one line, the number of the view:
 *                                                    the camera moves when it changes
 *   seed=N kind=any|room|yard|dark|plain|mirror|park the world
 *   views=N view=I spread=X fov=DEG freehand=no|yes  one of the rig's N places, I from 0
 *   size=PX samples=N shadow=N                       square pictures; quality of the rendering
 *   format=rgb|rggb|bggr                             developed, or the mosaic's 12 bits
 *   curve=srgb|gamma|filmic|agx|log|random|linear param=X
 *   full=US                                          exposure at which radiance 1 saturates
 *   well=E                                           electrons at saturation (10000): noise
 *   flicker=X hz=X line=US                           of the light; us per row, rolling shutter
 *   moving=SHARE                                     of the picture that somebody covers, each
 *                                                    frame elsewhere (sim/world/passer.h)
 *
 * and the keys of sim/device/feed.c: clock, timing, metadata, faults (sim/device/fault.h), truth.
 * When frames start: skew=US of frame 0 after open, drift=PPM of the sensor's clock, wobble=US of
 * each frame; grid=start|end: what of its exposure comes once a frame; shift=yes lets
 * camera_ops.shift lengthen one, by whole rows if `line` is given, else by whole us.
 * In a program, feed_truth and feed_now of sim/device/feed.h work with the state. */
#ifndef DEVICE_CAMERA_SIM_H
#define DEVICE_CAMERA_SIM_H

#include "sim/device/feed.h"

/* extern const struct camera_ops camera_sim; is in drivers/device/camera.h. */

#endif
