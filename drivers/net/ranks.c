#include "drivers/net/ranks.h"

#include "drivers/device/clocks.h"
#include "drivers/device/module.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* What launchers tell their processes: Open MPI 4 and 5, and Hydra of MPICH. */
static const struct library {
    const char *count; // variable with the number of processes
    struct module module;
} libraries[RANKS_LIBRARIES] = {
    {"OMPI_COMM_WORLD_SIZE",
     {"Open MPI", "hdrig-openmpi.so", "libopenmpi-dev", "libopenmpi3 or openmpi-bin",
      MPI_SHIM_TABLE, true}},
    {"PMI_SIZE",
     {"MPICH", "hdrig-mpich.so", "libmpich-dev", "libmpich12 or mpich", MPI_SHIM_TABLE, true}},
};

static const struct library *find_launcher(int *n)
{
    for (int i = 0; i < RANKS_LIBRARIES; i++) {
        const char *text = getenv(libraries[i].count);
        *n = text ? atoi(text) : 1;
        if (*n > 1)
            return &libraries[i];
    }
    *n = 1;
    return NULL;
}

int ranks_launched(void)
{
    int n;
    find_launcher(&n);
    return n;
}

/* ---- the team's transport, with sentences and the time of its waits ---- */

static err_t pass_error(struct ranks *r, err_t e)
{
    return e ? err_fail(e, "rank %d of %d: %s", r->team.rank, r->team.size, r->shim->text()) : OK;
}

static err_t begin_transfer(void *ctx, void *data, const size_t *at)
{
    struct ranks *r = ctx;
    return pass_error(r, r->shim->ops.begin(NULL, data, at));
}

static err_t wait_oldest(void *ctx)
{
    struct ranks *r = ctx;
    const int64_t from = clocks_now();
    err_t e = r->shim->ops.wait(NULL);
    r->team.waited_s += 1e-9 * (double)(clocks_now() - from);
    return pass_error(r, e);
}

static err_t exchange_parts(void *ctx, const void *out, const size_t *out_at, void *in,
                            const size_t *in_at)
{
    struct ranks *r = ctx;
    const int64_t from = clocks_now();
    err_t e = r->shim->ops.exchange(NULL, out, out_at, in, in_at);
    r->team.waited_s += 1e-9 * (double)(clocks_now() - from);
    return pass_error(r, e);
}

static const struct team_ops transport = {begin_transfer, wait_oldest, exchange_parts};

/* ---- opening ---- */

static err_t load_shim(const struct module *m, const struct mpi_shim **out)
{
    const void *table;
    err_t e = module_load(m, NULL, &table);
    *out = table;
    if (!e && (*out)->stamp != MPI_SHIM_STAMP)
        e = err_fail(ERR_UNSUPPORTED, "%s: %s was built for another version of this program",
                     m->what, m->file);
    return e;
}

err_t ranks_open(struct ranks *r, const atomic_bool *cancel)
{
    int n;
    const struct library *from = find_launcher(&n);
    memset(r, 0, sizeof *r);
    r->team.size = 1;
    if (!from)
        return OK;
    err_t e = load_shim(&from->module, &r->shim);
    if (e)
        return e;
    r->team = (struct team){.ops = &transport, .ctx = r};
    e = pass_error(r, r->shim->open(cancel, &r->team.rank, &r->team.size));
    if (e || r->team.size < 2)
        return e;
    for (int i = 0; i < r->team.size; i++)
        r->team.share[i] = 1;
    if (gethostname(r->host[r->team.rank], MPI_SHIM_HOST - 1) != 0)
        snprintf(r->host[r->team.rank], MPI_SHIM_HOST, "unknown");
    return team_collect(&r->team, r->host, MPI_SHIM_HOST);
}

void ranks_abort(struct ranks *r, int code)
{
    if (r->shim)
        r->shim->abort(code);
}

void ranks_close(struct ranks *r)
{
    if (r->shim)
        r->shim->close();
    memset(r, 0, sizeof *r);
}

err_t ranks_probe(int i, const char **what)
{
    const struct mpi_shim *shim;
    *what = libraries[i].module.what;
    return load_shim(&libraries[i].module, &shim);
}
