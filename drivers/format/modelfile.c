#include "drivers/format/modelfile.h"

#include "core/base/bytes.h"
#include "core/base/splitmix.h"
#include "core/kernels/gemm.h"
#include "drivers/format/json.h"
#include "drivers/format/netdims.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "floats are used as they are");

enum { NAME_CAP_SCALE = NET_NAME_CAP + 8 };

static const size_t FILE_BYTES_MAX = (size_t)64 << 30;
const char modelfile_format[] = "hdrig-model", modelfile_version[] = "1";

static const char *const precision_words[] = {
    [PRECISION_F32] = "fp32", [PRECISION_BF16] = "bf16", [PRECISION_S8] = "int8"};

const char *modelfile_precision(enum precision p)
{
    return precision_words[p];
}

bool modelfile_parse_precision(const char *word, enum precision *out)
{
    for (int p = PRECISION_F32; p <= PRECISION_S8; p++)
        if (strcmp(word, precision_words[p]) == 0) {
            *out = (enum precision)p;
            return true;
        }
    return false;
}

/* ---- checksum ---- */

static uint64_t mix_word(uint64_t word, uint64_t i)
{
    return splitmix_mix(word + (i + 1) * SPLITMIX_STEP);
}

static uint64_t word_at(const uint8_t *p)
{
    uint64_t w;
    memcpy(&w, p, sizeof w);
    return w;
}

void modelfile_add(struct modelfile_sum *s, const void *bytes, size_t n)
{
    const uint8_t *p = bytes;
    while (n > 0 && (s->n_rest > 0 || n < 8)) {
        s->rest[s->n_rest++] = *p++;
        n--;
        if (s->n_rest == 8) {
            s->sum += mix_word(word_at(s->rest), s->words++);
            s->n_rest = 0;
        }
    }
    for (; n >= 8; p += 8, n -= 8)
        s->sum += mix_word(word_at(p), s->words++);
    for (; n > 0; n--)
        s->rest[s->n_rest++] = *p++;
}

uint64_t modelfile_total(const struct modelfile_sum *s)
{
    uint8_t last[8] = {0};
    memcpy(last, s->rest, s->n_rest);
    return s->n_rest > 0 ? s->sum + mix_word(word_at(last), s->words) : s->sum;
}

err_t modelfile_verify(const struct modelfile *m)
{
    struct modelfile_sum s = {0};
    char hex[17];
    modelfile_add(&s, (const uint8_t *)m->model.map + m->head.data, m->head.size);
    snprintf(hex, sizeof hex, "%016jx", (uintmax_t)modelfile_total(&s));
    if (strcmp(hex, m->checksum) != 0)
        return err_fail(ERR_FORMAT, "%s: damaged: its data have the checksum %s, it says %.32s",
                        m->head.what, hex, m->checksum);
    return OK;
}

/* ---- reading ---- */

struct safetensors_tensor modelfile_stored(const struct tensor_spec *t, enum precision file)
{
    struct product_shape p = table_product(t);
    size_t k = (size_t)p.segs * (size_t)p.seg, panels = ((size_t)p.n + PANEL - 1) / PANEL;
    if (t->role == ROLE_PLAIN && t->repeat > 1)
        return (struct safetensors_tensor){
            .type = "F32", .rank = 1, .shape = {table_count(t) * (size_t)t->repeat}};
    if (t->role == ROLE_PLAIN) {
        struct safetensors_tensor plain = {.type = "F32", .rank = t->rank};
        for (int d = 0; d < t->rank; d++)
            plain.shape[d] = (size_t)t->shape[d];
        return plain;
    }
    switch (model_type(t, file)) {
    case PRECISION_BF16:
        return (struct safetensors_tensor){.type = "BF16", .rank = 3, .shape = {panels, k, PANEL}};
    case PRECISION_S8:
        return (struct safetensors_tensor){
            .type = "I8", .rank = 4, .shape = {panels, k / 4, PANEL, 4}};
    default:
        return (struct safetensors_tensor){.type = "F32", .rank = 3, .shape = {panels, k, PANEL}};
    }
}

struct reading {
    struct modelfile *m;
    size_t found; // tensors of the file that have been bound
};

/* Data of tensor `name` with the type and shape of `want`. */
static err_t bind_data(struct reading *r, const char *name, const struct safetensors_tensor *want,
                       size_t align, const void **out)
{
    const struct safetensors *head = &r->m->head;
    const struct safetensors_tensor *t = safetensors_find(head, name);
    if (!t)
        return err_fail(ERR_FORMAT, "%s: tensor %s is missing", head->what, name);
    if (strcmp(t->type, want->type) != 0)
        return err_fail(ERR_FORMAT, "%s: tensor %s is %s, it must be %s", head->what, name, t->type,
                        want->type);
    if (t->rank != want->rank)
        return err_fail(ERR_FORMAT, "%s: tensor %s has %d extents, it must have %d", head->what,
                        name, t->rank, want->rank);
    for (int d = 0; d < t->rank; d++)
        if (t->shape[d] != want->shape[d])
            return err_fail(ERR_FORMAT, "%s: tensor %s: extent %d is %zu, it must be %zu",
                            head->what, name, d, t->shape[d], want->shape[d]);
    *out = (const uint8_t *)r->m->model.map + head->data + t->begin;
    if ((uintptr_t)*out % align != 0)
        return err_fail(ERR_FORMAT, "%s: tensor %s begins at byte %zu, no multiple of %zu",
                        head->what, name, head->data + t->begin, align);
    r->found++;
    return OK;
}

static err_t check_finite(const char *what, const char *name, const float *v, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!isfinite(v[i]))
            return err_fail(ERR_FORMAT, "%s: tensor %s: element %zu is not finite", what, name, i);
    return OK;
}

static err_t bind_scale(struct reading *r, struct model_tensor *t)
{
    char name[NAME_CAP_SCALE];
    int n = table_product(&t->spec).n;
    const struct safetensors_tensor want = {.type = "F32", .rank = 1, .shape = {(size_t)n}};
    snprintf(name, sizeof name, "%s_scale", t->spec.name);
    const void *data;
    err_t e = bind_data(r, name, &want, sizeof(float), &data);
    if (!e)
        e = check_finite(r->m->head.what, name, data, (size_t)n);
    t->scale = data;
    for (int i = 0; i < n && !e; i++)
        if (t->scale[i] < 0)
            e = err_fail(ERR_FORMAT, "%s: tensor %s: element %d is %g, must be >= 0",
                         r->m->head.what, name, i, (double)t->scale[i]);
    return e;
}

static err_t bind_tensor(void *ctx, const struct tensor_spec *spec)
{
    struct reading *r = ctx;
    struct model *m = &r->m->model;
    if (!spec->used)
        return OK;
    struct model_tensor *t = &r->m->tensors[m->n];
    *t = (struct model_tensor){.spec = *spec, .type = model_type(spec, m->precision)};
    const struct safetensors_tensor want = modelfile_stored(spec, m->precision);
    bool plain = spec->role == ROLE_PLAIN;
    err_t e = bind_data(r, spec->name, &want, plain ? sizeof(float) : SAFETENSORS_ALIGN, &t->data);
    if (!e && t->type == PRECISION_S8)
        e = bind_scale(r, t);
    if (!e && (plain || spec->exact)) {
        size_t n = 1;
        for (int d = 0; d < want.rank; d++)
            n *= want.shape[d];
        e = check_finite(r->m->head.what, spec->name, t->data, n);
    }
    m->n++;
    return e;
}

static err_t count_used(void *ctx, const struct tensor_spec *spec)
{
    *(size_t *)ctx += spec->used;
    return OK;
}

/* Called when the file has more tensors than were bound. */
static err_t name_unknown(const struct modelfile *m)
{
    char name[NAME_CAP_SCALE];
    for (int i = 0; i < m->head.n; i++) {
        bool known = false;
        for (int k = 0; k < m->model.n && !known; k++) {
            const struct model_tensor *t = &m->model.tensors[k];
            snprintf(name, sizeof name, "%s_scale", t->spec.name);
            known = strcmp(m->head.tensors[i].name, t->spec.name) == 0 ||
                    (t->scale && strcmp(m->head.tensors[i].name, name) == 0);
        }
        if (!known)
            return err_fail(ERR_FORMAT, "%s: unknown tensor %.96s", m->head.what,
                            m->head.tensors[i].name);
    }
    return OK;
}

static err_t bind_tensors(struct modelfile *m)
{
    struct reading r = {.m = m};
    size_t n = 0;
    err_t e = table_walk(&m->model.dims, count_used, &n);
    if (e)
        return e;
    m->tensors = calloc(n, sizeof *m->tensors);
    m->model.tensors = m->tensors;
    if (!m->tensors)
        return err_fail(ERR_NOMEM, "%s: no memory for %zu tensors", m->head.what, n);
    e = table_walk(&m->model.dims, bind_tensor, &r);
    if (!e && r.found < (size_t)m->head.n)
        e = name_unknown(m);
    return e;
}

static err_t get_words(struct modelfile *m)
{
    const char *what = m->head.what, *format = safetensors_word(&m->head, "format"),
               *version = safetensors_word(&m->head, "version"),
               *precision = safetensors_word(&m->head, "precision");
    if (strcmp(format, modelfile_format) != 0)
        return err_fail(ERR_FORMAT, "%s: not weights of this program: its format is \"%.32s\"%s",
                        what, format, *format ? "" : "; see hdrig convert --help");
    if (strcmp(version, modelfile_version) != 0)
        return err_fail(ERR_UNSUPPORTED, "%s: weights of version \"%.32s\", this program reads %s",
                        what, version, modelfile_version);
    if (!modelfile_parse_precision(precision, &m->model.precision))
        return err_fail(ERR_FORMAT, "%s: precision \"%.32s\" is none of fp32, bf16, int8", what,
                        precision);
    m->model.source = safetensors_word(&m->head, "source");
    m->model.licence = safetensors_word(&m->head, "licence");
    m->checksum = safetensors_word(&m->head, "checksum");
    return OK;
}

/* JSON inside a word. own: json_free. */
static err_t get_json(const struct modelfile *m, const char *key, struct cJSON **out)
{
    const char *text = safetensors_word(&m->head, key);
    *out = NULL;
    err_t e = json_parse(m->head.what, text, strlen(text), out);
    return e ? err_fail(e, "%s: %s is not JSON", m->head.what, key) : OK;
}

static err_t get_dims(struct modelfile *m)
{
    struct cJSON *doc;
    err_t e = get_json(m, "config", &doc);
    if (!e)
        e = netdims_read(m->head.what, doc, true, &m->model.dims);
    json_free(doc);
    return e;
}

err_t modelfile_open_bytes(const char *what, const void *p, size_t n, struct modelfile *out)
{
    memset(out, 0, sizeof *out);
    err_t e = safetensors_open(what, p, n, n, &out->head);
    if (e)
        return e;
    out->model.map = p;
    out->model.bytes = n;
    e = get_words(out);
    if (!e)
        e = get_dims(out);
    if (!e)
        e = bind_tensors(out);
    if (e)
        modelfile_close(out);
    return e;
}

err_t modelfile_open(const char *path, struct modelfile *out)
{
    struct file_map map;
    memset(out, 0, sizeof *out);
    err_t e = file_map(path, FILE_BYTES_MAX, &map);
    if (e)
        return e;
    e = modelfile_open_bytes(path, map.p, map.n, out);
    if (e)
        file_unmap(&map);
    else
        out->map = map;
    return e;
}

void modelfile_close(struct modelfile *m)
{
    safetensors_close(&m->head);
    free(m->tensors);
    file_unmap(&m->map);
    memset(m, 0, sizeof *m);
}
