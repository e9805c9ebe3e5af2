/* libcamera_formats.hpp - pixel formats by their names here and in libcamera.
 * thread: any. */
#ifndef DRIVERS_LIBCAMERA_FORMATS_HPP
#define DRIVERS_LIBCAMERA_FORMATS_HPP

#include "drivers/device/camera.h"

#include <libcamera/libcamera.h>

namespace
{

namespace lc = libcamera;

struct format {
    camera_format ours;
    int bits;
    lc::PixelFormat theirs;
};

/* The first that a camera has is taken; of those before the ISP only on demand. */
const format formats[] = {
    {CAMERA_RGB8, 8, lc::formats::BGR888}, // named from the high byte of a word on
    {CAMERA_BGR8, 8, lc::formats::RGB888},
    {CAMERA_YUYV, 8, lc::formats::YUYV},
    {CAMERA_NV12, 8, lc::formats::NV12},
    {CAMERA_MJPG, 8, lc::formats::MJPEG},
    {CAMERA_GREY, 8, lc::formats::R8},
    {CAMERA_GREY16, 12, lc::formats::R12},
    {CAMERA_GREY16, 10, lc::formats::R10},
    {CAMERA_RGGB16, 16, lc::formats::SRGGB16},
    {CAMERA_RGGB16, 12, lc::formats::SRGGB12},
    {CAMERA_RGGB16, 10, lc::formats::SRGGB10},
    {CAMERA_BGGR16, 16, lc::formats::SBGGR16},
    {CAMERA_BGGR16, 12, lc::formats::SBGGR12},
    {CAMERA_BGGR16, 10, lc::formats::SBGGR10},
    {CAMERA_GRBG16, 16, lc::formats::SGRBG16},
    {CAMERA_GRBG16, 12, lc::formats::SGRBG12},
    {CAMERA_GRBG16, 10, lc::formats::SGRBG10},
    {CAMERA_GBRG16, 16, lc::formats::SGBRG16},
    {CAMERA_GBRG16, 12, lc::formats::SGBRG12},
    {CAMERA_GBRG16, 10, lc::formats::SGBRG10},
    {CAMERA_RGGB10P, 10, lc::formats::SRGGB10_CSI2P},
    {CAMERA_BGGR10P, 10, lc::formats::SBGGR10_CSI2P},
    {CAMERA_GRBG10P, 10, lc::formats::SGRBG10_CSI2P},
    {CAMERA_GBRG10P, 10, lc::formats::SGBRG10_CSI2P},
    {CAMERA_RGGB12P, 12, lc::formats::SRGGB12_CSI2P},
    {CAMERA_BGGR12P, 12, lc::formats::SBGGR12_CSI2P},
    {CAMERA_GRBG12P, 12, lc::formats::SGRBG12_CSI2P},
    {CAMERA_GBRG12P, 12, lc::formats::SGBRG12_CSI2P},
};

/* Before the ISP: what it multiplies with does not touch these. */
bool is_raw(camera_format f)
{
    return f >= CAMERA_GREY16;
}

const format *format_of(const lc::PixelFormat &theirs)
{
    for (const format &f : formats)
        if (f.theirs == theirs)
            return &f;
    return nullptr;
}

} // namespace

#endif
