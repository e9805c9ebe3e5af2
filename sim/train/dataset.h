/* dataset.h - a simulated scene in the released data layout: photographs of a rig, and the true
 * radiance and depth.
 * thread: any. */
#ifndef TRAIN_DATASET_H
#define TRAIN_DATASET_H

#include "sim/train/sample.h"
#include "sim/world/passer.h"

enum { DATASET_EXPOSURES = 8 };

#define DATASET_FLICKER_MAX 3.0 // stops

struct dataset_request {
    struct sample_scene sample;     // n_views counts all cameras: 2 * inputs - 1, or a walk
    int n_exposures;                // 1..DATASET_EXPOSURES
    float stops[DATASET_EXPOSURES]; // ascending, log2 of the exposure over the metered one
    bool noise;                     // as in sensor_default
    bool input_truth;               // radiance and depth of inputs, too
    enum local_tone local;          // of all photographs, before the curve
    struct curve curve;
    struct passer passer; // in a third of the photographs of inputs; share 0: nobody
    float flicker; // 0..DATASET_FLICKER_MAX stops: each of these photographs has another light
    float balance; // the same: each input has another white balance
    float lit; // 0..1 with a switched light, which is off in `sample`: in this share of the inputs
               // it is on
};

/* Photograph the world into the folder `dir`, which exists. Inputs (sample_is_input) are
 * "train", at the first, middle and last exposure; the others are "test", at every exposure and as
 * radiance:
 *   images/{train,test}_ldr_VVV_E.png, images_hdr/test_hdr_VVV.exr (radiance, and Z: depth; if
 *   asked for, train_hdr_VVV.exr),
 *   exposure.json (2^stops), sparse/0 (COLMAP text, a camera for each of the optics)
 *   with a passer-by, truth/masks/train_ldr_VVV_E.png of photographs that it is in: 0 where it is,
 *   255 elsewhere
 *   with flicker, truth/light.json: stops of the light of each photograph of an input, drawn evenly
 *   from -flicker..flicker, less their mean: that is no flicker but light
 *   with balance, truth/red.json and blue.json: stops of these beside green, drawn evenly from
 *   -balance..balance for each input, less their mean
 *   with a switched light, truth/lamp.json: 1 for each photograph of an input that it is on in, 0
 *   for the others; inputs are drawn by the seed, and what is held out and metered shows it off
 * Of several cameras, the EXIF data of a picture name the one that took it. Radiance is that before
 * optics dim it.
 * err:  ERR_ARG, ERR_NOMEM (see dataset_plan), those of writing, ERR_CANCELLED. */
MUST_USE err_t dataset_write(const struct run *r, const struct dataset_request *a, const char *dir);
void dataset_plan(struct plan *p, const struct dataset_request *a);

/* An upper bound for the bytes of the files. */
uint64_t dataset_bytes(const struct dataset_request *a);

#endif
