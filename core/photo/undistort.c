/* A pixel of the pinhole is a ray, and the lens says where the photograph has it. With the
 * derivative J of that place the footprint of the pixel is the parallelogram J; it is sampled
 * as often as its sides are long. */
#include "core/photo/undistort.h"

#include "core/base/num.h"

#include <string.h>

enum {
    BORDER = 64, // points on a side of the frame that are looked at
    HALVINGS = 60,
    SAMPLES = 8, // per side of a footprint
    ROWS = 32    // per chunk
};

#define LEAST_SCALE 0.1  // relative to the frame
#define SCALE_MAX 4096.0 // a side of one pixel grows no further

/* ---- the pinhole ---- */

/* Length in the photograph of one px of the pinhole (with the lens's focal lengths), in the
 * direction in which it is shortest; 0 where the photograph ends. */
static double shortest_px(const struct lens *l, const double size[2], const double ray[3])
{
    double p[2], by_ray[6], by_param[2 * LENS_PARAMS];
    if (!lens_project_grad(l, ray, p, by_ray, by_param))
        return 0;
    for (int k = 0; k < 2; k++)
        if (p[k] < -1e-6 * size[k] || p[k] > (1 + 1e-6) * size[k])
            return 0;
    const double j[4] = {by_ray[0] / l->fx, by_ray[1] / l->fy, by_ray[3] / l->fx,
                         by_ray[4] / l->fy};
    const double sum = j[0] * j[0] + j[1] * j[1] + j[2] * j[2] + j[3] * j[3];
    const double det = j[0] * j[3] - j[1] * j[2];
    return sqrt(fmax(0, (sum - sqrt(fmax(0, sum * sum - 4 * det * det))) / 2)); // singular value
}

/* Pinhole frames about a centre, px of the photograph. */
struct frame {
    const struct lens *lens;
    double size[2], centre[2];
};

/* Whether the frame, scaled by z about its centre, is seen everywhere. Pixels move away from the
 * principal point as rays do, so with the border the inside is seen. */
static bool is_covered(const struct frame *f, const double z[2])
{
    for (int i = 0; i < 4 * BORDER; i++) {
        const double along = (double)(i % BORDER) / BORDER;
        const double side[4][2] = {{along, 0}, {1, along}, {1 - along, 1}, {0, 1 - along}};
        const double *at = side[i / BORDER];
        const double ray[3] = {z[0] * (at[0] * f->size[0] - f->centre[0]) / f->lens->fx,
                               z[1] * (at[1] * f->size[1] - f->centre[1]) / f->lens->fy, 1};
        if (shortest_px(f->lens, f->size, ray) * UNDISTORT_STRETCH < 1)
            return false;
    }
    return true;
}

/* Grow the frame across, down or both, as far as it is covered. */
static void grow_field(const struct frame *f, bool across, bool down, double z[2])
{
    const double from[2] = {z[0], z[1]};
    double low = 0, high = SCALE_MAX;
    for (int i = 0; i < HALVINGS; i++) {
        const double middle = (low + high) / 2;
        z[0] = from[0] + (across ? middle : 0);
        z[1] = from[1] + (down ? middle : 0);
        *(is_covered(f, z) ? &low : &high) = middle;
    }
    z[0] = from[0] + (across ? low : 0);
    z[1] = from[1] + (down ? low : 0);
}

err_t undistort_camera(const char *what, const struct lens *l, int w, int h, struct camera *out)
{
    const struct frame f = {l, {w, h}, {l->cx, l->cy}};
    double z[2] = {0, 0};
    if (l->model == LENS_PINHOLE) {
        out->w = w;
        out->h = h;
        out->fx = (float)l->fx;
        out->fy = (float)l->fy;
        out->cx = (float)l->cx;
        out->cy = (float)l->cy;
        return OK;
    }
    if (!(l->cx > 0 && l->cx < w && l->cy > 0 && l->cy < h))
        return err_fail(ERR_FORMAT,
                        "%s: principal point %g, %g outside its %d x %d px: a %s lens is "
                        "undistorted around it",
                        what, l->cx, l->cy, w, h, lens_name(l->model));
    grow_field(&f, true, true, z);
    grow_field(&f, true, false, z);
    grow_field(&f, false, true, z);
    if (!(fmin(z[0], z[1]) >= LEAST_SCALE))
        return err_fail(ERR_FORMAT,
                        "%s: %s lens that leaves %.2g of the side of %d x %d px without "
                        "distortion, less than %g: its parameters cannot be right",
                        what, lens_name(l->model), fmin(z[0], z[1]), w, h, LEAST_SCALE);
    const double shrink = fmin(1, UNDISTORT_ENLARGE / fmax(z[0], z[1]));
    out->w = num_max(1, (int)lrint(shrink * z[0] * w));
    out->h = num_max(1, (int)lrint(shrink * z[1] * h));
    const double across = (double)out->w / w, down = (double)out->h / h;
    out->fx = (float)(across * l->fx / z[0]);
    out->fy = (float)(down * l->fy / z[1]);
    out->cx = (float)(across * l->cx);
    out->cy = (float)(down * l->cy);
    return OK;
}

double undistort_frame(const struct lens *l, int w, int h, int size[2])
{
    const struct frame f = {l, {w, h}, {0.5 * w, 0.5 * h}};
    const bool wide = w > h, high = h > w;
    double z[2] = {0, 0};
    size[0] = w;
    size[1] = h;
    grow_field(&f, true, true, z);
    if (!(z[0] > 0))
        return 0;
    const double both = z[0];
    grow_field(&f, wide, high, z);
    if (wide)
        size[1] = num_max(1, (int)lround(h * both / z[0]));
    else if (high)
        size[0] = num_max(1, (int)lround(w * both / z[1]));
    return l->fx / fmax(z[0], z[1]);
}

/* Angle to the axis of a pixel in the middle of a side; beyond the image circle: its edge's. */
static double angle_deg(const struct lens *l, double u, double v)
{
    const double pixel[2] = {u, v};
    double ray[3], angle = l->model == LENS_OPENCV_FISHEYE ? l->limit : atan(l->limit);
    if (lens_unproject(l, pixel, ray))
        angle = atan2(hypot(ray[0], ray[1]), ray[2]);
    return angle * 180 / NUM_PI;
}

struct undistort_field undistort_field(const struct lens *l, int w, int h,
                                       const struct camera *pinhole)
{
    const double f[2] = {(double)pinhole->fx, (double)pinhole->fy};
    const double c[2] = {(double)pinhole->cx, (double)pinhole->cy};
    const double size[2] = {pinhole->w, pinhole->h};
    struct undistort_field out;
    out.given_deg[0] = angle_deg(l, 0, l->cy) + angle_deg(l, w, l->cy);
    out.given_deg[1] = angle_deg(l, l->cx, 0) + angle_deg(l, l->cx, h);
    for (int k = 0; k < 2; k++)
        out.kept_deg[k] = (atan(c[k] / f[k]) + atan((size[k] - c[k]) / f[k])) * 180 / NUM_PI;
    return out;
}

/* ---- pixels ---- */

struct job {
    const struct lens *lens;
    const struct camera *pinhole;
    const struct image8 *in8; // one of these three
    const struct image16 *in16;
    const struct image *in;
    uint8_t *out8;
    uint16_t *out16;
    float *out;
};

static int clamp(int i, int n)
{
    return i < 0 ? 0 : i < n ? i : n - 1;
}

/* Keys' cubic with a = -1/2 at distances 1 + t, t, 1 - t, 2 - t. */
static void cubic_weights(float t, float w[4])
{
    const float s = 1 - t;
    w[0] = -0.5f * t * s * s;
    w[1] = 1 + t * t * (1.5f * t - 2.5f);
    w[2] = 1 + s * s * (1.5f * s - 2.5f);
    w[3] = -0.5f * s * t * t;
}

/* The 16 pixels around a point, whose centres are at .5: where they begin in the picture, and their
 * weights. */
struct cubic_taps {
    size_t at[16];
    float weight[16];
};

static struct cubic_taps cubic_taps(const double at[2], int w, int h)
{
    const double u = at[0] - 0.5, v = at[1] - 0.5;
    const int x = (int)floor(u), y = (int)floor(v);
    struct cubic_taps t;
    float wx[4], wy[4];
    cubic_weights((float)(u - x), wx);
    cubic_weights((float)(v - y), wy);
    for (int k = 0; k < 16; k++) {
        t.at[k] =
            3 * ((size_t)clamp(y - 1 + k / 4, h) * (size_t)w + (size_t)clamp(x - 1 + k % 4, w));
        t.weight[k] = wy[k / 4] * wx[k % 4];
    }
    return t;
}

static void add_cubic(const struct image8 *in, const double at[2], float sum[3])
{
    const struct cubic_taps t = cubic_taps(at, in->w, in->h);
    for (int k = 0; k < 16; k++)
        for (size_t c = 0; c < 3; c++)
            sum[c] += t.weight[k] * (float)in->px[t.at[k] + c];
}

static void add_cubic16(const struct image16 *in, const double at[2], float sum[3])
{
    const struct cubic_taps t = cubic_taps(at, in->w, in->h);
    for (int k = 0; k < 16; k++)
        for (size_t c = 0; c < 3; c++)
            sum[c] += t.weight[k] * (float)in->px[t.at[k] + c];
}

static void add_linear(const struct image *in, const double at[2], float sum[3])
{
    const double u = at[0] - 0.5, v = at[1] - 0.5;
    const int x = (int)floor(u), y = (int)floor(v);
    const float wx[2] = {(float)(x + 1 - u), (float)(u - x)},
                wy[2] = {(float)(y + 1 - v), (float)(v - y)};
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 4; k++) {
            const size_t line = (size_t)c * (size_t)in->h + (size_t)clamp(y + k / 2, in->h);
            const size_t i = line * (size_t)in->w + (size_t)clamp(x + k % 2, in->w);
            if (wy[k / 2] * wx[k % 2] > 0) // 0 times infinity
                sum[c] += wy[k / 2] * wx[k % 2] * in->px[i];
        }
}

/* Samples along side k of the footprint, and the share of the side over which they are spread: a
 * side of J px in the photograph, whose pixels are averages over 1 px each, needs sqrt(J^2 - 1). */
static int samples_along(const double j[4], int k, double *spread)
{
    const double side = hypot(j[k], j[2 + k]), more = sqrt(fmax(0, side * side - 1));
    *spread = side > 1 ? more / side : 0;
    return more < SAMPLES ? num_max(1, (int)ceil(more)) : SAMPLES;
}

/* Mean over the footprint of pixel (x, y); no source, which rounding can cause at the border: 0. */
static void average_footprint(const struct job *job, int x, int y, float mean[3])
{
    const struct camera *p = job->pinhole;
    const double f[2] = {(double)p->fx, (double)p->fy};
    const double ray[3] = {(x + 0.5 - (double)p->cx) / f[0], (y + 0.5 - (double)p->cy) / f[1], 1};
    double at[2], by_ray[6], by_param[2 * LENS_PARAMS];
    memset(mean, 0, 3 * sizeof *mean);
    if (!lens_project_grad(job->lens, ray, at, by_ray, by_param))
        return;
    const double j[4] = {by_ray[0] / f[0], by_ray[1] / f[1], by_ray[3] / f[0], by_ray[4] / f[1]};
    double sx, sy;
    const int nx = samples_along(j, 0, &sx), ny = samples_along(j, 1, &sy);
    for (int i = 0; i < nx * ny; i++) {
        const double dx = sx * ((i % nx + 0.5) / nx - 0.5), dy = sy * ((i / nx + 0.5) / ny - 0.5);
        const double to[2] = {at[0] + j[0] * dx + j[1] * dy, at[1] + j[2] * dx + j[3] * dy};
        if (job->in8)
            add_cubic(job->in8, to, mean);
        else if (job->in16)
            add_cubic16(job->in16, to, mean);
        else
            add_linear(job->in, to, mean);
    }
    for (int c = 0; c < 3; c++)
        mean[c] /= (float)(nx * ny);
}

static err_t resample_rows(void *ctx, int chunk, int worker)
{
    const struct job *j = ctx;
    const int w = j->pinhole->w, h = j->pinhole->h, to = num_min(h, (chunk + 1) * ROWS);
    (void)worker;
    for (int y = chunk * ROWS; y < to; y++)
        for (int x = 0; x < w; x++) {
            const size_t i = (size_t)y * (size_t)w + (size_t)x, plane = (size_t)w * (size_t)h;
            float mean[3];
            average_footprint(j, x, y, mean);
            for (size_t c = 0; c < 3 && j->out8; c++)
                j->out8[3 * i + c] = (uint8_t)(fminf(fmaxf(mean[c], 0), 255) + 0.5f);
            for (size_t c = 0; c < 3 && j->out16; c++)
                j->out16[3 * i + c] = (uint16_t)(fminf(fmaxf(mean[c], 0), 65535) + 0.5f);
            for (size_t c = 0; c < 3 && j->out; c++)
                j->out[c * plane + i] = mean[c];
        }
    return OK;
}

err_t undistort_image8(struct pool *pool, const struct lens *l, const struct image8 *in,
                       const struct camera *pinhole, uint8_t *out)
{
    struct job j = {.lens = l, .pinhole = pinhole, .in8 = in, .out8 = out};
    return pool_for(pool, (pinhole->h + ROWS - 1) / ROWS, resample_rows, &j);
}

err_t undistort_image16(struct pool *pool, const struct lens *l, const struct image16 *in,
                        const struct camera *pinhole, uint16_t *out)
{
    struct job j = {.lens = l, .pinhole = pinhole, .in16 = in, .out16 = out};
    return pool_for(pool, (pinhole->h + ROWS - 1) / ROWS, resample_rows, &j);
}

err_t undistort_image(struct pool *pool, const struct lens *l, const struct image *in,
                      const struct camera *pinhole, float *out)
{
    struct job j = {.lens = l, .pinhole = pinhole, .in = in, .out = out};
    return pool_for(pool, (pinhole->h + ROWS - 1) / ROWS, resample_rows, &j);
}
