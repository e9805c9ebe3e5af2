/* Point of convergence: least squares over all axes of the distance to the lines c + s a,
 * sum (I - a a^T) (p - c) = 0. */
#include "firmware/path.h"

#include "core/splat/raster.h"

#include <math.h>
#include <string.h>

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* False if v has no direction. */
static bool normalise(double v[3])
{
    double n = sqrt(dot(v, v));
    for (int k = 0; k < 3 && n > 1e-12; k++)
        v[k] /= n;
    return n > 1e-12;
}

static void row(const struct camera *cam, int i, double out[3])
{
    float r[9];
    raster_rotation(cam->q, r);
    for (int k = 0; k < 3; k++)
        out[k] = (double)r[3 * i + k];
}

void path_axis(const struct camera *cam, double axis[3])
{
    row(cam, 2, axis);
}

void path_centre(const struct camera *cam, double centre[3])
{
    double x[3], y[3], z[3];
    row(cam, 0, x);
    row(cam, 1, y);
    row(cam, 2, z);
    for (int k = 0; k < 3; k++)
        centre[k] =
            -(x[k] * (double)cam->t[0] + y[k] * (double)cam->t[1] + z[k] * (double)cam->t[2]);
}

int path_nearest(const struct camera *cams, int n, const struct camera *to)
{
    double c0[3], a0[3], best_distance = INFINITY, best_cos = -2;
    int best = 0;
    path_centre(to, c0);
    path_axis(to, a0);
    for (int i = 0; i < n; i++) {
        double c[3], a[3];
        path_centre(&cams[i], c);
        path_axis(&cams[i], a);
        double distance = sqrt((c[0] - c0[0]) * (c[0] - c0[0]) + (c[1] - c0[1]) * (c[1] - c0[1]) +
                               (c[2] - c0[2]) * (c[2] - c0[2]));
        double slack = 1e-4 * best_distance, cosine = dot(a, a0);
        bool nearer = !(distance >= best_distance - slack);
        bool same = distance <= best_distance + slack && cosine > best_cos;
        if (i > 0 && !nearer && !same)
            continue;
        best = i;
        best_distance = distance;
        best_cos = cosine;
    }
    return best;
}

/* Solve the symmetric 3x3 system m p = b by Cramer's rule; false if it is near singular. */
static bool solve3(const double m[9], const double b[3], double p[3])
{
    double c0[3], c1[3], c2[3];
    cross(m + 3, m + 6, c0);
    cross(m + 6, m, c1);
    cross(m, m + 3, c2);
    double det = dot(m, c0), trace = m[0] + m[4] + m[8];
    if (!(fabs(det) > 1e-6 * trace * trace * trace))
        return false;
    for (int k = 0; k < 3; k++)
        p[k] = (c0[k] * b[0] + c1[k] * b[1] + c2[k] * b[2]) / det;
    return true;
}

/* Where the axes converge; false if that is nowhere in front of the cameras. */
static bool convergence(const struct camera *cams, int n, double p[3])
{
    double m[9] = {0}, b[3] = {0};
    for (int i = 0; i < n; i++) {
        double a[3], c[3];
        path_axis(&cams[i], a);
        path_centre(&cams[i], c);
        for (int k = 0; k < 9; k++)
            m[k] += (k % 4 == 0) - a[k / 3] * a[k % 3];
        double along = dot(a, c);
        for (int k = 0; k < 3; k++)
            b[k] += c[k] - a[k] * along;
    }
    if (!solve3(m, b, p))
        return false;
    for (int i = 0; i < n; i++) {
        double a[3], c[3];
        path_axis(&cams[i], a);
        path_centre(&cams[i], c);
        if (dot(a, p) <= dot(a, c))
            return false;
    }
    return true;
}

struct spread {
    double centre[3], right[3], down[3], axis[3]; // mean frame of the cameras, orthonormal
    double across, along; // standard deviation of the centres along right and down
};

static void measure(const struct camera *cams, int n, struct spread *s)
{
    memset(s, 0, sizeof *s);
    for (int i = 0; i < n; i++) {
        double c[3], a[3], y[3];
        path_centre(&cams[i], c);
        path_axis(&cams[i], a);
        row(&cams[i], 1, y);
        for (int k = 0; k < 3; k++) {
            s->centre[k] += c[k] / n;
            s->axis[k] += a[k] / n;
            s->down[k] += y[k] / n;
        }
    }
    if (!normalise(s->axis))
        path_axis(&cams[0], s->axis);
    cross(s->down, s->axis, s->right);
    if (!normalise(s->right))
        row(&cams[0], 0, s->right);
    cross(s->axis, s->right, s->down);
    (void)normalise(s->down);
    for (int i = 0; i < n; i++) {
        double c[3];
        path_centre(&cams[i], c);
        for (int k = 0; k < 3; k++)
            c[k] -= s->centre[k];
        s->across += dot(c, s->right) * dot(c, s->right) / n;
        s->along += dot(c, s->down) * dot(c, s->down) / n;
    }
    s->across = sqrt(s->across);
    s->along = sqrt(s->along);
}

/* Unit quaternion w,x,y,z of the rotation with rows x, y, z (Shepperd's method). */
static void quaternion(const double *const m[3], float q[4])
{
    double t[4] = {1 + m[0][0] + m[1][1] + m[2][2], 1 + m[0][0] - m[1][1] - m[2][2],
                   1 - m[0][0] + m[1][1] - m[2][2], 1 - m[0][0] - m[1][1] + m[2][2]};
    int big = 0;
    for (int k = 1; k < 4; k++)
        big = t[k] > t[big] ? k : big;
    double v[4] = {m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 0};
    double s = 0.5 / sqrt(t[big]);
    if (big == 0) {
        q[0] = (float)(t[0] * s);
        for (int k = 0; k < 3; k++)
            q[k + 1] = (float)(v[k] * s);
        return;
    }
    int a = big - 1;
    q[0] = (float)(v[a] * s);
    for (int k = 0; k < 3; k++)
        q[k + 1] = (float)((k == a ? t[big] : m[a][k] + m[k][a]) * s);
}

/* Turn `cam` at eye to look at p with the image's y axis near `down`. */
static void look_at(const double eye[3], const double p[3], const double down[3],
                    struct camera *cam)
{
    double x[3], y[3], z[3] = {p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]};
    const double *const rows[3] = {x, y, z};
    if (!normalise(z))
        return;
    cross(down, z, x);
    if (!normalise(x))
        return;
    cross(z, x, y);
    quaternion(rows, cam->q);
    for (int k = 0; k < 3; k++)
        cam->t[k] = (float)-dot(rows[k], eye);
}

void path_orbit(const struct camera *cams, int n_cams, double far, int i, int n, struct camera *out)
{
    struct spread s;
    double p[3], eye[3];
    measure(cams, n_cams, &s);
    if (!convergence(cams, n_cams, p))
        for (int k = 0; k < 3; k++)
            p[k] = s.centre[k] + far * s.axis[k];
    double turn = 6.283185307179586 * i / n;
    for (int k = 0; k < 3; k++)
        eye[k] = s.centre[k] + cos(turn) * s.across * s.right[k] + sin(turn) * s.along * s.down[k];
    *out = cams[0];
    look_at(eye, p, s.down, out);
}
