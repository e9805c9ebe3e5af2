#include "drivers/device/uri.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { KEYS = 64 };

struct option {
    const char *what, *name, *value;
    int name_n, value_n;
};

static err_t set_number(const struct option *o, const struct uri_key *k, void *field)
{
    char text[64] = "", *end = text;
    double v = NAN;
    if (o->value_n > 0 && o->value_n < (int)sizeof text) {
        memcpy(text, o->value, (size_t)o->value_n);
        text[o->value_n] = '\0';
        v = strtod(text, &end);
    }
    bool whole = k->kind == URI_WHOLE;
    if (*end != '\0' || !(v >= k->lo && v <= k->hi) || (whole && v != floor(v)))
        return err_fail(ERR_ARG, "%s: %s is \"%.*s\", not a%s number in %.15g..%.15g", o->what,
                        k->name, o->value_n, o->value, whole ? " whole" : "", k->lo, k->hi);
    if (whole)
        *(int64_t *)field = (int64_t)v;
    else
        *(double *)field = v;
    return OK;
}

static err_t set_word(const struct option *o, const struct uri_key *k, int *field)
{
    const char *w = k->words;
    for (int i = 0;; i++) {
        size_t n = strcspn(w, "|");
        if (n == (size_t)o->value_n && memcmp(w, o->value, n) == 0) {
            *field = i;
            return OK;
        }
        if (w[n] == '\0')
            break;
        w += n + 1;
    }
    return err_fail(ERR_ARG, "%s: %s is \"%.*s\", not one of %s", o->what, k->name, o->value_n,
                    o->value, k->words);
}

static err_t set_field(const struct option *o, const struct uri_key *k, void *field)
{
    if (k->kind == URI_WORD)
        return set_word(o, k, field);
    if (k->kind != URI_STRING)
        return set_number(o, k, field);
    if (o->value_n < 1 || o->value_n >= URI_TEXT)
        return err_fail(ERR_ARG, "%s: %s has %d bytes, not 1..%d", o->what, k->name, o->value_n,
                        URI_TEXT - 1);
    memcpy(field, o->value, (size_t)o->value_n);
    ((char *)field)[o->value_n] = '\0';
    return OK;
}

static err_t set_option(const struct option *o, const struct uri_table *tables, int n, bool *seen)
{
    int at = 0;
    for (int t = 0; t < n; t++)
        for (int i = 0; i < tables[t].n; i++, at++) {
            const struct uri_key *k = &tables[t].key[i];
            if (strlen(k->name) != (size_t)o->name_n || memcmp(k->name, o->name, strlen(k->name)))
                continue;
            if (seen[at])
                return err_fail(ERR_ARG, "%s: %s is given twice", o->what, k->name);
            seen[at] = true;
            return set_field(o, k, (char *)tables[t].out + k->offset);
        }
    return err_fail(ERR_ARG, "%s: no option is called \"%.*s\"", o->what, o->name_n, o->name);
}

err_t uri_parse(const char *what, const char *text, const struct uri_table *tables, int n_tables)
{
    bool seen[KEYS] = {false};
    err_t e = OK;
    while (!e && *text) {
        size_t n = strcspn(text, ",");
        const char *equal = memchr(text, '=', n);
        if (!equal || n > 1 << 20)
            return err_fail(ERR_ARG, "%s: \"%.*s\" is not name=value", what, (int)(n < 64 ? n : 64),
                            text);
        struct option o = {.what = what, .name = text, .value = equal + 1};
        o.name_n = (int)(equal - text);
        o.value_n = (int)(n - (size_t)o.name_n - 1);
        e = set_option(&o, tables, n_tables, seen);
        text += n + (text[n] == ',');
    }
    return e;
}
