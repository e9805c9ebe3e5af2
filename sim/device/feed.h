/* feed.h - the common part of simulated cameras: clock, control timing, buffers, faults, truth. A
 * backend adds the pixels.
 * The state of a backend begins with struct feed; feed_fd, feed_request, feed_shift, feed_next,
 * feed_release, feed_info and feed_own_now are entries of its camera_ops.
 * Clocks. Real: frames end by CLOCK_MONOTONIC; those without a free buffer are lost and leave a
 * gap in the sequence. Virtual: time passes only in feed_next, which
 * goes to the end of the running frame when no frame is queued; a frame of 1 s takes no time. The
 * file descriptor is then always readable. All cameras of a rig have the same kind of clock.
 * thread: as camera.h. */
#ifndef DEVICE_FEED_H
#define DEVICE_FEED_H

#include "drivers/device/camera.h"

#include "drivers/device/uri.h"
#include "sim/device/fault.h"
#include "sim/device/timing.h"

#include <stdio.h>

enum feed_readback { FEED_HONEST, FEED_CACHED, FEED_LAGGED };
enum feed_metadata { FEED_CORRECT, FEED_ABSENT, FEED_LATE };

/* Options that the URI of every simulated camera may have; feed_keys documents them. */
struct feed_options {
    double fps, step_us, longest_us, gain_max, first_us, skew_us, drift_ppm, wobble_us;
    int64_t delay, gain_delay, jitter, claim, startup;
    int length, readback, metadata, virtual, stamp, grid, shift;
    char faults[URI_TEXT], truth[URI_TEXT], node[URI_TEXT];
};

/* The sensor's keys come last; a backend without a sensor takes the first feed_n_common. */
extern const struct uri_key feed_keys[];
extern const int feed_n_keys, feed_n_common;
extern const struct feed_options feed_defaults;

/* A frame whose pixels are wanted. */
struct feed_shot {
    struct exposure exposure; // true
    double start_s;           // since open
    int64_t number;           // number of the frame
    double red, blue;         // digital gain beyond the white balance
    double digital;
    int pick; // result of snap
};

/* Where pictures come from. */
struct feed_source {
    void *ctx;
    int w, h, bytes_per_px, bits, black;
    enum camera_format format;
    double time_min_s; // 0: the step of exposure times
    double line_s;     // time of a row; 0: not known
    char unit[CAMERA_UNIT_CAP];
    /* Fill px (stride w * bytes_per_px). May fail only for lack of memory. */
    MUST_USE err_t (*expose)(void *ctx, const struct feed_shot *shot, uint8_t *px);
    /* Replace *e by the nearest exposure that the source has; the result becomes `pick` of the
     * shot. NULL: the source has every exposure. `request`: *e is requested, else a frame ends. */
    int (*snap)(void *ctx, struct exposure *e, bool request);
};

/* True values of a delivered frame. */
struct feed_truth {
    int64_t number;           // number of the sensor's frame that gave the pixels
    struct exposure exposure; // with digital gain and drift in `gain`
    double torn;              // share of its rows that visibly have another exposure
    int64_t start_ns;         // when its exposure began
};

struct feed_item {                 // a queued frame
    struct feed_shot shot, former; // former: of the frame before
    double torn;                   // share of its rows that are of `former`: < 0 at the bottom
    struct exposure reported;
    int64_t due_ns, stamp_ns;
    uint32_t sequence;
    bool error, eio, index, half;
    size_t missing, noise; // bytes
};

struct feed_slot { // a buffer
    uint8_t *px;
    bool held;
    struct feed_truth truth;
};

/* Faults that last; counts are in frames or requests, -1 means for ever. */
struct feed_effects {
    int64_t drop, ignore, refuse_left, rollover;
    enum fault_verb refuse;
    bool drop_hidden, stalled, stuck, half, stamp_zero, stamp_real;
    double loss, tear, quantum_s, gain, gain_step, balance, balance_step, digital;
    int64_t stamp_add_ns;
    uint32_t sequence_add;
};

struct feed { // private
    struct feed_options opt;
    struct feed_source source;
    struct timing timing;
    struct fault_script script;
    bool fired[FAULT_MAX];
    struct feed_effects fx;
    int fd, n_slots, n_items, n_held, n_leaked;
    struct feed_item item[CAMERA_BUFFERS_MAX]; // in order
    struct feed_slot slot[CAMERA_BUFFERS_MAX];
    uint8_t *former;           // picture that torn rows are copied from; NULL without `tear`
    int64_t base_ns, clock_ns; // CLOCK_MONOTONIC at open; the virtual clock
    uint32_t sequence;         // sequence of the last frame
    struct exposure last_true, last_programmed, last_set;
    struct feed_shot last_shot;
    bool lost, has_fd;
    FILE *truth;
};

/* Check options and acquire everything that can fail.
 * own:  feed_close, also after an error.
 * err:  ERR_ARG, ERR_LOST, ERR_FORMAT, ERR_IO, ERR_UNSUPPORTED, ERR_NOMEM */
MUST_USE err_t feed_open(struct feed *f, const struct camera_cfg *cfg,
                         const struct feed_options *opt, const struct feed_source *source);
void feed_start(struct feed *f); // frame 0 begins now
void feed_close(struct feed *f); // accepts a zeroed one

void feed_info(const void *st, struct camera_info *out);
int feed_fd(const void *st);
MUST_USE err_t feed_request(void *st, const struct exposure *requested, struct exposure *set);
MUST_USE err_t feed_shift(void *st, double seconds, double *shift);
MUST_USE err_t feed_next(void *st, struct frame *out);
void feed_release(void *st, struct frame *f);

/* Time of the camera's clock, ns. */
int64_t feed_now(const void *st);

/* The same if the clock is virtual, else 0: an entry of camera_ops. */
int64_t feed_own_now(const void *st);

/* True values of a frame that is held. */
struct feed_truth feed_truth(const void *st, const struct frame *f);

#endif
