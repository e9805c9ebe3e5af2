/* handout.h - files that the first rank of a team has and others have not: they are sent once, into
 * a temporary folder of those that lack them.
 * Collective; without a team nothing is done. */
#ifndef BASE_HANDOUT_H
#define BASE_HANDOUT_H

#include "core/base/team.h"
#include "drivers/format/file.h"

enum { HANDOUT_PATHS = 40 };

struct handout {
    char dir[FILE_PATH_CAP]; // of what was received; "" if nothing was
    char *path[HANDOUT_PATHS];
    int n;
};

/* Where *path (a file, or a folder with all that is in it; NULL, "" and the words in `words`, a
 * list that ends with NULL, are no paths) is missing on a rank, it is received there, and *path
 * is that copy, valid until handout_close.
 * err:  ERR_IO, ERR_LIMIT (no space, too many paths), ERR_NOMEM, those of team.h. */
MUST_USE err_t handout_path(struct handout *h, struct team *t, const char *const *words,
                            const char **path);

/* Removes what was received. Accepts a zeroed struct. */
void handout_close(struct handout *h);

#endif
