/* timing.h - when the frames of a free-running sensor begin, and with which exposure and gain.
 * A control written during frame n applies from frame n + delay on (+ 0..jitter, but never before
 * an earlier write). A frame that runs is not cut short. Frames follow each other without a gap.
 * The sensor's clock may run slow, and the starts of frames may wobble around its grid.
 * Pure; any thread. */
#ifndef DEVICE_TIMING_H
#define DEVICE_TIMING_H

#include <stdbool.h>
#include <stdint.h>

enum { TIMING_DELAY_MAX = 32, TIMING_PENDING = 2 * TIMING_DELAY_MAX + 2 };

enum timing_length {
    TIMING_STRETCH, // a frame lasts as long as its exposure, at least the period (VBLANK)
    TIMING_LIMIT,   // the period limits exposures (UVC)
    TIMING_FREE     // exposure and frame length are independent (pictures from a file)
};

struct timing_cfg {
    double period_s;               // > 0
    double step_s, longest_s;      // times are multiples of step_s, one at least; 0: any
    double gain_max;               // >= 1
    int delay, gain_delay, jitter; // frames; 1..TIMING_DELAY_MAX, 0..TIMING_DELAY_MAX
    enum timing_length length;
    double drift;    // share by which frames are longer than they should be
    double wobble_s; // frames start within +-wobble_s of the grid, 0..period_s / 4
    uint64_t seed;   // seed of jitter and wobble
};

/* A control and the writes that do not apply yet. */
struct timing_control {
    double value; // in force in the frame that runs
    int n;
    struct {
        int64_t from; // frame
        double value;
    } pending[TIMING_PENDING]; // `from` rises
};

struct timing_frame {
    int64_t number, start_ns, end_ns; // the next one starts at the end
    double time_s, gain;
};

struct timing {
    struct timing_cfg cfg;
    struct timing_control time, gain;
    struct timing_frame now;      // the frame that runs
    int64_t grid_ns;              // when the next one would start without wobble
    int64_t shift_from, shift_ns; // frame to lengthen, if shift_ns > 0
    uint64_t writes;
};

/* Frame 0 starts at start_ns with exposure time_s, limited like a written one. */
void timing_open(struct timing *t, const struct timing_cfg *cfg, int64_t start_ns, double time_s);

/* The value that the device sets when asked for this one: rounded down and limited. */
double timing_time(const struct timing_cfg *c, double time_s);
double timing_gain(const struct timing_cfg *c, double gain);

/* Write both controls during the frame that runs. */
void timing_write(struct timing *t, double time_s, double gain);

/* Lengthen the frame that a control written now applies to; false: one is still to be. */
bool timing_shift(struct timing *t, int64_t ns);

/* Finish the frame that runs and begin the next one.
 * out: the finished one. */
struct timing_frame timing_step(struct timing *t);

/* Delay the running frame: the sensor pauses for `ns` before it. */
void timing_stall(struct timing *t, int64_t ns);

#endif
