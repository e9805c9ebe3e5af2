/* layout.h - sets as HDR-NeRF and HDR-GS publish them, and exposures that files of cameras hold.
 *
 * HDR-NeRF (real scenes): input_images/NNN_K.jpg, exposure K of view NNN, poses_bounds_exps.npy.
 * HDR-GS: the same with sparse/0, whose cameras count; synthetic scenes have images/N_K.png,
 * sparse/0, the radiance exr/N.exr, and the exposures 1/8, 1/2, 2, 8, 32, which its loader knows.
 * The views are, by their names, in turn inputs and held out: 18 and 17 of 35.
 * thread: any. */
#ifndef FORMAT_LAYOUT_H
#define FORMAT_LAYOUT_H

#include "core/base/types.h"

/* Whether the pictures of `dir` lie in this layout: poses_bounds_exps.npy or exr/ is beside them.
 * err:  ERR_ARG (path too long). */
MUST_USE err_t layout_is_bracketed(const char *dir, bool *out);

/* Keep the pictures of the inputs, or of the views that are held out; they are sorted by name. */
void layout_keep_half(bool inputs, struct capture *c);

/* Exposures by a file of cameras (rig, or if that is NULL transforms.json or poses_bounds_exps.npy
 * beside the pictures of `dir`), else by the layout of HDR-GS.
 * out:  *found: every picture has got one; else none has changed.
 * err:  those of rigfile_read. */
MUST_USE err_t layout_times(const char *dir, const char *rig, struct capture *c, bool *found);

#endif
