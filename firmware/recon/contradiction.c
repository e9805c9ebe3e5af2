#include "firmware/recon/contradiction.h"

#include "core/stereo/contradict.h"

enum { NAMED = 8 }; // views, at most

static void warn_of_views(const struct views *v, const struct contradict *c, struct job_result *out)
{
    for (int i = 0; i < v->n; i++)
        if (c->wrong[i])
            job_result_warn(out,
                            "%.64s seems to be at a wrong place: %.0f %% of what the others have "
                            "there contradicts it, as where parts of a scene look alike; leave it "
                            "out, or take more photographs between",
                            v->names[i], (double)(100 * c->of_view[i]));
}

/* Nothing tells the right ones. */
static void warn_of_scene(const struct views *v, const struct contradict *c, struct job_result *out)
{
    int worst = 0;
    for (int i = 1; i < v->n; i++)
        worst = c->of_view[i] > c->of_view[worst] ? i : worst;
    job_result_warn(out,
                    "photographs contradict each other's places (%.64s in %.0f %%): where parts of "
                    "a scene look alike, one was taken for another; take more between, with more "
                    "of what is behind, or give --rig PATH",
                    v->names[worst], (double)(100 * c->of_view[worst]));
}

err_t contradiction_run(const struct run *r, const struct views *v, const struct tonemap *tone,
                        const struct depthmaps *d, struct job_result *out)
{
    struct contradict c;
    const size_t mark = arena_mark(r->tmp);
    err_t e = contradict_run(r, v, tone, d, &c);
    if (!e && (c.median > CONTRADICT_MEDIAN || c.n_wrong > NAMED || 2 * c.n_wrong >= v->n))
        warn_of_scene(v, &c, out);
    else if (!e)
        warn_of_views(v, &c, out);
    arena_reset(r->tmp, mark);
    return e;
}
