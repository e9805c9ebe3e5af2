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
 *   IDLE     -> ARMED     on_arm()    the last camera streams
 *   ARMED    -> IDLE      on_lost()
 *   ARMED    -> SHOOTING  on_begin()  plan valid; from DONE, too, unless ARM is needed
 *   SHOOTING -> SHOOTING  on_frame()  kept, or not; next exposure requested
 *   SHOOTING -> SHOOTING  on_tick()   no frames for 3 longest waits + 1 s: restart, once per camera
 *   SHOOTING -> DONE      on_frame()  the last exposure was missing
 *   SHOOTING -> FAULT     stop()      attempts spent, camera lost, cancelled
 *   DONE, FAULT -> IDLE, ARMED  on_arm() for the first, the last camera
 *
 * Within SHOOTING, each camera by itself:
 *   WAIT   at base, until two frames that look the same are the reference; the rest before them was
 *          so long that all evidence must agree. Usually they are there before the trigger.
 *   RUN    pipelined: a new exposure with every frame; in the end base again. Cameras whose delay
 *          varies and that do not report exposures begin with REST instead.
 *   CHECK  at base after a conflict or a restart. If the frame looks like the reference, REST
 *          follows; if not, the light changed: all is forgotten and WAIT comes again, once.
 *   REST   one exposure at a time, until requests allow for no other
 *   OVER   everything kept, and a base frame afterwards that looks like the reference
 *
 * Evidence decides which exposure a frame has (W1 to W5 of firmware/capture/README.md 2; label.h).
 * The log of requests gives the exposures that can be in force. The pixels, compared with the
 * reference and with frames kept since, select one of them; the report of the device must agree.
 * Exposures that the pixels cannot tell apart are only accepted from rest, and marked.
 * A frame whose rows do not all have one exposure is taken again. N + delay + 1 frames when nothing
 * fails.
 *
 * Invariant: no frame is kept whose recorded exposure differs from the true one by more than
 * `tolerance` (stops), unless its evidence says `unverified`; a factor common to the reference and
 * all frames of a camera cannot be seen and does no harm. Three things together could break it:
 * light that changes by exactly one step for the whole set, a camera without reports, and an
 * unknown delay.
 * thread: any, one at a time. */
#ifndef CAPTURE_BRACKET_H
#define CAPTURE_BRACKET_H

#include "firmware/capture/evidence.h"

#include "core/photo/flicker.h"

/* The exposures of one camera, in the order of shooting; may repeat. n is 0 for a camera that takes
 * no part. Stagger mode is a plan with n = 1 and another exposure per camera. */
struct bracket_plan {
    int n;
    struct exposure requested[BRACKET_EXPOSURES_MAX];
};

enum bracket_state { BRACKET_IDLE, BRACKET_ARMED, BRACKET_SHOOTING, BRACKET_DONE, BRACKET_FAULT };

enum bracket_reason { // why a bracket ended in FAULT; bracket_sentence gives the words
    BRACKET_NONE,
    BRACKET_DEVICE_LOST,
    BRACKET_STALLED,
    BRACKET_INEFFECTIVE, // the exposure has no effect, or another one
    BRACKET_SCENE_CHANGED,
    BRACKET_DISAGREES, // pixels and requests contradict the report of the device
    BRACKET_GAINS,     // digital gain or white balance move
    BRACKET_BAD_FRAMES,
    BRACKET_REFUSED, // the device does not take a request
    BRACKET_CANCELLED,
    BRACKET_REASONS
};

enum bracket_event_kind {
    BRACKET_ARM,    // the camera streams; `set`, which it was asked for last, is its base exposure.
                    // Needed again after DONE, FAULT and requests that the machine did not make.
                    // same: after DONE, and nothing changed since, so the reference is kept
    BRACKET_BEGIN,  // plan
    BRACKET_ANSWER, // the device answered a request: err, set
    BRACKET_FRAME,  // frame, probe; NULL is allowed outside SHOOTING, for a frame that only counts
    BRACKET_UNUSABLE, // a frame that cannot be read (ERR_IO, bad JPEG); frame may be NULL
    BRACKET_LOST,     // camera gone; streams again with ARM
    BRACKET_OPENED,   // camera streams again after a restart
    BRACKET_TICK,     // time passed; names no camera, like BEGIN and CANCEL
    BRACKET_CANCEL
};

struct bracket_event {
    enum bracket_event_kind kind;
    int64_t now_ns; // CLOCK_MONOTONIC
    int camera;
    bool same;
    const struct bracket_plan *plan; // [cameras], for BEGIN
    const struct frame *frame;       // its pixels are not read
    const struct exposure_probe *probe;
    err_t err; // for ANSWER; OK: `set` is in force
    struct exposure set;
};

enum bracket_action_kind {
    BRACKET_REQUEST, // ask the camera for `exposure`; its next event is ANSWER, sent now or when
                     // bracket_action is false. Also comes after DONE and FAULT: back to base
    BRACKET_KEEP,    // copy the frame of this event as exposure `index`; bracket_evidence has more
    BRACKET_FORGET,  // drop all kept frames of the camera in this plan: they may be mistaken.
                     // index 1: the light changed; frames of former plans do not fit new ones
    BRACKET_RESTART  // close and open the camera, then OPENED or LOST
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

/* Handles one event. Call bracket_action until it is false before the next event, but for ANSWER.
 * err:  ERR_ARG (a plan out of range, an event that is not allowed now; nothing is changed). */
MUST_USE err_t bracket_event(struct bracket *b, const struct bracket_event *ev);
bool bracket_action(struct bracket *b, struct bracket_action *out);

/* Sets the flicker of a camera's light from now on; it is steady at first. */
void bracket_light(struct bracket *b, int camera, const struct flicker_light *light);

enum bracket_state bracket_state(const struct bracket *b);
enum bracket_reason bracket_reason(const struct bracket *b, int *camera);
const char *bracket_sentence(enum bracket_reason r);

/* Whether the camera has its reference, so that a plan can begin at once. */
bool bracket_settled(const struct bracket *b, int camera);

/* Evidence of a kept frame; NULL if it is not kept. */
const struct bracket_evidence *bracket_evidence(const struct bracket *b, int camera, int index);

struct bracket_progress {
    int kept, wanted; // frames of all cameras
    int frames;       // since BEGIN, from the camera that needed most
    int rejected, lost;
    bool resting; // some camera is not pipelined any more
};
void bracket_progress(const struct bracket *b, struct bracket_progress *out);

/* When a TICK is due if nothing else happens, CLOCK_MONOTONIC; INT64_MAX: never. */
int64_t bracket_deadline(const struct bracket *b);

#endif
