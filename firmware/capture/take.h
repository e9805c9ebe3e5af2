/* take.h - one capture of a rig: the frames that were kept, as the devices gave them, with all that
 * is known about each. Passed from session to store by pointer. */
#ifndef CAPTURE_TAKE_H
#define CAPTURE_TAKE_H

#include "drivers/device/clocks.h"
#include "firmware/capture/bracket.h"

#include "core/photo/develop.h"
#include "core/photo/meter.h"

enum {
    TAKE_FRAMES_MAX = BRACKET_CAMERAS_MAX * BRACKET_EXPOSURES_MAX,
    TAKE_TEXT = 256,
    TAKE_ID_CAP = 32
};

struct take_frame {
    int camera, index; // of the plan
    uint8_t *data;     // as the driver gave it
    size_t bytes;
    struct bracket_evidence evidence;
    struct clocks start; // of its exposure
    bool gains_known;    // as in struct frame
    double digital_gain, red_gain, blue_gain;
    bool lens_known;
    double lens;
};

struct take_camera {
    char uri[TAKE_TEXT];
    struct camera_info info;
    bool has_crf;
    struct crf crf;
    struct flicker_light light; // as far as it was measured
};

enum take_status { TAKE_COMPLETE, TAKE_ABORTED };

struct take {
    int n_cameras, n; // frames
    struct take_camera camera[BRACKET_CAMERAS_MAX];
    struct take_frame frame[TAKE_FRAMES_MAX]; // by camera, then index
    enum take_status status;
    char reason[TAKE_TEXT]; // why it was aborted; else warnings (coverage, unverified), or ""
    struct clocks trigger;
    bool clock_synced; // CLOCK_REALTIME by adjtimex
    bool stagger, metered;
    struct meter_result meter[BRACKET_CAMERAS_MAX]; // if metered
    double tolerance;                               // stops, the worst of the cameras
    double skew_s;                                  // largest between exposures of the same index
    int frames_used, rejected;
    bool is_place;             // of a session, which becomes one scene (places.h)
    char session[TAKE_ID_CAP]; // of a place: id of the session's first take, "" if this is it
    struct develop balance;    // of the session's display pictures; zeroed: measured
};

/* The exposure that is recorded for a frame, and as time x gain, s. */
const struct exposure *take_exposure(const struct take_frame *f);
double take_exposure_s(const struct take_frame *f);

/* Most time between the starts of the same exposure by two cameras, s. */
double take_skew_s(const struct take *t);

/* The first camera whose frames report more than one position of its lens, or -1. Less than
 * TAKE_LENS_STEP, in 1/m or the device's units, does not count: it changes the size of pictures by
 * 1/4000 behind a lens of 5 mm, half a pixel at the edge of 4000, and whole units are steps. */
#define TAKE_LENS_STEP 0.05
int take_lens_moved(const struct take *t);

/* Whether the exposure of some frame could not be proven by its pixels. */
bool take_unverified(const struct take *t);

/* Word of a format: "mjpg", "rggb10p"; NULL if there is no such format. */
const char *take_format(enum camera_format f);

void take_free(struct take *t); // frames too; accepts NULL

#endif
