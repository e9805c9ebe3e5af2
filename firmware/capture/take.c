#include "firmware/capture/take.h"

#include <math.h>
#include <stdlib.h>

const struct exposure *take_exposure(const struct take_frame *f)
{
    return &f->evidence.exposure;
}

double take_exposure_s(const struct take_frame *f)
{
    return take_exposure(f)->time_s * take_exposure(f)->gain;
}

const char *take_format(enum camera_format f)
{
    static const char *const words[CAMERA_FORMATS] = {
        "any",     "rgb8",    "bgr8",    "yuyv",    "nv12",    "mjpg",    "grey",
        "grey16",  "rggb16",  "bggr16",  "grbg16",  "gbrg16",  "rggb10p", "bggr10p",
        "grbg10p", "gbrg10p", "rggb12p", "bggr12p", "grbg12p", "gbrg12p"};
    return (unsigned)f < CAMERA_FORMATS ? words[f] : NULL;
}

/* Whether two cameras took the same exposure. */
static bool same_exposure(const struct take_frame *a, const struct take_frame *b)
{
    double x = a->evidence.requested.time_s, y = b->evidence.requested.time_s;
    return a->camera != b->camera && fabs(x - y) <= 0.01 * x;
}

double take_skew_s(const struct take *t)
{
    double worst = 0;
    for (int a = 0; a < t->n; a++)
        for (int b = 0; b < a; b++)
            if (same_exposure(&t->frame[a], &t->frame[b]))
                worst = fmax(worst, fabs((double)(t->frame[a].start.monotonic_ns -
                                                  t->frame[b].start.monotonic_ns)) /
                                        1e9);
    return worst;
}

int take_lens_moved(const struct take *t)
{
    for (int a = 0; a < t->n; a++)
        for (int b = 0; b < a; b++) {
            const struct take_frame *x = &t->frame[a], *y = &t->frame[b];
            if (x->camera == y->camera && x->lens_known && y->lens_known &&
                fabs(x->lens - y->lens) >= TAKE_LENS_STEP)
                return x->camera;
        }
    return -1;
}

bool take_unverified(const struct take *t)
{
    for (int k = 0; k < t->n; k++)
        if (t->frame[k].evidence.proof >= BRACKET_UNVERIFIED)
            return true;
    return false;
}

void take_free(struct take *t)
{
    for (int i = 0; t && i < TAKE_FRAMES_MAX; i++) {
        free(t->frame[i].data);
        free(t->frame[i].ghost.moved);
    }
    free(t);
}
