#include "drivers/format/masks.h"

#include "drivers/format/imgsize.h"

#include <dirent.h>
#include <string.h>

static const char suffix[] = ".png";

/* Bytes of a name without its suffix. */
static size_t stem(const char *name)
{
    const char *dot = strrchr(name, '.');
    return dot && dot > name ? (size_t)(dot - name) : strlen(name);
}

err_t masks_find(const char *photograph, bool *found, char path[FILE_PATH_CAP])
{
    const char *name = file_name(photograph);
    const size_t n[2] = {strlen(name), stem(name)};
    char dir[FILE_PATH_CAP], folder[FILE_PATH_CAP], mask[NAME_CAP + sizeof suffix];
    *found = false;
    err_t e = file_parent(photograph, dir);
    if (!e)
        e = file_companion(dir, "masks", found, folder);
    if (e || !*found)
        return e;
    *found = false;
    for (int k = 0; k < 2 && !e && !*found; k++) {
        snprintf(mask, sizeof mask, "%.*s%s", (int)n[k], name, suffix);
        e = file_join(folder, mask, path);
        *found = !e && file_is_regular(path);
    }
    return e;
}

err_t masks_look(const char *photograph, struct shot *s)
{
    char path[FILE_PATH_CAP];
    int w, h;
    err_t e = masks_find(photograph, &s->masked, path);
    if (e || !s->masked)
        return e;
    e = imgsize_read(path, &w, &h);
    if (!e && (w != s->taken_w || h != s->taken_h))
        e = err_fail(ERR_FORMAT, "%s: %d x %d px, but the photograph %s has %d x %d", path, w, h,
                     s->name, s->taken_w, s->taken_h);
    return e;
}

/* Whether it is the mask of a photograph of this name. */
static bool is_mask_of(const char *mask, size_t n, const char *name)
{
    return (n == strlen(name) || n == stem(name)) && strncmp(mask, name, n) == 0;
}

void masks_strange(const char *dir, const struct capture *c, struct namelist *out)
{
    char path[FILE_PATH_CAP];
    bool found;
    DIR *d = file_companion(dir, "masks", &found, path) == OK && found ? opendir(path) : NULL;
    if (!d)
        return;
    for (struct dirent *entry; (entry = readdir(d));) {
        const char *mask = entry->d_name;
        const size_t n = stem(mask);
        int i = 0;
        if (*mask == '.' || strcmp(mask + n, suffix) != 0)
            continue;
        while (i < c->n && !is_mask_of(mask, n, c->shots[i].name))
            i++;
        if (i == c->n)
            namelist_add(mask, out);
    }
    closedir(d);
}
