/* The page is firmware/web/view.html with @css@, @splats@, @light@, @tools@ and @js@ (the files
 * beside it), @title@, @info@, @scene@ and @rest@ replaced. @info@ is JSON: what pagesplats.h and
 * pagepack.h call the page's numbers, tone curve, background, cameras, photographs as JPEG.
 * @scene@ is the splats; of a large scene the most important ones, and @rest@ the others, so that
 * the page shows them while it is still read. */
#include "firmware/result/viewer.h"

#include "firmware/result/embed.h"
#include "firmware/result/pagepack.h"

#include "core/base/gaussians.h"
#include "core/base/rotation.h"
#include "core/splat/display.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"
#include "drivers/format/json.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

EMBED_FILE(viewer_html, "firmware/web/view.html");
EMBED_FILE(viewer_css, "firmware/web/view.css");
EMBED_FILE(viewer_unpack, "firmware/web/unpack.js");
EMBED_FILE(viewer_splats, "firmware/web/splats.js");
EMBED_FILE(viewer_light, "firmware/web/light.js");
EMBED_FILE(viewer_js, "firmware/web/view.js");
EMBED_FILE(viewer_tools, "firmware/web/tools.js");

enum { INFO_BYTES = 1 << 15, VIEW_BYTES = 2048, QUALITY = 75 };

struct page {
    FILE *f;
    const struct viewer_input *in;
    struct pagesplats splats;
    struct pagepack pack; // zeroed if lossless
};

static int page_degree(int n, int degree)
{
    while (degree > 0 &&
           (int64_t)n * (PAGESPLATS_BYTES + pagesplats_sh_bytes(degree)) > VIEWER_SCENE_MAX)
        degree--;
    return degree;
}

/* ---- first view ---- */

enum { CELLS = 16, LOOKED_AT = 1 << 14 }; // of a picture's edge; splats, about

/* The part of a view's picture in which there are proven splats, times their number. */
static double sight_of_view(const struct page *p, int view)
{
    const struct scene *s = p->in->scene;
    const struct camera *c = &s->cams[view];
    const float *const *mu = (const float *const *)&s->g.plane[G_MU];
    bool seen[CELLS * CELLS] = {0};
    double r[9], at[3], cells = 0, n = 0;
    rotation_of_camera(c, r);
    for (int i = 0; i < s->g.n; i += 1 + s->g.n / LOOKED_AT) {
        if (!pagesplats_is_drawn(&s->g, i) || pagesplats_is_guess(s, i))
            continue;
        for (int k = 0; k < 3; k++)
            at[k] = (double)c->t[k] + r[3 * k] * (double)mu[0][i] +
                    r[3 * k + 1] * (double)mu[1][i] + r[3 * k + 2] * (double)mu[2][i];
        double u = ((double)c->fx * at[0] / at[2] + (double)c->cx) / c->w;
        double v = ((double)c->fy * at[1] / at[2] + (double)c->cy) / c->h;
        if (!(at[2] > 0 && u >= 0 && u < 1 && v >= 0 && v < 1))
            continue;
        bool *cell = &seen[(int)(v * CELLS) * CELLS + (int)(u * CELLS)];
        cells += !*cell;
        *cell = true;
        n++;
    }
    return cells * n;
}

static int best_view(const struct page *p)
{
    double most = 0;
    int best = 0;
    for (int i = 0; i < p->in->scene->n_views; i++) {
        double sight = sight_of_view(p, i);
        if (sight > most)
            best = i;
        most = fmax(most, sight);
    }
    return best;
}

/* ---- data of the page ---- */

static void put_floats(FILE *f, const char *key, const float *v, int n)
{
    fprintf(f, "\"%s\":[", key);
    for (int i = 0; i < n; i++)
        fprintf(f, "%s%.9g", i ? "," : "", (double)v[i]);
    fputc(']', f);
}

/* Photographs of a place that the page may hold. */
static int exposures_max(const struct views *v)
{
    size_t pixels = extent_total(v->extent, v->n);
    return pixels > VIEWER_PHOTO_PIXELS ? 1 : (int)(VIEWER_PHOTO_PIXELS / pixels);
}

static err_t put_photo(const struct page *p, int i, FILE *f)
{
    const struct views *v = p->in->photos;
    struct image8 im = {v->extent[i].w, v->extent[i].h, 3, views_rgb(v, i)};
    void *jpeg;
    size_t n;
    err_t e = img_encode_jpeg(&im, QUALITY, v->names[i], &jpeg, &n);
    if (e)
        return e;
    fprintf(f, "{\"stops\":%.9g,\"src\":\"data:image/jpeg;base64,",
            (double)(v->log2t[i] - p->in->scene->tone.mid_log2t));
    struct pagetext text;
    pagetext_begin(&text, f);
    pagetext_put(&text, jpeg, n);
    pagetext_end(&text);
    fputs("\"}", f);
    free(jpeg);
    return OK;
}

static err_t put_photos(const struct page *p, int place, FILE *f)
{
    const struct views *v = p->in->photos;
    err_t e = OK;
    int left = exposures_max(v);
    fputs(",\"photos\":[", f);
    for (int i = place; i >= 0 && left > 0 && !e; i = views_next(v, place, i), left--) {
        if (i != place)
            fputc(',', f);
        e = put_photo(p, i, f);
    }
    fputc(']', f);
    return e;
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
    err_t e = p->in->photos ? put_photos(p, i, f) : OK;
    fputc('}', f);
    return e;
}

/* Steps of the splats' numbers. */
static void put_steps(const struct page *p, FILE *f)
{
    const struct pagesplats *s = &p->splats;
    const struct pagepack *k = &p->pack;
    fprintf(f, "\"scale\":[%.17g,%.17g],\"logit\":[%.17g,%.17g],\"light\":[%.17g,%.17g],",
            s->scale.lo, s->scale.step, s->logit.lo, s->logit.step, s->light.lo, s->light.step);
    if (!k->bytes)
        return;
    fprintf(
        f,
        "\"packed\":{\"bytes\":[%zu,%zu],\"at\":[%.17g,%.17g,%.17g],\"reach\":%.17g,\"step\":%.17g,"
        "\"low\":[%d,%d,%d],\"quat\":%d,\"sh\":%.17g,\"first\":%d},",
        k->n_bytes[0], k->n_bytes[1], k->at[0], k->at[1], k->at[2], k->reach, k->step, k->low[0],
        k->low[1], k->low[2], PAGEPACK_QUAT, k->sh, k->first);
}

static err_t put_info(const struct page *p, FILE *f)
{
    const struct scene *s = p->in->scene;
    err_t e = OK;
    fprintf(f, "{\"n\":%d,\"degree\":%d,\"size\":%d,\"unit\":%.17g,", p->splats.n, p->splats.degree,
            s->size, p->splats.unit);
    put_steps(p, f);
    fprintf(f, "\"middle\":%.9g,\"srgb_ev\":%.9g,", (double)s->tone.mid_log2t,
            (double)display_ev(&s->tone));
    int guesses = 0;
    for (int i = 0; i < s->g.n; i++)
        guesses += pagesplats_is_drawn(&s->g, i) && pagesplats_is_guess(s, i);
    fprintf(f, "\"guesses\":%d,\"first\":%d,\"metres\":%s,", guesses, best_view(p),
            s->metres ? "true" : "false");
    put_floats(f, "background", s->background, 3);
    fputc(',', f);
    put_floats(f, "tone", s->tone.p, TONE_PARAMS);
    fputs(",\"report\":", f);
    if (p->in->report)
        json_put_string(f, p->in->report);
    else
        fputs("null", f);
    const struct views *photos = p->in->photos;
    const float *taken = photos ? photos->log2t : s->log2t;
    int n_taken = photos ? photos->n + photos->n_more : s->n_views;
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

static void put_splats(const struct page *p, bool rest)
{
    const size_t *n = p->pack.n_bytes;
    struct pagetext text;
    pagetext_begin(&text, p->f);
    if (p->pack.bytes)
        pagetext_put(&text, p->pack.bytes + (rest ? n[0] : 0), n[rest]);
    else if (!rest)
        pagesplats_put(&p->splats, &text);
    pagetext_end(&text);
}

/* ---- the page ---- */

/* Indentation and comments are for readers of the source: those that begin a line and end one, and
 * what follows code after " // ", which no string has. The text ends with a newline. */
static void put_code(const char *text, size_t bytes, FILE *f)
{
    bool comment = false;
    for (const char *at = text, *next; at < text + bytes; at = next) {
        next = strchr(at, '\n') + 1;
        at += strspn(at, " ");
        comment |= strncmp(at, "/*", 2) == 0;
        if (comment) {
            comment = strncmp(next - 3, "*/", 2) != 0;
            continue;
        }
        const char *rest = memmem(at, (size_t)(next - at), " // ", 4);
        fwrite(at, 1, (size_t)((rest ? rest : next - 1) - at), f);
        fputc('\n', f);
    }
}

static err_t put_part(const struct page *p, const char *name, size_t n)
{
    if (strncmp(name, "css", n) == 0)
        put_code(viewer_css, viewer_css_size, p->f);
    else if (strncmp(name, "splats", n) == 0) {
        if (!p->in->lossless)
            put_code(viewer_unpack, viewer_unpack_size, p->f);
        put_code(viewer_splats, viewer_splats_size, p->f);
    } else if (strncmp(name, "light", n) == 0)
        put_code(viewer_light, viewer_light_size, p->f);
    else if (strncmp(name, "tools", n) == 0)
        put_code(viewer_tools, viewer_tools_size, p->f);
    else if (strncmp(name, "js", n) == 0)
        put_code(viewer_js, viewer_js_size, p->f);
    else if (strncmp(name, "title", n) == 0)
        put_title(p->in->title, p->f);
    else if (strncmp(name, "info", n) == 0)
        return put_json(p);
    else
        put_splats(p, strncmp(name, "rest", n) == 0);
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

/* As if they could not be compressed. */
static uint64_t photo_bytes(const struct views *v, int size)
{
    const uint64_t places = (uint64_t)v->n, all = places + (uint64_t)v->n_more,
                   square = (uint64_t)size * (uint64_t)size;
    uint64_t most = square * places; // one of each place
    if (most < VIEWER_PHOTO_PIXELS)
        most = VIEWER_PHOTO_PIXELS;
    return 3 * (all * square < most ? all * square : most) + all * (4096 + 64);
}

uint64_t viewer_bytes(const struct viewer_input *in)
{
    const struct scene *s = in->scene;
    uint64_t splat =
        PAGESPLATS_BYTES + (uint64_t)pagesplats_sh_bytes(page_degree(s->g.n, s->g.degree));
    uint64_t bytes = (uint64_t)s->g.n * splat + (in->photos ? photo_bytes(in->photos, s->size) : 0);
    return viewer_html_size + viewer_css_size + viewer_unpack_size + viewer_splats_size +
           viewer_light_size + viewer_tools_size + viewer_js_size + INFO_BYTES +
           (uint64_t)s->n_views * VIEW_BYTES + 12 * strlen(in->title) + bytes / 3 * 4 + 64;
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
    const struct views *photos = in->photos;
    return e || !photos
               ? e
               : check_finite(path, "the exposures", photos->log2t, photos->n + photos->n_more);
}

size_t viewer_plan(const struct viewer_input *in)
{
    return in->lossless ? 0 : pagepack_plan(in->scene->g.n, in->scene->g.degree);
}

err_t viewer_write(const char *path, const struct viewer_input *in)
{
    const struct scene *s = in->scene;
    struct page p = {.in = in};
    err_t e = check_page(path, in);
    if (e)
        return e;
    pagesplats_plan(s, page_degree(s->g.n, s->g.degree), in->lossless ? 0 : PAGEPACK_STEP,
                    &p.splats);
    if (!in->lossless)
        e = pagepack_run(&p.splats, &p.pack);
    if (!e)
        e = file_create(path, &p.f);
    if (!e) {
        e = put_page(&p);
        if (e)
            file_discard(p.f, path);
        else
            e = file_finish(p.f, path);
    }
    pagepack_free(&p.pack);
    return e;
}
