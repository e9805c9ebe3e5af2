/* An SPZ file from anyone: what its header promises is unpacked and no more. */
#include "drivers/format/spz.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct splats_bytes file = {"input", data, size};
    struct splats_info info;
    struct arena a;
    if (spz_format.peek(&file, &info) || info.n > 4096)
        return 0;
    if (arena_init(&a, "fuzz", gaussians_need(info.n, info.degree)))
        return 0;
    struct gaussians g;
    struct gaussians_report report;
    if (spz_format.parse(&file, 0, &a, &g, &report) == OK && g.n + report.dropped != info.n)
        abort();
    arena_free(&a);
    return 0;
}
