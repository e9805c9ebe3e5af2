/* The folder is walked and each entry looked up in the list, never the other way round: a list may
 * come from anywhere, its names are only compared. */
#include "drivers/format/filelist.h"

#include "core/base/sha256.h"

#include <dirent.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { DEPTH_MAX = 8, LIST_BYTES_MAX = 1 << 24, HEX = SHA256_HEX_CAP - 1 };

static const char head[] = "# written by hdrig: a folder with these files alone may be replaced\n";

struct entry {
    char *name; // own
    char hex[SHA256_HEX_CAP];
};

struct list {
    struct entry *v;
    size_t n, cap;
};

static void list_free(struct list *l)
{
    for (size_t i = 0; i < l->n; i++)
        free(l->v[i].name);
    free(l->v);
    *l = (struct list){0};
}

static int by_name(const void *a, const void *b)
{
    return strcmp(((const struct entry *)a)->name, ((const struct entry *)b)->name);
}

static err_t list_add(struct list *l, const char *name, size_t n, struct entry **out)
{
    if (l->n == l->cap) {
        size_t cap = l->cap ? 2 * l->cap : 64;
        struct entry *v = realloc(l->v, cap * sizeof *v);
        if (!v)
            return err_fail(ERR_NOMEM, "%s: no memory for %zu names", FILELIST_NAME, cap);
        l->v = v;
        l->cap = cap;
    }
    *out = &l->v[l->n];
    (*out)->name = strndup(name, n);
    if (!(*out)->name)
        return err_fail(ERR_NOMEM, "%s: no memory for a name", FILELIST_NAME);
    l->n++;
    return OK;
}

/* ---- walking ---- */

struct walk {
    const char *dir;
    err_t (*file)(struct walk *w, const char *path, const char *name, const struct stat *st);
    err_t (*folder)(struct walk *w, const char *path, const char *name); // after what is in it
    struct list *list;
    bool content;
};

static err_t walk_folder(struct walk *w, const char *name, int depth);

static err_t walk_entry(struct walk *w, const char *name, int depth)
{
    char path[FILE_PATH_CAP];
    struct stat st;
    err_t e = file_join(w->dir, name, path);
    if (e || strcmp(name, FILELIST_NAME) == 0)
        return e;
    if (lstat(path, &st) != 0)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    if (!S_ISDIR(st.st_mode))
        return w->file(w, path, name, &st);
    e = depth < DEPTH_MAX
            ? walk_folder(w, name, depth + 1)
            : err_fail(ERR_ARG, "%s: deeper than %d folders, no result is", path, DEPTH_MAX);
    return e ? e : w->folder(w, path, name);
}

/* name: relative to dir, "" for itself. */
static err_t walk_folder(struct walk *w, const char *name, int depth)
{
    char path[FILE_PATH_CAP], sub[FILE_PATH_CAP];
    err_t e = file_join(w->dir, name, path);
    DIR *d = e ? NULL : opendir(path);
    if (!e && !d)
        e = err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    for (struct dirent *x; !e && (x = readdir(d));) {
        if (strcmp(x->d_name, ".") == 0 || strcmp(x->d_name, "..") == 0)
            continue;
        int n = snprintf(sub, sizeof sub, "%s%s%s", name, *name ? "/" : "", x->d_name);
        e = n < FILE_PATH_CAP ? walk_entry(w, sub, depth)
                              : err_fail(ERR_ARG, "%s: holds a path that is too long", path);
    }
    if (d)
        closedir(d);
    return e;
}

static err_t hash_file(const char *path, char hex[SHA256_HEX_CAP])
{
    struct file_map m;
    struct sha256 h;
    err_t e = file_map(path, SIZE_MAX, &m);
    if (e)
        return e;
    sha256_init(&h);
    sha256_add(&h, m.p, m.n);
    sha256_hex(&h, hex);
    file_unmap(&m);
    return OK;
}

static err_t leave_folder(struct walk *w, const char *path, const char *name)
{
    (void)w;
    (void)path;
    (void)name;
    return OK;
}

/* ---- writing ---- */

static err_t list_file(struct walk *w, const char *path, const char *name, const struct stat *st)
{
    struct entry *x;
    (void)st;
    if (strcmp(name, FILELIST_PARTIAL) == 0) // is removed before the folder becomes visible
        return OK;
    err_t e = list_add(w->list, name, strlen(name), &x);
    return e ? e : hash_file(path, x->hex);
}

/* As sha256sum does: a name with a line break or a backslash is escaped, and its line begins with
 * a backslash. */
static void put_line(FILE *f, const struct entry *x)
{
    fprintf(f, "%s%s  ", strpbrk(x->name, "\\\n\r") ? "\\" : "", x->hex);
    for (const char *c = x->name; *c; c++)
        switch (*c) {
        case '\\':
            fputs("\\\\", f);
            break;
        case '\n':
            fputs("\\n", f);
            break;
        case '\r':
            fputs("\\r", f);
            break;
        default:
            putc(*c, f);
        }
    putc('\n', f);
}

static err_t put_list(const char *dir, const struct list *l)
{
    char path[FILE_PATH_CAP];
    FILE *f;
    err_t e = file_join(dir, FILELIST_NAME, path);
    if (!e)
        e = file_create(path, &f);
    if (e)
        return e;
    fputs(head, f);
    for (size_t i = 0; i < l->n; i++)
        put_line(f, &l->v[i]);
    return file_finish(f, path);
}

err_t filelist_write(const char *dir)
{
    struct list l = {0};
    struct walk w = {.dir = dir, .file = list_file, .folder = leave_folder, .list = &l};
    err_t e = walk_folder(&w, "", 0);
    if (!e && l.n)
        qsort(l.v, l.n, sizeof *l.v, by_name);
    if (!e)
        e = put_list(dir, &l);
    list_free(&l);
    return e;
}

/* ---- reading ---- */

/* Undo put_line in place. */
static void unescape_name(char *name)
{
    char *to = name;
    for (const char *c = name; *c; c++) {
        if (*c == '\\' && c[1])
            c++;
        else {
            *to++ = *c;
            continue;
        }
        *to++ = (char)(*c == 'n' ? '\n' : *c == 'r' ? '\r' : *c);
    }
    *to = 0;
}

static err_t read_line(struct list *l, const char *path, const char *line, size_t n)
{
    struct entry *x;
    bool escaped = n > 0 && *line == '\\';
    line += escaped;
    n -= escaped;
    if (n < HEX + 3 || strspn(line, "0123456789abcdef") != HEX || memcmp(line + HEX, "  ", 2) != 0)
        return err_fail(ERR_ARG, "%s: line %zu is not \"SHA256  NAME\": nothing is replaced", path,
                        l->n + 2);
    err_t e = list_add(l, line + HEX + 2, n - HEX - 2, &x);
    if (e)
        return e;
    memcpy(x->hex, line, HEX);
    x->hex[HEX] = 0;
    if (escaped)
        unescape_name(x->name);
    return OK;
}

static err_t parse_list(struct list *l, const char *path, const char *text, size_t n)
{
    const size_t begin = sizeof head - 1;
    err_t e = OK;
    if (n < begin || memcmp(text, head, begin) != 0)
        return err_fail(ERR_ARG, "%s: was not written by hdrig: nothing is replaced", path);
    for (size_t at = begin, end; at < n && !e; at = end + 1) {
        const char *stop = memchr(text + at, '\n', n - at);
        if (!stop)
            return err_fail(ERR_ARG, "%s: ends within a line: nothing is replaced", path);
        end = (size_t)(stop - text);
        e = read_line(l, path, text + at, end - at);
    }
    if (!e && l->n)
        qsort(l->v, l->n, sizeof *l->v, by_name);
    return e;
}

static err_t get_list(const char *dir, struct list *l)
{
    char path[FILE_PATH_CAP];
    struct file_map m;
    err_t e = file_join(dir, FILELIST_NAME, path);
    if (e)
        return e;
    if (!file_exists(path))
        return err_fail(ERR_ARG, "%s: already exists and is no result of hdrig (no %s in it)", dir,
                        FILELIST_NAME);
    e = file_map(path, LIST_BYTES_MAX, &m);
    if (e)
        return e == ERR_FORMAT ? ERR_ARG : e;
    e = parse_list(l, path, (const char *)m.p, m.n);
    file_unmap(&m);
    return e;
}

static const struct entry *find_entry(const struct list *l, const char *name)
{
    struct entry key = {.name = (char *)(uintptr_t)name};
    return l->n ? bsearch(&key, l->v, l->n, sizeof *l->v, by_name) : NULL;
}

static err_t check_file(struct walk *w, const char *path, const char *name, const struct stat *st)
{
    char hex[SHA256_HEX_CAP];
    const struct entry *x = find_entry(w->list, name);
    if (!x || !S_ISREG(st->st_mode))
        return err_fail(ERR_ARG, "%s: was not written by hdrig: move it out of %s first", path,
                        w->dir);
    if (!w->content)
        return OK;
    err_t e = hash_file(path, hex);
    if (!e && strcmp(hex, x->hex) != 0)
        e = err_fail(ERR_ARG,
                     "%s: was changed since hdrig wrote it: move it out of %s first, or give "
                     "--force to lose it",
                     path, w->dir);
    return e;
}

/* A folder belongs to the list if a file of it does. */
static err_t check_folder(struct walk *w, const char *path, const char *name)
{
    size_t n = strlen(name);
    for (size_t i = 0; i < w->list->n; i++)
        if (strncmp(w->list->v[i].name, name, n) == 0 && w->list->v[i].name[n] == '/')
            return OK;
    return err_fail(ERR_ARG, "%s: was not made by hdrig: move it out of %s first", path, w->dir);
}

err_t filelist_check(const char *dir, bool content)
{
    struct list l = {0};
    struct walk w = {dir, check_file, check_folder, &l, content};
    err_t e = get_list(dir, &l);
    if (!e)
        e = walk_folder(&w, "", 0);
    list_free(&l);
    return e;
}

/* ---- removing ---- */

static err_t remove_file(struct walk *w, const char *path, const char *name, const struct stat *st)
{
    if (S_ISREG(st->st_mode) && find_entry(w->list, name) && unlink(path) != 0)
        return err_fail(ERR_IO, "%s: cannot be removed: %s", path, strerror(errno));
    return OK;
}

static err_t remove_folder(struct walk *w, const char *path, const char *name)
{
    (void)w;
    (void)name;
    return rmdir(path) == 0 || errno == ENOTEMPTY || errno == EEXIST
               ? OK
               : err_fail(ERR_IO, "%s: cannot be removed: %s", path, strerror(errno));
}

/* The list goes last, so that it still describes the rest after a crash. */
err_t filelist_remove(const char *dir)
{
    char path[FILE_PATH_CAP];
    struct list l = {0};
    struct walk w = {.dir = dir, .file = remove_file, .folder = remove_folder, .list = &l};
    err_t e = get_list(dir, &l);
    if (!e)
        e = walk_folder(&w, "", 0);
    if (!e)
        e = file_join(dir, FILELIST_NAME, path);
    if (!e && (unlink(path) != 0 || rmdir(dir) != 0))
        e = err_fail(ERR_IO, "%s: cannot be removed: %s", dir, strerror(errno));
    list_free(&l);
    return e;
}
