/* A .splat file from anyone. */
#include "drivers/format/dotsplat.h"

#include "tests/fuzz/fuzz_splats.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_splats(&dotsplat_format, data, size);
}
