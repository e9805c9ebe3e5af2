/* textfile.h - short text files with given rights: settings and secrets. They are written whole or
 * not at all, and nobody can read a secret at any moment who may not read it afterwards.
 * thread: any. */
#ifndef FORMAT_TEXTFILE_H
#define FORMAT_TEXTFILE_H

#include "drivers/format/file.h"

/* Begins files of ours in folders of other programs. */
#define TEXTFILE_MARK "# written by hdrig"

struct textfile_rights {
    unsigned mode;     // as chmod
    const char *owner; // where there is such a user and group; NULL: the process's
    const char *group; // that has the rights of a group; if it does not exist, nobody has those.
                       // NULL: the process's
    bool keep;         // mode, owner and group of a former file instead
};

/* The text of a file of at most `max` bytes, with a 0 behind it.
 * own:  free.
 * err:  ERR_IO (ERR_LOST: there is none), ERR_FORMAT (longer; has a zero byte), ERR_NOMEM */
MUST_USE err_t textfile_read(const char *path, size_t max, char **out);

/* Whether textfile_write may write there: nothing is there, or a file with our mark.
 * err:  ERR_ARG (file of another program, folder, link), ERR_IO */
MUST_USE err_t textfile_check(const char *path);

/* A file at `path` is replaced in one step.
 * err:  ERR_IO, ERR_LIMIT (no space), ERR_ARG (path too long). On error nothing has changed. */
MUST_USE err_t textfile_write(const char *path, const struct textfile_rights *r, const char *text);

#endif
