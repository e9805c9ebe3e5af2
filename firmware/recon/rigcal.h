/* rigcal.h - the calibration of a rig from takes of it: lens and pose of each camera, which all
 * takes share. */
#ifndef RECON_RIGCAL_H
#define RECON_RIGCAL_H

#include "firmware/recon/rigcal_job.h"

/* Check that all takes are of the same cameras, 2 to RIGCHECK_MOST, and say how much memory the
 * calibration takes. Captures need only names and sizes.
 * err:  ERR_ARG. */
MUST_USE err_t rigcal_plan(const struct rigcal_job *job, int threads, struct job_memory *out);

/* Calibrate: from the board if one is seen that ties all cameras, else from points, with the scale
 * of the board where it ties two cameras. The arenas are as large as planned.
 * own:  rigcal_free.
 * err:  ERR_ARG (cameras that cannot be found, the sentence names one; no board although the size
 *       of its tags is given), those of decoding,
 *       ERR_NOMEM, ERR_CANCELLED. On error only *out may be freed. */
MUST_USE err_t rigcal_run(const struct run *r, const struct rigcal_job *job,
                          struct rigcal_result *out);

/* Accepts a zeroed result. */
void rigcal_free(struct rigcal_result *r);

#endif
