/* A glTF file from anyone: every attribute lies inside it, whatever its JSON says. */
#include "drivers/format/glb.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct splats_bytes file = {"input", data, size};
    struct splats_info info;
    struct arena a;
    if (glb_format.peek(&file, &info) || info.n > 4096)
        return 0;
    if (arena_init(&a, "fuzz", gaussians_need(info.n, info.degree)))
        return 0;
    struct gaussians g;
    struct gaussians_report report;
    if (glb_format.parse(&file, 0, &a, &g, &report) == OK && g.n + report.dropped != info.n)
        abort();
    arena_free(&a);
    return 0;
}
