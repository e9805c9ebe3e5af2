#include "drivers/format/rawframe.h"

#include "drivers/device/unpack.h"
#include "drivers/format/img.h"

#include <stdlib.h>

static err_t check_mapped(const struct rawframe *f, const struct file_map *m, struct frame *out)
{
    *out = (struct frame){.data = m->p,
                          .bytes = m->n,
                          .w = f->info.w,
                          .h = f->info.h,
                          .stride = f->info.stride,
                          .format = f->info.format};
    if (f->info.format < CAMERA_GREY16)
        return err_fail(ERR_FORMAT, "%s: format %d is not linear", f->path, (int)f->info.format);
    err_t e = unpack_check(&f->info, out);
    return e ? err_fail(e, "%s: %s", f->path, err_text()) : OK;
}

static err_t map_frame(const struct rawframe *f, struct file_map *m, struct frame *out)
{
    err_t e = file_map(f->path, IMG_FILE_MAX, m);
    if (e)
        return e;
    e = check_mapped(f, m, out);
    if (e)
        file_unmap(m);
    return e;
}

err_t rawframe_check(const struct rawframe *f)
{
    struct file_map m;
    struct frame frame;
    err_t e = map_frame(f, &m, &frame);
    if (!e)
        file_unmap(&m);
    return e;
}

/* Noise brings half of the numbers of a dark frame below the black level, not nearly all. */
static err_t check_black(const char *name, const struct raw *raw)
{
    const size_t n = (size_t)raw->w * (size_t)raw->h;
    size_t below = 0;
    for (size_t i = 0; i < n; i++)
        below += raw->px[i] < raw->black;
    return below <= n / 10 * 9
               ? OK
               : err_fail(ERR_FORMAT,
                          "%s: %.0f %% of its numbers are below the black level, which must be "
                          "wrong",
                          name, 100.0 * (double)below / (double)n);
}

err_t rawframe_develop(const char *name, const struct raw *raw, const struct develop *how,
                       struct image16 *out)
{
    *out = (struct image16){0};
    err_t e = check_black(name, raw);
    if (e)
        return e;
    out->px = malloc(3 * (size_t)raw->w * (size_t)raw->h * sizeof *out->px);
    if (!out->px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", name, raw->w, raw->h);
    out->w = raw->w;
    out->h = raw->h;
    out->channels = 3;
    develop_run16(raw, how, out->px);
    return OK;
}

err_t rawframe_read(const struct rawframe *f, struct image16 *out)
{
    struct file_map m;
    struct frame frame;
    *out = (struct image16){0};
    err_t e = map_frame(f, &m, &frame);
    if (e)
        return e;
    struct raw raw = {.px = malloc(unpack_count(&f->info) * sizeof *raw.px)};
    if (!raw.px)
        e = err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", f->path, frame.w, frame.h);
    if (!e && unpack_run(&f->info, &frame, &raw) != OK)
        e = err_fail(ERR_FORMAT, "%s: %s", f->path, err_text());
    if (!e) {
        e = rawframe_develop(f->path, &raw, &f->how, out);
        if (e == ERR_FORMAT)
            e = err_fail(e, "%s (%d); without the folder raw the pictures are used", err_text(),
                         raw.black);
    }
    free(raw.px);
    file_unmap(&m);
    return e;
}
