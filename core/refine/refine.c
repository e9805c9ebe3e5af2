/* One step: draw a view, render it (smaller in the first steps, pace_level), loss, backward; the
 * gradient of each block of splats goes straight into Adam while it is in the cache. Exposures of
 * a view share the rendering: its loss is their mean, and black or saturated pixels have hardly any
 * slope on the curve.
 *
 * Held-out squares of the input views (1 in 24 squares of 32 px, others in every view, so that most
 * photographs still show each surface) decide the size of the model:
 * - Gaussians: between 33 % and 70 % of the steps the splats with the largest gradients, guesses
 *   (confidence.h) left out, are split once a round, unless the held-out error is close to the
 *   noise of the photographs (then more splats would only learn noise), and until SPLITS_VAIN
 *   rounds have not lowered it;
 * - SH bands: one band at a time is trained for 15 % of the steps and kept if it lowers the
 *   held-out error;
 * - steps: when PATIENCE rounds have not lowered the held-out error, the schedule is cut short;
 * - the result: the scene with the lowest held-out error at full size. The start does not take
 *   part: it was made from the squares, too. */
#include "core/refine/refine.h"

#include "core/base/gaussians.h"
#include "core/base/splitmix.h"
#include "core/photo/noise.h"
#include "core/refine/confidence.h"
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
static const float START_LOGIT = 0.0f;  // most of the first step
static const float START_WIDER = 0.18f; // of ln deviation, the same
static const float STALL_DB = 0.01f;    // a round that gains less does not count as progress

static int round_of(int places)
{
    return places > ROUND_MIN ? places : ROUND_MIN;
}

/* Rounds after which splats may be split. */
static int count_splits(int steps, int places, int levels)
{
    const int round = round_of(places), end = (int)(SPLIT_END * (float)steps);
    int n = 0;
    for (int step = round; step <= end; step += round)
        n += pace_level(step - 1, steps, levels) < levels - 1 || levels == 1;
    return n;
}

int refine_begin(const struct refine_config *cfg, int places)
{
    float most = (float)cfg->gaussians_max, n = most;
    for (int k = count_splits(cfg->steps, places, cfg->levels); k > 0 && n > most / 2; k--)
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
        e = arena_alloc(a, q * q * (size_t)(f->held_px / TILE), sizeof *f->bands, &f->bands);
    if (!e)
        e = arena_zalloc(a, all * q * q, sizeof *f->sums, &f->sums);
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
    if (count_splits(cfg->steps, v->n, f.levels) > 0)
        arena_step(&a, confidence_need(cfg->gaussians_max));
    return a.peak;
}

static void choose_held(struct refine *f)
{
    uint64_t s = f->cfg->seed ^ 0x68656c64;
    for (int i = 0; i < f->v->n * f->squares * f->squares; i++)
        f->held[i] = splitmix_next(&s) % HELD_ONE_IN == 0;
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
    err_t e = refine_step_measure(f, &last);
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
    err_t e = refine_step_measure(f, &with);
    f->s->g.degree = degree - 1;
    if (!e)
        e = refine_step_measure(f, &without);
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
        trial >= f->v->n && refine_step_progress(f) >= 0.5f && f->s->g.degree < f->cfg->degree_max)
        add_band(f);
    return OK;
}

/* What one photograph shows alone would be split to fit that one only. */
static err_t spare_guesses(struct refine *f)
{
    float *confidence = f->d.tmp;
    err_t e = confidence_measure(f->r, f->v, f->s, confidence);
    for (int i = 0; i < f->s->g.n && !e; i++)
        f->d.score[i] = confidence[i] < CONFIDENCE_GUESS ? 0 : f->d.score[i];
    return e;
}

static err_t split_splats(struct refine *f)
{
    struct gaussians *g = &f->s->g;
    if (f->splits_done || !is_settled(f))
        return OK;
    float db = refine_step_held_db(f);
    /* one per pixel: more did not help denser starts */
    int most = (int)extent_cover(f->v->extent, f->v->n).at;
    most = most < f->cfg->gaussians_max ? most : f->cfg->gaussians_max;
    const float noise_db = f->noise_db + LEVEL_NOISE_DB * (float)f->level;
    bool noise = db > noise_db - SPLIT_NOISE_DB, all = g->n >= most;
    if (db > f->split_db) {
        f->split_db = db;
        f->splits_vain = 0;
    } else
        f->splits_vain++;
    const bool vain = f->splits_vain >= SPLITS_VAIN;
    f->splits_done = refine_step_progress(f) > SPLIT_END || noise || all || vain;
    if (f->splits_done) {
        add_note(f, "%d Gaussians: %s (held-out %.1f dB, noise of the photographs %.1f dB)", g->n,
                 all     ? "as many as pixels or as allowed"
                 : noise ? "more would learn noise"
                 : vain  ? "more made held-out squares no better"
                         : "the steps that are left train these",
                 (double)db, (double)noise_db);
        return OK;
    }
    density_prune(&f->d, 0.01f);
    err_t e = spare_guesses(f);
    if (e)
        return e;
    int room = most - g->n, want = (int)(SPLIT_SHARE * (float)g->n);
    density_split(&f->d, want < room ? want : room);
    density_sort(&f->d);
    return OK;
}

static err_t measure_best(struct refine *f)
{
    struct best *b = &f->best;
    struct scene *now = f->s, then = *now;
    then.g = b->g;
    then.tone = b->tone;
    then.cams = b->cams;
    f->s = &then;
    err_t e = b->step > 0 ? refine_step_measure(f, &b->db) : OK;
    f->s = now;
    return e;
}

/* Errors are not comparable with those from before something else was left out. */
static err_t judge_outliers(struct refine *f)
{
    bool changed;
    float db;
    err_t e = outliers_judge(f->r, &f->outliers, &f->raster, f->s, &changed);
    if (e || !changed)
        return e;
    e = measure_best(f);
    if (!e)
        e = refine_step_measure(f, &db);
    if (e)
        return e;
    f->split_db = db;
    f->best_db = f->level == 0 ? db : f->best_db;
    return OK;
}

/* Before the scene changes: is it the best? Costs a picture of each view, so seldom with many. */
static err_t compare_best(struct refine *f)
{
    float db;
    if (f->level > 0 || f->band_from > 0 || f->step - f->measured < MEASURE_STEPS * f->v->n)
        return OK;
    f->measured = f->step;
    err_t e = refine_step_measure(f, &db);
    if (!e && (f->best.step == 0 || db > f->best.db))
        keep_best(f, db);
    return e;
}

/* ---- time ---- */

static bool has_limit(const struct refine *f)
{
    return f->cfg->seconds > 0 && f->r->clock;
}

/* Seconds of a step at a level, by two that change nothing. */
static err_t time_level(struct refine *f, int level)
{
    const double start = f->r->clock();
    f->level = level;
    for (int k = 0; k < 2; k++) {
        err_t e = refine_step_rehearse(f, k * f->v->n / 2);
        if (e)
            return e;
    }
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
    float db = refine_step_held_db(f);
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
    if (!e)
        e = split_splats(f);
    if (e)
        return e;
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

/* What hides others learns alone, and what its neighbours do not reach tears: splats start half
 * open and wide. */
static void soften(struct gaussians *g)
{
    for (int i = 0; i < g->n; i++) {
        g->plane[G_LOGIT][i] = fminf(g->plane[G_LOGIT][i], START_LOGIT);
        for (int k = 0; k < 3; k++)
            g->plane[G_LOG_SCALE + k][i] += START_WIDER;
    }
}

/* What is known before the first step. */
static err_t begin_steps(struct refine *f)
{
    err_t e = noise_run(f->r, f->v, &f->noise_db);
    if (!e)
        e = limit_steps(f);
    if (!e)
        e = refine_step_measure(f, &f->rep->held_out_db[0]);
    if (!e && f->steps > 0)
        soften(&f->s->g);
    return e;
}

/* Errors of pictures of another size are not comparable, and parts come round slowly. */
static err_t enter_level(struct refine *f, int level)
{
    if (level == f->level)
        return OK;
    f->level = level;
    f->splits_vain = -1; // there is none yet
    return refine_step_measure(f, &f->split_db);
}

static err_t take_step(struct refine *f)
{
    const int round = round_of(f->v->n);
    err_t e = enter_level(f, pace_level(f->step, f->steps, f->levels));
    if (!e)
        e = refine_step_learn(f);
    f->expected += f->pace.seconds[f->level];
    f->rep->steps = ++f->step;
    if (!e && f->step % round == 0)
        e = end_round(f, round);
    if (!e)
        e = update_bands(f);
    if (!e && outliers_due(f->step, f->steps))
        e = judge_outliers(f);
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
