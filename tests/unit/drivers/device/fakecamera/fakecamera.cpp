/* A camera of 8x4 px that gives a frame every millisecond in a thread of its own. What it was
 * exposed with stands in its first bytes (double). Calls that libcamera forbids are counted. */
#include "tests/unit/drivers/device/fakecamera/fakecamera.h"

#include <libcamera/libcamera.h>

#include <algorithm>
#include <cerrno>
#include <condition_variable>
#include <cstdio>
#include <deque>
#include <mutex>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <thread>
#include <time.h>
#include <unistd.h>

extern "C" {
__attribute__((visibility("default"))) struct fakecamera fakecamera = {};
}

/* clock_gettime of the shim, renamed: the machine has slept for 1000 s, and nobody waits long for a
 * silent camera. */
extern "C" int fakecamera_clock(clockid_t clock, timespec *t) noexcept
{
    static std::atomic<int> calls;
    const long r = syscall(SYS_clock_gettime, CLOCK_MONOTONIC, t);
    t->tv_sec += fakecamera.silent ? 4 * ++calls : 0;
    t->tv_sec += clock == CLOCK_BOOTTIME ? 1000 : 0;
    return static_cast<int>(r);
}

namespace libcamera
{

static std::recursive_mutex guard; // of fakecamera and all devices

static void wrong(const char *what)
{
    const std::lock_guard<std::recursive_mutex> hold(guard);
    fakecamera.wrong++;
    snprintf(fakecamera.what, sizeof fakecamera.what, "%s", what);
}

extern "C" __attribute__((visibility("default"))) void fakecamera_put(int *field, int value)
{
    const std::lock_guard<std::recursive_mutex> hold(guard);
    *field = value;
}

struct Camera::device {
    int i = 0;
    std::string id;
    ControlInfoMap controls;
    ControlList properties;
    Stream stream;
    StreamConfiguration config;
    bool acquired = false, configured = false, running = false;
    bool gone = false, told = false; // told: the program has heard of it
    int late = 0;                    // requests reused since
    std::deque<Request *> queue;
    std::thread thread;
    unsigned sequence = 0;
    double exposure_us = 33333.0, gain = 4.0; // of the automatic
    bool manual = false;
    int af_mode = 0, af_state = 0, search_left = 0;
    double lens_at = 1.0;
    std::deque<std::pair<double, double>> coming;
};

void ControlList::set(unsigned id, const ControlValue &v)
{
    bool listed = !known_;
    for (size_t i = 0; known_ && i < known_->size(); i++)
        listed |= std::next(known_->begin(), static_cast<long>(i))->first->id() == id;
    if (!listed)
        wrong("a control is set that the camera does not list");
    values_[id] = v;
}

std::vector<PixelFormat> StreamFormats::pixelformats() const
{
    if (fakecamera.usb)
        return {formats::YUYV, formats::MJPEG};
    return {formats::NV12, formats::RGB888, formats::BGR888, formats::SRGGB12, formats::SRGGB10};
}

CameraConfiguration::Status CameraConfiguration::validate()
{
    const auto has = stream_.formats().pixelformats();
    Status status = fakecamera.invalid ? Invalid : Valid;
    if (std::find(has.begin(), has.end(), stream_.pixelFormat) == has.end()) {
        stream_.pixelFormat = has[0];
        status = Adjusted;
    }
    if (fakecamera.smaller)
        stream_.size = Size(4, 4);
    if (fakecamera.unknown_format)
        stream_.pixelFormat = PixelFormat(99);
    const bool wide =
        stream_.pixelFormat == formats::RGB888 || stream_.pixelFormat == formats::BGR888;
    stream_.stride = stream_.size.width * (wide ? 3 : stream_.pixelFormat == formats::NV12 ? 1 : 2);
    stream_.bufferCount = std::max(stream_.bufferCount, 2u);
    stream_.colorSpace = ColorSpace{ColorSpace::YcbcrEncoding::Rec709, ColorSpace::Range::Limited};
    return status;
}

FrameBuffer::~FrameBuffer()
{
    const std::lock_guard<std::recursive_mutex> hold(guard);
    munmap(memory_, planes_.back().offset + planes_.back().length);
    if (planes_.back().fd.get() != planes_[0].fd.get())
        close(planes_.back().fd.get());
    close(planes_[0].fd.get());
    fakecamera.buffers--;
}

FrameBufferAllocator::~FrameBufferAllocator()
{
    if (camera_->d->running)
        wrong("buffers are freed while the camera runs");
}

int FrameBufferAllocator::allocate(Stream *stream)
{
    const StreamConfiguration &c = camera_->d->config;
    if (stream != &camera_->d->stream)
        wrong("buffers for a stream that is not configured");
    if (fakecamera.fail_allocate)
        return -fakecamera.fail_allocate;
    for (unsigned i = 0; i < c.bufferCount; i++) {
        auto b = std::make_unique<FrameBuffer>();
        const unsigned luma = c.stride * c.size.height;
        const bool two = c.pixelFormat == formats::NV12;
        const int fd = memfd_create("frame", MFD_CLOEXEC);
        if (ftruncate(fd, luma + luma / 2) != 0)
            return -ENOMEM;
        b->planes_.push_back({SharedFD(fd), 0, luma});
        if (two)
            b->planes_.push_back({SharedFD(fakecamera.apart ? dup(fd) : fd), luma, luma / 2});
        for (size_t p = 0; p < b->planes_.size(); p++)
            b->metadata_.planes_.push_back({0});
        b->memory_ = static_cast<uint8_t *>(
            mmap(nullptr, luma + (two ? luma / 2 : 0), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0));
        fakecamera.buffers++;
        buffers_.push_back(std::move(b));
    }
    return static_cast<int>(c.bufferCount);
}

Request::Request(Camera *camera, uint64_t cookie)
    : camera_(camera), cookie_(cookie), controls_(camera->controls())
{
}

Request::~Request()
{
    if (fakecamera.buffers == 0 && !buffers_.empty())
        wrong("a request outlives its buffers");
}

void Request::reuse(ReuseFlag flags)
{
    const std::lock_guard<std::recursive_mutex> hold(guard);
    if (queued_)
        wrong("a request is reused while it is queued");
    // The program's thread may have been on its way here when it was told.
    if (camera_->d->told && ++camera_->d->late > 1)
        wrong("requests of a camera that has gone are reused");
    if (flags != ReuseBuffers)
        buffers_.clear();
    controls_.clear();
    metadata_.clear();
    status_ = RequestPending;
}

/* ---- a camera ---- */

Camera::Camera(int i) : d(std::make_unique<device>())
{
    d->i = i;
    d->id = fakecamera.id[i];
    d->properties.set(properties::Model.id(), ControlValue(std::string(fakecamera.model[i])));
    auto &c = d->controls;
    if (!fakecamera.uncontrolled) {
        c.emplace(&controls::AeEnable, ControlInfo(false, true));
        c.emplace(&controls::ExposureTime, ControlInfo(int32_t{75}, int32_t{2000000}));
        c.emplace(&controls::AnalogueGain, ControlInfo(1.0f, 16.0f));
#if FAKE_RELEASE >= 50
        c.emplace(&controls::ExposureTimeMode, ControlInfo(int32_t{0}, int32_t{1}));
        c.emplace(&controls::AnalogueGainMode, ControlInfo(int32_t{0}, int32_t{1}));
        if (fakecamera.syncs)
            c.emplace(&controls::SyncMode, ControlInfo(int32_t{0}, int32_t{2}));
#endif
    }
    if (fakecamera.lens)
        c.emplace(&controls::LensPosition, ControlInfo(0.0f, 10.0f));
    if (fakecamera.search)
        c.emplace(&controls::AfTrigger, ControlInfo(int32_t{0}, int32_t{1}));
    if (!fakecamera.usb) {
        c.emplace(&controls::AwbEnable, ControlInfo(false, true));
        c.emplace(&controls::AfMode, // no manual one without a lens
                  ControlInfo(int32_t{!fakecamera.lens}, int32_t{2}));
        c.emplace(&controls::FrameDurationLimits, ControlInfo(int64_t{20000}, int64_t{1500000}));
    }
}

Camera::~Camera()
{
    if (d->acquired)
        wrong("a camera is given up before its release");
    if (d->thread.joinable())
        d->thread.join();
}

const std::string &Camera::id() const
{
    return d->id;
}

int Camera::acquire()
{
    const std::lock_guard<std::recursive_mutex> hold(guard);
    if (fakecamera.fail_acquire || d->acquired)
        return d->acquired ? -EBUSY : -fakecamera.fail_acquire;
    d->acquired = true;
    fakecamera.acquired++;
    return 0;
}

int Camera::release()
{
    const std::lock_guard<std::recursive_mutex> hold(guard);
    if (!d->acquired || d->running)
        wrong("release of a camera that is not held, or runs");
    d->acquired = false;
    fakecamera.acquired--;
    return 0;
}

const ControlInfoMap &Camera::controls() const
{
    return d->controls;
}

const ControlList &Camera::properties() const
{
    return d->properties;
}

std::unique_ptr<CameraConfiguration>
Camera::generateConfiguration(const std::vector<StreamRole> &roles)
{
    auto c = std::make_unique<CameraConfiguration>();
    if (fakecamera.usb && roles[0] == StreamRole::Raw)
        return nullptr;
    c->stream_.pixelFormat = c->stream_.formats().pixelformats()[0];
    c->stream_.size = Size(8, 4);
    return c;
}

int Camera::configure(CameraConfiguration *config)
{
    if (!d->acquired || d->running)
        wrong("configure of a camera that is not held, or runs");
    if (fakecamera.fail_configure)
        return -fakecamera.fail_configure;
    config->stream_.stream_ = &d->stream;
    d->config = config->stream_;
    d->configured = true;
    return 0;
}

std::unique_ptr<Request> Camera::createRequest(uint64_t cookie)
{
    return std::make_unique<Request>(this, cookie);
}

int Camera::queueRequest(Request *r)
{
    const std::lock_guard<std::recursive_mutex> hold(guard);
    if (d->gone)
        return -ENODEV;
    if (!d->running)
        return -EACCES;
    if (fakecamera.fail_queue)
        return -fakecamera.fail_queue;
    if (r->queued_ || r->status_ != Request::RequestPending || r->buffers_.empty())
        wrong("a request is queued twice, or was not reused");
    r->queued_ = true;
    d->queue.push_back(r);
    return 0;
}

/* The lens, as the algorithm of the Raspberry Pi has it: manual, or a search after a trigger. */
static void obey_lens(Camera::device *d, const ControlList &list)
{
    const auto mode = list.get(controls::AfMode);
    const auto trigger = list.get(controls::AfTrigger);
    const auto lens = list.get(controls::LensPosition);
    if (mode && *mode != d->af_mode) {
        d->af_mode = *mode;
        d->af_state = d->search_left = 0;
    }
    if ((trigger && d->af_mode != 1) || (lens && d->af_mode != 0))
        wrong("a control of the lens in another mode");
    if (trigger) {
        fakecamera.searches++;
        d->af_state = 1;
        d->search_left = fakecamera.search;
    }
    if (lens)
        d->lens_at = *lens;
    if (lens && fakecamera.focus != *lens)
        fakecamera.focus = *lens;
    if (d->search_left > 0 && --d->search_left == 0) {
        d->af_state = fakecamera.in_vain ? 3 : 2;
        d->lens_at = fakecamera.in_vain ? 10.0 : 3.25;
    }
}

/* Controls that come with a request, or with the start. */
static void obey(Camera::device *d, const ControlList &list)
{
    const auto time = list.get(controls::ExposureTime);
    const auto gain = list.get(controls::AnalogueGain);
#if FAKE_RELEASE >= 50
    const auto mode = list.get(controls::ExposureTimeMode);
    const auto gain_mode = list.get(controls::AnalogueGainMode);
    if (mode && gain_mode)
        d->manual = *mode == 1 && *gain_mode == 1;
#else
    if (time)
        d->manual = *time != 0;
#endif
    auto last = d->coming.empty() ? std::make_pair(d->exposure_us, d->gain) : d->coming.back();
    if (d->manual && time)
        last.first = *time;
    if (d->manual && gain)
        last.second = *gain;
    d->coming.push_back(last);
    obey_lens(d, list);
}

static void finish(Camera *c, Request *r, bool cancelled)
{
    r->queued_ = false;
    r->status_ = cancelled ? Request::RequestCancelled : Request::RequestComplete;
    r->buffers_.begin()->second->metadata_.status =
        cancelled ? FrameMetadata::FrameCancelled : FrameMetadata::FrameSuccess;
    c->requestCompleted.emit(r);
}

static int64_t stamp()
{
    timespec t;
    clock_gettime(fakecamera.boottime ? CLOCK_BOOTTIME : CLOCK_MONOTONIC, &t);
    return static_cast<int64_t>(t.tv_sec) * 1000000000 + t.tv_nsec;
}

static void report(Camera::device *d, Request *r)
{
    const float colours[] = {2.0f, 1.5f};
    const int32_t black[] = {4096, 4096, 4096, 4096};
    ControlList &m = r->metadata_;
    m.set(controls::SensorTimestamp, stamp());
    if (fakecamera.usb)
        return;
    m.set(controls::ExposureTime, static_cast<int32_t>(d->exposure_us));
    m.set(controls::AnalogueGain, static_cast<float>(d->gain));
    m.set(controls::DigitalGain, 1.25f);
    m.set(controls::ColourGains, Span<const float, 2>(colours));
    m.set(controls::SensorBlackLevels, Span<const int32_t, 4>(black));
    m.set(controls::FrameDuration, int64_t{20000});
    if (fakecamera.lens) {
        m.set(controls::LensPosition, static_cast<float>(d->lens_at + 0.1 * fakecamera.nudge));
        m.set(controls::AfState, static_cast<int32_t>(d->af_state));
    }
}

/* One frame; called with the guard held. */
static void expose(Camera *c, Request *r)
{
    Camera::device *d = c->d.get();
    FrameBuffer *b = r->buffers_.begin()->second;
    obey(d, r->controls_);
    while (d->coming.size() > static_cast<size_t>(fakecamera.delay)) {
        d->exposure_us = d->coming.front().first;
        d->gain = d->coming.front().second;
        d->coming.pop_front();
    }
    if (d->exposure_us != 33333.0 && fakecamera.usb)
        d->exposure_us = 100.0 * static_cast<int>(d->exposure_us / 100.0); // as the handler does
    const double light = fakecamera.dark ? 0.0 : d->exposure_us * d->gain;
    memcpy(b->memory_, &light, sizeof light);
    b->metadata_.sequence = d->sequence++;
    b->metadata_.timestamp = static_cast<uint64_t>(stamp());
    for (size_t p = 0; p < b->planes_.size(); p++)
        b->metadata_.planes_[p].bytesused = b->planes_[p].length;
    const bool cut = fakecamera.cut > 0 && fakecamera.cut-- > 0;
    const bool bad = fakecamera.bad > 0 && fakecamera.bad-- > 0;
    b->metadata_.planes_[0].bytesused -= cut;
    report(d, r);
    const bool cancel = fakecamera.cancel > 0 && fakecamera.cancel-- > 0;
    fakecamera.frames++;
    r->queued_ = false;
    r->status_ = cancel ? Request::RequestCancelled : Request::RequestComplete;
    b->metadata_.status = cancel ? FrameMetadata::FrameCancelled
                          : bad  ? FrameMetadata::FrameError
                                 : FrameMetadata::FrameSuccess;
#if FAKE_RELEASE >= 52
    if (fakecamera.startup > 0 && !cancel && fakecamera.startup-- > 0)
        b->metadata_.status = FrameMetadata::FrameStartup;
#endif
}

/* True: go on. */
static bool run_once(Camera *c)
{
    Camera::device *d = c->d.get();
    std::unique_lock<std::recursive_mutex> hold(guard);
    if (!d->running)
        return false;
    if (fakecamera.unplug) {
        d->gone = true;
        std::deque<Request *> left;
        left.swap(d->queue);
        hold.unlock();
        for (Request *r : left)
            finish(c, r, true);
        c->disconnected.emit();
        hold.lock();
        d->told = true;
        return false;
    }
    if (d->queue.empty() || fakecamera.silent)
        return true;
    Request *r = d->queue.front();
    d->queue.pop_front();
    expose(c, r);
    hold.unlock();
    c->requestCompleted.emit(r);
    return true;
}

int Camera::start(const ControlList *list)
{
    const std::lock_guard<std::recursive_mutex> hold(guard);
    if (!d->configured || d->running)
        wrong("start of a camera that is not configured, or runs");
    if (fakecamera.fail_start)
        return -fakecamera.fail_start;
    fakecamera.frozen = 0;
    fakecamera.focus = -1.0;
    fakecamera.sync = 0;
#if FAKE_RELEASE >= 50
    if (const auto mode = list->get(controls::SyncMode))
        fakecamera.sync = *mode;
#endif
    for (const auto &[id, value] : list->all())
        fakecamera.frozen += id == controls::AeEnable.id() || id == controls::AwbEnable.id() ||
                             id == controls::AfMode.id() || id == 12 || id == 13;
    if (const auto limits = list->get(controls::FrameDurationLimits)) {
        fakecamera.frame_us[0] = (*limits)[0];
        fakecamera.frame_us[1] = (*limits)[1];
    }
    d->coming.clear();
    obey(d.get(), *list);
    d->exposure_us = d->coming.back().first;
    d->gain = d->coming.back().second;
    d->coming.clear();
    d->running = true;
    fakecamera.running++;
    d->thread = std::thread([this] {
        while (run_once(this))
            usleep(fakecamera.dark ? 20000 : 1000);
    });
    return 0;
}

int Camera::stop()
{
    std::unique_lock<std::recursive_mutex> hold(guard);
    if (std::this_thread::get_id() == d->thread.get_id())
        wrong("stop in libcamera's own thread");
    if (!d->running)
        return -EACCES;
    d->running = false;
    fakecamera.running--;
    hold.unlock();
    d->thread.join();
    std::deque<Request *> left;
    left.swap(d->queue);
    for (Request *r : left)
        finish(this, r, true);
    return d->gone ? -ENODEV : 0;
}

/* ---- the manager ---- */

CameraManager::CameraManager()
{
    if (fakecamera.managers++ != 0)
        wrong("a second manager");
}

CameraManager::~CameraManager()
{
    fakecamera.managers--;
    if (!cameras_.empty())
        wrong("the manager ends without a stop");
    if (fakecamera.acquired != 0)
        wrong("the manager ends while a camera is held");
}

int CameraManager::start()
{
    if (fakecamera.fail_manager)
        return -fakecamera.fail_manager;
    for (int i = 0; i < fakecamera.n_cameras; i++)
        cameras_.push_back(std::make_shared<Camera>(i));
    return 0;
}

void CameraManager::stop()
{
    cameras_.clear();
}

std::vector<std::shared_ptr<Camera>> CameraManager::cameras() const
{
    return cameras_;
}

} // namespace libcamera
