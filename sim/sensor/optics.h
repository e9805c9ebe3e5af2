/* optics.h - the optics of a rig's camera: size of the picture, lens, vignetting, gain and white
 * balance, and the syntax for them on the command line.
 * Pure functions; any thread. */
#ifndef SENSOR_OPTICS_H
#define SENSOR_OPTICS_H

#include "core/base/types.h"

struct optics {
    int w, h;          // px
    struct lens lens;  // of pictures of w x h
    float vignette[2]; // v2, v4: light is multiplied by 1 + v2 r^2 + v4 r^4, r the distance from
                       // (cx, cy) over half the picture's diagonal
    bool cos4;         // and by cos^4 of the angle between the ray and the axis
    float gain[3];     // and by this: relative gain times white balance, of R,G,B
};

#define OPTICS_SIDE_MIN 14
#define OPTICS_SIDE_MAX 2048 // px

#define OPTICS_WORDS                                                                               \
    "k1=-0.25,k2=0.05 (k1 k2 p1 p2) or fisheye,k1=0.01 (k1 k2 k3 k4), with fov=70 size=800x600 "   \
    "centre=0.51/0.48 v2=-0.3 v4=0.05 cos4 gain=1.1 wb=1.05/1/0.97"

/* Read a list of OPTICS_WORDS, each once. `size` (px, both sides) and `fov` (degrees) are those of
 * a camera that does not name its own: the horizontal field of view without the terms, if the
 * principal point were in the middle; a fisheye's is that of its angles. The centre, the principal
 * point, is in shares of the sides. `what` begins the sentence.
 * err:  ERR_ARG: unknown or doubled words, numbers out of bounds, vignetting that leaves no light
 *       in a corner, those of lens_init. */
MUST_USE err_t optics_parse(const char *what, const char *text, int size, double fov,
                            struct optics *out);

/* Factor of each colour at a pixel; 0 beyond the image circle if there is cos4. */
void optics_factor(const struct optics *o, double u, double v, float out[3]);

/* Whether the factor differs from 1 anywhere. */
bool optics_dims(const struct optics *o);

/* Multiply radiance, (3, h, w), by the factor at each pixel's centre. */
void optics_apply(const struct optics *o, float *radiance);

#endif
