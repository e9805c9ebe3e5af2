/* A PLY file from anyone: the header says how much memory is taken, then come rows. */
#include "drivers/format/ply.h"

#include "tests/fuzz/fuzz_splats.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_splats(&ply_format, data, size);
}
