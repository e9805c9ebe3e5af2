#include "drivers/format/netdims.h"

#include "drivers/format/json.h"

#include <math.h>

/* ADDED: a truth that older files have not; it is written where it is true. */
enum kind { WHOLE, LIST, REAL, TRUTH, ADDED };

static const struct member {
    const char *key;
    enum kind kind;
    size_t at;
} members[] = {
    {"embed", WHOLE, offsetof(struct net_dims, embed)},
    {"heads", WHOLE, offsetof(struct net_dims, heads)},
    {"dino_depth", WHOLE, offsetof(struct net_dims, dino_depth)},
    {"dino_heads", WHOLE, offsetof(struct net_dims, dino_heads)},
    {"depth", WHOLE, offsetof(struct net_dims, depth)},
    {"keep", LIST, offsetof(struct net_dims, keep)},
    {"qk_layer", WHOLE, offsetof(struct net_dims, qk_layer)},
    {"cam_depth", WHOLE, offsetof(struct net_dims, cam_depth)},
    {"cam_heads", WHOLE, offsetof(struct net_dims, cam_heads)},
    {"depth_feat", WHOLE, offsetof(struct net_dims, depth_feat)},
    {"gs_feat", WHOLE, offsetof(struct net_dims, gs_feat)},
    {"depth_oc", LIST, offsetof(struct net_dims, depth_oc)},
    {"gs_oc", LIST, offsetof(struct net_dims, gs_oc)},
    {"hdr", WHOLE, offsetof(struct net_dims, hdr)},
    {"size", WHOLE, offsetof(struct net_dims, size)},
    {"voxel", REAL, offsetof(struct net_dims, voxel)},
    {"gauss", TRUTH, offsetof(struct net_dims, gauss)},
    {"appearance", TRUTH, offsetof(struct net_dims, appearance)},
    {"rope_bf16", TRUTH, offsetof(struct net_dims, rope_bf16)},
    {"complete", ADDED, offsetof(struct net_dims, complete)},
};

enum { N_MEMBERS = sizeof members / sizeof members[0] };

static err_t get_whole(const char *what, const char *key, const struct cJSON *v, int *out)
{
    double number;
    if (!json_number(v, &number) || number != floor(number) || fabs(number) > 1e9)
        return err_fail(ERR_FORMAT, "%s: dimension %s is not a whole number", what, key);
    *out = (int)number;
    return OK;
}

static err_t get_list(const char *what, const char *key, const struct cJSON *v, int *out)
{
    if (!json_is_array(v) || json_count(v) != NET_KEEP)
        return err_fail(ERR_FORMAT, "%s: dimension %s is not a list of %d numbers", what, key,
                        NET_KEEP);
    err_t e = OK;
    for (v = json_first(v); v && !e; v = json_next(v))
        e = get_whole(what, key, v, out++);
    return e;
}

static err_t get_member(const char *what, const struct member *m, const struct cJSON *v, void *to)
{
    double number;
    switch (m->kind) {
    case WHOLE:
        return get_whole(what, m->key, v, to);
    case LIST:
        return get_list(what, m->key, v, to);
    case REAL:
        if (!json_number(v, &number) || fabs(number) > 1e30)
            return err_fail(ERR_FORMAT, "%s: dimension %s is not a number", what, m->key);
        *(float *)to = (float)number;
        return OK;
    default:
        if (!json_truth(v, to))
            return err_fail(ERR_FORMAT, "%s: dimension %s is neither true nor false", what, m->key);
        return OK;
    }
}

static err_t read_lpips(const char *what, const struct cJSON *v, struct net_dims *d)
{
    const char *name = json_string(v);
    *d = (struct net_dims){.lpips = name ? lpips_layers_named(name) : LPIPS_NONE};
    if (d->lpips == LPIPS_NONE)
        return err_fail(ERR_FORMAT,
                        "%s: lpips is not the name of a network that LPIPS uses: "
                        "vgg16 or alexnet",
                        what);
    return OK;
}

err_t netdims_read(const char *what, const struct cJSON *object, bool all, struct net_dims *d)
{
    const struct cJSON *lpips = json_member(object, "lpips");
    if (lpips)
        return read_lpips(what, lpips, d);
    for (int k = 0; k < N_MEMBERS; k++) {
        const struct cJSON *v = json_member(object, members[k].key);
        if (!v && all && members[k].kind != ADDED)
            return err_fail(ERR_FORMAT, "%s: dimension %s is missing", what, members[k].key);
        err_t e = v ? get_member(what, &members[k], v, (char *)d + members[k].at) : OK;
        if (e)
            return e;
    }
    err_t e = table_check(d);
    return e ? err_fail(e, "%s: %s", what, err_text()) : OK;
}

static void put_member(FILE *f, const struct member *m, const void *from)
{
    const int *v = from;
    if (m->kind == WHOLE)
        fprintf(f, "%d", *v);
    else if (m->kind == LIST)
        fprintf(f, "[%d,%d,%d,%d]", v[0], v[1], v[2], v[3]);
    else if (m->kind == REAL)
        fprintf(f, "%.9g", (double)*(const float *)from);
    else
        fputs(*(const bool *)from ? "true" : "false", f);
}

void netdims_put(FILE *f, const struct net_dims *d)
{
    if (d->lpips != LPIPS_NONE) {
        fprintf(f, "{\"lpips\":\"%s\"}", lpips_layers_of(d->lpips)->name);
        return;
    }
    for (int k = 0; k < N_MEMBERS; k++) {
        const void *from = (const char *)d + members[k].at;
        if (members[k].kind == ADDED && !*(const bool *)from)
            continue;
        fprintf(f, "%s\"%s\":", k ? "," : "{", members[k].key);
        put_member(f, &members[k], from);
    }
    putc('}', f);
}
