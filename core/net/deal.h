/* deal.h - who stores which keys. The views of a job are dealt to the ranks of a team; global
 * attention stores the tokens of all views in blocks of ATTENTION_KEYS, and a block belongs to the
 * rank that has its first token. That rank borrows the rest of its last block from the next ones.
 * thread: that of the job; any for reading. */
#ifndef NET_DEAL_H
#define NET_DEAL_H

#include "core/base/team.h"

struct deal {
    int size, rank;
    int token[TEAM_MAX + 1]; // of all views, the first one of each rank; then their number
    int block[TEAM_MAX + 1]; // the first that begins among these tokens; then their number
};

struct deal deal_of(const struct team *t, int n_views, int view_tokens);

/* Tokens of this rank, and those that it borrows, which follow them. */
int deal_own(const struct deal *d);
int deal_borrowed(const struct deal *d);

/* Fetch what this rank borrows, and lend. x: rows of `row` bytes, its own, then room for the
 * borrowed ones; collective.
 * err:  those of team_exchange. */
MUST_USE err_t deal_borrow(const struct deal *d, struct team *t, void *x, size_t row);

#endif
