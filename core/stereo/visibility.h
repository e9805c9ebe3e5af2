/* visibility.h - whether views see a point, by their depth maps.
 * Pure functions; any thread. */
#ifndef STEREO_VISIBILITY_H
#define STEREO_VISIBILITY_H

#include "core/stereo/sweep.h"

struct visibility {
    const struct depthmaps *depth;
    const struct camera *cams; // (n) of the views, units of the depth
    float (*rotation)[9];      // (n) their rotations, row by row
};

/* A point in the picture of a view. */
struct projected {
    float u, v; // px of the view
    float z;    // depth of the point
    size_t at;  // index into the maps of the pixel there
};

/* Allocate *s from `a`; then call visibility_set. */
MUST_USE err_t visibility_layout(struct visibility *s, struct arena *a, int n_views);

/* Both must outlive *s and have the number of views that was allocated. */
void visibility_set(struct visibility *s, const struct depthmaps *depth, const struct camera *cams);

/* Index into the maps of px (u, v), inside the view. */
size_t visibility_index(const struct visibility *s, int view, float u, float v);

/* The point at px (u, v) and depth z. */
void visibility_unproject(const struct visibility *s, int view, const float uvz[3], float out[3]);

/* Project a point into the picture of a view. False if it falls outside; then *out is undefined. */
bool visibility_project(const struct visibility *s, int view, const float point[3],
                        struct projected *out);

/* Whether the depth at an index is confirmed (SWEEP_CONF_CONFIRMED). */
bool visibility_confident(const struct visibility *s, size_t at);

/* Whether the depth there is confirmed and the point is on that surface, well in front of it, or
 * well behind it. */
bool visibility_on_surface(const struct visibility *s, const struct projected *p);
bool visibility_in_front(const struct visibility *s, const struct projected *p);
bool visibility_behind(const struct visibility *s, const struct projected *p);

#endif
