/* The staging folder appears and goes as a take does: whole, by one rename. What is fetched into it
 * need not be durable: it is hashed before it is used, and synced by joint_commit. */
#include "firmware/store/joint.h"

#include "firmware/store/part.h"
#include "firmware/store/store_inner.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

static bool is_id(const char *id)
{
    bool is_aborted;
    return strlen(id) < STORE_ID_CAP && store_number(id, &is_aborted) && !is_aborted;
}

/* Path of STORE/PREFIXid. */
static err_t folder_path(const char *store, const char *prefix, const char *id,
                         char out[FILE_PATH_CAP])
{
    char name[STORE_ID_CAP + 16];
    if (!is_id(id))
        return err_fail(ERR_ARG, "\"%.40s\" is not the id of a take", id);
    snprintf(name, sizeof name, "%s%s", prefix, id);
    return file_join(store, name, out);
}

/* ---- the folder ---- */

static err_t write_order(struct store *s, const char *tmp, const char *text)
{
    char path[FILE_PATH_CAP];
    err_t e = store_fs_mkdir(s->fs, tmp);
    if (!e)
        e = file_join(tmp, STORE_RIG_ORDER, path);
    if (!e)
        e = store_fs_write(s->fs, path, text, strlen(text));
    if (!e)
        e = file_join(tmp, STORE_RIG_BOOT, path);
    if (!e)
        e = store_fs_write(s->fs, path, s->boot, strlen(s->boot));
    return e ? e : store_fs_sync_dir(s->fs, tmp);
}

err_t joint_begin(struct store *s, const char *id, const char *text)
{
    char path[FILE_PATH_CAP], tmp[FILE_PATH_CAP], why[512];
    bool shown = false;
    if (strlen(text) > JOINT_ORDER_MAX)
        return err_fail(ERR_ARG, "the order of take %s has %zu bytes, at most %d are kept", id,
                        strlen(text), JOINT_ORDER_MAX);
    err_t e = folder_path(s->path, STORE_RIG, id, path);
    if (!e)
        e = folder_path(s->path, STORE_TMP "rig-", id, tmp);
    if (e)
        return e;
    e = write_order(s, tmp, text);
    if (!e)
        e = store_fs_move(s->fs, tmp, path);
    shown = !e;
    if (!e)
        e = store_fs_sync_dir(s->fs, s->path);
    if (!e)
        return OK;
    snprintf(why, sizeof why, "%s", err_text());
    if (!shown)
        store_fs_remove(s->fs, tmp, store_files_of_staging);
    else if (store_keep_drop(s, STORE_RIG, id, store_files_of_staging) != OK)
        return err_fail(e, "%s; its order stays", why);
    return err_fail(e, "%s", why);
}

err_t joint_change(struct store *s, const char *id, const char *text)
{
    char dir[FILE_PATH_CAP], path[FILE_PATH_CAP], tmp[FILE_PATH_CAP];
    err_t e = folder_path(s->path, STORE_RIG, id, dir);
    if (!e)
        e = file_join(dir, STORE_RIG_ORDER, path);
    if (!e)
        e = file_join(dir, STORE_RIG_ORDER STORE_RIG_PART, tmp);
    if (e)
        return e;
    s->fs->unlink(tmp); // left by a crash
    e = store_fs_write(s->fs, tmp, text, strlen(text));
    if (!e && s->fs->rename(tmp, path, 0) != 0)
        e = err_fail(file_code(errno), "%s: cannot be replaced: %s", path, strerror(errno));
    return e ? e : store_fs_sync_dir(s->fs, dir);
}

err_t joint_drop(struct store *s, const char *id)
{
    char path[FILE_PATH_CAP];
    err_t e = folder_path(s->path, STORE_RIG, id, path);
    if (e || !file_is_dir(path))
        return e;
    return store_keep_drop(s, STORE_RIG, id, store_files_of_staging);
}

int joint_pending(const char *store, char (*ids)[STORE_ID_CAP], int cap)
{
    char path[FILE_PATH_CAP];
    int n = store_list_prefix(store, STORE_RIG, ids, cap), kept = 0;
    for (int i = 0; i < n; i++) {
        if (folder_path(store, "", ids[i], path) != OK || file_is_dir(path))
            continue;
        memmove(ids[kept++], ids[i], STORE_ID_CAP);
    }
    return kept;
}

err_t joint_order(const char *store, const char *id, char **text)
{
    char path[FILE_PATH_CAP], file[FILE_PATH_CAP];
    size_t n;
    *text = NULL;
    err_t e = folder_path(store, STORE_RIG, id, path);
    if (!e)
        e = file_join(path, STORE_RIG_ORDER, file);
    if (e)
        return e;
    char *p = malloc(JOINT_ORDER_MAX + 2); // one more shows that it is too long
    if (!p)
        return err_fail(ERR_NOMEM, "%s: no memory to read it", file);
    e = store_fs_read(&store_fs_system, file, p, JOINT_ORDER_MAX + 1, &n);
    if (!e && n > JOINT_ORDER_MAX)
        e = err_fail(ERR_FORMAT, "%s: longer than %d bytes", file, JOINT_ORDER_MAX);
    if (e) {
        free(p);
        return e;
    }
    p[n] = 0;
    *text = p;
    return OK;
}

/* ---- parts ---- */

err_t joint_part_path(const char *store, const char *id, const char *member,
                      char out[FILE_PATH_CAP])
{
    char path[FILE_PATH_CAP];
    if (!manifest_is_member(member))
        return err_fail(ERR_ARG, "\"%.40s\" is not the name of a board", member);
    err_t e = folder_path(store, STORE_RIG, id, path);
    return e ? e : file_join(path, member, out);
}

err_t joint_part_make(struct store *s, const char *id, const char *member)
{
    char path[FILE_PATH_CAP], folder[FILE_PATH_CAP];
    err_t e = joint_part_path(s->path, id, member, path);
    if (!e && !file_is_dir(path))
        e = store_fs_mkdir(s->fs, path);
    for (int i = 1; i < STORE_FOLDERS && !e; i++) {
        e = file_join(path, store_folders[i], folder);
        if (!e && !file_is_dir(folder))
            e = store_fs_mkdir(s->fs, folder);
    }
    return e;
}

static err_t link_file(struct store *s, const char *from, const char *to, const char *name)
{
    char a[FILE_PATH_CAP], b[FILE_PATH_CAP];
    bool copied;
    err_t e = file_join(from, name, a);
    if (!e)
        e = file_join(to, name, b);
    if (!e && manifest_is_thumb(name) && !file_exists(a))
        return OK; // it may be missing
    return e || file_exists(b) ? e : store_fs_link(s->fs, a, b, &copied);
}

err_t joint_part_own(struct store *s, const char *id, const char *member, const char *part)
{
    char from[FILE_PATH_CAP], to[FILE_PATH_CAP];
    struct manifest *m = malloc(sizeof *m);
    if (!m)
        return err_fail(ERR_NOMEM, "%s: no memory for its manifest", part);
    err_t e = folder_path(s->path, "", part, from);
    if (!e)
        e = store_check_manifest(s->fs, from, m);
    if (!e)
        e = joint_part_make(s, id, member);
    if (!e)
        e = joint_part_path(s->path, id, member, to);
    if (!e)
        e = link_file(s, from, to, MANIFEST_FILE);
    for (int i = 0; !e && i < m->n; i++)
        e = link_file(s, from, to, m->file[i].name);
    free(m);
    return e;
}

err_t joint_part_files(const char *store, const char *id, const char *member, struct manifest *out)
{
    char path[FILE_PATH_CAP];
    memset(out, 0, sizeof *out);
    err_t e = joint_part_path(store, id, member, path);
    if (e)
        return e;
    struct part *p = malloc(sizeof *p);
    if (!p)
        return err_fail(ERR_NOMEM, "%s: no memory for its manifest", path);
    e = part_read(&store_fs_system, path, id, member, p);
    if (!e) {
        *out = p->manifest;
        part_free(p);
    }
    free(p);
    return e;
}
