/* cover.h - exposures for a histogram: the arithmetic of meter.c.
 * Pure; any thread. */
#ifndef PHOTO_COVER_H
#define PHOTO_COVER_H

#include "core/photo/meter.h"

/* The longest legal time of at most t; the shortest if there is none. */
double cover_legal(const struct meter_config *c, double t);

/* The longest time that a plan may have. */
double cover_longest(const struct meter_config *c);

/* First bin that is not wholly unclipped at that exposure; bins below it that are usable. */
int cover_top(const struct meter *m, double exposure_s);
int cover_length(const struct meter *m);

/* Square of signal to noise at relative exposure x. */
double cover_snr2(const struct meter_config *c, double x);

/* The plan for shares of the strongest and the weakest channel, [METER_BINS]. */
void cover_run(const struct meter *m, const double *top, const double *bottom,
               struct meter_result *out);

#endif
