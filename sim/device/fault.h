/* fault.h - scripts of faults for simulated cameras. Errors name the line.
 *
 *   at frame N VERB [ARGUMENT ...]     from frame N of the sensor on, counted from 0
 *   at time S VERB [ARGUMENT ...]      from the first frame on that ends S seconds after open
 *   # comment
 *
 * Lines end with a newline or ';'. A script in a URI begins with "at "; anything else is a file.
 *
 *   drop K [nogap]        K frames are lost; with nogap the sequence numbers have no gap
 *   lose P                from now on each frame is lost with probability P, leaving a gap
 *   duplicate             the frame comes twice with the same sequence number
 *   repeat                the frame has the pixels of the one before, and new metadata
 *   error                 flagged as bad, its lower half black
 *   short B               B of its bytes are missing; its length shows it
 *   corrupt B             its last B bytes are noise; nothing reports it
 *   tear P                from now on, with probability P, 3 to 45 % of a frame's rows, at its top
 *                         or bottom, are those of the frame before; nothing reports it
 *   late S                delivered S seconds later
 *   stall K               no frames for K periods, no gap in the sequence; 0: for ever
 *   eio                   delivery fails once, the frame is lost
 *   index                 the driver names a buffer that does not exist; one buffer is lost with it
 *   unplug                the device is gone
 *   sequence stuck|wrap   the sequence number stays; it continues 2 below 2^32
 *   stamp zero|realtime|back S    from now on 0, by the wrong clock, S seconds too early
 *   stamp jump S          once: all later ones are S seconds later (or earlier)
 *   ignore K              K frames keep the exposure of the frame before; 0: for ever
 *   rollover K            exposure times count modulo K steps
 *   quantum S             only multiples of S seconds are exposed, at least one
 *   gain F                true gain drifts by the factor F each frame
 *   balance F             red and blue drift by F and 1 / F each frame
 *   digital F             pixels are multiplied by F
 *   refuse access|busy|range K    the next K requests fail; 0: all
 *   format                frames are half as wide and high from now on
 *
 * thread: any. */
#ifndef DEVICE_FAULT_H
#define DEVICE_FAULT_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum fault_verb {
    FAULT_DROP,
    FAULT_LOSE,
    FAULT_DUPLICATE,
    FAULT_REPEAT,
    FAULT_ERROR,
    FAULT_SHORT,
    FAULT_CORRUPT,
    FAULT_TEAR,
    FAULT_LATE,
    FAULT_STALL,
    FAULT_EIO,
    FAULT_INDEX,
    FAULT_UNPLUG,
    FAULT_SEQUENCE_STUCK,
    FAULT_SEQUENCE_WRAP,
    FAULT_STAMP_ZERO,
    FAULT_STAMP_REALTIME,
    FAULT_STAMP_BACK,
    FAULT_STAMP_JUMP,
    FAULT_IGNORE,
    FAULT_ROLLOVER,
    FAULT_QUANTUM,
    FAULT_GAIN,
    FAULT_BALANCE,
    FAULT_DIGITAL,
    FAULT_REFUSE_ACCESS,
    FAULT_REFUSE_BUSY,
    FAULT_REFUSE_RANGE,
    FAULT_FORMAT,
    FAULT_VERBS
};

enum { FAULT_MAX = 256, FAULT_TEXT_MAX = 1 << 16 };

struct fault {
    enum fault_verb verb;
    double number; // the argument; 0 if it has none
    bool nogap;    // for drop
    bool by_time;
    int64_t frame;   // if not by_time
    int64_t time_ns; // if by_time
};

struct fault_script {
    int n;
    struct fault v[FAULT_MAX]; // in the order of the lines
};

/* Parse n bytes of a script; messages begin with `what`.
 * err:  ERR_FORMAT, naming line, word and bounds. On error *out is empty. */
MUST_USE err_t fault_parse(const char *what, const char *text, size_t n, struct fault_script *out);

/* Read a script given in a URI: its text, or the name of a file.
 * err:  ERR_FORMAT, ERR_IO. */
MUST_USE err_t fault_read(const char *script, struct fault_script *out);

#endif
