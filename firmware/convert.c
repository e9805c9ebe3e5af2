#include "firmware/convert.h"

#include "core/net/hashed.h"
#include "drivers/json.h"
#include "drivers/modelwrite.h"
#include "drivers/netdims.h"

#include <inttypes.h>
#include <string.h>

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

static err_t write_file(struct engine *en, const struct convert_request *q, struct modelwrite *w)
{
    w->precision = q->precision;
    err_t e = engine_reserve(en, 0, 0, modelwrite_need(w, pool_size(en->pool)), q->max_mb);
    return e ? e : modelwrite_run(&en->run, w, q->out);
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
