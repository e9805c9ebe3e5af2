/* imageset.h - a folder of photographs becomes a capture: names, exposures, cameras, then pixels.
 *
 * Layouts. `images` may be a folder that contains images/, the folder images/ itself, or a plain
 * folder of photographs. Pictures are its regular files *.png, *.jpg, *.jpeg, *.tif, *.tiff (any
 * case, not hidden); where it has none of these *.heic, *.heif; else *.dng, *.cr2, *.nef, *.arw;
 * else *.exr; in the order of their names. exposure.json, protocol.json and sparse/0 are
 * looked for beside the pictures, then one folder up; with no exposure.json the exposures come from
 * the pictures' EXIF, where all must have the same tags; where none has any, and names tell of no
 * brackets, all are taken to have one, and a note says so. A folder with names that begin with
 * "train" has the released layout: "train" pictures are inputs, "test" pictures are held out, and
 * train_ldr_000_2.png is exposure 2 of view train_ldr_000. In any other folder every picture is
 * an input, and a view of its own unless brackets finds that a camera stood still (brackets.h).
 * Other layouts with brackets are in layout.h; cameras may be in
 * transforms.json or poses_bounds_exps.npy instead of sparse/0, and exposures with them.
 *
 * Choice of exposures, unless every_exposure or brackets: the names that protocol.json gives for
 * this number of views (key "inputs"; input pictures only); else one exposure per view, in turn the
 * middle, the shortest and the longest of that view (t3, t1, t5 of five: the paper's set,
 * interleaved), and of the views n_views that are evenly spread. exposure_set limits this choice to
 * some of the times that the folder's pictures have, sorted; protocol.json is not read then.
 *
 * Several folders (`more`) are places of one scene, like the takes of one session: each has its
 * exposure.json, in one unit for all, and cameras are read only from a rig. The name of a shot then
 * is that of its folder and its own, FOLDER_NAME, also in the rig.
 * thread: any. */
#ifndef FORMAT_IMAGESET_H
#define FORMAT_IMAGESET_H

#include "drivers/format/file.h"
#include "drivers/format/physcam.h"

#include "core/base/types.h"

enum imageset_which { IMAGESET_TRAIN, IMAGESET_TEST, IMAGESET_ALL };

struct imageset_request {
    const char *images;        // folder
    const char *const *more;   // further folders and a NULL; NULL: none
    const char *exposures;     // file, NULL = exposure.json or EXIF
    const char *rig;           // any of rigfile.h, NULL = what rigfile_find finds
    enum imageset_which which; // of the released layout
    int n_views;               // 0 = all
    bool every_exposure;       // all exposures of the chosen views, without protocol.json
    bool brackets;             // all exposures of each view, unless protocol.json names pictures;
                               // which photographs are exposures of one view is looked for
    uint32_t exposure_set;     // bit k: the k-th shortest time of all may be used; 0 = every one
    bool may_lack_times;       // a picture without exposure has exposure 0, instead of an error
    bool no_cameras;           // neither rig nor sparse/0 are read
    bool some_cameras;         // pictures that the rig lacks are left out
    enum physcam_rule lenses;  // which photographs share a lens
};

enum { IMAGESET_NOTES = 4 };

struct imageset_part {
    char dir[FILE_PATH_CAP];
    int first;   // its shots begin here
    size_t skip; // bytes of a shot's name before the file name
};

struct imageset {
    char dir[FILE_PATH_CAP];    // of the pictures, the first of several
    int n_parts;                // 0: one folder
    struct imageset_part *part; // malloc'd
    struct rawframe *raw;       // malloc'd, of the shots that have one; NULL: none
    struct capture capture;     // shots malloc'd; image.px is NULL until imageset_load
    int n_unplaced;             // pictures that some_cameras left out
    int n_notes;
    char notes[IMAGESET_NOTES][240]; // sentences: files that look like pictures and are not read,
                                     // exposures that are taken for one
};

/* List everything but the pixels: names, exposures, cameras, and image.w and image.h from the
 * headers of the files (channels 3), so that memory can be planned before anything is decoded.
 * Photographs through lenses that distort are decoded as the pictures of the pinhole camera that
 * undistort_camera chooses; image and cam describe that picture. Contradictions are refused: a
 * picture without exposure where others have one, EXIF with f-number or ISO in some files only,
 * linear values beside display values (pixels.h), a rig that lacks a view or has another aspect
 * (cameras_find), a protocol that names a missing file.
 * own:  imageset_free.
 * err:  ERR_ARG (request, too few views, two folders of one name), ERR_IO, ERR_FORMAT (also: above
 *       CAMERAS_MAX pictures), ERR_UNSUPPORTED (rig), ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t imageset_list(const struct imageset_request *request, struct imageset *out);

/* Bytes of the pictures when at_a_time of them are held decoded, with the photographs that they are
 * undistorted from. */
size_t imageset_bytes(const struct capture *c, int at_a_time);

/* Decode the pixels of shot i, undistorted if its lens distorts; the set itself is not changed.
 * own:  img_free.
 * err:  those of img_read; ERR_FORMAT if the file changed its size since imageset_list. */
MUST_USE err_t imageset_decode(const struct imageset *set, int i, struct image8 *out);

/* The same as the photograph was taken, taken_w x taken_h px through its lens. */
MUST_USE err_t imageset_decode_taken(const struct imageset *set, int i, struct image8 *out);

/* The same for a shot of more than 8 bits, in 16 bits (pixels.h).
 * own:  pixels_free16. */
MUST_USE err_t imageset_decode16(const struct imageset *set, int i, struct image16 *out);

/* The mask (masks.h) of a masked shot, as the picture that imageset_decode gives, or
 * imageset_decode_taken: black where its pixels do not count, else white.
 * own, err:  as imageset_decode. */
MUST_USE err_t imageset_decode_mask(const struct imageset *set, int i, bool taken,
                                    struct image8 *out);

/* Decode every shot into the set.
 * err:  as imageset_decode; the set can still be freed. */
MUST_USE err_t imageset_load(struct imageset *set);

/* Accepts a zeroed set. */
void imageset_free(struct imageset *set);

#endif
