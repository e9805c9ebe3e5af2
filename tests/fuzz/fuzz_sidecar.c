/* A sidecar from anyone: what was peeked must suffice, and all that is read is finite. */
#include "drivers/format/sidecar.h"

#include <math.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct sidecar_bytes file = {"input", data, size};
    struct scene s = {0};
    struct arena a;
    struct sidecar_info info;
    if (sidecar_peek_bytes(&file, &info) || info.need > 1 << 24)
        return 0;
    if (arena_init(&a, "fuzz", info.need))
        return 0;
    err_t e = sidecar_parse(&file, 0, &a, &s);
    if (e == ERR_NOMEM || (e == OK && (s.n_views != info.n_views || a.used != info.need)))
        abort();
    for (int i = 0; e == OK && i < TONE_PARAMS; i++)
        if (!isfinite(s.tone.p[i]))
            abort();
    for (int i = 0; e == OK && i < info.n_views; i++)
        if (!isfinite(s.log2t[i]) || s.cams[i].w != s.size)
            abort();
    arena_free(&a);
    return 0;
}
