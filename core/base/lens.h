/* lens.h - from rays to pixels through the lens of a physical camera, and back. Models, names,
 * order of parameters and conventions are COLMAP's (its documentation, "Camera Models"): x right,
 * y down, z forward; the centre of the first pixel is at (0.5, 0.5).
 *
 * With x = X/Z, y = Y/Z, r^2 = x^2 + y^2:
 *   PINHOLE         x' = x
 *   SIMPLE_RADIAL   x' = x (1 + k1 r^2)
 *   RADIAL          x' = x (1 + k1 r^2 + k2 r^4)
 *   OPENCV          x' = x (1 + k1 r^2 + k2 r^4) + 2 p1 x y + p2 (r^2 + 2 x^2)
 *                   y' = y (1 + k1 r^2 + k2 r^4) + p1 (r^2 + 2 y^2) + 2 p2 x y
 *   OPENCV_FISHEYE  x' = x/r t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8), t = angle to z
 * and u = fx x' + cx, v = fy y' + cy. SIMPLE_RADIAL and RADIAL have one focal length.
 *
 * The polynomials turn back somewhere: a ray beyond the radius (fisheye: the angle) up to which
 * they grow has no pixel. Pure functions; any thread. */
#ifndef BASE_LENS_H
#define BASE_LENS_H

#include "core/base/err.h"

#include <stdbool.h>

enum lens_model {
    LENS_PINHOLE,
    LENS_SIMPLE_RADIAL,
    LENS_RADIAL,
    LENS_OPENCV,
    LENS_OPENCV_FISHEYE,
    LENS_MODELS
};

enum { LENS_TERMS = 4, LENS_PARAMS = 4 + LENS_TERMS };

struct lens {
    enum lens_model model;
    double fx, fy, cx, cy;   // px
    double term[LENS_TERMS]; // k1 k2 p1 p2, fisheye k1 k2 k3 k4; unused ones are 0
    double limit;            // set by lens_init: largest r, fisheye largest angle, that has a pixel
};

/* Check the numbers and find the limit.
 * err:  ERR_ARG (a focal length that is not positive, a number that is not finite). */
MUST_USE err_t lens_init(struct lens *l);

/* Pixel of a ray of any length. False where there is none: behind a lens that is no fisheye, beyond
 * the limit, not finite. */
bool lens_project(const struct lens *l, const double ray[3], double pixel[2]);

/* The same with derivatives, for bundle adjustment.
 * by_ray:   (2, 3) d pixel / d ray.
 * by_param: (2, LENS_PARAMS) d pixel / d (fx, fy, cx, cy, term). For models with one focal length
 *           the derivative by it is the sum of the first two. */
bool lens_project_grad(const struct lens *l, const double ray[3], double pixel[2], double by_ray[6],
                       double by_param[2 * LENS_PARAMS]);

/* Unit ray of a pixel, by Newton's method: lens_project gives the pixel again within 1e-9 of the
 * focal length. False outside the image circle. */
bool lens_unproject(const struct lens *l, const double pixel[2], double ray[3]);

/* COLMAP's name of a model, and the model of a name; LENS_MODELS if there is none. */
const char *lens_name(enum lens_model m);
enum lens_model lens_find(const char *name);

/* COLMAP's parameters of a model, in its order; values[] has room for LENS_PARAMS.
 * Both return their number. */
int lens_count(enum lens_model m);
int lens_params(const struct lens *l, double *values);

/* err:  ERR_FORMAT (n values do not fit the model), those of lens_init. */
MUST_USE err_t lens_from_params(enum lens_model m, const double *values, int n, struct lens *out);

/* False for PINHOLE, and for the perspective models when all their terms are 0. */
bool lens_distorts(const struct lens *l);

/* The lens of pictures scaled by x across and y down. */
void lens_scale(struct lens *l, double x, double y);

/* The lens of pictures of any width and h px height once they are turned a quarter clockwise. */
void lens_turn(struct lens *l, double h);

#endif
