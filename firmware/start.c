/* By the network: one forward pass; where cameras are known, its geometry is brought to them; then
 * one Gaussian per cell. A network without Gaussian head gives cameras and depth, from which seeds
 * are made as from stereo.
 * Memory: first what stays, then what the network needs, which is given back if it can be: without
 * refinement the planes of the scene are the network's own. */
#include "firmware/start.h"

#include "firmware/dump.h"
#include "firmware/engine.h"

#include "core/base/num.h"
#include "core/splat/gaussians.h"
#include "core/splat/seed.h"
#include "core/splat/sweep.h"

#include <string.h>

/* The network's planes stay where they are. */
static bool in_place(const struct job_config *cfg)
{
    return cfg->network && cfg->network->net.d.gauss && cfg->refine.steps == 0;
}

static void announce(const struct run *r, const char *stage)
{
    if (r->progress)
        r->progress(r->progress_ctx, stage, 0, 1, NULL);
}

/* The scene before its first splat, and room for what refinement may add. */
static err_t begin_scene(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    const struct views *v = &out->views;
    struct scene *s = &out->scene;
    size_t n = (size_t)v->n;
    *s = (struct scene){.tone = out->response,
                        .n_views = v->n,
                        .size = v->size,
                        .names = v->names,
                        .log2t = v->log2t};
    err_t e = arena_alloc(r->keep, n, sizeof *s->cams, &s->cams);
    if (!e && !in_place(cfg))
        e = gaussians_init(&s->g, r->keep, cfg->refine.gaussians_max, cfg->refine.degree_max);
    if (!e && v->cams)
        memcpy(s->cams, v->cams, n * sizeof *s->cams);
    return e;
}

/* ---- seeds from depth ---- */

static err_t place_seeds(const struct run *r, const struct job_config *cfg,
                         const struct depthmaps *depth, struct job_result *out)
{
    struct gaussians seeds, *g = &out->scene.g;
    struct seed_input in = {.views = &out->views, .depth = depth, .tone = &out->response};
    announce(r, "seed");
    /* half of the room: the refiner splits where the photographs hold more than noise */
    err_t e = seed_run(r, &in, (cfg->refine.gaussians_max + 1) / 2, &seeds);
    g->degree = 0; // refinement adds bands where the photographs ask for them
    for (int p = 0; !e && p < gaussians_planes(0); p++)
        memcpy(g->plane[p], seeds.plane[p], (size_t)seeds.n * sizeof(float));
    if (!e)
        g->n = seeds.n;
    job_lap(out, JOB_SEED);
    return e;
}

static err_t by_stereo(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    struct depthmaps depth;
    size_t mark = arena_mark(r->keep);
    announce(r, "sweep");
    err_t e = sweep_run(r, &out->views, &out->response, &depth);
    job_lap(out, JOB_SWEEP);
    if (!e)
        e = place_seeds(r, cfg, &depth, out);
    arena_reset(r->keep, mark);
    return e;
}

/* ---- the network ---- */

static err_t forward(const struct run *r, const struct network *n, struct job_result *out,
                     struct prediction *p)
{
    static const char *const backbone[] = {"backbone", NULL}, *const heads[] = {"camera", "depth",
                                                                                NULL};
    struct network_clock clock;
    struct run timed = network_timed(r, &clock);
    err_t e = net_run(&timed, &n->net, &out->views, p);
    network_clock_stop(&clock);
    file_drop(&n->file.map); // not needed again
    out->seconds[JOB_BACKBONE] += network_seconds(&clock, backbone);
    out->seconds[JOB_HEADS] += network_seconds(&clock, heads);
    job_lap(out, JOB_APPEARANCE); // the whole pass, hence less the two
    out->seconds[JOB_APPEARANCE] -= out->seconds[JOB_BACKBONE] + out->seconds[JOB_HEADS];
    return e;
}

/* Known cameras, or else those of the network. */
static err_t take_cameras(const struct run *r, struct job_result *out, struct prediction *p,
                          float *scale)
{
    struct scene *s = &out->scene;
    *scale = 1;
    if (out->views.cams)
        return network_place(r, s->cams, p, scale);
    memcpy(s->cams, p->geom.cams, (size_t)s->n_views * sizeof *s->cams);
    return OK;
}

static err_t dump_scene(const struct run *r, const struct job_config *cfg,
                        const struct prediction *p, const struct scene *s)
{
    struct dump_picture picture = {
        .g = &s->g,
        .extra = s->g.plane[G_LOGIT] + VOXEL_EXTRA * (size_t)s->g.cap, // as voxel_adapt left it
        .cam = &p->geom.cams[0],
        .tone = &s->tone};
    memcpy(picture.log2t, cfg->dump_log2t, sizeof picture.log2t);
    err_t e = dump_gaussians(r, &s->g);
    return e ? e : dump_picture(r, &picture);
}

/* Cells become the Gaussians of *s, whose tone curve is set. */
static err_t merge(const struct run *r, const struct job_config *cfg, const struct prediction *p,
                   struct scene *s)
{
    const struct net_dims *d = &cfg->network->net.d;
    const int max = in_place(cfg) ? 0 : cfg->refine.gaussians_max;
    struct voxels cells;
    float cell;
    announce(r, "voxel");
    err_t e = network_merge(r, p, d->voxel, max, &cells, &cell);
    if (e)
        return e;
    dump_cells(r, &cells);
    e = voxel_adapt(r, &cells, &s->g);
    if (!e && p->linear)
        network_from_display(&s->g);
    return e ? e : dump_scene(r, cfg, p, s);
}

/* Gaussians of *from as they are; bands above what *to has planes for are left out. */
static void copy_gaussians(const struct gaussians *from, int degree_max, struct gaussians *to)
{
    to->n = from->n;
    to->degree = from->degree < degree_max ? from->degree : degree_max;
    for (int p = 0; p < gaussians_planes(to->degree); p++)
        memcpy(to->plane[p], from->plane[p], (size_t)from->n * sizeof(float));
}

static err_t take_gaussians(const struct run *r, const struct job_config *cfg,
                            const struct prediction *p, struct job_result *out)
{
    struct scene *s = &out->scene, found = {.size = s->size};
    struct gaussians_report report;
    found.tone = p->tone;
    if (p->linear)
        network_display_curve(out->views.mid_log2t, &found.tone);
    err_t e = merge(r, cfg, p, &found);
    if (e)
        return e;
    if (in_place(cfg))
        s->g = found.g;
    else
        copy_gaussians(&found.g, cfg->refine.degree_max, &s->g);
    s->tone = found.tone;
    gaussians_sanitize(&s->g, &report);
    if (report.dropped)
        job_warn(out, "%d Gaussians of the network were not finite", report.dropped);
    for (int c = 0; c < 3 && in_place(cfg); c++)
        s->background[c] = 1; // model-spec 2.13
    return OK;
}

/* Depth of the network as that of stereo; every pixel counts as sure. */
static err_t take_depth(const struct run *r, const struct job_config *cfg, float scale,
                        struct prediction *p, struct job_result *out)
{
    const size_t n = (size_t)p->geom.n_views * (size_t)p->geom.size * (size_t)p->geom.size;
    struct depthmaps depth = {p->geom.n_views, p->geom.size, 1, p->geom.depth, NULL};
    err_t e = arena_alloc(r->keep, n, sizeof *depth.conf, &depth.conf);
    for (size_t i = 0; i < n && !e; i++) {
        depth.conf[i] = 1;
        depth.depth[i] *= scale;
    }
    return e ? e : place_seeds(r, cfg, &depth, out);
}

static err_t by_network(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    struct prediction p;
    float scale = 1;
    const size_t mark = arena_mark(r->keep);
    err_t e = dump_views(r, &out->views);
    job_lap(out, JOB_PREPROCESS);
    if (!e)
        e = forward(r, cfg->network, out, &p);
    if (!e)
        e = dump_prediction(r, &p);
    if (!e)
        e = take_cameras(r, out, &p, &scale);
    out->views.cams = out->scene.cams;
    if (!e && p.features)
        e = take_gaussians(r, cfg, &p, out);
    else if (!e)
        e = take_depth(r, cfg, scale, &p, out);
    if (!e && p.features)
        network_scale(&out->scene.g, scale);
    if (!in_place(cfg))
        arena_reset(r->keep, mark);
    job_lap(out, JOB_VOXEL);
    return e;
}

err_t start_run(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    err_t e = begin_scene(r, cfg, out);
    if (e)
        return e;
    return cfg->network ? by_network(r, cfg, out) : by_stereo(r, cfg, out);
}

/* ---- planning ---- */

static void plan_stereo(const struct views *v, int cap, int threads, struct job_memory *m)
{
    m->keep = arena_add(m->keep, arena_add(sweep_keep(v), seed_keep(cap)));
    m->tmp = num_max_size(m->tmp, sweep_plan(v, threads));
    m->tmp = num_max_size(m->tmp, seed_plan(v));
}

static void plan_network(const struct job_config *cfg, int n_views, int threads, bool tapped,
                         struct job_memory *m)
{
    const struct network *n = cfg->network;
    const struct views v = {.n = n_views, .size = cfg->size};
    const size_t pixels = (size_t)n_views * (size_t)cfg->size * (size_t)cfg->size;
    const int all = pixels <= GAUSSIANS_MAX ? (int)pixels : -1; // -1: plans say SIZE_MAX
    size_t keep, tmp;
    net_plan(&n->net, n_views, cfg->size, threads, &keep, &tmp);
    m->weights = n->file.model.bytes;
    m->keep = arena_add(m->keep, keep);
    m->tmp = num_max_size(m->tmp, tmp);
    m->tmp = num_max_size(m->tmp, network_place_plan(n_views));
    if (n->net.d.gauss) {
        m->keep = arena_add(m->keep, voxel_keep(all));
        m->tmp = num_max_size(m->tmp, voxel_plan(all));
    } else {
        m->keep = arena_add(m->keep, arena_need(pixels, sizeof(float)));
        m->keep = arena_add(m->keep, seed_keep(cfg->refine.gaussians_max));
        m->tmp = num_max_size(m->tmp, seed_plan(&v));
    }
    if (tapped)
        m->tmp = num_max_size(m->tmp, dump_plan(cfg->size, job_most(cfg, n_views)));
}

struct job_memory start_plan(const struct job_config *cfg, int n_views, int threads, bool tapped)
{
    const int cap = cfg->refine.gaussians_max;
    const struct views v = {.n = n_views, .size = cfg->size}; // all that plans look at
    struct job_memory m = {.keep = arena_need((size_t)n_views, sizeof(struct camera))};
    if (!in_place(cfg))
        m.keep = arena_add(m.keep, gaussians_need(cap, cfg->refine.degree_max));
    if (cfg->network)
        plan_network(cfg, n_views, threads, tapped, &m);
    else
        plan_stereo(&v, cap, threads, &m);
    return m;
}
