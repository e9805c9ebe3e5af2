/* The child's messages come through a pipe, its end through a pidfd. */
#include "firmware/jobs.h"

#include "firmware/cmd.h"
#include "firmware/places.h"

#include "core/base/log.h"
#include "drivers/file.h"
#include "drivers/origin.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/pidfd.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

extern char **environ;

enum { NICE = 10, GRACE_MS = 5000, INTERRUPTED = 130, JOBS_LINE = 512 };

static const char suffix[] = ".pending", pending[] = ORIGIN_COMMENT "\n";

/* What a child is told. */
struct order {
    char in[PLACES_MAX][FILE_PATH_CAP], out[FILE_PATH_CAP];
    char *argv[2 * PLACES_MAX + 8];
};

struct jobs {
    char program[FILE_PATH_CAP], captures[FILE_PATH_CAP], results[FILE_PATH_CAP];
    char config[FILE_PATH_CAP]; // "" for none
    int n;
    char queue[JOBS_MAX][STORE_ID_CAP]; // [0] is the running one
    pid_t pid;                          // 0: none runs
    int pidfd, pipe;
    bool cancelled;
    int warnings;         // of the running one
    char part[JOBS_LINE]; // of a line
    size_t n_part;
    struct jobs_state state;
    struct order order;
};

static err_t pending_path(const struct jobs *j, const char *id, char path[FILE_PATH_CAP])
{
    char name[STORE_ID_CAP + sizeof suffix];
    snprintf(name, sizeof name, "%s%s", id, suffix);
    return file_join(j->results, name, path);
}

/* A file of that name that somebody else put there is no job, and stays. */
static bool is_pending(const struct jobs *j, const char *id)
{
    char path[FILE_PATH_CAP];
    struct file_map m;
    if (pending_path(j, id, path) != OK || file_map(path, sizeof pending, &m) != OK)
        return false;
    bool ours = m.n == sizeof pending - 1 && memcmp(m.p, pending, m.n) == 0;
    file_unmap(&m);
    return ours;
}

static int by_name(const void *a, const void *b)
{
    return strcmp(a, b);
}

static err_t find_pending(struct jobs *j)
{
    DIR *d = opendir(j->results);
    if (!d)
        return err_fail(ERR_IO, "results.path %s: %s", j->results, strerror(errno));
    for (struct dirent *f; (f = readdir(d)) && j->n < JOBS_MAX;) {
        size_t n = strlen(f->d_name), tail = sizeof suffix - 1;
        char id[STORE_ID_CAP];
        if (n <= tail || n - tail >= STORE_ID_CAP || strcmp(f->d_name + n - tail, suffix) != 0)
            continue;
        snprintf(id, sizeof id, "%.*s", (int)(n - tail), f->d_name);
        if (is_pending(j, id))
            memcpy(j->queue[j->n++], id, sizeof id);
    }
    closedir(d);
    qsort(j->queue, (size_t)j->n, sizeof j->queue[0], by_name);
    return OK;
}

static err_t copy_path(const char *key, const char *path, char out[FILE_PATH_CAP])
{
    if (strlen(path) >= FILE_PATH_CAP)
        return err_fail(ERR_ARG, "%s: longer than %d bytes", key, FILE_PATH_CAP - 1);
    strcpy(out, path);
    return OK;
}

static err_t make_folder(const char *path)
{
    return mkdir(path, 0755) == 0 || errno == EEXIST
               ? OK
               : err_fail(ERR_IO, "results.path %s: %s", path, strerror(errno));
}

err_t jobs_open(const struct jobs_config *cfg, struct jobs **out)
{
    struct jobs *j = calloc(1, sizeof *j);
    *out = NULL;
    if (!j)
        return err_fail(ERR_NOMEM, "jobs: no memory");
    j->pidfd = j->pipe = -1;
    err_t e = copy_path("program", cfg->program, j->program);
    if (!e)
        e = copy_path("store.path", cfg->captures, j->captures);
    if (!e)
        e = copy_path("results.path", cfg->results, j->results);
    if (!e && cfg->config)
        e = copy_path("--config", cfg->config, j->config);
    if (!e)
        e = make_folder(j->results);
    if (!e)
        e = find_pending(j);
    if (e) {
        free(j);
        return e;
    }
    *out = j;
    return OK;
}

/* It waits from place `from` of the queue on. */
static bool waits(const struct jobs *j, int from, const char *id)
{
    for (int i = from; i < j->n; i++)
        if (strcmp(j->queue[i], id) == 0)
            return true;
    return false;
}

err_t jobs_add(struct jobs *j, const char *id)
{
    char path[FILE_PATH_CAP];
    FILE *f;
    if (waits(j, j->pid != 0, id))
        return OK;
    if (j->n == JOBS_MAX)
        return err_fail(ERR_LIMIT, "%s: %d reconstructions wait already", id, JOBS_MAX);
    err_t e = pending_path(j, id, path);
    if (!e && file_exists(path) && !is_pending(j, id))
        e = err_fail(ERR_ARG, "%s: is there already and was not written by hdrig", path);
    if (!e)
        e = file_create(path, &f);
    if (!e && fputs(pending, f) >= 0) // file_finish asks whether it worked
        e = file_finish(f, path);
    if (!e)
        e = file_sync(j->results); // a power cut leaves the job of a session that has ended
    if (e)
        return e;
    snprintf(j->queue[j->n++], STORE_ID_CAP, "%s", id);
    j->state.changed = true;
    return OK;
}

static void say(struct jobs *j, const char *text)
{
    snprintf(j->state.line, sizeof j->state.line, "%.*s", JOBS_TEXT - 1, text);
    j->state.changed = true;
}

/* The first of the queue is over; its result, if any, is in its folder. */
static void end(struct jobs *j, enum jobs_end how)
{
    char path[FILE_PATH_CAP];
    if (!waits(j, 1, j->queue[0]) && is_pending(j, j->queue[0]) &&
        pending_path(j, j->queue[0], path) == OK)
        unlink(path);
    j->state.last = how;
    snprintf(j->state.last_id, sizeof j->state.last_id, "%s", j->queue[0]);
    snprintf(j->state.last_line, sizeof j->state.last_line, "%s", j->state.line);
    j->state.last_warnings = j->warnings;
    if (how == JOBS_FAILED)
        log_warn("%s: no scene: %s", j->queue[0], j->state.line);
    else
        log_info("%s: reconstruction %s, %d warning%s", j->queue[0],
                 how == JOBS_DONE ? "done" : "cancelled", j->warnings, j->warnings == 1 ? "" : "s");
    j->n--;
    memmove(j->queue[0], j->queue[1], (size_t)j->n * sizeof j->queue[0]);
    j->cancelled = false;
    j->state.changed = true;
}

static err_t spawn(struct jobs *j, char *const argv[], int out)
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
        return err_fail(ERR_NOMEM, "jobs: no memory");
    if (posix_spawnattr_init(&attr) != 0) {
        posix_spawn_file_actions_destroy(&files);
        return err_fail(ERR_NOMEM, "jobs: no memory");
    }
    posix_spawnattr_setflags(&attr, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    posix_spawnattr_setsigmask(&attr, &none);
    posix_spawnattr_setsigdefault(&attr, &defaults);
    int why = posix_spawn_file_actions_addopen(&files, 0, "/dev/null", O_RDONLY, 0);
    if (!why)
        why = posix_spawn_file_actions_addopen(&files, 1, "/dev/null", O_WRONLY, 0);
    if (!why)
        why = posix_spawn_file_actions_adddup2(&files, out, 2);
    if (!why)
        why = posix_spawn(&j->pid, argv[0], &files, &attr, argv, environ);
    posix_spawnattr_destroy(&attr);
    posix_spawn_file_actions_destroy(&files);
    if (!why)
        return OK;
    j->pid = 0;
    return err_fail(ERR_IO, "%s: %s", argv[0], strerror(why));
}

/* The takes of the session of that name, else the take of that name. */
static err_t make_order(struct jobs *j)
{
    static char images[] = "--images", out[] = "--out", config[] = "--config";
    static char reconstruct[] = "reconstruct";
    struct order *o = &j->order;
    struct places p;
    char **arg = o->argv;
    err_t e = places_of(j->captures, j->queue[0], &p);
    if (!e && p.n == 0)
        memcpy(p.take[p.n++], j->queue[0], sizeof p.take[0]);
    *arg++ = j->program;
    *arg++ = reconstruct;
    for (int i = 0; i < p.n && !e; i++) {
        e = file_join(j->captures, p.take[i], o->in[i]);
        *arg++ = images;
        *arg++ = o->in[i];
    }
    if (!e)
        e = file_join(j->results, j->queue[0], o->out);
    *arg++ = out;
    *arg++ = o->out;
    *arg++ = j->config[0] ? config : NULL;
    *arg++ = j->config;
    *arg = NULL;
    return e;
}

static err_t start(struct jobs *j)
{
    int ends[2];
    err_t e = make_order(j);
    if (e)
        return e;
    if (pipe2(ends, O_CLOEXEC | O_NONBLOCK) != 0)
        return err_fail(ERR_IO, "jobs: %s", strerror(errno));
    fcntl(ends[1], F_SETFL, 0); // the child may wait
    e = spawn(j, j->order.argv, ends[1]);
    close(ends[1]);
    if (e) {
        close(ends[0]);
        return e;
    }
    setpriority(PRIO_PROCESS, (id_t)j->pid, NICE); // cameras come first
    j->pipe = ends[0];
    j->pidfd = pidfd_open(j->pid, 0);
    if (j->pidfd < 0) {
        e = err_fail(ERR_IO, "jobs: process %d cannot be watched: %s", (int)j->pid,
                     strerror(errno));
        kill(j->pid, SIGKILL);
        waitpid(j->pid, NULL, 0);
        close(j->pipe);
        j->pid = 0;
        j->pipe = -1;
        return e;
    }
    j->n_part = 0;
    j->warnings = 0;
    say(j, "");
    return OK;
}

static void hear(struct jobs *j, char c)
{
    if (c != '\n' && c != '\r') {
        if (j->n_part + 1 < sizeof j->part)
            j->part[j->n_part++] = c;
        return;
    }
    j->part[j->n_part] = 0;
    const char *warning = strstr(j->part, ": " CMD_WARNING);
    if (warning) {
        log_warn("%s%s", j->queue[0], warning);
        j->warnings++;
    } else if (j->n_part) {
        say(j, j->part);
    }
    j->n_part = 0;
}

/* Lines of the child; the last one is kept. A pipe at its end would wake poll for ever. */
static void listen_to(struct jobs *j)
{
    char text[1024];
    ssize_t n = 1;
    while (j->pipe >= 0 && (n > 0 || (n < 0 && errno == EINTR))) {
        n = read(j->pipe, text, sizeof text);
        for (ssize_t i = 0; i < n; i++)
            hear(j, text[i]);
    }
    if (n == 0) {
        close(j->pipe);
        j->pipe = -1;
    }
}

static void reap(struct jobs *j)
{
    int status;
    if (waitpid(j->pid, &status, WNOHANG) != j->pid)
        return;
    listen_to(j);
    if (j->pipe >= 0) // a grandchild may hold the other end
        close(j->pipe);
    close(j->pidfd);
    j->pid = 0;
    j->pipe = j->pidfd = -1;
    if (WIFEXITED(status) && WEXITSTATUS(status) == 0)
        end(j, JOBS_DONE);
    else if (j->cancelled || (WIFEXITED(status) && WEXITSTATUS(status) == INTERRUPTED))
        end(j, JOBS_CANCELLED);
    else {
        char text[64];
        if (WIFSIGNALED(status)) {
            snprintf(text, sizeof text, "killed by signal %d", WTERMSIG(status));
            say(j, text);
        }
        end(j, JOBS_FAILED);
    }
}

void jobs_step(struct jobs *j)
{
    if (j->pid) {
        listen_to(j);
        reap(j);
    }
    while (!j->pid && j->n > 0) {
        if (start(j) == OK)
            return;
        say(j, err_text());
        end(j, JOBS_FAILED);
    }
}

void jobs_cancel(struct jobs *j)
{
    if (!j->pid)
        return;
    j->cancelled = true;
    kill(j->pid, SIGTERM);
}

void jobs_close(struct jobs *j)
{
    if (!j)
        return;
    if (j->pid) {
        struct pollfd p = {.fd = j->pidfd, .events = POLLIN};
        kill(j->pid, SIGTERM);
        if (poll(&p, 1, GRACE_MS) <= 0)
            kill(j->pid, SIGKILL);
        waitpid(j->pid, NULL, 0);
        if (j->pipe >= 0)
            close(j->pipe);
        close(j->pidfd);
    }
    free(j);
}

int jobs_poll(const struct jobs *j, struct pollfd *fds, int cap)
{
    if (!j->pid || cap < JOBS_FDS)
        return 0;
    fds[0] = (struct pollfd){.fd = j->pidfd, .events = POLLIN};
    fds[1] = (struct pollfd){.fd = j->pipe, .events = POLLIN};
    return j->pipe >= 0 ? 2 : 1;
}

void jobs_look(struct jobs *j, struct jobs_state *out)
{
    j->state.running = j->pid != 0;
    j->state.waiting = j->n - (j->pid != 0);
    snprintf(j->state.id, sizeof j->state.id, "%s", j->pid ? j->queue[0] : "");
    *out = j->state;
    j->state.changed = false;
}
