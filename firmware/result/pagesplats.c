#include "firmware/result/pagesplats.h"

#include "core/base/bytes.h"
#include "core/base/gaussians.h"
#include "core/base/half.h"
#include "core/kernels/kernels.h"
#include "core/refine/confidence.h"
#include "core/splat/display.h"

#include <math.h>

#define UNIT_STOPS 24.0

int pagesplats_sh_bytes(int degree)
{
    int halves = 3 * ((degree + 1) * (degree + 1) - 1);
    return (2 * halves + PAGESPLATS_TEXEL - 1) / PAGESPLATS_TEXEL * PAGESPLATS_TEXEL;
}

bool pagesplats_is_drawn(const struct gaussians *g, int i)
{
    float sum = 0;
    for (int p = 0; p < gaussians_planes(g->degree); p++)
        sum += g->plane[p][i] * 0;
    float opacity = 1 / (1 + expf(-g->plane[G_LOGIT][i]));
    return sum == 0 && opacity >= RASTER_ALPHA_MIN;
}

bool pagesplats_is_guess(const struct scene *s, int i)
{
    return s->confidence && s->confidence[i] < CONFIDENCE_GUESS;
}

/* ---- ranges ---- */

struct span {
    double lo, hi;
};

static void widen_span(struct span *s, double v)
{
    s->lo = fmin(s->lo, v);
    s->hi = fmax(s->hi, v);
}

static struct pagesplats_range range_of(const struct span *s, double step)
{
    struct pagesplats_range r = {0};
    if (s->hi >= s->lo)
        r = (struct pagesplats_range){s->lo, fmax((s->hi - s->lo) / UINT16_MAX, step)};
    return r;
}

/* Log radiance that splat i exceeds in no direction: the addition theorem bounds each band. */
static double brightest_radiance(const struct gaussians *g, int i, int degree)
{
    double top = -INFINITY;
    for (int c = 0; c < 3; c++) {
        double sum = SH_BASIS0 * (double)g->plane[G_SH + c][i];
        for (int l = 1; l <= degree; l++) {
            double squares = 0;
            for (int k = l * l; k < (l + 1) * (l + 1); k++)
                squares += pow((double)g->plane[G_SH + 3 * k + c][i], 2);
            sum += sqrt(squares * (2 * l + 1)) * SH_BASIS0;
        }
        top = fmax(top, sum);
    }
    return fmin(top, (double)RASTER_LOG_MAX);
}

static double stored_logit(const struct gaussians *g, int i)
{
    return fmin((double)g->plane[G_LOGIT][i], 12); // 1 - 6e-6: far above the cap
}

static double stored_light(const struct gaussians *g, int colour, int i)
{
    double v = SH_BASIS0 * (double)g->plane[G_SH + colour][i];
    return fmin(fmax(v, -(double)RASTER_LOG_MAX), (double)RASTER_LOG_MAX);
}

static double unit_of(const struct scene *s, double brightest)
{
    double light = exp(brightest), middle = pow(0.5, (double)display_ev(&s->tone));
    for (int k = 0; k < 3; k++)
        light = fmax(light, (double)s->background[k]);
    light = fmin(light, middle * exp2(UNIT_STOPS));
    return light > 0 ? exp2(ceil(log2(light / (double)HALF_MAX))) : 1;
}

void pagesplats_plan(const struct scene *s, int degree, double step, struct pagesplats *out)
{
    static const struct span nothing = {INFINITY, -INFINITY};
    struct span scale = nothing, logit = nothing, light = nothing;
    double top = -INFINITY;
    *out = (struct pagesplats){.scene = s, .degree = degree};
    for (int i = 0; i < s->g.n; i++) {
        if (!pagesplats_is_drawn(&s->g, i))
            continue;
        out->n++;
        for (int k = 0; k < 3; k++) {
            widen_span(&scale, (double)s->g.plane[G_LOG_SCALE + k][i]);
            widen_span(&light, stored_light(&s->g, k, i));
        }
        widen_span(&logit, stored_logit(&s->g, i));
        top = fmax(top, brightest_radiance(&s->g, i, degree));
    }
    out->scale = range_of(&scale, step);
    out->logit = range_of(&logit, step);
    out->light = range_of(&light, step);
    out->unit = unit_of(s, top);
}

/* ---- numbers ---- */

static uint16_t steps_of(const struct pagesplats_range *r, double v)
{
    return r->step > 0 ? (uint16_t)lround((v - r->lo) / r->step) : 0;
}

static void pack_quat(const struct gaussians *g, int i, uint16_t out[3])
{
    double q[4], big = 0, sum = 0;
    int largest = 0, n = 0;
    for (int k = 0; k < 4; k++) {
        q[k] = (double)g->plane[G_QUAT + k][i];
        sum += q[k] * q[k];
        if (fabs(q[k]) > big) {
            big = fabs(q[k]);
            largest = k;
        }
    }
    double scale = big > 1e-30 ? copysign(sqrt(2 / sum), q[largest]) : 0; // 0: the identity
    for (int k = 0; k < 4; k++)
        if (k != largest)
            out[n++] = (uint16_t)lround((q[k] * scale + 1) * 16383);
    out[0] |= (uint16_t)((largest & 1) << 15);
    out[1] |= (uint16_t)((largest >> 1) << 15);
}

void pagesplats_numbers(const struct pagesplats *p, int i, uint16_t out[PAGESPLATS_NUMBERS])
{
    const struct gaussians *g = &p->scene->g;
    for (int k = 0; k < 3; k++) {
        out[PAGESPLATS_SCALE + k] = steps_of(&p->scale, (double)g->plane[G_LOG_SCALE + k][i]);
        out[PAGESPLATS_LIGHT + k] = steps_of(&p->light, stored_light(g, k, i));
    }
    out[PAGESPLATS_LOGIT] = steps_of(&p->logit, stored_logit(g, i));
    pack_quat(g, i, out + PAGESPLATS_QUAT);
    out[PAGESPLATS_QUAT + 2] |= (uint16_t)(pagesplats_is_guess(p->scene, i) << 15);
}

static void put_splat(const struct pagesplats *p, int i, struct pagetext *out)
{
    uint8_t bytes[PAGESPLATS_BYTES], *to = bytes;
    uint16_t v[PAGESPLATS_NUMBERS];
    for (int k = 0; k < 3; k++)
        to = bytes_put_f32(to, p->scene->g.plane[G_MU + k][i]);
    pagesplats_numbers(p, i, v);
    for (int k = 0; k < PAGESPLATS_NUMBERS; k++)
        to = bytes_put_u16(to, v[k]);
    pagetext_put(out, bytes, sizeof bytes);
}

static void put_harmonics(const struct pagesplats *p, int i, struct pagetext *out)
{
    const struct gaussians *g = &p->scene->g;
    int n = 3 * ((p->degree + 1) * (p->degree + 1) - 1);
    uint8_t texel[PAGESPLATS_TEXEL];
    for (int j = 0; j < n; j += PAGESPLATS_TEXEL / 2) {
        uint8_t *to = texel;
        for (int k = j; k < j + PAGESPLATS_TEXEL / 2; k++)
            to = bytes_put_u16(to, k < n ? half_from_float_sat(g->plane[G_SH + 3 + k][i]) : 0);
        pagetext_put(out, texel, sizeof texel);
    }
}

void pagesplats_put(const struct pagesplats *p, struct pagetext *out)
{
    const struct gaussians *g = &p->scene->g;
    for (int i = 0; i < g->n; i++)
        if (pagesplats_is_drawn(g, i))
            put_splat(p, i, out);
    for (int i = 0; i < g->n && p->degree > 0; i++)
        if (pagesplats_is_drawn(g, i))
            put_harmonics(p, i, out);
}
