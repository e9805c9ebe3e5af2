#include "firmware/cmd/tradeoff.h"

#include "firmware/base/engine.h"
#include "firmware/cmd/bench_net.h"
#include "firmware/recon/network.h"

#include "core/photo/prep.h"
#include "drivers/format/imageset.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- pictures ---- */

struct state {
    const struct tradeoff_request *rq;
    struct engine engine;
    int max_mb, n_models, n_images;
    char model[TRADEOFF_LIST_MAX][FILE_PATH_CAP];
    unsigned floats[TRADEOFF_FLOATS_MAX];
    int n_floats;
    bool exposures;    // pictures must have them
    bool dry;          // nothing is computed yet
    bool first;        // size and number of views: there parts are tried in floats
    struct arena base; // views, and what stays of the reference
    struct views views;
    struct differ_look ref;
    struct tradeoff *out;
};

static err_t list_pictures(const struct state *st, int n, struct imageset *set)
{
    const struct imageset_request rq = {.images = st->rq->images,
                                        .n_views = n,
                                        .may_lack_times = !st->exposures,
                                        .no_cameras = true};
    return imageset_list(&rq, set);
}

/* The set's pictures as often as needed. c: n shots. */
static void repeat_pictures(const struct state *st, const struct imageset *set, struct capture *c)
{
    for (int i = 0; i < c->n; i++) {
        c->shots[i] = set->capture.shots[i % set->capture.n];
        c->shots[i].exposure = st->exposures ? c->shots[i].exposure : 1;
    }
}

static err_t load_photographs(struct state *st, int size, struct capture *c)
{
    struct imageset set;
    size_t bytes = 0;
    err_t e = list_pictures(st, c->n < st->n_images ? c->n : st->n_images, &set);
    if (e)
        return e;
    repeat_pictures(st, &set, c);
    for (int i = 0; i < set.capture.n; i++)
        bytes += 3 * (size_t)c->shots[i].image.w * (size_t)c->shots[i].image.h;
    struct plan p = plan_begin(pool_size(st->engine.pool));
    prep_plan_capture(&p, c, NULL, (struct prep_size){size, true});
    differ_keep_plan(&p.keep, c->n, size);
    e = engine_reserve(&st->engine, bytes, p.keep.peak, p.tmp.peak, st->max_mb);
    if (!e && !st->dry)
        e = imageset_load(&set);
    if (!e && !st->dry) {
        repeat_pictures(st, &set, c);
        e = prep_run(&st->engine.run, c, (struct prep_size){size, true}, &st->views);
    }
    imageset_free(&set);
    return e;
}

static err_t make_noise(struct state *st, int size, int n)
{
    struct arena keep = arena_counter();
    bench_net_views_plan(&keep, n, size);
    differ_keep_plan(&keep, n, size);
    err_t e = engine_reserve(&st->engine, 0, keep.peak, 0, st->max_mb);
    return e ? e : bench_net_views(&st->engine.keep, n, size, &st->views);
}

/* Put the pictures, and room for the reference's results, into base. */
static err_t make_pictures(struct state *st, int size, int n)
{
    err_t e;
    if (st->rq->images) {
        struct capture c = {n, calloc((size_t)n, sizeof *c.shots)};
        e = c.shots ? load_photographs(st, size, &c)
                    : err_fail(ERR_NOMEM, "no memory for %d shots", n);
        free(c.shots);
    } else {
        e = make_noise(st, size, n);
    }
    st->base = st->engine.keep;
    memset(&st->engine.keep, 0, sizeof st->engine.keep);
    arena_free(&st->engine.tmp);
    return e;
}

/* ---- rows ---- */

static void name_row(const struct network *n, unsigned floats, char *out, size_t cap)
{
    static const struct {
        unsigned bit;
        const char *name;
    } parts[] = {{NET_FLOAT_ATTENTION, "attention"},
                 {NET_FLOAT_SPECIAL, "special"},
                 {NET_FLOAT_HEADS, "heads"},
                 {NET_FLOAT_BLOCKS, "blocks"}};
    const enum precision p = n->file.model.precision;
    int at = snprintf(out, cap, "%s", modelfile_precision(p));
    for (size_t i = 0; i < sizeof parts / sizeof parts[0] && p == PRECISION_S8; i++)
        if (floats & parts[i].bit)
            at += snprintf(out + at, cap - (size_t)at, " + %s", parts[i].name);
}

/* Forget the most memory so far. false: the system does not do that. */
static bool restart_peak(void)
{
    FILE *f = fopen("/proc/self/clear_refs", "w"); // proc(5): 5 resets the peak of the process
    const bool written = f && fputs("5", f) >= 0;
    return f && fclose(f) == 0 && written;
}

static err_t run_pass(struct state *st, const struct net *net, struct tradeoff_row *row)
{
    struct engine *en = &st->engine;
    struct prediction p;
    double start = engine_seconds();
    err_t e = net_run(&en->run, net, &st->views, &p);
    if (e)
        return e;
    row->seconds = engine_seconds() - start;
    row->memory_mb += (double)(en->keep.peak + en->tmp.peak) * 1e-6;
    struct differ_look look = differ_look(&p);
    if (st->ref.cams)
        return differ_measure(&st->ref, &look, st->views.log2t, &en->tmp, row->error);
    st->ref = look;
    return differ_keep(&st->base, &st->ref);
}

/* *s8: whether the file's arithmetic has parts. */
static err_t run_row(struct state *st, unsigned floats, struct tradeoff_row *row, bool *s8)
{
    const bool known = !st->dry && restart_peak();
    struct engine *en = &st->engine;
    struct network network;
    err_t e = network_open(st->model[row->model], NULL, floats, &network);
    if (e)
        return e;
    const struct model *m = &network.file.model;
    *s8 = m->precision == PRECISION_S8;
    name_row(&network, floats, row->what, sizeof row->what);
    row->memory_mb = (double)m->bytes * 1e-6;
    struct plan plan = plan_begin(pool_size(en->pool));
    net_plan(&plan, &network.net, row->views, row->size);
    differ_measure_plan(&plan.tmp, row->views, row->size);
    e = engine_reserve(en, arena_add(st->base.size, m->bytes), plan.keep.peak, plan.tmp.peak,
                       st->max_mb);
    if (!e && !st->dry)
        e = modelfile_verify(&network.file); // brings it into memory
    if (!e && !st->dry)
        e = run_pass(st, &network.net, row);
    row->rss_mb = known ? engine_peak_rss_mb() : NAN;
    arena_free(&en->keep);
    arena_free(&en->tmp);
    network_close(&network);
    return e;
}

/* ---- the table ---- */

static const struct {
    const char *key, *head;
} measures[DIFFER_FIGURES] = {
    [DIFFER_ROTATION] = {"rotation_deg", "rot deg"},
    [DIFFER_TRANSLATION] = {"translation_percent", "trans %"},
    [DIFFER_FOCAL] = {"focal_percent", "focal %"},
    [DIFFER_DEPTH] = {"depth_percent", "depth %"},
    [DIFFER_ALIGNED] = {"depth_aligned_percent", "aligned"},
    [DIFFER_RADIANCE] = {"radiance_stops", "stops"},
    [DIFFER_PSNR] = {"psnr_db", "PSNR"},
    [DIFFER_OPACITY] = {"opacity_rms", "opacity"},
};

static void print_number(double v, int digits)
{
    if (isfinite(v))
        printf(" %8.*f", digits, v);
    else
        printf(" %8s", "-");
}

static void print_row(const struct tradeoff *t)
{
    const struct tradeoff_row *r = &t->rows[t->n - 1];
    if (t->n == 1) {
        printf("%-24s %5s %5s %9s %8s %8s", "precision", "px", "views", "seconds", "MB", "process");
        for (int i = 0; i < DIFFER_FIGURES; i++)
            printf(" %8s", measures[i].head);
        putchar('\n');
    }
    printf("%-24s %5d %5d %9.3f %8.0f", r->what, r->size, r->views, r->seconds, r->memory_mb);
    print_number(r->rss_mb, 0);
    for (int i = 0; i < DIFFER_FIGURES; i++)
        print_number(r->error[i], i == DIFFER_PSNR ? 2 : 4);
    putchar('\n');
    fflush(stdout);
}

static err_t run_model(struct state *st, int model, int size, int n)
{
    bool s8 = true;
    err_t e = OK;
    for (int i = 0; i < (st->first ? st->n_floats : 1) && s8 && !e; i++) {
        struct tradeoff_row row = {.model = model, .size = size, .views = n};
        for (int k = 0; k < DIFFER_FIGURES; k++)
            row.error[k] = NAN;
        e = run_row(st, st->floats[i], &row, &s8);
        if (e || st->dry)
            continue;
        st->out->rows[st->out->n++] = row;
        progress_end(&st->engine.progress);
        if (st->rq->print)
            print_row(st->out);
    }
    return e;
}

static err_t run_group(struct state *st, int size, int n)
{
    if (size % NET_PATCH != 0)
        return err_fail(ERR_ARG, "--size: the network takes multiples of %d px, not %d", NET_PATCH,
                        size);
    err_t e = make_pictures(st, size, n);
    for (int i = 0; i < st->n_models && !e; i++)
        e = run_model(st, i, size, n);
    arena_free(&st->base);
    st->ref.cams = NULL;
    return e;
}

static err_t run_all(struct state *st, bool dry)
{
    const struct tradeoff_request *rq = st->rq;
    err_t e = OK;
    st->dry = dry;
    for (int s = 0; s < rq->n_sizes; s++)
        for (int v = 0; v < rq->n_views && !e; v++) {
            st->first = s == 0 && v == 0;
            e = run_group(st, rq->sizes[s], rq->views[v]);
        }
    return e;
}

static err_t split_models(struct state *st)
{
    for (const char *at = st->rq->models;; at++) {
        size_t n = strcspn(at, ",");
        if (n == 0 || n >= FILE_PATH_CAP)
            return err_fail(ERR_ARG, "--model: a name has %zu bytes, 1 to %d are allowed", n,
                            FILE_PATH_CAP - 1);
        if (st->n_models == TRADEOFF_LIST_MAX)
            return err_fail(ERR_ARG, "--model: more than %d files", TRADEOFF_LIST_MAX);
        memcpy(st->model[st->n_models], at, n);
        st->model[st->n_models++][n] = 0;
        at += n;
        if (!*at)
            return OK;
    }
}

/* Requirements of the reference for photographs, and their number. */
static err_t look_around(struct state *st)
{
    struct network network;
    struct imageset set;
    err_t e = split_models(st);
    if (e || !st->rq->images)
        return e;
    e = network_open(st->model[0], NULL, 0, &network);
    if (e)
        return e;
    st->exposures = network_needs_exposures(&network);
    network_close(&network);
    e = list_pictures(st, 0, &set);
    if (e)
        return e;
    st->n_images = set.capture.n;
    imageset_free(&set);
    return OK;
}

err_t tradeoff_run(const struct tradeoff_request *rq, const struct config *cfg,
                   struct tradeoff *out)
{
    static struct state st;
    st = (struct state){.rq = rq,
                        .max_mb = config_memory_mb(cfg),
                        .floats = {0, NET_FLOAT_ATTENTION, NET_FLOAT_SPECIAL, NET_FLOAT_HEADS,
                                   NET_FLOAT_BLOCKS, (unsigned)cfg->net_float_parts},
                        .n_floats = cfg->net_float_parts ? 6 : 5,
                        .out = out};
    out->n = 0;
    err_t e = look_around(&st);
    if (!e)
        e = engine_open(&st.engine, cfg->threads);
    if (!e)
        e = run_all(&st, true);
    if (!e)
        e = run_all(&st, false);
    engine_close(&st.engine);
    return e;
}

void tradeoff_report(const struct tradeoff *t, struct report *rep)
{
    report_open(rep, "trade", '[');
    for (int i = 0; i < t->n; i++) {
        const struct tradeoff_row *r = &t->rows[i];
        report_open(rep, NULL, '{');
        report_int(rep, "model", r->model);
        report_text(rep, "precision", r->what);
        report_int(rep, "size", r->size);
        report_int(rep, "views", r->views);
        report_number(rep, "seconds", r->seconds);
        report_number(rep, "memory_mb", r->memory_mb);
        report_number(rep, "peak_rss_mb", r->rss_mb);
        for (int k = 0; k < DIFFER_FIGURES; k++)
            report_number(rep, measures[k].key, r->error[k]);
        report_close(rep);
    }
    report_close(rep);
}
