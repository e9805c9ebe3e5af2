#include "firmware/recon/job_result.h"

#include "firmware/base/engine.h"

#include <stdarg.h>
#include <stdio.h>

void job_result_lap(struct job_result *j, enum job_stage stage)
{
    double now = engine_seconds();
    j->seconds[stage] += now - j->lap_s;
    j->lap_s = now;
    j->sent[stage] += j->team ? j->team->sent - j->lap_sent : 0;
    j->lap_sent = j->team ? j->team->sent : 0;
    j->peak_rss_mb = engine_peak_rss_mb();
}

struct prep_size job_result_size(const struct scene *s)
{
    struct prep_size out = {s->size, true};
    for (int i = 0; i < s->n_views; i++)
        out.square = out.square && s->cams[i].w == s->size && s->cams[i].h == s->size;
    return out;
}

void job_result_warn(struct job_result *j, const char *fmt, ...)
{
    if (j->n_warnings == JOB_WARNINGS)
        return;
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(j->warnings[j->n_warnings++], sizeof j->warnings[0], fmt, ap);
    va_end(ap);
}
