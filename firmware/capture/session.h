/* session.h - the cameras of a rig and one capture after the other: opens them, keeps them
 * streaming, meters, runs the bracket machine, copies kept frames into a take. All I/O on cameras
 * is here; it never blocks but in session_open and while a camera is opened again.
 * While armed, frames are drained and given back, so that the newest reference is at hand; a camera
 * that is lost is looked for every second, by the same URI.
 * thread: one. */
#ifndef CAPTURE_SESSION_H
#define CAPTURE_SESSION_H

#include "firmware/capture/calib.h"
#include "firmware/capture/idle_view.h"
#include "firmware/capture/schedule.h"
#include "firmware/capture/take.h"

#include <poll.h>

struct session_config {
    int n; // cameras, 1..BRACKET_CAMERAS_MAX
    const char *uri[BRACKET_CAMERAS_MAX];
    int w, h;
    enum camera_format format;
    const char *calibration; // folder of calib.h; NULL: none
    size_t memory;           // most bytes of kept frames; one more aborts the take
};

enum session_state {
    SESSION_LOST, // some camera is not there
    SESSION_ARMED,
    SESSION_METERING, // or focuses
    SESSION_SHOOTING, // or waits for the start
    SESSION_READY     // a take waits for session_collect
};

struct session;

/* Opens every camera; one that is not there is an error only here.
 * own:  session_close.
 * err:  as camera_ops.open, naming the camera; ERR_ARG, ERR_NOMEM, ERR_UNSUPPORTED (pictures) */
MUST_USE err_t session_open(const struct session_config *cfg, struct session **out);
void session_close(struct session *s); // accepts NULL

enum session_state session_state(const struct session *s);

/* Whether every camera waits at an exposure that it sees something at, as far as that can be: a
 * bracket that begins earlier may have to say `unverified`. */
bool session_settled(const struct session *s);

/* Sentence for the user: what it does or waits for. */
const char *session_status(const struct session *s);

/* The longest exposure in force or asked for, s: nothing ends sooner. */
double session_longest_s(const struct session *s);

/* How long before start_ns an order must come, s, so that its first frame begins as near to it as
 * can be: from now on, if no exposure changes. */
double session_lead_s(const struct session *s);

int session_cameras(const struct session *s);
const struct take_camera *session_camera(const struct session *s, int i); // as last opened
void session_progress(const struct session *s, struct bracket_progress *out);

/* Descriptors to wait for, and when to call session_step at the latest, CLOCK_MONOTONIC.
 * Descriptors of cameras change only when one is opened again. */
int session_poll(const struct session *s, struct pollfd *fds, int cap, int64_t *deadline_ns);

/* Handle all that waits.
 * err:  ERR_NOMEM; troubles of cameras are states and sentences, not errors. */
MUST_USE err_t session_step(struct session *s);

/* Begin a take.
 * err:  ERR_BUSY (one runs or waits), ERR_LOST (names the camera), ERR_ARG (order), ERR_NOMEM */
MUST_USE err_t session_begin(struct session *s, const struct session_order *o);

/* End the running take as aborted: `reason` goes into it. */
void session_cancel(struct session *s, const char *reason);

/* The finished take; state is ARMED (or LOST) afterwards.
 * own:  take_free. err: ERR_AGAIN */
MUST_USE err_t session_collect(struct session *s, struct take **out);

/* The present picture of a camera and its exposure. */
void session_view(const struct session *s, int camera, struct session_view *out);
const struct idle_view_picture *session_picture(const struct session *s, int camera);

#endif
