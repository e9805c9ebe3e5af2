/* graph.h - the parts of the network: the weights of each stage and the results that stages pass on
 * (core/net/README.md 2). */
#ifndef NET_GRAPH_H
#define NET_GRAPH_H

#include "core/kernels/kernels.h"
#include "core/net/model.h"

/* Parts of an I8 model that can be kept in float arithmetic at the cost of time (bits). */
enum {
    NET_FLOAT_BLOCKS = 1,    // products of the transformer blocks
    NET_FLOAT_ATTENTION = 2, // q k^T and p v
    NET_FLOAT_HEADS = 4,     // DPT trunks, appearance, Gaussian head, hypernetwork, completion
    NET_FLOAT_SPECIAL = 8,   // products of the camera and register tokens
    NET_FLOAT_ALL = 15
};

struct block_weights { // a transformer block (core/net/README.md 1.1)
    const float *norm1_g, *norm1_b, *norm2_g, *norm2_b, *gamma1, *gamma2;
    const float *q_g, *q_b, *k_g, *k_b; // norms of a head; NULL: none
    struct weight qkv, proj, fc1, fc2;
};

struct rcu_weights { // residual unit
    struct weight conv1, conv2;
};

struct dpt_weights { // core/net/README.md 2.5
    int feat, oc[NET_KEEP];
    const float *norm_g, *norm_b;
    struct weight project[NET_KEEP], resize[NET_KEEP];   // resize[2] is unused
    struct weight rn[NET_KEEP];                          // layer1_rn .. layer4_rn
    struct rcu_weights unit1[NET_KEEP], unit2[NET_KEEP]; // in refinenet1 .. 4; unit1[3] is unused
    struct weight out_conv[NET_KEEP];                    // in refinenet1 .. 4
    struct weight output_conv1;
};

struct camera_weights { // core/net/README.md 2.4
    const float *empty_pose, *token_norm_g, *token_norm_b, *trunk_norm_g, *trunk_norm_b;
    struct weight embed_pose, modulation, fc1, fc2;
    struct block_weights trunk[NET_DEPTH_MAX];
};

struct mlp_weights { // linear, ReLU, linear
    struct weight a, b;
};

struct appearance_weights { // core/net/README.md 2.6 to 2.9
    struct weight patch_embed, v_mean, v_var;
    const float *ln_g, *ln_b, *mean_g, *mean_b, *var_g, *var_b;
    struct mlp_weights film, mean_out, var_out, sensitivity; // sensitivity: convolutions 3x3, 1x1
    struct weight guide, scene_conv, proj_guide, proj_out;
};

struct meta_weights { // core/net/README.md 2.10
    struct weight exp_proj, enc0, enc2;
    struct mlp_weights out;
};

struct complete_weights { // core/net/README.md 2.14
    struct weight down[NET_COMPLETE], stay[NET_COMPLETE][NET_STAY_MAX];
    struct weight up[NET_COMPLETE - 1], join[NET_COMPLETE - 1], out;
};

struct net {
    struct net_dims d;
    unsigned floats; // NET_FLOAT_ bits in force; all of them unless the model is I8
    bool attend;     // also find patches in other views: prediction.matches
    /* DINOv2 */
    struct weight patch_embed;
    const float *cls_token, *dino_registers, *pos_embed, *dino_norm_g, *dino_norm_b;
    struct block_weights dino[NET_DEPTH_MAX];
    /* aggregator */
    const float *camera_token, *register_token; // (2, embed), (2, 4, embed)
    struct block_weights frame[NET_DEPTH_MAX], global[NET_DEPTH_MAX];
    struct camera_weights camera;
    struct dpt_weights depth, gauss;
    struct mlp_weights depth_out;
    struct weight input_merger;   // AnySplat only
    struct mlp_weights gauss_out; // hdr_conv, or AnySplat's own output_conv2
    struct appearance_weights appearance;
    struct meta_weights meta;
    struct complete_weights complete;
};

/* Tokens after the backbone, of the views that are dealt to this rank: without a team of all.
 * n_tokens = NET_SPECIAL + grid^2 per view. */
struct tokens {
    int n_views, grid, n_tokens, embed;
    int first, n_own;      // views [first, first + n_own) of the n_views
    float *keep[NET_KEEP]; // (n_own, n_tokens, 2 embed): frame block, global block
    float *q; // (heads, n_own n_tokens, embed / heads) of block qk_layer after the norms, before
              // rotary embedding; NULL without the appearance branch
    float *k; // the same of (heads, n_views n_tokens, embed / heads): all views
};

/* Geometry of the views in the network's own world: near the first camera, arbitrary scale. */
struct geometry {
    int n_views, size;
    float *pose;         // (n_views, NET_POSE) translation, quaternion xyzw, FoV vertical,
                         // horizontal, after activation
    struct camera *cams; // (n_views) of pose, for size x size
    float *depth;        // (n_views, size, size) > 0
};

/* Fused appearance (core/net/README.md 2.8). */
struct irradiance {
    float *code;         // (n_views, hdr) exposure code
    float *scene, *sens; // (n_own grid^2, hdr) of the views of this rank
};

/* One raw Gaussian per pixel, in the layout of voxel_merge. */
struct prediction {
    struct geometry geom;
    int n;                         // n_views size^2
    float *points;                 // (n, 3)
    float *features;               // (87, n): channels 0..82, 84..87 of the 88
    float *confidence;             // (n): channel 83
    float theta[NET_THETA];        // tone curve; zero without the appearance branch
    struct tonemap tone;           // its used part
    struct correspondence matches; // zeroed unless net.attend
    bool linear; // AnySplat: the SH give display colours minus 0.5, not log radiance
};

#endif
