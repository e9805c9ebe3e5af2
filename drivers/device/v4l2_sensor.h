/* v4l2_sensor.h - facts about image sensors that their drivers do not report: delays of settings,
 * gain of a code, black level. Pure.
 * thread: any. */
#ifndef DEVICE_V4L2_SENSOR_H
#define DEVICE_V4L2_SENSOR_H

#include <stdint.h>

struct v4l2_sensor {
    const char *name;
    int exposure_delay, gain_delay; // frames; -1 not known
    int margin;                     // lines that a frame is longer than its longest exposure
    int m0, c0, m1, c1;             // gain (m0 c + c0) / (m1 c + c1) of code c; all 0: see db
    double db;                      // per code; 0 too: not known
    int black;                      // level, of 65536; -1 not known
};

/* The sensor in a driver's name such as "imx219 10-0010" or "m00_b_imx415 4-001a"; an entry without
 * facts if the table has none of that name. Never NULL. */
const struct v4l2_sensor *v4l2_sensor_find(const char *name);

/* Gain factor of a code; 0 if that is not known, or the code is out of the formula's range. */
double v4l2_sensor_gain(const struct v4l2_sensor *s, int64_t code);

/* The largest code in lo..hi whose factor is at most `gain`; lo if there is none. */
int64_t v4l2_sensor_code(const struct v4l2_sensor *s, double gain, int64_t lo, int64_t hi);

#endif
