#include "drivers/format/llff.h"

#include "core/base/bytes.h"
#include "core/base/lin.h"
#include "core/base/rotation.h"
#include "drivers/format/file.h"
#include "drivers/format/name.h"

#include <dirent.h>
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum {
    COLUMNS = 17, // and the exposure
    HEAD_MAX = 4096,
    FILE_MAX = HEAD_MAX + CAMERAS_MAX * (COLUMNS + 1) * 8
};

struct array {
    const char *what;
    struct bytes data;
    int rows, columns;
    size_t size; // bytes of a value
    bool by_columns;
};

/* ---- the array ---- */

/* The text behind 'key': in the header, a Python dictionary; NULL if it is not there. */
static const char *value_of(const char *head, const char *key)
{
    const char *at = strstr(head, key);
    at = at ? at + strlen(key) : NULL;
    return at ? at + strspn(at, " :") : NULL;
}

static bool starts_with(const char *text, const char *with)
{
    return text && strncmp(text, with, strlen(with)) == 0;
}

static err_t read_shape(const char *head, struct array *a)
{
    const char *kind = value_of(head, "'descr'"), *shape = value_of(head, "'shape'");
    const char *order = value_of(head, "'fortran_order'");
    char *end = NULL;
    long rows = 0, columns = 0;
    a->size = starts_with(kind, "'<f8'") ? 8 : starts_with(kind, "'<f4'") ? 4 : 0;
    a->by_columns = starts_with(order, "True");
    if (starts_with(shape, "(")) {
        rows = strtol(shape + 1, &end, 10);
        columns = *end == ',' ? strtol(end + 1, &end, 10) : 0;
    }
    if (a->size == 0 || !order || !end || *end != ')')
        return err_fail(ERR_FORMAT, "%s: no array of two axes of little-endian floats", a->what);
    if (rows < 1 || rows > CAMERAS_MAX || columns < COLUMNS || columns > COLUMNS + 1)
        return err_fail(ERR_FORMAT, "%s: %ld x %ld numbers, allowed are 1 to %d rows of %d or %d",
                        a->what, rows, columns, CAMERAS_MAX, COLUMNS, COLUMNS + 1);
    a->rows = (int)rows;
    a->columns = (int)columns;
    return OK;
}

static err_t open_array(const char *what, const void *p, size_t n, struct array *a)
{
    char head[HEAD_MAX + 1];
    *a = (struct array){.what = what, .data = bytes_of(p, n)};
    const uint8_t *magic = bytes_take(&a->data, 8);
    if (!magic || memcmp(magic, "\x93NUMPY", 6) != 0 || magic[6] < 1 || magic[6] > 3)
        return err_fail(ERR_FORMAT, "%s: no file of NumPy's format 1 to 3", what);
    const size_t length = magic[6] == 1 ? bytes_u16(&a->data) : bytes_u32(&a->data);
    const uint8_t *text = length <= HEAD_MAX ? bytes_take(&a->data, length) : NULL;
    if (!text)
        return err_fail(ERR_FORMAT, "%s: a header of %zu bytes, in a file of %zu", what, length, n);
    memcpy(head, text, length);
    head[length] = 0;
    err_t e = read_shape(head, a);
    const size_t want = e ? 0 : (size_t)a->rows * (size_t)a->columns * a->size;
    if (!e && a->data.left != want)
        e = err_fail(ERR_FORMAT, "%s: %zu bytes of numbers, %d x %d need %zu", what, a->data.left,
                     a->rows, a->columns, want);
    return e;
}

static double value_at(const struct array *a, int row, int column)
{
    const int i = a->by_columns ? column * a->rows + row : row * a->columns + column;
    struct bytes b = bytes_of(a->data.p + (size_t)i * a->size, a->size);
    return a->size == 8 ? bytes_f64(&b) : (double)bytes_f32(&b);
}

/* ---- cameras ---- */

static err_t set_size(const struct array *a, int row, struct rig_view *v)
{
    const double h = value_at(a, row, 4), w = value_at(a, row, 9), f = value_at(a, row, 14);
    if (!(w >= 1 && w <= INT32_MAX && h >= 1 && h <= INT32_MAX) || w != floor(w) || h != floor(h))
        return err_fail(ERR_FORMAT, "%s: %s: %g x %g px", a->what, v->name, w, h);
    v->cam.w = (int)w;
    v->cam.h = (int)h;
    v->cam.fx = v->cam.fy = (float)f;
    v->cam.cx = (float)(w / 2);
    v->cam.cy = (float)(h / 2);
    return OK;
}

static err_t set_pose(const struct array *a, int row, struct rig_view *v)
{
    static const int column[3] = {1, 0, 2}; // right, down, back
    double r[9], centre[3], q[4], t[3];
    for (int i = 0; i < 3; i++) {
        centre[i] = value_at(a, row, 5 * i + 3);
        for (int k = 0; k < 3; k++)
            r[3 * k + i] = (k == 2 ? -1 : 1) * value_at(a, row, 5 * i + column[k]);
    }
    if (!rotation_is(r, CAMERAS_NOT_ROTATED))
        return err_fail(ERR_FORMAT, "%s: %s: its axes are no rotation within %g", a->what, v->name,
                        CAMERAS_NOT_ROTATED);
    rotation_to_quat(r, q);
    lin_apply(r, centre, t);
    for (int i = 0; i < 4; i++)
        v->cam.q[i] = (float)q[i];
    for (int i = 0; i < 3; i++)
        v->cam.t[i] = (float)-t[i];
    return OK;
}

static err_t set_exposure(const struct array *a, int row, struct rig_view *v)
{
    if (a->columns == COLUMNS)
        return OK;
    const double exposure = value_at(a, row, COLUMNS);
    if (!(exposure > 0) || !isfinite(exposure))
        return err_fail(ERR_FORMAT, "%s: %s: exposure %g is not finite and > 0", a->what, v->name,
                        exposure);
    v->has_exposure = true;
    v->exposure_log2 = (float)log2(exposure);
    return OK;
}

err_t llff_parse(const char *what, const void *p, size_t n, struct rig *io)
{
    struct array a;
    err_t e = open_array(what, p, n, &a);
    if (!e && a.rows != io->n)
        e = err_fail(ERR_FORMAT, "%s: %d rows for %d pictures", what, a.rows, io->n);
    for (int i = 0; i < io->n && !e; i++) {
        struct rig_view *v = &io->views[i];
        e = set_size(&a, i, v);
        if (!e)
            e = set_pose(&a, i, v);
        if (!e)
            e = set_exposure(&a, i, v);
        if (!e)
            e = cameras_check(what, v->name, &v->cam);
    }
    io->stored = true;
    return e;
}

/* ---- pictures ---- */

static int is_picture(const struct dirent *d)
{
    const char *dot = strrchr(d->d_name, '.');
    return dot && dot != d->d_name &&
           (strcasecmp(dot, ".png") == 0 || strcasecmp(dot, ".jpg") == 0 ||
            strcasecmp(dot, ".jpeg") == 0);
}

static int by_name(const struct dirent **a, const struct dirent **b)
{
    return strcmp((*a)->d_name, (*b)->d_name);
}

/* The views of the pictures of `dir`, in the order of their names. */
static err_t list_pictures(const char *dir, struct rig *out)
{
    struct dirent **list;
    const int n = scandir(dir, &list, is_picture, by_name);
    if (n < 0)
        return err_fail(ERR_IO, "%s: %s", dir, strerror(errno));
    err_t e = n <= CAMERAS_MAX ? OK : err_fail(ERR_FORMAT, "%s: %d pictures", dir, n);
    out->views = e ? NULL : calloc((size_t)n + 1, sizeof *out->views);
    if (!e && !out->views)
        e = err_fail(ERR_NOMEM, "%s: no memory for %d cameras", dir, n);
    for (int i = 0; i < n; i++) {
        if (!e)
            e = name_copy(dir, list[i]->d_name, strlen(list[i]->d_name), out->views[out->n++].name);
        free(list[i]);
    }
    free(list);
    return e;
}

err_t llff_read(const char *path, struct rig *out)
{
    char parent[FILE_PATH_CAP], dir[FILE_PATH_CAP];
    struct file_map m = {0};
    *out = (struct rig){0};
    err_t e = file_parent(path, parent);
    if (!e)
        e = file_join(parent, LLFF_PICTURES, dir);
    if (!e && !file_is_dir(dir))
        e = file_join(parent, "images", dir);
    if (!e)
        e = list_pictures(dir, out);
    if (!e)
        e = file_map(path, FILE_MAX, &m);
    if (!e)
        e = llff_parse(path, m.p, m.n, out);
    file_unmap(&m);
    if (e)
        cameras_free(out);
    return e;
}
