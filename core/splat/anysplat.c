#include "core/splat/anysplat.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"

#include <math.h>
#include <string.h>

static const float DARKEST = 1.0f / 512; // display value

void anysplat_radiance(struct gaussians *g)
{
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < g->n; i++) {
            float mean = g->plane[G_SH + c][i] * (float)SH_BASIS0 + 0.5f;
            float gain = mean > DARKEST ? 1 / mean : 0; // by d ln v = d v / v
            g->plane[G_SH + c][i] = logf(fmaxf(mean, DARKEST)) / (float)SH_BASIS0;
            for (int p = G_SH + 3 + c; p < gaussians_planes(g->degree); p += 3)
                g->plane[p][i] *= gain;
        }
}

/* log2 of the display value v at knot k. The error of a line between knots is as large everywhere
 * if they are equally far apart in sqrt(1 - v); here from v = 0.001 to 0.999. */
static double curve_knot(int k)
{
    const double first = 0.9995, last = 1.0 / 32;
    double s = first + (last - first) * k / (TONE_HIDDEN - 1);
    return log2(1 - s * s);
}

void anysplat_curve(float mid_log2t, struct tonemap *out)
{
    memset(out, 0, sizeof *out);
    out->mid_log2t = mid_log2t;
    for (int c = 0; c < 3; c++) {
        float *p = out->p + c * TONE_PER_COLOUR;
        double before = 0;
        for (int k = 0; k < TONE_HIDDEN; k++) {
            double x = curve_knot(k), next = curve_knot(k + 1);
            double slope = k + 1 < TONE_HIDDEN
                               ? (num_logit(exp2(next)) - num_logit(exp2(x))) / (next - x)
                               : before; // beyond the last knot: on as before
            p[k] = 1;
            p[TONE_HIDDEN + k] = (float)-x;
            p[2 * TONE_HIDDEN + k] = (float)(slope - before);
            before = slope;
        }
        p[3 * TONE_HIDDEN] = (float)num_logit(exp2(curve_knot(0)));
    }
}
