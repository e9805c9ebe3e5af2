/* Radiance of a pixel is sum of counts / sum of exposures over the frames that do not clip it. This
 * maximises the likelihood under photon noise; read noise costs little, because long exposures
 * weigh most in the dark (Hanji, Zhong & Mantiuk 2020). Counts are codes above
 * black, or the relative exposure of a display value.
 * A mosaic is merged before it is demosaiced: a frame that clips a pixel then has no part in its
 * neighbours' colours. With display values a frame counts for all three colours of a pixel or for
 * none, since devices mix them.
 * A pixel that is clipped in all frames gets the value of the shortest, which still rises above the
 * clipping code. Sums of counts below black become 0 at the end, not before demosaicing. */
#include "core/photo/merge.h"

#include <math.h>

struct merge {
    const struct raw *frames;
    int n, clip, shortest;
    float exposure[MERGE_FRAMES_MAX], gain[3]; // radiance of one count in 1 s
    float table[3][256];                       // counts of a display value
    struct image *out;
};

static void merge_init(const struct merge_set *s, struct merge *m)
{
    struct crf srgb;
    const struct crf *crf = s->crf;
    const struct raw *frames = s->frames;
    float unit = frames->linear ? 1.0f / (float)((1 << frames->bits) - 1 - frames->black) : 1.0f;
    m->frames = frames;
    m->n = s->n;
    m->clip = raw_clip(frames);
    m->shortest = 0;
    m->gain[0] = m->gain[1] = m->gain[2] = unit;
    if (frames->cfa != RAW_MONO) {
        m->gain[0] *= s->how->red;
        m->gain[2] *= s->how->blue;
    }
    for (int i = 0; i < s->n; i++) {
        m->exposure[i] = (float)s->exposure_s[i];
        if (m->exposure[i] < m->exposure[m->shortest])
            m->shortest = i;
    }
    if (frames->linear)
        return;
    if (!crf) {
        crf_srgb(&srgb);
        crf = &srgb;
    }
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < 256; i++)
            m->table[c][i] = exp2f(crf->log2x[c][i]);
}

/* Counts per second of a site of linear numbers. */
static inline float merge_site(const struct merge *m, size_t at)
{
    int black = m->frames->black, sum = 0;
    float t = 0.0f;
    for (int i = 0; i < m->n; i++) {
        int code = m->frames[i].px[at];
        sum += code < m->clip ? code - black : 0;
        t += code < m->clip ? m->exposure[i] : 0.0f;
    }
    if (t > 0.0f)
        return (float)sum / t;
    return (float)(m->frames[m->shortest].px[at] - black) / m->exposure[m->shortest];
}

/* Counts per second of a pixel of n display values. */
static void merge_pixel(const struct merge *m, size_t at, int n, float x[3])
{
    float t = 0.0f;
    x[0] = x[1] = x[2] = 0.0f;
    for (int i = 0; i <= m->n; i++) {
        bool last = i == m->n; // all frames clip it
        const uint16_t *p = m->frames[last ? m->shortest : i].px + at;
        bool clipped = p[0] >= m->clip || (n == 3 && (p[1] >= m->clip || p[2] >= m->clip));
        if (last ? t > 0.0f : clipped)
            continue;
        for (int c = 0; c < n; c++)
            x[c] += m->table[n == 3 ? c : 1][p[c] & 255];
        t += m->exposure[last ? m->shortest : i];
    }
    for (int c = 0; c < n; c++)
        x[c] /= t;
}

static void store_pixel(const struct merge *m, size_t at, const float x[3])
{
    size_t area = (size_t)m->frames->w * (size_t)m->frames->h;
    for (size_t c = 0; c < 3; c++)
        m->out->px[c * area + at] = fmaxf(x[c] * m->gain[c], 0.0f);
}

/* ---- mosaics ---- */

static void read_sites(const void *ctx, int y, int x, int n, float *v)
{
    const struct merge *m = ctx;
    size_t at = (size_t)y * (size_t)m->frames->w + (size_t)x;
    float gain[2];
    for (int k = 0; k < 2; k++)
        gain[k] = m->gain[raw_colour(m->frames->cfa, y, x + k)];
    for (int i = 0; i < n; i++)
        v[i] = merge_site(m, at + (size_t)i) * gain[i & 1];
}

static void write_pixels(const void *ctx, int y, int x, int n, float *const rgb[3])
{
    const struct merge *m = ctx;
    size_t area = (size_t)m->frames->w * (size_t)m->frames->h;
    for (size_t c = 0; c < 3; c++) {
        float *to = m->out->px + c * area + (size_t)y * (size_t)m->frames->w + x;
        for (int i = 0; i < n; i++)
            to[i] = fmaxf(rgb[c][i], 0.0f);
    }
}

/* ---- all ---- */

static void run_row(const struct merge *m, int y)
{
    const struct raw *f = m->frames;
    bool mono = f->cfa == RAW_MONO;
    for (size_t i = (size_t)y * (size_t)f->w, end = i + (size_t)f->w; i < end; i++) {
        float x[3];
        if (!f->linear)
            merge_pixel(m, mono ? i : 3 * i, mono ? 1 : 3, x);
        for (size_t c = 0; f->linear && c < (mono ? 1 : 3); c++)
            x[c] = merge_site(m, mono ? i : 3 * i + c);
        if (mono)
            x[1] = x[2] = x[0];
        store_pixel(m, i, x);
    }
}

void merge_rows(const struct merge_set *s, int begin, int end, struct image *out)
{
    struct merge m = {.out = out};
    enum raw_cfa cfa = s->frames->cfa;
    merge_init(s, &m);
    if (cfa != RAW_MONO && cfa != RAW_RGB) {
        struct develop_mosaic mosaic = {cfa, s->frames->w, s->frames->h,
                                        &m,  read_sites,   write_pixels};
        develop_rows(&mosaic, begin, end);
        return;
    }
    for (int y = begin; y < end; y++)
        run_row(&m, y);
}
