/* name.h - the rule for names of views from outside.
 * Such names become names of result files and strings in JSON, so they may not walk to another
 * folder.
 * thread: any. */
#ifndef FORMAT_NAME_H
#define FORMAT_NAME_H

#include "core/base/types.h"

/* Copy `n` bytes of text if they are a plain file name: 1 to NAME_CAP-1 bytes of valid UTF-8
 * without '/' and control characters, not "." or "..". `what` (a file) begins the sentence.
 * err:  ERR_FORMAT. */
MUST_USE err_t name_copy(const char *what, const char *text, size_t n, char out[NAME_CAP]);

/* Name of the picture at a path of n bytes: its last part or, if `folder`, FOLDER_NAME with the
 * part before it.
 * err:  as name_copy. */
MUST_USE err_t name_of_path(const char *what, const char *path, size_t n, bool folder,
                            char out[NAME_CAP]);

/* Bytes of the UTF-8 character at `text`, of which `left` > 0 bytes are there; 0 if it is malformed
 * (RFC 3629: no surrogates, nothing above 10FFFF, shortest form). */
size_t name_utf8(const char *text, size_t left);

/* Bytes of `name` that name its view: without the extension, and without the exposure number of
 * names like train_ldr_000_2.png. A number is taken off only if another one stands before it:
 * IMG_0001.jpg stays whole. */
size_t name_view(const char *name);

/* True if both names mean the same view by name_view. */
bool name_same_view(const char *a, const char *b);

#endif
