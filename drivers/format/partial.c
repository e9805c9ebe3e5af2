#include "drivers/format/partial.h"

#include "drivers/format/filelist.h"
#include "drivers/format/origin.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

enum { TREE_FDS = 16, NAME_CUT = 200 }; // bytes: with prefix and process a name may have 255

static int remove_entry(const char *path, const struct stat *st, int kind, struct FTW *where)
{
    (void)st;
    (void)kind;
    if (where->level > 0 &&
        !(where->level == 1 && strcmp(path + where->base, FILELIST_PARTIAL) == 0))
        (void)remove(path);
    return 0;
}

/* The mark goes last, so that the next run still finds the rest. */
static void remove_tree(const char *path)
{
    char mark[FILE_PATH_CAP];
    (void)nftw(path, remove_entry, TREE_FDS, FTW_DEPTH | FTW_PHYS);
    if (rmdir(path) != 0 && file_join(path, FILELIST_PARTIAL, mark) == OK && unlink(mark) == 0)
        (void)rmdir(path);
}

static bool lock_folder(int fd)
{
    return flock(fd, LOCK_EX | LOCK_NB) == 0;
}

/* Remove what a dead process left: it died before it was done, after the result of that name was
 * exchanged for a new one, or between its first two steps. */
static void remove_ours(const char *path)
{
    char mark[FILE_PATH_CAP];
    if (file_join(path, FILELIST_PARTIAL, mark) == OK && file_is_regular(mark))
        remove_tree(path);
    else if (rmdir(path) != 0 && filelist_check(path, false) == OK && filelist_remove(path) != OK)
        return; // the next run finds the rest
}

static void remove_unlocked(const char *path)
{
    int fd = open(path, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
    if (fd < 0)
        return;
    if (lock_folder(fd))
        remove_ours(path);
    close(fd);
}

static bool is_pid(const char *s)
{
    return *s && s[strspn(s, "0123456789")] == 0;
}

static void remove_leftovers(const char *parent, const char *prefix)
{
    char path[FILE_PATH_CAP];
    size_t n = strlen(prefix);
    DIR *d = opendir(parent);
    for (struct dirent *entry; d && (entry = readdir(d));)
        if (strncmp(entry->d_name, prefix, n) == 0 && is_pid(entry->d_name + n) &&
            file_join(parent, entry->d_name, path) == OK)
            remove_unlocked(path);
    if (d)
        closedir(d);
}

static err_t put_mark(const struct partial *p)
{
    char path[FILE_PATH_CAP];
    FILE *f;
    err_t e = file_join(p->dir, FILELIST_PARTIAL, path);
    if (!e)
        e = file_create(path, &f);
    if (e)
        return e;
    fclose(f); // nothing to write, nothing to lose
    return OK;
}

err_t partial_unmark(const struct partial *p)
{
    char path[FILE_PATH_CAP];
    err_t e = file_join(p->dir, FILELIST_PARTIAL, path);
    if (!e && unlink(path) != 0)
        e = err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    return e;
}

/* Lock the new folder. Another process that took it for a leftover may hold the lock or have
 * removed the folder. On a file system without locks leftovers are never removed. */
static err_t lock_new_folder(struct partial *p, const char *path)
{
    struct stat st;
    p->fd = open(p->dir, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
    if (p->fd < 0)
        return err_fail(file_code(errno), "%s: %s", p->dir, strerror(errno));
    if ((!lock_folder(p->fd) && errno == EWOULDBLOCK) || fstat(p->fd, &st) != 0 || st.st_nlink == 0)
        return err_fail(ERR_BUSY, "%s: another process is cleaning up there, try again", path);
    return OK;
}

err_t partial_open(const char *path, struct partial *p)
{
    char parent[FILE_PATH_CAP], dir[FILE_PATH_CAP], prefix[NAME_CUT + 8], name[NAME_CUT + 32];
    const char *of = file_name(path);
    memset(p, 0, sizeof *p);
    if (!*of || strcmp(of, ".") == 0 || strcmp(of, "..") == 0)
        return err_fail(ERR_ARG, "\"%.64s\": does not end with a name", path);
    snprintf(prefix, sizeof prefix, ".tmp-%.*s-", NAME_CUT, of);
    snprintf(name, sizeof name, "%s%ld", prefix, (long)getpid());
    err_t e = file_parent(path, parent);
    if (!e)
        e = file_join(parent, name, dir);
    if (e)
        return e;
    remove_leftovers(parent, prefix);
    if (mkdir(dir, 0777) != 0)
        return errno == EEXIST
                   ? err_fail(ERR_BUSY, "%s: is being written already", path)
                   : err_fail(file_code(errno), "%s: cannot create: %s", path, strerror(errno));
    memcpy(p->dir, dir, sizeof dir);
    e = lock_new_folder(p, path);
    if (!e)
        e = put_mark(p);
    if (e)
        partial_close(p);
    return e;
}

err_t partial_path(const struct partial *p, const char *path, char out[FILE_PATH_CAP])
{
    return file_join(p->dir, file_name(path), out);
}

err_t partial_show(const struct partial *p, const char *path)
{
    char from[FILE_PATH_CAP], parent[FILE_PATH_CAP];
    err_t e = partial_path(p, path, from);
    if (!e)
        e = file_parent(path, parent);
    if (!e)
        e = origin_check_place(path);
    if (!e)
        e = file_sync(from);
    if (!e)
        e = file_replace(from, path);
    return e ? e : file_sync(parent);
}

void partial_close(struct partial *p)
{
    if (p->dir[0])
        remove_tree(p->dir);
    if (p->fd > 0)
        close(p->fd);
    memset(p, 0, sizeof *p);
}
