#include "drivers/device/module.h"

#include "drivers/format/file.h"

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

static err_t find_module(const struct module *m, char path[FILE_PATH_CAP])
{
    char installed[FILE_PATH_CAP], name[FILE_PATH_CAP];
    snprintf(name, sizeof name, "../lib/hdrig/%s", m->file);
    if (file_of_program(m->file, path))
        return OK;
    if (file_of_program(name, installed)) {
        memcpy(path, installed, FILE_PATH_CAP);
        return OK;
    }
    return err_fail(ERR_UNSUPPORTED,
                    "%s: there is no %s, nor %s; it is built where the package %s is", m->what,
                    path, installed, m->package);
}

err_t module_load(const struct module *m, const char *path, const void **out)
{
    char found[FILE_PATH_CAP];
    *out = NULL;
    if (!path || !path[0]) {
        err_t e = find_module(m, found);
        if (e)
            return e;
        path = found;
    }
    void *lib = dlopen(path, RTLD_NOW | (m->global ? RTLD_GLOBAL : RTLD_LOCAL));
    if (!lib)
        return err_fail(ERR_UNSUPPORTED, "%s: %s; it needs %s", m->what, dlerror(), m->needs);
    *out = dlsym(lib, m->table);
    return *out ? OK
                : err_fail(ERR_UNSUPPORTED, "%s: %s is no module of this program", m->what, path);
}
