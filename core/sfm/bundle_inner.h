/* bundle_inner.h - what the files of bundle adjustment share. */
#ifndef SFM_BUNDLE_INNER_H
#define SFM_BUNDLE_INNER_H

#include "core/sfm/adjust.h"
#include "core/sfm/bundle.h"
#include "core/sfm/viewgraph.h"

#include <math.h>

enum { BUNDLE_GATE = 4 }; // expected errors of an inlier

/* One candidate result. */
struct answer {
    double scale; // of the expected errors, at least 1
    struct adjust_lens *lens;
    double *pose, *point;
    bool *placed, *in;
    double score;
    bool from_tracks;
};

struct bundle {
    const struct run *r;
    const struct bundle_config *cfg;
    const struct match_tracks *tracks;
    const struct views *v;
    int n_views;
    struct adjust a;
    struct viewgraph g;
    bool *trusted; // (observations) after the votes; all without them
    float *sorted; // (observations)
    struct answer best;
    double scale;
    double margin;          // score of a better answer over that of the best
    struct bundle_lens one; // if the caller knows of none
    struct lens *start;     // (n_lenses) that the present attempt begins with
    struct selfcal_lens *selfcal;
};

/* Adjustment assumes square pixels: rows are scaled by the aspect. */
static inline float bundle_aspect(const struct bundle *b)
{
    return b->v->aspect > 0 ? b->v->aspect : 1;
}

static inline int bundle_turned(const struct bundle *b, int view)
{
    return b->cfg->turned ? b->cfg->turned[view] : 0;
}

/* Depth of the start where an observation is. */
static inline float bundle_depth_at(const struct bundle *b, const struct match_observation *s)
{
    const struct extent *px = &b->v->extent[s->view];
    const int x = (int)fminf(fmaxf(s->u, 0), (float)(px->w - 1));
    const int y = (int)fminf(fmaxf(s->v, 0), (float)(px->h - 1));
    return b->cfg->start_depth[px->at + (size_t)y * (size_t)px->w + (size_t)x];
}

/* Lenses as the first attempt knows them. */
MUST_USE err_t bundle_start_known(struct bundle *b);

/* Lenses of the usual focal lengths, where these are not sure; answers from there must be clearly
 * better than one that agrees with EXIF. False if it is the same start. */
bool bundle_start_usual(struct bundle *b);

/* All attempts expect a focal length that is known, else each the one it begins with. */
void bundle_start_expect(struct bundle *b, int lens);

/* Redundancy of the observations that are `in`, and of all; with `soft`, those near the gate count
 * less. */
double bundle_result_redundancy(const struct bundle *b, const bool *in, bool soft, double *all);

/* The pose of a camera that is turned clockwise by quarters about its axis. */
void bundle_result_turn(double pose[ADJUST_POSE], int quarters);

/* The best answer as a result whose arrays are there. */
MUST_USE err_t bundle_result_write(struct bundle *b, struct bundle_result *out);

#endif
