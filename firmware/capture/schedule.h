/* schedule.h - which exposures a camera is asked for.
 * Pure; any thread. */
#ifndef CAPTURE_SCHEDULE_H
#define CAPTURE_SCHEDULE_H

#include "firmware/base/config.h"
#include "firmware/capture/frame_buffer.h"
#include "firmware/capture/take.h"

enum session_mode {
    SESSION_AUTO, // metered
    SESSION_LIST, // the given stops around the middle exposure
    SESSION_METER // metered as AUTO, but nothing is kept: the take has only its `meter`
};

struct session_order {
    enum session_mode mode;
    int n;
    double ev[BRACKET_EXPOSURES_MAX]; // for LIST: stops, any order
    double middle_s;                  // for LIST: exposure at EV 0; 0: metered
    bool stagger;  // one exposure per camera, in turn; every camera's turn moves on with each take
    int turn;      // for stagger: exposure of the first camera, from 0, round and round; -1: whose
                   // turn it is. Not for METER
    bool verify;   // for AUTO: check the coverage and extend once
    double snr;    // for AUTO, as a ratio; 0: default
    double skew_s; // larger spoils the take; 0: any
    bool refocus; // cameras with focus=once search anew; else only what has not since it was opened
    int64_t trigger_ns; // CLOCK_MONOTONIC
    int64_t start_ns;   // when the first exposure of a LIST with a known middle is to begin, by the
                        // cameras' clock (backends_now); 0, or past: at once
};

/* The order for a press, by settings that config_check_rig has read. */
void schedule_order(const struct config *c, int64_t press_ns, struct session_order *o);

/* Whether probes are needed: for the exposures, or for the middle one of a list. */
bool schedule_is_metered(const struct session_order *o);

/* The most frames that a take of that order keeps of one camera. */
int schedule_frames(const struct session_order *o);

/* The plan for a probe, which is its last exposure, from a reference at base_s: links between them,
 * if they are so far apart that pixels could not tell one from the other. Time 0: no plan. */
void schedule_probe(double time_s, double base_s, const struct camera_info *info,
                    struct bracket_plan *out);

/* Why the device cannot follow the order as it is; NULL: it can. */
const char *schedule_limit(const struct session_order *o, const struct camera_info *info,
                           const struct meter_result *r);

/* The plan of one camera. In an automatic bracket, probes that serve as exposures are marked as
 * used and not asked for again. In stagger mode the camera takes one exposure, number `turn` of
 * those of a full bracket, round and round; probes do not count then.
 * r: what the meter says, if it was asked. */
void schedule_shots(const struct session_order *o, int turn, const struct camera_info *info,
                    const struct meter_result *r, struct frame_buffer *roll,
                    struct bracket_plan *out);

/* Exposures that hold whole periods of a light that flickers, if they are near: at most a quarter
 * stop from what a list asks for, half a stop from what was metered. */
void schedule_steady(const struct session_order *o, const struct take_camera *c,
                     struct bracket_plan *io);

#endif
