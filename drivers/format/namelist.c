#include "drivers/format/namelist.h"

#include "drivers/format/name.h"

#include <stdio.h>
#include <string.h>

void namelist_add(const char *name, struct namelist *l)
{
    char plain[NAME_CAP];
    const int cap = (int)(sizeof l->first / sizeof l->first[0]);
    l->n++;
    if (name_copy("", name, strlen(name), plain) != OK)
        return; // counted
    int i = l->n_first;
    while (i > 0 && strcmp(plain, l->first[i - 1]) < 0)
        i--;
    if (i == cap)
        return;
    l->n_first += l->n_first < cap;
    memmove(l->first[i + 1], l->first[i], (size_t)(l->n_first - 1 - i) * sizeof plain);
    memcpy(l->first[i], plain, sizeof plain);
}

const char *namelist_text(const struct namelist *l, char *text, size_t cap)
{
    size_t n = 0;
    text[0] = 0;
    for (int i = 0; i < l->n_first && n < cap; i++) {
        const char *between = i == 0 ? "" : i + 1 < l->n ? ", " : " and ";
        n += (size_t)snprintf(text + n, cap - n, "%s%.32s", between, l->first[i]);
    }
    if (l->n > l->n_first && n < cap)
        snprintf(text + n, cap - n, "%s%d other%s", n ? " and " : "", l->n - l->n_first,
                 l->n - l->n_first > 1 ? "s" : "");
    return text;
}
