/* origin.h - whether a file was written by this program. Every format that it writes for the user
 * has a place for our mark, and a file without the mark is never replaced.
 * thread: any. */
#ifndef FORMAT_ORIGIN_H
#define FORMAT_ORIGIN_H

#include "core/base/err.h"

#include <stdbool.h>

/* Mark of reports, as member "generator" of their outermost object, and of pages. */
#define ORIGIN_GENERATOR "hdrig"
/* Mark of a video, as its comment, and of a gzip stream. */
#define ORIGIN_COMMENT "written by hdrig"

/* Whether a file may be put at `path`: nothing is there, an empty file, or a regular one of ours.
 * err:  ERR_ARG (a file of another program, a folder, a link), ERR_IO. */
MUST_USE err_t origin_check_place(const char *path);

#endif
