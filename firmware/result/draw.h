/* draw.h - pictures of a scene: radiance, the photograph of it at an exposure, and both as files.
 * */
#ifndef RESULT_DRAW_H
#define RESULT_DRAW_H

#include "core/base/types.h"
#include "core/photo/tonemap.h"
#include "core/splat/raster.h"

struct draw {
    struct raster raster;
    struct render maps;   // maps of the picture drawn last
    struct image display; // (3, h, w) in 0..1, of the last draw_display
    struct tonemap_table table;
    float mid_log2t;
};

/* Room for the picture of any view: w and h of the widest and the highest. */
struct extent draw_cover(const struct scene *s);

/* Bytes that draw_init takes for pictures up to w x h px of gaussians made for `cap` splats. */
size_t draw_plan(int cap, int w, int h);

/* err:  ERR_ARG (size), ERR_NOMEM. */
MUST_USE err_t draw_init(struct draw *d, struct arena *a, int cap, int w, int h);

/* Radiance, depth and alpha of the scene as `cam` sees it, into d->maps.
 * err:  as raster_run. */
MUST_USE err_t draw_run(const struct run *r, struct draw *d, const struct scene *s,
                        const struct camera *cam);

/* The photograph of d->maps at exposure log2t, into d->display, as a camera shades it; NULL: as it
 * is. */
void draw_display(struct draw *d, const struct shade *shade, float log2t);

/* The camera that is drawn for a photograph of cam->w x cam->h px through a lens: *cam, or the
 * pinhole that covers what a lens that distorts shows, with sides of at most `most` px.
 * err:  as distort_camera. */
MUST_USE err_t draw_lens_camera(const struct lens *l, const struct camera *cam, int most,
                                struct camera *out);

/* A photograph through a lens that distorts. */
struct draw_lens {
    const struct lens *lens; // of px
    const struct camera *drawn;
    struct extent px;
    float *room;   // (4, h, w)
    uint8_t *seen; // (h, w) result: 1 where *drawn saw what the lens shows, else 0; or NULL
};

/* Radiance and alpha of d->maps, which l->drawn saw, become those of the photograph. */
MUST_USE err_t draw_through_lens(struct pool *pool, struct draw *d, const struct draw_lens *l);

/* The confidence of pixels (core/refine/confidence.h). */
struct draw_confidence {
    struct scene splats; // drawn
    float *colour;       // (cap) of these
    float *map;          // (h, w) of the last draw_confidence_run
};

size_t draw_confidence_plan(int cap, int w, int h);

/* Maps up to w x h px of scenes made for `cap` splats.
 * err:  ERR_NOMEM. */
MUST_USE err_t draw_confidence_init(struct draw_confidence *c, struct arena *a, int cap, int w,
                                    int h);

/* Show s, which has confidence and outlives *c. */
void draw_confidence_set(struct draw_confidence *c, const struct scene *s);

/* Into c->map; d->maps are spoilt.
 * err:  as draw_run. */
MUST_USE err_t draw_confidence_run(const struct run *r, struct draw *d, struct draw_confidence *c,
                                   const struct camera *cam);

/* d->maps as EXR: radiance and alpha in half floats, with the camera; log2t becomes expTime.
 * out:  *clipped = values beyond the largest half, stored as that.
 * err:  ERR_IO, ERR_NOMEM. */
MUST_USE err_t draw_write_exr(const struct draw *d, const struct camera *cam, float log2t,
                              const char *path, size_t *clipped);

enum { DRAW_NAME_CAP = NAME_CAP + 16 };

/* "FOLDER/NAME.EXTENSION": the file of a view in a result; NAME is that of its photograph without
 * extension. folder and extension: at most 7 bytes each. */
void draw_name(const char *folder, const char *name, const char *extension,
               char out[DRAW_NAME_CAP]);

#endif
