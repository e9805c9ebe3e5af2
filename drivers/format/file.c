#include "drivers/format/file.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

enum { WRITE_BYTES = 1 << 18 }; // per system call

static err_t map_open(int fd, const char *path, size_t max, struct file_map *out)
{
    struct stat st;
    if (fstat(fd, &st) != 0)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    if (!S_ISREG(st.st_mode))
        return err_fail(ERR_FORMAT, "%s: not a regular file", path);
    if ((uintmax_t)st.st_size > max)
        return err_fail(ERR_FORMAT, "%s: %jd bytes, at most %zu are read", path,
                        (intmax_t)st.st_size, max);
    if (st.st_size == 0)
        return OK; // mmap refuses a length of 0
    void *p = mmap(NULL, (size_t)st.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
    if (p == MAP_FAILED)
        return err_fail(ERR_IO, "%s: cannot map %jd bytes: %s", path, (intmax_t)st.st_size,
                        strerror(errno));
    *out = (struct file_map){p, (size_t)st.st_size};
    return OK;
}

err_t file_map(const char *path, size_t max, struct file_map *out)
{
    *out = (struct file_map){0};
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK); // a FIFO must not hold us up
    if (fd < 0)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    err_t e = map_open(fd, path, max, out);
    close(fd);
    return e;
}

void file_unmap(struct file_map *m)
{
    if (m->p)
        munmap((void *)(uintptr_t)m->p, m->n);
    *m = (struct file_map){0};
}

bool file_exists(const char *path)
{
    struct stat st;
    return lstat(path, &st) == 0;
}

void file_drop(const struct file_map *m)
{
    if (m->p)
        madvise((void *)(uintptr_t)m->p, m->n, MADV_DONTNEED);
}

bool file_is_dir(const char *path)
{
    struct stat st;
    return stat(path, &st) == 0 && S_ISDIR(st.st_mode);
}

bool file_is_regular(const char *path)
{
    struct stat st;
    return stat(path, &st) == 0 && S_ISREG(st.st_mode);
}

bool file_is_same(const char *a, const char *b)
{
    struct stat x, y;
    return stat(a, &x) == 0 && stat(b, &y) == 0 && x.st_dev == y.st_dev && x.st_ino == y.st_ino;
}

bool file_is_special(const char *path)
{
    return file_exists(path) && !file_is_regular(path);
}

err_t file_join(const char *dir, const char *name, char out[FILE_PATH_CAP])
{
    size_t a = strlen(dir), b = strlen(name);
    if (a + 1 + b >= FILE_PATH_CAP)
        return err_fail(ERR_ARG, "%.64s.../%.64s: path of %zu bytes, allowed are %d", dir, name,
                        a + 1 + b, FILE_PATH_CAP - 1);
    memcpy(out, dir, a);
    out[a] = '/';
    memcpy(out + a + 1, name, b + 1);
    return OK;
}

const char *file_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

err_t file_parent(const char *path, char out[FILE_PATH_CAP])
{
    size_t n = (size_t)(file_name(path) - path);
    while (n > 1 && path[n - 1] == '/')
        n--;
    if (n >= FILE_PATH_CAP)
        return err_fail(ERR_ARG, "%.64s...: folder of %zu bytes, allowed are %d", path, n,
                        FILE_PATH_CAP - 1);
    memcpy(out, n ? path : ".", n ? n : 1);
    out[n ? n : 1] = 0;
    return OK;
}

bool file_of_program(const char *name, char path[FILE_PATH_CAP])
{
    char self[FILE_PATH_CAP];
    ssize_t n = readlink("/proc/self/exe", self, sizeof self - 1);
    while (n > 0 && self[n - 1] != '/')
        n--;
    self[n > 0 ? n : 0] = 0;
    if (snprintf(path, FILE_PATH_CAP, "%s%s", self, name) >= FILE_PATH_CAP)
        path[0] = 0;
    return path[0] && file_is_regular(path);
}

err_t file_companion(const char *dir, const char *name, bool *found, char path[FILE_PATH_CAP])
{
    char up[FILE_PATH_CAP];
    err_t e = file_join(dir, name, path);
    *found = !e && (file_is_regular(path) || file_is_dir(path));
    if (e || *found)
        return e;
    e = file_join(dir, "..", up);
    if (!e)
        e = file_join(up, name, path);
    *found = !e && (file_is_regular(path) || file_is_dir(path));
    return e;
}

err_t file_code(int why)
{
    return why == ENOSPC || why == EDQUOT ? ERR_LIMIT : ERR_IO;
}

err_t file_create(const char *path, FILE **out)
{
    *out = fopen(path, "wbe");
    if (!*out)
        return err_fail(file_code(errno), "%s: cannot create: %s", path, strerror(errno));
    setvbuf(*out, NULL, _IOFBF, WRITE_BYTES);
    errno = 0; // stdio keeps the fact of a failed write but not its reason
    return OK;
}

static void close_and_remove(FILE *f, const char *path)
{
    struct stat st;
    bool regular =
        fstat(fileno(f), &st) == 0 && S_ISREG(st.st_mode); // never remove /dev/stdout and its like
    fclose(f);
    if (regular)
        unlink(path);
}

err_t file_finish(FILE *f, const char *path)
{
    if (!ferror(f) && fflush(f) == 0 &&
        (fsync(fileno(f)) == 0 || errno == EINVAL)) { // EINVAL: a pipe or device
        if (fclose(f) == 0)
            return OK;
        int why = errno;
        if (file_is_regular(path)) // never remove /dev/stdout and its like
            unlink(path);
        return err_fail(file_code(why), "%s: closing failed: %s", path, strerror(why));
    }
    int why = errno;
    close_and_remove(f, path);
    return err_fail(file_code(why), "%s: writing failed: %s", path,
                    why ? strerror(why) : "unknown reason");
}

void file_discard(FILE *f, const char *path)
{
    if (f)
        close_and_remove(f, path);
}

err_t file_sync(const char *path)
{
    int fd = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC), why = fd < 0 ? errno : 0;
    if (fd >= 0 && fsync(fd) != 0 && errno != EINVAL) // EINVAL: a file system without it
        why = errno;
    if (fd >= 0)
        close(fd);
    return why ? err_fail(file_code(why), "%s: cannot be synced to the disk: %s", path,
                          strerror(why))
               : OK;
}

err_t file_replace(const char *from, const char *to)
{
    if (rename(from, to) == 0)
        return OK;
    int why = errno;
    unlink(from);
    return err_fail(file_code(why), "%s: cannot put the finished file there: %s", to,
                    strerror(why));
}
