/* coverage.h - exposures for a histogram: the arithmetic of meter.c.
 * Pure; any thread. */
#ifndef PHOTO_COVERAGE_H
#define PHOTO_COVERAGE_H

#include "core/photo/metering.h"

/* The longest legal time of at most t; the shortest if there is none. */
double coverage_legal(const struct meter_config *c, double t);

/* The longest time that a plan may have. */
double coverage_longest(const struct meter_config *c);

/* First bin that is not wholly unclipped at that exposure; bins below it that are usable. */
int coverage_top(const struct meter *m, double exposure_s);
int coverage_length(const struct meter *m);

/* Square of signal to noise at relative exposure x. */
double coverage_snr2(const struct meter_config *c, double x);

/* The plan for shares of the strongest and the weakest channel, [METER_BINS]. */
void coverage_run(const struct meter *m, const double *top, const double *bottom,
                  struct meter_result *out);

#endif
