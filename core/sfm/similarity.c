#include "core/sfm/similarity.h"

#include "core/base/num.h"
#include "core/base/rotation.h"

#include <math.h>

/* ---- scale ---- */

static double centre_distance(const struct camera *a, const struct camera *b)
{
    double p[3], q[3];
    rotation_centre(a, p);
    rotation_centre(b, q);
    return sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) +
                (p[2] - q[2]) * (p[2] - q[2]));
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

/* Add the rotation between the worlds by one camera, with the sign of q nearest to the sum. */
static void add_rotation(const struct camera *from, const struct camera *to, double sum[4])
{
    const double a[4] = {(double)to->q[0], -(double)to->q[1], -(double)to->q[2], -(double)to->q[3]};
    const double b[4] = {(double)from->q[0], (double)from->q[1], (double)from->q[2],
                         (double)from->q[3]};
    double q[4], side = 0;
    rotation_multiply(a, b, q);
    for (int k = 0; k < 4; k++)
        side += q[k] * sum[k];
    for (int k = 0; k < 4; k++)
        sum[k] += side < 0 ? -q[k] : q[k];
}

err_t similarity_fit(const struct run *r, const struct camera *from, const struct camera *to,
                     int n_views, struct similarity *out)
{
    float scale;
    double length = 0;
    err_t e = similarity_scale(r, from, to, n_views, &scale);
    *out = (struct similarity){.scale = (double)scale};
    for (int i = 0; i < n_views; i++)
        add_rotation(&from[i], &to[i], out->q);
    for (int k = 0; k < 4; k++)
        length += out->q[k] * out->q[k];
    for (int k = 0; k < 4; k++)
        out->q[k] = length > 0 ? out->q[k] / sqrt(length) : k == 0;
    for (int i = 0; i < n_views; i++) {
        double a[3], b[3], turned[3];
        rotation_centre(&from[i], a);
        rotation_centre(&to[i], b);
        rotate_vector(out->q, a, turned);
        for (int k = 0; k < 3; k++)
            out->t[k] += (b[k] - out->scale * turned[k]) / n_views;
    }
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
