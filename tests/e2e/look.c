/* look mean FILE.png...: its mean, 0..255, on a line each.
 * look false FILE.exr FILE.png LUMINANCE: the largest difference, 0..255, between the second and
 * the first in false colours that show 0 stops at LUMINANCE. */
#include "core/photo/falsecolour.h"
#include "drivers/format/exrfile.h"
#include "drivers/format/img.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static err_t print_mean(const char *path)
{
    struct image8 im;
    double sum = 0;
    err_t e = img_read(path, &im);
    if (e)
        return e;
    size_t n = 3 * (size_t)im.w * (size_t)im.h;
    for (size_t i = 0; i < n; i++)
        sum += im.px[i];
    printf("%.3f\n", sum / (double)n);
    img_free(&im);
    return OK;
}

static err_t compare(const char *exr, const char *png, float log2t)
{
    struct image radiance = {0};
    struct image8 got = {0}, want = {0};
    err_t e = exrfile_read(exr, &radiance);
    if (!e)
        e = img_read(png, &got);
    if (!e)
        e = img_read(png, &want); // for its shape
    if (!e && (got.w != radiance.w || got.h != radiance.h))
        e = err_fail(ERR_FORMAT, "%s and %s differ in size", exr, png);
    if (!e) {
        int most = 0;
        falsecolour_run(&radiance, log2t, &want);
        for (int i = 0; i < 3 * got.w * got.h; i++)
            most = abs(got.px[i] - want.px[i]) > most ? abs(got.px[i] - want.px[i]) : most;
        printf("%d\n", most);
    }
    exrfile_free(&radiance);
    img_free(&got);
    img_free(&want);
    return e;
}

int main(int argc, char **argv)
{
    err_t e = OK;
    bool mean = argc > 2 && strcmp(argv[1], "mean") == 0;
    if (!mean && !(argc == 5 && strcmp(argv[1], "false") == 0)) {
        fprintf(stderr, "usage: look mean FILE.png... | look false FILE.exr FILE.png LUMINANCE\n");
        return 2;
    }
    for (int i = 2; i < argc && !e && mean; i++)
        e = print_mean(argv[i]);
    if (!mean)
        e = compare(argv[2], argv[3], -log2f(strtof(argv[4], NULL)));
    if (e)
        fprintf(stderr, "look: %s\n", err_text());
    return e ? 1 : 0;
}
