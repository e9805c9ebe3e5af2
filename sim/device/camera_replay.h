/* camera_replay.h - the camera `replay:FOLDER,KEY=VALUE,...`: plays photographs. FOLDER is any set
 * that drivers/format/imageset.h reads with exposures; its name has no comma. A request gives the
 * picture of the present view that is nearest in log exposure; frames report its exposure.
 *
 *   which=train|test|all   pictures of the released layout
 *   bracket=N              N pictures in order of names are one view; 0: names tell the views
 *   view=I                 the first view shown, from 0
 *   step=N                 every N requests show the next view (the first after the last);
 *                          0: only camera_replay_step does
 *
 * and the first keys of sim/device/feed.c. The default delay is 1. */
#ifndef DEVICE_CAMERA_REPLAY_H
#define DEVICE_CAMERA_REPLAY_H

#include "sim/device/feed.h"

enum { CAMERA_REPLAY_MIB = 1024 }; // memory for decoded pictures

/* Go on to the next view: frames that end from now on show it. */
void camera_replay_step(void *st);

/* Number of views and the one that is shown. */
int camera_replay_views(const void *st);
int camera_replay_view(const void *st);

#endif
