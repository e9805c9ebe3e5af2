/* match.h - the same points in several photographs of mixed exposure: corners, descriptors that do
 * not depend on exposure, matches that agree both ways and with one epipolar geometry, sub-pixel
 * positions, tracks over views. The network's attention narrows the search where there is one
 * (core/net/README.md 2.7).
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_MATCH_H
#define SFM_MATCH_H

#include "core/base/plan.h"
#include "core/base/types.h"
#include "core/sfm/division.h"

/* One point seen in one view. */
struct match_observation {
    int track, view; // sorted by track, then view; a track has a view at most once
    float u, v;      // px of the view, pixel centres at + 0.5
    float sigma;     // px, expected error, > 0
};

struct match_tracks {
    int n_tracks, n;               // tracks of 2 or more views; observations
    struct match_observation *obs; // (n)
};

/* Find tracks. lenses: NULL if the views are those of pinholes; else their bends are found, and
 * focal lengths where there are any. prior: of net_run for these views
 * (core/net/shared_attention.c), or NULL: places outside its attention count as less likely; where
 * its attention is flat it is ignored.
 * out:  lives in r->keep, at most MATCH_TRACKS_MAX tracks of MATCH_SEEN_MAX observations for up to
 *       PAIR_ALL views (pair.h), in proportion for more; 0 tracks if nothing agrees, and for one
 *       view or views below 64 px.
 * err:  ERR_NOMEM (see match_plan), ERR_CANCELLED. On error *out is zeroed. */
enum { MATCH_SEEN_MAX = 1 << 16, MATCH_TRACKS_MAX = 4000 };
MUST_USE err_t match_run(const struct run *r, const struct views *v,
                         const struct correspondence *prior, struct division_lenses *lenses,
                         struct match_tracks *out);

/* Count what match_run takes; of v only n, size and extent are read. out: most tracks and
 * observations. */
void match_plan(struct plan *p, const struct views *v, int n_lenses, struct match_tracks *out);

#endif
