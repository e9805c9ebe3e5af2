#include "drivers/format/rigfile.h"

#include "drivers/format/colmap.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/llff.h"
#include "drivers/format/transforms.h"

#include <string.h>
#include <strings.h>

/* cameras.json or transforms.json, by what is in it. */
static err_t read_json(const char *path, struct rig *out)
{
    struct cJSON *doc;
    err_t e = json_read(path, &doc);
    if (e)
        return e;
    const bool frames = transforms_is(doc);
    json_free(doc);
    e = frames ? transforms_read(path, out) : cameras_read(path, out);
    cameras_use_photographs(out);
    return e;
}

/* A COLMAP folder, or one that holds sparse/0 or transforms.json. */
static err_t read_folder(const char *path, struct rig *out)
{
    char sparse[FILE_PATH_CAP], frames[FILE_PATH_CAP];
    err_t e = file_join(path, "sparse/0", sparse);
    if (!e)
        e = file_join(path, "transforms.json", frames);
    if (e)
        return e;
    if (file_is_dir(sparse))
        return colmap_read(sparse, out);
    return file_is_regular(frames) ? transforms_read(frames, out) : colmap_read(path, out);
}

static bool ends_with(const char *path, const char *end)
{
    const size_t n = strlen(path), m = strlen(end);
    return n > m && strcasecmp(path + n - m, end) == 0;
}

err_t rigfile_read(const char *path, struct rig *out)
{
    *out = (struct rig){0};
    if (file_is_dir(path))
        return read_folder(path, out);
    if (ends_with(path, ".json"))
        return read_json(path, out);
    if (ends_with(path, ".npy"))
        return llff_read(path, out);
    return err_fail(ERR_UNSUPPORTED,
                    "%s: a rig is a COLMAP folder, a cameras.json, a transforms.json or a "
                    "poses_bounds.npy",
                    path);
}

err_t rigfile_find(const char *dir, bool *found, char path[FILE_PATH_CAP])
{
    static const char *const names[] = {"sparse/0", "transforms.json", LLFF_NAME};
    err_t e = OK;
    *found = false;
    for (size_t i = 0; i < sizeof names / sizeof names[0] && !*found && !e; i++)
        e = file_companion(dir, names[i], found, path);
    return e;
}
