#include "core/stereo/transfer.h"

#include "core/base/rotation.h"

#include <math.h>

void transfer_pose_set(const struct camera *c, struct transfer_pose *p)
{
    rotation_of_camera(c, p->r);
    for (int i = 0; i < 3; i++)
        p->t[i] = (double)c->t[i];
    for (int i = 0; i < 3; i++)
        p->centre[i] = -(p->r[i] * p->t[0] + p->r[3 + i] * p->t[1] + p->r[6 + i] * p->t[2]);
    p->f[0] = (double)c->fx / c->w;
    p->f[1] = (double)c->fy / c->h;
    p->c[0] = (double)c->cx / c->w;
    p->c[1] = (double)c->cy / c->h;
}

void transfer_map(const struct transfer_pose *a, const struct transfer_pose *b,
                  const double size[4], double *h)
{
    double fa[2] = {a->f[0] * size[0], a->f[1] * size[1]};
    double ca[2] = {a->c[0] * size[0], a->c[1] * size[1]};
    double m[12];
    for (int i = 0; i < 3; i++) {
        double r[3], t = b->t[i];
        for (int j = 0; j < 3; j++) {
            r[j] = b->r[3 * i] * a->r[3 * j] + b->r[3 * i + 1] * a->r[3 * j + 1] +
                   b->r[3 * i + 2] * a->r[3 * j + 2];
            t -= r[j] * a->t[j];
        }
        m[4 * i] = r[0] / fa[0];
        m[4 * i + 1] = r[1] / fa[1];
        m[4 * i + 2] = r[2] - r[0] * ca[0] / fa[0] - r[1] * ca[1] / fa[1];
        m[4 * i + 3] = t;
    }
    for (int j = 0; j < 4; j++) {
        h[j] = size[2] * (b->f[0] * m[j] + b->c[0] * m[8 + j]);
        h[4 + j] = size[3] * (b->f[1] * m[4 + j] + b->c[1] * m[8 + j]);
        h[8 + j] = m[8 + j];
    }
}

bool transfer_apply(const double *h, double u, double v, double rho, double *out)
{
    double z = h[8] * u + h[9] * v + h[10] + h[11] * rho;
    if (z < 1e-6)
        return false;
    out[0] = (h[0] * u + h[1] * v + h[2] + h[3] * rho) / z;
    out[1] = (h[4] * u + h[5] * v + h[6] + h[7] * rho) / z;
    out[2] = z;
    return true;
}

double transfer_distance(const struct transfer_pose *a, const struct transfer_pose *b)
{
    double s = 0.0;
    for (int i = 0; i < 3; i++)
        s += (a->centre[i] - b->centre[i]) * (a->centre[i] - b->centre[i]);
    return sqrt(s);
}
