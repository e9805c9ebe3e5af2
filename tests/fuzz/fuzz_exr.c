/* Any bytes as an EXR file. */
#include "drivers/format/exrfile.h"
#include "drivers/format/imgsize.h"

int LLVMFuzzerTestOneInput(const uint8_t *p, size_t n);

int LLVMFuzzerTestOneInput(const uint8_t *p, size_t n)
{
    struct image im;
    int w = 0, h = 0;
    const err_t e = imgsize_parse("fuzz", p, n, &w, &h);
    if (exrfile_read_mem(p, n, "fuzz", &im) == OK && (im.w < 1 || im.h < 1 || im.channels != 3))
        __builtin_trap();
    if (e == OK && (w < 1 || h < 1))
        __builtin_trap();
    exrfile_free(&im);
    return 0;
}
