/* job_result.h - the result of a job: its scene, and the figures and warnings of the report. The
 * steps of a job (job.h) fill it in. */
#ifndef RECON_JOB_RESULT_H
#define RECON_JOB_RESULT_H

#include "core/base/rig.h"
#include "core/base/types.h"
#include "core/photo/prep.h"
#include "core/refine/confidence.h"
#include "core/refine/refine.h"
#include "core/refine/shade_fit.h"
#include "core/sfm/bundle.h"
#include "core/sfm/rigcheck.h"

enum job_stage {
    JOB_PREPROCESS,
    JOB_RESPONSE,
    JOB_CAMERAS, // bundle adjustment: cameras, or the scale of the network
    JOB_SWEEP,
    JOB_COMPLETION, // depth where stereo is not sure, by the network
    JOB_SEED,
    JOB_BACKBONE,
    JOB_HEADS,      // cameras and depth
    JOB_APPEARANCE, // fusion, Gaussian head, tone curve
    JOB_VOXEL,
    JOB_REFINE,
    JOB_CONFIDENCE,
    JOB_RENDER, // from here on: publication or evaluation
    JOB_WRITE,
    JOB_MEASURE,
    JOB_STAGES
};

enum { JOB_LENSES = 8 };                      // that the report names
enum { JOB_WARNINGS = RIG_CAMERAS_MAX + 12 }; // one for each camera of a rig, and some

/* How cameras that were not known were found. */
struct job_cameras {
    bool found;       // false: they were known, or are the network's own
    bool from_tracks; // bundle adjustment did better without the network's
    float confidence; // bundle.h
    float rms_px;
    int inliers, observations; // of points in views
    int placed;                // views
    int edge;                  // px, of the views they were found in
};

/* A lens that was found. */
struct job_lens {
    char camera_id[NAME_CAP];
    int photographs, edge; // edge: px, long side of the pictures that lens is for
    struct lens lens;      // from the middle; as the sensor is turned
    struct selfcal_lens selfcal;
    bool resampled; // the views were sampled again through it
};

/* Vignetting, gain and balance of a physical camera. */
struct job_light {
    char camera_id[NAME_CAP];
    int photographs;
    struct shade_fit_camera found;
};

/* A camera of a calibrated rig, checked. */
struct job_rig_camera {
    char name[NAME_CAP];
    struct rigcheck_camera check;
};

struct job_result {
    const struct capture *capture; // the job's
    struct views views;            // in keep; n is 0 if the photographs are not at hand
    struct tonemap response;       // from histograms: the nearest view is shown under it
    int taken;                     // photographs of brackets, before redundant ones were dropped
    char sizing[160];              // how large pictures were chosen, a sentence
    char budget[128];              // what was chosen to end in time; "": nothing
    float completed;               // share of the depth that is the completion branch's
    float sky, backdrop;           // shares of the depth that see sky, and black far behind
    int sky_filled;                // splats of sky that no photograph shows
    struct scene scene;            // in keep
    struct refine_report refine;
    struct confidence_advice advice; // if scene.confidence is known and not measured_only
    double confidence_mean, guesses; // over the pixels of the input views, and the share of those
                                     // below CONFIDENCE_GUESS; from publish_run
    struct job_cameras cameras;
    double start_s, lap_s; // by the clock
    double seconds[JOB_STAGES];
    const struct team *team;             // NULL: one process did all
    uint64_t sent[JOB_STAGES], lap_sent; // bytes by this rank; until the last lap
    double input_psnr;                   // dB, mean over the input views, NAN until publish_run
    float *input_db;            // (views.n + n_more) dB of each, in keep, NAN until then, or NULL
    bool measured_only;         // the scene was read from a file and only measured
    size_t keep_peak, tmp_peak; // bytes
    double peak_rss_mb;         // at the end of the last stage
    const char *precision;      // the network's; NULL: none was used
    int n_found;
    struct job_lens found[BUNDLE_VIEWS_MAX]; // where cameras were not known
    int n_light;                             // 0: not looked at
    struct job_light light[SHADE_FIT_CAMERAS];
    struct shade_fit_drift drift; // of the places; stops NULL: not looked at
    float balance_most;           // stops, of the place whose white balance is farthest off, and it
    int balance_place;
    int n_other_light; // places in the smaller group of light_change.h, and which
    bool other_light[BUNDLE_VIEWS_MAX];
    int n_rig; // 0: not checked
    struct job_rig_camera rig[RIGCHECK_MOST];
    int n_lenses;
    char lenses[JOB_LENSES][160]; // how photographs were undistorted, a sentence for each lens
    int n_warnings;
    char warnings[JOB_WARNINGS][480];
};

/* The time since the last call (or the start) goes to `stage`. */
void job_result_lap(struct job_result *j, enum job_stage stage);

/* out->response of out->views: from histograms; that of linear photographs is known.
 * err:  those of response_run. */
MUST_USE err_t job_result_curve(const struct run *r, struct job_result *out);

/* Size of the views of a scene: as squares if all are. */
struct prep_size job_result_size(const struct scene *s);

/* Shares of photograph i that masks hide, and that refinement left out of the rest.
 * map: (h, w) out: 1 where either; NULL: not wanted. */
struct job_left_out {
    double masked, moved;
};
struct job_left_out job_result_left_out(const struct job_result *j, int i, uint8_t *map);

/* Add a sentence for the report; those beyond JOB_WARNINGS are dropped. */
void job_result_warn(struct job_result *j, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));

#endif
