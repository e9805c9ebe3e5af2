#include "core/base/shell.h"

#include "core/base/rotation.h"

#include <math.h>

struct shell shell_of(const struct camera *cams, int n)
{
    struct shell s = {.radius = 0};
    double middle[3] = {0}, c[3], most = 0;
    for (int i = 0; i < n; i++) {
        rotation_centre(&cams[i], c);
        for (int k = 0; k < 3; k++)
            middle[k] += c[k] / n;
    }
    for (int i = 0; i < n; i++) {
        double d2 = 0;
        rotation_centre(&cams[i], c);
        for (int k = 0; k < 3; k++)
            d2 += (c[k] - middle[k]) * (c[k] - middle[k]);
        most = fmax(most, sqrt(d2));
    }
    const double radius = (double)SHELL_FAR * most;
    for (int k = 0; k < 3; k++)
        s.middle[k] = (float)middle[k];
    s.radius = radius > 0 && radius < 1e30 ? (float)radius : 0;
    return s;
}

bool shell_has(const struct shell *s, const float point[3])
{
    double d2 = 0;
    for (int k = 0; k < 3; k++)
        d2 += ((double)point[k] - (double)s->middle[k]) * ((double)point[k] - (double)s->middle[k]);
    return s->radius > 0 && sqrt(d2) > 0.5 * (double)s->radius;
}

/* |ray z - m| = radius for the middle m in the coordinates of the camera. */
float shell_depth(const struct shell *s, const struct camera *cam, float u, float v)
{
    const double ray[3] = {((double)u - (double)cam->cx) / (double)cam->fx,
                           ((double)v - (double)cam->cy) / (double)cam->fy, 1};
    double r[9], rr = 0, rm = 0, mm = 0;
    rotation_of_camera(cam, r);
    for (int i = 0; i < 3; i++) {
        double m = (double)cam->t[i];
        for (int k = 0; k < 3; k++)
            m += r[3 * i + k] * (double)s->middle[k];
        rr += ray[i] * ray[i];
        rm += ray[i] * m;
        mm += m * m;
    }
    const double radius = (double)s->radius;
    return (float)((rm + sqrt(fmax(rm * rm - rr * (mm - radius * radius), 0))) / rr);
}
