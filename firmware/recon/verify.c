#include "firmware/recon/verify.h"

#include "core/photo/exposure_stack.h"
#include "core/sfm/match.h"
#include "core/sfm/pose.h"

#include <string.h>

enum { HALVED_FROM = 320 }; // px, views that are checked at half their size: a quarter of the time

static bool is_halved(const struct views *v)
{
    return v->size >= HALVED_FROM;
}

/* Shapes of the halves. */
static void halve_extents(const struct views *v, struct extent *out)
{
    size_t at = 0;
    for (int i = 0; i < v->n; at += extent_pixels(&out[i++]))
        out[i] = (struct extent){v->extent[i].w / 2, v->extent[i].h / 2, at};
}

/* Pixels, and what is masked of them, which a plan does not know. */
static err_t layout(struct views *v, struct arena *tmp, const struct extent *half)
{
    const size_t pixels = extent_total(half, v->n);
    err_t e = arena_alloc(tmp, pixels, 3, &v->rgb);
    return e || !(v->masked || tmp->counts) ? e : arena_alloc(tmp, pixels, 1, &v->masked);
}

static void halve_mask(const struct views *from, int i, const struct views *v)
{
    const struct extent *px = &v->extent[i];
    for (int k = 0; k < px->w * px->h; k++)
        views_masked(v, i)[k] = views_hides_any(from, i, 2 * (k % px->w), 2 * (k / px->w), 2);
}

/* Means of 2 x 2 px, in tmp. half: their shapes, which *v keeps. */
static err_t halve_views(const struct run *r, struct extent *half, struct views *v)
{
    const struct views from = *v;
    halve_extents(&from, half);
    v->extent = half;
    v->size /= 2;
    v->n_more = 0;
    err_t e = layout(v, r->tmp, half);
    for (int i = 0; i < v->n && !e; i++) {
        const struct extent *px = &v->extent[i];
        const size_t row = 3 * (size_t)from.extent[i].w;
        if (v->masked)
            halve_mask(&from, i, v);
        for (int k = 0; k < 3 * px->w * px->h; k++) {
            const size_t y = 2 * (size_t)(k / 3 / px->w), x = 2 * (size_t)(k / 3 % px->w);
            const uint8_t *p = views_rgb(&from, i) + y * row + 3 * x + k % 3;
            views_rgb(v, i)[k] = (uint8_t)((p[0] + p[3] + p[row] + p[row + 3] + 2) / 4);
        }
    }
    return e;
}

void verify_plan(struct plan *p, const struct views *v)
{
    const size_t mark = arena_mark(&p->tmp), keep = arena_mark(&p->keep);
    struct match_tracks tracks;
    struct extent extent[RIGCHECK_MOST];
    struct views half = *v;
    exposure_stack_merge_plan(p, v);
    if (is_halved(v)) {
        halve_extents(v, extent);
        half.extent = extent;
        half.size /= 2;
        if (layout(&half, &p->tmp, extent))
            plan_refuse(p);
    }
    match_plan(p, &half, 0, &tracks);
    rigcheck_plan(p, v->n, &tracks);
    arena_reset(&p->keep, keep);
    arena_reset(&p->tmp, mark);
}

static void name_moved(struct job_result *out, int i, enum recipe_moved what)
{
    const struct rigcheck_camera *c = &out->rig[i].check;
    job_result_warn(out,
                    "the camera of %.64s has moved since the rig was calibrated: turned by %.2f "
                    "degrees, shifted by %.1f %% of its distance to the scene (what it sees is "
                    "%.1f px off); %s",
                    out->views.names[i], (double)c->turned_deg, 100 * (double)c->shift,
                    (double)c->off_px,
                    what == RECIPE_MOVED_SOLVE ? "the scene is made with its camera as it is now"
                                               : "calibrate the rig again");
}

static err_t treat_moved(enum recipe_moved what, struct job_result *out)
{
    int moved = -1, unknown = 0; // moved: the sentence of the last one
    for (int i = 0; i < out->n_rig; i++) {
        const struct rigcheck_camera *c = &out->rig[i].check;
        unknown += !c->known;
        if (!c->moved)
            continue;
        name_moved(out, i, what);
        moved = out->n_warnings - 1;
        if (what == RECIPE_MOVED_SOLVE)
            out->scene.cams[i] = c->cam;
    }
    if (unknown)
        job_result_warn(out,
                        "%d of %d cameras could not be checked against the rig's calibration: too "
                        "few points that two others see",
                        unknown, out->n_rig);
    if (moved >= 0 && what == RECIPE_MOVED_REFUSE)
        return err_fail(ERR_ARG, "%s", out->warnings[moved]);
    return OK;
}

err_t verify_run(const struct run *r, enum recipe_moved what, struct job_result *out)
{
    const size_t mark = arena_mark(r->tmp), keep = arena_mark(r->keep);
    struct rigcheck_camera found[RIGCHECK_MOST];
    struct camera cams[RIGCHECK_MOST];
    struct extent half[RIGCHECK_MOST];
    struct match_tracks tracks;
    struct tonemap tone;
    struct views v;
    if (r->progress)
        r->progress(r->progress_ctx, "rig", 0, 1, NULL);
    err_t e = exposure_stack_merge(r, &out->views, &out->response, &v, &tone);
    if (!e && is_halved(&v))
        e = halve_views(r, half, &v);
    for (int i = 0; i < v.n && !e; i++)
        cams[i] = pose_scaled(&out->scene.cams[i], v.extent[i].w, v.extent[i].h);
    if (!e)
        e = match_run(r, &v, NULL, NULL, &tracks);
    if (!e)
        e = rigcheck_run(r, &v, &tracks, cams, found);
    for (int i = 0; i < v.n && !e; i++) { // in px of the views
        const struct extent *px = &out->views.extent[i];
        found[i].cam = pose_scaled(&found[i].cam, px->w, px->h);
        found[i].off_px *= (float)px->w / (float)v.extent[i].w;
    }
    arena_reset(r->keep, keep);
    arena_reset(r->tmp, mark);
    out->n_rig = e ? 0 : out->views.n;
    for (int i = 0; i < out->n_rig; i++) {
        out->rig[i].check = found[i];
        memcpy(out->rig[i].name, out->views.names[i], sizeof out->rig[i].name);
    }
    job_result_lap(out, JOB_CAMERAS);
    return e ? e : treat_moved(what, out);
}

void verify_report(const struct job_result *j, struct report *rep)
{
    if (j->n_rig == 0)
        return;
    report_open(rep, "rig", '[');
    for (int i = 0; i < j->n_rig; i++) {
        const struct rigcheck_camera *c = &j->rig[i].check;
        report_open(rep, NULL, '{');
        report_text(rep, "name", j->rig[i].name);
        report_int(rep, "points", c->seen);
        report_bool(rep, "checked", c->known);
        report_bool(rep, "moved", c->moved);
        report_number(rep, "off_px", (double)c->off_px);
        report_number(rep, "turned_deg", (double)c->turned_deg);
        report_number(rep, "shift", (double)c->shift);
        report_close(rep);
    }
    report_close(rep);
}
