/* triangulate.h - points of tracks for given cameras.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_TRIANGULATE_H
#define SFM_TRIANGULATE_H

#include "core/sfm/adjust.h"

/* Triangulate each track: the point that most of its observations in placed views agree on within
 * `gate` expected errors; these are `in`. Tracks with fewer than two of them have none in.
 * err:  ERR_CANCELLED. */
MUST_USE err_t triangulate_points(const struct run *r, struct adjust *a, double gate);

#endif
