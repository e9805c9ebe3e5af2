#include "firmware/store/store_fs.h"

#include "core/base/log.h"
#include "drivers/format/file.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { STREAM_BYTES = 1 << 18, READ_BYTES = 1 << 16, DEPTH_MAX = 3 };

static int system_open(const char *path, int flags, mode_t mode)
{
    return open(path, flags, mode);
}

static int system_rename(const char *from, const char *to, unsigned flags)
{
    return renameat2(AT_FDCWD, from, AT_FDCWD, to, flags);
}

const struct store_fs store_fs_system = {
    .open = system_open,
    .close = close,
    .read = read,
    .write = write,
    .seek = lseek,
    .sync = fsync,
    .mkdir = mkdir,
    .rename = system_rename,
    .link = link,
    .unlink = unlink,
    .rmdir = rmdir,
    .access = access,
    .room = statvfs,
};

/* The error of a call that failed with `why`. */
static err_t call_fail(const char *path, const char *what, int why)
{
    return err_fail(file_code(why), "%s: %s: %s", path, what, strerror(why));
}

/* ---- files that are written ---- */

/* 0 is an error to stdio, a negative number is not allowed. */
static ssize_t stream_write(void *cookie, const char *p, size_t n)
{
    struct store_fs_file *f = cookie;
    size_t done = 0;
    while (done < n && !f->why) {
        ssize_t put = f->fs->write(f->fd, p + done, n - done);
        if (put > 0)
            done += (size_t)put;
        else if (put == 0 || errno != EINTR)
            f->why = put == 0 ? EIO : errno;
    }
    return f->why ? 0 : (ssize_t)done;
}

static int stream_seek(void *cookie, off64_t *at, int whence)
{
    struct store_fs_file *f = cookie;
    off_t now = f->fs->seek(f->fd, *at, whence);
    if (now < 0 && !f->why)
        f->why = errno;
    *at = now;
    return now < 0 ? -1 : 0;
}

err_t store_fs_create(const struct store_fs *fs, const char *path, struct store_fs_file *out)
{
    static const cookie_io_functions_t calls = {.write = stream_write, .seek = stream_seek};
    *out = (struct store_fs_file){.fs = fs, .path = path};
    out->fd = fs->open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (out->fd < 0)
        return call_fail(path, "cannot create", errno);
    out->stream = fopencookie(out, "wb", calls);
    if (!out->stream) {
        fs->close(out->fd);
        return err_fail(ERR_NOMEM, "%s: no memory for a stream", path);
    }
    setvbuf(out->stream, NULL, _IOFBF, STREAM_BYTES);
    return OK;
}

err_t store_fs_finish(struct store_fs_file *f)
{
    const char *what = "writing failed";
    bool bad = ferror(f->stream) != 0;
    bad = fclose(f->stream) != 0 || bad; // flushes; the descriptor is ours
    if (bad && !f->why)
        f->why = EIO;
    if (!f->why && f->fs->sync(f->fd) != 0) {
        f->why = errno;
        what = "cannot be synced to the disk";
    }
    if (f->fs->close(f->fd) != 0 && !f->why) {
        f->why = errno;
        what = "closing failed";
    }
    return f->why ? call_fail(f->path, what, f->why) : OK;
}

void store_fs_discard(struct store_fs_file *f)
{
    f->why = EIO; // nothing more is written
    fclose(f->stream);
    f->fs->close(f->fd);
}

err_t store_fs_write(const struct store_fs *fs, const char *path, const void *bytes, size_t n)
{
    struct store_fs_file f;
    err_t e = store_fs_create(fs, path, &f);
    if (e)
        return e;
    fwrite(bytes, 1, n, f.stream); // store_fs_finish asks whether it worked
    return store_fs_finish(&f);
}

/* ---- files that are read ---- */

static err_t open_regular(const struct store_fs *fs, const char *path, int *fd)
{
    struct stat st;
    *fd = fs->open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0);
    if (*fd < 0)
        return call_fail(path, "cannot be read", errno);
    if (fstat(*fd, &st) == 0 && S_ISREG(st.st_mode))
        return OK;
    fs->close(*fd);
    return err_fail(ERR_IO, "%s: not a regular file", path);
}

/* Reads up to n bytes; fewer only at the end of the file. Returns -1 with errno on failure. */
static ssize_t read_full(const struct store_fs *fs, int fd, uint8_t *p, size_t n)
{
    size_t done = 0;
    while (done < n) {
        ssize_t got = fs->read(fd, p + done, n - done);
        if (got == 0)
            break;
        if (got > 0)
            done += (size_t)got;
        else if (errno != EINTR)
            return -1;
    }
    return (ssize_t)done;
}

err_t store_fs_hash(const struct store_fs *fs, const char *path, uint64_t *bytes,
                    char hex[SHA256_HEX_CAP])
{
    uint8_t block[READ_BYTES];
    struct sha256 hash;
    int fd;
    *bytes = 0;
    err_t e = open_regular(fs, path, &fd);
    if (e)
        return e;
    sha256_init(&hash);
    for (ssize_t n = sizeof block; n == sizeof block && !e;) {
        n = read_full(fs, fd, block, sizeof block);
        if (n < 0)
            e = call_fail(path, "cannot be read", errno);
        sha256_add(&hash, block, n < 0 ? 0 : (size_t)n);
    }
    *bytes = hash.bytes;
    sha256_hex(&hash, hex);
    fs->close(fd);
    return e;
}

err_t store_fs_read(const struct store_fs *fs, const char *path, void *p, size_t cap, size_t *n)
{
    int fd;
    *n = 0;
    err_t e = open_regular(fs, path, &fd);
    if (e)
        return e;
    ssize_t got = read_full(fs, fd, p, cap);
    if (got < 0)
        e = call_fail(path, "cannot be read", errno);
    else
        *n = (size_t)got;
    fs->close(fd);
    return e;
}

err_t store_fs_sync(const struct store_fs *fs, const char *path)
{
    int fd;
    err_t e = open_regular(fs, path, &fd);
    if (e)
        return e;
    if (fs->sync(fd) != 0)
        e = call_fail(path, "cannot be synced to the disk", errno);
    fs->close(fd);
    return e;
}

static err_t copy_file(const struct store_fs *fs, const char *from, const char *to)
{
    uint8_t block[READ_BYTES];
    struct store_fs_file f;
    int fd;
    err_t e = open_regular(fs, from, &fd);
    if (e)
        return e;
    e = store_fs_create(fs, to, &f);
    for (ssize_t n = sizeof block; !e && n == sizeof block;) {
        n = read_full(fs, fd, block, sizeof block);
        if (n < 0) {
            e = call_fail(from, "cannot be read", errno);
            store_fs_discard(&f);
        } else if (n > 0) {
            fwrite(block, 1, (size_t)n, f.stream); // store_fs_finish asks whether it worked
        }
    }
    fs->close(fd);
    return e ? e : store_fs_finish(&f);
}

err_t store_fs_link(const struct store_fs *fs, const char *from, const char *to, bool *copied)
{
    *copied = false;
    if (fs->link(from, to) == 0)
        return OK;
    *copied = errno == EPERM || errno == EOPNOTSUPP || errno == ENOSYS || errno == EXDEV ||
              errno == EMLINK || errno == EINVAL;
    return *copied ? copy_file(fs, from, to)
                   : call_fail(to, "cannot be linked to its other name", errno);
}

/* ---- folders ---- */

err_t store_fs_text(const struct store_fs *fs, const char *path, size_t max, char **text, size_t *n)
{
    *text = malloc(max + 1);
    if (!*text)
        return err_fail(ERR_NOMEM, "%s: no memory to read it", path);
    err_t e = store_fs_read(fs, path, *text, max + 1, n);
    if (e) {
        free(*text);
        *text = NULL;
    }
    return e;
}

err_t store_fs_sync_dir(const struct store_fs *fs, const char *path)
{
    int fd = fs->open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC, 0), why = 0;
    if (fd < 0)
        return call_fail(path, "cannot be synced to the disk", errno);
    if (fs->sync(fd) != 0 && errno != EINVAL) // EINVAL: it cannot sync folders
        why = errno;
    fs->close(fd);
    return why ? call_fail(path, "cannot be synced to the disk", why) : OK;
}

err_t store_fs_mkdir(const struct store_fs *fs, const char *path)
{
    return fs->mkdir(path, 0777) == 0 ? OK : call_fail(path, "cannot create", errno);
}

err_t store_fs_move(const struct store_fs *fs, const char *from, const char *to)
{
    int failed = fs->rename(from, to, RENAME_NOREPLACE);
    if (failed && errno == EINVAL && !file_exists(to)) // a file system without the flag
        failed = fs->rename(from, to, 0);
    return failed ? call_fail(to, "cannot be used as the new name", errno) : OK;
}

/* A removal in progress. */
struct removal {
    const struct store_fs *fs;
    const char *root;
    bool (*own)(const char *name);
    char stays[FILE_PATH_CAP]; // the first foreign file, "" for none
};

static int remove_deep(struct removal *r, const char *name, int depth);

static int remove_entries(struct removal *r, const char *path, const char *name, int depth)
{
    char sub[FILE_PATH_CAP];
    DIR *d = opendir(path);
    int why = d ? 0 : errno;
    for (struct dirent *entry; d && (entry = readdir(d));) {
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0)
            continue;
        int n = snprintf(sub, sizeof sub, "%s%s%s", name, *name ? "/" : "", entry->d_name);
        int bad = n < (int)sizeof sub ? remove_deep(r, sub, depth) : ENAMETOOLONG;
        why = why ? why : bad;
    }
    if (d)
        closedir(d);
    return why;
}

/* Returns the errno of the first failed removal, or 0. name: below the root, "" for the root. */
static int remove_deep(struct removal *r, const char *name, int depth)
{
    char path[FILE_PATH_CAP];
    struct stat st;
    int n = snprintf(path, sizeof path, "%s%s%s", r->root, *name ? "/" : "", name);
    if (n >= (int)sizeof path)
        return ENAMETOOLONG;
    if (lstat(path, &st) != 0)
        return errno == ENOENT ? 0 : errno;
    bool folder = S_ISDIR(st.st_mode);
    if ((!folder && !S_ISREG(st.st_mode)) || (*name && !r->own(name)) || depth > DEPTH_MAX) {
        if (!r->stays[0])
            memcpy(r->stays, path, (size_t)n + 1);
        return 0;
    }
    if (!folder)
        return r->fs->unlink(path) == 0 ? 0 : errno;
    int why = remove_entries(r, path, name, depth + 1);
    return why || r->stays[0] ? why : r->fs->rmdir(path) == 0 ? 0 : errno;
}

void store_fs_remove(const struct store_fs *fs, const char *path, bool (*own)(const char *name))
{
    struct removal r = {.fs = fs, .root = path, .own = own};
    int why = remove_deep(&r, "", 0);
    if (why)
        log_warn("%s: cannot be removed: %s", path, strerror(why));
    else if (r.stays[0])
        log_warn("%s: was not written by hdrig and stays", r.stays);
}
