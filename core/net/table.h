/* table.h - every tensor of the network by name and shape, from the dimensions in a weights file;
 * no sizes are compiled in (core/net/README.md 3). Names are those of the
 * released checkpoint after removal of the Lightning prefix "model.".
 * Pure computation; thread: any. */
#ifndef NET_TABLE_H
#define NET_TABLE_H

#include "core/base/err.h"
#include "core/base/types.h"
#include "core/net/lpips_layers.h"

#include <stdbool.h>
#include <stddef.h>

enum {
    NET_KEEP = 4,    // kept layers, inputs of the DPT trunks
    NET_SPECIAL = 5, // camera token and 4 registers before the patches of a view
    NET_PATCH = CORRESPONDENCE_PATCH,
    NET_POS_GRID = 37,  // edge of the position grid of DINOv2
    NET_DEPTH_MAX = 64, // blocks of one kind
    NET_NAME_CAP = 96,  // bytes of a tensor name with its terminating 0
    NET_RAW = 84, // channels of the Gaussian head: logit, scale 3, rotation 4, SH 75, confidence
    NET_SENSITIVITY = 4,
    NET_THETA = 1926, // outputs of the hypernetwork; the first TONE_PARAMS are used
    NET_POSE = 9,     // translation 3, quaternion xyzw 4, vertical and horizontal field of view
    NET_COMPLETE = 6, // levels of the completion branch
    NET_COMPLETE_IN = 15,
    NET_COMPLETE_OUT = 3,
    NET_STAY_MAX = 2 // residual convolutions of a level of it
};

/* Dimensions, keys of the same name in the file's configuration. Checked by table_check. */
struct net_dims {
    int embed, heads;           // width of the tokens; attention heads, embed / heads is a
                                // multiple of 16, at most 128
    int dino_depth, dino_heads; // DINOv2 blocks and heads
    int depth;                  // frame and global blocks, each
    int keep[NET_KEEP];         // kept layers, ascending, the last is depth - 1
    int qk_layer;               // global block whose q and k steer the fusion
    int cam_depth, cam_heads;   // camera trunk, width 2 embed
    int depth_feat, gs_feat;    // width of the two DPT trunks, multiples of 8
    int depth_oc[NET_KEEP], gs_oc[NET_KEEP]; // projection widths, multiples of 4
    int hdr;     // width of the appearance branch, gs_feat / 2; 0 like gs_* without Gaussian head
    int size;    // px, edge of the views it was trained for; multiple of 14
    float voxel; // scene units, cell of the voxel fusion
    bool gauss, appearance; // has the Gaussian head; has the HDR modules (InstantHDR, not AnySplat)
    bool rope_bf16; // angles rounded to bf16 as in the released training (core/net/README.md 1.2)
    bool complete;  // has the completion branch (core/net/README.md 2.14)
    /* Not LPIPS_NONE: no network of scenes, but that of core/net/lpips.h; the rest is 0. */
    enum lpips_net lpips;
};

/* Dimensions of the release (core/net/README.md 3.1) and of golden/mini. */
extern const struct net_dims table_full, table_mini;

/* Of the levels of the completion branch: channels, residual convolutions. */
extern const int table_complete_width[NET_COMPLETE], table_complete_stay[NET_COMPLETE];

/* err:  ERR_FORMAT names the dimension, its value and its bound. */
MUST_USE err_t table_check(const struct net_dims *d);

/* How a tensor is stored in a weights file (core/net/model.h). */
enum tensor_role {
    ROLE_PLAIN,  // as it is, F32
    ROLE_LINEAR, // [n, k] product, in the precision of the file
    ROLE_CONV,   // [n, c, kh, kw] product with k ordered (ky, kx, c), in the precision of the file
    ROLE_CONV_T, // [c, o, s, s] transposed convolution with stride s: product with n ordered
                 // (a, b, o), in the precision of the file
};

struct tensor_spec {
    char name[NET_NAME_CAP];
    enum tensor_role role;
    bool exact; // a product that stays F32 in every precision (core/net/README.md 5)
    bool used;  // false: in the released checkpoint, never read; may be absent
    int rank;
    int shape[4]; // as in the checkpoint
    int repeat;   // PLAIN: number of copies in the weights file, one after the other; > 1 for
                  // the bias of a transposed convolution, whose product has s * s * o outputs
};

/* Call fn for every tensor of the network, in the order of the released checkpoint; stops at the
 * first error and returns it. d must have passed table_check. */
typedef err_t tensor_fn(void *ctx, const struct tensor_spec *t);
MUST_USE err_t table_walk(const struct net_dims *d, tensor_fn *fn, void *ctx);

/* Linear weights of LPIPS: those after stage i are "lin<i>.model.1.weight". */
#define TABLE_LINEAR "lin"

/* Elements of a tensor. */
size_t table_count(const struct tensor_spec *t);

/* The product that a tensor of role LINEAR, CONV or CONV_T becomes: n outputs, k inputs made of
 * `segs` runs of `seg` consecutive ones. Linear: 1 run; convolution: kh runs of kw * c. */
struct product_shape {
    int n, segs, seg;
};
struct product_shape table_product(const struct tensor_spec *t);

/* Element of a checkpoint tensor (C order) that is input i of output o of its product. */
size_t table_source(const struct tensor_spec *t, int o, int i);

#endif
