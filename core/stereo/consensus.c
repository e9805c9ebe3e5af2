#include "core/stereo/consensus.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

struct consensus {
    const struct visibility *s;
    int size; // px of a view
    size_t pixels;
    const float *guess; // (n, pixels)
    float *out;         // (n, pixels)
    float *seen; // (workers, n, pixels) depth of the nearest point; negative: confirmed; 0: none
    float *vote; // (workers, 2, n)
};

static bool is_depth(float z)
{
    return isfinite(z) && z > 0;
}

/* Project the depths of view j into view i. */
static void project_view(const struct consensus *c, int j, int i, float *seen)
{
    for (size_t k = 0; k < c->pixels; k++) {
        const float u = (float)(k % (size_t)c->size) + 0.5f;
        const float v = (float)(k / (size_t)c->size) + 0.5f;
        const size_t at = visibility_index(c->s, j, u, v);
        const bool sure = visibility_confident(c->s, at);
        const float z = sure ? c->s->depth->depth[at] : c->guess[(size_t)j * c->pixels + k];
        struct projected there;
        float point[3];
        if (!is_depth(z))
            continue;
        visibility_unproject(c->s, j, (const float[3]){u, v, z}, point);
        if (!visibility_project(c->s, i, point, &there))
            continue;
        float *nearest = &seen[(size_t)there.v * (size_t)c->size + (size_t)there.u];
        if (*nearest == 0 || there.z < fabsf(*nearest))
            *nearest = sure ? -there.z : there.z;
    }
}

/* votes: (2, n) scratch. */
static float median_vote(const struct consensus *c, const float *seen, float own, float *votes)
{
    const int views = c->s->depth->n;
    float *all = votes, *sure = votes + views;
    size_t n = 0, m = 0;
    all[n++] = own;
    for (int j = 0; j < views; j++) {
        const float z = seen[(size_t)j * c->pixels];
        if (z < 0)
            sure[m++] = -z;
        else if (z > 0)
            all[n++] = z;
    }
    return m ? num_median(sure, m) : num_median(all, n);
}

static err_t vote_view(void *ctx, int view, int worker)
{
    const struct consensus *c = ctx;
    const size_t n = (size_t)c->s->depth->n, first = (size_t)view * c->pixels;
    float *seen = c->seen + (size_t)worker * n * c->pixels;
    memset(seen, 0, n * c->pixels * sizeof *seen);
    for (int j = 0; j < (int)n; j++)
        if (j != view)
            project_view(c, j, view, seen + (size_t)j * c->pixels);
    for (size_t k = 0; k < c->pixels; k++) {
        const float own = c->guess[first + k];
        const size_t at = visibility_index(c->s, view, (float)(k % (size_t)c->size) + 0.5f,
                                           (float)(k / (size_t)c->size) + 0.5f);
        if (visibility_confident(c->s, at))
            c->out[first + k] = c->s->depth->depth[at];
        else
            c->out[first + k] =
                is_depth(own) ? median_vote(c, seen + k, own, c->vote + 2 * n * (size_t)worker)
                              : own;
    }
    return OK;
}

static err_t layout(struct consensus *c, struct arena *tmp, int n_views, int size, int threads)
{
    const size_t n = (size_t)n_views, workers = (size_t)threads;
    c->size = size;
    c->pixels = (size_t)size * (size_t)size;
    err_t e = arena_alloc(tmp, n * c->pixels, sizeof *c->out, &c->out);
    if (!e)
        e = arena_alloc(tmp, workers * n * c->pixels, sizeof *c->seen, &c->seen);
    return e ? e : arena_alloc(tmp, workers * n, 2 * sizeof *c->vote, &c->vote);
}

size_t consensus_plan(int n_views, int size, int threads)
{
    struct arena tmp = arena_counter();
    struct consensus c;
    return layout(&c, &tmp, n_views, size, threads) ? SIZE_MAX : tmp.peak;
}

err_t consensus_run(const struct run *r, const struct visibility *s, float *depth)
{
    const size_t n = (size_t)s->depth->n, mark = arena_mark(r->tmp);
    struct consensus c = {.s = s, .guess = depth};
    err_t e = layout(&c, r->tmp, s->depth->n, s->cams[0].w, pool_size(r->pool));
    if (!e)
        e = pool_for(r->pool, (int)n, vote_view, &c);
    if (!e)
        memcpy(depth, c.out, n * c.pixels * sizeof *depth);
    arena_reset(r->tmp, mark);
    return e;
}
