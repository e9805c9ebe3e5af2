/* With A = dL/dR R^T + dL/dt t^T, a rotation by w changes the loss by sum_ij A_ij [w]x_ij, so dL/dw
 * is twice the axial vector of A's antisymmetric part; dL/dv = dL/dt. */
#include "core/sfm/pose.h"

#include "core/base/rotation.h"
#include "core/base/shell.h"

#include <math.h>

enum { HALVINGS = 48 }; // of the range of a coordinate

void pose_twist_grad(const struct camera *c, const float grad[POSE_GRAD], float out[6])
{
    float r[9], a[9];
    rotation_from_unit(c->q, r);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            a[3 * i + j] = grad[9 + i] * c->t[j];
            for (int k = 0; k < 3; k++)
                a[3 * i + j] += grad[3 * i + k] * r[3 * j + k];
        }
    out[0] = a[7] - a[5];
    out[1] = a[2] - a[6];
    out[2] = a[3] - a[1];
    for (int i = 0; i < 3; i++)
        out[3 + i] = grad[9 + i];
}

void pose_move(struct camera *c, const float twist[6])
{
    float sum = 0;
    for (int i = 0; i < 6; i++)
        sum += twist[i];
    if (!isfinite(sum))
        return;
    double angle = sqrt((double)twist[0] * twist[0] + (double)twist[1] * twist[1] +
                        (double)twist[2] * twist[2]);
    double s = angle > 1e-9 ? sin(angle / 2) / angle : 0.5, w = cos(angle / 2);
    double x = s * twist[0], y = s * twist[1], z = s * twist[2];
    const double turn[4] = {w, x, y, z};
    const double b[4] = {(double)c->q[0], (double)c->q[1], (double)c->q[2], (double)c->q[3]};
    double q[4];
    rotation_multiply(turn, b, q);
    double len = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    const float d[4] = {(float)w, (float)x, (float)y, (float)z};
    float r[9], t[3];
    rotation_from_unit(d, r);
    for (int i = 0; i < 3; i++)
        t[i] = r[3 * i] * c->t[0] + r[3 * i + 1] * c->t[1] + r[3 * i + 2] * c->t[2] + twist[3 + i];
    for (int i = 0; i < 3; i++)
        c->t[i] = t[i];
    for (int i = 0; i < 4; i++)
        c->q[i] = (float)(q[i] / len);
}

static const float *mean_of(const struct gaussians *g, int i, float x[3])
{
    for (int k = 0; k < 3; k++)
        x[k] = g->plane[G_MU + k][i];
    return x;
}

/* Of one coordinate of the splats that are not of the shell; by halving, since there is no room to
 * sort them. */
static double median_mean(const struct gaussians *g, const struct shell *shell, int k)
{
    double lo = INFINITY, hi = -INFINITY;
    float x[3];
    for (int i = 0; i < g->n; i++)
        if (!shell_has(shell, mean_of(g, i, x))) {
            lo = fmin(lo, (double)x[k]);
            hi = fmax(hi, (double)x[k]);
        }
    for (int step = 0; step < HALVINGS && lo < hi; step++) {
        const double middle = 0.5 * (lo + hi);
        int more = 0;
        for (int i = 0; i < g->n; i++)
            if (!shell_has(shell, mean_of(g, i, x)))
                more += (double)x[k] > middle ? 1 : -1;
        *(more > 0 ? &lo : &hi) = middle;
    }
    return lo <= hi ? 0.5 * (lo + hi) : 0;
}

float pose_extent(const struct gaussians *g, const struct camera *cams, int n)
{
    const struct shell shell = shell_of(cams, n);
    double c[3], sum = 0;
    for (int k = 0; k < 3; k++)
        c[k] = median_mean(g, &shell, k);
    for (int i = 0; i < n; i++) {
        float r[9];
        double d2 = 0;
        rotation_from_unit(cams[i].q, r);
        for (int k = 0; k < 3; k++) {
            const float *t = cams[i].t;
            double o = -(double)(r[k] * t[0] + r[3 + k] * t[1] + r[6 + k] * t[2]);
            d2 += (o - c[k]) * (o - c[k]);
        }
        sum += sqrt(d2) / n;
    }
    return sum > 0 && isfinite(sum) ? (float)sum : 1.0f;
}

struct camera pose_scaled(const struct camera *c, int w, int h)
{
    struct camera s = *c;
    float ax = (float)w / (float)c->w, ay = (float)h / (float)c->h;
    s.w = w;
    s.h = h;
    s.fx *= ax;
    s.cx *= ax;
    s.fy *= ay;
    s.cy *= ay;
    return s;
}
