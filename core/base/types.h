/* types.h - the plain structs that modules exchange.
 * All fields are visible; each has its shape, unit and range. Arrays live in an arena of the caller
 * unless said. */
#ifndef BASE_TYPES_H
#define BASE_TYPES_H

#include "core/base/arena.h"
#include "core/base/err.h"
#include "core/base/lens.h"
#include "core/base/pool.h"
#include "core/base/team.h"

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Decoded picture, 8 bits per channel. */
struct image8 {
    int w, h, channels; // px; channels is 3 (R,G,B) unless said
    uint8_t *px;        // (h, w, channels), row 0 on top
};

/* Decoded picture, 16 bits per channel: display values, 65535 is 1. */
struct image16 {
    int w, h, channels;
    uint16_t *px; // (h, w, channels), row 0 on top
};

/* Linear radiance or any float map. */
struct image {
    int w, h, channels; // px; channels in the order R,G,B[,A]
    float *px;          // (channels, h, w), row 0 on top
};

/* Pinhole camera, x right, y down, z forward. X_cam = R(q) X_world + t; u = fx x/z + cx; pixel
 * (i, j) has its centre at u = i + 0.5, v = j + 0.5 (COLMAP's and gsplat's convention). */
struct camera {
    int w, h;             // px, of the image that fx, fy, cx, cy belong to
    float fx, fy, cx, cy; // px
    float q[4];           // world to camera, w,x,y,z, unit length
    float t[3];           // scene units
};

enum { NAME_CAP = 128 }; // bytes of an image name with its terminating 0

struct rawframe;

/* One photograph as it came from a file or a device. */
struct shot {
    char name[NAME_CAP]; // file name without folder
    struct image8 image;
    double exposure; // linear exposure time x gain, > 0, any common unit; 0 = not known
    bool has_camera;
    bool calibrated;   // cam is that of a rig's calibration
    bool metres;       // lengths of cam are metres; else the unit is any
    struct camera cam; // for image.w x image.h
    struct lens lens;  // PINHOLE: image is the photograph as taken; else it was undistorted from
                       // one of taken_w x taken_h px through this lens
    int taken_w, taken_h;
    bool masked;                // a file says which of its pixels count
    bool deep;                  // its file holds more than 8 bits
    bool linear;                // its file holds linear values: display values are their sRGB
    const struct rawframe *raw; // numbers of the sensor, read instead of its file; NULL: none
    bool again;                 // from the same place as the shot before it, at another exposure
    char camera_id[NAME_CAP];   // photographs with the same one share the lens of a physical camera
    double focal_px; // expected by its metadata, for the photograph as taken; 0: not known
    int turned;      // quarter turns clockwise from the sensor to the photograph, 0..3
};

/* A set of photographs of one static scene. */
struct capture {
    int n;
    struct shot *shots; // (n)
};

/* Shape of one of several pictures, and where it begins: they lie one after another. */
struct extent {
    int w, h;  // px
    size_t at; // pixels of all pictures before it
};

static inline size_t extent_pixels(const struct extent *e)
{
    return (size_t)e->w * (size_t)e->h;
}

/* Pixels of n pictures. */
static inline size_t extent_total(const struct extent *e, int n)
{
    return n > 0 ? e[n - 1].at + extent_pixels(&e[n - 1]) : 0;
}

/* Room for any one of n pictures: w and h of the widest and the highest, at: pixels of the
 * largest. */
static inline struct extent extent_cover(const struct extent *e, int n)
{
    struct extent out = {0, 0, 0};
    for (int i = 0; i < n; i++) {
        out.w = e[i].w > out.w ? e[i].w : out.w;
        out.h = e[i].h > out.h ? e[i].h : out.h;
        out.at = extent_pixels(&e[i]) > out.at ? extent_pixels(&e[i]) : out.at;
    }
    return out;
}

struct shade;

/* Photographs as the refiner and the network see them: 8 bit, exposures in log2
 * (core/photo/README.md 1.1 and 1.2); rectangles, for the network squares. Photographs 0 .. n - 1
 * show one place each, and most steps use only these; n .. n + n_more - 1 are other exposures of
 * these places, each of the shape that the first one of its place has. */
struct views {
    int n, size;           // places; px, the longest edge
    float aspect;          // height over width of the photographs if they are squeezed to squares,
                           // else 1; 0: 1
    struct extent *extent; // (n + n_more) in rgb
    char (*names)[NAME_CAP]; // (n + n_more)
    uint8_t *rgb;            // (n + n_more) pictures (h, w, 3)
    bool deep;               // there is rgb16
    uint16_t *rgb16;         // the pictures in 16 bits, 65535 is 1; NULL: only in 8
    uint8_t *masked;         // (n + n_more) pictures (h, w), 1: the pixel shows nothing of the
                             // scene, and its value changes nothing; NULL: none does
    float *log2t;            // (n + n_more) log2(max(t, 1e-8)), and drift
    const float *drift;      // (n + n_more) stops in log2t by which the light was brighter than in
                             // the others; NULL: it was alike
    float mid_log2t;         // (min + max) / 2 of log2t of all photographs
    bool srgb;               // the response is known to be that of sRGB, white at 1
    struct camera *cams;     // (n) for the extents; NULL if not known
    int n_more;
    int *place;                // (n_more) of photograph n + i, ascending
    const struct shade *shade; // (n) core/photo/shade.h; NULL: all cameras show light alike
};

static inline uint8_t *views_rgb(const struct views *v, int i)
{
    return v->rgb + 3 * v->extent[i].at;
}

static inline uint16_t *views_rgb16(const struct views *v, int i)
{
    return v->rgb16 + 3 * v->extent[i].at;
}

/* Its masked pixels (h, w); NULL: none are. */
static inline uint8_t *views_masked(const struct views *v, int i)
{
    return v->masked ? v->masked + v->extent[i].at : NULL;
}

/* Whether pixel k of photograph i is masked. */
static inline bool views_hides(const struct views *v, int i, size_t k)
{
    return v->masked && v->masked[v->extent[i].at + k];
}

/* Whether any pixel of the square of n x n px is, with (x, y) at its upper left. */
static inline bool views_hides_any(const struct views *v, int i, int x, int y, int n)
{
    for (int k = 0; v->masked && k < n * n; k++)
        if (views_hides(v, i, (size_t)(y + k / n) * (size_t)v->extent[i].w + (size_t)(x + k % n)))
            return true;
    return false;
}

/* The exposure as it was set. */
static inline float views_set_log2t(const struct views *v, int i)
{
    return v->drift ? v->log2t[i] - v->drift[i] : v->log2t[i];
}

/* The photograph of this place after photograph `last` (its first one is `place`); -1: none. */
static inline int views_next(const struct views *v, int place, int last)
{
    for (int i = last < v->n ? 0 : last - v->n + 1; i < v->n_more; i++)
        if (v->place[i] == place)
            return v->n + i;
    return -1;
}

enum {
    SH_DEGREE_MAX = 4,
    SH_COEFS_MAX = 25,
    /* planes of struct gaussians */
    G_MU = 0,        // 3: centre, scene units
    G_LOG_SCALE = 3, // 3: ln of the standard deviations, scene units
    G_QUAT = 6,      // 4: w,x,y,z, any length > 0 (normalised where used)
    G_LOGIT = 10,    // 1: logit of the opacity
    G_SH = 11,       // 3 (degree+1)^2: natural-log radiance, plane G_SH + 3*k + colour
    G_PLANES_MAX = G_SH + 3 * SH_COEFS_MAX
};

#define SH_BASIS0 0.28209479177387814 // the constant band everywhere, core/splat/README.md 4

/* Gaussians, structure of arrays: plane p of splat i is p[plane][i]. Planes above the degree are
 * NULL or unused. */
struct gaussians {
    int n, cap;                 // used; room in each plane
    int degree;                 // spherical harmonics: 0..4
    float *plane[G_PLANES_MAX]; // (cap) each, 64-byte aligned, cap a multiple of 16
};

static inline int gaussians_planes(int degree)
{
    return G_SH + 3 * (degree + 1) * (degree + 1);
}

enum { TONE_HIDDEN = 64, TONE_PER_COLOUR = 3 * TONE_HIDDEN + 1, TONE_PARAMS = 3 * TONE_PER_COLOUR };

/* Response from radiance to display value (core/photo/README.md 2.1): per colour
 * sigmoid(b2 + sum_k w2_k relu(w1_k x + b1_k)), x = log2(radiance + 1e-6) + log2 t - mid_log2t. */
struct tonemap {
    float p[TONE_PARAMS]; // per colour w1[64] b1[64] w2[64] b2
    float mid_log2t;
};

/* All data that rendering needs. */
struct scene {
    struct gaussians g;
    struct tonemap tone;
    float background[3];     // linear radiance behind everything, >= 0
    int n_views, size;       // input views; px
    char (*names)[NAME_CAP]; // (n_views)
    float *log2t;            // (n_views)
    struct camera *cams;     // (n_views) for size x size
    float *confidence;       // (g.n) 0..1, core/refine/confidence.h; NULL: not known
    bool metres;             // scene units are metres; else any
};

/* Called between steps by the thread that runs the job; done <= total. */
typedef void progress_fn(void *ctx, const char *stage, int done, int total, const char *note);

struct kernels;

enum { TAP_RANK_MAX = 5 };

/* One intermediate tensor, or one of `parts` equal pieces of it in C order. */
struct tap_tensor {
    const char *name;              // as in the reference's golden data
    int rank, shape[TAP_RANK_MAX]; // shape of the whole tensor
    int part, parts;
    const float *data;           // first element of this piece, or NULL:
    const int32_t *ints;         // the same as integers
    size_t stride[TAP_RANK_MAX]; // elements, from index to index of each axis
};

/* Receives intermediate tensors. thread: any, also several at once. */
struct tap {
    void (*put)(void *ctx, const struct tap_tensor *t);
    void *ctx;
};

enum {
    CORRESPONDENCE_PATCH = 14, // px, edge of a patch (core/net/README.md 2.1)
    CORRESPONDENCE_BEST = 4
};

/* Matches of the patches of one view in another by the network (core/net/shared_attention.h). */
struct correspondence {
    int n_views, grid;
    int16_t
        *token;   // (n_views, grid^2, n_views, CORRESPONDENCE_BEST) of the other view, best first;
                  // -1: none
    float *share; // same shape: share of the attention to that view, 0..1
};

/* Context of every heavy function. */
struct run {
    const struct kernels *k;
    struct pool *pool;        // NULL = single thread
    struct team *team;        // NULL = alone: other processes that work on this job
    struct arena *keep, *tmp; // results; scratch, reset to its mark before the function returns
    atomic_bool *cancel;      // NULL = never; checked at least every 0.5 s, then ERR_CANCELLED
    progress_fn *progress;    // NULL = none
    void *progress_ctx;
    const struct tap *tap; // NULL = none: tensors that are only inspected are not computed
    double (*clock)(void); // s, only rises; NULL = none: nothing depends on time
};

/* Check whether the job was cancelled; `stage` begins the sentence.
 * err:  ERR_CANCELLED. */
static inline MUST_USE err_t run_check(const struct run *r, const char *stage)
{
    if (r->cancel && atomic_load(r->cancel))
        return err_fail(ERR_CANCELLED, "%s: cancelled", stage);
    return OK;
}

#endif
