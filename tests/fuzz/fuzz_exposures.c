/* First byte: exposure.json or cameras.json; the rest is its text. */
#include "drivers/format/cameras.h"
#include "drivers/format/exposures.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct exposures x;
    struct rig rig;
    if (size < 1)
        return 0;
    if (data[0] & 1) {
        if (cameras_parse("input", data + 1, size - 1, &rig) == OK && rig.n < 1)
            abort();
        cameras_free(&rig);
        return 0;
    }
    err_t e = exposures_parse("input", data + 1, size - 1, &x);
    for (int i = 0; e == OK && i < x.n; i++)
        if (!(exposures_find(&x, x.v[i].name) > 0))
            abort();
    exposures_free(&x);
    return 0;
}
