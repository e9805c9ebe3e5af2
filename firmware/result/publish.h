/* publish.h - the folder of a finished job: scene.ply, scene.hdrig, cameras.json, tone.json,
 * hdr/NAME.exr and ldr/NAME.png per input view at its own exposure, report.json, report.html. */
#ifndef RESULT_PUBLISH_H
#define RESULT_PUBLISH_H

#include "firmware/recon/job.h"
#include "firmware/result/outdir.h"

/* Refuse before the work everything that publish_run could not write: photographs whose files would
 * have one name, and a folder that may not fit. cfg: of the job that will run on c.
 * err:  ERR_ARG, ERR_LIMIT (no space), ERR_IO. */
MUST_USE err_t publish_check(const struct capture *c, const struct job_config *cfg,
                             struct outdir *o);

/* Render the input views, write everything and make it visible under the name of `o`. Warnings and
 * times are added to *j, and how near the input views came to their photographs.
 * err:  ERR_ARG (two names that differ only in their extension), ERR_LIMIT (no space), ERR_IO,
 *       ERR_NOMEM, ERR_CANCELLED. Then the former result is untouched. */
MUST_USE err_t publish_run(const struct run *r, struct job_result *j, struct outdir *o);

/* The text of report.json. threads: of the pool that the job ran on. */
void publish_report(const struct job_result *j, int threads, FILE *f);

#endif
