/* libcamera_sync.hpp - cameras whose frames begin together, by libcamera of Raspberry Pi OS: one is
 * the server and tells the others over the network when its frames begin, by the clocks of the
 * boards; each client shortens or lengthens a frame until its own begin then, again and again.
 * Frames must have one length. The metadata SyncReady and SyncTimer say when all may begin to
 * record; they are not needed here, where the stamps of frames tell how far they are apart.
 * thread: the camera's. */
#ifndef DRIVERS_LIBCAMERA_SYNC_HPP
#define DRIVERS_LIBCAMERA_SYNC_HPP

#include "drivers/device/libcamera_controls.hpp"
#include "drivers/device/libcamera_errors.hpp"
#include "drivers/device/libcamera_shim.h"

namespace
{

class frame_sync
{
  public:
    /* err: ERR_UNSUPPORTED */
    err_t open(const lc::Camera &camera, enum libcamera_sync how)
    {
        how_ = how;
        if (how != LIBCAMERA_SYNC_SERVER && how != LIBCAMERA_SYNC_CLIENT)
            return OK;
        mode_ = find_control(camera, "SyncMode");
        return mode_ ? OK
                     : fail(ERR_UNSUPPORTED,
                            "libcamera: %s has no control SyncMode: leave sync= out, or install "
                            "libcamera of Raspberry Pi OS",
                            camera.id().c_str());
    }

    bool one_length() const
    {
        return how_ != LIBCAMERA_SYNC_OFF;
    }

    /* Controls of the start. */
    void put(lc::ControlList &list) const
    {
        if (mode_)
            set_number(list, *mode_->first, how_);
    }

  private:
    enum libcamera_sync how_ = LIBCAMERA_SYNC_OFF;
    const lc::ControlInfoMap::value_type *mode_ = nullptr;
};

} // namespace

#endif
