/* small_job.h - the result of a job that never ran: two views of 16 px and some splats before them,
 * for tests of what happens to results. */
#ifndef UNIT_SMALL_JOB_H
#define UNIT_SMALL_JOB_H

#include "core/base/gaussians.h"
#include "core/kernels/kernels.h"
#include "core/photo/tonemap.h"
#include "firmware/recon/job.h"
#include "firmware/result/draw.h"
#include "tests/unit/squares.h"

#include <stdlib.h>
#include <string.h>

enum { SMALL_SIZE = 16, SMALL_VIEWS = 2 };

struct small_job {
    struct kernels kernels;
    struct arena keep, tmp;
    atomic_bool cancel;
    struct run run;
    struct job_result result;
    char names[SMALL_VIEWS][NAME_CAP];
    float log2t[SMALL_VIEWS], db[SMALL_VIEWS];
    struct camera cams[SMALL_VIEWS];
    uint8_t rgb[SMALL_VIEWS * 3 * SMALL_SIZE * SMALL_SIZE];
};

static inline size_t small_job_room(int n)
{
    return arena_add(arena_add(draw_plan(n, SMALL_SIZE, SMALL_SIZE),
                               draw_confidence_plan(n, SMALL_SIZE, SMALL_SIZE)),
                     arena_need((size_t)SMALL_SIZE * SMALL_SIZE, 1));
}

/* n splats; the struct must not move. */
static inline void small_job_init(struct small_job *s, int n)
{
    struct job_result *j = &s->result;
    memset(s, 0, sizeof *s);
    kernels_init(&s->kernels, 0);
    if (arena_init(&s->keep, "keep", arena_add(gaussians_need(n, 0), arena_need((size_t)n, 4))) !=
            OK ||
        arena_init(&s->tmp, "tmp", small_job_room(n)) != OK ||
        gaussians_init(&j->scene.g, &s->keep, n, 0) != OK ||
        arena_zalloc(&s->keep, (size_t)n, sizeof(float), &j->scene.confidence) != OK)
        abort();
    s->run = (struct run){.k = &s->kernels, .keep = &s->keep, .tmp = &s->tmp, .cancel = &s->cancel};
    for (int i = 0; i < SMALL_VIEWS; i++) {
        s->names[i][0] = (char)('a' + i);
        memcpy(s->names[i] + 1, ".png", 5);
        s->log2t[i] = (float)(2 * i - 1);
        s->cams[i] = (struct camera){SMALL_SIZE, SMALL_SIZE, 16, 16, 8, 8, {1, 0, 0, 0}, {0, 0, 0}};
    }
    memset(s->rgb, 128, sizeof s->rgb);
    s->rgb[sizeof s->rgb / 2]++; // no copy of the first
    struct gaussians *g = &j->scene.g;
    g->n = n;
    for (int i = 0; i < n; i++) {
        g->plane[G_MU][i] = (float)(i % 16) / 8 - 1;
        g->plane[G_MU + 1][i] = (float)(i / 16 % 16) / 8 - 1;
        g->plane[G_MU + 2][i] = 2;
        for (int k = 0; k < 3; k++)
            g->plane[G_LOG_SCALE + k][i] = -2;
        g->plane[G_QUAT][i] = 1;
    }
    tonemap_linear(&j->scene.tone, 1, -10, 10, 0);
    j->views = (struct views){.n = SMALL_VIEWS,
                              .size = SMALL_SIZE,
                              .extent = squares(SMALL_VIEWS, SMALL_SIZE),
                              .names = s->names,
                              .rgb = s->rgb,
                              .log2t = s->log2t,
                              .cams = s->cams};
    j->input_db = s->db;
    j->scene.n_views = SMALL_VIEWS;
    j->scene.size = SMALL_SIZE;
    j->scene.names = s->names;
    j->scene.log2t = s->log2t;
    j->scene.cams = s->cams;
}

static inline void small_job_free(struct small_job *s)
{
    arena_free(&s->keep);
    arena_free(&s->tmp);
}

#endif
