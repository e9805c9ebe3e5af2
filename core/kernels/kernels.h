/* kernels.h - the contract of every inner loop, and the table that holds one variant of each.
 * Pure functions on the caller's memory; any thread. Sizes are in elements. No kernel reads or
 * writes outside the extents named here; no alignment is required unless stated. The plain C
 * variant is the reference: the others equal it within the bounds tested in tests/kernels (float
 * arithmetic is ordered differently per instruction set). */
#ifndef KERNELS_KERNELS_H
#define KERNELS_KERNELS_H

#include "core/base/types.h"
#include "core/kernels/gemm.h"

struct tonemap_curve;

enum {
    TILE = 16,        // px, edge of a raster tile (gsplat 1.4.0)
    SPLAT_BLOCK = 64, // splats per call of the projection kernels, at most
    GRAD2D = 11,      // sums kept per splat and tile by tile_grad, in the order of tile_grad_fn
    GRAD_SHOWN = 6,
    GRAD_RGB = 7,
    GRAD_Z = 10,
    SLOT = 12,     // floats from one tile's sums to the next, GRAD2D rounded up to 16-byte pieces
    POSE_GRAD = 16 // d/dR (9, row-major), d/dt (3), d/d(fx fy cx cy)
};

/* Constants of core/splat/README.md 2 and 3. */
#define RASTER_NEAR 1e-10f
#define RASTER_REACH 3.0f // standard deviations that a splat reaches
#define RASTER_FAR 1e10f
#define RASTER_BLUR 0.3f // px^2 added to both diagonal entries
#define RASTER_ALPHA_MAX 0.999f
#define RASTER_ALPHA_MIN (1.0f / 255.0f)
#define RASTER_STOP 1e-4f
/* core/splat/README.md 5: a splat is hidden in a picture where it is farther than RASTER_BEHIND
 * times the depth at which transmittance falls below RASTER_FRONT, unless RASTER_SHOWN of its
 * alpha passes. */
#define RASTER_FRONT 0.5f
#define RASTER_BEHIND 1.1f
#define RASTER_SHOWN 0.1f
/* Our guards: log radiance is clamped so that sums of radiance and their products stay finite; a
 * footprint beyond 1e9 px is dropped, because its determinant overflows. */
#define RASTER_LOG_MAX 60.0f
#define RASTER_COV_MAX 1e18f

/* A projected splat: one cache line. Splats that cannot be seen have x1 < x0. */
struct splat2d {
    float u, v; // px, projected centre
    /* log2 alpha = top - across (dx - shear dy)^2 - along dy^2, dx = u - x, dy = v - y */
    float across, shear, along; // px^-2, 1, px^-2
    float top;                  // log2 of the opacity
    float rgb[3];               // linear radiance
    float z;                    // depth, scene units
    int16_t x0, x1, y0,
        y1; // px, inclusive bounds of the pixels that can reach alpha 1/255, inside the image
    uint8_t tx0, tx1, ty0, ty1; // tiles, half open
    uint32_t base;              // first slot of this splat in the current group of tiles
    uint32_t pad[2];
};

struct view_geom {                        // one camera, prepared once per frame
    float r[9], t[3];                     // world to camera, row-major
    float centre[3];                      // camera centre in the world
    float fx, fy, cx, cy;                 // px
    float lim_x0, lim_x1, lim_y0, lim_y1; // bounds of x/z and y/z inside the Jacobian
    int w, h;                             // px, <= 4080
};

/* Project splats [first, first+count), count <= SPLAT_BLOCK, into out[first...]. */
typedef void project_fn(const struct gaussians *g, const struct view_geom *v, int first, int count,
                        struct splat2d *out);

/* Chain rule of `project` for the same block.
 * sums: (GRAD2D, SPLAT_BLOCK) per-splat totals of tile_grad; zero columns for unseen splats.
 * out: grad (planes of g->degree, SPLAT_BLOCK), overwritten; pose (POSE_GRAD) added to unless NULL.
 * Entries that are not finite are replaced by 0. */
typedef void project_grad_fn(const struct gaussians *g, const struct view_geom *v, int first,
                             int count, const float *sums, float *grad, float *pose);

/* One tile of one picture. All maps are (.., h, w) with row stride w. */
struct tile {
    const struct splat2d *splats;
    const uint32_t *list; // (n) splat numbers, front to back
    int n, x0, y0, w, h;  // list length; px of the tile's corner; px of the picture
    float background[3];
    float *radiance; // (3, h, w)
    float *depth;    // (h, w) or NULL
    float *alpha;    // (h, w)
    float *trans;    // (h, w) final transmittance
    float *front;    // (h, w) z where trans falls below RASTER_FRONT, else RASTER_FAR; or NULL
    int32_t *stop;   // (h, w) index in the list where the pixel became full; n if it never did
    /* for tile_grad */
    const float *d_radiance, *d_depth,
        *d_alpha;      // (3, h, w), (h, w), (h, w): d loss / d map; the last two may be NULL
    float *slots;      // (.., SLOT): sums of splat s go to slots[SLOT * slot_of(s)]
    int gx0, gx1, gy0; // tiles: rectangle of the current group (see raster.c)
};

/* Blend the list front to back (core/splat/README.md 3). */
typedef void tile_fn(const struct tile *t);

/* Sums over the tile's pixels, per splat: v x, v y, v xx, v xy, v yy, v (v = d loss / d sigma,
 * x = u - pixel), alpha (s - RASTER_SHOWN) with s = T if the splat is behind `front` and 1 else
 * (negative: hidden; full pixels add nothing), d loss / d (r, g, b, z). Writes every slot of the
 * list. */
typedef void tile_grad_fn(const struct tile *t);

/* Slot of splat s for tile (tx, ty): its tiles inside the group are numbered row by row. */
static inline uint32_t tile_slot(const struct splat2d *s, const struct tile *t, int tx, int ty)
{
    int x0 = s->tx0 > t->gx0 ? s->tx0 : t->gx0, x1 = s->tx1 < t->gx1 ? s->tx1 : t->gx1;
    int y0 = s->ty0 > t->gy0 ? s->ty0 : t->gy0;
    return s->base + (uint32_t)((ty - y0) * (x1 - x0) + (tx - x0));
}

struct adam_step {
    float lr, beta1, beta2, eps; // lr: rate of this step, without the bias corrections
    float fix1, fix2;            // 1/(1-beta1^t), 1/(1-beta2^t)
};

/* Adam on n parameters. Where seen[i] is 0 the parameter and its moments stay as they are (sparse
 * Adam); elsewhere seen[i] is 1. */
typedef void adam_fn(const struct adam_step *s, int n, const float *seen, const float *grad,
                     float *param, float *m1, float *m2);

/* Along a row, with the 11 taps of SSIM: out(i) = sum_k taps[k] in(i + k), i < n - 10. */
typedef void blur_row_fn(const float *taps, const float *in, int n, float *out);
/* Across rows: out(i) = sum_k taps[k] in[k][i], i < n. */
typedef void blur_col_fn(const float *taps, const float *const *in, int n, float *out);
/* blur_row of x, y, xx, yy, xy, where y = photo / 255; photo: any number, not only codes.
 * out: (5, stride). scratch: 2 stride floats. */
typedef void moments_row_fn(const float *taps, const float *x, const float *photo, int n,
                            size_t stride, float *scratch, float *out);

/* One row of one colour between radiance and display. */
struct tone_row {
    const struct tonemap_curve *curve;
    const float *radiance, *alpha; // (n)
    float shift;                   // log2 t - mid
    float behind;                  // display value added times (1 - alpha)
    float *x, *slope, *ldr; // (n) log2(radiance + 1e-6) + shift; d logit / dx there; display value
    uint8_t *segment;       // (n) of the curve
    int n;
};
typedef void tone_row_fn(const struct tone_row *t);
/* d: in d loss / d ldr, out d loss / d radiance.
 * logit: d loss / d logit. d_alpha: += d loss / d alpha. */
typedef void tone_row_grad_fn(const struct tone_row *t, float *d, float *logit, float *d_alpha);

/* Structural similarity of a row of windows (Wang et al. 2004; C1 = 0.01^2, C2 = 0.03^2, range 1).
 * m: (5, stride) window means of x, y, xx, yy, xy.
 * out: (3, stride) derivatives by the means of x, xx and xy.
 * returns: the sum of the n similarities. */
typedef double ssim_row_fn(const float *m, size_t stride, int n, float *out);

/* d = l1 sign(x - y) + ssim (g0 + 2 x g1 + y g2), y = photo / 255; g: (3, stride).
 * returns: sum of |x - y|. */
struct display_row {
    const float *x, *g, *photo;
    size_t stride;
    float l1, ssim;
    int n;
};
typedef double display_row_fn(const struct display_row *r, float *d);

struct kernels {
    const char *name; // instruction set of the float kernels
    project_fn *project;
    project_grad_fn *project_grad;
    tile_fn *tile;
    tile_grad_fn *tile_grad;
    adam_fn *adam;
    blur_row_fn *blur_row;
    blur_col_fn *blur_col;
    moments_row_fn *moments_row;
    ssim_row_fn *ssim_row;
    display_row_fn *display_row;
    tone_row_fn *tone_row;
    tone_row_grad_fn *tone_row_grad;
    struct gemm_kernels net; // the network's
};

/* The variants of the splat and loss kernels; kernels_init chooses. */
void splat_c(struct kernels *k);
void splat_sse41(struct kernels *k);
void splat_avx2(struct kernels *k);
void splat_avx512(struct kernels *k);
void splat_neon(struct kernels *k);
void loss_c(struct kernels *k);
void loss_sse41(struct kernels *k);
void loss_avx2(struct kernels *k);
void loss_avx512(struct kernels *k);
void loss_neon(struct kernels *k);

/* The variants of the network's products (gemm), row operations (nn) and transforms (fft); each
 * fills the slots that it improves. */
void gemm_c(struct gemm_kernels *k);
void gemm_sse41(struct gemm_kernels *k);
void gemm_avx2(struct gemm_kernels *k);
void gemm_avx512(struct gemm_kernels *k);
void gemm_avx512vnni(struct gemm_kernels *k);
void gemm_amx(struct gemm_kernels *k);
void gemm_neon(struct gemm_kernels *k);
void gemm_neondot(struct gemm_kernels *k);
void gemm_i8mm(struct gemm_kernels *k);
void nn_c(struct gemm_kernels *k);
void nn_sse41(struct gemm_kernels *k);
void nn_avx2(struct gemm_kernels *k);
void nn_avx512(struct gemm_kernels *k);
void nn_neon(struct gemm_kernels *k);
void fft_c(struct gemm_kernels *k);
void fft_sse41(struct gemm_kernels *k);
void fft_avx2(struct gemm_kernels *k);
void fft_avx512(struct gemm_kernels *k);
void fft_neon(struct gemm_kernels *k);

/* Fill the table with the best variants that `cpu` (bits of cpu.h) allows; 0 gives plain C. */
void kernels_init(struct kernels *k, unsigned cpu);

#endif
