/* The text is read three times: as any manifest, as photographs (raw_take.h), and for what a joint
 * take needs beyond. Files that frames name must be listed, and their number says that no others
 * are. */
#include "firmware/store/part.h"

#include "firmware/store/raw_take.h"

#include "drivers/format/file.h"
#include "drivers/format/json.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { KEYS_MAX = 64, DEPTH_MAX = 8, COUNT_MAX = 1000000000 };

static const char exposures[] = "exposure.json";
static const int64_t ns_max = INT64_C(1) << 62; // differences fit

/* ---- values ---- */

static bool get_ns(const struct cJSON *object, const char *key, int64_t *out)
{
    const char *s = json_string(json_member(object, key));
    const size_t sign = s && *s == '-', n = s ? strspn(s + sign, "0123456789") : 0;
    if (n < 1 || n > 19 || s[sign + n])
        return false;
    errno = 0;
    *out = strtoll(s, NULL, 10);
    return errno == 0 && *out > -ns_max && *out < ns_max;
}

static bool get_count(const struct cJSON *object, const char *key, int *out)
{
    double v = 0;
    if (!json_number(json_member(object, key), &v) || !(v >= 0 && v <= COUNT_MAX) || v != floor(v))
        return false;
    *out = (int)v;
    return true;
}

static void get_text(const struct cJSON *object, const char *key, char out[TAKE_TEXT])
{
    const char *s = json_string(json_member(object, key));
    snprintf(out, TAKE_TEXT, "%s", s ? s : "");
}

static bool is_shallow(const struct cJSON *node, int left)
{
    if (!json_is_object(node) && !json_is_array(node))
        return true;
    bool ok = left > 0;
    for (const struct cJSON *m = json_first(node); m && ok; m = json_next(m))
        ok = is_shallow(m, left - 1);
    return ok;
}

/* A camera or a frame is an object that names nothing twice. */
static err_t check_object(const char *what, const struct cJSON *node, const char *of, int i)
{
    int n = json_is_object(node) ? json_count(node) : 0;
    bool ok = n > 0 && n <= KEYS_MAX && is_shallow(node, DEPTH_MAX);
    for (const struct cJSON *a = ok ? json_first(node) : NULL; a && ok; a = json_next(a))
        ok = json_member(node, json_key(a)) == a; // the first of that name
    return ok ? OK
              : err_fail(ERR_FORMAT, "%s: %s %d is no object of at most %d different keys", what,
                         of, i, KEYS_MAX);
}

/* ---- the take ---- */

static err_t check_whose(const char *what, const struct manifest *m, const char *id,
                         const char *member)
{
    if (!m->rig_take[0])
        return err_fail(ERR_FORMAT, "%s: not a part of a rig's take", what);
    if (strcmp(m->rig_take, id) != 0)
        return err_fail(ERR_FORMAT, "%s: a part of take %s, not of %s", what, m->rig_take, id);
    if (strcmp(m->rig_member, member) != 0)
        return err_fail(ERR_FORMAT, "%s: the part of %s, not of %s", what, m->rig_member, member);
    if (!m->complete)
        return err_fail(ERR_FORMAT, "%s: an aborted take is no part", what);
    return OK;
}

static bool is_listed(const struct manifest *m, const char *name)
{
    for (int i = 0; i < m->n; i++)
        if (strcmp(m->file[i].name, name) == 0)
            return true;
    return false;
}

static err_t check_names(const char *what, const struct raw_take *raw, int i, const struct part *p)
{
    const struct raw_take_frame *r = &raw->frame[i];
    const struct part_frame *f = &p->frame[i];
    const bool is_jpeg = raw->camera[f->camera].format == CAMERA_MJPG;
    char name[MANIFEST_NAME_CAP];
    snprintf(name, sizeof name, "images/train_%02d_%02d.%s", f->camera, f->index,
             is_jpeg ? "jpg" : "png");
    bool ok = strcmp(name, r->picture) == 0;
    if (!is_jpeg)
        snprintf(name, sizeof name, "raw/%02d_%02d.bin", f->camera, f->index);
    if (!ok || strcmp(name, r->raw) != 0)
        return err_fail(ERR_FORMAT, "%s: frame %d has files with names of others", what, i);
    if (!is_listed(&p->manifest, r->picture) || !is_listed(&p->manifest, r->raw))
        return err_fail(ERR_FORMAT, "%s: a file of frame %d is not listed", what, i);
    return OK;
}

static err_t read_frame(const char *what, const struct cJSON *node, const struct raw_take *raw,
                        struct part *p)
{
    struct part_frame *f = &p->frame[p->n];
    const struct part_frame *last = p->n ? f - 1 : NULL;
    int64_t within;
    err_t e = check_object(what, node, "frame", p->n);
    if (e)
        return e;
    f->camera = raw->frame[p->n].camera;
    memcpy(f->picture, raw->frame[p->n].picture, sizeof f->picture);
    if (!get_count(node, "index", &f->index) || f->index >= BRACKET_EXPOSURES_MAX ||
        !json_number(json_member(node, "exposure_s"), &f->exposure_s) ||
        !(f->exposure_s > 0 && f->exposure_s < 1e6))
        return err_fail(ERR_FORMAT, "%s: frame %d needs an index below %d and an exposure", what,
                        p->n, BRACKET_EXPOSURES_MAX);
    if (last &&
        (last->camera > f->camera || (last->camera == f->camera && last->index >= f->index)))
        return err_fail(ERR_FORMAT, "%s: frame %d: not in order of camera and exposure", what,
                        p->n);
    if (!get_ns(node, "common_ns", &f->common_ns) || !get_ns(node, "within_ns", &within) ||
        within < 0)
        return err_fail(ERR_FORMAT, "%s: frame %d has no time on the common clock", what, p->n);
    p->within_ns = within > p->within_ns ? within : p->within_ns;
    return check_names(what, raw, p->n++, p);
}

static err_t check_camera(const char *what, const struct cJSON *node, int i)
{
    err_t e = check_object(what, node, "camera", i);
    if (!e && json_member(node, "member"))
        e = err_fail(ERR_FORMAT, "%s: camera %d is of a joint take", what, i);
    return e;
}

/* Every file that is listed is one of a frame or of the take. */
static err_t check_files(const char *what, const struct raw_take *raw, const struct part *p)
{
    char name[MANIFEST_NAME_CAP];
    int n = 1;
    for (int i = 0; i < p->n; i++) {
        const struct part_frame *f = &p->frame[i];
        manifest_mask_name(f->camera, f->index, name);
        n += raw->camera[f->camera].format == CAMERA_MJPG ? 1 : 2;
        n += is_listed(&p->manifest, name);
        manifest_thumb_name(f->camera, f->index, name);
        n += is_listed(&p->manifest, name);
    }
    for (int c = 0; c < p->n_cameras; c++) {
        snprintf(name, sizeof name, "merged/%02d.exr", c);
        n += is_listed(&p->manifest, name);
    }
    if (!is_listed(&p->manifest, exposures) || n != p->manifest.n)
        return err_fail(ERR_FORMAT, "%s: lists %d files, its frames and cameras have %d", what,
                        p->manifest.n, n);
    return OK;
}

static err_t read_lists(const char *what, const struct raw_take *raw, struct part *p)
{
    const struct cJSON *cameras = json_member(p->doc, "cameras");
    const struct cJSON *frames = json_member(p->doc, "frames");
    int i = 0;
    err_t e = OK;
    if (raw->n_cameras < 1 || raw->n_cameras > BRACKET_CAMERAS_MAX || raw->n < 1 ||
        raw->n > TAKE_FRAMES_MAX)
        return err_fail(ERR_FORMAT, "%s: %d cameras and %d frames, allowed are 1 to %d and 1 to %d",
                        what, raw->n_cameras, raw->n, BRACKET_CAMERAS_MAX, TAKE_FRAMES_MAX);
    p->n_cameras = raw->n_cameras;
    for (const struct cJSON *c = json_first(cameras); c && !e; c = json_next(c))
        e = check_camera(what, c, i++);
    for (const struct cJSON *f = json_first(frames); f && !e; f = json_next(f))
        e = read_frame(what, f, raw, p);
    return e ? e : check_files(what, raw, p);
}

static void read_head(const struct raw_take *raw, struct part *p)
{
    const struct cJSON *doc = p->doc;
    const char *clock = json_string(json_member(json_member(doc, "rig"), "clock"));
    snprintf(p->clock, sizeof p->clock, "%s", clock ? clock : "");
    get_text(doc, "reason", p->reason);
    get_text(doc, "not_merged", p->not_merged);
    (void)!json_truth(json_member(doc, "stagger"), &p->stagger); // unknown is false
    (void)!json_truth(json_member(doc, "metered"), &p->metered);
    p->tolerance = NAN;
    (void)!json_number(json_member(doc, "tolerance_stops"), &p->tolerance);
    (void)!get_count(doc, "frames_used", &p->frames_used); // unknown is 0
    (void)!get_count(doc, "rejected", &p->rejected);
    p->how = raw->how;
    for (int i = 0; i < raw->n_cameras; i++)
        p->is_mosaic = p->is_mosaic || raw->camera[i].format >= CAMERA_RGGB16;
}

static err_t read_text(const char *what, const char *text, size_t n, struct part *p)
{
    struct raw_take *raw = malloc(sizeof *raw);
    if (!raw)
        return err_fail(ERR_NOMEM, "%s: no memory for its frames", what);
    err_t e = raw_take_parse(what, text, n, raw);
    if (!e)
        e = json_parse(what, text, n, &p->doc);
    if (!e) {
        read_head(raw, p);
        e = read_lists(what, raw, p);
    }
    free(raw);
    return e;
}

err_t part_parse(const char *what, const char *text, size_t n, const char *id, const char *member,
                 struct part *out)
{
    memset(out, 0, sizeof *out);
    err_t e = manifest_parse(what, text, n, &out->manifest);
    if (!e)
        e = check_whose(what, &out->manifest, id, member);
    if (!e)
        e = read_text(what, text, n, out);
    if (e)
        part_free(out);
    return e;
}

err_t part_read(const struct store_fs *fs, const char *dir, const char *id, const char *member,
                struct part *out)
{
    char path[FILE_PATH_CAP];
    size_t n;
    memset(out, 0, sizeof *out);
    err_t e = file_join(dir, MANIFEST_FILE, path);
    if (e)
        return e;
    char *text;
    e = store_fs_text(fs, path, JSON_BYTES_MAX, &text, &n);
    if (!e)
        e = part_parse(path, text, n, id, member, out);
    free(text);
    return e;
}

void part_free(struct part *p)
{
    json_free(p->doc);
    memset(p, 0, sizeof *p);
}

/* ---- in the joint take ---- */

void part_rename(const char *name, int base, char out[MANIFEST_NAME_CAP])
{
    const size_t skip = strcspn(name, "0123456789"); // part_read knows the form
    const int camera = atoi(name + skip);
    snprintf(out, MANIFEST_NAME_CAP, "%.*s%02d%s", (int)skip, name, camera + base, name + skip + 2);
}

void part_put_cameras(FILE *f, const struct part *p, int base)
{
    const struct cJSON *list = json_member(p->doc, "cameras");
    for (const struct cJSON *c = json_first(list); c; c = json_next(c)) {
        fputs(base++ ? ",\n    {" : "\n    {", f);
        for (const struct cJSON *m = json_first(c); m; m = json_next(m)) {
            json_put_string(f, json_key(m));
            fputs(": ", f);
            json_put(f, m);
            fputs(", ", f);
        }
        fprintf(f, "\"member\": \"%s\"}", p->manifest.rig_member);
    }
}

/* Numbered again from `base` on. */
static void put_frame_value(FILE *f, const struct cJSON *m, const struct part_frame *x, int base)
{
    const char *key = json_key(m);
    char name[MANIFEST_NAME_CAP];
    json_put_string(f, key);
    fputs(": ", f);
    if (strcmp(key, "camera") == 0) {
        fprintf(f, "%d", x->camera + base);
    } else if (strcmp(key, "raw") == 0 || strcmp(key, "picture") == 0) {
        part_rename(json_string(m), base, name);
        json_put_string(f, name);
    } else {
        json_put(f, m);
    }
    fputs(json_next(m) ? ", " : "", f);
}

void part_put_frames(FILE *f, const struct part *p, int base)
{
    const struct cJSON *list = json_member(p->doc, "frames");
    const struct part_frame *x = p->frame;
    for (const struct cJSON *node = json_first(list); node; node = json_next(node), x++) {
        fputs(base || x > p->frame ? ",\n    {" : "\n    {", f);
        for (const struct cJSON *m = json_first(node); m; m = json_next(m))
            put_frame_value(f, m, x, base);
        putc('}', f);
    }
}
