#include "firmware/result/outdir.h"

#include "core/base/log.h"
#include "drivers/format/filelist.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

enum { TREE_FDS = 16 };

/* ---- names ---- */

/* Copy the path without slashes at its end. */
static err_t normalize_path(const char *path, char copy[FILE_PATH_CAP])
{
    size_t n = strlen(path);
    while (n > 1 && path[n - 1] == '/')
        n--;
    if (n >= FILE_PATH_CAP)
        return err_fail(ERR_ARG, "%.64s...: path of %zu bytes, allowed are %d", path, n,
                        FILE_PATH_CAP - 1);
    memcpy(copy, path, n);
    copy[n] = 0;
    const char *name = file_name(copy);
    if (!*name || strcmp(name, ".") == 0 || strcmp(name, "..") == 0)
        return err_fail(ERR_ARG, "\"%s\": give a folder of its own for the result", path);
    return OK;
}

static err_t make_parents(const char *path)
{
    char part[FILE_PATH_CAP];
    for (const char *slash = path; (slash = strchr(slash + 1, '/'));) {
        memcpy(part, path, (size_t)(slash - path));
        part[slash - path] = 0;
        if (mkdir(part, 0777) != 0 && errno != EEXIST)
            return err_fail(file_code(errno), "%s: cannot create: %s", part, strerror(errno));
    }
    return OK;
}

/* ---- the former result ---- */

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

/* Inputs that lie in `real`, an absolute path. */
static err_t check_inputs(const char *path, const char *real, const struct outdir_rules *rules)
{
    size_t n = strlen(real);
    for (int i = 0; rules && i < OUTDIR_INPUTS; i++) {
        char *in = rules->inputs[i] ? realpath(rules->inputs[i], NULL) : NULL;
        bool inside = in && strncmp(in, real, n) == 0 && (in[n] == 0 || in[n] == '/');
        free(in);
        if (inside)
            return err_fail(ERR_ARG,
                            "%s would be replaced, and %s is read from it: give the result a "
                            "folder of its own",
                            path, rules->inputs[i]);
    }
    return OK;
}

static err_t check_replaceable(const char *path, bool force)
{
    struct stat st;
    if (lstat(path, &st) != 0)
        return errno == ENOENT ? OK : err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    if (!S_ISDIR(st.st_mode))
        return err_fail(ERR_ARG, "%s: exists and is not a folder", path);
    return is_empty(path) ? OK : filelist_check(path, !force);
}

static err_t check_place(const char *path, const struct outdir_rules *rules)
{
    char *real = realpath(path, NULL); // NULL: nothing is there
    err_t e = real ? check_inputs(path, real, rules) : OK;
    free(real);
    return e ? e : check_replaceable(path, rules && rules->force);
}

/* ---- the folder ---- */

err_t outdir_open(const char *path, const struct outdir_rules *rules, struct outdir *o)
{
    memset(o, 0, sizeof *o);
    err_t e = normalize_path(path, o->path);
    if (!e)
        e = check_place(o->path, rules);
    if (!e)
        e = make_parents(o->path);
    if (!e)
        e = partial_open(o->path, &o->partial);
    if (e)
        memset(o, 0, sizeof *o);
    else
        o->force = rules && rules->force;
    return e;
}

static err_t free_bytes(const struct outdir *o, uint64_t *bytes)
{
    struct statvfs v;
    if (statvfs(o->partial.dir, &v) != 0)
        return err_fail(ERR_IO, "%s: %s", o->partial.dir, strerror(errno));
    *bytes = (uint64_t)v.f_bavail * v.f_frsize;
    return OK;
}

err_t outdir_reserve(struct outdir *o, uint64_t bytes)
{
    uint64_t have = 0;
    o->need = bytes;
    err_t e = free_bytes(o, &have);
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
    if (free_bytes(o, &have) != OK)
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
    return file_join(o->partial.dir, name, path);
}

err_t outdir_mkdir(struct outdir *o, const char *name)
{
    char path[FILE_PATH_CAP];
    err_t e = outdir_path(o, name, path);
    if (!e && mkdir(path, 0777) != 0)
        return err_fail(file_code(errno), "%s: cannot create: %s", path, strerror(errno));
    return e;
}

err_t outdir_report_open(const struct outdir *o, struct report *rep)
{
    char path[FILE_PATH_CAP];
    FILE *f;
    err_t e = outdir_path(o, OUTDIR_REPORT, path);
    if (!e)
        e = file_create(path, &f);
    if (e)
        return e;
    report_begin(rep, f);
    return OK;
}

err_t outdir_report_close(const struct outdir *o, struct report *rep)
{
    char path[FILE_PATH_CAP];
    report_close(rep);
    err_t e = outdir_path(o, OUTDIR_REPORT, path);
    return e ? e : file_finish(rep->f, path);
}

/* Files were synced when they were written. */
static int sync_folder(const char *path, const struct stat *st, int kind, struct FTW *where)
{
    (void)st;
    (void)where;
    return kind == FTW_DP ? (int)file_sync(path) : 0;
}

static err_t sync_tree(const char *path)
{
    int e = nftw(path, sync_folder, TREE_FDS, FTW_DEPTH | FTW_PHYS);
    return e == -1 ? err_fail(ERR_IO, "%s: %s", path, strerror(errno)) : (err_t)e;
}

static int exchange_folders(const struct outdir *o)
{
    return renameat2(AT_FDCWD, o->partial.dir, AT_FDCWD, o->path, RENAME_EXCHANGE);
}

/* The former result has the name of the partial folder now. If it gained a file in the last moment,
 * everything goes back. */
static err_t remove_former(struct outdir *o)
{
    err_t e = filelist_check(o->partial.dir, false);
    if (e && exchange_folders(o) == 0)
        return e;
    if (!e)
        e = filelist_remove(o->partial.dir);
    if (e) {
        log_warn("%s: what is left of the former result stays there: %s", o->partial.dir,
                 err_text());
        o->partial.dir[0] = 0;
    }
    return OK;
}

static err_t show_result(struct outdir *o)
{
    const char *dir = o->partial.dir;
    bool replace = file_is_dir(o->path) && !is_empty(o->path);
    int failed = replace ? exchange_folders(o) : rename(dir, o->path);
    if (failed && errno == EINVAL && replace)
        return err_fail(
            ERR_IO, "%s: this file system cannot exchange folders; remove the former result first",
            o->path);
    if (failed)
        return err_fail(file_code(errno), "%s: cannot make the result visible: %s", o->path,
                        strerror(errno));
    if (!replace)
        o->partial.dir[0] = 0;
    return replace ? remove_former(o) : OK;
}

err_t outdir_commit(struct outdir *o)
{
    char parent[FILE_PATH_CAP];
    err_t e = file_parent(o->path, parent);
    if (!e)
        e = filelist_write(o->partial.dir);
    if (!e)
        e = sync_tree(o->partial.dir);
    if (!e)
        e = check_replaceable(o->path, o->force); // it may have changed while we worked
    if (!e)
        e = partial_unmark(&o->partial);
    if (!e)
        e = show_result(o);
    if (e)
        return e;
    partial_close(&o->partial);
    return file_sync(parent);
}

void outdir_close(struct outdir *o)
{
    partial_close(&o->partial);
    memset(o, 0, sizeof *o);
}
