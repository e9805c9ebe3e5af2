/* job.h - reconstruction of one capture, all steps.
 * Response curve; cameras, if they are not known, by the network and bundle adjustment; first
 * Gaussians by the network or by stereo; refinement. */
#ifndef RECON_JOB_H
#define RECON_JOB_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/recipe.h"
#include "firmware/result/report.h"

/* Memory of a job, before a pixel is decoded; the capture needs only names, sizes and cameras.
 * `c` is refused here if it cannot become a scene: fewer than two views, some cameras known and
 * some not, more views or smaller ones than cameras can be found for. threads, tapped, team: of the
 * run to come; a rank needs memory for its own part.
 * err:  ERR_ARG. */
MUST_USE err_t job_plan(const struct capture *c, const struct job_config *cfg, int threads,
                        bool tapped, const struct team *team, struct job_memory *out);

/* Reconstruct a scene from photographs. The arenas are as large as planned.
 * err:  those of the steps. On error only the times in *out are valid. */
MUST_USE err_t job_run(const struct run *r, const struct capture *c, const struct job_config *cfg,
                       struct job_result *out);

/* Write the members that every report has into an open object. threads: of the job's pool. */
void job_report(const struct job_result *j, int threads, struct report *rep);

#endif
