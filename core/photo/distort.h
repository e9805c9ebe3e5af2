/* distort.h - the way back from undistort.h: pictures that a pinhole sees become those that a lens
 * takes. Pure computation; any thread. */
#ifndef PHOTO_DISTORT_H
#define PHOTO_DISTORT_H

#include "core/base/lens.h"
#include "core/base/types.h"

#define DISTORT_ANGLE 75 // degrees from the axis; a pinhole shows no more

/* The pinhole that covers what a lens shows in w x h px, as sharp in the middle unless a side had
 * more than side_max px.
 * out:  w, h, fx, fy, cx, cy; the pose stays.
 * err:  ERR_ARG (a lens that shows nothing within DISTORT_ANGLE). */
MUST_USE err_t distort_camera(const struct lens *l, int w, int h, int side_max, struct camera *out);

/* Resample n planes (1 to 4) that the pinhole sees: linear, each pixel the mean of samples over its
 * square; 0 where the lens shows nothing or more than the pinhole.
 * pool: NULL = single thread.
 * in:   (n, pinhole->h, pinhole->w).
 * out:  (n, h, w), not `in`; seen: (h, w), 1 where all samples lie in the pinhole's frame, else 0;
 *       or NULL. */
struct distort_job {
    const struct lens *lens;
    const struct camera *pinhole;
    int n, w, h;
    const float *in;
    float *out;
    uint8_t *seen;
};
MUST_USE err_t distort_run(struct pool *pool, const struct distort_job *j);

#endif
