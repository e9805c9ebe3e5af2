/* A .ksplat file from anyone: what its header promises is read, and no more. */
#include "drivers/format/ksplat.h"

#include <math.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct splats_bytes file = {"input", data, size};
    struct splats_info info;
    struct arena a;
    if (ksplat_format.peek(&file, &info) || info.n > 4096)
        return 0;
    if (arena_init(&a, "fuzz", gaussians_need(info.n, info.degree)))
        return 0;
    struct gaussians g;
    struct gaussians_report report;
    if (ksplat_format.parse(&file, 0, &a, &g, &report) || g.n + report.dropped != info.n)
        abort(); // what was peeked must be read
    for (int i = 0; i < g.n; i++)
        for (int p = 0; p < gaussians_planes(g.degree); p++)
            if (!isfinite(g.plane[p][i]))
                abort();
    arena_free(&a);
    return 0;
}
