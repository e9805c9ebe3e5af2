/* One step: draw a view, render it (at half size in the first third), loss, backward; the gradient of each
 * block of splats goes straight into Adam while it is in the cache.
 *
 * What the scene needs is decided by the held-out squares of the input views (1 in 24 squares of 32 px per view, other
 * squares in other views, so that every surface is still learned from most photographs):
 * - Gaussians: every ROUND steps in the first 60 % the splats that pull hardest are split, while the error falls;
 * - SH bands: one more band at a time is tried for a sixth of the steps and kept if it lowers the error;
 * - steps: the work ends when three rounds have not lowered it.
 * Learning rates: model-spec 5.2; the rate of positions is in units of the scene's extent. */
#include "core/opt/refine.h"

#include "core/opt/density.h"
#include "core/opt/loss.h"
#include "core/opt/pose.h"
#include "core/splat/raster.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { HELD_PX = 32, HELD_ONE_IN = 24, ROUND_MIN = 50, GROUPS = 6 };

/* Adam: betas and eps of model-spec 5.2. */
static const float BETA1 = 0.9f, BETA2 = 0.999f, EPS = 1e-15f;

struct rates {
    float mean, scale, quat, logit, sh0, sh, tone, pose;
};

/* model-spec 5.2, table of learning rates; `mean` per unit of extent. */
static const struct rates RATES = {1.6e-4f, 5e-3f, 1e-3f, 5e-2f, 2.5e-3f, 1.25e-4f, 2.5e-4f, 1e-5f};

struct refine {
    const struct run *r;
    const struct views *v;
    const struct refine_config *cfg;
    struct scene *s;
    struct refine_report *rep;
    struct density d;
    struct raster raster;
    struct loss loss;
    struct render pic;
    uint8_t *full, *half;  // (n, 3, size, size) photographs, and at half size
    uint8_t *held;         // (n, squares, squares)
    int squares;
    double *view_sse;      // (n) held-out squared error at the last visit
    long *view_n;          // (n) values in it
    float *view_loss;      // (n)
    int *deck, dealt;      // (n) order of the views in this round
    uint64_t rng;
    float extent;          // scene units
    int step, steps;
    float tone_m1[TONE_PARAMS], tone_m2[TONE_PARAMS];
    float *pose_m;         // (n, 12) moments of the twists
    int *pose_t;           // (n) steps of each camera
    struct adam_step group[GROUPS];
    bool scoring;
};

static uint64_t next_random(uint64_t *s)
{
    uint64_t z = *s += 0x9e3779b97f4a7c15ull; // splitmix64
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ z >> 27) * 0x94d049bb133111ebull;
    return z ^ z >> 31;
}

static float uniform(struct refine *f)
{
    return (float)(next_random(&f->rng) >> 40) * 0x1p-24f;
}

static size_t small_need(int n, int size)
{
    size_t v = (size_t)n, h = (size_t)size / 2, q = ((size_t)size + HELD_PX - 1) / HELD_PX;
    const size_t need[][2] = {{v * h * h * 3, 1}, {v * (size_t)size * (size_t)size * 3, 1}, {v * q * q, 1}, {v, 8}, {v, 8}, {v, 4}, {v, 4}, {v * 12, 4}, {v, 4},
                              {3 * (size_t)size * (size_t)size, 4}, {(size_t)size * (size_t)size, 4}};
    size_t total = 0;
    for (size_t i = 0; i < sizeof need / sizeof need[0]; i++)
        total = arena_add(total, arena_need(need[i][0], need[i][1]));
    return total;
}

size_t refine_plan(int n_views, int size, const struct refine_config *cfg, int threads)
{
    size_t total = small_need(n_views, size);
    total = arena_add(total, raster_plan(cfg->gaussians_max, size, size, true));
    total = arena_add(total, loss_plan(size, size, threads));
    return arena_add(total, density_plan(cfg->gaussians_max, cfg->degree_max));
}

static err_t alloc_all(struct refine *f)
{
    struct arena *a = f->r->tmp;
    size_t n = (size_t)f->v->n, size = (size_t)f->v->size, q = (size_t)f->squares, px = size * size;
    err_t e = arena_alloc(a, n * (size / 2) * (size / 2) * 3, 1, &f->half);
    e = e ? e : arena_alloc(a, n * px * 3, 1, &f->full);
    e = e ? e : arena_alloc(a, n * q * q, 1, &f->held);
    e = e ? e : arena_zalloc(a, n, 8, &f->view_sse);
    e = e ? e : arena_zalloc(a, n, 8, &f->view_n);
    e = e ? e : arena_zalloc(a, n, 4, &f->view_loss);
    e = e ? e : arena_alloc(a, n, 4, &f->deck);
    e = e ? e : arena_zalloc(a, n * 12, 4, &f->pose_m);
    e = e ? e : arena_zalloc(a, n, 4, &f->pose_t);
    e = e ? e : arena_alloc(a, 3 * px, 4, &f->pic.radiance);
    e = e ? e : arena_alloc(a, px, 4, &f->pic.alpha);
    e = e ? e : raster_init(&f->raster, a, f->cfg->gaussians_max, f->v->size, f->v->size, true);
    e = e ? e : loss_init(&f->loss, a, f->v->size, f->v->size, pool_size(f->r->pool));
    return e ? e : density_init(&f->d, a, &f->s->g, f->cfg->degree_max);
}

/* Photographs of one view as planes, and at half size. */
static err_t planes_chunk(void *ctx, int i, int worker)
{
    struct refine *f = ctx;
    (void)worker;
    size_t s = (size_t)f->v->size, h = s / 2;
    const uint8_t *in = f->v->rgb + (size_t)i * s * s * 3;
    uint8_t *full = f->full + (size_t)i * s * s * 3, *half = f->half + (size_t)i * h * h * 3;
    for (size_t c = 0; c < 3; c++) {
        for (size_t at = 0; at < s * s; at++)
            full[c * s * s + at] = in[at * 3 + c];
        for (size_t at = 0; at < h * h; at++) {
            const uint8_t *p = in + (2 * (at / h) * s + 2 * (at % h)) * 3 + c;
            half[c * h * h + at] = (uint8_t)((p[0] + p[3] + p[3 * s] + p[3 * s + 3] + 2) / 4);
        }
    }
    return OK;
}

static void choose_held(struct refine *f)
{
    uint64_t s = f->cfg->seed ^ 0x68656c64;
    for (int i = 0; i < f->v->n * f->squares * f->squares; i++)
        f->held[i] = next_random(&s) % HELD_ONE_IN == 0;
}

/* Median distance from the cameras to the splats' centre of mass: the yardstick of positions. */
static float scene_extent(const struct scene *s)
{
    double c[3] = {0}, sum = 0;
    for (int i = 0; i < s->g.n; i++)
        for (int k = 0; k < 3; k++)
            c[k] += (double)s->g.plane[k][i] / s->g.n;
    for (int i = 0; i < s->n_views; i++) {
        float r[9];
        double d2 = 0;
        raster_rotation(s->cams[i].q, r);
        for (int k = 0; k < 3; k++) {
            const float *t = s->cams[i].t;
            double o = -(double)(r[k] * t[0] + r[3 + k] * t[1] + r[6 + k] * t[2]);
            d2 += (o - c[k]) * (o - c[k]);
        }
        sum += sqrt(d2) / s->n_views;
    }
    return sum > 0 && isfinite(sum) ? (float)sum : 1.0f;
}

static void set_rate(struct adam_step *a, float lr, int t)
{
    *a = (struct adam_step){lr, BETA1, BETA2, EPS, (float)(1 / (1 - pow((double)BETA1, t))),
                            (float)(1 / (1 - pow((double)BETA2, t)))};
}

/* Which rate a plane has. */
static int group_of(int plane)
{
    return plane < G_LOG_SCALE ? 0 : plane < G_QUAT ? 1 : plane < G_LOGIT ? 2 : plane < G_SH ? 3 : plane < G_SH + 3 ? 4 : 5;
}

static void set_rates(struct refine *f)
{
    float decay = powf(0.01f, (float)f->step / (float)f->steps);
    const float lr[GROUPS] = {RATES.mean * f->extent * decay, RATES.scale, RATES.quat, RATES.logit, RATES.sh0, RATES.sh};
    for (int i = 0; i < GROUPS; i++)
        set_rate(&f->group[i], lr[i], f->step + 1);
}

/* The sink of the backward pass: Adam on one block. */
static void apply(void *ctx, int first, int count, const float *grad, const float *seen)
{
    struct refine *f = ctx;
    const struct gaussians *g = &f->s->g;
    if (f->scoring)
        for (int i = 0; i < count; i++) {
            float gx = grad[i], gy = grad[SPLAT_BLOCK + i], gz = grad[2 * SPLAT_BLOCK + i], big = -100;
            for (int k = 0; k < 3; k++)
                big = fmaxf(big, g->plane[G_LOG_SCALE + k][first + i]);
            f->d.score[first + i] += sqrtf(gx * gx + gy * gy + gz * gz) * expf(fminf(big, 80.0f));
        }
    for (int p = 0; p < gaussians_planes(g->degree); p++)
        f->r->k->adam(&f->group[group_of(p)], count, seen, grad + p * SPLAT_BLOCK, g->plane[p] + first,
                      f->d.m1[p] + first, f->d.m2[p] + first);
}

static int next_view(struct refine *f)
{
    int n = f->v->n;
    if (f->dealt == n)
        f->dealt = 0;
    if (f->dealt == 0)
        for (int i = 0; i < n; i++) { // inside-out shuffle
            int j = (int)(next_random(&f->rng) % (uint64_t)(i + 1));
            f->deck[i] = f->deck[j];
            f->deck[j] = i;
        }
    return f->deck[f->dealt++];
}

static struct raster_input view_input(const struct refine *f, const struct camera *cam)
{
    const float *b = f->s->background;
    return (struct raster_input){&f->s->g, cam, {b[0], b[1], b[2]}};
}

/* Render and compare view i at 1/scale of its size. */
static err_t look(struct refine *f, int i, int scale, const struct camera *cam, struct loss_output *out)
{
    size_t side = (size_t)cam->w;
    struct raster_input in = view_input(f, cam);
    err_t e = raster_run(f->r, &f->raster, &in, &f->pic);
    if (e)
        return e;
    struct loss_input li = {.pic = &f->pic, .tone = &f->s->tone, .shift = f->s->log2t[i] - f->s->tone.mid_log2t,
                            .photo = (scale == 1 ? f->full : f->half) + (size_t)i * side * side * 3,
                            .w_l1 = 0.8f, .w_ssim = 0.2f,
                            .held = f->held + (size_t)i * (size_t)f->squares * (size_t)f->squares,
                            .held_px = HELD_PX / scale};
    for (int c = 0; c < 3; c++)
        li.behind[c] = uniform(f);
    e = loss_run(f->r, &f->loss, &li, out);
    f->view_sse[i] = out->held_sse;
    f->view_n[i] = out->held_n;
    f->view_loss[i] = (float)out->loss;
    return e;
}

static void move_camera(struct refine *f, int i, const float pose[POSE_GRAD])
{
    float g[6], twist[6] = {0}, ones[6] = {1, 1, 1, 1, 1, 1}, *m = f->pose_m + 12 * i;
    struct adam_step a;
    pose_twist_grad(&f->s->cams[i], pose, g);
    set_rate(&a, RATES.pose * powf(0.01f, (float)f->step / (float)f->steps), ++f->pose_t[i]);
    for (int k = 0; k < 2; k++) { // translations in units of the extent
        struct adam_step b = a;
        b.lr *= k ? f->extent : 1.0f;
        f->r->k->adam(&b, 3, ones, g + 3 * k, twist + 3 * k, m + 3 * k, m + 6 + 3 * k);
    }
    pose_move(&f->s->cams[i], twist);
}

static err_t take_step(struct refine *f)
{
    int i = next_view(f), scale = f->step * 3 < f->steps && f->v->size >= 8 * LOSS_WINDOW ? 2 : 1;
    struct camera cam = pose_scaled(&f->s->cams[i], f->v->size / scale, f->v->size / scale);
    struct loss_output out;
    float pose[POSE_GRAD];
    err_t e = look(f, i, scale, &cam, &out);
    if (e)
        return e;
    set_rates(f);
    struct raster_input in = view_input(f, &cam);
    struct render_grad up = {f->loss.d_radiance, NULL, f->loss.d_alpha};
    struct raster_sink sink = {apply, f, f->cfg->poses ? pose : NULL, NULL};
    e = raster_grad_run(f->r, &f->raster, &in, &up, &sink);
    if (e)
        return e;
    struct adam_step tone;
    float ones[TONE_PARAMS];
    for (int k = 0; k < TONE_PARAMS; k++)
        ones[k] = 1;
    set_rate(&tone, RATES.tone, f->step + 1);
    f->r->k->adam(&tone, TONE_PARAMS, ones, out.tone, f->s->tone.p, f->tone_m1, f->tone_m2);
    if (f->cfg->poses)
        move_camera(f, i, pose);
    return OK;
}

static float held_db(const struct refine *f)
{
    double sse = 0, n = 0;
    for (int i = 0; i < f->v->n; i++) {
        sse += f->view_sse[i];
        n += (double)f->view_n[i];
    }
    return n > 0 ? (float)(-10 * log10(fmax(sse / n, 1e-10))) : 0.0f;
}

static err_t run_steps(struct refine *f)
{
    int round = f->v->n > ROUND_MIN ? f->v->n : ROUND_MIN;
    for (f->step = 0; f->step < f->steps; f->step++) {
        err_t e = take_step(f);
        if (e)
            return e;
        f->rep->steps = f->step + 1;
        if (f->step + 1 == f->v->n)
            f->rep->held_out_db[0] = held_db(f);
        if ((f->step + 1) % round == 0 && f->r->progress) {
            char note[64];
            snprintf(note, sizeof note, "held-out %.2f dB, %d Gaussians", (double)held_db(f), f->s->g.n);
            f->r->progress(f->r->progress_ctx, "refine", f->step + 1, f->steps, note);
        }
    }
    return OK;
}

err_t refine_run(const struct run *r, const struct views *v, const struct refine_config *cfg, struct scene *io,
                 struct refine_report *out)
{
    memset(out, 0, sizeof *out);
    size_t mark = arena_mark(r->tmp);
    struct refine f = {.r = r, .v = v, .cfg = cfg, .s = io, .rep = out, .rng = cfg->seed, .steps = cfg->steps};
    f.squares = (v->size + HELD_PX - 1) / HELD_PX;
    err_t e = alloc_all(&f);
    e = e ? e : pool_for(r->pool, v->n, planes_chunk, &f);
    if (!e) {
        choose_held(&f);
        f.extent = scene_extent(io);
        density_prune(&f.d, 0.01f); // model-spec 5.2 D
        density_sort(&f.d);
        e = run_steps(&f);
        out->held_out_db[1] = held_db(&f);
    }
    out->gaussians = io->g.n;
    out->degree = io->g.degree;
    arena_reset(r->tmp, mark);
    return e;
}
