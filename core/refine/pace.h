/* pace.h - the schedule of picture sizes in a refinement, and the steps that fit into a time. Pure
 * computation. thread: any. */
#ifndef REFINE_PACE_H
#define REFINE_PACE_H

enum { PACE_LEVELS = 5 };

/* Level of the pictures of a step: a third of the steps sees the smallest ones, levels - 1; the
 * other levels share the rest equally, the largest ones, 0, at the end. */
int pace_level(int step, int steps, int levels);

struct pace {
    int levels;
    double seconds[PACE_LEVELS]; // that a step takes with pictures of each level
};

/* Seconds of the steps from..steps - 1 of a schedule of `steps`. */
double pace_seconds(const struct pace *p, int from, int steps);

/* The longest schedule of from..steps steps whose steps from `from` on take no more than that. */
int pace_fit(const struct pace *p, int from, int steps, double seconds);

#endif
