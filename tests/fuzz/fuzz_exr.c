/* Any bytes as an EXR file. */
#include "drivers/format/exrfile.h"

int LLVMFuzzerTestOneInput(const uint8_t *p, size_t n);

int LLVMFuzzerTestOneInput(const uint8_t *p, size_t n)
{
    struct image im;
    if (exrfile_read_mem(p, n, "fuzz", &im) == OK && (im.w < 1 || im.h < 1 || im.channels != 3))
        __builtin_trap();
    exrfile_free(&im);
    return 0;
}
