/* Everything that decides how a refinement goes on, in one order for both ways. Numbers are
 * little-endian, as they lie in memory. What follows from the input is not part of it: the input
 * itself is, as three hashes. Where a team works, rank 0 saves and reads, and tells the others. */
#include "core/refine/refine_inner.h"

#include "core/base/bytes.h"
#include "core/base/gaussians.h"
#include "core/photo/shade.h"
#include "core/refine/part.h"

#include <string.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are copied as they are");

/* ---- the input ---- */

static void add_int(struct sha256 *s, int v)
{
    sha256_add(s, &v, sizeof v);
}

static void hash_options(const struct refine *f, struct refine_input *out)
{
    const struct refine_config *c = f->cfg;
    struct sha256 s;
    sha256_init(&s);
    add_int(&s, c->steps);
    add_int(&s, c->degree_max);
    add_int(&s, c->gaussians_max);
    sha256_add(&s, &c->seed, sizeof c->seed);
    add_int(&s, c->poses);
    add_int(&s, c->tone_known);
    add_int(&s, c->levels);
    add_int(&s, team_size(f->r->team));
    sha256_add(&s, f->r->k->name, strlen(f->r->k->name));
    sha256_hex(&s, out->options);
}

static void hash_photographs(const struct views *v, struct refine_input *out)
{
    const int n = v->n + v->n_more;
    const size_t values = 3 * extent_total(v->extent, n);
    struct sha256 s;
    sha256_init(&s);
    for (int i = 0; i < n; i++) {
        add_int(&s, v->extent[i].w);
        add_int(&s, v->extent[i].h);
        add_int(&s, i < v->n ? i : v->place[i - v->n]);
    }
    sha256_add(&s, v->log2t, (size_t)n * sizeof *v->log2t);
    if (v->masked)
        sha256_add(&s, v->masked, values / 3);
    if (v->deep)
        sha256_add(&s, v->rgb16, values * sizeof *v->rgb16);
    else
        sha256_add(&s, v->rgb, values);
    sha256_hex(&s, out->photographs);
}

static void hash_start(const struct refine *f, struct refine_input *out)
{
    const struct scene *scene = f->s;
    struct sha256 s;
    sha256_init(&s);
    for (int p = 0; p < gaussians_planes(scene->g.degree); p++)
        sha256_add(&s, scene->g.plane[p], (size_t)scene->g.n * sizeof(float));
    sha256_add(&s, &scene->tone, sizeof scene->tone);
    sha256_add(&s, scene->background, sizeof scene->background);
    sha256_add(&s, scene->cams, (size_t)f->v->n * sizeof *scene->cams);
    for (int i = 0; f->v->shade && i < f->v->n; i++) {
        sha256_add(&s, f->v->shade[i].r2, sizeof f->v->shade[i].r2);
        sha256_add(&s, &f->v->shade[i].model, sizeof f->v->shade[i].model);
    }
    sha256_hex(&s, out->start);
}

static struct refine_input hash_input(const struct refine *f)
{
    struct refine_input out;
    hash_options(f, &out);
    hash_photographs(f->v, &out);
    hash_start(f, &out);
    return out;
}

/* ---- the state ---- */

struct passage {
    struct refine *f;
    bool load;
    struct bytes in; // of rank 0
    err_t e;
};

static err_t refuse_damaged(void)
{
    return err_fail(ERR_FORMAT, "the checkpoint is damaged: start without --resume");
}

static void pass(struct passage *p, void *at, size_t n)
{
    struct team *t = p->f->r->team;
    if (p->e || n == 0)
        return;
    if (!p->load) {
        p->f->cfg->saver->put(p->f->cfg->saver->ctx, at, n);
        return;
    }
    const uint8_t *from = team_rank(t) == 0 ? bytes_take(&p->in, n) : NULL;
    if (from)
        memcpy(at, from, n);
    p->e = p->in.bad ? refuse_damaged() : team_copy(t, at, n);
}

/* lo..hi: what a state may hold. */
static void pass_int(struct passage *p, int *v, int lo, int hi)
{
    pass(p, v, sizeof *v);
    if (!p->e && (*v < lo || *v > hi))
        p->e = refuse_damaged();
}

static void pass_bool(struct passage *p, bool *v)
{
    int n = *v;
    pass_int(p, &n, 0, 1);
    *v = n == 1;
}

static void pass_float(struct passage *p, float *v)
{
    pass(p, v, sizeof *v);
}

static void pass_input(struct passage *p)
{
    struct refine_input *have = &p->f->input, was = *have;
    pass(p, &was, sizeof was);
    if (p->e || team_rank(p->f->r->team) > 0)
        return;
    if (memcmp(was.photographs, have->photographs, sizeof was.photographs) != 0)
        p->e = err_fail(ERR_ARG, "the checkpoint is of other photographs or of another --size: "
                                 "start without --resume");
    else if (memcmp(was.options, have->options, sizeof was.options) != 0)
        p->e = err_fail(ERR_ARG, "the checkpoint is of a job with other options, on another kind "
                                 "of processor, or on another number of boards: start without "
                                 "--resume");
    else if (memcmp(was.start, have->start, sizeof was.start) != 0)
        p->e = err_fail(ERR_ARG, "the checkpoint is of a job that began with other cameras, "
                                 "Gaussians or tone curves, by other options or calibrations: "
                                 "start without --resume");
}

/* Sums depend on how the work was dealt, by speeds that are measured again in every run. */
static void pass_shares(struct passage *p)
{
    struct team *t = p->f->r->team;
    for (int i = 0; t && i < t->size; i++)
        pass_int(p, &t->share[i], 1, TEAM_SHARE_MAX);
}

static void pass_counters(struct passage *p)
{
    struct refine *f = p->f;
    pass_int(p, &f->steps, 0, f->cfg->steps);
    pass_int(p, &f->step, 0, f->steps);
    pass_int(p, &f->level, 0, f->levels - 1);
    pass_int(p, &f->n_drawn, 0, f->v->n);
    pass_int(p, &f->band_from, 0, f->step);
    pass_int(p, &f->splits_vain, -1, f->step);
    pass_int(p, &f->measured, 0, f->step);
    pass_int(p, &f->stalled, 0, f->step);
    pass_int(p, &f->best.step, 0, f->step);
    pass_bool(p, &f->bands_done);
    pass_bool(p, &f->splits_done);
    pass(p, &f->rng, sizeof f->rng);
    pass_float(p, &f->loss);
    pass_float(p, &f->noise_db);
    pass_float(p, &f->best_db);
    pass_float(p, &f->split_db);
    pass_float(p, &f->best.db);
}

static void pass_report(struct passage *p)
{
    struct refine_report *rep = p->f->rep;
    pass_int(p, &rep->steps, 0, p->f->step);
    pass_bool(p, &rep->stopped_early);
    pass_float(p, &rep->loss);
    pass(p, rep->held_out_db, sizeof rep->held_out_db);
    pass_int(p, &rep->n_notes, 0, REFINE_NOTES);
    pass(p, rep->notes, sizeof rep->notes);
    for (int i = 0; i < REFINE_NOTES; i++)
        rep->notes[i][sizeof rep->notes[i] - 1] = 0;
}

static void pass_views(struct passage *p)
{
    struct refine *f = p->f;
    const size_t n = (size_t)f->v->n, photos = n + (size_t)f->v->n_more;
    pass(p, f->sums, photos * refine_squares(f) * sizeof *f->sums);
    pass(p, f->outliers.score, photos * outliers_cells(&f->outliers) * sizeof *f->outliers.score);
    pass(p, f->outliers.skip, photos * outliers_cells(&f->outliers));
    pass(p, f->pose_m, 12 * n * sizeof *f->pose_m);
    for (int i = 0; i < f->v->n; i++)
        pass_int(p, &f->pose_t[i], 0, f->step * PART_DRAWS);
    for (int i = 0; i < f->v->n; i++)
        pass_int(p, &f->shuffled[i], 0, f->v->n - 1);
}

static void pass_tone(struct passage *p, struct tonemap *t)
{
    float sum = 0;
    pass(p, t->p, sizeof t->p);
    pass_float(p, &t->mid_log2t);
    for (int i = 0; i < TONE_PARAMS; i++)
        sum += t->p[i] * 0.0f;
    if (!p->e && !(sum + t->mid_log2t * 0.0f == 0.0f))
        p->e = refuse_damaged();
}

/* Their sizes in pixels follow from the views. */
static void pass_cameras(struct passage *p, struct camera *cams)
{
    for (int i = 0; i < p->f->v->n; i++) {
        cams[i].w = p->f->s->cams[i].w;
        cams[i].h = p->f->s->cams[i].h;
        pass_float(p, &cams[i].fx);
        pass_float(p, &cams[i].fy);
        pass_float(p, &cams[i].cx);
        pass_float(p, &cams[i].cy);
        pass(p, cams[i].q, sizeof cams[i].q);
        pass(p, cams[i].t, sizeof cams[i].t);
    }
}

static void pass_counts(struct passage *p, struct gaussians *g)
{
    pass_int(p, &g->n, 0, p->f->cfg->gaussians_max);
    pass_int(p, &g->degree, 0, p->f->cfg->degree_max);
}

static void pass_planes(struct passage *p, const struct gaussians *like, float *const *plane)
{
    for (int i = 0; i < gaussians_planes(like->degree); i++)
        pass(p, plane[i], (size_t)like->n * sizeof(float));
}

static void pass_best(struct passage *p)
{
    struct best *b = &p->f->best;
    if (p->e || b->step == 0)
        return;
    pass_tone(p, &b->tone);
    pass_cameras(p, b->cams);
    pass_counts(p, &b->g);
    if (!p->e)
        pass_planes(p, &b->g, b->g.plane);
}

static void pass_scene(struct passage *p)
{
    struct refine *f = p->f;
    struct gaussians *g = &f->s->g;
    pass_tone(p, &f->s->tone);
    pass(p, f->tone_m1, sizeof f->tone_m1);
    pass(p, f->tone_m2, sizeof f->tone_m2);
    pass_cameras(p, f->s->cams);
    pass_counts(p, g);
    if (p->e)
        return;
    pass_planes(p, g, g->plane);
    pass_planes(p, g, f->d.m1);
    pass_planes(p, g, f->d.m2);
    pass(p, f->d.score, (size_t)g->n * sizeof *f->d.score);
}

static void pass_all(struct passage *p)
{
    pass_input(p);
    pass_shares(p);
    pass_counters(p);
    pass_report(p);
    pass_views(p);
    pass_scene(p);
    pass_best(p);
    if (!p->e && p->in.left > 0)
        p->e = refuse_damaged();
}

/* ---- for refine.c ---- */

err_t refine_state_begin(struct refine *f, bool *resumed)
{
    const struct refine_saver *s = f->cfg->saver;
    int go_on = s && s->state;
    if (s)
        f->input = hash_input(f);
    err_t e = team_copy(f->r->team, &go_on, sizeof go_on);
    *resumed = go_on;
    return e;
}

err_t refine_state_load(struct refine *f)
{
    struct passage p = {.f = f, .load = true};
    if (team_rank(f->r->team) == 0)
        p.in = bytes_of(f->cfg->saver->state, f->cfg->saver->bytes);
    pass_all(&p);
    return p.e;
}

err_t refine_state_keep(struct refine *f)
{
    const struct refine_saver *s = f->cfg->saver;
    const bool ends = f->r->cancel && atomic_load(f->r->cancel);
    struct passage p = {.f = f};
    if (s && s->begin(s->ctx, f->step, ends)) {
        pass_all(&p);
        s->end(s->ctx);
    }
    return ends ? err_fail(ERR_CANCELLED, "refine: cancelled") : OK;
}
