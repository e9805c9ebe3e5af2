/* rigplan.h - one list of exposures for all cameras of a rig.
 * Pure; any thread. */
#ifndef RIG_RIGPLAN_H
#define RIG_RIGPLAN_H

#include "firmware/base/config.h"
#include "firmware/rig/message.h"

struct rigplan {
    int n;
    double time_s[BRACKET_EXPOSURES_MAX]; // rising, within the bounds of messages
};

/* Whether cameras must be metered for it: bracket.mode = auto, or a list around no given middle. */
bool rigplan_is_metered(const struct config *c);

/* The exposures for n cameras that want these, by the settings bracket.*. In a list the middle lies
 * between the shortest and the longest that any camera wants. In an automatic bracket the list goes
 * from one to the other in equal steps, none wider than the widest between two exposures that a
 * camera wants (RIGPLAN_STEP stops if none wants two): what each camera's meter found enough.
 * err:  ERR_ARG (no camera wants any) */
#define RIGPLAN_STEP 4.0
MUST_USE err_t rigplan_make(const struct config *c, const struct message_meter *meters, int n,
                            struct rigplan *out);

#endif
