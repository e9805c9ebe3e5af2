/* undistort.h - a photograph taken through a lens becomes the picture of a pinhole, once, before
 * anything else sees it.
 *
 * The pinhole has the axis and the focal lengths of the lens, so the middle is as sharp as in the
 * photograph. Its frame is the photograph's, scaled about the principal point as far as every pixel
 * has a source (crop, no empty border) and none is stretched over more than UNDISTORT_STRETCH px:
 * first in both directions together, then in each. A fisheye that is linear in the angle so keeps
 * 120 degrees from corner to corner. A frame of more than UNDISTORT_ENLARGE times the photograph's
 * sides gets smaller focal lengths instead. Pure computation; any thread. */
#ifndef PHOTO_UNDISTORT_H
#define PHOTO_UNDISTORT_H

#include "core/base/lens.h"
#include "core/base/types.h"

enum { UNDISTORT_STRETCH = 4, UNDISTORT_ENLARGE = 2 };

/* The pinhole for photographs of w x h px through a lens.
 * out:  w, h, fx, fy, cx, cy; the pose stays. A lens without distortion is taken over as it is.
 * err:  ERR_FORMAT (a principal point outside the photograph, a lens that leaves less than a tenth
 *       of a side; `what` begins the sentence). */
MUST_USE err_t undistort_camera(const char *what, const struct lens *l, int w, int h,
                                struct camera *out);

/* The pinhole with square pixels and the photograph's longer edge, its principal point in the
 * middle, that shows as much as the photograph of w x h px covers, with the bound on stretching:
 * first in both directions together, then along the longer edge, so that the shorter one becomes
 * shorter.
 * out:  size, px across and down. returns: focal length, 0 if there is none. */
double undistort_frame(const struct lens *l, int w, int h, int size[2]);

/* Angles that a photograph shows across and down its middle, and what the pinhole keeps of them. */
struct undistort_field {
    double given_deg[2], kept_deg[2];
};

struct undistort_field undistort_field(const struct lens *l, int w, int h,
                                       const struct camera *pinhole);

/* Resample a photograph through a lens; each output pixel averages its footprint in the photograph.
 * Pictures by Keys' cubic (as prep.h), maps of radiance linearly: a cubic rings around lamps.
 * pool: NULL = single thread.
 * in:   as large as undistort_camera was told; 3 channels.
 * out:  (pinhole->h, pinhole->w, 3), image: (3, pinhole->h, pinhole->w); not `in`.
 * err:  those of the pool. */
MUST_USE err_t undistort_image8(struct pool *pool, const struct lens *l, const struct image8 *in,
                                const struct camera *pinhole, uint8_t *out);
MUST_USE err_t undistort_image16(struct pool *pool, const struct lens *l, const struct image16 *in,
                                 const struct camera *pinhole, uint16_t *out);
MUST_USE err_t undistort_image(struct pool *pool, const struct lens *l, const struct image *in,
                               const struct camera *pinhole, float *out);

#endif
