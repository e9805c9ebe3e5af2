/* The page is firmware/web/view.html with @css@, @splats@ and @js@ (the files beside it), @title@,
 * @info@ and @scene@ replaced.
 * @info@ is JSON: ranges and sizes below, tone curve, background, cameras, photographs as JPEG.
 * @scene@ is base64 of little-endian data. First 32 bytes for each splat:
 *   float x, y, z
 *   uint16 log_scale[3], logit            lo + step * value, with lo and step in @info@
 *   uint16 q[3]                           of the unit quaternion w,x,y,z all but the largest, which
 *                                         is positive: bits 0-14 are (value / sqrt(1/2) + 1) 16383;
 *                                         bit 15 of q[0] and q[1]: which one is the largest, of
 *                                         q[2]: the splat is a guess (core/refine/confidence.h)
 *   uint16 light[3]                       natural-log radiance of degree 0: lo + step * value
 * then for each splat the harmonics above degree 0 as half floats, coefficient by coefficient, red,
 * green, blue, filled up to 16 bytes.
 * Radiance of 1e-4 to 1e5 is kept to 2e-4 of its value, scales likewise.
 * `unit`: the page divides radiance by this power of two, so that the brightest splat fits into the
 * half floats of its picture; but 24 stops over the middle of the tone curve have to do, else one
 * wrong splat would leave nothing for the rest. */
#include "firmware/result/viewer.h"

#include "firmware/result/embed.h"

#include "core/base/base64.h"
#include "core/base/bytes.h"
#include "core/base/gaussians.h"
#include "core/base/half.h"
#include "core/kernels/kernels.h"
#include "core/refine/confidence.h"
#include "core/splat/display.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"
#include "drivers/format/json.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

EMBED_FILE(viewer_html, "firmware/web/view.html");
EMBED_FILE(viewer_css, "firmware/web/view.css");
EMBED_FILE(viewer_splats, "firmware/web/splats.js");
EMBED_FILE(viewer_js, "firmware/web/view.js");

enum { SPLAT_BYTES = 32, TEXEL_BYTES = 16, INFO_BYTES = 1 << 15, VIEW_BYTES = 2048, QUALITY = 90 };
enum { PIECE = 3 * 1024 }; // bytes encoded at once
enum { LOG_SCALE, LOGIT, LIGHT, N_RANGES };

#define UNIT_STOPS 24.0

/* Numbers stored in 16 bits. */
struct range {
    double lo, hi;
};

struct page {
    FILE *f;
    const struct viewer_input *in;
    int n, degree; // splats and harmonics that it holds
    struct range range[N_RANGES];
    double unit;
};

/* ---- drawn splats ---- */

static int sh_bytes(int degree)
{
    int halves = 3 * ((degree + 1) * (degree + 1) - 1);
    return (2 * halves + TEXEL_BYTES - 1) / TEXEL_BYTES * TEXEL_BYTES;
}

static int page_degree(int n, int degree)
{
    while (degree > 0 && (int64_t)n * (SPLAT_BYTES + sh_bytes(degree)) > VIEWER_SCENE_MAX)
        degree--;
    return degree;
}

static bool is_drawn(const struct gaussians *g, int i)
{
    float sum = 0;
    for (int p = 0; p < gaussians_planes(g->degree); p++)
        sum += g->plane[p][i] * 0;
    float opacity = 1 / (1 + expf(-g->plane[G_LOGIT][i]));
    return sum == 0 && opacity >= RASTER_ALPHA_MIN;
}

static void widen_range(struct range *r, double v)
{
    r->lo = fmin(r->lo, v);
    r->hi = fmax(r->hi, v);
}

/* Log radiance that splat i exceeds in no direction: the addition theorem bounds each band. */
static double brightest_radiance(const struct gaussians *g, int i, int degree)
{
    double top = -INFINITY;
    for (int c = 0; c < 3; c++) {
        double sum = SH_BASIS0 * (double)g->plane[G_SH + c][i];
        for (int l = 1; l <= degree; l++) {
            double squares = 0;
            for (int k = l * l; k < (l + 1) * (l + 1); k++)
                squares += pow((double)g->plane[G_SH + 3 * k + c][i], 2);
            sum += sqrt(squares * (2 * l + 1)) * SH_BASIS0;
        }
        top = fmax(top, sum);
    }
    return fmin(top, (double)RASTER_LOG_MAX);
}

static double stored_logit(const struct gaussians *g, int i)
{
    return fmin((double)g->plane[G_LOGIT][i], 12); // 1 - 6e-6: far above the cap
}

static double stored_light(const struct gaussians *g, int colour, int i)
{
    double v = SH_BASIS0 * (double)g->plane[G_SH + colour][i];
    return fmin(fmax(v, -(double)RASTER_LOG_MAX), (double)RASTER_LOG_MAX);
}

static void find_ranges(struct page *p)
{
    const struct scene *s = p->in->scene;
    double top = -INFINITY, middle = pow(0.5, (double)display_ev(&s->tone));
    for (int k = 0; k < N_RANGES; k++)
        p->range[k] = (struct range){INFINITY, -INFINITY};
    p->n = 0;
    for (int i = 0; i < s->g.n; i++) {
        if (!is_drawn(&s->g, i))
            continue;
        p->n++;
        for (int k = 0; k < 3; k++) {
            widen_range(&p->range[LOG_SCALE], (double)s->g.plane[G_LOG_SCALE + k][i]);
            widen_range(&p->range[LIGHT], stored_light(&s->g, k, i));
        }
        widen_range(&p->range[LOGIT], stored_logit(&s->g, i));
        top = fmax(top, brightest_radiance(&s->g, i, p->degree));
    }
    double light = exp(top);
    for (int k = 0; k < 3; k++)
        light = fmax(light, (double)s->background[k]);
    light = fmin(light, middle * exp2(UNIT_STOPS));
    p->unit = light > 0 ? exp2(ceil(log2(light / (double)HALF_MAX))) : 1;
    for (int k = 0; k < N_RANGES && p->n == 0; k++)
        p->range[k] = (struct range){0, 0};
}

/* ---- base64 ---- */

/* n <= PIECE */
static void put_base64(FILE *f, const uint8_t *bytes, size_t n)
{
    char text[PIECE / 3 * 4];
    const char *end = base64_encode(text, bytes, n);
    fwrite(text, 1, (size_t)(end - text), f);
}

struct encoder {
    FILE *f;
    size_t n;
    uint8_t piece[PIECE];
};

static void encoder_flush(struct encoder *e)
{
    put_base64(e->f, e->piece, e->n);
    e->n = 0;
}

/* n divides PIECE. */
static void encoder_add(struct encoder *e, const uint8_t *p, size_t n)
{
    memcpy(e->piece + e->n, p, n);
    e->n += n;
    if (e->n == PIECE)
        encoder_flush(e);
}

/* ---- splats ---- */

static double range_step(const struct range *r)
{
    return (r->hi - r->lo) / UINT16_MAX;
}

static uint16_t quantise_16(const struct range *r, double v)
{
    return r->hi > r->lo ? (uint16_t)lround((v - r->lo) / range_step(r)) : 0;
}

static void pack_quat(const struct gaussians *g, int i, uint16_t out[3])
{
    double q[4], big = 0, sum = 0;
    int largest = 0, n = 0;
    for (int k = 0; k < 4; k++) {
        q[k] = (double)g->plane[G_QUAT + k][i];
        sum += q[k] * q[k];
        if (fabs(q[k]) > big) {
            big = fabs(q[k]);
            largest = k;
        }
    }
    double scale = big > 1e-30 ? copysign(sqrt(2 / sum), q[largest]) : 0; // 0: the identity
    for (int k = 0; k < 4; k++)
        if (k != largest)
            out[n++] = (uint16_t)lround((q[k] * scale + 1) * 16383);
    out[0] |= (uint16_t)((largest & 1) << 15);
    out[1] |= (uint16_t)((largest >> 1) << 15);
}

static bool is_guess(const struct scene *s, int i)
{
    return s->confidence && s->confidence[i] < CONFIDENCE_GUESS;
}

static void put_splat(const struct page *p, int i, struct encoder *out)
{
    const struct gaussians *g = &p->in->scene->g;
    uint8_t bytes[SPLAT_BYTES], *to = bytes;
    uint16_t quat[3];
    for (int k = 0; k < 3; k++)
        to = bytes_put_f32(to, g->plane[G_MU + k][i]);
    for (int k = 0; k < 3; k++)
        to = bytes_put_u16(to,
                           quantise_16(&p->range[LOG_SCALE], (double)g->plane[G_LOG_SCALE + k][i]));
    to = bytes_put_u16(to, quantise_16(&p->range[LOGIT], stored_logit(g, i)));
    pack_quat(g, i, quat);
    quat[2] |= (uint16_t)(is_guess(p->in->scene, i) << 15);
    for (int k = 0; k < 3; k++)
        to = bytes_put_u16(to, quat[k]);
    for (int k = 0; k < 3; k++)
        to = bytes_put_u16(to, quantise_16(&p->range[LIGHT], stored_light(g, k, i)));
    encoder_add(out, bytes, sizeof bytes);
}

static void put_harmonics(const struct page *p, int i, struct encoder *out)
{
    const struct gaussians *g = &p->in->scene->g;
    int n = 3 * ((p->degree + 1) * (p->degree + 1) - 1);
    uint8_t texel[TEXEL_BYTES];
    for (int j = 0; j < n; j += TEXEL_BYTES / 2) {
        uint8_t *to = texel;
        for (int k = j; k < j + TEXEL_BYTES / 2; k++)
            to = bytes_put_u16(to, k < n ? half_from_float_sat(g->plane[G_SH + 3 + k][i]) : 0);
        encoder_add(out, texel, sizeof texel);
    }
}

static void put_scene(const struct page *p)
{
    struct encoder out = {.f = p->f};
    const struct gaussians *g = &p->in->scene->g;
    for (int i = 0; i < g->n; i++)
        if (is_drawn(g, i))
            put_splat(p, i, &out);
    for (int i = 0; i < g->n && p->degree > 0; i++)
        if (is_drawn(g, i))
            put_harmonics(p, i, &out);
    encoder_flush(&out);
}

/* ---- data of the page ---- */

static void put_floats(FILE *f, const char *key, const float *v, int n)
{
    fprintf(f, "\"%s\":[", key);
    for (int i = 0; i < n; i++)
        fprintf(f, "%s%.9g", i ? "," : "", (double)v[i]);
    fputc(']', f);
}

static err_t put_photo(const struct page *p, int i, FILE *f)
{
    const struct scene *s = p->in->scene;
    const struct camera *c = &s->cams[i];
    size_t at = 0, n;
    for (int k = 0; k < i; k++)
        at += 3 * (size_t)s->cams[k].w * (size_t)s->cams[k].h;
    struct image8 im = {c->w, c->h, 3, (uint8_t *)p->in->photos + at};
    void *jpeg;
    err_t e = img_encode_jpeg(&im, QUALITY, s->names[i], &jpeg, &n);
    if (e)
        return e;
    fputs(",\"photo\":\"data:image/jpeg;base64,", f);
    for (at = 0; at < n; at += PIECE)
        put_base64(f, (uint8_t *)jpeg + at, n - at < PIECE ? n - at : PIECE);
    fputc('"', f);
    free(jpeg);
    return OK;
}

static err_t put_view(const struct page *p, int i, FILE *f)
{
    const struct scene *s = p->in->scene;
    const struct camera *c = &s->cams[i];
    const float k[4] = {c->fx, c->fy, c->cx, c->cy};
    fprintf(f, "%s{\"name\":", i ? "," : "");
    json_put_string(f, s->names[i]);
    fprintf(f, ",\"stops\":%.9g,", (double)(s->log2t[i] - s->tone.mid_log2t));
    if (c->w != s->size || c->h != s->size)
        fprintf(f, "\"px\":[%d,%d],", c->w, c->h);
    put_floats(f, "k", k, 4);
    fputc(',', f);
    put_floats(f, "q", c->q, 4);
    fputc(',', f);
    put_floats(f, "t", c->t, 3);
    err_t e = p->in->photos ? put_photo(p, i, f) : OK;
    fputc('}', f);
    return e;
}

static err_t put_info(const struct page *p, FILE *f)
{
    static const char *const names[N_RANGES] = {"scale", "logit", "light"};
    const struct scene *s = p->in->scene;
    err_t e = OK;
    fprintf(f, "{\"n\":%d,\"degree\":%d,\"size\":%d,\"unit\":%.17g,", p->n, p->degree, s->size,
            p->unit);
    for (int k = 0; k < N_RANGES; k++)
        fprintf(f, "\"%s\":[%.17g,%.17g],", names[k], p->range[k].lo, range_step(&p->range[k]));
    fprintf(f, "\"middle\":%.9g,\"srgb_ev\":%.9g,", (double)s->tone.mid_log2t,
            (double)display_ev(&s->tone));
    int guesses = 0;
    for (int i = 0; i < s->g.n; i++)
        guesses += is_drawn(&s->g, i) && is_guess(s, i);
    fprintf(f, "\"guesses\":%d,", guesses);
    put_floats(f, "background", s->background, 3);
    fputc(',', f);
    put_floats(f, "tone", s->tone.p, TONE_PARAMS);
    fputs(",\"report\":", f);
    if (p->in->report)
        json_put_string(f, p->in->report);
    else
        fputs("null", f);
    const float *taken = p->in->log2t ? p->in->log2t : s->log2t;
    int n_taken = p->in->log2t ? p->in->n_log2t : s->n_views;
    fputs(",\"taken\":[", f);
    for (int i = 0; i < n_taken; i++)
        fprintf(f, "%s%.9g", i ? "," : "", (double)(taken[i] - s->tone.mid_log2t));
    fputs("],\"views\":[", f);
    for (int i = 0; i < s->n_views && !e; i++)
        e = put_view(p, i, f);
    fputs("]}", f);
    return e;
}

/* JSON inside HTML: "<" occurs within strings alone, where it may be written otherwise. */
static err_t put_json(const struct page *p)
{
    char *text = NULL;
    size_t n = 0;
    FILE *f = open_memstream(&text, &n);
    if (!f)
        return err_fail(ERR_NOMEM, "page of the scene: no memory");
    err_t e = put_info(p, f);
    if (fclose(f) != 0 && !e)
        e = err_fail(ERR_NOMEM, "page of the scene: no memory for its photographs");
    for (size_t i = 0; i < n && !e; i++)
        if (text[i] == '<')
            fputs("\\u003c", p->f);
        else
            fputc(text[i], p->f);
    free(text);
    return e;
}

static void put_title(const char *text, FILE *f)
{
    for (; *text; text++)
        if (strchr("<>&\"", *text))
            fprintf(f, "&#%d;", *text);
        else
            fputc(*text, f);
}

/* ---- the page ---- */

static err_t put_part(const struct page *p, const char *name, size_t n)
{
    if (strncmp(name, "css", n) == 0)
        fwrite(viewer_css, 1, viewer_css_size, p->f);
    else if (strncmp(name, "splats", n) == 0)
        fwrite(viewer_splats, 1, viewer_splats_size, p->f);
    else if (strncmp(name, "js", n) == 0)
        fwrite(viewer_js, 1, viewer_js_size, p->f);
    else if (strncmp(name, "title", n) == 0)
        put_title(p->in->title, p->f);
    else if (strncmp(name, "info", n) == 0)
        return put_json(p);
    else
        put_scene(p);
    return OK;
}

static err_t put_page(const struct page *p)
{
    const char *at = viewer_html, *end = viewer_html + viewer_html_size;
    err_t e = OK;
    while (at < end && !e) {
        const char *name = memchr(at, '@', (size_t)(end - at));
        const char *stop = name ? memchr(name + 1, '@', (size_t)(end - name - 1)) : NULL;
        fwrite(at, 1, (size_t)((stop ? name : end) - at), p->f);
        if (stop)
            e = put_part(p, name + 1, (size_t)(stop - name - 1));
        at = stop ? stop + 1 : end;
    }
    return e;
}

uint64_t viewer_bytes(const struct viewer_input *in)
{
    const struct scene *s = in->scene;
    uint64_t splat = SPLAT_BYTES + (uint64_t)sh_bytes(page_degree(s->g.n, s->g.degree));
    uint64_t photo = in->photos ? 3 * (uint64_t)s->size * (uint64_t)s->size + 4096 : 0;
    uint64_t bytes = (uint64_t)s->g.n * splat + (uint64_t)s->n_views * photo;
    return viewer_html_size + viewer_css_size + viewer_splats_size + viewer_js_size + INFO_BYTES +
           (uint64_t)s->n_views * VIEW_BYTES + 16 * (uint64_t)in->n_log2t + 12 * strlen(in->title) +
           bytes / 3 * 4 + 64;
}

/* JSON has no other numbers. */
static err_t check_finite(const char *path, const char *what, const float *v, int n)
{
    for (int i = 0; i < n; i++)
        if (!isfinite(v[i]))
            return err_fail(ERR_ARG, "%s: number %d of %s is not finite", path, i, what);
    return OK;
}

static err_t check_page(const char *path, const struct viewer_input *in)
{
    const struct scene *s = in->scene;
    err_t e = OK;
    if (s->g.n > VIEWER_SPLATS_MAX)
        return err_fail(ERR_ARG, "%s: %d splats, a page can hold %d", path, s->g.n,
                        VIEWER_SPLATS_MAX);
    for (int i = 0; i < s->n_views && !e; i++) {
        const struct camera *c = &s->cams[i];
        const float v[] = {c->fx,   c->fy,   c->cx,   c->cy,   c->q[0], c->q[1],
                           c->q[2], c->q[3], c->t[0], c->t[1], c->t[2], s->log2t[i]};
        e = check_finite(path, s->names[i], v, sizeof v / sizeof *v);
    }
    if (!e)
        e = check_finite(path, "the background", s->background, 3);
    if (!e)
        e = check_finite(path, "the tone curve", s->tone.p, TONE_PARAMS);
    if (!e)
        e = check_finite(path, "the middle exposure", &s->tone.mid_log2t, 1);
    return e || !in->log2t ? e : check_finite(path, "the exposures", in->log2t, in->n_log2t);
}

err_t viewer_write(const char *path, const struct viewer_input *in)
{
    const struct scene *s = in->scene;
    struct page p = {.in = in, .degree = page_degree(s->g.n, s->g.degree)};
    err_t e = check_page(path, in);
    if (e)
        return e;
    find_ranges(&p);
    e = file_create(path, &p.f);
    if (e)
        return e;
    e = put_page(&p);
    if (!e)
        return file_finish(p.f, path);
    file_discard(p.f, path);
    return e;
}
