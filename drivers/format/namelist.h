/* namelist.h - names for a sentence: how many there are, and the first of them in order.
 * thread: any. */
#ifndef FORMAT_NAMELIST_H
#define FORMAT_NAMELIST_H

#include "core/base/types.h"

enum { NAMELIST_SHOWN = 3 };

struct namelist {
    int n, n_first;
    char first[NAMELIST_SHOWN][NAME_CAP];
};

/* A name that name_copy refuses is only counted. */
void namelist_add(const char *name, struct namelist *l);

/* "a.heic, b.heic and 7 others". returns: text. */
const char *namelist_text(const struct namelist *l, char *text, size_t cap);

#endif
