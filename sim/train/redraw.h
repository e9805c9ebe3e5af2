/* redraw.h - the picture of Gaussians and the gradient of a loss on it, for sim/train (through
 * build/ARCH/libsim.so and ctypes): the rasteriser of core/splat with memory and threads of its
 * own. Thread: any; calls are independent. */
#ifndef TRAIN_REDRAW_H
#define TRAIN_REDRAW_H

enum { REDRAW_CAMERA = 11 }; // fx fy cx cy (px), q wxyz, t (scene units), world to camera

struct redraw {
    int n, degree;       // splats 1..GAUSSIANS_MAX; SH degree 0..4
    int w, h, threads;   // px, 1..RASTER_SIDE_MAX; as of pool_open
    float background[3]; // linear radiance
    float camera[REDRAW_CAMERA];
    const float *planes; // (planes of the degree, n) as in struct gaussians
    /* out, the caller's */
    float *radiance;      // (3, h, w) linear, with background
    float *depth, *alpha; // (h, w) as in struct render; depth may be NULL
    /* d loss / d maps; radiance NULL: no gradient is wanted; depth and alpha may be NULL */
    const float *up_radiance, *up_depth, *up_alpha;
    float *grad; // out: (planes of the degree, n), 0 where a splat is not drawn
};

/* Draw, then the gradient if it is wanted.
 * err:  0 on success, else the err_t; sample_error() has the sentence. */
int redraw_run(const struct redraw *q);

#endif
