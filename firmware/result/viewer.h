/* viewer.h - view.html: a scene in one page that opens from the disk, without network or server.
 * firmware/web/view.{html,css,js}, splats.js, light.js and tools.js, with the scene behind them.
 * thread: any. */
#ifndef RESULT_VIEWER_H
#define RESULT_VIEWER_H

#include "core/base/types.h"

enum {
    VIEWER_SPLATS_MAX = 1 << 22,   // that a page may hold
    VIEWER_SCENE_MAX = 256 << 20,  // bytes in the browser; SH bands beyond that are left out, the
                                   // highest first
    VIEWER_PHOTO_PIXELS = 1 << 26, // of all photographs, about: beyond that each place has fewer
                                   // exposures, but one
};

struct viewer_input {
    const struct scene *scene;
    const struct views *photos; // of the scene's places, to compare with; NULL: none
    const char *title;          // UTF-8
    const char *report;         // address of the report, relative; NULL: none
    bool lossless; // 32 bytes a splat and more (pagesplats.h); else those of pagepack.h
};

/* Upper bound of the file. */
uint64_t viewer_bytes(const struct viewer_input *in);

/* Bytes that viewer_write takes beside the scene. */
size_t viewer_plan(const struct viewer_input *in);

/* Splats that are never drawn (a number that is not finite, opacity below 1/255) are left out.
 * err:  ERR_ARG (more than VIEWER_SPLATS_MAX; a camera, exposure or tone curve that is not finite),
 *       ERR_IO, ERR_LIMIT (no space), ERR_NOMEM. The partial file is removed. */
MUST_USE err_t viewer_write(const char *path, const struct viewer_input *in);

#endif
