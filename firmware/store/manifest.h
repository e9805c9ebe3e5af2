/* manifest.h - manifest.json of a take: everything that is known about it, with size and SHA-256 of
 * all its other files. 64-bit times are strings of nanoseconds, since JSON numbers would round
 * them. Unknown values are null.
 * thread: any. */
#ifndef STORE_MANIFEST_H
#define STORE_MANIFEST_H

#include "firmware/capture/take.h"

#include "core/base/rig.h"
#include "core/base/sha256.h"
#include "core/photo/develop.h"

#include <stdio.h>

#define MANIFEST_FILE "manifest.json"

enum {
    MANIFEST_NAME_CAP = 64,
    MANIFEST_CAMERAS_MAX = RIG_CAMERAS_MAX, // of a joint take (joint.h), on all its boards
    MANIFEST_FRAMES_MAX = MANIFEST_CAMERAS_MAX * BRACKET_EXPOSURES_MAX,
    MANIFEST_FILES_MAX = 4 * MANIFEST_FRAMES_MAX + MANIFEST_CAMERAS_MAX + 1,
    MANIFEST_MEMBERS_MAX = MANIFEST_CAMERAS_MAX,
    MANIFEST_ID_CAP = 32,
    MANIFEST_BOOT_CAP = 37 // a boot id of the kernel
};

struct manifest_file {
    char name[MANIFEST_NAME_CAP]; // from the folder of the take
    uint64_t bytes;
    char sha256[SHA256_HEX_CAP];
};

/* The part of a manifest that is not in struct take. */
struct manifest {
    char id[MANIFEST_ID_CAP], boot[MANIFEST_BOOT_CAP];
    char session[MANIFEST_ID_CAP]; // id of the first take of its session; "": none
    bool complete;                 // its status
    char rig_take[MANIFEST_ID_CAP], rig_member[TAKE_MEMBER_CAP]; // of a board's part; else ""
    int members;                                                 // of a joint take; else 0
    unsigned long long counter;
    char not_merged[TAKE_TEXT]; // why there is no merged/ although there should be; ""
    struct develop how;         // how display pictures were developed; zeroed: there are none
    int n;
    struct manifest_file file[MANIFEST_FILES_MAX];
};

/* Names of a frame's files. */
void manifest_raw_name(const struct take *t, const struct take_frame *f,
                       char out[MANIFEST_NAME_CAP]);
void manifest_picture_name(const struct take *t, const struct take_frame *f,
                           char out[MANIFEST_NAME_CAP]);

/* Camera and exposure of a display picture, by its name without the folder. False: it has none. */
bool manifest_picture_is(const char *name, int *camera, int *index);

void manifest_mask_name(int camera, int index, char out[MANIFEST_NAME_CAP]);
void manifest_thumb_name(int camera, int index, char out[MANIFEST_NAME_CAP]);

/* Whether a file is a thumbnail, which may be missing or damaged: pages show the picture then. */
bool manifest_is_thumb(const char *name);

/* Whether the driver's bytes are the display picture as well. */
bool manifest_is_jpeg(const struct take *t, const struct take_frame *f);

/* Word of a proof: "reported", "pixels", "unverified-flicker", "unverified-dark",
 * "unverified-bright". */
const char *manifest_proof(enum bracket_proof p);

/* Whether a board may have that name: 1 to 31 of a-z, 0-9 and '-', which does not come first. */
bool manifest_is_member(const char *name);

/* Errors are those of the stream. */
void manifest_write(FILE *f, const struct manifest *m, const struct take *t);

/* JSON of a joint take's manifest: value of "rig", elements of "cameras" and of "frames". */
struct manifest_lists {
    const char *rig, *cameras, *frames;
};

/* The same with these; of `head` counts what is neither a camera nor a frame. */
void manifest_write_joint(FILE *f, const struct manifest *m, const struct take *head,
                          const struct manifest_lists *lists);

/* Room that manifest_part needs at most. */
enum { MANIFEST_HEAD = 512 };

/* Whether the manifest that begins with these bytes is that of a board's part, without reading all
 * of it; for manifests that this program wrote.
 * out:  id of the rig's take and name of the board, if it is. */
bool manifest_part(const char *text, size_t n, char take[MANIFEST_ID_CAP],
                   char member[TAKE_MEMBER_CAP]);

/* Read back from n bytes of text; `what` begins the sentence. Known keys, each once; files lie in
 * images/, masks/, thumbs/, raw/, merged/ or beside, no name twice.
 * out:  id, boot, session, status, rig, counter and files.
 * err:  ERR_FORMAT, ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t manifest_parse(const char *what, const char *text, size_t n, struct manifest *out);

#endif
