/* The limit is the first positive root of the derivative of the radial polynomial, found by steps
 * and bisection: with d = 1 + 3 k1 r^2 + 5 k2 r^4 (and 7 k3, 9 k4 for the angle of a fisheye).
 * The inverse solves the radial equation for the start (it is monotonic, so bisection brackets
 * Newton), then, for OPENCV, the two equations together. */
#include "core/base/lens.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { STEPS = 512, NEWTON = 60 };

#define RADIUS_MAX 20.0  // tan of 87 degrees: where a lens without distortion ends
#define CONVERGED 1e-12  // relative to the focal length
#define INVERSE 1e-9     // the promise of lens_unproject
#define LEAST_SLOPE 1e-3 // derivative of the distorted radius, at the limit

static const struct {
    const char *name;
    int focal, terms; // focal lengths and distortion terms among COLMAP's parameters
} MODEL[LENS_MODELS] = {{"PINHOLE", 2, 0},
                        {"SIMPLE_RADIAL", 1, 1},
                        {"RADIAL", 1, 2},
                        {"OPENCV", 2, 4},
                        {"OPENCV_FISHEYE", 2, 4}};

/* ---- the radial polynomial ---- */

/* Number of terms that are radial. */
static int radial_terms(const struct lens *l)
{
    return l->model == LENS_OPENCV_FISHEYE ? 4
           : l->model == LENS_OPENCV       ? 2
                                           : MODEL[l->model].terms;
}

/* Factor 1 + k1 r^2 + ... and the derivative of r times it. */
static double radial_factor(const struct lens *l, double r2, double *slope)
{
    double factor = 1, power = 1;
    *slope = 1;
    for (int i = 0; i < radial_terms(l); i++) {
        power *= r2;
        factor += l->term[i] * power;
        *slope += (2 * i + 3) * l->term[i] * power;
    }
    return factor;
}

static double slope_at(const struct lens *l, double r)
{
    double slope;
    (void)radial_factor(l, r * r, &slope);
    return slope;
}

static double find_limit(const struct lens *l)
{
    const double end = l->model == LENS_OPENCV_FISHEYE ? NUM_PI : RADIUS_MAX;
    double low = 0;
    for (int i = 1; i <= STEPS; i++) {
        double high = end * i / STEPS;
        if (slope_at(l, high) > LEAST_SLOPE) {
            low = high;
            continue;
        }
        for (int k = 0; k < NEWTON; k++) {
            double middle = (low + high) / 2;
            *(slope_at(l, middle) > LEAST_SLOPE ? &low : &high) = middle;
        }
        return low;
    }
    return end;
}

err_t lens_init(struct lens *l)
{
    const double all[LENS_PARAMS] = {l->fx,      l->fy,      l->cx,      l->cy,
                                     l->term[0], l->term[1], l->term[2], l->term[3]};
    for (int i = 0; i < LENS_PARAMS; i++)
        if (!isfinite(all[i]))
            return err_fail(ERR_ARG, "lens %s: parameter %d is not finite", MODEL[l->model].name,
                            i);
    if (!(l->fx > 0) || !(l->fy > 0))
        return err_fail(ERR_ARG, "lens %s: focal lengths %g and %g px are not positive",
                        MODEL[l->model].name, l->fx, l->fy);
    l->limit = find_limit(l);
    return OK;
}

/* ---- from rays to pixels ---- */

/* Distorted coordinates of x = X/Z, y = Y/Z, and their derivatives by x and y (j, 2 x 2) and by the
 * terms (d, 2 x 4). */
static void distort_point(const struct lens *l, const double x[2], double out[2], double j[4],
                          double d[2 * LENS_TERMS])
{
    const double r2 = x[0] * x[0] + x[1] * x[1];
    double slope, factor = radial_factor(l, r2, &slope), by_r2 = 0, power = 1;
    memset(d, 0, 2 * LENS_TERMS * sizeof *d);
    for (int i = 0; i < radial_terms(l); i++) {
        by_r2 += (i + 1) * l->term[i] * power;
        power *= r2;
        d[i] = x[0] * power;
        d[LENS_TERMS + i] = x[1] * power;
    }
    for (int i = 0; i < 2; i++) {
        out[i] = x[i] * factor;
        for (int k = 0; k < 2; k++)
            j[2 * i + k] = 2 * x[i] * x[k] * by_r2 + (i == k ? factor : 0);
    }
    if (l->model != LENS_OPENCV)
        return;
    const double p1 = l->term[2], p2 = l->term[3], xy = 2 * x[0] * x[1];
    const double a = r2 + 2 * x[0] * x[0], b = r2 + 2 * x[1] * x[1];
    out[0] += p1 * xy + p2 * a;
    out[1] += p1 * b + p2 * xy;
    j[0] += 2 * p1 * x[1] + 6 * p2 * x[0];
    j[1] += 2 * p1 * x[0] + 2 * p2 * x[1];
    j[2] += 2 * p1 * x[0] + 2 * p2 * x[1];
    j[3] += 6 * p1 * x[1] + 2 * p2 * x[0];
    d[2] = d[LENS_TERMS + 3] = xy;
    d[3] = a;
    d[LENS_TERMS + 2] = b;
}

/* Distorted coordinates of a ray, their derivatives by the ray (2 x 3) and by the terms (2 x 4). */
static bool distort_perspective(const struct lens *l, const double ray[3], double out[2],
                                double by_ray[6], double by_term[2 * LENS_TERMS])
{
    const double x[2] = {ray[0] / ray[2], ray[1] / ray[2]};
    double j[4];
    if (!(ray[2] > 0) || !(hypot(x[0], x[1]) <= l->limit))
        return false;
    distort_point(l, x, out, j, by_term);
    for (int i = 0; i < 2; i++) {
        by_ray[3 * i] = j[2 * i] / ray[2];
        by_ray[3 * i + 1] = j[2 * i + 1] / ray[2];
        by_ray[3 * i + 2] = -(j[2 * i] * x[0] + j[2 * i + 1] * x[1]) / ray[2];
    }
    return j[0] * j[3] > j[1] * j[2]; // tangential terms fold the edge
}

static bool distort_fisheye(const struct lens *l, const double ray[3], double out[2],
                            double by_ray[6], double by_term[2 * LENS_TERMS])
{
    const double rho2 = ray[0] * ray[0] + ray[1] * ray[1], rho = sqrt(rho2);
    const double len2 = rho2 + ray[2] * ray[2], angle = atan2(rho, ray[2]);
    double slope, factor = radial_factor(l, angle * angle, &slope), power = angle;
    if (!(len2 > 0) || !(angle <= l->limit) || (rho == 0 && ray[2] <= 0))
        return false;
    /* out = ray g with g = angle factor / rho; near the axis g = 1 / z */
    const bool axis = rho < 1e-9 * fabs(ray[2]);
    const double g = axis ? 1 / ray[2] : angle * factor / rho;
    const double by_rho = axis ? 0 : (slope * ray[2] / len2 - g) / rho2; // d g / d x_i = x_i by_rho
    const double by_z = -slope / len2;                                   // d g / d z
    for (int i = 0; i < 2; i++) {
        out[i] = ray[i] * g;
        for (int k = 0; k < 2; k++)
            by_ray[3 * i + k] = ray[i] * ray[k] * by_rho + (i == k ? g : 0);
        by_ray[3 * i + 2] = ray[i] * by_z;
    }
    for (int i = 0; i < LENS_TERMS; i++) {
        power *= angle * angle;
        by_term[i] = axis ? 0 : ray[0] / rho * power;
        by_term[LENS_TERMS + i] = axis ? 0 : ray[1] / rho * power;
    }
    return true;
}

bool lens_project_grad(const struct lens *l, const double ray[3], double pixel[2], double by_ray[6],
                       double by_param[2 * LENS_PARAMS])
{
    double x[2], by_term[2 * LENS_TERMS];
    const double f[2] = {l->fx, l->fy}, c[2] = {l->cx, l->cy};
    bool there = l->model == LENS_OPENCV_FISHEYE ? distort_fisheye(l, ray, x, by_ray, by_term)
                                                 : distort_perspective(l, ray, x, by_ray, by_term);
    if (!there || !isfinite(x[0]) || !isfinite(x[1]))
        return false;
    memset(by_param, 0, 2 * LENS_PARAMS * sizeof *by_param);
    for (int i = 0; i < 2; i++) {
        double *row = by_param + LENS_PARAMS * i;
        pixel[i] = f[i] * x[i] + c[i];
        for (int k = 0; k < 3; k++)
            by_ray[3 * i + k] *= f[i];
        row[i] = x[i];
        row[2 + i] = 1;
        for (int k = 0; k < MODEL[l->model].terms; k++)
            row[4 + k] = f[i] * by_term[LENS_TERMS * i + k];
    }
    return true;
}

bool lens_project(const struct lens *l, const double ray[3], double pixel[2])
{
    double by_ray[6], by_param[2 * LENS_PARAMS];
    return lens_project_grad(l, ray, pixel, by_ray, by_param);
}

/* ---- from pixels to rays ---- */

/* r with r factor(r) = s, inside the limit; negative if there is none. */
static double invert_radial(const struct lens *l, double s)
{
    double slope, low = 0, high = l->limit, r = fmin(s, high);
    if (s > high * radial_factor(l, high * high, &slope))
        return -1;
    for (int i = 0; i < NEWTON; i++) {
        double error = r * radial_factor(l, r * r, &slope) - s;
        if (fabs(error) <= CONVERGED * (1 + s))
            break;
        *(error > 0 ? &high : &low) = r;
        double next = r - error / slope;
        r = next > low && next < high ? next : (low + high) / 2;
    }
    return r;
}

/* x whose distorted coordinates are `to`, from a start near it. */
static bool invert_tangential(const struct lens *l, const double to[2], double x[2])
{
    double got[2], j[4], d[2 * LENS_TERMS];
    for (int i = 0; i < NEWTON; i++) {
        distort_point(l, x, got, j, d);
        const double e[2] = {got[0] - to[0], got[1] - to[1]}, det = j[0] * j[3] - j[1] * j[2];
        if (!(det > 0))
            return false;
        if (hypot(e[0], e[1]) <= CONVERGED * (1 + hypot(to[0], to[1])))
            return hypot(x[0], x[1]) <= l->limit;
        x[0] -= (j[3] * e[0] - j[1] * e[1]) / det;
        x[1] -= (j[0] * e[1] - j[2] * e[0]) / det;
    }
    return hypot(x[0], x[1]) <= l->limit &&
           hypot(got[0] - to[0], got[1] - to[1]) <= INVERSE * (1 + hypot(to[0], to[1]));
}

bool lens_unproject(const struct lens *l, const double pixel[2], double ray[3])
{
    const double to[2] = {(pixel[0] - l->cx) / l->fx, (pixel[1] - l->cy) / l->fy};
    const double s = hypot(to[0], to[1]), r = invert_radial(l, s);
    double x[2];
    if (!(r >= 0) && l->model != LENS_OPENCV)
        return false;
    if (l->model == LENS_OPENCV_FISHEYE) {
        const double share = s > 0 ? sin(r) / s : 1;
        ray[0] = to[0] * share;
        ray[1] = to[1] * share;
        ray[2] = cos(r);
        return true;
    }
    for (int i = 0; i < 2; i++)
        x[i] = s > 0 ? to[i] / s * (r >= 0 ? r : l->limit) : 0;
    if (l->model == LENS_OPENCV && !invert_tangential(l, to, x))
        return false;
    const double len = sqrt(1 + x[0] * x[0] + x[1] * x[1]);
    ray[0] = x[0] / len;
    ray[1] = x[1] / len;
    ray[2] = 1 / len;
    return true;
}

/* ---- names and parameters ---- */

const char *lens_name(enum lens_model m)
{
    return MODEL[m].name;
}

enum lens_model lens_find(const char *name)
{
    int m = 0;
    while (m < LENS_MODELS && strcmp(MODEL[m].name, name) != 0)
        m++;
    return (enum lens_model)m;
}

int lens_count(enum lens_model m)
{
    return MODEL[m].focal + 2 + MODEL[m].terms;
}

int lens_params(const struct lens *l, double *values)
{
    int n = 0;
    values[n++] = l->fx;
    if (MODEL[l->model].focal == 2)
        values[n++] = l->fy;
    values[n++] = l->cx;
    values[n++] = l->cy;
    for (int i = 0; i < MODEL[l->model].terms; i++)
        values[n++] = l->term[i];
    return n;
}

err_t lens_from_params(enum lens_model m, const double *values, int n, struct lens *out)
{
    const int focal = MODEL[m].focal, want = lens_count(m);
    if (n != want)
        return err_fail(ERR_FORMAT, "lens %s has %d parameters, not %d", MODEL[m].name, want, n);
    *out = (struct lens){m, values[0], values[focal - 1], values[focal], values[focal + 1], {0}, 0};
    for (int i = 0; i < MODEL[m].terms; i++)
        out->term[i] = values[focal + 2 + i];
    return lens_init(out);
}

bool lens_distorts(const struct lens *l)
{
    bool any = l->model == LENS_OPENCV_FISHEYE;
    for (int i = 0; i < LENS_TERMS; i++)
        any = any || l->term[i] != 0;
    return any;
}

void lens_scale(struct lens *l, double x, double y)
{
    l->fx *= x;
    l->cx *= x;
    l->fy *= y;
    l->cy *= y;
}

/* x becomes -y and y becomes x; the tangential terms are the vector (p2, p1). */
void lens_turn(struct lens *l, double h)
{
    const struct lens old = *l;
    l->fx = old.fy;
    l->fy = old.fx;
    l->cx = h - old.cy;
    l->cy = old.cx;
    if (l->model == LENS_OPENCV) {
        l->term[3] = -old.term[2];
        l->term[2] = old.term[3];
    }
}
