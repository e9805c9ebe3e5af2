#include "firmware/store/ghosts.h"

#include "firmware/store/store_media.h"

#include "core/base/log.h"
#include "core/photo/ghost.h"
#include "core/photo/ghost_shrink.h"
#include "drivers/format/img.h"

#include <stdlib.h>
#include <string.h>

/* The frames of one camera. */
struct bracket {
    int n;
    struct take_frame *frame[BRACKET_EXPOSURES_MAX];
    struct raw raw[BRACKET_EXPOSURES_MAX];
    double exposure_s[BRACKET_EXPOSURES_MAX];
    struct ghost_mask mask[BRACKET_EXPOSURES_MAX];
};

enum { SIDE = 1024 }; // px: longer frames are compared smaller

/* The take keeps masks that are not empty. */
static err_t keep_masks(const struct bracket *b)
{
    for (int i = 0; i < b->n; i++) {
        struct ghost_mask *to = &b->frame[i]->ghost;
        const size_t cells = (size_t)b->mask[i].cols * (size_t)b->mask[i].rows;
        *to = b->mask[i];
        to->moved = NULL;
        b->frame[i]->compared = true;
        if (!(to->share > 0))
            continue;
        to->moved = malloc(cells);
        if (!to->moved)
            return err_fail(ERR_NOMEM, "no memory for a mask of %zu cells", cells);
        memcpy(to->moved, b->mask[i].moved, cells);
    }
    return OK;
}

static int shrink_frames(struct bracket *b)
{
    const int side = b->raw[0].w > b->raw[0].h ? b->raw[0].w : b->raw[0].h;
    const int k = (side + SIDE - 1) / SIDE;
    for (int i = 0; i < b->n; i++)
        ghost_shrink_frame(&b->raw[i], k);
    return k;
}

static err_t compare_frames(const struct take *t, int camera, struct bracket *b)
{
    static const struct develop as_is = {1, 1};
    const struct take_camera *c = &t->camera[camera];
    const struct merge_set set = {b->raw, b->n, b->exposure_s, c->has_crf ? &c->crf : NULL,
                                  &as_is, NULL};
    struct arena a = {0};
    const int k = shrink_frames(b);
    err_t e = arena_init(&a, "what moved", ghost_plan(b->raw, b->n));
    if (!e)
        e = ghost_run(&a, &set, ghost_reference(&set), b->mask);
    for (int i = 0; i < b->n && !e; i++)
        ghost_shrink_undo(&b->mask[i], k);
    if (!e)
        e = keep_masks(b);
    arena_free(&a);
    return e;
}

static err_t compare_camera(struct take *t, int camera)
{
    struct bracket b = {0};
    err_t e = OK;
    for (int i = 0; i < t->n && !e; i++) {
        struct take_frame *f = &t->frame[i];
        if (f->camera != camera)
            continue;
        b.frame[b.n] = f;
        b.exposure_s[b.n] = take_exposure_s(f);
        e = store_media_unpack(t, f, &b.raw[b.n]);
        b.n += !e;
    }
    if (!e && b.n > 1)
        e = compare_frames(t, camera, &b);
    while (b.n > 0)
        free(b.raw[--b.n].px);
    return e;
}

static err_t compare_all(struct take *t)
{
    err_t e = OK;
    for (int i = 0; i < t->n; i++)
        if (t->frame[i].compared)
            return OK; // a take that is stored again
    for (int i = 0; i < t->n_cameras && !e; i++)
        e = compare_camera(t, i);
    return e;
}

bool ghosts_note(struct take *t, double share)
{
    const struct take_frame *most = NULL;
    const size_t n = strlen(t->reason);
    if (compare_all(t) != OK)
        log_warn("the exposures of a take were not compared: %s", err_text());
    for (int i = 0; i < t->n; i++)
        if (t->frame[i].ghost.moved && (!most || t->frame[i].ghost.share > most->ghost.share))
            most = &t->frame[i];
    if (share > 0 && most && most->ghost.share > share && !strstr(t->reason, "take it again"))
        snprintf(t->reason + n, sizeof t->reason - n,
                 "%s%.0f %% of camera %d's picture moved between its exposures: take it again",
                 n ? "; " : "", 100 * most->ghost.share, most->camera + 1);
    return most != NULL;
}

err_t ghosts_write(const struct store_fs *fs, const struct take *t, const struct take_frame *f,
                   const char *path)
{
    const struct camera_info *info = &t->camera[f->camera].info;
    const size_t px = (size_t)info->w * (size_t)info->h;
    struct image8 im = {info->w, info->h, 3, malloc(3 * px)};
    void *bytes = NULL;
    size_t n;
    if (!im.px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", path, info->w, info->h);
    for (size_t i = 0; i < px; i++) {
        const int x = (int)(i % (size_t)info->w), y = (int)(i / (size_t)info->w);
        memset(im.px + 3 * i, ghost_mask_at(&f->ghost, x, y) ? 0 : 255, 3);
    }
    err_t e = img_encode_png_fast(&im, path, &bytes, &n);
    if (!e)
        e = store_fs_write(fs, path, bytes, n);
    free(bytes);
    free(im.px);
    return e;
}
