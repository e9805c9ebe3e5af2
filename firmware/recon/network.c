#include "firmware/recon/network.h"

#include "firmware/base/engine.h"

#include "core/base/num.h"
#include "core/photo/prep.h"
#include "core/sfm/pose.h"

#include <string.h>

err_t network_open(const char *path, const char *precision, unsigned floats, struct network *out)
{
    memset(out, 0, sizeof *out);
    err_t e = modelfile_open(path, &out->file);
    if (e)
        return e;
    const char *have = modelfile_precision(out->file.model.precision);
    if (precision && strcmp(precision, have) != 0)
        e = err_fail(
            ERR_ARG,
            "%s holds %s weights, --precision %.16s was requested; hdrig convert --precision "
            "%.16s makes a file of them",
            path, have, precision, precision);
    if (!e && out->file.model.dims.lpips != LPIPS_NONE)
        e = err_fail(ERR_ARG,
                     "%s holds weights of LPIPS, for hdrig eval --lpips, not of a network "
                     "that finds scenes",
                     path);
    if (!e)
        e = net_bind(&out->file.model, floats, &out->net);
    if (e)
        network_close(out);
    return e;
}

void network_close(struct network *n)
{
    modelfile_close(&n->file);
    memset(n, 0, sizeof *n);
}

bool network_needs_exposures(const struct network *n)
{
    return n->net.d.appearance;
}

/* ---- time ---- */

void network_clock_stop(struct network_clock *c)
{
    const double now = engine_seconds(), busy = engine_busy_seconds();
    if (c->n > 0) {
        c->stage[c->n - 1].seconds += now - c->last;
        c->stage[c->n - 1].busy += busy - c->last_busy;
    }
    c->last = now;
    c->last_busy = busy;
}

void network_clock_skip(struct network_clock *c, double seconds, double busy)
{
    c->last += seconds;
    c->last_busy += busy;
}

/* Stages follow one another; one that comes again is moved to the end of the list. */
static void enter_stage(struct network_clock *c, const char *name)
{
    int i = 0;
    while (i < c->n && strcmp(c->stage[i].name, name) != 0)
        i++;
    if (i == NETWORK_STAGES)
        return;
    if (i == c->n) {
        snprintf(c->stage[i].name, sizeof c->stage[i].name, "%s", name);
        c->stage[i].seconds = c->stage[i].busy = 0;
        c->n++;
        return;
    }
    for (; i + 1 < c->n; i++) {
        struct network_stage swap = c->stage[i];
        c->stage[i] = c->stage[i + 1];
        c->stage[i + 1] = swap;
    }
}

static void timed_step(void *ctx, const char *stage, int done, int total, const char *note)
{
    struct network_clock *c = ctx;
    if (done == 0) { // it begins: the time before was another's
        network_clock_stop(c);
        enter_stage(c, stage);
    } else { // it has done something
        enter_stage(c, stage);
        network_clock_stop(c);
    }
    if (c->next)
        c->next(c->next_ctx, stage, done, total, note);
}

struct run network_timed(const struct run *r, struct network_clock *clock)
{
    struct run out = *r;
    *clock = (struct network_clock){.next = r->progress,
                                    .next_ctx = r->progress_ctx,
                                    .last = engine_seconds(),
                                    .last_busy = engine_busy_seconds()};
    out.progress = timed_step;
    out.progress_ctx = clock;
    return out;
}

static struct network_stage sum_of(const struct network_clock *c, const char *const *names)
{
    struct network_stage sum = {.seconds = 0};
    for (; *names; names++)
        for (int i = 0; i < c->n; i++)
            if (strcmp(c->stage[i].name, *names) == 0) {
                sum.seconds += c->stage[i].seconds;
                sum.busy += c->stage[i].busy;
            }
    return sum;
}

double network_seconds(const struct network_clock *c, const char *const *names)
{
    return sum_of(c, names).seconds;
}

double network_busy(const struct network_clock *c, const char *const *names)
{
    return sum_of(c, names).busy;
}

bool network_shipped(char path[FILE_PATH_CAP])
{
    return file_of_program("../share/hdrig/small.hdrig", path) ||
           file_of_program("../small.hdrig", path);
}

/* ---- cameras alone ---- */

static struct net geometry_of(const struct network *n, bool attend)
{
    struct net net = n->net;
    net.d.gauss = false;
    net.attend = attend;
    return net;
}

static int small_size(const struct network *n, int size)
{
    return size < n->net.d.size ? size / NET_PATCH * NET_PATCH : n->net.d.size;
}

/* Whether the views are what the network asks for: squares of `size` px. */
static bool takes_views(const struct views *v, int size)
{
    bool square = true;
    for (int i = 0; i < v->n; i++)
        square = square && v->extent[i].w == size && v->extent[i].h == size;
    return square;
}

/* The views as photographs, to be resized. */
static struct shot shot_of(const struct views *v, int i)
{
    const struct extent *px = &v->extent[i];
    struct shot s = {.image = {px->w, px->h, 3, NULL}, .exposure = 1};
    s.image.px = v->rgb ? views_rgb(v, i) : NULL;
    memcpy(s.name, v->names ? v->names[i] : "", v->names ? NAME_CAP : 1);
    return s;
}

static err_t layout_shots(struct capture *c, struct arena *keep, int n_views)
{
    c->n = n_views;
    return arena_alloc(keep, (size_t)n_views, sizeof *c->shots, &c->shots);
}

static err_t reduce_views(const struct run *r, const struct views *v, int size, struct views *out)
{
    struct capture c;
    err_t e = layout_shots(&c, r->keep, v->n);
    for (int i = 0; i < v->n && !e; i++)
        c.shots[i] = shot_of(v, i);
    if (!e)
        e = prep_run(r, &c, (struct prep_size){size, true}, out);
    if (!e) {
        out->log2t = v->log2t;
        out->mid_log2t = v->mid_log2t;
    }
    return e;
}

err_t network_look(const struct run *r, const struct network *n, bool attend, const struct views *v,
                   struct prediction *out)
{
    const int size = small_size(n, v->size);
    const struct net net = geometry_of(n, attend);
    struct views small = *v;
    err_t e = takes_views(v, size) ? OK : reduce_views(r, v, size, &small);
    if (!e)
        e = net_run(r, &net, &small, out);
    for (int i = 0; i < v->n && !e; i++)
        out->geom.cams[i] = pose_scaled(&out->geom.cams[i], v->extent[i].w, v->extent[i].h);
    return e;
}

void network_look_plan(struct plan *p, const struct network *n, bool attend, const struct views *v)
{
    const int size = small_size(n, v->size);
    const struct net net = geometry_of(n, attend);
    struct capture c;
    if (!takes_views(v, size)) {
        const struct extent most = extent_cover(v->extent, v->n);
        if (layout_shots(&c, &p->keep, v->n))
            plan_refuse(p);
        prep_plan(p, v->n, (size_t)v->n * (size_t)size * (size_t)size,
                  (struct image8){.w = most.w, .h = most.h}, size);
    }
    net_plan(p, &net, v->n, size);
}
