#include "drivers/format/checkpoint.h"

#include "core/base/bytes.h"
#include "core/base/half.h"
#include "drivers/format/json.h"
#include "drivers/format/name.h"
#include "drivers/format/pickle.h"
#include "drivers/format/safetensors.h"

#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

enum { PICKLE_BYTES_MAX = 32 << 20, SPREAD_MAX = 512 << 20, FOLDER_CAP = 256, STATE_DEPTH = 4 };

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

/* Parts of names from data parallelism, torch.compile, activation checkpoints and sharding. */
static const char *const wrappers[] = {"module.", "_orig_mod.", "_checkpoint_wrapped_module.",
                                       "_fsdp_wrapped_module."};

enum { N_WRAPPERS = sizeof wrappers / sizeof *wrappers };

static size_t prefix_bytes(const char *s, size_t n, const char *with)
{
    size_t m = strlen(with);
    return n >= m && memcmp(s, with, m) == 0 ? m : 0;
}

/* Bytes of a wrapper at the start of a part of a name, or of "model." at that of the name. */
static size_t wrapper_at(const char *text, size_t n, bool first)
{
    size_t found = first ? prefix_bytes(text, n, "model.") : 0;
    for (int i = 0; i < N_WRAPPERS && !found; i++)
        found = prefix_bytes(text, n, wrappers[i]);
    return found;
}

/* The name as the network's table has it; n bytes of text. */
static err_t take_name(const char *what, const char *text, size_t n, char out[CHECKPOINT_NAME_CAP])
{
    size_t to = 0;
    if (n > CHECKPOINT_NAME_CAP - 9)
        return err_fail(ERR_FORMAT, "%s: tensor %.*s...: name of %zu bytes, at most %d are read",
                        what, 64, text, n, CHECKPOINT_NAME_CAP - 9);
    for (size_t i = 0; i < n; i++)
        if ((unsigned char)text[i] < 0x20)
            return err_fail(ERR_FORMAT, "%s: a tensor name holds the character 0x%02x", what,
                            (unsigned)(unsigned char)text[i]);
    for (size_t i = 0, part; i < n; i += part) {
        part = wrapper_at(text + i, n - i, to == 0);
        if (part)
            continue;
        if (to == 0 && !prefix_bytes(text + i, n - i, "encoder."))
            to = (size_t)snprintf(out, CHECKPOINT_NAME_CAP, "encoder.");
        const char *dot = memchr(text + i, '.', n - i);
        part = dot ? (size_t)(dot - text) + 1 - i : n - i;
        memcpy(out + to, text + i, part);
        to += part;
    }
    out[to] = 0;
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

/* Make room for n more tensors. */
static err_t make_room(struct checkpoint *c, int n)
{
    const size_t all = (size_t)c->n + (size_t)n;
    void *p = realloc(c->tensors, (all + 1) * sizeof *c->tensors);
    if (!p)
        return err_fail(ERR_NOMEM, "%s: no memory for %zu tensors", current_part(c)->path, all);
    c->tensors = p;
    return OK;
}

/* The next free tensor, for the file that is being opened; the caller counts it when it is whole.
 * */
static struct checkpoint_tensor *next_tensor(struct checkpoint *c)
{
    c->tensors[c->n] = (struct checkpoint_tensor){.part = c->n_parts - 1};
    return &c->tensors[c->n];
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
    struct checkpoint_tensor *t = next_tensor(c);
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
    return take_name(current_part(c)->path, s->name, strlen(s->name), t->name);
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
        e = make_room(c, head.n);
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

struct unpickling {
    struct checkpoint *c;
    const struct checkpoint_part *part;
    const char *folder;
    const struct pickle *p;
};

static err_t bad_tensor(const struct checkpoint_part *p, const struct checkpoint_tensor *t,
                        const char *why)
{
    return err_fail(ERR_FORMAT, "%s: tensor %s: %s", p->path, t->name, why);
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

static void set_other(struct checkpoint_tensor *t, const struct pickle_value *kind)
{
    t->type = CHECKPOINT_OTHER;
    snprintf(t->kind, sizeof t->kind, "%.*s",
             (int)(kind->n_text < sizeof t->kind ? kind->n_text : sizeof t->kind), kind->text);
}

static void set_type(struct checkpoint_tensor *t, const struct pickle_value *kind)
{
    set_other(t, kind);
    if (kind->global == PICKLE_FLOAT_STORAGE)
        t->type = CHECKPOINT_F32;
    else if (kind->global == PICKLE_BFLOAT16_STORAGE)
        t->type = CHECKPOINT_BF16;
    else if (kind->global == PICKLE_HALF_STORAGE)
        t->type = CHECKPOINT_F16;
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
        return bad_tensor(u->part, t, "has no storage");
    set_type(t, kind);
    snprintf(name, sizeof name, "%s/data/%.*s", u->folder, (int)key->n_text, key->text);
    if (!zipfile_find(&u->part->zip, name, &t->storage))
        return err_fail(ERR_FORMAT, "%s: tensor %s: the archive has no %.96s", u->part->path,
                        t->name, name);
    err_t e = member_bytes(u->part, t->storage, &bytes);
    if (!e && t->type != CHECKPOINT_OTHER && t->room > bytes / type_bytes(t->type))
        e = err_fail(ERR_FORMAT, "%s: tensor %s: storage of %ju elements in %ju bytes",
                     u->part->path, t->name, (uintmax_t)t->room, (uintmax_t)bytes);
    return e;
}

/* Marks of a tensor: a dictionary, or nothing in older files. An unknown mark that is set makes the
 * tensor one of another kind. */
static void get_marks(const struct pickle *p, const struct pickle_value *dict,
                      struct checkpoint_tensor *t)
{
    if (!dict || dict->kind != PICKLE_DICT)
        return;
    for (int i = dict->first; i >= 0; i = p->items[p->items[i].next].next) {
        const struct pickle_value *k = &p->values[p->items[i].value],
                                  *v = &p->values[p->items[p->items[i].next].value];
        bool holds = v->kind != PICKLE_INT || v->number != 0;
        if (k->kind != PICKLE_TEXT || !holds)
            continue;
        if (k->n_text == 3 && memcmp(k->text, "neg", 3) == 0)
            t->negative = true;
        else if (t->type != CHECKPOINT_OTHER)
            set_other(t, k);
    }
}

static err_t add_tensor(const struct unpickling *u, const struct pickle_value *v,
                        struct checkpoint_tensor *t)
{
    int n_strides;
    size_t spread;
    if (v->kind == PICKLE_FOREIGN) {
        set_other(t, v);
        return OK;
    }
    err_t e = get_storage(u, pickle_item(u->p, v, 0), t);
    if (e)
        return e;
    if (!get_count(pickle_item(u->p, v, 1), &t->offset) ||
        !get_counts(u->p, pickle_item(u->p, v, 2), t->shape, &t->rank) ||
        !get_counts(u->p, pickle_item(u->p, v, 3), t->stride, &n_strides) || n_strides != t->rank)
        return bad_tensor(u->part, t, "has no offset, shape and strides");
    if (!spread_of(t, &spread) || t->offset > t->room || spread > t->room - t->offset)
        return bad_tensor(u->part, t, "reaches beyond its storage");
    get_marks(u->p, pickle_item(u->p, v, 6), t);
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
        if (k->kind != PICKLE_TEXT || (v->kind != PICKLE_TENSOR && v->kind != PICKLE_FOREIGN))
            continue;
        struct checkpoint_tensor *t = next_tensor(c);
        e = take_name(u->part->path, k->text, k->n_text, t->name);
        if (!e)
            e = add_tensor(u, v, t);
        c->n++;
    }
    return e;
}

/* The dictionary that counts; *top is the outermost value. */
static err_t find_state(const struct unpickling *u, const struct pickle_value **top)
{
    static const char *const keys[] = {"state_dict", "model_state_dict", "model", "module"};
    for (int depth = 0; depth < STATE_DEPTH; depth++) {
        const struct pickle_value *inner = NULL;
        const char *key = NULL;
        for (int k = 0; k < 4 && !inner; k++) {
            key = keys[k];
            inner = pickle_get(u->p, *top, key);
            if (inner && inner->kind != PICKLE_DICT && inner->kind != PICKLE_OPAQUE)
                inner = NULL;
        }
        if (!inner)
            break;
        if (inner->kind == PICKLE_OPAQUE)
            return err_fail(
                ERR_FORMAT,
                "%s: \"%s\" holds an object of Python, not a dictionary of tensors; save "
                "its state_dict() instead",
                u->part->path, key);
        *top = inner;
    }
    if ((*top)->kind == PICKLE_DICT)
        return OK;
    return err_fail(ERR_FORMAT,
                    "%s: holds no dictionary of tensors; save the model's state_dict() instead",
                    u->part->path);
}

static err_t add_pickled(struct checkpoint *c, const char *folder, const void *bytes, size_t n)
{
    struct pickle p;
    const struct unpickling u = {c, current_part(c), folder, &p};
    err_t e = pickle_parse(u.part->path, bytes, n, &p);
    if (e)
        return e;
    const struct pickle_value *top = &p.values[p.root];
    e = find_state(&u, &top);
    if (!e)
        e = add_tensors(&u, top);
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
        e = zipfile_load(&part->zip, index, PICKLE_BYTES_MAX, &p, &n);
    if (!e)
        e = add_pickled(c, folder, p, n);
    free(p);
    return e;
}

/* ---- files ---- */

enum content { CONTENT_SAFETENSORS, CONTENT_ZIP, CONTENT_INDEX };

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
    if (first[0] != 0x80 || first[1] >= 6)
        return OK;
    fclose(*f);
    *f = NULL;
    return err_fail(ERR_FORMAT, "%s: a file of PyTorch before 1.6; load it there and save it again",
                    path);
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
        err_t e = take_name(c->what, json_key(m), strlen(json_key(m)), name);
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

err_t checkpoint_open(const char *path, struct checkpoint *out)
{
    enum content content;
    uint64_t bytes;
    FILE *f;
    memset(out, 0, sizeof *out);
    out->what = path;
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
    size_t each = type_bytes(t->type);
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
    if (!spread_of(t, &spread) || spread == 0)
        return spread_of(t, &spread) ? OK : bad_tensor(p, t, "is too large");
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
