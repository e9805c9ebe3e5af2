/* small_take.h - a take of tiny frames whose light is known, for tests of what happens to takes.
 * Radiance rises along x from 1/16 to 16: 1 saturates in 1 s at gain 1; exposures are 1/16 s times
 * 4 a step. */
#ifndef UNIT_SMALL_TAKE_H
#define UNIT_SMALL_TAKE_H

#include "drivers/format/file.h"
#include "firmware/capture/take.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SMALL_W = 32, SMALL_H = 16, SMALL_BITS = 10, SMALL_BLACK = 64 };

#define SMALL_JPEG "tests/data/img/rgb.jpg" // its size is that of MJPG takes

static inline double small_radiance(int x, int w)
{
    return exp2(8.0 * (x + 0.5) / w - 4.0);
}

static inline double small_exposure_s(int index)
{
    return ldexp(1.0 / 16, 2 * index);
}

/* Red sites of a mosaic get half of the light. */
static inline void small_words(struct take_frame *f, const struct camera_info *info)
{
    const int top = (1 << SMALL_BITS) - 1;
    f->bytes = 2 * (size_t)info->w * (size_t)info->h;
    f->data = malloc(f->bytes);
    for (int i = 0; f->data && i < info->w * info->h; i++) {
        bool red = info->format == CAMERA_RGGB16 && i / info->w % 2 == 0 && i % 2 == 0;
        double x = small_radiance(i % info->w, info->w) * small_exposure_s(f->index);
        long v = SMALL_BLACK + lrint(fmin(red ? x / 2 : x, 1.0) * (top - SMALL_BLACK));
        f->data[2 * i] = (uint8_t)(v & 255);
        f->data[2 * i + 1] = (uint8_t)(v >> 8);
    }
}

static inline void small_jpeg(struct take_frame *f)
{
    struct file_map m;
    if (file_map(SMALL_JPEG, 1 << 20, &m) != OK)
        abort();
    f->bytes = m.n;
    f->data = malloc(m.n);
    if (f->data)
        memcpy(f->data, m.p, m.n);
    file_unmap(&m);
}

static inline void small_frame(struct take *t, int camera, int index)
{
    struct take_frame *f = &t->frame[t->n++];
    struct bracket_evidence *v = &f->evidence;
    f->camera = camera;
    f->index = index;
    if (t->camera[camera].info.format == CAMERA_MJPG)
        small_jpeg(f);
    else
        small_words(f, &t->camera[camera].info);
    v->requested = v->set = (struct exposure){small_exposure_s(index), 1.0};
    v->exposure = v->reported = v->set;
    v->reported_known = v->ratio_known = true;
    v->ratio = v->ratio_asked = 2.0f;
    v->patches = 1000;
    v->proof = BRACKET_REPORTED;
    v->sequence = 4000000000u + (uint32_t)index;
    v->timestamp_ns = v->start_ns = 9007199254740993; // no double holds it
    v->attempts = 1;
    f->start = (struct clocks){9007199254740993, 9007199254740994, 1767323045000000000};
}

/* own: take_free. NULL: no memory. */
static inline struct take *small_take(int cameras, int exposures, enum camera_format format)
{
    struct take *t = calloc(1, sizeof *t);
    if (!t)
        return NULL;
    t->n_cameras = cameras;
    t->metered = true;
    t->tolerance = 0.1;
    t->trigger = (struct clocks){1, 2, 1767323045999999999}; // 2026-01-02 03:04:05
    for (int c = 0; c < cameras; c++) {
        struct camera_info *info = &t->camera[c].info;
        bool jpeg = format == CAMERA_MJPG;
        *info = (struct camera_info){.w = jpeg ? 24 : SMALL_W,
                                     .h = jpeg ? 16 : SMALL_H,
                                     .stride = jpeg ? 0 : 2 * SMALL_W,
                                     .format = format,
                                     .bits = jpeg ? 8 : SMALL_BITS,
                                     .black = jpeg ? 0 : SMALL_BLACK,
                                     .period_s = 1.0 / 30,
                                     .time_min_s = 1e-4,
                                     .time_max_s = 10,
                                     .gain_max = 1,
                                     .exposure_delay = 2,
                                     .gain_delay = -1,
                                     .reports = true};
        snprintf(info->unit, sizeof info->unit, "small-%d", c);
        snprintf(t->camera[c].uri, sizeof t->camera[c].uri, "small:%d", c);
        t->meter[c] = (struct meter_result){.n = 1, .time_s = {0.25}, .stops = 8, .snr = 10};
        for (int i = 0; i < exposures; i++)
            small_frame(t, c, i);
    }
    for (int i = 0; i < t->n; i++)
        if (!t->frame[i].data) {
            take_free(t);
            return NULL;
        }
    return t;
}

#endif
