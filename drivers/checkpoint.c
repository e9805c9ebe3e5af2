#include "drivers/checkpoint.h"

#include "core/base/bytes.h"
#include "core/base/half.h"
#include "drivers/json.h"
#include "drivers/pickle.h"
#include "drivers/safetensors.h"

#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <zip.h>

enum { PICKLE_BYTES_MAX = 32 << 20, SPREAD_MAX = 512 << 20, BLOCK = 1 << 16, FOLDER_CAP = 256 };

/* Bytes of an element of a type that can be read. */
static size_t type_bytes(enum checkpoint_type type)
{
    return type == CHECKPOINT_F32 ? 4 : 2;
}

size_t checkpoint_count(const struct checkpoint_tensor *t)
{
    size_t n = 1;
    for (int k = 0; k < t->rank; k++)
        n *= t->shape[k];
    return n;
}

/* ---- tensors and their names ---- */

static int by_name(const void *a, const void *b)
{
    return strcmp(((const struct checkpoint_tensor *)a)->name,
                  ((const struct checkpoint_tensor *)b)->name);
}

const struct checkpoint_tensor *checkpoint_find(const struct checkpoint *c, const char *name)
{
    struct checkpoint_tensor key = {.rank = 0};
    if (c->n == 0 || strlen(name) >= sizeof key.name)
        return NULL;
    strcpy(key.name, name);
    return bsearch(&key, c->tensors, (size_t)c->n, sizeof key, by_name);
}

static bool begins(const char *s, size_t n, const char *with)
{
    return n >= strlen(with) && memcmp(s, with, strlen(with)) == 0;
}

/* The name as the network's table has it; n bytes of text. */
static err_t take_name(const struct checkpoint *c, const char *text, size_t n,
                       struct checkpoint_tensor *t)
{
    const char *prefix = "";
    if (begins(text, n, "model.")) {
        text += strlen("model.");
        n -= strlen("model.");
    }
    if (!begins(text, n, "encoder."))
        prefix = "encoder.";
    if (strlen(prefix) + n >= sizeof t->name)
        return err_fail(ERR_FORMAT, "%s: tensor %.*s...: name of %zu bytes, at most %d are read",
                        c->what, 64, text, n, CHECKPOINT_NAME_CAP - 9);
    for (size_t i = 0; i < n; i++)
        if ((unsigned char)text[i] < 0x20)
            return err_fail(ERR_FORMAT, "%s: a tensor name holds the character 0x%02x", c->what,
                            (unsigned)(unsigned char)text[i]);
    snprintf(t->name, sizeof t->name, "%s%.*s", prefix, (int)n, text);
    return OK;
}

static err_t sort_names(struct checkpoint *c)
{
    if (c->n > 0)
        qsort(c->tensors, (size_t)c->n, sizeof *c->tensors, by_name);
    for (int i = 1; i < c->n; i++)
        if (strcmp(c->tensors[i - 1].name, c->tensors[i].name) == 0)
            return err_fail(ERR_FORMAT, "%s: tensor %s is there twice", c->what,
                            c->tensors[i].name);
    return OK;
}

static err_t make_room(struct checkpoint *c, int n)
{
    c->tensors = calloc((size_t)n + 1, sizeof *c->tensors);
    return c->tensors ? OK : err_fail(ERR_NOMEM, "%s: no memory for %d tensors", c->what, n);
}

/* Elements from the tensor's first to behind its last; false if that overflows. */
static bool spread_of(const struct checkpoint_tensor *t, size_t *out)
{
    size_t count = 1, step;
    bool good = true;
    *out = 1;
    for (int k = 0; k < t->rank; k++) {
        good &= bytes_mul(count, t->shape[k], &count);
        if (t->shape[k] == 0) {
            *out = 0;
            return true;
        }
        good &= bytes_mul(t->shape[k] - 1, t->stride[k], &step) && bytes_add(*out, step, out);
    }
    return good && count <= SIZE_MAX / sizeof(float);
}

/* ---- safetensors ---- */

static err_t add_safetensor(struct checkpoint *c, const struct safetensors *head,
                            const struct safetensors_tensor *s)
{
    static const char *const types[] = {"F32", "BF16", "F16"};
    struct checkpoint_tensor *t = &c->tensors[c->n];
    size_t step = 1;
    t->type = CHECKPOINT_OTHER;
    for (int k = 0; k < 3; k++)
        if (strcmp(s->type, types[k]) == 0)
            t->type = (enum checkpoint_type)k;
    t->rank = s->rank;
    for (int k = s->rank - 1; k >= 0; k--) {
        t->shape[k] = s->shape[k];
        t->stride[k] = step;
        step *= s->shape[k];
    }
    t->storage = head->data + s->begin;
    t->room = step;
    c->n++;
    return take_name(c, s->name, strlen(s->name), t);
}

static err_t read_file(const struct checkpoint *c, uint64_t at, void *out, size_t n)
{
    FILE *f = c->file;
    errno = 0;
    if (fseeko(f, (off_t)at, SEEK_SET) == 0 && fread(out, 1, n, f) == n)
        return OK;
    return err_fail(errno ? ERR_IO : ERR_FORMAT, "%s: reading %zu bytes at %ju: %s", c->what, n,
                    (uintmax_t)at, errno ? strerror(errno) : "the file ends before");
}

static err_t open_safetensors(struct checkpoint *c, uint64_t bytes)
{
    struct safetensors head = {0};
    uint8_t first[8];
    size_t n = 0;
    err_t e = read_file(c, 0, first, sizeof first);
    if (!e)
        e = safetensors_header(c->what, first, bytes, &n);
    if (e)
        return e;
    uint8_t *p = malloc(n);
    e = p ? read_file(c, 0, p, n)
          : err_fail(ERR_NOMEM, "%s: no memory for a header of %zu bytes", c->what, n);
    if (!e)
        e = safetensors_open(c->what, p, n, bytes, &head);
    if (!e)
        e = make_room(c, head.n);
    for (int i = 0; i < head.n && !e; i++)
        e = add_safetensor(c, &head, &head.tensors[i]);
    safetensors_close(&head);
    free(p);
    return e;
}

/* ---- PyTorch ---- */

static err_t zip_fail(const struct checkpoint *c, const char *member, zip_error_t *z)
{
    err_t code = zip_error_code_zip(z) == ZIP_ER_MEMORY   ? ERR_NOMEM
                 : zip_error_system_type(z) == ZIP_ET_SYS ? ERR_IO
                                                          : ERR_FORMAT;
    return err_fail(code, "%s%s%s: %s", c->what, *member ? ": " : "", member,
                    zip_error_strerror(z));
}

/* n bytes of a member from `at` on; its checksum is compared if that is all of it. */
static err_t read_member(const struct checkpoint *c, uint64_t index, uint64_t at, void *out,
                         size_t n)
{
    char name[48], more;
    snprintf(name, sizeof name, "member %ju", (uintmax_t)index);
    zip_file_t *f = zip_fopen_index(c->zip, index, 0);
    if (!f)
        return zip_fail(c, name, zip_get_error(c->zip));
    err_t e = at == 0 || zip_fseek(f, (zip_int64_t)at, SEEK_SET) == 0
                  ? OK
                  : zip_fail(c, name, zip_file_get_error(f));
    for (size_t got = 0; got < n && !e;) {
        zip_int64_t more_bytes = zip_fread(f, (char *)out + got, n - got);
        if (more_bytes < 0)
            e = zip_fail(c, name, zip_file_get_error(f));
        else if (more_bytes == 0)
            e = err_fail(ERR_FORMAT, "%s: %s ends after %zu of %zu bytes", c->what, name, got, n);
        else
            got += (size_t)more_bytes;
    }
    if (!e && zip_fread(f, &more, 1) < 0) // at the end: the checksum
        e = zip_fail(c, name, zip_file_get_error(f));
    zip_fclose(f);
    return e;
}

/* Bytes of a stored member. */
static err_t member_bytes(const struct checkpoint *c, uint64_t index, uint64_t *out)
{
    zip_stat_t st;
    const zip_uint64_t need = ZIP_STAT_NAME | ZIP_STAT_SIZE | ZIP_STAT_COMP_SIZE |
                              ZIP_STAT_COMP_METHOD | ZIP_STAT_ENCRYPTION_METHOD;
    *out = 0;
    if (zip_stat_index(c->zip, index, 0, &st) != 0)
        return zip_fail(c, "", zip_get_error(c->zip));
    if ((st.valid & need) != need || st.comp_method != ZIP_CM_STORE ||
        st.encryption_method != ZIP_EM_NONE || st.size != st.comp_size)
        return err_fail(ERR_FORMAT, "%s: %.96s is compressed or encrypted; PyTorch stores as it is",
                        c->what, st.valid & ZIP_STAT_NAME ? st.name : "a member");
    *out = st.size;
    return OK;
}

/* Folder of the only <folder>/data.pkl, and the member. */
static err_t find_pickle(const struct checkpoint *c, char folder[FOLDER_CAP], uint64_t *index)
{
    zip_int64_t n = zip_get_num_entries(c->zip, 0);
    int found = 0;
    for (zip_uint64_t i = 0; n > 0 && i < (zip_uint64_t)n; i++) {
        const char *name = zip_get_name(c->zip, i, 0);
        const char *slash = name ? strchr(name, '/') : NULL;
        if (!slash || strcmp(slash, "/data.pkl") != 0 || slash - name >= FOLDER_CAP)
            continue;
        snprintf(folder, FOLDER_CAP, "%.*s", (int)(slash - name), name);
        *index = i;
        found++;
    }
    if (found != 1)
        return err_fail(ERR_FORMAT, "%s: a zip archive with %d <folder>/data.pkl, PyTorch's has 1",
                        c->what, found);
    return OK;
}

static err_t check_order(const struct checkpoint *c, const char *folder)
{
    char name[FOLDER_CAP + 16], order[8] = "";
    uint64_t bytes;
    snprintf(name, sizeof name, "%s/byteorder", folder);
    zip_int64_t i = zip_name_locate(c->zip, name, 0);
    if (i < 0)
        return OK; // older versions have none and are little-endian
    err_t e = member_bytes(c, (uint64_t)i, &bytes);
    if (!e && bytes < sizeof order)
        e = read_member(c, (uint64_t)i, 0, order, (size_t)bytes);
    if (!e && strcmp(order, "little") != 0)
        e = err_fail(ERR_FORMAT, "%s: byte order \"%s\", only little is read", c->what, order);
    return e;
}

struct unpickling {
    struct checkpoint *c;
    const char *folder;
    const struct pickle *p;
};

static err_t bad_tensor(const struct checkpoint *c, const struct checkpoint_tensor *t,
                        const char *why)
{
    return err_fail(ERR_FORMAT, "%s: tensor %s: %s", c->what, t->name, why);
}

static bool get_count(const struct pickle_value *v, uint64_t *out)
{
    if (!v || v->kind != PICKLE_INT || v->number < 0)
        return false;
    *out = (uint64_t)v->number;
    return true;
}

/* A tuple of at most CHECKPOINT_RANK_MAX counts. */
static bool get_counts(const struct pickle *p, const struct pickle_value *v, size_t *out, int *n)
{
    if (!v || v->kind != PICKLE_TUPLE || v->count > CHECKPOINT_RANK_MAX)
        return false;
    *n = v->count;
    for (int k = 0; k < v->count; k++) {
        uint64_t number;
        if (!get_count(pickle_item(p, v, k), &number))
            return false;
        out[k] = (size_t)number;
    }
    return true;
}

/* The member that holds a storage. */
static err_t get_storage(const struct unpickling *u, const struct pickle_value *v,
                         struct checkpoint_tensor *t)
{
    const struct pickle_value *kind =
                                  v && v->kind == PICKLE_STORAGE ? pickle_item(u->p, v, 1) : NULL,
                              *key = kind ? pickle_item(u->p, v, 2) : NULL;
    char name[FOLDER_CAP + 48];
    uint64_t bytes;
    if (!key || key->kind != PICKLE_TEXT || key->n_text > 24 || kind->kind != PICKLE_GLOBAL ||
        !get_count(pickle_item(u->p, v, 4), &t->room))
        return bad_tensor(u->c, t, "has no storage");
    t->type = kind->global == PICKLE_FLOAT_STORAGE      ? CHECKPOINT_F32
              : kind->global == PICKLE_BFLOAT16_STORAGE ? CHECKPOINT_BF16
              : kind->global == PICKLE_HALF_STORAGE     ? CHECKPOINT_F16
                                                        : CHECKPOINT_OTHER;
    snprintf(name, sizeof name, "%s/data/%.*s", u->folder, (int)key->n_text, key->text);
    zip_int64_t i = zip_name_locate(u->c->zip, name, 0);
    if (i < 0)
        return err_fail(ERR_FORMAT, "%s: tensor %s: the archive has no %.96s", u->c->what, t->name,
                        name);
    t->storage = (uint64_t)i;
    err_t e = member_bytes(u->c, t->storage, &bytes);
    if (!e && t->type != CHECKPOINT_OTHER && t->room > bytes / type_bytes(t->type))
        e = err_fail(ERR_FORMAT, "%s: tensor %s: storage of %ju elements in %ju bytes", u->c->what,
                     t->name, (uintmax_t)t->room, (uintmax_t)bytes);
    return e;
}

static err_t add_tensor(const struct unpickling *u, const struct pickle_value *v,
                        struct checkpoint_tensor *t)
{
    int n_strides;
    size_t spread;
    err_t e = get_storage(u, pickle_item(u->p, v, 0), t);
    if (e)
        return e;
    if (!get_count(pickle_item(u->p, v, 1), &t->offset) ||
        !get_counts(u->p, pickle_item(u->p, v, 2), t->shape, &t->rank) ||
        !get_counts(u->p, pickle_item(u->p, v, 3), t->stride, &n_strides) || n_strides != t->rank)
        return bad_tensor(u->c, t, "has no offset, shape and strides");
    if (!spread_of(t, &spread) || t->offset > t->room || spread > t->room - t->offset)
        return bad_tensor(u->c, t, "reaches beyond its storage");
    return OK;
}

/* The tensors among the members of a dictionary. */
static err_t add_tensors(const struct unpickling *u, const struct pickle_value *dict)
{
    const struct pickle *p = u->p;
    struct checkpoint *c = u->c;
    err_t e = make_room(c, dict->count / 2);
    for (int i = dict->first; i >= 0 && !e; i = p->items[p->items[i].next].next) {
        const struct pickle_value *k = &p->values[p->items[i].value],
                                  *v = &p->values[p->items[p->items[i].next].value];
        if (k->kind != PICKLE_TEXT || v->kind != PICKLE_TENSOR)
            continue;
        struct checkpoint_tensor *t = &c->tensors[c->n];
        e = take_name(c, k->text, k->n_text, t);
        if (!e)
            e = add_tensor(u, v, t);
        c->n++;
    }
    return e;
}

static err_t unpickle(struct checkpoint *c, const char *folder, const void *bytes, size_t n)
{
    struct pickle p;
    err_t e = pickle_parse(c->what, bytes, n, &p);
    if (e)
        return e;
    const struct pickle_value *top = &p.values[p.root], *state = pickle_get(&p, top, "state_dict");
    const struct unpickling u = {c, folder, &p};
    if (state && state->kind == PICKLE_DICT)
        top = state;
    if (top->kind == PICKLE_DICT)
        e = add_tensors(&u, top);
    else
        e = err_fail(ERR_FORMAT, "%s: holds no dictionary of tensors", c->what);
    pickle_free(&p);
    return e;
}

static err_t open_zip(struct checkpoint *c, const char *path)
{
    char folder[FOLDER_CAP];
    uint64_t index = 0, bytes = 0;
    zip_error_t why;
    int code;
    c->zip = zip_open(path, ZIP_RDONLY, &code);
    if (!c->zip) {
        zip_error_init_with_code(&why, code);
        err_t e = zip_fail(c, "", &why);
        zip_error_fini(&why);
        return e;
    }
    err_t e = find_pickle(c, folder, &index);
    if (!e)
        e = check_order(c, folder);
    if (!e)
        e = member_bytes(c, index, &bytes);
    if (!e && bytes > PICKLE_BYTES_MAX)
        e = err_fail(ERR_FORMAT, "%s: data.pkl has %ju bytes, at most %d are read", c->what,
                     (uintmax_t)bytes, PICKLE_BYTES_MAX);
    if (e)
        return e;
    void *p = malloc((size_t)bytes + 1);
    e = p ? read_member(c, index, 0, p, (size_t)bytes)
          : err_fail(ERR_NOMEM, "%s: no memory for %ju bytes", c->what, (uintmax_t)bytes);
    if (!e)
        e = unpickle(c, folder, p, (size_t)bytes);
    free(p);
    return e;
}

/* ---- both ---- */

static err_t open_any(struct checkpoint *c, const char *path)
{
    struct stat st;
    uint8_t first[8] = {0};
    if (stat(path, &st) != 0)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    if (!S_ISREG(st.st_mode)) // a FIFO must not hold us up
        return err_fail(ERR_FORMAT, "%s: not a regular file", path);
    FILE *f = c->file = fopen(path, "rbe");
    if (!f)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    size_t n = fread(first, 1, sizeof first, f);
    if (n == sizeof first && memcmp(first, "PK\3\4", 4) == 0) {
        fclose(f);
        c->file = NULL;
        return open_zip(c, path);
    }
    if (first[0] == 0x80 && first[1] < 6)
        return err_fail(ERR_FORMAT,
                        "%s: a file of PyTorch before 1.6; load it there and save it again", path);
    return open_safetensors(c, (uint64_t)st.st_size);
}

err_t checkpoint_open(const char *path, struct checkpoint *out)
{
    memset(out, 0, sizeof *out);
    out->what = path;
    err_t e = open_any(out, path);
    if (!e)
        e = sort_names(out);
    if (e)
        checkpoint_close(out);
    return e;
}

void checkpoint_close(struct checkpoint *c)
{
    if (c->zip)
        zip_discard(c->zip);
    if (c->file)
        fclose(c->file);
    free(c->tensors);
    memset(c, 0, sizeof *c);
}

/* ---- reading ---- */

static void to_floats(enum checkpoint_type type, const uint8_t *in, size_t n, float *out)
{
    if (type == CHECKPOINT_F32)
        memcpy(out, in, n * sizeof *out);
    for (size_t i = 0; i < n && type != CHECKPOINT_F32; i++) {
        uint16_t half = (uint16_t)(in[2 * i] | in[2 * i + 1] << 8);
        uint32_t bits = (uint32_t)half << 16;
        if (type == CHECKPOINT_BF16)
            memcpy(&out[i], &bits, sizeof bits);
        else
            out[i] = half_to_float(half);
    }
}

/* The n elements of the storage from t->offset on. */
static err_t read_run(const struct checkpoint *c, const struct checkpoint_tensor *t, size_t n,
                      float *out)
{
    size_t each = type_bytes(t->type);
    /* Halves are read into the upper part of out and widened from there, first to last. */
    uint8_t *raw = (uint8_t *)out + n * (sizeof *out - each);
    err_t e = c->zip ? read_member(c, t->storage, t->offset * each, raw, n * each)
                     : read_file(c, t->storage + t->offset * each, raw, n * each);
    if (!e && each < sizeof *out)
        to_floats(t->type, raw, n, out);
    return e;
}

/* Pick the elements of a view out of its run. */
static void pick(const struct checkpoint_tensor *t, const float *run, float *out)
{
    size_t index[CHECKPOINT_RANK_MAX] = {0}, at = 0, n = checkpoint_count(t);
    for (size_t i = 0; i < n; i++) {
        out[i] = run[at];
        for (int k = t->rank - 1; k >= 0; k--) {
            at += t->stride[k];
            if (++index[k] < t->shape[k])
                break;
            at -= index[k] * t->stride[k];
            index[k] = 0;
        }
    }
}

static bool is_contiguous(const struct checkpoint_tensor *t)
{
    size_t step = 1;
    for (int k = t->rank - 1; k >= 0; k--) {
        if (t->shape[k] > 1 && t->stride[k] != step)
            return false;
        step *= t->shape[k];
    }
    return true;
}

err_t checkpoint_read(const struct checkpoint *c, const struct checkpoint_tensor *t, float *out)
{
    size_t spread = 0;
    if (t->type == CHECKPOINT_OTHER)
        return err_fail(ERR_FORMAT, "%s: tensor %s is not float32, bfloat16 or float16", c->what,
                        t->name);
    if (!spread_of(t, &spread) || spread == 0)
        return spread_of(t, &spread) ? OK : bad_tensor(c, t, "is too large");
    if (is_contiguous(t))
        return read_run(c, t, spread, out);
    if (spread > SPREAD_MAX / sizeof *out)
        return err_fail(ERR_LIMIT,
                        "%s: tensor %s is spread over %zu elements, at most %zu are read", c->what,
                        t->name, spread, SPREAD_MAX / sizeof *out);
    float *run = malloc(spread * sizeof *run);
    err_t e = run ? read_run(c, t, spread, run)
                  : err_fail(ERR_NOMEM, "%s: no memory for tensor %s", c->what, t->name);
    if (!e)
        pick(t, run, out);
    free(run);
    return e;
}
