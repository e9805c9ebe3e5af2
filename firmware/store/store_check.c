/* Takes compared with their manifests. */
#include "firmware/store/store_inner.h"

#include "drivers/format/json.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

err_t store_check_listed(const struct manifest *m, const char *dir, const char *folder)
{
    char path[FILE_PATH_CAP], name[MANIFEST_NAME_CAP + 256];
    err_t e = file_join(dir, folder, path);
    DIR *d = e ? NULL : opendir(path);
    for (struct dirent *entry; d && !e && (entry = readdir(d));) {
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0)
            continue;
        snprintf(name, sizeof name, "%s%s%s", folder, *folder ? "/" : "", entry->d_name);
        bool known = !*folder && strcmp(name, MANIFEST_FILE) == 0;
        for (int i = 1; i < STORE_FOLDERS && !*folder; i++)
            known = known || strcmp(name, store_folders[i]) == 0;
        for (int i = 0; i < m->n && !known; i++)
            known = strcmp(m->file[i].name, name) == 0;
        if (!known)
            e = err_fail(ERR_FORMAT, "%s/%s: is not in the manifest", dir, name);
    }
    if (d)
        closedir(d);
    return e;
}

err_t store_check_file(const struct store_fs *fs, const char *dir, const struct manifest_file *f)
{
    char path[FILE_PATH_CAP], hex[SHA256_HEX_CAP];
    uint64_t bytes;
    err_t e = file_join(dir, f->name, path);
    if (!e && !file_exists(path))
        e = err_fail(ERR_FORMAT, "%s: is missing", path);
    if (!e)
        e = store_fs_hash(fs, path, &bytes, hex);
    if (e)
        return e;
    if (bytes != f->bytes)
        return err_fail(ERR_FORMAT,
                        "%s: the file has %" PRIu64 " bytes, the manifest says %" PRIu64, path,
                        bytes, f->bytes);
    if (strcmp(hex, f->sha256) != 0)
        return err_fail(ERR_FORMAT, "%s: its SHA-256 differs from the manifest", path);
    return OK;
}

err_t store_check_manifest(const struct store_fs *fs, const char *dir, struct manifest *m)
{
    char path[FILE_PATH_CAP];
    size_t n;
    err_t e = file_join(dir, MANIFEST_FILE, path);
    if (!e && !file_exists(path))
        e = err_fail(ERR_FORMAT, "%s: is missing", path);
    if (e)
        return e;
    char *text;
    e = store_fs_text(fs, path, JSON_BYTES_MAX, &text, &n);
    if (!e)
        e = manifest_parse(path, text, n, m);
    free(text);
    return e;
}

err_t store_check_take(const struct store_fs *fs, const char *dir, struct manifest *m)
{
    err_t e = store_check_manifest(fs, dir, m);
    for (int i = 0; i < STORE_FOLDERS && !e; i++)
        e = store_check_listed(m, dir, store_folders[i]);
    for (int i = 0; i < m->n && !e; i++)
        if (!manifest_is_thumb(m->file[i].name))
            e = store_check_file(fs, dir, &m->file[i]);
    return e;
}
