/* network.h - the network inside a job: a weights file that is open, the memory and the time of a
 * forward pass, and the way from its prediction to the start of a scene. */
#ifndef RECON_NETWORK_H
#define RECON_NETWORK_H

#include "core/net/net.h"
#include "core/splat/voxel.h"
#include "core/stereo/seed.h"
#include "drivers/format/file.h"
#include "drivers/format/modelfile.h"

struct network {
    struct modelfile file;
    struct net net; // points into file
};

/* precision: a word of modelfile.h that the file must have, or NULL. floats: NET_FLOAT_ bits.
 * own:  network_close.
 * err:  those of modelfile_open; ERR_ARG (another precision). On error *out is zeroed. */
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
    double last, last_busy; // of the clocks
    int n;
    struct network_stage stage[NETWORK_STAGES]; // the present one is the last
};

/* A run whose steps are timed: r with clock in front of its progress. clock must outlive it. */
struct run network_timed(const struct run *r, struct network_clock *clock);

/* The time since the last step goes to its stage. */
void network_clock_stop(struct network_clock *clock);

/* What has passed since then does not count. */
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

/* ---- from prediction to scene ---- */

/* The factor from the network's world to that of cameras that are known better, and p's geometry,
 * points and features moved to that world divided by the factor: sizes stay those that the network
 * knows. Pixels are unprojected anew, by these cameras.
 * cams: (n_views) for p->geom.size.
 * depth_scale: (n_views) factor of each view's depth, then the median is that of the world; NULL:
 *       the distances of the cameras say (similarity.h).
 * err:  ERR_NOMEM (r->tmp, see network_place_plan), ERR_CANCELLED. */
MUST_USE err_t network_place(const struct run *r, const struct camera *cams,
                             const float *depth_scale, struct prediction *p, float *scale);
void network_place_plan(struct plan *p, int n_views);

/* Leave views out: cameras, depth, points, Gaussians and depth_scale (n_views) of the others move
 * up; pose and matches do not. */
void network_drop(const bool *keep, float *depth_scale, struct prediction *p);

/* What is known by the time the cameras are. */
struct network_known {
    struct seed_input seen;     // one picture of each place with all that its exposures show, p's
                                // cameras, depth
    const struct views *views;  // what the network saw
    const struct tonemap *tone; // response of the camera
};

/* Where the photographs are sure, they overrule the network. Pixels of sure depth move there, the
 * others to where the views agree (consensus.h), all at the middle of the pixel and not at its
 * corner, as the network has it (core/net/README.md 2.11); Gaussians grow as their distance does,
 * so that they cover as many pixels as before, but with a standard deviation of one pixel at most.
 * A pixel that is neither black nor saturated has the photograph's radiance; others keep the
 * network's, under the known curve, which becomes p's, as far as this curve reaches.
 * Pixels are left out (their confidence is no number, see voxel_merge) where another view shows the
 * same surface and says more than twice as much about its radiance. Of a pixel whose depth is not
 * sure, every view may be that other one that has its point in the picture; it is also left out
 * where a view looks through it to what it is sure of, and where more views show another radiance
 * (by more than a stop) than the same.
 * Display colours (p->linear) stay as they are.
 * scale: of network_place.
 * err:  ERR_NOMEM (r->tmp, see network_sharpen_plan). */
MUST_USE err_t network_sharpen(const struct run *r, const struct network_known *known, float scale,
                               struct prediction *p);
void network_sharpen_plan(struct plan *p, int n_views, int size);

/* Gaussians of a prediction, merged (voxel.h). max: most of them, 0 = any number; the cell grows
 * from `cell` until they fit.
 * out:  memory in r->keep, see voxel_keep. *used: the cell.
 * err:  ERR_NOMEM (see voxel_plan), ERR_CANCELLED. */
MUST_USE err_t network_merge(const struct run *r, const struct prediction *p, float cell, int max,
                             struct voxels *out, float *used);

/* Make every length `scale` times as long. */
void network_scale(struct gaussians *g, float scale);

/* Display colours minus 0.5, as plain AnySplat gives them, become log radiance for the curve of
 * network_display_curve: exactly for the mean over all directions, to first order for the bands
 * above. What would be darker than 1/512 is that, without bands. */
void network_from_display(struct gaussians *g);

/* A curve that shows radiance as it is, 0..1, within 1/1000, at the middle exposure. */
void network_display_curve(float mid_log2t, struct tonemap *out);

#endif
