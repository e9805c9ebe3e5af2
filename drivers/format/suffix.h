/* suffix.h - kinds of pictures by the ends of their names, in any case; hidden files are none.
 * thread: any. */
#ifndef FORMAT_SUFFIX_H
#define FORMAT_SUFFIX_H

#include <stdbool.h>

bool suffix_is_picture(const char *name); // PNG, JPEG, TIFF

/* Read only where a folder has none of those before: beside JPEG, HEIC and raw are the same
 * photograph once more, and OpenEXR a result or the truth. */
bool suffix_is_heic(const char *name);
bool suffix_is_raw(const char *name); // DNG, CR2, NEF, ARW
bool suffix_is_exr(const char *name);

/* Pictures, or raw, that are not read beside those above, as users may expect. */
bool suffix_is_other(const char *name);

#endif
