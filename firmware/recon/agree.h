/* agree.h - whether all ranks of a team hold the same bytes: other photographs under the same name,
 * or other libraries, must not end as one scene. Collective; a single process agrees.
 * err:  ERR_ARG names the first rank that differs, those of team.h. */
#ifndef RECON_AGREE_H
#define RECON_AGREE_H

#include "core/base/types.h"

/* Pictures and exposures of the views. */
MUST_USE err_t agree_views(const struct run *r, const struct views *v);

/* Cameras, Gaussians and tone curve. when: "before refinement". */
MUST_USE err_t agree_scene(const struct run *r, const struct scene *s, const char *when);

#endif
