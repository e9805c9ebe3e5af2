/* Every kernel on every instruction set of this machine against plain C: ordinary and extreme
 * input, sizes around the width of vectors, arrays that end or start at inaccessible pages.
 * kernels_test [--seed N] [--bench]
 * Bounds are stated in the `keep` functions: a few roundings for row kernels; more where sums are
 * taken in another order or differences of large numbers matter. */
#include "core/base/rotation.h"
#include "core/photo/tonemap.h"
#include "core/splat/raster.h"
#include "tests/kernels/trial.h"

enum { W = 37, H = 29, TAPS = 11, PX = W * H };

static const float taps[TAPS] = {0.001f, 0.008f, 0.036f, 0.11f,  0.213f, 0.264f,
                                 0.213f, 0.11f,  0.036f, 0.008f, 0.001f};

/* --- rows ---------------------------------------------------------------------------------- */

static const float extremes[] = {0, -0.0f, 1, -1, 1e-45f, -1e-39f, 1e-20f, 3e15f, -3e15f};

/* One set of arrays serves all row kernels; each uses what its contract names. */
static struct {
    int n, stride;
    float *in, *scratch, *out, *d, *d_kept, *logit, *d_alpha;
    const float *rows[TAPS];
    float *photo; // codes
    struct tonemap_table table;
    struct tone_row tone;
    struct display_row display;
    double sum;
} row;

static void row_blur_make(int size, enum pattern pattern)
{
    row.n = size + TAPS - 1;
    row.in = trial_random((size_t)row.n, -1, 1);
    if (pattern == EXTREME)
        trial_spoil(row.in, (size_t)row.n, extremes, sizeof extremes / sizeof *extremes);
    row.out = trial_floats((size_t)size);
}

static void row_blur_call(const struct kernels *k)
{
    k->blur_row(taps, row.in, row.n, row.out);
}

static void row_blur_keep(struct outcome *o)
{
    trial_put_row(o, "blurred", row.out, row.n - (TAPS - 1), 5e-7);
    trial_scale(o, trial_largest(row.in, row.n));
}

static void col_blur_make(int size, enum pattern pattern)
{
    row.n = size;
    for (int k = 0; k < TAPS; k++) {
        float *in = trial_random((size_t)size, -1, 1);
        if (pattern == EXTREME)
            trial_spoil(in, (size_t)size, extremes, sizeof extremes / sizeof *extremes);
        row.rows[k] = in;
    }
    row.out = trial_floats((size_t)size);
}

static void col_blur_call(const struct kernels *k)
{
    k->blur_col(taps, row.rows, row.n, row.out);
}

static void col_blur_keep(struct outcome *o)
{
    double top = 0;
    for (int k = 0; k < TAPS; k++)
        top = fmax(top, trial_largest(row.rows[k], row.n));
    trial_put_row(o, "blurred", row.out, row.n, 5e-7);
    trial_scale(o, top);
}

static void moments_make(int size, enum pattern pattern)
{
    row.n = size + TAPS - 1;
    row.stride = row.n + 3;
    row.in = trial_random((size_t)row.n, 0, 1);
    row.photo = trial_random((size_t)row.n, 0, 255);
    for (int i = 0; pattern == EXTREME && i < row.n; i++) {
        row.in[i] = i % 3 == 0 ? 0.0f : 1.0f;
        row.photo[i] = i % 2 ? 0.0f : 255.0f;
    }
    row.scratch = trial_floats(2 * (size_t)row.stride);
    row.out = trial_floats(5 * (size_t)row.stride);
}

static void moments_call(const struct kernels *k)
{
    k->moments_row(taps, row.in, row.photo, row.n, (size_t)row.stride, row.scratch, row.out);
}

static void moments_keep(struct outcome *o)
{
    trial_put_columns(o, "moments", row.out, (const int[3]){5, row.n - (TAPS - 1), row.stride},
                      1e-6);
}

static void ssim_make(int size, enum pattern pattern)
{
    row.n = size;
    row.stride = size + 5;
    float *m = row.in = trial_floats(5 * (size_t)row.stride);
    for (int i = 0; i < size; i++) {
        bool flat = pattern == EXTREME && i % 2; // no variance, or the largest there is
        double x = trial_uniform(0, 1), y = trial_uniform(0, 1), part = trial_uniform(-1, 1);
        double vx = flat ? 0 : x * (1 - x), vy = flat ? 0 : y * (1 - y);
        if (pattern == EXTREME && i % 3 == 0)
            x = y = i % 2;
        m[i] = (float)x;
        m[row.stride + i] = (float)y;
        m[2 * row.stride + i] = (float)(x * x + vx);
        m[3 * row.stride + i] = (float)(y * y + vy);
        m[4 * row.stride + i] = (float)(x * y + part * sqrt(vx * vy));
    }
    row.out = trial_floats(3 * (size_t)row.stride);
}

static void ssim_call(const struct kernels *k)
{
    row.sum = k->ssim_row(row.in, (size_t)row.stride, row.n, row.out);
}

/* Variances are differences of moments: a rounding of 1e-7 there is divided by C2 = 9e-4.
 * Derivatives are up to 1 / C2. */
static void ssim_keep(struct outcome *o)
{
    float sum = (float)row.sum;
    trial_put_row(o, "sum", &sum, 1, 1e-3);
    trial_scale(o, row.n);
    trial_put_columns(o, "derivatives", row.out, (const int[3]){3, row.n, row.stride}, 1e-3);
    trial_scale(o, 1 / 9e-4);
}

static void display_make(int size, enum pattern pattern)
{
    row.n = size;
    row.stride = size + 2;
    row.in = trial_random((size_t)size, 0, 1);
    row.photo = trial_random((size_t)size, 0, 255);
    float *g = trial_random(3 * (size_t)row.stride, -1, 1);
    if (pattern == EXTREME)
        for (int i = 0; i < size; i++) {
            row.photo[i] = i % 2 ? 0.0f : 255.0f;
            row.in[i] = i % 3 == 0 ? (float)(i % 2) : i % 3 == 1 ? 1e-40f : 0.0f;
            g[i] = i % 5 ? 0.0f : 1e10f;
        }
    row.out = trial_floats((size_t)size);
    row.display = (struct display_row){row.in, g, row.photo, (size_t)row.stride, 0.8f, -0.1f, size};
}

static void display_call(const struct kernels *k)
{
    row.sum = k->display_row(&row.display, row.out);
}

static void display_keep(struct outcome *o)
{
    float sum = (float)row.sum;
    trial_put_row(o, "sum", &sum, 1, 5e-7);
    trial_scale(o, row.n);
    trial_put_row(o, "gradient", row.out, row.n, 1e-6);
}

static void tone_make(int size, enum pattern pattern)
{
    static const float bad[] = {0, 1e-45f, 1e-38f, 1e-6f, 1, 1e30f, 3e38f, INFINITY};
    struct tonemap t;
    tonemap_linear(&t, 0.7f, -9, 7, 0);
    for (int i = 0; i < TONE_PARAMS; i++)
        t.p[i] += (float)trial_uniform(-0.02, 0.02);
    tonemap_table_init(&row.table, &t);
    row.n = size;
    float *radiance = trial_random((size_t)size, -8, 8), *alpha = trial_random((size_t)size, 0, 1);
    for (int i = 0; i < size; i++)
        radiance[i] = exp2f(radiance[i]);
    if (pattern == EXTREME) {
        trial_spoil(radiance, (size_t)size, bad, sizeof bad / sizeof *bad);
        trial_spoil(alpha, (size_t)size, (const float[]){0, 1}, 2);
    }
    row.tone = (struct tone_row){.curve = &row.table.c[size % 3],
                                 .radiance = radiance,
                                 .alpha = alpha,
                                 .shift = pattern == EXTREME ? 20.0f : -1.3f,
                                 .behind = 0.25f,
                                 .x = trial_floats((size_t)size),
                                 .slope = trial_floats((size_t)size),
                                 .ldr = trial_floats((size_t)size),
                                 .segment = guard_alloc((size_t)size, 1),
                                 .n = size};
}

static void tone_call(const struct kernels *k)
{
    k->tone_row(&row.tone);
}

/* At a knot the segment, and with it the slope, may be that of either side. */
static void tone_keep(struct outcome *o)
{
    const struct tone_row *t = &row.tone;
    trial_put_row(o, "x", t->x, t->n, 1e-6);
    trial_put_row(o, "ldr", t->ldr, t->n, 1e-5);
    for (int i = 0; i < t->n; i++) {
        const struct tonemap_curve *c = t->curve;
        int s = t->segment[i];
        if (s > c->n || t->slope[i] != c->a[s] || (s > 0 && t->x[i] < c->knot[s - 1] - 1e-4f) ||
            (s < c->n && t->x[i] > c->knot[s] + 1e-4f))
            o->fault = "wrong segment";
    }
}

static void tone_grad_make(int size, enum pattern pattern)
{
    struct kernels c;
    tone_make(size, pattern);
    kernels_init(&c, 0);
    c.tone_row(&row.tone);
    row.d_kept = trial_random((size_t)size, -1, 1);
    row.d = trial_floats((size_t)size);
    row.logit = trial_floats((size_t)size);
    row.d_alpha = trial_random((size_t)size, -1, 1);
}

static void tone_grad_call(const struct kernels *k)
{
    memcpy(row.d, row.d_kept, (size_t)row.n * sizeof *row.d);
    k->tone_row_grad(&row.tone, row.d, row.logit, row.d_alpha);
}

/* The display value is taken back from its sum with the background, so it has an error of 1e-7. */
static void tone_grad_keep(struct outcome *o)
{
    trial_put_row(o, "radiance", row.d, row.n, 1e-5);
    trial_put_row(o, "logit", row.logit, row.n, 1e-5);
    trial_put_row(o, "alpha", row.d_alpha, row.n, 1e-6);
}

/* --- Adam ---------------------------------------------------------------------------------- */

static struct {
    struct adam_step step;
    int n;
    float *seen, *grad, *param, *m1, *m2;
} adam;

static void adam_make(int size, enum pattern pattern)
{
    static const float bad[] = {0, -0.0f, 1e-45f, -1e-30f, 1e-12f, 1e15f, -1e18f};
    adam.n = size;
    adam.step = (struct adam_step){1e-3f, 0.9f, 0.999f, 1e-15f, 1 / (1 - 0.729f), 1 / (1 - 0.997f)};
    adam.seen = trial_random((size_t)size, 0, 1);
    for (int i = 0; i < size; i++)
        adam.seen[i] = size % 5 == 0 ? 0.0f : adam.seen[i] < 0.3f ? 0.0f : 1.0f;
    adam.grad = trial_random((size_t)size, -1, 1);
    if (pattern == EXTREME)
        trial_spoil(adam.grad, (size_t)size, bad, sizeof bad / sizeof *bad);
    adam.param = trial_random((size_t)size, -3, 3);
    adam.m1 = trial_random((size_t)size, -1, 1);
    adam.m2 = trial_random((size_t)size, 0, 1);
    if (pattern == EXTREME)
        trial_spoil(adam.m2, (size_t)size, (const float[]){0, 1e-40f}, 2);
}

static void adam_call(const struct kernels *k)
{
    k->adam(&adam.step, adam.n, adam.seen, adam.grad, adam.param, adam.m1, adam.m2);
}

static void adam_keep(struct outcome *o)
{
    trial_put_row(o, "parameter", adam.param, adam.n, 1e-5);
    trial_put_row(o, "first moment", adam.m1, adam.n, 1e-6);
    trial_put_row(o, "second moment", adam.m2, adam.n, 1e-6);
}

/* --- projection ---------------------------------------------------------------------------- */

static struct {
    struct gaussians g;
    struct view_geom v;
    int first, count;
    bool finite_only;
    struct splat2d *out;
    float *sums, *grad, *pose;
} proj;

static void make_view(struct view_geom *v)
{
    float q[4] = {1, (float)trial_uniform(-0.3, 0.3), (float)trial_uniform(-0.3, 0.3),
                  (float)trial_uniform(-0.3, 0.3)};
    float len = sqrtf(1 + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int k = 0; k < 4; k++)
        q[k] /= len;
    *v = (struct view_geom){
        .t = {0.1f, -0.2f, 5}, .fx = 30, .fy = 33, .cx = 18, .cy = 15, .w = W, .h = H};
    rotation_from_unit(q, v->r);
    for (int k = 0; k < 3; k++)
        v->centre[k] = -(v->r[k] * v->t[0] + v->r[3 + k] * v->t[1] + v->r[6 + k] * v->t[2]);
    v->lim_x0 = v->cx / v->fx + 0.15f * W / v->fx;
    v->lim_x1 = (W - v->cx) / v->fx + 0.15f * W / v->fx;
    v->lim_y0 = v->cy / v->fy + 0.15f * H / v->fy;
    v->lim_y1 = (H - v->cy) / v->fy + 0.15f * H / v->fy;
}

static void make_gaussians(struct gaussians *g, int n, int degree)
{
    static const float lo[G_SH] = {-2, -2, -2, -4, -4, -4, -1, -1, -1, -1, -3};
    static const float hi[G_SH] = {2, 2, 2, -1, -1, -1, 1, 1, 1, 1, 4};
    *g = (struct gaussians){.n = n, .cap = (n + 15) / 16 * 16, .degree = degree};
    for (int p = 0; p < gaussians_planes(degree); p++) {
        double low = p < G_SH ? (double)lo[p] : p < G_SH + 3 ? -2 : -0.3;
        g->plane[p] = trial_random((size_t)g->cap, low, p < G_SH ? (double)hi[p] : -low);
    }
}

/* One worst case in every second splat. */
static void spoil_gaussians(struct gaussians *g, const struct view_geom *v)
{
    static const struct {
        int plane;
        float value;
    } bad[] = {
        {G_MU, NAN},         {G_MU + 2, -9},          {G_MU + 1, 1e30f},  {G_MU + 2, INFINITY},
        {G_LOG_SCALE, 100},  {G_LOG_SCALE + 1, -100}, {G_LOG_SCALE, NAN}, {G_LOG_SCALE + 2, 20},
        {G_QUAT, 1e30f},     {G_QUAT + 1, -INFINITY}, {G_LOGIT, -1e4f},   {G_LOGIT, 1e4f},
        {G_LOGIT, INFINITY}, {G_LOGIT, -INFINITY},    {G_LOGIT, NAN},     {G_SH, 1e30f},
        {G_SH + 1, -1e30f},  {G_SH + 2, INFINITY},    {G_MU, 1e-42f}};
    int n_bad = (int)(sizeof bad / sizeof *bad);
    for (int i = 0; i < g->n; i += 2) {
        int what = (i / 2) % (n_bad + 3);
        if (what < n_bad)
            g->plane[bad[what].plane][i] = bad[what].value;
        for (int k = 0; what == n_bad && k < 3; k++)
            g->plane[G_MU + k][i] = v->centre[k]; // on the camera
        for (int k = 0; what > n_bad && k < 4; k++)
            g->plane[G_QUAT + k][i] = what == n_bad + 1 ? 0.0f : g->plane[G_QUAT + k][i] * 1e-38f;
    }
}

static void project_make(int size, enum pattern pattern)
{
    proj.count = size > SPLAT_BLOCK ? SPLAT_BLOCK : size;
    proj.first = size % 2 ? 0 : SPLAT_BLOCK;
    proj.finite_only = pattern == EXTREME;
    make_view(&proj.v);
    make_gaussians(&proj.g, proj.first + proj.count, size % 5);
    if (pattern == EXTREME)
        spoil_gaussians(&proj.g, &proj.v);
    proj.out = guard_alloc((size_t)(proj.first + proj.count), sizeof *proj.out);
}

static void project_call(const struct kernels *k)
{
    k->project(&proj.g, &proj.v, proj.first, proj.count, proj.out);
}

/* Whether the near plane cuts such a splat is up to rounding. */
static bool on_camera(int i)
{
    const float *c = proj.v.centre;
    return proj.g.plane[G_MU][i] == c[0] && proj.g.plane[G_MU + 1][i] == c[1] &&
           proj.g.plane[G_MU + 2][i] == c[2];
}

static void project_keep(struct outcome *o)
{
    enum { FIELDS = 10 };
    static float f[FIELDS][SPLAT_BLOCK], edges[4][SPLAT_BLOCK], seen[SPLAT_BLOCK];
    memset(f, 0, sizeof f);
    memset(edges, 0, sizeof edges);
    for (int i = 0; i < proj.count; i++) {
        const struct splat2d *s = &proj.out[proj.first + i];
        seen[i] = s->x0 <= s->x1 && s->y0 <= s->y1 && !on_camera(proj.first + i);
        if (seen[i] == 0.0f)
            continue;
        const float v[] = {s->u,     s->v,      s->shear,  s->top,    s->across,
                           s->along, s->rgb[0], s->rgb[1], s->rgb[2], s->z};
        for (int k = 0; k < FIELDS; k++)
            f[k][i] = v[k];
        const float box[] = {s->x0, s->x1, s->y0, s->y1};
        for (int k = 0; k < 4; k++)
            edges[k][i] = box[k];
        if (s->x0 < 0 || s->y0 < 0 || s->x1 >= W || s->y1 >= H || s->tx0 != s->x0 / TILE ||
            s->tx1 != s->x1 / TILE + 1 || s->ty0 != s->y0 / TILE || s->ty1 != s->y1 / TILE + 1)
            o->fault = "wrong bounds";
    }
    for (int i = 0; i < proj.first; i++)
        if (!guard_is_canary(&proj.out[i].u))
            o->fault = "wrote before its block";
    trial_put_row(o, "seen", seen, proj.count, 0);
    double inf = proj.finite_only ? INFINITY : 1;
    trial_put(o, "centre", f[0], (const int[3]){2, proj.count, SPLAT_BLOCK}, 1e-5 * inf);
    trial_scale(o, W);
    trial_put(o, "shape", f[2], (const int[3]){2, proj.count, SPLAT_BLOCK}, 1e-5 * inf);
    trial_scale(o, 1);
    trial_put(o, "record", f[4], (const int[3]){6, proj.count, SPLAT_BLOCK}, 2e-5 * inf);
    trial_put(o, "edges", edges[0], (const int[3]){4, proj.count, SPLAT_BLOCK},
              proj.finite_only ? INFINITY : 0);
}

static void project_grad_make(int size, enum pattern pattern)
{
    project_make(size, pattern);
    proj.sums = trial_random(GRAD2D * SPLAT_BLOCK, -1, 1);
    if (pattern == EXTREME)
        trial_spoil(proj.sums, GRAD2D * SPLAT_BLOCK, extremes, sizeof extremes / sizeof *extremes);
    proj.grad = trial_floats((size_t)gaussians_planes(proj.g.degree) * SPLAT_BLOCK);
    proj.pose = size % 3 ? trial_random(POSE_GRAD, -1, 1) : NULL;
}

static void project_grad_call(const struct kernels *k)
{
    k->project_grad(&proj.g, &proj.v, proj.first, proj.count, proj.sums, proj.grad, proj.pose);
}

/* Gradients are sums of terms that cancel; the error is that of the largest terms of the plane. */
static void project_grad_keep(struct outcome *o)
{
    int planes = gaussians_planes(proj.g.degree);
    trial_put(o, "gradient", proj.grad, (const int[3]){planes, proj.count, SPLAT_BLOCK},
              proj.finite_only ? INFINITY : 2e-4);
    if (proj.pose)
        trial_put_row(o, "pose", proj.pose, POSE_GRAD, proj.finite_only ? INFINITY : 2e-4);
}

/* --- tiles --------------------------------------------------------------------------------- */

static struct {
    struct tile t;
    size_t slots; // in t.slots
} tiles;

/* Splats of a tile, front to back, and the first slot of each. */
static void list_splats(const struct splat2d *from, int n)
{
    struct tile *t = &tiles.t;
    struct splat2d *s = guard_alloc((size_t)n, sizeof *s);
    uint32_t list[2 * SPLAT_BLOCK];
    int tx = t->x0 / TILE, ty = t->y0 / TILE;
    memcpy(s, from, (size_t)n * sizeof *s);
    t->n = 0;
    tiles.slots = 0;
    for (int i = 0; i < n; i++) {
        if (s[i].x1 < s[i].x0 || s[i].y1 < s[i].y0)
            continue;
        s[i].base = (uint32_t)tiles.slots;
        tiles.slots += (size_t)((s[i].tx1 - s[i].tx0) * (s[i].ty1 - s[i].ty0));
        if (tx < s[i].tx0 || tx >= s[i].tx1 || ty < s[i].ty0 || ty >= s[i].ty1)
            continue;
        int j = t->n++;
        for (; j > 0 && s[list[j - 1]].z > s[i].z; j--)
            list[j] = list[j - 1];
        list[j] = (uint32_t)i;
    }
    uint32_t *sorted = guard_alloc((size_t)t->n, sizeof *sorted);
    memcpy(sorted, list, (size_t)t->n * sizeof *list);
    t->splats = s;
    t->list = sorted;
}

static void tile_make(int size, enum pattern pattern)
{
    static struct splat2d flat[2 * SPLAT_BLOCK];
    struct kernels c;
    struct gaussians g;
    struct view_geom v;
    kernels_init(&c, 0);
    make_view(&v);
    make_gaussians(&g, size, 1);
    for (int i = 0; pattern == EXTREME && i < size; i++) { // opaque, faint, needles, all over
        const float logit[] = {40, -5.53f, 10, 0}, scale[] = {-9, 2, -20, 0};
        g.plane[G_LOGIT][i] = logit[i % 4];
        g.plane[G_LOG_SCALE + i % 3][i] = scale[(i / 4) % 4];
    }
    for (int first = 0; first < size; first += SPLAT_BLOCK)
        c.project(&g, &v, first, size - first < SPLAT_BLOCK ? size - first : SPLAT_BLOCK, flat);
    tiles.t = (struct tile){.x0 = TILE * (size % 3),
                            .y0 = TILE * (size % 2),
                            .w = W,
                            .h = H,
                            .background = {1, 0.5f, 0},
                            .gx1 = (W + TILE - 1) / TILE};
    list_splats(flat, size);
    tiles.t.radiance = trial_floats(3 * PX);
    tiles.t.depth = size % 4 ? trial_floats(PX) : NULL;
    tiles.t.alpha = trial_floats(PX);
    tiles.t.trans = trial_floats(PX);
    tiles.t.front = size % 3 ? trial_floats(PX) : NULL;
    tiles.t.stop = guard_alloc(PX, sizeof *tiles.t.stop);
}

static void tile_call(const struct kernels *k)
{
    k->tile(&tiles.t);
}

/* Outside the tile every map must be untouched. */
static void put_map(struct outcome *o, const char *what, const float *map, double bound)
{
    const struct tile *t = &tiles.t;
    int nx = W - t->x0 < TILE ? W - t->x0 : TILE, ny = H - t->y0 < TILE ? H - t->y0 : TILE;
    trial_put(o, what, map + t->y0 * W + t->x0, (const int[3]){ny, nx, W}, bound);
    for (int i = 0; i < PX; i++) {
        int x = i % W - t->x0, y = i / W - t->y0;
        if ((x < 0 || x >= nx || y < 0 || y >= ny) && !guard_is_canary(map + i))
            o->fault = "wrote outside the tile";
    }
}

/* Pixels within rounding of a threshold (1/255, full) may go either way, but hundreds of seeds have
 * shown none. */
static void tile_keep(struct outcome *o)
{
    static float stop[PX], front[PX];
    const struct tile *t = &tiles.t;
    for (int c = 0; c < 3; c++)
        put_map(o, "radiance", t->radiance + c * PX, 1e-5);
    if (t->depth)
        put_map(o, "depth", t->depth, 1e-5);
    put_map(o, "alpha", t->alpha, 2e-6);
    trial_scale(o, 1);
    put_map(o, "transmittance", t->trans, 2e-6);
    trial_scale(o, 1);
    memcpy(stop, t->stop, sizeof stop);
    for (int i = 0; i < PX; i++)
        if (!guard_is_canary(stop + i))
            stop[i] = (float)t->stop[i];
    put_map(o, "stop", stop, 0);
    if (!t->front)
        return;
    memcpy(front, t->front, sizeof front);
    for (int i = 0; i < PX; i++) // so far a depth would hide the error of all others
        if (front[i] == RASTER_FAR)
            front[i] = -1;
    put_map(o, "front", front, 1e-6);
}

static void tile_grad_make(int size, enum pattern pattern)
{
    struct kernels c;
    kernels_init(&c, 0);
    tile_make(size, pattern);
    tiles.t.front = trial_floats(PX);
    c.tile(&tiles.t);
    tiles.t.d_radiance = trial_random(3 * PX, -1, 1);
    tiles.t.d_depth = size % 4 ? trial_random(PX, -0.1, 0.1) : NULL;
    tiles.t.d_alpha = size % 5 ? trial_random(PX, -1, 1) : NULL;
    tiles.t.slots = trial_floats(SLOT * tiles.slots);
}

static void tile_grad_call(const struct kernels *k)
{
    k->tile_grad(&tiles.t);
}

static void tile_grad_keep(struct outcome *o)
{
    static float sums[GRAD2D][2 * SPLAT_BLOCK];
    static bool mine[8 * SPLAT_BLOCK];
    const struct tile *t = &tiles.t;
    memset(mine, 0, sizeof mine);
    for (int i = 0; i < t->n; i++) {
        uint32_t slot = tile_slot(&t->splats[t->list[i]], t, t->x0 / TILE, t->y0 / TILE);
        mine[slot] = true;
        for (int k = 0; k < GRAD2D; k++)
            sums[k][i] = t->slots[SLOT * slot + (uint32_t)k];
    }
    for (size_t s = 0; s < tiles.slots; s++)
        for (size_t k = 0; k < SLOT && !mine[s]; k++)
            if (!guard_is_canary(t->slots + SLOT * s + k))
                o->fault = "wrote in a slot of another tile";
    trial_put(o, "sums", sums[0], (const int[3]){GRAD2D, t->n, 2 * SPLAT_BLOCK}, 2e-3);
}

/* --- all of them --------------------------------------------------------------------------- */

static const struct item items[] = {
    {"project", project_make, project_call, project_keep, 1, SPLAT_BLOCK, SPLAT_BLOCK - 1},
    {"project_grad", project_grad_make, project_grad_call, project_grad_keep, 1, SPLAT_BLOCK,
     SPLAT_BLOCK - 1},
    {"tile", tile_make, tile_call, tile_keep, 0, 100, 100},
    {"tile_grad", tile_grad_make, tile_grad_call, tile_grad_keep, 0, 100, 100},
    {"adam", adam_make, adam_call, adam_keep, 1, 100, 448},
    {"blur_row", row_blur_make, row_blur_call, row_blur_keep, 1, 100, 448},
    {"blur_col", col_blur_make, col_blur_call, col_blur_keep, 1, 100, 448},
    {"moments_row", moments_make, moments_call, moments_keep, 1, 100, 448},
    {"ssim_row", ssim_make, ssim_call, ssim_keep, 1, 100, 448},
    {"display_row", display_make, display_call, display_keep, 1, 100, 448},
    {"tone_row", tone_make, tone_call, tone_keep, 1, 100, 448},
    {"tone_row_grad", tone_grad_make, tone_grad_call, tone_grad_keep, 1, 100, 448},
};

enum { N_ITEMS = sizeof items / sizeof *items };

static int check_all(void)
{
    int failures = 0;
    for (int l = 0; l < N_LEVELS; l++) {
        struct kernels k;
        if ((cpu_detect() & trial_levels[l]) != trial_levels[l])
            continue;
        kernels_init(&k, trial_levels[l]);
        for (int i = 0; i < N_ITEMS; i++) {
            double top = 0;
            int bad = trial_check(&items[i], &k, &top);
            printf("%s %s %s, error %.2f of the bound\n", bad ? "FAILED" : "ok", k.name,
                   items[i].name, top);
            failures += bad;
        }
    }
    return failures;
}

int main(int argc, char **argv)
{
    bool timing = false;
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--seed") == 0 && i + 1 < argc)
            trial_seed = strtoull(argv[++i], NULL, 10);
        else if (strcmp(argv[i], "--bench") == 0)
            timing = true;
        else
            return fprintf(stderr, "usage: %s [--seed N] [--bench]\n", argv[0]), 2;
    }
    guard_open();
    printf("seed %llu\n", (unsigned long long)trial_seed);
    for (int i = 0; timing && i < N_ITEMS; i++)
        trial_bench(&items[i]);
    if (timing)
        return 0;
    guard_trap();
    return check_all() != 0;
}
