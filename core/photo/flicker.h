/* flicker.h - lamps on mains brighten and dim at twice its frequency: 100 or 120 Hz. What a camera
 * sees of it in short exposures, compared with longer ones that average over it: from frame to
 * frame, and from row to row where a shutter rolls.
 * Pure; any thread. */
#ifndef PHOTO_FLICKER_H
#define PHOTO_FLICKER_H

#include "core/photo/exposure_probe.h"

enum { FLICKER_FRAMES = 8 }; // short ones that are enough

/* Frames of one scene at two exposures. Zero it first. */
struct flicker {
    int n_long, n_short;
    double even[EXPOSURE_PROBE_EDGE];                // sums of rows over the long frames
    double row[FLICKER_FRAMES][EXPOSURE_PROBE_EDGE]; // of each short one
    double start_s[FLICKER_FRAMES], time_s[FLICKER_FRAMES];
    int places[EXPOSURE_PROBE_EDGE]; // that count
    double long_s;                   // the longer exposure
    bool counts[EXPOSURE_PROBE_PLACES];
};

/* A frame of the longer exposure, some of them first. */
void flicker_add_long(struct flicker *f, const struct exposure_probe *w, double time_s);

/* A frame of a shorter one, at most FLICKER_FRAMES. start_s: when the exposure of its first row
 * began. Several exposures tell more: lamp and frames may be in step, so that all frames of one
 * exposure see the same. */
void flicker_add_short(struct flicker *f, const struct exposure_probe *w, double start_s,
                       double time_s);

struct flicker_light {
    double hz;    // 100 or 120; 0: it is steady, or nothing can be said
    double depth; // 0..1: the light is mean (1 + depth sin(2 pi hz t))
};

/* What fits best. period_s: of frames: none takes longer to read. */
void flicker_find(const struct flicker *f, double period_s, struct flicker_light *out);

/* By how much an exposure may look brighter or darker than steady light makes it, stops. */
double flicker_stops(const struct flicker_light *l, double time_s);

/* The nearest exposure, s, of at least half a period, that holds whole periods of the light;
 * time_s itself if it is shorter, or the light is steady. */
double flicker_steady_s(const struct flicker_light *l, double time_s);

#endif
