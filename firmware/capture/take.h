/* take.h - one capture of a rig: the kept frames as the devices gave them, with their evidence.
 * The session passes it to the store by pointer. */
#ifndef CAPTURE_TAKE_H
#define CAPTURE_TAKE_H

#include "drivers/device/clocks.h"
#include "firmware/capture/bracket.h"

#include "core/photo/develop.h"
#include "core/photo/ghost_mask.h"
#include "core/photo/meter.h"

enum {
    TAKE_FRAMES_MAX = BRACKET_CAMERAS_MAX * BRACKET_EXPOSURES_MAX,
    TAKE_TEXT = 256,
    TAKE_ID_CAP = 32,
    TAKE_MEMBER_CAP = 32
};

struct take_frame {
    int camera, index; // index in the plan
    uint8_t *data;     // as the driver gave it
    size_t bytes;
    struct bracket_evidence evidence;
    struct clocks start; // when its exposure began
    int64_t common_ns;   // the same on the common clock of a rig of boards, within
    int64_t within_ns;   // this; only if take.rig is set
    bool gains_known;    // as in struct frame
    double digital_gain, red_gain, blue_gain;
    bool lens_known;
    double lens;
    bool compared;           // with the other exposures of its bracket (firmware/store/ghosts.h):
    struct ghost_mask ghost; // where it differs; its `moved` is NULL where nothing does
};

struct take_camera {
    char uri[TAKE_TEXT];
    struct camera_info info;
    bool has_crf;
    struct crf crf;
    struct flicker_light light; // zeroed where it was not measured
};

/* A take as one member's part of the take of a rig of several boards (firmware/rig/README.md). */
struct take_rig {
    char take[TAKE_ID_CAP];       // id of the rig's take
    char member[TAKE_MEMBER_CAP]; // name of the board
    char clock[16];               // how the common clock is known: "exchange" or "kernel"
};

enum take_status { TAKE_COMPLETE, TAKE_ABORTED };

struct take {
    int n_cameras, n; // frames
    struct take_camera camera[BRACKET_CAMERAS_MAX];
    struct take_frame frame[TAKE_FRAMES_MAX]; // by camera, then index
    enum take_status status;
    char reason[TAKE_TEXT]; // why it was aborted; else warnings (coverage, unverified), or ""
    struct clocks trigger;
    bool clock_synced; // whether CLOCK_REALTIME is synchronised, by adjtimex
    bool stagger, metered;
    struct meter_result meter[BRACKET_CAMERAS_MAX]; // if metered
    double tolerance;                               // stops, the largest of the cameras
    double skew_s;                                  // largest between cameras at the same exposure
    int frames_used, rejected;
    bool is_place; // part of a session, which becomes one scene (places.h)
    char session
        [TAKE_ID_CAP];      // id of the session's first take; "" for that take and outside sessions
    struct develop balance; // how the session's pictures are developed; zeroed: measured
    struct take_rig rig;    // zeroed: not of a rig of several boards
};

/* The recorded exposure of a frame, and its time x gain, s. */
const struct exposure *take_exposure(const struct take_frame *f);
double take_exposure_s(const struct take_frame *f);

/* The largest difference between the starts of the same exposure on two cameras, s. */
double take_skew_s(const struct take *t);

/* The first camera whose frames report more than one position of its lens, or -1. Less than
 * TAKE_LENS_STEP, in 1/m or the device's units, does not count: it changes the size of pictures by
 * 1/4000 behind a lens of 5 mm, half a pixel at the edge of 4000, and whole units are steps. */
#define TAKE_LENS_STEP 0.05
int take_lens_moved(const struct take *t);

/* Whether the exposure of some frame could not be proven by its pixels. */
bool take_unverified(const struct take *t);

/* The name of a format: "mjpg", "rggb10p"; NULL if there is no such format. */
const char *take_format(enum camera_format f);

void take_free(struct take *t); // frames too; accepts NULL

#endif
