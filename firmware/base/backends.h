/* backends.h - tables of the cameras and triggers in this build.
 * thread: any. */
#ifndef BASE_BACKENDS_H
#define BASE_BACKENDS_H

#include "drivers/device/camera.h"
#include "drivers/device/trigger.h"

/* The backend that a URI names before its first ':'.
 * err:  ERR_ARG lists the known ones. */
MUST_USE err_t backends_camera(const char *uri, const struct camera_ops **out);
MUST_USE err_t backends_trigger(const char *uri, const struct trigger_ops **out);

/* The present by the clock of a camera that is open: its own, else CLOCK_MONOTONIC; ns. */
int64_t backends_now(const struct camera_ops *ops, const void *st);

#endif
