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
    const struct ghost_mask *moved; // as in struct merge_set
    int n, clip;
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
    m->gain[0] = m->gain[1] = m->gain[2] = unit;
    if (frames->cfa != RAW_MONO) {
        m->gain[0] *= s->how->red;
        m->gain[2] *= s->how->blue;
    }
    m->moved = s->moved;
    for (int i = 0; i < s->n; i++)
        m->exposure[i] = (float)s->exposure_s[i];
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

/* Whether frame i counts at a pixel. */
static inline bool counts_at(const struct merge *m, int i, int x, int y)
{
    return !m->moved || !m->moved[i].moved || !ghost_mask_at(&m->moved[i], x, y);
}

/* Of the frames that count there. */
static int shortest_at(const struct merge *m, int x, int y)
{
    int best = -1;
    for (int i = 0; i < m->n; i++)
        if (counts_at(m, i, x, y) && (best < 0 || m->exposure[i] < m->exposure[best]))
            best = i;
    return best < 0 ? 0 : best;
}

/* Counts per second of a site of linear numbers, which is number `at` and of the pixel x, y. */
static inline float merge_site(const struct merge *m, size_t at, int x, int y)
{
    int black = m->frames->black, sum = 0;
    float t = 0.0f;
    for (int i = 0; i < m->n; i++) {
        int code = m->frames[i].px[at];
        bool good = code < m->clip && counts_at(m, i, x, y);
        sum += good ? code - black : 0;
        t += good ? m->exposure[i] : 0.0f;
    }
    if (t > 0.0f)
        return (float)sum / t;
    const int shortest = shortest_at(m, x, y);
    return (float)(m->frames[shortest].px[at] - black) / m->exposure[shortest];
}

/* Add the counts of n display values of frame i. */
static float add_display(const struct merge *m, int i, size_t at, int n, float sum[3])
{
    const uint16_t *p = m->frames[i].px + at;
    for (int c = 0; c < n; c++)
        sum[c] += m->table[n == 3 ? c : 1][p[c] & 255];
    return m->exposure[i];
}

/* Counts per second of the pixel x, y of n display values. */
static void merge_pixel(const struct merge *m, int x, int y, int n, float out[3])
{
    const size_t at = ((size_t)y * (size_t)m->frames->w + (size_t)x) * (size_t)n;
    float t = 0.0f;
    out[0] = out[1] = out[2] = 0.0f;
    for (int i = 0; i < m->n; i++) {
        const uint16_t *p = m->frames[i].px + at;
        bool clipped = p[0] >= m->clip || (n == 3 && (p[1] >= m->clip || p[2] >= m->clip));
        if (!clipped && counts_at(m, i, x, y))
            t += add_display(m, i, at, n, out);
    }
    if (!(t > 0.0f)) // all frames clip it
        t = add_display(m, shortest_at(m, x, y), at, n, out);
    for (int c = 0; c < n; c++)
        out[c] /= t;
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
        v[i] = merge_site(m, at + (size_t)i, x + i, y) * gain[i & 1];
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
    const int n = f->cfa == RAW_MONO ? 1 : 3;
    for (int x = 0; x < f->w; x++) {
        const size_t i = (size_t)y * (size_t)f->w + (size_t)x;
        float v[3];
        if (!f->linear)
            merge_pixel(m, x, y, n, v);
        for (int c = 0; f->linear && c < n; c++)
            v[c] = merge_site(m, (size_t)n * i + (size_t)c, x, y);
        if (n == 1)
            v[1] = v[2] = v[0];
        store_pixel(m, i, v);
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
