/* A take is written under a temporary name, file by file, and shown by one rename.
 * Protocol: firmware/store/README.md 1. */
#include "firmware/store/ghosts.h"
#include "firmware/store/store_inner.h"
#include "firmware/store/store_media.h"

#include "core/base/log.h"
#include "drivers/format/img.h"
#include "drivers/format/thumbnail.h"

#include <stdlib.h>
#include <string.h>

/* A take being written. */
struct commit {
    struct store *s;
    const struct take *t;
    bool ghosts; // something moved in it
    struct store_new to;
};

static bool camera_is_full(const struct take *t, int camera)
{
    int n = 0;
    for (int i = 0; i < t->n; i++)
        n += t->frame[i].camera == camera;
    return n > 1;
}

static err_t check_frame(const struct take *t, int i)
{
    const struct take_frame *f = &t->frame[i], *last = i ? f - 1 : NULL;
    double exposure_s = take_exposure_s(f);
    if (f->camera < 0 || f->camera >= t->n_cameras || f->index < 0 ||
        f->index >= BRACKET_EXPOSURES_MAX || !f->data || f->bytes == 0 ||
        !(exposure_s > 0 && exposure_s < 1e6))
        return err_fail(
            ERR_ARG, "take: frame %d: camera %d of %d, exposure %d of %d, %zu bytes, %g s", i,
            f->camera, t->n_cameras, f->index, BRACKET_EXPOSURES_MAX, f->bytes, exposure_s);
    if (last &&
        (last->camera > f->camera || (last->camera == f->camera && last->index >= f->index)))
        return err_fail(ERR_ARG, "take: frame %d: not in order of camera and exposure", i);
    return OK;
}

static err_t check_rig(const struct take_rig *r)
{
    bool is_aborted;
    if (!r->take[0] ||
        (store_number(r->take, &is_aborted) && !is_aborted && manifest_is_member(r->member) &&
         (strcmp(r->clock, "exchange") == 0 || strcmp(r->clock, "kernel") == 0)))
        return OK;
    return err_fail(ERR_ARG, "take: part of \"%s\" by \"%s\" with the clock \"%s\"", r->take,
                    r->member, r->clock);
}

static err_t check_shape(const struct take *t)
{
    int least = t->status == TAKE_COMPLETE ? 1 : 0;
    if (t->n_cameras < 1 || t->n_cameras > BRACKET_CAMERAS_MAX || t->n > TAKE_FRAMES_MAX ||
        t->n < least)
        return err_fail(ERR_ARG, "take: %d cameras and %d frames, allowed are 1 to %d and %d to %d",
                        t->n_cameras, t->n, BRACKET_CAMERAS_MAX, least, TAKE_FRAMES_MAX);
    err_t e = check_rig(&t->rig);
    for (int i = 0; i < t->n && !e; i++)
        e = check_frame(t, i);
    return e;
}

static err_t check_room(const struct store *s, const struct take *t)
{
    uint64_t need = 1 << 20; // manifest and counter
    for (int c = 0; c < t->n_cameras; c++) {
        int frames = 0;
        for (int i = 0; i < t->n; i++)
            frames += t->frame[i].camera == c;
        need += store_media_need(&t->camera[c].info, frames, s->cfg.merge);
    }
    return store_room(s, need);
}

static err_t add_file(struct commit *c, const char *name)
{
    struct manifest *m = &c->s->manifest;
    struct manifest_file *f = &m->file[m->n++];
    char path[FILE_PATH_CAP];
    snprintf(f->name, sizeof f->name, "%s", name);
    err_t e = file_join(c->to.tmp, name, path);
    return e ? e : store_fs_hash(c->s->fs, path, &f->bytes, f->sha256);
}

static err_t put_bytes(struct commit *c, const char *name, const void *bytes, size_t n)
{
    char path[FILE_PATH_CAP];
    err_t e = file_join(c->to.tmp, name, path);
    if (!e)
        e = store_fs_write(c->s->fs, path, bytes, n);
    return e ? e : add_file(c, name);
}

static err_t put_mask(struct commit *c, const struct take_frame *f)
{
    char name[MANIFEST_NAME_CAP], path[FILE_PATH_CAP];
    manifest_mask_name(f->camera, f->index, name);
    err_t e = file_join(c->to.tmp, name, path);
    if (!e)
        e = ghosts_write(c->s->fs, c->t, f, path);
    return e ? e : add_file(c, name);
}

/* im: its display picture; NULL: the frame is a JPEG. One that cannot be made, of a JPEG that a
 * camera cut off, must not cost the take. */
static err_t put_thumb(struct commit *c, const struct take_frame *f, const struct image8 *im)
{
    char name[MANIFEST_NAME_CAP];
    void *bytes;
    size_t n;
    manifest_thumb_name(f->camera, f->index, name);
    if ((im ? thumbnail_make(im, name, &bytes, &n)
            : thumbnail_of_jpeg(f->data, f->bytes, name, &bytes, &n)) != OK) {
        log_warn("%s: has no %s", c->s->manifest.id, err_text());
        return OK;
    }
    err_t e = put_bytes(c, name, bytes, n);
    free(bytes);
    return e;
}

static err_t put_picture(struct commit *c, const struct take_frame *f)
{
    char name[MANIFEST_NAME_CAP];
    struct image8 im;
    void *bytes = NULL;
    size_t n;
    manifest_picture_name(c->t, f, name);
    err_t e = store_media_develop(c->t, f, &c->s->manifest.how, &im);
    if (!e)
        e = img_encode_png_fast(&im, name, &bytes, &n);
    if (!e)
        e = put_bytes(c, name, bytes, n);
    free(bytes);
    if (!e)
        e = put_thumb(c, f, &im);
    img_free(&im);
    return e;
}

static err_t put_frame(struct commit *c, const struct take_frame *f)
{
    char name[MANIFEST_NAME_CAP];
    manifest_raw_name(c->t, f, name);
    err_t e = put_bytes(c, name, f->data, f->bytes);
    if (e || c->t->status != TAKE_COMPLETE)
        return e;
    if (f->ghost.moved)
        e = put_mask(c, f);
    if (e)
        return e;
    return manifest_is_jpeg(c->t, f) ? put_thumb(c, f, NULL) : put_picture(c, f);
}

static err_t put_merged(struct commit *c)
{
    char name[MANIFEST_NAME_CAP], path[FILE_PATH_CAP];
    err_t e = OK;
    for (int i = 0; i < c->t->n_cameras && !e; i++) {
        if (!camera_is_full(c->t, i))
            continue;
        snprintf(name, sizeof name, "merged/%02d.exr", i);
        e = file_join(c->to.tmp, name, path);
        if (!e)
            e = store_media_merge(c->s->fs, c->t, i, &c->s->manifest.how, path);
        if (!e)
            e = add_file(c, name);
    }
    return e;
}

static bool is_merged_name(const char *name)
{
    return strlen(name) == 6 && strspn(name, "0123456789") == 2 && !strcmp(name + 2, ".exr");
}

/* Merged radiance can be made again, frames cannot: a full disk must not cost the frames. */
static void give_up_merging(struct commit *c)
{
    struct manifest *m = &c->s->manifest;
    char path[FILE_PATH_CAP];
    snprintf(m->not_merged, sizeof m->not_merged, "%s", err_text());
    log_warn("%s: not merged, the frames are kept: %s", m->id, m->not_merged);
    while (m->n > 0 && strncmp(m->file[m->n - 1].name, "merged/", 7) == 0)
        m->n--;
    if (file_join(c->to.tmp, "merged", path) == OK)
        store_fs_remove(c->s->fs, path, is_merged_name);
}

/* exposure.json, for `hdrig reconstruct --images`. */
static err_t put_exposures(struct commit *c)
{
    char path[FILE_PATH_CAP], name[MANIFEST_NAME_CAP];
    struct store_fs_file f;
    err_t e = store_create(&c->to, "exposure.json", path, &f);
    if (e)
        return e;
    for (int i = 0; i < c->t->n; i++) {
        manifest_picture_name(c->t, &c->t->frame[i], name);
        fprintf(f.stream, "%s\n  \"%s\": %.9g", i ? "," : "{", name + strlen("images/"),
                take_exposure_s(&c->t->frame[i]));
    }
    fputs("\n}\n", f.stream);
    e = store_fs_finish(&f);
    return e ? e : add_file(c, "exposure.json");
}

static err_t put_manifest(struct commit *c)
{
    char path[FILE_PATH_CAP];
    struct store_fs_file f;
    err_t e = store_create(&c->to, MANIFEST_FILE, path, &f);
    if (e)
        return e;
    manifest_write(f.stream, &c->s->manifest, c->t);
    return store_fs_finish(&f);
}

/* The folders of the take: made before its files, synced after them. */
static err_t each_folder(const struct commit *c, bool merge,
                         err_t (*act)(const struct store_fs *, const char *))
{
    const bool complete = c->t->status == TAKE_COMPLETE;
    const char *const folders[] = {"raw", complete ? "images" : NULL, complete ? "thumbs" : NULL,
                                   complete && merge ? "merged" : NULL,
                                   complete && c->ghosts ? "masks" : NULL};
    char path[FILE_PATH_CAP];
    err_t e = OK;
    for (size_t i = 0; i < sizeof folders / sizeof folders[0] && !e; i++) {
        if (!folders[i])
            continue;
        e = file_join(c->to.tmp, folders[i], path);
        if (!e)
            e = act(c->s->fs, path);
    }
    return e;
}

static err_t write_take(struct commit *c)
{
    const struct take *t = c->t;
    bool merge = false;
    for (int i = 0; i < t->n_cameras; i++)
        merge = merge || (c->s->cfg.merge && camera_is_full(t, i));
    err_t e = store_fs_mkdir(c->s->fs, c->to.tmp);
    if (!e)
        e = each_folder(c, merge, store_fs_mkdir);
    if (!e && t->status == TAKE_COMPLETE) {
        c->s->manifest.how = t->balance;
        e = t->balance.red > 0.0f ? OK : store_media_balance(t, &c->s->manifest.how);
    }
    for (int i = 0; i < t->n && !e; i++)
        e = put_frame(c, &t->frame[i]);
    if (!e && t->status == TAKE_COMPLETE)
        e = put_exposures(c);
    if (!e && t->status == TAKE_COMPLETE && merge && put_merged(c) != OK) {
        give_up_merging(c);
        merge = false;
    }
    if (!e)
        e = put_manifest(c);
    if (!e)
        e = each_folder(c, merge, store_fs_sync_dir);
    return e ? e : store_fs_sync_dir(c->s->fs, c->to.tmp);
}

static err_t name_take(struct commit *c)
{
    const bool complete = c->t->status == TAKE_COMPLETE;
    struct manifest *m = &c->s->manifest;
    char id[STORE_ID_CAP];
    uint64_t number;
    memset(m, 0, sizeof *m);
    err_t e = store_next(c->s, &number, id);
    if (e)
        return e;
    memcpy(m->boot, c->s->boot, sizeof m->boot);
    m->counter = number;
    snprintf(m->id, sizeof m->id, "%s%.20s", complete ? "" : STORE_ABORTED, id);
    if (c->t->is_place && complete)
        snprintf(m->session, sizeof m->session, "%s", c->t->session[0] ? c->t->session : m->id);
    return store_name(c->s, m->id, &c->to);
}

err_t store_commit(struct store *s, struct take *t, char id[STORE_ID_CAP])
{
    struct commit c = {.s = s, .t = t};
    char why[512];
    id[0] = 0;
    err_t e = check_shape(t);
    if (!e)
        e = check_room(s, t);
    if (!e && t->status == TAKE_COMPLETE)
        c.ghosts = ghosts_note(t, s->cfg.moved);
    if (!e)
        e = name_take(&c);
    if (e)
        return e;
    e = write_take(&c);
    if (!e)
        e = store_show(&c.to);
    if (e) {
        snprintf(why, sizeof why, "%s", err_text());
        store_take_back(&c.to);
        return err_fail(e, "%s", why);
    }
    snprintf(id, STORE_ID_CAP, "%s", s->manifest.id);
    pthread_mutex_lock(&s->lock);
    store_keep_newest(s, t->status != TAKE_COMPLETE, s->manifest.session);
    pthread_mutex_unlock(&s->lock);
    return OK;
}
