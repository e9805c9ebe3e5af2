/* differ.h - how far two predictions of the network for the same views are apart.
 * Pure computation; thread: any. */
#ifndef REFINE_DIFFER_H
#define REFINE_DIFFER_H

#include "core/net/graph.h"

enum differ_figure {
    DIFFER_ROTATION,    // degrees, median over the views; cameras are seen from view 0
    DIFFER_TRANSLATION, // %, the same, of the longest distance between two reference cameras
    DIFFER_FOCAL,       // %, median over the views and both axes
    DIFFER_DEPTH,       // %, median over the pixels of |d / d_ref - 1|
    DIFFER_ALIGNED,     // %, the same after division by the median of d / d_ref
    DIFFER_RADIANCE,    // log2, rms over pixels and colours of the mean radiance of their Gaussians
    DIFFER_PSNR,        // dB, of that radiance on the prediction's own curve at the view's exposure
    DIFFER_OPACITY,     // rms over the pixels, 0..1
    DIFFER_FIGURES
};

/* The compared parts of a prediction. */
struct differ_look {
    int n_views, size;
    const struct camera *cams;  // (n_views)
    const float *depth;         // (n_views, size, size)
    const float *logit, *dc[3]; // the same: opacity, first harmonic; NULL without a Gaussian head
    struct tonemap tone;
    bool linear; // dc gives display colours, there is no radiance
};

/* out: points into p. */
struct differ_look differ_look(const struct prediction *p);

/* Let *io point to copies, allocated from a. differ_keep_plan allocates the same from a counter.
 * err:  ERR_NOMEM. */
MUST_USE err_t differ_keep(struct arena *a, struct differ_look *io);
void differ_keep_plan(struct arena *count, int n_views, int size);

/* Distances of p from ref, of the same views. log2t: (n_views).
 * out:  NAN where nothing can be said: no Gaussian head, no radiance, a value that is not finite,
 *       cameras in one place.
 * err:  ERR_NOMEM (tmp, which is back at its mark on return; see differ_measure_plan). */
MUST_USE err_t differ_measure(const struct differ_look *ref, const struct differ_look *p,
                              const float *log2t, struct arena *tmp, double out[DIFFER_FIGURES]);
void differ_measure_plan(struct arena *count, int n_views, int size);

#endif
