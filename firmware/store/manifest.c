/* Writing is a walk over struct take. Reading uses only the head and the list of files, which prove
 * that a take is whole; of the rest, which is for users and their programs, only the keys are
 * checked. */
#include "firmware/store/manifest.h"

#include "drivers/format/json.h"
#include "drivers/format/name.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

enum { VERSION = 1 };

static const char format[] = "hdrig-take", thumbs[] = "thumbs/";

/* ---- words ---- */

bool manifest_is_jpeg(const struct take *t, const struct take_frame *f)
{
    return t->camera[f->camera].info.format == CAMERA_MJPG;
}

void manifest_raw_name(const struct take *t, const struct take_frame *f,
                       char out[MANIFEST_NAME_CAP])
{
    if (manifest_is_jpeg(t, f) && t->status == TAKE_COMPLETE)
        manifest_picture_name(t, f, out);
    else
        snprintf(out, MANIFEST_NAME_CAP, "raw/%02d_%02d.%s", f->camera, f->index,
                 manifest_is_jpeg(t, f) ? "jpg" : "bin");
}

void manifest_picture_name(const struct take *t, const struct take_frame *f,
                           char out[MANIFEST_NAME_CAP])
{
    snprintf(out, MANIFEST_NAME_CAP, "images/train_%02d_%02d.%s", f->camera, f->index,
             manifest_is_jpeg(t, f) ? "jpg" : "png");
}

bool manifest_picture_is(const char *name, int *camera, int *index)
{
    int end = 0;
    return sscanf(name, "train_%3d_%2d%n", camera, index, &end) == 2 && name[end] == '.' &&
           *camera >= 0 && *camera < MANIFEST_CAMERAS_MAX && *index >= 0 &&
           *index < BRACKET_EXPOSURES_MAX;
}

void manifest_mask_name(int camera, int index, char out[MANIFEST_NAME_CAP])
{
    snprintf(out, MANIFEST_NAME_CAP, "masks/train_%02d_%02d.png", camera, index);
}

void manifest_thumb_name(int camera, int index, char out[MANIFEST_NAME_CAP])
{
    snprintf(out, MANIFEST_NAME_CAP, "%strain_%02d_%02d.jpg", thumbs, camera, index);
}

bool manifest_is_thumb(const char *name)
{
    return strncmp(name, thumbs, sizeof thumbs - 1) == 0;
}

const char *manifest_proof(enum bracket_proof p)
{
    static const char *const words[] = {"reported", "pixels", "unverified-flicker",
                                        "unverified-dark", "unverified-bright"};
    return (unsigned)p < sizeof words / sizeof words[0] ? words[p] : "none";
}

/* ---- writing ---- */

/* Begins a member. Keys are constants and need no escapes. */
static void put_key(FILE *f, const char *key)
{
    fprintf(f, "\"%s\": ", key);
}

/* Accepts any bytes. Bytes above ASCII are written as Latin-1, so the text is always JSON. */
static void put_text(FILE *f, const char *key, const char *s)
{
    put_key(f, key);
    putc('"', f);
    for (; *s; s++) {
        unsigned char c = (unsigned char)*s;
        if (c < 0x20 || c >= 0x7f || c == '"' || c == '\\')
            fprintf(f, "\\u%04x", c);
        else
            putc(c, f);
    }
    fputs("\", ", f);
}

static void put_value(FILE *f, double v)
{
    if (isfinite(v))
        fprintf(f, "%.12g", v);
    else
        fputs("null", f);
}

static void put_number(FILE *f, const char *key, double v)
{
    put_key(f, key);
    put_value(f, v);
    fputs(", ", f);
}

static void put_truth(FILE *f, const char *key, bool v)
{
    put_key(f, key);
    fputs(v ? "true, " : "false, ", f);
}

static void put_ns(FILE *f, const char *key, int64_t ns)
{
    put_key(f, key);
    fprintf(f, "\"%" PRId64 "\", ", ns);
}

/* The last member of an object: no comma follows. */
static void put_clocks(FILE *f, const char *key, const struct clocks *c)
{
    put_key(f, key);
    fprintf(f, "{\"monotonic_ns\": \"%" PRId64 "\", \"boottime_ns\": \"%" PRId64 "\", ",
            c->monotonic_ns, c->boottime_ns);
    fprintf(f, "\"realtime_ns\": \"%" PRId64 "\"}", c->realtime_ns);
}

static void put_exposure(FILE *f, const char *key, const struct exposure *x)
{
    put_key(f, key);
    if (x) {
        fputs("{\"time_s\": ", f);
        put_value(f, x->time_s);
        fputs(", \"gain\": ", f);
        put_value(f, x->gain);
        fputs("}, ", f);
    } else {
        fputs("null, ", f);
    }
}

static void put_crf(FILE *f, const struct crf *c)
{
    put_key(f, "crf");
    if (!c) {
        fputs("null", f);
        return;
    }
    fputs("{", f);
    put_truth(f, "known", c->known);
    put_number(f, "error_stops", (double)c->error);
    fputs("\"log2x\": [", f);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 256; k++) {
            fputs(k ? ", " : i ? ", [" : "[", f);
            put_value(f, (double)c->log2x[i][k]);
            fputs(k == 255 ? "]" : "", f);
        }
    fputs("]}", f);
}

static void put_meter(FILE *f, const struct meter_result *m)
{
    put_key(f, "meter");
    if (!m) {
        fputs("null, ", f);
        return;
    }
    fputs("{", f);
    put_number(f, "stops", m->stops);
    put_number(f, "snr", m->snr);
    put_number(f, "clipped", m->clipped);
    put_number(f, "dark", m->dark);
    put_truth(f, "too_bright", m->too_bright);
    put_truth(f, "too_dark", m->too_dark);
    fputs("\"time_s\": [", f);
    for (int i = 0; i < m->n && i < METER_EXPOSURES_MAX; i++) {
        fputs(i ? ", " : "", f);
        put_value(f, m->time_s[i]);
    }
    fputs("]}, ", f);
}

static void put_camera(FILE *f, const struct take *t, int i)
{
    const struct take_camera *c = &t->camera[i];
    const struct camera_info *d = &c->info;
    const char *word = take_format(d->format);
    fputs(i ? ",\n    {" : "\n    {", f);
    put_text(f, "uri", c->uri);
    put_text(f, "unit", d->unit);
    put_text(f, "pixels", word ? word : "none");
    put_number(f, "w", d->w);
    put_number(f, "h", d->h);
    put_number(f, "stride", d->stride);
    put_number(f, "bits", d->bits);
    put_number(f, "black", d->black);
    put_truth(f, "limited", d->limited);
    put_truth(f, "bt709", d->bt709);
    put_number(f, "period_s", d->period_s);
    put_number(f, "time_min_s", d->time_min_s);
    put_number(f, "time_max_s", d->time_max_s);
    put_number(f, "time_step_s", d->time_step_s);
    put_number(f, "gain_max", d->gain_max);
    put_number(f, "exposure_delay", d->exposure_delay < 0 ? NAN : d->exposure_delay);
    put_number(f, "gain_delay", d->gain_delay < 0 ? NAN : d->gain_delay);
    put_text(f, "stamp", d->stamp == CAMERA_STAMP_START ? "start" : "end");
    put_truth(f, "reports", d->reports);
    put_number(f, "flicker_hz", c->light.hz > 0.0 ? c->light.hz : NAN);
    put_number(f, "flicker_depth", c->light.hz > 0.0 ? c->light.depth : NAN);
    put_meter(f, t->metered ? &t->meter[i] : NULL);
    put_crf(f, c->has_crf ? &c->crf : NULL);
    fputs("}", f);
}

static void put_evidence(FILE *f, const struct bracket_evidence *v)
{
    put_exposure(f, "exposure", &v->exposure);
    put_exposure(f, "asked", &v->requested);
    put_exposure(f, "set", &v->set);
    put_exposure(f, "reported", v->reported_known ? &v->reported : NULL);
    put_text(f, "proof", manifest_proof(v->proof));
    put_number(f, "ratio_stops", v->ratio_known ? (double)v->ratio : NAN);
    put_number(f, "ratio_asked_stops", v->ratio_known ? (double)v->ratio_asked : NAN);
    put_number(f, "ratio_places", v->patches);
    put_number(f, "sequence", v->sequence);
    put_ns(f, "timestamp_ns", v->timestamp_ns);
    put_ns(f, "start_ns", v->start_ns);
    put_ns(f, "request_ns", v->request_ns);
    put_number(f, "frames_since_request", v->frames_since);
    put_number(f, "attempts", v->attempts);
    put_truth(f, "rested", v->rested);
}

static void put_frame(FILE *f, const struct take *t, int i)
{
    const struct take_frame *x = &t->frame[i];
    char name[MANIFEST_NAME_CAP];
    fputs(i ? ",\n    {" : "\n    {", f);
    put_number(f, "camera", x->camera);
    put_number(f, "index", x->index);
    manifest_raw_name(t, x, name);
    put_text(f, "raw", name);
    if (t->status == TAKE_COMPLETE) {
        manifest_picture_name(t, x, name);
        put_text(f, "picture", name);
    }
    put_number(f, "exposure_s", take_exposure_s(x));
    put_evidence(f, &x->evidence);
    put_number(f, "digital_gain", x->gains_known ? x->digital_gain : NAN);
    put_number(f, "red_gain", x->gains_known ? x->red_gain : NAN);
    put_number(f, "blue_gain", x->gains_known ? x->blue_gain : NAN);
    put_number(f, "lens", x->lens_known ? x->lens : NAN);
    put_number(f, "moved", x->compared ? x->ghost.share : NAN);
    put_number(f, "shift_x_px", x->compared ? (double)x->ghost.shift[0] : NAN);
    put_number(f, "shift_y_px", x->compared ? (double)x->ghost.shift[1] : NAN);
    if (t->rig.take[0]) {
        put_ns(f, "common_ns", x->common_ns);
        put_ns(f, "within_ns", x->within_ns);
    }
    put_clocks(f, "start", &x->start);
    fputs("}", f);
}

static void put_files(FILE *f, const struct manifest *m)
{
    fputs("\n  ],\n  \"files\": [", f);
    for (int i = 0; i < m->n; i++) {
        const struct manifest_file *x = &m->file[i];
        fputs(i ? ",\n    {" : "\n    {", f);
        put_text(f, "name", x->name);
        fprintf(f, "\"bytes\": %" PRIu64 ", \"sha256\": \"%s\"}", x->bytes, x->sha256);
    }
    fputs("\n  ]\n}\n", f);
}

static void put_rig(FILE *f, const struct take_rig *r)
{
    put_key(f, "rig");
    fprintf(f, "{\"take\": \"%s\", \"member\": \"%s\", ", r->take, r->member);
    fprintf(f, "\"clock\": \"%s\"}, ", r->clock);
}

/* What is written before the cameras. rig: JSON, NULL: t's. */
static void put_head(FILE *f, const struct manifest *m, const struct take *t, const char *rig)
{
    bool developed = m->how.red > 0.0f;
    fprintf(f, "{\n  \"format\": \"%s\", \"version\": %d,\n  ", format, VERSION);
    put_text(f, "id", m->id);
    put_text(f, "boot_id", m->boot);
    if (m->session[0])
        put_text(f, "session", m->session);
    if (rig)
        fprintf(f, "\"rig\": %s, ", rig);
    else if (t->rig.take[0])
        put_rig(f, &t->rig);
    fprintf(f, "\"counter\": %llu,\n  ", m->counter);
    put_text(f, "status", t->status == TAKE_COMPLETE ? "complete" : "aborted");
    put_text(f, "reason", t->reason);
    put_text(f, "not_merged", m->not_merged);
    fputs("\n  ", f);
    put_truth(f, "clock_synced", t->clock_synced);
    put_clocks(f, "trigger", &t->trigger);
    fputs(",\n  ", f);
    put_truth(f, "stagger", t->stagger);
    put_truth(f, "metered", t->metered);
    put_number(f, "tolerance_stops", t->tolerance);
    put_number(f, "skew_s", t->skew_s);
    put_number(f, "frames_used", t->frames_used);
    put_number(f, "rejected", t->rejected);
    fputs("\n  ", f);
    put_number(f, "white_red", developed ? (double)m->how.red : NAN);
    put_number(f, "white_blue", developed ? (double)m->how.blue : NAN);
    fputs("\n  \"cameras\": [", f);
}

void manifest_write(FILE *f, const struct manifest *m, const struct take *t)
{
    put_head(f, m, t, NULL);
    for (int i = 0; i < t->n_cameras; i++)
        put_camera(f, t, i);
    fputs("\n  ],\n  \"frames\": [", f);
    for (int i = 0; i < t->n; i++)
        put_frame(f, t, i);
    put_files(f, m);
}

void manifest_write_joint(FILE *f, const struct manifest *m, const struct take *head,
                          const struct manifest_lists *lists)
{
    put_head(f, m, head, lists->rig);
    fprintf(f, "%s\n  ],\n  \"frames\": [%s", lists->cameras, lists->frames);
    put_files(f, m);
}

/* ---- reading ---- */

/* Check that the first `needed` of the n keys are there, each once at most, and no other key. */
static err_t check_keys(const char *what, const struct cJSON *object, const char *const *keys,
                        int needed, int n)
{
    uint64_t seen = 0;
    for (const struct cJSON *m = json_first(object); m; m = json_next(m)) {
        int k = 0;
        while (k < n && strcmp(json_key(m), keys[k]) != 0)
            k++;
        if (k == n || (seen & UINT64_C(1) << k))
            return err_fail(ERR_FORMAT, "%s: key \"%.40s\" is %s", what, json_key(m),
                            k == n ? "not known" : "there twice");
        seen |= UINT64_C(1) << k;
    }
    for (int k = 0; k < needed; k++)
        if (!(seen & UINT64_C(1) << k))
            return err_fail(ERR_FORMAT, "%s: has no key \"%s\"", what, keys[k]);
    return OK;
}

/* A whole number from 0 to 2^53. */
static bool get_count(const struct cJSON *object, const char *key, uint64_t *out)
{
    double v;
    if (!json_number(json_member(object, key), &v) || !(v >= 0 && v <= 0x1p53) || v != floor(v))
        return false;
    *out = (uint64_t)v;
    return true;
}

/* Digits of a hash, an id or a boot id. */
static bool get_text(const struct cJSON *object, const char *key, const char *allowed, size_t cap,
                     char *out)
{
    const char *s = json_string(json_member(object, key));
    if (!s || !*s || strlen(s) >= cap || s[strspn(s, allowed)])
        return false;
    memcpy(out, s, strlen(s) + 1);
    return true;
}

static err_t check_name(const char *what, const char *name)
{
    static const char *const folders[] = {"images/", "masks/", "raw/", "merged/", thumbs};
    char copy[NAME_CAP];
    size_t skip = 0;
    for (size_t i = 0; i < sizeof folders / sizeof folders[0]; i++)
        if (strncmp(name, folders[i], strlen(folders[i])) == 0)
            skip = strlen(folders[i]);
    err_t e = name_copy(what, name + skip, strlen(name + skip), copy);
    if (e)
        return e;
    if (copy[0] == '.' || strcmp(name, MANIFEST_FILE) == 0)
        return err_fail(ERR_FORMAT, "%s: lists a file \"%s\", which a take cannot have", what,
                        name);
    return OK;
}

static err_t get_file(const char *what, const struct cJSON *node, struct manifest *out)
{
    static const char *const keys[] = {"name", "bytes", "sha256"};
    struct manifest_file *f = &out->file[out->n];
    const char *name = json_string(json_member(node, "name"));
    err_t e = json_is_object(node)
                  ? check_keys(what, node, keys, 3, 3)
                  : err_fail(ERR_FORMAT, "%s: an element of \"files\" is not an object", what);
    if (e)
        return e;
    if (!name || strlen(name) >= sizeof f->name || !get_count(node, "bytes", &f->bytes) ||
        !get_text(node, "sha256", "0123456789abcdef", sizeof f->sha256, f->sha256) ||
        strlen(f->sha256) != sizeof f->sha256 - 1)
        return err_fail(
            ERR_FORMAT,
            "%s: file %d needs a name below %zu bytes, a size and a SHA-256 of 64 digits", what,
            out->n + 1, sizeof f->name);
    memcpy(f->name, name, strlen(name) + 1);
    for (int i = 0; i < out->n; i++)
        if (strcmp(out->file[i].name, f->name) == 0)
            return err_fail(ERR_FORMAT, "%s: %s is listed twice", what, f->name);
    out->n++;
    return check_name(what, f->name);
}

static err_t get_files(const char *what, const struct cJSON *doc, struct manifest *out)
{
    const struct cJSON *list = json_member(doc, "files");
    if (!json_is_array(list) || json_count(list) > MANIFEST_FILES_MAX)
        return err_fail(ERR_FORMAT, "%s: files is not a list of at most %d", what,
                        MANIFEST_FILES_MAX);
    err_t e = OK;
    for (const struct cJSON *node = json_first(list); node && !e; node = json_next(node))
        e = get_file(what, node, out);
    return e;
}

static const char take_digits[] = "0123456789abcdef-",
                  member_letters[] = "abcdefghijklmnopqrstuvwxyz0123456789-";

bool manifest_is_member(const char *name)
{
    size_t n = strlen(name);
    return n > 0 && n < TAKE_MEMBER_CAP && name[0] != '-' && !name[strspn(name, member_letters)];
}

static bool get_member(const struct cJSON *object, const char *key, char out[TAKE_MEMBER_CAP])
{
    return get_text(object, key, member_letters, TAKE_MEMBER_CAP, out) && out[0] != '-';
}

static err_t check_board(const char *what, const struct cJSON *node)
{
    static const char *const keys[] = {"name", "part", "boot_id", "cameras", "clock", "within_ns"};
    char member[TAKE_MEMBER_CAP];
    err_t e = json_is_object(node)
                  ? check_keys(what, node, keys, 6, 6)
                  : err_fail(ERR_FORMAT, "%s: an element of \"members\" is not an object", what);
    if (!e && !get_member(node, "name", member))
        e = err_fail(ERR_FORMAT, "%s: a member of the rig has no name", what);
    return e;
}

static err_t get_joint(const char *what, const struct cJSON *rig, struct manifest *out)
{
    static const char *const keys[] = {"take", "members", "missing"};
    const struct cJSON *list = json_member(rig, "members"), *gone = json_member(rig, "missing");
    char take[MANIFEST_ID_CAP];
    err_t e = check_keys(what, rig, keys, 3, 3);
    if (e)
        return e;
    if (!get_text(rig, "take", take_digits, sizeof take, take) || strcmp(take, out->id) != 0)
        return err_fail(ERR_FORMAT, "%s: it is another take than its rig says", what);
    if (!json_is_array(list) || json_count(list) < 1 || json_count(list) > MANIFEST_MEMBERS_MAX ||
        !json_is_array(gone) || json_count(gone) > MANIFEST_MEMBERS_MAX)
        return err_fail(ERR_FORMAT, "%s: its rig needs lists of 1 to %d members and missing ones",
                        what, MANIFEST_MEMBERS_MAX);
    for (const struct cJSON *node = json_first(list); node && !e; node = json_next(node))
        e = check_board(what, node);
    for (const struct cJSON *node = json_first(gone); node && !e; node = json_next(node))
        if (!json_string(node) || !manifest_is_member(json_string(node)))
            e = err_fail(ERR_FORMAT, "%s: a missing member of the rig has no name", what);
    out->members = json_count(list);
    return e;
}

static err_t get_rig(const char *what, const struct cJSON *rig, struct manifest *out)
{
    static const char *const keys[] = {"take", "member", "clock"};
    if (!rig)
        return OK;
    if (!json_is_object(rig))
        return err_fail(ERR_FORMAT, "%s: rig is not an object", what);
    if (json_member(rig, "members"))
        return get_joint(what, rig, out);
    err_t e = check_keys(what, rig, keys, 3, 3);
    if (e)
        return e;
    const char *clock = json_string(json_member(rig, "clock"));
    if (!get_text(rig, "take", take_digits, sizeof out->rig_take, out->rig_take) ||
        !get_member(rig, "member", out->rig_member) || !clock ||
        (strcmp(clock, "exchange") != 0 && strcmp(clock, "kernel") != 0))
        return err_fail(ERR_FORMAT,
                        "%s: rig needs the id of a take, a member's name and a clock, exchange or "
                        "kernel",
                        what);
    return OK;
}

/* Text up to a quote, which follows; returns what comes after the quote, NULL: it does not fit. */
static const char *head_text(const char *at, size_t cap, char *out)
{
    size_t n = strcspn(at, "\"");
    if (n == 0 || n >= cap || !at[n])
        return NULL;
    memcpy(out, at, n);
    out[n] = 0;
    return at + n + 1;
}

bool manifest_part(const char *text, size_t n, char take[MANIFEST_ID_CAP],
                   char member[TAKE_MEMBER_CAP])
{
    static const char first[] = "\"rig\": {\"take\": \"", second[] = ", \"member\": \"";
    char head[MANIFEST_HEAD + 1];
    n = n < MANIFEST_HEAD ? n : MANIFEST_HEAD;
    memcpy(head, text, n);
    head[n] = 0;
    const char *at = strstr(head, first);
    at = at ? head_text(at + sizeof first - 1, MANIFEST_ID_CAP, take) : NULL;
    if (!at || strncmp(at, second, sizeof second - 1) != 0 || take[strspn(take, take_digits)])
        return false;
    return head_text(at + sizeof second - 1, TAKE_MEMBER_CAP, member) && manifest_is_member(member);
}

static err_t get_head(const char *what, const struct cJSON *doc, struct manifest *out)
{
    static const char *const keys[] = {
        "format", "version", "id",           "boot_id",    "counter",   "status",
        "reason", "trigger", "clock_synced", "stagger",    "metered",   "tolerance_stops",
        "skew_s", "cameras", "frames_used",  "rejected",   "white_red", "white_blue",
        "frames", "files",   "session",      "not_merged", "rig"};
    const int n_keys = sizeof keys / sizeof keys[0], optional = 3; // the last keys
    uint64_t version, counter;
    if (!json_is_object(doc))
        return err_fail(ERR_FORMAT, "%s: the document is not an object", what);
    err_t e = check_keys(what, doc, keys, n_keys - optional, n_keys);
    if (e)
        return e;
    const char *kind = json_string(json_member(doc, "format"));
    const char *status = json_string(json_member(doc, "status"));
    if (!kind || strcmp(kind, format) != 0 || !get_count(doc, "version", &version) ||
        version != VERSION)
        return err_fail(ERR_FORMAT, "%s: not a manifest of version %d", what, VERSION);
    if (!status || (strcmp(status, "complete") != 0 && strcmp(status, "aborted") != 0))
        return err_fail(ERR_FORMAT, "%s: status is neither complete nor aborted", what);
    if (!get_text(doc, "id", "0123456789abcdefort-", sizeof out->id, out->id) ||
        !get_text(doc, "boot_id", "0123456789abcdef-", sizeof out->boot, out->boot) ||
        !get_count(doc, "counter", &counter))
        return err_fail(ERR_FORMAT, "%s: id, boot_id or counter is malformed", what);
    if (json_member(doc, "session") &&
        !get_text(doc, "session", "0123456789abcdef-", sizeof out->session, out->session))
        return err_fail(ERR_FORMAT, "%s: session is not an id", what);
    out->counter = counter;
    out->complete = strcmp(status, "complete") == 0;
    return get_rig(what, json_member(doc, "rig"), out);
}

err_t manifest_parse(const char *what, const char *text, size_t n, struct manifest *out)
{
    struct cJSON *doc;
    memset(out, 0, sizeof *out);
    err_t e = json_parse(what, text, n, &doc);
    if (e)
        return e;
    e = get_head(what, doc, out);
    if (!e)
        e = get_files(what, doc, out);
    json_free(doc);
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}
