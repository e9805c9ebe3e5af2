/* sample.h - one world photographed by a rig, for training and `hdrig simulate`. Also
 * built as build/ARCH/libsim.so, which sim/train calls through ctypes. Thread: any; calls with
 * different arenas are independent. */
#ifndef TRAIN_SAMPLE_H
#define TRAIN_SAMPLE_H

#include "sim/sensor/local_tone.h"
#include "sim/sensor/optics.h"
#include "sim/sensor/sensor.h"
#include "sim/world/render.h"
#include "sim/world/target.h"

enum { SAMPLE_VIEWS = 256, SAMPLE_SIZE = 2048, SAMPLE_PX = 1 << 27, SAMPLE_SHOTS = 64 };

/* Whether the world has a light that is switched (sim/world/world.h), and how it is. */
enum sample_switch { SAMPLE_NO_SWITCH, SAMPLE_OFF, SAMPLE_ON };

/* A world and the rig that photographs it. */
struct sample_scene {
    uint64_t seed;
    int kind;                      // enum world_kind
    int n_views, size;             // 1..SAMPLE_VIEWS; px, 14..2048; at most SAMPLE_PX px in all
    float spread;                  // as in struct world_path
    float fov_deg;                 // as in struct world_path
    int jitter;                    // bool
    float orbit_deg;               // as in struct world_path, of a WORLD_PARK; 0: none
    int walk;                      // bool, as in struct world_path, of a WORLD_PARK; then all views
                                   // are inputs
    struct render_quality quality; // the lens is that of:
    int n_optics;                  // 0: none, square pictures and fov_deg
    const struct optics *optics;   // (n_optics) of the rig's cameras, which take turns: a view is
                                   // taken by camera sample_number() modulo n_optics
    const struct camera *rig; // ((n_views + 1) / 2) poses of a rig, brought to where the views of
                              // even number would be; those of odd number stand between two of
                              // them; NULL: none
    const struct target *target; // in the world, before views of even number; then lengths of the
                                 // rig are m, else it is scaled to the place; NULL: none
    int switched;                // enum sample_switch
};

/* Inputs are the views of even number, and all of a walk; the others are held out. The number of a
 * view counts those of its own kind. */
bool sample_is_input(const struct sample_scene *a, int view);
int sample_number(const struct sample_scene *a, int view);

/* The number of the camera that takes a view, and what stands before its sensor; 0 and NULL without
 * optics. */
int sample_camera_of(const struct sample_scene *a, int view);
const struct optics *sample_optics(const struct sample_scene *a, int view);

/* Shapes of the pictures, which lie one after another. */
void sample_extents(const struct sample_scene *a, struct extent *out);

/* Radiance, depth and cameras of all views. Radiance is that before the lens: optics do not dim it.
 * out:  radiance (3, h, w) of each view, depth (h, w), as sample_extents says, cams (n), all the
 *       caller's; any of radiance and depth may be NULL. *key: exposure time, s, that puts the
 *       median luminance of the view whose median is the middle one at 18 % of full scale of
 *       sensor_default: an exposure of 2^0.
 * err:  ERR_ARG, ERR_NOMEM (r->tmp, see sample_plan), ERR_CANCELLED */
MUST_USE err_t sample_make(const struct run *r, const struct sample_scene *a, float *radiance,
                           float *depth, struct camera *cams, double *key);

/* The same, and the world is kept.
 * radiance, depth, cams: as above, the caller's, set before.
 * out:  the rest; the world lives in r->tmp until its user resets that to where it was. */
struct sample_place {
    float *radiance, *depth;
    struct camera *cams;
    double key;
    struct render_world *world;
};
MUST_USE err_t sample_open(const struct run *r, const struct sample_scene *a,
                           struct sample_place *out);

/* For both; also enough for sample_expose of one such picture after sample_open. */
void sample_plan(struct plan *p, const struct sample_scene *a, enum local_tone local);

/* How a radiance image is photographed. */
struct sample_camera {
    int w, h;                    // px, of the picture
    double key;                  // as in sample_make
    const struct sensor *sensor; // NULL: no noise, and no clipping but that of the curve
    const struct curve *curve;   // not NULL
    uint64_t seed;               // seed of the noise
    uint64_t first;              // the number of the first photograph, for the noise
    enum local_tone local;       // before the curve
};

/* Photographs of one radiance image (3, h, w) at the exposures 2^stops[i] times key, stops
 * in -40..40, n in 1..SAMPLE_SHOTS, the i-th of number c->first + i. A sensor is
 * exposed for an hour at most.
 * out:  px (n, h, w, 3)
 * err:  ERR_ARG, ERR_NOMEM (r->tmp, see sample_plan), ERR_CANCELLED */
MUST_USE err_t sample_expose(const struct run *r, const struct sample_camera *c,
                             const float *radiance, int n, const float *stops, uint8_t *px);

/* ---- for ctypes: one thread, own memory; 0 on success, else the err_t ---- */

struct sample_request { // all that Python fills in
    struct sample_scene scene;
    int noise;        // 0 or 1: sensor_default or none
    int curve_family; // enum curve_family, or -1: drawn by curve_seed
    float curve_param;
    uint64_t curve_seed, noise_seed;
};

/* cams (n_views, 11): fx fy cx cy, q wxyz, t. */
int sample_photograph(const struct sample_request *q, float *radiance, float *depth, float *cams,
                      double *key);
int sample_develop(const struct sample_request *q, double key, const float *radiance, int n,
                   const float *stops, uint8_t *px);
const char *sample_error(void);

#endif
