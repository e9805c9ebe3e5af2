/* camera.h - one camera that streams frames and takes exposure requests: what every backend offers.
 * A backend is one constant table, camera_NAME (`camera_sim`, `camera_replay`, `camera_v4l2`, ...).
 *
 * Life: open, then any order of request, next, release, then close. The camera streams from open to
 * close. A request never names a frame: controls take effect some frames later. The capture code
 * therefore labels frames by evidence, and a frame carries every report of the device.
 * `info.exposure_delay` and `gain_delay` are what the device promises, not proof.
 *
 * thread: one, the same from open to close. No call but open and close blocks. */
#ifndef DEVICE_CAMERA_H
#define DEVICE_CAMERA_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { CAMERA_BUFFERS_MAX = 32 };

enum camera_format {
    CAMERA_ANY,    // as a request only: the format that the backend does best
    CAMERA_RGB8,   // R,G,B
    CAMERA_BGR8,   // B,G,R
    CAMERA_YUYV,   // Y0 U Y1 V
    CAMERA_NV12,   // Y plane, then (h/2) rows of Cb,Cr pairs, same stride
    CAMERA_MJPG,   // a JPEG file; stride 0
    CAMERA_GREY,   // 8 bits
    CAMERA_GREY16, // 16-bit little-endian words, `bits` low bits used
    CAMERA_RGGB16, // Bayer mosaic in such words
    CAMERA_BGGR16,
    CAMERA_GRBG16,
    CAMERA_GBRG16,
    CAMERA_RGGB10P, // MIPI: 4 px in 5 bytes, bits 9..2, then the low pairs, px 0 in bits 1:0
    CAMERA_BGGR10P,
    CAMERA_GRBG10P,
    CAMERA_GBRG10P,
    CAMERA_RGGB12P, // MIPI: 2 px in 3 bytes, bits 11..4 each, then px 0 in the low nibble
    CAMERA_BGGR12P,
    CAMERA_GRBG12P,
    CAMERA_GBRG12P,
    CAMERA_FORMATS
};

struct camera_cfg {
    const char *uri;           // "BACKEND:rest"; the backend parses the rest
    int w, h;                  // px wanted; 0: the backend's own
    enum camera_format format; // wanted
    int buffers;               // wanted, 1..CAMERA_BUFFERS_MAX; 0: 4
};

/* Shutter and gain of a frame. */
struct exposure {
    double time_s; // > 0
    double gain;   // analogue, >= 1
};

enum camera_stamp { CAMERA_STAMP_START, CAMERA_STAMP_END }; // when the first row is exposed

enum { CAMERA_UNIT_CAP = 128 }; // bytes with the terminating 0

/* Facts that hold from open to close. */
struct camera_info {
    char unit[CAMERA_UNIT_CAP]; // this very device, the same after replugging: with size and format
                                // it names a calibration; printable, without spaces
    int w, h, stride;           // px; bytes from row to row
    enum camera_format format;  // never CAMERA_ANY
    int bits, black;            // mosaics: used bits, black level; else 8, 0
    int buffers;                // frames that may be held and waiting together
    double period_s;            // between frames whose exposure fits into it
    double time_min_s, time_max_s;
    double time_step_s;             // exposure times are rounded down to multiples; 0 not known
    double gain_max;                // 1: cannot be changed
    int exposure_delay, gain_delay; // frames from the one that runs during a request to the first
                                    // that shows it; -1 not known
    enum camera_stamp stamp;        // what timestamp_ns means
    bool ends_on_grid;              // exposures end one frame after the other, as where a shutter
                                    // runs ahead of readout: shorter ones begin later; else all
                                    // begin so
    bool reports;                   // frames say their exposure
    bool chooses;                   // it has few exposures: its answer to a request is right,
                                    // however far from it
    bool limited, bt709;            // YUV: 16..235 instead of 0..255; its matrix, else BT.601
};

enum {
    FRAME_ERROR = 1, // the device says that the pixels are bad
    FRAME_SHORT = 2, // fewer bytes than the format needs
};

/* A filled buffer of the driver. It belongs to the caller until release. */
struct frame {
    const uint8_t *data;
    size_t bytes;     // valid ones; those beyond are from some older frame
    int w, h, stride; // px, bytes; of this frame: compare with camera_info
    enum camera_format format;
    uint32_t sequence;    // counts frames, also lost ones; some devices get this wrong
    int64_t timestamp_ns; // CLOCK_MONOTONIC, see camera_info.stamp; 0: not known
    unsigned flags;       // FRAME_*
    bool exposure_known;  // the device says what this frame was exposed with:
    struct exposure exposure;
    bool gains_known; // the device says what it multiplied the pixels with:
    bool gains_later; // ... or will, behind these: they are raw
    double digital_gain, red_gain, blue_gain;
    bool lens_known; // the device reports the position of its lens:
    double lens;     // 1/m, or the device's units; see its option focus=
    int index;       // which buffer, for the backend
};

struct camera_ops {
    const char *name; // BACKEND of the URI
    size_t state_bytes;

    /* Open the device and start streaming. st: state_bytes, any content, aligned as malloc does.
     * own:  close; on error there is nothing to close.
     * err:  ERR_ARG (URI: the sentence names key and bound), ERR_UNSUPPORTED (size, format),
     *       ERR_LOST (no such device now; try again later), ERR_BUSY (used by another program),
     *       ERR_IO, ERR_FORMAT (files that the URI names), ERR_NOMEM */
    MUST_USE err_t (*open)(void *st, const struct camera_cfg *cfg);

    /* Stops streaming and frees; frames that are held become invalid. Works after ERR_LOST. */
    void (*close)(void *st);

    void (*info)(const void *st, struct camera_info *out);

    /* Readable when next has a frame or an error; sometimes in vain. Constant. */
    int (*fd)(const void *st);

    /* Ask for an exposure from as early a frame on as possible. Time is rounded down to the
     * device's steps, time and gain are limited to its range.
     * out:  *set: the setting in force, read back where the device allows it.
     * err:  ERR_ARG (not finite or not positive; or the device calls it out of range), ERR_BUSY
     *       (later), ERR_UNSUPPORTED (the control is not ours, an automatic mode has it), ERR_IO,
     *       ERR_LOST. On error *set is not changed, and neither are coming frames. */
    MUST_USE err_t (*request)(void *st, const struct exposure *requested, struct exposure *set);

    /* Lengthen one coming frame, once, by `seconds` (0..period), so that later frames start that
     * much later; 0 s asks whether that is possible. NULL: the device cannot.
     * out:  *shift: what was set, rounded to its steps.
     * err:  ERR_UNSUPPORTED, ERR_BUSY (later), ERR_IO, ERR_LOST. On error nothing is changed. */
    MUST_USE err_t (*shift)(void *st, double seconds, double *shift);

    /* The oldest frame that waits.
     * own:  release.
     * err:  ERR_AGAIN (none; also when the caller holds all buffers), ERR_IO (a frame could not be
     *       had, the next one may), ERR_LOST (device gone: close). On error *out is zeroed. */
    MUST_USE err_t (*next)(void *st, struct frame *out);

    /* Give a frame back and zero it. Accepts a zeroed frame. */
    void (*release)(void *st, struct frame *f);

    /* The search of focus=once: begins one if `again`, or if none has found a focus since open, and
     * is then called without `again` until it is over. Frames go on coming. After OK the lens stays
     * until the next search. NULL, or OK at once: nothing is to be searched.
     * err:  ERR_AGAIN (searches), ERR_TIMEOUT (found none), ERR_IO, ERR_BUSY, ERR_LOST */
    MUST_USE err_t (*focus)(void *st, bool again);

    /* Present time, ns, of a camera that stamps frames with a clock of its own. Waits and ages are
     * measured by it, so that a simulation does not depend on the speed of the machine. NULL, or a
     * result of 0: CLOCK_MONOTONIC. */
    int64_t (*now)(const void *st);
};

extern const struct camera_ops camera_v4l2, camera_libcamera;
extern const struct camera_ops camera_sim, camera_replay; // in sim/

#endif
