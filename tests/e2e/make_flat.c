/* make_flat FILE SIZE VALUE [HOT] - a square PNG of one grey; HOT: value of its middle pixel. */
#include "drivers/format/img.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(int argc, char **argv)
{
    int size = argc > 3 ? atoi(argv[2]) : 0;
    if (size < 1 || size > 2048) {
        fprintf(stderr, "usage: make_flat FILE SIZE VALUE [HOT]\n");
        return 2;
    }
    size_t n = 3 * (size_t)size * (size_t)size;
    struct image8 im = {size, size, 3, malloc(n)};
    if (!im.px)
        return 1;
    memset(im.px, atoi(argv[3]), n);
    if (argc > 4)
        memset(im.px + 3 * ((size_t)size / 2 * (size_t)size + (size_t)size / 2), atoi(argv[4]), 3);
    err_t e = img_write_png(argv[1], &im);
    if (e)
        fprintf(stderr, "make_flat: %s\n", err_text());
    free(im.px);
    return e ? 1 : 0;
}
