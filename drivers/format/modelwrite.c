/* The table is walked three times: for the header, for the products, whose scales are kept, and for
 * the plain tensors. The checksum is known at the end, so the header is then written again. */
#include "drivers/format/modelwrite.h"

#include "core/base/num.h"
#include "core/kernels/gemm.h"
#include "core/net/pack.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/modelfile.h"
#include "drivers/format/netdims.h"
#include "drivers/format/origin.h"
#include "drivers/format/partial.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/statvfs.h>
#include <unistd.h>

struct writing {
    const struct run *r;
    const struct modelwrite *w;
    FILE *f;
    struct modelfile_sum sum;
    float *in;    // values of a tensor
    uint8_t *out; // a packed product
    float *row;   // (workers, k) for the largest k
    float *scale; // (n_scale) of all I8 products so far
    size_t n_scale;
    int done, total; // tensors
};

/* Memory for the largest tensor, and bytes of all in the file. */
struct sizes {
    enum precision precision;
    size_t values, packed, k, scales;
    uint64_t file; // bytes, without header and scales
    int tensors;
};

static err_t add_size(void *ctx, const struct tensor_spec *t)
{
    struct sizes *s = ctx;
    if (!t->used)
        return OK;
    s->tensors++;
    s->values = num_max_size(s->values, table_count(t));
    if (t->role == ROLE_PLAIN) {
        s->file += table_count(t) * (size_t)t->repeat * sizeof(float);
        return OK;
    }
    enum precision type = model_type(t, s->precision);
    struct product_shape p = table_product(t);
    const size_t packed = (size_t)pack_panels(t) * pack_panel_bytes(t, type);
    s->file += packed;
    s->packed = num_max_size(s->packed, packed);
    s->k = num_max_size(s->k, (size_t)p.segs * (size_t)p.seg);
    s->scales += type == PRECISION_S8 ? (size_t)p.n : 0;
    return OK;
}

static struct sizes sizes_of(const struct modelwrite *w)
{
    struct sizes s = {.precision = w->precision};
    err_t e = table_walk(&w->dims, add_size, &s);
    (void)e; // add_size does not fail
    return s;
}

static err_t layout(struct writing *x, struct arena *a, const struct sizes *s, int workers)
{
    err_t e = arena_alloc(a, s->values, sizeof *x->in, &x->in);
    if (!e)
        e = arena_alloc(a, s->packed, 1, &x->out);
    if (!e)
        e = arena_alloc(a, s->k * (size_t)workers, sizeof *x->row, &x->row);
    return e ? e : arena_alloc(a, s->scales, sizeof *x->scale, &x->scale);
}

size_t modelwrite_need(const struct modelwrite *w, int threads)
{
    const struct sizes s = sizes_of(w);
    struct arena a = arena_counter();
    struct writing x;
    return layout(&x, &a, &s, threads) ? SIZE_MAX : a.peak;
}

err_t modelwrite_check(const struct modelwrite *w, const char *path)
{
    char folder[FILE_PATH_CAP];
    struct statvfs v;
    const struct sizes s = sizes_of(w);
    const uint64_t need = s.file + s.scales * sizeof(float);
    if (file_is_special(path))
        return OK;
    err_t e = file_parent(path, folder);
    if (e)
        return e;
    if (access(folder, W_OK | X_OK) != 0 || statvfs(folder, &v) != 0)
        return err_fail(ERR_IO, "%s: nothing can be written to folder %s: %s", path, folder,
                        strerror(errno));
    if ((uint64_t)v.f_bavail * v.f_frsize < need)
        return err_fail(ERR_LIMIT,
                        "%s: the weights take %" PRIu64 " bytes, there is room for %" PRIu64, path,
                        need, (uint64_t)v.f_bavail * v.f_frsize);
    return OK;
}

/* ---- header ---- */

static err_t put_tensor(struct safetensors_writer *h, const struct tensor_spec *t,
                        enum precision file)
{
    struct safetensors_tensor stored = modelfile_stored(t, file);
    stored.name = t->name;
    safetensors_put(h, &stored);
    return OK;
}

struct header {
    struct safetensors_writer *h;
    enum precision file;
};

static err_t put_product(void *ctx, const struct tensor_spec *t)
{
    const struct header *x = ctx;
    return t->used && t->role != ROLE_PLAIN ? put_tensor(x->h, t, x->file) : OK;
}

static err_t put_scale(void *ctx, const struct tensor_spec *t)
{
    const struct header *x = ctx;
    char name[NET_NAME_CAP + 8];
    if (!t->used || model_type(t, x->file) != PRECISION_S8)
        return OK;
    snprintf(name, sizeof name, "%s_scale", t->name);
    const struct safetensors_tensor scale = {
        .name = name, .type = "F32", .rank = 1, .shape = {(size_t)table_product(t).n}};
    safetensors_put(x->h, &scale);
    return OK;
}

static err_t put_plain(void *ctx, const struct tensor_spec *t)
{
    const struct header *x = ctx;
    return t->used && t->role == ROLE_PLAIN ? put_tensor(x->h, t, x->file) : OK;
}

static void put_config(struct safetensors_writer *h, const struct net_dims *d)
{
    char *text = NULL;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    if (f) {
        netdims_put(f, d);
        h->bad |= ferror(f) != 0;
        h->bad |= fclose(f) != 0;
    }
    if (text)
        safetensors_put_word(h, "config", text);
    else
        h->bad = true;
    free(text);
}

/* The header at the start of the file; its length does not depend on the checksum. */
static err_t write_header(const struct writing *x, uint64_t checksum)
{
    struct safetensors_writer h;
    struct header ctx = {&h, x->w->precision};
    tensor_fn *const walks[] = {put_product, put_scale, put_plain};
    char hex[17];
    snprintf(hex, sizeof hex, "%016jx", (uintmax_t)checksum);
    safetensors_begin(&h);
    safetensors_put_word(&h, "format", modelfile_format);
    safetensors_put_word(&h, "version", modelfile_version);
    safetensors_put_word(&h, "precision", modelfile_precision(x->w->precision));
    put_config(&h, &x->w->dims);
    safetensors_put_word(&h, "source", x->w->source);
    safetensors_put_word(&h, "licence", x->w->licence);
    safetensors_put_word(&h, "checksum", hex);
    err_t e = OK;
    for (int k = 0; k < 3 && !e; k++)
        e = table_walk(&x->w->dims, walks[k], &ctx);
    err_t ended = safetensors_end(&h, e ? NULL : x->f);
    return e ? e : ended;
}

/* ---- data ---- */

static err_t put_data(struct writing *x, const void *p, size_t n)
{
    modelfile_add(&x->sum, p, n);
    errno = 0;
    if (n > 0 && fwrite(p, 1, n, x->f) != n)
        return err_fail(file_code(errno), "writing failed: %s",
                        errno ? strerror(errno) : "unknown reason");
    return OK;
}

static err_t fetch_values(struct writing *x, const struct tensor_spec *t)
{
    const struct run *r = x->r;
    if (r->cancel && atomic_load(r->cancel))
        return err_fail(ERR_CANCELLED, "cancelled");
    if (r->progress)
        r->progress(r->progress_ctx, "convert", x->done++, x->total, "");
    err_t e = x->w->fetch(x->w->ctx, r, t, x->in);
    size_t n = table_count(t);
    for (size_t i = 0; i < n && !e; i++)
        if (!isfinite(x->in[i]))
            e = err_fail(ERR_FORMAT, "tensor %s: element %zu is not finite", t->name, i);
    return e;
}

struct packing {
    struct writing *x;
    const struct tensor_spec *t;
    enum precision type;
    size_t k;
};

static err_t pack_one(void *ctx, int panel, int worker)
{
    struct packing *p = ctx;
    struct writing *x = p->x;
    const struct pack to = {
        .row = x->row + (size_t)worker * p->k,
        .out = x->out + (size_t)panel * pack_panel_bytes(p->t, p->type),
        .scale = p->type == PRECISION_S8 ? x->scale + x->n_scale + (size_t)panel * PANEL : NULL};
    pack_panel(p->t, p->type, panel, x->in, &to);
    return OK;
}

static err_t write_product(void *ctx, const struct tensor_spec *t)
{
    struct writing *x = ctx;
    if (!t->used || t->role == ROLE_PLAIN)
        return OK;
    struct product_shape s = table_product(t);
    struct packing p = {x, t, model_type(t, x->w->precision), (size_t)s.segs * (size_t)s.seg};
    err_t e = fetch_values(x, t);
    if (!e)
        e = pool_for(x->r->pool, pack_panels(t), pack_one, &p);
    if (e)
        return e;
    x->n_scale += p.type == PRECISION_S8 ? (size_t)s.n : 0;
    return put_data(x, x->out, (size_t)pack_panels(t) * pack_panel_bytes(t, p.type));
}

static err_t write_plain(void *ctx, const struct tensor_spec *t)
{
    struct writing *x = ctx;
    if (!t->used || t->role != ROLE_PLAIN)
        return OK;
    err_t e = fetch_values(x, t);
    for (int k = 0; k < t->repeat && !e; k++)
        e = put_data(x, x->in, table_count(t) * sizeof(float));
    return e;
}

static err_t write_all(struct writing *x)
{
    err_t e = write_header(x, 0);
    if (!e)
        e = table_walk(&x->w->dims, write_product, x);
    if (!e)
        e = put_data(x, x->scale, x->n_scale * sizeof(float));
    if (!e)
        e = table_walk(&x->w->dims, write_plain, x);
    if (e)
        return e;
    rewind(x->f);
    e = write_header(x, modelfile_total(&x->sum));
    if (!e && x->r->progress)
        x->r->progress(x->r->progress_ctx, "convert", x->total, x->total, "");
    return e;
}

/* ---- the file ---- */

/* Write the file of `path` at `at` for now; it is removed on error. */
static err_t write_file(struct writing *x, const char *at, const char *path)
{
    err_t e = file_create(at, &x->f);
    if (e)
        return e;
    e = write_all(x);
    if (!e)
        return file_finish(x->f, at);
    file_discard(x->f, at);
    return e == ERR_CANCELLED ? e : err_fail(e, "%s: %s", path, err_text());
}

/* Read the finished file back before it gets its name. */
static err_t publish_file(struct writing *x, const char *path)
{
    char at[FILE_PATH_CAP];
    struct partial p;
    struct modelfile m = {0};
    err_t e = partial_open(path, &p);
    if (!e)
        e = partial_path(&p, path, at);
    if (!e)
        e = write_file(x, at, path);
    if (!e)
        e = modelfile_open(at, &m);
    modelfile_close(&m);
    if (!e)
        e = partial_show(&p, path);
    partial_close(&p);
    return e;
}

err_t modelwrite_run(const struct run *r, const struct modelwrite *w, const char *path)
{
    struct sizes s = sizes_of(w);
    struct writing x = {.r = r, .w = w, .total = s.tensors};
    const size_t mark = arena_mark(r->tmp);
    err_t e = file_is_special(path) ? OK : origin_check_place(path);
    if (!e)
        e = layout(&x, r->tmp, &s, r->pool ? pool_size(r->pool) : 1);
    if (!e)
        e = file_is_special(path) ? write_file(&x, path, path) : publish_file(&x, path);
    arena_reset(r->tmp, mark);
    return e;
}
