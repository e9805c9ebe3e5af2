#include "firmware/base/tool.h"

#include "firmware/base/child.h"

#include "drivers/device/clocks.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#define LONGEST_NS INT64_C(60000000000)

static void keep_line(void *ctx, const char *line)
{
    snprintf(ctx, CHILD_LINE, "%s", line);
}

static bool is_in_path(const char *name)
{
    char at[1024];
    const char *p = getenv("PATH");
    if (strchr(name, '/') || !p)
        return access(name, X_OK) == 0;
    for (size_t n = 0; *p; p += n + (p[n] == ':')) {
        n = strcspn(p, ":");
        snprintf(at, sizeof at, "%.*s/%s", (int)n, p, name);
        if (access(at, X_OK) == 0)
            return true;
    }
    return false;
}

err_t tool_run(char *const argv[])
{
    struct child c;
    struct pollfd fds[CHILD_FDS];
    char line[CHILD_LINE] = "";
    const int64_t end = clocks_now() + LONGEST_NS;
    int status = 0;
    if (!is_in_path(argv[0]))
        return err_fail(ERR_LOST, "the program %s is not there: install it", argv[0]);
    err_t e = child_start(&c, argv, true);
    if (e)
        return e;
    while (!child_ended(&c, keep_line, line, &status)) {
        if (clocks_now() > end) {
            child_stop(&c);
            return err_fail(ERR_TIMEOUT, "%s: does not end", argv[0]);
        }
        poll(fds, (nfds_t)child_poll(&c, fds, CHILD_FDS), 1000);
        child_listen(&c, keep_line, line);
    }
    if (WIFEXITED(status) && WEXITSTATUS(status) == 0)
        return OK;
    return err_fail(ERR_IO, "%s: %s", argv[0], line[0] ? line : "has failed");
}
