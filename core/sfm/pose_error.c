#include "core/sfm/pose_error.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/similarity.h"

#include <math.h>

struct figures {
    float *angle, *distance, *focal; // (n) each
};

static err_t layout(struct figures *f, struct arena *tmp, size_t n)
{
    err_t e = arena_alloc(tmp, n, sizeof *f->angle, &f->angle);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *f->distance, &f->distance);
    return e ? e : arena_alloc(tmp, n, sizeof *f->focal, &f->focal);
}

size_t pose_error_plan(int n)
{
    struct arena tmp = arena_counter();
    struct figures f;
    if (layout(&f, &tmp, (size_t)n))
        return SIZE_MAX;
    arena_step(&tmp, similarity_plan(n));
    return tmp.peak;
}

/* Root of the mean squared distance of the cameras from their mean. */
static double spread_of(const struct camera *c, int n)
{
    double sum[3] = {0}, square = 0, x[3];
    for (int i = 0; i < n; i++) {
        rotation_centre(&c[i], x);
        for (int k = 0; k < 3; k++) {
            sum[k] += x[k] / n;
            square += x[k] * x[k] / n;
        }
    }
    return sqrt(fmax(square - sum[0] * sum[0] - sum[1] * sum[1] - sum[2] * sum[2], 1e-30));
}

err_t pose_error_measure(const struct run *r, const struct camera *found, const struct camera *real,
                         int n, struct pose_error *out)
{
    const size_t mark = arena_mark(r->tmp), count = (size_t)n;
    struct figures f;
    struct similarity w;
    *out = (struct pose_error){.n = n};
    err_t e = layout(&f, r->tmp, count);
    if (!e)
        e = similarity_fit(r, found, real, n, &w);
    const double size = e ? 1 : spread_of(real, n);
    for (int i = 0; i < n && !e; i++) {
        struct camera c = similarity_apply(&w, &found[i]);
        double a[3], b[3];
        rotation_centre(&c, a);
        rotation_centre(&real[i], b);
        f.angle[i] = (float)(rotation_between(&c, &real[i]) * 180 / NUM_PI);
        f.distance[i] = (float)(hypot(hypot(a[0] - b[0], a[1] - b[1]), a[2] - b[2]) / size);
        f.focal[i] = (float)fabs((double)c.fx / (double)real[i].fx - 1);
    }
    if (!e) {
        out->rot_deg = (double)num_median(f.angle, count);
        out->trans = (double)num_median(f.distance, count);
        out->focal = (double)num_median(f.focal, count);
    }
    arena_reset(r->tmp, mark);
    return e;
}
