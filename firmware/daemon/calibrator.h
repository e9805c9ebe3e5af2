/* calibrator.h - the daemon's cameras calibrated on command: `hdrig calibrate` as a child process
 * for one camera after the other, because the daemon alone may open them. The cameras must be
 * closed meanwhile.
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
    bool done; // all are calibrated, which is answered when they are open again
    int64_t done_ns;
    uint64_t id; // of the client that asked
    int i;       // camera that is measured
    char what[16], longest[32];
    char line[CHILD_LINE]; // what the child said last
    char text[CHILD_LINE + 64];
    struct child child;
};

/* Take the order "calibrate [WHAT SECONDS]" (the options --what and --longest of hdrig calibrate)
 * of a client, who gets {"line": TEXT} for every line that the child says, then the answer.
 * err:  ERR_ARG (words, no cameras), ERR_BUSY (another one runs) */
MUST_USE err_t calibrator_begin(struct calibrator *c, uint64_t id, const char *order);

void calibrator_cancel(struct calibrator *c);
int calibrator_poll(const struct calibrator *c, struct pollfd *fds, int cap); // at most CHILD_FDS
void calibrator_step(struct calibrator *c);                                   // start, listen, reap
/* Answer a client whose cameras are calibrated, once these are `armed`, or did not get so in
 * CALIBRATOR_WAIT_S; who asked may take a capture then. now_ns: CLOCK_MONOTONIC. */
void calibrator_answer(struct calibrator *c, bool armed, int64_t now_ns);
const char *calibrator_sentence(struct calibrator *c); // what it does
void calibrator_close(struct calibrator *c);           // ends the child

#endif
