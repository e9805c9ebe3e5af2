#include "drivers/format/npy.h"

#include "drivers/format/json.h"
#include "drivers/format/name.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { BLOCK = 4096 }; // values gathered at a time

err_t npy_open(struct npy_dir *d, const char *path)
{
    memset(d, 0, sizeof *d);
    size_t n = strlen(path);
    if (n >= sizeof d->path)
        return err_fail(ERR_ARG, "%.64s...: path of %zu bytes, allowed are %zu", path, n,
                        sizeof d->path - 1);
    memcpy(d->path, path, n + 1);
    d->tensors = calloc(NPY_TENSORS_MAX, sizeof *d->tensors);
    if (!d->tensors)
        return err_fail(ERR_NOMEM, "%s: no memory for a list of tensors", path);
    pthread_mutex_init(&d->lock, NULL);
    d->tap = (struct tap){npy_put, d};
    d->open = true;
    return OK;
}

/* ---- one file ---- */

static size_t count_values(const struct npy_tensor *t)
{
    size_t n = 1;
    for (int i = 0; i < t->rank; i++)
        n *= (size_t)t->shape[i];
    return n;
}

static err_t file_path(const struct npy_dir *d, const struct npy_tensor *t,
                       char path[FILE_PATH_CAP])
{
    char name[NAME_CAP + 8];
    snprintf(name, sizeof name, "%s.npy", t->name);
    return file_join(d->path, name, path);
}

static err_t write_at(int fd, const char *path, const void *p, size_t n, size_t at)
{
    for (size_t done = 0; done < n;) {
        ssize_t k = pwrite(fd, (const char *)p + done, n - done, (off_t)(at + done));
        if (k < 0 && errno == EINTR)
            continue;
        if (k <= 0)
            return err_fail(file_code(errno), "%s: writing failed: %s", path, strerror(errno));
        done += (size_t)k;
    }
    return OK;
}

static void make_head(const struct npy_tensor *t, char head[NPY_HEAD])
{
    char shape[80] = "";
    for (int i = 0, at = 0; i < t->rank; i++)
        at += snprintf(shape + at, sizeof shape - (size_t)at, "%d,%s", t->shape[i],
                       i + 1 < t->rank ? " " : "");
    memset(head, ' ', NPY_HEAD);
    const int size = NPY_HEAD - 10;
    const unsigned char magic[10] = {0x93, 'N', 'U', 'M', 'P', 'Y', 1, 0, size & 255, size >> 8};
    memcpy(head, magic, sizeof magic);
    int n = snprintf(head + 10, NPY_HEAD - 10,
                     "{'descr': '%s', 'fortran_order': False, 'shape': (%s), }",
                     t->ints ? "<i4" : "<f4", shape);
    head[10 + n] = ' ';
    head[NPY_HEAD - 1] = '\n';
}

/* The file in its full size, without data. */
static err_t create_file(const struct npy_dir *d, const struct npy_tensor *t)
{
    char path[FILE_PATH_CAP], head[NPY_HEAD];
    err_t e = file_path(d, t, path);
    if (e)
        return e;
    int fd = open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0)
        return err_fail(file_code(errno), "%s: cannot create: %s", path, strerror(errno));
    make_head(t, head);
    if (ftruncate(fd, (off_t)(NPY_HEAD + 4 * count_values(t))) != 0)
        e = err_fail(file_code(errno), "%s: cannot make it %zu bytes: %s", path,
                     NPY_HEAD + 4 * count_values(t), strerror(errno));
    if (!e)
        e = write_at(fd, path, head, sizeof head, 0);
    close(fd);
    return e;
}

/* ---- pieces ---- */

/* Position of a piece's next value in the whole tensor. */
struct walk {
    int index[TAP_RANK_MAX], first[TAP_RANK_MAX];
};

static void walk_start(const struct tap_tensor *t, size_t flat, struct walk *w)
{
    for (int i = t->rank - 1; i >= 0; i--) {
        w->first[i] = w->index[i] = (int)(flat % (size_t)t->shape[i]);
        flat /= (size_t)t->shape[i];
    }
}

static void walk_step(const struct tap_tensor *t, struct walk *w)
{
    for (int i = t->rank - 1; i >= 0; i--) {
        if (++w->index[i] < t->shape[i])
            return;
        w->index[i] = 0;
    }
}

static void gather_values(const struct tap_tensor *t, struct walk *w, size_t n, int32_t *out)
{
    for (size_t k = 0; k < n; k++) {
        ptrdiff_t at = 0;
        for (int i = 0; i < t->rank; i++)
            at += (ptrdiff_t)(w->index[i] - w->first[i]) * (ptrdiff_t)t->stride[i];
        if (t->ints)
            out[k] = t->ints[at];
        else
            memcpy(&out[k], &t->data[at], sizeof out[k]);
        walk_step(t, w);
    }
}

static err_t write_piece(const struct npy_dir *d, const struct npy_tensor *own,
                         const struct tap_tensor *t)
{
    char path[FILE_PATH_CAP];
    int32_t block[BLOCK];
    struct walk w;
    const size_t size = count_values(own) / (size_t)own->parts, from = size * (size_t)t->part;
    err_t e = file_path(d, own, path);
    if (e)
        return e;
    int fd = open(path, O_WRONLY | O_CLOEXEC);
    if (fd < 0)
        return err_fail(ERR_IO, "%s: cannot open: %s", path, strerror(errno));
    walk_start(t, from, &w);
    for (size_t done = 0, n; done < size && !e; done += n) {
        n = size - done < BLOCK ? size - done : BLOCK;
        gather_values(t, &w, n, block);
        e = write_at(fd, path, block, 4 * n, NPY_HEAD + 4 * (from + done));
    }
    if (close(fd) != 0 && !e)
        e = err_fail(file_code(errno), "%s: closing failed: %s", path, strerror(errno));
    return e;
}

/* ---- the list ---- */

static err_t check_piece(const struct npy_dir *d, const struct tap_tensor *t)
{
    size_t n = 1;
    if (t->rank < 1 || t->rank > TAP_RANK_MAX || (t->data != NULL) == (t->ints != NULL))
        return err_fail(ERR_FORMAT, "%s: tensor %.64s has rank %d or not one kind of data", d->path,
                        t->name, t->rank);
    for (int i = 0; i < t->rank; i++)
        if (t->shape[i] < 1 || __builtin_mul_overflow(n, (size_t)t->shape[i], &n) || n >> 40)
            return err_fail(ERR_FORMAT, "%s: tensor %.64s: axis %d of %d is not in 1..2^40 in all",
                            d->path, t->name, i, t->shape[i]);
    if (t->parts < 1 || t->part < 0 || t->part >= t->parts || n % (size_t)t->parts)
        return err_fail(ERR_FORMAT, "%s: tensor %.64s: piece %d of %d does not divide %zu values",
                        d->path, t->name, t->part, t->parts, n);
    return OK;
}

/* A tensor's index in the list; a new one gets its file. Under the lock. */
static err_t find_tensor(struct npy_dir *d, const struct tap_tensor *t, struct npy_tensor **out)
{
    for (int i = 0; i < d->n; i++)
        if (strcmp(d->tensors[i].name, t->name) == 0) {
            *out = &d->tensors[i];
            return OK;
        }
    if (d->n == NPY_TENSORS_MAX)
        return err_fail(ERR_LIMIT, "%s: more than %d tensors", d->path, NPY_TENSORS_MAX);
    struct npy_tensor *own = &d->tensors[d->n];
    *own = (struct npy_tensor){.rank = t->rank, .ints = t->ints != NULL, .parts = t->parts};
    memcpy(own->shape, t->shape, sizeof own->shape);
    err_t e = name_copy(d->path, t->name, strlen(t->name), own->name);
    if (!e)
        e = create_file(d, own);
    if (!e)
        d->n++;
    *out = own;
    return e;
}

static err_t enter_piece(struct npy_dir *d, const struct tap_tensor *t, struct npy_tensor **own)
{
    err_t e = check_piece(d, t);
    if (!e)
        e = find_tensor(d, t, own);
    if (e)
        return e;
    bool same = (*own)->rank == t->rank && (*own)->ints == (t->ints != NULL) &&
                (*own)->parts == t->parts && (*own)->done < t->parts;
    for (int i = 0; i < t->rank && same; i++)
        same = (*own)->shape[i] == t->shape[i];
    if (!same)
        return err_fail(ERR_FORMAT, "%s: piece %d of tensor %s contradicts a former one", d->path,
                        t->part, t->name);
    (*own)->done++;
    return OK;
}

static void remember_error(struct npy_dir *d, err_t e)
{
    if (d->failed)
        return;
    d->failed = e;
    snprintf(d->reason, sizeof d->reason, "%s", err_text());
}

void npy_put(void *ctx, const struct tap_tensor *t)
{
    struct npy_dir *d = ctx;
    struct npy_tensor *own = NULL;
    pthread_mutex_lock(&d->lock);
    err_t e = d->failed ? d->failed : enter_piece(d, t, &own);
    if (e)
        remember_error(d, e);
    pthread_mutex_unlock(&d->lock);
    if (!e && (e = write_piece(d, own, t)) != OK) {
        pthread_mutex_lock(&d->lock);
        remember_error(d, e);
        pthread_mutex_unlock(&d->lock);
    }
}

/* ---- the end ---- */

static err_t write_index(const struct npy_dir *d)
{
    char path[FILE_PATH_CAP];
    FILE *f;
    err_t e = file_join(d->path, "index.json", path);
    if (!e)
        e = file_create(path, &f);
    if (e)
        return e;
    fputs("{\"tensors\": [", f);
    for (int i = 0; i < d->n; i++) {
        const struct npy_tensor *t = &d->tensors[i];
        fprintf(f, "%s\n{\"name\": ", i ? "," : "");
        json_put_string(f, t->name);
        fputs(", \"file\": ", f);
        char name[NAME_CAP + 8];
        snprintf(name, sizeof name, "%s.npy", t->name);
        json_put_string(f, name);
        fprintf(f, ", \"dtype\": \"%s\", \"stored\": \"full\", \"shape\": [",
                t->ints ? "int32" : "float32");
        for (int k = 0; k < t->rank; k++)
            fprintf(f, "%s%d", k ? ", " : "", t->shape[k]);
        fputs("]}", f);
    }
    fputs("]}\n", f);
    return file_finish(f, path);
}

static err_t finish_index(struct npy_dir *d)
{
    if (d->failed)
        return err_fail(d->failed, "%s", d->reason);
    for (int i = 0; i < d->n; i++)
        if (d->tensors[i].done < d->tensors[i].parts)
            return err_fail(ERR_FORMAT, "%s: tensor %s has %d of %d pieces", d->path,
                            d->tensors[i].name, d->tensors[i].done, d->tensors[i].parts);
    return write_index(d);
}

err_t npy_close(struct npy_dir *d)
{
    err_t e = d->open ? finish_index(d) : OK;
    if (d->open)
        pthread_mutex_destroy(&d->lock);
    free(d->tensors);
    memset(d, 0, sizeof *d);
    return e;
}
