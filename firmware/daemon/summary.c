#include "firmware/daemon/summary.h"

#include "drivers/format/file.h"
#include "drivers/format/json.h"

#include <math.h>
#include <string.h>
#include <sys/stat.h>

/* Folder of its scene. */
static const char *scene_of(const struct summary *s)
{
    return s->session[0] ? s->session : s->id;
}

static void copy_text(char *out, size_t cap, const char *text)
{
    snprintf(out, cap, "%s", text ? text : "");
}

/* The worst of the cameras. */
static void read_meter(const struct cJSON *meter, struct summary *s)
{
    double v;
    if (json_number(json_member(meter, "stops"), &v))
        s->stops = fmax(s->stops, v);
    if (json_number(json_member(meter, "clipped"), &v))
        s->clipped = fmax(s->clipped, v);
    if (json_number(json_member(meter, "dark"), &v))
        s->dark = fmax(s->dark, v);
}

/* Files are listed by camera, then exposure. */
static void read_images(const struct cJSON *files, struct summary *s)
{
    const int middle = s->cameras > 0 ? (s->frames / s->cameras - 1) / 2 : 0;
    static const char folder[] = "images/";
    int last = -1;
    for (const struct cJSON *f = json_first(files); f; f = json_next(f)) {
        const char *name = json_string(json_member(f, "name"));
        int camera, index;
        if (!name || strncmp(name, folder, sizeof folder - 1) != 0 ||
            !manifest_picture_is(name + sizeof folder - 1, &camera, &index))
            continue;
        const bool add = s->cameras == 1 || camera != last;
        if (add && s->n_images == (s->cameras == 1 ? SUMMARY_EXPOSURES : SUMMARY_IMAGES))
            return;
        if (add || index <= middle)
            copy_text(s->image[add ? s->n_images++ : s->n_images - 1], sizeof s->image[0],
                      name + sizeof folder - 1);
        last = camera;
    }
}

err_t summary_read(const char *store, const char *id, struct summary *out)
{
    char dir[FILE_PATH_CAP], path[FILE_PATH_CAP];
    struct cJSON *doc = NULL;
    memset(out, 0, sizeof *out);
    err_t e = file_join(store, id, dir);
    if (!e)
        e = file_join(dir, MANIFEST_FILE, path);
    if (!e)
        e = json_read(path, &doc);
    if (e)
        return e;
    const struct cJSON *cameras = json_member(doc, "cameras");
    const char *status = json_string(json_member(doc, "status"));
    const char *session = json_string(json_member(doc, "session"));
    copy_text(out->id, sizeof out->id, id);
    copy_text(out->session, sizeof out->session, session && store_is_id(session) ? session : "");
    copy_text(out->reason, sizeof out->reason, json_string(json_member(doc, "reason")));
    out->complete = status && strcmp(status, "complete") == 0;
    out->cameras = json_count(cameras);
    out->frames = json_count(json_member(doc, "frames"));
    out->clipped = out->dark = -1;
    for (const struct cJSON *c = json_first(cameras); c; c = json_next(c))
        read_meter(json_member(c, "meter"), out);
    read_images(json_member(doc, "files"), out);
    json_free(doc);
    return OK;
}

int summary_warnings(const char *results, struct summary *s)
{
    char dir[FILE_PATH_CAP], path[FILE_PATH_CAP];
    struct stat st;
    struct cJSON *doc = NULL;
    if (file_join(results, scene_of(s), dir) != OK || file_join(dir, "report.json", path) != OK ||
        stat(path, &st) != 0)
        return -1;
    int64_t ns = (int64_t)st.st_mtim.tv_sec * 1000000000 + st.st_mtim.tv_nsec;
    if (ns == s->report_ns)
        return s->warnings;
    s->report_ns = ns;
    s->warnings = json_read(path, &doc) == OK ? json_count(json_member(doc, "warnings")) : -1;
    json_free(doc);
    return s->warnings;
}

void summary_write(const struct summary *s, int warnings, FILE *out)
{
    fputs("{\"id\": ", out);
    json_put_string(out, s->id);
    fprintf(out, ", \"complete\": %s, \"frames\": %d, \"cameras\": %d, \"result\": %s",
            s->complete ? "true" : "false", s->frames, s->cameras,
            warnings >= 0 ? "true" : "false");
    if (s->session[0])
        fprintf(out, ", \"session\": \"%s\"", s->session);
    if (warnings >= 0)
        fprintf(out, ", \"warnings\": %d", warnings);
    if (s->stops > 0)
        fprintf(out, ", \"stops\": %.1f", s->stops);
    if (s->clipped >= 0)
        fprintf(out, ", \"clipped\": %.4g, \"dark\": %.4g", s->clipped, s->dark);
    fputs(", \"reason\": ", out);
    json_put_string(out, s->reason);
    fputs(", \"images\": [", out);
    for (int i = 0; i < s->n_images; i++) {
        fputs(i ? ", " : "", out);
        json_put_string(out, s->image[i]);
    }
    fputs("]}", out);
}
