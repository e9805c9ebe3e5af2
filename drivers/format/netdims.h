/* netdims.h - the network's dimensions as JSON: {"embed": 1024, "keep": [4, 11, 17, 23], ...} with
 * the names of struct net_dims; or {"lpips": "vgg16"} or "alexnet", which has no dimensions.
 * thread: any. */
#ifndef FORMAT_NETDIMS_H
#define FORMAT_NETDIMS_H

#include "core/net/table.h"

#include <stdio.h>

struct cJSON;

/* Read the members of an object into *d. Others are ignored; one that is missing is an error if
 * `all`, else it leaves *d as it was; so does `complete` in any case, which older files have not.
 * `what` begins the sentence. Runs table_check.
 * err:  ERR_FORMAT. */
MUST_USE err_t netdims_read(const char *what, const struct cJSON *object, bool all,
                            struct net_dims *d);

/* Write them on one line. */
void netdims_put(FILE *f, const struct net_dims *d);

#endif
