#include "firmware/capture/frame_buffer.h"

#include "drivers/format/subsample.h"

#include <stdlib.h>
#include <string.h>

err_t frame_buffer_add(struct frame_buffer *r, const struct take_frame *t, const struct frame *f,
                       bool used)
{
    if (r->n == FRAME_BUFFER_MAX)
        return err_fail(ERR_LIMIT, "camera %d: more than %d frames cannot be kept", t->camera,
                        FRAME_BUFFER_MAX);
    uint8_t *copy = malloc(f->bytes);
    if (!copy)
        return err_fail(ERR_NOMEM, "camera %d: no memory for a frame of %zu bytes", t->camera,
                        f->bytes);
    memcpy(copy, f->data, f->bytes);
    struct take_frame *kept = &r->kept[r->n].frame;
    *kept = *t;
    kept->data = copy;
    kept->bytes = f->bytes;
    kept->gains_known = f->gains_known;
    kept->digital_gain = f->digital_gain;
    kept->red_gain = f->red_gain;
    kept->blue_gain = f->blue_gain;
    kept->lens_known = f->lens_known;
    kept->lens = f->lens;
    r->kept[r->n++].used = used;
    return OK;
}

void frame_buffer_cut(struct frame_buffer *r, int from)
{
    for (int k = from; k < r->n; k++)
        free(r->kept[k].frame.data);
    r->n = from < r->n ? from : r->n;
}

size_t frame_buffer_bytes(const struct frame_buffer *r)
{
    size_t sum = 0;
    for (int k = 0; k < r->n; k++)
        sum += r->kept[k].frame.bytes;
    return sum;
}

int frame_buffer_used(const struct frame_buffer *r)
{
    int n = 0;
    for (int k = 0; k < r->n; k++)
        n += r->kept[k].used;
    return n;
}

static err_t subsample_kept(const struct frame_buffer *r, int k, const struct camera_info *info,
                            struct raw *out)
{
    const struct take_frame *t = &r->kept[k].frame;
    struct frame f = {.data = t->data,
                      .bytes = t->bytes,
                      .w = info->w,
                      .h = info->h,
                      .stride = info->stride,
                      .format = info->format};
    return subsample_run(info, &f, out);
}

static const struct crf *crf_of(const struct take_camera *c)
{
    return c->has_crf ? &c->crf : NULL;
}

err_t frame_buffer_meter(const struct frame_buffer *r, int from, const struct take_camera *c,
                         struct raw *px, struct meter *m)
{
    err_t e = OK;
    for (int k = from; k < r->n && !e; k++) {
        e = subsample_kept(r, k, &c->info, px);
        if (!e)
            meter_add(m, px, crf_of(c), take_exposure_s(&r->kept[k].frame));
    }
    return e;
}

void frame_buffer_cover(const struct frame_buffer *r, const struct take_camera *c,
                        const struct meter_config *cfg, struct meter_coverage *out)
{
    struct raw px[FRAME_BUFFER_MAX];
    double exposure[FRAME_BUFFER_MAX];
    size_t count = subsample_count(&c->info);
    int n = 0;
    *out = (struct meter_coverage){0};
    uint16_t *all = r->n ? malloc(count * sizeof *all * (size_t)r->n) : NULL;
    for (int k = 0; all && k < r->n; k++) {
        px[n].px = all + count * (size_t)n;
        if (r->kept[k].used && subsample_kept(r, k, &c->info, &px[n]) == OK)
            exposure[n++] = take_exposure_s(&r->kept[k].frame);
    }
    if (n > 0)
        meter_check(cfg, px, n, crf_of(c), exposure, out);
    free(all);
}

static int by_exposure(const void *a, const void *b)
{
    double x = take_exposure_s(a), y = take_exposure_s(b);
    return (x > y) - (x < y);
}

void frame_buffer_move(struct frame_buffer *r, struct take *t)
{
    int first = t->n;
    for (int k = 0; k < r->n; k++) {
        if (r->kept[k].used && t->n - first < BRACKET_EXPOSURES_MAX && t->n < TAKE_FRAMES_MAX)
            t->frame[t->n++] = r->kept[k].frame;
        else
            free(r->kept[k].frame.data);
    }
    r->n = 0;
    qsort(t->frame + first, (size_t)(t->n - first), sizeof t->frame[0], by_exposure);
    for (int k = first; k < t->n; k++)
        t->frame[k].index = k - first;
}
