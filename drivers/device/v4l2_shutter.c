/* Every setting is one VIDIOC_S_EXT_CTRLS, so that an error names its control; exposure and gain go
 * together, and come back when only the first of them was written. Drivers clamp in silence, also
 * to ranges that have changed (VBLANK changes that of EXPOSURE): what is in force is read back. */
#include "drivers/device/v4l2_shutter.h"

#include "core/base/log.h"
#include "drivers/device/v4l2_control.h"

#include <errno.h>
#include <linux/videodev2.h>
#include <math.h>
#include <string.h>

#define TICK_S 1e-4         // V4L2_CID_EXPOSURE_ABSOLUTE
#define PERIOD_S (1 / 30.0) // for devices that do not report it
enum { LINES_MAX = 1 << 30 };

/* ---- automatic modes ---- */

enum freeze_to { VALUE, LOWEST, USUAL };

struct freeze {
    const char *name;
    uint32_t id;
    enum freeze_to to;
    int value, or_value; // for VALUE; or_value where the device refuses the first
    bool must;           // pictures of a set could not be compared
};

static const struct freeze freezes[] = {
    {"automatic exposure", V4L2_CID_EXPOSURE_AUTO, VALUE, V4L2_EXPOSURE_MANUAL,
     V4L2_EXPOSURE_SHUTTER_PRIORITY, true},
    {"automatic gain", V4L2_CID_AUTOGAIN, VALUE, 0, 0, true},
    {"automatic white balance", V4L2_CID_AUTO_WHITE_BALANCE, VALUE, 0, 0, true},
    {"automatic white balance", V4L2_CID_AUTO_N_PRESET_WHITE_BALANCE, VALUE,
     V4L2_WHITE_BALANCE_MANUAL, V4L2_WHITE_BALANCE_DAYLIGHT, true},
    {"automatic sensitivity", V4L2_CID_ISO_SENSITIVITY_AUTO, VALUE, V4L2_ISO_SENSITIVITY_MANUAL,
     V4L2_ISO_SENSITIVITY_MANUAL, true},
    {"automatic focus", V4L2_CID_FOCUS_AUTO, VALUE, 0, 0, true},
    {"automatic brightness", V4L2_CID_AUTOBRIGHTNESS, VALUE, 0, 0, true},
    {"automatic hue", V4L2_CID_HUE_AUTO, VALUE, 0, 0, false},
    {"automatic colour gain", V4L2_CID_CHROMA_AGC, VALUE, 0, 0, false},
    // it would lower the rate by itself
    {"rate that exposure changes", V4L2_CID_EXPOSURE_AUTO_PRIORITY, VALUE, 0, 0, false},
    {"backlight compensation", V4L2_CID_BACKLIGHT_COMPENSATION, LOWEST, 0, 0, false},
    {"wide dynamic range", V4L2_CID_WIDE_DYNAMIC_RANGE, VALUE, 0, 0, false},
    // else some firmware rounds exposures to mains periods
    {"power line filter", V4L2_CID_POWER_LINE_FREQUENCY, VALUE, 0, 0, false},
    {"image stabilisation", V4L2_CID_IMAGE_STABILIZATION, VALUE, 0, 0, false},
    {"scene mode", V4L2_CID_SCENE_MODE, VALUE, V4L2_SCENE_MODE_NONE, V4L2_SCENE_MODE_NONE, false},
    {"white balance", V4L2_CID_WHITE_BALANCE_TEMPERATURE, USUAL, 0, 0, false},
    {"red balance", V4L2_CID_RED_BALANCE, USUAL, 0, 0, false},
    {"blue balance", V4L2_CID_BLUE_BALANCE, USUAL, 0, 0, false},
    {"gain", V4L2_CID_GAIN, USUAL, 0, 0, false},
    {"analogue gain", V4L2_CID_ANALOGUE_GAIN, USUAL, 0, 0, false},
    {"digital gain", V4L2_CID_DIGITAL_GAIN, USUAL, 0, 0, false},
    {"brightness", V4L2_CID_BRIGHTNESS, USUAL, 0, 0, false},
    {"contrast", V4L2_CID_CONTRAST, USUAL, 0, 0, false},
    {"saturation", V4L2_CID_SATURATION, USUAL, 0, 0, false},
    {"hue", V4L2_CID_HUE, USUAL, 0, 0, false},
    {"gamma", V4L2_CID_GAMMA, USUAL, 0, 0, false},
    {"sharpness", V4L2_CID_SHARPNESS, USUAL, 0, 0, false},
};

/* Read the control back and compare. */
static err_t check_frozen(const struct v4l2_node *n, const struct freeze *f, int written)
{
    int64_t now;
    int number = v4l2_control_get(n, f->id, &now);
    if (number)
        return v4l2_sys_fail(n, number, "read its controls");
    if (now == f->value || now == f->or_value)
        return OK;
    bool refused = !written || written == EINVAL || written == ERANGE || written == EACCES;
    return err_fail(refused ? ERR_UNSUPPORTED : ERR_IO,
                    "%s: %s cannot be switched off (it reads %lld, not %d)%s%s", n->path, f->name,
                    (long long)now, f->value, written ? ": " : "",
                    written ? strerror(written) : "");
}

static err_t freeze_control(const struct v4l2_node *n, const struct freeze *f)
{
    struct v4l2_range r;
    err_t e = v4l2_control_query(n, f->id, &r);
    if (e || !v4l2_control_there(&r))
        return e;
    int64_t to = f->to == LOWEST ? r.lo : f->to == USUAL ? r.usual : f->value;
    int number = r.fixed ? EACCES : v4l2_control_set(n, f->id, to);
    if ((number == EINVAL || number == ERANGE) && f->or_value != f->value)
        number = v4l2_control_set(n, f->id, f->or_value);
    if (number == ENODEV)
        return v4l2_sys_fail(n, number, "set its controls");
    if (f->must)
        return check_frozen(n, f, number);
    if (number && number != EACCES) // EACCES: another control rules it
        log_debug("%s: %s stays as it is: %s", n->path, f->name, strerror(number));
    return OK;
}

err_t v4l2_shutter_freeze(const struct v4l2_node *n)
{
    err_t e = OK;
    for (size_t i = 0; !e && i < sizeof freezes / sizeof freezes[0]; i++)
        e = freeze_control(n, &freezes[i]);
    return e;
}

/* ---- exposure and gain ---- */

static uint32_t exposure_id(const struct v4l2_shutter *c)
{
    return c->kind == V4L2_SHUTTER_TICKS ? V4L2_CID_EXPOSURE_ABSOLUTE : V4L2_CID_EXPOSURE;
}

static err_t exposure_fail(const struct v4l2_shutter *c, int number, int64_t code)
{
    switch (number) {
    case EBUSY:
        return err_fail(ERR_BUSY, "%s: the camera takes no exposure now", c->node.path);
    case EACCES:
    case EPERM:
    case EILSEQ: // "wrong state" of a USB camera
        return err_fail(ERR_UNSUPPORTED,
                        "%s: exposure is not ours to set: an automatic mode of the camera has it",
                        c->node.path);
    case EINVAL:
    case ERANGE:
        return err_fail(ERR_ARG, "%s: exposure %.6f s (code %lld) is out of the device's range",
                        c->node.path, (double)code * c->unit_s, (long long)code);
    default:
        return v4l2_sys_fail(&c->node, number, "set its exposure");
    }
}

/* *written: how many of the controls the device has taken. */
static int set_codes(const struct v4l2_shutter *c, int64_t code, int64_t gain, uint32_t *written)
{
    struct v4l2_ext_control v[2] = {{.id = exposure_id(c), .value = (int32_t)code},
                                    {.id = V4L2_CID_ANALOGUE_GAIN, .value = (int32_t)gain}};
    struct v4l2_ext_controls all = {
        .which = V4L2_CTRL_WHICH_CUR_VAL, .count = c->gain_lo < c->gain_hi ? 2 : 1, .controls = v};
    int number = v4l2_sys_ioctl(&c->node, VIDIOC_S_EXT_CTRLS, &all);
    // error_idx == count: the check before writing failed
    *written = number && all.error_idx < all.count ? all.error_idx : 0;
    return number;
}

/* Set both and read them back. err: as exposure_fail */
static err_t write_codes(struct v4l2_shutter *c, int64_t code, int64_t gain)
{
    uint32_t written;
    int number = set_codes(c, code, gain, &written);
    if ((number == EACCES || number == EILSEQ) &&
        !written) { // another program switched it on again
        err_t e = freeze_control(&c->node, &freezes[0]);
        if (e)
            return e;
        number = set_codes(c, code, gain, &written);
    }
    if (number && written > 0)
        v4l2_control_set(&c->node, exposure_id(c), c->code);
    if (number)
        return exposure_fail(c, number, code);
    int64_t now;
    number = v4l2_control_get(&c->node, exposure_id(c), &now);
    if (number == ENODEV)
        return v4l2_sys_fail(&c->node, number, "read its exposure");
    c->code = number ? code : now;
    c->gain = gain;
    if (c->gain_lo < c->gain_hi && v4l2_control_get(&c->node, V4L2_CID_ANALOGUE_GAIN, &now) == 0)
        c->gain = now;
    return OK;
}

/* ---- sensors ---- */

static err_t set_vblank(struct v4l2_shutter *c, int64_t to)
{
    if (to == c->vblank)
        return OK;
    int number = v4l2_control_set(&c->node, V4L2_CID_VBLANK, to);
    if (number == EBUSY)
        return err_fail(ERR_BUSY, "%s: the length of frames cannot be set now", c->node.path);
    if (number)
        return v4l2_sys_fail(&c->node, number, "set its vertical blanking");
    c->vblank = to;
    return OK;
}

/* Blanking of a frame that has room for so many lines of exposure; no less than usual. */
static int64_t vblank_for(const struct v4l2_shutter *c, int64_t lines)
{
    int64_t need = lines + c->sensor->margin - c->h;
    if (need <= c->vblank_base)
        return c->vblank_base;
    need += c->vblank_step - 1;
    return v4l2_control_fit(need, c->vblank_lo, c->vblank_hi, c->vblank_step);
}

static err_t line_time(struct v4l2_shutter *c, const struct v4l2_layout *l)
{
    int64_t rate = 0, hblank = 0;
    int number = v4l2_control_get(&c->node, V4L2_CID_PIXEL_RATE, &rate);
    if (!number)
        number = v4l2_control_get(&c->node, V4L2_CID_HBLANK, &hblank);
    if (number)
        return v4l2_sys_fail(&c->node, number, "tell its pixel rate and blanking");
    c->unit_s = ((double)l->w + (double)hblank) / (double)rate;
    if (!(c->unit_s >= 1e-7 && c->unit_s <= 0.1))
        return err_fail(ERR_UNSUPPORTED,
                        "%s: %d px and %lld of blanking at %lld px/s make no time of a line",
                        c->node.path, l->w, (long long)hblank, (long long)rate);
    return OK;
}

/* The longest exposure is what the driver allows in its longest frame: margins differ by sensor,
 * and some drivers count on in a slower mode of the sensor. */
static err_t longest_lines(struct v4l2_shutter *c, const struct v4l2_range *exposure)
{
    struct v4l2_range r;
    c->most = exposure->hi;
    if (c->vblank_lo == c->vblank_hi)
        return OK;
    err_t e = set_vblank(c, c->vblank_hi);
    if (!e)
        e = v4l2_control_query(&c->node, V4L2_CID_EXPOSURE, &r);
    if (!e && v4l2_control_there(&r))
        c->most = r.hi;
    err_t back = set_vblank(c, c->vblank_base);
    if (c->most > c->h + c->vblank_hi - c->sensor->margin)
        c->most = c->h + c->vblank_hi - c->sensor->margin;
    return e ? e : back;
}

static err_t open_lines(struct v4l2_shutter *c, const struct v4l2_layout *l,
                        const struct v4l2_range *exposure, double longest_s)
{
    struct v4l2_range v;
    err_t e = line_time(c, l);
    if (!e)
        e = v4l2_control_query(&c->node, V4L2_CID_VBLANK, &v);
    if (e)
        return e;
    c->h = l->h;
    if (v4l2_control_get(&c->node, V4L2_CID_VBLANK, &c->vblank) != 0 || !v4l2_control_there(&v) ||
        v.lo < 0 || v.hi > LINES_MAX) {
        c->most = exposure->hi; // a frame's length is not known
        return OK;
    }
    c->vblank_lo = v.fixed ? c->vblank : v.lo;
    c->vblank_hi = v.fixed ? c->vblank : v.hi;
    c->vblank_step = v.step;
    c->vblank_base = v.fixed ? c->vblank : v.usual;
    c->vblank_base = vblank_for(c, (int64_t)fmin(longest_s / c->unit_s, LINES_MAX));
    e = longest_lines(c, exposure);
    if (!e)
        e = set_vblank(c, c->vblank_base);
    c->period_s = (double)(c->h + c->vblank_base) * c->unit_s;
    return e;
}

static err_t open_gain(struct v4l2_shutter *c)
{
    struct v4l2_range r;
    err_t e = v4l2_control_query(&c->node, V4L2_CID_ANALOGUE_GAIN, &r);
    if (e || !v4l2_control_there(&r) || r.fixed)
        return e;
    bool factors = v4l2_sensor_gain(c->sensor, r.lo) > 0.0;
    c->gain_lo = factors ? v4l2_sensor_code(c->sensor, 1.0, r.lo, r.hi) : 0;
    c->gain_hi = factors ? v4l2_sensor_code(c->sensor, 1e9, c->gain_lo, r.hi) : 0;
    c->gain = c->gain_lo;
    return OK;
}

/* ---- life ---- */

err_t v4l2_shutter_open(struct v4l2_shutter *c, const struct v4l2_layout *l, double longest_s,
                        double period_s)
{
    struct v4l2_range r, rate;
    c->kind = V4L2_SHUTTER_FIXED;
    c->period_s = period_s > 0.0 ? period_s : PERIOD_S;
    c->unit_s = TICK_S;
    err_t e = v4l2_control_query(&c->node, V4L2_CID_EXPOSURE_ABSOLUTE, &r);
    if (e)
        return e;
    if (v4l2_control_there(&r) && !r.fixed) {
        c->kind = V4L2_SHUTTER_TICKS;
        c->most = (int64_t)fmin(c->period_s / TICK_S * (1.0 + 1e-6), (double)r.hi);
    } else {
        e = v4l2_control_query(&c->node, V4L2_CID_EXPOSURE, &r);
        if (!e)
            e = v4l2_control_query(&c->node, V4L2_CID_PIXEL_RATE, &rate);
        if (e || !v4l2_control_there(&r) || r.fixed || !v4l2_control_there(&rate))
            return e; // the unit is not known
        c->kind = V4L2_SHUTTER_LINES;
        e = open_lines(c, l, &r, longest_s);
        if (!e)
            e = open_gain(c);
    }
    c->step = r.step;
    c->least = r.lo > 0 ? r.lo : r.step;
    if (!e && c->least > c->most)
        e = err_fail(ERR_UNSUPPORTED, "%s: exposures of %lld..%lld times %.1f us make no range",
                     c->node.path, (long long)c->least, (long long)c->most, c->unit_s * 1e6);
    if (!e)
        e = write_codes(c, v4l2_control_fit(r.usual, c->least, c->most, c->step), c->gain);
    return e == ERR_ARG ? err_fail(ERR_UNSUPPORTED, "%s", err_text())
                        : e; // the first exposure is ours, not a request
}

/* Frames are stretched before a longer exposure is written and shortened after a shorter one: what
 * begins between the two has an exposure that was asked for. */
static err_t stretch_and_write(struct v4l2_shutter *c, int64_t code, int64_t gain)
{
    int64_t was = c->vblank, to = was;
    if (c->kind == V4L2_SHUTTER_LINES && c->vblank_lo < c->vblank_hi)
        to = vblank_for(c, code);
    err_t e = to > was ? set_vblank(c, to) : OK;
    if (e)
        return e;
    e = write_codes(c, code, gain);
    c->shifted = c->shifted && e;
    if (e && to > was) // coming frames are not to change
        (void)!set_vblank(c, was);
    if (!e && to < was && set_vblank(c, to) == ERR_LOST)
        return ERR_LOST; // else frames are longer than they need be, until the next request
    return e;
}

err_t v4l2_shutter_request(struct v4l2_shutter *c, const struct exposure *requested,
                           struct exposure *set_to)
{
    if (c->kind == V4L2_SHUTTER_FIXED)
        return err_fail(ERR_UNSUPPORTED, "%s: has no exposure control with a known unit",
                        c->node.path);
    double codes = fmin(floor(requested->time_s / c->unit_s * (1.0 + 1e-9)), (double)c->most);
    int64_t code = v4l2_control_fit((int64_t)codes, c->least, c->most, c->step), gain = c->gain_lo;
    if (c->gain_lo < c->gain_hi)
        gain = v4l2_sensor_code(c->sensor, requested->gain, c->gain_lo, c->gain_hi);
    err_t e = stretch_and_write(c, code, gain);
    if (e)
        return e == ERR_NOMEM ? err_fail(ERR_IO, "%s", err_text())
                              : e; // memory of the kernel, not ours
    if (c->code < 1)
        return err_fail(ERR_IO, "%s: exposure set to %lld reads back as %lld", c->node.path,
                        (long long)code, (long long)c->code);
    double factor = c->gain_lo < c->gain_hi ? v4l2_sensor_gain(c->sensor, c->gain) : 1.0;
    *set_to = (struct exposure){(double)c->code * c->unit_s, factor > 0.0 ? factor : 1.0};
    return OK;
}

err_t v4l2_shutter_shift(struct v4l2_shutter *c, double seconds, double *shift)
{
    if (c->kind != V4L2_SHUTTER_LINES || c->vblank_lo >= c->vblank_hi)
        return err_fail(ERR_UNSUPPORTED, "%s: the length of frames is fixed", c->node.path);
    if (c->shifted)
        return err_fail(ERR_BUSY, "%s: a frame is still to be lengthened", c->node.path);
    int64_t was = c->vblank, lines = llround(fmin(fmax(seconds, 0.0), c->period_s) / c->unit_s);
    int64_t to = v4l2_control_fit(was + lines, c->vblank_lo, c->vblank_hi, c->vblank_step);
    err_t e = to > was ? set_vblank(c, to) : OK;
    if (e)
        return e;
    c->shifted = c->vblank > was;
    c->vblank_usual = was;
    *shift = (double)(c->vblank - was) * c->unit_s;
    return OK;
}

err_t v4l2_shutter_shifted(struct v4l2_shutter *c)
{
    err_t e = c->shifted ? set_vblank(c, c->vblank_usual) : OK;
    c->shifted = c->shifted && e;
    return e;
}

void v4l2_shutter_info(const struct v4l2_shutter *c, struct camera_info *out)
{
    bool gain = c->gain_lo < c->gain_hi, lines = c->kind == V4L2_SHUTTER_LINES;
    out->period_s = c->period_s;
    out->time_min_s = (double)c->least * c->unit_s;
    out->time_max_s = (double)c->most * c->unit_s;
    out->time_step_s = (double)c->step * c->unit_s;
    if (c->kind == V4L2_SHUTTER_FIXED) {
        out->time_min_s = out->time_max_s = c->period_s;
        out->time_step_s = 0.0;
    }
    out->gain_max = gain ? v4l2_sensor_gain(c->sensor, c->gain_hi) : 1.0;
    out->exposure_delay = lines ? c->sensor->exposure_delay : -1;
    out->gain_delay = lines ? c->sensor->gain_delay : -1;
}
