/* v4l2_rig.h - one camera of the V4L2 backend on a fake kernel, for its tests. */
#ifndef DEVICE_V4L2_RIG_H
#define DEVICE_V4L2_RIG_H

#include "drivers/device/camera_v4l2.h"

#include "tests/unit/drivers/device/v4l2_fake_kinds.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static struct fake fake;
static void *state; // state of the only camera

static const char webcam[] = "v4l2:/dev/fake";
static const char sensor[] = "v4l2:/dev/fake,subdev=/dev/fake-subdev0";

static inline err_t open_cfg(const struct camera_cfg *cfg)
{
    free(state);
    state = malloc(camera_v4l2.state_bytes);
    assert_non_null(state);
    memset(state, 0xA5, camera_v4l2.state_bytes);
    return camera_v4l2_open_with(state, cfg, &fake.sys);
}

static inline err_t open_uri(const char *uri)
{
    return open_cfg(&(struct camera_cfg){.uri = uri});
}

static inline void open_ok(const char *uri)
{
    err_t e = open_uri(uri);
    if (e)
        print_message("%s\n", err_text());
    assert_int_equal(e, OK);
}

static inline void nothing_left(void)
{
    if (fake.breach[0])
        print_message("%s\n", fake.breach);
    assert_string_equal(fake.breach, "");
    assert_int_equal(fake.fds, 0);
    assert_int_equal(fake.maps, 0);
}

static inline void close_all(void)
{
    camera_v4l2.close(state);
    free(state);
    state = NULL;
    nothing_left();
}

static inline void refuses(err_t e, err_t code, const char *says)
{
    if (e != code || !strstr(err_text(), says))
        print_message("error %d: %s\n", e, err_text());
    assert_int_equal(e, code);
    assert_non_null(strstr(err_text(), says));
}

/* Opening is refused, and leaves nothing behind. */
static inline void open_refused(const char *uri, err_t code, const char *says)
{
    refuses(open_uri(uri), code, says);
    nothing_left();
}

static inline struct camera_info get_info(void)
{
    struct camera_info info;
    camera_v4l2.info(state, &info);
    return info;
}

static inline struct frame take(void)
{
    struct frame f;
    assert_int_equal(camera_v4l2.next(state, &f), OK);
    return f;
}

static inline int code_of(const struct frame *f)
{
    int32_t code;
    memcpy(&code, f->data, sizeof code);
    return code;
}

static inline struct exposure request_exposure(double time_s, double gain)
{
    struct exposure set = {0};
    assert_int_equal(camera_v4l2.request(state, &(struct exposure){time_s, gain}, &set), OK);
    return set;
}

static inline err_t ask_err(double time_s)
{
    struct exposure set = {7.0, 7.0};
    err_t e = camera_v4l2.request(state, &(struct exposure){time_s, 1.0}, &set);
    assert_true((e == OK) == (set.time_s != 7.0));
    return e;
}

static inline bool near(double a, double b)
{
    return fabs(a - b) <= 1e-9 + 1e-6 * fabs(b);
}

static inline int64_t control(uint32_t id)
{
    return fake_control(&fake, id)->value;
}

#endif
