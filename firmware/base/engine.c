#include "firmware/base/engine.h"

#include "core/base/cpu.h"
#include "drivers/device/clocks.h"
#include "drivers/format/file.h"

#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>

atomic_bool engine_cancel;

err_t engine_open(struct engine *en, int threads)
{
    unsigned mask;
    memset(en, 0, sizeof *en);
    err_t e = cpu_parse_mask(getenv("HDRIG_CPU_MASK"), &mask);
    if (!e)
        e = pool_open(&en->pool, threads);
    if (e)
        return e;
    en->cpu = cpu_detect() & mask;
    kernels_init(&en->kernels, en->cpu);
    progress_init(&en->progress, stderr);
    en->run = (struct run){.clock = engine_seconds,
                           .k = &en->kernels,
                           .pool = en->pool,
                           .keep = &en->keep,
                           .tmp = &en->tmp,
                           .cancel = &engine_cancel,
                           .progress = progress_step,
                           .progress_ctx = &en->progress};
    return OK;
}

err_t engine_reserve(struct engine *en, size_t other, size_t keep, size_t tmp, int max_mb)
{
    size_t sum = arena_add(other, arena_add(keep, tmp));
    if (sum == SIZE_MAX || (double)sum > max_mb * 1e6)
        return err_fail(ERR_LIMIT, "this job needs %.0f MB, --max-memory is %d MB",
                        (double)sum * 1e-6 + 0.5, max_mb);
    err_t e = arena_init(&en->keep, "keep", keep);
    return e ? e : arena_init(&en->tmp, "tmp", tmp);
}

void engine_close(struct engine *en)
{
    progress_end(&en->progress);
    pool_close(en->pool);
    arena_free(&en->keep);
    arena_free(&en->tmp);
    memset(en, 0, sizeof *en);
}

double engine_peak_rss_mb(void)
{
    struct rusage u;
    return getrusage(RUSAGE_SELF, &u) == 0 ? (double)u.ru_maxrss * 1024e-6
                                           : 0.0; // Linux counts in KiB
}

err_t engine_program(char hash[SHA256_HEX_CAP])
{
    struct file_map m;
    struct sha256 sum;
    err_t e = file_map("/proc/self/exe", SIZE_MAX, &m);
    if (e)
        return e;
    sha256_init(&sum);
    sha256_add(&sum, m.p, m.n);
    sha256_hex(&sum, hash);
    file_unmap(&m);
    return OK;
}

double engine_seconds(void)
{
    return (double)clocks_now() * 1e-9;
}

double engine_busy_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
