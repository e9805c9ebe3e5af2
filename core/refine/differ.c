#include "core/refine/differ.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/photo/metrics.h"
#include "core/photo/tonemap.h"
#include "core/sfm/similarity.h"
#include "core/splat/voxel.h"

#include <float.h>
#include <math.h>
#include <string.h>

static const double DEGREE = NUM_PI / 180;

static size_t count_pixels(const struct differ_look *l)
{
    return (size_t)l->n_views * (size_t)l->size * (size_t)l->size;
}

struct differ_look differ_look(const struct prediction *p)
{
    struct differ_look l = {.n_views = p->geom.n_views,
                            .size = p->geom.size,
                            .cams = p->geom.cams,
                            .depth = p->geom.depth,
                            .tone = p->tone,
                            .linear = p->linear};
    if (!p->features)
        return l;
    l.logit = p->features + VOXEL_LOGIT * count_pixels(&l);
    for (size_t c = 0; c < 3; c++)
        l.dc[c] = p->features + (VOXEL_SH + c * SH_COEFS_MAX) * count_pixels(&l);
    return l;
}

/* For the copies of one prediction: its cameras, and `pixels` values of each of five planes. */
static err_t alloc_copies(struct arena *a, size_t views, size_t pixels, struct camera **cams,
                          float **planes)
{
    err_t e = arena_alloc(a, views, sizeof **cams, cams);
    return e ? e : arena_alloc(a, 5 * pixels, sizeof **planes, planes);
}

void differ_keep_plan(struct arena *count, int n_views, int size)
{
    const size_t views = (size_t)n_views;
    struct camera *cams;
    float *planes;
    (void)alloc_copies(count, views, views * (size_t)size * (size_t)size, &cams,
                       &planes); // a counter is never full
}

err_t differ_keep(struct arena *a, struct differ_look *io)
{
    const size_t n = count_pixels(io), views = (size_t)io->n_views;
    const float **from[] = {&io->depth, &io->logit, &io->dc[0], &io->dc[1], &io->dc[2]};
    struct camera *cams;
    float *to;
    err_t e = alloc_copies(a, views, n, &cams, &to);
    if (e)
        return e;
    memcpy(cams, io->cams, views * sizeof *cams);
    io->cams = cams;
    for (int i = 0; i < 5 && *from[i]; i++, to += n) {
        memcpy(to, *from[i], n * sizeof *to);
        *from[i] = to;
    }
    return OK;
}

static double median(const float *v, size_t n)
{
    double m;
    return metrics_quantile(v, n, 0.5, &m) == OK ? m : NAN;
}

/* View i in the world of view 0. */
static struct camera seen_from_first(const struct differ_look *l, int i)
{
    struct similarity w = {.scale = 1};
    for (int k = 0; k < 4; k++)
        w.q[k] = (double)l->cams[0].q[k];
    for (int k = 0; k < 3; k++)
        w.t[k] = (double)l->cams[0].t[k];
    return similarity_apply(&w, &l->cams[i]);
}

static double distance(const struct camera *a, const struct camera *b)
{
    double x[3], y[3];
    rotation_centre(a, x);
    rotation_centre(b, y);
    return hypot(hypot(x[0] - y[0], x[1] - y[1]), x[2] - y[2]);
}

static double longest_baseline(const struct differ_look *l)
{
    double most = 0;
    for (int i = 1; i < l->n_views; i++)
        for (int k = 0; k < i; k++)
            most = fmax(most, distance(&l->cams[i], &l->cams[k]));
    return most;
}

/* work: (2 n_views). */
static void compare_cameras(const struct differ_look *ref, const struct differ_look *p, float *work,
                            double *out)
{
    const int n = ref->n_views;
    const double base = longest_baseline(ref);
    for (int i = 1; i < n; i++) {
        struct camera a = seen_from_first(ref, i), b = seen_from_first(p, i);
        work[i - 1] = (float)(rotation_between(&a, &b) / DEGREE);
        work[n + i - 1] = (float)(100 * distance(&a, &b) / base); // not finite where base is 0
    }
    out[DIFFER_ROTATION] = median(work, (size_t)n - 1);
    out[DIFFER_TRANSLATION] = median(work + n, (size_t)n - 1);
    for (int i = 0; i < n; i++) {
        work[i] = 100 * fabsf(p->cams[i].fx / ref->cams[i].fx - 1);
        work[n + i] = 100 * fabsf(p->cams[i].fy / ref->cams[i].fy - 1);
    }
    out[DIFFER_FOCAL] = median(work, 2 * (size_t)n);
}

/* work: (pixels). */
static void compare_depths(const struct differ_look *ref, const struct differ_look *p, float *work,
                           double *out)
{
    const size_t n = count_pixels(ref);
    for (size_t i = 0; i < n; i++)
        work[i] = p->depth[i] / ref->depth[i];
    const float scale = (float)median(work, n);
    for (size_t i = 0; i < n; i++)
        work[i] = 100 * fabsf(p->depth[i] / ref->depth[i] - 1);
    out[DIFFER_DEPTH] = median(work, n);
    for (size_t i = 0; i < n; i++)
        work[i] = 100 * fabsf(p->depth[i] / ref->depth[i] / scale - 1);
    out[DIFFER_ALIGNED] = median(work, n);
}

/* Display values of n pixels from `at` on. */
static void show_display(const struct differ_look *l, const struct tonemap_table *table, int colour,
                         float log2t, size_t at, float *out)
{
    const size_t n = count_pixels(l) / (size_t)l->n_views;
    for (size_t i = 0; i < n; i++) {
        float x = (float)SH_BASIS0 * l->dc[colour][at + i];
        out[i] = l->linear ? fminf(fmaxf(x + 0.5f, 0), 1) : fminf(expf(x), FLT_MAX);
    }
    if (!l->linear)
        tonemap_run(&table->c[colour], out, log2t - l->tone.mid_log2t, n, out);
}

/* work: (2, size^2). */
static double psnr(const struct differ_look *ref, const struct differ_look *p, const float *log2t,
                   float *work)
{
    const size_t n = count_pixels(ref) / (size_t)ref->n_views;
    struct tonemap_table a, b;
    double sum = 0;
    tonemap_table_init(&a, &ref->tone);
    tonemap_table_init(&b, &p->tone);
    for (int k = 0; k < 3 * ref->n_views; k++) {
        size_t view = (size_t)k / 3;
        show_display(ref, &a, k % 3, log2t[view], view * n, work);
        show_display(p, &b, k % 3, log2t[view], view * n, work + n);
        for (size_t i = 0; i < n; i++)
            sum += pow((double)work[n + i] - (double)work[i], 2);
    }
    return fmin(METRICS_PSNR_MAX, -10 * log10(sum / (3 * (double)count_pixels(ref))));
}

static double sigmoid(float x)
{
    return 1 / (1 + exp(-(double)x));
}

static void compare_gaussians(const struct differ_look *ref, const struct differ_look *p,
                              double *out)
{
    const size_t n = count_pixels(ref);
    const double stops = SH_BASIS0 / log(2);
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += pow(sigmoid(p->logit[i]) - sigmoid(ref->logit[i]), 2);
    out[DIFFER_OPACITY] = sqrt(sum / (double)n);
    sum = 0;
    for (int c = 0; c < 3; c++)
        for (size_t i = 0; i < n; i++)
            sum += pow(stops * ((double)p->dc[c][i] - (double)ref->dc[c][i]), 2);
    out[DIFFER_RADIANCE] = sqrt(sum / (3 * (double)n));
}

static err_t alloc_work(struct arena *tmp, size_t pixels, float **work)
{
    return arena_alloc(tmp, pixels, sizeof **work, work);
}

void differ_measure_plan(struct arena *count, int n_views, int size)
{
    const size_t mark = arena_mark(count);
    float *work;
    (void)alloc_work(count, (size_t)n_views * (size_t)size * (size_t)size,
                     &work); // a counter is never full
    arena_reset(count, mark);
}

err_t differ_measure(const struct differ_look *ref, const struct differ_look *p, const float *log2t,
                     struct arena *tmp, double out[DIFFER_FIGURES])
{
    const size_t mark = arena_mark(tmp);
    float *work; // sized for two views at least, so that all of the above fits
    for (int i = 0; i < DIFFER_FIGURES; i++)
        out[i] = NAN;
    err_t e = alloc_work(tmp, count_pixels(ref), &work);
    if (e)
        return e;
    compare_cameras(ref, p, work, out);
    compare_depths(ref, p, work, out);
    if (ref->logit && p->logit && ref->linear == p->linear) {
        compare_gaussians(ref, p, out);
        if (isfinite(out[DIFFER_RADIANCE])) // curves show what is not a number as black
            out[DIFFER_PSNR] = psnr(ref, p, log2t, work);
        if (ref->linear)
            out[DIFFER_RADIANCE] = NAN;
    }
    arena_reset(tmp, mark);
    return OK;
}
