/* picture OUT WIDTH COLUMNS FILE.png... - tiles of equal size, square, in rows; the last has the
 * legend of false colours at its edge. */
#include "core/photo/falsecolour.h"
#include "drivers/format/img.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { GAP = 8, PAPER = 255 };

/* Mean over [from, to) of one axis of a line of `n` values, `stride` apart. */
static double mean(const uint8_t *v, size_t stride, int n, double from, double to)
{
    double sum = 0;
    for (int i = (int)from; i < n && i < to; i++) {
        double a = i > from ? i : from, b = i + 1 < to ? i + 1 : to;
        sum += v[(size_t)i * stride] * (b - a);
    }
    return sum / (to - from);
}

/* Shrink `in` to side x side px at x, y of out. */
static err_t place(const struct image8 *in, const struct image8 *out, int x, int y, int side)
{
    double sx = (double)in->w / side, sy = (double)in->h / side;
    uint8_t *rows = malloc(3 * (size_t)side * (size_t)in->h); // shrunk across, not yet down
    if (!rows)
        return err_fail(ERR_NOMEM, "no memory for %d px", side);
    for (int i = 0; i < 3 * side * in->h; i++) {
        int c = i % 3, column = i / 3 % side, row = i / 3 / side;
        const uint8_t *line = in->px + 3 * (size_t)row * (size_t)in->w + c;
        rows[i] = (uint8_t)(mean(line, 3, in->w, column * sx, (column + 1) * sx) + 0.5);
    }
    for (int i = 0; i < 3 * side * side; i++) {
        int row = i / 3 / side, k = i % (3 * side);
        double v = mean(rows + k, 3 * (size_t)side, in->h, row * sy, (row + 1) * sy);
        out->px[3 * ((size_t)(y + row) * (size_t)out->w + (size_t)x) + (size_t)k] =
            (uint8_t)(v + 0.5);
    }
    free(rows);
    return OK;
}

static err_t add_legend(const struct image8 *out, int x, int y, int side)
{
    struct image8 bar = {FALSECOLOUR_LEGEND_W, side, 3,
                         malloc((size_t)(3 * side * FALSECOLOUR_LEGEND_W))};
    if (!bar.px)
        return err_fail(ERR_NOMEM, "no memory for the legend");
    falsecolour_legend(&bar);
    for (int row = 0; row < side; row++)
        memcpy(out->px + 3 * ((size_t)(y + row) * (size_t)out->w + (size_t)(x + side - bar.w)),
               bar.px + 3 * row * bar.w, 3 * (size_t)bar.w);
    free(bar.px);
    return OK;
}

static err_t compose(const struct image8 *out, int columns, int n, char **files)
{
    int side = (out->w + GAP) / columns - GAP, x = 0, y = 0;
    err_t e = OK;
    for (int i = 0; i < n && !e; i++) {
        struct image8 in;
        x = i % columns * (side + GAP);
        y = i / columns * (side + GAP);
        e = img_read(files[i], &in);
        if (!e)
            e = place(&in, out, x, y, side);
        img_free(&in);
    }
    return e ? e : add_legend(out, x, y, side);
}

int main(int argc, char **argv)
{
    int width = argc > 4 ? atoi(argv[2]) : 0, columns = argc > 4 ? atoi(argv[3]) : 0;
    if (width < 64 || width > 8192 || columns < 1 || columns > width / 64) {
        fprintf(stderr, "usage: picture OUT.png WIDTH COLUMNS FILE.png...\n");
        return 2;
    }
    int rows = (argc - 4 + columns - 1) / columns, side = (width + GAP) / columns - GAP;
    struct image8 out = {width, rows * (side + GAP) - GAP, 3, NULL};
    size_t bytes = 3 * (size_t)out.w * (size_t)out.h;
    out.px = malloc(bytes);
    err_t e = out.px ? OK : err_fail(ERR_NOMEM, "no memory for %d x %d px", out.w, out.h);
    if (!e) {
        memset(out.px, PAPER, bytes);
        e = compose(&out, columns, argc - 4, argv + 4);
    }
    if (!e)
        e = img_write_png(argv[1], &out);
    if (e)
        fprintf(stderr, "picture: %s\n", err_text());
    free(out.px);
    return e ? 1 : 0;
}
