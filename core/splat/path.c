/* Point of convergence: least squares over all axes of the distance to the lines c + s a,
 * sum (I - a a^T) (p - c) = 0.
 * Way through the cameras: Catmull-Rom as the pyramid of P. J. Barry and R. N. Goldman (SIGGRAPH
 * 1988), its knots apart as cameras are, and its six interpolations lines for centres and great
 * arcs for rotations (J. Schlag, Graphics Gems II, 1991): centres and rotations turn without a
 * kink. */
#include "core/splat/path.h"

#include "core/base/rotation.h"
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

static void camera_row(const struct camera *cam, int i, double out[3])
{
    float r[9];
    rotation_from_unit(cam->q, r);
    for (int k = 0; k < 3; k++)
        out[k] = (double)r[3 * i + k];
}

void path_axis(const struct camera *cam, double axis[3])
{
    camera_row(cam, 2, axis);
}

int path_nearest(const struct camera *cams, int n, const struct camera *to)
{
    double c0[3], a0[3], best_distance = INFINITY, best_cos = -2;
    int best = 0;
    rotation_centre(to, c0);
    path_axis(to, a0);
    for (int i = 0; i < n; i++) {
        double c[3], a[3];
        rotation_centre(&cams[i], c);
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
static bool find_convergence(const struct camera *cams, int n, double p[3])
{
    double m[9] = {0}, b[3] = {0};
    for (int i = 0; i < n; i++) {
        double a[3], c[3];
        path_axis(&cams[i], a);
        rotation_centre(&cams[i], c);
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
        rotation_centre(&cams[i], c);
        if (dot(a, p) <= dot(a, c))
            return false;
    }
    return true;
}

struct spread {
    double centre[3], right[3], down[3], axis[3]; // mean frame of the cameras, orthonormal
    double across, along; // standard deviation of the centres along right and down
};

static void measure_spread(const struct camera *cams, int n, struct spread *s)
{
    memset(s, 0, sizeof *s);
    for (int i = 0; i < n; i++) {
        double c[3], a[3], y[3];
        rotation_centre(&cams[i], c);
        path_axis(&cams[i], a);
        camera_row(&cams[i], 1, y);
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
        camera_row(&cams[0], 0, s->right);
    cross(s->axis, s->right, s->down);
    (void)normalise(s->down);
    for (int i = 0; i < n; i++) {
        double c[3];
        rotation_centre(&cams[i], c);
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
    measure_spread(cams, n_cams, &s);
    if (!find_convergence(cams, n_cams, p))
        for (int k = 0; k < 3; k++)
            p[k] = s.centre[k] + far * s.axis[k];
    double turn = 6.283185307179586 * i / n;
    for (int k = 0; k < 3; k++)
        eye[k] = s.centre[k] + cos(turn) * s.across * s.right[k] + sin(turn) * s.along * s.down[k];
    *out = cams[0];
    look_at(eye, p, s.down, out);
}

/* ---- through the cameras ---- */

#define STOP_SHARE 0.1 // times the mean step: nearer cameras are one stop

struct pose {
    double c[3], q[4]; // centre; rotation as in struct camera
};

static struct pose pose_of(const struct camera *cam)
{
    struct pose p;
    rotation_centre(cam, p.c);
    for (int k = 0; k < 4; k++)
        p.q[k] = (double)cam->q[k];
    return p;
}

/* Angle between unit vectors, 0..pi; exact for small ones too. */
static double quaternion_angle(const double a[4], const double b[4])
{
    double minus = 0, plus = 0;
    for (int k = 0; k < 4; k++) {
        minus += (a[k] - b[k]) * (a[k] - b[k]);
        plus += (a[k] + b[k]) * (a[k] + b[k]);
    }
    return 2 * atan2(sqrt(minus), sqrt(plus));
}

/* The line and the great arc from a (u = 0) to b (u = 1), and beyond. */
static struct pose pose_between(const struct pose *a, const struct pose *b, double u)
{
    struct pose out;
    double angle = quaternion_angle(a->q, b->q), s = sin(angle);
    bool turns = s > 1e-9;
    for (int k = 0; k < 4; k++)
        out.q[k] =
            turns ? (sin((1 - u) * angle) * a->q[k] + sin(u * angle) * b->q[k]) / s : a->q[k];
    for (int k = 0; k < 3; k++)
        out.c[k] = a->c[k] + u * (b->c[k] - a->c[k]);
    return out;
}

/* The one of the two quaternions of b's rotation that is nearer to a's. */
static void align_pose(const struct pose *a, struct pose *b)
{
    double cosine = 0;
    for (int k = 0; k < 4; k++)
        cosine += a->q[k] * b->q[k];
    for (int k = 0; k < 4; k++)
        b->q[k] *= cosine < 0 ? -1 : 1;
}

/* How far the picture of something at `far` moves from a to b, radians. */
static double picture_step(const struct camera *a, const struct camera *b, double far)
{
    struct pose p = pose_of(a), q = pose_of(b);
    double square = 0;
    align_pose(&p, &q);
    for (int k = 0; k < 3; k++)
        square += (p.c[k] - q.c[k]) * (p.c[k] - q.c[k]);
    return sqrt(square) / far + 2 * quaternion_angle(p.q, q.q);
}

struct way {
    const struct camera *cams;
    int n;
    double far, apart; // apart: the least step between two stops
};

/* The stop behind camera a, -1 if there is none; *h is the step there. */
static int next_stop(const struct way *w, int a, double *h)
{
    for (int b = a + 1; b < w->n; b++) {
        *h = picture_step(w->cams + a, w->cams + b, w->far);
        if (*h > w->apart)
            return b;
    }
    return -1;
}

/* At t in 0..h[1] between p[1] and p[2]; h: steps between the four. */
static struct pose pyramid_pose(const struct pose p[4], const double h[3], double t)
{
    struct pose a0 = pose_between(p, p + 1, 1 + t / h[0]),
                a1 = pose_between(p + 1, p + 2, t / h[1]),
                a2 = pose_between(p + 2, p + 3, (t - h[1]) / h[2]),
                b0 = pose_between(&a0, &a1, (t + h[0]) / (h[0] + h[1])),
                b1 = pose_between(&a1, &a2, t / (h[1] + h[2]));
    return pose_between(&b0, &b1, t / h[1]);
}

static double way_length(const struct way *w)
{
    double sum = 0, h = 0;
    for (int a = 0; (a = next_stop(w, a, &h)) >= 0;)
        sum += h;
    return sum;
}

/* Put the first of two cameras at `p`, its lens on the way to that of the second. */
static void place_camera(const struct camera *second, double share, struct pose p,
                         struct camera *cam)
{
    const float u = (float)share;
    cam->fx += u * (second->fx - cam->fx);
    cam->fy += u * (second->fy - cam->fy);
    cam->cx += u * (second->cx - cam->cx);
    cam->cy += u * (second->cy - cam->cy);
    for (int k = 0; k < 4; k++)
        cam->q[k] = (float)p.q[k];
    for (int k = 0; k < 3; k++) {
        double r[3];
        camera_row(cam, k, r);
        cam->t[k] = (float)-dot(r, p.c);
    }
}

void path_through(const struct camera *cams, int n_cams, double far, double u, struct camera *out)
{
    struct way w = {cams, n_cams, far, 0};
    w.apart = STOP_SHARE * way_length(&w) / n_cams;
    double t = u * way_length(&w), h[3] = {0};
    int before = -1, a = 0, b = next_stop(&w, 0, &h[1]);
    while (b >= 0 && t > h[1]) {
        t -= h[1];
        h[0] = h[1];
        before = a;
        a = b;
        b = next_stop(&w, a, &h[1]);
    }
    *out = cams[a];
    if (b < 0)
        return;
    int after = next_stop(&w, b, &h[2]);
    struct pose p[4] = {pose_of(cams + (before < 0 ? a : before)), pose_of(cams + a),
                        pose_of(cams + b), pose_of(cams + (after < 0 ? b : after))};
    for (int k = 0; k < 3; k++)
        align_pose(p + k, p + k + 1);
    if (before < 0) { // as if there were one before the first
        p[0] = pose_between(p + 1, p + 2, -1);
        h[0] = h[1];
    }
    if (after < 0) {
        p[3] = pose_between(p + 1, p + 2, 2);
        h[2] = h[1];
    }
    place_camera(cams + b, t / h[1], pyramid_pose(p, h, t), out);
}
