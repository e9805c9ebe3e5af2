/* focus.h - what the option focus= of a camera asks for.
 * thread: any. */
#ifndef DEVICE_FOCUS_H
#define DEVICE_FOCUS_H

#include "core/base/err.h"

#include <stdbool.h>

enum { FOCUS_SEARCH_S = 5 }; // most time of a search: a slow lens through its whole range

struct focus {
    bool once;       // search when asked to (camera_ops.focus), then stay there
    double position; // 1/m with libcamera, else in the device's units; < 0: as it stands
};

/* "once", a number in 0..most, or "" for neither. `what` begins the sentence.
 * err:  ERR_ARG; also for "auto", which no bracket can use */
MUST_USE err_t focus_parse(const char *what, const char *text, double most, struct focus *out);

#endif
