/* calibrator.h - calibrates the daemon's cameras on command: one child process `hdrig calibrate`
 * per camera, one after the other. The daemon must have its cameras closed meanwhile.
 * thread: one. Nothing blocks but calibrator_close. */
#ifndef DAEMON_CALIBRATOR_H
#define DAEMON_CALIBRATOR_H

#include "firmware/base/child.h"
#include "firmware/base/config.h"
#include "firmware/daemon/ctl.h"

enum { CALIBRATOR_WAIT_S = 5 };

struct calibrator {
    const struct config *set; // cameras and calibration.path; given
    const char *config_path;  // for the child; NULL: none; given
    const char *program;      // hdrig; given
    struct ctl *ctl;          // given
    bool on, cancelled;
    bool done; // all are calibrated; the answer waits until they are open again
    int64_t done_ns;
    uint64_t id; // the client that asked
    int i;       // camera that is measured
    char what[16], longest[32];
    char line[CHILD_LINE]; // last line of the child
    char text[CHILD_LINE + 64];
    struct child child;
};

/* Take the order "calibrate [WHAT SECONDS]" (the options --what and --longest of hdrig calibrate)
 * of a client, which gets {"line": TEXT} for every line of the child, then the answer.
 * err:  ERR_ARG (words, no cameras), ERR_BUSY (another one runs) */
MUST_USE err_t calibrator_begin(struct calibrator *c, uint64_t id, const char *order);

void calibrator_cancel(struct calibrator *c);
int calibrator_poll(const struct calibrator *c, struct pollfd *fds, int cap); // at most CHILD_FDS
void calibrator_step(struct calibrator *c);                                   // start, listen, reap
/* Answer the client after the calibration, once the cameras are `armed` or CALIBRATOR_WAIT_S is
 * over, so that it can take a capture at once. now_ns: CLOCK_MONOTONIC. */
void calibrator_answer(struct calibrator *c, bool armed, int64_t now_ns);
const char *calibrator_sentence(struct calibrator *c); // its state in words
void calibrator_close(struct calibrator *c);           // ends the child

#endif
