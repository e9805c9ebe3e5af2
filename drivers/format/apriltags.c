/* The library counts pixels from their corners (a pixel's centre is at .5) since 3.1; its ideal tag
 * has y down, and its corners begin at the lower left. */
#include "drivers/format/apriltags.h"

/* Inline functions of these convert without saying so. */
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Wsign-conversion"
#pragma GCC diagnostic ignored "-Wstrict-prototypes"
#pragma GCC diagnostic ignored "-Wshadow"
#pragma GCC diagnostic ignored "-Wundef"
#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>
#pragma GCC diagnostic pop

#include <stdlib.h>
#include <string.h>

enum { SIDE_LEAST = 16, WRONG_BITS = 1, RIM = 3, LARGE = 4000000 };

struct apriltags {
    apriltag_family_t *family;
    apriltag_detector_t *detector;
};

err_t apriltags_cells(int id, uint8_t out[APRILTAGS_EDGE][APRILTAGS_EDGE])
{
    apriltag_family_t *f = tag36h11_create();
    if (!f)
        return err_fail(ERR_NOMEM, "no memory for tag %d", id);
    const uint64_t code = f->codes[id];
    memset(out, 0, APRILTAGS_EDGE * APRILTAGS_EDGE);
    for (uint32_t i = 0; i < f->nbits; i++)
        out[f->bit_y[i]][f->bit_x[i]] = code >> (f->nbits - 1 - i) & 1;
    tag36h11_destroy(f);
    return OK;
}

err_t apriltags_open(struct apriltags **out)
{
    struct apriltags *a = calloc(1, sizeof *a);
    *out = a;
    if (a) {
        a->family = tag36h11_create();
        a->detector = apriltag_detector_create();
    }
    if (!a || !a->family || !a->detector) {
        apriltags_close(a);
        *out = NULL;
        return err_fail(ERR_NOMEM, "no memory to look for tags");
    }
    apriltag_detector_add_family_bits(a->detector, a->family, WRONG_BITS);
    a->detector->nthreads = 1;
    return OK;
}

void apriltags_close(struct apriltags *a)
{
    if (!a)
        return;
    if (a->detector)
        apriltag_detector_destroy(a->detector);
    if (a->family)
        tag36h11_destroy(a->family);
    free(a);
}

static struct apriltags_tag tag_of(const apriltag_detection_t *d)
{
    static const int from[4] = {3, 2, 1, 0};
    struct apriltags_tag out = {
        .id = d->id, .wrong_bits = d->hamming, .margin = d->decision_margin};
    for (int k = 0; k < 4; k++)
        memcpy(out.corner[k], d->p[from[k]], sizeof out.corner[k]);
    return out;
}

/* A tag that the edge of the picture cuts has corners there. */
static bool is_whole(const struct apriltags_tag *t, int w, int h)
{
    for (int k = 0; k < 4; k++)
        if (!(t->corner[k][0] >= RIM && t->corner[k][0] <= w - RIM && t->corner[k][1] >= RIM &&
              t->corner[k][1] <= h - RIM))
            return false;
    return true;
}

/* By id, then from the top: the same order for every run. */
static int by_id(const void *a, const void *b)
{
    const struct apriltags_tag *x = a, *y = b;
    if (x->id != y->id)
        return x->id - y->id;
    return (x->corner[0][1] > y->corner[0][1]) - (x->corner[0][1] < y->corner[0][1]);
}

err_t apriltags_find(struct apriltags *a, const uint8_t *grey, int w, int h,
                     struct apriltags_tag *out, int *n)
{
    image_u8_t im = {.width = w, .height = h, .stride = w, .buf = (uint8_t *)(uintptr_t)grey};
    *n = 0;
    if (w < SIDE_LEAST || h < SIDE_LEAST)
        return err_fail(ERR_ARG, "tags: a picture of %d x %d px, at least %d are needed", w, h,
                        SIDE_LEAST);
    a->detector->quad_decimate = (int64_t)w * h > LARGE ? 2 : 1; // edges are refined in full
    zarray_t *found = apriltag_detector_detect(a->detector, &im);
    if (!found)
        return err_fail(ERR_NOMEM, "no memory to look for tags in %d x %d px", w, h);
    for (int i = 0; i < zarray_size(found) && *n < APRILTAGS_MAX; i++) {
        apriltag_detection_t *d;
        zarray_get(found, i, &d);
        out[*n] = tag_of(d);
        *n += is_whole(&out[*n], w, h);
    }
    apriltag_detections_destroy(found);
    qsort(out, (size_t)*n, sizeof *out, by_id);
    return OK;
}
