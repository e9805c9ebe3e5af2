/* tool.h - another program, run to its end.
 * thread: any. Blocks. */
#ifndef BASE_TOOL_H
#define BASE_TOOL_H

#include "core/base/err.h"

/* argv[0] is found in PATH. Others may read the arguments: they must have no secrets.
 * err:  ERR_IO with the last line that it wrote (ERR_LOST: there is no such program), ERR_TIMEOUT
 *       (ended after a minute) */
MUST_USE err_t tool_run(char *const argv[]);

#endif
