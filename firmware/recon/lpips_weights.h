/* lpips_weights.h - a weights file of LPIPS (hdrig convert --lpips) that is open. */
#ifndef RECON_LPIPS_WEIGHTS_H
#define RECON_LPIPS_WEIGHTS_H

#include "core/net/lpips.h"
#include "drivers/format/modelfile.h"

struct lpips_weights {
    struct modelfile file;
    struct lpips net; // points into file
};

/* own:  lpips_weights_close.
 * err:  those of modelfile_open and lpips_bind. On error *out is zeroed. */
MUST_USE err_t lpips_weights_open(const char *path, struct lpips_weights *out);

/* Accepts a zeroed struct. */
void lpips_weights_close(struct lpips_weights *w);

#endif
