/* Any bytes as a picture: decoded, and asked for the exposure of its EXIF data. */
#include "drivers/format/img.h"
#include "drivers/format/imgsize.h"
#include "drivers/format/photofile.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *p, size_t n);

int LLVMFuzzerTestOneInput(const uint8_t *p, size_t n)
{
    struct image8 im;
    struct image16 deep = {0};
    bool linear;
    int w, h;
    struct img_exif exif;
    if (img_read_mem(p, n, "fuzz", &im) == OK && (im.w < 1 || im.h < 1 || im.channels != 3))
        __builtin_trap();
    if (imgsize_parse("fuzz", p, n, &w, &h) == OK && (w < 1 || h < 1))
        __builtin_trap();
    if (img_is_deep(p, n, &linear) && img_read16_mem(p, n, "fuzz", &deep) == OK && !deep.px)
        __builtin_trap();
    free(deep.px);
    const struct photofile *photo = photofile_of(p, n);
    if (photo && photo->read(p, n, "fuzz", &deep) == OK) {
        if (deep.w < 1 || deep.h < 1 || !deep.px)
            __builtin_trap();
        free(deep.px);
    }
    img_free(&im);
    if (img_exif_mem(p, n, "fuzz", &exif) == OK && !(img_exif_exposure(&exif) > 0.0))
        __builtin_trap();
    return 0;
}
