#include "core/net/net.h"

#include "core/net/appearance.h"
#include "core/net/backbone.h"
#include "core/net/camera.h"
#include "core/net/depth.h"
#include "core/net/finite.h"
#include "core/net/gausshead.h"
#include "core/net/metanet.h"
#include "core/net/shared_attention.h"
#include "core/net/tap.h"

#include <float.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* ---- binding ---- */

/* Keeps the first error; after it binding does nothing. */
struct binder {
    const struct model *m;
    err_t e;
};

static void __attribute__((format(printf, 3, 4)))
bind_plain(struct binder *b, const float **out, const char *fmt, ...)
{
    char name[NET_NAME_CAP];
    va_list args;
    va_start(args, fmt);
    vsnprintf(name, sizeof name, fmt, args);
    va_end(args);
    if (!b->e)
        b->e = model_plain(b->m, name, out);
}

static void __attribute__((format(printf, 3, 4)))
bind_weight(struct binder *b, struct weight *out, const char *fmt, ...)
{
    char name[NET_NAME_CAP];
    va_list args;
    va_start(args, fmt);
    vsnprintf(name, sizeof name, fmt, args);
    va_end(args);
    if (!b->e)
        b->e = model_weight(b->m, name, out);
}

static void bind_norm(struct binder *b, const float **gamma, const float **beta, const char *name)
{
    bind_plain(b, gamma, "%s.weight", name);
    bind_plain(b, beta, "%s.bias", name);
}

/* Block i of a list of them; qk: with norms of q and k. */
static void bind_block(struct binder *b, struct block_weights *w, const char *list, int i, bool qk)
{
    char name[NET_NAME_CAP], part[NET_NAME_CAP + 16];
    snprintf(name, sizeof name, "%s.%d", list, i);
    snprintf(part, sizeof part, "%s.norm1", name);
    bind_norm(b, &w->norm1_g, &w->norm1_b, part);
    snprintf(part, sizeof part, "%s.norm2", name);
    bind_norm(b, &w->norm2_g, &w->norm2_b, part);
    bind_plain(b, &w->gamma1, "%s.ls1.gamma", name);
    bind_plain(b, &w->gamma2, "%s.ls2.gamma", name);
    bind_weight(b, &w->qkv, "%s.attn.qkv", name);
    bind_weight(b, &w->proj, "%s.attn.proj", name);
    bind_weight(b, &w->fc1, "%s.mlp.fc1", name);
    bind_weight(b, &w->fc2, "%s.mlp.fc2", name);
    if (!qk)
        return;
    snprintf(part, sizeof part, "%s.attn.q_norm", name);
    bind_norm(b, &w->q_g, &w->q_b, part);
    snprintf(part, sizeof part, "%s.attn.k_norm", name);
    bind_norm(b, &w->k_g, &w->k_b, part);
}

static void bind_aggregator(struct binder *b, struct net *n)
{
    const char *a = "encoder.aggregator", *dino = "encoder.aggregator.patch_embed";
    bind_plain(b, &n->camera_token, "%s.camera_token", a);
    bind_plain(b, &n->register_token, "%s.register_token", a);
    bind_plain(b, &n->cls_token, "%s.cls_token", dino);
    bind_plain(b, &n->dino_registers, "%s.register_tokens", dino);
    bind_plain(b, &n->pos_embed, "%s.pos_embed", dino);
    bind_weight(b, &n->patch_embed, "%s.patch_embed.proj", dino);
    bind_norm(b, &n->dino_norm_g, &n->dino_norm_b, "encoder.aggregator.patch_embed.norm");
    for (int i = 0; i < n->d.dino_depth; i++)
        bind_block(b, n->dino + i, "encoder.aggregator.patch_embed.blocks", i, false);
    for (int i = 0; i < n->d.depth; i++) {
        bind_block(b, n->frame + i, "encoder.aggregator.frame_blocks", i, true);
        bind_block(b, n->global + i, "encoder.aggregator.global_blocks", i, true);
    }
}

static void bind_camera(struct binder *b, struct net *n)
{
    struct camera_weights *c = &n->camera;
    const char *h = "encoder.camera_head";
    bind_plain(b, &c->empty_pose, "%s.empty_pose_tokens", h);
    bind_norm(b, &c->token_norm_g, &c->token_norm_b, "encoder.camera_head.token_norm");
    bind_norm(b, &c->trunk_norm_g, &c->trunk_norm_b, "encoder.camera_head.trunk_norm");
    bind_weight(b, &c->embed_pose, "%s.embed_pose", h);
    bind_weight(b, &c->modulation, "%s.poseLN_modulation.1", h);
    bind_weight(b, &c->fc1, "%s.pose_branch.fc1", h);
    bind_weight(b, &c->fc2, "%s.pose_branch.fc2", h);
    for (int i = 0; i < n->d.cam_depth; i++)
        bind_block(b, c->trunk + i, "encoder.camera_head.trunk", i, false);
}

static void bind_unit(struct binder *b, struct rcu_weights *w, const char *h, int level, int unit)
{
    bind_weight(b, &w->conv1, "%s.scratch.refinenet%d.resConfUnit%d.conv1", h, level, unit);
    bind_weight(b, &w->conv2, "%s.scratch.refinenet%d.resConfUnit%d.conv2", h, level, unit);
}

static void bind_dpt(struct binder *b, struct dpt_weights *w, const char *h)
{
    bind_plain(b, &w->norm_g, "%s.norm.weight", h);
    bind_plain(b, &w->norm_b, "%s.norm.bias", h);
    for (int k = 0; k < NET_KEEP; k++) {
        bind_weight(b, &w->project[k], "%s.projects.%d", h, k);
        w->oc[k] = w->project[k].n;
        bind_weight(b, &w->rn[k], "%s.scratch.layer%d_rn", h, k + 1);
        bind_weight(b, &w->out_conv[k], "%s.scratch.refinenet%d.out_conv", h, k + 1);
        bind_unit(b, &w->unit2[k], h, k + 1, 2);
        if (k != 2) // the third size is that of the tokens
            bind_weight(b, &w->resize[k], "%s.resize_layers.%d", h, k);
        if (k != NET_KEEP - 1) // the coarsest level has nothing to join
            bind_unit(b, &w->unit1[k], h, k + 1, 1);
    }
    bind_weight(b, &w->output_conv1, "%s.scratch.output_conv1", h);
    w->feat = w->out_conv[0].n;
}

static void bind_appearance(struct binder *b, struct appearance_weights *w)
{
    const char *h = "encoder.hdr_head", *r = "encoder.hdr_head.regression";
    bind_weight(b, &w->patch_embed, "%s.patch_embed", h);
    bind_weight(b, &w->v_mean, "%s.v_mean_proj", r);
    bind_weight(b, &w->v_var, "%s.v_var_proj", r);
    bind_norm(b, &w->ln_g, &w->ln_b, "encoder.hdr_head.regression.ln");
    bind_norm(b, &w->mean_g, &w->mean_b, "encoder.hdr_head.regression.mean_out.0");
    bind_norm(b, &w->var_g, &w->var_b, "encoder.hdr_head.regression.var_out.0");
    bind_weight(b, &w->film.a, "%s.exp_film.0", r);
    bind_weight(b, &w->film.b, "%s.exp_film.2", r);
    bind_weight(b, &w->mean_out.a, "%s.mean_out.1", r);
    bind_weight(b, &w->mean_out.b, "%s.mean_out.3", r);
    bind_weight(b, &w->var_out.a, "%s.var_out.1", r);
    bind_weight(b, &w->var_out.b, "%s.var_out.3", r);
    bind_weight(b, &w->sensitivity.a, "%s.sensitivity_conv.0", h);
    bind_weight(b, &w->sensitivity.b, "%s.sensitivity_conv.2", h);
    bind_weight(b, &w->guide, "%s.guide_encoder.0", h);
    bind_weight(b, &w->scene_conv, "%s.scene_conv.0", h);
    bind_weight(b, &w->proj_guide, "%s.hdr_upsample.proj_guide.0", h);
    bind_weight(b, &w->proj_out, "%s.hdr_upsample.proj_out.0", h);
}

static void bind_meta(struct binder *b, struct meta_weights *w)
{
    const char *h = "encoder.generate_tonemapper";
    bind_weight(b, &w->exp_proj, "%s.exp_proj", h);
    bind_weight(b, &w->enc0, "%s.enc.0", h);
    bind_weight(b, &w->enc2, "%s.enc.2", h);
    bind_weight(b, &w->out.a, "%s.out.0", h);
    bind_weight(b, &w->out.b, "%s.out.2", h);
}

static void bind_gauss(struct binder *b, struct net *n)
{
    const char *h = "encoder.gaussian_param_head";
    bind_dpt(b, &n->gauss, h);
    if (n->d.appearance) {
        bind_weight(b, &n->gauss_out.a, "encoder.hdr_conv.0");
        bind_weight(b, &n->gauss_out.b, "encoder.hdr_conv.2");
        bind_appearance(b, &n->appearance);
        bind_meta(b, &n->meta);
    } else {
        bind_weight(b, &n->gauss_out.a, "%s.scratch.output_conv2.0", h);
        bind_weight(b, &n->gauss_out.b, "%s.scratch.output_conv2.2", h);
        bind_weight(b, &n->input_merger, "%s.input_merger.0", h);
    }
}

static void bind_complete(struct binder *b, struct complete_weights *w)
{
    const char *h = "encoder.complete";
    for (int l = 0; l < NET_COMPLETE; l++) {
        bind_weight(b, &w->down[l], "%s.down.%d", h, l);
        for (int k = 0; k < table_complete_stay[l]; k++)
            bind_weight(b, &w->stay[l][k], "%s.stay.%d.%d", h, l, k);
    }
    for (int l = 0; l < NET_COMPLETE - 1; l++) {
        bind_weight(b, &w->up[l], "%s.up.%d", h, l);
        bind_weight(b, &w->join[l], "%s.join.%d", h, l);
    }
    bind_weight(b, &w->out, "%s.out", h);
}

err_t net_bind(const struct model *m, unsigned floats, struct net *out)
{
    struct binder b = {.m = m};
    const char *depth = "encoder.depth_head";
    memset(out, 0, sizeof *out);
    out->d = m->dims;
    out->floats = m->precision == PRECISION_S8 ? floats & NET_FLOAT_ALL : NET_FLOAT_ALL;
    bind_aggregator(&b, out);
    bind_camera(&b, out);
    bind_dpt(&b, &out->depth, depth);
    bind_weight(&b, &out->depth_out.a, "%s.scratch.output_conv2.0", depth);
    bind_weight(&b, &out->depth_out.b, "%s.scratch.output_conv2.2", depth);
    if (out->d.gauss)
        bind_gauss(&b, out);
    if (out->d.complete)
        bind_complete(&b, &out->complete);
    return b.e;
}

/* ---- the graph ---- */

static bool too_many(int n_views, int size)
{
    return n_views > INT_MAX / size / size;
}

static err_t check_views(const struct run *r, const struct views *v)
{
    if (r->team && r->tap)
        return err_fail(ERR_UNSUPPORTED, "tensors cannot be inspected where several ranks share "
                                         "the network: run it in a single process");
    if (v->n < 2)
        return err_fail(ERR_ARG, "the network needs 2 views or more, there is %d", v->n);
    if (v->size < NET_PATCH || v->size % NET_PATCH != 0)
        return err_fail(ERR_ARG,
                        "the network takes views whose side is a multiple of %d px, not %d",
                        NET_PATCH, v->size);
    if (too_many(v->n, v->size))
        return err_fail(ERR_ARG, "%d views of %d px have more than %d pixels", v->n, v->size,
                        INT_MAX);
    return OK;
}

struct points_job {
    const struct geometry *g;
    float *points; // (n, 3)
};

static err_t points_chunk(void *ctx, int chunk, int worker)
{
    const struct points_job *j = ctx;
    size_t side = (size_t)j->g->size;
    (void)worker;
    depth_unproject(j->g, chunk, j->points + (size_t)chunk * side * side * 3);
    return OK;
}

static err_t layout_points(struct prediction *p, struct arena *keep)
{
    return arena_alloc(keep, (size_t)p->n * 3, sizeof *p->points, &p->points);
}

static err_t find_points(const struct run *r, struct prediction *io)
{
    const struct geometry *g = &io->geom;
    err_t e = layout_points(io, r->keep);
    struct points_job j = {g, io->points};
    if (!e)
        e = pool_for(r->pool, g->n_views, points_chunk, &j);
    if (!e)
        e = finite_check(r, "points.world", FLT_MAX, io->points, (size_t)io->n * 3);
    if (!e)
        tap_put(r, &(struct tap_tensor){.name = "points.world",
                                        .rank = 5,
                                        .shape = {1, g->n_views, g->size, g->size, 3},
                                        .data = io->points});
    return e;
}

static err_t layout_summary(float **summary, struct arena *tmp, const struct net *net, int n_views)
{
    return arena_alloc(tmp, (size_t)n_views * 2 * (size_t)net->d.hdr, sizeof **summary, summary);
}

/* Everything that needs the tokens, after the geometry. */
static err_t run_gauss(const struct run *r, const struct net *net, const struct views *v,
                       const struct tokens *t, struct prediction *out)
{
    struct irradiance irr;
    struct gausshead_in in = {.views = v, .tokens = t};
    float *summary = NULL;
    err_t e = OK;
    if (net->d.appearance) {
        e = appearance_run(r, net, v, t, &irr);
        in.irr = &irr;
        if (!e)
            e = layout_summary(&summary, r->tmp, net, v->n);
    }
    if (!e)
        e = gausshead_run(r, net, &in, out, summary);
    if (!e && net->d.appearance)
        e = metanet_run(r, net, summary, v->n, v->mid_log2t, out);
    return e ? e : find_points(r, out);
}

static err_t plan_gauss(struct plan *p, const struct net *net, int n_views, int size)
{
    struct prediction out = {.n = n_views * size * size};
    float *summary;
    err_t e = OK;
    if (net->d.appearance) {
        appearance_plan(p, net, n_views, size);
        e = layout_summary(&summary, &p->tmp, net, n_views);
    }
    gausshead_plan(p, net, n_views, size);
    if (net->d.appearance)
        metanet_plan(p, net);
    return e ? e : layout_points(&out, &p->keep);
}

void net_plan(struct plan *p, const struct net *net, int n_views, int size)
{
    struct plan backbone = plan_begin(p->threads);
    backbone.team = p->team;
    const size_t mark = arena_mark(&p->tmp);
    if (too_many(n_views, size)) {
        plan_refuse(p);
        return;
    }
    backbone_plan(&backbone, net, n_views, size);
    arena_hold(&p->tmp, backbone.keep.peak); // tokens are not needed in the end
    arena_step(&p->tmp, backbone.tmp.peak);
    camera_plan(p, net, n_views);
    depth_plan(p, net, n_views, size);
    if (net->attend)
        shared_attention_plan(p, &net->d, n_views, size);
    if (net->d.gauss && plan_gauss(p, net, n_views, size))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t net_run(const struct run *r, const struct net *net, const struct views *v,
              struct prediction *out)
{
    struct tokens t;
    struct run backbone = *r;
    size_t keep = arena_mark(r->keep), tmp = arena_mark(r->tmp);
    memset(out, 0, sizeof *out);
    err_t e = check_views(r, v);
    if (e)
        return e;
    backbone.keep = r->tmp;
    e = backbone_run(&backbone, net, v, &t);
    if (!e)
        e = camera_run(r, net, &t, v->size, &out->geom);
    if (!e)
        e = depth_run(r, net, &t, &out->geom);
    if (!e && net->attend && t.q)
        e = shared_attention_run(r, &net->d, &t, &out->matches);
    if (!e && net->d.gauss)
        e = run_gauss(r, net, v, &t, out);
    arena_reset(r->tmp, tmp);
    if (e) {
        arena_reset(r->keep, keep);
        memset(out, 0, sizeof *out);
    }
    return e;
}
