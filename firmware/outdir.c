#include "firmware/outdir.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

enum { TREE_FDS = 16 };

static int remove_entry(const char *path, const struct stat *st, int kind, struct FTW *where)
{
    (void)st;
    (void)kind;
    (void)where;
    return remove(path);
}

static void remove_tree(const char *path)
{
    (void)nftw(path, remove_entry, TREE_FDS,
               FTW_DEPTH | FTW_PHYS); // what stays is found by the next run
}

/* ---- names ---- */

/* Copy the path without slashes at its end and split it. */
static err_t split(const char *path, char copy[FILE_PATH_CAP], char parent[FILE_PATH_CAP],
                   const char **name)
{
    size_t n = strlen(path);
    while (n > 1 && path[n - 1] == '/')
        n--;
    if (n >= FILE_PATH_CAP)
        return err_fail(ERR_ARG, "%.64s...: path of %zu bytes, allowed are %d", path, n,
                        FILE_PATH_CAP - 1);
    memcpy(copy, path, n);
    copy[n] = 0;
    char *slash = strrchr(copy, '/');
    *name = slash ? slash + 1 : copy;
    if (!**name || strcmp(*name, ".") == 0 || strcmp(*name, "..") == 0)
        return err_fail(ERR_ARG, "\"%s\": give a folder of its own for the result", path);
    size_t up = slash ? (size_t)(slash - copy) : 0;
    memcpy(parent, up ? copy : slash ? "/" : ".", up ? up : 1);
    parent[up ? up : 1] = 0;
    return OK;
}

static err_t make_parents(char *path)
{
    for (char *s = path + 1;; s++) {
        char was = *s;
        if (was && was != '/')
            continue;
        *s = 0;
        int failed = mkdir(path, 0777) != 0 && errno != EEXIST;
        int why = errno;
        *s = was;
        if (failed)
            return err_fail(ERR_IO, "%s: cannot create: %s", path, strerror(why));
        if (!was)
            return OK;
    }
}

/* ---- what is there already ---- */

static bool is_empty(const char *path)
{
    DIR *d = opendir(path);
    int n = 0;
    while (d && readdir(d))
        n++;
    if (d)
        closedir(d);
    return d && n <= 2; // . and ..
}

static err_t check_replaceable(const char *path)
{
    struct stat st;
    char report[FILE_PATH_CAP];
    if (lstat(path, &st) != 0)
        return errno == ENOENT ? OK : err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    if (!S_ISDIR(st.st_mode))
        return err_fail(ERR_ARG, "%s: exists and is not a folder", path);
    err_t e = file_join(path, OUTDIR_REPORT, report);
    if (e || file_is_regular(report) || is_empty(path))
        return e;
    return err_fail(ERR_ARG, "%s: exists and is no former result (no %s in it): not replaced", path,
                    OUTDIR_REPORT);
}

/* Remove a folder that a dead process left: nobody holds its lock. */
static void remove_stale(const char *path)
{
    int fd = open(path, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
    if (fd < 0)
        return;
    if (flock(fd, LOCK_EX | LOCK_NB) == 0)
        remove_tree(path);
    close(fd);
}

static bool is_pid(const char *s)
{
    return *s && s[strspn(s, "0123456789")] == 0;
}

static void remove_all_stale(const char *parent, const char *name)
{
    char prefix[FILE_PATH_CAP], path[FILE_PATH_CAP];
    int n = snprintf(prefix, sizeof prefix, ".tmp-%s-", name);
    DIR *d = n < (int)sizeof prefix ? opendir(parent) : NULL;
    for (struct dirent *entry; d && (entry = readdir(d));)
        if (strncmp(entry->d_name, prefix, (size_t)n) == 0 && is_pid(entry->d_name + n) &&
            file_join(parent, entry->d_name, path) == OK)
            remove_stale(path);
    if (d)
        closedir(d);
}

/* ---- the folder ---- */

err_t outdir_open(const char *path, struct outdir *o)
{
    char parent[FILE_PATH_CAP], tmp[FILE_PATH_CAP];
    const char *name;
    memset(o, 0, sizeof *o);
    err_t e = split(path, o->path, parent, &name);
    if (!e)
        e = check_replaceable(o->path);
    if (!e)
        e = make_parents(parent);
    if (e)
        goto fail;
    remove_all_stale(parent, name);
    int n = snprintf(tmp, sizeof tmp, "%s/.tmp-%s-%ld", parent, name, (long)getpid());
    e = n < (int)sizeof tmp ? OK : err_fail(ERR_ARG, "%.64s...: path too long", path);
    if (!e && mkdir(tmp, 0777) != 0)
        e = err_fail(ERR_IO, "%s: cannot create: %s", tmp, strerror(errno));
    if (e)
        goto fail;
    memcpy(o->tmp, tmp, sizeof tmp);
    o->fd = open(tmp, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (o->fd < 0)
        e = err_fail(ERR_IO, "%s: %s", tmp, strerror(errno));
    else if (flock(o->fd, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK)
        e = err_fail(ERR_BUSY, "%s: another process is removing it, try again", tmp);
    if (!e)
        return OK;
fail:
    outdir_close(o);
    return e;
}

static err_t room(const struct outdir *o, uint64_t *bytes)
{
    struct statvfs v;
    if (statvfs(o->tmp, &v) != 0)
        return err_fail(ERR_IO, "%s: %s", o->tmp, strerror(errno));
    *bytes = (uint64_t)v.f_bavail * v.f_frsize;
    return OK;
}

err_t outdir_reserve(struct outdir *o, uint64_t bytes)
{
    uint64_t have = 0;
    o->need = bytes;
    err_t e = room(o, &have);
    if (!e && have < bytes)
        return err_fail(ERR_LIMIT,
                        "%s: the result takes up to %" PRIu64 " bytes, there is room for %" PRIu64,
                        o->path, bytes, have);
    return e;
}

err_t outdir_reason(const struct outdir *o, err_t e)
{
    char text[320];
    uint64_t have = 0;
    struct rlimit file;
    if (e != ERR_IO)
        return e;
    snprintf(text, sizeof text, "%s", err_text());
    if (room(o, &have) != OK)
        return err_fail(e, "%s", text);
    if (getrlimit(RLIMIT_FSIZE, &file) == 0 && file.rlim_cur < have)
        have = file.rlim_cur;
    if (have >= o->need)
        return e;
    return err_fail(ERR_LIMIT,
                    "%s (the result takes up to %" PRIu64 " bytes, there is room for %" PRIu64 ")",
                    text, o->need, have);
}

err_t outdir_path(const struct outdir *o, const char *name, char path[FILE_PATH_CAP])
{
    return file_join(o->tmp, name, path);
}

err_t outdir_mkdir(struct outdir *o, const char *name)
{
    char path[FILE_PATH_CAP];
    err_t e = outdir_path(o, name, path);
    if (!e && mkdir(path, 0777) != 0)
        return err_fail(file_code(errno), "%s: cannot create: %s", path, strerror(errno));
    return e;
}

static err_t sync_dir(const char *path)
{
    int fd = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    bool ok = fd >= 0 && (fsync(fd) == 0 || errno == EINVAL); // EINVAL: a file system without it
    err_t e = ok ? OK : err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    if (fd >= 0)
        close(fd);
    return e;
}

static err_t sync_tree(const char *path)
{
    DIR *d = opendir(path);
    if (!d)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    err_t e = OK;
    char sub[FILE_PATH_CAP];
    for (struct dirent *entry; !e && (entry = readdir(d));) {
        if (entry->d_name[0] == '.')
            continue;
        e = file_join(path, entry->d_name, sub);
        if (!e && file_is_dir(sub))
            e = sync_dir(sub);
    }
    closedir(d);
    return e ? e : sync_dir(path);
}

err_t outdir_commit(struct outdir *o)
{
    char copy[FILE_PATH_CAP], parent[FILE_PATH_CAP];
    const char *name;
    err_t e = split(o->path, copy, parent, &name);
    if (!e)
        e = sync_tree(o->tmp);
    if (!e)
        e = check_replaceable(o->path); // it may have changed while we worked
    if (e)
        return e;
    bool replace = file_is_dir(o->path) && !is_empty(o->path);
    int failed = replace ? renameat2(AT_FDCWD, o->tmp, AT_FDCWD, o->path, RENAME_EXCHANGE)
                         : rename(o->tmp, o->path);
    if (failed && errno == EINVAL && replace)
        return err_fail(
            ERR_IO, "%s: this file system cannot exchange folders; remove the former result first",
            o->path);
    if (failed)
        return err_fail(ERR_IO, "%s: cannot make the result visible: %s", o->path, strerror(errno));
    if (replace)
        remove_tree(o->tmp); // holds the former result now
    o->tmp[0] = 0;
    return sync_dir(parent);
}

void outdir_close(struct outdir *o)
{
    if (o->tmp[0])
        remove_tree(o->tmp);
    if (o->fd > 0)
        close(o->fd);
    memset(o, 0, sizeof *o);
}
