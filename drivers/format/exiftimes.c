#include "drivers/format/exiftimes.h"

#include "drivers/format/file.h"
#include "drivers/format/img.h"
#include "drivers/format/name.h"
#include "drivers/format/namelist.h"
#include "drivers/format/pixels.h"

#include <stdlib.h>
#include <string.h>

/* A tag that only some files have makes the exposures incomparable. */
static err_t check_tag(const char *tag, bool may_lack, const bool *has, struct capture *c)
{
    char with_text[100], without_text[100];
    struct namelist with = {0}, without = {0};
    for (int i = 0; i < c->n; i++)
        if (c->shots[i].exposure > 0)
            namelist_add(c->shots[i].name, has[i] ? &with : &without);
    if (with.n == 0 || without.n == 0)
        return OK;
    for (int i = 0; i < c->n && may_lack; i++)
        if (!has[i])
            c->shots[i].exposure = 0;
    if (may_lack)
        return OK;
    return err_fail(ERR_FORMAT,
                    "EXIF of %s lacks %s, that of %s has it: their exposures cannot be "
                    "compared; " EXIFTIMES_WRITE,
                    namelist_text(&without, without_text, sizeof without_text), tag,
                    namelist_text(&with, with_text, sizeof with_text));
}

/* has_iso, has_f: scratch for all pictures. */
static err_t read_files(const char *dir, bool may_lack, bool *has_iso, bool *has_f,
                        struct capture *c)
{
    for (int i = 0; i < c->n; i++) {
        struct shot *s = &c->shots[i];
        struct img_exif x;
        char path[FILE_PATH_CAP];
        err_t e = file_join(dir, s->name, path);
        if (!e)
            e = pixels_exif(path, &x);
        if (e && e != ERR_FORMAT && e != ERR_UNSUPPORTED)
            return e;
        s->exposure = e ? 0 : img_exif_exposure(&x); // no such data
        has_iso[i] = !e && x.iso > 0;
        has_f[i] = !e && x.f_number > 0;
    }
    err_t e = check_tag("the f-number", may_lack, has_f, c);
    return e ? e : check_tag("the ISO value", may_lack, has_iso, c);
}

err_t exiftimes_read(const char *dir, bool may_lack, struct capture *c)
{
    const size_t n = (size_t)c->n;
    bool *has = calloc(n + 1, 2 * sizeof *has);
    if (!has)
        return err_fail(ERR_NOMEM, "%s: no memory for %d pictures", dir, c->n);
    err_t e = read_files(dir, may_lack, has, has + n, c);
    free(has);
    return e;
}

bool exiftimes_assume(struct capture *c)
{
    for (int i = 0; i < c->n; i++) {
        const char *name = c->shots[i].name;
        if (c->shots[i].exposure > 0 || strncmp(name, "train", 5) == 0 ||
            strncmp(name, "test", 4) == 0 || (i > 0 && name_same_view(name, c->shots[i - 1].name)))
            return false;
    }
    for (int i = 0; i < c->n; i++)
        c->shots[i].exposure = 1;
    return c->n > 0;
}
