/* flicker.h - lamps on mains brighten and dim at twice its frequency: 100 or 120 Hz. It shows
 * in short exposures, compared with longer ones that average over it: from frame to frame, and from
 * row to row under a rolling shutter.
 * Pure; any thread. */
#ifndef PHOTO_FLICKER_H
#define PHOTO_FLICKER_H

#include "core/photo/exposure_probe.h"

enum { FLICKER_FRAMES = 8 }; // short frames that suffice

/* Frames of one scene at two exposures. Zero it first. */
struct flicker {
    int n_long, n_short;
    double even[EXPOSURE_PROBE_EDGE];                // sums of rows over the long frames
    double row[FLICKER_FRAMES][EXPOSURE_PROBE_EDGE]; // sums of rows of each short frame
    double var[FLICKER_FRAMES][EXPOSURE_PROBE_EDGE]; // their squared standard errors
    double start_s[FLICKER_FRAMES], time_s[FLICKER_FRAMES];
    int patches[EXPOSURE_PROBE_EDGE]; // number that counts in each row
    double long_s;                    // the longer exposure
    bool counts[EXPOSURE_PROBE_PATCHES];
};

/* Add a frame of the longer exposure. These come first. */
void flicker_add_long(struct flicker *f, const struct exposure_probe *w, double time_s);

/* Add a frame of a shorter exposure, at most FLICKER_FRAMES. start_s: start of the exposure of its
 * first row. Several exposures are better than one: lamp and frames may be in step, so that all
 * frames of one exposure look alike. */
void flicker_add_short(struct flicker *f, const struct exposure_probe *w, double start_s,
                       double time_s);

struct flicker_light {
    double hz;    // 100 or 120; 0: the light is steady, or not known
    double depth; // 0..1: the light is mean (1 + depth sin(2 pi hz t))
};

/* The best fit. period_s: from frame to frame; reading a frame takes at most as long. */
void flicker_find(const struct flicker *f, double period_s, struct flicker_light *out);

/* Most that an exposure may look brighter or darker than under steady light, stops. */
double flicker_stops(const struct flicker_light *l, double time_s);

/* The nearest exposure, s, of at least half a period, that holds whole periods of the light;
 * time_s itself if it is shorter, or the light is steady. */
double flicker_steady_s(const struct flicker_light *l, double time_s);

#endif
