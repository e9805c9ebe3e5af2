/* tradeoff.h - cost of precision: forward passes of several weights files at several sizes and
 * numbers of views, their time, memory and distance to the first file, for `hdrig bench`. */
#ifndef CMD_TRADEOFF_H
#define CMD_TRADEOFF_H

#include "core/refine/differ.h"
#include "firmware/base/config.h"
#include "firmware/result/report.h"

enum { TRADEOFF_LIST_MAX = 8, TRADEOFF_FLOATS_MAX = 6 };

struct tradeoff_request {
    const char *models; // files, separated by commas
    const char *images; // folder of photographs, used again where there are too few; NULL: noise
    int n_views, n_sizes;
    const int *views, *sizes; // at most TRADEOFF_LIST_MAX each
    bool print;               // every row to stdout when it is ready
};

struct tradeoff_row {
    int model;     // index in the list
    char what[64]; // precision, and the parts of an int8 model that are in floats
    int size, views;
    double seconds;               // for one forward pass, with the file in memory
    double memory_mb;             // most of the arenas, and the file
    double rss_mb;                // most of the process, NAN if the system cannot tell
    double error[DIFFER_FIGURES]; // NAN in the reference's own row
};

struct tradeoff {
    int n;
    struct tradeoff_row
        rows[TRADEOFF_LIST_MAX * (TRADEOFF_LIST_MAX * TRADEOFF_LIST_MAX + TRADEOFF_FLOATS_MAX)];
};

/* For every size and number of views each file; at the first of both an int8 file also with one
 * part after the other in floats, and with those of net.float_parts. The first file is the
 * reference. Memory is checked before the first pass.
 * err:  ERR_ARG (lists, sizes), ERR_LIMIT (memory), those of network_open, modelfile_verify,
 *       imageset_load and net_run. */
MUST_USE err_t tradeoff_run(const struct tradeoff_request *rq, const struct config *cfg,
                            struct tradeoff *out);

/* An array of objects, member "trade" of an open object. */
void tradeoff_report(const struct tradeoff *t, struct report *rep);

#endif
