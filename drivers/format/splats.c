/* A reflection of axes D = diag(+-1) turns R S S R^T into (D R D) S S (D R D)^T: the quaternion's x
 * belongs to the product of the signs of y and z, and so on. A harmonic is odd or even in each
 * coordinate (sh_body.h has the polynomials). */
#include "drivers/format/splats.h"

#include "core/base/num.h"
#include "core/splat/display.h"
#include "drivers/format/file.h"

#include <math.h>
#include <string.h>

err_t splats_peek(const struct splats_format *f, const char *path, struct splats_info *out)
{
    struct file_map m;
    memset(out, 0, sizeof *out);
    err_t e = file_map(path, f->bytes_max, &m);
    if (e)
        return e;
    e = f->peek(&(struct splats_bytes){path, m.p, m.n}, out);
    file_unmap(&m);
    return e;
}

err_t splats_read(const struct splats_format *f, const char *path, float ev, struct arena *a,
                  struct gaussians *g, struct gaussians_report *report)
{
    struct file_map m;
    memset(g, 0, sizeof *g);
    err_t e = file_map(path, f->bytes_max, &m);
    if (e)
        return e;
    e = f->parse(&(struct splats_bytes){path, m.p, m.n}, ev, a, g, report);
    file_unmap(&m);
    return e;
}

err_t splats_check_finite(const char *path, const struct gaussians *g)
{
    for (int p = 0; p < gaussians_planes(g->degree); p++)
        for (int i = 0; i < g->n; i++)
            if (!isfinite(g->plane[p][i]))
                return err_fail(ERR_ARG, "%s: splat %d of %d: plane %d is %g, not finite", path, i,
                                g->n, p, (double)g->plane[p][i]);
    return OK;
}

err_t splats_check(const char *path, const struct gaussians *g)
{
    err_t e = splats_check_finite(path, g);
    for (int i = 0; i < g->n && !e; i++) {
        float longest = 0;
        for (int k = 0; k < 4; k++)
            longest = fmaxf(longest, fabsf(g->plane[G_QUAT + k][i]));
        if (!(longest > 0))
            e = err_fail(ERR_ARG, "%s: splat %d of %d: quaternion of length 0", path, i, g->n);
    }
    return e;
}

int splats_sign(int plane, unsigned axes)
{
    enum { X = 1, Y = 2, Z = 4 };
    static const unsigned char odd_geometry[G_SH] = {X, Y, Z, 0, 0, 0, 0, Y | Z, X | Z, X | Y, 0};
    static const unsigned char odd[SH_COEFS_MAX] = {
        0,     Y,         Z,     X,     X | Y, Y | Z, 0, X | Z, 0, // bands 0 to 2
        Y,     X | Y | Z, Y,     Z,     X,     Z,     X,           // 3
        X | Y, Y | Z,     X | Y, Y | Z, 0,     X | Z, 0, X | Z, 0};
    unsigned set = axes & (plane < G_SH ? odd_geometry[plane] : odd[(plane - G_SH) / 3]);
    return (set ^ set >> 1 ^ set >> 2) & 1 ? -1 : 1;
}

float splats_log_scale(float length)
{
    return isfinite(length) ? fmaxf((float)log((double)length), GAUSSIANS_LOG_SCALE_MIN) : NAN;
}

float splats_logit(int byte)
{
    return (float)num_logit(fmin(fmax(byte, 0.25), 254.75) / 255);
}

float splats_colour(int byte)
{
    return (float)((byte / 255.0 - 0.5) / SH_BASIS0);
}

void splats_to_radiance(struct gaussians *g, float ev)
{
    int planes = gaussians_planes(g->degree) - G_SH;
    for (int i = 0; i < g->n; i++) {
        float f[3 * SH_COEFS_MAX], out[3 * SH_COEFS_MAX];
        for (int j = 0; j < planes; j++)
            f[j] = g->plane[G_SH + j][i];
        display_to_radiance(f, g->degree, ev, out);
        for (int j = 0; j < planes; j++)
            g->plane[G_SH + j][i] = out[j];
    }
}
