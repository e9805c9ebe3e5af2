/* similarity.h - the similarity transform between two worlds with the same cameras, up to
 * noise: scale, rotation, translation.
 * Pure computation; thread: any. */
#ifndef SFM_SIMILARITY_H
#define SFM_SIMILARITY_H

#include "core/base/types.h"

/* Scale of the world of `to` relative to that of `from`: median over pairs of views of the
 * ratio of the distances between their cameras. 1 if the cameras of one of them are all in one
 * place. err:  ERR_NOMEM (r->tmp, see similarity_plan). */
MUST_USE err_t similarity_scale(const struct run *r, const struct camera *from,
                                const struct camera *to, int n_views, float *out);

/* Bytes that similarity_scale takes from r->tmp. */
size_t similarity_plan(int n_views);

/* Rotation, row-major, that takes directions of the world of `from` to that of `to`, where both are
 * the same camera. */
void similarity_rotation(const struct camera *from, const struct camera *to, float out[9]);

/* A similarity between two worlds: x_to = scale R(q) x_from + t. */
struct similarity {
    double scale, q[4], t[3]; // q: w,x,y,z, unit
};

/* The similarity that takes the cameras `from` to the cameras `to` of the same n_views >= 1
 * pictures: scale of similarity_scale, then the rotation and the translation of the centres with
 * the least sum of distances from those of all cameras: a few wrong cameras move them little.
 * err:  ERR_NOMEM (r->tmp, see similarity_plan). */
MUST_USE err_t similarity_fit(const struct run *r, const struct camera *from,
                              const struct camera *to, int n_views, struct similarity *out);

/* The same camera in the other world. */
struct camera similarity_apply(const struct similarity *w, const struct camera *cam);

#endif
