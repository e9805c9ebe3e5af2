/* fft_body.h - Fourier transform of 16 x 16 real tiles, LANES channels at a time; compiled once per
 * instruction set. Included by fft_<isa>.c after one SIMD_ macro.
 * Rows are transformed in pairs, the second as imaginary part of the first; so are the columns of
 * frequencies 0 and 8, which are real. A transform of 16 is two passes of four. The inverse is the
 * forward transform with real and imaginary parts exchanged. */
#include "core/kernels/kernels.h"
#include "core/kernels/simd.h"

enum { EDGE = FFT_EDGE, HALF = EDGE / 2, C0 = 7 * EDGE, C8 = C0 + 7, REAL = 3 * FFT_BINS };

/* Half the spectrum of the rows: frequency along x, then row. */
struct spectrum {
    float re[HALF + 1][EDGE][LANES], im[HALF + 1][EDGE][LANES];
};

/* cos and sin of pi m / 8. */
static const float cosine[10] = {1,  0.92387953251f,  0.70710678119f,  0.38268343236f,
                                 0,  -0.38268343236f, -0.70710678119f, -0.92387953251f,
                                 -1, -0.92387953251f};
static const float sine[10] = {0, 0.38268343236f, 0.70710678119f, 0.92387953251f,
                               1, 0.92387953251f, 0.70710678119f, 0.38268343236f,
                               0, -0.38268343236f};

/* X_k = sum of x_n i^(-n k) over elements at, at + step, .. */
static inline void dft4(vf *re, vf *im, int at, int step)
{
    int b = at + step, c = b + step, d = c + step;
    vf sr = re[at] + re[c], si = im[at] + im[c], tr = re[at] - re[c], ti = im[at] - im[c];
    vf ur = re[b] + re[d], ui = im[b] + im[d], vr = re[b] - re[d], vi = im[b] - im[d];
    re[at] = sr + ur;
    im[at] = si + ui;
    re[b] = tr + vi;
    im[b] = ti - vr;
    re[c] = sr - ur;
    im[c] = si - ui;
    re[d] = tr - vi;
    im[d] = ti + vr;
}

/* In place; frequency k2 + 4 k1 ends at 4 k1 + k2. */
static inline __attribute__((always_inline)) void fft16(vf *re, vf *im)
{
    for (int n = 0; n < 4; n++)
        dft4(re, im, n, 4); // n + 4 k2
    for (int n = 1; n < 4; n++)
        for (int k = 1; k < 4; k++) {
            vf c = v_set(cosine[n * k]), s = v_set(sine[n * k]), a = re[n + 4 * k];
            re[n + 4 * k] = v_fma(a, c, im[n + 4 * k] * s);
            im[n + 4 * k] = v_fnma(a, s, im[n + 4 * k] * c);
        }
    for (int k = 0; k < 4; k++)
        dft4(re, im, 4 * k, 1); // 4 k2 + k1
    for (int i = 0; i < 4; i++)
        for (int j = i + 1; j < 4; j++) {
            vf a = re[4 * i + j], b = im[4 * i + j];
            re[4 * i + j] = re[4 * j + i];
            im[4 * i + j] = im[4 * j + i];
            re[4 * j + i] = a;
            im[4 * j + i] = b;
        }
}

/* z = a + i b with the spectra of real a and b: frequency k of both from those of z. */
static inline void split_pair(const vf *re, const vf *im, int k, vf out[4])
{
    const vf half = v_set(0.5f);
    int m = (EDGE - k) % EDGE;
    out[0] = (re[k] + re[m]) * half;
    out[1] = (im[k] - im[m]) * half;
    out[2] = (im[k] + im[m]) * half;
    out[3] = (re[m] - re[k]) * half;
}

/* The inverse of split_pair: a = in[0] + i in[1], b = in[2] + i in[3]. */
static inline void join_pair(vf *re, vf *im, int k, const vf in[4])
{
    int m = EDGE - k;
    re[k] = in[0] - in[3];
    im[k] = in[1] + in[2];
    re[m] = in[0] + in[3];
    im[m] = in[2] - in[1];
}

/* ---- forward ---- */

static void rows_forward(const struct fft_tile *t, int c, struct spectrum *s)
{
    vf re[EDGE], im[EDGE], v[4];
    for (int y = 0; y < EDGE; y += 2) {
        const float *a = t->px + (size_t)y * t->row + c, *b = a + t->row;
        for (int x = 0; x < EDGE; x++) {
            re[x] = v_load(a + (size_t)x * t->step);
            im[x] = v_load(b + (size_t)x * t->step);
        }
        fft16(re, im);
        for (int k = 0; k <= HALF; k++) {
            split_pair(re, im, k, v);
            v_store(s->re[k][y], v[0]);
            v_store(s->im[k][y], v[1]);
            v_store(s->re[k][y + 1], v[2]);
            v_store(s->im[k][y + 1], v[3]);
        }
    }
}

static inline void store_bin(const struct fft_tile *t, int c, int bin, vf re, vf im)
{
    float *p = t->planes + (size_t)(3 * bin) * t->plane + c;
    v_store(p, re);
    v_store(p + t->plane, im);
    v_store(p + 2 * t->plane, re + im);
}

/* The columns of frequencies 0 and 8 hold real numbers: both take one transform. */
static void real_columns_forward(const struct fft_tile *t, int c, const struct spectrum *s)
{
    vf re[EDGE], im[EDGE], v[4];
    float *real = t->planes + REAL * t->plane + c;
    for (int y = 0; y < EDGE; y++) {
        re[y] = v_load(s->re[0][y]);
        im[y] = v_load(s->re[HALF][y]);
    }
    fft16(re, im);
    v_store(real, re[0]);
    v_store(real + t->plane, re[HALF]);
    v_store(real + 2 * t->plane, im[0]);
    v_store(real + 3 * t->plane, im[HALF]);
    for (int k = 1; k < HALF; k++) {
        split_pair(re, im, k, v);
        store_bin(t, c, C0 + k - 1, v[0], v[1]);
        store_bin(t, c, C8 + k - 1, v[2], v[3]);
    }
}

static void fft_forward(const struct fft_tile *t)
{
    struct spectrum s;
    vf re[EDGE], im[EDGE];
    for (int c = 0; c < t->n; c += LANES) {
        rows_forward(t, c, &s);
        for (int k = 1; k < HALF; k++) {
            for (int y = 0; y < EDGE; y++) {
                re[y] = v_load(s.re[k][y]);
                im[y] = v_load(s.im[k][y]);
            }
            fft16(re, im);
            for (int y = 0; y < EDGE; y++)
                store_bin(t, c, (k - 1) * EDGE + y, re[y], im[y]);
        }
        real_columns_forward(t, c, &s);
    }
}

/* ---- inverse ---- */

static inline void load_bin(const struct fft_tile *t, int c, int bin, vf *re, vf *im)
{
    const float *p = t->planes + (size_t)(3 * bin) * t->plane + c;
    vf y2 = v_load(p + 2 * t->plane);
    *re = y2 - v_load(p + t->plane);
    *im = y2 + v_load(p);
}

static void real_columns_inverse(const struct fft_tile *t, int c, struct spectrum *s)
{
    vf re[EDGE], im[EDGE], v[4];
    const float *real = t->planes + REAL * t->plane + c;
    re[0] = v_load(real);
    re[HALF] = v_load(real + t->plane);
    im[0] = v_load(real + 2 * t->plane);
    im[HALF] = v_load(real + 3 * t->plane);
    for (int k = 1; k < HALF; k++) {
        load_bin(t, c, C0 + k - 1, v, v + 1);
        load_bin(t, c, C8 + k - 1, v + 2, v + 3);
        join_pair(re, im, k, v);
    }
    fft16(im, re);
    for (int y = 0; y < EDGE; y++) {
        v_store(s->re[0][y], re[y]);
        v_store(s->re[HALF][y], im[y]);
        v_store(s->im[0][y], v_set(0));
        v_store(s->im[HALF][y], v_set(0));
    }
}

static void rows_inverse(const struct fft_tile *t, int c, const struct spectrum *s)
{
    vf re[EDGE], im[EDGE], v[4];
    for (int y = 0; y < t->edge; y += 2) {
        for (int k = 0; k <= HALF; k++) {
            v[0] = v_load(s->re[k][y]);
            v[1] = v_load(s->im[k][y]);
            v[2] = v_load(s->re[k][y + 1]);
            v[3] = v_load(s->im[k][y + 1]);
            if (k % HALF)
                join_pair(re, im, k, v);
            else
                re[k] = v[0], im[k] = v[2];
        }
        fft16(im, re);
        float *a = t->px + (size_t)y * t->row + c;
        for (int x = 0; x < t->edge; x++) {
            v_store(a + (size_t)x * t->step, re[x]);
            if (y + 1 < t->edge)
                v_store(a + t->row + (size_t)x * t->step, im[x]);
        }
    }
}

static void fft_inverse(const struct fft_tile *t)
{
    struct spectrum s;
    vf re[EDGE], im[EDGE];
    for (int c = 0; c < t->n; c += LANES) {
        for (int k = 1; k < HALF; k++) {
            for (int y = 0; y < EDGE; y++)
                load_bin(t, c, (k - 1) * EDGE + y, re + y, im + y);
            fft16(im, re);
            for (int y = 0; y < EDGE; y++) {
                v_store(s.re[k][y], re[y]);
                v_store(s.im[k][y], im[y]);
            }
        }
        real_columns_inverse(t, c, &s);
        rows_inverse(t, c, &s);
    }
}

static void fft_fill(struct gemm_kernels *k)
{
    k->s8_beats_fft = false;
    k->fft_forward = fft_forward;
    k->fft_inverse = fft_inverse;
}
