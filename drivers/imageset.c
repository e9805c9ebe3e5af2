#include "drivers/imageset.h"

#include "drivers/cameras.h"
#include "drivers/colmap.h"
#include "drivers/exposures.h"
#include "drivers/img.h"
#include "drivers/imgsize.h"
#include "drivers/json.h"
#include "drivers/name.h"

#include <dirent.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

void imageset_free(struct imageset *set)
{
    for (int i = 0; i < set->capture.n; i++)
        img_free(&set->capture.shots[i].image);
    free(set->capture.shots);
    memset(set, 0, sizeof *set);
}

/* ---- the folder ---- */

static bool has_suffix(const char *name, const char *suffix)
{
    size_t n = strlen(name), k = strlen(suffix);
    return n > k && strcasecmp(name + n - k, suffix) == 0;
}

static bool is_picture(const char *name)
{
    return name[0] != '.' &&
           (has_suffix(name, ".png") || has_suffix(name, ".jpg") || has_suffix(name, ".jpeg"));
}

static bool begins(const char *name, const char *prefix)
{
    return strncmp(name, prefix, strlen(prefix)) == 0;
}

static err_t find_pictures(const char *images, char dir[FILE_PATH_CAP])
{
    err_t e = file_join(images, "images", dir);
    if (e || file_is_dir(dir))
        return e;
    if (!file_is_dir(images))
        return err_fail(ERR_IO, "%s: not a folder", images);
    memcpy(dir, images, strlen(images) + 1); // file_join has checked the length
    return OK;
}

/* Path of a companion beside the pictures or one folder up; *found is false if it is in neither. */
static err_t find_companion(const char *dir, const char *name, bool *found,
                            char path[FILE_PATH_CAP])
{
    char up[FILE_PATH_CAP];
    err_t e = file_join(dir, name, path);
    *found = !e && (file_is_regular(path) || file_is_dir(path));
    if (e || *found)
        return e;
    e = file_join(dir, "..", up);
    if (!e)
        e = file_join(up, name, path);
    *found = !e && (file_is_regular(path) || file_is_dir(path));
    return e;
}

static err_t add_picture(const char *dir, const char *name, struct capture *c)
{
    char path[FILE_PATH_CAP];
    err_t e = file_join(dir, name, path);
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

static err_t scan(struct imageset *set)
{
    struct capture *c = &set->capture;
    c->shots = calloc(CAMERAS_MAX, sizeof *c->shots);
    if (!c->shots)
        return err_fail(ERR_NOMEM, "%s: no memory for the list of pictures", set->dir);
    DIR *d = opendir(set->dir);
    if (!d)
        return err_fail(ERR_IO, "%s: %s", set->dir, strerror(errno));
    err_t e = OK;
    for (struct dirent *entry; !e && (entry = readdir(d));)
        if (is_picture(entry->d_name))
            e = add_picture(set->dir, entry->d_name, c);
    closedir(d);
    if (!e && c->n > 0)
        qsort(c->shots, (size_t)c->n, sizeof *c->shots, by_name);
    return e;
}

static bool is_released(const struct capture *c)
{
    for (int i = 0; i < c->n; i++)
        if (begins(c->shots[i].name, "train"))
            return true;
    return false;
}

/* Keep the shots with keep[i] set, in order. */
static void compact(struct capture *c, const bool *keep)
{
    int n = 0;
    for (int i = 0; i < c->n; i++)
        if (keep[i])
            c->shots[n++] = c->shots[i];
    c->n = n;
}

static err_t filter(const struct imageset_request *rq, bool released, struct imageset *set)
{
    static const char *const prefix[] = {"train", "test", ""};
    struct capture *c = &set->capture;
    int all = c->n, n = 0;
    for (int i = 0; i < all; i++)
        if (released ? begins(c->shots[i].name, prefix[rq->which]) : rq->which != IMAGESET_TEST)
            c->shots[n++] = c->shots[i];
    c->n = n;
    if (n > 0)
        return OK;
    if (all == 0)
        return err_fail(ERR_FORMAT, "%s: no pictures (*.png, *.jpg, *.jpeg) in it", set->dir);
    return err_fail(ERR_FORMAT, "%s: none of its %d pictures is a \"%s\" picture", set->dir, all,
                    prefix[rq->which]);
}

/* ---- exposures ---- */

static err_t times_from_file(const char *path, struct capture *c)
{
    struct exposures x;
    err_t e = exposures_read(path, &x);
    if (e)
        return e;
    for (int i = 0; i < c->n; i++)
        c->shots[i].exposure = exposures_find(&x, c->shots[i].name);
    exposures_free(&x);
    return OK;
}

static err_t times_from_exif(struct imageset *set)
{
    for (int i = 0; i < set->capture.n; i++) {
        struct shot *s = &set->capture.shots[i];
        char path[FILE_PATH_CAP];
        err_t e = file_join(set->dir, s->name, path);
        if (!e)
            e = img_exif_exposure(path, &s->exposure);
        if (e == ERR_FORMAT || e == ERR_UNSUPPORTED) // no such data: counted with the others below
            s->exposure = 0;
        else if (e)
            return e;
    }
    return OK;
}

static err_t check_times(const char *source, const struct capture *c)
{
    int lacking = 0, first = 0;
    for (int i = c->n - 1; i >= 0; i--) {
        if (c->shots[i].exposure > 0)
            continue;
        lacking++;
        first = i;
    }
    if (lacking == 0)
        return OK;
    return err_fail(ERR_FORMAT, "%s: no exposure for %s and %d others of %d pictures", source,
                    c->shots[first].name, lacking - 1, c->n);
}

static err_t get_times(const struct imageset_request *rq, struct imageset *set)
{
    char path[FILE_PATH_CAP];
    bool found;
    const char *source = rq->exposures;
    err_t e = OK;
    if (!source) {
        e = find_companion(set->dir, "exposure.json", &found, path);
        if (e)
            return e;
        source = found ? path : NULL;
    }
    e = source ? times_from_file(source, &set->capture) : times_from_exif(set);
    if (e)
        return e;
    if (rq->may_lack_times)
        return OK;
    return check_times(source ? source : "EXIF (no exposure.json found)", &set->capture);
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
        return err_fail(ERR_ARG, "%s: exposure %d asked, its pictures have %d different ones", dir,
                        highest + 1, n);
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
    err_t e = find_companion(set->dir, "protocol.json", listed, path);
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

static err_t choose(const struct imageset_request *rq, bool released, struct imageset *set)
{
    int n_views = count_views(&set->capture, released), n = rq->n_views ? rq->n_views : n_views;
    if (n < 1 || n > n_views)
        return err_fail(ERR_ARG, "%s: %d views asked, there are %d", set->dir, rq->n_views,
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
        compact(&set->capture, keep);
    for (int i = 1; i < set->capture.n && released && rq->brackets && !e; i++)
        set->capture.shots[i].again =
            name_same_view(set->capture.shots[i - 1].name, set->capture.shots[i].name);
    free(keep);
    return e;
}

/* ---- sizes and cameras ---- */

static err_t get_sizes(struct imageset *set)
{
    struct shot *s = set->capture.shots;
    for (int i = 0; i < set->capture.n; i++) {
        char path[FILE_PATH_CAP];
        err_t e = file_join(set->dir, s[i].name, path);
        if (!e)
            e = imgsize_read(path, &s[i].image.w, &s[i].image.h);
        if (e)
            return e;
        s[i].image.channels = 3;
        if (s[i].image.w != s[0].image.w || s[i].image.h != s[0].image.h)
            return err_fail(ERR_FORMAT, "%s: %s has %d x %d px but %s has %d x %d", set->dir,
                            s[0].name, s[0].image.w, s[0].image.h, s[i].name, s[i].image.w,
                            s[i].image.h);
    }
    return OK;
}

/* A COLMAP folder, or one that holds sparse/0. */
static err_t read_folder(const char *path, struct rig *out)
{
    char inner[FILE_PATH_CAP];
    err_t e = file_join(path, "sparse/0", inner);
    if (e)
        return e;
    return colmap_read(file_is_dir(inner) ? inner : path, out);
}

static err_t read_rig(const char *path, struct rig *out)
{
    *out = (struct rig){0};
    if (file_is_dir(path))
        return read_folder(path, out);
    if (has_suffix(path, ".json"))
        return cameras_read(path, out);
    return err_fail(ERR_UNSUPPORTED, "%s: a rig is a COLMAP folder or a cameras.json", path);
}

static err_t get_cameras(const struct imageset_request *rq, struct imageset *set)
{
    char path[FILE_PATH_CAP];
    bool found = true;
    const char *source = rq->rig;
    if (rq->no_cameras)
        return OK;
    if (!source) {
        err_t e = find_companion(set->dir, "sparse/0", &found, path);
        if (e || !found)
            return e;
        source = path;
    }
    struct rig rig;
    err_t e = read_rig(source, &rig);
    for (int i = 0; i < set->capture.n && !e; i++) {
        struct shot *s = &set->capture.shots[i];
        e = cameras_find(source, &rig, s->name, s->image.w, s->image.h, &s->cam);
        s->has_camera = !e;
    }
    cameras_free(&rig);
    return e;
}

/* ---- all together ---- */

err_t imageset_list(const struct imageset_request *rq, struct imageset *out)
{
    memset(out, 0, sizeof *out);
    bool released = false;
    err_t e = find_pictures(rq->images, out->dir);
    if (!e)
        e = scan(out);
    if (!e) {
        released = is_released(&out->capture);
        e = choose_times(rq, out);
    }
    if (!e)
        e = filter(rq, released, out);
    if (!e)
        e = get_times(rq, out);
    if (!e)
        e = choose(rq, released, out);
    if (!e)
        e = get_sizes(out);
    if (!e)
        e = get_cameras(rq, out);
    if (e)
        imageset_free(out);
    return e;
}

err_t imageset_decode(const struct imageset *set, int i, struct image8 *out)
{
    const struct shot *s = &set->capture.shots[i];
    char path[FILE_PATH_CAP];
    memset(out, 0, sizeof *out);
    err_t e = file_join(set->dir, s->name, path);
    if (!e)
        e = img_read(path, out);
    if (e || (out->w == s->image.w && out->h == s->image.h))
        return e;
    int w = out->w, h = out->h;
    img_free(out);
    return err_fail(ERR_FORMAT, "%s: %d x %d px, but its header said %d x %d before", path, w, h,
                    s->image.w, s->image.h);
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
