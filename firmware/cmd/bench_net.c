/* Kinds of work follow from the calls of kernels: in the second pass every kernel of
 * the table is replaced by one that notes the time around it. A product whose run of inputs is at
 * most 128 long belongs to attention (in floats also to the Fourier convolutions), one of several
 * runs to a convolution. */
#include "firmware/cmd/bench_net.h"

#include "drivers/device/clocks.h"
#include "firmware/base/engine.h"
#include "firmware/recon/network.h"

#include "core/base/cpu.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SHORT_RUN = 128 };

/* ---- arithmetic of a forward pass: core/net/README.md 3.4 ---- */

static double squared(double x)
{
    return x * x;
}

/* One DPT trunk on one view. */
static double trunk_macs(const struct net_dims *d, int feat, const int oc[NET_KEEP], int grid)
{
    const double m = squared(grid), small = squared((grid + 1) / 2), f2 = squared(feat);
    const double at[NET_KEEP] = {16 * m, 4 * m, m, small}; // pixels of the levels
    double sum = m * 2 * d->embed * (oc[0] + oc[1] + oc[2] + oc[3]);
    sum += 16 * m * squared(oc[0]) + 4 * m * squared(oc[1]) + 9 * small * squared(oc[3]);
    for (int k = 0; k < NET_KEEP; k++) {
        int units = k == NET_KEEP - 1 ? 1 : 2;
        double after = k == 0 ? 4 * at[0] : at[k - 1];
        sum += 9 * at[k] * oc[k] * feat + units * 18 * at[k] * f2 + after * f2;
    }
    return sum + 4 * at[0] * 9 * feat * (feat / 2.0);
}

struct work {
    double backbone, camera, depth, appearance;
};

static struct work work_of(const struct net_dims *d, int n_views, int size)
{
    const int grid = size / NET_PATCH;
    const double v = n_views, c = d->embed, m = squared(grid), p = m + NET_SPECIAL, w = 2 * c;
    const double px = squared(size), hdr = d->hdr;
    struct work k = {0};
    k.backbone = v * m * 588 * c + v * (d->dino_depth + 2 * d->depth) * 12 * c * c * p +
                 v * (d->dino_depth + d->depth) * 2 * p * p * c + d->depth * 2 * squared(v * p) * c;
    k.camera = 4 * v * (9 * w + 3 * w * w + d->cam_depth * 12 * w * w + w * w / 2 + 9 * w / 2);
    k.depth = v * trunk_macs(d, d->depth_feat, d->depth_oc, grid) +
              v * px * (9 * 32 * d->depth_feat / 2.0 + 64);
    if (!d->gauss)
        return k;
    k.appearance = v * trunk_macs(d, d->gs_feat, d->gs_oc, grid) +
                   v * px * (9 * squared(d->gs_feat / 2.0) + NET_RAW * d->gs_feat / 2.0);
    if (!d->appearance)
        return k;
    k.appearance += v * hdr * 588 * m + v * m * v * p * c + 2 * squared(v * m) * hdr +
                    v * m * 6 * hdr * hdr + v * px * 147 * hdr +
                    v * m * (9 * hdr * hdr + 9 * 32 * hdr + 128) + 2 * v * px * 49 * hdr * hdr;
    k.appearance += v * m * 196 * (2 * hdr + NET_RAW + NET_SENSITIVITY) * hdr +
                    v * squared((grid + 1) / 2) * 9 * hdr * hdr;
    return k;
}

/* ---- kernels that note their time ---- */

enum kind {
    S8_LINEAR,
    S8_CONV,
    S8_ATTENTION,
    F32_LINEAR,
    F32_CONV,
    F32_ATTENTION,
    QUANTISE,
    UNPACK,
    NORM,
    EPILOGUE,
    TURN,
    SOFTMAX,
    FOURIER,
    KINDS
};

static const char *const kind_names[KINDS] = {
    "s8 linear",        "s8 convolution",         "s8 attention",
    "f32 linear",       "f32 convolution",        "f32 attention and Fourier products",
    "quantise",         "unpack weights",         "norm",
    "epilogue",         "head norm and rotation", "softmax",
    "Fourier transform"};

static struct gemm_kernels inner; // the kernels behind the clocks
static _Atomic int64_t spent_ns[KINDS], macs[KINDS];

static void note_time(enum kind kind, int64_t start, int64_t n)
{
    atomic_fetch_add_explicit(&spent_ns[kind], clocks_now() - start, memory_order_relaxed);
    if (n)
        atomic_fetch_add_explicit(&macs[kind], n, memory_order_relaxed);
}

static void noted_s8(const struct gemm_s8 *g)
{
    int64_t start = clocks_now();
    inner.s8(g);
    note_time(g->segs > 1           ? S8_CONV
              : g->seg <= SHORT_RUN ? S8_ATTENTION
                                    : S8_LINEAR,
              start, (int64_t)g->m * g->panels * PANEL * g->segs * g->seg);
}

static void noted_f32(const struct gemm_f32 *g)
{
    int64_t start = clocks_now();
    inner.f32(g);
    note_time(g->segs > 1           ? F32_CONV
              : g->seg <= SHORT_RUN ? F32_ATTENTION
                                    : F32_LINEAR,
              start, (int64_t)g->m * g->panels * PANEL * g->segs * g->seg);
}

/* A function `noted_NAME` around inner.NAME. */
#define NOTED(name, kind, params, args)                                                            \
    static void noted_##name params                                                                \
    {                                                                                              \
        int64_t start = clocks_now();                                                              \
        inner.name args;                                                                           \
        note_time(kind, start, 0);                                                                 \
    }

NOTED(unpack_s8, UNPACK, (const int8_t *w, int k, float *out), (w, k, out))
NOTED(unpack_bf16, UNPACK, (const uint16_t *w, int k, float *out), (w, k, out))
NOTED(quant, QUANTISE, (const float *x, size_t n, float inv, int8_t *out), (x, n, inv, out))
NOTED(hadamard, QUANTISE, (float *x, int n, int block), (x, n, block))
NOTED(norm, NORM, (const struct norm *s, const float *x, float *y), (s, x, y))
NOTED(epilogue, EPILOGUE, (const struct epilogue *e), (e))
NOTED(head_rotary, TURN, (const struct head_rotary *t, float *x), (t, x))
NOTED(attend_block, SOFTMAX, (const struct attend_block *b), (b))
NOTED(attend_add, SOFTMAX, (const struct attend_add *a), (a))
NOTED(fft_forward, FOURIER, (const struct fft_tile *t), (t))
NOTED(fft_inverse, FOURIER, (const struct fft_tile *t), (t))

static float noted_absmax(const float *x, size_t n)
{
    int64_t start = clocks_now();
    float most = inner.absmax(x, n);
    note_time(QUANTISE, start, 0);
    return most;
}

static void note_all(struct gemm_kernels *k)
{
    inner = *k;
    for (int i = 0; i < KINDS; i++)
        spent_ns[i] = macs[i] = 0;
    k->s8 = noted_s8;
    k->f32 = noted_f32;
    k->unpack_s8 = noted_unpack_s8;
    k->unpack_bf16 = noted_unpack_bf16;
    k->absmax = noted_absmax;
    k->quant = noted_quant;
    k->hadamard = noted_hadamard;
    k->norm = noted_norm;
    k->epilogue = noted_epilogue;
    k->head_rotary = noted_head_rotary;
    k->attend_block = noted_attend_block;
    k->attend_add = noted_attend_add;
    k->fft_forward = noted_fft_forward;
    k->fft_inverse = noted_fft_inverse;
}

/* ---- a forward pass ---- */

struct state {
    struct engine engine;
    struct network network;
    struct views views;
    struct prediction prediction;
    struct limits_loop loop[2];   // for integers, for floats
    struct limits_turns turns[2]; // taken between the steps of a pass
    struct network_clock clock;
};

static size_t count_values(int n, int size)
{
    return 3 * (size_t)n * (size_t)size * (size_t)size;
}

static err_t alloc_views(struct arena *a, int n, int size, struct views *v)
{
    err_t e = arena_alloc(a, count_values(n, size), 1, &v->rgb);
    return e ? e : arena_alloc(a, (size_t)n, sizeof *v->log2t, &v->log2t);
}

void bench_net_views_plan(struct arena *count, int n, int size)
{
    struct views v;
    (void)alloc_views(count, n, size, &v); // a counter is never full
}

err_t bench_net_views(struct arena *a, int n, int size, struct views *v)
{
    const size_t values = count_values(n, size);
    uint64_t rng = 1;
    *v = (struct views){.n = n, .size = size};
    err_t e = alloc_views(a, n, size, v);
    for (size_t i = 0; i < values && !e; i++) {
        rng = rng * 6364136223846793005ull + 1442695040888963407ull;
        v->rgb[i] = (uint8_t)(rng >> 56);
    }
    for (int i = 0; i < n && !e; i++)
        v->log2t[i] = (float)(i % 3 * 2 - 2);
    return e;
}

static err_t reserve_memory(struct state *st, int n, int size, int max_mb)
{
    struct plan plan = plan_begin(pool_size(st->engine.pool));
    bench_net_views_plan(&plan.keep, n, size);
    net_plan(&plan, &st->network.net, n, size);
    err_t e = engine_reserve(&st->engine, st->network.file.model.bytes, plan.keep.peak,
                             plan.tmp.peak, max_mb);
    return e ? e : bench_net_views(&st->engine.keep, n, size, &st->views);
}

/* Between the steps of a pass the limits are measured; that does not count. */
static void take_turn(void *ctx, const char *stage, int done, int total, const char *note)
{
    struct state *st = ctx;
    const double start = engine_seconds(), busy = engine_busy_seconds();
    for (int i = 0; i < 2; i++)
        limits_add(&st->turns[i], limits_now(st->engine.pool, &st->loop[i]), 0);
    progress_step(&st->engine.progress, stage, done, total, note);
    network_clock_skip(&st->clock, engine_seconds() - start, engine_busy_seconds() - busy);
}

static err_t run_pass(struct state *st)
{
    struct run r = st->engine.run;
    const size_t mark = arena_mark(&st->engine.keep);
    r.progress = take_turn;
    r.progress_ctx = st;
    st->turns[0].n = st->turns[1].n = 0;
    const struct run timed = network_timed(&r, &st->clock);
    err_t e = net_run(&timed, &st->network.net, &st->views, &st->prediction);
    network_clock_stop(&st->clock);
    arena_reset(&st->engine.keep, mark);
    return e;
}

static struct bench_net_figure stage_figure(const struct state *st, const char *name, double done,
                                            const char *const *stages, struct bench_net *out)
{
    const bool floats = st->network.file.model.precision != PRECISION_S8;
    const struct gemm_kernels *k = &st->engine.kernels.net;
    const double busy = network_busy(&st->clock, stages) / out->threads;
    return (struct bench_net_figure){.name = name,
                                     .isa = floats ? k->f32_name : k->s8_name,
                                     .threads = out->threads,
                                     .seconds = network_seconds(&st->clock, stages),
                                     .macs = done,
                                     .share = limits_share_of(&st->turns[floats], done / busy)};
}

static void stage_figures(const struct state *st, struct bench_net *out)
{
    static const char *const backbone[] = {"backbone", NULL}, *const heads[] = {"camera", "depth",
                                                                                NULL};
    const char *all[NETWORK_STAGES + 1] = {NULL}, *rest[NETWORK_STAGES + 1] = {NULL};
    const struct work w = work_of(&st->network.net.d, out->views, out->size);
    for (int i = 0, n = 0; i < st->clock.n; i++) {
        const char *name = all[i] = st->clock.stage[i].name;
        if (strcmp(name, "backbone") != 0 && strcmp(name, "camera") != 0 &&
            strcmp(name, "depth") != 0)
            rest[n++] = name;
    }
    out->stages[0] = stage_figure(st, "backbone", w.backbone, backbone, out);
    out->stages[1] = stage_figure(st, "heads", w.camera + w.depth, heads, out);
    out->stages[2] = stage_figure(st, "appearance", w.appearance, rest, out);
    out->stages[3] =
        stage_figure(st, "all", w.backbone + w.camera + w.depth + w.appearance, all, out);
    out->n_stages = BENCH_NET_STAGES;
    out->seconds = out->stages[3].seconds;
}

/* Kernels note their time by the clock: a call is short. */
static void kind_figures(const struct state *st, double seconds, struct bench_net *out)
{
    double rest = seconds;
    for (int i = 0; i < KINDS; i++) {
        const bool floats = i > S8_ATTENTION, product = i <= F32_ATTENTION;
        const double s = 1e-9 * (double)spent_ns[i] / out->threads;
        struct bench_net_figure f = {
            .name = kind_names[i], .threads = out->threads, .seconds = s, .macs = (double)macs[i]};
        rest -= s;
        if (spent_ns[i] == 0)
            continue;
        if (product) {
            f.isa = floats ? inner.f32_name : inner.s8_name;
            f.share = limits_share_of(&st->turns[floats], f.macs / s);
        }
        out->kinds[out->n_kinds++] = f;
    }
    out->kinds[out->n_kinds++] = (struct bench_net_figure){
        .name = "copies, waiting, other", .threads = out->threads, .seconds = rest};
}

static double clock_total(const struct network_clock *c)
{
    double sum = 0;
    for (int i = 0; i < c->n; i++)
        sum += c->stage[i].seconds;
    return sum;
}

static err_t both_passes(struct state *st, struct bench_net *out)
{
    st->loop[0] = limits_s8(st->engine.kernels.net.s8_name);
    st->loop[1] = limits_f32(st->engine.kernels.net.f32_name);
    err_t e = run_pass(st); // brings the weights into memory
    if (!e)
        e = run_pass(st);
    if (e)
        return e;
    out->keep_mb = (double)st->engine.keep.peak * 1e-6;
    out->tmp_mb = (double)st->engine.tmp.peak * 1e-6;
    out->rss_mb = engine_peak_rss_mb();
    stage_figures(st, out);
    note_all(&st->engine.kernels.net);
    e = run_pass(st);
    if (!e)
        kind_figures(st, clock_total(&st->clock), out);
    return e;
}

err_t bench_net_run(const char *model, int views, int size, const struct config *cfg,
                    struct bench_net *out)
{
    static struct state st;
    err_t e = network_open(model, NULL, (unsigned)cfg->net_float_parts, &st.network);
    if (e)
        return e;
    out->views = views;
    out->size = size ? size : st.network.net.d.size;
    snprintf(out->precision, sizeof out->precision, "%s",
             modelfile_precision(st.network.file.model.precision));
    e = engine_open(&st.engine, cfg->threads);
    if (!e) {
        out->threads = pool_size(st.engine.pool);
        e = reserve_memory(&st, views, out->size, config_memory_mb(cfg));
    }
    if (!e)
        e = both_passes(&st, out);
    engine_close(&st.engine);
    network_close(&st.network);
    return e;
}

/* ---- products alone ---- */

/* Shapes of the released network: of a block, of attention, of a 3 x 3 convolution. */
static const struct shape {
    const char *s8, *f32;
    int segs, seg;
} shapes[] = {{"s8 64 x 1024 x 32", "f32 64 x 1024 x 32", 1, 1024},
              {"s8 64 x 64 x 32", "f32 64 x 64 x 32", 1, 64},
              {"s8 64 x (3 x 768) x 32", "f32 64 x (3 x 768) x 32", 3, 768}};

enum { N_SHAPES = sizeof shapes / sizeof shapes[0], ROWS = 64, N_PANELS = 2, CALLS = 16384 };

struct product {
    const struct gemm_kernels *k;
    const struct shape *shape;
    bool s8;
    int8_t *work; // (workers, each)
    size_t each;
};

static err_t product_chunk(void *ctx, int chunk, int worker)
{
    const struct product *p = ctx;
    const struct shape *s = p->shape;
    const size_t k = (size_t)(s->segs * s->seg), elem = p->s8 ? 1 : sizeof(float);
    const size_t gap = 4096; // from run to run of a convolution
    int8_t *a = p->work + (size_t)worker * p->each;
    int8_t *w = a + (ROWS * 256 + k + 3 * gap) * elem, *c = w + k * PANEL * N_PANELS * elem;
    (void)chunk;
    struct gemm_s8 i = {ROWS, N_PANELS,  s->segs,   s->seg,          a, s->segs > 1 ? 256 : k, gap,
                        w,    k * PANEL, (void *)c, PANEL * N_PANELS};
    struct gemm_f32 f = {
        ROWS, N_PANELS,  s->segs,   s->seg,    (void *)a,        s->segs > 1 ? 256 : k,
        gap,  (void *)w, k * PANEL, (void *)c, PANEL * N_PANELS, false};
    for (int n = 0; n < CALLS / (int)k; n++) {
        if (p->s8)
            p->k->s8(&i);
        else
            p->k->f32(&f);
    }
    return OK;
}

/* The product and its limit take turns. */
static err_t measure_product(struct pool *pool, struct product *p, struct bench_net_figure *out)
{
    const int threads = pool_size(pool), chunks = 4 * threads;
    const int k = p->shape->segs * p->shape->seg;
    const double done = (double)(CALLS / k) * chunks * ROWS * N_PANELS * PANEL * k;
    const char *isa = p->s8 ? p->k->s8_name : p->k->f32_name;
    const struct limits_loop loop = p->s8 ? limits_s8(isa) : limits_f32(isa);
    struct limits_turns turns = {.n = 0};
    double best = 1e30, total = 0;
    while (total < 0.1) {
        const double limit = limits_now(pool, &loop);
        double start = engine_seconds(), busy = engine_busy_seconds();
        err_t e = pool_for(pool, chunks, product_chunk, p);
        double s = engine_seconds() - start;
        limits_add(&turns, limit, done * threads / (engine_busy_seconds() - busy));
        if (e)
            return e;
        if (atomic_load(&engine_cancel))
            return err_fail(ERR_CANCELLED, "bench: interrupted");
        best = s < best ? s : best;
        total += s;
    }
    *out = (struct bench_net_figure){.name = p->s8 ? p->shape->s8 : p->shape->f32,
                                     .isa = isa,
                                     .threads = threads,
                                     .seconds = best,
                                     .macs = done,
                                     .share = limits_sum_up(&turns)};
    return OK;
}

/* Every shape with the products of `k`; what a level below has too is left out. */
static err_t measure_level(struct engine *en, struct pool *pool, const struct gemm_kernels *k,
                           const struct gemm_kernels *below, struct bench_net *out)
{
    struct product p = {.k = k, .each = 4 << 20};
    err_t e = arena_zalloc(&en->tmp, (size_t)pool_size(pool), p.each, &p.work);
    for (int i = 0; i < 2 * N_SHAPES && !e; i++) {
        p.shape = &shapes[i % N_SHAPES];
        p.s8 = i < N_SHAPES;
        if (below && (p.s8 ? below->s8 == k->s8 : below->f32 == k->f32))
            continue;
        if (out->n_kernels < BENCH_NET_KERNELS)
            e = measure_product(pool, &p, &out->kernels[out->n_kernels++]);
    }
    arena_reset(&en->tmp, 0);
    return e;
}

err_t bench_net_kernels(const struct config *cfg, struct bench_net *out)
{
    static const unsigned levels[] = {0,       CPU_SSE41, CPU_AVX2,    CPU_AVX512, CPU_AVX512VNNI,
                                      CPU_AMX, CPU_NEON,  CPU_NEONDOT, CPU_I8MM};
    static struct engine en;
    struct kernels k[2];
    struct pool *one = NULL;
    unsigned cpu = 0;
    err_t e = engine_open(&en, cfg->threads);
    if (!e)
        e = engine_reserve(&en, 0, 0, (size_t)pool_size(en.pool) << 22, config_memory_mb(cfg));
    if (!e)
        e = pool_open(&one, 1);
    for (size_t i = 0; i < sizeof levels / sizeof levels[0] && !e; i++) {
        if ((levels[i] & en.cpu) != levels[i])
            continue;
        cpu |= levels[i];
        k[1] = k[0];
        kernels_init(&k[0], cpu);
        e = measure_level(&en, one, &k[0].net, cpu ? &k[1].net : NULL, out);
        if (!e && pool_size(en.pool) > 1)
            e = measure_level(&en, en.pool, &k[0].net, cpu ? &k[1].net : NULL, out);
    }
    pool_close(one);
    engine_close(&en);
    return e;
}

/* ---- results ---- */

static void report_list(struct report *rep, const char *key, const struct bench_net_figure *f,
                        int n)
{
    if (n == 0)
        return;
    report_open(rep, key, '[');
    for (int i = 0; i < n; i++) {
        report_open(rep, NULL, '{');
        report_text(rep, "name", f[i].name);
        report_int(rep, "threads", f[i].threads);
        report_number(rep, "seconds", f[i].seconds);
        if (f[i].macs > 0 && f[i].share.limit > 0) {
            report_text(rep, "kernels", f[i].isa);
            report_number(rep, "gmac", f[i].macs * 1e-9);
            report_number(rep, "gmac_per_s", f[i].macs * 1e-9 / f[i].seconds);
            report_number(rep, "limit_gmac_per_s", f[i].share.limit * 1e-9);
            report_number(rep, "share_of_limit", f[i].share.share);
            report_number(rep, "share_low", f[i].share.low);
            report_number(rep, "share_high", f[i].share.high);
        }
        report_close(rep);
    }
    report_close(rep);
}

void bench_net_report(const struct bench_net *b, struct report *rep)
{
    if (b->n_stages) {
        report_text(rep, "precision", b->precision);
        report_int(rep, "views", b->views);
        report_int(rep, "size", b->size);
        report_int(rep, "threads", b->threads);
        report_number(rep, "seconds", b->seconds);
        report_number(rep, "keep_peak_mb", b->keep_mb);
        report_number(rep, "tmp_peak_mb", b->tmp_mb);
        report_number(rep, "peak_rss_mb", b->rss_mb);
    }
    report_list(rep, "stages", b->stages, b->n_stages);
    report_list(rep, "kinds", b->kinds, b->n_kinds);
    report_list(rep, "kernels", b->kernels, b->n_kernels);
}

static void print_list(const char *what, const struct bench_net_figure *f, int n)
{
    if (n == 0)
        return;
    printf("\n%-36s %-10s %7s %9s %10s %9s %9s %6s  %s\n", what, "kernels", "threads", "seconds",
           "GMAC", "GMAC/s", "limit", "share", "quartiles");
    for (int i = 0; i < n; i++) {
        printf("%-36s %-10s %7d %9.4f", f[i].name, f[i].isa ? f[i].isa : "", f[i].threads,
               f[i].seconds);
        if (f[i].macs > 0 && f[i].share.limit > 0)
            printf(" %10.2f %9.1f %9.1f %6.3f  %.3f-%.3f", f[i].macs * 1e-9,
                   f[i].macs * 1e-9 / f[i].seconds, f[i].share.limit * 1e-9, f[i].share.share,
                   f[i].share.low, f[i].share.high);
        putchar('\n');
    }
}

void bench_net_print(const struct bench_net *b)
{
    if (b->n_stages)
        printf("\n%s, %d views of %d px: %.2f s, arenas %.0f + %.0f MB, process %.0f MB at most\n",
               b->precision, b->views, b->size, b->seconds, b->keep_mb, b->tmp_mb, b->rss_mb);
    print_list("stage", b->stages, b->n_stages);
    print_list("kind of work", b->kinds, b->n_kinds);
    print_list("product", b->kernels, b->n_kernels);
}
