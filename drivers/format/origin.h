/* origin.h - whether a file was written by this program. Every format that it writes for the user
 * says so in a place of its own, and a file that does not is never replaced.
 * thread: any. */
#ifndef FORMAT_ORIGIN_H
#define FORMAT_ORIGIN_H

#include "core/base/err.h"

#include <stdbool.h>

/* Of reports, as the member "generator" of their outermost object, and of pages. */
#define ORIGIN_GENERATOR "hdrig"
/* Of a video, as its comment; of a gzip stream, too. */
#define ORIGIN_COMMENT "written by hdrig"

/* Whether a file may be put at `path`: nothing is there, an empty file, or a regular one of ours.
 * err:  ERR_ARG (somebody else's, a folder, a link), ERR_IO. */
MUST_USE err_t origin_check_place(const char *path);

#endif
