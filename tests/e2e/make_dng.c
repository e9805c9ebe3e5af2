/* make_dng RADIANCE.exr EXPOSURE OUT.dng - the numbers of a sensor behind a mosaic, full at 1 /
 * EXPOSURE; its exposure time is that of EXPOSURE times 20 ms. Photon noise of 10,000 electrons. */
#include "drivers/format/exrfile.h"
#include "tests/unit/dng.h"

#include "core/base/splitmix.h"

#include <stdio.h>
#include <stdlib.h>

/* Of mean 0 and deviation 1, nearly normal. */
static double variate(uint64_t *rng)
{
    double sum = -6;
    for (int i = 0; i < 12; i++)
        sum += (double)(splitmix_next(rng) >> 11) * 0x1p-53;
    return sum;
}

static void expose(const struct image *im, double exposure, struct dng *out)
{
    const size_t n = (size_t)im->w * (size_t)im->h;
    uint64_t rng = 1;
    for (size_t i = 0; i < n; i++) {
        double rgb[3];
        for (size_t c = 0; c < 3; c++) {
            const double v = exposure * (double)im->px[c * n + i];
            rgb[c] = fmax(v + sqrt(fmin(v, 4) / 1e4) * variate(&rng), 0);
        }
        dng_site(out, im->w, (int)(i % (size_t)im->w), (int)(i / (size_t)im->w), rgb);
    }
}

int main(int argc, char **argv)
{
    struct image im;
    const double exposure = argc == 4 ? atof(argv[2]) : 0;
    if (!(exposure > 0) || exrfile_read(argv[1], &im) != OK)
        return 1;
    const size_t bytes = dng_bytes(im.w, im.h);
    struct dng t = {.p = calloc(1, bytes)};
    FILE *f = t.p ? fopen(argv[3], "wb") : NULL;
    if (!f)
        return 1;
    dng_head(&t, im.w, im.h, 1, (unsigned)lrint(20 * exposure));
    expose(&im, exposure, &t);
    const size_t written = fwrite(t.p, 1, bytes, f);
    return fclose(f) != 0 || written != bytes;
}
