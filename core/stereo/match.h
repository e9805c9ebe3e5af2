/* match.h - the matching cost of two views of a surface: how little windows of log2 luminance
 * agree, by the variance of their difference relative to the contrast of the view (a correlation
 * that is invariant to exposure and requires equal contrast) and by the mean difference (which
 * distinguishes repetitions of a pattern).
 * Pure functions; any thread. */
#ifndef STEREO_MATCH_H
#define STEREO_MATCH_H

#include <math.h>
#include <stddef.h>

enum {
    MATCH_NEAR_MAX = 4, // neighbours that a view is compared with
    MATCH_RADIUS = 2,   // px, of the window
    MATCH_TAPS = 2 * MATCH_RADIUS + 1
};

#define MATCH_BLIND 0.5f       // cost where no pixel has information
#define MATCH_OUTSIDE 0.75f    // outside the neighbour: worse than blind, better than wrong
#define MATCH_INSIDE 1e-4f     // least weight of a pixel inside the neighbour's picture
#define MATCH_HIDDEN 0.1f      // a neighbour adds at most this to the best one, which may see alone
#define MATCH_NOISE_VAR 0.012f // stops^2 added: noise alone does not correlate

/* Log2 luminance and its reliability, interleaved: both are sampled together. */
struct match_light {
    int w, h;
    float *px; // (h, w, 2)
};

/* Between four pixels; u, v from 0 to below w - 1, h - 1. out: luminance, reliability. */
static inline void match_sample(const struct match_light *p, float u, float v, float out[2])
{
    const int iu = (int)u, iv = (int)v;
    const float fu = u - (float)iu, fv = v - (float)iv;
    const float *q = p->px + 2 * ((size_t)iv * (size_t)p->w + (size_t)iu);
    const float *below = q + 2 * p->w;
    for (int k = 0; k < 2; k++)
        out[k] = (q[k] + fu * (q[k + 2] - q[k])) * (1.0f - fv) +
                 (below[k] + fu * (below[k + 2] - below[k])) * fv;
}

/* Half the inverse variance of the window around one pixel of a view, the noise included. */
static inline float match_contrast(const struct match_light *p, int x, int y)
{
    const float centre = p->px[2 * (y * p->w + x)];
    float weight = 1e-6f, sum = 0.0f, square = 0.0f;
    for (int k = 0; k < MATCH_TAPS * MATCH_TAPS; k++) {
        int u = x + k % MATCH_TAPS - MATCH_RADIUS, v = y + k / MATCH_TAPS - MATCH_RADIUS;
        if (u < 0 || v < 0 || u >= p->w || v >= p->h)
            continue;
        const float *px = p->px + 2 * (v * p->w + u);
        weight += px[1];
        sum += px[1] * (px[0] - centre);
        square += px[1] * (px[0] - centre) * (px[0] - centre);
    }
    float var = (square - sum * sum / weight) / weight;
    return 0.5f / ((var > 0.0f ? var : 0.0f) + MATCH_NOISE_VAR);
}

/* Minimum without a comparison, which would keep GCC from vectorising. */
static inline float match_min(float a, float b)
{
    return 0.5f * (a + b - fabsf(a - b));
}

/* Cost of a window whose centre is inside, from its weighted moments: weight, difference and its
 * square. contrast: match_contrast of the view; 1 - correlation = half the variance of the
 * difference over the variance of the view. */
static inline float match_cost(const float m[3], float contrast)
{
    const float inv = 1.0f / (m[0] + MATCH_INSIDE), mean = m[1] * inv;
    const float unlike = match_min((m[2] * inv - mean * mean) * contrast, 2.0f);
    const float known = m[0] / (m[0] + 0.06f * MATCH_TAPS * MATCH_TAPS);
    return MATCH_BLIND +
           known * (0.35f * unlike + 0.4f * match_min(fabsf(mean), 1.0f) - MATCH_BLIND);
}

#endif
