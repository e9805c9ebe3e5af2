#include "firmware/base/tempdir.h"

#include <errno.h>
#include <ftw.h>
#include <stdlib.h>
#include <string.h>

err_t tempdir_make(const char *name, char path[FILE_PATH_CAP])
{
    const char *tmp = getenv("TMPDIR");
    if (!tmp || !*tmp)
        tmp = "/tmp";
    err_t e = OK;
    if (snprintf(path, FILE_PATH_CAP, "%s/%s-XXXXXX", tmp, name) >= FILE_PATH_CAP)
        e = err_fail(ERR_ARG, "TMPDIR: longer than %d bytes", FILE_PATH_CAP - 32);
    else if (!mkdtemp(path))
        e = err_fail(file_code(errno), "a folder in %s: %s", tmp, strerror(errno));
    if (e)
        path[0] = '\0';
    return e;
}

static int remove_entry(const char *path, const struct stat *st, int flag, struct FTW *at)
{
    (void)st;
    (void)flag;
    (void)at;
    remove(path);
    return 0; // whatever stays, the rest goes
}

void tempdir_remove(const char *path)
{
    if (path[0])
        nftw(path, remove_entry, 16, FTW_DEPTH | FTW_PHYS);
}
