/* sights.h - what the photographs show of small squares of their depth maps.
 * Pure functions of *s; any thread. */
#ifndef STEREO_SIGHTS_H
#define STEREO_SIGHTS_H

#include "core/photo/response.h"
#include "core/stereo/sweep.h"

struct sights {
    const struct views *views;
    const struct depthmaps *depth; // of these views
    struct response_table table;   // of the response
};

/* v and d must outlive *s. */
void sights_set(struct sights *s, const struct views *v, const struct depthmaps *d,
                const struct tonemap *tone);

/* ln radiance of the pixels under a square and its reliability; and its bounds, of which one is far
 * where the picture is black or saturated. */
struct sight {
    float ln[3], weight[3], least[3], most[3];
};

/* at: middle, side: edge of the square, px of the map; alike: all pixels count alike, else as they
 * are reliable. */
struct sight sights_look(const struct sights *s, int view, const float *at, float side, bool alike);

/* Whether one view is as bright as the other allows, if that is black or saturated. */
bool sights_agree(const struct sight *a, const struct sight *b);

/* Add ln radiance to sum, (3, 2), weighted by reliability. */
void sights_add(const struct sight *o, float factor, float (*sum)[2]);

/* Standard deviation over mean of the picture under a square, as displayed, where it shows. */
float sights_contrast(const struct sights *s, int view, const float *at, float side);

/* Reliability of the green of a pixel (x, y) of the picture. */
float sights_reliability(const struct sights *s, int view, int x, int y);

#endif
