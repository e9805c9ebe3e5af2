#include "drivers/format/exposures.h"

#include "drivers/format/json.h"
#include "drivers/format/name.h"

#include <stdlib.h>
#include <string.h>

static int by_name(const void *a, const void *b)
{
    return strcmp(((const struct exposure_entry *)a)->name,
                  ((const struct exposure_entry *)b)->name);
}

static err_t get_entries(const char *what, const struct cJSON *doc, void *into)
{
    struct exposures *out = into;
    if (!json_is_object(doc))
        return err_fail(ERR_FORMAT, "%s: not an object of file names and times", what);
    int n = json_count(doc);
    if (n < 1 || n > EXPOSURES_MAX)
        return err_fail(ERR_FORMAT, "%s: %d exposures, allowed are 1 to %d", what, n,
                        EXPOSURES_MAX);
    out->v = calloc((size_t)n, sizeof *out->v);
    if (!out->v)
        return err_fail(ERR_NOMEM, "%s: no memory for %d exposures", what, n);
    for (const struct cJSON *m = json_first(doc); m; m = json_next(m)) {
        struct exposure_entry *x = &out->v[out->n++];
        const char *key = json_key(m);
        err_t e = name_copy(what, key, strlen(key), x->name);
        if (e)
            return e;
        if (!json_number(m, &x->time) || !(x->time > 0))
            return err_fail(
                ERR_FORMAT,
                "%s: exposure of %s is not a finite number > 0, such as seconds x ISO / "
                "f-number^2",
                what, x->name);
    }
    qsort(out->v, (size_t)out->n, sizeof *out->v, by_name);
    for (int i = 1; i < out->n; i++)
        if (strcmp(out->v[i - 1].name, out->v[i].name) == 0)
            return err_fail(ERR_FORMAT, "%s: %s is named twice", what, out->v[i].name);
    return OK;
}

err_t exposures_parse(const char *what, const void *text, size_t n, struct exposures *out)
{
    *out = (struct exposures){0};
    err_t e = json_parse_with(what, text, n, get_entries, out);
    if (e)
        exposures_free(out);
    return e;
}

err_t exposures_read(const char *path, struct exposures *out)
{
    *out = (struct exposures){0};
    err_t e = json_read_with(path, get_entries, out);
    if (e)
        exposures_free(out);
    return e;
}

void exposures_free(struct exposures *e)
{
    free(e->v);
    *e = (struct exposures){0};
}

static int key_to_entry(const void *key, const void *entry)
{
    return strcmp(key, ((const struct exposure_entry *)entry)->name);
}

static double find(const struct exposures *e, const char *name)
{
    const struct exposure_entry *x = bsearch(name, e->v, (size_t)e->n, sizeof *e->v, key_to_entry);
    return x ? x->time : 0;
}

double exposures_find(const struct exposures *e, const char *name)
{
    if (e->n == 0)
        return 0;
    const double time = find(e, name);
    return time > 0 ? time : find(e, EXPOSURES_OTHERS);
}
