/* model.h - the weights of a network in a mapped weights file, ready to use.
 *
 * A weights file is a safetensors file; drivers/format/modelfile.h describes and checks it.
 * Products are stored packed, so that nothing is copied when a network starts:
 *   F32, BF16  [panels, k, 16]       panel p, input i, output 16 p + j; outputs >= n are 0
 *   I8         [panels, k/4, 16, 4]  panel p, input 4 i + l, output 16 p + j; with NAME_scale F32
 *                                    [n]: weight = scale * integer. k is a multiple of 4.
 * Immutable after it was opened. thread: any. */
#ifndef NET_MODEL_H
#define NET_MODEL_H

#include "core/net/table.h"

#include <stdint.h>

enum precision { PRECISION_F32, PRECISION_BF16, PRECISION_S8 };

/* One matrix product y = W x + b. Pointers into the file. */
struct weight {
    enum precision type;
    int n;              // outputs, >= 1
    int segs, seg;      // inputs k = segs * seg, see product_shape
    int rotate;         // I8: edge of the Hadamard blocks that inputs pass first; 0 = none
    const void *panels; // ((n + 15) / 16, ...) as above; elements of `type`
    const float *scale; // (n) I8, else NULL
    const float *bias;  // (n) or NULL
};

struct model_tensor {
    struct tensor_spec spec;
    enum precision type;
    const void *data;
    const float *scale; // for I8
};

struct model {
    struct net_dims dims;
    enum precision precision; // that of the products which are not exact
    int n;
    const struct model_tensor *tensors; // (n) in the order of table_walk; unused ones are left out
    const void *map;                    // the file
    size_t bytes;
    const char *source, *licence; // texts from the file
};

/* Type of tensor t in a file of this precision: plain and exact ones are F32, and so are products
 * of an I8 file whose runs are no multiple of 4. */
enum precision model_type(const struct tensor_spec *t, enum precision file);

/* Edge of the blocks by which the inputs of product t are rotated (gemm.h) before they become
 * integers; its weights are stored so. 0 = none, and for PLAIN. */
int model_rotation(const struct tensor_spec *t, enum precision file);

/* Tensor `name`; NULL if the model has none. */
const struct model_tensor *model_find(const struct model *m, const char *name);

/* Plain tensor `name`, in the shape of table_walk, `repeat` times.
 * err:  ERR_FORMAT names what is missing. */
MUST_USE err_t model_plain(const struct model *m, const char *name, const float **out);

/* Product `name`.weight with the bias `name`.bias if the model has one.
 * err:  ERR_FORMAT names what is missing. */
MUST_USE err_t model_weight(const struct model *m, const char *name, struct weight *out);

static inline int weight_k(const struct weight *w)
{
    return w->segs * w->seg;
}

#endif
