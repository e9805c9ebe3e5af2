#include "firmware/recon/convert.h"

#include "firmware/recon/smooth.h"

#include "core/base/log.h"
#include "core/base/sha256.h"
#include "core/net/hashed.h"
#include "drivers/format/checkpoint.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/modelwrite.h"
#include "drivers/format/netdims.h"
#include "drivers/format/netdims_infer.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

/* ---- dimensions ---- */

/* {"model": {...}, "voxel_size": v, "image_size": s}: what is missing is as in the release. */
static err_t read_index(const char *path, struct net_dims *d)
{
    struct cJSON *doc;
    double voxel, size;
    err_t e = json_read(path, &doc);
    if (e)
        return e;
    const struct cJSON *model = json_member(doc, "model");
    if (!json_is_object(model))
        e = err_fail(ERR_FORMAT, "%s: has no object \"model\"", path);
    if (!e && json_number(json_member(doc, "voxel_size"), &voxel) && voxel > 0 && voxel < 1e6)
        d->voxel = (float)voxel;
    if (!e && json_number(json_member(doc, "image_size"), &size) && size > 0 && size < 1e6)
        d->size = (int)size;
    if (!e)
        e = netdims_read(path, model, false, d);
    json_free(doc);
    return e;
}

static err_t read_config(const char *config, struct net_dims *d)
{
    *d = table_full;
    if (strcmp(config, "full") == 0)
        return OK;
    if (strcmp(config, "mini") != 0)
        return read_index(config, d);
    *d = table_mini;
    return OK;
}

static err_t write_file(struct engine *en, const struct convert_request *q,
                        const struct modelwrite *weights)
{
    struct modelwrite w = *weights;
    if (w.dims.lpips != LPIPS_NONE && q->precision != PRECISION_F32)
        return err_fail(ERR_ARG, "weights of LPIPS are fp32 only");
    struct smooth smooth = {.dims = &w.dims, .fetch = w.fetch, .ctx = w.ctx};
    w.precision = q->precision;
    if (q->precision == PRECISION_S8) {
        w.fetch = smooth_fetch;
        w.ctx = &smooth;
    }
    err_t e = engine_reserve(en, 0, 0, modelwrite_need(&w, pool_size(en->pool)), q->max_mb);
    if (!e)
        e = modelwrite_run(&en->run, &w, q->out);
    smooth_free(&smooth);
    return e;
}

/* ---- weights made of numbers ---- */

enum { CHUNK = 1 << 16 };

struct numbers {
    uint64_t seed;
    const struct tensor_spec *t;
    float *out;
};

static err_t fill_chunk(void *ctx, int chunk, int worker)
{
    const struct numbers *x = ctx;
    size_t first = (size_t)chunk * CHUNK, n = table_count(x->t) - first;
    (void)worker;
    hashed_fill(x->t, x->seed, first, n < CHUNK ? n : CHUNK, x->out + first);
    return OK;
}

static err_t fetch_numbers(void *ctx, const struct run *r, const struct tensor_spec *t, float *out)
{
    struct numbers x = {*(const uint64_t *)ctx, t, out};
    return pool_for(r->pool, (int)((table_count(t) + CHUNK - 1) / CHUNK), fill_chunk, &x);
}

err_t convert_hashed(struct engine *en, const struct convert_request *q, uint64_t seed)
{
    char source[32];
    snprintf(source, sizeof source, "hashed %" PRIu64, seed);
    struct modelwrite w = {
        .source = source, .licence = "none, numbers", .fetch = fetch_numbers, .ctx = &seed};
    err_t e = read_config(q->config, &w.dims);
    w.dims.rope_bf16 = false; // the golden data are pure float32
    return e ? e : write_file(en, q, &w);
}

/* ---- weights of others ---- */

enum { LIST_CAP = 400, LISTED_MAX = 5, HASH_BYTES = 1 << 20 };

/* Names for a sentence, the first few. */
struct list {
    int n;
    size_t used;
    char text[LIST_CAP];
};

static void list_add(struct list *l, const char *name, const char *note)
{
    if (l->n++ < LISTED_MAX && l->used < sizeof l->text)
        l->used += (size_t)snprintf(l->text + l->used, sizeof l->text - l->used, "%s%s%s",
                                    l->n > 1 ? ", " : "", name, note);
}

static const char *list_more(const struct list *l)
{
    return l->n > LISTED_MAX ? ", ..." : "";
}

/* A checkpoint against the table of the network, or what in both begins with a prefix. */
struct match {
    const struct checkpoint *c;
    const char *prefix;
    bool *known; // (c->n) whether the table has it, read or not
    struct list missing, wrong, unread;
};

static bool same_shape(const struct checkpoint_tensor *a, const struct tensor_spec *b)
{
    if (a->rank != b->rank)
        return false;
    for (int k = 0; k < a->rank; k++)
        if (a->shape[k] != (size_t)b->shape[k])
            return false;
    return true;
}

static err_t match_tensor(void *ctx, const struct tensor_spec *t)
{
    struct match *m = ctx;
    if (strncmp(t->name, m->prefix, strlen(m->prefix)) != 0)
        return OK;
    const struct checkpoint_tensor *have = checkpoint_find(m->c, t->name);
    if (have)
        m->known[have - m->c->tensors] = true;
    if (!t->used)
        return OK;
    if (!have) {
        list_add(&m->missing, t->name, "");
    } else if (have->type == CHECKPOINT_OTHER) {
        char note[CHECKPOINT_KIND_CAP + 8];
        snprintf(note, sizeof note, " is %s", have->kind);
        list_add(&m->unread, t->name, note);
    } else if (!same_shape(have, t)) {
        char note[96] = " [";
        size_t n = 2;
        for (int k = 0; k < have->rank && n < 40; k++)
            n += (size_t)snprintf(note + n, sizeof note - n, k ? ",%zu" : "%zu", have->shape[k]);
        n += (size_t)snprintf(note + n, sizeof note - n, "], not [");
        for (int k = 0; k < t->rank; k++)
            n += (size_t)snprintf(note + n, sizeof note - n, k ? ",%d" : "%d", t->shape[k]);
        snprintf(note + n, sizeof note - n, "]");
        list_add(&m->wrong, t->name, note);
    }
    return OK;
}

static void warn_of_extras(const struct match *m)
{
    struct list extra = {0};
    for (int i = 0; i < m->c->n; i++)
        if (!m->known[i] && strncmp(m->c->tensors[i].name, m->prefix, strlen(m->prefix)) == 0)
            list_add(&extra, m->c->tensors[i].name, "");
    if (extra.n > 0)
        log_warn("%s: tensors are not of this network and left out (%d): %s%s", m->c->what, extra.n,
                 extra.text, list_more(&extra));
}

static err_t match_all(const struct checkpoint *c, const struct net_dims *d, const char *prefix)
{
    struct match m = {.c = c, .prefix = prefix, .known = calloc((size_t)c->n + 1, sizeof *m.known)};
    if (!m.known)
        return err_fail(ERR_NOMEM, "no memory for %d names", c->n);
    err_t e = table_walk(d, match_tensor, &m);
    if (!e && m.missing.n > 0)
        e = err_fail(ERR_FORMAT, "%s: tensors are missing (%d): %s%s", c->what, m.missing.n,
                     m.missing.text, list_more(&m.missing));
    if (!e && m.unread.n > 0)
        e = err_fail(ERR_FORMAT,
                     "%s: tensors are not float32, bfloat16 or float16 (%d): %s%s; save them so",
                     c->what, m.unread.n, m.unread.text, list_more(&m.unread));
    if (!e && m.wrong.n > 0)
        e = err_fail(ERR_FORMAT, "%s: tensors have another shape (%d): %s%s", c->what, m.wrong.n,
                     m.wrong.text, list_more(&m.wrong));
    if (!e)
        warn_of_extras(&m);
    free(m.known);
    return e;
}

/* Adds the bytes of a file. */
static err_t hash_file(const struct run *r, const char *path, uint8_t *block, struct sha256 *s)
{
    struct stat st;
    FILE *f = fopen(path, "rbe");
    err_t e = OK;
    if (!f || fstat(fileno(f), &st) != 0)
        e = err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    for (int i = 0, total = e ? 0 : (int)(st.st_size / HASH_BYTES) + 1; !e; i++) {
        size_t n = fread(block, 1, HASH_BYTES, f);
        sha256_add(s, block, n);
        r->progress(r->progress_ctx, "hash", i < total ? i + 1 : total, total, "");
        if (atomic_load(r->cancel))
            e = err_fail(ERR_CANCELLED, "cancelled");
        else if (n < HASH_BYTES)
            break;
    }
    if (!e && ferror(f))
        e = err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    if (f)
        fclose(f);
    return e;
}

/* Hash of the bytes of all files of a checkpoint, in the order of their names. */
static err_t hash_all(const struct run *r, const struct checkpoint *c, char hex[SHA256_HEX_CAP])
{
    struct sha256 s;
    uint8_t *block = malloc(HASH_BYTES);
    err_t e = block ? OK : err_fail(ERR_NOMEM, "no memory to read %s", c->what);
    sha256_init(&s);
    for (int i = 0; i < c->n_parts && !e; i++)
        e = hash_file(r, c->parts[i].path, block, &s);
    free(block);
    sha256_hex(&s, hex);
    return e;
}

/* The values of a tensor, which must be within -CONVERT_WEIGHT_MAX and CONVERT_WEIGHT_MAX. */
static err_t read_tensor(const struct checkpoint *c, const struct tensor_spec *t, float *out)
{
    const size_t n = table_count(t);
    err_t e = checkpoint_read(c, checkpoint_find(c, t->name), out);
    for (size_t i = 0; i < n && !e; i++)
        if (!(fabsf(out[i]) <= CONVERT_WEIGHT_MAX))
            e = err_fail(ERR_FORMAT,
                         "tensor %s: element %zu is %g, weights are within -%g and %g: the "
                         "checkpoint is damaged or no trained network",
                         t->name, i, (double)out[i], (double)CONVERT_WEIGHT_MAX,
                         (double)CONVERT_WEIGHT_MAX);
    return e;
}

static err_t fetch_tensor(void *ctx, const struct run *r, const struct tensor_spec *t, float *out)
{
    (void)r;
    return read_tensor(ctx, t, out);
}

static err_t convert_open(struct engine *en, const struct convert_request *q, struct checkpoint *c)
{
    char hex[SHA256_HEX_CAP], source[FILE_PATH_CAP + SHA256_HEX_CAP + 16];
    struct modelwrite w = {
        .source = source, .licence = "that of the source", .fetch = fetch_tensor, .ctx = c};
    err_t e = q->config ? read_config(q->config, &w.dims) : netdims_infer_run(c, &w.dims);
    w.precision = q->precision;
    if (!e)
        e = match_all(c, &w.dims, "");
    if (!e)
        e = modelwrite_check(&w, q->out);
    if (!e)
        e = hash_all(&en->run, c, hex);
    if (e)
        return e;
    snprintf(source, sizeof source, "%.200s sha256:%s", file_name(c->what), hex);
    return write_file(en, q, &w);
}

static err_t check_other(const char *path, const char *out)
{
    return file_is_same(path, out)
               ? err_fail(ERR_ARG, "%s would be replaced by what is made of it: give another --out",
                          path)
               : OK;
}

err_t convert_file(struct engine *en, const struct convert_request *q, const char *path)
{
    struct checkpoint c = {0};
    err_t e = check_other(path, q->out);
    if (!e)
        e = checkpoint_open(path, "encoder.", &c);
    if (!e)
        e = convert_open(en, q, &c);
    checkpoint_close(&c);
    return e;
}

/* ---- LPIPS ---- */

struct both {
    struct checkpoint backbone, linear;
};

static err_t fetch_lpips(void *ctx, const struct run *r, const struct tensor_spec *t, float *out)
{
    const struct both *b = ctx;
    const bool linear = strncmp(t->name, TABLE_LINEAR, strlen(TABLE_LINEAR)) == 0;
    const size_t n = table_count(t);
    (void)r;
    err_t e = read_tensor(linear ? &b->linear : &b->backbone, t, out);
    for (size_t i = 0; i < n && linear && !e; i++)
        if (out[i] < 0)
            e = err_fail(ERR_FORMAT,
                         "tensor %s: element %zu is %g, linear weights of LPIPS are >= 0", t->name,
                         i, (double)out[i]);
    return e;
}

/* Which of the two networks it is: their first kernels differ. */
static err_t tell_backbone(const struct checkpoint *c, enum lpips_net *out)
{
    static const char first[] = "features.0.weight";
    const struct checkpoint_tensor *t = checkpoint_find(c, first);
    const size_t edge = t && t->rank == 4 ? t->shape[2] : 0;
    *out = edge == 3 ? LPIPS_VGG16 : edge == 11 ? LPIPS_ALEXNET : LPIPS_NONE;
    if (*out == LPIPS_NONE)
        return err_fail(ERR_FORMAT,
                        "%s: has no tensor %s of kernels of 3 or 11 px: --lpips needs "
                        "torchvision's vgg16 or alexnet here",
                        c->what, first);
    return OK;
}

static err_t match_both(const struct both *b, const struct net_dims *d)
{
    err_t e = match_all(&b->backbone, d, "features.");
    if (!e)
        e = match_all(&b->linear, d, TABLE_LINEAR);
    return e ? err_fail(e, "%s (for LPIPS of %s)", err_text(), lpips_layers_of(d->lpips)->name)
             : OK;
}

static err_t convert_both(struct engine *en, const struct convert_request *q, struct both *b)
{
    char of_backbone[SHA256_HEX_CAP], of_linear[SHA256_HEX_CAP];
    char source[2 * (200 + SHA256_HEX_CAP + 16)];
    struct modelwrite w = {
        .source = source, .licence = "those of the sources", .fetch = fetch_lpips, .ctx = b};
    err_t e = tell_backbone(&b->backbone, &w.dims.lpips);
    if (!e)
        e = match_both(b, &w.dims);
    if (!e)
        e = modelwrite_check(&w, q->out);
    if (!e)
        e = hash_all(&en->run, &b->backbone, of_backbone);
    if (!e)
        e = hash_all(&en->run, &b->linear, of_linear);
    if (e)
        return e;
    snprintf(source, sizeof source, "%.200s sha256:%s, %.200s sha256:%s",
             file_name(b->backbone.what), of_backbone, file_name(b->linear.what), of_linear);
    return write_file(en, q, &w);
}

err_t convert_lpips(struct engine *en, const struct convert_request *q, const char *backbone,
                    const char *linear)
{
    struct both b = {.backbone = {0}};
    err_t e = check_other(backbone, q->out);
    if (!e)
        e = check_other(linear, q->out);
    if (!e)
        e = checkpoint_open(backbone, "", &b.backbone);
    if (!e)
        e = checkpoint_open(linear, "", &b.linear);
    if (!e)
        e = convert_both(en, q, &b);
    checkpoint_close(&b.backbone);
    checkpoint_close(&b.linear);
    return e;
}
