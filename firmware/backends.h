/* backends.h - which cameras and triggers this build knows.
 * thread: any. */
#ifndef FIRMWARE_BACKENDS_H
#define FIRMWARE_BACKENDS_H

#include "drivers/camera.h"
#include "drivers/trigger.h"

/* The backend that a URI names before its first ':'; NULL if there is none. */
const struct camera_ops *backends_camera(const char *uri);
const struct trigger_ops *backends_trigger(const char *uri);

/* Names, separated by blanks, for sentences and doctor. */
const char *backends_cameras(void);
const char *backends_triggers(void);

#endif
