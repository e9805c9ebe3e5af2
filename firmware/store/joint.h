/* joint.h - the take of a rig of many boards: collected in a staging folder of its conductor's
 * store, committed as one take of many cameras.
 *
 *   STORE/.rig-BOOT8-NNNNNN/        named by the id that store_reserve gave the take
 *     order.json                    what was ordered, the caller's text; written before the order
 *     boot_id                       of the conductor then
 *     MEMBER/                       that board's part: manifest.json, which comes first, and the
 *                                   files that it lists, under the same names; one that is being
 *                                   fetched has .part at the end of its name
 *
 * Cameras of the joint take are numbered over all members in the caller's order. Its files are
 * second names of those in the staging folder, or copies where the file system has no links. The
 * folder stays until the take is on the disk; store_open removes one that stayed longer.
 * thread: any, one at a time for each take; a store's own thread may store takes meanwhile. */
#ifndef STORE_JOINT_H
#define STORE_JOINT_H

#include "firmware/store/manifest.h"
#include "firmware/store/store.h"

#include "drivers/format/file.h"

enum { JOINT_ORDER_MAX = 64 << 10, JOINT_MEMBERS_MAX = MANIFEST_MEMBERS_MAX };

/* Make the staging folder, durably.
 * err:  ERR_ARG (id, length of the text), ERR_IO (also: it is there), ERR_LIMIT, ERR_NOMEM. After
 *       an error nothing of it is left. */
MUST_USE err_t joint_begin(struct store *s, const char *id, const char *text);

/* Put another text in the place of the order, durably. err: ERR_ARG, ERR_IO, ERR_LIMIT */
MUST_USE err_t joint_change(struct store *s, const char *id, const char *text);

/* Ids of staging folders whose takes do not exist yet, newest first; returns their number, at most
 * cap. */
int joint_pending(const char *store, char (*ids)[STORE_ID_CAP], int cap);

/* What was ordered.
 * own:  free. err: ERR_IO, ERR_FORMAT (longer than an order), ERR_NOMEM. On error *text is NULL. */
MUST_USE err_t joint_order(const char *store, const char *id, char **text);

/* Folder of a member's part. err: ERR_ARG (no id of a take, no name of a board) */
MUST_USE err_t joint_part_path(const char *store, const char *id, const char *member,
                               char out[FILE_PATH_CAP]);

/* Make that folder with those in it, as far as they are missing. err: ERR_ARG, ERR_IO, ERR_LIMIT */
MUST_USE err_t joint_part_make(struct store *s, const char *id, const char *member);

/* The same, with all files of a take of this store, for the part of the conductor itself.
 * err:  as joint_part_make; ERR_FORMAT, ERR_NOMEM (its manifest). */
MUST_USE err_t joint_part_own(struct store *s, const char *id, const char *member,
                              const char *part);

/* Files to fetch, by the manifest that was fetched.
 * out:  n, file[]: names, bytes, hashes; the rest is the part's, too.
 * err:  ERR_FORMAT (not that member's complete part of that take, or not as a take is), ERR_IO (no
 *       manifest yet), ERR_ARG, ERR_NOMEM. */
MUST_USE err_t joint_part_files(const char *store, const char *id, const char *member,
                                struct manifest *out);

/* A joint take. */
struct joint {
    const char *id;
    int n, n_missing;
    const char *const *member;  // in the order of their cameras
    const char *const *missing; // members without a part
    struct clocks trigger;
    bool clock_synced;
};

/* Compare all parts with their manifests, make the joint take of them, remove the staging folder.
 * After an error nothing of the take is left, and staging is as before; but a file of it that could
 * not be synced is removed, and has to be fetched again.
 * err:  ERR_FORMAT (names the part and what is wrong with it), ERR_IO (also: no manifest; the take
 *       exists), ERR_LIMIT (too many cameras; disk full), ERR_ARG (names), ERR_NOMEM. */
MUST_USE err_t joint_commit(struct store *s, const struct joint *j);

/* Remove the staging folder. OK if there is none. err: ERR_IO, ERR_LIMIT, ERR_ARG */
MUST_USE err_t joint_drop(struct store *s, const char *id);

#endif
