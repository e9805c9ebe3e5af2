#include "drivers/format/imageset.h"

#include "core/base/num.h"
#include "core/photo/undistort.h"
#include "drivers/format/brackets.h"
#include "drivers/format/exiftimes.h"
#include "drivers/format/exposures.h"
#include "drivers/format/img.h"
#include "drivers/format/imgsize.h"
#include "drivers/format/json.h"
#include "drivers/format/layout.h"
#include "drivers/format/llff.h"
#include "drivers/format/masks.h"
#include "drivers/format/name.h"
#include "drivers/format/namelist.h"
#include "drivers/format/pixels.h"
#include "drivers/format/rigfile.h"
#include "drivers/format/suffix.h"

#include <dirent.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>

void imageset_free(struct imageset *set)
{
    for (int i = 0; i < set->capture.n; i++)
        img_free(&set->capture.shots[i].image);
    free(set->capture.shots);
    free(set->part);
    free(set->raw);
    memset(set, 0, sizeof *set);
}

/* ---- the folder ---- */

static bool has_prefix(const char *name, const char *prefix)
{
    return strncmp(name, prefix, strlen(prefix)) == 0;
}

/* What the last note says, unless another does. */
static void keep_note(struct imageset *set)
{
    const char *note = set->notes[set->n_notes];
    for (int i = 0; i < set->n_notes; i++)
        if (strcmp(note, set->notes[i]) == 0)
            return;
    set->n_notes++;
}

/* Sentence "N files are not read (names): why", once. */
static void add_note(const struct namelist *l, const char *why, struct imageset *set)
{
    char text[128];
    if (l->n == 0 || set->n_notes == IMAGESET_NOTES)
        return;
    char *note = set->notes[set->n_notes];
    snprintf(note, sizeof set->notes[0], "%d file%s not read (%s): %s", l->n,
             l->n > 1 ? "s are" : " is", namelist_text(l, text, sizeof text), why);
    keep_note(set);
}

static const char only_png_jpeg[] =
    "pictures must be PNG, JPEG or TIFF, or all HEIC, all raw (DNG, CR2, NEF, ARW) or all EXR";

static err_t find_pictures(const char *images, char dir[FILE_PATH_CAP])
{
    static const char *const inside[] = {"images", LLFF_PICTURES};
    for (int i = 0; i < 2; i++) {
        err_t e = file_join(images, inside[i], dir);
        if (e || file_is_dir(dir))
            return e;
    }
    if (!file_is_dir(images))
        return err_fail(ERR_IO, "%s: %s", images,
                        file_exists(images) ? "not a folder" : "no such folder");
    memcpy(dir, images, strlen(images) + 1); // file_join has checked the length
    return OK;
}

static err_t add_picture(const char *dir, const char *name, struct namelist *odd, struct capture *c)
{
    char path[FILE_PATH_CAP];
    err_t e = file_join(dir, name, path);
    if (!e && !file_is_regular(path) && !file_is_dir(path))
        namelist_add(name, odd);
    if (e || !file_is_regular(path))
        return e;
    if (c->n == CAMERAS_MAX)
        return err_fail(ERR_FORMAT, "%s: more than %d pictures", dir, CAMERAS_MAX);
    struct shot *s = &c->shots[c->n];
    e = name_copy(dir, name, strlen(name), s->name);
    c->n += !e;
    return e;
}

static int by_name(const void *a, const void *b)
{
    return strcmp(((const struct shot *)a)->name, ((const struct shot *)b)->name);
}

static err_t scan_folder(struct imageset *set)
{
    struct capture *c = &set->capture;
    c->shots = calloc(CAMERAS_MAX, sizeof *c->shots);
    if (!c->shots)
        return err_fail(ERR_NOMEM, "%s: no memory for the list of pictures", set->dir);
    DIR *d = opendir(set->dir);
    if (!d)
        return err_fail(ERR_IO, "%s: %s", set->dir, strerror(errno));
    struct namelist other = {0}, odd = {0};
    err_t e = OK;
    bool (*const kind[])(const char *name) = {suffix_is_picture, suffix_is_heic, suffix_is_raw,
                                              suffix_is_exr};
    for (int k = 0; k < 4 && c->n == 0 && !e; k++) {
        other = (struct namelist){0};
        rewinddir(d);
        for (struct dirent *entry; !e && (entry = readdir(d));) {
            if (kind[k](entry->d_name))
                e = add_picture(set->dir, entry->d_name, &odd, c);
            else if (suffix_is_other(entry->d_name))
                namelist_add(entry->d_name, &other);
        }
    }
    closedir(d);
    add_note(&other, only_png_jpeg, set);
    add_note(&odd, "no regular files, or links to nothing", set);
    if (!e && c->n > 0)
        qsort(c->shots, (size_t)c->n, sizeof *c->shots, by_name);
    return e;
}

/* Pictures in the folder that holds images/. */
static void note_beside(const char *images, struct imageset *set)
{
    struct namelist beside = {0};
    DIR *d = strcmp(images, set->dir) != 0 ? opendir(images) : NULL;
    if (!d)
        return;
    for (struct dirent *entry; (entry = readdir(d));)
        if (suffix_is_picture(entry->d_name))
            namelist_add(entry->d_name, &beside);
    closedir(d);
    add_note(&beside, "they lie beside the folder images, which alone is looked into", set);
}

static void note_masks(struct imageset *set)
{
    struct namelist strange = {0};
    masks_strange(set->dir, &set->capture, &strange);
    add_note(&strange, "in masks, but no photograph has their name", set);
}

static bool is_released(const struct capture *c)
{
    for (int i = 0; i < c->n; i++)
        if (has_prefix(c->shots[i].name, "train"))
            return true;
    return false;
}

static err_t filter_pictures(const struct imageset_request *rq, bool released, struct imageset *set)
{
    static const char *const prefix[] = {"train", "test", ""};
    struct capture *c = &set->capture;
    struct namelist neither = {0};
    int all = c->n, n = 0;
    for (int i = 0; i < all; i++) {
        const char *name = c->shots[i].name;
        if (released && !has_prefix(name, prefix[IMAGESET_TRAIN]) &&
            !has_prefix(name, prefix[IMAGESET_TEST]))
            namelist_add(name, &neither);
        if (released ? has_prefix(name, prefix[rq->which]) : rq->which != IMAGESET_TEST)
            c->shots[n++] = c->shots[i];
    }
    c->n = n;
    if (rq->which != IMAGESET_ALL)
        add_note(&neither, "beside pictures called train..., only train... and test... count", set);
    if (n > 0)
        return OK;
    if (all == 0)
        return err_fail(ERR_FORMAT,
                        "%s: no pictures (*.png, *.jpg, *.jpeg, *.tif, *.tiff, *.heic, *.dng, "
                        "*.cr2, *.nef, *.arw, *.exr) in it%s%s",
                        set->dir, set->n_notes ? "; " : "", set->n_notes ? set->notes[0] : "");
    return err_fail(ERR_FORMAT, "%s: none of its %d pictures is a \"%s\" picture", set->dir, all,
                    prefix[rq->which]);
}

/* ---- exposures ---- */

/* Note the files that have a time but no picture's name. */
static void note_timed(const struct exposures *x, struct imageset *set)
{
    char path[FILE_PATH_CAP];
    struct namelist other = {0};
    for (int i = 0; i < x->n; i++) {
        const char *name = x->v[i].name;
        if (!suffix_is_picture(name) && !suffix_is_other(name) &&
            file_join(set->dir, name, path) == OK && file_is_regular(path))
            namelist_add(name, &other);
    }
    add_note(&other, only_png_jpeg, set);
}

static err_t times_from_file(const char *path, struct imageset *set)
{
    struct exposures x;
    err_t e = exposures_read(path, &x);
    if (e)
        return e;
    for (int i = 0; i < set->capture.n; i++)
        set->capture.shots[i].exposure = exposures_find(&x, set->capture.shots[i].name);
    note_timed(&x, set);
    exposures_free(&x);
    return OK;
}

static err_t check_times(const char *source, const struct capture *c)
{
    char text[128];
    struct namelist lacking = {0};
    for (int i = 0; i < c->n; i++)
        if (!(c->shots[i].exposure > 0))
            namelist_add(c->shots[i].name, &lacking);
    if (lacking.n == 0)
        return OK;
    namelist_text(&lacking, text, sizeof text);
    if (!source)
        return err_fail(ERR_FORMAT, "EXIF has no exposure for %s, of %d pictures: " EXIFTIMES_WRITE,
                        text, c->n);
    return err_fail(ERR_FORMAT, "%s: no exposure for %s, of %d pictures: add one for each", source,
                    text, c->n);
}

/* Photographs whose data a program removed, frames of a film. */
static void assume_times(struct imageset *set)
{
    if (!exiftimes_assume(&set->capture) || set->n_notes == IMAGESET_NOTES)
        return;
    snprintf(set->notes[set->n_notes], sizeof set->notes[0],
             "no picture has an exposure in its EXIF: all are taken for photographs of one "
             "exposure; if they are not, " EXIFTIMES_WRITE);
    keep_note(set);
}

static err_t get_times(const struct imageset_request *rq, struct imageset *set)
{
    char path[FILE_PATH_CAP];
    bool found;
    const char *source = rq->exposures;
    err_t e = OK;
    if (!source) {
        e = file_companion(set->dir, "exposure.json", &found, path);
        if (e)
            return e;
        source = found ? path : NULL;
    }
    found = false;
    if (!source)
        e = layout_times(set->dir, rq->no_cameras ? NULL : rq->rig, &set->capture, &found);
    if (e || found)
        return e;
    e = source ? times_from_file(source, set)
               : exiftimes_read(set->dir, rq->may_lack_times, &set->capture);
    if (e || rq->may_lack_times)
        return e;
    if (!source)
        assume_times(set);
    return check_times(source, &set->capture);
}

static int by_time(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Keep the pictures whose time is in `mask`; `time` is scratch for all of them. */
static err_t keep_times(const char *dir, uint32_t mask, double *time, struct capture *c)
{
    int n = 0, all = c->n, highest = 31 - __builtin_clz(mask);
    for (int i = 0; i < all; i++)
        time[i] = c->shots[i].exposure;
    qsort(time, (size_t)all, sizeof *time, by_time);
    for (int i = 0; i < all; i++)
        if (n == 0 || time[i] > time[n - 1])
            time[n++] = time[i];
    if (highest >= n)
        return err_fail(ERR_ARG, "%s: exposure %d requested, its pictures have %d different ones",
                        dir, highest + 1, n);
    c->n = 0;
    for (int i = 0; i < all; i++) {
        const double *rank = bsearch(&c->shots[i].exposure, time, (size_t)n, sizeof *time, by_time);
        if (rank - time < 32 && mask >> (rank - time) & 1)
            c->shots[c->n++] = c->shots[i];
    }
    return OK;
}

/* The ranks count all pictures of the folder, so that they mean the same for train and test. */
static err_t choose_times(const struct imageset_request *rq, struct imageset *set)
{
    if (!rq->exposure_set || set->capture.n == 0)
        return OK;
    err_t e = get_times(rq, set);
    if (e)
        return e;
    double *time = malloc((size_t)set->capture.n * sizeof *time);
    if (!time)
        return err_fail(ERR_NOMEM, "%s: no memory for %d times", set->dir, set->capture.n);
    e = keep_times(set->dir, rq->exposure_set, time, &set->capture);
    free(time);
    return e;
}

/* ---- which pictures ---- */

/* Shots [from, *to) are the exposures of one view. */
static int end_of_view(const struct capture *c, bool released, int from)
{
    int to = from + 1;
    while (released && to < c->n && name_same_view(c->shots[from].name, c->shots[to].name))
        to++;
    return to;
}

static int count_views(const struct capture *c, bool released)
{
    int n = 0;
    for (int i = 0; i < c->n; i = end_of_view(c, released, i))
        n++;
    return n;
}

/* Index of the shot with the `rank`th shortest exposure of [from, to); equal times by name. */
static int shot_of_rank(const struct shot *s, int from, int to, int rank)
{
    for (int i = from; i < to; i++) {
        int shorter = 0;
        for (int j = from; j < to; j++)
            shorter += s[j].exposure < s[i].exposure || (s[j].exposure == s[i].exposure && j < i);
        if (shorter == rank)
            return i;
    }
    return from;
}

static bool is_spread_choice(int i_view, int n_views, int n)
{
    if (n >= n_views)
        return true;
    if (n == 1)
        return i_view == n_views / 2;
    for (int k = 0; k < n; k++)
        if ((2 * k * (n_views - 1) + n - 1) / (2 * (n - 1)) == i_view)
            return true;
    return false;
}

static void choose_spread(const struct imageset_request *rq, bool released, int n_views,
                          struct capture *c, bool *keep)
{
    int i_view = 0, turn = 0, n = rq->n_views ? rq->n_views : n_views;
    for (int from = 0, to; from < c->n; from = to, i_view++) {
        to = end_of_view(c, released, from);
        if (!is_spread_choice(i_view, n_views, n))
            continue;
        int m = to - from;
        int ranks[3] = {m / 2, 0, m - 1};
        int chosen = shot_of_rank(c->shots, from, to, ranks[turn++ % 3]);
        for (int i = from; i < to; i++)
            keep[i] = rq->every_exposure || rq->brackets || i == chosen;
    }
}

static err_t choose_named(const char *path, const struct cJSON *names, const struct capture *c,
                          bool *keep)
{
    for (const struct cJSON *v = json_first(names); v; v = json_next(v)) {
        const char *name = json_string(v);
        if (!name)
            return err_fail(ERR_FORMAT, "%s: \"inputs\" must be lists of file names", path);
        int i = 0;
        while (i < c->n && strcmp(c->shots[i].name, name) != 0)
            i++;
        if (i == c->n)
            return err_fail(ERR_FORMAT, "%s: input %.127s is not among the %d pictures", path, name,
                            c->n);
        if (keep[i])
            return err_fail(ERR_FORMAT, "%s: input %.127s is listed twice", path, name);
        keep[i] = true;
    }
    return OK;
}

/* *listed is false if there is no protocol.json or it says nothing about n views. */
static err_t choose_by_protocol(const struct imageset *set, int n, bool *keep, bool *listed)
{
    char path[FILE_PATH_CAP], key[16];
    struct cJSON *doc;
    err_t e = file_companion(set->dir, "protocol.json", listed, path);
    if (e || !*listed)
        return e;
    e = json_read(path, &doc);
    if (e)
        return e;
    snprintf(key, sizeof key, "%d", n);
    const struct cJSON *names = json_member(json_member(doc, "inputs"), key);
    *listed = json_is_array(names) && json_count(names) > 0;
    if (*listed)
        e = choose_named(path, names, &set->capture, keep);
    json_free(doc);
    return e;
}

/* Keep the shots with keep[i] set, in order. */
static void keep_shots(struct capture *c, const bool *keep)
{
    int n = 0;
    for (int i = 0; i < c->n; i++)
        if (keep[i])
            c->shots[n++] = c->shots[i];
    c->n = n;
}

/* Keep the pictures that are asked for, and mark those that show a place again. */
static err_t choose_pictures(const struct imageset_request *rq, bool released, struct imageset *set)
{
    int n_views = count_views(&set->capture, released), n = rq->n_views ? rq->n_views : n_views;
    if (n < 1 || n > n_views)
        return err_fail(ERR_ARG, "%s: %d views requested, there are %d", set->dir, rq->n_views,
                        n_views);
    bool *keep = calloc((size_t)set->capture.n, sizeof *keep), listed = false;
    if (!keep)
        return err_fail(ERR_NOMEM, "%s: no memory for %d pictures", set->dir, set->capture.n);
    err_t e = OK;
    if (released && rq->which == IMAGESET_TRAIN && !rq->every_exposure && !rq->exposure_set)
        e = choose_by_protocol(set, n, keep, &listed);
    if (!e && !listed)
        choose_spread(rq, released, n_views, &set->capture, keep);
    if (!e)
        keep_shots(&set->capture, keep);
    for (int i = 1; i < set->capture.n && released && rq->brackets && !e; i++)
        set->capture.shots[i].again =
            name_same_view(set->capture.shots[i - 1].name, set->capture.shots[i].name);
    free(keep);
    return e;
}

/* ---- sizes and cameras ---- */

/* The file of shot i. */
static err_t picture_path(const struct imageset *set, int i, char path[FILE_PATH_CAP])
{
    const char *dir = set->dir, *name = set->capture.shots[i].name;
    for (int k = 0; k < set->n_parts && set->part[k].first <= i; k++) {
        dir = set->part[k].dir;
        name = set->capture.shots[i].name + set->part[k].skip;
    }
    return file_join(dir, name, path);
}

static err_t get_sizes(const struct imageset_request *rq, struct imageset *set)
{
    struct shot *s = set->capture.shots;
    for (int i = 0; i < set->capture.n; i++) {
        char path[FILE_PATH_CAP];
        err_t e = file_join(set->dir, s[i].name, path);
        if (!e)
            e = imgsize_read(path, &s[i].image.w, &s[i].image.h);
        if (!e)
            e = pixels_look(path, &s[i]);
        if (!e && s[i].linear != s[0].linear)
            e = err_fail(ERR_FORMAT, "%s: %s, unlike %s: all must be of one kind", path,
                         s[i].linear ? "linear values" : "display values", s[0].name);
        if (e)
            return e;
        s[i].image.channels = 3;
        s[i].taken_w = s[i].image.w;
        s[i].taken_h = s[i].image.h;
        e = physcam_read(path, rq->lenses, &s[i]);
        if (!e)
            e = masks_look(path, &s[i]);
        if (e)
            return e;
        if (s[i].again) // exposures of one place are of one camera
            memcpy(s[i].camera_id, s[i - 1].camera_id, sizeof s[i].camera_id);
    }
    return OK;
}

/* Its camera by the name that has one, and the size that it has once it is undistorted. */
static err_t give_camera(const char *source, const struct rig *rig, const char *path,
                         const char *name, struct shot *s)
{
    struct cameras_picture picture = {name, s->taken_w, s->taken_h, 1};
    struct rig_view v;
    err_t e = imgsize_orientation(path, &picture.orientation);
    if (!e)
        e = cameras_find(source, rig, &picture, &v);
    if (e)
        return e;
    s->cam = v.cam;
    s->lens = v.lens;
    s->has_camera = true;
    s->calibrated = v.has_deviation;
    s->metres = rig->metres;
    if (s->lens.model != LENS_PINHOLE)
        e = undistort_camera(s->name, &s->lens, s->taken_w, s->taken_h, &s->cam);
    s->image.w = s->cam.w;
    s->image.h = s->cam.h;
    return e;
}

/* Keep the pictures that have a camera, or whose place has one. */
static err_t keep_placed(const char *source, const struct rig *rig, struct imageset *set)
{
    struct capture *c = &set->capture;
    bool has = false;
    int n = 0;
    for (int i = 0; i < c->n; i++) {
        bool own;
        err_t e = cameras_has(source, rig, c->shots[i].name, &own);
        if (e)
            return e;
        has = own || (c->shots[i].again && has);
        if (has)
            c->shots[n++] = c->shots[i];
        for (int k = 0; k < set->n_parts && !has; k++)
            set->part[k].first -= set->part[k].first > n;
    }
    set->n_unplaced = c->n - n;
    c->n = n;
    return n > 0 ? OK
                 : err_fail(ERR_FORMAT, "%s: no camera for any of %d pictures", source,
                            set->n_unplaced);
}

static err_t decode_shot(void *set, int i, struct image8 *out)
{
    return imageset_decode(set, i, out);
}

/* Further exposures of a place have the camera of the first. */
static err_t give_cameras(const char *source, const struct rig *rig, struct imageset *set)
{
    const struct capture *c = &set->capture;
    char path[FILE_PATH_CAP];
    err_t e = OK;
    for (int i = 0, named = 0; i < c->n && !e; i++) {
        bool has;
        e = cameras_has(source, rig, c->shots[i].name, &has);
        named = has || !c->shots[i].again ? i : named;
        if (!e)
            e = picture_path(set, i, path);
        if (!e)
            e = give_camera(source, rig, path, c->shots[named].name, &c->shots[i]);
    }
    return e;
}

/* plain: a folder whose names tell of no brackets. */
static err_t get_cameras(const struct imageset_request *rq, bool plain, struct imageset *set)
{
    char found_path[FILE_PATH_CAP];
    const char *source = rq->rig;
    const struct prep_source from = {.decode = decode_shot, .release = img_free, .ctx = set};
    bool found = !rq->no_cameras;
    err_t e = OK;
    if (found && !source) {
        e = rigfile_find(set->dir, &found, found_path);
        source = found_path;
    }
    if (e || !found)
        return e || !plain || !rq->brackets ? e : brackets_mark(&set->capture, &from);
    struct rig rig;
    e = rigfile_read(source, &rig);
    if (!e && plain && (rq->brackets || rq->some_cameras))
        e = brackets_mark_lacking(source, &rig, &from, &set->capture);
    if (!e && rq->some_cameras)
        e = keep_placed(source, &rig, set);
    if (!e)
        e = give_cameras(source, &rig, set);
    cameras_free(&rig);
    if (e == ERR_FORMAT && !rq->rig)
        e = err_fail(e, "%s; it was found beside the pictures: --rig none does without it",
                     err_text());
    return e;
}

/* ---- all together ---- */

static err_t list_folder(const struct imageset_request *rq, struct imageset *out)
{
    memset(out, 0, sizeof *out);
    bool released = false, bracketed = false;
    err_t e = find_pictures(rq->images, out->dir);
    if (!e)
        e = scan_folder(out);
    if (!e) {
        note_beside(rq->images, out);
        note_masks(out);
        released = is_released(&out->capture);
        e = choose_times(rq, out);
    }
    if (!e && !released)
        e = layout_is_bracketed(out->dir, &bracketed);
    if (!e && bracketed && rq->which != IMAGESET_ALL)
        layout_keep_half(rq->which == IMAGESET_TRAIN, &out->capture);
    if (!e && !bracketed)
        e = filter_pictures(rq, released, out);
    if (!e)
        e = get_times(rq, out);
    if (!e)
        e = choose_pictures(rq, released || bracketed, out);
    if (!e)
        e = get_sizes(rq, out);
    if (!e)
        e = get_cameras(rq, !released && !bracketed, out);
    if (e)
        imageset_free(out);
    return e;
}

/* ---- several folders ---- */

/* Last part of a path, without slashes behind it. */
static err_t folder_name(const char *path, char out[NAME_CAP])
{
    size_t n = strlen(path);
    while (n > 1 && path[n - 1] == '/')
        n--;
    const char *slash = memrchr(path, '/', n), *from = slash ? slash + 1 : path;
    return name_copy(path, from, n - (size_t)(from - path), out);
}

static err_t check_folder(const char *images)
{
    char dir[FILE_PATH_CAP], path[FILE_PATH_CAP];
    bool found;
    err_t e = find_pictures(images, dir);
    if (!e)
        e = file_companion(dir, "exposure.json", &found, path);
    if (!e && !found)
        e = err_fail(ERR_ARG, "%s: has no exposure.json, which each of several folders needs",
                     images);
    return e;
}

/* The shots of one more folder, with its name before theirs. */
static err_t append_folder(const char *images, const struct imageset *one, struct imageset *all)
{
    char folder[NAME_CAP], name[2 * NAME_CAP];
    struct capture *c = &all->capture;
    struct imageset_part *part = &all->part[all->n_parts];
    err_t e = folder_name(images, folder);
    memcpy(part->dir, one->dir, sizeof part->dir);
    part->first = c->n;
    part->skip = strlen(folder) + 1;
    for (int i = 0; i < one->capture.n && !e; i++) {
        if (c->n == CAMERAS_MAX)
            return err_fail(ERR_FORMAT, "%s: more than %d pictures with those before", images,
                            CAMERAS_MAX);
        struct shot *s = &c->shots[c->n++];
        *s = one->capture.shots[i];
        int n = snprintf(name, sizeof name, "%s_%s", folder, one->capture.shots[i].name);
        e = name_copy(images, name, (size_t)n, s->name);
    }
    for (int i = 0; i < part->first && !e; i++)
        for (int k = part->first; k < c->n && !e; k++)
            if (strcmp(c->shots[i].name, c->shots[k].name) == 0)
                e = err_fail(ERR_ARG, "%s: another folder has its name and a picture %s", images,
                             c->shots[k].name + part->skip);
    all->n_parts++;
    return e;
}

static err_t add_folder(const struct imageset_request *rq, struct imageset *all)
{
    struct imageset one;
    err_t e = check_folder(rq->images);
    if (!e)
        e = list_folder(rq, &one);
    if (e)
        return e;
    e = append_folder(rq->images, &one, all);
    if (!all->dir[0])
        memcpy(all->dir, one.dir, sizeof all->dir);
    for (int i = 0; i < one.n_notes && all->n_notes < IMAGESET_NOTES; i++)
        memcpy(all->notes[all->n_notes++], one.notes[i], sizeof one.notes[i]);
    imageset_free(&one);
    return e;
}

static err_t list_folders(const struct imageset_request *rq, struct imageset *out)
{
    struct imageset_request each = *rq;
    size_t n = 1;
    memset(out, 0, sizeof *out);
    if (rq->exposures || rq->n_views || rq->exposure_set)
        return err_fail(ERR_ARG, "a file of exposures and a choice of pictures go with one folder, "
                                 "not with several");
    while (rq->more[n - 1])
        n++;
    each.no_cameras = true;
    out->part = calloc(n, sizeof *out->part);
    out->capture.shots = calloc(CAMERAS_MAX, sizeof *out->capture.shots);
    err_t e = out->part && out->capture.shots
                  ? OK
                  : err_fail(ERR_NOMEM, "%s: no memory for the list of pictures", rq->images);
    for (size_t i = 0; i < n && !e; i++) {
        each.images = i ? rq->more[i - 1] : rq->images;
        e = add_folder(&each, out);
    }
    if (!e && rq->rig)
        e = get_cameras(rq, false, out);
    if (e)
        imageset_free(out);
    return e;
}

err_t imageset_list(const struct imageset_request *rq, struct imageset *out)
{
    return rq->more && rq->more[0] ? list_folders(rq, out) : list_folder(rq, out);
}

static err_t decode8(const struct imageset *set, int i, bool taken, bool mask, struct image8 *out)
{
    char path[FILE_PATH_CAP];
    struct shot s = set->capture.shots[i];
    if (taken)
        s.lens.model = LENS_PINHOLE;
    *out = (struct image8){0};
    err_t e = picture_path(set, i, path);
    return e ? e : (mask ? pixels_decode_mask : pixels_decode)(path, &s, out);
}

err_t imageset_decode(const struct imageset *set, int i, struct image8 *out)
{
    return decode8(set, i, false, false, out);
}

err_t imageset_decode_taken(const struct imageset *set, int i, struct image8 *out)
{
    return decode8(set, i, true, false, out);
}

err_t imageset_decode16(const struct imageset *set, int i, struct image16 *out)
{
    char path[FILE_PATH_CAP];
    *out = (struct image16){0};
    err_t e = picture_path(set, i, path);
    return e ? e : pixels_decode16(path, &set->capture.shots[i], out);
}

err_t imageset_decode_mask(const struct imageset *set, int i, bool taken, struct image8 *out)
{
    return decode8(set, i, taken, true, out);
}

size_t imageset_bytes(const struct capture *c, int at_a_time)
{
    size_t sum = 0, most = 0, photo = 0;
    for (int i = 0; i < c->n; i++) {
        const struct shot *s = &c->shots[i];
        const bool distorted = s->lens.model != LENS_PINHOLE;
        size_t picture = arena_need((size_t)s->image.w, (size_t)s->image.h * 3);
        size_t taken = distorted ? arena_need((size_t)s->taken_w, (size_t)s->taken_h * 3) : 0;
        most = num_max_size(
            most, arena_add(arena_add(picture, taken),
                            (size_t)s->taken_w * (size_t)s->taken_h * (pixels_bytes(s) - 3)));
        photo = num_max_size(photo, taken);
        sum = arena_add(sum, picture);
    }
    return at_a_time < c->n ? most * (size_t)at_a_time : arena_add(sum, photo);
}

err_t imageset_load(struct imageset *set)
{
    for (int i = 0; i < set->capture.n; i++) {
        struct image8 image;
        err_t e = imageset_decode(set, i, &image);
        if (e)
            return e;
        img_free(&set->capture.shots[i].image);
        set->capture.shots[i].image = image;
    }
    return OK;
}
