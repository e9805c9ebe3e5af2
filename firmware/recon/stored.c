#include "firmware/recon/stored.h"

#include "firmware/recon/shading.h"

#include "core/base/num.h"
#include "core/sfm/bundle.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"

#include <string.h>

void stored_put(const struct job_result *j, const struct shot *s, struct rig_view *out)
{
    memcpy(out->camera, s->camera_id, NAME_CAP);
    out->has_light = shading_model(j, s->camera_id, &out->light);
}

/* Whether view i is the first one of its physical camera. */
static bool is_first(const struct rig *rig, int i)
{
    for (int k = 0; k < i; k++)
        if (strcmp(rig->views[k].camera, rig->views[i].camera) == 0)
            return false;
    return rig->views[i].camera[0] != 0;
}

static int count_photographs(const struct rig *rig, const char *camera)
{
    int n = 0;
    for (int i = 0; i < rig->n; i++)
        n += strcmp(rig->views[i].camera, camera) == 0;
    return n;
}

static void keep_light(const struct shade_model *m, struct shade_fit_camera *out)
{
    out->model = *m;
    for (int k = 0; k < SHADE_TERMS; k++)
        out->kept[SHADE_FIT_V2 + k] = m->term[k] != 0;
    out->kept[SHADE_FIT_GAIN] = m->gain[0] != 0 || m->gain[1] != 0 || m->gain[2] != 0;
}

void stored_light(const struct rig *rig, struct job_result *out)
{
    out->n_light = 0;
    for (int i = 0; i < rig->n && out->n_light < SHADE_FIT_CAMERAS; i++) {
        const struct rig_view *v = &rig->views[i];
        if (!v->has_light || !is_first(rig, i))
            continue;
        struct job_light *l = &out->light[out->n_light++];
        *l = (struct job_light){.photographs = count_photographs(rig, v->camera)};
        memcpy(l->camera_id, v->camera, NAME_CAP);
        keep_light(&v->light, &l->found);
    }
}

static int turns_of(const struct capture *c, const char *name)
{
    for (int i = 0; i < c->n; i++)
        if (strcmp(c->shots[i].name, name) == 0)
            return c->shots[i].turned;
    return 0;
}

/* The lens of a view, px from the middle, as the sensor is turned. */
static struct job_lens lens_of(const struct rig_view *v, int turned)
{
    struct job_lens out = {.resampled = v->photograph.w > 0};
    const struct camera *c = &v->cam;
    const int w = out.resampled ? v->photograph.w : c->w,
              h = out.resampled ? v->photograph.h : c->h;
    out.lens = out.resampled ? v->photograph.lens
                             : (struct lens){.fx = (double)c->fx,
                                             .fy = (double)c->fy,
                                             .cx = (double)c->cx,
                                             .cy = (double)c->cy};
    out.lens.cx -= 0.5 * w;
    out.lens.cy -= 0.5 * h;
    for (int k = turned; k % 4 != 0; k++)
        lens_turn(&out.lens, 0);
    out.edge = num_max(w, h);
    memcpy(out.camera_id, v->camera, NAME_CAP);
    return out;
}

void stored_lenses(const struct rig *rig, const struct capture *inputs, struct job_result *out)
{
    out->n_found = 0;
    for (int i = 0; i < rig->n && out->n_found < BUNDLE_VIEWS_MAX; i++) {
        const struct rig_view *v = &rig->views[i];
        if (!is_first(rig, i))
            continue;
        struct job_lens *l = &out->found[out->n_found++];
        *l = lens_of(v, turns_of(inputs, v->name));
        l->photographs = count_photographs(rig, v->camera);
    }
}

static err_t take_exposures(const char *what, const struct cJSON *doc, void *out)
{
    const struct cJSON *list = json_member(doc, "inputs");
    err_t e = json_is_array(list) ? OK : err_fail(ERR_FORMAT, "%s: no list of inputs", what);
    for (const struct cJSON *i = e ? NULL : json_first(list); i && !e; i = json_next(i)) {
        float log2t;
        e = json_float(what, i, "exposure_log2", &log2t);
        if (!e)
            evaluate_see(out, log2t);
    }
    return e;
}

err_t stored_exposures(const char *path, struct evaluate_seen *io)
{
    return file_exists(path) ? json_read_with(path, take_exposures, io) : OK;
}
