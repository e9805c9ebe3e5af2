/* recipe.h - the request for a job, and how it is carried out: where cameras, depth and the first
 * Gaussians come from. Decided once, before a pixel is decoded: planning and running both read it.
 */
#ifndef RECON_RECIPE_H
#define RECON_RECIPE_H

#include "firmware/recon/network.h"

#include "core/base/types.h"
#include "core/photo/prep.h"
#include "core/refine/refine.h"

/* Lens model of cameras that are not known. */
enum recipe_lens { RECIPE_LENS_AUTO, RECIPE_LENS_PINHOLE, RECIPE_LENS_FISHEYE };

/* What happens to cameras of a calibrated rig that have moved. */
enum recipe_moved { RECIPE_MOVED_SOLVE, RECIPE_MOVED_WARN, RECIPE_MOVED_REFUSE };

struct job_config {
    int size;        // px, longest edge of the pictures that the scene is refined with
    bool size_fixed; // a budget does not make it smaller
    double budget_s; // seconds that the job should take; 0: any
    bool once;       // memory is short: no closer look at views that find no place
    bool square;     // squeeze the photographs to squares, as the paper's protocol has it
    struct refine_config refine;
    const struct network *network; // NULL: none
    bool cameras_only;             // only cameras are taken from the network
    bool polish;   // the network's cameras by bundle adjustment, always without a network; its
                   // depth by stereo
    bool stereo;   // refinement starts from stereo also if a network gave Gaussians
    float fov_deg; // of cameras that are not known, horizontal; 0: to be found
    enum recipe_lens lens;
    enum recipe_moved moved;          // of cameras of a calibrated rig
    bool principal;                   // look for the principal points of such lenses, too
    const struct prep_source *source; // of the pixels; NULL: they are in the capture
    float dump_log2t[3];              // exposures of the dumped picture, if run.tap is set
};

struct job_memory {
    size_t pictures, weights; // bytes: decoded photographs at a time (malloc'd), mapped file
    size_t keep, tmp;         // arenas
};

enum recipe_source {
    RECIPE_GIVEN,   // cameras: given with the photographs
    RECIPE_BUNDLE,  // cameras: by bundle adjustment, which starts from the network's if it runs
    RECIPE_STEREO,  // depth: by plane sweep
    RECIPE_SEEDS,   // Gaussians: from depth and photographs
    RECIPE_NETWORK, // any of them: as the network predicts
};

struct recipe {
    enum recipe_source cameras, depth, gaussians;
    bool network;    // it runs: for cameras, depth or Gaussians
    bool complete;   // its completion branch runs: for depth where stereo is not sure
    bool bundle;     // bundle adjustment: for cameras, or, where they are given, for the scale of
                     // the network's depth
    bool must_place; // views that bundle adjustment cannot place have no other camera
    bool correct;    // stereo and photographs correct the network's Gaussians
    bool forward;    // the scene is the network's single forward pass
    bool refine;     // refinement runs, if only to remove transparent Gaussians
    bool check;      // cameras are those of a rig's calibration: the photographs tell if one moved
    bool tapped;     // run.tap is set: tensors are dumped
    bool square;     // views are squares: a network's depth or Gaussians belong to their pixels
    int size, work;  // px, longest edge of the views: of refinement; of what comes before it
    int closer;      // of those where cameras are looked for again if some lack one, 0: never
    int places;      // camera positions: brackets count once
    int gaussians_max, degree_max;   // of the scene
    struct refine_config refinement; // as requested, bounded by the number of pixels
};

/* Choose for a capture; only its names, sizes and cameras are read. tapped: run.tap will be set;
 * the whole forward pass is dumped then. */
struct recipe recipe_choose(const struct capture *c, const struct job_config *cfg, bool tapped);

/* The recipe with views of another size, not above its own; a plan for it holds. */
struct recipe recipe_with_size(const struct recipe *recipe, const struct capture *c,
                               const struct job_config *cfg, int size);

/* The same for cameras alone, none of which are known: only the members cameras, network and bundle
 * are meaningful. */
struct recipe recipe_of_cameras(const struct job_config *cfg);

/* Whether the scene will be the network's single forward pass, which no capture changes. */
bool recipe_forward(const struct job_config *cfg);

enum { RECIPE_SIZE_AUTO = 0, RECIPE_SIZE_FULL = -1 }; // of job_config.size

/* Edge of the views for cfg->size px, RECIPE_SIZE_AUTO or RECIPE_SIZE_FULL. Full: that of the
 * largest photograph. Auto: what the network was trained for if it sees the scene, 448 for squares,
 * else full within RECIPE_AUTO_MAX, not less than 448. */
enum { RECIPE_AUTO_MAX = 1600 };
int recipe_size(const struct job_config *cfg, const struct capture *c);

/* Pixels of one view of each place. */
long long recipe_pixels(const struct capture *c, struct prep_size size);

/* A sentence about the sizes of pictures. cameras: px, of the views they were found in, 0: not. */
void recipe_tell_size(const struct recipe *recipe, const struct capture *c, int cameras, char *text,
                      size_t cap);

/* Longest edge, px, of the views that cameras and depth are found in. */
int recipe_work(const struct job_config *cfg);

/* Refuse more views than cameras can be found for, and views that are too small. Only names and
 * sizes of the capture are read.
 * err:  ERR_ARG. */
MUST_USE err_t recipe_check(const struct recipe *recipe, const struct capture *c);

#endif
