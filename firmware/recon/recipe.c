#include "firmware/recon/recipe.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/sfm/bundle.h"
#include "core/sfm/corner.h"
#include "core/sfm/rigcheck.h"
#include "core/splat/raster.h"
#include "core/stereo/sweep.h"

#include <stdio.h>

/* px: without another wish; of the views that cameras and depth are found in; of the first pictures
 * of refinement, at least. */
enum { SIZE_DEFAULT = 448, WORK_SIZE = 448, LEVEL_SIZE = 400 };

bool recipe_forward(const struct job_config *cfg)
{
    return cfg->network && !cfg->cameras_only && cfg->network->net.d.gauss &&
           cfg->refine.steps == 0;
}

/* Whether depth is found by stereo, even if there is a network. */
static bool takes_stereo(const struct job_config *cfg, bool tapped)
{
    return !cfg->network || cfg->cameras_only || (cfg->stereo && !tapped && !recipe_forward(cfg));
}

static enum recipe_source choose_cameras(bool known, bool bundle)
{
    return known ? RECIPE_GIVEN : bundle ? RECIPE_BUNDLE : RECIPE_NETWORK;
}

long long recipe_pixels(const struct capture *c, struct prep_size size)
{
    long long sum = 0;
    for (int i = 0; i < c->n; i++) {
        const struct extent px = prep_extent(size, c->shots[i].image.w, c->shots[i].image.h);
        sum += i == 0 || !c->shots[i].again ? (long long)extent_pixels(&px) : 0;
    }
    return sum;
}

/* More Gaussians than pixels serve nothing. */
static void limit_gaussians(const struct capture *c, const struct job_config *cfg,
                            struct recipe *out)
{
    const long long pixels = recipe_pixels(c, (struct prep_size){cfg->size, out->square});
    const int all = pixels < GAUSSIANS_MAX ? (int)pixels : GAUSSIANS_MAX;
    out->refinement.gaussians_max = num_min(cfg->refine.gaussians_max, all);
    out->gaussians_max = out->forward ? all : out->refinement.gaussians_max;
    out->degree_max = out->forward ? SH_DEGREE_MAX : cfg->refine.degree_max;
}

static int longest_edge(const struct capture *c)
{
    int most = 0;
    for (int i = 0; i < c->n; i++)
        most = num_max(most, num_max(c->shots[i].image.w, c->shots[i].image.h));
    return most;
}

static void choose_sizes(const struct capture *c, const struct job_config *cfg, struct recipe *out)
{
    const int longest = longest_edge(c);
    out->work = out->square ? cfg->size : recipe_work(cfg);
    out->closer = 0;
    if (out->cameras == RECIPE_BUNDLE && !out->square && !cfg->once)
        out->closer = 2 * out->work;
    out->size = num_max(out->work, num_min(cfg->size, longest));
    out->refinement.levels = 2;
    while (!out->square && out->refinement.levels < REFINE_LEVELS &&
           out->size >> out->refinement.levels >= LEVEL_SIZE)
        out->refinement.levels++;
}

struct recipe recipe_choose(const struct capture *c, const struct job_config *cfg, bool tapped)
{
    const bool known = c->n > 0 && c->shots[0].has_camera, stereo = takes_stereo(cfg, tapped);
    const bool gaussians = !stereo && cfg->network->net.d.gauss;
    struct recipe out = {.depth = stereo ? RECIPE_STEREO : RECIPE_NETWORK,
                         .gaussians = gaussians ? RECIPE_NETWORK : RECIPE_SEEDS,
                         .network = cfg->network && !(stereo && known),
                         .complete = stereo && cfg->network && cfg->network->net.d.complete,
                         .forward = recipe_forward(cfg),
                         .tapped = tapped,
                         .square = !stereo || cfg->square,
                         .places = prep_places(c),
                         .refinement = cfg->refine};
    out.check = known && out.places >= RIGCHECK_LEAST && out.places <= RIGCHECK_MOST;
    for (int i = 0; i < c->n; i++)
        out.check = out.check && c->shots[i].calibrated;
    out.bundle = out.network ? cfg->polish && !tapped && (!known || gaussians) : !known;
    out.cameras = choose_cameras(known, out.bundle);
    out.must_place = out.bundle && (!cfg->network || cfg->cameras_only);
    out.correct = out.bundle && gaussians;
    /* without steps the refiner takes out what is transparent, which a network's scene keeps */
    out.refine = cfg->refine.steps > 0 || !out.forward;
    out.refinement.poses = cfg->refine.poses || out.cameras == RECIPE_BUNDLE;
    limit_gaussians(c, cfg, &out);
    choose_sizes(c, cfg, &out);
    return out;
}

struct recipe recipe_with_size(const struct recipe *recipe, const struct capture *c,
                               const struct job_config *cfg, int size)
{
    struct job_config smaller = *cfg;
    smaller.size = size;
    return recipe_choose(c, &smaller, recipe->tapped);
}

struct recipe recipe_of_cameras(const struct job_config *cfg)
{
    struct job_config alone = *cfg;
    alone.cameras_only = true;
    return recipe_choose(&(struct capture){.n = 0}, &alone, false);
}

int recipe_size(const struct job_config *cfg, const struct capture *c)
{
    const int full = num_min(longest_edge(c), RASTER_SIDE_MAX);
    if (cfg->size > 0)
        return cfg->size;
    if (cfg->size == RECIPE_SIZE_FULL)
        return full;
    if (!takes_stereo(cfg, false))
        return cfg->network->net.d.size;
    return cfg->square ? SIZE_DEFAULT : num_max(SIZE_DEFAULT, num_min(full, RECIPE_AUTO_MAX));
}

/* Cameras and depth need no more than WORK_SIZE, and take time that grows with the pixels. */
int recipe_work(const struct job_config *cfg)
{
    const bool square = cfg->square || !takes_stereo(cfg, false);
    return square ? cfg->size : num_min(cfg->size, WORK_SIZE);
}

void recipe_tell_size(const struct recipe *recipe, const struct capture *c, int cameras, char *text,
                      size_t cap)
{
    const int n = snprintf(text, cap, "pictures of %d px, from photographs of up to %d px",
                           recipe->size, longest_edge(c));
    if (n < 0 || (size_t)n >= cap)
        return;
    if (cameras > recipe->work)
        snprintf(text + n, cap - (size_t)n, "; cameras at %d px, depth at %d px", cameras,
                 recipe->work);
    else if (recipe->work < recipe->size)
        snprintf(text + n, cap - (size_t)n, "; cameras and depth at %d px", recipe->work);
}

/* The narrowest view; its photograph in *i. */
static int shortest_edge(const struct recipe *recipe, const struct capture *c, int size, int *i)
{
    int least = size;
    *i = 0;
    for (int k = 0; k < c->n; k++) {
        const struct image8 *im = &c->shots[k].image;
        const struct extent px =
            prep_extent((struct prep_size){size, recipe->square}, im->w, im->h);
        if (num_min(px.w, px.h) < least) {
            least = num_min(px.w, px.h);
            *i = k;
        }
    }
    return least;
}

err_t recipe_check(const struct recipe *recipe, const struct capture *c)
{
    const int size = recipe->work;
    int narrow, least;
    if (recipe->bundle && recipe->places > BUNDLE_VIEWS_MAX)
        return err_fail(ERR_ARG,
                        "%d views, cameras can be found for at most %d: keep those that show the "
                        "most, each overlapping its neighbours%s",
                        recipe->places, BUNDLE_VIEWS_MAX,
                        recipe->cameras == RECIPE_GIVEN ? "; or take --set cameras.polish=0"
                                                        : "; or give the cameras with --rig PATH");
    least = recipe->must_place               ? CORNER_SIZE_MIN
            : recipe->depth == RECIPE_STEREO ? SWEEP_SIZE_MIN
                                             : 1;
    if (recipe->depth == RECIPE_NETWORK && size % NET_PATCH)
        return err_fail(ERR_ARG, "--size %d, a network that makes the scene takes multiples of %d",
                        size, NET_PATCH);
    if (size < least)
        return err_fail(ERR_ARG,
                        "views of %d px are too small to find %s, take at least --size %d%s", size,
                        recipe->must_place ? "cameras" : "depth", least,
                        recipe->must_place ? ", or give the cameras with --rig PATH" : "");
    if (shortest_edge(recipe, c, size, &narrow) < least)
        return err_fail(ERR_ARG,
                        "%s: %d x %d px become a view that is less than %d px narrow; crop it, or "
                        "take a larger --size",
                        c->shots[narrow].name, c->shots[narrow].image.w, c->shots[narrow].image.h,
                        least);
    return OK;
}
