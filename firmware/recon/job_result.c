#include "firmware/recon/job_result.h"

#include "firmware/base/engine.h"

#include "core/photo/response.h"

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

err_t job_result_curve(const struct run *r, struct job_result *out)
{
    if (!out->views.srgb)
        return response_run(r, &out->views, &out->response);
    response_srgb(out->views.mid_log2t, &out->response);
    return OK;
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

/* Whether refinement left out pixel (x, y) of photograph i. */
static bool is_left_out(const struct refine_left_out *l, int i, int x, int y)
{
    return l->cell &&
           l->cell[((size_t)i * (size_t)l->across + (size_t)(y / l->px)) * (size_t)l->across +
                   (size_t)(x / l->px)];
}

struct job_left_out job_result_left_out(const struct job_result *j, int i, uint8_t *map)
{
    const struct extent *px = &j->views.extent[i];
    const size_t n = extent_pixels(px);
    size_t masked = 0, moved = 0;
    for (size_t k = 0; k < n; k++) {
        const bool hidden = views_hides(&j->views, i, k);
        const bool left_out =
            !hidden &&
            is_left_out(&j->refine.left_out, i, (int)(k % (size_t)px->w), (int)(k / (size_t)px->w));
        masked += hidden;
        moved += left_out;
        if (map)
            map[k] = hidden || left_out;
    }
    return (struct job_left_out){(double)masked / (double)n, (double)moved / (double)n};
}
