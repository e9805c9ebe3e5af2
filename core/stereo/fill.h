/* fill.h - what the completion branch of the network (core/net/complete.h) is told about a view,
 * and its answer taken into the depth maps.
 * Pure computation; thread: any, a workspace belongs to one at a time. */
#ifndef STEREO_FILL_H
#define STEREO_FILL_H

#include "core/stereo/guess.h"
#include "core/stereo/visibility.h"

#include "core/photo/response.h"

/* What is known of a pixel. Inverse depth is in log2 over the median of what is usable in the view,
 * halved; light in log2 over its median, a third. */
enum {
    FILL_LIGHT,      // 3: radiance
    FILL_WEIGHT = 3, // of the light, 0: black, saturated or masked .. 1: accurate
    FILL_USABLE,     // 1: stereo has a usable depth
    FILL_CONF,       // confidence of stereo
    FILL_STEREO,     // inverse depth of stereo
    FILL_FAR,        // 1: sees what is infinitely far
    FILL_GUESS,      // inverse depth of guess_smooth
    FILL_RAY,        // 2: x / z and y / z of the ray
    FILL_SEEN = 11,  // share of four other views that have the guess in their picture
    FILL_NEAREST,    // inverse depth of the nearest confirmed point that other views have here,
    FILL_FARTHEST,   // of the farthest one; 0: none has
    FILL_OTHERS,     // share of four such points
    FILL_INPUT
};

struct fill {
    const struct views *views;     // with cameras; those of the maps
    const struct depthmaps *depth; // from sweep_run and far_run
    struct response_table table;
    struct guess_work guess;
    struct visibility vis;
    float *rho;  // (pixels of the largest map) inverse depth of guess_smooth
    float *sort; // as many
    bool sky;    // of fill_look_for_sky
};

/* Memory for any of n maps.
 * err:  ERR_NOMEM. */
MUST_USE err_t fill_layout(struct fill *f, struct arena *a, const struct extent *maps, int n);

/* All must outlive *f. */
void fill_set(struct fill *f, const struct views *v, const struct tonemap *tone,
              const struct depthmaps *depth);

/* What is known of a view. out: (h, w, FILL_INPUT) of its map. f->rho is that of the view then. */
void fill_input(struct fill *f, int view, float *out);

/* What the branch says of a pixel. */
enum {
    FILL_RESIDUAL, // log2 of the inverse depth over guess_smooth
    FILL_SPREAD,   // natural logarithm of b of a Laplace distribution of that residual
    FILL_IS_FAR,   // logit: it sees what is infinitely far
    FILL_ANSWER
};

/* Whether the branch may tell what is sky: not where it says so of so few pixels that they are
 * lamps or windows. answer: (FILL_ANSWER) of the maps of all views. */
void fill_look_for_sky(struct fill *f, const float *answer);

/* Take it into the maps where stereo is not sure, after fill_input of all views and
 * fill_look_for_sky.
 * answer: (h, w, FILL_ANSWER) of the map of the view. d: that of fill_set.
 * returns: the number of pixels that changed. */
size_t fill_take(struct fill *f, int view, const float *answer, struct depthmaps *d);

#endif
