/* file.h - whole files: mapped for reading, written completely or not at all.
 * A mapped file must not shrink while it is read; results of this program never do, since they
 * appear by rename.
 * thread: any. */
#ifndef FORMAT_FILE_H
#define FORMAT_FILE_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

enum { FILE_PATH_CAP = 4096 }; // bytes of a path with its terminating 0

struct file_map {
    const uint8_t *p; // NULL if n is 0
    size_t n;         // bytes
};

/* Map a regular file of at most `max` bytes for reading.
 * own:  file_unmap.
 * err:  ERR_IO (open, map), ERR_FORMAT (not a regular file, larger than max). On error
 *       *out is zeroed. */
MUST_USE err_t file_map(const char *path, size_t max, struct file_map *out);

/* Accepts a zeroed map. */
void file_unmap(struct file_map *m);

bool file_exists(const char *path); // a file of any kind, or a folder
/* Let the kernel drop the map's pages; they are read again on the next access. */
void file_drop(const struct file_map *m);

bool file_is_dir(const char *path);
bool file_is_regular(const char *path);
bool file_is_same(const char *a, const char *b); // one file or folder, also under two names
/* A device, a pipe or the like, which a finished file must not replace. */
bool file_is_special(const char *path);

/* out = "dir/name".
 * err:  ERR_ARG if that is longer than FILE_PATH_CAP - 1. */
MUST_USE err_t file_join(const char *dir, const char *name, char out[FILE_PATH_CAP]);

/* A regular file by its path from the folder that this program lies in: "../share/x".
 * out: path, also if there is none; "" if that is too long. */
bool file_of_program(const char *name, char path[FILE_PATH_CAP]);

/* Path of a companion beside the files of `dir` or one folder up; *found is false if it is in
 * neither.
 * err:  ERR_ARG as file_join. */
MUST_USE err_t file_companion(const char *dir, const char *name, bool *found,
                              char path[FILE_PATH_CAP]);

/* The folder that `path` lies in.
 * err:  ERR_ARG if that is longer than FILE_PATH_CAP - 1. */
MUST_USE err_t file_parent(const char *path, char out[FILE_PATH_CAP]);

/* The part of `path` after its last slash. */
const char *file_name(const char *path);

/* Code of a failed write with this errno: ERR_LIMIT if there is no space, else ERR_IO. */
MUST_USE err_t file_code(int why);

/* Create or empty a file for writing; write with stdio and ask for errors once, in file_finish.
 * own:  file_finish or file_discard.
 * err:  ERR_LIMIT (no space), ERR_IO. */
MUST_USE err_t file_create(const char *path, FILE **out);

/* Flush, sync to the medium and close. If any write since file_create failed, the file is removed.
 * err:  ERR_LIMIT (no space), ERR_IO. f is closed in any case. */
MUST_USE err_t file_finish(FILE *f, const char *path);

/* Make the bytes of a file, or the names in a folder, durable.
 * err:  ERR_IO, ERR_LIMIT (no space). */
MUST_USE err_t file_sync(const char *path);

/* Rename a finished file; a file at `to` is replaced in one step. `from` is removed on error.
 * err:  ERR_IO, ERR_LIMIT (no space). */
MUST_USE err_t file_replace(const char *from, const char *to);

/* Close and remove. Accepts NULL. */
void file_discard(FILE *f, const char *path);

#endif
