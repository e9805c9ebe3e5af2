/* lenses.h - the lenses of a job's photographs, where these come without cameras: which share one,
 * what is known before, what bundle adjustment found, and the photographs seen through it. */
#ifndef RECON_LENSES_H
#define RECON_LENSES_H

#include "firmware/recon/job_result.h"
#include "firmware/recon/recipe.h"
#include "firmware/result/report.h"

#include "core/photo/prep.h"
#include "core/sfm/bundle.h"

/* Lenses of the places of views. */
struct lenses {
    int n;
    struct bundle_lens *lens; // (n)
    int *of;                  // (places) the lens of each
    int *turned;              // (places) quarter turns of the sensor
    struct extent *taken;     // (places) shapes of the photographs as views
    float *pinhole;           // (places) px, focal length that lenses_resample drew; 0 before
    double *error_before;     // (n) of selfcal.h, of photographs as they were taken
};

/* The shot of this name, which exists. */
const struct shot *lenses_shot(const struct capture *c, const char *name);

/* Number of lenses of a capture. */
int lenses_count(const struct capture *c);

/* Arrays in keep for as many places. */
MUST_USE err_t lenses_layout(struct lenses *l, struct arena *keep, int n_views);

/* Group the views by camera_id. The focal length is that of EXIF, or of the field of view asked,
 * if any. */
void lenses_group(struct lenses *l, const struct capture *c, const struct views *v,
                  const struct job_config *cfg);

/* Whether the lenses found differ from l->lens by more than `px` anywhere in the views. */
bool lenses_moved(const struct lenses *l, const struct views *v, const struct bundle_result *found,
                  double px);

/* Note what was found for the report, and for other photographs of these cameras. */
void lenses_note(const struct lenses *l, const struct capture *c, const struct bundle_result *found,
                 struct job_result *out);

/* Take over and note what was found, and draw out->views again, as pinholes see them through these
 * lenses; shapes of the views become those of undistort_frame.
 * err:  those of decoding; ERR_FORMAT (a lens that leaves nothing to see). */
MUST_USE err_t lenses_resample(const struct run *r, const struct capture *c,
                               const struct prep_source *from, const struct bundle_result *found,
                               struct lenses *l, struct job_result *out);

/* Where the views of a result were drawn again, give views that are to take their place the same
 * frames: their longer edge stays. small: the views before; all photographs of both correspond. */
void lenses_reshape(const struct job_result *j, const struct views *small, struct views *large);

/* Draw these, too: focal lengths are those of out->views.cams.
 * err:  those of decoding. */
MUST_USE err_t lenses_redraw(const struct run *r, const struct capture *c,
                             const struct prep_source *from, struct job_result *out);

/* Lens found of the camera that took a photograph, in px of that; false if none was. resampled: the
 * views are undistorted from it. */
bool lenses_find(const struct job_result *j, const struct shot *s, struct lens *out,
                 bool *resampled);

/* Photographs that were not in the job become pictures of the pinholes of their cameras' lenses. */
void lenses_apply(const struct job_result *j, struct capture *c);

/* Their values, for report.json. */
void lenses_report(const struct job_result *j, struct report *rep);

#endif
