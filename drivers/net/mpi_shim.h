/* mpi_shim.h - interface of the modules hdrig-openmpi.so and hdrig-mpich.so. The two libraries have
 * different binary interfaces, so the program loads the one that its launcher belongs to, and runs
 * without either otherwise. One thread of the module makes all calls of MPI, so transfers go on
 * while the program computes; it sleeps between its looks, so it takes no core.
 * thread: one caller. */
#ifndef NET_MPI_SHIM_H
#define NET_MPI_SHIM_H

#include "core/base/team.h"

#include <stdatomic.h>

/* Program and module were built from the same structs; count up when the meaning changes. */
#define MPI_SHIM_STAMP (1u << 24 | (unsigned)sizeof(struct team_ops) << 12 | TEAM_MAX)

#define MPI_SHIM_TABLE "mpi_shim_table" // symbol of the module

enum { MPI_SHIM_HOST = 64 }; // bytes of a machine's name with its terminating 0

/* Sentences of errors are in text(). */
struct mpi_shim {
    unsigned stamp;
    const char *(*text)(void); // sentence of the last error
    /* cancel: ends every wait. */
    err_t (*open)(const atomic_bool *cancel, int *rank, int *size);
    struct team_ops ops;     // ctx is not used
    void (*abort)(int code); // end all ranks; does not return
    void (*close)(void);     // after success: waits for all ranks
};

#endif
