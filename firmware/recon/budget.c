/* The seconds that the plane sweep took for a pixel of a view are the unit: it is as bound to the
 * processor as rendering is. Measured in that unit on a room and a yard of 8 views at 448, 800 and
 * 1600 px, 100 to 1000 steps: README.md. */
#include "firmware/recon/budget.h"

#include "firmware/base/engine.h"

#include "core/base/num.h"

#include <math.h>
#include <stdio.h>

#define STEP_PIXEL 0.33  // units, of a step of refinement: for each pixel of its picture
#define STEP_SPLAT 0.17  // for each Gaussian
#define AFTER_PIXEL 1.0  // of confidence and results: for each pixel of all views
#define AFTER_WORK 0.85  // for each pixel of the views of depth

struct speed {
    double unit;   // s
    double before; // of reading the photographs again
    double left;   // of the job
};

static double pixels_of(const struct capture *c, const struct recipe *recipe, int size)
{
    return (double)recipe_pixels(c, (struct prep_size){size, recipe->square});
}

/* Seconds that remain for refinement. */
static double time_to_refine(const struct speed *s, const struct capture *c,
                             const struct recipe *recipe)
{
    const double px = pixels_of(c, recipe, recipe->size);
    const double work = pixels_of(c, recipe, recipe->work);
    const double before = recipe->size > recipe->work ? s->before : 0;
    return s->left - before - s->unit * (AFTER_PIXEL * px + AFTER_WORK * work);
}

/* Steps of which size are expected to fit. */
struct choice {
    int size;       // px
    double seconds; // for refinement
};

static int expect_steps(const struct speed *s, const struct capture *c, const struct recipe *recipe,
                        int splats)
{
    struct pace p = {.levels = recipe->refinement.levels};
    const double px = pixels_of(c, recipe, recipe->size) / recipe->places;
    for (int k = 0; k < p.levels; k++)
        p.seconds[k] = s->unit * (STEP_SPLAT * splats + STEP_PIXEL * ldexp(px, -2 * k));
    return pace_fit(&p, 0, recipe->refinement.steps, time_to_refine(s, c, recipe));
}

err_t budget_choose(const struct run *r, const struct capture *c, const struct job_config *cfg,
                    struct recipe *recipe, struct job_result *done)
{
    if (!(cfg->budget_s > 0))
        return OK;
    struct recipe best = *recipe;
    const struct speed s = {.left = cfg->budget_s - (engine_seconds() - done->start_s),
                            .before = done->seconds[JOB_PREPROCESS],
                            .unit = done->seconds[JOB_SWEEP] / pixels_of(c, recipe, recipe->work)};
    const int wanted = num_min(BUDGET_STEPS, recipe->refinement.steps);
    while (!cfg->size_fixed && s.unit > 0 && best.size > best.work &&
           expect_steps(&s, c, &best, done->scene.g.n) < wanted)
        best = recipe_with_size(recipe, c, cfg, num_max(best.work, best.size * 7 / 8));
    /* above 0: no time is not the same as any */
    best.refinement.seconds = fmax(time_to_refine(&s, c, &best), 1e-3);
    struct choice choice = {best.size, best.refinement.seconds};
    err_t e = team_copy(r->team, &choice, sizeof choice); // the clock of the first rank counts
    if (choice.size != recipe->size)
        *recipe = recipe_with_size(recipe, c, cfg, choice.size);
    recipe->refinement.seconds = choice.seconds;
    snprintf(done->budget, sizeof done->budget,
             "%.0f s in all: pictures of %d px, %.0f s for refinement", cfg->budget_s, recipe->size,
             recipe->refinement.seconds);
    return e;
}
