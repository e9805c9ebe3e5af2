/* netdims_infer.h - dimensions of a network from the shapes in its checkpoint.
 * Read from names and shapes: embed, heads, all depths, widths of the DPT trunks, which modules
 * there are. Shapes do not tell the rest, which is as in the releases: heads of 64 channels in
 * DINOv2 and of 128 in the camera trunk (at least one), kept layers and qk_layer (of 24 blocks),
 * voxel 0.002; size 448, and 518 for VGGT, which has no Gaussian head; angles rounded to bf16.
 * thread: any. */
#ifndef FORMAT_NETDIMS_INFER_H
#define FORMAT_NETDIMS_INFER_H

#include "core/net/table.h"
#include "drivers/format/checkpoint.h"

/* err:  ERR_FORMAT names the tensor that is missing or the dimension that makes no sense;
 *       ERR_UNSUPPORTED if kept layers are not known for that many blocks. */
MUST_USE err_t netdims_infer_run(const struct checkpoint *c, struct net_dims *out);

#endif
