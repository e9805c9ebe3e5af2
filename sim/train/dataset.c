/* All cameras are photographed first, because the exposure meter looks at all of them; then view by
 * view: pictures at their exposures, radiance and depth. Whoever passes by is painted over the
 * radiance of one photograph, so that everything else stays as it is without. */
#include "sim/train/dataset.h"

#include "core/base/splitmix.h"
#include "drivers/format/exrfile.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"

#include <errno.h>
#include <math.h>
#include <string.h>
#include <sys/stat.h>

enum { SHOTS = 3 }; // most photographs of an input

/* Pixels of all views; of the largest. */
static size_t all_pixels(const struct dataset_request *a, size_t *largest)
{
    struct extent all[SAMPLE_VIEWS];
    sample_extents(&a->sample, all);
    *largest = extent_cover(all, a->sample.n_views).at;
    return extent_total(all, a->sample.n_views);
}

uint64_t dataset_bytes(const struct dataset_request *a)
{
    size_t largest;
    /* as if nothing could be compressed */
    return (uint64_t)all_pixels(a, &largest) *
               (3 * (uint64_t)a->n_exposures + (a->input_truth ? 12 : 8) +
                (a->passer.share > 0 ? 3 * SHOTS : 0)) +
           (1 << 20);
}

/* The scene in memory while files are written. */
struct set {
    const struct dataset_request *a;
    const char *dir;
    struct extent extent[SAMPLE_VIEWS];
    struct sample_place place; // its radiance and depth are those of all views
    struct sample_place lit;   // the same with the switched light on, without depth
    float *seen;               // (3, h, w) radiance of one view behind its optics
    uint8_t *px;               // (DATASET_EXPOSURES, h, w, 3) of one view
    uint8_t *mask;             // (4, h, w): of one photograph, and as R,G,B
};

/* Inputs have the first, the middle and the last exposure. */
static bool is_taken(const struct dataset_request *a, int view, int k)
{
    return !sample_is_input(&a->sample, view) || k == 0 || k == a->n_exposures / 2 ||
           k == a->n_exposures - 1;
}

/* A photograph of an input, by its number. */
static bool is_input_photo(const struct dataset_request *a, int number)
{
    const int view = number / DATASET_EXPOSURES, k = number % DATASET_EXPOSURES;
    return k < a->n_exposures && sample_is_input(&a->sample, view) && is_taken(a, view, k);
}

/* Whether somebody passes by in a photograph: in a third of them, drawn by the seed. */
static bool is_passed(const struct dataset_request *a, int view, int k)
{
    const uint64_t seed = splitmix_mix(a->passer.seed + 1);
    const uint64_t own = splitmix_mix(seed + (uint64_t)(view * DATASET_EXPOSURES + k));
    int n = 0, before = 0;
    if (!(a->passer.share > 0) || !sample_is_input(&a->sample, view))
        return false;
    for (int i = 0; i < a->sample.n_views * DATASET_EXPOSURES; i++) {
        if (!is_input_photo(a, i))
            continue;
        n++;
        before += splitmix_mix(seed + (uint64_t)i) < own;
    }
    return before < (n + 2) / 3;
}

/* -1..1 of a photograph, by its number, for one of several purposes. */
static double draw_evenly(const struct dataset_request *a, uint64_t purpose, int number)
{
    const uint64_t seed = splitmix_mix(a->sample.seed + purpose);
    return (double)(splitmix_mix(seed + (uint64_t)number) >> 11) * 0x1p-52 - 1;
}

/* The same, less the mean of every `step`th photograph of inputs. */
static float draw_beside(const struct dataset_request *a, uint64_t purpose, int step, int number)
{
    double sum = 0;
    int n = 0;
    for (int i = 0; i < a->sample.n_views * DATASET_EXPOSURES; i += step) {
        if (!is_input_photo(a, i))
            continue;
        n++;
        sum += draw_evenly(a, purpose, i);
    }
    return (float)(draw_evenly(a, purpose, number) - sum / n);
}

/* Stops of the light of a photograph beside that of the others. */
static float light_of(const struct dataset_request *a, int view, int k)
{
    const int number = view * DATASET_EXPOSURES + k;
    return a->flicker > 0 && is_input_photo(a, number) ? a->flicker * draw_beside(a, 2, 1, number)
                                                       : 0;
}

/* Stops of red (0), green and blue by the white balance of a view beside that of the others; a
 * camera sets it once for the photographs of a view. */
static float balance_of(const struct dataset_request *a, int view, int colour)
{
    const uint64_t purpose[3] = {4, 0, 5};
    return a->balance > 0 && colour != 1 && sample_is_input(&a->sample, view)
               ? a->balance *
                     draw_beside(a, purpose[colour], DATASET_EXPOSURES, view * DATASET_EXPOSURES)
               : 0;
}

/* Whether the switched light is on: in a share of the inputs, drawn by the seed. */
static bool is_lit(const struct dataset_request *a, int view)
{
    const uint64_t seed = splitmix_mix(a->sample.seed + 3);
    const uint64_t own = splitmix_mix(seed + (uint64_t)view);
    int n = 0, before = 0;
    if (a->sample.switched == SAMPLE_NO_SWITCH || !sample_is_input(&a->sample, view))
        return false;
    for (int i = 0; i < a->sample.n_views; i++) {
        if (!sample_is_input(&a->sample, i))
            continue;
        n++;
        before += splitmix_mix(seed + (uint64_t)i) < own;
    }
    return before < (int)lroundf(a->lit * (float)n);
}

static void picture_name(const struct sample_scene *a, int view, int k, char out[NAME_CAP])
{
    snprintf(out, NAME_CAP, "%s_ldr_%03d_%d.png", sample_is_input(a, view) ? "train" : "test",
             sample_number(a, view), k);
}

/* ---- pictures ---- */

static err_t write_pictures(const struct set *s, int view)
{
    const struct dataset_request *a = s->a;
    const struct extent *x = &s->extent[view];
    char name[NAME_CAP], path[FILE_PATH_CAP], folder[FILE_PATH_CAP], camera[32];
    const struct img_maker maker = {"hdrig", camera};
    snprintf(camera, sizeof camera, "simulated camera %d", sample_camera_of(&a->sample, view) + 1);
    err_t e = file_join(s->dir, "images", folder);
    for (int k = 0; k < a->n_exposures && !e; k++) {
        struct image8 im = {x->w, x->h, 3, s->px + 3 * extent_pixels(x) * (size_t)k};
        if (!is_taken(a, view, k))
            continue;
        picture_name(&a->sample, view, k, name);
        e = file_join(folder, name, path);
        if (!e)
            e = img_write_png_by(path, &im, a->sample.n_optics > 1 ? &maker : NULL);
    }
    return e;
}

/* The world as a view shows it. */
static const struct sample_place *place_of(const struct set *s, int view)
{
    return is_lit(s->a, view) ? &s->lit : &s->place;
}

static err_t write_radiance(const struct set *s, int view)
{
    const struct extent *x = &s->extent[view];
    struct image im = {x->w, x->h, 3, place_of(s, view)->radiance + 3 * x->at};
    struct exrfile_extra extra = {.depth = s->place.depth + x->at, .cam = &s->place.cams[view]};
    char name[NAME_CAP], path[FILE_PATH_CAP];
    snprintf(name, sizeof name, "images_hdr/%s_hdr_%03d.exr",
             sample_is_input(&s->a->sample, view) ? "train" : "test",
             sample_number(&s->a->sample, view));
    err_t e = file_join(s->dir, name, path);
    return e ? e : exrfile_write(path, &im, &extra, NULL);
}

/* s->seen of a view through its optics, and its white balance. */
static void pass_camera(const struct set *s, int view)
{
    const struct optics *o = sample_optics(&s->a->sample, view);
    const size_t n = extent_pixels(&s->extent[view]);
    if (o && optics_dims(o))
        optics_apply(o, s->seen);
    for (int c = 0; c < 3 && s->a->balance > 0; c++) {
        const float gain = exp2f(balance_of(s->a, view, c));
        for (size_t i = 0; i < n; i++)
            s->seen[(size_t)c * n + i] *= gain;
    }
}

/* The radiance that the sensor of a view gets. */
static const float *seen_radiance(const struct set *s, int view)
{
    const struct optics *o = sample_optics(&s->a->sample, view);
    const struct extent *x = &s->extent[view];
    const float *radiance = place_of(s, view)->radiance + 3 * x->at;
    if (!(o && optics_dims(o)) && !(s->a->balance > 0))
        return radiance;
    memcpy(s->seen, radiance, 3 * extent_pixels(x) * sizeof *s->seen);
    pass_camera(s, view);
    return s->seen;
}

static err_t write_mask(const struct set *s, int view, int k)
{
    const struct extent *x = &s->extent[view];
    const size_t n = extent_pixels(x);
    struct image8 im = {x->w, x->h, 3, s->mask + n};
    char name[NAME_CAP], path[FILE_PATH_CAP], folder[FILE_PATH_CAP];
    for (size_t i = 0; i < 3 * n; i++)
        im.px[i] = s->mask[i / 3];
    picture_name(&s->a->sample, view, k, name);
    err_t e = file_join(s->dir, "truth/masks", folder);
    if (!e)
        e = file_join(folder, name, path);
    return e ? e : img_write_png(path, &im);
}

/* The photograph `k` of a view again, with somebody who passes by. */
static err_t pass_by(const struct run *r, const struct set *s, const struct sample_camera *cam,
                     int view, int k)
{
    const float stops[1] = {s->a->stops[k] + light_of(s->a, view, k)};
    const struct dataset_request *a = s->a;
    const struct optics *o = sample_optics(&a->sample, view);
    const struct extent *x = &s->extent[view];
    const size_t n = 3 * extent_pixels(x);
    struct sample_camera one = *cam;
    struct render_quality quality = a->sample.quality;
    const struct passer_shot shot = {&s->place.cams[view], &quality,
                                     (uint64_t)(view * DATASET_EXPOSURES + k)};
    quality.lens = o && lens_distorts(&o->lens) ? &o->lens : NULL;
    one.first = (uint64_t)k;
    memcpy(s->seen, place_of(s, view)->radiance + 3 * x->at, n * sizeof *s->seen);
    err_t e = passer_draw(r, place_of(s, view)->world, &a->passer, &shot, s->seen, s->mask);
    if (!e)
        pass_camera(s, view);
    if (!e)
        e = sample_expose(r, &one, s->seen, 1, stops, s->px + n * (size_t)k);
    return e ? e : write_mask(s, view, k);
}

static err_t write_view(const struct run *r, const struct set *s, int view)
{
    const struct dataset_request *a = s->a;
    const struct sample_camera cam = {.w = s->extent[view].w,
                                      .h = s->extent[view].h,
                                      .key = s->place.key,
                                      .sensor = a->noise ? &sensor_default : NULL,
                                      .curve = &a->curve,
                                      .local = a->local,
                                      .seed = a->sample.seed * 1000 + (uint64_t)view};
    float stops[DATASET_EXPOSURES]; // brighter light is a longer exposure, but for dark current
    for (int k = 0; k < a->n_exposures; k++)
        stops[k] = a->stops[k] + light_of(a, view, k);
    err_t e = sample_expose(r, &cam, seen_radiance(s, view), a->n_exposures, stops, s->px);
    for (int k = 0; k < a->n_exposures && !e; k++)
        if (is_taken(a, view, k) && is_passed(a, view, k))
            e = pass_by(r, s, &cam, view, k);
    if (!e)
        e = write_pictures(s, view);
    return e || (sample_is_input(&a->sample, view) && !a->input_truth) ? e
                                                                       : write_radiance(s, view);
}

/* ---- text ---- */

static err_t open_text(const struct set *s, const char *name, char path[FILE_PATH_CAP], FILE **out)
{
    err_t e = file_join(s->dir, name, path);
    return e ? e : file_create(path, out);
}

enum number { EXPOSURE, LIGHT, RED, BLUE, LAMP };

static double number_of(const struct dataset_request *a, enum number what, int view, int k)
{
    if (what == LIGHT)
        return (double)light_of(a, view, k);
    if (what == RED || what == BLUE)
        return (double)balance_of(a, view, what == RED ? 0 : 2);
    return what == LAMP ? (double)is_lit(a, view) : exp2((double)a->stops[k]);
}

/* A number of each photograph that is written, or of those of inputs: its exposure, stops of its
 * light, of red and of blue, whether the switched light is on. */
static err_t write_numbers(const struct set *s, const char *file, enum number what)
{
    const struct dataset_request *a = s->a;
    char path[FILE_PATH_CAP], name[NAME_CAP];
    const char *before = "{\n";
    FILE *f;
    err_t e = open_text(s, file, path, &f);
    if (e)
        return e;
    for (int view = 0; view < a->sample.n_views; view++)
        for (int k = 0; k < a->n_exposures; k++) {
            if (!is_taken(a, view, k) || (what != EXPOSURE && !sample_is_input(&a->sample, view)))
                continue;
            picture_name(&a->sample, view, k, name);
            fprintf(f, "%s \"%s\": %.9g", before, name, number_of(a, what, view, k));
            before = ",\n";
        }
    fputs("\n}\n", f);
    return file_finish(f, path);
}

/* COLMAP's text model without points; each camera is written for one picture of its view, which
 * stands for all of them. */
static err_t write_images(const struct set *s)
{
    char path[FILE_PATH_CAP], name[NAME_CAP];
    FILE *f;
    err_t e = open_text(s, "sparse/0/images.txt", path, &f);
    if (e)
        return e;
    for (int view = 0; view < s->a->sample.n_views; view++) {
        const struct camera *c = &s->place.cams[view];
        picture_name(&s->a->sample, view, s->a->n_exposures / 2, name);
        fprintf(f, "%d", view + 1);
        for (int i = 0; i < 4; i++)
            fprintf(f, " %.9g", (double)c->q[i]);
        for (int i = 0; i < 3; i++)
            fprintf(f, " %.9g", (double)c->t[i]);
        fprintf(f, " %d %s\n\n", sample_camera_of(&s->a->sample, view) + 1, name);
    }
    return file_finish(f, path);
}

static void put_optics(const struct optics *o, int number, FILE *f)
{
    double values[LENS_PARAMS];
    const int n = lens_params(&o->lens, values);
    fprintf(f, "%d %s %d %d", number, lens_name(o->lens.model), o->w, o->h);
    for (int i = 0; i < n; i++)
        fprintf(f, " %.17g", values[i]);
    fputc('\n', f);
}

static err_t write_cameras(const struct set *s)
{
    const struct camera *c = &s->place.cams[0];
    char path[FILE_PATH_CAP];
    FILE *f;
    err_t e = open_text(s, "sparse/0/cameras.txt", path, &f);
    if (e)
        return e;
    for (int i = 0; i < s->a->sample.n_optics; i++)
        put_optics(&s->a->sample.optics[i], i + 1, f);
    if (s->a->sample.n_optics == 0)
        fprintf(f, "1 PINHOLE %d %d %.9g %.9g %.9g %.9g\n", c->w, c->h, (double)c->fx,
                (double)c->fy, (double)c->cx, (double)c->cy);
    e = file_finish(f, path);
    if (!e)
        e = open_text(s, "sparse/0/points3D.txt", path, &f);
    return e ? e : file_finish(f, path);
}

static err_t make_folders(const struct set *s)
{
    static const char *const names[] = {"images",   "images_hdr", "sparse",
                                        "sparse/0", "truth",      "truth/masks"};
    const struct dataset_request *a = s->a;
    const bool truth = a->flicker > 0 || a->balance > 0 || a->sample.switched != SAMPLE_NO_SWITCH;
    const int n = a->passer.share > 0 ? 6 : truth ? 5 : 4;
    char path[FILE_PATH_CAP];
    for (int i = 0; i < n; i++) {
        err_t e = file_join(s->dir, names[i], path);
        if (e)
            return e;
        if (mkdir(path, 0777) != 0)
            return err_fail(file_code(errno), "%s: %s", path, strerror(errno));
    }
    return OK;
}

/* ---- all ---- */

static err_t check_request(const struct dataset_request *a)
{
    if (a->n_exposures < 1 || a->n_exposures > DATASET_EXPOSURES)
        return err_fail(ERR_ARG, "data set: %d exposures, allowed are 1 to %d", a->n_exposures,
                        DATASET_EXPOSURES);
    for (int k = 0; k < a->n_exposures; k++)
        if (!(fabsf(a->stops[k]) <= 40))
            return err_fail(ERR_ARG, "data set: exposure of 2^%g, allowed are 2^-40 to 2^40",
                            (double)a->stops[k]);
    if (!(a->lit >= 0 && a->lit <= 1))
        return err_fail(ERR_ARG, "data set: light is on in a share of %g, allowed are 0 to 1",
                        (double)a->lit);
    if (!(a->flicker >= 0 && (double)a->flicker <= DATASET_FLICKER_MAX))
        return err_fail(ERR_ARG, "data set: flicker of %g stops, allowed are 0 to %g",
                        (double)a->flicker, DATASET_FLICKER_MAX);
    return a->balance >= 0 && (double)a->balance <= DATASET_FLICKER_MAX
               ? OK
               : err_fail(ERR_ARG, "data set: white balance off by %g stops, allowed are 0 to %g",
                          (double)a->balance, DATASET_FLICKER_MAX);
}

static err_t alloc_set(struct arena *keep, struct set *s)
{
    const struct dataset_request *a = s->a;
    size_t largest;
    const size_t all = all_pixels(a, &largest);
    err_t e = arena_alloc(keep, all * 3, sizeof(float), &s->place.radiance);
    if (!e)
        e = arena_alloc(keep, all, sizeof(float), &s->place.depth);
    if (!e && a->sample.switched != SAMPLE_NO_SWITCH)
        e = arena_alloc(keep, all * 3, sizeof(float), &s->lit.radiance);
    if (!e && (a->sample.n_optics > 0 || a->passer.share > 0 || a->balance > 0))
        e = arena_alloc(keep, largest, 3 * sizeof *s->seen, &s->seen);
    if (!e && a->passer.share > 0)
        e = arena_alloc(keep, largest, 4, &s->mask);
    if (!e)
        e = arena_alloc(keep, largest, 3 * DATASET_EXPOSURES, &s->px);
    if (!e)
        e = arena_alloc(keep, (size_t)a->sample.n_views, sizeof *s->place.cams, &s->place.cams);
    return e;
}

void dataset_plan(struct plan *p, const struct dataset_request *a)
{
    struct set s = {.a = a};
    const size_t mark = arena_mark(&p->keep);
    (void)alloc_set(&p->keep, &s); // a counter is never full
    const size_t none = arena_mark(&p->tmp);
    struct plan one = plan_begin(p->threads);
    sample_plan(&one, &a->sample, a->local);
    if (a->sample.switched != SAMPLE_NO_SWITCH)
        arena_hold(&p->tmp, one.tmp.peak);
    arena_step(&p->tmp, one.tmp.peak);
    arena_reset(&p->tmp, none);
    arena_reset(&p->keep, mark);
}

static err_t open_places(const struct run *r, struct set *s)
{
    struct sample_scene on = s->a->sample;
    err_t e = OK;
    s->lit.cams = s->place.cams;
    if (on.switched != SAMPLE_NO_SWITCH) {
        on.switched = SAMPLE_ON;
        e = sample_open(r, &on, &s->lit);
    }
    return e ? e : sample_open(r, &s->a->sample, &s->place);
}

err_t dataset_write(const struct run *r, const struct dataset_request *a, const char *dir)
{
    struct set s = {.a = a, .dir = dir};
    const size_t mark = arena_mark(r->keep), scratch = arena_mark(r->tmp);
    err_t e = check_request(a);
    sample_extents(&a->sample, s.extent);
    if (!e)
        e = make_folders(&s);
    if (!e)
        e = alloc_set(r->keep, &s);
    if (!e)
        e = open_places(r, &s);
    for (int view = 0; view < a->sample.n_views && !e; view++) {
        e = run_check(r, "data set");
        if (!e)
            e = write_view(r, &s, view);
        if (!e && r->progress)
            r->progress(r->progress_ctx, "write", view + 1, a->sample.n_views, NULL);
    }
    if (!e)
        e = write_numbers(&s, "exposure.json", EXPOSURE);
    if (!e && a->flicker > 0)
        e = write_numbers(&s, "truth/light.json", LIGHT);
    if (!e && a->balance > 0)
        e = write_numbers(&s, "truth/red.json", RED);
    if (!e && a->balance > 0)
        e = write_numbers(&s, "truth/blue.json", BLUE);
    if (!e && a->sample.switched != SAMPLE_NO_SWITCH)
        e = write_numbers(&s, "truth/lamp.json", LAMP);
    if (!e)
        e = write_images(&s);
    if (!e)
        e = write_cameras(&s);
    arena_reset(r->tmp, scratch);
    arena_reset(r->keep, mark);
    return e;
}
