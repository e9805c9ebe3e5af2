/* filelist.h - files.sha256: the files of a folder that this program wrote, in lines of sha256sum
 * ("sha256sum -c files.sha256" verifies a copy). The first line, a comment, says that the list is
 * ours. Code that replaces or removes such a folder checks it against the list, so that no other
 * file is lost.
 * thread: any. */
#ifndef FORMAT_FILELIST_H
#define FORMAT_FILELIST_H

#include "drivers/format/file.h"

#define FILELIST_NAME "files.sha256"
#define FILELIST_PARTIAL ".hdrig-partial" // mark of a folder that is not complete (partial.h)

/* Write the list of all files in `dir`, which only the caller uses.
 * err:  ERR_IO, ERR_LIMIT (no space), ERR_ARG (path too long, folders too deep), ERR_NOMEM. */
MUST_USE err_t filelist_write(const char *dir);

/* Whether `dir` has a list and holds nothing but the files of it, all of them or some.
 * content: their bytes must be those of the list, too.
 * err:  ERR_ARG names the file that is not ours or was changed, ERR_IO, ERR_NOMEM. */
MUST_USE err_t filelist_check(const char *dir, bool content);

/* Remove the files of its list, then its folders as far as they are empty, `dir` last.
 * err:  ERR_IO (another file lies in it and stays), those of filelist_check. */
MUST_USE err_t filelist_remove(const char *dir);

#endif
