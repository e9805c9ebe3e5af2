/* tiny_net.h - the smallest network, that of tests/data/ckpt. */
#ifndef NET_TINY_NET_H
#define NET_TINY_NET_H

#include "core/net/table.h"

static const struct net_dims tiny_net = {
    .embed = 32,
    .heads = 1,
    .dino_depth = 1,
    .dino_heads = 1,
    .depth = 4,
    .keep = {0, 1, 2, 3},
    .qk_layer = 2,
    .cam_depth = 1,
    .cam_heads = 1,
    .depth_feat = 8,
    .gs_feat = 8,
    .depth_oc = {4, 8, 12, 12},
    .gs_oc = {4, 4, 8, 8},
    .hdr = 4,
    .size = 56,
    .voxel = 0.25f,
    .gauss = true,
    .appearance = true,
    .rope_bf16 = true,
};

#endif
