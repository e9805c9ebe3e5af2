/* Pictures of a page against those of hdrig render:
 *   compare display A.png B.png        PSNR, dB, and the largest difference
 *   compare srgb EV A.exr B.png        the same; A is radiance, shown as sRGB at 2^EV
 *   compare false LOG2T A.exr B.png    the same; A is radiance, in false colours at exposure LOG2T
 *   compare radiance A.exr B.f32       median, 0.99 quantile and largest relative difference; B has
 *                                      w x h x 4 little-endian floats R, G, B, any; what the half
 *                                      floats of A cannot hold counts as their largest */
#include "core/base/half.h"
#include "core/photo/falsecolour.h"
#include "core/photo/metrics.h"
#include "core/splat/display.h"
#include "drivers/format/exrfile.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static err_t compare_display(const struct image8 *a, const char *path)
{
    struct image8 b = {0};
    err_t e = img_read(path, &b);
    if (!e && (a->w != b.w || a->h != b.h))
        e = err_fail(ERR_FORMAT, "%d x %d and %d x %d px", a->w, a->h, b.w, b.h);
    if (!e) {
        size_t n = 3 * (size_t)b.w * (size_t)b.h;
        double sum = 0;
        int most = 0;
        for (size_t i = 0; i < n; i++) {
            int d = abs(a->px[i] - b.px[i]);
            sum += d * d;
            most = d > most ? d : most;
        }
        printf("%.1f %d\n", fmin(10 * log10(255 * 255 * (double)n / sum), METRICS_PSNR_MAX), most);
    }
    img_free(&b);
    return e;
}

static void show_srgb(const struct image *a, double ev, struct image8 *out)
{
    size_t pixels = (size_t)a->w * (size_t)a->h;
    for (size_t i = 0; i < 3 * pixels; i++) {
        float v = display_encode(a->px[i % 3 * pixels + i / 3] * (float)exp2(ev));
        out->px[i] = (uint8_t)lroundf(255 * fminf(v, 1));
    }
}

static err_t compare_shown(const char *how, double number, const char *exr, const char *path)
{
    struct image a = {0};
    struct image8 shown = {0};
    err_t e = exrfile_read(exr, &a);
    if (!e) {
        shown = (struct image8){a.w, a.h, 3, malloc(3 * (size_t)a.w * (size_t)a.h)};
        e = shown.px ? OK : err_fail(ERR_NOMEM, "no memory");
    }
    if (!e && strcmp(how, "srgb") == 0)
        show_srgb(&a, number, &shown);
    else if (!e)
        falsecolour_run(&a, (float)number, &shown);
    if (!e)
        e = compare_display(&shown, path);
    free(shown.px);
    exrfile_free(&a);
    return e;
}

static int by_size(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static err_t print_differences(const struct image *a, const float *b)
{
    size_t pixels = (size_t)a->w * (size_t)a->h, n = 3 * pixels;
    float *d = calloc(n, sizeof *d);
    if (!d)
        return err_fail(ERR_NOMEM, "no memory");
    for (size_t i = 0; i < n; i++) {
        float v = a->px[i], w = fminf(b[4 * (i % pixels) + i / pixels], HALF_MAX);
        d[i] = v == w ? 0 : fabsf(v - w) / fmaxf(v, 1e-6f);
    }
    qsort(d, n, sizeof *d, by_size);
    printf("%.6f %.6f %.6f\n", (double)d[n / 2], (double)d[n * 99 / 100], (double)d[n - 1]);
    free(d);
    return OK;
}

static err_t compare_radiance(const char *exr, const char *raw)
{
    struct image a = {0};
    struct file_map b = {0};
    err_t e = exrfile_read(exr, &a);
    if (!e)
        e = file_map(raw, SIZE_MAX / 2, &b);
    if (!e && b.n != (size_t)a.w * (size_t)a.h * 4 * sizeof(float))
        e = err_fail(ERR_FORMAT, "%s: %zu bytes for %d x %d px", raw, b.n, a.w, a.h);
    if (!e)
        e = print_differences(&a, (const float *)(const void *)b.p);
    file_unmap(&b);
    exrfile_free(&a);
    return e;
}

int main(int argc, char **argv)
{
    const char *how = argc > 3 ? argv[1] : "";
    err_t e;
    if (strcmp(how, "display") == 0) {
        struct image8 a;
        e = img_read(argv[2], &a);
        if (!e)
            e = compare_display(&a, argv[3]);
        img_free(&a);
    } else if (strcmp(how, "radiance") == 0) {
        e = compare_radiance(argv[2], argv[3]);
    } else if (argc == 5 && (strcmp(how, "srgb") == 0 || strcmp(how, "false") == 0)) {
        e = compare_shown(how, atof(argv[2]), argv[3], argv[4]);
    } else {
        fprintf(stderr, "usage: compare display|radiance A B | srgb|false NUMBER A B\n");
        return 2;
    }
    if (e)
        fprintf(stderr, "compare: %s\n", err_text());
    return e ? 1 : 0;
}
