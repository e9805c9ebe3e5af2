/* masks.h - pictures that say which pixels of photographs show the scene: masks/NAME.png (COLMAP's
 * names) or masks/NAME.png without the photograph's own suffix, beside the photographs or one
 * folder up, as large as these are when they are upright. Black does not count.
 * thread: any. */
#ifndef FORMAT_MASKS_H
#define FORMAT_MASKS_H

#include "drivers/format/file.h"
#include "drivers/format/namelist.h"

#include "core/base/types.h"

/* The mask of the photograph in this file.
 * err:  ERR_ARG (too long a path). */
MUST_USE err_t masks_find(const char *photograph, bool *found, char path[FILE_PATH_CAP]);

/* s->masked: there is one. s->taken_w and s->taken_h are set.
 * err:  those of masks_find and imgsize_read; ERR_FORMAT (of another size). */
MUST_USE err_t masks_look(const char *photograph, struct shot *s);

/* Names of the masks that belong to none of the photographs in a folder, for a sentence. */
void masks_strange(const char *dir, const struct capture *c, struct namelist *out);

#endif
