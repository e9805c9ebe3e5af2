#include "firmware/recon/recipe.h"

#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/sfm/bundle.h"
#include "core/sfm/corner.h"

enum { SIZE_DEFAULT = 448 };

bool recipe_forward(const struct job_config *cfg)
{
    return cfg->network && !cfg->cameras_only && cfg->network->net.d.gauss &&
           cfg->refine.steps == 0;
}

/* Whether depth is found by stereo, whatever the network could say. */
static bool takes_stereo(const struct job_config *cfg, bool tapped)
{
    return !cfg->network || cfg->cameras_only || (cfg->stereo && !tapped && !recipe_forward(cfg));
}

static enum recipe_source choose_cameras(bool known, bool bundle)
{
    return known ? RECIPE_GIVEN : bundle ? RECIPE_BUNDLE : RECIPE_NETWORK;
}

/* More Gaussians than pixels serve nothing. */
static void limit_gaussians(const struct job_config *cfg, struct recipe *out)
{
    const long long pixels = (long long)out->places * cfg->size * cfg->size;
    const int all = pixels < GAUSSIANS_MAX ? (int)pixels : GAUSSIANS_MAX;
    out->refinement.gaussians_max = num_min(cfg->refine.gaussians_max, all);
    out->gaussians_max = out->forward ? all : out->refinement.gaussians_max;
    out->degree_max = out->forward ? SH_DEGREE_MAX : cfg->refine.degree_max;
}

struct recipe recipe_choose(const struct capture *c, const struct job_config *cfg, bool tapped)
{
    const bool known = c->n > 0 && c->shots[0].has_camera, stereo = takes_stereo(cfg, tapped);
    const bool gaussians = !stereo && cfg->network->net.d.gauss;
    struct recipe out = {.depth = stereo ? RECIPE_STEREO : RECIPE_NETWORK,
                         .gaussians = gaussians ? RECIPE_NETWORK : RECIPE_SEEDS,
                         .network = cfg->network && !(stereo && known),
                         .forward = recipe_forward(cfg),
                         .tapped = tapped,
                         .places = prep_places(c),
                         .refinement = cfg->refine};
    out.bundle = out.network ? cfg->polish && !tapped && (!known || gaussians) : !known;
    out.cameras = choose_cameras(known, out.bundle);
    out.must_place = out.bundle && (!cfg->network || cfg->cameras_only);
    out.correct = out.bundle && gaussians;
    /* without steps the refiner takes out what is transparent, which a network's scene keeps */
    out.refine = cfg->refine.steps > 0 || !out.forward;
    out.refinement.poses = cfg->refine.poses || out.cameras == RECIPE_BUNDLE;
    limit_gaussians(cfg, &out);
    return out;
}

struct recipe recipe_of_cameras(const struct job_config *cfg)
{
    struct job_config alone = *cfg;
    alone.cameras_only = true;
    return recipe_choose(&(struct capture){.n = 0}, &alone, false);
}

int recipe_size(const struct job_config *cfg)
{
    return takes_stereo(cfg, false) ? SIZE_DEFAULT : cfg->network->net.d.size;
}

err_t recipe_check(const struct recipe *recipe, int size)
{
    if (recipe->bundle && recipe->places > BUNDLE_VIEWS_MAX)
        return err_fail(ERR_ARG,
                        "%d views, cameras can be found for at most %d: keep those that show the "
                        "most, each overlapping its neighbours%s",
                        recipe->places, BUNDLE_VIEWS_MAX,
                        recipe->cameras == RECIPE_GIVEN ? "; or take --set cameras.polish=0"
                                                        : "; or give the cameras with --rig PATH");
    if (recipe->must_place && size < CORNER_SIZE_MIN)
        return err_fail(ERR_ARG,
                        "views of %d px are too small to find cameras, take at least --size %d, or "
                        "give the cameras with --rig PATH",
                        size, (CORNER_SIZE_MIN + 13) / 14 * 14);
    return OK;
}
