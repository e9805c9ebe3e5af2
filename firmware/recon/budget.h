/* budget.h - size of the views and seconds of refinement for a job that must end in time. */
#ifndef RECON_BUDGET_H
#define RECON_BUDGET_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/recipe.h"

/* Choose once the first Gaussians are there, if cfg->budget_s > 0: the largest views, up to the
 * recipe's, for which BUDGET_STEPS steps of refinement are expected to fit, not smaller than the
 * views of depth; with cfg->size_fixed, the recipe's. The speed of the machine is that of depth.
 * out:  *recipe, with the seconds of refinement, as many steps as fit into which are done;
 *       *sentence about it in done->budget.
 * err:  those of team_copy: the first rank of a team chooses. */
enum { BUDGET_STEPS = 300 };
MUST_USE err_t budget_choose(const struct run *r, const struct capture *c,
                             const struct job_config *cfg, struct recipe *recipe,
                             struct job_result *done);

#endif
