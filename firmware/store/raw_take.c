#include "firmware/store/raw_take.h"

#include "drivers/format/json.h"
#include "drivers/format/name.h"
#include "drivers/format/rawframe.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- the manifest ---- */

static bool get_int(const struct cJSON *object, const char *key, int *out)
{
    double v;
    if (!json_number(json_member(object, key), &v) || !(v >= 0 && v <= 1e9) || v != floor(v))
        return false;
    *out = (int)v;
    return true;
}

static err_t get_camera(const char *what, const struct cJSON *node, int i, struct camera_info *out)
{
    const char *word = json_string(json_member(node, "pixels"));
    int f = CAMERA_ANY + 1;
    while (word && f < CAMERA_FORMATS && strcmp(word, take_format((enum camera_format)f)) != 0)
        f++;
    if (!word || f == CAMERA_FORMATS || !get_int(node, "w", &out->w) ||
        !get_int(node, "h", &out->h) || !get_int(node, "stride", &out->stride) ||
        !get_int(node, "bits", &out->bits) || !get_int(node, "black", &out->black))
        return err_fail(ERR_FORMAT,
                        "%s: camera %d needs pixels, w, h, stride, bits and black, a format's name "
                        "and whole numbers from 0 to 1e9",
                        what, i);
    out->format = (enum camera_format)f;
    return OK;
}

/* A name that begins with `folder` and leads nowhere else. */
static bool get_name(const struct cJSON *node, const char *key, const char *folder,
                     char out[MANIFEST_NAME_CAP])
{
    const char *s = json_string(json_member(node, key));
    const size_t n = strlen(folder);
    char copy[NAME_CAP];
    if (!s || strlen(s) >= MANIFEST_NAME_CAP || strncmp(s, folder, n) != 0 ||
        name_copy(key, s + n, strlen(s + n), copy) != OK)
        return false;
    memcpy(out, s, strlen(s) + 1);
    return true;
}

static err_t get_frame(const char *what, const struct cJSON *node, struct raw_take *out)
{
    struct raw_take_frame *f = &out->frame[out->n];
    if (!get_int(node, "camera", &f->camera) || f->camera >= out->n_cameras ||
        !get_name(node, "picture", "images/", f->picture))
        return err_fail(ERR_FORMAT,
                        "%s: frame %d needs one of %d cameras, and a picture in images/", what,
                        out->n, out->n_cameras);
    const bool is_jpeg = out->camera[f->camera].format == CAMERA_MJPG;
    if (!get_name(node, "raw", is_jpeg ? "images/" : "raw/", f->raw))
        return err_fail(ERR_FORMAT, "%s: frame %d names no file of its numbers", what, out->n);
    out->n++;
    return OK;
}

static bool get_gain(const struct cJSON *doc, const char *key, float *out)
{
    double v = 1; // null: all are 1
    const bool known = json_number(json_member(doc, key), &v);
    *out = (float)v;
    return (!known && !json_string(json_member(doc, key))) || (v >= 1.0 / 64 && v <= 64);
}

static err_t take_facts(const char *what, const struct cJSON *doc, void *ctx)
{
    struct raw_take *out = ctx;
    const struct cJSON *cameras = json_member(doc, "cameras"), *frames = json_member(doc, "frames");
    err_t e = OK;
    if (!json_is_array(cameras) || json_count(cameras) > MANIFEST_CAMERAS_MAX ||
        !json_is_array(frames) || json_count(frames) > MANIFEST_FRAMES_MAX)
        return err_fail(ERR_FORMAT, "%s: needs lists of at most %d cameras and %d frames", what,
                        MANIFEST_CAMERAS_MAX, MANIFEST_FRAMES_MAX);
    if (!get_gain(doc, "white_red", &out->how.red) || !get_gain(doc, "white_blue", &out->how.blue))
        return err_fail(ERR_FORMAT, "%s: white_red or white_blue is not in [1/64, 64]", what);
    for (const struct cJSON *c = json_first(cameras); c && !e; c = json_next(c)) {
        e = get_camera(what, c, out->n_cameras, &out->camera[out->n_cameras]);
        out->n_cameras += !e;
    }
    for (const struct cJSON *f = json_first(frames); f && !e; f = json_next(f))
        e = get_frame(what, f, out);
    return e;
}

err_t raw_take_parse(const char *what, const char *text, size_t n, struct raw_take *out)
{
    memset(out, 0, sizeof *out);
    err_t e = json_parse_with(what, text, n, take_facts, out);
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}

/* ---- photographs ---- */

/* One folder of pictures of a set. */
struct folder {
    const char *images;
    int first, end; // shots
    size_t skip;    // bytes of their names before those of the files
    char take[FILE_PATH_CAP];
    struct raw_take facts;
};

/* Whether images/ lies in a take; its folder is known then. */
static bool find_take(struct folder *f, char manifest[FILE_PATH_CAP])
{
    static const char tail[] = "/images";
    const size_t n = strlen(f->images), k = sizeof tail - 1;
    if (n <= k || strcmp(f->images + n - k, tail) != 0)
        return false;
    memcpy(f->take, f->images, n - k);
    f->take[n - k] = 0;
    return file_join(f->take, MANIFEST_FILE, manifest) == OK && file_is_regular(manifest);
}

bool raw_take_is(const char *images)
{
    struct folder f = {.images = images};
    char manifest[FILE_PATH_CAP];
    return (file_join(images, MANIFEST_FILE, manifest) == OK && file_is_regular(manifest)) ||
           (strlen(images) < FILE_PATH_CAP && find_take(&f, manifest));
}

static const struct raw_take_frame *find_frame(const struct folder *f, const char *name)
{
    for (int i = 0; i < f->facts.n; i++)
        if (strcmp(f->facts.frame[i].picture + strlen("images/"), name + f->skip) == 0)
            return &f->facts.frame[i];
    return NULL;
}

static err_t give_frame(const struct folder *f, const struct shot *s, struct rawframe *out)
{
    const struct raw_take_frame *frame = find_frame(f, s->name);
    if (!frame)
        return err_fail(ERR_FORMAT, "%s/" MANIFEST_FILE ": has no frame of %s", f->take, s->name);
    out->info = f->facts.camera[frame->camera];
    out->how = f->facts.how;
    err_t e = file_join(f->take, frame->raw, out->path);
    if (!e)
        e = rawframe_check(out);
    if (!e && (out->info.w != s->taken_w || out->info.h != s->taken_h))
        e = err_fail(ERR_FORMAT, "%s: %d x %d px, but its picture has %d x %d", out->path,
                     out->info.w, out->info.h, s->taken_w, s->taken_h);
    return e;
}

static bool is_linear(const struct raw_take *t)
{
    for (int i = 0; i < t->n; i++)
        if (t->camera[t->frame[i].camera].format < CAMERA_GREY16)
            return false;
    return t->n > 0;
}

/* *is_raw: it is a take of linear numbers. */
static err_t give_frames(struct imageset *set, struct folder *f, bool *is_raw)
{
    char path[FILE_PATH_CAP];
    struct file_map m;
    *is_raw = find_take(f, path);
    if (!*is_raw)
        return OK;
    err_t e = file_map(path, JSON_BYTES_MAX, &m);
    if (!e)
        e = raw_take_parse(path, (const char *)m.p, m.n, &f->facts);
    file_unmap(&m);
    if (!e)
        *is_raw = is_linear(&f->facts);
    for (int i = f->first; i < f->end && *is_raw && !e; i++)
        e = give_frame(f, &set->capture.shots[i], &set->raw[i]);
    return e;
}

static err_t give_all(struct imageset *set, struct folder *f, bool *are_raw)
{
    err_t e = OK;
    *are_raw = true;
    for (int k = 0; k < (set->n_parts ? set->n_parts : 1) && *are_raw && !e; k++) {
        const struct imageset_part *part = set->n_parts ? &set->part[k] : NULL;
        f->images = part ? part->dir : set->dir;
        f->first = part ? part->first : 0;
        f->skip = part ? part->skip : 0;
        f->end = k + 1 < set->n_parts ? set->part[k + 1].first : set->capture.n;
        e = give_frames(set, f, are_raw);
    }
    return e;
}

err_t raw_take_attach(struct imageset *set)
{
    struct folder *f = calloc(1, sizeof *f);
    bool are_raw = false;
    set->raw = calloc((size_t)set->capture.n, sizeof *set->raw);
    err_t e = f && set->raw ? give_all(set, f, &are_raw)
                            : err_fail(ERR_NOMEM, "%s: no memory for its frames", set->dir);
    free(f);
    if (!e && are_raw) {
        for (int i = 0; i < set->capture.n; i++) {
            set->capture.shots[i].raw = &set->raw[i];
            set->capture.shots[i].deep = set->capture.shots[i].linear = true;
        }
        return OK;
    }
    free(set->raw);
    set->raw = NULL;
    if (e == ERR_NOMEM || e == ERR_ARG)
        return e;
    if (e && set->n_notes < IMAGESET_NOTES)
        snprintf(set->notes[set->n_notes++], sizeof set->notes[0],
                 "the pictures of 8 bits are used, not the sensor's numbers: %.160s", err_text());
    return OK;
}
