/* locate.h - where photographs were taken: points that several of them show, then bundle
 * adjustment. */
#ifndef RECON_LOCATE_H
#define RECON_LOCATE_H

#include "core/base/types.h"
#include "core/sfm/bundle.h"

/* Count what locate_run takes; of v only n, size and extent are read. */
void locate_plan(struct plan *p, const struct views *v, int n_lenses);

/* Cameras of all views. prior: where the network sees the patches of one view in another, or NULL.
 * out:  arrays live in r->keep.
 * err:  ERR_ARG (a picture that is too small), ERR_NOMEM (see locate_plan), ERR_CANCELLED. */
MUST_USE err_t locate_run(const struct run *r, const struct views *v,
                          const struct correspondence *prior, const struct bundle_config *cfg,
                          struct bundle_result *out);

/* Below this confidence (bundle.h) nothing says that the cameras are right. */
#define LOCATE_CONFIDENT 0.1f

#endif
