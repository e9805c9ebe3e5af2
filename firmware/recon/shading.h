/* shading.h - what the physical cameras of a job do to light (core/photo/shade.h), and light that
 * was another in each photograph: found once depth is known, then part of every comparison with
 * the photographs. A lamp that was on in some of them only is told in a warning. */
#ifndef RECON_SHADING_H
#define RECON_SHADING_H

#include "firmware/recon/job_result.h"
#include "firmware/result/report.h"

#include "core/stereo/sweep.h"

/* Exposures of out->views that are not what they say (exposure_even.h), together with the response:
 * out->views.log2t and drift, where there is any.
 * drift: (out->views.n + n_more) room, as below
 * err:   ERR_NOMEM, ERR_CANCELLED. */
MUST_USE err_t shading_brackets(const struct run *r, float *drift, struct job_result *out);
void shading_brackets_plan(struct plan *p, const struct views *v);

/* Room for the maps of as many views. */
MUST_USE err_t shading_layout(struct shade **out, struct arena *keep, int n_views);

/* Find it from surfaces, and say so in *out. Nothing changes where nothing was found.
 * refit: the response curve is fitted again with it, where it is not known but told by exposures in
 *        other places; else light is all that sets photographs apart.
 * room:  (out->views.n) of shading_layout; becomes out->views.shade and seen->shade. NULL: of
 *        cameras nothing is asked.
 * drift: (out->views.n + n_more) room, or out->views.drift so far, which it becomes.
 * seen:  one photograph of each place, with cameras; tone: its curve.
 * err:   ERR_NOMEM (see shading_plan), ERR_CANCELLED. */
struct shading_input {
    const struct capture *capture;
    const struct depthmaps *depth;
    struct shade *room;
    float *drift;
    struct views *seen;
    struct tonemap *tone;
    bool refit;
};
MUST_USE err_t shading_run(const struct run *r, const struct shading_input *in,
                           struct job_result *out);

/* Bytes of r->tmp. */
size_t shading_plan(int n_views);

/* Vignetting, gain and balance of a physical camera; false: none was found. */
bool shading_model(const struct job_result *j, const char *camera_id, struct shade_model *out);

/* Whether any was found, of any camera. */
bool shading_found(const struct job_result *j);

/* The same over the pixels of a view of the photograph with this pinhole; false: none was found. */
bool shading_of(const struct job_result *j, const struct shot *s, const struct camera *view,
                struct shade *out);

/* Sentences about light and white balance that changed, for a list of report.json. */
void shading_tell(const struct job_result *j, struct report *rep);

/* For report.json. */
void shading_report(const struct job_result *j, struct report *rep);

#endif
