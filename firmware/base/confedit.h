/* confedit.h - changes settings in a file that people edit, too: lines that say the same, and
 * everything else, stay as they are. Pure.
 * thread: any. */
#ifndef BASE_CONFEDIT_H
#define BASE_CONFEDIT_H

#include "core/base/err.h"

struct confedit {
    const char *key, *value;
};

/* The text with these n values: the last line that sets a key is changed, lines before it that do
 * are dropped, keys that are missing come at the end.
 * own:  free.
 * err:  ERR_NOMEM */
MUST_USE err_t confedit_apply(const char *text, const struct confedit *values, int n, char **out);

#endif
