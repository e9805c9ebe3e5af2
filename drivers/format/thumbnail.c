/* Some rows of each pixel's are added up, then their sums along x: with all rows it takes four
 * times as long, and nobody sees a difference. */
#include "drivers/format/thumbnail.h"

#include "core/base/num.h"
#include "drivers/format/img.h"

#include <stdlib.h>
#include <string.h>

enum { QUALITY = 75, HEADERS = 4096, ROWS = 4 };

/* Size of the thumbnail of a picture. */
static struct image8 size_of(int w, int h)
{
    const int longest = num_max(w, h);
    if (longest <= THUMBNAIL_EDGE)
        return (struct image8){w, h, 3, NULL};
    return (struct image8){num_max(1, (int)(((int64_t)w * THUMBNAIL_EDGE + longest / 2) / longest)),
                           num_max(1, (int)(((int64_t)h * THUMBNAIL_EDGE + longest / 2) / longest)),
                           3, NULL};
}

uint64_t thumbnail_need(int w, int h)
{
    const struct image8 small = size_of(w, h);
    return 6 * (uint64_t)small.w * (uint64_t)small.h + HEADERS; // as the encoder reserves
}

/* First of the n pixels that pixel i of m covers. */
static int first_of(int i, int n, int m)
{
    return (int)((int64_t)i * n / m);
}

/* Means of the columns of a row of sums over so many rows. */
static void shrink_row(const uint32_t *sum, int w, int rows, int small_w, uint8_t *out)
{
    for (int x = 0; x < small_w; x++) {
        const int from = first_of(x, w, small_w), end = first_of(x + 1, w, small_w);
        const uint32_t n = (uint32_t)(rows * (end - from));
        for (int c = 0; c < 3; c++) {
            uint32_t v = n / 2;
            for (int k = from; k < end; k++)
                v += sum[3 * k + c];
            out[3 * x + c] = (uint8_t)(v / n);
        }
    }
}

static void shrink(const struct image8 *im, uint32_t *sum, const struct image8 *out)
{
    const size_t n = 3 * (size_t)im->w;
    for (int y = 0; y < out->h; y++) {
        const int from = first_of(y, im->h, out->h), end = first_of(y + 1, im->h, out->h);
        const int rows = num_min(ROWS, end - from);
        memset(sum, 0, n * sizeof *sum);
        for (int k = 0; k < rows; k++) {
            const uint8_t *px = im->px + n * (size_t)(from + first_of(k, end - from, rows));
            for (size_t i = 0; i < n; i++)
                sum[i] += px[i];
        }
        shrink_row(sum, im->w, rows, out->w, out->px + 3 * (size_t)out->w * (size_t)y);
    }
}

err_t thumbnail_make(const struct image8 *im, const char *name, void **bytes, size_t *n)
{
    struct image8 small = size_of(im->w, im->h);
    uint32_t *sum = malloc(3 * (size_t)im->w * sizeof *sum);
    small.px = malloc(3 * (size_t)small.w * (size_t)small.h);
    *bytes = NULL;
    err_t e = OK;
    if (!sum || !small.px)
        e = err_fail(ERR_NOMEM, "%s: no memory to make it", name);
    if (!e) {
        shrink(im, sum, &small);
        e = img_encode_jpeg(&small, QUALITY, name, bytes, n);
    }
    img_free(&small);
    free(sum);
    return e;
}

err_t thumbnail_of_jpeg(const void *jpeg, size_t size, const char *name, void **bytes, size_t *n)
{
    struct image8 im;
    *bytes = NULL;
    err_t e = img_read_jpeg_small(jpeg, size, name, THUMBNAIL_EDGE, &im);
    if (!e)
        e = thumbnail_make(&im, name, bytes, n);
    img_free(&im);
    return e;
}
