/* bracket.h - the bracket machine: which exposure each camera of a rig is asked for next, and which
 * frame may be kept under which exposure. Pure: no device, no clock; time comes inside events.
 *
 * States, and what is true in each:
 *   IDLE      some camera does not stream
 *   ARMED     every camera streams at its base exposure
 *   SHOOTING  a plan runs; kept frames are proven, those still missing have been asked for or will
 *             be with the next frame of their camera
 *   DONE      every frame of the plan is kept, and the light was the same afterwards
 *   FAULT     the plan was given up; frames still kept are proven; `reason` says why
 *
 *   IDLE     -> ARMED     arm()       of the last camera
 *   ARMED    -> IDLE      lost()
 *   ARMED    -> SHOOTING  begin()     plan valid; from DONE too, if nobody else asked for exposures
 *   SHOOTING -> SHOOTING  frame()     kept, or not; next exposure requested
 *   SHOOTING -> SHOOTING  restart()   no frames for 3 longest waits + 1 s: once per camera and set
 *   SHOOTING -> DONE      frame()     the last one missing
 *   SHOOTING -> FAULT     fail()      attempts spent, camera lost, cancelled
 *   DONE, FAULT -> IDLE, ARMED  arm() of the first, the last camera
 *
 * Within SHOOTING, each camera by itself:
 *   WAIT   at base, until a frame from after so long a rest that every witness must agree, and one
 *          more like it, are the reference. Usually there before the trigger.
 *   RUN    pipelined: a new exposure with every frame; in the end base again. Not for cameras
 *          whose delay varies and that do not report: REST at once.
 *   CHECK  after a conflict, or a restart: at base. It looks like the reference: go on with REST.
 *          It does not: the light changed, everything is forgotten and WAIT comes again, once.
 *   REST   one exposure at a time, until requests allow for no other
 *   OVER   everything kept, and a base frame afterwards that looks like the reference
 *
 * What a frame is, is decided by evidence (W1 to W5 of firmware/capture/README.md 2; label.h).
 * From the log of requests follow the exposures that can be in force in it. The pixels, compared
 * with the reference and with frames kept since, pick one of them; what the device reports must
 * agree. Exposures that cannot be told apart by the pixels are only accepted from rest, and marked.
 * A frame whose rows do not all have one exposure is taken again. N + delay + 1 frames when nothing
 * fails.
 *
 * Invariant: no frame is kept whose recorded exposure differs from the true one by more than
 * `tolerance` (stops), unless its evidence says `unverified`; a factor common to the reference and
 * all frames of a camera cannot be seen and does no harm. What could break it: light that for
 * as long as the set is another by exactly a step, a camera that reports nothing, and a delay that
 * nobody knows, all together.
 * thread: any, one at a time. */
#ifndef CAPTURE_BRACKET_H
#define CAPTURE_BRACKET_H

#include "firmware/capture/evidence.h"

#include "core/photo/flicker.h"

/* The exposures of one camera, in the order of shooting; may repeat. n is 0 for a camera that takes
 * no part. Stagger mode is a plan with n = 1 and another exposure per camera. */
struct bracket_plan {
    int n;
    struct exposure ask[BRACKET_EXPOSURES_MAX];
};

enum bracket_state { BRACKET_IDLE, BRACKET_ARMED, BRACKET_SHOOTING, BRACKET_DONE, BRACKET_FAULT };

enum bracket_reason { // of a fault; bracket_sentence says it
    BRACKET_NONE,
    BRACKET_DEVICE_LOST,
    BRACKET_STALLED,
    BRACKET_INEFFECTIVE, // exposure has no, or another, effect
    BRACKET_SCENE_CHANGED,
    BRACKET_DISAGREES, // device reports what pixels and requests contradict
    BRACKET_GAINS,     // digital gain or white balance move
    BRACKET_BAD_FRAMES,
    BRACKET_REFUSED, // the device does not take a request
    BRACKET_CANCELLED,
    BRACKET_REASONS
};

enum bracket_event_kind {
    BRACKET_ARM,    // the camera streams; `set`, which it was asked for last, is its base exposure.
                    // To be said again after DONE, FAULT and requests of others
    BRACKET_BEGIN,  // plan
    BRACKET_ANSWER, // of a request: err, set
    BRACKET_FRAME, // frame, witness; NULL will do outside of SHOOTING, for a frame that only counts
    BRACKET_UNUSABLE, // a frame that could not be had or read (ERR_IO, bad JPEG); frame may be NULL
    BRACKET_LOST,     // camera gone; streams again with ARM
    BRACKET_OPENED,   // camera streams again after a restart
    BRACKET_TICK,     // of no camera, as are BEGIN and CANCEL
    BRACKET_CANCEL
};

struct bracket_event {
    enum bracket_event_kind kind;
    int64_t now_ns; // CLOCK_MONOTONIC
    int camera;
    const struct bracket_plan *plan; // [cameras], of BEGIN
    const struct frame *frame;       // pixels are not looked at
    const struct exposure_probe *witness;
    err_t err; // of ANSWER; OK: `set` holds
    struct exposure set;
};

enum bracket_action_kind {
    BRACKET_REQUEST, // ask the camera for `exposure`; ANSWER before any other event of it, at once
    // or when bracket_action is false. Comes after DONE and FAULT too: back to base
    BRACKET_KEEP,   // copy the frame of this event as exposure `index`; evidence is in the machine
    BRACKET_FORGET, // all kept frames of the camera in this plan, for they may be mistaken; index
                    // 1: the light changed, so that frames of former plans do not go with new ones
    BRACKET_RESTART // close and open the camera, then OPENED or LOST
};

struct bracket_action {
    enum bracket_action_kind kind;
    int camera, index;
    struct exposure exposure;
};

struct bracket; // about 100 kB per camera

/* own: bracket_free. err: ERR_NOMEM, ERR_ARG (0 or too many cameras, fields out of range) */
MUST_USE err_t bracket_new(const struct bracket_camera *cameras, int n, struct bracket **out);
void bracket_free(struct bracket *b);

/* One event; then bracket_action until it is false, before the next event but ANSWER.
 * err:  ERR_ARG (a plan out of range, an event that cannot be now; nothing is changed). */
MUST_USE err_t bracket_event(struct bracket *b, const struct bracket_event *ev);
bool bracket_action(struct bracket *b, struct bracket_action *out);

/* The light of a camera from now on; steady at first. */
void bracket_light(struct bracket *b, int camera, const struct flicker_light *light);

enum bracket_state bracket_state(const struct bracket *b);
enum bracket_reason bracket_reason(const struct bracket *b, int *camera);
const char *bracket_sentence(enum bracket_reason r);

/* Evidence of a kept frame; NULL if it is not kept. */
const struct bracket_evidence *bracket_evidence(const struct bracket *b, int camera, int index);

struct bracket_progress {
    int kept, wanted; // frames of all cameras
    int frames;       // looked at since BEGIN, of the camera that needed most
    int rejected, lost;
    bool resting; // some camera is not pipelined any more
};
void bracket_progress(const struct bracket *b, struct bracket_progress *out);

/* When a TICK is due if nothing else happens, CLOCK_MONOTONIC; INT64_MAX: never. */
int64_t bracket_deadline(const struct bracket *b);

#endif
