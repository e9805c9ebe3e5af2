#include "firmware/base/confedit.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>

/* Whether the line at p sets the key. A line that begins with a blank goes on with the one before
 * (inih). */
static bool sets(const char *p, const char *key)
{
    const size_t n = strlen(key);
    if (strncmp(p, key, n) != 0)
        return false;
    p += n;
    p += strspn(p, " \t");
    return *p == '=' || *p == ':';
}

static const char *next_line(const char *p)
{
    const char *end = strchr(p, '\n');
    return end ? end + 1 : p + strlen(p);
}

static bool is_last(const char *line, const char *key)
{
    for (const char *p = next_line(line); *p; p = next_line(p))
        if (sets(p, key))
            return false;
    return true;
}

static void put_value(const struct confedit *v, FILE *f)
{
    fprintf(f, "%s =%s%s\n", v->key, *v->value ? " " : "", v->value);
}

static void put_line(const char *line, const struct confedit *values, int n, FILE *f)
{
    const char *end = next_line(line);
    for (int i = 0; i < n; i++) {
        if (!sets(line, values[i].key))
            continue;
        if (is_last(line, values[i].key))
            put_value(&values[i], f);
        return;
    }
    fwrite(line, 1, (size_t)(end - line), f);
    if (end[-1] != '\n')
        fputc('\n', f);
}

err_t confedit_apply(const char *text, const struct confedit *values, int n, char **out)
{
    size_t size;
    *out = NULL;
    FILE *f = open_memstream(out, &size);
    if (!f)
        return err_fail(ERR_NOMEM, "settings: no memory");
    for (const char *p = text; *p; p = next_line(p))
        put_line(p, values, n, f);
    for (int i = 0; i < n; i++) {
        const char *p = text;
        while (*p && !sets(p, values[i].key))
            p = next_line(p);
        if (!*p)
            put_value(&values[i], f);
    }
    return fclose(f) == 0 ? OK : err_fail(ERR_NOMEM, "settings: no memory");
}
