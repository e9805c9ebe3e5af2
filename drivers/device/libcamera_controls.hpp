/* libcamera_controls.hpp - controls by name, as numbers of any type: types and
 * names differ between releases.
 * thread: any. */
#ifndef DRIVERS_LIBCAMERA_CONTROLS_HPP
#define DRIVERS_LIBCAMERA_CONTROLS_HPP

#include <libcamera/libcamera.h>

#include <cstdint>
#include <cstring>

namespace
{

namespace lc = libcamera;

/* The first element as a number. */
double number(const lc::ControlValue &v, double otherwise)
{
    const auto bytes = v.data();
    const auto as = [&](auto x) {
        if (bytes.size() < sizeof x)
            return otherwise;
        memcpy(&x, bytes.data(), sizeof x);
        return static_cast<double>(x);
    };
    switch (v.type()) {
    case lc::ControlTypeBool:
    case lc::ControlTypeByte:
        return as(uint8_t{});
    case lc::ControlTypeInteger32:
        return as(int32_t{});
    case lc::ControlTypeInteger64:
        return as(int64_t{});
    case lc::ControlTypeFloat:
        return as(float{});
    default:
        return otherwise;
    }
}

void set_number(lc::ControlList &list, const lc::ControlId &id, double v)
{
    switch (id.type()) {
    case lc::ControlTypeBool:
        list.set(id.id(), lc::ControlValue(v != 0.0));
        break;
    case lc::ControlTypeInteger32:
        list.set(id.id(), lc::ControlValue(static_cast<int32_t>(v)));
        break;
    case lc::ControlTypeFloat:
        list.set(id.id(), lc::ControlValue(static_cast<float>(v)));
        break;
    default:
        break;
    }
}

/* Off, or manual. */
struct frozen {
    const char *name;
    double value;
};
const frozen frozen_controls[] = {
    {"AeEnable", 0}, {"ExposureTimeMode", 1}, {"AnalogueGainMode", 1}, {"AwbEnable", 0},
    {"AfMode", 0},   {"AeFlickerMode", 0},    {"HdrMode", 0},
};

const lc::ControlInfoMap::value_type *find_control(const lc::Camera &camera, const char *name)
{
    for (const auto &entry : camera.controls())
        if (entry.first->name() == name)
            return &entry;
    return nullptr;
}

} // namespace

#endif
