/* A poses_bounds_exps.npy for three pictures. */
#include "drivers/format/llff.h"

#include <math.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct rig_view v[3] = {{.name = "a.jpg"}, {.name = "b.jpg"}, {.name = "c.jpg"}};
    struct rig rig = {.n = 3, .views = v};
    if (llff_parse("input", data, size, &rig) != OK)
        return 0;
    for (int i = 0; i < 3; i++)
        if (!(v[i].cam.fx > 0) || !isfinite(v[i].cam.t[2]) || !isfinite(v[i].exposure_log2))
            abort();
    return 0;
}
