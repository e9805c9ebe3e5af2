/* loss.h - difference of a rendered picture from a photograph, and its gradient.
 * loss = w_l1 mean |d| + w_ssim (1 - SSIM), on display values: tone curve of the radiance, plus a
 * background colour where the splats are transparent (core/refine/README.md 4). SSIM: 11-tap
 * Gaussian, sigma 1.5, valid windows only (as torchmetrics). Squares marked as held out give no
 * gradient; their squared error is returned apart. Masked pixels, and cells that are left out,
 * count as if the photograph were the picture.
 * Invariant: the result does not depend on the number of threads. */
#ifndef REFINE_LOSS_H
#define REFINE_LOSS_H

#include "core/base/types.h"
#include "core/photo/tonemap.h"
#include "core/splat/raster.h"

enum { LOSS_WINDOW = 11 };

/* Workspace; fields belong to loss.c. */
struct loss {
    int w, h, stride; // stride of the derivative maps, w + 10 rounded up
    float taps[LOSS_WINDOW];
    float *ldr, *x, *slope; // (3, h, w)
    uint8_t *segment;       // (3, h, w)
    float *maps;            // (3 colours, 3, h + 10, stride), zero border of 10
    float *scratch;         // per worker
    size_t scratch_floats;
    double *partial;   // per chunk
    float *d_radiance; // (3, h, w) result
    float *d_alpha;    // (h, w) result
    double *totals;    // (TEAM_MAX, ..) of each rank
    /* Set after loss_init: each rank compares its rows, and sums are those of all. NULL: alone. */
    struct team *team;
};

/* Of values that are held out, over black. */
struct held_sum {
    double sse; // of the differences
    double n;   // how many values
};

struct loss_input {
    const struct render *pic;
    const struct tonemap *tone;
    float shift;             // log2 t - mid_log2t
    const uint8_t *photo;    // (3, h, w) of the photograph
    const uint16_t *photo16; // the same in 16 bits, 65535 is 1; NULL: photo
    const uint8_t *masked;   // (h, w) of the photograph: 1 = masked; NULL: nothing is
    int photo_w, photo_h;    // px; 0: those of the picture
    int x, y;                // px of the photograph where the picture begins, multiples of held_px
    float behind[3];         // display value added times (1 - alpha)
    float w_l1, w_ssim;
    const uint8_t *held;   // (ceil(photo_h / held_px), held_across) 1 = held out; NULL = nothing
    int held_px;           // edge of a square
    int held_across;       // squares in a row of `held`, >= ceil(photo_w / held_px)
    struct held_sum *sums; // (bands, held_across) out: of each 16 rows of the photograph that are
                           // compared here and each square, whose edge is a multiple of 16 then;
                           // NULL: not wanted
    /* The same for cells of cell_px, of which 16 is a multiple, in rows of cells_across. */
    const uint8_t *skip; // 1 = left out; NULL = nothing
    float *excess;       // (rows, 3, cells_across) out: mean of picture - photograph of each
                         // cell that is compared here, left out or not; NULL: not wanted
    int cell_px, cells_across;
    int first, end; // rows of the picture that this rank of a team compares, begin and end on
                    // multiples of 16 or at the picture's end; 10 more on both sides are drawn
    bool more;      // add to the gradients of the previous call: another photograph, same picture
};

struct loss_output {
    double loss;
    struct held_sum held;    // all of the picture
    float tone[TONE_PARAMS]; // gradient of the curves
};

/* Bytes that loss_init takes. */
size_t loss_plan(int w, int h, int workers);

/* err: ERR_ARG (a side below 11 px or above RASTER_SIDE_MAX), ERR_NOMEM. */
MUST_USE err_t loss_init(struct loss *l, struct arena *a, int w, int h, int workers);

/* Rows of cells of px pixels, `row` bytes each, that other ranks have compared.
 * data: from the first row of the photograph on; t: NULL: nothing to do.
 * err:  those of team_collect. */
MUST_USE err_t loss_gather(struct team *t, const struct loss_input *in, int px, void *data,
                           size_t row);

/* Value and gradient; the picture has the planned size or a smaller one (same workspace, other step
 * of a pyramid).
 * out:  *out, l->d_radiance and l->d_alpha (inputs of render_grad); of a rank: in its rows.
 * err:  ERR_ARG, those of team_gather. */
MUST_USE err_t loss_run(const struct run *r, struct loss *l, const struct loss_input *in,
                        struct loss_output *out);

#endif
