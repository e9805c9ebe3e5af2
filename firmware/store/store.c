/* A take becomes visible by one rename, after every byte of it and every name in it is on the disk;
 * that rename is synced before store_commit returns. The counter is replaced before,
 * and the sync that makes the take durable makes the counter so too; should a crash keep only one
 * of both, the next number is beyond the larger one. A take that is removed gets a .tmp- name
 * first, which is synced before the first file goes.
 * One process at a time: it holds a lock on the folder. Protocol: firmware/store/README.md 1. */
#include "firmware/store/store.h"

#include "firmware/store/store_inner.h"
#include "firmware/store/store_media.h"

#include "core/base/log.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

enum { CHECKED = 3, BOOT_DIGITS = 8 }; // takes that store_open verifies

const char *const store_folders[STORE_FOLDERS] = {"", "images", "raw", "merged", "masks", "thumbs"};
static const char boot_path[] = "/proc/sys/kernel/random/boot_id";
static const char counter_name[] = "counter", aborted[] = STORE_ABORTED;
static const uint64_t counter_max = 999999999;

/* ---- names ---- */

uint64_t store_number(const char *name, bool *is_aborted)
{
    size_t skip = sizeof aborted - 1;
    *is_aborted = strncmp(name, aborted, skip) == 0;
    name += *is_aborted ? skip : 0;
    if (strspn(name, "0123456789abcdef") != BOOT_DIGITS || name[BOOT_DIGITS] != '-')
        return 0;
    name += BOOT_DIGITS + 1;
    size_t n = strspn(name, "0123456789");
    uint64_t v = n >= 6 && n <= 9 && !name[n] ? strtoull(name, NULL, 10) : 0;
    char again[16];
    snprintf(again, sizeof again, "%06" PRIu64, v);
    return strcmp(again, name) == 0 ? v : 0;
}

bool store_is_id(const char *name)
{
    bool is_aborted;
    return strlen(name) < STORE_ID_CAP && store_number(name, &is_aborted) != 0;
}

bool store_next_entry(DIR *d, const char *prefix, struct store_entry *out)
{
    const size_t skip = strlen(prefix);
    for (struct dirent *entry; (entry = readdir(d));) {
        struct stat st;
        if (strncmp(entry->d_name, prefix, skip) != 0)
            continue;
        out->number = store_number(entry->d_name + skip, &out->is_aborted);
        if (!out->number || fstatat(dirfd(d), entry->d_name, &st, AT_SYMLINK_NOFOLLOW) != 0 ||
            !S_ISDIR(st.st_mode))
            continue;
        snprintf(out->id, sizeof out->id, "%.*s", STORE_ID_CAP - 1, entry->d_name + skip);
        return true;
    }
    return false;
}

bool store_comes_before(const struct store_entry *a, const struct store_entry *b)
{
    return a->number != b->number ? a->number > b->number : strcmp(a->id, b->id) > 0;
}

int store_list(const struct store *s, char (*ids)[STORE_ID_CAP], int cap)
{
    return store_list_in(s->path, ids, cap);
}

int store_list_in(const char *path, char (*ids)[STORE_ID_CAP], int cap)
{
    return store_list_prefix(path, "", ids, cap);
}

int store_list_prefix(const char *path, const char *prefix, char (*ids)[STORE_ID_CAP], int cap)
{
    struct store_entry x, other;
    int n = 0;
    DIR *d = opendir(path);
    while (d && store_next_entry(d, prefix, &x)) {
        int at = n;
        for (; at > 0; at--) {
            memcpy(other.id, ids[at - 1], STORE_ID_CAP);
            other.number = store_number(other.id, &other.is_aborted);
            if (store_comes_before(&other, &x))
                break;
            if (at < cap)
                memcpy(ids[at], ids[at - 1], STORE_ID_CAP);
        }
        if (at < cap)
            memcpy(ids[at], x.id, STORE_ID_CAP);
        n += n < cap;
    }
    if (d)
        closedir(d);
    return n;
}

/* ---- parts of a rig's takes ---- */

bool store_is_part(const struct store_fs *fs, const char *path, const char *id,
                   char take[MANIFEST_ID_CAP], char member[TAKE_MEMBER_CAP])
{
    char dir[FILE_PATH_CAP], file[FILE_PATH_CAP], head[MANIFEST_HEAD];
    size_t n;
    return file_join(path, id, dir) == OK && file_join(dir, MANIFEST_FILE, file) == OK &&
           store_fs_read(fs, file, head, sizeof head, &n) == OK &&
           manifest_part(head, n, take, member);
}

int store_parts(const char *path, struct store_part *out, int cap)
{
    struct store_entry x, other;
    struct store_part part;
    int n = 0;
    DIR *d = opendir(path);
    while (d && store_next_entry(d, "", &x)) {
        memcpy(part.id, x.id, sizeof part.id);
        if (x.is_aborted ||
            !store_is_part(&store_fs_system, path, x.id, part.rig_take, part.rig_member))
            continue;
        int at = n;
        for (; at > 0; at--) {
            memcpy(other.id, out[at - 1].id, sizeof other.id);
            other.number = store_number(other.id, &other.is_aborted);
            if (store_comes_before(&other, &x))
                break;
            if (at < cap)
                out[at] = out[at - 1];
        }
        if (at < cap)
            out[at] = part;
        n += n < cap;
    }
    if (d)
        closedir(d);
    return n;
}

/* The newest part of that take; false: there is none. */
static bool find_part(const struct store *s, const char *rig_take, struct store_entry *out)
{
    struct store_entry x;
    char take[MANIFEST_ID_CAP], member[TAKE_MEMBER_CAP];
    bool found = false;
    DIR *d = opendir(s->path);
    while (d && store_next_entry(d, "", &x))
        if (!x.is_aborted && (!found || store_comes_before(&x, out)) &&
            store_is_part(s->fs, s->path, x.id, take, member) && strcmp(take, rig_take) == 0) {
            *out = x;
            found = true;
        }
    if (d)
        closedir(d);
    return found;
}

err_t store_release(struct store *s, const char *rig_take)
{
    struct store_entry x = {0};
    err_t e = OK;
    pthread_mutex_lock(&s->lock);
    while (!e && find_part(s, rig_take, &x))
        e = store_keep_remove(s, x.id);
    pthread_mutex_unlock(&s->lock);
    return e;
}

/* ---- opening ---- */

err_t store_verify(const char *dir)
{
    struct manifest *m = malloc(sizeof *m);
    if (!m)
        return err_fail(ERR_NOMEM, "%s: no memory for its manifest", dir);
    err_t e = store_check_take(&store_fs_system, dir, m);
    free(m);
    return e;
}

static err_t sync_parent(const struct store *s, char *path)
{
    char *slash = strrchr(path, '/');
    if (!slash)
        return store_fs_sync_dir(s->fs, ".");
    if (slash == path)
        return store_fs_sync_dir(s->fs, "/");
    *slash = 0;
    err_t e = store_fs_sync_dir(s->fs, path);
    *slash = '/';
    return e;
}

/* The folder and those above it, so that a power cut finds them: also those that are there, which a
 * former run may have made and not brought to the disk. Errors of folders that
 * exist are ignored: the program may lack permission for them. */
static err_t make_folders(const struct store *s)
{
    char path[FILE_PATH_CAP];
    err_t e = OK;
    for (size_t i = 1; !e && s->path[i - 1]; i++) {
        if (s->path[i] && s->path[i] != '/')
            continue;
        memcpy(path, s->path, i);
        path[i] = 0;
        bool there = file_is_dir(path);
        if (!there)
            e = store_fs_mkdir(s->fs, path);
        if (!e)
            e = sync_parent(s, path);
        if (there)
            e = OK;
    }
    return e;
}

static err_t lock_store(struct store *s)
{
    s->fd = open(s->path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (s->fd < 0)
        return err_fail(ERR_IO, "%s: cannot be opened: %s", s->path, strerror(errno));
    if (flock(s->fd, LOCK_EX | LOCK_NB) != 0)
        return errno == EWOULDBLOCK
                   ? err_fail(ERR_BUSY, "%s: another process stores its captures there", s->path)
                   : err_fail(ERR_IO, "%s: cannot be locked: %s", s->path, strerror(errno));
    if (s->fs->access(s->path, R_OK | W_OK | X_OK) != 0)
        return err_fail(ERR_IO, "%s: captures cannot be stored there: %s", s->path,
                        strerror(errno));
    return OK;
}

static err_t read_boot(struct store *s)
{
    size_t n;
    err_t e = store_fs_read(&store_fs_system, boot_path, s->boot, sizeof s->boot - 1, &n);
    if (!e && strspn(s->boot, "0123456789abcdef-") != sizeof s->boot - 1)
        e = err_fail(ERR_FORMAT, "%s: \"%.40s\" is not a boot id", boot_path, s->boot);
    return e;
}

static bool is_tmp_name(const char *name)
{
    const size_t n = sizeof STORE_TMP - 1;
    return strncmp(name, STORE_TMP, n) == 0 &&
           (strcmp(name + n, counter_name) == 0 || strcmp(name + n, STORE_SESSION_ENDED) == 0 ||
            store_is_id(name + n));
}

/* A staging folder that was on its way out, or in. */
static bool is_tmp_staging(const char *name)
{
    static const char first[] = STORE_TMP "rig-";
    const size_t n = sizeof first - 1;
    return strncmp(name, first, n) == 0 && store_is_id(name + n);
}

/* Remove the leftovers of a crash, once their temporary names are on the disk: a folder with the
 * name of a take must stay whole. */
static void remove_leftovers(struct store *s)
{
    char path[FILE_PATH_CAP];
    if (store_fs_sync_dir(s->fs, s->path) != OK) {
        log_warn("%s", err_text());
        return;
    }
    DIR *d = opendir(s->path);
    for (struct dirent *entry; d && (entry = readdir(d));) {
        const bool staging = is_tmp_staging(entry->d_name);
        if ((staging || is_tmp_name(entry->d_name)) &&
            file_join(s->path, entry->d_name, path) == OK)
            store_fs_remove(s->fs, path, staging ? store_files_of_staging : store_files_of_take);
    }
    if (d)
        closedir(d);
}

static void skip_numbers(struct store *s, const char *prefix)
{
    struct store_entry x;
    DIR *d = opendir(s->path);
    while (d && store_next_entry(d, prefix, &x))
        s->next = x.number >= s->next ? x.number + 1 : s->next;
    if (d)
        closedir(d);
}

/* Reads the counter. If it lags behind the names or cannot be read, the number after the
 * largest name is used. */
static void read_counter(struct store *s)
{
    char path[FILE_PATH_CAP], text[32] = "";
    size_t n = 0;
    bool ok = file_join(s->path, counter_name, path) == OK &&
              store_fs_read(s->fs, path, text, sizeof text - 1, &n) == OK;
    char *end = text;
    uint64_t v = ok && text[0] >= '0' && text[0] <= '9' ? strtoull(text, &end, 10) : 0;
    ok = ok && n > 1 && strcmp(end, "\n") == 0 && v >= 1 && v <= counter_max;
    s->next = ok ? v : 1;
    skip_numbers(s, "");
    skip_numbers(s, STORE_RIG);
    if (!ok && n > 0)
        log_warn("%s: its number is not in 1 to %" PRIu64 ", %" PRIu64 " is used", path,
                 counter_max, s->next);
}

/* Renames a damaged take. Only a faulty disk or a change by another program damages one. */
static void check_take(struct store *s, const char *id)
{
    char path[FILE_PATH_CAP], name[STORE_ID_CAP + 16], aside[FILE_PATH_CAP];
    err_t e = file_join(s->path, id, path);
    if (!e)
        e = store_check_take(s->fs, path, &s->old);
    if (!e)
        return;
    log_warn("%s", err_text());
    snprintf(name, sizeof name, "damaged-%s", id);
    if (e == ERR_FORMAT &&
        (file_join(s->path, name, aside) != OK || store_fs_move(s->fs, path, aside) != OK))
        log_warn("%s", err_text());
}

static err_t set_path(struct store *s, const char *path)
{
    size_t n = path ? strlen(path) : 0;
    while (n > 1 && path[n - 1] == '/')
        n--;
    if (n == 0 || n >= FILE_PATH_CAP - 128)
        return err_fail(ERR_ARG, "store: the path has %zu bytes, 1 to %d are allowed", n,
                        FILE_PATH_CAP - 129);
    memcpy(s->path, path, n);
    return OK;
}

err_t store_open_on(const struct store_fs *fs, const struct store_config *cfg, struct store **out)
{
    char last[CHECKED][STORE_ID_CAP];
    *out = NULL;
    struct store *s = calloc(1, sizeof *s);
    if (!s)
        return err_fail(ERR_NOMEM, "store: no memory for its state");
    s->fs = fs;
    s->cfg = *cfg;
    s->fd = -1;
    pthread_mutex_init(&s->lock, NULL);
    err_t e = cfg->keep >= 0
                  ? set_path(s, cfg->path)
                  : err_fail(ERR_ARG, "store.keep is %d takes, at least 0 is needed", cfg->keep);
    if (!e)
        e = make_folders(s);
    if (!e)
        e = lock_store(s);
    if (!e)
        e = read_boot(s);
    if (e) {
        store_close(s);
        return e;
    }
    remove_leftovers(s);
    read_counter(s);
    for (int i = store_list(s, last, CHECKED) - 1; i >= 0; i--)
        check_take(s, last[i]);
    store_keep_unstage(s);
    *out = s;
    return OK;
}

err_t store_open(const struct store_config *cfg, struct store **out)
{
    return store_open_on(&store_fs_system, cfg, out);
}

void store_close(struct store *s)
{
    if (s && s->fd >= 0)
        close(s->fd);
    if (s)
        pthread_mutex_destroy(&s->lock);
    free(s);
}

/* ---- space ---- */

uint64_t store_need(const struct store *s, const struct camera_info *info, int frames)
{
    return store_media_need(info, frames, s->cfg.merge);
}

err_t store_room(const struct store *s, uint64_t bytes)
{
    struct statvfs v;
    if (s->fs->room(s->path, &v) != 0)
        return err_fail(ERR_IO, "%s: its free space cannot be read: %s", s->path, strerror(errno));
    uint64_t have = (uint64_t)v.f_bavail * v.f_frsize;
    if (bytes <= have && s->cfg.reserve <= have - bytes)
        return OK;
    return err_fail(ERR_LIMIT,
                    "%s: a capture takes up to %" PRIu64 " bytes and %" PRIu64
                    " are to stay free, there is room for %" PRIu64,
                    s->path, bytes, s->cfg.reserve, have);
}

/* ---- a new take ---- */

/* The next number is on the disk before this one is used. */
static err_t advance_counter(struct store *s)
{
    char path[FILE_PATH_CAP], tmp[FILE_PATH_CAP], text[32];
    if (s->next > counter_max)
        return err_fail(ERR_LIMIT,
                        "%s: %" PRIu64 " is the last number, no more takes can be stored", s->path,
                        counter_max);
    int n = snprintf(text, sizeof text, "%" PRIu64 "\n", s->next + 1);
    err_t e = file_join(s->path, counter_name, path);
    if (!e)
        e = file_join(s->path, ".tmp-counter", tmp);
    if (e)
        return e;
    s->fs->unlink(tmp); // left by a crash
    e = store_fs_write(s->fs, tmp, text, (size_t)n);
    if (!e && s->fs->rename(tmp, path, 0) != 0)
        e = err_fail(file_code(errno), "%s: cannot be replaced: %s", path, strerror(errno));
    s->next += !e;
    return e;
}

err_t store_next(struct store *s, uint64_t *number, char id[STORE_ID_CAP])
{
    id[0] = 0;
    pthread_mutex_lock(&s->lock);
    *number = s->next;
    err_t e = advance_counter(s);
    pthread_mutex_unlock(&s->lock);
    if (!e)
        snprintf(id, STORE_ID_CAP, "%.*s-%06" PRIu64, BOOT_DIGITS, s->boot, *number);
    return e;
}

err_t store_reserve(struct store *s, char id[STORE_ID_CAP])
{
    uint64_t number;
    err_t e = store_next(s, &number, id);
    if (!e)
        e = store_fs_sync_dir(s->fs, s->path);
    if (e)
        id[0] = 0;
    return e;
}

err_t store_name(const struct store *s, const char *id, struct store_new *out)
{
    char name[STORE_ID_CAP + 8];
    out->s = s;
    out->shown = false;
    snprintf(name, sizeof name, STORE_TMP "%s", id);
    err_t e = file_join(s->path, id, out->path);
    return e ? e : file_join(s->path, name, out->tmp);
}

err_t store_create(const struct store_new *n, const char *name, char path[FILE_PATH_CAP],
                   struct store_fs_file *out)
{
    err_t e = file_join(n->tmp, name, path);
    return e ? e : store_fs_create(n->s->fs, path, out);
}

err_t store_show(struct store_new *n)
{
    err_t e = store_fs_move(n->s->fs, n->tmp, n->path);
    n->shown = !e;
    return e ? e : store_fs_sync_dir(n->s->fs, n->s->path);
}

void store_take_back(const struct store_new *n)
{
    const struct store_fs *fs = n->s->fs;
    err_t e = n->shown ? store_fs_move(fs, n->path, n->tmp) : OK;
    if (!e && n->shown)
        e = store_fs_sync_dir(fs, n->s->path);
    if (!e)
        store_fs_remove(fs, n->tmp, store_files_of_take);
    else
        log_warn("%s", err_text());
}
