#include "drivers/device/focus.h"

#include <stdlib.h>
#include <string.h>

err_t focus_parse(const char *what, const char *text, double most, struct focus *out)
{
    char *end;
    double v = strtod(text, &end);
    *out = (struct focus){strcmp(text, "once") == 0, -1.0};
    if (!*text || out->once)
        return OK;
    if (strcmp(text, "auto") == 0 || strcmp(text, "continuous") == 0)
        return err_fail(ERR_ARG,
                        "%s: focus=%s would move the lens between the frames of a bracket, which "
                        "must have one geometry: use focus=once",
                        what, text);
    if (*end || !(v >= 0.0 && v <= most))
        return err_fail(ERR_ARG, "%s: focus is \"%.40s\", neither once nor a number in 0..%.15g",
                        what, text, most);
    out->position = v;
    return OK;
}
