/* The page: head with a policy that allows this style and this script by their SHA-256 and nothing
 * else but pictures in data: addresses; style; the skeleton; two blocks of JSON, pictures and
 * report; the script. In the blocks every '<' is written as an escape, so no name can end them.
 * A picture is a strip of four squares: photograph, scene, their distance averaged over the box of
 * each pixel, black over red and yellow to white at a quarter of full scale, or stripes where the
 * photograph does not count, and the confidence, black to white. */
#include "firmware/result/report_page.h"

#include "firmware/result/embed.h"

#include "core/base/base64.h"
#include "core/base/num.h"
#include "core/base/sha256.h"
#include "core/photo/prep.h"
#include "drivers/format/img.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

EMBED_FILE(sheet_html, "firmware/web/report.html");
EMBED_FILE(sheet_css, "firmware/web/report.css");
EMBED_FILE(sheet_js, "firmware/web/report.js");

enum { THUMB = 192, QUALITY = 70, SQUARES = 4, STRIPE = 4 }; // px, longest edge; px of a stripe
static const double ERROR_WHITE = 0.25;

uint64_t report_page_bytes(int n_pictures)
{
    uint64_t strip = 3 * SQUARES * THUMB * THUMB; // a JPEG of noise is smaller than its pixels
    return (uint64_t)n_pictures * (base64_chars(strip) + 4096) + (1 << 18);
}

/* ---- pictures ---- */

struct sums { // over the box of a thumbnail's pixel
    double photograph[3], display[3], error, sure;
    int left_out;
};

static struct sums sum_box(const struct image8 *photograph,
                           const struct report_page_drawing *drawing, const int box[4])
{
    const size_t plane = (size_t)photograph->w * (size_t)photograph->h;
    const struct image *display = drawing ? drawing->display : NULL;
    struct sums s = {0};
    for (int y = box[1]; y < box[3]; y++)
        for (int x = box[0]; x < box[2]; x++)
            for (int c = 0; c < 3; c++) {
                size_t at = (size_t)y * (size_t)photograph->w + (size_t)x;
                s.left_out += drawing && drawing->left_out && drawing->left_out[at];
                s.sure += drawing ? (double)drawing->confidence[at] / 3 : 0;
                double z = photograph->px[3 * at + (size_t)c] / 255.0;
                double d = display ? (double)display->px[(size_t)c * plane + at] : z;
                s.photograph[c] += z;
                s.display[c] += d;
                s.error += fabs(d - z) / 3;
            }
    return s;
}

static uint8_t srgb_code(double v)
{
    return (uint8_t)(v > 0 ? v < 1 ? v * 255 + 0.5 : 255 : 0); // a NaN is black
}

/* Diagonal stripes in place of distances, which have no blue without red and green. */
static void put_stripe(int x, int y, uint8_t out[3])
{
    static const uint8_t stripe[2][3] = {{96, 144, 255}, {24, 36, 96}};
    memcpy(out, stripe[(x + y) / STRIPE % 2], 3);
}

/* out: a pixel of each square. */
static void mean_of(const struct sums *s, int n, uint8_t out[SQUARES][3])
{
    double error = 3 * s->error / n / ERROR_WHITE;
    for (int c = 0; c < 3; c++) {
        out[0][c] = srgb_code(s->photograph[c] / n);
        out[1][c] = srgb_code(s->display[c] / n);
        out[2][c] = srgb_code(error - c);
        out[3][c] = srgb_code(s->sure / n);
    }
}

/* own: free(out->px). */
static err_t make_strip(const struct report_page *s, const struct image8 *photograph,
                        const struct report_page_drawing *drawing, struct image8 *out)
{
    const struct extent thumb = prep_extent(
        (struct prep_size){.edge = num_min(num_max(photograph->w, photograph->h), THUMB)},
        photograph->w, photograph->h);
    const int squares = drawing ? SQUARES : 1, w = thumb.w, h = thumb.h;
    uint8_t *px = calloc(extent_pixels(&thumb), 3 * SQUARES);
    if (!px)
        return err_fail(ERR_NOMEM, "%s: no memory for a thumbnail", s->path);
    *out = (struct image8){squares * w, h, 3, px};
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            const int box[4] = {x * photograph->w / w, y * photograph->h / h,
                                (x + 1) * photograph->w / w, (y + 1) * photograph->h / h};
            struct sums sum = sum_box(photograph, drawing, box);
            uint8_t mean[SQUARES][3];
            const int n = (box[2] - box[0]) * (box[3] - box[1]);
            mean_of(&sum, n, mean);
            if (2 * sum.left_out > 3 * n)
                put_stripe(x, y, mean[2]);
            for (int k = 0; k < squares; k++)
                memcpy(px + 3 * ((y * squares + k) * w + x), mean[k], 3);
        }
    return OK;
}

err_t report_page_picture(struct report_page *s, int i, const struct image8 *photograph,
                          const struct report_page_drawing *drawing)
{
    const struct image *display = drawing ? drawing->display : NULL;
    struct image8 strip;
    void *jpeg;
    size_t n;
    const int w = photograph->w, h = photograph->h;
    if (w < 1 || h < 1 || (display && (display->w != w || display->h != h)))
        return err_fail(ERR_ARG, "%s: picture of %d x %d px, the scene's has %d x %d", s->path, w,
                        h, display ? display->w : 0, display ? display->h : 0);
    err_t e = make_strip(s, photograph, drawing, &strip);
    if (e)
        return e;
    e = img_encode_jpeg(&strip, QUALITY, s->path, &jpeg, &n);
    free(strip.px);
    if (e)
        return e;
    char *text = malloc(base64_chars(n));
    if (text) {
        base64_encode(text, jpeg, n);
        fprintf(s->f, "%s\n\"%d\": \"data:image/jpeg;base64,", s->n++ > 0 ? "," : "", i);
        fwrite(text, 1, base64_chars(n), s->f);
        putc('"', s->f);
    } else {
        e = err_fail(ERR_NOMEM, "%s: no memory for a thumbnail", s->path);
    }
    free(text);
    free(jpeg);
    return e;
}

/* ---- page ---- */

/* 'sha256-...' of a policy. */
static void put_hash(FILE *f, const char *text, size_t n)
{
    struct sha256 sha;
    char hex[SHA256_HEX_CAP], digits[64];
    uint8_t raw[32];
    sha256_init(&sha);
    sha256_add(&sha, text, n);
    sha256_hex(&sha, hex);
    for (size_t i = 0; i < sizeof raw; i++) {
        const char byte[3] = {hex[2 * i], hex[2 * i + 1], 0};
        raw[i] = (uint8_t)strtoul(byte, NULL, 16);
    }
    fprintf(f, "'sha256-%.*s'", (int)(base64_encode(digits, raw, sizeof raw) - digits), digits);
}

err_t report_page_open(const char *path, struct report_page *s)
{
    memset(s, 0, sizeof *s);
    if (strlen(path) >= sizeof s->path)
        return err_fail(ERR_ARG, "%s: longer than %d bytes", path, FILE_PATH_CAP - 1);
    strcpy(s->path, path);
    err_t e = file_create(path, &s->f);
    if (e) {
        memset(s, 0, sizeof *s);
        return e;
    }
    fputs("<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n"
          "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; "
          "img-src data:; base-uri 'none'; form-action 'none'; style-src ",
          s->f);
    put_hash(s->f, sheet_css, sheet_css_size);
    fputs("; script-src ", s->f);
    put_hash(s->f, sheet_js, sheet_js_size);
    fputs("\">\n<style>", s->f);
    fwrite(sheet_css, 1, sheet_css_size, s->f);
    fputs("</style>\n", s->f);
    fwrite(sheet_html, 1, sheet_html_size, s->f);
    fputs("<script type=\"application/json\" id=\"pictures\">{", s->f);
    return OK;
}

err_t report_page_close(struct report_page *s, const char *json)
{
    FILE *f = s->f;
    struct file_map text;
    err_t e = file_map(json, SIZE_MAX, &text);
    if (e) {
        report_page_discard(s);
        return e;
    }
    fputs("}</script>\n<script type=\"application/json\" id=\"data\">", f);
    for (size_t i = 0; i < text.n; i++)
        if (text.p[i] == '<')
            fputs("\\u003c", f);
        else
            putc(text.p[i], f);
    file_unmap(&text);
    fputs("</script>\n<script>", f);
    fwrite(sheet_js, 1, sheet_js_size, f);
    fputs("</script>\n", f);
    s->f = NULL;
    return file_finish(f, s->path);
}

void report_page_discard(struct report_page *s)
{
    if (s->f)
        file_discard(s->f, s->path);
    s->f = NULL;
}

err_t report_page_write(const char *path, const struct job_result *j, const char *json)
{
    const struct views *v = &j->views;
    struct report_page s;
    err_t e = report_page_open(path, &s);
    for (int i = 0; i < v->n + v->n_more && !e; i++) {
        const struct image8 photograph = {v->extent[i].w, v->extent[i].h, 3, views_rgb(v, i)};
        e = report_page_picture(&s, i, &photograph, NULL);
    }
    if (!e)
        return report_page_close(&s, json);
    report_page_discard(&s);
    return e;
}
