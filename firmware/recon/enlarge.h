/* enlarge.h - the views of a job at another size: the same photographs, read once more. */
#ifndef RECON_ENLARGE_H
#define RECON_ENLARGE_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/recipe.h"

/* out->views, no squares, and the cameras of out->scene become those of `edge` px; through the
 * lenses that were found.
 * c:    the shots of the job.
 * err:  those of prep_read. */
MUST_USE err_t enlarge_run(const struct run *r, const struct capture *c,
                           const struct job_config *cfg, int edge, struct job_result *out);

/* Count what it takes: views of all shots. */
void enlarge_plan(struct plan *p, const struct capture *c, const struct prep_source *from,
                  int edge);

#endif
