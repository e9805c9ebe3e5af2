/* One step: draw a view, render it (smaller in the first steps, pace_level), loss, backward; the
 * gradient of each block of splats goes straight into Adam while it is in the cache. Exposures of
 * a view share the rendering: its loss is their mean, and black or saturated pixels have hardly any
 * slope on the curve.
 *
 * Held-out squares of the input views (1 in 24 squares of 32 px, others in every view, so that most
 * photographs still show each surface) decide the size of the model:
 * - Gaussians: between 33 % and 70 % of the steps the splats with the largest gradients are split
 *   once a round, unless the held-out error is close to the noise of the photographs (then more
 *   splats would only learn noise), and until SPLITS_VAIN rounds have not lowered it;
 * - SH bands: one band at a time is trained for 15 % of the steps and kept if it lowers the
 *   held-out error;
 * - steps: when PATIENCE rounds have not lowered the held-out error, the schedule is cut short;
 * - the result: the scene with the lowest held-out error at full size. The start does not take
 *   part: it was made from the squares, too. */
#include "core/refine/refine.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/base/splitmix.h"
#include "core/photo/noise.h"
#include "core/photo/shade.h"
#include "core/refine/part.h"
#include "core/refine/refine_inner.h"
#include "core/sfm/pose.h"
#include "core/splat/raster.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { HELD_PX = 32, HELD_ONE_IN = 24, ROUND_MIN = 50, PATIENCE = 4 };
enum { SPLITS_VAIN = 2 };            // rounds of splits that have not helped
enum { MEASURE_STEPS = 8 };          // per view, between two measurements of the scene
enum { EDGE_MIN = 4 * LOSS_WINDOW }; // px of a view that is drawn smaller

static const float SPLIT_SHARE = 0.2f;    // of the splats in one round
static const float SPLIT_END = 0.7f;      // share of the steps after which nothing is split
static const float SPLIT_NOISE_DB = 6.0f; // no more splats within this of the noise
static const float LEVEL_NOISE_DB = 6.0f; // the mean of four pixels has half of their noise
static const float BAND_GAIN_DB =
    0.05f; // least gain of a band: removing any trained band costs a little
static const double HELD_FADES = 0.75; // weight of squares that were seen in the part before
static const float STALL_DB = 0.01f;   // a round that gains less does not count as progress

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

static int round_of(int places)
{
    return places > ROUND_MIN ? places : ROUND_MIN;
}

int refine_begin(const struct refine_config *cfg, int places)
{
    float most = (float)cfg->gaussians_max, n = most;
    const int round = round_of(places), end = (int)(SPLIT_END * (float)cfg->steps);
    for (int step = round; step <= end && n > most / 2; step += round)
        if (pace_level(step - 1, cfg->steps, cfg->levels) < cfg->levels - 1 || cfg->levels == 1)
            n /= 1 + SPLIT_SHARE;
    return (int)fmaxf(n, most / 2);
}

static int shortest_edge(const struct views *v)
{
    int out = v->size;
    for (int i = 0; i < v->n; i++) {
        out = v->extent[i].w < out ? v->extent[i].w : out;
        out = v->extent[i].h < out ? v->extent[i].h : out;
    }
    return out;
}

static int count_levels(const struct views *v, const struct refine_config *cfg)
{
    int n = cfg->levels;
    while (n > 1 && (shortest_edge(v) >> (n - 1) < EDGE_MIN || cfg->steps < 3 * v->n))
        n--;
    return n;
}

static err_t layout_best(struct refine *f, struct arena *a)
{
    err_t e = arena_alloc(a, (size_t)f->v->n, sizeof *f->best.cams, &f->best.cams);
    for (int p = 0; p < gaussians_planes(f->cfg->degree_max) && !e; p++)
        e = arena_alloc(a, (size_t)f->s->g.cap, 4, &f->best.g.plane[p]);
    return e;
}

static err_t layout(struct refine *f, struct arena *a, int threads)
{
    const struct extent most = extent_cover(f->v->extent, f->v->n);
    const int photos = f->v->n + f->v->n_more;
    const size_t px = most.at;
    f->held_px = HELD_PX << (f->levels > 2 ? f->levels - 2 : 0);
    f->squares = (f->v->size + f->held_px - 1) / f->held_px;
    size_t n = (size_t)f->v->n, q = (size_t)f->squares, all = (size_t)photos;
    f->photos = (struct pyramid){.v = f->v, .levels = f->levels};
    err_t e = pyramid_layout(&f->photos, a);
    if (!e)
        e = arena_alloc(a, n * q * q, 1, &f->held);
    if (!e)
        e = outliers_layout(&f->outliers, a, f->v, OUTLIERS_PX << (f->levels > 2));
    if (!e)
        e = arena_zalloc(a, all, 8, &f->photo_sse);
    if (!e)
        e = arena_zalloc(a, all, 8, &f->photo_n);
    if (!e)
        e = arena_zalloc(a, n, 4, &f->shuffled);
    if (!e)
        e = arena_zalloc(a, n * 12, 4, &f->pose_m);
    if (!e)
        e = arena_zalloc(a, n, 4, &f->pose_t);
    if (!e)
        e = arena_alloc(a, 3 * px, 4, &f->pic.radiance);
    if (!e)
        e = arena_alloc(a, px, 4, &f->pic.alpha);
    if (!e)
        e = raster_init(&f->raster, a, f->cfg->gaussians_max, most.w, most.h, true);
    if (!e)
        e = loss_init(&f->loss_work, a, most.w, most.h, threads);
    if (!e)
        e = layout_best(f, a);
    return e ? e : density_init(&f->d, a, &f->s->g, f->cfg->degree_max);
}

size_t refine_plan(const struct views *v, const struct refine_config *cfg, int threads)
{
    struct arena planes = arena_counter(), a = arena_counter();
    struct scene s;
    struct refine f = {.v = v, .cfg = cfg, .s = &s, .levels = count_levels(v, cfg)};
    if (gaussians_init(&s.g, &planes, cfg->gaussians_max, cfg->degree_max) ||
        layout(&f, &a, threads))
        return SIZE_MAX;
    arena_step(&a, noise_plan(v));
    return a.peak;
}

static void choose_held(struct refine *f)
{
    uint64_t s = f->cfg->seed ^ 0x68656c64;
    for (int i = 0; i < f->v->n * f->squares * f->squares; i++)
        f->held[i] = splitmix_next(&s) % HELD_ONE_IN == 0;
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

static float progress_of(const struct refine *f)
{
    return (float)f->step / (float)f->steps;
}

static void set_rates(struct refine *f)
{
    float slow = powf(0.1f, progress_of(f)), fast = slow * slow;
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

/* Loss of the rendered part of view i against photograph k. Adds to *out and to the gradients of
 * the photographs before. */
static err_t compare_photo(struct refine *f, int i, int k, const struct loss_input *as,
                           struct loss_output *out)
{
    const double fades = as->photo_w > f->pic.w || as->photo_h > f->pic.h ? HELD_FADES : 0;
    const size_t squares = (size_t)f->squares * (size_t)f->squares;
    struct loss_input li = *as;
    li.shift = f->v->log2t[k] - f->s->tone.mid_log2t;
    li.photo16 = pyramid_deep(&f->photos, k, f->level);
    li.photo = pyramid_planes(&f->photos, k, f->level);
    li.masked = pyramid_masked(&f->photos, k, f->level);
    li.held = f->held + (size_t)i * squares;
    li.skip = outliers_skip(&f->outliers, k);
    struct loss_output one;
    err_t e = loss_run(f->r, &f->loss_work, &li, &one);
    if (e)
        return e;
    f->photo_sse[k] = fades * f->photo_sse[k] + one.held_sse;
    f->photo_n[k] = fades * f->photo_n[k] + (double)one.held_n;
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
    set_rate(&a, RATES.pose * powf(0.01f, progress_of(f)), ++f->pose_t[i]);
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

static err_t learn_view(struct refine *f)
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


static void add_note(struct refine *f, const char *fmt, ...) __attribute__((format(printf, 2, 3)));

static void add_note(struct refine *f, const char *fmt, ...)
{
    va_list ap;
    if (f->rep->n_notes == REFINE_NOTES)
        return;
    va_start(ap, fmt);
    vsnprintf(f->rep->notes[f->rep->n_notes++], sizeof f->rep->notes[0], fmt, ap);
    va_end(ap);
}

static float to_decibel(double mean_square)
{
    return (float)(-10 * log10(fmax(mean_square, 1e-10)));
}

static float held_db(const struct refine *f)
{
    double sse = 0, n = 0;
    for (int i = 0; i < f->v->n + f->v->n_more; i++) {
        sse += f->photo_sse[i];
        n += f->photo_n[i];
    }
    return n > 0 ? to_decibel(sse / n) : 0.0f;
}

static void note_outliers(struct refine *f)
{
    float most = 0;
    int photos = 0;
    for (int k = 0; k < f->v->n + f->v->n_more; k++) {
        const float share = outliers_share(&f->outliers, k);
        photos += share > 0;
        most = fmaxf(most, share);
    }
    if (photos)
        add_note(f,
                 "left out what the other photographs do not show: in %d photographs, at most "
                 "%.1f %% of one",
                 photos, 100 * (double)most);
}

size_t refine_cells(const struct views *v)
{
    const size_t across = (size_t)(v->size + OUTLIERS_PX - 1) / OUTLIERS_PX;
    return (size_t)(v->n + v->n_more) * across * across;
}

static void keep_outliers(const struct refine *f)
{
    const struct outliers *o = &f->outliers;
    if (!f->cfg->left_out)
        return;
    f->rep->left_out = (struct refine_left_out){o->px, o->across, f->cfg->left_out};
    memcpy(f->cfg->left_out, o->skip, (size_t)(f->v->n + f->v->n_more) * outliers_cells(o));
}

/* Present held-out error of all views. */
static err_t measure_held_out(struct refine *f, float *db)
{
    const float black[3] = {0, 0, 0};
    for (int i = 0; i < f->v->n; i++) {
        const struct part whole = view_now(f, i);
        struct loss_output out;
        err_t e = compare_view(f, i, &whole, black, false, &out);
        if (e)
            return e;
    }
    *db = held_db(f);
    return OK;
}

static void keep_best(struct refine *f, float db)
{
    struct best *b = &f->best;
    b->db = db;
    b->step = f->step;
    b->tone = f->s->tone;
    memcpy(b->cams, f->s->cams, (size_t)f->v->n * sizeof *b->cams);
    gaussians_copy(&f->s->g, f->cfg->degree_max, &b->g);
}

/* The last scene, or a better one before it. */
static err_t settle_best(struct refine *f)
{
    struct best *b = &f->best;
    float last;
    err_t e = measure_held_out(f, &last);
    f->rep->step_kept = f->step;
    f->rep->held_out_db[1] = last;
    if (e || b->step == 0 || last >= b->db)
        return e;
    add_note(f, "kept the scene of step %d: held-out %.2f dB there, %.2f dB at step %d", b->step,
             (double)b->db, (double)last, f->step);
    f->rep->step_kept = b->step;
    f->rep->held_out_db[1] = b->db;
    f->s->tone = b->tone;
    memcpy(f->s->cams, b->cams, (size_t)f->v->n * sizeof *b->cams);
    gaussians_copy(&b->g, f->cfg->degree_max, &f->s->g);
    return OK;
}

/* Past the smallest pictures: the scene may become richer. */
static bool is_settled(const struct refine *f)
{
    return f->level < f->levels - 1 || f->levels == 1;
}

static void add_band(struct refine *f)
{
    struct gaussians *g = &f->s->g;
    int from = gaussians_planes(g->degree);
    g->degree++;
    for (int p = from; p < gaussians_planes(g->degree); p++) {
        memset(g->plane[p], 0, (size_t)g->cap * sizeof(float));
        memset(f->d.m1[p], 0, (size_t)g->cap * sizeof(float));
        memset(f->d.m2[p], 0, (size_t)g->cap * sizeof(float));
    }
    f->band_from = f->step;
}

/* Keep the band on trial only if the held-out squares are worse without it. */
static err_t judge_band(struct refine *f)
{
    float with, without;
    int degree = f->s->g.degree;
    err_t e = measure_held_out(f, &with);
    f->s->g.degree = degree - 1;
    if (!e)
        e = measure_held_out(f, &without);
    f->s->g.degree = degree;
    if (e)
        return e;
    bool keep = with - without >= BAND_GAIN_DB;
    if (!keep)
        f->s->g.degree--;
    f->bands_done = !keep;
    f->band_from = 0;
    add_note(f, "SH band %d: held-out %.2f dB with it, %.2f dB without: %s", degree, (double)with,
             (double)without, keep ? "kept" : "not needed");
    return OK;
}

static err_t update_bands(struct refine *f)
{
    int trial = f->steps * 15 / 100;
    if (f->band_from > 0 && f->step - f->band_from >= trial) {
        err_t e = judge_band(f);
        if (e)
            return e;
    }
    if (f->band_from == 0 && !f->bands_done && is_settled(f) && f->step + trial < f->steps &&
        trial >= f->v->n && progress_of(f) >= 0.5f && f->s->g.degree < f->cfg->degree_max)
        add_band(f);
    return OK;
}

static void split_splats(struct refine *f)
{
    struct gaussians *g = &f->s->g;
    if (f->splits_done || !is_settled(f))
        return;
    float db = held_db(f);
    /* one per pixel: more did not help denser starts */
    int most = (int)extent_cover(f->v->extent, f->v->n).at;
    most = most < f->cfg->gaussians_max ? most : f->cfg->gaussians_max;
    const float noise_db = f->noise_db + LEVEL_NOISE_DB * (float)f->level;
    bool noise = db > noise_db - SPLIT_NOISE_DB, all = g->n >= most;
    if (f->level != f->split_level || db > f->split_db) {
        f->split_level = f->level;
        f->split_db = db;
        f->splits_vain = 0;
    } else
        f->splits_vain++;
    const bool vain = f->splits_vain >= SPLITS_VAIN;
    f->splits_done = progress_of(f) > SPLIT_END || noise || all || vain;
    if (f->splits_done) {
        add_note(f, "%d Gaussians: %s (held-out %.1f dB, noise of the photographs %.1f dB)", g->n,
                 all     ? "as many as pixels or as allowed"
                 : noise ? "more would learn noise"
                 : vain  ? "more made held-out squares no better"
                         : "the steps that are left train these",
                 (double)db, (double)noise_db);
        return;
    }
    density_prune(&f->d, 0.01f);
    int room = most - g->n, want = (int)(SPLIT_SHARE * (float)g->n);
    density_split(&f->d, want < room ? want : room);
    density_sort(&f->d);
}

/* Before the scene changes: is it the best? Costs a picture of each view, so seldom with many. */
static err_t compare_best(struct refine *f)
{
    float db;
    if (f->level > 0 || f->band_from > 0 || f->step - f->measured < MEASURE_STEPS * f->v->n)
        return OK;
    f->measured = f->step;
    err_t e = measure_held_out(f, &db);
    if (!e && (f->best.step == 0 || db > f->best.db))
        keep_best(f, db);
    return e;
}

/* ---- time ---- */

static bool has_limit(const struct refine *f)
{
    return f->cfg->seconds > 0 && f->r->clock;
}

static void ignore_gradient(void *ctx, int first, int count, const float *grad, const float *seen)
{
    (void)ctx, (void)first, (void)count, (void)grad, (void)seen;
}

/* Seconds of a step at a level, by two that change nothing. */
static err_t time_level(struct refine *f, int level)
{
    const float black[3] = {0, 0, 0};
    const struct raster_sink sink = {ignore_gradient, f, NULL, NULL};
    const double start = f->r->clock();
    const uint64_t rng = f->rng;
    f->level = level;
    for (int k = 0; k < 2 * draws_of(f); k++) {
        const int i = k % 2 * f->v->n / 2;
        const struct part part = draw_part(f, i);
        struct loss_output out;
        err_t e = compare_view(f, i, &part, black, false, &out);
        if (!e)
            e = propagate_loss(f, &part.cam, &sink);
        if (e)
            return e;
    }
    f->rng = rng;
    f->pace.seconds[level] = (f->r->clock() - start) / 2;
    return team_copy(f->r->team, &f->pace.seconds[level], sizeof f->pace.seconds[level]);
}

/* Between the smallest and the largest pictures a step costs something for each splat and something
 * for each pixel. */
static err_t limit_steps(struct refine *f)
{
    struct pace *p = &f->pace;
    const int last = f->levels - 1;
    if (!has_limit(f))
        return OK;
    p->levels = f->levels;
    err_t e = time_level(f, last);
    if (!e && last > 0)
        e = time_level(f, 0);
    for (int k = 1; k < last; k++) {
        const double share = (ldexp(1, -2 * k) - ldexp(1, -2 * last)) / (1 - ldexp(1, -2 * last));
        p->seconds[k] = p->seconds[last] + share * (p->seconds[0] - p->seconds[last]);
    }
    f->ready = f->r->clock();
    f->steps = pace_fit(p, 0, f->steps, f->cfg->seconds - (f->ready - f->began));
    return e ? e : team_copy(f->r->team, &f->steps, sizeof f->steps);
}

/* Leave out the steps that would come too late, by the time that those before have taken. */
static err_t keep_pace(struct refine *f)
{
    if (!has_limit(f))
        return OK;
    const double now = f->r->clock(), left = f->cfg->seconds - (now - f->began);
    if (now > f->ready)
        f->steps = pace_fit(&f->pace, f->step, f->steps, left * f->expected / (now - f->ready));
    return team_copy(f->r->team, &f->steps, sizeof f->steps);
}

/* Once a round: report, split and decide whether to stop. */
static err_t end_round(struct refine *f, int round)
{
    float db = held_db(f);
    f->rep->loss = f->loss / (float)round;
    f->loss = 0;
    if (f->r->progress) {
        char text[96];
        snprintf(text, sizeof text, "held-out %.2f dB, %d Gaussians", (double)db, f->s->g.n);
        f->r->progress(f->r->progress_ctx, "refine", f->step, f->steps, text);
    }
    err_t e = compare_best(f);
    if (!e)
        e = keep_pace(f);
    if (e)
        return e;
    split_splats(f);
    if (f->level > 0 || f->band_from > 0)
        return OK;
    bool better = db > f->best_db + STALL_DB;
    f->stalled = better ? 0 : f->stalled + 1;
    f->best_db = fmaxf(f->best_db, db);
    int rest = f->steps / 20 > round ? f->steps / 20 : round;
    if (f->stalled >= PATIENCE && !f->rep->stopped_early && f->steps - f->step > rest) {
        f->rep->stopped_early = true;
        add_note(f, "stopped at step %d of %d: %d rounds have not lowered the held-out error",
                 f->step + rest, f->steps, PATIENCE);
        f->steps = f->step + rest;
    }
    return OK;
}

/* What is known before the first step. */
static err_t begin_steps(struct refine *f)
{
    err_t e = noise_run(f->r, f->v, &f->noise_db);
    if (!e)
        e = limit_steps(f);
    return e ? e : measure_held_out(f, &f->rep->held_out_db[0]);
}

static err_t take_step(struct refine *f)
{
    const int round = round_of(f->v->n);
    err_t e = OK;
    f->level = pace_level(f->step, f->steps, f->levels);
    for (int k = 0; k < draws_of(f) && !e; k++)
        e = learn_view(f);
    f->expected += f->pace.seconds[f->level];
    f->rep->steps = ++f->step;
    if (!e && f->step % round == 0)
        e = end_round(f, round);
    if (!e)
        e = update_bands(f);
    if (!e && outliers_due(f->step, f->steps))
        e = outliers_judge(f->r, &f->outliers, &f->raster, f->s);
    return e;
}

/* A step with all that follows from it: a saved state is that between two. */
static err_t take_whole_step(struct refine *f)
{
    const struct run *r = f->r;
    struct run whole = *r;
    if (f->cfg->saver)
        whole.cancel = NULL;
    f->r = &whole;
    err_t e = take_step(f);
    f->r = r;
    return e;
}

/* Which scene it shall be. */
static err_t finish_steps(struct refine *f)
{
    err_t e = OK;
    if (f->band_from > 0)
        e = judge_band(f);
    if (!e)
        e = settle_best(f);
    /* the state is still that after the last step */
    return e == ERR_CANCELLED ? refine_state_keep(f) : e;
}

static err_t run_steps(struct refine *f)
{
    err_t e = OK;
    while (f->step < f->steps && !e) {
        e = take_whole_step(f);
        if (!e)
            e = refine_state_keep(f);
    }
    if (!e)
        e = finish_steps(f);
    if (f->steps < f->cfg->steps && !f->rep->stopped_early)
        add_note(f, "%d of %d steps: no more fit into the time", f->steps, f->cfg->steps);
    if (!e) {
        note_outliers(f);
        keep_outliers(f);
    }
    return e;
}

err_t refine_run(const struct run *r, const struct views *v, const struct refine_config *cfg,
                 struct scene *io, struct refine_report *out)
{
    memset(out, 0, sizeof *out);
    size_t mark = arena_mark(r->tmp);
    bool resumed = false;
    struct refine f = {.r = r,
                       .v = v,
                       .cfg = cfg,
                       .s = io,
                       .rep = out,
                       .rng = cfg->seed,
                       .steps = cfg->steps,
                       .levels = count_levels(v, cfg),
                       .began = r->clock ? r->clock() : 0};
    if (cfg->levels < 1 || cfg->levels > REFINE_LEVELS)
        return err_fail(ERR_ARG, "refine: %d levels, must be 1..%d", cfg->levels, REFINE_LEVELS);
    if (shortest_edge(v) < LOSS_WINDOW)
        return err_fail(ERR_ARG, "refine: a view is %d px narrow, a side must be at least %d px",
                        shortest_edge(v), LOSS_WINDOW);
    err_t e = layout(&f, r->tmp, pool_size(r->pool));
    f.raster.team = f.loss_work.team = r->team;
    if (!e)
        e = pyramid_run(r->pool, &f.photos);
    if (!e)
        e = refine_state_begin(&f, &resumed);
    if (!e) {
        choose_held(&f);
        outliers_begin(&f.outliers);
        f.extent = pose_extent(&io->g, io->cams, io->n_views);
        density_prune(&f.d, 0.01f); // core/refine/README.md 1, D
        density_sort(&f.d);
    }
    if (!e)
        e = resumed ? refine_state_load(&f) : begin_steps(&f);
    if (!e)
        e = run_steps(&f);
    out->gaussians = io->g.n;
    out->degree = io->g.degree;
    arena_reset(r->tmp, mark);
    return e;
}
