/* fakecamera.h - how the libcamera that is played for tests behaves, and what it saw. The test
 * finds the struct by its name in the module that was built with it.
 * thread: the test's, before open; fields marked live through fakecamera_put at any time. */
#ifndef FAKECAMERA_FAKECAMERA_H
#define FAKECAMERA_FAKECAMERA_H

#include <stdbool.h>
#include <stdint.h>

enum { FAKECAMERA_CAMERAS = 3 };

struct fakecamera {
    int n_cameras;
    const char *id[FAKECAMERA_CAMERAS], *model[FAKECAMERA_CAMERAS];
    bool usb;          // no gain that counts, no exposure in the metadata
    bool uncontrolled; // no exposure at all
    bool apart;        // planes in different memory
    bool invalid;      // no configuration will do
    bool smaller;      // gives another size than was asked for
    bool unknown_format;
    bool syncs;    // its frames can be made to begin with those of others, where that is known
    bool lens;     // that can be moved, up to 10 dioptres
    int search;    // frames of a search, which ends at 3.25; 0: it cannot search
    bool in_vain;  // it finds nothing
    bool boottime; // stamps by the book; the machine has slept for 1000 s
    bool dark;     // nothing in its pictures, which come every 20 ms as it says
    int delay;     // frames from a request's controls to the first frame that shows them
    int startup;   // frames at the start that are not to be used, where that can be told
    int fail_manager, fail_acquire, fail_configure, fail_allocate, fail_start; // errno

    /* live */
    int cancel;     // so many of the next frames are cancelled
    int bad, cut;   // so many are bad, have fewer bytes
    int fail_queue; // errno
    int nudge;      // steps of the lens, 0.1 1/m
    int silent;     // no frames, and time flies
    int unplug;

    /* what was seen */
    int managers, acquired, buffers, running; // that are there now
    int wrong;                                // calls that libcamera forbids
    char what[128];                           // the last of them
    int frozen;                               // automatic controls switched off at the start
    int64_t frame_us[2];                      // FrameDurationLimits at the start
    double focus;                             // LensPosition as last set; < 0: never
    int searches;
    int sync; // SyncMode at the start
    unsigned frames;
};

#define FAKECAMERA_SYMBOL "fakecamera"
#define FAKECAMERA_PUT "fakecamera_put" // void (*)(int *field, int value)

#endif
