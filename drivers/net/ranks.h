/* ranks.h - this process as one of those that mpirun or mpiexec started, of Open MPI or MPICH: its
 * team. The library is loaded as a module (mpi_shim.h); without a launcher none is needed.
 * thread: the one that runs the job. */
#ifndef NET_RANKS_H
#define NET_RANKS_H

#include "drivers/net/mpi_shim.h"

#include <stdbool.h>

struct ranks {
    struct team team;                   // equal shares
    char host[TEAM_MAX][MPI_SHIM_HOST]; // machine of each rank
    const struct mpi_shim *shim;        // NULL: alone
};

/* Number of processes that the launcher says it has started; 1 if there is none. */
int ranks_launched(void);

/* Join the others. Alone: r->team.size is 1, and r->shim NULL.
 * cancel: ends every wait, and must live as long as *r.
 * own:  ranks_close or ranks_abort.
 * err:  ERR_UNSUPPORTED (no module), ERR_LIMIT (ranks, threads), ERR_LOST, ERR_CANCELLED. */
MUST_USE err_t ranks_open(struct ranks *r, const atomic_bool *cancel);

/* This rank has failed: the launcher ends all. Does not return unless alone. */
void ranks_abort(struct ranks *r, int code);

/* After success; waits for the others. Accepts a zeroed struct. */
void ranks_close(struct ranks *r);

enum { RANKS_LIBRARIES = 2 };

/* Whether processes of library i, 0..RANKS_LIBRARIES - 1, can be joined here. what: its name.
 * err:  as ranks_open, without joining. */
MUST_USE err_t ranks_probe(int i, const char **what);

#endif
