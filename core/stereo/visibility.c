#include "core/stereo/visibility.h"

#include "core/base/num.h"
#include "core/base/rotation.h"

#include <math.h>

static const float NEARER = 0.95f; // a surface hides points beyond its depth over this

err_t visibility_layout(struct visibility *s, struct arena *a, int n_views)
{
    return arena_alloc(a, (size_t)n_views, sizeof *s->rotation, &s->rotation);
}

void visibility_set(struct visibility *s, const struct depthmaps *depth, const struct camera *cams)
{
    s->depth = depth;
    s->cams = cams;
    for (int i = 0; i < depth->n; i++)
        rotation_from_unit(cams[i].q, s->rotation[i]);
}

size_t visibility_index(const struct visibility *s, int view, float u, float v)
{
    const struct depthmaps *m = s->depth;
    const struct extent *px = &m->extent[view];
    const int x = num_min((int)u / m->scale, px->w - 1), y = num_min((int)v / m->scale, px->h - 1);
    return px->at + (size_t)y * (size_t)px->w + (size_t)x;
}

void visibility_unproject(const struct visibility *s, int view, const float uvz[3], float out[3])
{
    const struct camera *c = &s->cams[view];
    const float *r = s->rotation[view];
    const float x[3] = {(uvz[0] - c->cx) / c->fx * uvz[2] - c->t[0],
                        (uvz[1] - c->cy) / c->fy * uvz[2] - c->t[1], uvz[2] - c->t[2]};
    for (int k = 0; k < 3; k++)
        out[k] = r[k] * x[0] + r[3 + k] * x[1] + r[6 + k] * x[2];
}

bool visibility_project(const struct visibility *s, int view, const float point[3],
                        struct projected *out)
{
    const struct camera *c = &s->cams[view];
    const float *r = s->rotation[view];
    float x[3];
    for (int k = 0; k < 3; k++)
        x[k] = r[3 * k] * point[0] + r[3 * k + 1] * point[1] + r[3 * k + 2] * point[2] + c->t[k];
    *out = (struct projected){c->fx * x[0] / x[2] + c->cx, c->fy * x[1] / x[2] + c->cy, x[2], 0};
    if (!(out->z > 0 && out->u >= 0 && out->v >= 0 && out->u < (float)c->w && out->v < (float)c->h))
        return false;
    out->at = visibility_index(s, view, out->u, out->v);
    return true;
}

bool visibility_confident(const struct visibility *s, size_t at)
{
    return s->depth->conf[at] >= SWEEP_CONF_CONFIRMED;
}

bool visibility_on_surface(const struct visibility *s, const struct projected *p)
{
    return visibility_confident(s, p->at) &&
           fabsf(s->depth->depth[p->at] - p->z) <= SWEEP_SAME_SURFACE * p->z;
}

bool visibility_in_front(const struct visibility *s, const struct projected *p)
{
    return visibility_confident(s, p->at) && s->depth->depth[p->at] * NEARER > p->z;
}

bool visibility_behind(const struct visibility *s, const struct projected *p)
{
    return visibility_confident(s, p->at) && s->depth->depth[p->at] < NEARER * p->z;
}
