/* hdrig bench: figures of this machine against its limits.
 * splat: a slab of pixel-sized splats is drawn (forward), differentiated (backward) and optimised
 *        (step: forward, loss, backward and Adam for every parameter): the largest scene with every
 *        instruction set, on one thread and on all; then every number of splats at every size of
 *        the picture with the best. Splats keep their size in pixels, so that one axis of that
 *        table shows the cost of a splat and the other that of a pixel.
 *        Where a launcher started several ranks, each draws the largest scene with the best at
 *        the same time, and the first prints how fast each is: a slow one holds all up.
 * network, kernels: see bench_net.h. trade: see tradeoff.h. capture: see bench_capture.h. */
#include "core/base/splitmix.h"
#include "firmware/base/engine.h"
#include "firmware/capture/bracket.h"
#include "firmware/cmd/bench_capture.h"
#include "firmware/cmd/bench_net.h"
#include "firmware/cmd/cmd.h"
#include "firmware/cmd/tradeoff.h"
#include "firmware/recon/limits.h"
#include "firmware/result/report.h"

#include "core/base/cpu.h"
#include "core/base/gaussians.h"
#include "core/refine/loss.h"
#include "core/splat/raster.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { REPEATS = 5, LEVELS_MAX = 10, TABLE_MAX = CMD_LIST_MAX * CMD_LIST_MAX };

/* Operations of the blending loops per pixel and splat, counted in core/splat/README.md 3: distance
 * and exponent 7, exp 12, alpha 2, weights and four channels 11; backward the same again, and the
 * chain rule 32. */
enum { FORWARD_OPS = 32, BACKWARD_OPS = 64 };

#define BENCH_MAX_S 2.0 // for the repeats of one measurement

struct request {
    const char *what, *json, *gaussians_text, *degree_text, *size_text, *model, *views_text;
    const char *images, *cameras_text;
    bool splat, network, kernels, trade, capture;
    bool together; // on several ranks
    int cameras;
    struct cmd_list gaussians, sizes, views;
    int degree;
    struct config cfg;
};

struct figure {
    const char *kernels;
    int threads, gaussians, pixels;
    double forward_s, backward_s, step_s;
    double pairs;              // splats that each pixel looks at, summed
    struct limits_share share; // flop/s, in forward and backward together
};

struct rank_figure {
    double bandwidth; // bytes/s
    struct figure splat;
};

struct state {
    struct teamwork team;
    struct rank_figure ranks[TEAM_MAX];
    struct engine engine;
    struct gaussians g;
    struct camera cam;
    struct raster raster;
    struct loss loss;
    struct render pic;
    struct tonemap tone;
    uint8_t *photo;
    float *m1, *m2;      // (planes, cap) Adam's moments
    double bandwidth[2]; // bytes/s of one thread, of all
    int n_levels, n_table;
    struct figure levels[LEVELS_MAX], table[TABLE_MAX];
    struct bench_net net;
    struct bench_capture capture;
    struct tradeoff trade;
};

/* ---- the scene ---- */

static float draw_uniform(uint64_t *s)
{
    return (float)(splitmix_next(s) >> 40) * 0x1p-24f;
}

/* A slab between depths 3 and 5 that fills the picture; standard deviations 0.4 to 1 px, opacity
 * 0.8. */
static void make_scene(struct state *st, int n, int size)
{
    uint64_t rng = 1;
    struct gaussians *g = &st->g;
    float focal = 0.85f * (float)size, half = 0.5f * (float)size;
    st->cam = (struct camera){size, size, focal, focal, half, half, {1, 0, 0, 0}, {0, 0, 0}};
    g->n = n;
    for (int i = 0; i < n; i++) {
        float z = 3 + 2 * draw_uniform(&rng);
        g->plane[G_MU][i] = (draw_uniform(&rng) - 0.5f) * z / 0.85f;
        g->plane[G_MU + 1][i] = (draw_uniform(&rng) - 0.5f) * z / 0.85f;
        g->plane[G_MU + 2][i] = z;
        for (int k = 0; k < 3; k++)
            g->plane[G_LOG_SCALE + k][i] = logf((0.4f + 0.6f * draw_uniform(&rng)) * z / focal);
        for (int k = 0; k < 4; k++)
            g->plane[G_QUAT + k][i] = draw_uniform(&rng) - 0.5f + (k == 0);
        g->plane[G_LOGIT][i] = logf(0.8f / 0.2f);
        for (int p = G_SH; p < gaussians_planes(g->degree); p++)
            g->plane[p][i] = (draw_uniform(&rng) - 0.5f) * (p < G_SH + 3 ? 4.0f : 0.2f);
    }
    for (int i = 0; i < 3 * size * size; i++)
        st->photo[i] = (uint8_t)(255 * draw_uniform(&rng));
}

/* ---- what is timed ---- */

static err_t run_forward(struct state *st)
{
    struct raster_input in = {&st->g, &st->cam, {0, 0, 0}};
    return raster_run(&st->engine.run, &st->raster, &in, &st->pic);
}

static void ignore_gradient(void *ctx, int first, int count, const float *grad, const float *seen)
{
    (void)ctx;
    (void)first;
    (void)count;
    (void)grad;
    (void)seen;
}

static err_t backward_into(struct state *st, raster_sink_fn *fn)
{
    struct raster_input in = {&st->g, &st->cam, {0, 0, 0}};
    struct render_grad up = {.radiance = st->loss.d_radiance, .alpha = st->loss.d_alpha};
    struct raster_sink sink = {.fn = fn, .ctx = st};
    return raster_grad_run(&st->engine.run, &st->raster, &in, &up, &sink);
}

static err_t run_backward(struct state *st)
{
    return backward_into(st, ignore_gradient);
}

static err_t run_loss(struct state *st)
{
    struct loss_output out;
    struct loss_input in = {
        .pic = &st->pic, .tone = &st->tone, .photo = st->photo, .w_l1 = 0.8f, .w_ssim = 0.2f};
    return loss_run(&st->engine.run, &st->loss, &in, &out);
}

/* Rates of zero: the same arithmetic, and the scene stays what it is. */
static void adam_block(void *ctx, int first, int count, const float *grad, const float *seen)
{
    struct state *st = ctx;
    const struct adam_step step = {0.0f, 0.9f, 0.999f, 1e-15f, 1.0f, 1.0f};
    for (int p = 0; p < gaussians_planes(st->g.degree); p++) {
        size_t at = (size_t)p * (size_t)st->g.cap + (size_t)first;
        st->engine.kernels.adam(&step, count, seen, grad + (size_t)p * SPLAT_BLOCK,
                                st->g.plane[p] + first, st->m1 + at, st->m2 + at);
    }
}

static err_t run_step(struct state *st)
{
    err_t e = run_forward(st);
    if (!e)
        e = run_loss(st);
    return e ? e : backward_into(st, adam_block);
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* A limit and runs that take turns: its rate, their processor time per thread, s. */
struct turns {
    const struct limits_loop *limit;
    int n;
    double rate[REPEATS], busy[REPEATS];
};

/* Median of a few runs after one to warm up. */
static err_t measure_median(struct state *st, err_t (*fn)(struct state *), struct turns *turns,
                            double *median)
{
    struct pool *pool = st->engine.run.pool;
    double t[REPEATS], total = 0;
    int n = 0;
    err_t e = fn(st);
    while (!e && n < REPEATS && (n < 1 || total < BENCH_MAX_S)) {
        turns->rate[n] = limits_now(pool, turns->limit);
        double start = engine_seconds(), busy = engine_busy_seconds();
        e = fn(st);
        t[n] = engine_seconds() - start;
        turns->busy[n] = (engine_busy_seconds() - busy) / pool_size(pool);
        total += t[n++];
    }
    turns->n = n;
    if (e)
        return e;
    qsort(t, (size_t)n, sizeof t[0], compare_doubles);
    *median = t[n / 2];
    return atomic_load(&engine_cancel) ? ERR_CANCELLED : OK;
}

/* Pixels of a tile that a splat can reach before they are full. */
static double pairs_of_tile(const struct tile *t)
{
    double pairs = 0;
    for (int i = 0; i < t->n; i++) {
        const struct splat2d *s = &t->splats[t->list[i]];
        int x0 = s->x0 > t->x0 ? s->x0 : t->x0,
            x1 = s->x1 < t->x0 + TILE ? s->x1 : t->x0 + TILE - 1;
        int y0 = s->y0 > t->y0 ? s->y0 : t->y0,
            y1 = s->y1 < t->y0 + TILE ? s->y1 : t->y0 + TILE - 1;
        for (int y = y0; y <= y1; y++)
            for (int x = x0; x <= x1; x++)
                pairs += i < t->stop[y * t->w + x];
    }
    return pairs;
}

static err_t count_pairs(struct state *st, double *pairs)
{
    struct raster *rs = &st->raster;
    const struct raster_input in = {&st->g, &st->cam, {0, 0, 0}};
    *pairs = 0;
    for (int i = 0; i < rs->n_groups; i++) {
        const struct raster_group *group = &rs->groups[i];
        err_t e = raster_load_group(&st->engine.run, rs, i);
        if (e)
            return e;
        for (int k = 0; k < (group->x1 - group->x0) * (group->y1 - group->y0); k++) {
            struct tile t = raster_tile(rs, &in, k);
            *pairs += pairs_of_tile(&t);
        }
    }
    return OK;
}

static err_t measure_all(struct state *st, unsigned cpu, struct figure *f)
{
    kernels_init(&st->engine.kernels, cpu);
    f->kernels = st->engine.kernels.name;
    f->threads = pool_size(st->engine.run.pool);
    f->gaussians = st->g.n;
    f->pixels = st->cam.w * st->cam.h;
    const struct limits_loop limit = limits_flops(cpu);
    struct turns forwards = {&limit, .n = 0}, backwards = forwards, steps = forwards;
    struct limits_turns shares = {.n = 0};
    err_t e = measure_median(st, run_forward, &forwards, &f->forward_s);
    if (!e)
        e = count_pairs(st, &f->pairs);
    if (!e)
        e = run_loss(st);
    if (!e)
        e = measure_median(st, run_backward, &backwards, &f->backward_s);
    if (!e)
        e = measure_median(st, run_step, &steps, &f->step_s);
    for (int i = 0; !e && i < forwards.n && i < backwards.n; i++)
        limits_add(&shares, (forwards.rate[i] + backwards.rate[i]) / 2,
                   f->pairs * (FORWARD_OPS + BACKWARD_OPS) /
                       (forwards.busy[i] + backwards.busy[i]));
    f->share = limits_sum_up(&shares);
    return e;
}

/* ---- which ---- */

/* Every level of the mask with all below it, highest first; each on all threads, then on one. */
static err_t measure_levels(struct state *st, struct pool *one)
{
    static const unsigned levels[] = {CPU_AVX512, CPU_AVX2, CPU_SSE41, CPU_NEON, 0};
    unsigned cpu = st->engine.cpu;
    struct pool *all = st->engine.pool;
    err_t e = OK;
    for (size_t i = 0; i < sizeof levels / sizeof levels[0] && !e; i++) {
        if (levels[i] && !(cpu & levels[i]))
            continue;
        for (int single = 0; single < 2 && !e; single++) {
            st->engine.run.pool = single ? one : all;
            e = measure_all(st, levels[i] ? cpu : 0, &st->levels[st->n_levels++]);
        }
        cpu &= ~levels[i];
    }
    st->engine.run.pool = all;
    return e;
}

static err_t measure_table(const struct request *rq, struct state *st)
{
    err_t e = OK;
    for (int k = 0; k < rq->sizes.n; k++)
        for (int i = 0; i < rq->gaussians.n && !e; i++) {
            make_scene(st, rq->gaussians.v[i], rq->sizes.v[k]);
            e = measure_all(st, st->engine.cpu, &st->table[st->n_table++]);
        }
    return e;
}

static int largest_of(const struct cmd_list *l)
{
    int most = l->v[0];
    for (int i = 1; i < l->n; i++)
        most = l->v[i] > most ? l->v[i] : most;
    return most;
}

static err_t layout_scene(struct state *st, float **px, struct arena *a, const struct request *rq,
                          int workers)
{
    const int size = largest_of(&rq->sizes);
    const size_t pixels = (size_t)size * (size_t)size;
    err_t e = gaussians_init(&st->g, a, largest_of(&rq->gaussians), rq->degree);
    const size_t moments = (size_t)gaussians_planes(rq->degree) * (size_t)st->g.cap;
    if (!e)
        e = raster_init(&st->raster, a, st->g.cap, size, size, true);
    if (!e)
        e = loss_init(&st->loss, a, size, size, workers);
    if (!e)
        e = arena_alloc(a, pixels, 5 * sizeof **px + 3, px);
    if (!e)
        e = arena_zalloc(a, moments, 2 * sizeof *st->m1, &st->m1);
    if (!e)
        st->m2 = st->m1 + moments;
    return e;
}

static err_t layout_triad(struct arena *keep, float **work)
{
    return arena_alloc(keep, LIMITS_TRIAD_FLOATS, sizeof **work, work);
}

static err_t reserve_memory(const struct request *rq, struct state *st)
{
    const int size = largest_of(&rq->sizes), workers = pool_size(st->engine.pool);
    const size_t pixels = (size_t)size * (size_t)size;
    struct arena keep = arena_counter(), tmp = arena_counter();
    float *px = NULL;
    err_t e = layout_scene(st, &px, &tmp, rq, workers);
    if (!e)
        e = layout_triad(&keep, &px);
    if (!e)
        e = engine_reserve(&st->engine, 0, keep.peak, tmp.peak, config_memory_mb(&rq->cfg));
    if (!e)
        e = layout_scene(st, &px, &st->engine.tmp, rq, workers);
    if (e)
        return e;
    st->pic = (struct render){.radiance = px, .depth = px + 3 * pixels, .alpha = px + 4 * pixels};
    st->photo = (uint8_t *)(px + 5 * pixels);
    tonemap_linear(&st->tone, 1.0f, -10.0f, 10.0f, 0.0f);
    return OK;
}

/* Memory for all, and the largest scene in it. work: for limits_bandwidth. */
static err_t make_largest(const struct request *rq, struct state *st, float **work)
{
    err_t e = reserve_memory(rq, st);
    if (!e)
        e = layout_triad(&st->engine.keep, work);
    if (!e)
        make_scene(st, largest_of(&rq->gaussians), largest_of(&rq->sizes));
    return e;
}

static err_t bench_splat(const struct request *rq, struct state *st)
{
    struct pool *one = NULL;
    float *work;
    err_t e = engine_open(&st->engine, rq->cfg.threads);
    if (!e)
        e = make_largest(rq, st, &work);
    if (!e)
        e = pool_open(&one, 1);
    if (!e) {
        st->bandwidth[0] = limits_bandwidth(one, work);
        st->bandwidth[1] = limits_bandwidth(st->engine.pool, work);
        e = measure_levels(st, one);
    }
    if (!e)
        e = measure_table(rq, st);
    pool_close(one);
    return e;
}

/* This rank's figures, then those of all. */
static err_t bench_ranks(const struct request *rq, struct state *st)
{
    struct team *team = st->engine.run.team;
    struct rank_figure *own = &st->ranks[team_rank(team)];
    float *work;
    st->engine.run.team = NULL; // each draws alone
    err_t e = make_largest(rq, st, &work);
    if (!e)
        e = team_collect(team, st->ranks, sizeof *st->ranks); // all begin now
    if (!e) {
        own->bandwidth = limits_bandwidth(st->engine.pool, work);
        e = measure_all(st, st->engine.cpu, &own->splat);
    }
    if (!e)
        e = team_collect(team, st->ranks, sizeof *st->ranks);
    for (int i = 0; i < team_size(team); i++)
        st->ranks[i].splat.kernels = st->engine.kernels.name; // a pointer does not travel
    return e;
}

static err_t run_tradeoff(const struct request *rq, struct state *st)
{
    const struct tradeoff_request trade = {.models = rq->model,
                                           .images = rq->images,
                                           .n_views = rq->views.n,
                                           .n_sizes = rq->sizes.n,
                                           .views = rq->views.v,
                                           .sizes = rq->sizes.v,
                                           .print = !rq->json || strcmp(rq->json, "-") != 0};
    return tradeoff_run(&trade, &rq->cfg, &st->trade);
}

static err_t run_bench(const struct request *rq, struct state *st)
{
    const int size = rq->size_text ? rq->sizes.v[0] : 0;
    err_t e = OK;
    if (rq->together)
        return bench_ranks(rq, st);
    if (rq->network) // first: it may be refused
        e = bench_net_run(rq->model, rq->views.v[0], size, &rq->cfg, &st->net);
    if (!e && rq->splat)
        e = bench_splat(rq, st);
    engine_close(&st->engine);
    if (!e && rq->kernels)
        e = bench_net_kernels(&rq->cfg, &st->net);
    if (!e && rq->capture)
        e = bench_capture_run(rq->cameras, &rq->cfg, &st->capture);
    if (!e && rq->trade)
        e = run_tradeoff(rq, st);
    return e;
}

/* ---- results ---- */

static void report_figure(struct report *rep, const struct figure *f)
{
    report_int(rep, "gaussians", f->gaussians);
    report_int(rep, "pixels", f->pixels);
    report_text(rep, "kernels", f->kernels);
    report_int(rep, "threads", f->threads);
    report_number(rep, "seconds_forward", f->forward_s);
    report_number(rep, "seconds_backward", f->backward_s);
    report_number(rep, "seconds_step", f->step_s);
    report_number(rep, "pixel_splat_pairs", f->pairs);
    report_number(rep, "limit_gflop_per_s", f->share.limit * 1e-9);
    report_number(rep, "share_of_limit", f->share.share);
    report_number(rep, "share_low", f->share.low);
    report_number(rep, "share_high", f->share.high);
}

static void report_figures(struct report *rep, const char *key, const struct figure *f, int n)
{
    report_open(rep, key, '[');
    for (int i = 0; i < n; i++) {
        report_open(rep, NULL, '{');
        report_figure(rep, &f[i]);
        report_close(rep);
    }
    report_close(rep);
}

static void report_ranks(struct report *rep, const struct state *st)
{
    const struct ranks *r = &st->team.ranks;
    report_open(rep, "ranks", '[');
    for (int i = 0; i < r->team.size; i++) {
        report_open(rep, NULL, '{');
        report_text(rep, "host", r->host[i]);
        report_int(rep, "share_of_work", r->team.share[i]);
        report_number(rep, "bandwidth_gb_per_s", st->ranks[i].bandwidth * 1e-9);
        report_figure(rep, &st->ranks[i].splat);
        report_close(rep);
    }
    report_close(rep);
}

static void write_report(const struct request *rq, const struct state *st, FILE *f)
{
    struct report rep;
    report_begin(&rep, f);
    if (rq->together) {
        report_int(&rep, "sh_degree", rq->degree);
        report_ranks(&rep, st);
    } else if (rq->splat) {
        report_int(&rep, "sh_degree", rq->degree);
        report_number(&rep, "bandwidth_gb_per_s_one_thread", st->bandwidth[0] * 1e-9);
        report_number(&rep, "bandwidth_gb_per_s", st->bandwidth[1] * 1e-9);
        report_figure(&rep, &st->levels[0]); // the best level on all threads
        report_figures(&rep, "levels", st->levels, st->n_levels);
        report_figures(&rep, "table", st->table, st->n_table);
    }
    if (rq->network || rq->kernels) {
        report_open(&rep, "network", '{');
        bench_net_report(&st->net, &rep);
        report_close(&rep);
    }
    if (rq->capture) {
        report_open(&rep, "capture", '{');
        bench_capture_report(&st->capture, &rep);
        report_close(&rep);
    }
    if (rq->trade)
        tradeoff_report(&st->trade, &rep);
    report_close(&rep);
}

static void print_figures(const struct figure *f, int n)
{
    printf("\n%8s %8s %-8s %7s %9s %10s %9s %8s %6s  %s\n", "splats", "pixels", "kernels",
           "threads", "forward s", "backward s", "step s", "GFlop/s", "share", "quartiles");
    for (int i = 0; i < n; i++)
        printf("%8d %8d %-8s %7d %9.4f %10.4f %9.4f %8.1f %6.3f  %.3f-%.3f\n", f[i].gaussians,
               f[i].pixels, f[i].kernels, f[i].threads, f[i].forward_s, f[i].backward_s,
               f[i].step_s, f[i].share.limit * 1e-9, f[i].share.share, f[i].share.low,
               f[i].share.high);
}

static void print_tables(const struct state *st)
{
    printf(
        "memory %.1f GB/s, one thread %.1f GB/s\nGFlop/s: measured limit of the instruction set; "
        "share: of it in forward and backward, in processor time; median and quartiles of turns\n",
        st->bandwidth[1] * 1e-9, st->bandwidth[0] * 1e-9);
    print_figures(st->levels, st->n_levels);
    print_figures(st->table, st->n_table);
}

/* Who is slow, and whether what it is dealt (teamwork.h) fits. */
static void print_ranks(const struct state *st)
{
    const struct ranks *r = &st->team.ranks;
    int least = 0, most = 0, all = 0;
    for (int i = 0; i < r->team.size; i++) {
        all += r->team.share[i];
        least = st->ranks[i].splat.step_s < st->ranks[least].splat.step_s ? i : least;
        most = st->ranks[i].splat.step_s > st->ranks[most].splat.step_s ? i : most;
    }
    const double fastest = st->ranks[least].splat.step_s;
    printf("%4s %-20s %7s %8s %8s %11s %8s %9s %6s %8s\n", "rank", "host", "threads", "splats",
           "pixels", "memory GB/s", "GFlop/s", "step s", "speed", "its part");
    for (int i = 0; i < r->team.size; i++) {
        const struct figure *f = &st->ranks[i].splat;
        printf("%4d %-20s %7d %8d %8d %11.1f %8.1f %9.4f %6.2f %6.1f %%\n", i, r->host[i],
               f->threads, f->gaussians, f->pixels, st->ranks[i].bandwidth * 1e-9,
               f->share.limit * 1e-9, f->step_s, fastest / f->step_s,
               100.0 * r->team.share[i] / all);
    }
    printf("a step takes %.4f s on rank %d (%s) to %.4f s on rank %d (%s)\n", fastest, least,
           r->host[least], st->ranks[most].splat.step_s, most, r->host[most]);
}

static err_t write_results(const struct request *rq, const struct state *st, struct cmd_json *json)
{
    if (json->f)
        write_report(rq, st, json->f);
    if (json->f != stdout && rq->together)
        print_ranks(st);
    else if (json->f != stdout && rq->splat)
        print_tables(st);
    if (json->f != stdout)
        bench_net_print(&st->net);
    if (json->f != stdout && rq->capture)
        bench_capture_print(&st->capture);
    return cmd_json_close(json);
}

static err_t read_what(struct request *rq)
{
    rq->together = ranks_launched() > 1;
    const bool all = strcmp(rq->what, "all") == 0, rest = all && !rq->together;
    rq->splat = all || strcmp(rq->what, "splat") == 0;
    rq->kernels = rest || strcmp(rq->what, "kernels") == 0;
    rq->network = (rest && rq->model) || strcmp(rq->what, "network") == 0;
    rq->trade = strcmp(rq->what, "trade") == 0;
    rq->capture = rest || strcmp(rq->what, "capture") == 0;
    if (!rq->splat && !rq->kernels && !rq->network && !rq->trade && !rq->capture)
        return err_fail(ERR_ARG,
                        "--what: \"%.64s\" is none of splat, network, kernels, capture, trade, all",
                        rq->what);
    if ((rq->network || rq->trade) && !rq->model)
        return err_fail(ERR_ARG, "--what %s needs --model FILE", rq->what);
    if (rq->images && !rq->trade)
        return err_fail(ERR_ARG, "--images is for --what trade");
    if (rq->together && (!rq->splat || rq->model))
        return err_fail(ERR_ARG, "several ranks measure splats only: start %s%s without a launcher",
                        rq->model ? "--model" : "--what ", rq->model ? "" : rq->what);
    return OK;
}

static err_t read_numbers(struct request *rq)
{
    rq->cameras = BRACKET_CAMERAS_MAX;
    rq->degree = 1;
    const char *sizes = rq->size_text ? rq->size_text : "224,448";
    err_t e = read_what(rq);
    if (!e)
        e = cmd_list("--gaussians", rq->gaussians_text, 1, 4000000, &rq->gaussians);
    if (!e)
        e = cmd_list("--size", sizes, LOSS_WINDOW, RASTER_SIDE_MAX, &rq->sizes);
    if (!e && rq->degree_text)
        e = cmd_whole("--degree", rq->degree_text, 0, SH_DEGREE_MAX, &rq->degree);
    if (!e && rq->cameras_text)
        e = cmd_whole("--cameras", rq->cameras_text, 1, BRACKET_CAMERAS_MAX, &rq->cameras);
    if (!e)
        e = cmd_list("--views", rq->views_text, 2, 1000, &rq->views);
    return e;
}

int cmd_bench_run(int argc, char **argv)
{
    static struct state st;
    struct cmd_json json = {0};
    struct request rq = {
        .what = "all", .gaussians_text = "25000,50000,100000,200000", .views_text = "4"};
    const struct cmd_option options[] = {
        {"what", "WHICH", "splat: drawing and optimising; network; kernels; capture; all; trade",
         NULL, &rq.what, NULL},
        {"cameras", "N", "of --what capture, default 16", NULL, &rq.cameras_text, NULL},
        {"model", "FILE", "weights of the network; trade: LIST, the first is the reference", NULL,
         &rq.model, NULL},
        {"views", "N", "that the network sees, default 4; trade: LIST", NULL, &rq.views_text, NULL},
        {"images", "DIR", "trade: photographs that the network sees, else noise", NULL, &rq.images,
         NULL},
        {"json", "FILE", "figures as JSON, - for stdout", NULL, &rq.json, NULL},
        {"gaussians", "LIST", "splats, default 25000,50000,100000,200000", NULL, &rq.gaussians_text,
         NULL},
        {"size", "LIST", "edges of the picture, px, default 224,448; network: that of the model",
         NULL, &rq.size_text, NULL},
        {"degree", "D", "of the harmonics, default 1", NULL, &rq.degree_text, NULL},
        CMD_THREADS,
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {
        "bench", "",
        "Figures of this machine against its limits; trade: of weights files against the first.\n"
        "Under mpirun: how fast the machine of each rank draws, and what part of a job it gets.",
        options, sizeof options / sizeof options[0]};
    int code;
    if (!cmd_parse(&usage, argc, argv, &rq.cfg, &code))
        return code;
    if (read_numbers(&rq) != OK)
        return cmd_misuse(&usage, err_text());
    err_t e = OK;
    if (rq.together)
        e = teamwork_open(&st.team, usage.name, rq.cfg.threads, &st.engine);
    const bool speaks = teamwork_speaks(&st.team);
    if (!e)
        e = cmd_json_open(speaks ? rq.json : NULL, &json);
    if (!e)
        e = run_bench(&rq, &st);
    if (!e && speaks)
        e = write_results(&rq, &st, &json);
    cmd_json_discard(&json);
    code = speaks ? cmd_finish(usage.name, e) : CMD_OK;
    teamwork_close(&st.team, e, speaks ? code : CMD_FAILURE);
    engine_close(&st.engine);
    return code;
}
