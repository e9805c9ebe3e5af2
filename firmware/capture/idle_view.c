/* Shares are of numbers, all colours alike. The exposure to wait at goes in steps of two stops
 * until neither clipped nor dark numbers are the most. */
#include "firmware/capture/idle_view.h"

#include <math.h>
#include <string.h>

#define CLIPPED 0.99 // share of the range
#define DARK 0.005
#define BASE_LONGEST_S 0.1 // as far as darkness drives it
#define BASE_FACTOR 4.0

void idle_view_look(const struct raw *p, struct session_view *out)
{
    size_t n = (size_t)p->w * (size_t)p->h * (p->cfa == RAW_RGB ? 3 : 1);
    int top = (1 << p->bits) - 1, range = top - p->black;
    uint32_t clipped = 0, dark = 0;
    memset(out->histogram, 0, sizeof out->histogram);
    for (size_t i = 0; i < n; i++) {
        int v = p->px[i] > p->black ? p->px[i] - p->black : 0;
        double display = (double)v / range;
        if (p->linear)
            display = pow(display, 1 / 2.2);
        int bin = (int)(display * SESSION_BINS);
        out->histogram[bin < SESSION_BINS ? bin : SESSION_BINS - 1]++;
        clipped += v >= range * CLIPPED;
        dark += v <= range * DARK;
    }
    out->clipped = (float)((double)clipped / (double)n);
    out->dark = (float)((double)dark / (double)n);
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
