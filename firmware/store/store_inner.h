/* store_inner.h - what the files of the store share: store.c, store_commit.c, store_check.c,
 * store_files.c, store_keep.c, and joint.c, which makes one take of many. */
#ifndef STORE_STORE_INNER_H
#define STORE_STORE_INNER_H

#include "firmware/store/manifest.h"
#include "firmware/store/store.h"
#include "firmware/store/store_fs.h"

#include "drivers/format/file.h"

#include <dirent.h>
#include <pthread.h>

#define STORE_TMP ".tmp-"
#define STORE_ABORTED "aborted-"
#define STORE_RIG ".rig-" // staging folder of a joint take
#define STORE_RIG_ORDER "order.json"
#define STORE_RIG_BOOT "boot_id"
#define STORE_RIG_PART ".part" // end of the name of a file that is being fetched

enum { STORE_FOLDERS = 6 };
extern const char *const store_folders[STORE_FOLDERS]; // of a take; the first is the take, ""

struct store {
    const struct store_fs *fs;
    char path[FILE_PATH_CAP];
    struct store_config cfg;
    int fd; // the folder, locked
    char boot[MANIFEST_BOOT_CAP];
    struct manifest manifest; // the take that store_commit writes: of its thread
    pthread_mutex_t lock;     // of what follows, and of removing takes
    uint64_t next, kept;      // kept: the newest take that was found not to be removable
    struct manifest old;      // a take that is checked
};

/* ---- store.c ---- */

/* A take found in a folder. */
struct store_entry {
    uint64_t number;
    bool is_aborted;
    char id[STORE_ID_CAP];
};

/* The next folder of a take, in any order; of those with `prefix` before the take's name. */
bool store_next_entry(DIR *d, const char *prefix, struct store_entry *out);

/* Newer takes come first. Equal numbers, which only a copied folder can have, are ordered by
 * name. */
bool store_comes_before(const struct store_entry *a, const struct store_entry *b);

/* Ids of the folders with that prefix, newest first; returns their number, at most cap. */
int store_list_prefix(const char *path, const char *prefix, char (*ids)[STORE_ID_CAP], int cap);

/* Whether a complete take is a board's part.
 * out:  id of the rig's take and name of the board, if it is. */
bool store_is_part(const struct store_fs *fs, const char *path, const char *id,
                   char take[MANIFEST_ID_CAP], char member[TAKE_MEMBER_CAP]);

/* The next number, which is on the disk before it is used, and the id of a take with it; durable
 * when the folder of the store is synced. On error id is "". */
MUST_USE err_t store_next(struct store *s, uint64_t *number, char id[STORE_ID_CAP]);

/* A take being written, under a temporary name until it is shown. */
struct store_new {
    const struct store *s;
    char tmp[FILE_PATH_CAP], path[FILE_PATH_CAP];
    bool shown;
};

MUST_USE err_t store_name(const struct store *s, const char *id, struct store_new *out);

/* Create a file of it, by its name in the take.
 * out:  its path, which *out needs. */
MUST_USE err_t store_create(const struct store_new *n, const char *name, char path[FILE_PATH_CAP],
                            struct store_fs_file *out);

/* Its folders are synced: give it its name, durably. */
MUST_USE err_t store_show(struct store_new *n);

/* Remove a failed take. If it was visible, its files go only after its temporary name is on the
 * disk; else store_open tries again. */
void store_take_back(const struct store_new *n);

/* ---- store_check.c: err as store_verify ---- */

MUST_USE err_t store_check_manifest(const struct store_fs *fs, const char *dir,
                                    struct manifest *out);

/* That all files of a folder of the take are listed. */
MUST_USE err_t store_check_listed(const struct manifest *m, const char *dir, const char *folder);
MUST_USE err_t store_check_file(const struct store_fs *fs, const char *dir,
                                const struct manifest_file *f);
MUST_USE err_t store_check_take(const struct store_fs *fs, const char *dir, struct manifest *out);

/* ---- store_files.c ---- */

/* Whether a take may have a file or folder of that name; everything else belongs to other
 * programs. */
bool store_files_of_take(const char *name);

/* The same of a staging folder. */
bool store_files_of_staging(const char *name);

/* ---- store_keep.c: for takes, the caller holds s->lock ---- */

/* Remove the takes beyond store.keep; session: of the newest take, "" for none. */
void store_keep_newest(struct store *s, bool is_aborted, const char *session);

/* Remove a take, once it is sure that nothing else is in it. err: as store_release */
MUST_USE err_t store_keep_remove(struct store *s, const char *id);

/* Remove the folder with that prefix before its name.
 * err:  ERR_IO, ERR_LIMIT: it cannot be renamed; files that stay are only logged. */
MUST_USE err_t store_keep_drop(const struct store *s, const char *prefix, const char *id,
                               bool (*own)(const char *name));

/* Remove the staging folders of takes that exist. */
void store_keep_unstage(const struct store *s);

#endif
