/* visibility.h - what a view knows of a point, once there are depth maps.
 * Pure functions; any thread. */
#ifndef STEREO_VISIBILITY_H
#define STEREO_VISIBILITY_H

#include "core/stereo/sweep.h"

struct visibility {
    const struct depthmaps *depth;
    const struct camera *cams; // (n) for depth->size * depth->scale px, units of the depth
    float (*turn)[9];          // (n) their rotations, row by row
};

/* Where a view has a point. */
struct sighting {
    float u, v; // px of the view
    float z;    // depth of the point
    size_t at;  // index into the maps of the pixel there
};

/* Memory of *s, from `a`; then visibility_set. */
MUST_USE err_t visibility_layout(struct visibility *s, struct arena *a, int n_views);

/* Both must outlive *s; as many views as memory was made for. */
void visibility_set(struct visibility *s, const struct depthmaps *depth, const struct camera *cams);

/* Index into the maps of px (u, v) of the view, which is inside. */
size_t visibility_at(const struct visibility *s, int view, float u, float v);

/* The point at depth z behind px (u, v). */
void visibility_point(const struct visibility *s, int view, const float uvz[3], float out[3]);

/* False if the view does not have the point in its picture; then *out is not defined. */
bool visibility_look(const struct visibility *s, int view, const float point[3],
                     struct sighting *out);

/* Whether several views agree on the depth there (confidence of 0.6 and more). */
bool visibility_sure(const struct visibility *s, size_t at);

/* Whether the view is sure that the point is on what it sees, well before that, or well behind. */
bool visibility_same(const struct visibility *s, const struct sighting *p);
bool visibility_through(const struct visibility *s, const struct sighting *p);
bool visibility_behind(const struct visibility *s, const struct sighting *p);

#endif
