#include "drivers/format/rigfile.h"

#include "drivers/format/colmap.h"
#include "drivers/format/file.h"

#include <string.h>
#include <strings.h>

/* A COLMAP folder, or one that holds sparse/0. */
static err_t read_folder(const char *path, struct rig *out)
{
    char inner[FILE_PATH_CAP];
    err_t e = file_join(path, "sparse/0", inner);
    if (e)
        return e;
    return colmap_read(file_is_dir(inner) ? inner : path, out);
}

err_t rigfile_read(const char *path, struct rig *out)
{
    const size_t n = strlen(path);
    *out = (struct rig){0};
    if (file_is_dir(path))
        return read_folder(path, out);
    if (n > 5 && strcasecmp(path + n - 5, ".json") == 0)
        return cameras_read(path, out);
    return err_fail(ERR_UNSUPPORTED, "%s: a rig is a COLMAP folder or a cameras.json", path);
}
