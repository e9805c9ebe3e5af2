/* raster.h - pictures of Gaussians: forward, and the gradient of a loss on the picture.
 * Equal to gsplat 1.4.0 with the options of the release (core/splat/README.md 2 and 3), up to float
 * rounding near its thresholds, but for splats that reach RASTER_REACH deviations behind the
 * camera: these are not drawn.
 * Invariant: the result depends only on the input, never on the number of threads.
 * Nothing is allocated after raster_init: when splats cover more tiles than planned, the picture
 * is made in several groups of tiles.
 *
 * Defined results at the extremes: splats with a NaN or infinite number, behind or nearer than
 * RASTER_NEAR, with opacity below 1/255, or wider than 1e9 px are not drawn; log radiance is
 * clamped to +-RASTER_LOG_MAX; a zero quaternion is the identity; gradients that are
 * not finite are 0. */
#ifndef SPLAT_RASTER_H
#define SPLAT_RASTER_H

#include "core/base/types.h"
#include "core/kernels/kernels.h"

enum {
    RASTER_SIDE_MAX = 4080, // px; tile numbers are stored in 8 bits
    RASTER_CHUNK = 512      // splats in one chunk of the pool, a multiple of SPLAT_BLOCK
};

/* A picture. Maps of w x h pixels, owned by the caller. */
struct render {
    int w, h;
    float *radiance; // (3, h, w) linear, with background
    float *depth;    // (h, w) sum of z alpha T, not divided by alpha; NULL = not wanted
    float *alpha;    // (h, w) 0..1
};

/* Scene and camera to draw. */
struct raster_input {
    const struct gaussians *g;
    const struct camera *cam;
    float background[3]; // linear radiance
};

/* A rectangle of tiles whose lists fit the planned memory. */
struct raster_group {
    int x0, x1, y0, y1; // tiles, half open
};

/* Tile rows of a splat, half open, and its tiles in each; all 0: it is not seen. */
struct raster_span {
    uint8_t y0, y1, wide;
};

/* Workspace. Fields belong to raster.c and raster_grad.c. */
struct raster {
    int cap, w, h, tiles_x, tiles_y;
    size_t cap_pairs;            // room for splat-tile pairs in one group
    struct splat2d *splats;      // (cap)
    uint32_t *block_seen;        // visible splats before each block
    uint32_t *key[2], *order[2]; // (cap) depth keys and splat numbers
    uint64_t *boxes;             // (cap) splat number and tile rectangle, by depth
    uint32_t *tile_count;        // (tiles) splats per tile
    uint32_t *start;             // (tiles + 1) of the current group, row-major in the group
    uint32_t *list;              // (cap_pairs)
    struct raster_group *groups; // (tiles)
    int n_groups, loaded;        // loaded: group whose lists are in place
    int n_seen;
    struct view_geom view;
    float *trans;   // (h, w)
    float *front;   // (h, w); NULL without gradients
    int32_t *stop;  // (h, w)
    float *slots;   // (cap_pairs, SLOT); NULL without gradients
    float *sums;    // (cap, SLOT)
    float *partial; // pose gradients per chunk
    /* Set after raster_init with gradients: the tile rows of each picture are dealt out to these
     * ranks, whose scenes and cameras are the same; a rank's maps are complete in the rows of
     * raster_rows and, where the picture goes on, RASTER_HALO rows beyond. Gradients are summed
     * over the ranks, as far as they are by radiance and alpha. NULL: alone. */
    struct team *team;
    struct raster_span *spans; // (cap) with gradients, of a team
    int row0, row1;            // tile rows that are drawn
    int band[TEAM_MAX + 1];    // first tile row of each rank
};

enum { RASTER_HALO = TILE };

/* Bytes that raster_init takes for pictures up to w x h and up to cap splats. */
size_t raster_plan(int cap, int w, int h, bool gradients);

/* err: ERR_ARG (sizes), ERR_NOMEM. */
MUST_USE err_t raster_init(struct raster *rs, struct arena *a, int cap, int w, int h,
                           bool gradients);

/* Draw. in->g->n <= cap; the camera's w, h are those of the picture and at most the planned ones.
 * out:  the maps of *out, whose w, h are set.
 * err:  ERR_ARG, ERR_CANCELLED. */
MUST_USE err_t raster_run(const struct run *r, struct raster *rs, const struct raster_input *in,
                          struct render *out);

/* Rows of the picture drawn last that this rank has: all, or those dealt to it. */
void raster_rows(const struct raster *rs, int *first, int *end);

/* d loss / d maps of the picture drawn last; of a rank: in its rows. */
struct render_grad {
    const float *radiance; // (3, h, w)
    const float *depth;    // (h, w) or NULL
    const float *alpha;    // (h, w) or NULL
};

/* Receives the gradient of splats [first, first + count), count <= SPLAT_BLOCK.
 * grad: (planes of the degree, SPLAT_BLOCK); seen: 1 where the splat was drawn and not hidden
 * (core/splat/README.md 5), else 0.
 * thread: called at the same time for different blocks, each exactly once. */
typedef void raster_sink_fn(void *ctx, int first, int count, const float *grad, const float *seen);

struct raster_sink {
    raster_sink_fn *fn;
    void *ctx;
    float *pose;       // (POSE_GRAD) dL/d R, t, fx fy cx cy, or NULL
    float *background; // (3) or NULL; alone
};

/* Backward pass of the last raster_run on this workspace with the same input. The sink may change
 * the splats of its own block.
 * err: ERR_ARG (no gradients planned), ERR_CANCELLED. */
MUST_USE err_t raster_grad_run(const struct run *r, struct raster *rs,
                               const struct raster_input *in, const struct render_grad *up,
                               const struct raster_sink *sink);

/* Choose the rows of each rank, once n splats are projected (for raster.c). */
void raster_team_deal(struct raster *rs, int n);

/* sums of the rows of this rank become those of all ranks. done: called for chunks [first, end)
 * of splats once theirs are complete, while others are on their way (for raster_grad.c).
 * err: those of team_begin and of done. */
typedef err_t raster_team_fn(void *ctx, int first, int end);
MUST_USE err_t raster_team_sum(const struct run *r, struct raster *rs, int n, raster_team_fn *done,
                               void *ctx);

/* Fill lists of group `i` unless they are in place (for raster_grad.c). */
MUST_USE err_t raster_load_group(const struct run *r, struct raster *rs, int i);

/* The tile number k of the loaded group, ready for tile kernels (for raster_grad.c). */
struct tile raster_tile(const struct raster *rs, const struct raster_input *in, int k);

#endif
