/* bench_capture.h - measures whether this machine keeps up with a rig, by cameras that replay
 * pictures.
 * thread: the one of the command. */
#ifndef CMD_BENCH_CAPTURE_H
#define CMD_BENCH_CAPTURE_H

#include "firmware/base/config.h"
#include "firmware/result/report.h"

#include "core/base/err.h"

struct bench_capture {
    int cameras, w, h, takes, exposures;
    double fps;
    int frames, frames_most; // looked at, mean of the takes; the most of one
    int lost, rejected;      // in all takes
    double wait_s;           // waiting: share of one core that watching all cameras takes
    double wait_share;
    double take_s, take_share; // mean time of a take; share of one core during it
    double store_s;            // mean time of writing one, in the background
    double rss_mb;
};

/* err: those of session_open and store_open, ERR_CANCELLED */
MUST_USE err_t bench_capture_run(int cameras, const struct config *cfg, struct bench_capture *out);

void bench_capture_report(const struct bench_capture *b, struct report *rep);
void bench_capture_print(const struct bench_capture *b);

#endif
