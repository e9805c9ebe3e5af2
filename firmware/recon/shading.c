#include "firmware/recon/shading.h"

#include "firmware/recon/lenses.h"

#include "core/refine/response_refit.h"

#include <math.h>
#include <string.h>

enum { ROUNDS = 8 }; // of curve and light in turn
#define SETTLED 0.01 // stops, no further round for less

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

static void set_models(const struct job_result *j, const int *camera, struct shade *room)
{
    for (int i = 0; i < j->views.n; i++)
        room[i].model = j->light[camera[i]].found.model;
}

/* Largest difference of the models from those in room, stops. */
static double largest_change(const struct job_result *j, const int *camera,
                             const struct shade *room)
{
    double most = 0;
    for (int i = 0; i < j->views.n; i++) {
        const struct shade_model *a = &j->light[camera[i]].found.model, *b = &room[i].model;
        struct shade_model d;
        for (int k = 0; k < SHADE_TERMS; k++)
            d.term[k] = a->term[k] - b->term[k];
        for (int c = 0; c < 3; c++)
            d.gain[c] = a->gain[c] - b->gain[c];
        most = fmax(most, shade_most(&d));
    }
    return most;
}

/* ---- the step ---- */

static err_t fit_models(const struct run *r, const struct shading_input *in, const int *camera,
                        struct job_result *out)
{
    struct shade_fit_camera found[SHADE_FIT_CAMERAS];
    const struct shade_fit_input from = {.v = in->seen,
                                         .depth = in->depth,
                                         .tone = in->tone,
                                         .shade = in->room,
                                         .camera = camera,
                                         .n_cameras = out->n_light};
    err_t e = shade_fit_run(r, &from, found);
    for (int k = 0; k < out->n_light && !e; k++)
        out->light[k].found = found[k];
    return e;
}

err_t shading_run(const struct run *r, const struct shading_input *in, struct job_result *out)
{
    const struct tonemap before = *in->tone;
    int camera[BUNDLE_VIEWS_MAX];
    err_t e = OK;
    if (out->views.n > BUNDLE_VIEWS_MAX || !group_cameras(in->capture, out, camera)) {
        out->n_light = 0;
        return OK;
    }
    for (int i = 0; i < out->views.n; i++)
        map_view(out, lenses_shot(in->capture, out->views.names[i]), &out->views.cams[i],
                 &in->room[i]);
    for (int i = 0; i < out->views.n; i++)
        in->room[i].model = (struct shade_model){.gain = {0}};
    for (int k = 0; k < ROUNDS && !e; k++) {
        e = fit_models(r, in, camera, out);
        if (e || !shading_found(out))
            break;
        const bool settled = largest_change(out, camera, in->room) < SETTLED;
        set_models(out, camera, in->room);
        in->seen->shade = out->views.shade = in->room;
        if (settled || !in->refit)
            break;
        e = response_refit_run(r, in->seen, in->depth, in->tone);
    }
    if (e || shading_found(out))
        return e;
    *in->tone = before;
    in->seen->shade = out->views.shade = NULL;
    return OK;
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

void shading_report(const struct job_result *j, struct report *rep)
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
