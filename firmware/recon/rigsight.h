/* rigsight.h - points of the takes of a rig for the calibration with a board: tracks of views that
 * were drawn through the lenses of that calibration, as sights in the photographs. */
#ifndef RECON_RIGSIGHT_H
#define RECON_RIGSIGHT_H

#include "core/sfm/boardcal.h"
#include "core/sfm/match.h"

/* A view as it was drawn. */
struct rigsight_view {
    int w, h;     // px
    double focal; // px, its pinhole's; the principal point is in the middle
};

struct rigsight {
    struct boardfit_points points; // arrays malloc'd
    struct boardfit_sight *sight;
    int *first;
};

/* Place the points of tracks, which are sorted, for the cameras of a calibration; those that do not
 * agree with it within RIGSIGHT_GATE px are left out.
 * view: (cameras)
 * own:  rigsight_free, also on error.
 * err:  ERR_NOMEM. */
#define RIGSIGHT_GATE 3.0
MUST_USE err_t rigsight_make(const struct boardcal *in, const struct boardcal_result *b,
                             const struct rigsight_view *view, const struct match_tracks *t,
                             struct rigsight *out);
void rigsight_free(struct rigsight *s);

#endif
