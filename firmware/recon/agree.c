#include "firmware/recon/agree.h"

#include "core/base/sha256.h"

#include <stdio.h>
#include <string.h>

static err_t compare(struct team *t, struct sha256 *mine, const char *what)
{
    static char hash[TEAM_MAX][SHA256_HEX_CAP];
    sha256_hex(mine, hash[t->rank]);
    err_t e = team_collect(t, hash, sizeof *hash);
    for (int i = 1; i < t->size && !e; i++)
        if (strcmp(hash[i], hash[0]) != 0)
            e = err_fail(ERR_ARG, "rank %d has other %s than rank 0", i, what);
    return e;
}

err_t agree_views(const struct run *r, const struct views *v)
{
    struct sha256 h;
    const int n = v->n + v->n_more;
    const size_t px = extent_total(v->extent, n);
    if (!r->team)
        return OK;
    sha256_init(&h);
    sha256_add(&h, v->rgb, 3 * px);
    if (v->masked)
        sha256_add(&h, v->masked, px);
    if (v->rgb16)
        sha256_add(&h, v->rgb16, 3 * px * sizeof *v->rgb16);
    sha256_add(&h, v->log2t, (size_t)n * sizeof *v->log2t);
    return compare(r->team, &h, "photographs or exposures");
}

err_t agree_scene(const struct run *r, const struct scene *s, const char *when)
{
    struct sha256 h;
    char what[64];
    if (!r->team)
        return OK;
    sha256_init(&h);
    sha256_add(&h, s->cams, (size_t)s->n_views * sizeof *s->cams);
    for (int p = 0; p < gaussians_planes(s->g.degree); p++)
        sha256_add(&h, s->g.plane[p], (size_t)s->g.n * sizeof *s->g.plane[p]);
    sha256_add(&h, s->tone.p, sizeof s->tone.p);
    snprintf(what, sizeof what, "numbers %s", when);
    return compare(r->team, &h, what);
}
