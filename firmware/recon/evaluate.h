/* evaluate.h - a reconstructed scene against photographs and radiance that it has not seen
 * (core/refine/README.md 5). LDR: the tone-mapped float picture against the 8-bit photograph / 255.
 * Photographs through a lens that distorts are compared as they were taken (the pinhole that covers
 * the lens is drawn and resampled, distort.h), so the pixels do not depend on the lens that was
 * found; what lies beyond DISTORT_ANGLE does not count. Squares are compared undistorted.
 * HDR: both divided by their own 99 % quantile, clipped, mu-law; and in stops. Per image, then the
 * mean over all; LPIPS where its weights are given. Beside it, what a lookup would score: the
 * nearest input view, brought to the exposure of the test picture by the recovered response;
 * without input views (j->views) there is none. */
#ifndef RECON_EVALUATE_H
#define RECON_EVALUATE_H

#include "firmware/recon/job_result.h"
#include "firmware/result/outdir.h"

#include "drivers/format/imageset.h"

#include "core/base/plan.h"
#include "core/net/lpips.h"

enum { EVALUATE_EXPOSURES = 64 };

struct evaluate_score {
    int n;                    // images
    double psnr, ssim, lpips; // means, dB, 1 and 1; NAN: not measured
};

struct evaluate_exposure {
    double exposure; // linear, unit of the data set
    struct evaluate_score score;
};

/* Pixels of the test views by what the input views prove of them (core/refine/confidence.h):
 * guesses, and the rest. */
struct evaluate_trust {
    double pixels[2], squares[2]; // of all exposures; mean of the colours, display value^2
};

/* One test picture. */
struct evaluate_picture {
    const char *name;
    double exposure, psnr, ssim, lpips;
    bool seen; // an input photograph has this exposure
};

struct evaluate_result {
    int views;                                  // rendered
    struct evaluate_score ldr_seen, ldr_unseen; // at exposures that input photographs have, others
    int n_pictures;
    struct evaluate_picture *pictures; // (n_pictures) in r->keep
    int n_stops;
    double stops; // mean error of radiance over n_stops views (metrics.h); 0 of them: no radiance
    struct evaluate_score ldr, hdr, nearest; // n is 0 for hdr if the set has no radiance
    struct evaluate_trust trust;
    int n_exposures;
    struct evaluate_exposure exposures[EVALUATE_EXPOSURES]; // ascending
};

/* What is measured at which size; lpips: NULL: none. */
struct evaluate_pictures {
    const struct capture *test;
    struct prep_size size;
    const struct lpips *lpips;
};

/* err:  ERR_FORMAT (more than EVALUATE_EXPOSURES different exposures), ERR_ARG (a picture is too
 *       small for LPIPS). */
MUST_USE err_t evaluate_check(const struct evaluate_pictures *e);

/* Count what evaluate_run takes. cap: room for Gaussians in the scene. */
void evaluate_plan(struct plan *p, const struct evaluate_pictures *e, int cap);

/* Exposures that input photographs have. */
struct evaluate_seen {
    int n;
    float log2t[EVALUATE_EXPOSURES];
};

/* Add one, if there is none like it; more than there is room for are forgotten. */
void evaluate_see(struct evaluate_seen *s, float log2t);

/* A warning if the exposures of the test pictures cannot be in the unit of those of `inputs`. */
void evaluate_compare_units(const struct evaluate_seen *inputs, const struct capture *test,
                            struct job_result *j);

struct evaluate_job {
    const struct imageset *test;
    const struct evaluate_seen *inputs;
    const struct lpips *lpips; // or NULL
    struct outdir *o;          // folder for ldr/NAME.png and hdr/NAME.exr, or NULL
};

/* Render every view of `test` once and measure all of its exposures, where their masks let them
 * count. Times and warnings go to *j.
 * err:  ERR_ARG (a test view without camera, masks of everything), those of evaluate_check, of
 *       reading, drawing and writing, ERR_CANCELLED. */
MUST_USE err_t evaluate_run(const struct run *r, struct job_result *j,
                            const struct evaluate_job *what, struct evaluate_result *out);

#endif
