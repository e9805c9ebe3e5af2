/* store_fs.h - every file operation of the store, as a table that a test can replace, and whole
 * files through it. No function changes an existing file: files are made, synced, renamed and
 * removed. thread: any. */
#ifndef STORE_STORE_FS_H
#define STORE_STORE_FS_H

#include "core/base/err.h"
#include "core/base/sha256.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <sys/statvfs.h>
#include <sys/types.h>

/* The system calls of these names, with errno. */
struct store_fs {
    int (*open)(const char *path, int flags, mode_t mode);
    int (*close)(int fd);
    ssize_t (*read)(int fd, void *p, size_t n);
    ssize_t (*write)(int fd, const void *p, size_t n);
    off_t (*seek)(int fd, off_t at, int whence);
    int (*sync)(int fd);
    int (*mkdir)(const char *path, mode_t mode);
    int (*rename)(const char *from, const char *to, unsigned flags); // renameat2
    int (*link)(const char *from, const char *to);
    int (*unlink)(const char *path);
    int (*rmdir)(const char *path);
    int (*access)(const char *path, int mode);
    int (*room)(const char *path, struct statvfs *out); // statvfs
};

extern const struct store_fs store_fs_system;

/* A file being written. */
struct store_fs_file {
    const struct store_fs *fs;
    const char *path; // the caller's
    FILE *stream;     // write with stdio, it can seek; ask for errors once, in store_fs_finish
    int fd, why;      // errno of the first failed call
};

/* Make a new file.
 * own:  store_fs_finish or store_fs_discard.
 * err:  ERR_LIMIT (no space), ERR_IO. */
MUST_USE err_t store_fs_create(const struct store_fs *fs, const char *path,
                               struct store_fs_file *out);

/* Flush, sync and close; f is closed in any case; an incomplete file stays.
 * err:  ERR_LIMIT, ERR_IO; also when a call since store_fs_create failed. */
MUST_USE err_t store_fs_finish(struct store_fs_file *f);
void store_fs_discard(struct store_fs_file *f);

/* A new file of these bytes, synced. */
MUST_USE err_t store_fs_write(const struct store_fs *fs, const char *path, const void *bytes,
                              size_t n);

/* Size and hash of a regular file.
 * err:  ERR_IO (also: not there, not a regular file). */
MUST_USE err_t store_fs_hash(const struct store_fs *fs, const char *path, uint64_t *bytes,
                             char hex[SHA256_HEX_CAP]);

/* The first bytes of a file, at most cap, read through the table: unlike a mapped file it may be on
 * a disk that fails.
 * err:  ERR_IO. */
MUST_USE err_t store_fs_read(const struct store_fs *fs, const char *path, void *p, size_t cap,
                             size_t *n);

/* Make the bytes of a finished file durable.
 * err:  ERR_IO, ERR_LIMIT. */
MUST_USE err_t store_fs_sync(const struct store_fs *fs, const char *path);

/* A second name for a file; where the file system has none, a copy, synced.
 * out:  whether it is a copy.
 * err:  ERR_IO (also: the name is taken), ERR_LIMIT, ERR_NOMEM. */
MUST_USE err_t store_fs_link(const struct store_fs *fs, const char *from, const char *to,
                             bool *copied);

/* A whole file of at most `max` bytes; of a longer one, max + 1 bytes, so that it shows.
 * own:  free.
 * err:  ERR_IO, ERR_NOMEM. On error *text is NULL. */
MUST_USE err_t store_fs_text(const struct store_fs *fs, const char *path, size_t max, char **text,
                             size_t *n);

/* Make the names in a folder durable.
 * err:  ERR_IO, ERR_LIMIT. */
MUST_USE err_t store_fs_sync_dir(const struct store_fs *fs, const char *path);

MUST_USE err_t store_fs_mkdir(const struct store_fs *fs, const char *path);

/* Rename a file or folder to a free name.
 * err:  ERR_IO (also: the name is taken), ERR_LIMIT. */
MUST_USE err_t store_fs_move(const struct store_fs *fs, const char *from, const char *to);

/* Remove a file, or a folder with those of its files and folders whose names, relative to it, are
 * `own`. Other files, and files that cannot be removed, stay, with a line in the log: the
 * next store_open tries again. */
void store_fs_remove(const struct store_fs *fs, const char *path, bool (*own)(const char *name));

#endif
