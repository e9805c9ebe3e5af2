/* libcamera.h - the part of libcamera that the shim uses, for its test; C++. FAKE_RELEASE is 3 for
 * 0.0.3, 72 for 0.7.2: what those two have, and have not.
 * thread: as libcamera's: completed requests come from a thread of its own. */
#ifndef LIBCAMERA_LIBCAMERA_H
#define LIBCAMERA_LIBCAMERA_H

#include <atomic>
#include <cstdint>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

namespace libcamera
{

template <class T, size_t N = std::dynamic_extent> using Span = std::span<T, N>;

/* ---- controls ---- */

enum ControlType {
    ControlTypeNone,
    ControlTypeBool,
    ControlTypeByte,
    ControlTypeInteger32,
    ControlTypeInteger64,
    ControlTypeFloat,
    ControlTypeString
};

template <class T> struct control_type;
template <> struct control_type<bool> {
    static constexpr ControlType value = ControlTypeBool;
};
template <> struct control_type<int32_t> {
    static constexpr ControlType value = ControlTypeInteger32;
};
template <> struct control_type<int64_t> {
    static constexpr ControlType value = ControlTypeInteger64;
};
template <> struct control_type<float> {
    static constexpr ControlType value = ControlTypeFloat;
};
template <> struct control_type<std::string> {
    static constexpr ControlType value = ControlTypeString;
};
template <class T, size_t N> struct control_type<std::span<const T, N>> : control_type<T> {
};

class ControlValue
{
  public:
    ControlValue() = default;
    template <class T> ControlValue(const T &v) : type_(control_type<T>::value)
    {
        put(v);
    }
    ControlType type() const
    {
        return type_;
    }
    Span<const uint8_t> data() const
    {
        return bytes_;
    }
    template <class T> T get() const
    {
        if constexpr (std::is_same_v<T, std::string>)
            return std::string(bytes_.begin(), bytes_.end());
        else
            return as(static_cast<T *>(nullptr));
    }

  private:
    template <class T> void put(const T &v)
    {
        if constexpr (std::is_arithmetic_v<T>)
            bytes_.assign(reinterpret_cast<const uint8_t *>(&v),
                          reinterpret_cast<const uint8_t *>(&v) + sizeof v);
        else
            bytes_.assign(reinterpret_cast<const uint8_t *>(v.data()),
                          reinterpret_cast<const uint8_t *>(v.data() + v.size()));
    }
    template <class T> T as(T *) const
    {
        T v;
        memcpy(&v, bytes_.data(), sizeof v);
        return v;
    }
    template <class T, size_t N> std::span<const T, N> as(std::span<const T, N> *) const
    {
        return std::span<const T, N>(reinterpret_cast<const T *>(bytes_.data()), N);
    }
    ControlType type_ = ControlTypeNone;
    std::vector<uint8_t> bytes_;
};

class ControlId
{
  public:
    ControlId(unsigned id, const char *name, ControlType type) : id_(id), name_(name), type_(type)
    {
    }
    unsigned id() const
    {
        return id_;
    }
    const std::string &name() const
    {
        return name_;
    }
    ControlType type() const
    {
        return type_;
    }

  private:
    unsigned id_;
    std::string name_;
    ControlType type_;
};

template <class T> class Control : public ControlId
{
  public:
    Control(unsigned id, const char *name) : ControlId(id, name, control_type<T>::value)
    {
    }
};

class ControlInfo
{
  public:
    ControlInfo(const ControlValue &min, const ControlValue &max) : min_(min), max_(max)
    {
    }
    const ControlValue &min() const
    {
        return min_;
    }
    const ControlValue &max() const
    {
        return max_;
    }

  private:
    ControlValue min_, max_;
};

using ControlInfoMap = std::unordered_map<const ControlId *, ControlInfo>;

class ControlList
{
  public:
    ControlList() = default;
    explicit ControlList(const ControlInfoMap &known) : known_(&known)
    {
    }
    void set(unsigned id, const ControlValue &v);
    template <class T, class V> void set(const Control<T> &c, const V &v)
    {
        set(c.id(), ControlValue(T(v)));
    }
    template <class T> std::optional<T> get(const Control<T> &c) const
    {
        const auto at = values_.find(c.id());
        return at == values_.end() ? std::nullopt : std::optional<T>(at->second.template get<T>());
    }
    void clear()
    {
        values_.clear();
    }
    const std::map<unsigned, ControlValue> &all() const
    {
        return values_;
    }

  private:
    const ControlInfoMap *known_ = nullptr;
    std::map<unsigned, ControlValue> values_;
};

namespace controls
{
inline const Control<bool> AeEnable(1, "AeEnable");
inline const Control<int32_t> ExposureTime(2, "ExposureTime");
inline const Control<float> AnalogueGain(3, "AnalogueGain");
inline const Control<bool> AwbEnable(4, "AwbEnable");
inline const Control<Span<const float, 2>> ColourGains(5, "ColourGains");
inline const Control<Span<const int64_t, 2>> FrameDurationLimits(6, "FrameDurationLimits");
inline const Control<int64_t> SensorTimestamp(7, "SensorTimestamp");
inline const Control<float> DigitalGain(8, "DigitalGain");
inline const Control<Span<const int32_t, 4>> SensorBlackLevels(9, "SensorBlackLevels");
inline const Control<int64_t> FrameDuration(10, "FrameDuration");
inline const Control<int32_t> AfMode(11, "AfMode");
inline const Control<float> LensPosition(14, "LensPosition");
inline const Control<int32_t> AfTrigger(15, "AfTrigger");
inline const Control<int32_t> AfState(16, "AfState");
#if FAKE_RELEASE >= 50
inline const Control<int32_t> ExposureTimeMode(12, "ExposureTimeMode");
inline const Control<int32_t> AnalogueGainMode(13, "AnalogueGainMode");
inline const Control<int32_t> SyncMode(20001, "SyncMode"); // of Raspberry Pi OS
#endif
} // namespace controls

namespace properties
{
inline const Control<std::string> Model(1, "Model");
}

/* ---- formats ---- */

class PixelFormat
{
  public:
    constexpr PixelFormat(uint32_t fourcc = 0, uint64_t modifier = 0)
        : fourcc_(fourcc), modifier_(modifier)
    {
    }
    constexpr bool operator==(const PixelFormat &o) const
    {
        return fourcc_ == o.fourcc_ && modifier_ == o.modifier_;
    }
    std::string toString() const
    {
        return "FORMAT-" + std::to_string(fourcc_);
    }

  private:
    uint32_t fourcc_;
    uint64_t modifier_;
};

namespace formats
{
inline constexpr PixelFormat RGB888(1), BGR888(2), NV12(3), YUYV(4), MJPEG(5), R8(6), R10(7),
    R12(8), SRGGB16(10), SRGGB12(11), SRGGB10(12), SBGGR16(13), SBGGR12(14), SBGGR10(15),
    SGRBG16(16), SGRBG12(17), SGRBG10(18), SGBRG16(19), SGBRG12(20), SGBRG10(21),
    SRGGB10_CSI2P(12, 1), SBGGR10_CSI2P(15, 1), SGRBG10_CSI2P(18, 1), SGBRG10_CSI2P(21, 1),
    SRGGB12_CSI2P(11, 1), SBGGR12_CSI2P(14, 1), SGRBG12_CSI2P(17, 1), SGBRG12_CSI2P(20, 1);
}

struct Size {
    Size(unsigned w = 0, unsigned h = 0) : width(w), height(h)
    {
    }
    unsigned width, height;
};

struct ColorSpace {
    enum class YcbcrEncoding { None, Rec601, Rec709, Rec2020 };
    enum class Range { Full, Limited };
    YcbcrEncoding ycbcrEncoding;
    Range range;
};

/* ---- streams and buffers ---- */

class Stream
{
};

class StreamFormats
{
  public:
    std::vector<PixelFormat> pixelformats() const;
};

struct StreamConfiguration {
    PixelFormat pixelFormat;
    Size size;
    unsigned stride = 0, frameSize = 0, bufferCount = 0;
    std::optional<ColorSpace> colorSpace;
    Stream *stream() const
    {
        return stream_;
    }
    StreamFormats formats() const
    {
        return {};
    }
    Stream *stream_ = nullptr;
};

enum class StreamRole { Raw, StillCapture, VideoRecording, Viewfinder };

class CameraConfiguration
{
  public:
    enum Status { Valid, Adjusted, Invalid };
    Status validate();
    bool empty() const
    {
        return false;
    }
    StreamConfiguration &at(unsigned)
    {
        return stream_;
    }
    StreamConfiguration stream_;
};

struct FrameMetadata {
    enum Status {
        FrameSuccess,
        FrameError,
        FrameCancelled,
#if FAKE_RELEASE >= 52
        FrameStartup
#endif
    };
    struct Plane {
        unsigned bytesused;
    };
    Status status = FrameSuccess;
    unsigned sequence = 0;
    uint64_t timestamp = 0;
#if FAKE_RELEASE >= 70
    Span<const Plane> planes() const
    {
        return planes_;
    }
#else
    const std::vector<Plane> &planes() const
    {
        return planes_;
    }
#endif
    std::vector<Plane> planes_;
};

class SharedFD
{
  public:
    explicit SharedFD(int fd = -1) : fd_(fd)
    {
    }
    int get() const
    {
        return fd_;
    }

  private:
    int fd_;
};

class FrameBuffer
{
  public:
    struct Plane {
        SharedFD fd;
        unsigned offset, length;
    };
    ~FrameBuffer();
    const std::vector<Plane> &planes() const
    {
        return planes_;
    }
    const FrameMetadata &metadata() const
    {
        return metadata_;
    }
    std::vector<Plane> planes_;
    FrameMetadata metadata_;
    uint8_t *memory_ = nullptr; // the device's view
};

class Camera;

class FrameBufferAllocator
{
  public:
    explicit FrameBufferAllocator(std::shared_ptr<Camera> camera) : camera_(camera)
    {
    }
    ~FrameBufferAllocator();
    int allocate(Stream *stream);
    const std::vector<std::unique_ptr<FrameBuffer>> &buffers(Stream *) const
    {
        return buffers_;
    }

  private:
    std::shared_ptr<Camera> camera_;
    std::vector<std::unique_ptr<FrameBuffer>> buffers_;
};

class Request
{
  public:
    enum Status { RequestPending, RequestComplete, RequestCancelled };
    enum ReuseFlag { Default, ReuseBuffers };
    using BufferMap = std::map<const Stream *, FrameBuffer *>;
    Request(Camera *camera, uint64_t cookie);
    ~Request();
    void reuse(ReuseFlag flags);
    int addBuffer(const Stream *stream, FrameBuffer *buffer)
    {
        buffers_[stream] = buffer;
        return 0;
    }
    ControlList &controls()
    {
        return controls_;
    }
#if FAKE_RELEASE >= 70
    const ControlList &metadata() const
#else
    ControlList &metadata()
#endif
    {
        return metadata_;
    }
    const BufferMap &buffers() const
    {
        return buffers_;
    }
    uint64_t cookie() const
    {
        return cookie_;
    }
    Status status() const
    {
        return status_;
    }
    Camera *camera_;
    uint64_t cookie_;
    ControlList controls_, metadata_;
    BufferMap buffers_;
    Status status_ = RequestPending;
    bool queued_ = false;
};

/* ---- cameras ---- */

template <class... A> class Signal
{
  public:
    template <class T> void connect(T *to, void (T::*slot)(A...))
    {
        to_ = to;
        slot_ = [=](A... a) { (to->*slot)(a...); };
    }
    template <class T> void disconnect(T *to)
    {
        if (to == to_)
            slot_ = nullptr;
    }
    void emit(A... a)
    {
        if (slot_)
            slot_(a...);
    }

  private:
    void *to_ = nullptr;
    std::function<void(A...)> slot_;
};

class Camera
{
  public:
    explicit Camera(int i);
    ~Camera();
    const std::string &id() const;
    int acquire();
    int release();
    const ControlInfoMap &controls() const;
    const ControlList &properties() const;
    std::unique_ptr<CameraConfiguration> generateConfiguration(const std::vector<StreamRole> &);
    int configure(CameraConfiguration *config);
    std::unique_ptr<Request> createRequest(uint64_t cookie);
    int queueRequest(Request *request);
    int start(const ControlList *controls);
    int stop();
    Signal<Request *> requestCompleted;
    Signal<> disconnected;
    struct device; // what the library has of it
    std::unique_ptr<device> d;
};

class CameraManager
{
  public:
    CameraManager();
    ~CameraManager();
    int start();
    void stop();
    std::vector<std::shared_ptr<Camera>> cameras() const;

  private:
    std::vector<std::shared_ptr<Camera>> cameras_;
};

} // namespace libcamera

#endif
