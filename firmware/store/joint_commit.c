/* One part after another is read, compared with its files, and added to the manifest of the joint
 * take; only then is something written. So that one document of a part, which may be hostile, is in
 * memory at a time, cameras and frames are collected as text. */
#include "firmware/store/joint.h"

#include "firmware/store/part.h"
#include "firmware/store/store_inner.h"

#include "core/base/log.h"
#include "drivers/format/json.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { EXPOSURES = BRACKET_EXPOSURES_MAX };

static const char exposures[] = "exposure.json";

struct text {
    FILE *f;
    char *p;
    size_t n;
};

/* A joint take in the making. */
struct work {
    struct store *s;
    const struct joint *j;
    struct store_new to;
    struct manifest m;
    struct take head; // what is neither a camera nor a frame
    struct source {
        int member;
        char name[MANIFEST_NAME_CAP];
    } from[MANIFEST_FILES_MAX]; // of the files in m
    struct shot {
        double exposure_s;
        char picture[MANIFEST_NAME_CAP];
    } frame[MANIFEST_FRAMES_MAX];
    int n, n_cameras;
    bool is_merged, is_masked, is_balanced, differs;
    int64_t first_ns[EXPOSURES], last_ns[EXPOSURES]; // starts on the common clock
    int starts[EXPOSURES];
    struct text rig, cameras, frames;
    struct part part;
};

/* ---- the request ---- */

static err_t check_member(const char *const *list, int n, int i)
{
    if (!manifest_is_member(list[i]))
        return err_fail(ERR_ARG, "\"%.40s\" is not the name of a board", list[i]);
    for (int k = i + 1; k < n; k++)
        if (strcmp(list[k], list[i]) == 0)
            return err_fail(ERR_ARG, "board %s is named twice", list[i]);
    return OK;
}

static err_t check_joint(const struct joint *j)
{
    err_t e = OK;
    if (j->n < 1 || j->n > JOINT_MEMBERS_MAX || j->n_missing < 0 ||
        j->n_missing > JOINT_MEMBERS_MAX)
        return err_fail(ERR_ARG, "take %s: %d boards and %d missing ones, 1 to %d can be a rig",
                        j->id, j->n, j->n_missing, JOINT_MEMBERS_MAX);
    for (int i = 0; i < j->n && !e; i++)
        e = check_member(j->member, j->n, i);
    for (int i = 0; i < j->n_missing && !e; i++)
        e = check_member(j->missing, j->n_missing, i);
    return e;
}

/* Boot of the conductor when the take was ordered. */
static err_t read_boot(struct work *w, const char *staging)
{
    char path[FILE_PATH_CAP];
    size_t n = 0;
    err_t e = file_join(staging, STORE_RIG_BOOT, path);
    if (!e)
        e = store_fs_read(w->s->fs, path, w->m.boot, sizeof w->m.boot - 1, &n);
    if (!e && (n != strlen(w->s->boot) || w->m.boot[strspn(w->m.boot, "0123456789abcdef-")] ||
               strncmp(w->m.boot, w->j->id, strcspn(w->j->id, "-")) != 0))
        e = err_fail(ERR_FORMAT, "%s: not the boot id of take %s", path, w->j->id);
    return e;
}

/* ---- the parts ---- */

/* Add a sentence to the take's reason. */
static void add_reason(struct work *w, const char *who, const char *what)
{
    char *reason = w->head.reason;
    const size_t n = strlen(reason);
    if (*what && !strstr(reason, what))
        snprintf(reason + n, sizeof w->head.reason - n, "%s%s%s%s", n ? "; " : "", who,
                 *who ? ": " : "", what);
}

/* All pictures are developed with one balance: that of the first board with a mosaic. */
static void add_balance(struct work *w)
{
    const struct develop *a = &w->m.how, *b = &w->part.how;
    if (w->is_balanced && w->part.is_mosaic)
        w->differs = w->differs || fabs((double)(a->red / b->red) - 1) > 0.01 ||
                     fabs((double)(a->blue / b->blue) - 1) > 0.01;
    else if (w->part.is_mosaic || !(w->m.how.red > 0.0f))
        w->m.how = w->part.how;
    w->is_balanced = w->is_balanced || w->part.is_mosaic;
}

static void add_head(struct work *w, int i)
{
    const struct part *p = &w->part;
    struct take *h = &w->head;
    add_balance(w);
    add_reason(w, w->j->member[i], p->reason);
    if (!w->m.not_merged[0] && p->not_merged[0])
        snprintf(w->m.not_merged, sizeof w->m.not_merged, "%s: %.200s", w->j->member[i],
                 p->not_merged);
    h->stagger = h->stagger || p->stagger;
    h->metered = (h->metered || i == 0) && p->metered;
    h->tolerance = fmax(h->tolerance, p->tolerance); // of a NaN, the other
    h->frames_used = h->frames_used > p->frames_used ? h->frames_used : p->frames_used;
    h->rejected = h->rejected < INT32_MAX - p->rejected ? h->rejected + p->rejected : INT32_MAX;
}

static void add_frames(struct work *w)
{
    for (int i = 0; i < w->part.n; i++) {
        const struct part_frame *f = &w->part.frame[i];
        const int k = f->index;
        struct shot *x = &w->frame[w->n++];
        x->exposure_s = f->exposure_s;
        part_rename(f->picture, w->n_cameras, x->picture);
        if (!w->starts[k] || f->common_ns < w->first_ns[k])
            w->first_ns[k] = f->common_ns;
        if (!w->starts[k] || f->common_ns > w->last_ns[k])
            w->last_ns[k] = f->common_ns;
        w->starts[k]++;
    }
}

static void add_member(struct work *w, int i)
{
    const struct manifest *m = &w->part.manifest;
    fprintf(w->rig.f, "%s{\"name\": \"%s\", \"part\": \"%s\", \"boot_id\": \"%s\", ",
            i ? ",\n    " : "\n    ", w->j->member[i], m->id, m->boot);
    fprintf(w->rig.f, "\"cameras\": %d, \"clock\": \"%s\", \"within_ns\": \"%" PRId64 "\"}",
            w->part.n_cameras, w->part.clock, w->part.within_ns);
}

/* After a sync that failed the kernel may have dropped the bytes, and the next sync would not say
 * so: such a file goes, and has to be fetched again. */
static err_t sync_staged(const struct work *w, const char *path)
{
    err_t e = store_fs_sync(w->s->fs, path);
    if (e)
        w->s->fs->unlink(path);
    return e;
}

/* Every file is as the manifest says, and on the disk; a thumbnail that is not is left out. */
static err_t add_files(struct work *w, int member, const char *dir)
{
    const struct manifest *m = &w->part.manifest;
    char path[FILE_PATH_CAP];
    err_t e = OK;
    for (int i = 0; i < m->n && !e; i++) {
        e = store_check_file(w->s->fs, dir, &m->file[i]);
        if (e && manifest_is_thumb(m->file[i].name)) {
            e = OK;
            continue;
        }
        if (e || strcmp(m->file[i].name, exposures) == 0)
            continue;
        struct source *from = &w->from[w->m.n];
        struct manifest_file *to = &w->m.file[w->m.n++];
        from->member = member;
        memcpy(from->name, m->file[i].name, sizeof from->name);
        *to = m->file[i];
        part_rename(from->name, w->n_cameras, to->name);
        w->is_merged = w->is_merged || strncmp(to->name, "merged/", 7) == 0;
        w->is_masked = w->is_masked || strncmp(to->name, "masks/", 6) == 0;
        e = file_join(dir, from->name, path);
        if (!e)
            e = sync_staged(w, path);
    }
    return e;
}

static err_t add_part(struct work *w, int i)
{
    struct part *p = &w->part;
    char dir[FILE_PATH_CAP];
    err_t e = joint_part_path(w->s->path, w->j->id, w->j->member[i], dir);
    if (!e)
        e = part_read(w->s->fs, dir, w->j->id, w->j->member[i], p);
    if (e)
        return e;
    if (w->n_cameras + p->n_cameras > MANIFEST_CAMERAS_MAX)
        e = err_fail(ERR_LIMIT, "take %s: %d cameras up to board %s, at most %d are one take",
                     w->j->id, w->n_cameras + p->n_cameras, w->j->member[i], MANIFEST_CAMERAS_MAX);
    if (!e)
        e = add_files(w, i, dir);
    if (!e) {
        add_head(w, i);
        add_frames(w);
        add_member(w, i);
        part_put_cameras(w->cameras.f, p, w->n_cameras);
        part_put_frames(w->frames.f, p, w->n_cameras);
        w->n_cameras += p->n_cameras;
    }
    part_free(p);
    return e;
}

/* ---- the text ---- */

static bool text_open(struct text *t)
{
    t->f = open_memstream(&t->p, &t->n);
    return t->f != NULL;
}

static bool text_close(struct text *t)
{
    bool ok = t->f && !ferror(t->f);
    if (t->f && fclose(t->f) != 0)
        ok = false;
    t->f = NULL;
    return ok && t->p;
}

static void text_free(struct text *t)
{
    (void)!text_close(t); // there is an error already, or nothing to close
    free(t->p);
}

/* Head fields that all parts decide together. */
static void finish_head(struct work *w)
{
    char missing[TAKE_TEXT] = "";
    double skew = 0;
    for (int k = 0; k < EXPOSURES; k++)
        skew = w->starts[k] ? fmax(skew, (double)(w->last_ns[k] - w->first_ns[k]) / 1e9) : skew;
    w->head.skew_s = skew;
    if (w->differs)
        add_reason(w, "", "white balance differs between boards");
    for (int i = 0; i < w->j->n_missing; i++) {
        size_t n = strlen(missing);
        snprintf(missing + n, sizeof missing - n, "%s%s", i ? ", " : "", w->j->missing[i]);
    }
    add_reason(w, "missing boards", missing);
}

static err_t collect(struct work *w)
{
    const struct joint *j = w->j;
    err_t e = OK;
    w->head.tolerance = NAN;
    w->head.trigger = j->trigger;
    w->head.clock_synced = j->clock_synced;
    if (!text_open(&w->rig) || !text_open(&w->cameras) || !text_open(&w->frames))
        return err_fail(ERR_NOMEM, "take %s: no memory for its manifest", j->id);
    fprintf(w->rig.f, "{\"take\": \"%s\", \"members\": [", j->id);
    for (int i = 0; i < j->n && !e; i++)
        e = add_part(w, i);
    if (e)
        return e;
    fputs("], \"missing\": [", w->rig.f);
    for (int i = 0; i < j->n_missing; i++)
        fprintf(w->rig.f, "%s\"%s\"", i ? ", " : "", j->missing[i]);
    fputs("]}", w->rig.f);
    finish_head(w);
    if (!text_close(&w->rig) || !text_close(&w->cameras) || !text_close(&w->frames))
        return err_fail(ERR_NOMEM, "take %s: no memory for its manifest", j->id);
    return OK;
}

/* ---- the files ---- */

static err_t each_folder(const struct work *w, err_t (*act)(const struct store_fs *, const char *))
{
    char path[FILE_PATH_CAP];
    err_t e = OK;
    for (int i = 1; i < STORE_FOLDERS && !e; i++) {
        if ((strcmp(store_folders[i], "merged") == 0 && !w->is_merged) ||
            (strcmp(store_folders[i], "masks") == 0 && !w->is_masked))
            continue;
        e = file_join(w->to.tmp, store_folders[i], path);
        if (!e)
            e = act(w->s->fs, path);
    }
    return e;
}

static err_t link_file(const struct work *w, int i)
{
    char dir[FILE_PATH_CAP], from[FILE_PATH_CAP], to[FILE_PATH_CAP];
    bool copied = false;
    err_t e = joint_part_path(w->s->path, w->j->id, w->j->member[w->from[i].member], dir);
    if (!e)
        e = file_join(dir, w->from[i].name, from);
    if (!e)
        e = file_join(w->to.tmp, w->m.file[i].name, to);
    if (!e)
        e = store_fs_link(w->s->fs, from, to, &copied);
    return e || !copied ? e : store_check_file(w->s->fs, w->to.tmp, &w->m.file[i]);
}

static err_t put_exposures(struct work *w)
{
    struct manifest_file *m = &w->m.file[w->m.n++];
    char path[FILE_PATH_CAP];
    struct store_fs_file f;
    snprintf(m->name, sizeof m->name, "%s", exposures);
    err_t e = store_create(&w->to, exposures, path, &f);
    if (e)
        return e;
    for (int i = 0; i < w->n; i++)
        fprintf(f.stream, "%s\n  \"%s\": %.9g", i ? "," : "{",
                w->frame[i].picture + strlen("images/"), w->frame[i].exposure_s);
    fputs("\n}\n", f.stream);
    e = store_fs_finish(&f);
    return e ? e : store_fs_hash(w->s->fs, path, &m->bytes, m->sha256);
}

/* Which also has to be one that can be read. */
static err_t put_manifest(struct work *w)
{
    const struct manifest_lists lists = {w->rig.p, w->cameras.p, w->frames.p};
    char path[FILE_PATH_CAP];
    struct store_fs_file f;
    err_t e = store_create(&w->to, MANIFEST_FILE, path, &f);
    if (e)
        return e;
    manifest_write_joint(f.stream, &w->m, &w->head, &lists);
    e = store_fs_finish(&f);
    return e ? e : store_check_manifest(w->s->fs, w->to.tmp, &w->part.manifest);
}

static err_t write_take(struct work *w)
{
    store_fs_remove(w->s->fs, w->to.tmp, store_files_of_take); // of a try that could not be removed
    err_t e = store_fs_mkdir(w->s->fs, w->to.tmp);
    if (!e)
        e = each_folder(w, store_fs_mkdir);
    for (int i = 0, n = w->m.n; i < n && !e; i++)
        e = link_file(w, i);
    if (!e)
        e = put_exposures(w);
    if (!e)
        e = put_manifest(w);
    if (!e)
        e = each_folder(w, store_fs_sync_dir);
    return e ? e : store_fs_sync_dir(w->s->fs, w->to.tmp);
}

static err_t write_and_show(struct work *w)
{
    char why[512];
    err_t e = write_take(w);
    if (!e)
        e = store_show(&w->to);
    if (!e)
        return OK;
    snprintf(why, sizeof why, "%s", err_text());
    store_take_back(&w->to);
    return err_fail(e, "%s", why);
}

static err_t run(struct work *w)
{
    char staging[FILE_PATH_CAP], name[STORE_ID_CAP + 8];
    bool is_aborted;
    err_t e = check_joint(w->j);
    if (e)
        return e;
    w->m.counter = store_number(w->j->id, &is_aborted);
    if (!w->m.counter || is_aborted || !store_is_id(w->j->id))
        return err_fail(ERR_ARG, "\"%.40s\" is not the id of a take", w->j->id);
    snprintf(w->m.id, sizeof w->m.id, "%s", w->j->id);
    snprintf(name, sizeof name, STORE_RIG "%s", w->m.id);
    e = file_join(w->s->path, name, staging);
    if (!e)
        e = read_boot(w, staging);
    if (!e)
        e = store_name(w->s, w->m.id, &w->to);
    if (!e && file_exists(w->to.path))
        e = err_fail(ERR_IO, "%s: the take is there already", w->to.path);
    if (!e)
        e = collect(w);
    return e ? e : write_and_show(w);
}

err_t joint_commit(struct store *s, const struct joint *j)
{
    struct work *w = calloc(1, sizeof *w);
    if (!w)
        return err_fail(ERR_NOMEM, "take %s: no memory to put it together", j->id);
    w->s = s;
    w->j = j;
    err_t e = run(w);
    text_free(&w->rig);
    text_free(&w->cameras);
    text_free(&w->frames);
    free(w);
    if (e)
        return e;
    if (joint_drop(s, j->id) != OK)
        log_warn("%s", err_text());
    pthread_mutex_lock(&s->lock);
    store_keep_newest(s, false, "");
    pthread_mutex_unlock(&s->lock);
    return OK;
}
