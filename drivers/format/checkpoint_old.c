#include "drivers/format/checkpoint_old.h"

#include "core/base/num.h"
#include "drivers/format/checkpoint_pickle.h"

#include <stdlib.h>
#include <string.h>

enum { PROTOCOL = 1001 };

static const size_t FILE_BYTES_MAX = (size_t)64 << 30;

/* A storage, as the pickle has it and then as the file has it. */
struct stored {
    const char *key;
    int n_key;
    int each;           // bytes of an element
    uint64_t at, bytes; // in the file; 0, 0: the list of keys has not named it
};

struct reading {
    struct checkpoint *c;
    const char *path;
    struct bytes in;    // from the next pickle or storage on
    uint64_t file;      // bytes
    int n;              // storages
    struct stored *all; // (n) by key
};

/* Bytes of an element of a storage class; 0: unknown. */
static int element_bytes(const struct pickle_value *kind)
{
    static const struct {
        const char *name;
        int bytes;
    } known[] = {{"FloatStorage", 4},         {"DoubleStorage", 8},  {"HalfStorage", 2},
                 {"BFloat16Storage", 2},      {"LongStorage", 8},    {"IntStorage", 4},
                 {"ShortStorage", 2},         {"CharStorage", 1},    {"ByteStorage", 1},
                 {"BoolStorage", 1},          {"QInt8Storage", 1},   {"QUInt8Storage", 1},
                 {"QInt32Storage", 4},        {"UntypedStorage", 1}, {"ComplexFloatStorage", 8},
                 {"ComplexDoubleStorage", 16}};
    for (size_t k = 0; k < sizeof known / sizeof known[0]; k++)
        if (strlen(known[k].name) == kind->n_text &&
            memcmp(known[k].name, kind->text, kind->n_text) == 0)
            return known[k].bytes;
    return 0;
}

/* ---- pickles ---- */

/* own:  pickle_free. */
static err_t next_pickle(struct reading *r, struct pickle *out)
{
    const size_t most = CHECKPOINT_PICKLE_BYTES_MAX;
    const size_t n = r->in.left < most ? r->in.left : most;
    err_t e = pickle_parse(r->path, r->in.p, n, out);
    if (!e)
        bytes_skip(&r->in, out->bytes, 1);
    return e;
}

/* A pickle of the long integer 0x1950a86a20f9469cfc6c. */
static err_t check_magic(struct reading *r)
{
    static const uint8_t magic[] = {0x8a, 10,   0x6c, 0xfc, 0x9c, 0x46, 0xf9,
                                    0x20, 0x6a, 0xa8, 0x50, 0x19, '.'};
    const uint8_t *first = r->in.p;
    struct pickle p;
    err_t e = next_pickle(r, &p);
    if (!e && (p.bytes < sizeof magic ||
               memcmp(first + p.bytes - sizeof magic, magic, sizeof magic) != 0))
        e = err_fail(ERR_FORMAT, "%s: a pickle, but not one of PyTorch: its magic number is wrong",
                     r->path);
    pickle_free(&p);
    return e;
}

static err_t check_protocol(struct reading *r)
{
    struct pickle p;
    err_t e = next_pickle(r, &p);
    if (!e && (p.values[p.root].kind != PICKLE_INT || p.values[p.root].number != PROTOCOL))
        e = err_fail(ERR_FORMAT, "%s: not of PyTorch's protocol %d, which is read", r->path,
                     PROTOCOL);
    pickle_free(&p);
    return e;
}

static err_t check_machine(struct reading *r)
{
    struct pickle p;
    err_t e = next_pickle(r, &p);
    const struct pickle_value *little =
        e ? NULL : pickle_get(&p, &p.values[p.root], "little_endian");
    if (!e && (!little || little->kind != PICKLE_INT || little->number != 1))
        e = err_fail(ERR_FORMAT,
                     "%s: was not written on a little-endian machine, only these are "
                     "read",
                     r->path);
    pickle_free(&p);
    return e;
}

/* ---- storages ---- */

static int by_key(const void *a, const void *b)
{
    const struct stored *x = a, *y = b;
    const int n = num_min(x->n_key, y->n_key), c = memcmp(x->key, y->key, (size_t)n);
    return c ? c : x->n_key - y->n_key;
}

static struct stored *find_key(const struct reading *r, const char *key, size_t n)
{
    const struct stored want = {.key = key, .n_key = (int)n};
    return r->n > 0 ? bsearch(&want, r->all, (size_t)r->n, sizeof want, by_key) : NULL;
}

/* Each storage that the object names, once. */
static err_t list_storages(struct reading *r, const struct pickle *p)
{
    struct checkpoint_pickle_storage s;
    int n = 0;
    r->all = malloc(((size_t)p->n_values + 1) * sizeof *r->all);
    if (!r->all)
        return err_fail(ERR_NOMEM, "%s: no memory for %d storages", r->path, p->n_values);
    for (int i = 0; i < p->n_values; i++)
        if (checkpoint_pickle_storage(p, &p->values[i], &s))
            r->all[n++] = (struct stored){s.key, (int)s.n_key, element_bytes(s.kind), 0, 0};
    if (n > 0)
        qsort(r->all, (size_t)n, sizeof *r->all, by_key);
    for (int i = 0; i < n; i++)
        if (r->n == 0 || by_key(&r->all[r->n - 1], &r->all[i]) != 0)
            r->all[r->n++] = r->all[i];
        else if (r->all[r->n - 1].each != r->all[i].each)
            return err_fail(ERR_FORMAT, "%s: storage %.*s has two types", r->path, r->all[i].n_key,
                            r->all[i].key);
    return OK;
}

/* The next storage of the file. */
static err_t place_storage(struct reading *r, const struct pickle_value *key)
{
    struct stored *s = key->kind == PICKLE_TEXT && key->n_text <= CHECKPOINT_PICKLE_KEY_MAX
                           ? find_key(r, key->text, key->n_text)
                           : NULL;
    if (!s || s->each == 0)
        return err_fail(ERR_FORMAT, "%s: holds a storage whose type is not known", r->path);
    const uint64_t count = bytes_u64(&r->in);
    s->at = r->file - r->in.left;
    bytes_skip(&r->in, count, (size_t)s->each);
    if (r->in.bad)
        return err_fail(ERR_FORMAT,
                        "%s: cut short: storage %.*s of %ju elements does not end in it", r->path,
                        s->n_key, s->key, (uintmax_t)count);
    s->bytes = r->file - r->in.left - s->at;
    return OK;
}

static err_t place_storages(struct reading *r)
{
    struct pickle keys;
    err_t e = next_pickle(r, &keys);
    const struct pickle_value *list = e ? NULL : &keys.values[keys.root];
    if (!e && list->kind != PICKLE_LIST)
        e = err_fail(ERR_FORMAT, "%s: has no list of storages behind the object", r->path);
    for (int i = e ? -1 : list->first; i >= 0 && !e; i = keys.items[i].next)
        e = place_storage(r, &keys.values[keys.items[i].value]);
    pickle_free(&keys);
    return e;
}

static err_t find_storage(const void *ctx, const struct checkpoint_pickle_storage *s,
                          struct checkpoint_tensor *t, uint64_t *bytes)
{
    const struct reading *r = ctx;
    const struct stored *found = find_key(r, s->key, s->n_key);
    if (!found || found->at == 0)
        return err_fail(ERR_FORMAT, "%s: tensor %s: the file has no storage %.*s", r->path, t->name,
                        (int)s->n_key, s->key);
    t->storage = found->at;
    *bytes = found->bytes;
    return OK;
}

/* ---- all ---- */

static err_t read_object(struct reading *r)
{
    struct pickle object;
    const struct checkpoint_pickle job = {r->c, find_storage, r};
    err_t e = next_pickle(r, &object);
    if (!e)
        e = list_storages(r, &object);
    if (!e)
        e = place_storages(r);
    if (!e)
        e = checkpoint_pickle_add(&job, &object);
    free(r->all);
    pickle_free(&object);
    return e;
}

err_t checkpoint_old_add(struct checkpoint *c)
{
    struct reading r = {.c = c, .path = c->parts[c->n_parts - 1].path};
    struct file_map map;
    err_t e = file_map(r.path, FILE_BYTES_MAX, &map);
    if (e)
        return e;
    r.in = bytes_of(map.p, map.n);
    r.file = map.n;
    e = check_magic(&r);
    if (!e)
        e = check_protocol(&r);
    if (!e)
        e = check_machine(&r);
    if (!e)
        e = read_object(&r);
    file_unmap(&map);
    return e;
}
