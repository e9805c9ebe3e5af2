/* disk_model.h - file operations of the store that are carried out on a folder, counted, made to
 * fail or to kill the process at any call, and written down; and from what was written down, the
 * folder that a power cut would leave.
 *
 * Of a cut is only certain: bytes of a file that were there when it was synced; names in a folder
 * that were there when the folder was synced. Of all that came later each write may be there,
 * missing, half there or zeros, each change of names may be there or not, whatever their order; a
 * rename is one change. Bytes that a failed sync was to bring to the disk, no later one brings. */
#ifndef FAULT_DISK_MODEL_H
#define FAULT_DISK_MODEL_H

#include "firmware/store/store_fs.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { DISK_NODES = 2048, DISK_CHANGES = 8192, DISK_FDS = 64, DISK_NAME = 48 };

enum disk_kind { DISK_MAKE, DISK_RENAME, DISK_REMOVE, DISK_WRITE, DISK_SYNC };

struct disk_change {
    enum disk_kind kind;
    int node, folder; // what; where its name is
    char name[DISK_NAME], to[DISK_NAME];
    off_t at;
    size_t n;
    uint8_t *bytes;
    bool failed; // for DISK_SYNC
};

struct disk_node {
    bool is_folder, gone;
    int folder;
    int file; // whose bytes it has: itself, but for a second name
    char name[DISK_NAME];
};

static struct disk {
    char root[512]; // folder; node 0
    struct disk_node node[DISK_NODES];
    struct disk_change change[DISK_CHANGES];
    int nodes, changes;
    int fd_node[DISK_FDS];
    off_t fd_at[DISK_FDS];
    bool fd_half[DISK_FDS];                    // the last write was of half of what was wanted
    bool watch;                                // changes are written down
    int calls, fail_at, kill_at, dead_at, why; // calls so far; -1: never
    int failed_change;                         // changes before the first failure
    bool for_good, failed; // later calls that change something fail as well; it happened
} disk;

/* Begin with the empty folder `root`; without `watch` calls are only counted, on any folder. */
static inline void disk_reset(const char *root, bool watch)
{
    for (int i = 0; i < disk.changes; i++)
        free(disk.change[i].bytes);
    disk = (struct disk){.nodes = 1,
                         .fail_at = -1,
                         .kill_at = -1,
                         .dead_at = -1,
                         .watch = watch,
                         .node = {{.is_folder = true}}}; // its file is 0, itself
    snprintf(disk.root, sizeof disk.root, "%s", root);
}

/* Whether this call fails. A full disk has no effect on what needs no space. From dead_at on no
 * call has an effect, as if the process had been killed; until the test sets it to -1. */
static inline bool disk_fails(bool changes, bool needs_space)
{
    int call = disk.calls++;
    if (call == disk.kill_at)
        raise(SIGKILL);
    bool full = disk.why == ENOSPC || disk.why == EDQUOT;
    bool now = call == disk.fail_at || (disk.dead_at >= 0 && call >= disk.dead_at) ||
               (disk.for_good && disk.failed && changes && (needs_space || !full));
    if (now && !disk.failed)
        disk.failed_change = disk.changes;
    disk.failed = disk.failed || now;
    if (now)
        errno = disk.why;
    return now;
}

/* The node of a path, -1 if there is none, or not in our folder; where its last name would be, and
 * that name. */
static inline int disk_find(const char *path, int *folder, char name[DISK_NAME])
{
    int node = 0;
    size_t skip = strlen(disk.root);
    *folder = -1;
    name[0] = 0;
    if (strncmp(path, disk.root, skip) != 0)
        return -1;
    for (path += skip; *path;) {
        path += strspn(path, "/");
        size_t n = strcspn(path, "/");
        if (n == 0)
            break;
        if (n >= DISK_NAME || node < 0)
            abort();
        memcpy(name, path, n);
        name[n] = 0;
        *folder = node;
        node = -1;
        for (int i = 1; i < disk.nodes && node < 0; i++)
            if (!disk.node[i].gone && disk.node[i].folder == *folder &&
                strcmp(disk.node[i].name, name) == 0)
                node = i;
        path += n;
    }
    return node;
}

static inline struct disk_change *disk_note(enum disk_kind kind, int node)
{
    if (disk.changes == DISK_CHANGES)
        abort();
    struct disk_change *c = &disk.change[disk.changes++];
    *c = (struct disk_change){.kind = kind, .node = node, .folder = disk.node[node].folder};
    memcpy(c->name, disk.node[node].name, DISK_NAME);
    return c;
}

static inline void disk_make(const char *path, bool is_folder)
{
    int folder;
    char name[DISK_NAME];
    if (!disk.watch)
        return;
    if (disk_find(path, &folder, name) >= 0 || disk.nodes == DISK_NODES)
        abort();
    int node = disk.nodes++;
    disk.node[node] = (struct disk_node){.is_folder = is_folder, .folder = folder, .file = node};
    memcpy(disk.node[node].name, name, DISK_NAME);
    disk_note(DISK_MAKE, node);
}

/* ---- the table ---- */

static inline int disk_open(const char *path, int flags, mode_t mode)
{
    int folder;
    char name[DISK_NAME];
    bool creates = flags & O_CREAT;
    if (disk_fails(creates, creates))
        return -1;
    int fd = open(path, flags, mode);
    if (fd < 0)
        return -1;
    if (fd >= DISK_FDS)
        abort();
    if (creates)
        disk_make(path, false);
    int node = disk.watch ? disk_find(path, &folder, name) : -1;
    disk.fd_node[fd] = node < 0 ? node : disk.node[node].file;
    disk.fd_at[fd] = 0;
    disk.fd_half[fd] = false;
    return fd;
}

static inline int disk_close(int fd)
{
    bool fails = disk_fails(false, false);
    int why = errno, got = close(fd); // is closed in any case
    errno = fails ? why : errno;
    return fails ? -1 : got;
}

static inline ssize_t disk_read(int fd, void *p, size_t n)
{
    return disk_fails(false, false) ? -1 : read(fd, p, n);
}

/* In two halves, so that a process is killed between them, or a disk gets full. */
static inline ssize_t disk_write(int fd, const void *p, size_t n)
{
    if (disk_fails(true, true))
        return -1;
    disk.fd_half[fd] = !disk.fd_half[fd];
    size_t half = n > 1 && disk.fd_half[fd] ? n / 2 : n;
    ssize_t got = write(fd, p, half);
    if (got != (ssize_t)half)
        abort();
    if (!disk.watch)
        return got;
    struct disk_change *c = disk_note(DISK_WRITE, disk.fd_node[fd]);
    c->at = disk.fd_at[fd];
    c->n = half;
    c->bytes = malloc(half ? half : 1);
    memcpy(c->bytes, p, half);
    disk.fd_at[fd] += (off_t)half;
    return got;
}

static inline off_t disk_seek(int fd, off_t at, int whence)
{
    if (disk_fails(false, false))
        return -1;
    return disk.fd_at[fd] = lseek(fd, at, whence);
}

static inline int disk_sync(int fd)
{
    bool fails = disk_fails(true, false);
    if (disk.watch && disk.fd_node[fd] >= 0)
        disk_note(DISK_SYNC, disk.fd_node[fd])->failed = fails;
    return fails ? -1 : 0;
}

static inline int disk_mkdir(const char *path, mode_t mode)
{
    if (disk_fails(true, true) || mkdir(path, mode) != 0)
        return -1;
    disk_make(path, true);
    return 0;
}

static inline int disk_rename(const char *from, const char *to, unsigned flags)
{
    int folder, old;
    char name[DISK_NAME];
    if (disk_fails(true, false) || renameat2(AT_FDCWD, from, AT_FDCWD, to, flags) != 0)
        return -1;
    if (!disk.watch)
        return 0;
    int node = disk_find(from, &folder, name);
    struct disk_change *c = disk_note(DISK_RENAME, node);
    old = disk_find(to, &folder, name);
    if (old >= 0)
        disk.node[old].gone = true;
    if (folder != c->folder)
        abort();
    memcpy(c->to, name, DISK_NAME);
    memcpy(disk.node[node].name, name, DISK_NAME);
    return 0;
}

static inline int disk_link(const char *from, const char *to)
{
    int folder;
    char name[DISK_NAME];
    if (disk_fails(true, true) || link(from, to) != 0)
        return -1;
    if (!disk.watch)
        return 0;
    int node = disk_find(from, &folder, name);
    disk_make(to, false);
    disk.node[disk.nodes - 1].file = disk.node[node].file;
    return 0;
}

static inline void disk_forget(const char *path)
{
    int folder;
    char name[DISK_NAME];
    if (!disk.watch)
        return;
    int node = disk_find(path, &folder, name);
    disk_note(DISK_REMOVE, node);
    disk.node[node].gone = true;
}

static inline int disk_unlink(const char *path)
{
    if (disk_fails(true, false) || unlink(path) != 0)
        return -1;
    disk_forget(path);
    return 0;
}

static inline int disk_rmdir(const char *path)
{
    if (disk_fails(true, false) || rmdir(path) != 0)
        return -1;
    disk_forget(path);
    return 0;
}

static inline int disk_access(const char *path, int mode)
{
    return disk_fails(false, false) ? -1 : access(path, mode);
}

static inline int disk_room(const char *path, struct statvfs *out)
{
    return disk_fails(false, false) ? -1 : statvfs(path, out);
}

static const struct store_fs disk_fs = {.open = disk_open,
                                        .close = disk_close,
                                        .read = disk_read,
                                        .write = disk_write,
                                        .seek = disk_seek,
                                        .sync = disk_sync,
                                        .mkdir = disk_mkdir,
                                        .rename = disk_rename,
                                        .link = disk_link,
                                        .unlink = disk_unlink,
                                        .rmdir = disk_rmdir,
                                        .access = disk_access,
                                        .room = disk_room};

/* ---- power cuts ---- */

/* seed 0: everything is there (a process that died); 1: nothing that was not synced. */
struct disk_cut {
    int changes; // that came before it
    uint64_t seed;
};

/* 0..3 for a change that was not synced. */
static inline int disk_luck(const struct disk_cut *cut, int change)
{
    uint64_t v =
        (cut->seed << 40 | (uint64_t)cut->changes << 20 | (uint64_t)change) * 0x9e3779b97f4a7c15u;
    v = (v ^ v >> 29) * 0xbf58476d1ce4e5b9u;
    return cut->seed == 0 ? 3 : cut->seed == 1 ? 0 : (int)(v >> 62);
}

/* Whether a change of a node, made as number `change`, was brought to the disk by a sync of that
 * node: of bytes by the next one, of names by any. */
static inline bool disk_synced(const struct disk_cut *cut, int node, int change)
{
    for (int i = change; i < cut->changes; i++)
        if (disk.change[i].kind == DISK_SYNC && disk.change[i].node == node &&
            (!disk.change[i].failed || !disk.node[node].is_folder))
            return !disk.change[i].failed;
    return false;
}

static inline void disk_put_file(const struct disk_cut *cut, int node, const char *path)
{
    FILE *f = fopen(path, "wb");
    if (!f)
        abort();
    for (int i = 0; i < cut->changes; i++) {
        const struct disk_change *c = &disk.change[i];
        if (c->kind != DISK_WRITE || c->node != node)
            continue;
        int luck = disk_synced(cut, node, i) ? 3 : disk_luck(cut, i);
        fseeko(f, c->at, SEEK_SET);
        for (size_t k = 0; k < (luck == 0 ? 0 : luck == 1 ? c->n / 2 : c->n); k++)
            putc(luck == 2 ? 0 : c->bytes[k], f);
    }
    fclose(f);
}

/* Node of each name of a folder: changes in order. */
static inline int disk_names(const struct disk_cut *cut, int folder, int *node,
                             char (*name)[DISK_NAME])
{
    int n = 0;
    for (int i = 0; i < cut->changes; i++) {
        const struct disk_change *c = &disk.change[i];
        if (c->kind > DISK_REMOVE || c->folder != folder ||
            !(disk_synced(cut, folder, i) || disk_luck(cut, i) > 1))
            continue;
        const char *to = c->kind == DISK_RENAME ? c->to : c->name;
        int kept = 0;
        for (int k = 0; k < n; k++) {
            bool goes = strcmp(name[k], c->name) == 0 || strcmp(name[k], to) == 0;
            node[kept] = node[k];
            memmove(name[kept], name[k], DISK_NAME);
            kept += !goes;
        }
        n = kept;
        if (c->kind == DISK_REMOVE)
            continue;
        node[n] = c->node;
        memcpy(name[n++], to, DISK_NAME);
    }
    return n;
}

/* Make the folder `path` as the cut left node `folder`. */
static inline void disk_put(const struct disk_cut *cut, int folder, const char *path)
{
    enum { NAMES = 64 };
    int node[NAMES];
    char name[NAMES][DISK_NAME], sub[1024];
    if (mkdir(path, 0777) != 0)
        abort();
    int n = disk_names(cut, folder, node, name);
    for (int i = 0; i < n; i++) {
        snprintf(sub, sizeof sub, "%s/%.*s", path, DISK_NAME, name[i]);
        if (disk.node[node[i]].is_folder)
            disk_put(cut, node[i], sub);
        else
            disk_put_file(cut, disk.node[node[i]].file, sub);
    }
}

#endif
