/* exiftimes.h - exposures of pictures from their EXIF data.
 * thread: any. */
#ifndef FORMAT_EXIFTIMES_H
#define FORMAT_EXIFTIMES_H

#include "core/base/types.h"

/* What to do where EXIF does not tell. */
#define EXIFTIMES_WRITE                                                                            \
    "write exposure.json beside the pictures: {\"NAME\": seconds x ISO / f-number^2, ...} "        \
    "or {\"*\": 1} for all"

/* Exposures of the shots, which are files of dir: seconds x ISO / f-number^2; 0 where a file tells
 * none. f-number and ISO must be in all files that have a time or in none; else with may_lack the
 * files without have 0.
 * err:  ERR_FORMAT (tags that only some files have, unless may_lack), ERR_IO, ERR_NOMEM. */
MUST_USE err_t exiftimes_read(const char *dir, bool may_lack, struct capture *c);

/* One exposure for all shots, where none tells any and no two names are of one view or of the
 * released layout, whose names tell exposures apart; whether it is so. */
bool exiftimes_assume(struct capture *c);

#endif
