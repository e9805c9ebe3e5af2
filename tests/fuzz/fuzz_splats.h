/* fuzz_splats.h - a file of splats from anyone: what its header promises is read, and no more. */
#ifndef FUZZ_FUZZ_SPLATS_H
#define FUZZ_FUZZ_SPLATS_H

#include "drivers/format/splats.h"

#include <math.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static int fuzz_splats(const struct splats_format *format, const uint8_t *data, size_t size)
{
    struct splats_bytes file = {"input", data, size};
    struct splats_info info;
    struct arena a;
    if (format->peek(&file, &info) || info.n > 4096)
        return 0;
    if (arena_init(&a, "fuzz", gaussians_need(info.n, info.degree)))
        return 0;
    struct gaussians g;
    struct gaussians_report report;
    if (format->parse(&file, info.ev, &a, &g, &report) || g.n + report.dropped != info.n)
        abort(); // what was peeked must be read
    for (int i = 0; i < g.n; i++)
        for (int p = 0; p < gaussians_planes(g.degree); p++)
            if (!isfinite(g.plane[p][i]))
                abort();
    arena_free(&a);
    return 0;
}

#endif
