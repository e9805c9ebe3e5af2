#include "drivers/format/netdims_infer.h"

#include <stdio.h>
#include <string.h>

enum { DINO_HEAD = 64, CAMERA_HEAD = 128, VGGT_SIZE = 518, EXTENT_MAX = 1 << 20 };

/* Extent k of a tensor of that rank. */
static err_t get_extent(const struct checkpoint *c, const char *name, int rank, int k, int *out)
{
    const struct checkpoint_tensor *t = checkpoint_find(c, name);
    *out = 0;
    if (!t)
        return err_fail(ERR_FORMAT, "%s: has no %s: no weights of InstantHDR, AnySplat or VGGT",
                        c->what, name);
    if (t->type == CHECKPOINT_OTHER)
        return err_fail(ERR_FORMAT, "%s: tensor %s is %s; float32, bfloat16 and float16 are read",
                        c->what, name, t->kind);
    if (t->rank != rank || t->shape[k] < 1 || t->shape[k] > EXTENT_MAX)
        return err_fail(ERR_FORMAT, "%s: tensor %s has not %d extents of 1 to %d", c->what, name,
                        rank, EXTENT_MAX);
    *out = (int)t->shape[k];
    return OK;
}

/* Number of blocks: the first that is missing. */
static int count_blocks(const struct checkpoint *c, const char *blocks)
{
    char name[NET_NAME_CAP];
    int n = 0;
    do
        snprintf(name, sizeof name, "%s.%d.norm1.weight", blocks, n);
    while (n <= NET_DEPTH_MAX && checkpoint_find(c, name) && ++n);
    return n;
}

static err_t infer_trunk(const struct checkpoint *c, const char *head, int *feat, int oc[NET_KEEP])
{
    char name[NET_NAME_CAP];
    snprintf(name, sizeof name, "%s.scratch.layer1_rn.weight", head);
    err_t e = get_extent(c, name, 4, 0, feat);
    for (int k = 0; k < NET_KEEP && !e; k++) {
        snprintf(name, sizeof name, "%s.projects.%d.weight", head, k);
        e = get_extent(c, name, 4, 0, &oc[k]);
    }
    return e;
}

static int at_least_one(int n)
{
    return n < 1 ? 1 : n;
}

static err_t infer_layers(const struct checkpoint *c, struct net_dims *d)
{
    if (d->depth != table_full.depth)
        return err_fail(ERR_UNSUPPORTED,
                        "%s: %d frame blocks: which layers to keep is known for %d only; give "
                        "--config",
                        c->what, d->depth, table_full.depth);
    memcpy(d->keep, table_full.keep, sizeof d->keep);
    d->qk_layer = table_full.qk_layer;
    return OK;
}

err_t netdims_infer_run(const struct checkpoint *c, struct net_dims *out)
{
    struct net_dims d = {.voxel = table_full.voxel, .rope_bf16 = true, .size = VGGT_SIZE};
    int head = 1;
    err_t e = get_extent(c, "encoder.aggregator.camera_token", 4, 3, &d.embed);
    if (!e)
        e = get_extent(c, "encoder.aggregator.frame_blocks.0.attn.q_norm.weight", 1, 0, &head);
    d.heads = at_least_one(d.embed / head);
    d.dino_heads = at_least_one(d.embed / DINO_HEAD);
    d.cam_heads = at_least_one(2 * d.embed / CAMERA_HEAD);
    d.dino_depth = count_blocks(c, "encoder.aggregator.patch_embed.blocks");
    d.depth = count_blocks(c, "encoder.aggregator.frame_blocks");
    d.cam_depth = count_blocks(c, "encoder.camera_head.trunk");
    if (!e)
        e = infer_layers(c, &d);
    if (!e)
        e = infer_trunk(c, "encoder.depth_head", &d.depth_feat, d.depth_oc);
    d.gauss = checkpoint_find(c, "encoder.gaussian_param_head.norm.weight") != NULL;
    d.appearance = checkpoint_find(c, "encoder.hdr_head.patch_embed.weight") != NULL;
    d.complete = checkpoint_find(c, "encoder.complete.out.weight") != NULL;
    if (!e && d.gauss) {
        d.size = table_full.size;
        e = infer_trunk(c, "encoder.gaussian_param_head", &d.gs_feat, d.gs_oc);
        d.hdr = d.gs_feat / 2;
    }
    if (!e && (e = table_check(&d)) != OK)
        e = err_fail(e, "%s: %s", c->what, err_text());
    *out = d;
    return e;
}
