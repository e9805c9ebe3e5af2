/* idle_view.h - what a camera sees while it waits.
 * Pure; any thread. */
#ifndef CAPTURE_IDLE_VIEW_H
#define CAPTURE_IDLE_VIEW_H

#include "core/photo/raw.h"
#include "drivers/device/camera.h"

enum { SESSION_BINS = 64, IDLE_VIEW_EDGE = 160 };

/* For the status page: the newest frame, looked at once a second. */
struct session_view {
    bool present;
    struct exposure exposure;         // as set
    uint32_t histogram[SESSION_BINS]; // counts of display values
    float clipped, dark;              // shares
};

/* The same frame, small: display values with their mean made grey. */
struct idle_view_picture {
    int w, h;                                        // at most IDLE_VIEW_EDGE; 0: none yet
    uint8_t px[3 * IDLE_VIEW_EDGE * IDLE_VIEW_EDGE]; // (h, w, 3) red, green, blue
};

/* Histogram and shares of a picture. */
void idle_view_look(const struct raw *p, struct session_view *out);

void idle_view_shrink(const struct raw *p, struct idle_view_picture *out);

/* A better exposure to wait at than now_s, which v was seen at: so that most of the scene is
 * visible. 0: there is none. */
double idle_view_base(const struct session_view *v, const struct camera_info *info, double now_s);

#endif
