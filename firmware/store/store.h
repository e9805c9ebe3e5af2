/* store.h - takes on disk, each complete or not there (firmware/store/README.md).
 *
 *   STORE/counter                   the next number, replaced atomically
 *   STORE/BOOT8-NNNNNN/             BOOT8: first 8 digits of the boot id; NNNNNN: counter
 *     images/train_CC_EE.png|jpg    display pictures: camera CC, exposure EE; JPEG as it came
 *     exposure.json                 name to exposure, for `hdrig reconstruct --images`
 *     raw/CC_EE.bin                 bytes of the driver, unless they are the JPEG
 *     merged/CC.exr                 full brackets: parts e00.. and `merged`, exposure attributes;
 *                                   not there if that failed, which the manifest and the log say
 *     manifest.json                 everything known, sizes and SHA-256 of all files; written last
 *   STORE/aborted-BOOT8-NNNNNN/     the same for aborted takes: raw/ and manifest only
 *   STORE/session-ended           the session that was ended last (places.h)
 *   STORE/damaged-.../              takes that store_open found to differ from their manifest
 *
 * Written as .tmp-..., every file synced, then renamed with RENAME_NOREPLACE and the parent synced.
 * Removed in the opposite order: only the files of a take, and only a take without other files in
 * it. Numbers rise and are never used again, even if takes are removed.
 * thread: one; store_room and store_list from another one too. */
#ifndef STORE_STORE_H
#define STORE_STORE_H

#include "firmware/capture/take.h"

enum { STORE_ID_CAP = TAKE_ID_CAP };

#define STORE_SESSION_ENDED "session-ended"

struct store_config {
    const char *path;
    uint64_t reserve; // bytes of the file system that stay free
    bool merge;       // write merged/
    int keep;         // takes; the oldest complete ones beyond that are removed, and as many
                      // aborted ones are kept; those of the newest session stay; 0: all
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

/* Write a take and make it visible. After an error nothing of it is left (a disk that also refuses
 * the removal may show it, whole), older takes are unchanged, and the caller may try again.
 * out:  id, its folder's name.
 * err:  ERR_LIMIT (full), ERR_IO, ERR_ARG (a take that contradicts itself), ERR_NOMEM, those of
 *       unpack_run */
MUST_USE err_t store_commit(struct store *s, const struct take *t, char id[STORE_ID_CAP]);

/* Names of takes, aborted ones too, newest first; returns their number, at most cap. */
int store_list(const struct store *s, char (*ids)[STORE_ID_CAP], int cap);

/* The same for the folder of a store. thread: any, other processes too. */
int store_list_in(const char *path, char (*ids)[STORE_ID_CAP], int cap);

/* Number of a take by its name, [aborted-]BOOT8-NNNNNN; 0 if it is no name of one. */
uint64_t store_number(const char *name, bool *is_aborted);

/* Whether a take may have that name. */
bool store_is_id(const char *name);

/* Compare a take with its manifest: every file, size and hash.
 * err:  ERR_FORMAT names the file: missing, different, not listed; ERR_IO (cannot be read),
 *       ERR_NOMEM. */
MUST_USE err_t store_verify(const char *dir);

#endif
