#include "drivers/format/checkpoint.h"

#include "core/base/half.h"
#include "drivers/format/checkpoint_old.h"
#include "drivers/format/checkpoint_pickle.h"
#include "drivers/format/json.h"
#include "drivers/format/name.h"
#include "drivers/format/safetensors.h"

#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

enum { SPREAD_MAX = 512 << 20, FOLDER_CAP = 256 };

size_t checkpoint_count(const struct checkpoint_tensor *t)
{
    size_t n = 1;
    for (int k = 0; k < t->rank; k++)
        n *= t->shape[k];
    return n;
}

/* ---- tensors and their names ---- */

/* The file that is being opened. */
static struct checkpoint_part *current_part(const struct checkpoint *c)
{
    return &c->parts[c->n_parts - 1];
}

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

/* ---- safetensors ---- */

static err_t add_safetensor(struct checkpoint *c, const struct safetensors *head,
                            const struct safetensors_tensor *s)
{
    static const char *const types[] = {"F32", "BF16", "F16"};
    struct checkpoint_tensor *t = checkpoint_tensors_next(c);
    size_t step = 1;
    t->type = CHECKPOINT_OTHER;
    snprintf(t->kind, sizeof t->kind, "%s", s->type);
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
    return checkpoint_tensors_name(c, current_part(c)->path, bytes_of(s->name, strlen(s->name)),
                                   t->name);
}

static err_t read_file(const struct checkpoint_part *p, uint64_t at, void *out, size_t n)
{
    FILE *f = p->file;
    errno = 0;
    if (fseeko(f, (off_t)at, SEEK_SET) == 0 && fread(out, 1, n, f) == n)
        return OK;
    return err_fail(errno ? ERR_IO : ERR_FORMAT, "%s: reading %zu bytes at %ju: %s", p->path, n,
                    (uintmax_t)at, errno ? strerror(errno) : "the file ends before");
}

static err_t open_safetensors(struct checkpoint *c, uint64_t bytes)
{
    const struct checkpoint_part *part = current_part(c);
    struct safetensors head = {0};
    uint8_t first[8];
    size_t n = 0;
    err_t e = read_file(part, 0, first, sizeof first);
    if (!e)
        e = safetensors_header(part->path, first, bytes, &n);
    if (e)
        return e;
    uint8_t *p = malloc(n);
    e = p ? read_file(part, 0, p, n)
          : err_fail(ERR_NOMEM, "%s: no memory for a header of %zu bytes", part->path, n);
    if (!e)
        e = safetensors_open(part->path, p, n, bytes, &head);
    if (!e)
        e = checkpoint_tensors_room(c, head.n);
    for (int i = 0; i < head.n && !e; i++)
        e = add_safetensor(c, &head, &head.tensors[i]);
    safetensors_close(&head);
    free(p);
    return e;
}

/* ---- PyTorch ---- */

/* Bytes of a stored member. */
static err_t member_bytes(const struct checkpoint_part *p, uint64_t index, uint64_t *out)
{
    struct zipfile_info info;
    err_t e = zipfile_look(&p->zip, index, &info);
    *out = info.bytes;
    if (!e && !info.stored)
        e = err_fail(ERR_FORMAT, "%s: %.96s is compressed or encrypted; PyTorch stores as it is",
                     p->path, zipfile_name(&p->zip, index));
    return e;
}

/* Folder of the only <folder>/data.pkl, and the member. */
static err_t find_pickle(const struct checkpoint_part *p, char folder[FOLDER_CAP], uint64_t *index)
{
    const uint64_t n = zipfile_count(&p->zip);
    int found = 0;
    for (uint64_t i = 0; i < n; i++) {
        const char *name = zipfile_name(&p->zip, i);
        const char *slash = name ? strchr(name, '/') : NULL;
        if (!slash || strcmp(slash, "/data.pkl") != 0 || slash - name >= FOLDER_CAP)
            continue;
        snprintf(folder, FOLDER_CAP, "%.*s", (int)(slash - name), name);
        *index = i;
        found++;
    }
    if (found != 1)
        return err_fail(ERR_FORMAT, "%s: a zip archive with %d <folder>/data.pkl, PyTorch's has 1",
                        p->path, found);
    return OK;
}

static err_t check_order(const struct checkpoint_part *p, const char *folder)
{
    char name[FOLDER_CAP + 16], order[8] = "";
    uint64_t i, bytes;
    snprintf(name, sizeof name, "%s/byteorder", folder);
    if (!zipfile_find(&p->zip, name, &i))
        return OK; // older versions have none and are little-endian
    err_t e = member_bytes(p, i, &bytes);
    if (!e && bytes < sizeof order)
        e = zipfile_read(&p->zip, i, 0, order, (size_t)bytes);
    if (!e && strcmp(order, "little") != 0)
        e = err_fail(ERR_FORMAT, "%s: byte order \"%s\", only little is read", p->path, order);
    return e;
}

struct archive {
    const struct checkpoint_part *part;
    const char *folder;
};

/* The member that holds a storage. */
static err_t find_member(const void *ctx, const struct checkpoint_pickle_storage *s,
                         struct checkpoint_tensor *t, uint64_t *bytes)
{
    const struct archive *a = ctx;
    char name[FOLDER_CAP + CHECKPOINT_PICKLE_KEY_MAX + 8];
    snprintf(name, sizeof name, "%s/data/%.*s", a->folder, (int)s->n_key, s->key);
    if (!zipfile_find(&a->part->zip, name, &t->storage))
        return err_fail(ERR_FORMAT, "%s: tensor %s: the archive has no %.96s", a->part->path,
                        t->name, name);
    return member_bytes(a->part, t->storage, bytes);
}

static err_t add_pickled(struct checkpoint *c, const char *folder, const void *bytes, size_t n)
{
    struct pickle p;
    const struct archive a = {current_part(c), folder};
    const struct checkpoint_pickle job = {c, find_member, &a};
    err_t e = pickle_parse(a.part->path, bytes, n, &p);
    if (e)
        return e;
    e = checkpoint_pickle_add(&job, &p);
    pickle_free(&p);
    return e;
}

static err_t open_zip(struct checkpoint *c)
{
    struct checkpoint_part *part = current_part(c);
    char folder[FOLDER_CAP];
    uint64_t index = 0, bytes = 0;
    size_t n = 0;
    void *p = NULL;
    err_t e = zipfile_open(part->path, &part->zip);
    if (!e)
        e = find_pickle(part, folder, &index);
    if (!e)
        e = check_order(part, folder);
    if (!e)
        e = member_bytes(part, index, &bytes);
    if (!e)
        e = zipfile_load(&part->zip, index, CHECKPOINT_PICKLE_BYTES_MAX, &p, &n);
    if (!e)
        e = add_pickled(c, folder, p, n);
    free(p);
    return e;
}

/* ---- files ---- */

enum content { CONTENT_SAFETENSORS, CONTENT_ZIP, CONTENT_OLD, CONTENT_INDEX };

/* Open a file and tell its kind from its first bytes. own: fclose(*f). */
static err_t open_content(const char *path, FILE **f, uint64_t *bytes, enum content *out)
{
    struct stat st;
    uint8_t first[8] = {0};
    *f = NULL;
    if (stat(path, &st) != 0)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    if (!S_ISREG(st.st_mode)) // a FIFO must not hold us up
        return err_fail(ERR_FORMAT, "%s: not a regular file", path);
    *f = fopen(path, "rbe");
    if (!*f)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    size_t n = fread(first, 1, sizeof first, *f);
    *bytes = (uint64_t)st.st_size;
    *out = CONTENT_SAFETENSORS;
    if (n == sizeof first && memcmp(first, "PK\3\4", 4) == 0)
        *out = CONTENT_ZIP;
    else if (first[0] == '{' && !memchr(first, 0, n)) // no length: below 4 MB it ends with zeros
        *out = CONTENT_INDEX;
    else if (first[0] == 0x80 && first[1] < 6) // the protocol of a pickle
        *out = CONTENT_OLD;
    return OK;
}

/* The tensors of one file, whose path is that of the part behind the last. */
static err_t open_part(struct checkpoint *c)
{
    struct checkpoint_part *part = &c->parts[c->n_parts++];
    enum content content;
    uint64_t bytes;
    FILE *f;
    err_t e = open_content(part->path, &f, &bytes, &content);
    if (e)
        return e;
    part->file = f;
    if (content == CONTENT_INDEX)
        return err_fail(ERR_FORMAT, "%s: neither a PyTorch file nor safetensors", part->path);
    if (content == CONTENT_SAFETENSORS)
        return open_safetensors(c, bytes);
    if (content == CONTENT_OLD)
        return checkpoint_old_add(c);
    fclose(f);
    part->file = NULL;
    return open_zip(c);
}

static err_t make_parts(struct checkpoint *c, int n)
{
    c->parts = calloc((size_t)n, sizeof *c->parts);
    return c->parts ? OK : err_fail(ERR_NOMEM, "%s: no memory for %d files", c->what, n);
}

/* ---- index ---- */

static int by_path(const void *a, const void *b)
{
    return strcmp(((const struct checkpoint_part *)a)->path,
                  ((const struct checkpoint_part *)b)->path);
}

/* The file of a member of the map, beside the index. */
static err_t shard_path(const struct checkpoint *c, const struct cJSON *member,
                        char out[FILE_PATH_CAP])
{
    const char *text = json_string(member);
    char folder[FILE_PATH_CAP], name[NAME_CAP];
    err_t e = text ? name_copy(c->what, text, strlen(text), name)
                   : err_fail(ERR_FORMAT, "%s: \"%.96s\" of \"weight_map\" names no file", c->what,
                              json_key(member));
    if (!e)
        e = file_parent(c->what, folder);
    return e ? e : file_join(folder, name, out);
}

/* Paths of all files of the map, each once, ascending. */
static err_t list_parts(struct checkpoint *c, const struct cJSON *map, int *n)
{
    *n = 0;
    err_t e = make_parts(c, CHECKPOINT_PARTS_MAX);
    for (const struct cJSON *m = json_first(map); m && !e; m = json_next(m)) {
        char path[FILE_PATH_CAP];
        int k = 0;
        e = shard_path(c, m, path);
        while (!e && k < *n && strcmp(c->parts[k].path, path) != 0)
            k++;
        if (!e && k == CHECKPOINT_PARTS_MAX)
            e = err_fail(ERR_LIMIT, "%s: names more than %d files", c->what, CHECKPOINT_PARTS_MAX);
        if (!e && k == *n)
            snprintf(c->parts[(*n)++].path, FILE_PATH_CAP, "%s", path);
    }
    if (!e)
        qsort(c->parts, (size_t)*n, sizeof *c->parts, by_path);
    return e;
}

/* Whether every tensor of the map is in its file. */
static err_t check_map(const struct checkpoint *c, const struct cJSON *map)
{
    for (const struct cJSON *m = json_first(map); m; m = json_next(m)) {
        char name[CHECKPOINT_NAME_CAP], path[FILE_PATH_CAP];
        err_t e =
            checkpoint_tensors_name(c, c->what, bytes_of(json_key(m), strlen(json_key(m))), name);
        if (!e)
            e = shard_path(c, m, path);
        if (e)
            return e;
        const struct checkpoint_tensor *t = checkpoint_find(c, name);
        if (!t || strcmp(c->parts[t->part].path, path) != 0)
            return err_fail(ERR_FORMAT, "%s: tensor %s is not in %s", c->what, name, path);
    }
    return OK;
}

static err_t open_index(struct checkpoint *c)
{
    struct cJSON *doc;
    int n = 0;
    err_t e = json_read(c->what, &doc);
    if (e)
        return e;
    const struct cJSON *map = json_member(doc, "weight_map");
    if (!json_is_object(map) || !json_first(map))
        e = err_fail(ERR_FORMAT, "%s: no index of weights: it has no object \"weight_map\"",
                     c->what);
    if (!e)
        e = list_parts(c, map, &n);
    while (c->n_parts < n && !e)
        e = open_part(c);
    if (!e)
        e = sort_names(c);
    if (!e)
        e = check_map(c, map);
    json_free(doc);
    return e;
}

static err_t open_one(struct checkpoint *c)
{
    err_t e = make_parts(c, 1);
    if (!e && strlen(c->what) >= FILE_PATH_CAP)
        e = err_fail(ERR_ARG, "%.96s...: path of more than %d bytes", c->what, FILE_PATH_CAP - 1);
    if (e)
        return e;
    strcpy(c->parts[0].path, c->what);
    e = open_part(c);
    return e ? e : sort_names(c);
}

err_t checkpoint_open(const char *path, const char *owner, struct checkpoint *out)
{
    enum content content;
    uint64_t bytes;
    FILE *f;
    memset(out, 0, sizeof *out);
    out->what = path;
    out->owner = owner;
    err_t e = open_content(path, &f, &bytes, &content);
    if (e)
        return e;
    fclose(f);
    e = content == CONTENT_INDEX ? open_index(out) : open_one(out);
    if (e)
        checkpoint_close(out);
    return e;
}

void checkpoint_close(struct checkpoint *c)
{
    for (int i = 0; i < c->n_parts; i++) {
        zipfile_close(&c->parts[i].zip);
        if (c->parts[i].file)
            fclose(c->parts[i].file);
    }
    free(c->parts);
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
    const struct checkpoint_part *p = &c->parts[t->part];
    size_t each = checkpoint_tensors_bytes(t->type);
    /* Halves are read into the upper part of out and widened from there, first to last. */
    uint8_t *raw = (uint8_t *)out + n * (sizeof *out - each);
    err_t e = p->zip.zip ? zipfile_read(&p->zip, t->storage, t->offset * each, raw, n * each)
                         : read_file(p, t->storage + t->offset * each, raw, n * each);
    if (!e && each < sizeof *out)
        to_floats(t->type, raw, n, out);
    for (size_t i = 0; i < n && !e && t->negative; i++)
        out[i] = -out[i];
    return e;
}

/* Pick the elements of a view out of its run. */
static void gather_view(const struct checkpoint_tensor *t, const float *run, float *out)
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
    const struct checkpoint_part *p = &c->parts[t->part];
    size_t spread = 0;
    if (t->type == CHECKPOINT_OTHER)
        return err_fail(ERR_FORMAT, "%s: tensor %s is %s; float32, bfloat16 and float16 are read",
                        p->path, t->name, t->kind);
    if (!checkpoint_tensors_spread(t, &spread) || spread == 0)
        return checkpoint_tensors_spread(t, &spread)
                   ? OK
                   : err_fail(ERR_FORMAT, "%s: tensor %s is too large", p->path, t->name);
    if (is_contiguous(t))
        return read_run(c, t, spread, out);
    if (spread > SPREAD_MAX / sizeof *out)
        return err_fail(ERR_LIMIT,
                        "%s: tensor %s is spread over %zu elements, at most %zu are read", p->path,
                        t->name, spread, SPREAD_MAX / sizeof *out);
    float *run = malloc(spread * sizeof *run);
    err_t e = run ? read_run(c, t, spread, run)
                  : err_fail(ERR_NOMEM, "%s: no memory for tensor %s", p->path, t->name);
    if (!e)
        gather_view(t, run, out);
    free(run);
    return e;
}
