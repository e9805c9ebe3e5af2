/* gaussians.h - memory and range checks of struct gaussians (core/base/types.h).
 * Pure computation. thread: any. */
#ifndef BASE_GAUSSIANS_H
#define BASE_GAUSSIANS_H

#include "core/base/types.h"

enum { GAUSSIANS_MAX = 1 << 24 }; // splats; density_sort packs a number into 24 bits

#define GAUSSIANS_LOG_SCALE_MIN -27.6310211f // ln 1e-12
#define GAUSSIANS_LOG_SCALE_MAX 13.8155106f  // ln 1e6
#define GAUSSIANS_LOGIT_MAX 30.0f            // opacity within 1e-13 of 0 or 1

/* Bytes that gaussians_init takes from its arena; SIZE_MAX for a cap or degree that it refuses. */
size_t gaussians_need(int cap, int degree);

/* The room that gaussians_init makes for `cap` splats: a multiple of 16, at least 16. */
int gaussians_cap(int cap);

/* Room for `cap` splats (0..GAUSSIANS_MAX, rounded up by gaussians_cap) of SH
 * `degree` 0..4.
 * out:  *g with n = 0, planes zeroed, unused planes NULL; memory lives in a. On error *g is zeroed.
 * err:  ERR_ARG, ERR_NOMEM (arena; see gaussians_need). */
MUST_USE err_t gaussians_init(struct gaussians *g, struct arena *a, int cap, int degree);

struct gaussians_report {
    int dropped;  // splats removed: some plane was NaN or infinite
    int repaired; // splats kept with at least one value brought back into its range
};

/* Remove splats with a value that is not finite; the others keep their order. Then clamp log_scale
 * to [ln 1e-12, ln 1e6] and the logit to [-30, 30]; a quaternion shorter than 1e-6 becomes the
 * identity, one longer than 1e6 is brought to unit length. Splats already in range keep every bit.
 * out:  *report. */
void gaussians_sanitize(struct gaussians *g, struct gaussians_report *report);

/* Splat `from` also becomes splat `to`. */
void gaussians_move(const struct gaussians *g, int from, int to);

/* Make every length `scale` times as long. */
void gaussians_scale(struct gaussians *g, float scale);

/* Gaussians of *from as they are; bands above degree_max are left out. to: with planes and room for
 * them. */
void gaussians_copy(const struct gaussians *from, int degree_max, struct gaussians *to);

#endif
