#include "firmware/recon/shading.h"

#include "firmware/recon/lenses.h"

#include "core/photo/exposure_even.h"
#include "core/photo/response.h"
#include "core/refine/response_refit.h"

#include <math.h>
#include <string.h>

enum { ROUNDS = 8 }; // of curve and light in turn
#define SETTLED 0.01 // stops, no further round for less
#define TOLD 0.01f   // stops

err_t shading_layout(struct shade **out, struct arena *keep, int n_views)
{
    return arena_alloc(keep, (size_t)n_views, sizeof **out, out);
}

size_t shading_plan(int n_views)
{
    return shade_fit_plan(n_views);
}

/* ---- cameras ---- */

static int find_camera(const struct job_result *j, const char *id)
{
    int k = 0;
    while (k < j->n_light && strcmp(j->light[k].camera_id, id) != 0)
        k++;
    return k;
}

/* camera: (places). False if there are more than can be told apart. */
static bool group_cameras(const struct capture *c, struct job_result *j, int *camera)
{
    const struct views *v = &j->views;
    j->n_light = 0;
    for (int i = 0; i < v->n; i++) {
        const struct shot *s = lenses_shot(c, v->names[i]);
        const int k = find_camera(j, s->camera_id);
        if (k == SHADE_FIT_CAMERAS)
            return false;
        if (k == j->n_light) {
            j->light[j->n_light] = (struct job_light){.photographs = 0};
            memcpy(j->light[j->n_light++].camera_id, s->camera_id, NAME_CAP);
        }
        j->light[k].photographs++;
        camera[i] = k;
    }
    return true;
}

/* Any number of them. camera: (places) the first place of each. */
static void tell_cameras(const struct capture *c, const struct views *v, int *camera)
{
    for (int i = 0; i < v->n; i++) {
        const char *own = lenses_shot(c, v->names[i])->camera_id;
        for (camera[i] = 0; camera[i] < i; camera[i]++)
            if (strcmp(lenses_shot(c, v->names[camera[i]])->camera_id, own) == 0)
                break;
    }
}

/* Where the pixels of a view are in the photograph as taken. */
static void map_view(const struct job_result *j, const struct shot *s, const struct camera *view,
                     struct shade *out)
{
    struct lens lens = s->lens;
    bool drawn = lens_distorts(&lens), resampled;
    if (lenses_find(j, s, &lens, &resampled))
        drawn = resampled;
    shade_map(drawn ? &lens : NULL, s->taken_w, s->taken_h, view, out);
}

bool shading_found(const struct job_result *j)
{
    for (int k = 0; k < j->n_light; k++)
        for (int i = 0; i < SHADE_FIT_KINDS; i++)
            if (j->light[k].found.kept[i])
                return true;
    return false;
}

/* ---- the step ---- */

/* What a run of shading works on. */
struct fitting {
    const struct shading_input *in;
    struct job_result *out;
    int camera[BUNDLE_VIEWS_MAX];
    float set[BUNDLE_VIEWS_MAX];   // exposures of in->seen before
    float used[BUNDLE_VIEWS_MAX];  // stops in them since
    float stops[BUNDLE_VIEWS_MAX]; // of drift
    float balance[BUNDLE_VIEWS_MAX][3];
    struct light_change change;
};

static err_t fit_models(const struct run *r, struct fitting *f)
{
    struct shade_fit_camera found[SHADE_FIT_CAMERAS];
    const struct shading_input *in = f->in;
    struct job_result *out = f->out;
    const struct shade_fit_input from = {.v = in->seen,
                                         .depth = in->depth,
                                         .tone = in->tone,
                                         .tone_known = !in->refit,
                                         .shade = in->room,
                                         .camera = f->camera,
                                         .n_cameras = out->n_light};
    out->drift.stops = f->stops;
    out->drift.balance = out->n_light ? f->balance : NULL;
    f->change.other = out->other_light;
    err_t e = shade_fit_run(r, &from, found, &out->drift, &f->change);
    for (int k = 0; k < out->n_light && !e; k++)
        out->light[k].found = found[k];
    return e;
}

static bool anything_found(const struct fitting *f)
{
    return f->out->drift.kept || shading_found(f->out);
}

/* What the camera and the white balance of place i do to light. */
static struct shade_model model_of(const struct fitting *f, int i)
{
    struct shade_model m = f->out->light[f->camera[i]].found.model;
    for (int c = 0; c < 3; c++)
        m.gain[c] += (double)f->balance[i][c];
    return m;
}

/* Takes over the models. Returns the largest change, stops. */
static double use_shades(const struct fitting *f)
{
    double most = 0;
    for (int i = 0; i < f->out->views.n; i++) {
        struct shade_model *was = &f->in->room[i].model, d;
        const struct shade_model m = model_of(f, i);
        for (int k = 0; k < SHADE_TERMS; k++)
            d.term[k] = m.term[k] - was->term[k];
        for (int c = 0; c < 3; c++)
            d.gain[c] = m.gain[c] - was->gain[c];
        most = fmax(most, shade_most(&d));
        *was = m;
    }
    f->in->seen->shade = f->out->views.shade = f->in->room;
    return most;
}

/* Takes over what was found. Returns the largest change, stops. */
static double use_models(struct fitting *f)
{
    struct views *seen = f->in->seen;
    double most = 0;
    for (int i = 0; i < seen->n; i++) {
        const float log2t = f->set[i] + f->stops[i];
        most = fmax(most, fabs((double)(log2t - seen->log2t[i])));
        seen->log2t[i] = log2t;
        f->used[i] = f->stops[i];
    }
    return f->out->n_light ? fmax(most, use_shades(f)) : most;
}

static void begin_fitting(struct fitting *f)
{
    const struct shading_input *in = f->in;
    struct job_result *out = f->out;
    for (int i = 0; i < out->views.n; i++)
        f->set[i] = in->seen->log2t[i];
    if (!in->room || !group_cameras(in->capture, out, f->camera)) {
        out->n_light = 0;
        tell_cameras(in->capture, &out->views, f->camera);
    }
    for (int i = 0; i < out->views.n && out->n_light; i++) {
        map_view(out, lenses_shot(in->capture, out->views.names[i]), &out->views.cams[i],
                 &in->room[i]);
        in->room[i].model = (struct shade_model){.gain = {0}};
    }
}

/* Names of the smaller group, as many as a sentence has room for. */
static void warn_change(const struct fitting *f)
{
    enum { NAMES = 8 };
    struct job_result *out = f->out;
    char names[NAMES * 32] = "", rest[32] = "";
    int n = 0;
    for (int i = 0; i < out->views.n; i++) {
        const size_t used = strlen(names);
        if (out->other_light[i] && n++ < NAMES)
            snprintf(names + used, sizeof names - used, "%s%.28s", used ? ", " : "",
                     out->views.names[i]);
    }
    if (n > NAMES)
        snprintf(rest, sizeof rest, " and %d more", n - NAMES);
    job_result_warn(out,
                    "a lamp or the sun lights %s%s otherwise than the rest, and the scene mixes "
                    "both: photograph again without switching lights, or leave %s out",
                    names, rest, out->views.n_more ? "these places" : "these");
}

static void note_balance(const struct fitting *f)
{
    struct job_result *out = f->out;
    out->balance_most = 0;
    for (int i = 0; i < 3 * out->views.n && out->drift.coloured; i++) {
        const float stops = fabsf(f->balance[i / 3][i % 3]);
        if (stops <= out->balance_most)
            continue;
        out->balance_most = stops;
        out->balance_place = i / 3;
    }
}

/* All photographs of a place share its drift. */
static void end_fitting(struct fitting *f)
{
    struct views *v = &f->out->views;
    float *drift = f->in->drift;
    note_balance(f);
    f->out->n_other_light = f->change.others;
    if (f->change.others > 0)
        warn_change(f);
    f->in->seen->drift = NULL; // it has done its work
    f->out->drift.stops = drift;
    f->out->drift.balance = NULL;
    if (!f->out->drift.kept)
        return;
    for (int i = 0; i < v->n + v->n_more; i++) {
        const float stops = f->stops[i < v->n ? i : v->place[i - v->n]];
        drift[i] = stops + (v->drift ? v->drift[i] : 0);
        v->log2t[i] += v->log2t == f->in->seen->log2t ? 0 : stops;
    }
    v->drift = drift;
}

err_t shading_run(const struct run *r, const struct shading_input *in, struct job_result *out)
{
    const struct tonemap before = *in->tone;
    struct fitting f = {.in = in, .out = out};
    err_t e = OK;
    out->n_light = 0;
    if (out->views.n > BUNDLE_VIEWS_MAX)
        return OK;
    begin_fitting(&f);
    in->seen->drift = f.used;
    for (int k = 0; k < ROUNDS && !e; k++) {
        e = fit_models(r, &f);
        if (e)
            break;
        const bool settled = use_models(&f) < SETTLED;
        if (!anything_found(&f) || settled || !in->refit)
            break;
        e = response_refit_run(r, in->seen, in->depth, in->tone);
    }
    if (!e && !anything_found(&f))
        *in->tone = before;
    if (!shading_found(out) && !out->drift.coloured)
        in->seen->shade = out->views.shade = NULL;
    end_fitting(&f);
    return e;
}

static err_t layout_brackets(float *set_used[2], struct arena *tmp, const struct views *v)
{
    const size_t n = (size_t)(v->n + v->n_more);
    err_t e = arena_alloc(tmp, n, sizeof *set_used[0], &set_used[0]);
    return e ? e : arena_alloc(tmp, n, sizeof *set_used[1], &set_used[1]);
}

void shading_brackets_plan(struct plan *p, const struct views *v)
{
    const size_t mark = arena_mark(&p->tmp);
    float *set_used[2];
    if (layout_brackets(set_used, &p->tmp, v))
        plan_refuse(p);
    exposure_even_plan(p, v);
    arena_step(&p->tmp, response_plan(v));
    arena_reset(&p->tmp, mark);
}

/* Curve and light in turn: one is found with the other. */
static err_t even_brackets(const struct run *r, const float *set, float *used, float *drift,
                           struct job_result *out)
{
    struct views *v = &out->views;
    const size_t n = (size_t)(v->n + v->n_more);
    float moved = INFINITY;
    err_t e = OK;
    for (int k = 0; k < ROUNDS && moved > SETTLED && !e; k++) {
        memcpy(used, v->log2t, n * sizeof *used);
        memcpy(v->log2t, set, n * sizeof *set);
        e = exposure_even_run(r, v, &out->response, drift);
        moved = 0;
        for (size_t i = 0; i < n && !e; i++) {
            v->log2t[i] += drift[i];
            moved = fmaxf(moved, fabsf(v->log2t[i] - used[i]));
        }
        if (!e && moved > SETTLED)
            e = job_result_curve(r, out);
    }
    return e;
}

err_t shading_brackets(const struct run *r, float *drift, struct job_result *out)
{
    struct views *v = &out->views;
    const size_t mark = arena_mark(r->tmp);
    float *set_used[2];
    err_t e = layout_brackets(set_used, r->tmp, v);
    if (!e) {
        memcpy(set_used[0], v->log2t, (size_t)(v->n + v->n_more) * sizeof *v->log2t);
        e = even_brackets(r, set_used[0], set_used[1], drift, out);
    }
    for (int i = 0; i < v->n + v->n_more && !e; i++)
        if (drift[i] != 0)
            v->drift = drift;
    arena_reset(r->tmp, mark);
    return e;
}

bool shading_model(const struct job_result *j, const char *camera_id, struct shade_model *out)
{
    const int k = find_camera(j, camera_id);
    if (!shading_found(j) || k == j->n_light)
        return false;
    *out = j->light[k].found.model;
    return true;
}

bool shading_of(const struct job_result *j, const struct shot *s, const struct camera *view,
                struct shade *out)
{
    if (!shading_model(j, s->camera_id, &out->model))
        return false;
    map_view(j, s, view, out);
    return true;
}

/* ---- words ---- */

static void report_cameras(const struct job_result *j, struct report *rep)
{
    static const char *const words[SHADE_FIT_KINDS] = {"v2", "v4", "v6", "gain", "white_balance"};
    if (j->n_light == 0)
        return;
    report_open(rep, "light", '[');
    for (int i = 0; i < j->n_light; i++) {
        const struct job_light *l = &j->light[i];
        const struct shade_fit_camera *f = &l->found;
        float corner[3];
        shade_stops(&f->model, 1, corner);
        report_open(rep, NULL, '{');
        report_text(rep, "camera", l->camera_id);
        report_int(rep, "photographs", l->photographs);
        report_row(rep, "vignetting_stops", f->model.term, SHADE_TERMS);
        report_number(rep, "corner_stops", (double)corner[0] - f->model.gain[0]);
        report_row(rep, "gain_stops", f->model.gain, 3);
        report_int(rep, "left_out_observations", f->held);
        report_number(rep, "left_out_error_before", f->error_before);
        report_number(rep, "left_out_error", f->error);
        report_open(rep, "left_out_error_without", '{');
        for (int k = 0; k < SHADE_FIT_KINDS; k++)
            if (f->kept[k] && f->without[k] > 0)
                report_number(rep, words[k], f->without[k]);
        report_close(rep);
        report_close(rep);
    }
    report_close(rep);
}

/* The photograph whose light is farthest from that of all. */
static int farthest_light(const struct job_result *j)
{
    int most = 0;
    for (int i = 1; i < j->views.n + j->views.n_more; i++)
        if (fabsf(j->views.drift[i]) > fabsf(j->views.drift[most]))
            most = i;
    return most;
}

void shading_tell(const struct job_result *j, struct report *rep)
{
    const float *drift = j->views.drift;
    char text[192];
    const int i = drift ? farthest_light(j) : 0;
    if (drift && fabsf(drift[i]) >= TOLD) {
        snprintf(text, sizeof text,
                 "light was not the same in all photographs, up to %.2f stops %s (%.40s): evened "
                 "out%s",
                 fabs((double)drift[i]), drift[i] > 0 ? "brighter" : "darker", j->views.names[i],
                 fabs((double)drift[i]) < SHADE_FIT_DRIFT_MOST ? "" : " as far as that goes");
        report_text(rep, NULL, text);
    }
    if (j->drift.coloured) {
        snprintf(text, sizeof text,
                 "white balance was not the same in all photographs, up to %.2f stops (%.40s): "
                 "evened out",
                 (double)j->balance_most, j->views.names[j->balance_place]);
        report_text(rep, NULL, text);
    }
}

static void report_drift(const struct job_result *j, struct report *rep)
{
    const struct shade_fit_drift *d = &j->drift;
    if (d->held == 0)
        return;
    report_open(rep, "drift", '{');
    report_bool(rep, "used", d->kept);
    report_int(rep, "left_out_observations", d->held);
    report_number(rep, "left_out_error_without", d->error_before);
    report_number(rep, "left_out_error_with", d->error);
    report_bool(rep, "white_balance", d->coloured);
    if (d->error_grey > 0)
        report_number(rep, "left_out_error_without_white_balance", d->error_grey);
    report_close(rep);
}

void shading_report(const struct job_result *j, struct report *rep)
{
    report_drift(j, rep);
    report_cameras(j, rep);
}
