#include "firmware/result/draw.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/photo/distort.h"
#include "core/photo/shade.h"
#include "core/refine/confidence.h"
#include "drivers/format/exrfile.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MAPS = 5, DISPLAY = 3 }; // planes: radiance 3, depth, alpha

err_t draw_init(struct draw *d, struct arena *a, int cap, int w, int h)
{
    float *px;
    size_t pixels = (size_t)w * (size_t)h;
    memset(d, 0, sizeof *d);
    err_t e = raster_init(&d->raster, a, cap, w, h, false);
    if (!e)
        e = arena_alloc(a, pixels, (MAPS + DISPLAY) * sizeof *px, &px);
    if (e)
        return e;
    d->maps = (struct render){.radiance = px, .depth = px + 3 * pixels, .alpha = px + 4 * pixels};
    d->display = (struct image){.channels = 3, .px = px + MAPS * pixels};
    return OK;
}

struct extent draw_cover(const struct scene *s)
{
    struct extent out = {0, 0, 0};
    for (int i = 0; i < s->n_views; i++) {
        const struct extent px = {s->cams[i].w, s->cams[i].h, 0}, both[2] = {out, px};
        out = extent_cover(both, 2);
    }
    return out;
}

size_t draw_plan(int cap, int w, int h)
{
    struct arena a = arena_counter();
    struct draw d;
    return draw_init(&d, &a, gaussians_cap(cap), w, h) ? SIZE_MAX : a.peak;
}

err_t draw_run(const struct run *r, struct draw *d, const struct scene *s, const struct camera *cam)
{
    struct raster_input in = {&s->g, cam, {s->background[0], s->background[1], s->background[2]}};
    tonemap_table_init(&d->table, &s->tone);
    d->mid_log2t = s->tone.mid_log2t;
    return raster_run(r, &d->raster, &in, &d->maps);
}

void draw_display(struct draw *d, const struct shade *shade, float log2t)
{
    size_t pixels = (size_t)d->maps.w * (size_t)d->maps.h;
    const float *from = d->maps.radiance;
    d->display.w = d->maps.w;
    d->display.h = d->maps.h;
    if (shade) {
        memcpy(d->display.px, from, 3 * pixels * sizeof *from);
        shade_apply(NULL, shade, d->display.w, d->display.h, d->display.px);
        from = d->display.px;
    }
    for (int c = 0; c < 3; c++)
        tonemap_run(&d->table.c[c], from + (size_t)c * pixels, log2t - d->mid_log2t, pixels,
                    d->display.px + (size_t)c * pixels);
}

err_t draw_lens_camera(const struct lens *l, const struct camera *cam, int most, struct camera *out)
{
    *out = *cam;
    if (!lens_distorts(l))
        return OK;
    return distort_camera(l, cam->w, cam->h, num_min(most, RASTER_SIDE_MAX), out);
}

err_t draw_through_lens(struct pool *pool, struct draw *d, const struct draw_lens *l)
{
    const size_t n = extent_pixels(&l->px);
    const int w = l->px.w, h = l->px.h;
    struct distort_job j = {l->lens, l->drawn, 3, w, h, d->maps.radiance, l->room, l->seen};
    err_t e = distort_run(pool, &j);
    j.n = 1;
    j.in = d->maps.alpha;
    j.out = l->room + 3 * n;
    if (!e)
        e = distort_run(pool, &j);
    memcpy(d->maps.radiance, l->room, 3 * n * sizeof *l->room);
    memcpy(d->maps.alpha, j.out, n * sizeof *l->room);
    d->maps.w = w;
    d->maps.h = h;
    return e;
}

err_t draw_confidence_init(struct draw_confidence *c, struct arena *a, int cap, int w, int h)
{
    memset(c, 0, sizeof *c);
    err_t e = arena_alloc(a, (size_t)cap, sizeof *c->colour, &c->colour);
    return e ? e : arena_alloc(a, (size_t)w * (size_t)h, sizeof *c->map, &c->map);
}

size_t draw_confidence_plan(int cap, int w, int h)
{
    struct arena a = arena_counter();
    struct draw_confidence c;
    return draw_confidence_init(&c, &a, gaussians_cap(cap), w, h) ? SIZE_MAX : a.peak;
}

void draw_confidence_set(struct draw_confidence *c, const struct scene *s)
{
    confidence_splats(s, c->colour, &c->splats.g);
}

err_t draw_confidence_run(const struct run *r, struct draw *d, struct draw_confidence *c,
                          const struct camera *cam)
{
    err_t e = draw_run(r, d, &c->splats, cam);
    if (!e)
        memcpy(c->map, d->maps.radiance, (size_t)cam->w * (size_t)cam->h * sizeof *c->map);
    return e;
}

err_t draw_write_exr(const struct draw *d, const struct camera *cam, float log2t, const char *path,
                     size_t *clipped)
{
    struct image rgb = {d->maps.w, d->maps.h, 3, d->maps.radiance};
    struct exrfile_extra extra = {.half = true,
                                  .alpha = d->maps.alpha,
                                  .exposure_s = exp2f(log2t),
                                  .log2t = &log2t,
                                  .cam = cam};
    return exrfile_write(path, &rgb, &extra, clipped);
}

void draw_name(const char *folder, const char *name, const char *extension, char out[DRAW_NAME_CAP])
{
    const char *dot = strrchr(name, '.');
    int stem = dot && dot != name ? (int)(dot - name) : (int)strlen(name);
    snprintf(out, DRAW_NAME_CAP, "%s/%.*s.%s", folder, stem, name, extension);
}
