/* bench_net.h - figures of the network for `hdrig bench`: its stages and kinds of work in a forward
 * pass, and its products with every instruction set. */
#ifndef CMD_BENCH_NET_H
#define CMD_BENCH_NET_H

#include "firmware/base/config.h"
#include "firmware/recon/limits.h"
#include "firmware/result/report.h"

#include "core/base/types.h"

enum { BENCH_NET_STAGES = 4, BENCH_NET_KINDS = 16, BENCH_NET_KERNELS = 64 };

struct bench_net_figure {
    const char *name, *isa; // isa: of the instruction set that limits it, or NULL
    int threads;
    double seconds;
    double macs;               // multiply-accumulates; 0: it is something else
    struct limits_share share; // shares of their limit, by the clock and by processor time; 0: none
};

struct bench_net {
    int views, size, threads;
    char precision[8];
    double seconds, tmp_mb, keep_mb, rss_mb;
    int n_stages, n_kinds, n_kernels;
    struct bench_net_figure stages[BENCH_NET_STAGES], kinds[BENCH_NET_KINDS];
    struct bench_net_figure kernels[BENCH_NET_KERNELS];
};

/* A forward pass of the weights file `model` on `views` pictures of noise; size 0: that of the
 * model. Stages: multiply-accumulates by the formulas of core/net/README.md 3.4, whatever way they
 * are computed, so that a stage may beat the limit. Kinds, in a second pass: as the kernels are
 * called.
 * err:  those of network_open and net_run, ERR_LIMIT (memory). */
MUST_USE err_t bench_net_run(const char *model, int views, int size, const struct config *cfg,
                             struct bench_net *out);

/* n views of noise, at three exposures in turn. bench_net_views_plan allocates the same from a
 * counter.
 * err:  ERR_NOMEM. */
MUST_USE err_t bench_net_views(struct arena *a, int n, int size, struct views *v);
void bench_net_views_plan(struct arena *count, int n, int size);

/* The products alone, on one thread and on all, with every instruction set.
 * err:  ERR_NOMEM, ERR_CANCELLED. */
MUST_USE err_t bench_net_kernels(const struct config *cfg, struct bench_net *out);

/* Members of an open object; nothing of what was not run. */
void bench_net_report(const struct bench_net *b, struct report *rep);
void bench_net_print(const struct bench_net *b);

#endif
