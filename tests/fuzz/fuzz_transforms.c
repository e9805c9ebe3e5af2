/* The text of a transforms.json. */
#include "drivers/format/transforms.h"

#include <math.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct rig rig;
    if (transforms_parse("input", data, size, &rig) != OK && rig.views)
        abort();
    for (int i = 0; i < rig.n; i++) {
        const struct rig_view *v = &rig.views[i];
        if (!(v->cam.fx > 0) || !v->name[0] || !isfinite(v->cam.t[0]) || !isfinite(v->cam.q[0]))
            abort();
    }
    cameras_free(&rig);
    return 0;
}
