/* exposures.h - exposure.json: {"file name": linear exposure time, ...}, any common unit; the name
 * "*" stands for all files that are not named.
 * thread: any. */
#ifndef FORMAT_EXPOSURES_H
#define FORMAT_EXPOSURES_H

#include "core/base/types.h"

#define EXPOSURES_OTHERS "*"

enum { EXPOSURES_MAX = 65536 }; // entries of one file

struct exposure_entry {
    char name[NAME_CAP];
    double time; // finite, > 0
};

struct exposures {
    int n;
    struct exposure_entry *v; // (n), malloc'd, sorted by name, no name twice
};

/* Read an exposure file.
 * own:  exposures_free.
 * err:  ERR_IO, ERR_FORMAT (also: a name twice, a time that is not finite and > 0), ERR_NOMEM.
 *       On error *out is zeroed. */
MUST_USE err_t exposures_read(const char *path, struct exposures *out);

/* As exposures_read, from n bytes of text; `what` begins the sentence. */
MUST_USE err_t exposures_parse(const char *what, const void *text, size_t n, struct exposures *out);

/* Accepts a zeroed struct. */
void exposures_free(struct exposures *e);

/* Time of a file name, or of those not named; 0 if it is not listed. */
double exposures_find(const struct exposures *e, const char *name);

#endif
