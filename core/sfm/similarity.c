#include "core/sfm/similarity.h"

#include "core/base/num.h"
#include "core/base/rotation.h"

#include <math.h>

/* ---- scale ---- */

static double distance(const double p[3], const double q[3])
{
    return sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) +
                (p[2] - q[2]) * (p[2] - q[2]));
}

static double centre_distance(const struct camera *a, const struct camera *b)
{
    double p[3], q[3];
    rotation_centre(a, p);
    rotation_centre(b, q);
    return distance(p, q);
}

static err_t layout(float **ratio, struct arena *tmp, int n_views)
{
    const size_t n = (size_t)n_views, pairs = n_views > 0 ? n * (n - 1) / 2 : 0;
    return arena_alloc(tmp, pairs, sizeof **ratio, ratio);
}

size_t similarity_plan(int n_views)
{
    struct arena tmp = arena_counter();
    float *ratio;
    return layout(&ratio, &tmp, n_views) ? SIZE_MAX : tmp.peak;
}

err_t similarity_scale(const struct run *r, const struct camera *from, const struct camera *to,
                       int n_views, float *out)
{
    size_t mark = arena_mark(r->tmp), n = 0;
    float *ratio;
    *out = 1.0f;
    err_t e = layout(&ratio, r->tmp, n_views);
    if (e)
        return e;
    for (int i = 0; i < n_views; i++)
        for (int j = 0; j < i; j++) {
            double a = centre_distance(&from[i], &from[j]), b = centre_distance(&to[i], &to[j]);
            if (a > 0 && b > 0 && isnormal((float)(b / a)))
                ratio[n++] = (float)(b / a);
        }
    if (n > 0)
        *out = num_median(ratio, n);
    arena_reset(r->tmp, mark);
    return OK;
}

/* ---- similarity ---- */

static void conjugate(const double q[4], double out[4])
{
    out[0] = q[0];
    for (int k = 1; k < 4; k++)
        out[k] = -q[k];
}

static void rotate_vector(const double q[4], const double x[3], double out[3])
{
    const double v[4] = {0, x[0], x[1], x[2]};
    double back[4], half[4], full[4];
    conjugate(q, back);
    rotation_multiply(q, v, half);
    rotation_multiply(half, back, full);
    for (int k = 0; k < 3; k++)
        out[k] = full[k + 1];
}

/* The rotation between the worlds by one camera. */
static void rotation_by(const struct camera *from, const struct camera *to, double q[4])
{
    const double a[4] = {(double)to->q[0], -(double)to->q[1], -(double)to->q[2], -(double)to->q[3]};
    const double b[4] = {(double)from->q[0], (double)from->q[1], (double)from->q[2],
                         (double)from->q[3]};
    rotation_multiply(a, b, q);
}

static double dot4(const double a[4], const double b[4])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
}

/* The translation between the worlds by one camera. */
static void translation_by(const struct similarity *w, const struct camera *from,
                           const struct camera *to, double t[3])
{
    double a[3], b[3], turned[3];
    rotation_centre(from, a);
    rotation_centre(to, b);
    rotate_vector(w->q, a, turned);
    for (int k = 0; k < 3; k++)
        t[k] = b[k] - w->scale * turned[k];
}

static double angle_off(const struct similarity *w, const struct camera *from,
                        const struct camera *to)
{
    double q[4];
    rotation_by(from, to, q);
    return 2 * acos(fmin(1, fabs(dot4(q, w->q)) / sqrt(fmax(dot4(q, q), 1e-30))));
}

static double distance_off(const struct similarity *w, const struct camera *from,
                           const struct camera *to)
{
    double t[3];
    translation_by(w, from, to, t);
    return distance(t, w->t);
}

/* Means of rotation and translation by weights of 1 over what was off before, which find the point
 * with the least sum of distances (Weiszfeld): a few wrong cameras move it little. */
static void fit_rotation(const struct camera *from, const struct camera *to, int n,
                         struct similarity *io, double least)
{
    double sum[4] = {0};
    for (int i = 0; i < n; i++) {
        double q[4];
        rotation_by(&from[i], &to[i], q);
        const double weight = least > 0 ? 1 / (angle_off(io, &from[i], &to[i]) + least) : 1;
        for (int k = 0, side = dot4(q, sum) < 0 ? -1 : 1; k < 4; k++)
            sum[k] += side * weight * q[k];
    }
    const double length = sqrt(dot4(sum, sum));
    for (int k = 0; k < 4; k++)
        io->q[k] = length > 0 ? sum[k] / length : k == 0;
}

static void fit_translation(const struct camera *from, const struct camera *to, int n,
                            struct similarity *io, double least)
{
    double sum[3] = {0}, total = 0;
    for (int i = 0; i < n; i++) {
        double t[3];
        translation_by(io, &from[i], &to[i], t);
        const double weight = least > 0 ? 1 / (distance_off(io, &from[i], &to[i]) + least) : 1;
        total += weight;
        for (int k = 0; k < 3; k++)
            sum[k] += weight * t[k];
    }
    for (int k = 0; k < 3; k++)
        io->t[k] = sum[k] / total;
}

/* The mean, then that by what each camera is off, again and again. */
static void
settle(void (*fit)(const struct camera *, const struct camera *, int, struct similarity *, double),
       double (*off)(const struct similarity *, const struct camera *, const struct camera *),
       const struct camera *from, const struct camera *to, int n, struct similarity *io)
{
    enum { ROUNDS = 20 };
    const double share = 0.01; // of the mean, that cannot be told from 0
    fit(from, to, n, io, 0);
    for (int k = 0; k < ROUNDS; k++) {
        double mean = 0;
        for (int i = 0; i < n; i++)
            mean += off(io, &from[i], &to[i]) / n;
        fit(from, to, n, io, share * mean);
    }
}

err_t similarity_fit(const struct run *r, const struct camera *from, const struct camera *to,
                     int n_views, struct similarity *out)
{
    float scale;
    err_t e = similarity_scale(r, from, to, n_views, &scale);
    *out = (struct similarity){.scale = (double)scale};
    settle(fit_rotation, angle_off, from, to, n_views, out);
    settle(fit_translation, distance_off, from, to, n_views, out);
    return e;
}

struct camera similarity_apply(const struct similarity *w, const struct camera *cam)
{
    struct camera out = *cam;
    const double q[4] = {(double)cam->q[0], (double)cam->q[1], (double)cam->q[2],
                         (double)cam->q[3]};
    double away[4], turned[4], centre[3], moved[3], back[3];
    conjugate(w->q, away);
    rotation_multiply(q, away, turned);
    rotation_centre(cam, centre);
    rotate_vector(w->q, centre, moved);
    for (int k = 0; k < 3; k++)
        moved[k] = w->scale * moved[k] + w->t[k];
    rotate_vector(turned, moved, back);
    for (int k = 0; k < 4; k++)
        out.q[k] = (float)turned[k];
    for (int k = 0; k < 3; k++)
        out.t[k] = (float)-back[k];
    return out;
}

void similarity_rotation(const struct camera *from, const struct camera *to, float out[9])
{
    float a[9], b[9];
    rotation_from_unit(from->q, a);
    rotation_from_unit(to->q, b);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = b[i] * a[j] + b[3 + i] * a[3 + j] + b[6 + i] * a[6 + j];
}
