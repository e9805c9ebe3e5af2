/* Takes and staging folders go the way they came: renamed to a temporary name, which is synced, and
 * then their files. */
#include "firmware/store/store_inner.h"

#include "core/base/log.h"

#include <string.h>

err_t store_keep_drop(const struct store *s, const char *prefix, const char *id,
                      bool (*own)(const char *name))
{
    char path[FILE_PATH_CAP], name[STORE_ID_CAP + 16], tmp[FILE_PATH_CAP];
    snprintf(name, sizeof name, "%s%s", prefix, id);
    err_t e = file_join(s->path, name, path);
    snprintf(name, sizeof name, STORE_TMP "%s%s", *prefix ? prefix + 1 : "", id);
    if (!e)
        e = file_join(s->path, name, tmp);
    if (!e)
        e = store_fs_move(s->fs, path, tmp);
    if (!e)
        e = store_fs_sync_dir(s->fs, s->path);
    if (!e)
        store_fs_remove(s->fs, tmp, own);
    return e;
}

/* Check that it is a take of this store without foreign files. */
static err_t check_removable(struct store *s, const char *id)
{
    char path[FILE_PATH_CAP];
    err_t e = file_join(s->path, id, path);
    if (!e)
        e = store_check_manifest(s->fs, path, &s->old);
    if (!e && strcmp(s->old.id, id) != 0)
        e = err_fail(ERR_FORMAT, "%s: its manifest belongs to %s", path, s->old.id);
    for (int i = 0; i < STORE_FOLDERS && !e; i++)
        e = store_check_listed(&s->old, path, store_folders[i]);
    return e;
}

err_t store_keep_remove(struct store *s, const char *id)
{
    err_t e = check_removable(s, id);
    return e ? e : store_keep_drop(s, "", id, store_files_of_take);
}

/* Whether store.keep is about a take: parts of a rig's takes wait for their conductor. */
static bool is_counted(const struct store *s, const struct store_entry *x)
{
    char take[MANIFEST_ID_CAP], member[TAKE_MEMBER_CAP];
    return x->is_aborted || !store_is_part(s->fs, s->path, x->id, take, member);
}

/* How many folders there are of that kind: as many as takes that count, or more. */
static int count_entries(const struct store *s, bool is_aborted)
{
    struct store_entry x;
    int n = 0;
    DIR *d = opendir(s->path);
    while (d && store_next_entry(d, "", &x))
        n += x.is_aborted == is_aborted;
    if (d)
        closedir(d);
    return n;
}

/* The oldest of its kind that is newer than `than` (number 0: of all), and how many of them there
 * are. */
static int oldest_entry(const struct store *s, bool is_aborted, const struct store_entry *than,
                        struct store_entry *out)
{
    struct store_entry x;
    int n = 0;
    DIR *d = opendir(s->path);
    *out = (struct store_entry){0};
    while (d && store_next_entry(d, "", &x))
        if (x.is_aborted == is_aborted && (!than->number || store_comes_before(&x, than)) &&
            is_counted(s, &x) && (n++ == 0 || store_comes_before(out, &x)))
            *out = x;
    if (d)
        closedir(d);
    return n;
}

/* A take with added files is not removed, with one warning; nor are the places of the session that
 * the newest take belongs to. */
void store_keep_newest(struct store *s, bool is_aborted, const char *session)
{
    struct store_entry x, than = {0};
    err_t e = OK;
    if (s->cfg.keep <= 0 || count_entries(s, is_aborted) <= s->cfg.keep)
        return;
    int surplus = oldest_entry(s, is_aborted, &than, &x) - s->cfg.keep;
    for (; surplus > 0 && !e; surplus--, than = x) {
        oldest_entry(s, is_aborted, &than, &x);
        if (check_removable(s, x.id) != OK) {
            if (x.number > s->kept)
                log_warn("%s; the take is kept although store.keep is exceeded", err_text());
            s->kept = x.number > s->kept ? x.number : s->kept;
        } else if (!(s->old.complete && s->old.rig_take[0]) &&
                   (!*session || strcmp(s->old.session, session) != 0)) {
            e = store_keep_drop(s, "", x.id, store_files_of_take);
        }
    }
    if (e)
        log_warn("%s", err_text());
}

void store_keep_unstage(const struct store *s)
{
    struct store_entry x;
    char path[FILE_PATH_CAP];
    DIR *d = opendir(s->path);
    while (d && store_next_entry(d, STORE_RIG, &x))
        if (file_join(s->path, x.id, path) == OK && file_is_dir(path) &&
            store_keep_drop(s, STORE_RIG, x.id, store_files_of_staging) != OK)
            log_warn("%s", err_text());
    if (d)
        closedir(d);
}
