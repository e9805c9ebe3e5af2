#include "drivers/device/module.h"

#include "drivers/format/file.h"

#include <dlfcn.h>
#include <stdio.h>
#include <unistd.h>

static err_t find_module(const struct module *m, char path[FILE_PATH_CAP])
{
    static const char *const folders[] = {"", "../lib/hdrig/"};
    char self[FILE_PATH_CAP];
    ssize_t n = readlink("/proc/self/exe", self, sizeof self - 1);
    while (n > 0 && self[n - 1] != '/')
        n--;
    self[n > 0 ? n : 0] = '\0';
    for (int i = 0; i < 2; i++) {
        int len = snprintf(path, FILE_PATH_CAP, "%s%s%s", self, folders[i], m->file);
        if (len < FILE_PATH_CAP && file_is_regular(path))
            return OK;
    }
    return err_fail(ERR_UNSUPPORTED,
                    "%s: there is no %s in %s or %s%s; it is built where the package %s is",
                    m->what, m->file, self, self, folders[1], m->package);
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
