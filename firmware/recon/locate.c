#include "firmware/recon/locate.h"

#include <math.h>

/* What matching says about lenses of which nothing else is known. */
struct rough {
    struct division_lens *division; // (n_lenses)
    struct bundle_lens *lens;       // (n_lenses)
    double *frame;                  // (n_lenses) px, from the middle to the corner
};

static err_t layout(struct rough *l, struct arena *tmp, int n_lenses)
{
    const size_t n = (size_t)n_lenses;
    err_t e = arena_zalloc(tmp, n, sizeof *l->division, &l->division);
    if (!e)
        e = arena_zalloc(tmp, n, sizeof *l->frame, &l->frame);
    return e ? e : arena_zalloc(tmp, n, sizeof *l->lens, &l->lens);
}

void locate_plan(struct plan *p, const struct views *v, int n_lenses)
{
    const size_t mark = arena_mark(&p->tmp);
    struct match_tracks tracks;
    struct rough l;
    if (layout(&l, &p->tmp, n_lenses))
        plan_refuse(p);
    match_plan(p, v, n_lenses, &tracks);
    bundle_plan(p, v->n, n_lenses, &tracks);
    arena_reset(&p->tmp, mark);
}

/* Whether nothing says how the lenses distort. */
static bool is_unknown(const struct bundle_config *cfg)
{
    bool unknown = cfg->find_distortion && !cfg->pinhole && cfg->n_lenses > 0;
    for (int i = 0; i < cfg->n_lenses; i++)
        unknown = unknown && cfg->lens[i].start.model == LENS_PINHOLE;
    return unknown;
}

static void expect_lenses(const struct views *v, const struct bundle_config *cfg, struct rough *l)
{
    for (int i = v->n - 1; i >= 0; i--) {
        const struct extent *px = &v->extent[i];
        const int lens = cfg->lens_of[i];
        const double given = cfg->lens[lens].start.fx;
        l->frame[lens] = 0.5 * hypot(px->w, px->h);
        l->division[lens].focal = given > 0 ? given : BUNDLE_FOCAL * fmax(px->w, px->h);
    }
}

/* Lenses to start with, where matches say that they distort. */
static err_t start_lenses(const struct rough *l, struct bundle_config *cfg)
{
    err_t e = OK;
    bool any = false;
    for (int i = 0; i < cfg->n_lenses && !e; i++) {
        struct division_lens d = l->division[i];
        l->lens[i] = cfg->lens[i];
        if (cfg->lens[i].start.fx > 0)
            d.focal = cfg->lens[i].start.fx;
        else
            l->lens[i].focal_guessed = true;
        any = any || d.bend != 0;
        e = division_fit(&d, l->frame[i], &l->lens[i].start);
    }
    if (any)
        cfg->lens = l->lens;
    return e;
}

err_t locate_run(const struct run *r, const struct views *v, const struct correspondence *prior,
                 const struct bundle_config *cfg, struct bundle_result *out)
{
    const size_t mark = arena_mark(r->tmp);
    const bool unknown = is_unknown(cfg);
    struct bundle_config own = *cfg;
    struct match_tracks tracks;
    struct rough l;
    if (r->progress)
        r->progress(r->progress_ctx, "cameras", 0, 2, NULL);
    err_t e = layout(&l, r->tmp, cfg->n_lenses);
    if (!e && unknown)
        expect_lenses(v, cfg, &l);
    struct division_lenses find = {cfg->n_lenses, cfg->lens_of, l.division};
    if (!e)
        e = match_run(r, v, prior, unknown ? &find : NULL, &tracks);
    if (!e && unknown)
        e = start_lenses(&l, &own);
    if (!e && r->progress)
        r->progress(r->progress_ctx, "cameras", 1, 2, NULL);
    if (!e)
        e = bundle_run(r, v, &tracks, &own, out);
    arena_reset(r->tmp, mark);
    return e;
}
