/* Down: each level halves the map before it, then adds residuals to its own. Up: the coarser result
 * is projected at its own size, since weights of an interpolation sum to one; the convolution that
 * joins it with the level's map reads it resized (Ronneberger et al. 2015).
 * A convolution must not write to the map that it reads, because tiles read pixels of their
 * neighbours: each level has two maps and goes from one to the other. */
#include "core/net/complete.h"

#include "core/net/dpt.h"
#include "core/net/finite.h"

#include <string.h>

struct level {
    int h, w, c;
    float *px;   // (h, w, c), the level's map as far as it is computed
    float *room; // (h, w, c), for the next one
};

struct unet {
    const struct run *r;
    const struct complete_weights *w;
    bool floats;
    struct level level[NET_COMPLETE];
    float *up; // the map of a level with the channels of the next finer one
};

static size_t pixel_count(const struct level *l)
{
    return (size_t)l->h * (size_t)l->w;
}

/* To level l from the one before, or from the input. */
static struct layer_conv down_conv(const struct unet *u, const struct complete_in *in, int l)
{
    struct layer_conv c = l == 0
                              ? conv_3x3(u->w->down, in->h, in->w, 1)
                              : conv_3x3(u->w->down + l, u->level[l - 1].h, u->level[l - 1].w, 2);
    c.floats = u->floats;
    return c;
}

static struct layer_conv level_conv(const struct unet *u, const struct weight *w, int l)
{
    struct layer_conv c = conv_3x3(w, u->level[l].h, u->level[l].w, 1);
    c.floats = u->floats;
    return c;
}

static void swap_maps(struct level *l)
{
    float *px = l->px;
    l->px = l->room;
    l->room = px;
}

/* The level's own map, from the input or the map before it. */
static err_t go_down(struct unet *u, const struct complete_in *in, int l)
{
    struct level *at = u->level + l;
    struct layer_conv c = down_conv(u, in, l);
    const struct layer_map from = {l ? at[-1].px : in->px, c.w_px, c.channels, false};
    struct layer_out out = {.out = at->px, .ldo = (size_t)at->c, .act = ACT_RELU};
    c.fetch = layer_map_fetch;
    c.ctx = &from;
    err_t e = layer_conv_run(u->r, &c, &out);
    for (int k = 0; k < table_complete_stay[l] && !e; k++) {
        const struct layer_map map = {at->px, at->w, at->c, false};
        c = level_conv(u, &u->w->stay[l][k], l);
        c.fetch = layer_map_fetch;
        c.ctx = &map;
        memcpy(at->room, at->px, pixel_count(at) * (size_t)at->c * sizeof *at->px);
        out.out = at->room;
        out.add = true;
        e = layer_conv_run(u->r, &c, &out);
        swap_maps(at);
    }
    return e;
}

/* Join the coarser result. */
static err_t go_up(struct unet *u, int l)
{
    struct level *at = u->level + l, *from = at + 1;
    const struct dpt_blend b = {.map = {u->up, from->h, from->w, at->c, at->h, at->w, false},
                                .plus = at->px};
    struct layer_conv c = level_conv(u, u->w->join + l, l);
    c.fetch = dpt_blend_fetch;
    c.ctx = &b;
    err_t e =
        layer_run(u->r, u->w->up + l,
                  &(struct layer_in){from->px, (size_t)from->c, (int)pixel_count(from), u->floats},
                  &(struct layer_out){.out = u->up, .ldo = (size_t)at->c});
    if (!e)
        e = layer_conv_run(
            u->r, &c, &(struct layer_out){.out = at->room, .ldo = (size_t)at->c, .act = ACT_RELU});
    swap_maps(at);
    return e;
}

static err_t go_out(const struct unet *u, float *out)
{
    const struct level *from = u->level;
    const struct layer_map map = {from->px, from->w, from->c, false};
    struct layer_conv c = level_conv(u, &u->w->out, 0);
    c.fetch = layer_map_fetch;
    c.ctx = &map;
    err_t e = layer_conv_run(u->r, &c, &(struct layer_out){.out = out, .ldo = NET_COMPLETE_OUT});
    return e ? e
             : finite_check(u->r, "complete.out", FINITE_MAX, out,
                            pixel_count(from) * NET_COMPLETE_OUT);
}

static struct unet unet_of(const struct net *net, const struct complete_in *in)
{
    struct unet u = {.w = &net->complete, .floats = net->floats & NET_FLOAT_HEADS};
    for (int l = 0; l < NET_COMPLETE; l++) {
        const struct layer_conv c = down_conv(&u, in, l);
        u.level[l] = (struct level){.h = conv_size(c.h, c.kh, c.stride, c.pad),
                                    .w = conv_size(c.w_px, c.kw, c.stride, c.pad),
                                    .c = c.w->n};
    }
    return u;
}

static err_t layout(struct unet *u, struct arena *tmp)
{
    size_t most = 0;
    err_t e = OK;
    for (int l = 0; l < NET_COMPLETE && !e; l++) {
        struct level *at = u->level + l;
        const size_t n = pixel_count(at);
        if (l > 0 && most < n * (size_t)at[-1].c)
            most = n * (size_t)at[-1].c;
        e = arena_alloc(tmp, n * (size_t)at->c, sizeof *at->px, &at->px);
        if (!e)
            e = arena_alloc(tmp, n * (size_t)at->c, sizeof *at->room, &at->room);
    }
    return e ? e : arena_alloc(tmp, most, sizeof *u->up, &u->up);
}

void complete_plan(struct plan *p, const struct net *net, const struct complete_in *in)
{
    struct unet u = unet_of(net, in);
    const size_t mark = arena_mark(&p->tmp);
    if (layout(&u, &p->tmp))
        plan_refuse(p);
    for (int l = 0; l < NET_COMPLETE; l++) {
        const bool coarsest = l == NET_COMPLETE - 1;
        const struct layer_conv down = down_conv(&u, in, l);
        const struct layer_conv same = level_conv(&u, coarsest ? u.w->stay[l] : u.w->join + l, l);
        layer_conv_plan(p, &down);
        layer_conv_plan(p, &same); // all of a level are alike
        if (!coarsest)
            layer_plan(p, u.level[l + 1].c);
    }
    const struct layer_conv out = level_conv(&u, &u.w->out, 0);
    layer_conv_plan(p, &out);
    arena_reset(&p->tmp, mark);
}

err_t complete_run(const struct run *r, const struct net *net, const struct complete_in *in,
                   float *out)
{
    struct unet u = unet_of(net, in);
    const size_t mark = arena_mark(r->tmp);
    u.r = r;
    err_t e = layout(&u, r->tmp);
    for (int l = 0; l < NET_COMPLETE && !e; l++)
        e = go_down(&u, in, l);
    for (int l = NET_COMPLETE - 2; l >= 0 && !e; l--)
        e = go_up(&u, l);
    if (!e)
        e = go_out(&u, out);
    arena_reset(r->tmp, mark);
    return e;
}
