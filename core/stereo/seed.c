/* Views are processed by falling score (confidence of depth times reliability of the pictures). The
 * map of a view is cut into blocks; a block that is flat in colour and in depth becomes one splat,
 * others are cut into four, down to a quarter of a pixel of the map. Each splat is projected into
 * all views: where it explains a pixel, that pixel gets no splat of its own, and its radiance
 * counts. A second round fills pixels that no splat covers, at the depth of the farthest usable
 * surfaces around them: there they fill holes and occlude nothing. (At the mean depth around them
 * they cost 0.1 to 2.4 dB in five scenes without refinement; at the farthest depth of the whole
 * view 0.2 dB more than here.) */
#include "core/stereo/seed.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/photo/response.h"

#include <math.h>
#include <string.h>

enum {
    BLOCK = 8,      // largest block, px of the map
    RETREATS = 16,  // steps by which a guess may go back
    TRIES = 12,     // times the detail may be given up
    SAMPLES = 4,    // pixels per axis that are read for the colour of a splat in one view
    LEVELS_MAX = 9, // of the smooth depth
    BINS = 64       // of inverse depth between the farthest and the nearest usable surface
};

enum {
    FREE = 0,
    COVERED = 1,
    EXPLAINED = 2
}; // marks of a pixel: a splat lies there; a splat lies at the pixel's own depth

static const float FARTHEST =
    0.05f; // share of the usable pixels around a guess that may lie behind it
static const float AROUND = 0.3f;     // least share of usable pixels in the blocks around
static const float DETAIL = 0.06f;    // relative contrast at which a block is cut, first try
static const float FLAT = 0.006f;     // relative distance of inverse depths from a plane, first try
static const float RETREAT = 0.94f;   // factor on inverse depth of one step
static const float WIDTH = 0.55f;     // standard deviation per spacing
static const float THICKNESS = 0.15f; // standard deviation across the surface per spacing
static const float TILT_MIN = 0.25f;  // cosine of the steepest surface

struct frame {
    float r[9], t[3]; // world to camera
    float f[2], c[2]; // px of the map
};

struct seed {
    const struct run *run;
    const struct seed_input *in;
    struct gaussians *out;
    int max;
    float loss; // factor on the thresholds: > 1 gives up detail
    bool full;
    float linear[3][256], weight[3][256]; // tables of the response for exposure shift 0
    struct frame *frame;                  // (n)
    int *order;                           // (n) views, best first
    float *score;                         // (n)
    uint8_t *mark;                        // (n, size, size)
    float *levels; // (2, 4/3 size^2 + ...) inverse depth times weight, weight: pyramid of one view
    float *rho;    // (size, size) of the view in work
    uint32_t *sum; // (blocks + 1, blocks + 1, BINS) sure pixels above, to the left and up to a bin
};

/* A square of the map with the plane of inverse depth a (x - x0) + b (y - y0) + c through its
 * middle. */
struct patch {
    int view;
    float x, y, side; // middle and edge, px of the map
    float a, b, c;
    bool sure; // else a guess
};

/* ---- cameras ---- */

static void set_frame(const struct camera *cam, int scale, struct frame *f)
{
    double r[9];
    rotation_of_camera(cam, r);
    for (int i = 0; i < 9; i++)
        f->r[i] = (float)r[i];
    memcpy(f->t, cam->t, sizeof f->t);
    f->f[0] = cam->fx / (float)scale;
    f->f[1] = cam->fy / (float)scale;
    f->c[0] = cam->cx / (float)scale;
    f->c[1] = cam->cy / (float)scale;
}

static void to_world(const struct frame *f, const float *v, float *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = f->r[i] * v[0] + f->r[3 + i] * v[1] + f->r[6 + i] * v[2];
}

/* Pixel of the map and depth; false behind the camera or outside. */
static bool project_to_map(const struct frame *f, const float *x, int size, float *out)
{
    float p[3];
    for (int i = 0; i < 3; i++)
        p[i] = f->r[3 * i] * x[0] + f->r[3 * i + 1] * x[1] + f->r[3 * i + 2] * x[2] + f->t[i];
    if (!(p[2] > 1e-6f))
        return false;
    out[0] = f->f[0] * p[0] / p[2] + f->c[0];
    out[1] = f->f[1] * p[1] / p[2] + f->c[1];
    out[2] = p[2];
    return out[0] >= 0.0f && out[1] >= 0.0f && out[0] < (float)size && out[1] < (float)size;
}

/* ---- pictures ---- */

static const uint8_t *pixel_at(const struct seed *s, int view, int x, int y)
{
    size_t size = (size_t)s->in->views->size;
    return s->in->views->rgb + 3 * (((size_t)view * size + (size_t)y) * size + (size_t)x);
}

/* Range of picture pixels under [at - side / 2, at + side / 2] of the map: first, step and count.
 * */
static void sample_range(const struct seed *s, float at, float side, int *range)
{
    const int scale = s->in->depth->scale, size = s->in->views->size;
    int n = (int)(side * (float)scale + 0.5f);
    n = n < 1 ? 1 : n;
    range[1] = (n + SAMPLES - 1) / SAMPLES;
    range[2] = n / range[1];
    int first = (int)floorf(at * (float)scale - 0.5f * (float)n + 0.5f) + range[1] / 2;
    int last = size - 1 - (range[2] - 1) * range[1];
    range[0] = first < 0 || last < 0 ? 0 : first > last ? last : first;
}

/* Add ln radiance of the pixels under a square to sum, weighted by reliability. */
static void add_colour(const struct seed *s, int view, const float *at, float side, float factor,
                       float (*sum)[2])
{
    int rx[3], ry[3];
    sample_range(s, at[0], side, rx);
    sample_range(s, at[1], side, ry);
    float value[3] = {0}, weight[3] = {0};
    for (int i = 0; i < rx[2] * ry[2]; i++) {
        const uint8_t *p = pixel_at(s, view, rx[0] + i % rx[2] * rx[1], ry[0] + i / rx[2] * ry[1]);
        for (int c = 0; c < 3; c++) {
            float w = s->weight[c][p[c]] + 1e-4f;
            value[c] += w * s->linear[c][p[c]];
            weight[c] += w;
        }
    }
    const float shift = s->in->views->log2t[view] - s->in->views->mid_log2t;
    for (int c = 0; c < 3; c++) {
        float w = factor * weight[c] / (float)(rx[2] * ry[2]);
        sum[c][0] += w * (logf(value[c] / weight[c] + 1e-9f) - shift * 0.69314718f);
        sum[c][1] += w;
    }
}

/* Standard deviation over mean of the picture under a square, as displayed. */
static float block_contrast(const struct seed *s, int view, const float *at, float side)
{
    const int scale = s->in->depth->scale, n = (int)(side * (float)scale);
    const int x0 = (int)((at[0] - 0.5f * side) * (float)scale),
              y0 = (int)((at[1] - 0.5f * side) * (float)scale);
    float top = 0.0f;
    for (int c = 0; c < 3; c++) {
        float sum = 0.0f, square = 0.0f;
        for (int i = 0; i < n * n; i++) {
            float z = (float)pixel_at(s, view, x0 + i % n, y0 + i / n)[c] / 255.0f;
            sum += z;
            square += z * z;
        }
        float mean = sum / (float)(n * n), var = square / (float)(n * n) - mean * mean;
        float rel = sqrtf(var > 0.0f ? var : 0.0f) / (mean + 0.1f);
        top = rel > top ? rel : top;
    }
    return top;
}

/* ---- one splat ---- */

/* Project the splat at x, `width` wide in the world, into all views; mark the pixels that it covers
 * and explains, and collect its colour. */
static void mark_all_views(struct seed *s, const struct patch *p, const float *x, float width,
                           float (*sum)[2])
{
    const int w = s->in->depth->size;
    for (int j = 0; j < s->in->views->n; j++) {
        float at[3];
        if (!project_to_map(&s->frame[j], x, w, at))
            continue;
        const float side = width * s->frame[j].f[0] / at[2];
        const size_t plane = (size_t)j * (size_t)w * (size_t)w;
        const size_t middle = plane + (size_t)at[1] * (size_t)w + (size_t)at[0];
        const float *depth = s->in->depth->depth, *conf = s->in->depth->conf;
        if (j != p->view && fabsf(depth[middle] - at[2]) < SWEEP_SAME_SURFACE * at[2] &&
            conf[middle] >= SWEEP_CONF_USABLE)
            add_colour(s, j, at, side < p->side ? side : p->side, conf[middle], sum);
        if (side > 2.5f * p->side)
            continue; // this view is near enough to get its own splats
        int x0 = (int)(at[0] - 0.5f * side + 0.5f), x1 = (int)(at[0] + 0.5f * side + 0.5f);
        int y0 = (int)(at[1] - 0.5f * side + 0.5f), y1 = (int)(at[1] + 0.5f * side + 0.5f);
        x0 = x0 < 0 ? 0 : x0;
        y0 = y0 < 0 ? 0 : y0;
        for (int v = y0; v < (y1 < w ? y1 : w); v++) {
            for (int u = x0; u < (x1 < w ? x1 : w); u++) {
                size_t k = plane + (size_t)v * (size_t)w + (size_t)u;
                s->mark[k] |= fabsf(depth[k] - at[2]) < 2.0f * SWEEP_SAME_SURFACE * at[2]
                                  ? EXPLAINED | COVERED
                                  : COVERED;
            }
        }
    }
}

/* Whether the usable depths of a view lie behind the point at `at` (pixel, depth). All pixels
 * around it must agree, because at the rim of a near object an error of one pixel shows the
 * background. */
static bool is_seen_through(const struct seed *s, int view, const float *at)
{
    const int w = s->in->depth->size;
    for (int i = 0; i < 9; i++) {
        int x = (int)at[0] + i % 3 - 1, y = (int)at[1] + i / 3 - 1;
        if (x < 0 || y < 0 || x >= w || y >= w)
            continue;
        size_t k = ((size_t)view * (size_t)w + (size_t)y) * (size_t)w + (size_t)x;
        if (s->in->depth->conf[k] < SWEEP_CONF_USABLE ||
            s->in->depth->depth[k] * (1.0f - 2.0f * SWEEP_SAME_SURFACE) < at[2])
            return false;
    }
    return true;
}

/* Number of views that see a surface at x less those that see through it. */
static int count_support(const struct seed *s, int own, const float *x)
{
    const int w = s->in->depth->size;
    int sum = 0;
    for (int j = 0; j < s->in->views->n; j++) {
        float at[3];
        if (j == own || !project_to_map(&s->frame[j], x, w, at))
            continue;
        size_t k = ((size_t)j * (size_t)w + (size_t)at[1]) * (size_t)w + (size_t)at[0];
        float depth = s->in->depth->depth[k], conf = s->in->depth->conf[k];
        if (conf >= SWEEP_CONF_USABLE && fabsf(depth - at[2]) < SWEEP_SAME_SURFACE * at[2])
            sum++;
        else if (conf >= SWEEP_CONF_USABLE && depth > at[2] && is_seen_through(s, j, at))
            sum--;
    }
    return sum;
}

static void unproject(const struct frame *f, const struct patch *p, float rho, float *x)
{
    float camera[3] = {(p->x - f->c[0]) / f->f[0] / rho - f->t[0],
                       (p->y - f->c[1]) / f->f[1] / rho - f->t[1], 1.0f / rho - f->t[2]};
    to_world(f, camera, x);
}

/* Unit vectors in the camera: along the slope, across it, normal.
 * returns: cosine between normal and line of sight. */
static float surface_axes(const struct frame *f, const struct patch *p, const float *ray,
                          float (*axis)[3])
{
    float n[3] = {p->a * f->f[0], p->b * f->f[1],
                  p->c + p->a * (f->c[0] - p->x) + p->b * (f->c[1] - p->y)};
    float ray_len = sqrtf(ray[0] * ray[0] + ray[1] * ray[1] + 1.0f);
    float len = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    float sight[3] = {ray[0] / ray_len, ray[1] / ray_len, 1.0f / ray_len}, cosine = 0.0f;
    for (int i = 0; i < 3; i++)
        cosine += n[i] * sight[i] / (len + 1e-20f);
    float part[3], slope = 0.0f; // the normal's part across the line of sight
    for (int i = 0; i < 3; i++) {
        part[i] = n[i] / (len + 1e-20f) - cosine * sight[i];
        slope += part[i] * part[i];
    }
    slope = sqrtf(slope);
    if (!(slope > 1e-4f)) {
        float side = sqrtf(sight[0] * sight[0] + sight[2] * sight[2]);
        part[0] = sight[2] / side;
        part[1] = 0.0f;
        part[2] = -sight[0] / side;
        slope = 1.0f;
        cosine = 1.0f;
    }
    cosine = cosine < TILT_MIN ? TILT_MIN : cosine > 1.0f ? 1.0f : cosine;
    float sine = sqrtf(1.0f - cosine * cosine);
    for (int i = 0; i < 3; i++) {
        axis[2][i] = cosine * sight[i] + sine * part[i] / slope;
        axis[0][i] = cosine * part[i] / slope - sine * sight[i];
    }
    for (int i = 0; i < 3; i++)
        axis[1][i] = axis[2][(i + 1) % 3] * axis[0][(i + 2) % 3] -
                     axis[2][(i + 2) % 3] * axis[0][(i + 1) % 3];
    return cosine;
}

/* Quaternion of the rotation whose columns are the axes. */
static void axes_to_quat(float (*axis)[3], float q[4])
{
    double r[9], out[4];
    for (int i = 0; i < 9; i++)
        r[i] = (double)axis[i % 3][i / 3];
    rotation_to_quat(r, out);
    for (int i = 0; i < 4; i++)
        q[i] = (float)out[i];
}

static void emit_splat(struct seed *s, struct patch *p)
{
    struct gaussians *g = s->out;
    const struct frame *f = &s->frame[p->view];
    float x[3];
    unproject(f, p, p->c, x);
    for (int i = 0; count_support(s, p->view, x) < 0; i++) {
        if (p->sure || i == RETREATS)
            return;
        p->c *= RETREAT; // a guess retreats until no view sees through it
        unproject(f, p, p->c, x);
    }
    if (g->n >= s->max) {
        s->full = true;
        return;
    }
    const int i = g->n++;
    float ray[3] = {(p->x - f->c[0]) / f->f[0], (p->y - f->c[1]) / f->f[1], 1.0f}, z = 1.0f / p->c;
    float axis[3][3], world[3][3], q[4], sum[3][2] = {{0}};
    float width = p->side * z / f->f[0], cosine = surface_axes(f, p, ray, axis);
    for (int k = 0; k < 3; k++)
        to_world(f, axis[k], world[k]);
    axes_to_quat(world, q);
    const float at[2] = {p->x, p->y};
    add_colour(s, p->view, at, p->side, 2.0f, sum);
    mark_all_views(s, p, x, width, sum);
    const float scale[3] = {WIDTH * width / cosine, WIDTH * width, THICKNESS * width};
    const float opacity = p->sure ? 0.85f : 0.6f;
    for (int k = 0; k < 3; k++) {
        g->plane[G_MU + k][i] = x[k];
        g->plane[G_LOG_SCALE + k][i] = logf(scale[k]);
        g->plane[G_SH + k][i] = sum[k][0] / sum[k][1] / (float)SH_BASIS0;
    }
    for (int k = 0; k < 4; k++)
        g->plane[G_QUAT + k][i] = q[k];
    g->plane[G_LOGIT][i] = logf(opacity / (1.0f - opacity));
}

/* ---- blocks ---- */

/* Fit a plane of inverse depth to a block of n x n pixels.
 * returns: the largest distance from it, relative. */
static float fit_plane(const struct seed *s, int x0, int y0, int n, struct patch *p)
{
    const int w = s->in->depth->size;
    float sum = 0.0f, sx = 0.0f, sy = 0.0f, half = 0.5f * (float)(n - 1), norm = 0.0f, off = 0.0f;
    for (int i = 0; i < n * n; i++) {
        float v = s->rho[(y0 + i / n) * w + x0 + i % n], dx = (float)(i % n) - half,
              dy = (float)(i / n) - half;
        sum += v;
        sx += v * dx;
        sy += v * dy;
        norm += dx * dx;
    }
    p->c = sum / (float)(n * n);
    p->a = sx / norm;
    p->b = sy / norm;
    for (int i = 0; i < n * n; i++) {
        float v = s->rho[(y0 + i / n) * w + x0 + i % n], dx = (float)(i % n) - half,
              dy = (float)(i / n) - half;
        float e = fabsf(v - p->c - p->a * dx - p->b * dy);
        off = e > off ? e : off;
    }
    return off / p->c;
}

/* A single pixel takes its slope from the 3 x 3 pixels around it if they are one surface. */
static void pixel_plane(const struct seed *s, int x, int y, struct patch *p)
{
    const int w = s->in->depth->size;
    struct patch around;
    p->a = p->b = 0.0f;
    p->c = s->rho[y * w + x];
    if (w < 3)
        return;
    int x0 = x < 1 ? 0 : x > w - 2 ? w - 3 : x - 1, y0 = y < 1 ? 0 : y > w - 2 ? w - 3 : y - 1;
    if (fit_plane(s, x0, y0, 3, &around) > 2.0f * FLAT)
        return;
    p->a = around.a;
    p->b = around.b;
}

/* One pixel of the map: one splat, or four where the picture shows more than the map resolves. */
static void seed_pixel(struct seed *s, int view, int x, int y, bool sure)
{
    struct patch p = {
        .view = view, .x = (float)x + 0.5f, .y = (float)y + 0.5f, .side = 1.0f, .sure = sure};
    const float at[2] = {p.x, p.y};
    pixel_plane(s, x, y, &p);
    if (s->in->depth->scale < 2 || !sure ||
        block_contrast(s, view, at, 1.0f) < 2.0f * DETAIL * s->loss) {
        emit_splat(s, &p);
        return;
    }
    for (int k = 0; k < 4; k++) {
        struct patch part = p;
        float dx = 0.5f * (float)(k % 2) - 0.25f, dy = 0.5f * (float)(k / 2) - 0.25f;
        part.x += dx;
        part.y += dy;
        part.c += p.a * dx + p.b * dy;
        part.side = 0.5f;
        emit_splat(s, &part);
    }
}

static bool needs_splat(const struct seed *s, int view, int x, int y, bool sure)
{
    const int w = s->in->depth->size;
    size_t k = ((size_t)view * (size_t)w + (size_t)y) * (size_t)w + (size_t)x;
    if (sure)
        return s->in->depth->conf[k] >= SWEEP_CONF_USABLE && !(s->mark[k] & EXPLAINED);
    return !(s->mark[k] & COVERED);
}

/* Seed one block: one splat if half of it needs one and all of it is flat, else its quarters. */
static void seed_block(struct seed *s, int view, const int *corner, int n, bool sure)
{
    const int w = s->in->depth->size;
    int inside = 0, count = 0;
    for (int i = 0; i < n * n; i++) {
        int x = corner[0] + i % n, y = corner[1] + i / n;
        if (x < w && y < w) {
            inside++;
            count += needs_splat(s, view, x, y, sure);
        }
    }
    if (count == 0 || s->full)
        return;
    if (n == 1) {
        seed_pixel(s, view, corner[0], corner[1], sure);
        return;
    }
    if (2 * count >= n * n && inside == n * n) {
        float half = 0.5f * (float)n;
        struct patch p = {.view = view,
                          .x = (float)corner[0] + half,
                          .y = (float)corner[1] + half,
                          .side = (float)n,
                          .sure = sure};
        const float at[2] = {p.x, p.y};
        if (fit_plane(s, corner[0], corner[1], n, &p) < FLAT * s->loss &&
            block_contrast(s, view, at, (float)n) < DETAIL * s->loss) {
            emit_splat(s, &p);
            return;
        }
    }
    for (int k = 0; k < 4; k++) {
        int quarter[2] = {corner[0] + k % 2 * n / 2, corner[1] + k / 2 * n / 2};
        seed_block(s, view, quarter, n / 2, sure);
    }
}

/* ---- depth of a view ---- */

/* Blocks per axis of a map. */
static int blocks_across(int w)
{
    return (w + BLOCK - 1) / BLOCK;
}

/* Inverse depth of the view in s->rho: kept where confident, else filled from coarser levels. */
static void smooth_depth(struct seed *s, int view)
{
    const int w = s->in->depth->size;
    const size_t base = (size_t)view * (size_t)w * (size_t)w;
    float *level[LEVELS_MAX];
    int side[LEVELS_MAX], n = 1;
    level[0] = s->levels;
    side[0] = w;
    for (int i = 0; i < w * w; i++) {
        float conf = s->in->depth->conf[base + (size_t)i], c = conf * conf + 1e-4f;
        level[0][2 * i] = c / s->in->depth->depth[base + (size_t)i];
        level[0][2 * i + 1] = c;
    }
    for (; n < LEVELS_MAX && side[n - 1] > 1; n++) {
        side[n] = (side[n - 1] + 1) / 2;
        level[n] = level[n - 1] + 2 * side[n - 1] * side[n - 1];
        memset(level[n], 0, 2 * (size_t)side[n] * (size_t)side[n] * sizeof(float));
        for (int i = 0; i < side[n - 1] * side[n - 1]; i++) {
            int up = i / side[n - 1] / 2 * side[n] + i % side[n - 1] / 2;
            level[n][2 * up] += level[n - 1][2 * i];
            level[n][2 * up + 1] += level[n - 1][2 * i + 1];
        }
    }
    for (n--; n > 0; n--) {
        for (int i = 0; i < side[n - 1] * side[n - 1]; i++) {
            int up = i / side[n - 1] / 2 * side[n] + i % side[n - 1] / 2;
            float pulled = level[n][2 * up] / level[n][2 * up + 1], c = level[n - 1][2 * i + 1];
            float lack = c < 0.1f ? 0.1f - c : 0.0f;
            level[n - 1][2 * i] += lack * pulled;
            level[n - 1][2 * i + 1] += lack;
        }
    }
    for (int i = 0; i < w * w; i++)
        s->rho[i] = level[0][2 * i] / level[0][2 * i + 1];
}

/* Summed-area table of the usable pixels of a view over the blocks, per bin (lo + k step). */
static void sum_sure(struct seed *s, int view, float lo, float step)
{
    const int w = s->in->depth->size, n = blocks_across(w), row = (n + 1) * BINS;
    const float *conf = s->in->depth->conf + (size_t)view * (size_t)w * (size_t)w;
    memset(s->sum, 0, (size_t)row * (size_t)(n + 1) * sizeof *s->sum);
    for (int i = 0; i < w * w; i++) {
        float bin = step > 0.0f ? (s->rho[i] - lo) / step + 0.5f : 0.0f;
        int b = (int)fminf(fmaxf(bin, 0.0f), (float)(BINS - 1));
        if (conf[i] >= SWEEP_CONF_USABLE)
            s->sum[(i / w / BLOCK + 1) * row + (i % w / BLOCK + 1) * BINS + b]++;
    }
    for (int k = 0; k < n * n; k++) {
        uint32_t *here = s->sum + (k / n + 1) * row + (k % n + 1) * BINS, upto = 0;
        for (int b = 0; b < BINS; b++) {
            upto += here[b];
            here[b] = upto + here[b - BINS] + here[b - row] - here[b - row - BINS];
        }
    }
}

/* Bin of the farthest usable surfaces in the smallest square of blocks around block x, y that has
 * enough of them. */
static int farthest_bin(const struct seed *s, int x, int y)
{
    const int w = s->in->depth->size, n = blocks_across(w), row = (n + 1) * BINS;
    for (int r = 1;; r *= 2) {
        int x0 = x < r ? 0 : x - r, x1 = x + r < n ? x + r + 1 : n;
        int y0 = y < r ? 0 : y - r, y1 = y + r < n ? y + r + 1 : n, b = 0;
        const uint32_t *low = s->sum + y0 * row, *high = s->sum + y1 * row;
        uint32_t count[BINS];
        for (int k = 0; k < BINS; k++)
            count[k] =
                high[x1 * BINS + k] - high[x0 * BINS + k] - low[x1 * BINS + k] + low[x0 * BINS + k];
        const float all = (float)count[BINS - 1];
        if (all < AROUND * (float)((x1 - x0) * (y1 - y0) * BLOCK * BLOCK) && r < n)
            continue;
        while (b < BINS - 1 && (float)count[b] <= FARTHEST * all)
            b++;
        return b;
    }
}

/* Limit s->rho to the farthest surfaces around each pixel, even where its depth is usable: other
 * views see through the pixels left over there. Reuses s->levels. */
static void limit_nearness(struct seed *s, int view)
{
    const int w = s->in->depth->size;
    const float *conf = s->in->depth->conf + (size_t)view * (size_t)w * (size_t)w;
    size_t n = 0;
    for (int i = 0; i < w * w; i++) {
        if (conf[i] >= SWEEP_CONF_USABLE)
            s->levels[n++] = s->rho[i];
    }
    if (n == 0)
        return;
    const float lo = num_quantile(s->levels, n, 0.01f),
                hi = num_sorted_quantile(s->levels, n, 0.99f);
    const float step = (hi - lo) / (BINS - 1);
    sum_sure(s, view, lo, step);
    for (int k = 0; k < blocks_across(w) * blocks_across(w); k++) {
        const int x0 = k % blocks_across(w) * BLOCK, y0 = k / blocks_across(w) * BLOCK;
        const float far = lo + step * (float)farthest_bin(s, x0 / BLOCK, y0 / BLOCK);
        for (int i = 0; i < BLOCK * BLOCK; i++) {
            int x = x0 + i % BLOCK, y = y0 + i / BLOCK;
            if (x < w && y < w)
                s->rho[y * w + x] = fminf(s->rho[y * w + x], far);
        }
    }
}

/* ---- entry ---- */

/* Sum of confidence times reliability of the green pixels of a view. */
static float view_score(const struct seed *s, int view)
{
    const int w = s->in->depth->size, scale = s->in->depth->scale;
    float sum = 0.0f;
    for (int i = 0; i < w * w; i++)
        sum += s->in->depth->conf[(size_t)view * (size_t)w * (size_t)w + (size_t)i] *
               s->weight[1][pixel_at(s, view, i % w * scale, i / w * scale)[1]];
    return sum;
}

static void sort_views(struct seed *s)
{
    for (int i = 0; i < s->in->views->n; i++) {
        int k = i;
        s->score[i] = view_score(s, i);
        for (; k > 0 && s->score[s->order[k - 1]] < s->score[i]; k--)
            s->order[k] = s->order[k - 1];
        s->order[k] = i;
    }
}

/* All splats at the present loss of detail; s->full if they are too many. */
static err_t seed_all(struct seed *s)
{
    const int w = s->in->depth->size, n = s->in->views->n;
    s->out->n = 0;
    s->full = false;
    memset(s->mark, FREE, (size_t)n * (size_t)w * (size_t)w);
    for (int i = 0; i < 2 * n && !s->full; i++) {
        if (s->run->cancel && atomic_load(s->run->cancel))
            return err_fail(ERR_CANCELLED, "seed: cancelled");
        smooth_depth(s, s->order[i % n]);
        if (i >= n)
            limit_nearness(s, s->order[i % n]);
        for (int y = 0; y < w; y += BLOCK) {
            for (int x = 0; x < w; x += BLOCK)
                seed_block(s, s->order[i % n], (const int[2]){x, y}, BLOCK, i < n);
        }
        if (s->run->progress)
            s->run->progress(s->run->progress_ctx, "seed", i + 1, 2 * n,
                             s->loss > 1 ? "again, with less detail" : NULL);
    }
    return OK;
}

static size_t levels_floats(size_t w)
{
    size_t sum = 0;
    for (int k = 0; k < LEVELS_MAX; k++, w = (w + 1) / 2)
        sum += 2 * w * w;
    return sum;
}

static err_t layout(struct seed *s, struct arena *a, const struct depthmaps *d)
{
    const size_t n = (size_t)d->n, w = (size_t)d->size;
    err_t e = arena_alloc(a, n, sizeof *s->frame, &s->frame);
    if (!e)
        e = arena_alloc(a, n, sizeof *s->order, &s->order);
    if (!e)
        e = arena_alloc(a, n, sizeof *s->score, &s->score);
    if (!e)
        e = arena_alloc(a, n * w * w, sizeof *s->mark, &s->mark);
    if (!e)
        e = arena_alloc(a, levels_floats(w), sizeof *s->levels, &s->levels);
    if (!e)
        e = arena_alloc(a, w * w, sizeof *s->rho, &s->rho);
    const size_t side = (size_t)blocks_across((int)w) + 1;
    if (!e)
        e = arena_alloc(a, side * side * BINS, sizeof *s->sum, &s->sum);
    return e;
}

void seed_plan(struct plan *p, const struct depthmaps *d, int max, struct gaussians *out)
{
    struct seed s = {0};
    const size_t mark = arena_mark(&p->tmp);
    if (gaussians_init(out, &p->keep, max, 0) || layout(&s, &p->tmp, d))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

static err_t check_input(const struct seed_input *in, int max)
{
    const struct depthmaps *d = in->depth;
    if (max < 1 || max > GAUSSIANS_MAX)
        return err_fail(ERR_ARG, "seed: limit of %d splats, must be 1..%d", max, GAUSSIANS_MAX);
    if (in->views->n < 1 || !in->views->cams || d->n != in->views->n || d->scale < 1 ||
        d->size < 1 || d->size * d->scale > in->views->size)
        return err_fail(ERR_ARG,
                        "seed: %d views of %d px and %d depth maps of %d px do not belong together",
                        in->views->n, in->views->size, d->n, d->size);
    return OK;
}

static void prepare_views(struct seed *s)
{
    struct response_table table;
    response_tabulate(s->in->tone, &table);
    for (int k = 0; k < 3 * 256; k++) {
        s->linear[k / 256][k % 256] = exp2f(table.x[k / 256][k % 256]);
        s->weight[k / 256][k % 256] = table.weight[k / 256][k % 256];
    }
    for (int i = 0; i < s->in->views->n; i++)
        set_frame(&s->in->views->cams[i], s->in->depth->scale, &s->frame[i]);
    sort_views(s);
}

err_t seed_run(const struct run *r, const struct seed_input *in, int max, struct gaussians *out)
{
    struct seed s = {.run = r, .in = in, .out = out, .max = max, .loss = 1.0f};
    size_t mark = arena_mark(r->tmp), keep = arena_mark(r->keep);
    memset(out, 0, sizeof *out);
    err_t e = check_input(in, max);
    if (e)
        return e;
    e = gaussians_init(out, r->keep, max, 0);
    if (!e)
        e = layout(&s, r->tmp, in->depth);
    if (!e)
        prepare_views(&s);
    for (int i = 0; i < TRIES && !e; i++, s.loss *= 1.4f) {
        e = seed_all(&s);
        if (!s.full)
            break;
    }
    arena_reset(r->tmp, mark);
    if (e) {
        arena_reset(r->keep, keep);
        memset(out, 0, sizeof *out);
    }
    return e;
}
