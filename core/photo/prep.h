/* prep.h - photographs to the 8-bit views that refiner and network see. The resize is
 * Pillow's antialiased bicubic, bit for bit; exposures become log2 (core/photo/README.md 1). Pure
 * computation, no files. */
#ifndef PHOTO_PREP_H
#define PHOTO_PREP_H

#include "core/base/plan.h"
#include "core/base/types.h"

enum { PREP_SIZE_MAX = 4096 }; // px, side of a view

/* Resize `in` (3 channels, any shape) to a square of `size` px; the aspect ratio is not kept.
 * tmp:  back at its mark on return; peak as prep_plan says for one shot and one thread.
 * out:  (size, size, 3).
 * err:  ERR_ARG (size, shape or channels), ERR_NOMEM. */
MUST_USE err_t prep_resize(const struct image8 *in, int size, struct arena *tmp, uint8_t *out);

/* How large views become: `edge` px on the longer side, the shape kept, but no picture is enlarged
 * beyond PREP_ENLARGED px; or squeezed to squares. */
enum { PREP_ENLARGED = 448 };
struct prep_size {
    int edge;
    bool square;
};

/* Shape of the view of a picture of w x h px. */
struct extent prep_extent(struct prep_size size, int w, int h);

/* Shapes of all views, in their order. out: (c->n). */
void prep_extents(const struct capture *c, struct prep_size size, struct extent *out);

/* Count what prep_run takes for n shots that become `pixels` in all; the largest of them, or a
 * larger one. */
void prep_plan(struct plan *p, int n, size_t pixels, struct image8 largest, int edge);
struct prep_source;
void prep_plan_capture(struct plan *p, const struct capture *c, const struct prep_source *from,
                       struct prep_size size);

/* Whether the views get planes of 16 bits: all shots are deep and the source can give them. */
bool prep_is_deep(const struct capture *c, const struct prep_source *from);

/* Largest width and height of all. */
struct image8 prep_largest(const struct capture *c);

/* Places that the shots were taken from. */
int prep_places(const struct capture *c);

/* Resize all shots, take their exposures to log2, scale their cameras to the views. The first
 * shot of a place represents it; its other shots follow after all places.
 * out:  arrays live in r->keep; cams is NULL unless every shot has a camera.
 * err:  ERR_ARG (no shot, bad size, a shot without picture or with an exposure that is not finite
 *       and > 0, a camera for another image size, another size than the shot before from the same
 *       place; the sentence names the file), ERR_NOMEM, ERR_CANCELLED. On error *out is zeroed. */
MUST_USE err_t prep_run(const struct run *r, const struct capture *c, struct prep_size size,
                        struct views *out);

/* A source of pixels that are not in the capture. A worker releases one picture before it decodes
 * the next. decode returns shot i with the size that the capture has. thread: any. */
struct prep_source {
    err_t (*decode)(void *ctx, int i, struct image8 *out);
    void (*release)(struct image8 *im);
    void *ctx;
    err_t (*decode16)(void *ctx, int i, struct image16 *out); // the same of a deep shot, or NULL
    void (*release16)(struct image16 *im);
    err_t (*decode_mask)(void *ctx, int i, struct image8 *out); // of a masked shot: black where its
                                                                // pixels do not count, else white
};

/* A mask that was resampled as its photograph, (h, w, 3), becomes that of struct views, (h, w): a
 * pixel counts if it and those up to 2 px away, as far as a cubic mixes them, are white. */
void prep_mask(const uint8_t *rgb, const struct extent *px, uint8_t *masked);

/* As prep_run.
 * from: NULL = the capture itself.
 * err:  those of prep_run and of decode. */
MUST_USE err_t prep_read(const struct run *r, const struct capture *c,
                         const struct prep_source *from, struct prep_size size, struct views *out);

/* One view as the network's input tensor: ((v / 255) * 2 - 1 + 1) * 0.5, each step rounded to float
 * as the reference does (core/photo/README.md 1.1, point 4).
 * rgb:  (size, size, 3).
 * out:  (3, size, size), in [0, 1]. */
void prep_to_float(const uint8_t *rgb, int size, float *out);

#endif
