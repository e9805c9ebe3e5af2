/* By the network: one forward pass; where cameras are known or polished, its geometry is brought to
 * them, and its depth and colours to the photographs where these are sure; then one Gaussian per
 * cell. A network without Gaussian head gives cameras and depth, from which seeds are made as from
 * stereo.
 * Memory: first what stays, then what the network needs, which is given back if it can be: without
 * refinement the planes of the scene are the network's own. */
#include "firmware/recon/start.h"

#include "firmware/base/engine.h"
#include "firmware/recon/dump.h"
#include "firmware/recon/figures.h"
#include "firmware/recon/locate.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/photo/exposure_stack.h"
#include "core/photo/response.h"
#include "core/refine/response_refit.h"
#include "core/sfm/corner.h"
#include "core/stereo/seed.h"
#include "core/stereo/sweep.h"

#include <math.h>
#include <string.h>

/* Whether the network's Gaussians begin the scene; else it gives cameras and perhaps depth. */
static bool takes_gaussians(const struct job_config *cfg)
{
    return job_forward(cfg) || (cfg->network->net.d.gauss && !cfg->cameras_only && !cfg->stereo);
}

/* Whether the network is only asked for cameras. */
static bool looks(const struct job_config *cfg)
{
    return cfg->cameras_only || (!takes_gaussians(cfg) && cfg->stereo);
}

/* Whether bundle adjustment follows the network. What is dumped is the network's own. */
static bool adjusts(const struct job_config *cfg, bool known, bool tapped)
{
    return cfg->polish && !tapped && (!known || takes_gaussians(cfg));
}

static bool locates(const struct run *r, const struct job_config *cfg, const struct job_result *out)
{
    return adjusts(cfg, out->views.cams != NULL, r->tap != NULL);
}

/* A network that is only asked for cameras has nothing to say about known ones. */
static bool asks_network(const struct job_config *cfg, bool known)
{
    return cfg->network && !(looks(cfg) && known);
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
    for (int c = 0; c < 3 && job_forward(cfg); c++)
        s->background[c] = 1; // core/splat/README.md 3
    err_t e = arena_alloc(r->keep, n, sizeof *s->cams, &s->cams);
    if (!e && !job_forward(cfg))
        e = gaussians_init(&s->g, r->keep, cfg->refine.gaussians_max, cfg->refine.degree_max);
    if (!e && v->cams)
        memcpy(s->cams, v->cams, n * sizeof *s->cams);
    return e;
}

/* ---- seeds from depth ---- */

/* Geometric mean of the radiance that the photographs tell of: holes in a scene are less wrong in
 * it than in black. */
static void set_background(const struct views *v, const struct tonemap *tone, float out[3])
{
    const size_t pixels = (size_t)v->size * (size_t)v->size;
    struct response_table table;
    response_tabulate(tone, &table);
    for (int c = 0; c < 3; c++) {
        double sum = 0, weight = 0;
        for (int i = 0; i < v->n; i++) {
            float shift = v->log2t[i] - v->mid_log2t;
            const uint8_t *p = v->rgb + 3 * pixels * (size_t)i + c;
            for (size_t k = 0; k < pixels; k++, p += 3) {
                double w = (double)table.weight[c][*p] + 1e-4;
                sum += w * (double)(table.x[c][*p] - shift);
                weight += w;
            }
        }
        out[c] = (float)exp2(sum / weight);
    }
}

/* What stereo looks at: of each place one picture with all that its exposures show. */
struct seen {
    struct views views;
    struct tonemap tone;
};

static err_t place_seeds(const struct run *r, const struct job_config *cfg, const struct seen *seen,
                         const struct depthmaps *depth, struct job_result *out)
{
    struct gaussians seeds, *g = &out->scene.g;
    const struct seed_input in = {.views = &seen->views, .depth = depth, .tone = &seen->tone};
    announce(r, "seed");
    /* the refiner splits where the photographs hold more than noise */
    err_t e = seed_run(r, &in, refine_begin(&cfg->refine, seen->views.n), &seeds);
    set_background(&seen->views, &seen->tone, out->scene.background);
    g->degree = 0; // refinement adds bands where the photographs ask for them
    for (int p = 0; !e && p < gaussians_planes(0); p++)
        memcpy(g->plane[p], seeds.plane[p], (size_t)seeds.n * sizeof(float));
    if (!e)
        g->n = seeds.n;
    job_lap(out, JOB_SEED);
    return e;
}

/* Depth, and with it a better curve. *seen: in r->tmp. */
static err_t sweep(const struct run *r, struct job_result *out, struct seen *seen,
                   struct depthmaps *depth)
{
    announce(r, "sweep");
    err_t e = exposure_stack_merge(r, &out->views, &out->response, &seen->views, &seen->tone);
    if (!e)
        e = sweep_run(r, &seen->views, &seen->tone, depth);
    if (!e && out->views.n_more == 0) {
        e = response_refit_run(r, &out->views, depth, &seen->tone);
        out->scene.tone = seen->tone;
    }
    job_lap(out, JOB_SWEEP);
    return e;
}

static err_t by_stereo(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    struct depthmaps depth;
    struct seen seen;
    const size_t mark = arena_mark(r->tmp);
    err_t e = sweep(r, out, &seen, &depth);
    if (!e)
        e = place_seeds(r, cfg, &seen, &depth, out);
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- cameras ---- */

/* Why cameras are not known, and what mends it. */
static const char *cause(const struct views *v, const struct bundle_result *b, char text[240])
{
    int blanks = 0, blank = 0, copies = 0, copy = 0;
    for (int i = 0; i < v->n; i++) {
        if (figures_blank(v, i))
            blank = blanks++ ? blank : i;
        if (figures_copied(v, i) >= 0)
            copy = copies++ ? copy : i;
    }
    if (2 * blanks >= v->n)
        snprintf(text, 240,
                 "%d of %d photographs are black or saturated all over (%.64s); take them at other "
                 "exposures",
                 blanks, v->n, v->names[blank]);
    else if (2 * (copies + 1) > v->n && copies)
        snprintf(text, 240,
                 "no parallax, %d of %d photographs are copies (%.64s is %.64s); take each from "
                 "another place",
                 copies, v->n, v->names[copy], v->names[figures_copied(v, copy)]);
    else if (b->agreement >= LOCATE_SURE)
        snprintf(
            text, 240,
            "no parallax, the camera turned or stood still; step aside between photographs, by "
            "a tenth of the distance or more");
    else
        snprintf(text, 240,
                 "the views have too few points in common (%d); photograph so that neighbours "
                 "overlap by more than half",
                 b->inliers);
    return text;
}

static void sum_up(const struct bundle_result *b, struct job_result *out)
{
    char text[240];
    out->cameras = (struct job_cameras){.found = true,
                                        .from_tracks = b->from_tracks,
                                        .confidence = b->confidence,
                                        .rms_px = b->rms_px,
                                        .inliers = b->inliers,
                                        .sightings = b->sightings,
                                        .placed = b->n_placed};
    if (b->confidence < LOCATE_SURE)
        job_warn(out, "cameras are a guess: %s, or give the cameras with --rig PATH",
                 cause(&out->views, b, text));
}

/* A view that is not tied to the others would only spoil the scene. p: of these views, or NULL. */
static err_t leave_out(const struct run *r, const struct bundle_result *b, struct prediction *p,
                       struct job_result *out)
{
    struct views *v = &out->views;
    const size_t mark = arena_mark(r->tmp);
    bool *keep;
    int n = 0;
    if (b->confidence < LOCATE_SURE || b->n_placed < 2)
        return OK;
    err_t e = arena_alloc(r->tmp, (size_t)(v->n + v->n_more), sizeof *keep, &keep);
    if (e)
        return e;
    for (int i = 0; i < v->n + v->n_more; i++)
        keep[i] = i >= v->n || b->placed[i];
    for (int i = 0; i < v->n; i++) {
        const char *blank = keep[i] ? NULL : figures_blank(v, i);
        if (keep[i])
            out->scene.cams[n++] = out->scene.cams[i];
        else if (blank)
            job_warn(out, "%s is left out: it is %s all over; take it at a %s exposure",
                     v->names[i], blank, *blank == 'b' ? "longer" : "shorter");
        else
            job_warn(out,
                     "%s is left out: too little in common with the other views; take it nearer to "
                     "one of them",
                     v->names[i]);
    }
    if (2 * n < v->n)
        job_warn(out,
                 "only %d of %d photographs could be placed: cameras and scene may be wrong; light "
                 "the others, or photograph so that neighbours overlap by more than half",
                 n, v->n);
    if (p)
        network_drop(b->placed, b->depth_scale, p);
    exposure_stack_drop(v, keep);
    out->scene.n_views = n;
    arena_reset(r->tmp, mark);
    return OK;
}

/* Bundle adjustment. Of cameras that are known only the scale of the network's depth is wanted.
 * p: of the network, or NULL. */
static err_t find_cameras(const struct run *r, const struct job_config *cfg,
                          const struct prediction *p, struct job_result *out,
                          struct bundle_result *b)
{
    const struct views *v = &out->views;
    const bool known = v->cams != NULL;
    struct bundle_config want = {.start = known ? v->cams
                                          : p   ? p->geom.cams
                                                : NULL,
                                 .start_depth = p && !looks(cfg) ? p->geom.depth : NULL,
                                 .focal_known = known || cfg->fov_deg > 0,
                                 .rig_known = known};
    struct seen seen;
    const size_t mark = arena_mark(r->tmp);
    if (!known && cfg->fov_deg > 0)
        want.focal = (float)v->size / 2 / tanf(cfg->fov_deg * (float)NUM_PI / 360);
    err_t e = exposure_stack_merge(r, v, &out->response, &seen.views, &seen.tone);
    if (!e)
        e = locate_run(r, &seen.views, p && p->matches.token ? &p->matches : NULL, &want, b);
    arena_reset(r->tmp, mark);
    if (!e && !known) {
        memcpy(out->scene.cams, b->cams, (size_t)v->n * sizeof *b->cams);
        sum_up(b, out);
    }
    job_lap(out, JOB_CAMERAS);
    return e;
}

static err_t refuse_cameras(const struct bundle_result *b, const struct views *v)
{
    char text[240];
    return err_fail(ERR_ARG, "the cameras cannot be found: %s, or give --rig PATH",
                    cause(v, b, text));
}

static err_t without_network(const struct run *r, const struct job_config *cfg,
                             struct job_result *out)
{
    struct bundle_result b;
    const size_t mark = arena_mark(r->keep);
    err_t e = out->views.cams ? OK : find_cameras(r, cfg, NULL, out, &b);
    if (!e && !out->views.cams && b.n_placed < 2)
        e = refuse_cameras(&b, &out->views);
    if (!e && !out->views.cams)
        e = leave_out(r, &b, NULL, out);
    out->views.cams = out->scene.cams;
    if (!e)
        e = by_stereo(r, cfg, out);
    arena_reset(r->keep, mark);
    return e;
}

/* ---- the network ---- */

static err_t forward(const struct run *r, const struct job_config *cfg, struct job_result *out,
                     struct prediction *p)
{
    const struct network *n = cfg->network;
    struct net net = n->net;
    static const char *const backbone[] = {"backbone", NULL}, *const heads[] = {"camera", "depth",
                                                                                NULL};
    struct network_clock clock;
    struct run timed = network_timed(r, &clock);
    net.d.gauss = takes_gaussians(cfg);
    net.attend = locates(r, cfg, out);
    err_t e = looks(cfg) ? network_look(&timed, n, net.attend, &out->views, p)
                         : net_run(&timed, &net, &out->views, p);
    network_clock_stop(&clock);
    file_drop(&n->file.map); // not needed again
    out->seconds[JOB_BACKBONE] += network_seconds(&clock, backbone);
    out->seconds[JOB_HEADS] += network_seconds(&clock, heads);
    job_lap(out, JOB_APPEARANCE); // the whole pass, hence less the two
    out->seconds[JOB_APPEARANCE] -= out->seconds[JOB_BACKBONE] + out->seconds[JOB_HEADS];
    return e;
}

/* Cameras that are known, or polished, or else the network's own; its geometry is moved there, at a
 * scale that is left to network_scale. */
static err_t take_cameras(const struct run *r, const struct job_config *cfg, struct job_result *out,
                          struct prediction *p, float *scale)
{
    struct scene *s = &out->scene;
    struct bundle_result b;
    *scale = 1;
    if (!locates(r, cfg, out)) {
        if (out->views.cams)
            return network_place(r, s->cams, NULL, p, scale);
        memcpy(s->cams, p->geom.cams, (size_t)s->n_views * sizeof *s->cams);
        return OK;
    }
    err_t e = find_cameras(r, cfg, p, out, &b);
    if (!e && cfg->cameras_only && b.n_placed < 2)
        e = refuse_cameras(&b, &out->views);
    if (!e && !out->views.cams)
        e = leave_out(r, &b, looks(cfg) ? NULL : p, out);
    if (!e && !looks(cfg))
        e = network_place(r, s->cams, b.depth_scale, p, scale);
    return e;
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
    const int max = job_forward(cfg) ? 0 : cfg->refine.gaussians_max;
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

/* Stereo and photographs correct the network's Gaussians; the cameras are right by now. */
static err_t sharpen(const struct run *r, float scale, struct prediction *p, struct job_result *out)
{
    struct depthmaps depth;
    struct seen seen;
    const size_t keep = arena_mark(r->keep), tmp = arena_mark(r->tmp);
    err_t e = sweep(r, out, &seen, &depth);
    const struct network_known known = {
        {&seen.views, &depth, &seen.tone}, &out->views, &out->scene.tone};
    if (!e)
        e = network_sharpen(r, &known, scale, p);
    if (!e && !p->linear)
        set_background(&seen.views, &seen.tone, out->scene.background);
    arena_reset(r->keep, keep);
    arena_reset(r->tmp, tmp);
    return e;
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
    if (job_forward(cfg))
        s->g = found.g;
    else
        copy_gaussians(&found.g, cfg->refine.degree_max, &s->g);
    s->tone = found.tone;
    gaussians_sanitize(&s->g, &report);
    if (report.dropped)
        return err_fail(ERR_FORMAT,
                        "the network overflows: %d of its %d Gaussians are not finite; its weights "
                        "are damaged or of another network: convert them again, or take another "
                        "model",
                        report.dropped, report.dropped + s->g.n);
    return OK;
}

/* Depth of the network as that of stereo; every pixel counts as sure. */
static err_t take_depth(const struct run *r, const struct job_config *cfg, float scale,
                        struct prediction *p, struct job_result *out)
{
    const size_t n = (size_t)p->geom.n_views * (size_t)p->geom.size * (size_t)p->geom.size;
    const size_t mark = arena_mark(r->tmp);
    struct seen seen;
    struct depthmaps depth = {p->geom.n_views, p->geom.size, 1, p->geom.depth, NULL};
    err_t e = arena_alloc(r->keep, n, sizeof *depth.conf, &depth.conf);
    for (size_t i = 0; i < n && !e; i++) {
        depth.conf[i] = 1;
        depth.depth[i] *= scale;
    }
    if (!e)
        e = exposure_stack_merge(r, &out->views, &out->response, &seen.views, &seen.tone);
    if (!e)
        e = place_seeds(r, cfg, &seen, &depth, out);
    arena_reset(r->tmp, mark);
    return e;
}

static err_t with_network(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    struct prediction p;
    float scale = 1;
    const size_t mark = arena_mark(r->keep);
    err_t e = dump_views(r, &out->views);
    job_lap(out, JOB_PREPROCESS);
    if (!e)
        e = forward(r, cfg, out, &p);
    if (!e)
        e = dump_prediction(r, &p);
    if (!e)
        e = take_cameras(r, cfg, out, &p, &scale);
    const bool known =
        locates(r, cfg, out) && (out->views.cams || out->cameras.confidence >= LOCATE_SURE);
    out->views.cams = out->scene.cams;
    if (!e && p.features && known)
        e = sharpen(r, scale, &p, out);
    if (!e && p.features) {
        e = take_gaussians(r, cfg, &p, out);
        if (!e)
            network_scale(&out->scene.g, scale);
        job_lap(out, JOB_VOXEL);
    } else if (!e && cfg->stereo) {
        arena_reset(r->keep, mark);
        e = by_stereo(r, cfg, out);
    } else if (!e) {
        e = take_depth(r, cfg, scale, &p, out);
    }
    if (!job_forward(cfg))
        arena_reset(r->keep, mark);
    return e;
}

/* What is dumped is the network's whole pass. */
static struct job_config within(const struct job_config *asked, bool tapped)
{
    struct job_config cfg = *asked;
    cfg.stereo = cfg.stereo && !tapped;
    return cfg;
}

err_t start_run(const struct run *r, const struct job_config *cfg, struct job_result *out)
{
    const struct job_config mine = within(cfg, r->tap != NULL);
    err_t e = begin_scene(r, &mine, out);
    if (e)
        return e;
    if (asks_network(&mine, out->views.cams != NULL))
        return with_network(r, &mine, out);
    if (mine.network)
        job_warn(out, "the network was not needed: cameras are known, and refinement starts from "
                      "stereo; to start from the network all the same: --set start.stereo=0");
    return without_network(r, &mine, out);
}

/* ---- planning ---- */

static void plan_cameras(const struct views *v, int threads, struct job_memory *m)
{
    struct plan p = plan_begin(threads);
    locate_plan(&p, v->n, v->size);
    m->keep = arena_add(m->keep, p.keep.peak);
    m->tmp = num_max_size(m->tmp, p.tmp.peak);
}

static void plan_stereo(const struct views *v, int cap, int threads, struct job_memory *m)
{
    struct plan p = plan_begin(threads);
    struct depthmaps depth;
    struct gaussians seeds;
    sweep_plan(&p, v, &depth);
    seed_plan(&p, &depth, cap, &seeds);
    m->keep = arena_add(m->keep, p.keep.peak);
    m->tmp = num_max_size(m->tmp, p.tmp.peak);
}

/* The forward pass and what is done with it before its memory is given back. */
static void plan_forward(const struct job_config *cfg, const struct views *v, int threads,
                         struct job_memory *m)
{
    struct net net = cfg->network->net;
    const size_t pixels = (size_t)v->n * (size_t)v->size * (size_t)v->size;
    const int all = pixels <= GAUSSIANS_MAX ? (int)pixels : -1; // -1: plans say SIZE_MAX
    net.d.gauss = takes_gaussians(cfg);
    net.attend = cfg->polish;
    if (looks(cfg))
        network_look_plan(cfg->network, v, threads, &m->keep, &m->tmp);
    else
        net_plan(&net, v->n, v->size, threads, &m->keep, &m->tmp);
    if (cfg->polish)
        plan_cameras(v, threads, m);
    m->tmp = num_max_size(m->tmp, network_place_plan(v->n));
    if (net.d.gauss && cfg->polish) {
        struct plan p = plan_begin(threads);
        struct depthmaps depth;
        sweep_plan(&p, v, &depth);
        m->keep = arena_add(m->keep, p.keep.peak);
        m->tmp = num_max_size(m->tmp, p.tmp.peak);
        m->tmp = num_max_size(m->tmp, network_sharpen_plan(v->n, v->size, threads));
    }
    if (net.d.gauss) {
        struct plan p = plan_begin(threads);
        voxel_plan(&p, all);
        m->keep = arena_add(m->keep, p.keep.peak);
        m->tmp = num_max_size(m->tmp, p.tmp.peak);
    } else if (!cfg->stereo) {
        m->keep = arena_add(m->keep, arena_need(pixels, sizeof(float)));
        struct plan p = plan_begin(threads);
        struct depthmaps depth = {.n = v->n, .size = v->size};
        struct gaussians seeds;
        seed_plan(&p, &depth, cfg->refine.gaussians_max, &seeds);
        m->keep = arena_add(m->keep, p.keep.peak);
        m->tmp = num_max_size(m->tmp, p.tmp.peak);
    }
}

err_t start_check(const struct job_config *asked, const struct views *v, bool tapped)
{
    const struct job_config cfg = within(asked, tapped);
    const bool known = v->cams != NULL;
    const bool bundle = asks_network(&cfg, known) ? adjusts(&cfg, known, tapped) : !known;
    if (bundle && v->n > BUNDLE_VIEWS_MAX)
        return err_fail(ERR_ARG,
                        "%d views, cameras can be found for at most %d: keep those that show the "
                        "most, each overlapping its neighbours%s",
                        v->n, BUNDLE_VIEWS_MAX,
                        known ? "; or take --set cameras.polish=0"
                              : "; or give the cameras with --rig PATH");
    if (!known && (!cfg.network || cfg.cameras_only) && v->size < CORNER_SIZE_MIN)
        return err_fail(ERR_ARG,
                        "views of %d px are too small to find cameras, take at least --size %d, or "
                        "give the cameras with --rig PATH",
                        v->size, (CORNER_SIZE_MIN + 13) / 14 * 14);
    return OK;
}

struct job_memory start_plan(const struct job_config *asked, const struct views *v, int threads,
                             bool tapped)
{
    const struct job_config mine = within(asked, tapped), *cfg = &mine;
    const int cap = cfg->refine.gaussians_max;
    struct job_memory m = {.keep = 0}, stereo = {.keep = 0};
    if (cfg->network) {
        plan_forward(cfg, v, threads, &m);
        m.weights = cfg->network->file.model.bytes;
    } else if (!v->cams) {
        plan_cameras(v, threads, &m);
    }
    if (!cfg->network || cfg->stereo)
        plan_stereo(v, cap, threads, &stereo);
    m.keep = cfg->network ? num_max_size(m.keep, stereo.keep) : arena_add(m.keep, stereo.keep);
    m.tmp = num_max_size(m.tmp, stereo.tmp);
    if (tapped)
        m.tmp = num_max_size(m.tmp, dump_plan(cfg->size, job_most(cfg, v->n)));
    m.tmp = arena_add(m.tmp, exposure_stack_plan(v, threads));
    m.keep = arena_add(m.keep, arena_need((size_t)v->n, sizeof(struct camera)));
    if (!job_forward(cfg))
        m.keep = arena_add(m.keep, gaussians_need(cap, cfg->refine.degree_max));
    return m;
}
