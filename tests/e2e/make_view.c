/* make_view OUT KIND NUMBER - scenes that are hard to show, as OUT/scene.hdrig, OUT/small.html and,
 * without loss, if they have at most LOSSLESS_MAX splats, OUT/view.html:
 *   thin D     half transparent splats of SH degree D, a lamp ten stops above them, and radiance
 *              from 1e-4 to 1e5
 *   walls N    N splats, many of them opaque, with the same light
 *   half 0     `thin` of degree 0, every other splat of which is a guess: scene.hdrig lacks these
 *   scale S    `walls` in another unit of length
 *   aside 0    `walls` that the last camera looks at, through a longer lens, and no other
 *   one 0      a single splat
 *   pair 0     two opaque splats 1.2 m apart
 *   dark 0     nothing that can be seen
 *   near 0     a splat on each camera, others just before it
 *   shapes 0   needles, points, plates, what reaches in from the side, quaternions of any length
 * Three views of SIZE px; the last one has photographs at the exposures of all. The same arguments
 * give the same bytes. */
#include "core/base/gaussians.h"
#include "core/photo/tonemap.h"
#include "core/refine/confidence.h"
#include "drivers/format/file.h"
#include "drivers/format/scenefile.h"
#include "firmware/result/viewer.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

enum { VIEWS = 3, PHOTOS = 5, SIZE = 112, THIN = 1500, LOSSLESS_MAX = 10000 };

static uint32_t seed = 1;

/* Numerical Recipes' generator, upper bits. */
static double uniform(double lo, double hi)
{
    seed = seed * 1664525u + 1013904223u;
    return lo + (hi - lo) * (seed >> 8) / (1 << 24);
}

static void put_splat(struct gaussians *g, double logit, double size)
{
    int i = g->n++;
    double z = uniform(2, 6);
    g->plane[G_MU][i] = (float)(uniform(-0.6, 0.6) * z);
    g->plane[G_MU + 1][i] = (float)(uniform(-0.6, 0.6) * z);
    g->plane[G_MU + 2][i] = (float)z;
    g->plane[G_LOGIT][i] = (float)logit;
    for (int k = 0; k < 3; k++)
        g->plane[G_LOG_SCALE + k][i] = (float)log(size * uniform(0.2, 1));
    for (int k = 0; k < 4; k++)
        g->plane[G_QUAT + k][i] = (float)uniform(-1, 1);
    for (int k = 0; k < 3 * (g->degree + 1) * (g->degree + 1); k++)
        g->plane[G_SH + k][i] = (float)uniform(-0.3, 0.3);
    for (int c = 0; c < 3; c++)
        g->plane[G_SH + c][i] = (float)(log(0.18 * exp2(uniform(-2, 2))) / 0.28209479177387814);
}

static void light(struct gaussians *g, int i, double radiance)
{
    for (int c = 0; c < 3; c++)
        g->plane[G_SH + c][i] = (float)(log(radiance * (1 - 0.2 * c)) / 0.28209479177387814);
}

/* Makes some of the splats a lamp, some the sun, some a cellar. */
static void put_lights(struct gaussians *g)
{
    static const double radiance[] = {0.18 * 1024, 1e5, 1e-4};
    for (int i = 0; i < 60 && i < g->n; i++) {
        int which = i / 20;
        g->plane[G_MU][i] = (float)(uniform(-0.1, 0.1) + 0.8 * which - 0.8);
        g->plane[G_MU + 1][i] = (float)uniform(-0.1, 0.1);
        g->plane[G_MU + 2][i] = 2.5f;
        light(g, i, radiance[which]);
    }
}

static void put_shapes(struct gaussians *g)
{
    static const float scales[][3] = {
        {-27, -27, -27}, {0, -9, -9}, {0, 0, -20}, {3, -27, -27}, {-5, -5, 2}};
    for (int i = 0; i < 40; i++) {
        put_splat(g, uniform(-2, 3), 0.1);
        for (int k = 0; k < 3; k++)
            g->plane[G_LOG_SCALE + k][i] = scales[i % 5][k];
        for (int k = 0; k < 4; k++)
            g->plane[G_QUAT + k][i] *= i % 3 ? (float)pow(10, i % 7) : 1;
    }
    for (int side = -1; side < 2; side += 2) {
        put_splat(g, 1, 1.5);
        g->plane[G_MU][g->n - 1] = 2.5f * (float)side;
        g->plane[G_MU + 2][g->n - 1] = 1.1f;
    }
}

static void put_kind(struct scene *s, const char *kind, double number)
{
    struct gaussians *g = &s->g;
    if (strcmp(kind, "thin") == 0 || strcmp(kind, "half") == 0)
        for (int i = 0; i < THIN; i++)
            put_splat(g, uniform(-5, -2.5), 0.15);
    if (strcmp(kind, "walls") == 0 || strcmp(kind, "scale") == 0 || strcmp(kind, "aside") == 0)
        for (int i = 0; i < g->cap; i++)
            put_splat(g, uniform(-4, 9), g->cap > 10000 ? 0.03 : 0.12);
    if (g->n > 0)
        put_lights(g);
    if (strcmp(kind, "one") == 0 || strcmp(kind, "dark") == 0) {
        put_splat(g, 3, 0.3);
        g->plane[G_MU][0] = g->plane[G_MU + 1][0] = 0;
        g->plane[G_LOGIT][0] = strcmp(kind, "one") == 0 ? 3 : -20;
    }
    for (int i = 0; i < 2 && strcmp(kind, "pair") == 0; i++) {
        put_splat(g, 6, 0.5);
        g->plane[G_MU][i] = i ? -0.1f : -0.7f;
        g->plane[G_MU + 1][i] = i ? 0.1f : 0;
        g->plane[G_MU + 2][i] = i ? 4.03441f : 3;
    }
    if (strcmp(kind, "shapes") == 0)
        put_shapes(g);
    for (int i = 0; i < 10 && strcmp(kind, "near") == 0; i++) {
        put_splat(g, -1, 0.1);
        for (int k = 0; k < 3; k++)
            g->plane[G_MU + k][i] = k == 2 ? (float)i / 1000 : 0;
    }
    for (int i = 0; i < g->n && strcmp(kind, "scale") == 0; i++)
        for (int k = 0; k < 3; k++) {
            g->plane[G_MU + k][i] *= (float)number;
            g->plane[G_LOG_SCALE + k][i] += (float)log(number);
        }
}

/* A bent curve, another for each colour; views that are shifted, turned, off centre. */
static void put_scene(struct scene *s, double unit)
{
    tonemap_linear(&s->tone, 0.8f, -9, 9, -2);
    for (int c = 0; c < 3; c++) {
        s->tone.p[c * TONE_PER_COLOUR + 2 * TONE_HIDDEN + 30] = 0.2f;
        s->tone.p[c * TONE_PER_COLOUR + 2 * TONE_HIDDEN + 40 + c] = -0.4f;
    }
    for (int i = 0; i < VIEWS; i++) {
        double angle = 0.15 * (i - 1);
        s->cams[i] = (struct camera){SIZE,
                                     SIZE,
                                     90,
                                     95,
                                     SIZE / 2 + 3 * i,
                                     SIZE / 2 - 2,
                                     {(float)cos(angle / 2), 0, (float)sin(angle / 2), 0},
                                     {(float)(0.3 * (1 - i) * unit), 0, (float)(0.1 * i * unit)}};
        s->log2t[i] = (float)(3 * (i - 1)) - 2;
        snprintf(s->names[i], NAME_CAP, "view <script> \"%d\".png", i);
    }
    memcpy(s->background, (float[]){0.02f, 0.03f, 0.05f}, sizeof s->background);
}

static void look_aside(struct camera *c, bool sees)
{
    if (sees)
        c->fx = c->fy = 200;
    else
        memcpy(c->q, (float[]){0, 0, 1, 0}, sizeof c->q);
}

/* What is no guess. */
static void keep_proven(struct scene *s)
{
    int n = 0;
    for (int i = 0; i < s->g.n && s->confidence; i++)
        if (s->confidence[i] >= CONFIDENCE_GUESS) {
            gaussians_move(&s->g, i, n);
            s->confidence[n++] = s->confidence[i];
        }
    s->g.n = s->confidence ? n : s->g.n;
}

/* Ramps: each photograph has another slope. */
static void put_photos(const struct scene *s, struct views *v)
{
    for (int i = 0; i < PHOTOS; i++) {
        v->extent[i] = (struct extent){SIZE, SIZE, (size_t)i * SIZE * SIZE};
        v->log2t[i] = s->log2t[i < VIEWS ? i : i - VIEWS];
        for (int k = 0; k < 3 * SIZE * SIZE; k++)
            views_rgb(v, i)[k] = (uint8_t)(k / 3 % SIZE * 2 / (i < VIEWS ? 1 : i - 1));
    }
}

static err_t write_files(const char *out, struct scene *s, const struct views *photos)
{
    char path[FILE_PATH_CAP];
    struct viewer_input page = {
        .scene = s, .photos = photos, .title = "</title><b>scene</b> & \"view\""};
    err_t e = file_join(out, "small.html", path);
    if (!e)
        e = viewer_write(path, &page);
    page.lossless = true;
    if (!e)
        e = file_join(out, "view.html", path);
    if (!e && s->g.n <= LOSSLESS_MAX)
        e = viewer_write(path, &page);
    keep_proven(s);
    if (!e)
        e = file_join(out, "scene.hdrig", path);
    return e ? e : scenefile_write(path, s);
}

int main(int argc, char **argv)
{
    static uint8_t pixels[PHOTOS * SIZE * SIZE * 3];
    static char names[PHOTOS][NAME_CAP];
    static float log2t[VIEWS], taken[PHOTOS];
    static struct extent extent[PHOTOS];
    struct views photos = {.n = VIEWS,
                           .extent = extent,
                           .names = names,
                           .rgb = pixels,
                           .log2t = taken,
                           .n_more = PHOTOS - VIEWS,
                           .place = (int[]){VIEWS - 1, VIEWS - 1}};
    static struct camera cams[VIEWS];
    static float confidence[THIN];
    struct scene s = {.n_views = VIEWS, .size = SIZE, .names = names, .log2t = log2t, .cams = cams};
    struct arena a;
    double number = argc == 4 ? atof(argv[3]) : -1;
    if (number < 0) {
        fprintf(stderr, "usage: make_view OUT KIND NUMBER\n");
        return 2;
    }
    const char *kind = argv[2];
    int degree = strcmp(kind, "thin") == 0 ? (int)number : strcmp(kind, "walls") == 0 ? 1 : 0;
    int cap = strcmp(kind, "walls") == 0 ? (int)number : THIN;
    mkdir(argv[1], 0755);
    err_t e = arena_init(&a, "scene", gaussians_need(cap, degree));
    if (!e)
        e = gaussians_init(&s.g, &a, cap, degree);
    if (!e) {
        put_kind(&s, kind, number);
        for (int i = 0; i < THIN; i++)
            confidence[i] = i % 2 ? 0.1f : 0.9f;
        s.confidence = strcmp(kind, "half") == 0 ? confidence : NULL;
        s.metres = strcmp(kind, "pair") == 0;
        put_scene(&s, strcmp(kind, "scale") == 0 ? number : 1);
        for (int i = 0; i < VIEWS && strcmp(kind, "aside") == 0; i++)
            look_aside(&cams[i], i == VIEWS - 1);
        put_photos(&s, &photos);
        e = write_files(argv[1], &s, &photos);
    }
    if (e)
        fprintf(stderr, "make_view: %s\n", err_text());
    arena_free(&a);
    return e ? 1 : 0;
}
