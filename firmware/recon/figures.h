/* figures.h - what the photographs of a job hold and which curve its camera has, in numbers for
 * report.json and in warnings.
 * thread: any. */
#ifndef RECON_FIGURES_H
#define RECON_FIGURES_H

#include "firmware/recon/job_result.h"
#include "firmware/result/report.h"

#include "core/photo/response.h"

enum {
    FIGURES_BINS = 64,    // bins of 4 display values each
    FIGURES_DARK = 8,     // display values below are noise
    FIGURES_CLIPPED = 252 // display values from here on hold no information
};

enum { FIGURES_EXPOSURES = 32 };

/* A photograph. A pixel is clipped, dark or seen well by its brightest colour. */
struct figures_input {
    double clipped, dark; // shares of the pixels
    double alone;         // share that is seen well here and would be at no other exposure
    uint32_t histogram[3][FIGURES_BINS];
};

/* Photographs with one exposure. */
struct figures_exposure {
    double log2t, stops; // stops: to the middle exposure
    int n;
    double clipped, dark, alone; // means of those that were looked at
    double from, to; // what is seen well: log2 radiance, 0 = display 0.5 at the middle exposure
};

struct figures {
    const struct views *v;
    const struct tonemap *tone; // the scene's curve
    struct response_table table;
    int n; // exposures, ascending; less than a tenth of a stop apart they are one, of many more
    struct figures_exposure exposure[FIGURES_EXPOSURES];
};

void figures_init(struct figures *f, const struct views *v, const struct tonemap *tone);

/* Look at view i, once. */
void figures_input(struct figures *f, int i, struct figures_input *out);

/* "black" or "saturated" if photograph i is so all over, else NULL. A few bright pixels may be a
 * lamp that only so short an exposure shows: black has none. */
const char *figures_blank(const struct views *v, int i);

/* The first photograph before i with the same pixels that shows anything; -1: none. */
int figures_copied(const struct views *v, int i);

/* Members "inputs", "exposures", "tone" into an open object; the first two only if the photographs
 * are at hand. */
void figures_report(const struct job_result *j, struct report *rep);

/* Warnings about exposures and views that are missing, each with what to do. */
void figures_warn(struct job_result *j);

#endif
