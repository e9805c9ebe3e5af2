/* Rotation vectors by Rodrigues' formula; quaternions of matrices from the largest component
 * (Shepperd 1978). */
#include "core/base/rotation.h"

#include "core/base/lin.h"

#include <math.h>

void rotation_exp(const double w[3], double r[9])
{
    double angle = sqrt(lin_dot(w, w)), s = angle > 1e-9 ? sin(angle / 2) / angle : 0.5;
    const double q[4] = {cos(angle / 2), s * w[0], s * w[1], s * w[2]};
    rotation_from_quat(q, r);
}

void rotation_log(const double r[9], double w[3])
{
    double q[4];
    rotation_to_quat(r, q);
    double s = sqrt(lin_dot(q + 1, q + 1)), angle = 2 * atan2(s, q[0]);
    for (int k = 0; k < 3; k++)
        w[k] = s > 1e-12 ? q[1 + k] / s * angle : 2 * q[1 + k];
}

void rotation_to_quat(const double r[9], double q[4])
{
    const double t[4] = {1 + r[0] + r[4] + r[8], 1 + r[0] - r[4] - r[8], 1 - r[0] + r[4] - r[8],
                         1 - r[0] - r[4] + r[8]};
    int k = 0;
    for (int i = 1; i < 4; i++)
        k = t[i] > t[k] ? i : k;
    const double v[4][4] = {
        {t[0], r[7] - r[5], r[2] - r[6], r[3] - r[1]},
        {r[7] - r[5], t[1], r[1] + r[3], r[2] + r[6]},
        {r[2] - r[6], r[1] + r[3], t[2], r[5] + r[7]},
        {r[3] - r[1], r[2] + r[6], r[5] + r[7], t[3]},
    };
    double len = 0;
    for (int i = 0; i < 4; i++)
        len += v[k][i] * v[k][i];
    len = v[k][0] < 0 ? -sqrt(len) : sqrt(len);
    for (int i = 0; i < 4; i++)
        q[i] = v[k][i] / len;
}

void rotation_from_quat(const double q[4], double r[9])
{
    const double sum = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    const double n = sum > 0 ? 2 / sum : 0;
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    r[0] = 1 - n * (y * y + z * z);
    r[1] = n * (x * y - w * z);
    r[2] = n * (x * z + w * y);
    r[3] = n * (x * y + w * z);
    r[4] = 1 - n * (x * x + z * z);
    r[5] = n * (y * z - w * x);
    r[6] = n * (x * z - w * y);
    r[7] = n * (y * z + w * x);
    r[8] = 1 - n * (x * x + y * y);
}

bool rotation_is(const double r[9], double error)
{
    double off = 0, normal[3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            off = fmax(off, fabs(lin_dot(r + 3 * i, r + 3 * k) - (i == k)));
    lin_cross(r, r + 3, normal);
    for (int i = 0; i < 9; i++) // fmax ignores a NaN
        off = isfinite(r[i]) ? off : INFINITY;
    return off <= error && lin_dot(normal, r + 6) > 0;
}

void rotation_multiply(const double a[4], const double b[4], double out[4])
{
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

void rotation_from_unit(const float q[4], float r[9])
{
    float w = q[0], x = q[1], y = q[2], z = q[3];
    r[0] = 1 - 2 * (y * y + z * z);
    r[1] = 2 * (x * y - w * z);
    r[2] = 2 * (x * z + w * y);
    r[3] = 2 * (x * y + w * z);
    r[4] = 1 - 2 * (x * x + z * z);
    r[5] = 2 * (y * z - w * x);
    r[6] = 2 * (x * z - w * y);
    r[7] = 2 * (y * z + w * x);
    r[8] = 1 - 2 * (x * x + y * y);
}

void rotation_of_camera(const struct camera *cam, double r[9])
{
    const double q[4] = {(double)cam->q[0], (double)cam->q[1], (double)cam->q[2],
                         (double)cam->q[3]};
    rotation_from_quat(q, r);
}

void rotation_centre(const struct camera *cam, double out[3])
{
    float r[9];
    rotation_from_unit(cam->q, r);
    for (int k = 0; k < 3; k++)
        out[k] = -((double)r[k] * (double)cam->t[0] + (double)r[3 + k] * (double)cam->t[1] +
                   (double)r[6 + k] * (double)cam->t[2]);
}

/* By the distance of the quaternions, which says more about small angles than their product. */
double rotation_between(const struct camera *a, const struct camera *b)
{
    double minus = 0, plus = 0;
    for (int k = 0; k < 4; k++) {
        double x = (double)a->q[k], y = (double)b->q[k];
        minus += (x - y) * (x - y);
        plus += (x + y) * (x + y);
    }
    return 4 * asin(fmin(sqrt(fmin(minus, plus)) / 2, 1));
}
