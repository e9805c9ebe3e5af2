/* view.h - what a camera sees while it waits.
 * Pure; any thread. */
#ifndef CAPTURE_IDLE_VIEW_H
#define CAPTURE_IDLE_VIEW_H

#include "firmware/capture/session.h"

#include "core/photo/raw.h"

/* Histogram and shares of a picture. */
void idle_view_look(const struct raw *p, struct session_view *out);

/* A better exposure to wait at than now_s, which v was seen at: so that most of the scene is
 * visible. 0: there is none. */
double idle_view_base(const struct session_view *v, const struct camera_info *info, double now_s);

#endif
