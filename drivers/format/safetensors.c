#include "drivers/format/safetensors.h"

#include "core/base/bytes.h"
#include "drivers/format/json.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- reading ---- */

/* Bytes of an element; 0 for an unknown type. */
static size_t type_bytes(const char *type)
{
    static const struct {
        const char *name;
        size_t bytes;
    } types[] = {{"BOOL", 1}, {"U8", 1},  {"I8", 1},  {"F8_E5M2", 1}, {"F8_E4M3", 1},
                 {"I16", 2},  {"U16", 2}, {"F16", 2}, {"BF16", 2},    {"I32", 4},
                 {"U32", 4},  {"F32", 4}, {"F64", 8}, {"I64", 8},     {"U64", 8}};
    for (size_t k = 0; k < sizeof types / sizeof types[0]; k++)
        if (strcmp(types[k].name, type) == 0)
            return types[k].bytes;
    return 0;
}

/* A list of at most `room` whole numbers that doubles hold exactly. */
static err_t get_list(const char *what, const struct cJSON *tensor, const char *key, int room,
                      size_t *out, int *n)
{
    const struct cJSON *list = json_member(tensor, key);
    if (!json_is_array(list) || json_count(list) > room)
        return err_fail(ERR_FORMAT, "%s: tensor %.96s: \"%s\" is not a list of up to %d numbers",
                        what, json_key(tensor), key, room);
    *n = 0;
    for (const struct cJSON *v = json_first(list); v; v = json_next(v)) {
        double number;
        if (!json_number(v, &number) || number < 0 || number != floor(number) || number > 0x1p52)
            return err_fail(
                ERR_FORMAT,
                "%s: tensor %.96s: \"%s\" holds something other than whole numbers up to 2^52",
                what, json_key(tensor), key);
        out[(*n)++] = (size_t)number;
    }
    return OK;
}

static err_t get_tensor(const struct safetensors *s, const struct cJSON *node,
                        struct safetensors_tensor *t)
{
    size_t offsets[2], bytes;
    int n;
    t->name = json_key(node);
    t->type = json_string(json_member(node, "dtype"));
    if (!t->type || json_count(node) != 3)
        return err_fail(ERR_FORMAT,
                        "%s: tensor %.96s has other members than dtype, shape and data_offsets",
                        s->what, t->name);
    bytes = type_bytes(t->type);
    if (bytes == 0)
        return err_fail(ERR_FORMAT, "%s: tensor %.96s is of unknown type %.16s", s->what, t->name,
                        t->type);
    err_t e = get_list(s->what, node, "shape", SAFETENSORS_RANK_MAX, t->shape, &t->rank);
    if (!e)
        e = get_list(s->what, node, "data_offsets", 2, offsets, &n);
    if (e)
        return e;
    for (int k = 0; k < t->rank; k++)
        if (!bytes_mul(bytes, t->shape[k], &bytes))
            return err_fail(ERR_FORMAT, "%s: tensor %.96s: its shape overflows", s->what, t->name);
    if (n != 2 || offsets[1] > s->size || offsets[0] > offsets[1] ||
        offsets[1] - offsets[0] != bytes)
        return err_fail(
            ERR_FORMAT, "%s: tensor %.96s: data from %zu to %zu of %zu bytes, its shape needs %zu",
            s->what, t->name, n > 0 ? offsets[0] : 0, n > 1 ? offsets[1] : 0, s->size, bytes);
    t->begin = offsets[0];
    t->end = offsets[1];
    return OK;
}

static int by_name(const void *a, const void *b)
{
    return strcmp(((const struct safetensors_tensor *)a)->name,
                  ((const struct safetensors_tensor *)b)->name);
}

static int by_offset(const void *a, const void *b)
{
    const struct safetensors_tensor *x = a, *y = b;
    if (x->begin != y->begin)
        return x->begin < y->begin ? -1 : 1;
    return (x->end > y->end) - (x->end < y->end);
}

/* Each tensor must begin where another ends. Leaves them sorted by offset. */
static err_t check_tiling(const struct safetensors *s)
{
    size_t at = 0;
    if (s->n > 0)
        qsort(s->tensors, (size_t)s->n, sizeof *s->tensors, by_offset);
    for (int i = 0; i < s->n; i++) {
        if (s->tensors[i].begin != at)
            return err_fail(ERR_FORMAT,
                            "%s: tensor %.96s begins at byte %zu of the data, not %zu: overlap or "
                            "hole",
                            s->what, s->tensors[i].name, s->tensors[i].begin, at);
        at = s->tensors[i].end;
    }
    if (at != s->size)
        return err_fail(ERR_FORMAT, "%s: the tensors end at byte %zu of %zu bytes of data", s->what,
                        at, s->size);
    return OK;
}

static err_t check_names(const struct safetensors *s)
{
    if (s->n > 0)
        qsort(s->tensors, (size_t)s->n, sizeof *s->tensors, by_name);
    for (int i = 1; i < s->n; i++)
        if (strcmp(s->tensors[i - 1].name, s->tensors[i].name) == 0)
            return err_fail(ERR_FORMAT, "%s: tensor %.96s is there twice", s->what,
                            s->tensors[i].name);
    return OK;
}

static bool is_metadata(const struct cJSON *node)
{
    return strcmp(json_key(node), "__metadata__") == 0;
}

static err_t get_tensors(struct safetensors *s)
{
    int words = 0;
    if (!json_is_object(s->doc))
        return err_fail(ERR_FORMAT, "%s: the header is no object", s->what);
    s->tensors = calloc((size_t)json_count(s->doc) + 1, sizeof *s->tensors);
    if (!s->tensors)
        return err_fail(ERR_NOMEM, "%s: no memory for %d tensors", s->what, json_count(s->doc));
    for (const struct cJSON *m = json_first(s->doc); m; m = json_next(m)) {
        if (is_metadata(m)) {
            if (words++ > 0)
                return err_fail(ERR_FORMAT, "%s: __metadata__ is there twice", s->what);
            continue;
        }
        err_t e = get_tensor(s, m, &s->tensors[s->n]);
        if (e)
            return e;
        s->n++;
    }
    err_t e = check_names(s);
    if (!e)
        e = check_tiling(s);
    if (!e)
        e = check_names(s); // sorts
    return e;
}

err_t safetensors_header(const char *what, const uint8_t first[8], uint64_t file, size_t *out)
{
    struct bytes b = bytes_of(first, 8);
    uint64_t n = bytes_u64(&b);
    if (file < 8 || n > JSON_BYTES_MAX || n > file - 8)
        return err_fail(ERR_FORMAT, "%s: header of %ju bytes in a file of %ju, at most %d are read",
                        what, (uintmax_t)n, (uintmax_t)file, JSON_BYTES_MAX);
    *out = (size_t)n + 8;
    return OK;
}

err_t safetensors_open(const char *what, const void *p, size_t n, uint64_t file,
                       struct safetensors *out)
{
    memset(out, 0, sizeof *out);
    size_t header = 0;
    if (n < 8)
        return err_fail(ERR_FORMAT, "%s: %zu bytes are no safetensors file", what, n);
    err_t e = safetensors_header(what, p, file, &header);
    if (!e && header > n)
        e = err_fail(ERR_FORMAT, "%s: cut short within its header", what);
    if (!e)
        e = json_parse(what, (const uint8_t *)p + 8, header - 8, &out->doc);
    if (e)
        return e;
    out->what = what;
    out->data = header;
    out->size = (size_t)(file - header);
    e = get_tensors(out);
    if (e)
        safetensors_close(out);
    return e;
}

void safetensors_close(struct safetensors *s)
{
    json_free(s->doc);
    free(s->tensors);
    memset(s, 0, sizeof *s);
}

const struct safetensors_tensor *safetensors_find(const struct safetensors *s, const char *name)
{
    struct safetensors_tensor key = {.name = name};
    return s->n == 0 ? NULL : bsearch(&key, s->tensors, (size_t)s->n, sizeof *s->tensors, by_name);
}

const char *safetensors_word(const struct safetensors *s, const char *key)
{
    const char *word = json_string(json_member(json_member(s->doc, "__metadata__"), key));
    return word ? word : "";
}

/* ---- writing ---- */

void safetensors_begin(struct safetensors_writer *w)
{
    memset(w, 0, sizeof *w);
    w->f = open_memstream(&w->text, &w->bytes);
    w->bad = !w->f;
    if (w->f)
        putc('{', w->f);
}

void safetensors_put_word(struct safetensors_writer *w, const char *key, const char *text)
{
    if (!w->f)
        return;
    fputs(w->words++ ? "," : "\"__metadata__\":{", w->f);
    json_put_string(w->f, key);
    putc(':', w->f);
    json_put_string(w->f, text);
}

void safetensors_put(struct safetensors_writer *w, const struct safetensors_tensor *t)
{
    uint64_t bytes = type_bytes(t->type);
    if (!w->f)
        return;
    if (w->tensors == 0 && w->words > 0)
        fputs("},", w->f);
    else if (w->tensors > 0)
        putc(',', w->f);
    w->tensors++;
    json_put_string(w->f, t->name);
    fprintf(w->f, ":{\"dtype\":\"%s\",\"shape\":[", t->type);
    for (int k = 0; k < t->rank; k++) {
        fprintf(w->f, k ? ",%zu" : "%zu", t->shape[k]);
        bytes *= t->shape[k];
    }
    fprintf(w->f, "],\"data_offsets\":[%ju,%ju]}", (uintmax_t)w->at, (uintmax_t)(w->at + bytes));
    w->at += bytes;
}

err_t safetensors_end(struct safetensors_writer *w, FILE *f)
{
    if (w->f) {
        fputs(w->tensors == 0 && w->words > 0 ? "}}" : "}", w->f);
        for (long at = ftell(w->f); (at + 8) % SAFETENSORS_ALIGN != 0; at++)
            putc(' ', w->f);
        w->bad |= ferror(w->f) != 0;
        w->bad |= fclose(w->f) != 0 || !w->text; // glibc: a failed last growth leaves NULL only
    }
    if (!w->bad && f) {
        uint8_t length[8];
        bytes_put_u64(length, w->bytes);
        fwrite(length, 1, sizeof length, f);
        fwrite(w->text, 1, w->bytes, f);
    }
    bool bad = w->bad;
    free(w->text);
    memset(w, 0, sizeof *w);
    return bad ? err_fail(ERR_NOMEM, "no memory for the header of a safetensors file") : OK;
}
