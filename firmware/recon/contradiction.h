/* contradiction.h - the warning where photographs contradict the places that were found for their
 * cameras (core/stereo/contradict.h). */
#ifndef RECON_CONTRADICTION_H
#define RECON_CONTRADICTION_H

#include "firmware/recon/job_result.h"

#include "core/base/plan.h"
#include "core/stereo/sweep.h"

/* As contradict_run; what it finds becomes warnings of out. */
MUST_USE err_t contradiction_run(const struct run *r, const struct views *v,
                                 const struct tonemap *tone, const struct depthmaps *d,
                                 struct job_result *out);

#endif
