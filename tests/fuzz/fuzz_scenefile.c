/* A scene from anyone: the header says how much memory is taken and where every tensor lies. */
#include "core/base/gaussians.h"
#include "drivers/format/scenefile.h"

#include <math.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct scenefile_bytes file = {"input", data, size};
    struct scenefile_info info;
    struct arena a;
    if (scenefile_peek_bytes(&file, &info) || info.need > 1 << 24)
        return 0;
    if (arena_init(&a, "fuzz", info.need))
        return 0;
    struct scene s;
    err_t e = scenefile_parse(&file, &a, &s);
    if (e == ERR_NOMEM || (e == OK && a.used != info.need))
        abort(); // what was peeked must suffice
    for (int i = 0; e == OK && i < s.g.n; i++)
        for (int p = 0; p < gaussians_planes(s.g.degree); p++)
            if (!isfinite(s.g.plane[p][i]))
                abort();
    arena_free(&a);
    return 0;
}
