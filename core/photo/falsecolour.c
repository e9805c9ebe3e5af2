/* Turbo by the polynomial of degree 5 that A. Mikhailov and R. du Ruyter published with it ("Turbo,
 * An Improved Rainbow Colormap for Visualization", Google AI Blog 2019). */
#include "core/photo/falsecolour.h"

#include <math.h>
#include <string.h>

enum { SHOWN = FALSECOLOUR_STOPS + 1, GLYPH_W = 5, GLYPH_H = 7, LABEL_STEP = 4 };

static const uint8_t NOT_A_NUMBER[3] = {255, 0, 255}, PAPER[3] = {32, 32, 32},
                     INK[3] = {224, 224, 224};

float falsecolour_stops(const float rgb[3])
{
    float y = 0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2]; // ITU-R BT.709
    return y <= 0 ? -INFINITY : log2f(y);
}

void falsecolour_of(float stops, uint8_t rgb[3])
{
    static const float turbo[3][6] = {
        {0.13572138f, 4.61539260f, -42.66032258f, 132.13108234f, -152.94239396f, 59.28637943f},
        {0.09140261f, 2.19418839f, 4.84296658f, -14.18503333f, 4.27729857f, 2.82956604f},
        {0.10667330f, 12.64194608f, -60.58204836f, 110.36276771f, -89.90310912f, 27.34824973f},
    };
    float x = (stops + FALSECOLOUR_STOPS) / (2 * FALSECOLOUR_STOPS);
    if (isnan(stops))
        memcpy(rgb, NOT_A_NUMBER, 3);
    else if (x < 0 || x > 1)
        memset(rgb, x < 0 ? 0 : 255, 3);
    else
        for (int c = 0; c < 3; c++) {
            float v = 0;
            for (int k = 5; k >= 0; k--)
                v = v * x + turbo[c][k];
            rgb[c] = (uint8_t)(255 * fminf(fmaxf(v, 0), 1) + 0.5f);
        }
}

void falsecolour_run(const struct image *radiance, float log2t, const struct image8 *out)
{
    size_t pixels = (size_t)radiance->w * (size_t)radiance->h;
    for (size_t i = 0; i < pixels; i++) {
        const float *px = radiance->px + i;
        const float rgb[3] = {px[0], px[pixels], px[2 * pixels]};
        falsecolour_of(falsecolour_stops(rgb) + log2t, out->px + 3 * i);
    }
}

/* ---- legend ---- */

static void fill_box(const struct image8 *out, const int box[4], const uint8_t rgb[3])
{
    for (int y = box[1] < 0 ? 0 : box[1]; y < box[3] && y < out->h; y++)
        for (int x = box[0]; x < box[2] && x < out->w; x++)
            memcpy(out->px + 3 * ((size_t)y * (size_t)out->w + (size_t)x), rgb, 3);
}

/* One of "+-048" with its upper left corner at x, y; a dot is `scale` px wide. */
static void draw_glyph(const struct image8 *out, char which, int x, int y, int scale)
{
    static const char names[] = "+-048";
    static const uint8_t rows[][GLYPH_H] = {{0x00, 0x04, 0x04, 0x1f, 0x04, 0x04, 0x00},
                                            {0x00, 0x00, 0x00, 0x1f, 0x00, 0x00, 0x00},
                                            {0x0e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e},
                                            {0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02},
                                            {0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e}};
    const uint8_t *row = rows[strchr(names, which) - names];
    for (int i = 0; i < GLYPH_W * GLYPH_H; i++) {
        int left = x + scale * (i % GLYPH_W), top = y + scale * (i / GLYPH_W);
        const int dot[4] = {left, top, left + scale, top + scale};
        if (row[i / GLYPH_W] >> (GLYPH_W - 1 - i % GLYPH_W) & 1)
            fill_box(out, dot, INK);
    }
}

void falsecolour_legend(const struct image8 *out)
{
    int scale = out->w < FALSECOLOUR_LEGEND_W ? 1 : out->w / FALSECOLOUR_LEGEND_W;
    int bar = out->w * 2 / 5;
    const int all[4] = {0, 0, out->w, out->h};
    fill_box(out, all, PAPER);
    for (int y = 0; y < out->h; y++) {
        const int line[4] = {0, y, bar, y + 1};
        uint8_t rgb[3];
        falsecolour_of(SHOWN - 2 * SHOWN * ((float)y + 0.5f) / (float)out->h, rgb);
        fill_box(out, line, rgb);
    }
    for (int s = -FALSECOLOUR_STOPS; s <= FALSECOLOUR_STOPS; s++) {
        bool labelled = s % LABEL_STEP == 0;
        int y = out->h * (SHOWN - s) / (2 * SHOWN), x = bar + 3 * scale;
        const int tick[4] = {bar, y, labelled ? x : x - 2 * scale, y + scale};
        fill_box(out, tick, INK);
        if (!labelled)
            continue;
        if (s != 0)
            draw_glyph(out, s < 0 ? '-' : '+', x + scale, y - 3 * scale, scale);
        draw_glyph(out, (char)('0' + (s < 0 ? -s : s)), x + (GLYPH_W + 2) * scale, y - 3 * scale,
                   scale);
    }
}
