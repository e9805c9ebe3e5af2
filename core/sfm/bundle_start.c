/* Lenses that the attempts of bundle adjustment begin with, and what they expect of focal lengths.
 * Straight down on a field and along a street, focal length and depth tell little of each other:
 * what bends a little or matches wrongly moved them by a quarter to a third, at standard errors of
 * a fiftieth. So EXIF counts for about what it is worth. */
#include "core/sfm/bundle_inner.h"

#include "core/base/num.h"

#include <math.h>

/* Weights of an expected ln focal length: that of EXIF is off by some 6 percent (rounded, of
 * another diagonal), and sightings, which count as independent, were off by 7 to 10 standard errors
 * outdoors: five is what they count for; a network's; of no knowledge. */
static const double PRIOR_KNOWN = 5 / 0.06, PRIOR_START = 4, PRIOR_USUAL = 2;
static const double PRIOR_REACH = 0.3; // more in ln is EXIF of a photograph that was cut
static const double CLEARLY = 1.02; // redundancy over that of another answer, not to believe EXIF

/* Focal length over picture size: 120 degrees of a fisheye. */
static const double ANGLE120 = 0.477464829275686;

static bool is_fisheye(const struct bundle *b, int lens)
{
    return b->cfg->lens[lens].start.model == LENS_OPENCV_FISHEYE;
}

static double usual_focal(const struct bundle *b, int lens)
{
    for (int v = 0; v < b->n_views; v++)
        if (b->a.lens_of[v] == lens)
            return (is_fisheye(b, lens) ? ANGLE120 : BUNDLE_FOCAL) *
                   num_max(b->v->extent[v].w, b->v->extent[v].h);
    return BUNDLE_FOCAL * b->v->size;
}

/* Focal length of a lens that the first attempt begins with. */
static double start_focal(const struct bundle *b, int lens)
{
    float f[BUNDLE_VIEWS_MAX];
    int n = 0;
    const double given = b->cfg->lens[lens].start.fx;
    if (given > 0 && isfinite(given))
        return given;
    for (int i = 0; i < b->n_views && b->cfg->start; i++)
        if (b->a.lens_of[i] == lens)
            f[n++] = sqrtf(b->cfg->start[i].fx * b->cfg->start[i].fy * bundle_aspect(b));
    return n ? (double)num_median(f, (size_t)n) : usual_focal(b, lens);
}

void bundle_start_expect(struct bundle *b, int lens)
{
    const struct bundle_lens *before = &b->cfg->lens[lens];
    const bool known = before->start.fx > 0 && !before->focal_guessed;
    struct adjust_lens *l = &b->a.lens[lens];
    l->prior_focal = log(known ? before->start.fx : b->start[lens].fx);
    l->prior_reach = known ? PRIOR_REACH : 0;
    l->prior = known ? PRIOR_KNOWN : b->cfg->start ? PRIOR_START : PRIOR_USUAL;
}

/* Views are as large as the photographs they were resampled from. */
static double frame_of(const struct bundle *b, int lens)
{
    double most = 0;
    for (int v = 0; v < b->n_views; v++)
        if (b->a.lens_of[v] == lens)
            most = fmax(
                most, 0.5 * hypot(b->v->extent[v].w, b->v->extent[v].h * (double)bundle_aspect(b)));
    return most;
}

err_t bundle_start_known(struct bundle *b)
{
    err_t e = OK;
    for (int i = 0; i < b->a.n_lenses; i++) {
        struct adjust_lens *l = &b->a.lens[i];
        b->start[i] = b->cfg->lens[i].start;
        b->start[i].fx = b->start[i].fy = start_focal(b, i);
        if (!e)
            e = lens_init(&b->start[i]);
        l->frame = frame_of(b, i);
        bundle_start_expect(b, i);
        l->lens = b->best.lens[i].lens = b->start[i];
    }
    return e;
}

bool bundle_start_usual(struct bundle *b)
{
    bool other = false;
    for (int i = 0; i < b->a.n_lenses; i++) {
        const struct lens *l = &b->cfg->lens[i].start;
        const double first = start_focal(b, i), usual = usual_focal(b, i);
        const bool sure = b->cfg->focal_known || (l->fx > 0 && lens_distorts(l));
        b->start[i].fx = b->start[i].fy = sure ? first : usual;
        other = other || (!sure && fabs(log(first / usual)) > 0.05);
        if (b->a.lens[i].prior_reach > 0)
            b->margin = CLEARLY;
    }
    return other;
}
