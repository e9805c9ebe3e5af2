/* Views are processed by falling score (confidence of depth times reliability of the pictures). The
 * map of a view is cut into blocks; a block that is flat in colour and in depth becomes one splat,
 * others are cut into four, down to a quarter of a pixel of the map. Each splat is projected into
 * all views: where it explains a pixel, that pixel gets no splat of its own, and its radiance
 * counts; where as many views contradict a splat as confirm it, there is none. A second round fills
 * pixels that no splat covers, at the depth of the farthest usable surfaces around them: there they
 * fill holes and occlude nothing. (At the mean depth around them they cost 0.1 to 2.4 dB in five
 * scenes without refinement; at the farthest depth of the whole view 0.2 dB more than here.) */
#include "core/stereo/seed.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/base/shell.h"
#include "core/stereo/far.h"
#include "core/stereo/guess.h"
#include "core/stereo/sights.h"

#include <math.h>
#include <string.h>

enum {
    BLOCK = 8,     // largest block, px of the map
    RETREATS = 16, // steps by which a guess may go back
    TRIES = 12,    // times the detail may be given up
};

enum {
    FREE = 0,
    COVERED = 1,
    EXPLAINED = 2
}; // marks of a pixel: a splat lies there; a splat lies at the pixel's own depth

static const float DETAIL = 0.06f;    // relative contrast at which a block is cut, first try
static const float FLAT = 0.006f;     // relative distance of inverse depths from a plane, first try
static const float RETREAT = 0.94f;   // factor on inverse depth of one step
static const float WIDTH = 0.46f;     // standard deviation per spacing
static const float SKY_PRIOR = 0.02f; // weight of the mean radiance of the shell
static const float FAR_WIDTH = 0.8f;  // of the shell, behind which there is nothing
static const float THICKNESS = 0.15f; // standard deviation across the surface per spacing
static const float TILT_MIN = 0.25f;  // cosine of the steepest surface
static const float CLEAR = 4.0f;      // standard deviations around a camera where nothing is,
static const float CLEAR_MOST = 0.2f; // at most, of the depth
static const float OPEN = 0.5f;       // share of the depth of the nearest surface that a view sees
static const float NEAREST = 0.05f;   // quantile of depths that counts as that

struct frame {
    float r[9], t[3]; // world to camera
    float centre[3];
    float f[2], c[2]; // px of the map
};

struct seed {
    const struct run *run;
    const struct seed_input *in;
    struct gaussians *out;
    struct shell shell;
    float sky[3][2]; // ln radiance of the shell times its reliability; the latter
    int max;
    float loss; // factor on the thresholds: > 1 gives up detail
    bool full;
    struct sights sights;
    struct frame *frame; // (n)
    float *open;         // (n) distance from a camera where hardly anything is
    int *order;          // (n) views, best first
    float *score;        // (n)
    uint8_t *mark;       // (maps)
    float *rho;          // (h, w) of the view in work
    float *smooth;       // (h, w) memory of rho in the first round
    float *guess;        // (maps) inverse depth in the second round
    struct guess_work work;
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
    double centre[3];
    rotation_centre(cam, centre);
    for (int i = 0; i < 3; i++)
        f->centre[i] = (float)centre[i];
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
static bool project_to_map(const struct frame *f, const float *x, const struct extent *map,
                           float *out)
{
    float p[3];
    for (int i = 0; i < 3; i++)
        p[i] = f->r[3 * i] * x[0] + f->r[3 * i + 1] * x[1] + f->r[3 * i + 2] * x[2] + f->t[i];
    if (!(p[2] > 1e-6f))
        return false;
    out[0] = f->f[0] * p[0] / p[2] + f->c[0];
    out[1] = f->f[1] * p[1] / p[2] + f->c[1];
    out[2] = p[2];
    return out[0] >= 0.0f && out[1] >= 0.0f && out[0] < (float)map->w && out[1] < (float)map->h;
}

/* ---- one splat ---- */

/* Project the splat at x, `width` wide in the world, into all views; mark the pixels that it covers
 * and explains, and collect its colour, of which `own` is what its own view shows. */
static void mark_all_views(struct seed *s, const struct patch *p, const float *x, float width,
                           const struct sight *own, float (*sum)[2])
{
    for (int j = 0; j < s->in->views->n; j++) {
        const struct extent *map = &s->in->depth->extent[j];
        const int w = map->w, h = map->h;
        float at[3];
        if (!project_to_map(&s->frame[j], x, map, at))
            continue;
        const float side = width * s->frame[j].f[0] / at[2];
        const size_t plane = map->at;
        const size_t middle = plane + (size_t)at[1] * (size_t)w + (size_t)at[0];
        const float *depth = s->in->depth->depth, *conf = s->in->depth->conf;
        if (j != p->view && fabsf(depth[middle] - at[2]) < SWEEP_SAME_SURFACE * at[2] &&
            conf[middle] >= SWEEP_CONF_USABLE) {
            const struct sight other =
                sights_look(&s->sights, j, at, side < p->side ? side : p->side, false);
            if (sights_agree(own, &other))
                sights_add(&other, conf[middle], sum);
        }
        if (side > 2.5f * p->side)
            continue; // this view is near enough to get its own splats
        int x0 = (int)(at[0] - 0.5f * side + 0.5f), x1 = (int)(at[0] + 0.5f * side + 0.5f);
        int y0 = (int)(at[1] - 0.5f * side + 0.5f), y1 = (int)(at[1] + 0.5f * side + 0.5f);
        x0 = x0 < 0 ? 0 : x0;
        y0 = y0 < 0 ? 0 : y0;
        for (int v = y0; v < (y1 < h ? y1 : h); v++) {
            for (int u = x0; u < (x1 < w ? x1 : w); u++) {
                size_t k = plane + (size_t)v * (size_t)w + (size_t)u;
                s->mark[k] |= fabsf(depth[k] - at[2]) < 2.0f * SWEEP_SAME_SURFACE * at[2]
                                  ? EXPLAINED | COVERED
                                  : COVERED;
            }
        }
    }
}

/* Whether the usable depths of a view lie behind the point at `at` (pixel, depth). Most pixels
 * around it must be usable and all of these agree, because at the rim of a near object an error of
 * one pixel shows the background. */
static bool is_seen_through(const struct seed *s, int view, const float *at)
{
    const struct extent *map = &s->in->depth->extent[view];
    int inside = 0, usable = 0;
    for (int i = 0; i < 9; i++) {
        int x = (int)at[0] + i % 3 - 1, y = (int)at[1] + i / 3 - 1;
        if (x < 0 || y < 0 || x >= map->w || y >= map->h)
            continue;
        size_t k = map->at + (size_t)y * (size_t)map->w + (size_t)x;
        inside++;
        if (s->in->depth->conf[k] < SWEEP_CONF_USABLE)
            continue;
        usable++;
        if (s->in->depth->depth[k] * (1.0f - 2.0f * SWEEP_SAME_SURFACE) < at[2])
            return false;
    }
    return 3 * usable >= 2 * inside;
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

/* A patch in the world: its middle, its width, and how far around it no other camera may stand; its
 * axes in the camera, of surface_axes. */
struct surface {
    float x[3], axis[3][3], cosine, width, reach;
};

static struct surface lay_out(const struct frame *f, const struct patch *p)
{
    const float z = 1.0f / p->c;
    const float ray[3] = {(p->x - f->c[0]) / f->f[0], (p->y - f->c[1]) / f->f[1], 1.0f};
    const float camera[3] = {ray[0] * z - f->t[0], ray[1] * z - f->t[1], z - f->t[2]};
    struct surface o = {.width = p->side * z / f->f[0]};
    to_world(f, camera, o.x);
    o.cosine = surface_axes(f, p, ray, o.axis);
    o.reach = fminf(CLEAR * WIDTH * o.width / o.cosine, CLEAR_MOST * z);
    return o;
}

static float distance_to(const struct frame *f, const float *x)
{
    const float d[3] = {x[0] - f->centre[0], x[1] - f->centre[1], x[2] - f->centre[2]};
    return sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
}

/* What view j says of a point of the splat: 1 it sees a surface there, -1 it sees through it, 0 it
 * does not know. Where it guesses as well, none may guess that it is farther. */
static int verdict_of(const struct seed *s, const struct patch *p, int j, const float *x)
{
    const struct extent *map = &s->in->depth->extent[j];
    float at[3];
    if (!project_to_map(&s->frame[j], x, map, at))
        return 0;
    const size_t k = map->at + (size_t)at[1] * (size_t)map->w + (size_t)at[0];
    const float depth = s->in->depth->depth[k];
    if (s->in->depth->conf[k] < SWEEP_CONF_USABLE)
        return -(!p->sure && s->guess[k] * at[2] < 1.0f - 2.0f * SWEEP_SAME_SURFACE);
    if (fabsf(depth - at[2]) < SWEEP_SAME_SURFACE * at[2])
        return 1;
    return -(depth > at[2] && is_seen_through(s, j, at));
}

/* Whether view j sees through a corner of a guess, which may be large there. */
static bool is_in_the_way(const struct seed *s, const struct patch *p, int j,
                          const struct surface *o)
{
    for (int k = 0; k < 4; k++) {
        const float u = (k % 2 ? 0.5f : -0.5f) * o->width / o->cosine,
                    v = (k / 2 ? 0.5f : -0.5f) * o->width;
        float corner[3], x[3];
        for (int i = 0; i < 3; i++)
            corner[i] = u * o->axis[0][i] + v * o->axis[1][i];
        to_world(&s->frame[p->view], corner, x);
        for (int i = 0; i < 3; i++)
            x[i] += o->x[i];
        if (verdict_of(s, p, j, x) < 0)
            return true;
    }
    return false;
}

/* Whether another camera stands in the splat, or other views see through it and no more of them see
 * a surface there: wrong matches of two views confirm each other, and a third one contradicts them.
 * Those just before the cameras on the other side of a thing often have no third: there two are not
 * enough. A guess holds where they are as many. */
static bool is_refuted(const struct seed *s, const struct patch *p, const struct surface *o)
{
    int seen = 0, through = 0;
    bool open = false;
    for (int j = 0; j < s->in->views->n; j++) {
        if (j == p->view)
            continue;
        const float away = distance_to(&s->frame[j], o->x);
        if (away < o->reach)
            return true;
        open = open || away < s->open[j];
        const int verdict = verdict_of(s, p, j, o->x);
        seen += verdict > 0;
        through += verdict < 0 || (!p->sure && verdict == 0 && is_in_the_way(s, p, j, o));
    }
    if (open && (!p->sure || seen < 2))
        return true;
    return seen < through || (p->sure && seen == through && through > 0);
}

/* Whether it shows a black backdrop. */
static bool is_black(const struct seed *s, const struct patch *p)
{
    const struct depthmaps *d = s->in->depth;
    const struct extent *map = &d->extent[p->view];
    return sweep_far(d, map->at + (size_t)p->y * (size_t)map->w + (size_t)p->x) == FAR_BLACK;
}

static void emit_splat(struct seed *s, struct patch *p)
{
    struct gaussians *g = s->out;
    const struct frame *f = &s->frame[p->view];
    struct surface o = lay_out(f, p);
    for (int i = 0; is_refuted(s, p, &o); i++) {
        if (p->sure || i == RETREATS)
            return;
        p->c *= RETREAT; // a guess retreats until no view sees through it
        o = lay_out(f, p);
    }
    if (g->n >= s->max) {
        s->full = true;
        return;
    }
    const int i = g->n;
    float world[3][3], q[4], sum[3][2] = {{0}};
    for (int k = 0; k < 3; k++)
        to_world(f, o.axis[k], world[k]);
    axes_to_quat(world, q);
    const float at[2] = {p->x, p->y};
    const struct sight own = sights_look(&s->sights, p->view, at, p->side, false);
    sights_add(&own, 2.0f, sum);
    mark_all_views(s, p, o.x, o.width, &own, sum);
    const bool far = shell_has(&s->shell, o.x);
    for (int k = 0; k < 3 && far; k++) { // the sky of a saturated pixel is as all the rest of it
        const float mean = s->sky[k][0] / s->sky[k][1];
        sum[k][0] += SKY_PRIOR * fminf(fmaxf(mean, own.least[k]), own.most[k]);
        sum[k][1] += SKY_PRIOR;
    }
    if (is_black(s, p)) { // what is reliable there is noise
        const struct sight mean = sights_look(&s->sights, p->view, at, p->side, true);
        memset(sum, 0, sizeof sum);
        sights_add(&mean, 1, sum);
    }
    if (!(sum[0][1] > 0)) // all that shows it is masked
        return;
    g->n++;
    const float wide = far ? FAR_WIDTH * o.width : WIDTH * o.width;
    const float scale[3] = {wide / o.cosine, wide, THICKNESS * o.width};
    const float opacity = far ? SHELL_OPACITY : p->sure ? 0.85f : 0.6f;
    for (int k = 0; k < 3; k++) {
        g->plane[G_MU + k][i] = o.x[k];
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
    const int w = s->in->depth->extent[p->view].w;
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
    const int w = s->in->depth->extent[p->view].w, h = s->in->depth->extent[p->view].h;
    struct patch around = {.view = p->view};
    p->a = p->b = 0.0f;
    p->c = s->rho[y * w + x];
    if (w < 3 || h < 3)
        return;
    int x0 = x < 1 ? 0 : x > w - 2 ? w - 3 : x - 1, y0 = y < 1 ? 0 : y > h - 2 ? h - 3 : y - 1;
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
        sights_contrast(&s->sights, view, at, 1.0f) < 2.0f * DETAIL * s->loss) {
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
    const struct extent *map = &s->in->depth->extent[view];
    size_t k = map->at + (size_t)y * (size_t)map->w + (size_t)x;
    if (sure)
        return s->in->depth->conf[k] >= SWEEP_CONF_USABLE && !(s->mark[k] & EXPLAINED);
    return !(s->mark[k] & COVERED);
}

/* Seed one block: one splat if half of it needs one and all of it is flat, else its quarters. */
static void seed_block(struct seed *s, int view, const int *corner, int n, bool sure)
{
    const struct extent *map = &s->in->depth->extent[view];
    int inside = 0, count = 0;
    for (int i = 0; i < n * n; i++) {
        int x = corner[0] + i % n, y = corner[1] + i / n;
        if (x < map->w && y < map->h) {
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
            sights_contrast(&s->sights, view, at, (float)n) < DETAIL * s->loss) {
            emit_splat(s, &p);
            return;
        }
    }
    for (int k = 0; k < 4; k++) {
        int quarter[2] = {corner[0] + k % 2 * n / 2, corner[1] + k / 2 * n / 2};
        seed_block(s, view, quarter, n / 2, sure);
    }
}

/* ---- entry ---- */

/* Sum of confidence times reliability of the green pixels of a view. */
static float view_score(const struct seed *s, int view)
{
    const struct extent *map = &s->in->depth->extent[view];
    const int w = map->w, scale = s->in->depth->scale;
    float sum = 0.0f;
    for (int i = 0; i < w * map->h; i++) {
        const int x = i % w * scale, y = i / w * scale;
        if (!views_hides_any(s->in->views, view, x, y, 1))
            sum += s->in->depth->conf[map->at + (size_t)i] *
                   sights_reliability(&s->sights, view, x, y);
    }
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

/* Inverse depth of all views, for guesses. */
static void guess_depths(struct seed *s)
{
    for (int i = 0; i < s->in->views->n; i++) {
        float *rho = s->guess + s->in->depth->extent[i].at;
        guess_smooth(&s->work, s->in->depth, i, rho);
        guess_shell(s->in->depth, i, rho);
        guess_limit(&s->work, s->in->depth, i, rho);
    }
}

/* Masked pixels need no splats. */
static void clear_marks(struct seed *s)
{
    const struct depthmaps *d = s->in->depth;
    const struct views *v = s->in->views;
    memset(s->mark, FREE, extent_total(d->extent, v->n));
    for (int i = 0; i < v->n && v->masked; i++) {
        const struct extent *map = &d->extent[i];
        for (int k = 0; k < map->w * map->h; k++)
            if (sweep_hides(d, v, i, k))
                s->mark[map->at + (size_t)k] = COVERED | EXPLAINED;
    }
}

/* All splats at the present loss of detail; s->full if they are too many. */
static err_t seed_all(struct seed *s)
{
    const struct extent *maps = s->in->depth->extent;
    const int n = s->in->views->n;
    s->out->n = 0;
    s->full = false;
    clear_marks(s);
    for (int i = 0; i < 2 * n && !s->full; i++) {
        const struct extent *map = &maps[s->order[i % n]];
        if (s->run->cancel && atomic_load(s->run->cancel))
            return err_fail(ERR_CANCELLED, "seed: cancelled");
        if (i == n)
            guess_depths(s);
        s->rho = i < n ? s->smooth : s->guess + map->at;
        if (i < n) {
            guess_smooth(&s->work, s->in->depth, s->order[i], s->rho);
            guess_shell(s->in->depth, s->order[i], s->rho);
        }
        for (int y = 0; y < map->h; y += BLOCK) {
            for (int x = 0; x < map->w; x += BLOCK)
                seed_block(s, s->order[i % n], (const int[2]){x, y}, BLOCK, i < n);
        }
        if (s->run->progress)
            s->run->progress(s->run->progress_ctx, "seed", i + 1, 2 * n,
                             s->loss > 1 ? "again, with less detail" : NULL);
    }
    return OK;
}

static err_t layout(struct seed *s, struct arena *a, const struct extent *maps, int n_views)
{
    const size_t n = (size_t)n_views;
    err_t e = arena_alloc(a, n, sizeof *s->frame, &s->frame);
    if (!e)
        e = arena_alloc(a, n, sizeof *s->open, &s->open);
    if (!e)
        e = arena_alloc(a, n, sizeof *s->order, &s->order);
    if (!e)
        e = arena_alloc(a, n, sizeof *s->score, &s->score);
    if (!e)
        e = arena_alloc(a, extent_total(maps, n_views), sizeof *s->mark, &s->mark);
    if (!e)
        e = arena_alloc(a, extent_total(maps, n_views), sizeof *s->guess, &s->guess);
    if (!e)
        e = arena_alloc(a, extent_cover(maps, n_views).at, sizeof *s->smooth, &s->smooth);
    return e ? e : guess_layout(&s->work, a, maps, n_views);
}

void seed_plan(struct plan *p, const struct extent *maps, int n, int max, struct gaussians *out)
{
    struct seed s = {0};
    const size_t mark = arena_mark(&p->tmp);
    if (gaussians_init(out, &p->keep, max, 0) || layout(&s, &p->tmp, maps, n))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

static err_t check_input(const struct seed_input *in, int max)
{
    const struct depthmaps *d = in->depth;
    if (max < 1 || max > GAUSSIANS_MAX)
        return err_fail(ERR_ARG, "seed: limit of %d splats, must be 1..%d", max, GAUSSIANS_MAX);
    bool fits = in->views->n > 0 && in->views->cams && d->n == in->views->n && d->scale > 0;
    for (int i = 0; i < d->n && fits; i++)
        fits = d->extent[i].w > 0 && d->extent[i].h > 0 &&
               d->extent[i].w * d->scale <= in->views->extent[i].w &&
               d->extent[i].h * d->scale <= in->views->extent[i].h;
    if (!fits)
        return err_fail(ERR_ARG,
                        "seed: %d views and %d depth maps at 1/%d of their size do not belong "
                        "together",
                        in->views->n, d->n, d->scale);
    return OK;
}

/* Mean ln radiance of all pixels that see the shell. */
static void measure_sky(struct seed *s)
{
    const struct depthmaps *d = s->in->depth;
    for (int c = 0; c < 3; c++) {
        s->sky[c][0] = 0;
        s->sky[c][1] = 1e-9f;
    }
    for (int j = 0; j < d->n && d->far; j++) {
        const struct extent *map = &d->extent[j];
        for (int k = 0; k < map->w * map->h; k++) {
            const float at[2] = {(float)(k % map->w) + 0.5f, (float)(k / map->w) + 0.5f};
            if (!d->far[map->at + (size_t)k])
                continue;
            const struct sight o = sights_look(&s->sights, j, at, 1, false);
            sights_add(&o, 1, s->sky);
        }
    }
}

/* Cameras stand in the open: nothing is guessed near one. */
static void measure_open(struct seed *s)
{
    const struct depthmaps *d = s->in->depth;
    for (int i = 0; i < d->n; i++) {
        const struct extent *map = &d->extent[i];
        size_t n = 0;
        for (size_t k = map->at; k < map->at + extent_pixels(map); k++)
            if (d->conf[k] >= SWEEP_CONF_USABLE && !sweep_far(d, k))
                s->smooth[n++] = d->depth[k];
        s->open[i] = OPEN * num_quantile(s->smooth, n, NEAREST);
    }
}

static void prepare_views(struct seed *s)
{
    s->shell = shell_of(s->in->views->cams, s->in->views->n);
    sights_set(&s->sights, s->in->views, s->in->depth, s->in->tone);
    for (int i = 0; i < s->in->views->n; i++)
        set_frame(&s->in->views->cams[i], s->in->depth->scale, &s->frame[i]);
    measure_sky(s);
    measure_open(s);
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
        e = layout(&s, r->tmp, in->depth->extent, in->depth->n);
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
