/* zipfile.h - members of a zip archive, through libzip. Their names are looked up and never used as
 * paths; what the archive says of their sizes is a claim until they have been read.
 * thread: one at a time. */
#ifndef FORMAT_ZIPFILE_H
#define FORMAT_ZIPFILE_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct zipfile {
    const char *what; // begins the sentences; not owned
    void *zip;
};

/* Open an archive on the disk, or one of n bytes at p, which must stay.
 * own:  zipfile_close.
 * err:  ERR_IO, ERR_FORMAT (no archive), ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t zipfile_open(const char *path, struct zipfile *out);
MUST_USE err_t zipfile_open_bytes(const char *what, const void *p, size_t n, struct zipfile *out);

/* Accepts a zeroed struct. */
void zipfile_close(struct zipfile *z);

/* Members, and the name of one; NULL if it cannot be read. */
uint64_t zipfile_count(const struct zipfile *z);
const char *zipfile_name(const struct zipfile *z, uint64_t index);

/* Whether there is a member of that name. out: *index of the first. */
bool zipfile_find(const struct zipfile *z, const char *name, uint64_t *index);

struct zipfile_info {
    uint64_t bytes; // unpacked
    bool stored;    // neither compressed nor encrypted
};

/* err:  ERR_IO, ERR_FORMAT, ERR_NOMEM. */
MUST_USE err_t zipfile_look(const struct zipfile *z, uint64_t index, struct zipfile_info *out);

/* n bytes of a member from `at` on, which is 0 unless it is stored. The checksum is compared where
 * the member ends with them and `at` is 0.
 * err:  ERR_FORMAT (shorter; damaged; encrypted), ERR_IO, ERR_NOMEM. */
MUST_USE err_t zipfile_read(const struct zipfile *z, uint64_t index, uint64_t at, void *out,
                            size_t n);

/* All of a member that has at most `max` bytes.
 * own:  free(*out).
 * err:  as zipfile_read; ERR_FORMAT (larger). On error *out is NULL. */
MUST_USE err_t zipfile_load(const struct zipfile *z, uint64_t index, size_t max, void **out,
                            size_t *n);

#endif
