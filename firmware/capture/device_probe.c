/* Frames are fetched one by one, counted, and measured on a subsampled picture where the caller
 * asks for it. Ages of requests come from label_advance, so that a delay measured here means the
 * same to the bracket machine. Time stamps are only compared with each other and, for the record,
 * with the arrival. */
#include "firmware/capture/device_probe.h"

#include "firmware/base/backends.h"
#include "firmware/base/engine.h"
#include "firmware/capture/calib.h"

#include "drivers/format/subsample.h"

#include <math.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define SECOND INT64_C(1000000000)
#define WALL_NS INT64_C(1000000000000000000) // 30 years: above this it is wall time

enum {
    BUSY_FRAMES = 10,
    UNUSABLE_MAX = 100,
    GAP_MAX = 64,
    FLOOR = 24 // display code
};

/* ---- life ---- */

static err_t prepare_probe(struct device_probe *w)
{
    struct bracket_camera about;
    size_t count = subsample_count(&w->info);
    if (!count)
        return err_fail(ERR_UNSUPPORTED, "%s: pictures of %dx%d px cannot be read", w->uri,
                        w->info.w, w->info.h);
    w->sample.px = malloc(count * sizeof *w->sample.px);
    if (!w->sample.px)
        return err_fail(ERR_NOMEM, "%s: no memory for a picture", w->uri);
    w->linear = subsample_kind(&w->info).linear;
    calib_camera(&w->info, NULL, &about);
    label_init(&w->label, &about);
    w->count.stamp_early_s = INFINITY;
    w->count.stamp_late_s = -INFINITY;
    return OK;
}

static err_t open_device(struct device_probe *w, const struct camera_cfg *cfg)
{
    err_t e = backends_camera(cfg->uri, &w->ops);
    if (e)
        return e;
    w->st = calloc(1, w->ops->state_bytes);
    if (!w->st)
        return err_fail(ERR_NOMEM, "%s: no memory for the camera", cfg->uri);
    e = w->ops->open(w->st, cfg);
    if (!e) {
        w->ops->info(w->st, &w->info);
        return OK;
    }
    free(w->st);
    w->st = NULL;
    return err_fail(e, "%s: %s", cfg->uri, err_text());
}

err_t device_probe_open(const struct camera_cfg *cfg, struct device_probe **out)
{
    *out = NULL;
    struct device_probe *w = calloc(1, sizeof *w);
    if (!w)
        return err_fail(ERR_NOMEM, "%s: no memory for the camera", cfg->uri);
    w->uri = cfg->uri;
    err_t e = open_device(w, cfg);
    if (!e)
        e = prepare_probe(w);
    if (e)
        device_probe_close(w);
    else
        *out = w;
    return e;
}

void device_probe_close(struct device_probe *w)
{
    if (!w)
        return;
    if (w->st)
        w->ops->close(w->st);
    free(w->st);
    free(w->sample.px);
    free(w);
}

void device_probe_tell(struct device_probe *w, const char *stage, int done, int total)
{
    if (w->progress)
        progress_step(w->progress, stage, done, total, NULL);
}

static int64_t now_of(const struct device_probe *w)
{
    return backends_now(w->ops, w->st);
}

/* ---- counting ---- */

static void count_sequence(struct device_probe *w, const struct frame *f)
{
    struct device_probe_count *c = &w->count;
    const struct label *l = &w->label;
    uint32_t gap = f->sequence - l->sequence;
    double longest = label_longest_s(l), dt = (double)(f->timestamp_ns - l->stamp_ns) * 1e-9;
    bool end = w->info.stamp == CAMERA_STAMP_END;
    bool timed = f->timestamp_ns > 0 && l->stamp_ns > 0;
    bool known = l->n > 1 || (l->n == 1 && l->log[0].age_lo > l->doubt); // how long frames are
    c->repeated += gap == 0;
    c->backward += gap > UINT32_MAX / 2;
    gap = gap == 0 || gap > UINT32_MAX / 2 ? 1 : gap;
    c->lost += (int)gap - 1;
    bool jump = timed && known && dt > ((double)gap + GAP_MAX) * longest;
    c->jumps += jump;
    c->hidden += timed && known && !jump && dt > ((double)gap + 0.5 + end) * longest;
    c->stamps_back += timed && dt <= 0.0;
}

static void count_frame(struct device_probe *w, const struct frame *f, int64_t now)
{
    struct device_probe_count *c = &w->count;
    double late = (double)(now - f->timestamp_ns) * 1e-9;
    if (w->label.seen)
        count_sequence(w, f);
    c->frames++;
    c->flagged += (f->flags & (FRAME_ERROR | FRAME_SHORT)) != 0;
    c->unstamped += f->timestamp_ns <= 0;
    c->stamps_wall += f->timestamp_ns > WALL_NS;
    if (f->timestamp_ns > 0 && f->timestamp_ns <= WALL_NS) {
        c->stamp_early_s = fmin(c->stamp_early_s, late);
        c->stamp_late_s = fmax(c->stamp_late_s, late);
    }
    if (!f->gains_known || f->gains_later)
        return;
    w->red = c->gains_known ? w->red : f->red_gain;
    w->blue = c->gains_known ? w->blue : f->blue_gain;
    c->gains_known = true;
    c->gain_off = fmax(c->gain_off, fabs(f->digital_gain - 1.0));
    c->balance_off = fmax(
        c->balance_off, fmax(fabs(f->red_gain / w->red - 1.0), fabs(f->blue_gain / w->blue - 1.0)));
}

/* ---- frames ---- */

static err_t next_within(struct device_probe *w, double limit_s, struct frame *f)
{
    int64_t end = now_of(w) + (int64_t)(limit_s * 1e9);
    struct timespec tick = {.tv_nsec = SECOND / 10};
    for (;;) {
        if (atomic_load(&engine_cancel))
            return err_fail(ERR_CANCELLED, "cancelled");
        err_t e = w->ops->next(w->st, f);
        w->count.failed += e == ERR_IO;
        if (e != ERR_AGAIN && e != ERR_IO)
            return e;
        if (now_of(w) >= end)
            return err_fail(ERR_TIMEOUT, "no frame came within %.3g s", limit_s);
        struct pollfd p = {.fd = w->ops->fd(w->st), .events = POLLIN | POLLPRI};
        ppoll(&p, 1, &tick, NULL);
    }
}

/* Fetches the next frame that is not a duplicate. */
static err_t fetch_frame(struct device_probe *w, struct frame *f, struct device_probe_frame *out)
{
    double limit_s = 3.0 * label_longest_s(&w->label) + 1.0;
    for (;;) {
        err_t e = next_within(w, limit_s, f);
        if (e)
            return e;
        int64_t now = now_of(w);
        bool again = label_duplicate(&w->label, f);
        count_frame(w, f, now);
        if (again) {
            w->ops->release(w->st, f);
            continue;
        }
        label_advance(&w->label, f, now);
        const struct label_request *r = label_newest(&w->label);
        out->usable = !(f->flags & (FRAME_ERROR | FRAME_SHORT));
        out->age_lo = r ? r->age_lo : 0;
        out->age_hi = r ? r->age_hi : 0;
        out->exposure_known = f->exposure_known;
        out->exposure = f->exposure;
        out->sequence = f->sequence;
        out->stamp_ns = f->timestamp_ns;
        out->arrival_ns = now;
        return OK;
    }
}

/* In the dark, noise that cannot go below black, and black that is not 0, look like light. */
static void doubt_dark(const struct device_probe *w, struct exposure_probe *s)
{
    struct crf srgb;
    crf_srgb(&srgb);
    float floor = exp2f((w->has_crf ? &w->crf : &srgb)->log2x[1][FLOOR]);
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        s->floor[i] = fmaxf(s->floor[i], floor);
        if (s->state[i] == EXPOSURE_PROBE_GOOD && s->x[i] < floor) {
            s->state[i] = EXPOSURE_PROBE_DARK;
            s->good--;
            s->dark++;
        }
    }
}

static err_t look_at(struct device_probe *w, const struct frame *f, struct device_probe_frame *out)
{
    err_t e = out->usable ? subsample_run(&w->info, f, &w->sample) : OK;
    if (e == ERR_NOMEM)
        return e;
    w->count.unreadable += e != OK;
    out->usable = out->usable && !e;
    if (out->usable)
        exposure_probe_measure(&w->sample, w->has_crf ? &w->crf : NULL, &out->seen);
    if (out->usable && !w->linear)
        doubt_dark(w, &out->seen);
    return OK;
}

err_t device_probe_next(struct device_probe *w, bool look, struct device_probe_frame *out)
{
    struct frame f;
    err_t e = fetch_frame(w, &f, out);
    if (e)
        return e;
    if (look)
        e = look_at(w, &f, out);
    w->ops->release(w->st, &f);
    return e;
}

err_t device_probe_unusable(const struct device_probe *w, int n)
{
    return err_fail(ERR_FORMAT, "%s: %d frames in a row cannot be used: %s", w->uri, n,
                    w->count.unreadable ? err_text() : "the camera marks them as bad");
}

err_t device_probe_rest(struct device_probe *w, int frames, struct device_probe_frame *out)
{
    int bad = 0;
    for (;;) {
        bool look = label_newest(&w->label)->age_lo + 1 >= frames;
        err_t e = device_probe_next(w, look, out);
        if (e)
            return e;
        if (!look || out->age_lo < frames)
            continue;
        if (out->usable)
            return OK;
        if (++bad == UNUSABLE_MAX)
            return device_probe_unusable(w, bad);
    }
}

static void copy_codes(const struct raw *px, uint8_t *rgb)
{
    size_t n = (size_t)px->w * (size_t)px->h;
    bool mono = px->cfa == RAW_MONO;
    for (size_t i = 0; i < 3 * n; i++)
        rgb[i] = (uint8_t)px->px[mono ? i / 3 : i];
}

static err_t unpack_all(const struct device_probe *w, const struct frame *f, uint8_t *rgb)
{
    struct raw full = {.px = malloc(unpack_count(&w->info) * sizeof *full.px)};
    if (!full.px)
        return err_fail(ERR_NOMEM, "%s: no memory for a picture", w->uri);
    err_t e = unpack_run(&w->info, f, &full);
    if (!e)
        copy_codes(&full, rgb);
    free(full.px);
    return e;
}

err_t device_probe_picture(struct device_probe *w, int frames, uint8_t *rgb)
{
    struct device_probe_frame s;
    for (int bad = 0; bad < UNUSABLE_MAX;) {
        struct frame f;
        err_t e = fetch_frame(w, &f, &s);
        if (e)
            return e;
        bool old = s.age_lo >= frames;
        if (old && s.usable)
            e = unpack_all(w, &f, rgb);
        w->ops->release(w->st, &f);
        if (e == ERR_NOMEM || (old && s.usable && !e))
            return e;
        w->count.unreadable += e != OK;
        bad += old;
    }
    return device_probe_unusable(w, UNUSABLE_MAX);
}

err_t device_probe_drain(struct device_probe *w)
{
    struct device_probe_frame s;
    for (int i = 0; i < w->info.buffers; i++) {
        struct pollfd p = {.fd = w->ops->fd(w->st), .events = POLLIN};
        if (poll(&p, 1, 0) <= 0)
            return OK;
        err_t e = device_probe_next(w, false, &s);
        if (e)
            return e;
    }
    return OK;
}

err_t device_probe_resume(struct device_probe *w)
{
    struct device_probe_frame s;
    struct device_probe_count before = w->count;
    for (int i = 0; i <= w->info.buffers; i++) {
        err_t e = device_probe_next(w, false, &s);
        if (e)
            return e;
    }
    before.frames = w->count.frames;
    w->count = before;
    return OK;
}

/* ---- requests ---- */

/* Devices round down, to less than a step; those that do not know their steps to less than half. */
static bool is_rounded(const struct camera_info *info, double requested, double set)
{
    double step = info->time_step_s > 0.0 ? info->time_step_s : 0.5 * requested,
           eps = 1e-6 * requested;
    double least = fmin(fmax(requested - step, info->time_min_s), info->time_max_s);
    return set <= fmax(requested, info->time_min_s) + eps && set >= least - eps;
}

err_t device_probe_ask(struct device_probe *w, double time_s, int index)
{
    struct label_request r = {.index = index, .requested = {time_s, 1.0}};
    struct device_probe_frame s;
    err_t e = ERR_BUSY;
    for (int i = 0; i < BUSY_FRAMES && e == ERR_BUSY; i++) {
        r.asked_ns = now_of(w);
        e = w->ops->request(w->st, &r.requested, &r.set);
        w->count.requests++;
        w->count.refused += e != OK;
        err_t frame = e == ERR_BUSY ? device_probe_next(w, false, &s) : OK;
        if (frame)
            return frame;
    }
    if (e)
        return e == ERR_LOST ? e : err_fail(e, "exposure of %g s: %s", time_s, err_text());
    w->count.misread += !is_rounded(&w->info, time_s, r.set.time_s);
    r.answered_ns = now_of(w);
    label_asked(&w->label, &r);
    return OK;
}

double device_probe_expected(const struct device_probe *w)
{
    return label_newest(&w->label)->expect.time_s;
}

int device_probe_in_force(const struct device_probe *w, int delay)
{
    const struct label *l = &w->label;
    for (int i = l->n - 1; i >= 0; i--) {
        if (l->log[i].age_lo >= delay)
            return l->log[i].index;
        if (l->log[i].age_hi >= delay)
            return -1;
    }
    return -1;
}
