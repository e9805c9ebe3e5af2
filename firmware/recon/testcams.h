/* testcams.h - where the test photographs of a data set were taken, if no rig tells: they are
 * located together with the input views, by the network if there is one and by bundle adjustment,
 * then aligned to the finished scene (core/refine/README.md 1, B, and 5). */
#ifndef RECON_TESTCAMS_H
#define RECON_TESTCAMS_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/recipe.h"

#include "core/sfm/pose_error.h"
#include "drivers/format/imageset.h"

struct testcams_scene {
    bool square;   // all its views are squares, or may be
    int gaussians; // at most
};

/* Memory beside that of the job.
 * err:  ERR_NOMEM. */
MUST_USE err_t testcams_plan(const struct job_config *cfg, const struct testcams_scene *scene,
                             const struct capture *train, const struct capture *test, int threads,
                             struct job_memory *out);

/* Refuse before the work more views than cameras can be found for.
 * err:  ERR_ARG. */
MUST_USE err_t testcams_check(const struct job_config *cfg, const struct capture *train,
                              const struct capture *test);

/* Find the cameras of test->capture, one per view, from the middle one of its pictures. j is
 * finished; those that cannot be placed are its warning.
 * err:  those of reading, of the network, of locate_run and of align_run. */
MUST_USE err_t testcams_run(const struct run *r, const struct job_config *cfg, struct job_result *j,
                            struct imageset *test);

/* The error of all cameras, those of the scene and of the test views. Shots have the true ones.
 * err:  ERR_NOMEM. */
MUST_USE err_t testcams_measure(const struct run *r, const struct job_result *j,
                                const struct capture *train, const struct capture *true_test,
                                const struct capture *test, struct pose_error *out);

#endif
