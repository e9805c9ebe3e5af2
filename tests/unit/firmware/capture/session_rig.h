/* session_rig.h - simulated cameras for tests of sessions, and what the simulator says of every
 * frame. Tests keep time by the cameras' own clock where they can (clock=virtual). */
#ifndef CAPTURE_SESSION_RIG_H
#define CAPTURE_SESSION_RIG_H

#include "firmware/capture/session.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* What the simulator gave to a frame. A camera that is opened again counts anew: of several
 * lines for one sequence number and time, the one that fits best is taken. */
struct rig_truth {
    bool found;
    double exposure_s, torn; // time x gain; share of its rows
    int64_t start_ns;        // of its exposure
};

static inline struct rig_truth rig_truth(int camera, const struct take_frame *frame)
{
    struct rig_truth out = {0};
    char name[32], line[256];
    snprintf(name, sizeof name, "truth%d", camera);
    FILE *f = fopen(tmpdir_path(name), "r");
    while (f && fgets(line, sizeof line, f)) {
        unsigned sequence;
        long long ns, number, start;
        double time, gain, torn;
        int n = sscanf(line, "%u %lld %lld %lf %lf %lf %lld", &sequence, &ns, &number, &time, &gain,
                       &torn, &start);
        bool same =
            n == 7 && sequence == frame->evidence.sequence && ns == frame->evidence.timestamp_ns;
        double off = fabs(take_exposure_s(frame) - time * gain);
        if (same && (!out.found || off < fabs(take_exposure_s(frame) - out.exposure_s)))
            out = (struct rig_truth){true, time * gain, torn, start};
    }
    if (f)
        fclose(f);
    return out;
}

/* Whatever waits; a camera in real time has 20 ms. */
static inline err_t rig_turn(struct session *s)
{
    struct pollfd p[BRACKET_CAMERAS_MAX];
    int64_t deadline;
    int n = session_poll(s, p, BRACKET_CAMERAS_MAX, &deadline);
    poll(p, (nfds_t)n, 20);
    return session_step(s);
}

#endif
