#include "firmware/take.h"

#include <stdlib.h>

const struct exposure *take_exposure(const struct take_frame *f)
{
    const struct bracket_evidence *v = &f->evidence;
    return v->reported_known ? &v->reported : &v->set;
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

void take_free(struct take *t)
{
    for (int i = 0; t && i < TAKE_FRAMES_MAX; i++)
        free(t->frame[i].data);
    free(t);
}
