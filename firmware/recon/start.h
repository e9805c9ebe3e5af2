/* start.h - cameras and the first Gaussians of a scene, by stereo or by the network. Steps of
 * job.c. */
#ifndef RECON_START_H
#define RECON_START_H

#include "firmware/recon/job.h"

/* Memory of start_run, with a pool of `threads`, and of drawing its result. Of v only its sizes are
 * looked at, and whether it has cameras. tapped: run.tap is set. */
struct job_memory start_plan(const struct job_config *asked, const struct views *v, int threads,
                             bool tapped);

/* Refuse before the work what start_run could not do: more views than cameras can be found for, or
 * views too small for that. Of v as start_plan.
 * err:  ERR_ARG. */
MUST_USE err_t start_check(const struct job_config *asked, const struct views *v, bool tapped);

/* From out->views and out->response to out->scene, ready for refinement; its Gaussians have room
 * for cfg->refine.gaussians_max unless there is no refinement. Cameras that
 * were not known become out->views.cams too. Times go to *out.
 * err:  those of the steps. */
MUST_USE err_t start_run(const struct run *r, const struct job_config *cfg, struct job_result *out);

#endif
