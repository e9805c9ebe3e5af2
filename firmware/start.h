/* start.h - the first Gaussians of a scene: by stereo from known cameras, or by the network. Steps
 * of job.c. */
#ifndef FIRMWARE_START_H
#define FIRMWARE_START_H

#include "firmware/job.h"

/* Memory of start_run, with a pool of `threads`, and of drawing its result. tapped: run.tap is
 * set. */
struct job_memory start_plan(const struct job_config *cfg, int n_views, int threads, bool tapped);

/* From out->views and out->response to out->scene, ready for refinement; its Gaussians have room
 * for cfg->refine.gaussians_max unless there is no refinement. Without known cameras those of the
 * network become out->views.cams too. Times go to *out.
 * err:  those of the steps. */
MUST_USE err_t start_run(const struct run *r, const struct job_config *cfg, struct job_result *out);

#endif
