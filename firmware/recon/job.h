/* job.h - one capture through all steps.
 * Response curve; cameras, if they are not known, by the network and bundle adjustment; first
 * Gaussians by the network or by stereo; refinement. */
#ifndef RECON_JOB_H
#define RECON_JOB_H

#include "firmware/recon/network.h"
#include "firmware/result/report.h"

#include "core/base/types.h"
#include "core/photo/prep.h"
#include "core/refine/refine.h"

enum job_stage {
    JOB_PREPROCESS,
    JOB_RESPONSE,
    JOB_CAMERAS, // where they were not known, or a network needs a scale
    JOB_SWEEP,
    JOB_SEED,
    JOB_BACKBONE,
    JOB_HEADS,      // cameras and depth
    JOB_APPEARANCE, // fusion, Gaussian head, tone curve
    JOB_VOXEL,
    JOB_REFINE,
    JOB_RENDER, // this and the following by whoever publishes or evaluates
    JOB_WRITE,
    JOB_MEASURE,
    JOB_STAGES
};

enum { JOB_WARNINGS = 76 }; // one for each view that may be left out, and some

struct job_config {
    int size; // px, edge of the square views
    struct refine_config refine;
    const struct network *network; // NULL: none
    bool cameras_only;             // the network is only asked for cameras
    bool polish;   // the network's cameras by bundle adjustment, always without a network; its
                   // depth by stereo
    bool stereo;   // refinement starts from stereo also if a network gave Gaussians
    float fov_deg; // of cameras that are not known, horizontal; 0: to be found
    const struct prep_source *source; // of the pixels; NULL: they are in the capture
    float dump_log2t[3];              // exposures of the dumped picture, if run.tap is set
};

struct job_memory {
    size_t pictures, weights; // bytes: decoded photographs at a time (malloc'd), mapped file
    size_t keep, tmp;         // arenas
};

/* How cameras that were not known were found. */
struct job_cameras {
    bool found;       // false: they were known, or are the network's own
    bool from_tracks; // bundle adjustment did better without the network's
    float confidence; // bundle.h
    float rms_px;
    int inliers, sightings, placed; // points seen; views
};

struct job_result {
    struct views views;      // in keep; n is 0 if the photographs are not at hand
    struct tonemap response; // from histograms: the nearest view is shown under it
    int taken;               // photographs of brackets, before those that show nothing more went
    struct scene scene;      // in keep
    struct refine_report refine;
    struct job_cameras cameras;
    double start_s, lap_s; // of the clock
    double seconds[JOB_STAGES];
    double input_psnr;          // dB, mean over the input views, NAN until publish_run
    float *input_db;            // (views.n + n_more) dB of each, in keep, NAN until then, or NULL
    bool measured_only;         // the scene is from a file: nothing to tell about its making
    size_t keep_peak, tmp_peak; // bytes
    double peak_rss_mb;         // at the end of the last stage
    const char *precision;      // of the network; NULL: none was used
    int n_warnings;
    char warnings[JOB_WARNINGS][240];
};

/* Memory of a job, before a pixel is decoded; the capture needs only names, sizes and cameras.
 * `c` is refused here if it cannot become a scene: fewer than two views, some cameras known and
 * some not, more views or smaller ones than cameras can be found for. tapped: run.tap will be set.
 * err:  ERR_ARG. */
MUST_USE err_t job_plan(const struct capture *c, const struct job_config *cfg, int threads,
                        bool tapped, struct job_memory *out);

/* Whether the scene is the network's single forward pass. */
bool job_forward(const struct job_config *cfg);

/* Most Gaussians that a scene of so many views can have. */
int job_most(const struct job_config *cfg, int n_views);

/* The whole way from photographs to a scene. Arenas as planned.
 * err:  those of the steps. On error *out holds the times so far, nothing else. */
MUST_USE err_t job_run(const struct run *r, const struct capture *c, const struct job_config *cfg,
                       struct job_result *out);

/* The time since the last call (or the start) goes to `stage`. */
void job_lap(struct job_result *j, enum job_stage stage);

/* Add a sentence for the report; those beyond JOB_WARNINGS are dropped. */
void job_warn(struct job_result *j, const char *fmt, ...) __attribute__((format(printf, 2, 3)));

/* The members that every report has, into an open object. threads: of the pool that the job ran on.
 * */
void job_report(const struct job_result *j, int threads, struct report *rep);

#endif
