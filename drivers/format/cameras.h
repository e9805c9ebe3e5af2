/* cameras.h - known cameras by image name, and their file cameras.json:
 *   {"generator": "hdrig", "convention": "...", "unit": "m",
 *    "cameras": [{"name": "a.png", "w": 448, "h": 448, "fx": ..., "fy": ..., "cx": ..., "cy": ...,
 *                 "q": [w,x,y,z], "t": [x,y,z], "exposure_log2": ...,
 *                 "model": "OPENCV", "params": [...]}, ...]}
 * Units and axes are those of struct camera; "unit" is there if lengths are metres. "model" and
 * "params" (COLMAP's, core/base/lens.h) are there if the photographs are distorted, and then say
 * what fx, fy, cx, cy are. The views of a result are undistorted: there "photograph": {"w": ...,
 * "h": ..., "model": ..., "params": [...]} tells how the photograph of this view was taken.
 * "camera" names the physical camera, and "light": {"vignetting_stops": [v2, v4, v6], "gain_stops":
 * [r, g, b]} is what it does to light (core/photo/shade.h), if that is known. "deviation":
 * [degrees, share] has the standard errors of a calibrated pose, "covariance" that of its rotation
 * about the camera's axes, rad, and of its shift along them, lengths of the file: 21 numbers, by
 * row up to the diagonal. What all cameras do together is not in these (core/sfm/covariance.h).
 * Numbers have nine digits, params seventeen: written and read back they are the same.
 * thread: any. */
#ifndef FORMAT_CAMERAS_H
#define FORMAT_CAMERAS_H

#include "core/base/types.h"
#include "core/photo/shade.h"
#include "core/sfm/covariance.h"

#include <stdio.h>

enum { CAMERAS_MAX = 4096, CAMERAS_COVARIANCE = 21 }; // views of one set; numbers of a pose

#define CAMERAS_NOT_ROTATED 1e-3 // most that R R^T of a file may differ from the identity

struct rig_view {
    char name[NAME_CAP];
    struct camera cam; // pose; fx, fy, cx, cy, w, h of the photograph as taken
    struct lens lens;  // PINHOLE (0): cam says all
    bool has_exposure;
    float exposure_log2; // log2 of the linear exposure
    struct {
        int w, h; // 0: cam and lens are those of the photograph
        struct lens lens;
    } photograph;          // of which cam is the undistorted view
    char camera[NAME_CAP]; // physical camera; empty: not known
    bool has_light;
    struct shade_model light;
    bool has_deviation;
    float deviation[2]; // standard errors: of the rotation, degrees; of the centre, as a share of
                        // the distance to what it sees; >= 0
    bool has_covariance;
    float covariance[CAMERAS_COVARIANCE]; // lower triangle by rows, variances >= 0
};

/* Known cameras; no two have the same name. */
struct rig {
    int n;
    struct rig_view *views; // (n), malloc'd
    bool metres;            // lengths are metres; else the unit is any
    bool stored;            // they are those of the pictures as stored, not turned upright by EXIF
};

/* A picture whose camera is looked for. */
struct cameras_picture {
    const char *name;
    int w, h;        // px, upright
    int orientation; // by which its file says to turn it (img_orientation)
};

/* Read cameras.json. Unknown members are ignored; "exposure_log2" may be absent, "model" and
 * "params" too; with these two fx, fy, cx, cy may.
 * Checked: sizes 1 to 65536, everything finite, focal lengths > 0, |q| within 1e-3 of 1 (then
 * normalised), names by name_copy and distinct, model known, as many params as it has, at most
 * CAMERAS_MAX.
 * own:  cameras_free.
 * err:  ERR_IO, ERR_FORMAT, ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t cameras_read(const char *path, struct rig *out);

/* As cameras_read, from n bytes of text; `what` begins the sentence. */
MUST_USE err_t cameras_parse(const char *what, const void *text, size_t n, struct rig *out);

/* Write cameras.json; the partial file is removed on error.
 * err:  ERR_IO, ERR_LIMIT (no space). */
MUST_USE err_t cameras_write(const char *path, const struct rig *rig);

/* The photographs take the place of the views that were made from them. */
void cameras_use_photographs(struct rig *rig);

/* Whether cameras_find finds a view of this name.
 * err:  ERR_FORMAT: several that differ. */
MUST_USE err_t cameras_has(const char *what, const struct rig *rig, const char *name, bool *has);

/* Write one element of the list "cameras", without the comma behind it. */
void cameras_put(FILE *f, const struct rig_view *v);

/* Accepts a zeroed rig. */
void cameras_free(struct rig *rig);

/* Refuse a camera that the struct's comment does not allow, and normalise q; `what` and `name`
 * begin the sentence.
 * err:  ERR_FORMAT. */
MUST_USE err_t cameras_check(const char *what, const char *name, struct camera *cam);

/* Take a lens over into a view: intrinsics, and the lens itself if it distorts.
 * err:  ERR_FORMAT (numbers that lens_init refuses); `what` and `name` begin the sentence. */
MUST_USE err_t cameras_set_lens(const char *what, const char *name, struct lens *l,
                                struct rig_view *out);

/* Set how well a pose is known: covariance and deviation; neither if that is infinite.
 * unit:  lengths of the file of one of the covariance
 * depth: distance to what it sees, lengths of the file; 0: nothing */
void cameras_set_covariance(const double covariance[COVARIANCE_POSE], double unit, double depth,
                            struct rig_view *out);

/* Refuse two views of one name.
 * err:  ERR_FORMAT naming it, ERR_NOMEM. */
MUST_USE err_t cameras_check_names(const char *what, const struct rig *rig);

/* View of a picture: the view of exactly this name, else the one of the same view
 * (name_same_view), scaled if it was made for another size of the same aspect. If the picture is
 * turned by EXIF and the cameras are those of stored pictures, or fit the stored picture only, pose
 * and lens are turned with it.
 * err:  ERR_FORMAT: no such view, several that differ, another aspect, an orientation that mirrors.
 *       `what` begins the sentence. */
MUST_USE err_t cameras_find(const char *what, const struct rig *rig,
                            const struct cameras_picture *picture, struct rig_view *out);

#endif
