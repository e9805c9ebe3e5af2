/* store.h - takes on disk, each complete or not there (firmware/store/README.md).
 *
 *   STORE/counter                   the next number, replaced atomically
 *   STORE/BOOT8-NNNNNN/             BOOT8: first 8 digits of the boot id; NNNNNN: counter
 *     images/train_CC_EE.png|jpg    display pictures: camera CC, exposure EE; JPEG as it came
 *     masks/train_CC_EE.png         of frames in which something moved: 0 where (ghosts.h)
 *     thumbs/train_CC_EE.jpg        small copies of the pictures, for pages; any may be missing
 *     exposure.json                 name to exposure, for `hdrig reconstruct --images`
 *     raw/CC_EE.bin                 bytes of the driver, unless they are the JPEG
 *     merged/CC.exr                 full brackets: parts e00.. and `merged`, exposure attributes;
 *                                   not there if that failed, which the manifest and the log say
 *     manifest.json                 everything known, sizes and SHA-256 of all files; written last
 *   STORE/aborted-BOOT8-NNNNNN/     the same for aborted takes: raw/ and manifest only
 *   STORE/session-ended           the session that was ended last (places.h)
 *   STORE/damaged-.../              takes that store_open found to differ from their manifest
 *   STORE/.rig-BOOT8-NNNNNN/        a take of a rig of many boards, being collected (joint.h)
 *
 * Written as .tmp-..., every file synced, then renamed with RENAME_NOREPLACE and the parent synced.
 * Removed in the opposite order: only the files of a take, and only a take without other files in
 * it. Numbers rise and are never used again, even if takes are removed.
 * thread: one, the writer; store_room, store_list, store_reserve, store_release and joint.h from
 * another one too, meanwhile. */
#ifndef STORE_STORE_H
#define STORE_STORE_H

#include "firmware/capture/take.h"

enum { STORE_ID_CAP = TAKE_ID_CAP };

#define STORE_SESSION_ENDED "session-ended"

struct store_config {
    const char *path;
    uint64_t reserve; // bytes of the file system that stay free
    bool merge;       // write merged/
    double moved;     // share of a picture, beyond which movement between the exposures of a
                      // bracket becomes a sentence in the take's reason; 0: never
    int keep;         // takes; the oldest complete ones beyond that are removed, and as many
                      // aborted ones are kept; those of the newest session stay, and complete
                      // parts of a rig's takes, which do not count; 0: all
};

struct store;
struct store_fs;

/* Creates the folder, removes what a crash left, checks the last takes.
 * own:  store_close. err: ERR_IO (names path; read-only, no permission), ERR_BUSY (another process
 *       uses it), ERR_LIMIT (no space for the folder), ERR_ARG, ERR_NOMEM */
MUST_USE err_t store_open(const struct store_config *cfg, struct store **out);
void store_close(struct store *s); // accepts NULL

/* As store_open, on other file operations than the system's: firmware/store/store_fs.h. */
MUST_USE err_t store_open_on(const struct store_fs *fs, const struct store_config *cfg,
                             struct store **out);

/* Upper bound of the bytes of `frames` exposures of a camera on the disk. */
uint64_t store_need(const struct store *s, const struct camera_info *info, int frames);

/* Whether a take of that many bytes would fit.
 * err:  ERR_LIMIT with need, free and reserve. */
MUST_USE err_t store_room(const struct store *s, uint64_t bytes);

/* Compare the exposures of its brackets (ghosts.h), write a take and make it visible. After an
 * error nothing of it is left (a disk that also refuses the removal may show it, whole), older
 * takes are unchanged, and the caller may try again.
 * out:  id, its folder's name.
 * err:  ERR_LIMIT (full), ERR_IO, ERR_ARG (a take that contradicts itself), ERR_NOMEM, those of
 *       unpack_run */
MUST_USE err_t store_commit(struct store *s, struct take *t, char id[STORE_ID_CAP]);

/* Take the next number for a take that will be committed later by joint_commit. Durable; a number
 * that stays unused is a gap. thread: any.
 * out:  id of that take.
 * err:  ERR_LIMIT, ERR_IO. */
MUST_USE err_t store_reserve(struct store *s, char id[STORE_ID_CAP]);

/* A complete take that is the part of one board in a take of a rig, and waits for its conductor. */
struct store_part {
    char id[STORE_ID_CAP], rig_take[STORE_ID_CAP], rig_member[TAKE_MEMBER_CAP];
};

/* Parts in the folder of a store, newest first; returns their number, at most cap. Reads the
 * beginning of each manifest. thread: any, other processes too. */
int store_parts(const char *path, struct store_part *out, int cap);

/* Remove the parts of that take of the rig: the conductor has it. OK if there is none. thread: any.
 * err:  ERR_IO, ERR_LIMIT, ERR_FORMAT (a part has other files in it), ERR_NOMEM. */
MUST_USE err_t store_release(struct store *s, const char *rig_take);

/* Names of takes, aborted ones too, newest first; returns their number, at most cap. */
int store_list(const struct store *s, char (*ids)[STORE_ID_CAP], int cap);

/* The same for the folder of a store. thread: any, other processes too. */
int store_list_in(const char *path, char (*ids)[STORE_ID_CAP], int cap);

/* Number of a take by its name, [aborted-]BOOT8-NNNNNN; 0 if it is no name of one. */
uint64_t store_number(const char *name, bool *is_aborted);

/* Whether a take may have that name. */
bool store_is_id(const char *name);

/* Compare a take with its manifest: every file but thumbnails, size and hash.
 * err:  ERR_FORMAT names the file: missing, different, not listed; ERR_IO (cannot be read),
 *       ERR_NOMEM. */
MUST_USE err_t store_verify(const char *dir);

#endif
