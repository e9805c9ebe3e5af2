/* Shares are of numbers, all colours alike. The exposure to wait at goes in steps of two stops
 * until neither clipped nor dark numbers are the most. */
#include "firmware/capture/idle_view.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

#define CLIPPED 0.99 // share of the range
#define DARK 0.005
#define BASE_LONGEST_S 0.1 // as far as darkness drives it
#define BASE_FACTOR 4.0
#define GAMMA 2.2
#define GREY 0.35         // mean of the small picture, linear
#define BALANCE_MOST 4.0f // of a colour, against a scene of one colour

enum {
    TABLE_BITS = 12, // of codes that tell a bin
    SIDE_MOST = 4    // samples across that a small pixel is made of
};

static double display_of(const struct raw *p, int code)
{
    const double v = (double)num_max(code - p->black, 0) / ((1 << p->bits) - 1 - p->black);
    return p->linear ? pow(v, 1 / GAMMA) : v;
}

void idle_view_look(const struct raw *p, struct session_view *out)
{
    size_t n = (size_t)p->w * (size_t)p->h * (p->cfa == RAW_RGB ? 3 : 1);
    int top = (1 << p->bits) - 1, range = top - p->black, shift = num_max(p->bits - TABLE_BITS, 0);
    uint32_t clipped = 0, dark = 0;
    uint8_t bin[1 << TABLE_BITS];
    memset(out->histogram, 0, sizeof out->histogram);
    for (int c = 0; c <= top >> shift; c++)
        bin[c] =
            (uint8_t)num_min((int)(display_of(p, c << shift) * SESSION_BINS), SESSION_BINS - 1);
    for (size_t i = 0; i < n; i++) {
        int v = p->px[i] > p->black ? p->px[i] - p->black : 0;
        out->histogram[bin[num_min(p->px[i], top) >> shift]]++;
        clipped += v >= range * CLIPPED;
        dark += v <= range * DARK;
    }
    out->clipped = (float)((double)clipped / (double)n);
    out->dark = (float)((double)dark / (double)n);
}

/* Mean linear colour of the samples from (x, y) on, side x side. */
static void mean_colour(const struct raw *p, int x, int y, int side, float out[3])
{
    const bool mosaic = p->cfa != RAW_RGB && p->cfa != RAW_MONO;
    const int stride = p->cfa == RAW_RGB ? 3 : 1;
    float n[3] = {0}, sum[3] = {0};
    for (int i = 0; i < side * side; i++) {
        const int u = x + i % side, v = y + i / side;
        const uint16_t *px = p->px + (size_t)stride * ((size_t)v * (size_t)p->w + (size_t)u);
        for (int c = 0; c < 3; c++) {
            if (mosaic && raw_colour(p->cfa, v, u) != c)
                continue;
            const float light = (float)num_max(px[stride == 3 ? c : 0] - p->black, 0);
            sum[c] += p->linear ? light : light * light;
            n[c]++;
        }
    }
    for (int c = 0; c < 3; c++)
        out[c] = sum[c] / n[c];
}

void idle_view_shrink(const struct raw *p, struct idle_view_picture *out)
{
    const int block = (num_max(p->w, p->h) + IDLE_VIEW_EDGE - 1) / IDLE_VIEW_EDGE;
    const int step = num_max(2, block + (block & 1)); // whole cells of a mosaic
    const int side = num_min(step, SIDE_MOST);
    float mean[3] = {0}, gain[3], light[3];
    out->w = p->w / step;
    out->h = p->h / step;
    const int n = out->w * out->h;
    for (int i = 0; i < n; i++) {
        mean_colour(p, i % out->w * step, i / out->w * step, side, light);
        for (int c = 0; c < 3; c++)
            mean[c] += light[c] / (float)n;
    }
    const float top = fmaxf(fmaxf(mean[0], mean[1]), fmaxf(mean[2], 1e-6f));
    for (int c = 0; c < 3; c++)
        gain[c] = (float)GREY / fmaxf(mean[c], top / BALANCE_MOST);
    for (int i = 0; i < n; i++) {
        mean_colour(p, i % out->w * step, i / out->w * step, side, light);
        for (int c = 0; c < 3; c++)
            out->px[3 * i + c] =
                (uint8_t)lroundf(255 * powf(fminf(1, gain[c] * light[c]), 1 / (float)GAMMA));
    }
}

double idle_view_base(const struct session_view *v, const struct camera_info *info, double now_s)
{
    double t = now_s;
    if (v->clipped > 0.5f)
        t = fmax(now_s / BASE_FACTOR, info->time_min_s);
    else if (v->dark > 0.5f)
        t = fmin(now_s * BASE_FACTOR, fmin(BASE_LONGEST_S, info->time_max_s));
    bool better = v->clipped > 0.5f ? t < 0.9 * now_s : t > 1.1 * now_s; // not for the rounding
    return better ? t : 0;
}
