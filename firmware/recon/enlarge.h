/* enlarge.h - from the views that cameras and depth were found in to those of refinement: the same
 * photographs, read once more at the size that was asked for. */
#ifndef RECON_ENLARGE_H
#define RECON_ENLARGE_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/recipe.h"

/* out->views and the cameras of out->scene become larger; through the lenses that were found.
 * c:    the shots of the job.
 * err:  those of prep_read. */
MUST_USE err_t enlarge_run(const struct run *r, const struct capture *c,
                           const struct job_config *cfg, const struct recipe *recipe,
                           struct job_result *out);

/* Count what it takes: views of all shots. */
void enlarge_plan(struct plan *p, const struct capture *c, const struct prep_source *from,
                  const struct recipe *recipe);

#endif
