#include "firmware/base/teamwork.h"

#include "core/base/cpu.h"
#include "core/base/log.h"
#include "core/base/num.h"

#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

/* What must be the same on all ranks, else their bytes would differ. */
struct sameness {
    char program[SHA256_HEX_CAP], instructions[CPU_NAMES_CAP];
};

enum { SPEED_TRIES = 5, SPEED_CHUNKS = 64 };
enum { SPEED_FLOATS = 4096, SPEED_ROUNDS = 40 };

/* ---- threads ---- */

static int count_neighbours(const struct ranks *r)
{
    int n = 0;
    for (int i = 0; i < r->team.size; i++)
        n += strcmp(r->host[i], r->host[r->team.rank]) == 0;
    return n;
}

static int choose_threads(const struct ranks *r)
{
    const int cores = (int)sysconf(_SC_NPROCESSORS_ONLN);
    cpu_set_t mine;
    const int bound = sched_getaffinity(0, sizeof mine, &mine) == 0 ? CPU_COUNT(&mine) : cores;
    return num_max(1, bound < cores ? bound : cores / count_neighbours(r));
}

/* ---- the same program ---- */

static err_t describe_program(const struct engine *en, struct sameness *out)
{
    memset(out, 0, sizeof *out);
    cpu_names(en->cpu, out->instructions);
    return engine_program(out->program);
}

static err_t compare_programs(struct ranks *r, const struct engine *en)
{
    static struct sameness all[TEAM_MAX];
    err_t e = describe_program(en, &all[r->team.rank]);
    if (!e)
        e = team_collect(&r->team, all, sizeof *all);
    for (int i = 1; i < r->team.size && !e; i++) {
        if (strcmp(all[i].program, all[0].program) != 0)
            e = err_fail(ERR_UNSUPPORTED,
                         "rank %d (%s) runs another build of this program than rank 0 (%s); "
                         "install the same package on all machines of one kind",
                         i, r->host[i], r->host[0]);
        else if (strcmp(all[i].instructions, all[0].instructions) != 0)
            e = err_fail(ERR_UNSUPPORTED,
                         "rank %d (%s) has the instructions %s, rank 0 (%s) %s: their results "
                         "differ in the last bits; let all use the same with HDRIG_CPU_MASK",
                         i, r->host[i], all[i].instructions, r->host[0], all[0].instructions);
    }
    return e;
}

/* ---- speed ---- */

/* A chain of products and sums that stays in the cache. */
static err_t spend_time(void *ctx, int chunk, int worker)
{
    float x[SPEED_FLOATS];
    volatile float *sink = ctx;
    (void)worker;
    for (int i = 0; i < SPEED_FLOATS; i++)
        x[i] = (float)(i + chunk);
    for (int k = 0; k < SPEED_ROUNDS; k++)
        for (int i = 0; i < SPEED_FLOATS; i++)
            x[i] = 0.5f * x[i] + 1.0f;
    sink[chunk] = x[chunk];
    return OK;
}

/* Shares by the best of a few tries, in powers of two, so that equal machines have equal ones in
 * every run. */
static err_t measure_shares(struct ranks *r, const struct engine *en)
{
    static float sink[SPEED_CHUNKS];
    double speed[TEAM_MAX] = {0}, most = 0;
    err_t e = OK;
    for (int k = 0; k < SPEED_TRIES && !e; k++) {
        const double from = engine_seconds();
        e = pool_for(en->pool, SPEED_CHUNKS, spend_time, sink);
        speed[r->team.rank] = fmax(speed[r->team.rank], 1 / (engine_seconds() - from + 1e-9));
    }
    if (!e)
        e = team_collect(&r->team, speed, sizeof *speed);
    for (int i = 0; i < r->team.size; i++)
        most = fmax(most, speed[i]);
    for (int i = 0; i < r->team.size && !e; i++) {
        const int halvings = (int)lround(log2(most / fmax(speed[i], 1e-9)));
        r->team.share[i] = TEAM_SHARE_MAX >> num_min(halvings, 3);
    }
    return e;
}

/* ---- */

err_t teamwork_open(struct teamwork *w, const char *command, int threads, struct engine *en)
{
    struct ranks *r = &w->ranks;
    memset(w, 0, sizeof *w);
    memset(en, 0, sizeof *en);
    w->command = command;
    err_t e = ranks_open(r, &engine_cancel);
    if (e || r->team.size == 1)
        return e ? e : engine_open(en, threads);
    if (r->team.rank > 0)
        log_set_level(LOG_ERROR);
    e = engine_open(en, threads > 0 ? threads : choose_threads(r));
    if (e)
        return e;
    en->run.team = &r->team;
    if (r->team.rank > 0)
        en->run.progress = NULL;
    e = compare_programs(r, en);
    return e ? e : measure_shares(r, en);
}

bool teamwork_speaks(const struct teamwork *w)
{
    return w->ranks.team.rank == 0;
}

err_t teamwork_path(struct teamwork *w, const char **path)
{
    static const char *const words[] = {"none", NULL};
    struct team *t = w->ranks.team.size > 1 ? &w->ranks.team : NULL;
    return handout_path(&w->files, t, words, path);
}

/* A failure of all ranks is told by the first, which is why the others wait before they speak. */
static void abort_ranks(struct teamwork *w, err_t e, int code)
{
    const struct ranks *r = &w->ranks;
    if (r->team.rank > 0 && e != ERR_CANCELLED) {
        sleep(1);
        if (!atomic_load(&engine_cancel) && e != ERR_LOST)
            fprintf(stderr, "hdrig %s: rank %d of %d (%s): %s\n", w->command, r->team.rank,
                    r->team.size, r->host[r->team.rank], err_text());
    }
    ranks_abort(&w->ranks, code);
}

void teamwork_close(struct teamwork *w, err_t e, int code)
{
    handout_close(&w->files);
    if (e)
        abort_ranks(w, e, code);
    ranks_close(&w->ranks);
    memset(w, 0, sizeof *w);
}
