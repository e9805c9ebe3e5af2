/* coverage.h - exposure times that cover a histogram, for meter.c.
 * Pure; any thread. */
#ifndef PHOTO_COVERAGE_H
#define PHOTO_COVERAGE_H

#include "core/photo/metering.h"

/* The longest legal time of at most t; the shortest if there is none. */
double coverage_legal_s(const struct meter_config *c, double t);

/* The longest time that a plan may have. */
double coverage_longest_s(const struct meter_config *c);

/* First bin that may clip at that exposure; the bins below it are unclipped. */
int coverage_clip_bin(const struct meter *m, double exposure_s);

/* Number of usable bins of an exposure, below its coverage_clip_bin. */
int coverage_bins(const struct meter *m);

/* Square of signal to noise at relative exposure x. */
double coverage_snr2(const struct meter_config *c, double x);

/* The plan for shares of the strongest and the weakest channel, [METER_BINS]. */
void coverage_run(const struct meter *m, const double *top, const double *bottom,
                  struct meter_result *out);

#endif
