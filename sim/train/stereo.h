/* stereo.h - depth maps of photographs whose cameras are known, as the program makes them, and what
 * it tells the completion branch about them (core/stereo/fill.h), for sim/train (through
 * build/ARCH/libsim.so and ctypes). Thread: any; calls are independent. */
#ifndef TRAIN_STEREO_H
#define TRAIN_STEREO_H

#include <stdint.h>

enum { STEREO_VIEWS = 16, STEREO_CAMERA = 11 }; // fx fy cx cy (px), q wxyz, t: world to camera

struct stereo_request {
    int n, w, h;        // 2..STEREO_VIEWS photographs of 16..256 px: the maps have their size
    const uint8_t *px;  // (n, h, w, 3)
    const float *log2t; // (n)
    const float *cams;  // (n, STEREO_CAMERA)
    /* out, the caller's */
    float *input; // (n, h, w, FILL_INPUT)
    float *guess; // (n, h, w) inverse depth that the branch corrects
};

/* The response is found as for photographs of one exposure per place.
 * err:  0 on success, else the err_t; sample_error() has the sentence. */
int stereo_run(const struct stereo_request *q);

#endif
