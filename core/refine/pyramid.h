/* pyramid.h - photographs as planes, and at half the size.
 * Pure functions; any thread, pyramid_run on the pool. */
#ifndef REFINE_PYRAMID_H
#define REFINE_PYRAMID_H

#include "core/base/types.h"
#include "core/refine/pace.h"

/* n pixels R,G,B side by side become planes (3, n). */
void pyramid_split(const uint8_t *rgb, size_t n, uint8_t *out);

/* Means of four pixels each. in: planes (3, h, w); out: (3, h / 2, w / 2), not in. */
void pyramid_halve(const uint8_t *in, int w, int h, uint8_t *out);
void pyramid_halve_deep(const uint16_t *in, int w, int h, uint16_t *out);

/* What has a masked pixel in it. in: (h, w); out: (h / 2, w / 2), not in. */
void pyramid_halve_mask(const uint8_t *in, int w, int h, uint8_t *out);

/* All photographs of some views, every size of them. */
struct pyramid {
    const struct views *v;
    int levels;
    uint8_t *planes[PACE_LEVELS]; // of level k 2^k times smaller
    uint16_t *deep[PACE_LEVELS];  // instead, where the views have 16 bits
    uint8_t *masked[PACE_LEVELS]; // from level 1 on, where the views have masks
};

/* Memory; v and levels are set. err: ERR_NOMEM. */
MUST_USE err_t pyramid_layout(struct pyramid *p, struct arena *a);

/* err:  those of the pool. */
MUST_USE err_t pyramid_run(struct pool *pool, struct pyramid *p);

/* Planes (3, h, w) of photograph i; those that the views do not have are NULL. */
const uint8_t *pyramid_planes(const struct pyramid *p, int i, int level);
const uint16_t *pyramid_deep(const struct pyramid *p, int i, int level);

/* Its masked pixels (h, w); NULL: none are. */
const uint8_t *pyramid_masked(const struct pyramid *p, int i, int level);

#endif
