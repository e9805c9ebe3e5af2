#include "core/photo/distort.h"

#include "core/base/num.h"

#include <string.h>

enum {
    GRID = 33,  // points across the picture where its rays are looked at
    ROWS = 16,  // per chunk
    SAMPLES = 4 // of a pixel, per side, at most
};

static const double FAR = DISTORT_ANGLE * NUM_PI / 180;

/* x / z, y / z of a pixel; false: none, or beyond FAR. */
static bool pinhole_position(const struct lens *l, double u, double v, double at[2])
{
    const double px[2] = {u, v};
    double ray[3];
    if (!lens_unproject(l, px, ray) || !(ray[2] >= cos(FAR) - 1e-9))
        return false;
    at[0] = ray[0] / ray[2];
    at[1] = ray[1] / ray[2];
    return true;
}

err_t distort_camera(const struct lens *l, int w, int h, int side_max, struct camera *out)
{
    double lo[2] = {0, 0}, hi[2] = {0, 0};
    bool any = false;
    for (int i = 0; i < GRID * GRID; i++) {
        const double u = (double)(i % GRID) / (GRID - 1) * w;
        const double v = (double)(i / GRID) / (GRID - 1) * h;
        double at[2];
        if (!pinhole_position(l, u, v, at)) { // towards this side all that a pinhole can show
            const double most = tan(FAR);
            at[0] = u < l->cx ? -most : most;
            at[1] = v < l->cy ? -most : most;
        } else {
            any = true;
        }
        for (int k = 0; k < 2; k++) {
            lo[k] = fmin(lo[k], at[k]);
            hi[k] = fmax(hi[k], at[k]);
        }
    }
    if (!any)
        return err_fail(ERR_ARG, "a %s lens that shows nothing within %d degrees of its axis",
                        lens_name(l->model), DISTORT_ANGLE);
    double f[2] = {l->fx, l->fy};
    const double most = fmax((hi[0] - lo[0]) * f[0], (hi[1] - lo[1]) * f[1]) + 3;
    const double shrink = fmin(1, side_max / most);
    for (int k = 0; k < 2; k++)
        f[k] *= shrink;
    out->fx = (float)f[0];
    out->fy = (float)f[1];
    out->cx = (float)(1 - lo[0] * f[0]); // one px around
    out->cy = (float)(1 - lo[1] * f[1]);
    out->w = num_min(side_max, (int)ceil((hi[0] - lo[0]) * f[0]) + 2);
    out->h = num_min(side_max, (int)ceil((hi[1] - lo[1]) * f[1]) + 2);
    return OK;
}

/* Add weight times the planes at (u, v) to sum, whose pixels have their centres at .5. */
static void add_linear(const struct distort_job *j, const double at[2], float weight, float *sum)
{
    const int w = j->pinhole->w, h = j->pinhole->h;
    const double u = at[0] - 0.5, v = at[1] - 0.5;
    const int x = num_max(0, num_min((int)floor(u), w - 2)),
              y = num_max(0, num_min((int)floor(v), h - 2));
    const float right = (float)fmin(fmax(u - x, 0), 1), down = (float)fmin(fmax(v - y, 0), 1);
    const float share[4] = {(1 - right) * (1 - down), right * (1 - down), (1 - right) * down,
                            right * down};
    for (int n = 0; n < j->n; n++)
        for (int k = 0; k < 4; k++) {
            const size_t row = (size_t)n * (size_t)h + (size_t)num_min(y + k / 2, h - 1);
            const size_t i = row * (size_t)w + (size_t)num_min(x + k % 2, w - 1);
            if (share[k] > 0) // 0 times infinity
                sum[n] += weight * share[k] * j->in[i];
        }
}

/* Samples per side that see every pixel of the pinhole where the two are about as sharp. */
static int samples_of(const struct distort_job *j)
{
    const double across = (double)j->pinhole->w / j->w, down = (double)j->pinhole->h / j->h;
    return num_max(1, num_min((int)ceil(fmax(across, down) - 0.1), SAMPLES));
}

static void resample_pixel(const struct distort_job *j, int x, int y, int samples)
{
    const size_t plane = (size_t)j->w * (size_t)j->h;
    float *to = j->out + (size_t)y * (size_t)j->w + (size_t)x;
    float sum[4] = {0};
    bool seen = true;
    for (int i = 0; i < samples * samples; i++) {
        double at[2];
        if (!pinhole_position(j->lens, x + (i % samples + 0.5) / samples,
                              y + (i / samples + 0.5) / samples, at)) {
            seen = false;
            continue;
        }
        at[0] = at[0] * (double)j->pinhole->fx + (double)j->pinhole->cx;
        at[1] = at[1] * (double)j->pinhole->fy + (double)j->pinhole->cy;
        seen = seen && at[0] >= 0 && at[0] <= j->pinhole->w && at[1] >= 0 && at[1] <= j->pinhole->h;
        add_linear(j, at, 1.0f / (float)(samples * samples), sum);
    }
    for (int n = 0; n < j->n; n++)
        to[(size_t)n * plane] = sum[n];
    if (j->seen)
        j->seen[to - j->out] = seen;
}

static err_t resample_rows(void *ctx, int chunk, int worker)
{
    const struct distort_job *j = ctx;
    const int samples = samples_of(j);
    (void)worker;
    for (int y = chunk * ROWS; y < num_min(j->h, (chunk + 1) * ROWS); y++)
        for (int x = 0; x < j->w; x++)
            resample_pixel(j, x, y, samples);
    return OK;
}

err_t distort_run(struct pool *pool, const struct distort_job *j)
{
    struct distort_job own = *j;
    return pool_for(pool, (j->h + ROWS - 1) / ROWS, resample_rows, &own);
}
