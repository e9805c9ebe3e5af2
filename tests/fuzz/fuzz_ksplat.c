/* A .ksplat file from anyone. */
#include "drivers/format/ksplat.h"

#include "tests/fuzz/fuzz_splats.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_splats(&ksplat_format, data, size);
}
