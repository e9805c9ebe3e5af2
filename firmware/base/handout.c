/* For each path: who lacks it; then, if anyone does, its own name, and for each file in it its name
 * and size, and its bytes in pieces. An empty name ends the list. With a folder goes what readers
 * of data sets look for beside it. All ranks take part, so that the calls are the same. */
#include "firmware/base/handout.h"

#include "firmware/base/tempdir.h"

#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { PIECE = 1 << 22, OPEN_MOST = 16 };

/* drivers/format/imageset.c, layout.c, rigfile.c */
static const char *const companions[] = {"exposure.json",
                                         "protocol.json",
                                         "poses_bounds_exps.npy",
                                         "transforms.json",
                                         "cameras.json",
                                         "sparse",
                                         "exr"};

struct item {
    uint64_t bytes;
    char name[FILE_PATH_CAP]; // from the folder on that the path lies in: "/set/a.jpg"
};

struct delivery {
    struct team *team;
    char from[FILE_PATH_CAP]; // path on rank 0, without links
    size_t parent;            // bytes of the folder that it lies in
    const char *to;           // folder in which it is put; NULL: this rank has it
    char *piece;
    err_t e;
};

/* nftw has no context. */
static _Thread_local struct delivery *now;

/* ---- one file ---- */

static err_t make_parents(char *path, size_t from)
{
    for (char *p = path + from + 1; *p; p++)
        if (*p == '/') {
            *p = 0;
            const bool bad = mkdir(path, 0700) != 0 && errno != EEXIST;
            const int why = errno;
            *p = '/';
            if (bad)
                return err_fail(file_code(why), "%s: %s", path, strerror(why));
        }
    return OK;
}

static err_t create_file(const struct delivery *d, const struct item *it, int *fd)
{
    char path[FILE_PATH_CAP];
    if (snprintf(path, sizeof path, "%s%s", d->to, it->name) >= (int)sizeof path)
        return err_fail(ERR_ARG, "%s: path too long", d->to);
    err_t e = make_parents(path, strlen(d->to));
    if (e)
        return e;
    *fd = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
    return *fd < 0 ? err_fail(file_code(errno), "%s: %s", path, strerror(errno)) : OK;
}

static err_t read_piece(int fd, char *p, size_t n, const char *name)
{
    while (n > 0) {
        const ssize_t got = read(fd, p, n);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return err_fail(ERR_IO, "%s: %s", name, got ? strerror(errno) : "it became shorter");
        p += got;
        n -= (size_t)got;
    }
    return OK;
}

static err_t write_piece(int fd, const char *p, size_t n, const char *name)
{
    while (n > 0) {
        const ssize_t put = write(fd, p, n);
        if (put < 0 && errno == EINTR)
            continue;
        if (put <= 0)
            return err_fail(file_code(errno), "%s: %s", name, strerror(errno));
        p += put;
        n -= (size_t)put;
    }
    return OK;
}

/* fd: the file to read on rank 0, to write where it is missing, else -1. */
static err_t move_bytes(const struct delivery *d, const struct item *it, int fd)
{
    err_t e = OK;
    for (uint64_t done = 0; done < it->bytes && !e;) {
        const size_t n = it->bytes - done < PIECE ? (size_t)(it->bytes - done) : PIECE;
        if (d->team->rank == 0)
            e = read_piece(fd, d->piece, n, it->name);
        if (!e)
            e = team_copy(d->team, d->piece, n);
        if (!e && d->team->rank > 0 && fd >= 0)
            e = write_piece(fd, d->piece, n, it->name);
        done += n;
    }
    return e;
}

/* ---- rank 0 ---- */

static err_t send_file(struct delivery *d, const char *path, off_t bytes)
{
    struct item it = {.bytes = (uint64_t)bytes};
    snprintf(it.name, sizeof it.name, "%s", path + d->parent);
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    err_t e = team_copy(d->team, &it, sizeof it);
    if (!e)
        e = move_bytes(d, &it, fd);
    close(fd);
    return e;
}

static int visit_file(const char *path, const struct stat *st, int kind, struct FTW *at)
{
    (void)at;
    if (kind == FTW_F && S_ISREG(st->st_mode))
        now->e = send_file(now, path, st->st_size);
    return now->e != OK;
}

static err_t send_tree(struct delivery *d, const char *path)
{
    now = d;
    if (nftw(path, visit_file, OPEN_MOST, 0) != 0 && !d->e)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    return d->e;
}

static err_t send_files(struct delivery *d)
{
    struct item it = {.bytes = 0};
    snprintf(it.name, sizeof it.name, "%s", d->from + d->parent);
    err_t e = team_copy(d->team, &it, sizeof it);
    if (!e)
        e = send_tree(d, d->from);
    for (size_t i = 0; i < sizeof companions / sizeof companions[0] && !e; i++) {
        char path[FILE_PATH_CAP];
        const int n =
            snprintf(path, sizeof path, "%.*s/%s", (int)d->parent, d->from, companions[i]);
        if (n < (int)sizeof path && file_is_dir(d->from) && file_exists(path) &&
            strcmp(path, d->from) != 0)
            e = send_tree(d, path);
    }
    it.name[0] = 0;
    return e ? e : team_copy(d->team, &it, sizeof it);
}

static err_t find_files(struct delivery *d, const char *path)
{
    char *real = realpath(path, NULL);
    if (!real || strlen(real) >= sizeof d->from) {
        free(real);
        return err_fail(ERR_IO, "%s: %s", path, strerror(real ? ENAMETOOLONG : errno));
    }
    memcpy(d->from, real, strlen(real) + 1);
    d->parent = (size_t)(strrchr(real, '/') - real);
    free(real);
    return send_files(d);
}

/* ---- the others ---- */

/* d->from: the path's own name. */
static err_t receive_files(struct delivery *d)
{
    struct item it = {.bytes = 0};
    err_t e = team_copy(d->team, &it, sizeof it);
    memcpy(d->from, it.name, sizeof it.name);
    while (!e) {
        int fd = -1;
        e = team_copy(d->team, &it, sizeof it);
        if (e || !it.name[0])
            return e;
        it.name[sizeof it.name - 1] = 0;
        if (strstr(it.name, "/../"))
            return err_fail(ERR_FORMAT, "rank 0 sends a file named %s", it.name);
        if (d->to)
            e = create_file(d, &it, &fd);
        if (!e)
            e = move_bytes(d, &it, fd);
        if (fd >= 0 && close(fd) != 0 && !e)
            e = err_fail(file_code(errno), "%s: %s", it.name, strerror(errno));
    }
    return e;
}

/* The copy's path. */
static err_t place_of(struct handout *h, const struct delivery *d, const char **path)
{
    if (asprintf(&h->path[h->n], "%s%s", d->to, d->from) < 0) {
        h->path[h->n] = NULL;
        return err_fail(ERR_NOMEM, "no memory for a path");
    }
    *path = h->path[h->n++];
    return OK;
}

static err_t make_place(struct handout *h, char to[FILE_PATH_CAP])
{
    if (h->n == HANDOUT_PATHS)
        return err_fail(ERR_LIMIT, "more than %d paths", HANDOUT_PATHS);
    err_t e = h->dir[0] ? OK : tempdir_make("hdrig", h->dir);
    if (e)
        return e;
    if (snprintf(to, FILE_PATH_CAP, "%s/%d", h->dir, h->n) >= FILE_PATH_CAP)
        return err_fail(ERR_ARG, "%s: path too long", h->dir);
    return mkdir(to, 0700) == 0 ? OK : err_fail(file_code(errno), "%s: %s", to, strerror(errno));
}

static bool is_path(const char *const *words, const char *path)
{
    for (; path && *words; words++)
        if (strcmp(*words, path) == 0)
            return false;
    return path && *path;
}

err_t handout_path(struct handout *h, struct team *t, const char *const *words, const char **path)
{
    struct delivery d = {.team = t};
    char to[FILE_PATH_CAP];
    bool lacks[TEAM_MAX] = {false}, any = false;
    if (!t || !is_path(words, *path))
        return OK;
    lacks[t->rank] = !file_exists(*path);
    err_t e = team_collect(t, lacks, sizeof *lacks);
    for (int i = 1; i < t->size; i++)
        any = any || lacks[i];
    if (e || !any || lacks[0]) // what nobody has is refused where it is needed
        return e;
    if (lacks[t->rank]) {
        e = make_place(h, to);
        d.to = to;
    }
    d.piece = malloc(PIECE);
    if (!e && !d.piece)
        e = err_fail(ERR_NOMEM, "no memory to send files");
    if (!e)
        e = t->rank == 0 ? find_files(&d, *path) : receive_files(&d);
    free(d.piece);
    return e || !d.to ? e : place_of(h, &d, path);
}

void handout_close(struct handout *h)
{
    tempdir_remove(h->dir);
    for (int i = 0; i < h->n; i++)
        free(h->path[i]);
    memset(h, 0, sizeof *h);
}
