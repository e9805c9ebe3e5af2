/* lpips_layers.h - the layers of the two networks whose features LPIPS compares (Zhang et al.,
 * CVPR 2018): the convolutions of VGG16 and AlexNet as torchvision numbers them. */
#ifndef NET_LPIPS_LAYERS_H
#define NET_LPIPS_LAYERS_H

enum lpips_net { LPIPS_NONE, LPIPS_VGG16, LPIPS_ALEXNET };

enum { LPIPS_STAGES = 5, LPIPS_STAGE_CONVS = 3, LPIPS_CONVS = LPIPS_STAGES * LPIPS_STAGE_CONVS };

/* A convolution with bias and ReLU. */
struct lpips_conv {
    int feature; // weights: features.N of torchvision
    int kernel, stride, pad;
};

/* A maximum over windows, then convolutions, after the last of which features are compared. */
struct lpips_stage {
    int window, step; // px; 1, 1: no maximum
    int width;        // channels of all its convolutions
    int n;
    struct lpips_conv conv[LPIPS_STAGE_CONVS];
};

struct lpips_layers {
    const char *name;
    struct lpips_stage stage[LPIPS_STAGES];
};

/* NULL for LPIPS_NONE and numbers that are none. */
const struct lpips_layers *lpips_layers_of(enum lpips_net net);

/* The network of that name; LPIPS_NONE if there is none. */
enum lpips_net lpips_layers_named(const char *name);

#endif
