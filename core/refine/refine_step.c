/* A view of the scene against its photographs: what they differ by, and a step that lowers it. */
#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/base/splitmix.h"
#include "core/photo/shade.h"
#include "core/refine/part.h"
#include "core/refine/refine_inner.h"
#include "core/sfm/pose.h"

#include <math.h>
#include <string.h>

/* Adam: betas and eps of core/refine/README.md 1. */
static const float BETA1 = 0.9f, BETA2 = 0.999f, EPS = 1e-15f;

struct rates {
    float mean, scale, quat, logit, sh0, sh, tone, pose;
};

/* The release (core/refine/README.md 1) refines a scene that a network has placed well; ours starts
 * from stereo and has fewer steps, so positions move 12 times, shapes 6 and 12 times, colours 16
 * and 40 times as fast (chosen on held-out squares: faster than 8, 3, 6, 8 by 0.35 dB in 500
 * steps), and every rate falls, to 1 % for positions and 10 % for the rest. `mean` is per unit of
 * extent. */
static const struct rates RATES = {12 * 1.6e-4f, 6 * 5e-3f,     12 * 1e-3f, 5e-2f,
                                   16 * 2.5e-3f, 40 * 1.25e-4f, 2.5e-4f,    1e-5f};

static float random_uniform(struct refine *f)
{
    return (float)(splitmix_next(&f->rng) >> 40) * 0x1p-24f;
}

static void set_rate(struct adam_step *a, float lr, int t)
{
    *a = (struct adam_step){lr,
                            BETA1,
                            BETA2,
                            EPS,
                            (float)(1 / (1 - pow((double)BETA1, t))),
                            (float)(1 / (1 - pow((double)BETA2, t)))};
}

/* Index of the learning rate of a plane. */
static int group_of(int plane)
{
    return plane < G_LOG_SCALE ? 0
           : plane < G_QUAT    ? 1
           : plane < G_LOGIT   ? 2
           : plane < G_SH      ? 3
           : plane < G_SH + 3  ? 4
                               : 5;
}

float refine_step_progress(const struct refine *f)
{
    return (float)f->step / (float)f->steps;
}

static void set_rates(struct refine *f)
{
    float slow = powf(0.1f, refine_step_progress(f)), fast = slow * slow;
    const float lr[REFINE_GROUPS] = {RATES.mean * f->extent * fast,
                                     RATES.scale * slow,
                                     RATES.quat * slow,
                                     RATES.logit * slow,
                                     RATES.sh0 * slow,
                                     RATES.sh * slow};
    for (int i = 0; i < REFINE_GROUPS; i++)
        set_rate(&f->group[i], lr[i], f->step + 1);
}

/* The sink of the backward pass: Adam on one block. */
static void apply_adam(void *ctx, int first, int count, const float *grad, const float *seen)
{
    struct refine *f = ctx;
    const struct gaussians *g = &f->s->g;
    if (!f->splits_done)
        for (int i = 0; i < count; i++) {
            if (seen[i] == 0)
                continue;
            float gx = grad[i], gy = grad[SPLAT_BLOCK + i], gz = grad[2 * SPLAT_BLOCK + i],
                  big = -100;
            for (int k = 0; k < 3; k++)
                big = fmaxf(big, g->plane[G_LOG_SCALE + k][first + i]);
            f->d.score[first + i] += sqrtf(gx * gx + gy * gy + gz * gz) * expf(fminf(big, 80.0f));
        }
    for (int p = 0; p < gaussians_planes(g->degree); p++)
        f->r->k->adam(&f->group[group_of(p)], count, seen, grad + p * SPLAT_BLOCK,
                      g->plane[p] + first, f->d.m1[p] + first, f->d.m2[p] + first);
}

static int next_view(struct refine *f)
{
    int n = f->v->n;
    if (f->n_drawn == n)
        f->n_drawn = 0;
    if (f->n_drawn == 0)
        for (int i = 0; i < n; i++) { // inside-out shuffle
            int j = (int)(splitmix_next(&f->rng) % (uint64_t)(i + 1));
            f->shuffled[i] = f->shuffled[j];
            f->shuffled[j] = i;
        }
    return f->shuffled[f->n_drawn++];
}

static struct raster_input view_input(const struct refine *f, const struct camera *cam)
{
    const float *b = f->s->background;
    return (struct raster_input){&f->s->g, cam, {b[0], b[1], b[2]}};
}

/* What is held out of photograph k and was compared. */
static err_t note_sums(struct refine *f, int k, const struct loss_input *in)
{
    const int px = in->held_px, bands = px / TILE, across = f->squares;
    const int x1 = (in->x + in->pic->w + px - 1) / px, y1 = (in->y + in->pic->h + px - 1) / px;
    const int last = (in->y + in->pic->h + TILE - 1) / TILE;
    struct held_sum *to = f->sums + (size_t)k * refine_squares(f);
    err_t e = loss_gather(f->r->team, in, TILE, f->bands, (size_t)across * sizeof *f->bands);
    for (int y = in->y / px; y < y1 && !e; y++)
        for (int x = in->x / px; x < x1; x++) {
            struct held_sum all = {0};
            for (int b = y * bands; b < num_min((y + 1) * bands, last); b++) {
                all.sse += f->bands[b * across + x].sse;
                all.n += f->bands[b * across + x].n;
            }
            to[y * across + x] = all;
        }
    return e;
}

/* Loss of the rendered part of view i against photograph k. Adds to *out and to the gradients of
 * the photographs before. */
static err_t compare_photo(struct refine *f, int i, int k, const struct loss_input *as,
                           struct loss_output *out)
{
    struct loss_input li = *as;
    li.shift = f->v->log2t[k] - f->s->tone.mid_log2t;
    li.photo16 = pyramid_deep(&f->photos, k, f->level);
    li.photo = pyramid_planes(&f->photos, k, f->level);
    li.masked = pyramid_masked(&f->photos, k, f->level);
    li.held = f->held + (size_t)i * refine_squares(f);
    li.skip = outliers_skip(&f->outliers, k);
    struct loss_output one;
    err_t e = loss_run(f->r, &f->loss_work, &li, &one);
    if (e)
        return e;
    e = note_sums(f, k, &li);
    if (e)
        return e;
    out->loss += one.loss;
    for (int p = 0; p < TONE_PARAMS; p++)
        out->tone[p] += one.tone[p];
    return OK;
}

/* Radiance of view i as its camera shows it, or a gradient by that back to radiance. */
static void shade_view(const struct refine *f, int i, float *planes)
{
    if (f->v->shade)
        shade_apply(f->r->pool, &f->v->shade[i], f->pic.w, f->pic.h, planes);
}

/* Render a part of view i at the current size and compare it with its photographs; when the scene
 * learns from them, what they show alone is left out. */
static err_t compare_view(struct refine *f, int i, const struct part *part, const float behind[3],
                          bool learns, struct loss_output *out)
{
    struct raster_input in = view_input(f, &part->cam);
    const struct extent *px = &f->v->extent[i];
    int n = 0;
    memset(out, 0, sizeof *out);
    err_t e = raster_run(f->r, &f->raster, &in, &f->pic);
    if (!e)
        shade_view(f, i, f->pic.radiance);
    for (int k = i; k >= 0; k = views_next(f->v, i, k))
        n++;
    int first, end;
    raster_rows(&f->raster, &first, &end);
    struct loss_input as = {.pic = &f->pic,
                            .first = first,
                            .end = end,
                            .tone = &f->s->tone,
                            .behind = {behind[0], behind[1], behind[2]},
                            .w_l1 = 0.8f / (float)n,
                            .w_ssim = 0.2f / (float)n,
                            .photo_w = px->w >> f->level,
                            .photo_h = px->h >> f->level,
                            .x = part->x,
                            .y = part->y,
                            .held_px = f->held_px >> f->level,
                            .held_across = f->squares,
                            .sums = f->bands,
                            .cell_px = f->outliers.px >> f->level,
                            .cells_across = f->outliers.across,
                            .excess = learns ? f->outliers.excess : NULL};
    for (int k = i; k >= 0 && !e; k = views_next(f->v, i, k)) {
        e = compare_photo(f, i, k, &as, out);
        if (!e && as.excess)
            e = outliers_see(f->r->team, &f->outliers, k, &as);
        as.more = true;
    }
    if (!e)
        shade_view(f, i, f->loss_work.d_radiance);
    return e;
}

static void move_camera(struct refine *f, int i, const float pose[POSE_GRAD])
{
    float g[6], twist[6] = {0}, ones[6] = {1, 1, 1, 1, 1, 1}, *m = f->pose_m + 12 * i;
    struct adam_step a;
    pose_twist_grad(&f->s->cams[i], pose, g);
    set_rate(&a, RATES.pose * powf(0.01f, refine_step_progress(f)), ++f->pose_t[i]);
    for (int k = 0; k < 2; k++) { // translations in units of the extent
        struct adam_step b = a;
        b.lr *= k ? f->extent : 1.0f;
        f->r->k->adam(&b, 3, ones, g + 3 * k, twist + 3 * k, m + 3 * k, m + 6 + 3 * k);
    }
    pose_move(&f->s->cams[i], twist);
}

static void move_tone(struct refine *f, const float grad[TONE_PARAMS])
{
    struct adam_step tone;
    float ones[TONE_PARAMS];
    for (int k = 0; k < TONE_PARAMS; k++)
        ones[k] = 1;
    set_rate(&tone, RATES.tone, f->step + 1);
    f->r->k->adam(&tone, TONE_PARAMS, ones, grad, f->s->tone.p, f->tone_m1, f->tone_m2);
}

/* A view at the present size of the pictures. */
static struct part view_now(const struct refine *f, int i)
{
    const struct extent *px = &f->v->extent[i];
    const struct camera cam = pose_scaled(&f->s->cams[i], px->w >> f->level, px->h >> f->level);
    return part_whole(&cam);
}

/* Light of cameras is known over whole views. */
static bool sees_parts(const struct refine *f)
{
    return f->level == 0 && f->v->size >= PART_FROM && !f->v->shade;
}

static int draws_of(const struct refine *f)
{
    return sees_parts(f) ? PART_DRAWS : 1;
}

/* What is drawn of a view in a step. */
static struct part draw_part(struct refine *f, int i)
{
    const struct part whole = view_now(f, i);
    return sees_parts(f) && num_max(whole.cam.w, whole.cam.h) >= PART_FROM
               ? part_random(&whole.cam, f->held_px, &f->rng)
               : whole;
}

/* The gradients of the comparison before, splat by splat into the sink. */
static err_t propagate_loss(struct refine *f, const struct camera *cam,
                            const struct raster_sink *sink)
{
    const struct raster_input in = view_input(f, cam);
    const struct render_grad up = {f->loss_work.d_radiance, NULL, f->loss_work.d_alpha};
    return raster_grad_run(f->r, &f->raster, &in, &up, sink);
}

static err_t learn_part(struct refine *f)
{
    int i = next_view(f);
    const struct part part = draw_part(f, i);
    struct loss_output out;
    float pose[POSE_GRAD], behind[3];
    for (int c = 0; c < 3; c++)
        behind[c] = random_uniform(f);
    err_t e = compare_view(f, i, &part, behind, true, &out);
    if (e)
        return e;
    f->loss += (float)out.loss / (float)draws_of(f);
    set_rates(f);
    const struct raster_sink sink = {apply_adam, f, f->cfg->poses ? pose : NULL, NULL};
    e = propagate_loss(f, &part.cam, &sink);
    if (e)
        return e;
    if (!f->cfg->tone_known)
        move_tone(f, out.tone);
    if (f->cfg->poses)
        move_camera(f, i, pose);
    return OK;
}

err_t refine_step_learn(struct refine *f)
{
    err_t e = OK;
    for (int k = 0; k < draws_of(f) && !e; k++)
        e = learn_part(f);
    return e;
}

static void ignore_gradient(void *ctx, int first, int count, const float *grad, const float *seen)
{
    (void)ctx, (void)first, (void)count, (void)grad, (void)seen;
}

err_t refine_step_rehearse(struct refine *f, int i)
{
    const float black[3] = {0, 0, 0};
    const struct raster_sink sink = {ignore_gradient, f, NULL, NULL};
    const uint64_t rng = f->rng;
    err_t e = OK;
    for (int k = 0; k < draws_of(f) && !e; k++) {
        const struct part part = draw_part(f, i);
        struct loss_output out;
        e = compare_view(f, i, &part, black, false, &out);
        if (!e)
            e = propagate_loss(f, &part.cam, &sink);
    }
    f->rng = rng;
    return e;
}

static float to_decibel(double mean_square)
{
    return (float)(-10 * log10(fmax(mean_square, 1e-10)));
}

float refine_step_held_db(const struct refine *f)
{
    const size_t photos = (size_t)(f->v->n + f->v->n_more);
    struct held_sum all = {0};
    for (size_t i = 0; i < photos * refine_squares(f); i++) {
        all.sse += f->sums[i].sse;
        all.n += f->sums[i].n;
    }
    return all.n > 0 ? to_decibel(all.sse / all.n) : 0.0f;
}

err_t refine_step_measure(struct refine *f, float *db)
{
    const float black[3] = {0, 0, 0};
    for (int i = 0; i < f->v->n; i++) {
        const struct part whole = view_now(f, i);
        struct loss_output out;
        err_t e = compare_view(f, i, &whole, black, false, &out);
        if (e)
            return e;
    }
    *db = refine_step_held_db(f);
    return OK;
}
