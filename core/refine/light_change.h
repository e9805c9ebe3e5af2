/* light_change.h - whether photographs were taken in two states of light: a lamp that is on in some
 * of them only, or the sun behind a cloud. Light that is added to a part of the place makes the
 * difference of two photographs vary over the picture, and only if they are of different states;
 * all else that is the same all over them (exposure, gain, brighter light of all lamps) does not.
 * Two groups of two photographs or more are found if photographs of one agree much better than
 * photographs of different groups by one camera, as near to each other and at exposures as similar,
 * and if neither group has the longer exposures: what a camera or its curve does, or gloss that
 * another place sees, is not taken for light. Nor is chance: groups that half of the squares tell
 * must differ in the other half, either way.
 * Pure computation, single thread. thread: any. */
#ifndef REFINE_LIGHT_CHANGE_H
#define REFINE_LIGHT_CHANGE_H

#include "core/base/types.h"

enum {
    LIGHT_CHANGE_VIEWS = 256, // at most
    LIGHT_CHANGE_SQUARES = 64 // of a view
};

/* A surface that two views show. */
struct light_change_seen {
    uint16_t view[2];
    uint16_t square; // of view[0] that it is in, below LIGHT_CHANGE_SQUARES
    float stops;     // log2 of its radiance in view[0] less that in view[1]
};

struct light_change_input {
    int n_views;
    const struct light_change_seen *seen; // (n) those of one pair, in this order, in a row
    int n;
    const struct camera *cams; // (n_views)
    const float *log2t;        // (n_views) exposures, where the response may be wrong; else NULL
    const int *camera;         // (n_views) numbers of physical cameras
};

/* Stops, root mean square, by which the difference of two photographs varies from square to square
 * beside its median. */
struct light_change {
    bool *other; // (n_views) of the caller: those of the smaller group; of two groups of one size,
                 // that of the last photograph
    int others;  // how many; 0: there is one group only
    double between, within; // medians over pairs of the best two groups, and the share of all
    double larger;          // comparisons of a pair between them with one within that it wins; 0:
                            // unknown
};

/* err: ERR_NOMEM (tmp, see light_change_plan). */
MUST_USE err_t light_change_find(const struct light_change_input *in, struct arena *tmp,
                                 struct light_change *out);

/* Bytes of tmp. */
size_t light_change_plan(int n_views, int n);

#endif
