/* stored.h - what a result says about its photographs and the physical cameras that took them
 * (report.json, cameras.json), for photographs that are compared with its scene. */
#ifndef RECON_STORED_H
#define RECON_STORED_H

#include "firmware/recon/evaluate.h"
#include "firmware/recon/job_result.h"

#include "drivers/format/cameras.h"

/* Write down the physical camera of a view of *j and what it does to light. */
void stored_put(const struct job_result *j, const struct shot *s, struct rig_view *out);

/* Read it again: out->light. */
void stored_light(const struct rig *rig, struct job_result *out);

/* And out->found, the lenses, as if they had been found for the views of `rig`. inputs: its
 * photographs, or some of them; they tell how the sensor was turned. */
void stored_lenses(const struct rig *rig, const struct capture *inputs, struct job_result *out);

/* Add the exposures of all photographs of a result, by its report.json at `path`, if there is one.
 * err:  ERR_FORMAT, those of json_read. */
MUST_USE err_t stored_exposures(const char *path, struct evaluate_seen *io);

#endif
