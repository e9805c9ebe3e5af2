/* Walks the modules in the order of the released checkpoint. Role and precision of a tensor follow
 * from its name and shape (emit_tensor). */
#include "core/net/table.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { WIDTH_MAX = 4096, HEAD_MAX = 128, SIZE_MAX_PX = 1792, MLP = 4, TAIL = 32 };

const struct net_dims table_full = {
    .embed = 1024,
    .heads = 16,
    .dino_depth = 24,
    .dino_heads = 16,
    .depth = 24,
    .keep = {4, 11, 17, 23},
    .qk_layer = 14,
    .cam_depth = 4,
    .cam_heads = 16,
    .depth_feat = 256,
    .gs_feat = 256,
    .depth_oc = {256, 512, 1024, 1024},
    .gs_oc = {256, 512, 1024, 1024},
    .hdr = 128,
    .size = 448,
    .voxel = 0.002f,
    .gauss = true,
    .appearance = true,
    .rope_bf16 = true,
};

const struct net_dims table_mini = {
    .embed = 384,
    .heads = 6,
    .dino_depth = 4,
    .dino_heads = 6,
    .depth = 6,
    .keep = {1, 2, 4, 5},
    .qk_layer = 3,
    .cam_depth = 2,
    .cam_heads = 6,
    .depth_feat = 64,
    .gs_feat = 256,
    .depth_oc = {48, 96, 192, 192},
    .gs_oc = {64, 96, 128, 128},
    .hdr = 128,
    .size = 112,
    .voxel = 0.08f,
    .gauss = true,
    .appearance = true,
    .rope_bf16 = false,
};

const int table_complete_width[NET_COMPLETE] = {32, 48, 64, 96, 128, 128};
const int table_complete_stay[NET_COMPLETE] = {0, 1, 1, NET_STAY_MAX, 1, NET_STAY_MAX};

/* ---- dimensions ---- */

static err_t check_range(const char *what, int v, int step, int max)
{
    if (v < step || v > max || v % step != 0)
        return err_fail(ERR_FORMAT, "dimension %s is %d, allowed are multiples of %d up to %d",
                        what, v, step, max);
    return OK;
}

static err_t check_heads(const char *what, int width, int heads)
{
    err_t e = check_range(what, heads, 1, WIDTH_MAX);
    if (e)
        return e;
    if (width % heads != 0 || width / heads % 16 != 0 || width / heads > HEAD_MAX)
        return err_fail(ERR_FORMAT,
                        "dimension %s is %d: heads of %g of %d channels, allowed are multiples of "
                        "16 up to %d",
                        what, heads, (double)width / heads, width, HEAD_MAX);
    return OK;
}

static err_t check_layers(const struct net_dims *d)
{
    for (int k = 0; k < NET_KEEP; k++)
        if (d->keep[k] <= (k ? d->keep[k - 1] : -1) || d->keep[k] >= d->depth)
            return err_fail(ERR_FORMAT,
                            "dimension keep: entry %d is %d, they must ascend within 0..%d", k,
                            d->keep[k], d->depth - 1);
    if (d->keep[NET_KEEP - 1] != d->depth - 1)
        return err_fail(ERR_FORMAT, "dimension keep: the last is %d, it must be depth - 1 = %d",
                        d->keep[NET_KEEP - 1], d->depth - 1);
    if (d->qk_layer < 0 || d->qk_layer >= d->depth)
        return err_fail(ERR_FORMAT, "dimension qk_layer is %d, allowed are 0..%d", d->qk_layer,
                        d->depth - 1);
    return OK;
}

static err_t check_gauss(const struct net_dims *d)
{
    if (d->appearance && !d->gauss)
        return err_fail(ERR_FORMAT, "dimension appearance is true without gauss");
    err_t e = OK;
    if (d->gauss)
        e = check_range("gs_feat", d->gs_feat, 8, WIDTH_MAX);
    else if (d->gs_feat != 0)
        e = err_fail(ERR_FORMAT, "dimension gs_feat is %d without gauss, must be 0", d->gs_feat);
    for (int k = 0; k < NET_KEEP && !e; k++)
        if (d->gauss)
            e = check_range("gs_oc", d->gs_oc[k], 4, WIDTH_MAX);
        else if (d->gs_oc[k] != 0)
            e = err_fail(ERR_FORMAT, "dimension gs_oc is %d without gauss, must be 0", d->gs_oc[k]);
    if (!e && d->hdr != d->gs_feat / 2)
        e = err_fail(ERR_FORMAT, "dimension hdr is %d, must be gs_feat / 2 = %d", d->hdr,
                     d->gs_feat / 2);
    return e;
}

err_t table_check(const struct net_dims *d)
{
    if (d->lpips != LPIPS_NONE)
        return OK;
    err_t e = check_range("embed", d->embed, 16, WIDTH_MAX);
    if (!e)
        e = check_heads("heads", d->embed, d->heads);
    if (!e)
        e = check_range("dino_depth", d->dino_depth, 1, NET_DEPTH_MAX);
    if (!e)
        e = check_heads("dino_heads", d->embed, d->dino_heads);
    if (!e)
        e = check_range("depth", d->depth, 1, NET_DEPTH_MAX);
    if (!e)
        e = check_layers(d);
    if (!e)
        e = check_range("cam_depth", d->cam_depth, 1, NET_DEPTH_MAX);
    if (!e)
        e = check_heads("cam_heads", 2 * d->embed, d->cam_heads);
    if (!e)
        e = check_range("depth_feat", d->depth_feat, 8, WIDTH_MAX);
    for (int k = 0; k < NET_KEEP && !e; k++)
        e = check_range("depth_oc", d->depth_oc[k], 4, WIDTH_MAX);
    if (!e)
        e = check_gauss(d);
    if (!e)
        e = check_range("size", d->size, NET_PATCH, SIZE_MAX_PX);
    if (!e && !(d->voxel >= 1e-6f && d->voxel <= 1e6f))
        e = err_fail(ERR_FORMAT, "dimension voxel is %g, allowed are 1e-6 to 1e6",
                     (double)d->voxel);
    return e;
}

/* ---- tensors ---- */

struct walk {
    const struct net_dims *d;
    tensor_fn *fn;
    void *ctx;
    err_t e;
};

struct shape {
    int rank, n[4];
};

static struct shape shape_1d(int a)
{
    return (struct shape){1, {a, 1, 1, 1}};
}

static struct shape shape_2d(int a, int b)
{
    return (struct shape){2, {a, b, 1, 1}};
}

static struct shape shape_3d(int a, int b, int c)
{
    return (struct shape){3, {a, b, c, 1}};
}

static struct shape shape_4d(int n, int c, int edge)
{
    return (struct shape){4, {n, c, edge, edge}};
}

static bool ends_with(const char *s, const char *with)
{
    size_t n = strlen(s), m = strlen(with);
    return n >= m && strcmp(s + n - m, with) == 0;
}

/* Whether the name begins with one of the prefixes, a list closed by NULL. */
static bool begins_with(const char *name, const char *const *prefix)
{
    for (; *prefix; prefix++)
        if (strncmp(name, *prefix, strlen(*prefix)) == 0)
            return true;
    return false;
}

static enum tensor_role role_of(const char *name, int rank)
{
    static const char *const plain[] = {TABLE_LINEAR, NULL};
    if (rank < 2 || !ends_with(name, ".weight") || begins_with(name, plain))
        return ROLE_PLAIN;
    if (rank == 2)
        return ROLE_LINEAR;
    bool transposed =
        ends_with(name, "resize_layers.0.weight") || ends_with(name, "resize_layers.1.weight");
    return transposed ? ROLE_CONV_T : ROLE_CONV;
}

/* First layers, whose inputs are pixels or times, and last ones, whose outputs are exponents, poses
 * or curves (hazards 1, 8, 9, 11, 12, 14, 15, 23, 29, 33 of core/net/README.md 5). From fused
 * tokens to radiance differences of large maps count: with 8 bits the trained small model is 0.6
 * stops off. The completion branch has most of its error in the layers that read maps of full size,
 * where floats take hardly longer (core/net/README.md 2.14). */
static const char *const exact_products[] = {
    "encoder.aggregator.patch_embed.patch_embed.proj.",
    "encoder.camera_head.embed_pose.",
    "encoder.camera_head.pose_branch.",
    "encoder.depth_head.scratch.output_conv2.2.",
    "encoder.gaussian_param_head.scratch.output_conv2.2.",
    "encoder.gaussian_param_head.input_merger.",
    "encoder.hdr_head.patch_embed.",
    "encoder.hdr_head.guide_encoder.",
    "encoder.hdr_head.regression.",
    "encoder.hdr_head.scene_conv.",
    "encoder.hdr_head.hdr_upsample.",
    "encoder.hdr_head.sensitivity_conv.2.",
    "encoder.hdr_conv.",
    "encoder.generate_tonemapper.exp_proj.",
    "encoder.generate_tonemapper.out.",
    "encoder.complete.down.0.",
    "encoder.complete.down.1.",
    "encoder.complete.join.0.",
    "encoder.complete.out.",
    "features.",
    NULL,
};

static const char *const never_used[] = {
    "encoder.aggregator.patch_embed.mask_token",
    "encoder.hdr_head.pos_embed.div_term",
    NULL,
};

/* Modules that InstantHDR replaces by its own. */
static const char *const replaced[] = {
    "encoder.gaussian_param_head.scratch.output_conv2.",
    "encoder.gaussian_param_head.input_merger.",
    NULL,
};

static void emit_spec(struct walk *w, const struct tensor_spec *t)
{
    if (!w->e)
        w->e = w->fn(w->ctx, t);
}

static void __attribute__((format(printf, 3, 4)))
emit_tensor(struct walk *w, struct shape s, const char *fmt, ...)
{
    struct tensor_spec t = {.rank = s.rank};
    va_list args;
    va_start(args, fmt);
    vsnprintf(t.name, sizeof t.name, fmt, args);
    va_end(args);
    memcpy(t.shape, s.n, sizeof t.shape);
    t.role = role_of(t.name, t.rank);
    t.exact = t.role != ROLE_PLAIN && begins_with(t.name, exact_products);
    t.repeat = ends_with(t.name, "resize_layers.0.bias")   ? 16
               : ends_with(t.name, "resize_layers.1.bias") ? 4
                                                           : 1;
    t.used =
        !begins_with(t.name, never_used) && !(w->d->appearance && begins_with(t.name, replaced));
    emit_spec(w, &t);
}

/* NAME.weight and NAME.bias; bias: its length. */
static void __attribute__((format(printf, 4, 5)))
emit_pair(struct walk *w, struct shape s, int bias, const char *fmt, ...)
{
    char name[NET_NAME_CAP];
    va_list args;
    va_start(args, fmt);
    vsnprintf(name, sizeof name, fmt, args);
    va_end(args);
    emit_tensor(w, s, "%.80s.weight", name);
    emit_tensor(w, shape_1d(bias), "%.80s.bias", name);
}

/* One transformer block of width c; qk: width of the norms of q and k, 0 = none. */
static void emit_block(struct walk *w, const char *stem, int i, int c, int qk)
{
    char name[NET_NAME_CAP];
    snprintf(name, sizeof name, "%.60s.%d", stem, i);
    emit_pair(w, shape_1d(c), c, "%.70s.norm1", name);
    emit_pair(w, shape_2d(3 * c, c), 3 * c, "%.70s.attn.qkv", name);
    if (qk > 0) {
        emit_pair(w, shape_1d(qk), qk, "%.70s.attn.q_norm", name);
        emit_pair(w, shape_1d(qk), qk, "%.70s.attn.k_norm", name);
    }
    emit_pair(w, shape_2d(c, c), c, "%.70s.attn.proj", name);
    emit_tensor(w, shape_1d(c), "%.70s.ls1.gamma", name);
    emit_pair(w, shape_1d(c), c, "%.70s.norm2", name);
    emit_pair(w, shape_2d(MLP * c, c), MLP * c, "%.70s.mlp.fc1", name);
    emit_pair(w, shape_2d(c, MLP * c), c, "%.70s.mlp.fc2", name);
    emit_tensor(w, shape_1d(c), "%.70s.ls2.gamma", name);
}

static void walk_aggregator(struct walk *w)
{
    const char *a = "encoder.aggregator", *dino = "encoder.aggregator.patch_embed";
    int c = w->d->embed, qk = c / w->d->heads;
    emit_tensor(w, (struct shape){4, {1, 2, 1, c}}, "%s.camera_token", a);
    emit_tensor(w, (struct shape){4, {1, 2, NET_SPECIAL - 1, c}}, "%s.register_token", a);
    emit_tensor(w, shape_3d(1, 1, c), "%s.cls_token", dino);
    emit_tensor(w, shape_3d(1, 1 + NET_POS_GRID * NET_POS_GRID, c), "%s.pos_embed", dino);
    emit_tensor(w, shape_3d(1, NET_SPECIAL - 1, c), "%s.register_tokens", dino);
    emit_tensor(w, shape_2d(1, c), "%s.mask_token", dino);
    emit_pair(w, shape_4d(c, 3, NET_PATCH), c, "%s.patch_embed.proj", dino);
    for (int i = 0; i < w->d->dino_depth; i++)
        emit_block(w, "encoder.aggregator.patch_embed.blocks", i, c, 0);
    emit_pair(w, shape_1d(c), c, "%s.norm", dino);
    for (int i = 0; i < w->d->depth; i++)
        emit_block(w, "encoder.aggregator.frame_blocks", i, c, qk);
    for (int i = 0; i < w->d->depth; i++)
        emit_block(w, "encoder.aggregator.global_blocks", i, c, qk);
}

static void walk_camera_head(struct walk *w)
{
    const char *h = "encoder.camera_head";
    int c = 2 * w->d->embed;
    emit_tensor(w, shape_3d(1, 1, NET_POSE), "%s.empty_pose_tokens", h);
    for (int i = 0; i < w->d->cam_depth; i++)
        emit_block(w, "encoder.camera_head.trunk", i, c, 0);
    emit_pair(w, shape_1d(c), c, "%s.token_norm", h);
    emit_pair(w, shape_1d(c), c, "%s.trunk_norm", h);
    emit_pair(w, shape_2d(c, NET_POSE), c, "%s.embed_pose", h);
    emit_pair(w, shape_2d(3 * c, c), 3 * c, "%s.poseLN_modulation.1", h);
    emit_pair(w, shape_2d(c / 2, c), c / 2, "%s.pose_branch.fc1", h);
    emit_pair(w, shape_2d(NET_POSE, c / 2), NET_POSE, "%s.pose_branch.fc2", h);
}

/* Everything of a DPT head up to scratch.output_conv1. */
static void walk_dpt_trunk(struct walk *w, const char *h, int feat, const int oc[NET_KEEP])
{
    int c = 2 * w->d->embed;
    emit_pair(w, shape_1d(c), c, "%s.norm", h);
    for (int k = 0; k < NET_KEEP; k++)
        emit_pair(w, shape_4d(oc[k], c, 1), oc[k], "%s.projects.%d", h, k);
    emit_pair(w, shape_4d(oc[0], oc[0], 4), oc[0], "%s.resize_layers.0", h);
    emit_pair(w, shape_4d(oc[1], oc[1], 2), oc[1], "%s.resize_layers.1", h);
    emit_pair(w, shape_4d(oc[3], oc[3], 3), oc[3], "%s.resize_layers.3", h);
    for (int k = 0; k < NET_KEEP; k++)
        emit_tensor(w, shape_4d(feat, oc[k], 3), "%s.scratch.layer%d_rn.weight", h, k + 1);
    for (int k = 1; k <= NET_KEEP; k++) {
        emit_pair(w, shape_4d(feat, feat, 1), feat, "%s.scratch.refinenet%d.out_conv", h, k);
        for (int unit = k == NET_KEEP ? 2 : 1; unit <= 2; unit++)
            for (int conv = 1; conv <= 2; conv++)
                emit_pair(w, shape_4d(feat, feat, 3), feat,
                          "%s.scratch.refinenet%d.resConfUnit%d.conv%d", h, k, unit, conv);
    }
    emit_pair(w, shape_4d(feat / 2, feat, 3), feat / 2, "%s.scratch.output_conv1", h);
}

static void walk_depth_head(struct walk *w)
{
    const char *h = "encoder.depth_head";
    walk_dpt_trunk(w, h, w->d->depth_feat, w->d->depth_oc);
    emit_pair(w, shape_4d(TAIL, w->d->depth_feat / 2, 3), TAIL, "%s.scratch.output_conv2.0", h);
    emit_pair(w, shape_4d(2, TAIL, 1), 2, "%s.scratch.output_conv2.2", h);
}

static void walk_gauss_head(struct walk *w)
{
    const char *h = "encoder.gaussian_param_head";
    int c = w->d->hdr;
    walk_dpt_trunk(w, h, w->d->gs_feat, w->d->gs_oc);
    emit_pair(w, shape_4d(c, c, 3), c, "%s.scratch.output_conv2.0", h);
    emit_pair(w, shape_4d(NET_RAW, c, 1), NET_RAW, "%s.scratch.output_conv2.2", h);
    emit_pair(w, shape_4d(c, 3, 7), c, "%s.input_merger.0", h);
}

static void walk_hdr_head(struct walk *w)
{
    const char *h = "encoder.hdr_head", *r = "encoder.hdr_head.regression";
    int c = w->d->hdr;
    emit_pair(w, shape_4d(c, 3, NET_PATCH), c, "%s.patch_embed", h);
    emit_tensor(w, shape_1d(c / 2), "%s.pos_embed.div_term", h);
    emit_pair(w, shape_1d(c), c, "%s.ln", r);
    emit_pair(w, shape_2d(c, c), c, "%s.v_mean_proj", r);
    emit_pair(w, shape_2d(c, c), c, "%s.v_var_proj", r);
    for (int i = 0; i < 2; i++) {
        const char *out = i == 0 ? "mean_out" : "var_out";
        emit_pair(w, shape_1d(c), c, "%s.%s.0", r, out);
        emit_pair(w, shape_2d(c, c), c, "%s.%s.1", r, out);
        emit_pair(w, shape_2d(c, c), c, "%s.%s.3", r, out);
    }
    emit_pair(w, shape_2d(c, 3 * c), c, "%s.exp_film.0", r);
    emit_pair(w, shape_2d(2 * c, c), 2 * c, "%s.exp_film.2", r);
    emit_pair(w, shape_4d(c, 3, 7), c, "%s.guide_encoder.0", h);
    emit_pair(w, shape_4d(c, c, 3), c, "%s.scene_conv.0", h);
    emit_pair(w, shape_4d(TAIL, c, 3), TAIL, "%s.sensitivity_conv.0", h);
    emit_pair(w, shape_4d(NET_SENSITIVITY, TAIL, 1), NET_SENSITIVITY, "%s.sensitivity_conv.2", h);
    emit_pair(w, shape_4d(c, c, 7), c, "%s.hdr_upsample.proj_guide.0", h);
    emit_pair(w, shape_4d(c, c, 7), c, "%s.hdr_upsample.proj_out.0", h);
}

static void walk_tone_mapper(struct walk *w)
{
    const char *h = "encoder.generate_tonemapper";
    int c = w->d->hdr;
    emit_pair(w, shape_4d(c, c, 3), c, "encoder.hdr_conv.0");
    emit_pair(w, shape_4d(NET_RAW, c, 1), NET_RAW, "encoder.hdr_conv.2");
    emit_pair(w, shape_2d(c, c), c, "%s.exp_proj", h);
    emit_pair(w, shape_4d(c, 2 * c + NET_RAW + NET_SENSITIVITY, NET_PATCH), c, "%s.enc.0", h);
    emit_pair(w, shape_4d(c, c, 3), c, "%s.enc.2", h);
    emit_pair(w, shape_2d(c, 4 * c), c, "%s.out.0", h);
    emit_pair(w, shape_2d(NET_THETA, c), NET_THETA, "%s.out.2", h);
}

static void walk_complete(struct walk *w)
{
    const char *h = "encoder.complete";
    const int *c = table_complete_width;
    for (int l = 0; l < NET_COMPLETE; l++)
        emit_pair(w, shape_4d(c[l], l ? c[l - 1] : NET_COMPLETE_IN, 3), c[l], "%s.down.%d", h, l);
    for (int l = 0; l < NET_COMPLETE; l++)
        for (int k = 0; k < table_complete_stay[l]; k++)
            emit_pair(w, shape_4d(c[l], c[l], 3), c[l], "%s.stay.%d.%d", h, l, k);
    for (int l = 0; l < NET_COMPLETE - 1; l++)
        emit_pair(w, shape_4d(c[l], c[l + 1], 1), c[l], "%s.up.%d", h, l);
    for (int l = 0; l < NET_COMPLETE - 1; l++)
        emit_pair(w, shape_4d(c[l], c[l], 3), c[l], "%s.join.%d", h, l);
    emit_pair(w, shape_4d(NET_COMPLETE_OUT, c[0], 3), NET_COMPLETE_OUT, "%s.out", h);
}

/* All stay floats: LPIPS is measured, not approximated. */
static void walk_lpips(struct walk *w)
{
    const struct lpips_layers *layers = lpips_layers_of(w->d->lpips);
    for (int s = 0, before = 3; s < LPIPS_STAGES; s++) {
        const struct lpips_stage *stage = &layers->stage[s];
        for (int i = 0; i < stage->n; i++, before = stage->width)
            emit_pair(w, shape_4d(stage->width, before, stage->conv[i].kernel), stage->width,
                      "features.%d", stage->conv[i].feature);
    }
    for (int s = 0; s < LPIPS_STAGES; s++)
        emit_tensor(w, (struct shape){4, {1, layers->stage[s].width, 1, 1}},
                    TABLE_LINEAR "%d.model.1.weight", s);
}

err_t table_walk(const struct net_dims *d, tensor_fn *fn, void *ctx)
{
    struct walk w = {d, fn, ctx, OK};
    if (d->lpips != LPIPS_NONE) {
        walk_lpips(&w);
        return w.e;
    }
    walk_aggregator(&w);
    walk_camera_head(&w);
    walk_depth_head(&w);
    if (d->gauss)
        walk_gauss_head(&w);
    if (d->appearance) {
        walk_hdr_head(&w);
        walk_tone_mapper(&w);
    }
    if (d->complete)
        walk_complete(&w);
    return w.e;
}

/* ---- products ---- */

size_t table_count(const struct tensor_spec *t)
{
    size_t n = 1;
    for (int k = 0; k < t->rank; k++)
        n *= (size_t)t->shape[k];
    return n;
}

struct product_shape table_product(const struct tensor_spec *t)
{
    const int *s = t->shape;
    switch (t->role) {
    case ROLE_LINEAR:
        return (struct product_shape){s[0], 1, s[1]};
    case ROLE_CONV:
        return (struct product_shape){s[0], s[2], s[3] * s[1]};
    case ROLE_CONV_T:
        return (struct product_shape){s[2] * s[3] * s[1], 1, s[0]};
    default:
        return (struct product_shape){0, 0, 0};
    }
}

size_t table_source(const struct tensor_spec *t, int o, int i)
{
    const int *s = t->shape;
    if (t->role == ROLE_LINEAR)
        return (size_t)o * (size_t)s[1] + (size_t)i;
    size_t cell = (size_t)s[2] * (size_t)s[3];
    if (t->role == ROLE_CONV) { // o (ky kx c) of [o, c, ky, kx]
        int at = i / s[1], c = i % s[1];
        return ((size_t)o * (size_t)s[1] + (size_t)c) * cell + (size_t)at;
    }
    int at = o / s[1], out = o % s[1]; // (a b o) c of [c, o, a, b]
    return ((size_t)i * (size_t)s[1] + (size_t)out) * cell + (size_t)at;
}
