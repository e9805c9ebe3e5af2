/* libcamera_focus.hpp - the lens of a camera of libcamera: where requests put it, and the search of
 * focus=once. For a search the camera is in AfModeAuto, in which the lens moves after a trigger
 * only; otherwise it is manual (libcamera_controls.hpp).
 * thread: the camera's. */
#ifndef DRIVERS_LIBCAMERA_FOCUS_HPP
#define DRIVERS_LIBCAMERA_FOCUS_HPP

#include "drivers/device/focus.h"
#include "drivers/device/libcamera_controls.hpp"
#include "drivers/device/libcamera_errors.hpp"

#include <libcamera/libcamera.h>

namespace
{

class lens
{
  public:
    err_t open(const lc::Camera &camera, const struct focus &want)
    {
        const char *const name = camera.id().c_str();
        const auto *range = find_control(camera, "LensPosition");
        const auto *mode = find_control(camera, "AfMode");
        want_ = want;
        position_ = want.position;
        if (!want.once && want.position < 0.0)
            return OK;
        if (!range)
            return fail(ERR_UNSUPPORTED, "libcamera: %s: its focus is fixed: leave focus= out",
                        name);
        const double lo = number(range->second.min(), 0.0), hi = number(range->second.max(), 0.0);
        const bool searches = mode && number(mode->second.max(), 0.0) >= int{MODE_AUTO} &&
                              find_control(camera, "AfTrigger");
        if (want.once && !searches)
            return fail(ERR_UNSUPPORTED,
                        "libcamera: %s: cannot search its focus: give a position in %g..%g (1/m)",
                        name, lo, hi);
        if (!want.once && !(want.position >= lo && want.position <= hi))
            return fail(ERR_ARG, "libcamera: %s: focus=%g is outside of its %g..%g (1/m)", name,
                        want.position, lo, hi);
        return OK;
    }

    /* Controls of a request; null: those of the start. */
    void put(lc::ControlList &list, const lc::Request *request)
    {
        if (step_ == TRIGGER || step_ == SENT || step_ == SEARCHING)
            list.set(lc::controls::AfMode, int32_t{MODE_AUTO});
        else if (position_ >= 0.0)
            list.set(lc::controls::LensPosition, static_cast<float>(position_));
        if (step_ != TRIGGER || !request)
            return;
        list.set(lc::controls::AfTrigger, int32_t{TRIGGER_START});
        carrier_ = request;
        step_ = SENT;
    }

    /* A request has completed. The search begins with the one that carried the trigger. */
    void see(const lc::Request *request, const lc::ControlList &metadata, bool cancelled)
    {
        if (step_ == SENT && request == carrier_)
            step_ = cancelled ? TRIGGER : SEARCHING;
        if (step_ != SEARCHING || cancelled)
            return;
        const auto state = metadata.get(lc::controls::AfState);
        const auto at = metadata.get(lc::controls::LensPosition);
        if (state && *state == STATE_FAILED)
            step_ = FAILED;
        if (!state || *state != STATE_FOCUSED)
            return;
        step_ = STANDS;
        position_ = at ? double{*at} : -1.0;
    }

    /* See camera_ops.focus. */
    err_t focus(const char *name, bool again, int64_t now_ns)
    {
        if (!want_.once)
            return OK;
        if (again || step_ == NEVER) {
            step_ = TRIGGER;
            until_ns_ = now_ns + int64_t{FOCUS_SEARCH_S} * 1000000000;
            return ERR_AGAIN;
        }
        if (step_ == STANDS)
            return OK;
        if (step_ != FAILED && now_ns < until_ns_)
            return ERR_AGAIN;
        const bool failed = step_ == FAILED;
        step_ = NEVER;
        return failed ? fail(ERR_TIMEOUT, "libcamera: %s: found no focus", name)
                      : fail(ERR_TIMEOUT, "libcamera: %s: found no focus in %d s", name,
                             int{FOCUS_SEARCH_S});
    }

  private:
    enum { MODE_AUTO = 1, TRIGGER_START = 0, STATE_FOCUSED = 2, STATE_FAILED = 3 }; // libcamera's
    enum step {
        NEVER,     // searched, or in vain
        TRIGGER,   // the next request starts it
        SENT,      // ... and is under way
        SEARCHING, // since it came back
        STANDS,
        FAILED
    };

    struct focus want_ {
        false, -1.0
    };
    double position_ = -1.0; // 1/m that requests carry; < 0: none, it stays where it is
    step step_ = NEVER;
    const lc::Request *carrier_ = nullptr; // of the trigger
    int64_t until_ns_ = 0;
};

} // namespace

#endif
