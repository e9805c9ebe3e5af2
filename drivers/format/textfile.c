#include "drivers/format/textfile.h"

#include <errno.h>
#include <fcntl.h>
#include <grp.h>
#include <pwd.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

err_t textfile_read(const char *path, size_t max, char **out)
{
    *out = NULL;
    FILE *f = fopen(path, "rbe");
    if (!f)
        return err_fail(errno == ENOENT ? ERR_LOST : ERR_IO, "%s: %s", path, strerror(errno));
    char *text = malloc(max + 2);
    const size_t n = text ? fread(text, 1, max + 1, f) : 0;
    const bool bad = ferror(f) != 0;
    fclose(f);
    if (text && !bad && n <= max && !memchr(text, 0, n)) {
        text[n] = 0;
        *out = text;
        return OK;
    }
    free(text);
    if (!text)
        return err_fail(ERR_NOMEM, "%s: no memory", path);
    if (bad)
        return err_fail(ERR_IO, "%s: cannot be read", path);
    return err_fail(ERR_FORMAT, n > max ? "%s: more than %zu bytes" : "%s: zero byte", path, max);
}

err_t textfile_check(const char *path)
{
    struct stat st;
    char head[sizeof TEXTFILE_MARK] = "";
    if (lstat(path, &st) != 0)
        return errno == ENOENT ? OK : err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    FILE *f = S_ISREG(st.st_mode) ? fopen(path, "rbe") : NULL;
    const bool ours = f && fgets(head, sizeof head, f) && strcmp(head, TEXTFILE_MARK) == 0;
    if (f)
        fclose(f);
    return ours ? OK
                : err_fail(ERR_ARG, "%s is not a file that hdrig wrote: it stays; move it away",
                           path);
}

/* Owner and rights, before there is anything to read. */
static err_t set_rights(int fd, const char *path, const struct textfile_rights *r)
{
    struct stat old;
    unsigned mode = r->mode;
    bool kept = true;
    if (r->keep && stat(path, &old) == 0) {
        mode = old.st_mode & 0777;
        kept = fchown(fd, old.st_uid, old.st_gid) == 0;
    } else if (r->group) {
        const struct group *g = getgrnam(r->group);
        const struct passwd *u = r->owner ? getpwnam(r->owner) : NULL;
        kept = g && fchown(fd, u ? u->pw_uid : (uid_t)-1, g->gr_gid) == 0;
    }
    if (!kept)
        mode &= ~(unsigned)(S_IRWXG);
    return fchmod(fd, mode) == 0 ? OK : err_fail(ERR_IO, "%s: %s", path, strerror(errno));
}

static err_t write_all(int fd, const char *path, const char *text)
{
    size_t left = strlen(text);
    while (left > 0) {
        const ssize_t n = write(fd, text, left);
        if (n < 0 && errno != EINTR)
            return err_fail(file_code(errno), "%s: %s", path, strerror(errno));
        text += n > 0 ? n : 0;
        left -= n > 0 ? (size_t)n : 0;
    }
    return fsync(fd) == 0 || errno == EINVAL
               ? OK
               : err_fail(file_code(errno), "%s: %s", path, strerror(errno));
}

err_t textfile_write(const char *path, const struct textfile_rights *r, const char *text)
{
    char dir[FILE_PATH_CAP], temp[FILE_PATH_CAP];
    err_t e = file_parent(path, dir);
    if (!e)
        e = file_join(dir, ".hdrig-XXXXXX", temp);
    if (e)
        return e;
    const int fd = mkostemp(temp, O_CLOEXEC);
    if (fd < 0)
        return err_fail(file_code(errno), "%s: cannot create: %s", path, strerror(errno));
    e = set_rights(fd, path, r);
    if (!e)
        e = write_all(fd, path, text);
    close(fd);
    if (e) {
        unlink(temp);
        return e;
    }
    e = file_replace(temp, path);
    return e ? e : file_sync(dir);
}
