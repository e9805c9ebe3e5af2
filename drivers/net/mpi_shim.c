/* Transfers wait in a ring; the thread starts them in the order in which they were begun, which is
 * the same on all ranks, and completes them in that order.
 * A machine whose cable or current is gone says nothing, and MPI would wait for it. So the thread
 * of rank 0 and those of the others exchange a byte every BEAT_S, whatever their programs do; the
 * last one says goodbye. */
#include "drivers/net/mpi_shim.h"

#include <errno.h>
#include <limits.h>
#include <mpi.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

enum { RING = TEAM_PENDING + 1 };
enum { LOOK_LEAST_NS = 20000, LOOK_MOST_NS = 200000 }; // between two looks at a transfer
enum { CANCEL_NS = 200000000 };                        // between two looks at the cancel flag

enum { BEAT_S = 2, SILENT_S = 30, IDLE_NS = 500000000 }; // IDLE_NS: looks without transfers
enum { BEATS, GOODBYE };                                 // what a byte says

/* Bytes to and from one other rank. */
struct peer {
    MPI_Request send, receive;
    char out, in;
    int64_t sent_ns, heard_ns;
    bool left; // it has said goodbye
};

struct transfer {
    const char *out; // NULL: a gather in place
    char *in;
    int out_n[TEAM_MAX], out_at[TEAM_MAX], in_n[TEAM_MAX], in_at[TEAM_MAX];
    MPI_Request request;
};

enum phase { STARTING, RUNNING, FAILED };

static struct {
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t work, done;
    enum phase phase;
    bool quit, aborts;
    const atomic_bool *cancel;
    int rank, size;
    struct transfer ring[RING];
    unsigned begun, started, complete, waited; // transfers so far
    MPI_Comm beats;
    struct peer peer[TEAM_MAX]; // of rank 0: all others; of others: rank 0
    char text[256];
} team = {.lock = PTHREAD_MUTEX_INITIALIZER};

/* ---- the thread that calls MPI ---- */

static void fail_team(const char *text)
{
    pthread_mutex_lock(&team.lock);
    snprintf(team.text, sizeof team.text, "%s", text);
    team.phase = FAILED;
    pthread_cond_broadcast(&team.done);
    pthread_mutex_unlock(&team.lock);
}

static void fail_mpi(const char *what, int code)
{
    char reason[MPI_MAX_ERROR_STRING] = "", text[sizeof team.text];
    int n;
    MPI_Error_string(code, reason, &n);
    snprintf(text, sizeof text, "MPI: %s: %.160s", what, reason);
    fail_team(text);
}

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static bool has_peer(int rank)
{
    return rank != team.rank && (rank == 0 || team.rank == 0);
}

static int listen_to(int rank)
{
    struct peer *p = &team.peer[rank];
    return MPI_Irecv(&p->in, 1, MPI_BYTE, rank, 0, team.beats, &p->receive);
}

static int open_beats(void)
{
    int code = MPI_Comm_dup(MPI_COMM_WORLD, &team.beats);
    if (code == MPI_SUCCESS)
        code = MPI_Comm_set_errhandler(team.beats, MPI_ERRORS_RETURN);
    for (int i = 0; i < team.size && code == MPI_SUCCESS; i++) {
        team.peer[i] = (struct peer){.send = MPI_REQUEST_NULL, .heard_ns = now_ns()};
        if (has_peer(i))
            code = listen_to(i);
    }
    return code;
}

/* Send to a rank when it is time, and hear it. */
static int beat_with(int rank, char says, int64_t now)
{
    struct peer *p = &team.peer[rank];
    int over, code = MPI_Test(&p->send, &over, MPI_STATUS_IGNORE);
    if (code == MPI_SUCCESS && over && p->out != GOODBYE &&
        (says == GOODBYE || now - p->sent_ns >= (int64_t)BEAT_S * 1000000000)) {
        p->out = says;
        p->sent_ns = now;
        code = MPI_Isend(&p->out, 1, MPI_BYTE, rank, 0, team.beats, &p->send);
    }
    if (code != MPI_SUCCESS || p->left)
        return code;
    code = MPI_Test(&p->receive, &over, MPI_STATUS_IGNORE);
    if (code != MPI_SUCCESS || !over)
        return code;
    p->heard_ns = now;
    p->left = p->in == GOODBYE;
    return p->left ? code : listen_to(rank);
}

static void fail_silent(int rank)
{
    char text[sizeof team.text];
    snprintf(text, sizeof text, "rank %d has said nothing for %d s", rank, SILENT_S);
    fail_team(text);
}

/* False if a rank is gone. */
static bool beat(char says)
{
    const int64_t now = now_ns();
    for (int i = 0; i < team.size; i++) {
        if (!has_peer(i))
            continue;
        const int code = beat_with(i, says, now);
        if (code != MPI_SUCCESS)
            fail_mpi("a rank is gone", code);
        else if (!team.peer[i].left && now - team.peer[i].heard_ns > (int64_t)SILENT_S * 1000000000)
            fail_silent(i);
        if (team.phase == FAILED)
            return false;
    }
    return true;
}

/* Until all have heard the last of each other; what a rank leaves unheard would be an error. */
static bool say_goodbye(void)
{
    const struct timespec pause = {0, LOOK_MOST_NS};
    bool all = false;
    while (!all) {
        if (!beat(GOODBYE))
            return false;
        all = true;
        for (int i = 0; i < team.size; i++)
            all = all && (!has_peer(i) || (team.peer[i].left && team.peer[i].out == GOODBYE &&
                                           team.peer[i].send == MPI_REQUEST_NULL));
        nanosleep(&pause, NULL);
    }
    return true;
}

static bool start_mpi(void)
{
    int level;
    int code = MPI_Init_thread(NULL, NULL, MPI_THREAD_SERIALIZED, &level);
    if (code == MPI_SUCCESS)
        code = MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);
    if (code == MPI_SUCCESS)
        code = MPI_Comm_rank(MPI_COMM_WORLD, &team.rank);
    if (code == MPI_SUCCESS)
        code = MPI_Comm_size(MPI_COMM_WORLD, &team.size);
    if (code == MPI_SUCCESS && team.size <= TEAM_MAX)
        code = open_beats();
    if (code != MPI_SUCCESS) {
        fail_mpi("it does not start", code);
        return false;
    }
    pthread_mutex_lock(&team.lock);
    team.phase = RUNNING;
    pthread_cond_broadcast(&team.done);
    pthread_mutex_unlock(&team.lock);
    return true;
}

static bool start_transfer(struct transfer *t)
{
    const int code = t->out ? MPI_Ialltoallv(t->out, t->out_n, t->out_at, MPI_BYTE, t->in, t->in_n,
                                             t->in_at, MPI_BYTE, MPI_COMM_WORLD, &t->request)
                            : MPI_Iallgatherv(MPI_IN_PLACE, 0, MPI_BYTE, t->in, t->in_n, t->in_at,
                                              MPI_BYTE, MPI_COMM_WORLD, &t->request);
    if (code != MPI_SUCCESS)
        fail_mpi("a transfer does not start", code);
    return code == MPI_SUCCESS;
}

static bool look_at_transfer(struct transfer *t, int *over)
{
    const int code = MPI_Test(&t->request, over, MPI_STATUS_IGNORE);
    if (code != MPI_SUCCESS)
        fail_mpi("a rank is gone", code);
    return code == MPI_SUCCESS;
}

/* Start what has begun, and look at the oldest one; returns false when there is nothing more. */
static bool serve_transfers(unsigned begun, bool *advanced)
{
    int over = 0;
    *advanced = false;
    for (; team.started != begun; team.started++) {
        if (!start_transfer(&team.ring[team.started % RING]))
            return false;
        *advanced = true;
    }
    if (team.complete == team.started)
        return true;
    if (!look_at_transfer(&team.ring[team.complete % RING], &over))
        return false;
    if (over) {
        pthread_mutex_lock(&team.lock);
        team.complete++;
        pthread_cond_broadcast(&team.done);
        pthread_mutex_unlock(&team.lock);
        *advanced = true;
    }
    return true;
}

static struct timespec after(int64_t ns)
{
    const int64_t at = now_ns() + ns;
    return (struct timespec){at / 1000000000, at % 1000000000};
}

/* Sleep until there is a transfer, for a while. returns: transfers begun so far. */
static unsigned wait_for_work(bool *quit)
{
    const struct timespec until = after(IDLE_NS);
    pthread_mutex_lock(&team.lock);
    if (team.complete == team.begun && !team.quit)
        pthread_cond_timedwait(&team.work, &team.lock, &until);
    const unsigned begun = team.begun;
    *quit = team.quit;
    pthread_mutex_unlock(&team.lock);
    return begun;
}

static void *call_mpi(void *arg)
{
    struct timespec pause = {0, LOOK_LEAST_NS};
    bool on = start_mpi() && team.size <= TEAM_MAX, advanced, quit;
    (void)arg;
    while (on) {
        const unsigned begun = wait_for_work(&quit);
        if (quit)
            break;
        on = beat(BEATS) && serve_transfers(begun, &advanced);
        if (!on || team.complete == team.started)
            continue;
        if (advanced)
            pause.tv_nsec = LOOK_LEAST_NS;
        else if (nanosleep(&pause, NULL) == 0 && pause.tv_nsec < LOOK_MOST_NS)
            pause.tv_nsec += pause.tv_nsec / 2;
    }
    if (on && !team.aborts && say_goodbye())
        MPI_Finalize();
    return NULL;
}

/* ---- the caller ---- */

static err_t refuse(err_t e, const char *text)
{
    snprintf(team.text, sizeof team.text, "%s", text);
    return e;
}

static const char *last_text(void)
{
    return team.text;
}

/* Until `ready` by the lock's owner, a failure or a cancel. */
static err_t wait_for(bool (*ready)(void))
{
    err_t e = OK;
    pthread_mutex_lock(&team.lock);
    while (!e && team.phase != FAILED && !ready()) {
        const struct timespec until = after(CANCEL_NS);
        pthread_cond_timedwait(&team.done, &team.lock, &until);
        if (team.cancel && atomic_load(team.cancel))
            e = refuse(ERR_CANCELLED, "ranks: cancelled");
    }
    if (!e && team.phase == FAILED)
        e = ERR_LOST;
    pthread_mutex_unlock(&team.lock);
    return e;
}

static bool is_running(void)
{
    return team.phase == RUNNING;
}

static bool is_complete(void)
{
    return team.complete != team.waited;
}

static err_t open_team(const atomic_bool *cancel, int *rank, int *size)
{
    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(&team.work, &monotonic);
    pthread_cond_init(&team.done, &monotonic);
    team.cancel = cancel;
    if (pthread_create(&team.thread, NULL, call_mpi, NULL) != 0)
        return refuse(ERR_LIMIT, "MPI: the system refused a thread");
    err_t e = wait_for(is_running);
    if (e)
        return e;
    *rank = team.rank;
    *size = team.size;
    return team.size <= TEAM_MAX ? OK : refuse(ERR_LIMIT, "MPI: there are too many ranks");
}

/* Bytes from at[0] on; MPI counts in int. */
static bool set_counts(const size_t *at, int n[TEAM_MAX], int first[TEAM_MAX])
{
    if (!at || at[team.size] > INT_MAX)
        return false;
    for (int i = 0; i < team.size; i++) {
        first[i] = (int)at[i];
        n[i] = (int)(at[i + 1] - at[i]);
    }
    return true;
}

static err_t begin_transfer(const void *out, const size_t *out_at, void *in, const size_t *in_at)
{
    pthread_mutex_lock(&team.lock);
    struct transfer *t = &team.ring[team.begun % RING];
    const bool room = team.begun - team.waited < TEAM_PENDING;
    pthread_mutex_unlock(&team.lock);
    if (!room)
        return refuse(ERR_LIMIT, "ranks: too many transfers at a time");
    t->out = out;
    t->in = in;
    if (!set_counts(in_at, t->in_n, t->in_at) || (out && !set_counts(out_at, t->out_n, t->out_at)))
        return refuse(ERR_LIMIT, "ranks: a transfer of more than 2147483647 bytes");
    pthread_mutex_lock(&team.lock);
    team.begun++;
    pthread_cond_signal(&team.work);
    pthread_mutex_unlock(&team.lock);
    return OK;
}

static err_t begin_gather(void *ctx, void *data, const size_t *at)
{
    (void)ctx;
    return begin_transfer(NULL, NULL, data, at);
}

static err_t wait_oldest(void *ctx)
{
    (void)ctx;
    err_t e = wait_for(is_complete);
    if (!e)
        team.waited++;
    return e;
}

/* A rank with nothing to send or to receive gives itself a byte: for an empty exchange Open MPI 4.1
 * counts no message number, and all later ones of this rank would miss those of the others. */
static err_t exchange_parts(void *ctx, const void *out, const size_t *out_at, void *in,
                            const size_t *in_at)
{
    static char from, to;
    size_t at[TEAM_MAX + 1] = {0};
    const bool empty = out_at[team.size] == out_at[0] && in_at[team.size] == in_at[0];
    for (int i = team.rank; i < team.size; i++)
        at[i + 1] = 1;
    err_t e = empty ? begin_transfer(&from, at, &to, at) : begin_transfer(out, out_at, in, in_at);
    return e ? e : wait_oldest(ctx);
}

static void stop_thread(bool aborts)
{
    pthread_mutex_lock(&team.lock);
    team.quit = true;
    team.aborts = aborts;
    pthread_cond_signal(&team.work);
    pthread_mutex_unlock(&team.lock);
}

/* The thread may be waiting for ranks that never start. */
static void abort_team(int code)
{
    struct timespec until;
    stop_thread(true);
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec += 1;
    pthread_timedjoin_np(team.thread, NULL, &until);
    MPI_Abort(MPI_COMM_WORLD, code);
}

static void close_team(void)
{
    stop_thread(false);
    pthread_join(team.thread, NULL);
}

__attribute__((visibility("default"))) const struct mpi_shim mpi_shim_table = {
    .stamp = MPI_SHIM_STAMP,
    .text = last_text,
    .open = open_team,
    .ops = {.begin = begin_gather, .wait = wait_oldest, .exchange = exchange_parts},
    .abort = abort_team,
    .close = close_team,
};
