/* store_media.h - computes display pictures and merged radiance from the frames of a take before it
 * is stored.
 * thread: any. */
#ifndef STORE_STORE_MEDIA_H
#define STORE_STORE_MEDIA_H

#include "firmware/capture/take.h"
#include "firmware/store/store_fs.h"

#include "core/base/types.h"
#include "core/photo/develop.h"
#include "core/photo/raw.h"

/* The numbers of a frame.
 * own:  free(out->px).
 * err:  ERR_FORMAT (it differs from its camera's format), ERR_NOMEM. */
MUST_USE err_t store_media_unpack(const struct take *t, const struct take_frame *f,
                                  struct raw *out);

/* One white balance for all mosaics of a take; 1 if there are none.
 * err:  ERR_FORMAT (a frame differs from its camera's format), ERR_NOMEM. */
MUST_USE err_t store_media_balance(const struct take *t, struct develop *out);

/* The display picture of a frame.
 * own:  img_free.
 * err:  those of unpack_run, ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t store_media_develop(const struct take *t, const struct take_frame *f,
                                   const struct develop *how, struct image8 *out);

/* Merge the frames of a camera that has several, without the pixels that moved: part `merged`,
 * then e00.. for each exposure, whole. Radiance is relative, 1 saturates in 1 s at gain 1; it is
 * the value in the file times hdrigRadianceScale, a power of two that brings nearly all values of
 * `merged` below 1.
 * err:  those of unpack_run and of writing. */
MUST_USE err_t store_media_merge(const struct store_fs *fs, const struct take *t, int camera,
                                 const struct develop *how, const char *path);

/* Upper bound of the bytes of `frames` exposures of that camera on the disk. */
uint64_t store_media_need(const struct camera_info *info, int frames, bool merge);

#endif
