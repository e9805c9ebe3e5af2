#include "firmware/recon/rigsight.h"

#include "core/base/lin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double FARTHEST = 100; // depths of the board: farther points tell nothing of lengths

/* Where a view shows something, in the photograph; false outside its lens. */
static bool set_sight(const struct boardcal *in, const struct boardcal_result *b,
                      const struct rigsight_view *view, const struct match_observation *o,
                      struct boardfit_sight *out)
{
    const struct rigsight_view *v = &view[o->view];
    const struct lens *l = &b->lens[in->lens_of[o->view]];
    const double ray[3] = {((double)o->u - 0.5 * v->w) / v->focal,
                           ((double)o->v - 0.5 * v->h) / v->focal, 1};
    out->camera = o->view;
    out->sigma = (double)o->sigma * l->fx / v->focal;
    return lens_project(l, ray, out->px);
}

/* The point nearest to the rays of n sights; false where they are parallel. */
static bool meet_rays(const struct boardcal *in, const struct boardcal_result *b,
                      const struct boardfit_sight *s, int n, double out[3])
{
    double h[9] = {0}, g[3] = {0}, inverse[9];
    for (int i = 0; i < n; i++) {
        const double *pose = b->pose[s[i].camera];
        double ray[3], d[3], c[3];
        if (!lens_unproject(&b->lens[in->lens_of[s[i].camera]], s[i].px, ray))
            return false;
        lin_apply_t(pose, ray, d);
        lin_apply_t(pose, pose + 9, c);
        for (int k = 0; k < 3; k++)
            for (int m = 0; m < 3; m++) {
                const double p = (k == m) - d[k] * d[m];
                h[3 * k + m] += p;
                g[k] -= p * c[m];
            }
    }
    if (!lin_inverse3(h, inverse))
        return false;
    lin_apply(inverse, g, out);
    return isfinite(out[0]) && isfinite(out[1]) && isfinite(out[2]);
}

/* Whether all sights agree with a point that is not too far. */
static bool agrees(const struct boardfit *f, const struct boardcal_result *b,
                   const struct boardfit_sight *s, int n, const double at[3])
{
    for (int i = 0; i < n; i++) {
        const double *pose = b->pose[s[i].camera];
        const double depth = lin_dot(pose + 6, at) + pose[11];
        double e[2];
        if (!boardfit_sight_error(f, &s[i], at, e) || hypot(e[0], e[1]) > RIGSIGHT_GATE ||
            depth > FARTHEST * b->depth[s[i].camera])
            return false;
    }
    return true;
}

static err_t allocate(const struct match_tracks *t, struct rigsight *out)
{
    const size_t n = (size_t)t->n + 1, tracks = (size_t)t->n_tracks + 1;
    memset(out, 0, sizeof *out);
    out->sight = malloc(n * sizeof *out->sight);
    out->first = calloc(tracks, sizeof *out->first);
    out->points.at = malloc(tracks * sizeof *out->points.at);
    out->points.first = out->first;
    out->points.sight = out->sight;
    return out->sight && out->first && out->points.at
               ? OK
               : err_fail(ERR_NOMEM, "no memory for %d points", t->n_tracks);
}

err_t rigsight_make(const struct boardcal *in, const struct boardcal_result *b,
                    const struct rigsight_view *view, const struct match_tracks *t,
                    struct rigsight *out)
{
    struct boardcal_result found = *b; // only read through the fit
    const struct boardfit f = {
        .lens_of = in->lens_of, .lens = found.fit, .pose = found.pose, .board = found.board};
    err_t e = allocate(t, out);
    for (int i = 0, n; i < t->n && !e; i += n) {
        struct boardfit_points *p = &out->points;
        struct boardfit_sight *s = out->sight + out->first[p->n];
        int seen = 0;
        for (n = 0; i + n < t->n && t->obs[i + n].track == t->obs[i].track; n++)
            seen += seen < BOARDFIT_SEEN && set_sight(in, b, view, &t->obs[i + n], &s[seen]);
        if (seen < 2 || !meet_rays(in, b, s, seen, p->at[p->n]) ||
            !agrees(&f, b, s, seen, p->at[p->n]))
            continue;
        out->first[p->n + 1] = out->first[p->n] + seen;
        p->n++;
    }
    return e;
}

void rigsight_free(struct rigsight *s)
{
    free(s->sight);
    free(s->first);
    free(s->points.at);
    memset(s, 0, sizeof *s);
}
