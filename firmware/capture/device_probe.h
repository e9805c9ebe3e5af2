/* device_probe.h - one camera, request by request and frame by frame, as its pixels show it: what
 * measurements of the device itself are made with. Nothing that the device says is believed; ages
 * of requests are counted as the bracket machine does (firmware/capture/label.h).
 * thread: one. Calls block until a frame comes, time is up or engine_cancel is set. */
#ifndef CAPTURE_DEVICE_PROBE_H
#define CAPTURE_DEVICE_PROBE_H

#include "firmware/base/progress.h"
#include "firmware/capture/label.h"

/* Statistics of all frames since open. */
struct device_probe_count {
    int frames;
    int lost;                           // by the sequence
    int hidden;                         // by the time stamps, and the sequence does not tell
    int repeated, backward;             // sequence
    int flagged;                        // as bad or short, by the device
    int unreadable, failed;             // by unpacking; ERR_IO
    int requests, refused, misread;     // misread: not rounded down to a step
    int unstamped, stamps_back;         // 0 or less; not later than the one before
    int stamps_wall, jumps;             // stamps of CLOCK_REALTIME; jumps too large for lost frames
    double stamp_early_s, stamp_late_s; // arrival less stamp, the least and the most; of the others
    double gain_off, balance_off;       // most that digital gain is off 1, and balance moves
    bool gains_known;
};

struct device_probe {
    const char *uri; // not owned
    const struct camera_ops *ops;
    void *st;
    struct camera_info info;
    bool linear, has_crf;
    struct crf crf; // response of display values; has_crf false: sRGB is assumed
    struct label label;
    struct raw sample;
    struct device_probe_count count;
    double red, blue;          // gains of the first frame
    struct progress *progress; // or NULL
};

/* A frame. */
struct device_probe_frame {
    bool usable; // else only ages and stamps hold
    struct exposure_probe seen;
    int age_lo, age_hi; // frames since the one that ran during the last request
    bool exposure_known;
    struct exposure exposure; // as the device says
    uint32_t sequence;
    int64_t stamp_ns, arrival_ns;
};

/* own:  device_probe_close.
 * err:  those of camera_ops.open and backends_camera, with the URI; ERR_UNSUPPORTED (size),
 *       ERR_NOMEM */
MUST_USE err_t device_probe_open(const struct camera_cfg *cfg, struct device_probe **out);
void device_probe_close(struct device_probe *w); // accepts NULL

/* Ask for an exposure at gain 1; `index` names it for device_probe_in_force.
 * err:  those of camera_ops.request, with the time; ERR_BUSY only after several frames. */
MUST_USE err_t device_probe_ask(struct device_probe *w, double time_s, int index);

/* Exposure that the last request should give, s. */
double device_probe_expected(const struct device_probe *w);

/* The next frame; pixels are only looked at if `look`.
 * err:  ERR_TIMEOUT (none for 3 of the longest and 1 s), ERR_LOST, ERR_CANCELLED */
MUST_USE err_t device_probe_next(struct device_probe *w, bool look, struct device_probe_frame *out);

/* The first usable frame that is so many frames older than the last request.
 * err:  as device_probe_next; ERR_FORMAT (100 unusable frames in a row) */
MUST_USE err_t device_probe_rest(struct device_probe *w, int frames,
                                 struct device_probe_frame *out);

/* ERR_FORMAT: n frames in a row, and why. */
MUST_USE err_t device_probe_unusable(const struct device_probe *w, int n);

/* As device_probe_rest, all of the picture as 8-bit R,G,B; only for display values. */
MUST_USE err_t device_probe_picture(struct device_probe *w, int frames, uint8_t *rgb);

/* Frames that wait are counted; afterwards the next one was exposed after now, or nearly so. */
MUST_USE err_t device_probe_drain(struct device_probe *w);

/* Nobody looked for some time: what was lost meanwhile is not the camera's doing. */
MUST_USE err_t device_probe_resume(struct device_probe *w);

/* Index of the request that the frame that came last was exposed with, if the delay is `delay`; -1:
 * not known. */
int device_probe_in_force(const struct device_probe *w, int delay);

/* Progress of a stage. */
void device_probe_tell(struct device_probe *w, const char *stage, int done, int total);

#endif
