/* session_inner.h - what the files of session.c share: no part of the interface. A camera
 * fails by a sentence that names it. */
#ifndef CAPTURE_SESSION_INNER_H
#define CAPTURE_SESSION_INNER_H

#include "firmware/capture/frame_buffer.h"
#include "firmware/capture/session.h"

enum { SESSION_SETTLE = 12 }; // frames until a request is surely in force

#define SESSION_RETRY_NS INT64_C(1000000000) // between searches for a lost camera

enum phase { // the machine runs from PROBE to EXTEND
    PHASE_NONE,
    PHASE_FOCUS,
    PHASE_WAIT,
    PHASE_PROBE,
    PHASE_SHOOT,
    PHASE_EXTEND,
    PHASE_TROUBLE
};

enum { SESSION_STARTS = 64 };

/* When the last frames of a camera that waits began, by its clock. */
struct frame_starts {
    int skip;     // frames to pass over first
    bool gap;     // some were not seen: the next one shows whether they went on as before
    bool longer;  // an exposure that changes their length was asked for
    bool crowded; // the last order left no time to change the exposure of waiting
    int n;
    int64_t ns[SESSION_STARTS]; // oldest first; of frames, not of exposures
    double len;                 // of a frame, ns, as before a shift by `len_n` frames
    int len_n;
    bool fixed; // the length of frames cannot be changed
};

/* Observation of one camera's light after something went wrong. */
struct trouble {
    double base_s, time_s; // to go back to; asked for now
    int wait;              // frames until it is in force
    bool is_short, over;
    struct flicker seen;
};

struct cam {
    const struct camera_ops *ops;
    void *st;
    bool open;
    struct take_camera about;
    struct calib calib;
    bool calibrated;
    struct exposure set;       // last request, as read back
    int64_t retry_ns, look_ns; // when to look for it, and at what it sees
    bool looked;               // since it was armed
    struct session_view view;
    struct idle_view_picture picture;
    struct meter meter;
    struct meter_result plan;
    struct frame_buffer roll;
    int n_before; // frames of former plans of this take
    struct trouble trouble;
    struct frame_starts starts;
};

struct session {
    struct session_config cfg;
    int n;
    struct cam cam[BRACKET_CAMERAS_MAX];
    struct bracket *machine;
    struct raw sample; // samples of the current frame
    struct exposure_probe probe;
    enum phase phase;
    bool lost, cancelled, ready, complete;
    bool relit, again; // the light changed after probes; metered anew once
    struct session_order order;
    struct bracket_plan plan[BRACKET_CAMERAS_MAX];
    int turn; // for stagger mode
    struct clocks trigger;
    int frames_used, rejected;
    bool tried;       // why it failed was looked for, once per take
    int64_t until_ns; // and so long; of PHASE_FOCUS: when to look again, of PHASE_WAIT: to begin
    char reason[TAKE_TEXT], note[TAKE_TEXT];
};

/* ---- session_machine.c ---- */

/* The earliest present of all cameras, ns: no camera is late by it. */
int64_t session_machine_now(const struct session *s);

/* Put the camera's URI before the sentence of e. returns: e */
MUST_USE err_t session_machine_name(const struct cam *c, err_t e);

/* err:  as camera_ops.open */
MUST_USE err_t session_machine_open(struct session *s, int camera);
void session_machine_close(struct cam *c);

/* Close a camera that failed by the last error; it is looked for again after a while. */
void session_machine_lose(struct session *s, int camera);

/* Pass an event to the machine and carry out its actions. f: the frame of the event, or NULL.
 * err:  as bracket_event; ERR_LIMIT, ERR_NOMEM (frames) */
MUST_USE err_t session_machine_event(struct session *s, const struct bracket_event *ev,
                                     const struct frame *f);

/* Ask for the exposure of waiting (0: it is as it is) and tell the machine.
 * err:  as camera_ops.request; the camera is lost then. */
MUST_USE err_t session_machine_arm(struct session *s, int camera, double base_s);

/* Arm all open cameras, also after an error. same: they wait as they did before a complete take.
 * err:  the first of session_machine_arm */
MUST_USE err_t session_machine_arm_all(struct session *s, bool same);

/* ---- session_focus.c ---- */

/* Every camera's camera_ops.focus; they are armed again at the end of PHASE_FOCUS.
 * err:  as that, ERR_LOST, as session_machine_arm */
MUST_USE err_t session_focus(struct session *s, bool again);

/* ---- session_start.c ---- */

/* An exposure was asked for; the camera waits again, surely at its exposure if `settled`: what is
 * known of its frames is kept if none of the exposures meanwhile changed their length. */
void session_start_asked(struct cam *c);
void session_start_rest(struct cam *c, bool settled);
void session_start_forget(struct cam *c);

/* Note a frame of a camera that waits. */
void session_start_see(struct session *s, int camera, const struct frame *f, int64_t now);

/* session_lead_s */
double session_start_lead_s(const struct session *s);

/* PHASE_WAIT begins: until order.start_ns is so near that the plan must begin.
 * err:  as session_machine_arm */
MUST_USE err_t session_start_begin(struct session *s);

/* Whether the camera has seen every frame that ends before the plan begins. */
bool session_start_due(const struct session *s, int camera);

/* Sets when to begin by what is known of the frames now, and aligns cameras that can be.
 * err:  ERR_AGAIN (not yet), ERR_LOST */
MUST_USE err_t session_start_wait(struct session *s);

/* ---- session_trouble.c ---- */

/* Whether it is worth a look at the light why a bracket failed.
 * err:  as session_machine_arm */
bool session_trouble_is_light(const struct session *s, enum bracket_reason r);
MUST_USE err_t session_trouble_begin(struct session *s);

/* A frame while PHASE_TROUBLE lasts. */
MUST_USE err_t session_trouble_see(struct session *s, int camera, const struct frame *f,
                                   const struct exposure_probe *w);

enum session_outcome { SESSION_LOOKING, SESSION_STEADY, SESSION_FLICKERS };

/* End the observation. Once light flickers the machine knows and every camera is armed again. */
MUST_USE err_t session_trouble_end(struct session *s, enum session_outcome *out);

/* Why camera i failed, and what mends it. */
void session_trouble_sentence(struct session *s, int i, enum bracket_reason r);

#endif
