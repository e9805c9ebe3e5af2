#include "firmware/recon/rigboard.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/board.h"
#include "drivers/format/apriltags.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const float MARGIN_LEAST = 12;    // levels of 255, contrast of a tag's bits
static const float MARGIN_SHARE = 0.6f;  // of the best exposure, of those that count
static const double EDGE_LEAST = 12;     // px, of a tag
static const double FOCAL_UNSURE = 0.01; // standard error of ln focal length
static const double AGREE_LEAST = 0.8;   // of the corners

/* ---- tags of a take ---- */

struct photograph {
    struct apriltags_tag *tag; // (APRILTAGS_MAX)
    int n;
};

struct search {
    const struct run *r;
    const struct rigcal_take *take;
    struct photograph *photo; // (shots)
};

static err_t find_in(struct photograph *p, const struct image8 *im)
{
    struct apriltags *a = NULL;
    const size_t n = (size_t)im->w * (size_t)im->h;
    uint8_t *grey = malloc(n);
    err_t e = grey ? OK : err_fail(ERR_NOMEM, "no memory for %d x %d px", im->w, im->h);
    for (size_t i = 0; i < n && !e; i++)
        grey[i] = (uint8_t)((im->px[3 * i] + 2 * im->px[3 * i + 1] + im->px[3 * i + 2] + 2) / 4);
    if (!e)
        e = apriltags_open(&a);
    if (!e)
        e = apriltags_find(a, grey, im->w, im->h, p->tag, &p->n);
    apriltags_close(a);
    free(grey);
    return e;
}

static err_t search_photograph(void *ctx, int i, int worker)
{
    const struct search *s = ctx;
    struct photograph *p = &s->photo[i];
    struct image8 im = s->take->capture->shots[i].image;
    (void)worker;
    err_t e = run_check(s->r, "board");
    p->tag = e ? NULL : malloc(APRILTAGS_MAX * sizeof *p->tag);
    if (!e && !p->tag)
        e = err_fail(ERR_NOMEM, "no memory for tags");
    if (!e && s->take->source)
        e = s->take->source->decode(s->take->source->ctx, i, &im);
    if (e)
        return e;
    e = find_in(p, &im);
    if (s->take->source)
        s->take->source->release(&im);
    return e;
}

/* ---- corners ---- */

/* Shortest edge, px. */
static double least_edge(const struct apriltags_tag *t)
{
    double least = INFINITY;
    for (int k = 0; k < 4; k++)
        least = fmin(least, hypot(t->corner[(k + 1) % 4][0] - t->corner[k][0],
                                  t->corner[(k + 1) % 4][1] - t->corner[k][1]));
    return least;
}

static bool is_good(const struct apriltags_tag *t)
{
    return board_has(t->id) && t->margin >= MARGIN_LEAST && least_edge(t) >= EDGE_LEAST;
}

/* Which way a corner moves where the tag shrinks. */
static void inward_of(const double c[4][2], int k, double out[2])
{
    const double *to[2] = {c[(k + 1) % 4], c[(k + 3) % 4]};
    out[0] = out[1] = 0;
    for (int i = 0; i < 2; i++) {
        const double x = to[i][0] - c[k][0], y = to[i][1] - c[k][1], length = hypot(x, y);
        out[0] += x / length;
        out[1] += y / length;
    }
}

/* The tag of a photograph, if it is shown well. */
static const struct apriltags_tag *good_tag(const struct photograph *p, int id)
{
    for (int k = 0; k < p->n; k++)
        if (p->tag[k].id == id && is_good(&p->tag[k]))
            return &p->tag[k];
    return NULL;
}

/* The mean of a tag over the exposures of a place; false if none shows it well. */
static bool mean_tag(const struct photograph *photo, int n, int id, struct apriltags_tag *out)
{
    float best = 0;
    int used = 0;
    for (int i = 0; i < n; i++) {
        const struct apriltags_tag *t = good_tag(&photo[i], id);
        best = fmaxf(best, t ? t->margin : 0);
    }
    for (int i = 0; i < n; i++) {
        const struct apriltags_tag *t = good_tag(&photo[i], id);
        if (!t || t->margin < MARGIN_SHARE * best)
            continue;
        used++;
        for (int c = 0; c < 2 * BOARD_CORNERS; c++)
            out->corner[c / 2][c % 2] +=
                (t->corner[c / 2][c % 2] - out->corner[c / 2][c % 2]) / used;
    }
    return used > 0;
}

static err_t add_tag(struct rigboard *b, const struct apriltags_tag *t, int camera, int take)
{
    if (b->n + BOARD_CORNERS > b->cap) {
        const int cap = 2 * b->cap + 1024;
        struct boardfit_corner *more = realloc(b->corner, (size_t)cap * sizeof *more);
        if (!more)
            return err_fail(ERR_NOMEM, "no memory for %d corners of tags", cap);
        b->corner = more;
        b->cap = cap;
    }
    for (int k = 0; k < BOARD_CORNERS; k++) {
        struct boardfit_corner *c = &b->corner[b->n++];
        *c = (struct boardfit_corner){.camera = camera, .take = take};
        board_corner(t->id, k, c->at);
        memcpy(c->px, t->corner[k], sizeof c->px);
        inward_of(t->corner, k, c->inward);
    }
    return OK;
}

/* A tag that a photograph shows twice, -1: none. */
static int doubled_tag(const struct photograph *p)
{
    for (int k = 1; k < p->n; k++)
        if (p->tag[k].id == p->tag[k - 1].id && is_good(&p->tag[k]) && is_good(&p->tag[k - 1]))
            return p->tag[k].id;
    return -1;
}

static err_t add_place(struct rigboard *b, const struct photograph *photo, int n, int camera,
                       int take)
{
    int tags = 0;
    err_t e = OK;
    for (int id = 0; id < BOARD_IDS && tags < RIGBOARD_CORNERS / BOARD_CORNERS && !e; id++) {
        struct apriltags_tag mean = {.id = id};
        if (!mean_tag(photo, n, id, &mean))
            continue;
        e = add_tag(b, &mean, camera, take);
        tags++;
    }
    b->tags[take] += tags;
    b->most = num_max(b->most, tags);
    return e;
}

/* Tags that say that this is not the board, or not one board. */
static bool is_odd(const struct rigcal_take *t, const struct photograph *photo, int first, int n,
                   struct job_result *notes)
{
    for (int i = first; i < first + n; i++) {
        const int twice = doubled_tag(&photo[i]);
        const char *name = t->capture->shots[i].name;
        for (int k = 0; k < photo[i].n; k++)
            if (!board_has(photo[i].tag[k].id))
                job_result_warn(notes,
                                "%.80s: tag %d in %.64s is not of a board of hdrig rig board, "
                                "which end with %d",
                                t->name, photo[i].tag[k].id, name, BOARD_IDS - 1);
        if (twice < 0)
            continue;
        job_result_warn(notes,
                        "%.80s: tag %d is in %.64s twice: of two boards, what this camera sees is "
                        "left out",
                        t->name, twice, name);
        return true;
    }
    return false;
}

static err_t add_take(struct rigboard *b, int take, const struct rigcal_take *t,
                      const struct photograph *photo, struct job_result *notes)
{
    const struct capture *c = t->capture;
    err_t e = OK;
    for (int i = 0, n, camera = 0; i < c->n && !e; i += n, camera++) {
        for (n = 1; i + n < c->n && c->shots[i + n].again; n++)
            ;
        if (!is_odd(t, photo, i, n, notes))
            e = add_place(b, photo + i, n, camera, take);
    }
    return e;
}

static err_t find_in_take(const struct run *r, const struct rigcal_job *job, int take,
                          struct job_result *notes, struct rigboard *out)
{
    const struct rigcal_take *t = &job->take[take];
    const int n = t->capture->n;
    struct search s = {r, t, calloc((size_t)n, sizeof *s.photo)};
    if (!s.photo)
        return err_fail(ERR_NOMEM, "no memory for tags");
    err_t e = pool_for(r->pool, n, search_photograph, &s);
    if (!e)
        e = add_take(out, take, t, s.photo, notes);
    for (int i = 0; i < n; i++)
        free(s.photo[i].tag);
    free(s.photo);
    if (r->progress)
        r->progress(r->progress_ctx, "board", take + 1, job->n, NULL);
    return e;
}

static const struct shot *shot_of(const struct rigcal_job *job, int camera)
{
    const struct capture *c = job->take[0].capture;
    int i = 0;
    for (int place = -1; i < c->n; i++) {
        place += !c->shots[i].again;
        if (place == camera)
            break;
    }
    return &c->shots[i];
}

/* Which cameras share a lens. */
static void group_lenses(const struct rigcal_job *job, int n, struct rigboard *b)
{
    for (int i = 0; i < n; i++) {
        const struct shot *s = shot_of(job, i);
        int first = 0;
        while (strcmp(shot_of(job, first)->camera_id, s->camera_id) != 0 ||
               shot_of(job, first)->turned != s->turned)
            first++;
        b->lens_of[i] = first < i ? b->lens_of[first] : b->n_lenses++;
        if (first < i)
            continue;
        const bool fisheye = job->cfg->lens == RECIPE_LENS_FISHEYE;
        const double half = (double)job->cfg->fov_deg * NUM_PI / 360;
        b->lens[b->lens_of[i]] = (struct boardcal_lens){
            .w = s->taken_w,
            .h = s->taken_h,
            .focal = half > 0 ? s->taken_w / 2.0 / (fisheye ? half : tan(half)) : s->focal_px,
            .pinhole = job->cfg->lens == RECIPE_LENS_PINHOLE,
            .fisheye = fisheye};
    }
}

err_t rigboard_find(const struct run *r, const struct rigcal_job *job, struct job_result *notes,
                    struct rigboard *out)
{
    err_t e = OK;
    memset(out, 0, sizeof *out);
    group_lenses(job, prep_places(job->take[0].capture), out);
    for (int i = 0; i < job->n && !e; i++)
        e = find_in_take(r, job, i, notes, out);
    for (int i = 0; i < job->n && !e && rigboard_seen(out); i++)
        if (out->tags[i] == 0)
            job_result_warn(notes, "%.80s: no camera sees the board in this take",
                            job->take[i].name);
    return e;
}

void rigboard_free(struct rigboard *b)
{
    free(b->corner);
    memset(b, 0, sizeof *b);
}

/* ---- result ---- */

struct boardcal rigboard_problem(const struct rigcal_job *job, const struct rigboard *b)
{
    return (struct boardcal){prep_places(job->take[0].capture),
                             job->n,
                             b->n_lenses,
                             b->n_used,
                             b->lens_of,
                             b->lens,
                             b->corner};
}

err_t rigboard_solve(const struct run *r, const struct rigcal_job *job, struct rigboard *b,
                     bool *tied)
{
    b->n_used = b->n;
    struct boardcal in = rigboard_problem(job, b);
    err_t e = boardcal_run(r, &in, &b->found);
    b->n_used = in.n;
    *tied = !e && boardcal_tied(&in, &b->found);
    return e;
}

/* Units of the result for one of the board; without a tag's size typical depth becomes 1. */
static double unit_of(const struct rigcal_job *job, const struct rigboard *b, int n)
{
    float depth[BOARDCAL_CAMERAS];
    if (job->tag_mm > 0)
        return job->tag_mm / 1000;
    for (int i = 0; i < n; i++)
        depth[i] = (float)b->found.depth[i];
    return 1 / fmax((double)num_median(depth, (size_t)n), 1e-9);
}

static err_t write_view(const struct rigcal_job *job, const struct rigboard *b, int i, double unit,
                        struct rig_view *out)
{
    const struct shot *s = shot_of(job, i);
    const struct boardcal_result *f = &b->found;
    struct lens lens = f->lens[b->lens_of[i]];
    double q[4];
    memcpy(out->name, s->name, sizeof out->name);
    memcpy(out->camera, s->camera_id, sizeof out->camera);
    rotation_to_quat(f->pose[i], q);
    for (int k = 0; k < 4; k++)
        out->cam.q[k] = (float)q[k];
    for (int k = 0; k < 3; k++)
        out->cam.t[k] = (float)(f->pose[i][9 + k] * unit);
    out->cam.w = s->taken_w;
    out->cam.h = s->taken_h;
    cameras_set_covariance(f->covariance[i], unit, f->depth[i] * unit, out);
    return cameras_set_lens("rig", s->name, &lens, out);
}

static void note_lenses(const struct rigcal_job *job, const struct rigboard *b, int n,
                        struct job_result *notes)
{
    notes->n_found = b->n_lenses;
    for (int i = n - 1; i >= 0; i--) {
        const struct shot *s = shot_of(job, i);
        struct job_lens *to = &notes->found[b->lens_of[i]];
        const int photographs = to->photographs;
        *to = (struct job_lens){.photographs = photographs + 1,
                                .edge = num_max(s->taken_w, s->taken_h),
                                .lens = b->found.lens[b->lens_of[i]]};
        memcpy(to->camera_id, s->camera_id, sizeof to->camera_id);
        memcpy(to->selfcal.deviation, b->found.lens_sd[b->lens_of[i]],
               sizeof to->selfcal.deviation);
    }
}

/* What the takes lack. */
static void warn_weak(const struct rigboard *b, struct job_result *notes)
{
    for (int i = 0; i < b->n_lenses; i++)
        if (b->found.lens_sd[i][0] > FOCAL_UNSURE)
            job_result_warn(notes,
                            "%.64s: the focal length is known within %.1f %% only: hold the board "
                            "tilted, and nearer, in more takes",
                            notes->found[i].camera_id, 100 * b->found.lens_sd[i][0]);
    if (b->found.used < AGREE_LEAST * b->n)
        job_result_warn(notes,
                        "of %d corners of tags %d agree: the board is bent, moved while it was "
                        "photographed, or there are two",
                        b->n, b->found.used);
}

err_t rigboard_write(const struct rigcal_job *job, const struct rigboard *b,
                     struct rigcal_result *out)
{
    const int n = prep_places(job->take[0].capture);
    const double unit = unit_of(job, b, n);
    out->rig.views = calloc((size_t)n, sizeof *out->rig.views);
    err_t e = out->rig.views ? OK : err_fail(ERR_NOMEM, "no memory for the rig");
    for (int i = 0; i < n && !e; i++)
        e = write_view(job, b, i, unit, &out->rig.views[out->rig.n++]);
    note_lenses(job, b, n, out->notes);
    warn_weak(b, out->notes);
    out->rig.metres = job->tag_mm > 0;
    out->board = true;
    out->rms_px = (float)b->found.rms_px;
    out->inliers = b->found.used;
    out->observations = b->n;
    return e;
}

/* Centre of a camera as the board has it, units of the board. */
static void centre_on_board(const struct rigboard *b, int camera, double out[3])
{
    const double *pose = b->found.pose[camera];
    lin_apply_t(pose, pose + 9, out);
    for (int k = 0; k < 3; k++)
        out[k] = -out[k];
}

static double distance(const double a[3], const double b[3])
{
    const double d[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
    return sqrt(lin_dot(d, d));
}

double rigboard_metres(const struct rigcal_job *job, const struct rigboard *b,
                       const struct rig *rig)
{
    float ratio[BOARDCAL_CAMERAS * BOARDCAL_CAMERAS / 2];
    size_t n = 0;
    for (int i = 0; i < rig->n; i++)
        for (int k = 0; k < i; k++) {
            double now[2][3], board[2][3];
            if (b->found.part[i] != b->found.main_part || b->found.part[k] != b->found.main_part)
                continue;
            rotation_centre(&rig->views[i].cam, now[0]);
            rotation_centre(&rig->views[k].cam, now[1]);
            centre_on_board(b, i, board[0]);
            centre_on_board(b, k, board[1]);
            if (distance(now[0], now[1]) > 0)
                ratio[n++] = (float)(distance(board[0], board[1]) / distance(now[0], now[1]));
        }
    return (double)num_median(ratio, n) * job->tag_mm / 1000;
}

err_t rigboard_untied(const struct rigcal_job *job, const struct rigboard *b)
{
    const int n = prep_places(job->take[0].capture);
    int a = 0, other = 0;
    while (a + 1 < n && b->found.part[a] != b->found.main_part)
        a++;
    while (other + 1 < n && b->found.part[other] == b->found.main_part)
        other++;
    return err_fail(ERR_ARG,
                    "nothing ties the camera of %s to that of %s%s: add takes in which both see at "
                    "least two tags of the board at the same press, or cameras between them do",
                    shot_of(job, other)->name, shot_of(job, a)->name,
                    b->found.part[other] < 0 ? ", it sees no board" : "");
}

void rigboard_plan(struct plan *p, const struct rigcal_job *job, const struct match_tracks *most)
{
    const int n = prep_places(job->take[0].capture);
    arena_step(&p->tmp,
               boardcal_plan(n, job->n, n * job->n * RIGBOARD_CORNERS, most->n_tracks, most->n));
}
