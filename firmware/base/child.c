/* Lines come through a pipe, the end through a pidfd. */
#include "firmware/base/child.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <string.h>
#include <sys/pidfd.h>
#include <sys/wait.h>
#include <unistd.h>

extern char **environ;

enum { GRACE_MS = 5000 };

static err_t spawn_child(struct child *c, char *const argv[], int out, bool all)
{
    posix_spawn_file_actions_t files;
    posix_spawnattr_t attr;
    sigset_t none, defaults;
    sigemptyset(&none);
    sigemptyset(&defaults);
    sigaddset(&defaults, SIGTERM);
    sigaddset(&defaults, SIGINT);
    sigaddset(&defaults, SIGPIPE);
    if (posix_spawn_file_actions_init(&files) != 0)
        return err_fail(ERR_NOMEM, "%s: no memory", argv[0]);
    if (posix_spawnattr_init(&attr) != 0) {
        posix_spawn_file_actions_destroy(&files);
        return err_fail(ERR_NOMEM, "%s: no memory", argv[0]);
    }
    posix_spawnattr_setflags(&attr, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    posix_spawnattr_setsigmask(&attr, &none);
    posix_spawnattr_setsigdefault(&attr, &defaults);
    int why = posix_spawn_file_actions_addopen(&files, 0, "/dev/null", O_RDONLY, 0);
    if (!why)
        why = all ? posix_spawn_file_actions_adddup2(&files, out, 1)
                  : posix_spawn_file_actions_addopen(&files, 1, "/dev/null", O_WRONLY, 0);
    if (!why)
        why = posix_spawn_file_actions_adddup2(&files, out, 2);
    if (!why)
        why = posix_spawnp(&c->pid, argv[0], &files, &attr, argv, environ);
    posix_spawnattr_destroy(&attr);
    posix_spawn_file_actions_destroy(&files);
    if (!why)
        return OK;
    c->pid = 0;
    return err_fail(ERR_IO, "%s: %s", argv[0], strerror(why));
}

static void close_fds(struct child *c)
{
    if (c->pipe >= 0)
        close(c->pipe);
    if (c->pidfd >= 0)
        close(c->pidfd);
    c->pid = 0;
    c->pipe = c->pidfd = -1;
    c->n_part = 0;
}

err_t child_start(struct child *c, char *const argv[], bool all)
{
    int ends[2];
    memset(c, 0, sizeof *c);
    if (pipe2(ends, O_CLOEXEC | O_NONBLOCK) != 0)
        return err_fail(ERR_IO, "%s: %s", argv[0], strerror(errno));
    fcntl(ends[1], F_SETFL, 0); // the child may wait
    err_t e = spawn_child(c, argv, ends[1], all);
    close(ends[1]);
    if (e) {
        close(ends[0]);
        return e;
    }
    c->pipe = ends[0];
    c->pidfd = pidfd_open(c->pid, 0);
    if (c->pidfd >= 0)
        return OK;
    e = err_fail(ERR_IO, "%s: process %d cannot be watched: %s", argv[0], (int)c->pid,
                 strerror(errno));
    kill(c->pid, SIGKILL);
    waitpid(c->pid, NULL, 0);
    close_fds(c);
    return e;
}

int child_poll(const struct child *c, struct pollfd *fds, int cap)
{
    if (!c->pid || cap < CHILD_FDS)
        return 0;
    fds[0] = (struct pollfd){.fd = c->pidfd, .events = POLLIN};
    fds[1] = (struct pollfd){.fd = c->pipe, .events = POLLIN};
    return c->pipe >= 0 ? 2 : 1;
}

static void add_letter(struct child *c, char letter, child_line_fn *fn, void *ctx)
{
    if (letter != '\n' && letter != '\r') {
        if (c->n_part + 1 < sizeof c->part)
            c->part[c->n_part++] = letter;
        return;
    }
    c->part[c->n_part] = 0;
    if (c->n_part)
        fn(ctx, c->part);
    c->n_part = 0;
}

/* A pipe at its end would wake poll for ever. */
void child_listen(struct child *c, child_line_fn *fn, void *ctx)
{
    char text[1024];
    ssize_t n = 1;
    if (!c->pid)
        return;
    while (c->pipe >= 0 && (n > 0 || (n < 0 && errno == EINTR))) {
        n = read(c->pipe, text, sizeof text);
        for (ssize_t i = 0; i < n; i++)
            add_letter(c, text[i], fn, ctx);
    }
    if (n == 0) {
        close(c->pipe);
        c->pipe = -1;
    }
}

bool child_ended(struct child *c, child_line_fn *fn, void *ctx, int *status)
{
    if (!c->pid || waitpid(c->pid, status, WNOHANG) != c->pid)
        return false;
    child_listen(c, fn, ctx);
    close_fds(c); // a grandchild may hold the other end of the pipe
    return true;
}

void child_cancel(const struct child *c)
{
    if (c->pid)
        kill(c->pid, SIGTERM);
}

void child_stop(struct child *c)
{
    if (!c->pid)
        return;
    struct pollfd p = {.fd = c->pidfd, .events = POLLIN};
    kill(c->pid, SIGTERM);
    if (poll(&p, 1, GRACE_MS) <= 0)
        kill(c->pid, SIGKILL);
    waitpid(c->pid, NULL, 0);
    close_fds(c);
}
