/* raw_take.h - takes as photographs of the sensor's own numbers, instead of their pictures.
 * thread: any. */
#ifndef STORE_RAW_TAKE_H
#define STORE_RAW_TAKE_H

#include "firmware/store/manifest.h"

#include "drivers/format/imageset.h"

/* The part of a manifest that says how its frames were taken. */
struct raw_take {
    int n_cameras, n;
    struct camera_info camera[MANIFEST_CAMERAS_MAX]; // format, w, h, stride, bits, black
    struct develop how;
    struct raw_take_frame {
        int camera;
        char raw[MANIFEST_NAME_CAP], picture[MANIFEST_NAME_CAP]; // in raw/ and in images/
    } frame[MANIFEST_FRAMES_MAX];
};

/* Read it from n bytes of the manifest of a complete take; `what` begins the sentence. Sizes and
 * levels are whole numbers, and no more; rawframe_check compares them with the files.
 * err:  ERR_FORMAT, ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t raw_take_parse(const char *what, const char *text, size_t n, struct raw_take *out);

/* Whether a folder of photographs is a take, or the pictures of one. */
bool raw_take_is(const char *images);

/* Gains of the manifest: digital and colour gains act behind numbers that are raw, else a take has
 * a digital gain of 1 (bracket.h); exposures have the analogue gain.
 *
 * Where every photograph of a set is a frame of a stored take, whose sensor gave linear numbers:
 * these are read instead of the pictures. Where such a take lacks one of them, or its file cannot
 * be right, the pictures of all are used, and a note of the set says why.
 * err:  ERR_NOMEM, ERR_ARG (path too long). */
MUST_USE err_t raw_take_attach(struct imageset *set);

#endif
