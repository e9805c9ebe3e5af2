/* One camera of libcamera behind drivers/device/libcamera_shim.h.
 * Requests circulate: a frame that is given back takes its request with the exposure that was asked
 * for last into the queue again, so that as many as there are buffers are always on their way. A
 * completed one comes in libcamera's thread, which only puts its address into a ring and writes an
 * eventfd; everything else happens in the caller's thread.
 * Everything automatic is switched off by name where the camera lists it: what there is differs
 * from release to release (ExposureTimeMode from 0.5 on, without which an exposure is ignored).
 * open waits for the first frame: only that one tells whether this camera reports its exposures.
 * Once the camera is gone or a request cannot be queued, no request is touched again (reuse of one
 * ends in a crash); stop, buffers and release are left to close, in this order. Until 0.7.2 at
 * least, libcamera aborts when it stops a USB camera that has gone before udev says so: close waits
 * for that.
 * Compiles with 0.0.3 to 0.7.2. */
#include "drivers/device/libcamera_shim.h"
#include "drivers/device/libcamera_sync.hpp"

#include "drivers/device/libcamera_controls.hpp"
#include "drivers/device/libcamera_errors.hpp"
#include "drivers/device/libcamera_focus.hpp"
#include "drivers/device/libcamera_formats.hpp"

#include <libcamera/libcamera.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <dirent.h>
#include <linux/dma-buf.h>
#include <linux/videodev2.h>
#include <memory>
#include <mutex>
#include <poll.h>
#include <string>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <time.h>
#include <unistd.h>
#include <vector>

namespace
{

constexpr int FIRST_FRAME_MS = 5000;
constexpr int NEWS_MS = 2000;         // until libcamera is told of an unplugging, at most
constexpr int PERIOD_FRAMES = 3;      // after which the period is taken from the stamps
constexpr double START_S = 0.01;      // exposure before anything is asked for
constexpr double UVC_STEP_US = 100.0; // to which the UVC handler cuts exposure times

/* ---- differences between releases and cameras ---- */

/* Frames at the start that are transferred well and are not to be used: 0.5.2 and later. */
template <class M> auto is_startup(const M &m, int) -> decltype(M::FrameStartup, bool())
{
    return m.status == M::FrameStartup;
}
template <class M> bool is_startup(const M &, long)
{
    return false;
}

int64_t now_ns(clockid_t clock)
{
    timespec t;
    clock_gettime(clock, &t);
    return static_cast<int64_t>(t.tv_sec) * 1000000000 + t.tv_nsec;
}

/* Stamps are of CLOCK_BOOTTIME by the book, and of CLOCK_MONOTONIC where a handler passes on those
 * of V4L2. The two part only by suspends, of which the shortest is far longer than a frame: a stamp
 * ahead of CLOCK_MONOTONIC is of the other clock. */
int64_t monotonic(int64_t stamp)
{
    const int64_t now = now_ns(CLOCK_MONOTONIC), apart = now_ns(CLOCK_BOOTTIME) - now;
    return stamp > now + 100000000 && stamp - apart <= now + 100000000 ? stamp - apart : stamp;
}

/* ---- the one manager ---- */

/* libcamera allows one per process; it lives as long as a camera is open. */
std::shared_ptr<lc::CameraManager> manager_get(err_t *e)
{
    static std::mutex lock;
    static std::weak_ptr<lc::CameraManager> known;
    const std::lock_guard<std::mutex> hold(lock);
    auto manager = known.lock();
    if (manager)
        return manager;
    auto fresh = std::make_unique<lc::CameraManager>();
    const int r = fresh->start();
    if (r != 0) {
        *e = fail(ERR_IO, "libcamera: does not start: %s", strerror(-r));
        return nullptr;
    }
    manager = std::shared_ptr<lc::CameraManager>(fresh.release(), [](lc::CameraManager *m) {
        m->stop();
        delete m;
    });
    known = manager;
    return manager;
}

/* ---- unplugging ---- */

/* Whether a video node that this process (through libcamera) holds open has gone. */
bool node_gone()
{
    constexpr unsigned VIDEO_MAJOR = 81;
    bool gone = false;
    DIR *const all = opendir("/proc/self/fd");
    for (const dirent *e; all && !gone && (e = readdir(all));) {
        const int fd = atoi(e->d_name);
        struct stat is;
        v4l2_capability what;
        gone = fstat(fd, &is) == 0 && S_ISCHR(is.st_mode) && major(is.st_rdev) == VIDEO_MAJOR &&
               ioctl(fd, VIDIOC_QUERYCAP, &what) != 0 && errno == ENODEV;
    }
    if (all)
        closedir(all);
    return gone;
}

} // namespace

/* ---- a camera ---- */

struct libcamera_shim_camera {
    std::string name;
    std::shared_ptr<lc::CameraManager> manager;
    std::shared_ptr<lc::Camera> camera;
    std::unique_ptr<lc::CameraConfiguration> config;
    std::unique_ptr<lc::FrameBufferAllocator> allocator;
    std::vector<std::unique_ptr<lc::Request>> requests; // by cookie
    struct mapping {
        uint8_t *base;
        size_t bytes, offset;
        int fd;
    };
    std::vector<mapping> maps; // by cookie
    camera_info info{};
    class lens lens;
    frame_sync sync;
    double time_us = 0.0, gain = 1.0, step_us = 1.0;
    int64_t frame_us[2] = {0, 0};  // shortest, longest
    int cancelled = 0, event = -1; // cancelled: in a row
    bool acquired = false, started = false;
    std::string lost_why;

    /* One writer, libcamera's thread, and one reader. */
    std::array<lc::Request *, 2 * CAMERA_BUFFERS_MAX> ring{};
    std::atomic<unsigned> written{0}, read{0};
    std::atomic<bool> lost{false}, unplugged{false}; // unplugged: reported by libcamera

    void wake()
    {
        const uint64_t one = 1;
        if (write(event, &one, sizeof one) < 0) {
            // full: it is readable already
        }
    }

    void completed(lc::Request *r)
    {
        const unsigned at = written.load(std::memory_order_relaxed);
        ring[at % ring.size()] = r;
        written.store(at + 1, std::memory_order_release);
        wake();
    }

    void disconnected()
    {
        unplugged = true;
        lost = true;
        wake();
    }

    lc::Request *pop()
    {
        const unsigned at = read.load(std::memory_order_relaxed);
        if (at == written.load(std::memory_order_acquire))
            return nullptr;
        lc::Request *const r = ring[at % ring.size()];
        read.store(at + 1, std::memory_order_relaxed);
        return r;
    }

    ~libcamera_shim_camera()
    {
        for (int ms = 0; started && !unplugged && ms < NEWS_MS && node_gone(); ms += 10)
            poll(nullptr, 0, 10);
        if (started)
            camera->stop(); // cancels what is queued; fails when the camera is gone
        if (event >= 0) {
            camera->requestCompleted.disconnect(this);
            camera->disconnected.disconnect(this);
        }
        requests.clear();
        for (const mapping &m : maps)
            munmap(m.base, m.bytes);
        allocator.reset();
        if (acquired)
            camera->release();
        config.reset();
        camera.reset();
        if (event >= 0)
            close(event);
    }
};

namespace
{

using session = libcamera_shim_camera;

err_t lose_camera(session &s, const char *why)
{
    if (s.lost_why.empty())
        s.lost_why = why;
    s.lost = true;
    s.wake(); // and stays readable
    return fail(ERR_LOST, "libcamera: %s: %s", s.name.c_str(), s.lost_why.c_str());
}

/* ---- open, step by step ---- */

std::string model_of(const lc::Camera &camera)
{
    const auto model = camera.properties().get(lc::properties::Model);
    return model ? std::string(*model) : std::string();
}

err_t choose_camera(session &s, const std::string &wanted)
{
    std::string all;
    std::vector<std::shared_ptr<lc::Camera>> fit;
    for (const auto &c : s.manager->cameras()) {
        all += (all.empty() ? "" : ", ") + c->id();
        if (c->id() == wanted) {
            s.camera = c;
            return OK;
        }
        if (c->id().find(wanted) != std::string::npos ||
            model_of(*c).find(wanted) != std::string::npos)
            fit.push_back(c);
    }
    if (all.empty())
        return fail(ERR_LOST,
                    "libcamera: no camera is there, or the user is not in group \"video\";"
                    " sensors on ribbon cables also need the package libcamera-ipa");
    if (fit.empty())
        return fail(ERR_LOST, "libcamera: no camera is called \"%s\"; there are: %s",
                    wanted.c_str(), all.c_str());
    if (fit.size() > 1)
        return fail(ERR_ARG, "libcamera: \"%s\" means %zu cameras of: %s", wanted.c_str(),
                    fit.size(), all.c_str());
    s.camera = fit[0];
    return OK;
}

err_t acquire_camera(session &s)
{
    s.name = s.camera->id();
    const int r = s.camera->acquire();
    if (r == -EBUSY)
        return fail(ERR_BUSY, "libcamera: %s is used by another program", s.name.c_str());
    if (r != 0)
        return fail(code_of(r), "libcamera: %s cannot be had: %s", s.name.c_str(), strerror(-r));
    s.acquired = true;
    return OK;
}

/* Set the stream's format: the requested one, else the first of our table that the camera has. */
void want_format(lc::StreamConfiguration &stream, camera_format wanted)
{
    const auto has = stream.formats().pixelformats();
    const format *first = nullptr;
    for (const format &f : formats) {
        if (wanted == CAMERA_ANY ? is_raw(f.ours) : f.ours != wanted)
            continue;
        if (!first)
            first = &f;
        if (std::find(has.begin(), has.end(), f.theirs) != has.end()) {
            stream.pixelFormat = f.theirs;
            return;
        }
    }
    if (first)
        stream.pixelFormat = first->theirs;
}

/* Compare the validated stream with the request. */
err_t check_stream(const session &s, const lc::StreamConfiguration &stream,
                   const camera_cfg &wanted)
{
    const format *f = format_of(stream.pixelFormat);
    const int w = static_cast<int>(stream.size.width), h = static_cast<int>(stream.size.height);
    const bool other_size = (wanted.w > 0 && wanted.w != w) || (wanted.h > 0 && wanted.h != h);
    if (!f || other_size || (wanted.format != CAMERA_ANY && wanted.format != f->ours))
        return fail(ERR_UNSUPPORTED, "libcamera: %s gives %dx%d %s, which is not the request%s",
                    s.name.c_str(), w, h, stream.pixelFormat.toString().c_str(),
                    f ? "" : ", nor a format that this program reads");
    return OK;
}

err_t configure_stream(session &s, const camera_cfg &wanted)
{
    const auto role = is_raw(wanted.format) ? lc::StreamRole::Raw : lc::StreamRole::VideoRecording;
    s.config = s.camera->generateConfiguration({role});
    if (!s.config || s.config->empty())
        return fail(ERR_UNSUPPORTED, "libcamera: %s has no stream of the kind that is asked for",
                    s.name.c_str());
    lc::StreamConfiguration &stream = s.config->at(0);
    want_format(stream, wanted.format);
    if (wanted.w > 0 && wanted.h > 0)
        stream.size = lc::Size(static_cast<unsigned>(wanted.w), static_cast<unsigned>(wanted.h));
    stream.bufferCount = wanted.buffers > 0 ? static_cast<unsigned>(wanted.buffers) : 4;
    if (s.config->validate() == lc::CameraConfiguration::Invalid)
        return fail(ERR_UNSUPPORTED, "libcamera: %s refuses the size or format", s.name.c_str());
    const err_t e = check_stream(s, stream, wanted);
    if (e)
        return e;
    const int r = s.camera->configure(s.config.get());
    return r == 0 ? OK
                  : fail(code_of(r), "libcamera: %s cannot be configured: %s", s.name.c_str(),
                         strerror(-r));
}

/* Planes have to lie as camera.h says: one behind the other in one piece of memory. */
err_t map_buffer(session &s, const lc::FrameBuffer &buffer)
{
    const auto &planes = buffer.planes();
    size_t end = 0;
    for (size_t i = 0; i < planes.size(); i++) {
        if (planes[i].fd.get() != planes[0].fd.get() || (i > 0 && planes[i].offset != end))
            return fail(ERR_UNSUPPORTED, "libcamera: %s: plane %zu of a buffer lies apart",
                        s.name.c_str(), i);
        end = size_t{planes[i].offset} + planes[i].length;
    }
    const int fd = planes.empty() ? -1 : planes[0].fd.get();
    void *base = end > 0 ? mmap(nullptr, end, PROT_READ, MAP_SHARED, fd, 0) : MAP_FAILED;
    if (base == MAP_FAILED)
        return fail(ERR_IO, "libcamera: %s: a buffer of %zu bytes cannot be mapped: %s",
                    s.name.c_str(), end, strerror(errno));
    s.maps.push_back({static_cast<uint8_t *>(base), end, planes[0].offset, fd});
    return OK;
}

err_t allocate_buffers(session &s)
{
    lc::Stream *stream = s.config->at(0).stream();
    s.allocator = std::make_unique<lc::FrameBufferAllocator>(s.camera);
    const int r = s.allocator->allocate(stream);
    if (r <= 0)
        return fail(r == -ENOMEM ? ERR_NOMEM : ERR_IO, "libcamera: %s: no buffers: %s",
                    s.name.c_str(), strerror(-r));
    for (const auto &buffer : s.allocator->buffers(stream)) {
        if (s.requests.size() == CAMERA_BUFFERS_MAX)
            break;
        err_t e = map_buffer(s, *buffer);
        auto request = s.camera->createRequest(s.requests.size());
        if (!e && (!request || request->addBuffer(stream, buffer.get()) != 0))
            e = fail(ERR_NOMEM, "libcamera: %s: no request", s.name.c_str());
        if (e)
            return e;
        s.requests.push_back(std::move(request));
    }
    return OK;
}

void describe_stream(session &s, camera_stamp stamp)
{
    const lc::StreamConfiguration &stream = s.config->at(0);
    const format *f = format_of(stream.pixelFormat);
    camera_info &i = s.info;
    std::string unit = model_of(*s.camera) + ":" + s.name;
    for (char &c : unit)
        c = c > ' ' && c <= '~' ? c : '_';
    if (unit.size() >= CAMERA_UNIT_CAP) // the end tells cameras apart
        unit.erase(0, unit.size() - CAMERA_UNIT_CAP + 1);
    memcpy(i.unit, unit.c_str(), unit.size() + 1);
    i.w = static_cast<int>(stream.size.width);
    i.h = static_cast<int>(stream.size.height);
    i.format = f->ours;
    i.stride = f->ours == CAMERA_MJPG ? 0 : static_cast<int>(stream.stride);
    i.bits = f->bits;
    i.buffers = static_cast<int>(s.requests.size());
    i.exposure_delay = i.gain_delay = -1; // as many as are queued, and the sensor's
    i.stamp = stamp;
    i.ends_on_grid = true;
    if (stream.colorSpace) {
        i.limited = stream.colorSpace->range == lc::ColorSpace::Range::Limited;
        i.bt709 = stream.colorSpace->ycbcrEncoding == lc::ColorSpace::YcbcrEncoding::Rec709;
    }
}

/* Ranges of the controls. */
void describe_controls(session &s)
{
    camera_info &i = s.info;
    const auto *frame = find_control(*s.camera, "FrameDurationLimits");
    const auto *time = find_control(*s.camera, "ExposureTime");
    const auto *gain = find_control(*s.camera, "AnalogueGain");
    if (frame) {
        const double lo = number(frame->second.min(), 0.0), hi = number(frame->second.max(), 0.0);
        s.frame_us[0] = static_cast<int64_t>(std::max(lo, 1.0));
        s.frame_us[1] = std::max(static_cast<int64_t>(hi), s.frame_us[0]);
        if (s.sync.one_length())
            s.frame_us[1] = s.frame_us[0];
    }
    i.gain_max = gain ? std::max(number(gain->second.max(), 1.0), 1.0) : 1.0;
    if (!time)
        return;
    const double lo = std::max(number(time->second.min(), 1.0), 1.0);
    double hi = number(time->second.max(), lo);
    if (s.frame_us[1] > 1)
        hi = std::min(hi, static_cast<double>(s.frame_us[1]));
    i.time_min_s = lo * 1e-6;
    i.time_max_s = std::max(hi, lo) * 1e-6;
    s.time_us = std::clamp(START_S, i.time_min_s, i.time_max_s) * 1e6;
}

/* Controls of a request; null: those of the start. */
void put_controls(session &s, lc::ControlList &list, const lc::Request *request)
{
    for (const auto &[id, range] : s.camera->controls()) {
        for (const frozen &f : frozen_controls)
            if (id->name() == f.name && f.value >= number(range.min(), 0.0) &&
                f.value <= number(range.max(), 1.0))
                set_number(list, *id, f.value);
        if (id->name() == "ExposureTime")
            set_number(list, *id, s.time_us);
        else if (id->name() == "AnalogueGain" && s.info.gain_max > 1.0)
            set_number(list, *id, s.gain);
    }
    s.lens.put(list, request);
}

err_t queue_request(session &s, lc::Request *r)
{
    put_controls(s, r->controls(), r);
    const int why = s.camera->queueRequest(r);
    return why == 0 ? OK : lose_camera(s, why == -ENODEV ? "the camera has gone" : strerror(-why));
}

/* Queue a completed request again. */
err_t requeue(session &s, lc::Request *r)
{
    if (s.lost)
        return lose_camera(s, "the camera has gone");
    r->reuse(lc::Request::ReuseBuffers);
    return queue_request(s, r);
}

err_t start_camera(session &s)
{
    lc::ControlList list(s.camera->controls());
    put_controls(s, list, nullptr);
    s.sync.put(list);
    if (s.frame_us[1] > 0) {
        const std::array<int64_t, 2> limits = {s.frame_us[0], s.frame_us[1]};
        list.set(lc::controls::FrameDurationLimits, lc::Span<const int64_t, 2>(limits));
    }
    s.event = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (s.event < 0)
        return fail(ERR_IO, "libcamera: no eventfd: %s", strerror(errno));
    s.camera->requestCompleted.connect(&s, &session::completed);
    s.camera->disconnected.connect(&s, &session::disconnected);
    const int r = s.camera->start(&list);
    if (r != 0)
        return fail(code_of(r), "libcamera: %s does not start: %s", s.name.c_str(), strerror(-r));
    s.started = true;
    for (const auto &request : s.requests) {
        const err_t e = queue_request(s, request.get());
        if (e)
            return e;
    }
    return OK;
}

/* ---- frames ---- */

void sync_cpu(const session::mapping &m, uint64_t flags)
{
    dma_buf_sync sync = {};
    sync.flags = flags | DMA_BUF_SYNC_READ;
    if (ioctl(m.fd, DMA_BUF_IOCTL_SYNC, &sync) != 0) {
        // no dma-buf, or one without caches
    }
}

size_t bytes_needed(const camera_info &i)
{
    const size_t rows = static_cast<size_t>(i.stride) * static_cast<size_t>(i.h);
    return i.format == CAMERA_MJPG ? 4 : i.format == CAMERA_NV12 ? rows + rows / 2 : rows;
}

void fill_metadata(const session &s, const lc::ControlList &m, frame *out)
{
    const auto stamp = m.get(lc::controls::SensorTimestamp);
    const auto time = m.get(lc::controls::ExposureTime);
    const auto gain = m.get(lc::controls::AnalogueGain);
    const auto digital = m.get(lc::controls::DigitalGain);
    const auto colour = m.get(lc::controls::ColourGains);
    if (stamp && *stamp > 0)
        out->timestamp_ns = *stamp;
    out->timestamp_ns = monotonic(out->timestamp_ns);
    out->exposure_known = time && *time > 0;
    if (out->exposure_known)
        out->exposure = {*time * 1e-6, gain ? std::max(double{*gain}, 1.0) : 1.0};
    const auto lens = m.get(lc::controls::LensPosition);
    out->lens_known = lens.has_value();
    out->lens = lens ? double{*lens} : 0.0;
    out->gains_known = digital || colour;
    out->gains_later = is_raw(s.info.format);
    if (!out->gains_known)
        return;
    out->digital_gain = digital ? *digital : 1.0;
    out->red_gain = colour ? (*colour)[0] : 1.0;
    out->blue_gain = colour ? (*colour)[1] : 1.0;
}

void fill_frame(session &s, lc::Request *r, frame *out)
{
    const lc::FrameMetadata &m = r->buffers().begin()->second->metadata();
    const auto at = static_cast<size_t>(r->cookie());
    const session::mapping &map = s.maps[at];
    const auto &planes = m.planes();
    size_t bytes = 0;
    for (size_t i = 0; i < planes.size(); i++)
        bytes += planes[i].bytesused;
    sync_cpu(map, DMA_BUF_SYNC_START);
    out->data = map.base + map.offset;
    out->bytes = std::min(bytes, map.bytes - map.offset);
    out->w = s.info.w;
    out->h = s.info.h;
    out->stride = s.info.stride;
    out->format = s.info.format;
    out->sequence = m.sequence;
    out->timestamp_ns = static_cast<int64_t>(m.timestamp);
    out->flags = (m.status == lc::FrameMetadata::FrameError ? unsigned{FRAME_ERROR} : 0u) |
                 (out->bytes < bytes_needed(s.info) ? unsigned{FRAME_SHORT} : 0u);
    out->index = static_cast<int>(at);
    fill_metadata(s, r->metadata(), out);
}

/* A frame was cancelled while the stream runs: the pipeline handler timed out. */
err_t was_cancelled(session &s, lc::Request *r)
{
    if (++s.cancelled > s.info.buffers)
        return lose_camera(s, "the stream has stalled, frame after frame is cancelled");
    const err_t e = requeue(s, r);
    return e ? e : fail(ERR_IO, "libcamera: %s: a frame was cancelled", s.name.c_str());
}

err_t next(session &s, frame *out)
{
    *out = frame{};
    for (;;) {
        if (s.lost)
            return lose_camera(s, "the camera has gone");
        lc::Request *r = s.pop();
        if (!r) {
            uint64_t n;
            const bool had = read(s.event, &n, sizeof n) == sizeof n;
            if (s.lost) // between the look and the read
                continue;
            r = had ? s.pop() : nullptr;
        }
        if (!r)
            return ERR_AGAIN;
        const lc::FrameMetadata &m = r->buffers().begin()->second->metadata();
        const bool cancelled = r->status() == lc::Request::RequestCancelled ||
                               m.status == lc::FrameMetadata::FrameCancelled;
        s.lens.see(r, r->metadata(), cancelled);
        if (cancelled)
            return was_cancelled(s, r);
        s.cancelled = 0;
        if (!is_startup(m, 0)) {
            fill_frame(s, r, out);
            return OK;
        }
        const err_t e = requeue(s, r);
        if (e)
            return e;
    }
}

void release(session &s, frame *f)
{
    const auto at = static_cast<size_t>(f->index);
    if (!f->data)
        return;
    *f = frame{};
    sync_cpu(s.maps[at], DMA_BUF_SYNC_END);
    const err_t e = requeue(s, s.requests[at].get());
    (void)e; // next reports it
}

/* ---- facts that only a frame reports ---- */

void learn_from_frame(session &s, const frame &f, const lc::ControlList &m)
{
    camera_info &i = s.info;
    const auto black = m.get(lc::controls::SensorBlackLevels);
    const auto period = m.get(lc::controls::FrameDuration);
    i.reports = f.exposure_known;
    if (black && is_raw(i.format))
        i.black = (*black)[0] >> (16 - i.bits); // of 16 bits
    i.period_s = s.frame_us[0] > 1       ? 1e-6 * static_cast<double>(s.frame_us[0])
                 : period && *period > 0 ? 1e-6 * static_cast<double>(*period)
                                         : 0.0;
    if (!i.reports) { // a USB camera: gain codes are not factors, see v4l2_shutter.h
        i.gain_max = 1.0;
        s.step_us = UVC_STEP_US;
        i.time_step_s = UVC_STEP_US * 1e-6;
    }
}

/* Whether the period is known after n frames, of which the last two are these. The first interval
 * of a stream may be anything. */
bool know_period(session &s, int n, const frame &before, const frame &f)
{
    camera_info &i = s.info;
    const double step = 1e-9 * static_cast<double>(f.timestamp_ns - before.timestamp_ns);
    if (i.period_s <= 0.0 && n >= PERIOD_FRAMES)
        i.period_s = step > 0.0 && step < 10.0 ? step / std::max(f.sequence - before.sequence, 1u)
                                               : 1.0 / 30;
    if (i.period_s > 0.0 && i.time_max_s <= 0.0)
        i.time_min_s = i.time_max_s = i.period_s; // nothing can be asked for
    return i.period_s > 0.0;
}

err_t first_frame(session &s)
{
    const int64_t limit = now_ns(CLOCK_MONOTONIC) + int64_t{FIRST_FRAME_MS} * 1000000;
    frame f, before{};
    for (int n = 0;;) {
        const err_t e = next(s, &f);
        if (e == OK) {
            if (n++ == 0)
                learn_from_frame(s, f, s.requests[static_cast<size_t>(f.index)]->metadata());
            const bool done = know_period(s, n, before, f);
            before = f;
            release(s, &f);
            if (done)
                return OK;
            continue;
        }
        if (e == ERR_LOST)
            return e;
        const int64_t left = (limit - now_ns(CLOCK_MONOTONIC)) / 1000000;
        if (left <= 0)
            return fail(ERR_IO, "libcamera: %s gave no frame in %d s", s.name.c_str(),
                        FIRST_FRAME_MS / 1000);
        pollfd p = {s.event, POLLIN, 0};
        poll(&p, 1, static_cast<int>(left));
    }
}

err_t open_session(session &s, const libcamera_shim_cfg &cfg)
{
    err_t e = OK;
    s.manager = manager_get(&e);
    if (!e)
        e = choose_camera(s, cfg.camera);
    if (!e)
        e = acquire_camera(s);
    if (!e)
        e = s.lens.open(*s.camera, cfg.focus);
    if (!e)
        e = s.sync.open(*s.camera, cfg.sync);
    if (!e)
        e = configure_stream(s, cfg.wanted);
    if (!e)
        e = allocate_buffers(s);
    if (e)
        return e;
    describe_stream(s, cfg.stamp);
    describe_controls(s);
    e = start_camera(s);
    return e ? e : first_frame(s);
}

err_t ask_exposure(session &s, const exposure &requested, exposure *set)
{
    const camera_info &i = s.info;
    if (s.lost)
        return lose_camera(s, "the camera has gone");
    if (!(requested.time_s > 0.0 && requested.gain > 0.0 && std::isfinite(requested.time_s) &&
          std::isfinite(requested.gain)))
        return fail(ERR_ARG, "libcamera: %s: an exposure of %g s and gain %g", s.name.c_str(),
                    requested.time_s, requested.gain);
    if (!find_control(*s.camera, "ExposureTime"))
        return fail(ERR_UNSUPPORTED, "libcamera: %s has no control of its exposure",
                    s.name.c_str());
    const double lo = i.time_min_s * 1e6, hi = i.time_max_s * 1e6;
    const double us = std::clamp(requested.time_s * 1e6 + 1e-6, lo, hi);
    s.time_us = std::max(std::floor(us / s.step_us) * s.step_us, std::ceil(lo));
    s.gain = std::clamp(requested.gain, 1.0, i.gain_max);
    *set = {s.time_us * 1e-6, s.gain};
    return OK;
}

/* ---- table ---- */

err_t shim_open(const libcamera_shim_cfg *cfg, libcamera_shim_camera **out)
{
    *out = nullptr;
    return guarded([&] {
        auto s = std::make_unique<session>();
        const err_t e = open_session(*s, *cfg);
        if (!e)
            *out = s.release();
        return e;
    });
}

void shim_close(libcamera_shim_camera *c)
{
    delete c;
}

void shim_info(const libcamera_shim_camera *c, camera_info *out)
{
    *out = c->info;
}

int shim_fd(const libcamera_shim_camera *c)
{
    return c->event;
}

err_t shim_request(libcamera_shim_camera *c, const exposure *requested, exposure *set)
{
    return guarded([&] { return ask_exposure(*c, *requested, set); });
}

err_t shim_next(libcamera_shim_camera *c, frame *out)
{
    return guarded([&] { return next(*c, out); });
}

void shim_release(libcamera_shim_camera *c, frame *f)
{
    const err_t e = guarded([&] {
        release(*c, f);
        return OK;
    });
    (void)e;
}

err_t shim_focus(libcamera_shim_camera *c, bool again)
{
    return guarded([&] {
        return c->lost ? lose_camera(*c, "the camera has gone")
                       : c->lens.focus(c->name.c_str(), again, now_ns(CLOCK_MONOTONIC));
    });
}

const char *shim_text()
{
    return last_text;
}

} // namespace

extern "C" __attribute__((visibility("default"))) const libcamera_shim libcamera_shim_table = {
    LIBCAMERA_SHIM_STAMP, shim_text, shim_open,    shim_close, shim_info, shim_fd,
    shim_request,         shim_next, shim_release, shim_focus};
