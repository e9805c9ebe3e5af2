/* verify.h - the cameras of a calibrated rig against a take: the photographs tell which of them
 * have moved since. */
#ifndef RECON_VERIFY_H
#define RECON_VERIFY_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/recipe.h"
#include "firmware/result/report.h"

/* Count the memory of verify_run; of v only numbers and shapes are read. */
void verify_plan(struct plan *p, const struct views *v);

/* Check out->scene.cams against out->views and out->response; a warning names each camera that
 * moved. RECIPE_MOVED_SOLVE: the scene gets the cameras as they are found.
 * err:  ERR_ARG names a camera that moved (RECIPE_MOVED_REFUSE); ERR_NOMEM, ERR_CANCELLED. */
MUST_USE err_t verify_run(const struct run *r, enum recipe_moved what, struct job_result *out);

/* What was found, for report.json. */
void verify_report(const struct job_result *j, struct report *rep);

#endif
