/* The first of the queue is a child process (firmware/base/child.h). */
#include "firmware/daemon/jobs.h"

#include "firmware/base/child.h"
#include "firmware/base/config.h"
#include "firmware/cmd/cmd.h"
#include "firmware/result/resume.h"
#include "firmware/store/places.h"

#include "core/base/log.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/format/origin.h"

#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

enum { NICE = 10, INTERRUPTED = 130, LAUNCHER_WORDS = 32 };

static const char suffix[] = ".pending", pending[] = ORIGIN_COMMENT "\n";

/* Arguments of a child. */
struct order {
    char in[PLACES_MAX][FILE_PATH_CAP], out[FILE_PATH_CAP];
    char launcher[CONFIG_TEXT]; // its words end with 0
    char *argv[2 * PLACES_MAX + 9 + LAUNCHER_WORDS];
};

struct jobs {
    char program[FILE_PATH_CAP], captures[FILE_PATH_CAP], results[FILE_PATH_CAP];
    char config[FILE_PATH_CAP]; // "" for none
    char launcher[CONFIG_TEXT]; // "" for none
    int n;
    char queue[JOBS_MAX][STORE_ID_CAP]; // [0] is the running one
    struct child child;
    bool cancelled, resumed; // the running job
    int warnings;            // so far, in the running job
    struct jobs_state state;
    struct order order;
};

static err_t pending_path(const struct jobs *j, const char *id, char path[FILE_PATH_CAP])
{
    char name[STORE_ID_CAP + sizeof suffix];
    snprintf(name, sizeof name, "%s%s", id, suffix);
    return file_join(j->results, name, path);
}

/* A file of that name without our mark is not a job, and stays. */
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

/* Puts the words of `launcher` into argv, at most LAUNCHER_WORDS. returns: behind the last. */
static char **put_launcher(char *launcher, char **argv)
{
    char *save, *word = strtok_r(launcher, " ", &save);
    for (int i = 0; word && i < LAUNCHER_WORDS; i++, word = strtok_r(NULL, " ", &save))
        *argv++ = word;
    return argv;
}

static err_t check_launcher(const char *launcher, char out[CONFIG_TEXT])
{
    int words = 0;
    for (const char *p = launcher; *p; p++)
        words += *p != ' ' && (p == launcher || p[-1] == ' ');
    if (words > LAUNCHER_WORDS || strlen(launcher) >= CONFIG_TEXT)
        return err_fail(ERR_ARG, "job.launcher has %d words, at most %d", words, LAUNCHER_WORDS);
    memcpy(out, launcher, strlen(launcher) + 1);
    return OK;
}

/* Open MPI 4 and 5 would look for a machine without current after five minutes only. What the user
 * has set stays. */
static void hasten_launcher(void)
{
    static const char *const set[][2] = {{"time", "10"}, {"intvl", "5"}, {"probes", "4"}};
    char name[64];
    for (int i = 0; i < 6; i++) {
        snprintf(name, sizeof name, "%s_MCA_oob_tcp_keepalive_%s", i < 3 ? "OMPI" : "PRTE",
                 set[i % 3][0]);
        setenv(name, set[i % 3][1], 0);
    }
}

err_t jobs_open(const struct jobs_config *cfg, struct jobs **out)
{
    struct jobs *j = calloc(1, sizeof *j);
    *out = NULL;
    if (!j)
        return err_fail(ERR_NOMEM, "jobs: no memory");
    err_t e = copy_path("program", cfg->program, j->program);
    if (!e)
        e = copy_path("store.path", cfg->captures, j->captures);
    if (!e)
        e = copy_path("results.path", cfg->results, j->results);
    if (!e && cfg->config)
        e = copy_path("--config", cfg->config, j->config);
    if (!e && cfg->launcher)
        e = check_launcher(cfg->launcher, j->launcher);
    if (j->launcher[0])
        hasten_launcher();
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

/* It waits from position `from` of the queue on. */
static bool is_queued(const struct jobs *j, int from, const char *id)
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
    if (is_queued(j, j->child.pid != 0, id))
        return OK;
    if (j->n == JOBS_MAX)
        return err_fail(ERR_LIMIT, "%s: already %d reconstructions wait, no more are taken", id,
                        JOBS_MAX);
    err_t e = pending_path(j, id, path);
    if (!e && file_exists(path) && !is_pending(j, id))
        e = err_fail(ERR_ARG, "%s: already exists and was not written by hdrig", path);
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

static void set_line(struct jobs *j, const char *text)
{
    snprintf(j->state.line, sizeof j->state.line, "%.*s", JOBS_TEXT - 1, text);
    j->state.changed = true;
}

/* The first of the queue is over; its result, if any, is in its folder. */
static void end_job(struct jobs *j, enum jobs_end how)
{
    char path[FILE_PATH_CAP];
    if (!is_queued(j, 1, j->queue[0]) && is_pending(j, j->queue[0]) &&
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

/* The takes of the session of that name, else the take of that name. */
static err_t make_order(struct jobs *j)
{
    static char images[] = "--images", out[] = "--out", config[] = "--config";
    static char reconstruct[] = "reconstruct", resume[] = "--resume";
    struct order *o = &j->order;
    struct places p;
    char **arg = o->argv;
    err_t e = places_of(j->captures, j->queue[0], &p);
    if (!e && p.n == 0)
        memcpy(p.take[p.n++], j->queue[0], sizeof p.take[0]);
    memcpy(o->launcher, j->launcher, sizeof o->launcher);
    arg = put_launcher(o->launcher, arg);
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
    j->resumed = resume_has(o->out);
    if (j->resumed)
        *arg++ = resume;
    *arg++ = j->config[0] ? config : NULL;
    *arg++ = j->config;
    *arg = NULL;
    return e;
}

static err_t start_child(struct jobs *j)
{
    err_t e = make_order(j);
    if (!e)
        e = child_start(&j->child, j->order.argv, false);
    if (e)
        return e;
    setpriority(PRIO_PROCESS, (id_t)j->child.pid, NICE); // cameras come first
    j->warnings = 0;
    set_line(j, "");
    return OK;
}

/* A line of the child; the last one is kept. */
static void take_line(void *ctx, const char *line)
{
    struct jobs *j = ctx;
    const char *warning = strstr(line, ": " CMD_WARNING);
    if (warning) {
        log_warn("%s%s", j->queue[0], warning);
        j->warnings++;
    } else {
        set_line(j, line);
    }
}

static void reap_child(struct jobs *j)
{
    int status;
    if (!child_ended(&j->child, take_line, j, &status))
        return;
    if (WIFEXITED(status) && WEXITSTATUS(status) == 0)
        end_job(j, JOBS_DONE);
    else if (j->cancelled || (WIFEXITED(status) && WEXITSTATUS(status) == INTERRUPTED)) {
        resume_forget(j->order.out);
        end_job(j, JOBS_CANCELLED);
    } else if (j->resumed) { // the next step starts it again
        log_warn("%s: begins again, its checkpoint did not help: %s", j->queue[0], j->state.line);
        resume_forget(j->order.out);
    } else {
        char text[64];
        if (WIFSIGNALED(status)) {
            snprintf(text, sizeof text, "killed by signal %d", WTERMSIG(status));
            set_line(j, text);
        }
        end_job(j, JOBS_FAILED);
    }
}

void jobs_step(struct jobs *j)
{
    child_listen(&j->child, take_line, j);
    reap_child(j);
    while (!j->child.pid && j->n > 0) {
        if (start_child(j) == OK)
            return;
        set_line(j, err_text());
        end_job(j, JOBS_FAILED);
    }
}

void jobs_cancel(struct jobs *j)
{
    j->cancelled = j->child.pid != 0;
    child_cancel(&j->child);
}

void jobs_close(struct jobs *j)
{
    if (!j)
        return;
    child_stop(&j->child);
    free(j);
}

int jobs_poll(const struct jobs *j, struct pollfd *fds, int cap)
{
    return child_poll(&j->child, fds, cap);
}

void jobs_look(struct jobs *j, struct jobs_state *out)
{
    j->state.running = j->child.pid != 0;
    j->state.waiting = j->n - (j->child.pid != 0);
    snprintf(j->state.id, sizeof j->state.id, "%s", j->child.pid ? j->queue[0] : "");
    *out = j->state;
    j->state.changed = false;
}

void jobs_write(struct jobs *jobs, FILE *f)
{
    static const char *const ends[] = {"", "done", "failed", "cancelled"};
    struct jobs_state j = {0};
    if (jobs)
        jobs_look(jobs, &j);
    fprintf(f,
            "\"job\": {\"running\": %s, \"id\": \"%s\", \"line\": ", j.running ? "true" : "false",
            j.id);
    json_put_string(f, j.line);
    fprintf(f,
            ", \"waiting\": %d, \"last\": \"%s\", \"last_id\": \"%s\", \"last_line\": ", j.waiting,
            ends[j.last], j.last_id);
    json_put_string(f, j.last_line);
    fprintf(f, ", \"last_warnings\": %d}", j.last_warnings);
}
