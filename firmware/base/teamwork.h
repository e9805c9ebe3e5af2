/* teamwork.h - an engine that works with the engines of other ranks, if a launcher (mpirun) started
 * several: the same program on all, files where they are needed, one voice for messages. */
#ifndef BASE_TEAMWORK_H
#define BASE_TEAMWORK_H

#include "firmware/base/engine.h"
#include "firmware/base/handout.h"

#include "drivers/net/ranks.h"

struct teamwork {
    struct ranks ranks;
    struct handout files;
    const char *command; // begins sentences
};

/* engine_open, and en->run.team if there are several ranks: threads 0 is then one per core that the
 * launcher has bound this rank to, or its share of the machine's cores. Shares of the team are
 * measured. Ranks but the first are silent.
 * own:  teamwork_close, then engine_close.
 * err:  those of engine_open and ranks_open, ERR_UNSUPPORTED (another program, or other
 *       instructions). */
MUST_USE err_t teamwork_open(struct teamwork *w, const char *command, int threads,
                             struct engine *en);

/* Whether this rank writes results and messages: the only one, or the first. */
bool teamwork_speaks(const struct teamwork *w);

/* See handout_path. `none` is no path. */
MUST_USE err_t teamwork_path(struct teamwork *w, const char **path);

/* The end of the job on this rank, e: how it ended. After a failure the other ranks are ended, and
 * this does not return, but on the only rank. Accepts a zeroed struct. */
void teamwork_close(struct teamwork *w, err_t e, int code);

#endif
