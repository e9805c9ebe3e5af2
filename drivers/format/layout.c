#include "drivers/format/layout.h"

#include "drivers/format/file.h"
#include "drivers/format/llff.h"
#include "drivers/format/name.h"
#include "drivers/format/rigfile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { EXPOSURES = 5 };

static const double hdr_gs_exposures[EXPOSURES] = {0.125, 0.5, 2, 8, 32};

err_t layout_is_bracketed(const char *dir, bool *out)
{
    char path[FILE_PATH_CAP];
    err_t e = file_companion(dir, LLFF_NAME, out, path);
    if (!e && !*out)
        e = file_companion(dir, "exr", out, path);
    return e;
}

void layout_keep_half(bool inputs, struct capture *c)
{
    char view[NAME_CAP] = "";
    int n = 0, i_view = -1;
    for (int i = 0; i < c->n; i++) {
        if (i == 0 || !name_same_view(view, c->shots[i].name))
            i_view++;
        memcpy(view, c->shots[i].name, sizeof view);
        if ((i_view % 2 == 0) == inputs)
            c->shots[n++] = c->shots[i];
    }
    c->n = n;
}

static const struct rig_view *find_view(const struct rig *rig, const char *name)
{
    for (int i = 0; i < rig->n; i++)
        if (rig->views[i].has_exposure && strcmp(rig->views[i].name, name) == 0)
            return &rig->views[i];
    return NULL;
}

static err_t times_of_rig(const char *path, struct capture *c, bool *found)
{
    struct rig rig;
    err_t e = rigfile_read(path, &rig);
    if (e)
        return e;
    *found = true;
    for (int i = 0; i < c->n && *found; i++)
        *found = find_view(&rig, c->shots[i].name) != NULL;
    for (int i = 0; i < c->n && *found; i++)
        c->shots[i].exposure = exp2((double)find_view(&rig, c->shots[i].name)->exposure_log2);
    cameras_free(&rig);
    return OK;
}

/* The number of the exposure at the end of a name; -1: another name. */
static int exposure_number(const char *name)
{
    const size_t n = name_view(name);
    return name[n] == '_' && name[n + 1] >= '0' && name[n + 1] < '0' + EXPOSURES &&
                   name[n + 2] == '.'
               ? name[n + 1] - '0'
               : -1;
}

static err_t times_of_hdr_gs(const char *dir, struct capture *c, bool *found)
{
    char path[FILE_PATH_CAP];
    err_t e = file_companion(dir, "exr", found, path);
    for (int i = 0; i < c->n && *found && !e; i++)
        *found = exposure_number(c->shots[i].name) >= 0;
    for (int i = 0; i < c->n && *found && !e; i++)
        c->shots[i].exposure = hdr_gs_exposures[exposure_number(c->shots[i].name)];
    return e;
}

err_t layout_times(const char *dir, const char *rig, struct capture *c, bool *found)
{
    static const char *const names[] = {"transforms.json", LLFF_NAME};
    char path[FILE_PATH_CAP];
    bool there;
    err_t e = OK;
    *found = false;
    if (rig)
        e = times_of_rig(rig, c, found);
    for (int i = 0; i < 2 && !rig && !*found && !e; i++) {
        e = file_companion(dir, names[i], &there, path);
        if (!e && there)
            e = times_of_rig(path, c, found);
    }
    return e || *found ? e : times_of_hdr_gs(dir, c, found);
}
