#include "firmware/recon/lenses.h"

#include "core/base/num.h"
#include "core/photo/undistort.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { GRID = 17 }; // points across a view where lenses are compared

err_t lenses_layout(struct lenses *l, struct arena *keep, int n_views)
{
    const size_t n = (size_t)n_views;
    err_t e = arena_zalloc(keep, n, sizeof *l->lens, &l->lens);
    if (!e)
        e = arena_zalloc(keep, n, sizeof *l->of, &l->of);
    if (!e)
        e = arena_zalloc(keep, n, sizeof *l->turned, &l->turned);
    if (!e)
        e = arena_zalloc(keep, n, sizeof *l->taken, &l->taken);
    if (!e)
        e = arena_zalloc(keep, n, sizeof *l->pinhole, &l->pinhole);
    return e ? e : arena_zalloc(keep, n, sizeof *l->error_before, &l->error_before);
}

/* ---- which, and what is known ---- */

const struct shot *lenses_shot(const struct capture *c, const char *name)
{
    int i = 0;
    while (i + 1 < c->n && strcmp(c->shots[i].name, name) != 0)
        i++;
    return &c->shots[i];
}

int lenses_count(const struct capture *c)
{
    int n = 0;
    for (int i = 0; i < c->n; i++) {
        int first = 0;
        while (strcmp(c->shots[first].camera_id, c->shots[i].camera_id) != 0)
            first++;
        n += first == i;
    }
    return n;
}

/* Px of the view per px of the photograph: along the width, to which the focal lengths of squeezed
 * views belong, else along the longer edge. */
static double view_scale(const struct shot *s, const struct extent *px)
{
    if (px->w == px->h && s->taken_w > 0)
        return (double)px->w / s->taken_w;
    return (double)num_max(px->w, px->h) / num_max(s->taken_w, s->taken_h);
}

/* Focal length in px of the view; 0: not known. */
static double expected_focal(const struct shot *s, const struct extent *px,
                             const struct job_config *cfg)
{
    const double half = (double)cfg->fov_deg * NUM_PI / 360;
    if (half > 0)
        return px->w / 2.0 / (cfg->lens == RECIPE_LENS_FISHEYE ? half : tan(half));
    if (!(s->focal_px > 0))
        return 0;
    return s->focal_px * view_scale(s, px);
}

/* The lens of views for pictures as large as the photograph where they were squeezed. */
static void note_size(const struct shot *s, const struct extent *px, struct job_lens *out)
{
    out->edge = num_max(px->w, px->h);
    if (px->w != px->h || s->taken_w == s->taken_h)
        return;
    out->edge = num_max(s->taken_w, s->taken_h);
    out->lens.fx /= view_scale(s, px);
    out->lens.fy = out->lens.fx;
}

static struct bundle_lens lens_before(const struct shot *s, const struct extent *px,
                                      const struct job_config *cfg)
{
    const bool fisheye = cfg->lens == RECIPE_LENS_FISHEYE;
    return (struct bundle_lens){.start = {.model = fisheye ? LENS_OPENCV_FISHEYE : LENS_PINHOLE,
                                          .fx = expected_focal(s, px, cfg)}};
}

void lenses_group(struct lenses *l, const struct capture *c, const struct views *v,
                  const struct job_config *cfg)
{
    l->n = 0;
    for (int i = 0; i < v->n; i++) {
        const struct shot *s = lenses_shot(c, v->names[i]);
        int first = 0;
        while (strcmp(lenses_shot(c, v->names[first])->camera_id, s->camera_id) != 0)
            first++;
        l->turned[i] = s->turned;
        l->taken[i] = v->extent[i];
        l->of[i] = first < i ? l->of[first] : l->n++;
        if (first == i)
            l->lens[l->of[i]] = lens_before(s, &v->extent[i], cfg);
    }
}

/* ---- found ---- */

/* Largest distance, px, of the pixels that two lenses have for a ray. */
static double lens_change(const struct lens *from, const struct lens *to, const struct extent *px)
{
    double most = 0;
    for (int i = 0; i < GRID * GRID; i++) {
        const double at[2] = {(i % GRID / (GRID - 1.0) - 0.5) * px->w,
                              (i / GRID / (GRID - 1.0) - 0.5) * px->h};
        double ray[3], now[2];
        if (!lens_unproject(from, at, ray) || !lens_project(to, ray, now))
            continue;
        most = fmax(most, hypot(now[0] - at[0], now[1] - at[1]));
    }
    return most;
}

bool lenses_moved(const struct lenses *l, const struct views *v, const struct bundle_result *found,
                  double px)
{
    for (int i = 0; i < v->n; i++) {
        const struct lens *to = &found->lenses[l->of[i]];
        struct lens from = l->lens[l->of[i]].start;
        if (l->pinhole[i] == 0 && (to->cx != 0 || to->cy != 0))
            return true;          // cameras of views have their principal points in the middle
        if (l->pinhole[i] == 0) { // as taken: only what is not a pinhole matters
            from = (struct lens){.fx = to->fx, .fy = to->fy};
            if (lens_init(&from) != OK)
                return false;
        }
        if (lens_change(&from, to, &v->extent[i]) > px)
            return true;
    }
    return false;
}

/* ---- photographs again ---- */

struct retake {
    const struct run *r;
    const struct capture *c;
    const struct prep_source *from;
    const struct job_result *j;
    struct views *v;
    const float *pinhole; // (places); NULL: that of v->cams
};

static int place_of(const struct views *v, int i)
{
    return i < v->n ? i : v->place[i - v->n];
}

/* Lens in px of a photograph, for that as it is turned. */
static struct lens photo_lens(const struct lens *found, int turned, double scale, int w, int h)
{
    struct lens out = *found;
    lens_scale(&out, scale, scale);
    for (int k = 0; k < turned; k++)
        lens_turn(&out, 0);
    out.cx += 0.5 * w;
    out.cy += 0.5 * h;
    return out;
}

/* Like resize_mask of prep.c: the view's own pixels are written afterwards. */
static err_t retake_mask(const struct retake *t, int i, const struct lens *lens,
                         const struct camera *pinhole)
{
    const struct shot *shot = lenses_shot(t->c, t->v->names[i]);
    struct image8 im;
    if (!shot->masked)
        return OK;
    err_t e = t->from->decode_mask(t->from->ctx, (int)(shot - t->c->shots), &im);
    if (e)
        return e;
    e = undistort_image8(NULL, lens, &im, pinhole, views_rgb(t->v, i));
    prep_mask(views_rgb(t->v, i), &t->v->extent[i], views_masked(t->v, i));
    t->from->release(&im);
    return e;
}

static err_t retake_view(void *ctx, int i, int worker)
{
    const struct retake *t = ctx;
    const int place = place_of(t->v, i);
    const struct shot *shot = lenses_shot(t->c, t->v->names[i]);
    const struct extent *px = &t->v->extent[i];
    struct image8 im = shot->image;
    struct lens lens;
    bool resampled;
    (void)worker;
    err_t e = run_check(t->r, "undistorting");
    if (e || !lenses_find(t->j, shot, &lens, &resampled))
        return e;
    const float focal = t->pinhole ? t->pinhole[place] : t->v->cams[place].fx;
    const struct camera pinhole = {.w = px->w,
                                   .h = px->h,
                                   .fx = focal,
                                   .fy = focal,
                                   .cx = 0.5f * (float)px->w,
                                   .cy = 0.5f * (float)px->h};
    if (t->v->masked)
        e = retake_mask(t, i, &lens, &pinhole);
    const bool deep = t->v->deep;
    struct image16 im16;
    if (!e && deep)
        e = t->from->decode16(t->from->ctx, (int)(shot - t->c->shots), &im16);
    else if (!e && t->from)
        e = t->from->decode(t->from->ctx, (int)(shot - t->c->shots), &im);
    if (e)
        return e;
    if (deep) {
        e = undistort_image16(NULL, &lens, &im16, &pinhole, views_rgb16(t->v, i));
        for (size_t k = 0; k < 3 * extent_pixels(px); k++)
            views_rgb(t->v, i)[k] = (uint8_t)((views_rgb16(t->v, i)[k] + 128) / 257);
        t->from->release16(&im16);
        return e;
    }
    e = undistort_image8(NULL, &lens, &im, &pinhole, views_rgb(t->v, i));
    if (t->from)
        t->from->release(&im);
    return e;
}

static err_t choose_pinholes(struct views *v, struct lenses *l)
{
    for (int i = 0; i < v->n + v->n_more; i++) {
        const int place = place_of(v, i);
        const struct extent *px = &l->taken[place];
        const struct lens lens =
            photo_lens(&l->lens[l->of[place]].start, l->turned[place], 1, px->w, px->h);
        int size[2];
        l->pinhole[place] = (float)undistort_frame(&lens, px->w, px->h, size);
        if (!(l->pinhole[place] > 0))
            return err_fail(ERR_FORMAT,
                            "%s: the lens found (%s, focal length %.0f of %d px) leaves nothing to "
                            "see; give its cameras with --rig PATH",
                            v->names[i], lens_name(lens.model), lens.fx, num_max(px->w, px->h));
        v->extent[i].w = size[0];
        v->extent[i].h = size[1];
    }
    return OK;
}

err_t lenses_resample(const struct run *r, const struct capture *c, const struct prep_source *from,
                      const struct bundle_result *found, struct lenses *l, struct job_result *out)
{
    struct views *v = &out->views;
    struct retake t = {r, c, from, out, v, l->pinhole};
    for (int i = 0; i < l->n; i++) {
        if (l->pinhole[0] == 0)
            l->error_before[i] = found->selfcal[i].error_before;
        l->lens[i] = (struct bundle_lens){.start = found->lenses[i]};
    }
    err_t e = choose_pinholes(v, l);
    lenses_note(l, c, found, out);
    return e ? e : pool_for(r->pool, v->n + v->n_more, retake_view, &t);
}

static bool is_resampled(const struct job_result *j)
{
    return j->n_found > 0 && j->found[0].resampled;
}

void lenses_reshape(const struct job_result *j, const struct views *small, struct views *large)
{
    for (int i = 0; i < large->n + large->n_more && is_resampled(j); i++) {
        const struct extent *from = &small->extent[i];
        struct extent *to = &large->extent[i];
        const double scale = (double)num_max(to->w, to->h) / num_max(from->w, from->h);
        to->w = num_min(to->w, num_max(1, (int)lround(from->w * scale)));
        to->h = num_min(to->h, num_max(1, (int)lround(from->h * scale)));
    }
}

err_t lenses_redraw(const struct run *r, const struct capture *c, const struct prep_source *from,
                    struct job_result *out)
{
    struct views *v = &out->views;
    struct retake t = {r, c, from, out, v, NULL};
    if (!is_resampled(out))
        return OK;
    return pool_for(r->pool, v->n + v->n_more, retake_view, &t);
}

/* ---- words ---- */

void lenses_note(const struct lenses *l, const struct capture *c, const struct bundle_result *found,
                 struct job_result *out)
{
    const struct views *v = &out->views;
    out->n_found = out->n_lenses = 0;
    for (int k = 0; k < l->n && out->n_found < BUNDLE_VIEWS_MAX; k++) {
        struct job_lens *to = &out->found[out->n_found++];
        *to = (struct job_lens){.lens = found->lenses[k], .selfcal = found->selfcal[k]};
        if (l->pinhole[0] > 0)
            to->selfcal.error_before = l->error_before[k];
        int first = 0;
        for (int i = v->n - 1; i >= 0; i--)
            if (l->of[i] == k) {
                memcpy(to->camera_id, lenses_shot(c, v->names[i])->camera_id, sizeof to->camera_id);
                to->resampled = l->pinhole[i] > 0;
                to->photographs++;
                first = i;
            }
        note_size(lenses_shot(c, v->names[first]), &v->extent[first], to);
        if (to->resampled && lens_distorts(&to->lens) && out->n_lenses < JOB_LENSES)
            snprintf(out->lenses[out->n_lenses++], sizeof out->lenses[0],
                     "%d photograph%s undistorted: the lens was found to be %s, focal length %.1f "
                     "of %d px",
                     to->photographs, to->photographs == 1 ? "" : "s", lens_name(to->lens.model),
                     to->lens.fx, to->edge);
    }
}

bool lenses_find(const struct job_result *j, const struct shot *s, struct lens *out,
                 bool *resampled)
{
    int k = 0;
    while (k < j->n_found && strcmp(j->found[k].camera_id, s->camera_id) != 0)
        k++;
    if (k == j->n_found)
        return false;
    const struct job_lens *from = &j->found[k];
    const double scale = (double)num_max(s->taken_w, s->taken_h) / from->edge;
    *out = photo_lens(&from->lens, s->turned, scale, s->taken_w, s->taken_h);
    *resampled = from->resampled;
    return true;
}

void lenses_apply(const struct job_result *j, struct capture *c)
{
    for (int i = 0; i < c->n; i++) {
        struct shot *s = &c->shots[i];
        struct lens lens;
        bool resampled;
        if (!lenses_find(j, s, &lens, &resampled))
            continue;
        int size[2] = {s->taken_w, s->taken_h};
        const float focal =
            (float)(resampled ? undistort_frame(&lens, size[0], size[1], size) : lens.fx);
        s->cam = (struct camera){.w = size[0],
                                 .h = size[1],
                                 .fx = focal,
                                 .fy = focal,
                                 .cx = 0.5f * (float)size[0],
                                 .cy = 0.5f * (float)size[1],
                                 .q = {1}};
        s->image.w = size[0];
        s->image.h = size[1];
        if (resampled)
            s->lens = lens;
    }
}

static const char *stop_text(enum selfcal_stop stop)
{
    return stop == SELFCAL_FEW    ? "too few points in three views to judge distortion"
           : stop == SELFCAL_FULL ? "no richer model"
                                  : "the next model predicted left-out points no better";
}

/* Px right of and below the middle of the photograph as the sensor has it. */
static void report_principal(const struct job_lens *l, struct report *rep)
{
    report_open(rep, "principal_px", '[');
    report_number(rep, NULL, l->lens.cx);
    report_number(rep, NULL, l->lens.cy);
    report_close(rep);
    report_open(rep, "principal_deviation", '[');
    report_number(rep, NULL, l->selfcal.deviation[ADJUST_CENTRE]);
    report_number(rep, NULL, l->selfcal.deviation[ADJUST_CENTRE + 1]);
    report_close(rep);
}

void lenses_report(const struct job_result *j, struct report *rep)
{
    static const char *const keys[2][LENS_TERMS] = {{"k1", "k2", "p1", "p2"},
                                                    {"k1", "k2", "k3", "k4"}};
    if (j->n_found == 0)
        return;
    report_open(rep, "lenses", '[');
    for (int i = 0; i < j->n_found; i++) {
        const struct job_lens *l = &j->found[i];
        const bool fisheye = l->lens.model == LENS_OPENCV_FISHEYE;
        report_open(rep, NULL, '{');
        report_text(rep, "camera", l->camera_id);
        report_int(rep, "photographs", l->photographs);
        report_text(rep, "model", lens_name(l->lens.model));
        report_int(rep, "edge_px", l->edge);
        report_number(rep, "focal_px", l->lens.fx);
        report_number(rep, "focal_deviation", l->selfcal.deviation[0]);
        for (int k = 0; k < LENS_TERMS; k++)
            if (l->selfcal.deviation[1 + k] > 0)
                report_number(rep, keys[fisheye][k], l->lens.term[k]);
        report_open(rep, "deviations", '[');
        for (int k = 0; k < LENS_TERMS; k++)
            if (l->selfcal.deviation[1 + k] > 0)
                report_number(rep, NULL, l->selfcal.deviation[1 + k]);
        report_close(rep);
        if (l->selfcal.deviation[ADJUST_CENTRE] > 0)
            report_principal(l, rep);
        report_int(rep, "left_out_points", l->selfcal.held);
        report_number(rep, "left_out_error_before", sqrt(l->selfcal.error_before));
        report_number(rep, "left_out_error", sqrt(l->selfcal.error));
        report_text(rep, "stopped_because", stop_text(l->selfcal.stop));
        report_close(rep);
    }
    report_close(rep);
}
