/* speck.h - crumbs in a depth map: a few pixels that one other view confirms and that are far from
 * all around them are wrong matches more often than leaves.
 * Pure functions; any thread. */
#ifndef STEREO_SPECK_H
#define STEREO_SPECK_H

/* One view's. */
struct speck_map {
    int w, h;
    const float *depth;      // (h, w)
    float *conf;             // (h, w) 0 .. 1
    float usable, confirmed; // from these on a depth is used; several views confirm it; above 0
    int least;               // px of a piece that stays
    int *list;               // (h, w) scratch
};

/* Pieces of usable depth (neighbours within 3 %) of less than `least` px, none of which several
 * views confirm: their confidence becomes 0.
 * returns: number of pixels. */
int speck_drop(const struct speck_map *m);

#endif
