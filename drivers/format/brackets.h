/* brackets.h - which photographs of a folder are brackets of a camera that stood still, as on a
 * tripod. thread: any. */
#ifndef FORMAT_BRACKETS_H
#define FORMAT_BRACKETS_H

#include "core/photo/prep.h"
#include "drivers/format/cameras.h"

enum { BRACKETS_MOST = 16 }; // photographs of one place

/* Marks the shots that show the place of the shot before them again (struct shot): by the same
 * camera, at exposures that all differ by BRACKETS_STOPS or more, and the same picture
 * (core/photo/still.h). Decodes the photographs of which that may be, one at a time.
 * err:  those of from->decode, ERR_NOMEM. */
#define BRACKETS_STOPS 0.25
MUST_USE err_t brackets_mark(struct capture *c, const struct prep_source *from);

/* The same where a rig has cameras for some of the shots only, as that of a scene, which has one
 * for each place; a shot with a camera of its own is never marked. Else nothing is done. */
MUST_USE err_t brackets_mark_lacking(const char *source, const struct rig *rig,
                                     const struct prep_source *from, struct capture *c);

#endif
