#include "core/refine/part.h"

#include "core/base/num.h"
#include "core/base/splitmix.h"

struct part part_whole(const struct camera *cam)
{
    return (struct part){.cam = *cam};
}

/* Length of a part of a side, and where it begins; the last one may be shorter. */
static int choose_side(int px, int unit, uint64_t *rng, int *from)
{
    const int units = (px + unit - 1) / unit, wide = (units + PART_SIDES - 1) / PART_SIDES;
    *from = (int)(splitmix_next(rng) % (uint64_t)(units - wide + 1)) * unit;
    return num_min(wide * unit, px - *from);
}

struct part part_random(const struct camera *cam, int unit, uint64_t *rng)
{
    struct part out = part_whole(cam);
    out.cam.w = choose_side(cam->w, unit, rng, &out.x);
    out.cam.h = choose_side(cam->h, unit, rng, &out.y);
    out.cam.cx -= (float)out.x;
    out.cam.cy -= (float)out.y;
    return out;
}
