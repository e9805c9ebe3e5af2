/* testview.h - one photograph of a test set, in the size in which it is compared. */
#ifndef RECON_TESTVIEW_H
#define RECON_TESTVIEW_H

#include "core/photo/prep.h"
#include "drivers/format/imageset.h"

/* Read photograph i.
 * lensed: as it was taken, without a camera; else as its shot says.
 * out:    one view; arrays live in r->keep.
 * err:    those of reading and of prep_read. */
MUST_USE err_t testview_read(const struct run *r, const struct imageset *set, int i, bool lensed,
                             struct prep_size size, struct views *out);

/* Count it for the largest photograph, of which `most` pixels are kept; edge: that of prep_size. */
void testview_plan(struct plan *p, const struct capture *c, size_t most, int edge);

#endif
