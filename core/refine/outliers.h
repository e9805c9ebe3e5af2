/* outlier.h - cells of the photographs that the scene does not explain: what moved while they were
 * taken. A scene that all photographs share differs from one of them by noise, by edges that are a
 * pixel off, and by errors that its neighbours have, too. By patches of one sign it differs where a
 * photograph shows something that the others do not: trimmed residuals with spatial coherence
 * (SpotLessSplats, Sabour et al. 2024), here of the signed mean of a cell, display values. A cell
 * is left out only where at least two other photographs show the same surface and the scene
 * explains them: of two photographs nobody can tell which one is right.
 * thread: any, a workspace belongs to one at a time. */
#ifndef REFINE_OUTLIERS_H
#define REFINE_OUTLIERS_H

#include "core/base/arena.h"
#include "core/base/types.h"
#include "core/refine/loss.h"
#include "core/splat/raster.h"

enum { OUTLIERS_PX = 8 }; // least edge of a cell

struct outliers {
    const struct views *v;
    int px;           // edge of a cell in photographs of full size
    int across, down; // cells of the longest edge
    float *excess;    // (down, 3, across) of the comparison at hand: mean of picture - photograph
    /* (photographs, down, across) */
    float *score;  // the largest of the three, as last seen; < 0: not yet
    uint8_t *hit;  // workspace: more than the photograph as a whole is off
    uint8_t *skip; // 1: left out
    /* Workspace. */
    uint8_t *former;         // (photographs, down, across) skip before a judgement
    uint8_t *patch;          // (down, across)
    float *depth;            // (n, down, across) of each place; 0: hardly covered
    float *alpha, *radiance; // (down, across), (3, down, across)
    float *sorted;           // (max(down across, photographs))
    float *share;            // (photographs) of the cells that are patches
};

/* Memory. px: OUTLIERS_PX or more. v outlives *o. err: ERR_NOMEM. */
MUST_USE err_t outliers_layout(struct outliers *o, struct arena *a, const struct views *v, int px);

/* Nothing was seen, nothing is left out. */
void outliers_begin(struct outliers *o);

/* Cells of photograph k from a comparison, whose excess is that of *o.
 * t:    whose ranks have compared some rows each, or NULL.
 * err:  those of team_spread. */
MUST_USE err_t outliers_see(struct team *t, struct outliers *o, int k,
                            const struct loss_input *compared);

/* Whether step `step` of `steps` is one after which photographs are judged. */
bool outliers_due(int step, int steps);

/* What is left out from now on; *changed: it is not what was before. rs: planned for s and its
 * views; each rank of r->team draws all of it, and the first one decides, since others may differ
 * in the last digit.
 * err:  those of raster_run and team_copy. */
MUST_USE err_t outliers_judge(const struct run *r, struct outliers *o, const struct raster *rs,
                              const struct scene *s, bool *changed);

/* Share of the cells of photograph k that is left out. */
float outliers_share(const struct outliers *o, int k);

/* Cells of one photograph, as they lie in memory. */
static inline size_t outliers_cells(const struct outliers *o)
{
    return (size_t)o->across * (size_t)o->down;
}

/* Its cells; NULL: all of it counts. */
const uint8_t *outliers_skip(const struct outliers *o, int k);

#endif
