/* part.h - a board's part of a joint take, as it lies in the staging folder. What it says comes
 * from another machine: after part_read every number, name and count of it can be used.
 * thread: any. */
#ifndef STORE_PART_H
#define STORE_PART_H

#include "firmware/store/manifest.h"
#include "firmware/store/store_fs.h"

struct cJSON;

struct part_frame {
    int camera, index;
    double exposure_s;
    int64_t common_ns;
    char picture[MANIFEST_NAME_CAP];
};

struct part {
    struct manifest manifest;
    struct cJSON *doc;
    int n_cameras, n;
    struct part_frame frame[TAKE_FRAMES_MAX]; // by camera, then index
    bool is_mosaic;                           // of some camera
    struct develop how;
    int64_t within_ns; // the worst of the frames
    char clock[16], reason[TAKE_TEXT], not_merged[TAKE_TEXT];
    bool stagger, metered;
    double tolerance; // NAN: not known
    int frames_used, rejected;
};

/* Read the manifest in `dir`: of a complete take that is `member`'s part of the rig's take `id`,
 * and whose files have the names that a take gives them, none missing and none more.
 * own:  part_free.
 * err:  ERR_FORMAT, ERR_IO, ERR_NOMEM. On error there is nothing to free. */
MUST_USE err_t part_read(const struct store_fs *fs, const char *dir, const char *id,
                         const char *member, struct part *out);

/* The same of n bytes of text; `what` begins the sentence. */
MUST_USE err_t part_parse(const char *what, const char *text, size_t n, const char *id,
                          const char *member, struct part *out);
void part_free(struct part *p);

/* Name of a file of the part in the joint take, where `base` cameras come before its own. */
void part_rename(const char *name, int base, char out[MANIFEST_NAME_CAP]);

/* Elements of lists "cameras" and "frames" of the joint take, everything kept that the part says; a
 * comma comes before each if others do (base > 0). */
void part_put_cameras(FILE *f, const struct part *p, int base);
void part_put_frames(FILE *f, const struct part *p, int base);

#endif
