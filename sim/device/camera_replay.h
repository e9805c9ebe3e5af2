/* camera_replay.h - the camera `replay:FOLDER,KEY=VALUE,...`: plays photographs. FOLDER is whatever
 * drivers/format/imageset.h reads with exposures, without comma in its name. A request gives the
 * picture of the present view that is nearest in log exposure; frames say which one it is.
 *
 *   which=train|test|all   pictures of the released layout
 *   bracket=N              N pictures in the order of names are one view; 0: told by their names
 *   view=I                 the first view shown, from 0
 *   step=N                 after N requests the next one goes on to the next view (the last one is
 *                          followed by the first); 0: only camera_replay_step does
 *
 * and the first keys of sim/device/feed.c. The delay is 1 if not given. */
#ifndef DEVICE_CAMERA_REPLAY_H
#define DEVICE_CAMERA_REPLAY_H

#include "sim/device/feed.h"

enum { CAMERA_REPLAY_MIB = 1024 }; // of decoded pictures

/* Go on to the next view: frames that end from now on show it. */
void camera_replay_step(void *st);

/* Number of views and the one that is shown. */
int camera_replay_views(const void *st);
int camera_replay_view(const void *st);

#endif
