#include "firmware/base/backends.h"

#include "drivers/device/clocks.h"

#include <stdbool.h>
#include <string.h>

static const struct camera_ops *const cameras[] = {&camera_v4l2, &camera_libcamera, &camera_replay,
                                                   &camera_sim};
static const struct trigger_ops *const triggers[] = {&trigger_gpio, &trigger_gpiod, &trigger_evdev,
                                                     &trigger_timer};

enum {
    N_CAMERAS = sizeof cameras / sizeof cameras[0],
    N_TRIGGERS = sizeof triggers / sizeof triggers[0],
    LIST = 128
};

/* Whether the URI begins with "name:"; else the name joins the list. */
static bool uri_matches(const char *uri, const char *name, char list[LIST])
{
    size_t n = strlen(name), used = strlen(list);
    if (strncmp(uri, name, n) == 0 && uri[n] == ':')
        return true;
    if (used + n + 3 < LIST)
        strcat(strcat(strcat(list, " "), name), ":");
    return false;
}

err_t backends_camera(const char *uri, const struct camera_ops **out)
{
    char list[LIST] = "";
    for (int i = 0; i < N_CAMERAS; i++) {
        *out = cameras[i];
        if (uri_matches(uri, cameras[i]->name, list))
            return OK;
    }
    *out = NULL;
    return err_fail(ERR_ARG, "camera %.100s: begins with none of%s", uri, list);
}

err_t backends_trigger(const char *uri, const struct trigger_ops **out)
{
    char list[LIST] = "";
    for (int i = 0; i < N_TRIGGERS; i++) {
        *out = triggers[i];
        if (uri_matches(uri, triggers[i]->name, list))
            return OK;
    }
    *out = NULL;
    return err_fail(ERR_ARG, "trigger %.100s: begins with none of%s", uri, list);
}

int64_t backends_now(const struct camera_ops *ops, const void *st)
{
    int64_t own = ops->now ? ops->now(st) : 0;
    return own ? own : clocks_now();
}
