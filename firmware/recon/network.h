/* network.h - the network inside a job: a weights file that is open, the memory and the time of a
 * forward pass, and the way from its prediction to the start of a scene. */
#ifndef RECON_NETWORK_H
#define RECON_NETWORK_H

#include "core/net/net.h"
#include "drivers/format/file.h"
#include "drivers/format/modelfile.h"

struct network {
    struct modelfile file;
    struct net net; // points into file
};

/* precision: a word of modelfile.h that the file must have, or NULL. floats: NET_FLOAT_ bits.
 * own:  network_close.
 * err:  those of modelfile_open; ERR_ARG (another precision, weights of LPIPS). On error *out is
 *       zeroed. */
MUST_USE err_t network_open(const char *path, const char *precision, unsigned floats,
                            struct network *out);

/* Where the model lies that comes with this program: small.hdrig beside the program as it was
 * installed or built. False: it is not there. */
bool network_shipped(char path[FILE_PATH_CAP]);

/* Accepts a zeroed struct. */
void network_close(struct network *n);

/* Whether the photographs must have exposures: only the appearance branch looks at them. */
bool network_needs_exposures(const struct network *n);

/* ---- time ---- */

enum { NETWORK_STAGES = 16 };

struct network_stage {
    char name[24];
    double seconds, busy; // busy: processor time of all threads
};

/* Seconds of each stage that a progress_fn hears of. The time before a step belongs to the stage of
 * that step; before the first step of a stage, of which nothing is done, to the stage before. */
struct network_clock {
    progress_fn *next; // or NULL
    void *next_ctx;
    double last, last_busy; // last readings of the clocks
    int n;
    struct network_stage stage[NETWORK_STAGES]; // the present one is the last
};

/* A run whose steps are timed: r with clock in front of its progress. clock must outlive it. */
struct run network_timed(const struct run *r, struct network_clock *clock);

/* The time since the last step goes to its stage. */
void network_clock_stop(struct network_clock *clock);

/* Leave out that many seconds of wall time and of processor time. */
void network_clock_skip(struct network_clock *clock, double seconds, double busy);

/* Seconds of the stages whose name is in the list `names`, NULL at its end; processor time. */
double network_seconds(const struct network_clock *clock, const char *const *names);
double network_busy(const struct network_clock *clock, const char *const *names);

/* ---- cameras alone ---- */

/* Cameras of all views, their depth and, if attend, where patches are found in other views, without
 * Gaussians.
 * Views larger than those that the network was trained for are reduced: what comes of it is only a
 * start.
 * out:  geom.cams for v->size; depth and matches of the size that the network saw.
 * err:  those of prep_run and net_run; ERR_NOMEM (see network_look_plan). */
MUST_USE err_t network_look(const struct run *r, const struct network *n, bool attend,
                            const struct views *v, struct prediction *out);
void network_look_plan(struct plan *p, const struct network *n, bool attend, const struct views *v);

#endif
